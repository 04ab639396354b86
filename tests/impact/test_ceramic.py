"""Ceramic particles: elastic impact, tensile stress, and the verdicts embedded, rebounds and broken."""

from pathlib import Path

import numpy as np
import pytest
from scenes import problems_with, scene_with, several

from coupler import run
from coupler.impact.ending import EndCriterion
from coupler.impact.measure import tension
from coupler.impact.verdict import efficiency_range, is_tied, judge, verdict_values
from coupler.physics.adhesion import Adhesion, PairBond, clean_share, oxide_film
from coupler.physics.materials import material
from coupler.plan.planning import plan

MASS = 1e-11  # kg
CERAMIC = plan(scene_with(particle__material="Al2O3", substrate__material="Al")).impact


def test_the_greatest_principal_stress_is_that_of_the_tensor(rng: np.random.Generator) -> None:
    """Three principal stresses, turned at random; Voigt order xx yy zz yz xz xy."""
    principal = rng.normal(size=(50, 3))
    turn = np.linalg.qr(rng.normal(size=(50, 3, 3)))[0]
    s = np.einsum("nik,nk,njk->nij", turn, principal, turn)
    voigt = np.stack([s[:, 0, 0], s[:, 1, 1], s[:, 2, 2], s[:, 1, 2], s[:, 0, 2], s[:, 0, 1]], axis=1)
    np.testing.assert_allclose(tension(voigt), principal.max(axis=1), atol=1e-12)


def test_a_ceramic_is_embedded_or_rebounds_by_its_motion() -> None:
    """Whatever ties metals: a tied law, or bonds by exposure."""
    for law in (Adhesion("tied"), Adhesion("cohesive", criterion="exposure")):
        assert judge(law, CERAMIC, MASS, 30.0, None).verdict == "rebounds"
        assert judge(law, CERAMIC, MASS, 30.0, None, touches=True).verdict == "embedded"
        found = verdict_values(law, CERAMIC, MASS, 0.5, None)
        assert (found["verdict"], found["rebounded"], found["restitution"]) == ("embedded", False, 0.0)
        assert not is_tied(law, CERAMIC)


def test_a_ceramic_that_moves_without_contact_is_not_embedded() -> None:
    """Such as one that slides down the flank of a splat: it can still land, so that its mass counts as lost or as deposited."""
    law = Adhesion("tied")
    found = verdict_values(law, CERAMIC, MASS, -3.0, None, speed=17.0)
    assert (found["verdict"], found["rebounded"], found["restitution"]) == ("undecided", None, None)
    assert "without contact it moves at 17 m/s" in found["verdict_rests_on"]
    assert efficiency_range([found]) == (0.0, 1.0)
    assert judge(law, CERAMIC, MASS, -3.0, None, touches=True, speed=17.0).verdict == "embedded"
    assert judge(law, CERAMIC, MASS, 30.0, None, speed=35.0).verdict == "rebounds"


def test_a_broken_particle_is_lost_and_has_no_rebound() -> None:
    found = verdict_values(Adhesion("tied"), CERAMIC, MASS, 30.0, None, broken="tensile stress")
    assert (found["verdict"], found["verdict_by"], found["rebounded"]) == ("broken", "stress", True)
    assert found["restitution"] is found["rebound_velocity_m_s"] is None
    whole = verdict_values(Adhesion("tied"), CERAMIC, MASS, 0.0, None)
    assert efficiency_range([found, whole]) == (0.5, 0.5)


def test_only_a_law_of_its_pair_bonds_a_ceramic() -> None:
    nickel, alumina = material("Ni"), material("Al2O3")
    law = Adhesion("cohesive", 1e8, 10.0, pairs=(PairBond(("Ni", "Al2O3"), strength=5e7),))
    assert law.joins(nickel, alumina)
    assert law.joins(nickel, material("Al"))
    assert not law.joins(material("Al"), alumina)
    pair = {"metals": ["nickel", "alumina"], "strength": "50 MPa"}
    table = {"kind": "cohesive", "strength": "100 MPa", "energy": "10 J/m2", "pair": [pair]}
    by_other_names = scene_with(substrate__material="alumina", adhesion=table).derived.adhesion_law
    assert by_other_names.joins(nickel, alumina)
    assert by_other_names.between("Al2O3", "Ni").strength == 5e7
    (told,) = problems_with(particle__material="Al2O3", adhesion=table | {"criterion": "velocity"})
    assert "Al2O3 is a ceramic, and has no critical velocity" in told
    exposure, force = oxide_film(nickel, alumina)
    assert clean_share(np.array([0.99]), exposure) == force == 0.0
    on_ceramic = plan(scene_with(substrate__material="Al2O3"))
    assert judge(on_ceramic.adhesion, on_ceramic.impact, MASS, 30.0, None).verdict == "rebounds"
    assert any("Al2O3 is a ceramic" in text for text in on_ceramic.warnings)
    mixed = plan(several({}, {"material": "Al2O3"}))
    assert (mixed.adhesion.kind, mixed.adhesion.criterion) == ("tied", "velocity")
    assert [impact.can_bond for impact in mixed.impacts] == [True, False]


def test_a_ceramic_is_at_rest_when_its_crater_stops_it() -> None:
    """In contact while it rises it is not yet over; stopped there it is embedded; without contact it has left."""
    for force, sinking, met, held in ((1.0, -30.0, False, True), (1.0, 0.1, True, True), (0.0, -30.0, True, False)):
        ending = EndCriterion(500e-9, "rest", 50e-9, 500.0)
        for time, down, push in ((10, 200.0, 3.0), (20, -40.0, 2.0), *((t, sinking, force) for t in range(21, 31))):
            ending.observe(time * 1e-9, down, push, "embedded" if push else "free")
        assert (ending.met(30e-9), ending.loud == ending.time) == (met, held)


def test_a_ceramic_without_a_tensile_limit_is_refused() -> None:
    (problem,) = problems_with(particle__material="Mine", materials={"Mine": {"base": "Ni", "kind": "ceramic"}})
    assert problem.startswith("materials.Mine: tensile_limit: missing: a ceramic needs")


@pytest.mark.slow
def test_an_elastic_sphere_meets_its_half_space_as_by_hertz(tmp_path: Path) -> None:
    """Peak force of two equal spheres' half: 4/3 E* sqrt(R) d^1.5, d = (15 m v^2 / (16 sqrt(R) E*))^0.4 (Johnson (1985), Contact
    Mechanics, 11.4). 1000 points, two of them in the radius of the contact: 5 %. Waves take 5 to 10 % of the velocity."""
    own = {"base": "Al2O3", "E": "100 GPa", "A": "20 GPa", "tensile_limit": "90 GPa"}
    scene = scene_with(
        preset="draft", particle__material="Own", particle__velocity="100 m/s", substrate__material="Own", contact__friction=0.0,
        substrate__diameter="150 um", substrate__height="75 um", output__at="ends", materials={"Own": own},
    )  # fmt: skip
    result = run(scene, tmp_path, threads=1)
    metal, R, v = plan(scene).impact.material, 12.5e-6, 100.0
    mass, E = metal.rho * 4.0 / 3.0 * np.pi * R**3, metal.E / (2.0 * (1.0 - metal.nu**2))
    depth = (15.0 * mass * v**2 / (16.0 * np.sqrt(R) * E)) ** 0.4
    assert result.history("contact_force").max() == pytest.approx(4.0 / 3.0 * E * np.sqrt(R) * depth**1.5, rel=0.05)
    assert result.eps_p_max == 0.0
    assert 0.9 < result.restitution < 1.0
    assert result.values["broken_share"] == 0.0
