"""Bonds by exposure and pressure: the film theory's limits, what an impact accumulates, and its bonds in a run."""

from pathlib import Path

import numpy as np
import pytest
from runs import Stopped
from scenes import problems_with, scene, scene_with

from coupler import Result, Scene, run
from coupler.deposition.run import resume
from coupler.errors import ColdsprayError
from coupler.impact.exchange import Impact
from coupler.physics import materials
from coupler.physics.adhesion import (
    EXTRUSION,
    clean_share,
    ligament_bonds,
    ligament_width,
    oxide_film,
    sound_fraction,
)
from coupler.plan.planning import plan

FILM = {"oxide_thickness": "2.5 nm", "oxide_strength": "10 GPa", "oxide_threshold": 0.1}
EXPOSURE = """[adhesion]
kind = "cohesive"
criterion = "exposure"
[materials.SS304]
oxide_thickness = "2.5 nm"
oxide_strength = "10 GPa"
oxide_threshold = 0.1
"""
TEXT = scene(("OFHC_Cu", 20, 600), spacing=2.7, element_size=4.0, diameter=100, height=50, more=EXPOSURE)


def test_clean_metal_under_pressure_meets_and_nothing_else_does() -> None:
    """f = c min((p - p_E) / sigma_0, 1)."""
    sigma = 400e6
    pressure = np.array([EXTRUSION * sigma, (EXTRUSION + 0.5) * sigma, (EXTRUSION + 3.0) * sigma])
    share = sound_fraction(np.full(3, 0.5), pressure, np.full(3, sigma))
    assert share == pytest.approx([0.0, 0.25, 0.5])
    molten = sound_fraction(np.full(3, 0.5), np.array([0.0, 1e6, -1e6]), np.zeros(3))
    assert molten.tolist() == [0.0, 0.5, 0.0]


def test_a_film_stretches_to_its_threshold_and_no_further() -> None:
    """Lengths of a strip of 100: its film covers 100 / (1 - Y') once it has cracked."""
    length = np.array([90.0, 100.0, 125.0, 160.0, 400.0])
    covered = np.minimum(length, 100.0 / (1.0 - 0.2))
    assert clean_share(1.0 - 100.0 / length, 0.2) == pytest.approx(1.0 - covered / length, abs=1e-15)


def test_two_patterns_of_strips_meet_as_the_mean_of_all_positions() -> None:
    """Counted on two gratings, of the periods 1000 and 700, the shares .3 and .4 clean: what is welded, and how wide the strips are."""
    place = np.arange(7000)
    first, second = place % 1000 < 300, place % 700 < 280
    width, welded = 300.0, [np.count_nonzero(first & np.roll(second, shift)) / len(place) for shift in range(700)]
    law = ligament_bonds(np.array([0.3]), np.array([width]), np.array([0.4]), np.array([1.0]), 1e9)
    assert law["strength"] == pytest.approx((2.0 + np.pi) / np.sqrt(3.0) * np.mean(welded))
    strips = 7  # of the first surface: what of each lies on clean metal, in the mean
    assert law["energy"] == pytest.approx(0.5 * law["strength"] * np.mean(welded) * len(place) / strips)


def test_the_law_is_read_and_what_it_cannot_use_is_refused() -> None:
    table = {"kind": "cohesive", "criterion": "exposure"}
    law = scene_with(adhesion=table, materials={"SS304": FILM}).derived.adhesion_law
    assert law.in_impact
    assert law.words == "cohesive, by exposure and pressure, with the oxide films of the metals"
    for change, says in (
        ({"strength": "300 MPa"}, "uses the oxide films: remove it"), ({"kind": "tied"}, "needs kind"),
        ({"threshold": 0.5}, "no effect"),
        ({"pair": [{"metals": ["Ni", "Ni"]}]}, "pair has no effect"),
    ):  # fmt: skip
        assert any(says in problem for problem in problems_with(adhesion=table | change))
    problems = problems_with(adhesion=table, particle={"material": "W"})
    assert any("W has no oxide film: give oxide_thickness" in problem for problem in problems)


def test_ligaments_are_torn_by_the_work_of_their_limit_load() -> None:
    """G = 3/4 (2 + pi) h sigma_f f c c'^2 / (1 - c), whatever the flow stress (docs/theory/bonds.md); a fifth of it in shear."""
    f, c, force, meets = np.array([0.5, 0.4]), np.array([0.5, 0.8]), np.array([16.5, 7.0]), np.array([0.6, 0.9])

    def law_of(sigma: float, stiffness: float) -> dict[str, np.ndarray]:
        strength = np.full(2, sigma)
        return ligament_bonds(f, ligament_width(c, force, strength), meets, strength, stiffness)

    for sigma in (3e8, 9e8):
        law = law_of(sigma, 1e19)
        assert law["energy"] == pytest.approx(0.75 * (2.0 + np.pi) * force * f * c * meets**2 / (1.0 - c), rel=1e-12)
        assert law["shear_energy"] == pytest.approx(law["energy"] / (2.0 + np.pi), rel=1e-12)
        assert law["strength"] == pytest.approx((2.0 + np.pi) / np.sqrt(3.0) * sigma * f * meets, rel=1e-12)
        assert np.all(law["rewelds"] == 1.0)
    soft = law_of(3e8, 1e15)  # the spring opens by w before its strength
    assert np.all(soft["energy"] >= soft["strength"] ** 2 / 2e15)


