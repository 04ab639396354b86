"""Critical velocities against hand calculations, the adhesion of a scene, and its messages."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import scene

from coupler import Scene
from coupler.errors import ColdsprayError, SceneError
from coupler.physics import materials
from coupler.physics.adhesion import Adhesion, PairBond, critical_velocity
from coupler.physics.constitutive import is_metal, law_record
from coupler.plan.planning import plan


def test_schmidts_formula_by_hand() -> None:
    nickel = replace(materials.material("Ni"), sigma_TS=317e6)
    mechanical = 1.2 * 4 * 317e6 / 8906  # at 293 K nothing is softened
    thermal = 0.3 * 456 * (1726 - 293)
    assert critical_velocity(nickel, 293.0) == pytest.approx(np.sqrt(mechanical + thermal))
    assert critical_velocity(nickel, 293.0) == pytest.approx(606, abs=1)
    half = 0.5 * (293 + 1726)
    warm = 1.2 * 4 * 317e6 * 0.5 / 8906 + 0.3 * nickel.cp_at(half) * (1726 - half)
    assert critical_velocity(nickel, half) == pytest.approx(np.sqrt(warm))
    assert critical_velocity(nickel, 1726.0) == 0.0


@pytest.mark.parametrize("name", ["Ni", "Ti", "SS304", "OFHC_Cu", "Al"])
def test_the_library_has_strengths_with_their_sources(name: str) -> None:
    metal = materials.material(name)
    assert metal.sigma_TS is not None
    assert 100e6 < metal.sigma_TS < 600e6
    assert "sigma_TS" in metal.source
    assert critical_velocity(metal, 300.0) > critical_velocity(metal, 600.0) > 200.0


def test_a_metal_without_strength_says_what_to_do() -> None:
    with pytest.raises(ColdsprayError, match=r"42CrMo4 has no sigma_TS.*\[materials.42CrMo4\]"):
        critical_velocity(materials.material("42CrMo4"), 300.0)
    catalogue, problems = materials.from_scene({"Mine": {"base": "42CrMo4", "sigma_TS": "1 GPa"}})
    assert problems == []
    assert catalogue["Mine"].sigma_TS == 1e9
    assert critical_velocity(catalogue["Mine"], 300.0) > 500


def test_what_each_criterion_bonds() -> None:
    strain, pressure = np.array([0.1, 0.9, 2.0]), np.array([3e9, 1e9, 0.0])
    cohesive = {"kind": "cohesive", "strength": 3e8, "energy": 20.0}
    assert not Adhesion().bonded(3).any()
    assert Adhesion(kind="tied").bonded(3).all()
    by_strain = Adhesion(criterion="plastic_strain", threshold=0.9, **cohesive)
    assert by_strain.bonded(3, plastic_strain=strain).tolist() == [False, True, True]
    by_pressure = Adhesion(kind="tied", criterion="pressure", threshold=1e9)
    assert by_pressure.bonded(3, pressure=pressure).tolist() == [True, True, False]
    by_velocity = Adhesion(kind="tied", criterion="velocity")
    assert by_velocity.bonded(3, velocity_ratio=1.01).all()
    assert not by_velocity.bonded(3, velocity_ratio=0.99).any()


def test_the_law_is_what_bonds_take() -> None:
    assert Adhesion(kind="tied").law() == {}
    law = Adhesion(kind="cohesive", strength=3e8, energy=0.0, shear_strength=2e8).law()
    assert law == {"strength": 3e8, "energy": 0.0, "shear_strength": 2e8}


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"kind": "glued"}, "kind: 'glued' is not one of none, tied, cohesive"),
        ({"kind": "cohesive", "energy": 1.0}, "strength is missing"),
        ({"kind": "cohesive", "strength": 1e8}, "energy is missing"),
        ({"kind": "tied", "strength": 1e8}, "strength has no effect"),
        ({"kind": "cohesive", "strength": 0.0, "energy": 1.0}, "strength must be positive"),
        ({"kind": "cohesive", "strength": 1e8, "energy": -1.0}, "or 0 for a brittle bond"),
        ({"kind": "tied", "criterion": "pressure"}, "threshold is missing"),
        ({"kind": "none", "criterion": "exposure"}, 'exposure" needs kind = "cohesive"'),
        ({"kind": "tied", "criterion": "luck"}, "criterion: 'luck' is not one of"),
        ({"kind": "tied", "threshold": 1.0}, "threshold has no effect"),
        ({"kind": "tied", "criterion": "velocity", "threshold": float("nan")}, "positive number"),
    ],
)
def test_what_makes_no_sense_is_said_by_field(fields: dict, says: str) -> None:
    with pytest.raises(SceneError, match=says) as caught:
        Adhesion(**fields)
    assert len(caught.value.problems) == 1


def test_each_pair_of_metals_has_its_law() -> None:
    law = Adhesion(
        kind="cohesive", strength=4e8, energy=60.0,
        pairs=(PairBond(("Ni", "Cu"), energy=10.0), PairBond(("Cu", "Cu"), strength=1e8, shear_strength=5e7)),
    )  # fmt: skip
    arrays = law.law_on("Cu", ["Ni", "Cu", "Al"])
    assert arrays["strength"].tolist() == [4e8, 1e8, 4e8]
    assert arrays["energy"].tolist() == arrays["shear_energy"].tolist() == [10.0, 60.0, 60.0]
    assert arrays["shear_strength"].tolist() == [4e8, 5e7, 4e8]
    assert law.between("Al", "Ni") is law
    assert Adhesion(kind="tied").law_on("Cu", ["Ni"]) == {}
    for pairs, kind, says in (
        ((PairBond(("Ni", "Cu")), PairBond(("Cu", "Ni"))), "cohesive", "occur twice"),
        ((PairBond(("Ni", "Cu"), strength=-1.0),), "cohesive", "pair Ni - Cu: strength must be positive"),
        ((PairBond(("Ni", "Cu")),), "tied", "pair has no effect"),
    ):
        strong = {"strength": 4e8, "energy": 60.0} if kind == "cohesive" else {}
        with pytest.raises(SceneError, match=says):
            Adhesion(kind=kind, pairs=pairs, **strong)


def test_a_law_record_is_known_as_its_metal() -> None:
    laws = np.concatenate(
        [law_record(materials.material(name), {"rate_hardening": False}, 1e-9) for name in ("Ni", "SS304", "Ni")]
    )
    assert is_metal(laws, materials.material("Ni")).tolist() == [True, False, True]
    laws["rho"] *= 1.003  # of a splat: its mass over the volume of its mesh
    assert is_metal(laws, materials.material("Ni")).tolist() == [True, False, True]


def test_all_problems_at_once() -> None:
    with pytest.raises(SceneError) as caught:
        Adhesion(kind="cohesive", criterion="plastic_strain")
    assert len(caught.value.problems) == 3


def test_a_particle_that_nothing_holds_because_its_critical_velocity_is_not_known_is_told() -> None:
    unknown = scene(("V", 25, 500))
    told = [text for text in plan(Scene.from_text(unknown)).warnings if "[materials.V]" in text]
    assert len(told) == 1
    for known in (scene(("Ni", 25, 500)), unknown + '[adhesion]\nkind = "none"\n'):
        assert not any("sigma_TS" in text for text in plan(Scene.from_text(known)).warnings)