def test_the_smaller_fragments_and_the_tougher_film_decide() -> None:
    nickel, copper = materials.material("Ni"), materials.material("Cu")
    assert oxide_film(nickel, copper) == oxide_film(copper, nickel) == pytest.approx((0.10, 7.0))
    with pytest.raises(ColdsprayError, match=r"Ag has no oxide film.*\[materials.Ag\]"):
        oxide_film(nickel, materials.material("Ag"))


def test_films_of_the_library_follow_from_their_thickness() -> None:
    """K = sigma_f sqrt(1.976 h), K = 0.6 MPa sqrt(m), for all but Cu2O, whose strength is a tenth of its modulus; the table of
    docs/theory/bonds.md has two digits."""
    films = {name: found.material for name, found in materials._library().items() if found.material.oxide_thickness}
    assert {"Ti", "Ti6Al4V", "SS304", "SS316L", "IN718", "Zn", "Ta", "Fe", "AZ31B", "Ni", "OFHC_Cu", "Al"} <= set(films)
    for name, metal in films.items():
        tough = 0.6e6 / np.sqrt(1.976 * metal.oxide_thickness)
        assert metal.oxide_strength == pytest.approx(2.8e9 if name == "OFHC_Cu" else tough, rel=0.02), name
        assert metal.oxide_strength <= tough * 1.02


def test_a_particle_of_few_points_is_told_that_its_bonds_come_out_too_weak() -> None:
    few = [text for text in plan(Scene.from_text(TEXT, "few")).warnings if "too few for bonds by exposure" in text]
    assert len(few) == 1
    many = TEXT.replace("2.7 um", "0.6 um")
    assert many != TEXT
    assert not any("too few" in text for text in plan(Scene.from_text(many, "many")).warnings)


@pytest.fixture(scope="module")
def exposed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, dict[str, np.ndarray]]:
    seen: dict[str, np.ndarray] = {}

    def probe(impact: Impact) -> None:
        e = impact.exposure
        if e is not None:
            for name in ("clean", "sound"):
                now = getattr(e, name)[:, 0] if name == "clean" else getattr(e, name)
                assert np.all(now >= seen.get(name, 0.0))
                seen[name] = now.copy()
        if impact.bonds is not None and "sinking" not in seen:
            seen["sinking"] = np.array(impact.sinking)
        if impact.bonds is not None:
            seen["rows"], seen["strength"] = impact.bonds.bond.nodes, impact.bonds.bond.strength[:, 0].copy()
        depth, vertices = impact.contact.depth, impact.surface.weights.shape[0]
        if impact.sinking < 200.0 and impact.force[2] > 0.2 * seen.setdefault("peak", impact.force[2].copy()):
            shares = depth[:vertices].sum(), impact.surface.at_vertices(depth).sum(), depth.sum()
            seen["depths"] = seen.get("depths", 0.0) + np.array(shares)
        seen["peak"] = np.maximum(seen.get("peak", 0.0), impact.force[2])

    folder = tmp_path_factory.mktemp("exposure")
    return run(Scene.from_text(TEXT, "exposure"), folder / "out", probe=probe), seen


def test_an_impact_exposes_metal_and_bonds_it(exposed: tuple[Result, dict[str, np.ndarray]]) -> None:
    result, seen = exposed
    assert 0.1 < seen["clean"][seen["rows"]].mean() < 0.9
    assert np.all(seen["sound"] <= seen["clean"] + 1e-12)
    assert np.ptp(seen["strength"]) > 50e6  # each place has its own bond
    assert seen["strength"].max() < 2.97 * 600e6  # no more than work-hardened copper bears between cracks
    assert result.verdict_by_bonds in ("sticks", "rebounds")
    assert result.bonded_area_m2 > 0.0
    assert abs(result.energy_drift) < 7e-3  # 250 points, stiff contact; in the rebound it changes by less than 1e-5


def test_pressure_that_points_carry_counts_at_the_vertices(exposed: tuple[Result, dict[str, np.ndarray]]) -> None:
    """Where the particle is flat its points come through its surface and carry half of the force: the vertices above them press."""
    alone, with_points, all_ = exposed[1]["depths"]
    assert alone < 0.8 * all_
    assert with_points > 0.93 * all_


def test_places_bond_where_the_crater_runs_away_from_a_particle_that_still_sinks(
    exposed: tuple[Result, dict[str, np.ndarray]],
) -> None:
    """A place bonds when its own pressure falls, so that bonds are there before the greatest deformation."""
    assert 0 < exposed[1]["sinking"] < 500.0


@pytest.mark.slow
def test_it_goes_on_from_a_checkpoint(exposed: tuple[Result, dict[str, np.ndarray]], tmp_path: Path) -> None:
    def stop(impact: Impact) -> None:
        if impact.bonds is not None and impact.time > 20e-9:
            raise Stopped

    with pytest.raises(Stopped):
        run(Scene.from_text(TEXT, "exposure"), tmp_path / "out", probe=stop, checkpoint_every=0.0)
    again = resume(tmp_path / "out")
    for name in ("bonded_area_m2", "bonded_area_end_m2", "velocity_z_m_s"):
        assert again.values[name] == pytest.approx(exposed[0].values[name], rel=1e-9), name
