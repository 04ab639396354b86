"""A particle that bonds in its impact is held while it rebounds; one that does not leaves, and the run goes on without it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import block, substrate
from runs import Stopped
from scenes import TINY, scene

from coupler import Result, Scene, run
from coupler.contact.contact import Contact
from coupler.contact.law import stiffness
from coupler.contact.model import Nodes
from coupler.deposition.run import resume
from coupler.errors import SolverError
from coupler.geometry import mesher
from coupler.geometry.tetrahedra import volumes
from coupler.impact.exchange import Impact
from coupler.impact.verdict import efficiency_range
from coupler.physics.adhesion import Adhesion
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.planning import CONTACT_STIFFNESS, plan
from coupler.target import placing
from coupler.target.bodies import Bodies
from coupler.target.domain import BodyState

COARSE = {"spacing": 3.2, "element_size": 5.5, "diameter": 100, "height": 50}
ONE = scene(("Ni", 25, 500), **COARSE)
STRONG = '[adhesion]\nkind = "cohesive"\nstrength = "462 MPa"\nenergy = "150 J/m2"\n'
WEAK = STRONG.replace("150 J/m2", "8 J/m2")


def test_who_is_held_in_the_impact() -> None:
    assert Adhesion(kind="cohesive", strength=1e8, energy=1.0).in_impact
    assert Adhesion(kind="tied", criterion="pressure", threshold=1e9).in_impact
    assert not Adhesion(kind="tied").in_impact
    assert not Adhesion(kind="tied", criterion="velocity").in_impact
    # the law is kept also for one particle alone
    assert plan(Scene.from_text(ONE + STRONG, "one")).adhesion.kind == "cohesive"


@pytest.mark.slow
def test_springs_of_the_contact_hold_little_of_the_rebound(tmp_path: Path) -> None:
    """Energy of the penalty springs at the greatest deformation over that of the rebound: more than all of it at the stiffness of an
    impact without bonds and 200 points, less than half at the stiffness with bonds. Brittle bonds, which take up next to nothing."""

    def share(numerics: dict[str, float]) -> float:
        held: list[float] = []

        def probe(impact: Impact) -> None:
            if impact.sinking < 0.0:
                held.append(impact.ledger.rows["contact"])

        text = scene(("Ni", 25, 500), **TINY, more=STRONG.replace("150 J/m2", "0 J/m2"))
        result = run(
            Scene.from_text(text, "brittle"), tmp_path / f"{len(numerics)}", quiet=True, numerics=numerics, probe=probe
        )
        return held[0] / (0.5 * result.particle_mass_kg * result.velocity_z_m_s**2)

    assert share({"contact_stiffness": CONTACT_STIFFNESS}) > 1.0
    assert share({}) < 0.5


def test_a_point_above_the_surface_is_not_deep_below_a_steep_facet() -> None:
    """Its box comes near, its plane has the point behind it, nearer facets are no candidates: no contact, however deep it looks."""
    x = np.array([[0.0, 0.0, 0.0], [-4e-6, 0.0, 7e-6], [-4e-6, 2e-6, 1e-6]])
    k, face = stiffness(1e11, 1e-12, 2.4e-6), np.array([[0, 1, 2]])
    contact = Contact(np.zeros(1, int), face, np.ones(1, int), [k], [2.4e-6], 0.0, jump=np.inf)
    p = np.array([[0.0, 1.0e-6, 7.5e-6]])
    contact.search(p, x, 0.0, always=np.array([0]))
    assert contact.rows.tolist() == [0]
    contact.forces(1e-12, Nodes(x, np.zeros((3, 3)), np.zeros((3, 3)), 3))
    assert not contact.points.f.any()
    assert contact.penalty_energy == 0.0


def test_no_hole_around_a_splat() -> None:
    """What sticks out from under a joined body can still be hit: a particle beside it must not fall through."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    new = substrate().joined(
        [block((-10e-6, -10e-6, 0.0), 0.0, 1.0, law)], Adhesion(kind="tied"), 5e-6, (0.0, 0.0, 0.0), 1.0, 1
    )
    mesh = new.target.mesh
    beyond = np.abs(new.target.nodes.x[:, :2]).max(axis=1) > 10.1e-6
    top = mesh.sets["top"]
    out = top[beyond[mesh.facets[top]].any(axis=1)]
    assert np.isin(out, new.reachable()).all()
    assert len(new.buried) > 0


def test_a_splat_put_on_the_surface_keeps_its_volume(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cube of 20 um that reaches 1.2 um into the substrate loses 6 % of its volume there; its free surface makes up for it."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    body = block((-10e-6, -10e-6, -1.2e-6), 0.0, 1.0, law)

    def joined() -> Bodies:
        return substrate().joined([body], Adhesion(kind="tied"), 6e-6, (0.0, 0.0, 0.0), 1.0, 1)

    new = joined()
    own = new.target.mesh.conn[new.body == 1]
    assert volumes(new.target.nodes.x, own).sum() == pytest.approx(8e-15, rel=1e-3)
    assert new.target.nodes.x[np.unique(own), 2].min() > -1e-9, "it lies on the substrate"
    monkeypatch.setattr(placing, "MOST_OFFSET", 0.0)
    with pytest.raises(SolverError, match="changed its volume by -6"):
        joined()


def test_a_splat_that_cannot_be_moved_out_gets_its_volume_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nodes that have been moved out cannot give back what the fitting has changed."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    body = block((-10e-6, -10e-6, -1.2e-6), 0.0, 1.0, law)
    seen: list[float] = []
    move_out = placing._cleared

    def first_fails(splat: BodyState, points: np.ndarray, *others: Any) -> np.ndarray:
        seen.append(volumes(points, splat.tets).sum())
        if len(seen) == 1:
            raise SolverError("its volume")
        return move_out(splat, points, *others)

    monkeypatch.setattr(placing, "_cleared", first_fails)
    new = substrate().joined([body], Adhesion(kind="tied"), 6e-6, (0.0, 0.0, 0.0), 1.0, 1)
    assert seen[0] < 0.96 * 8e-15
    assert seen[1] == pytest.approx(8e-15, rel=1e-3)
    assert new.target.elements.volume[new.body == 1].sum() == pytest.approx(8e-15, rel=0.01)


def test_a_thin_place_does_not_keep_a_splat_from_its_volume() -> None:
    """The lower side of a plate of 4 x 4 x 1 goes down by an eighth; a place of its upper side is too thin to go down as far as the
    rest of it must."""
    points, tets = mesher.box((4.0, 4.0, 1.0), 0.5)
    points = points - points.mean(axis=0)
    upper, lower = points[:, 2] > 0.49, points[:, 2] < -0.49
    middle = np.argmin(np.where(upper, np.hypot(*points[:, :2].T), np.inf))
    down = -0.01 * np.eye(len(points))[middle][:, None] * [0.0, 0.0, 1.0]
    left = volumes(points + down, tets) / volumes(points, tets)
    points += down * 0.87 / (1.0 - left.min())  # its thinnest element keeps 0.13 of its volume
    body = block((0.0, 0.0, 0.0), 0.0, 1.0, law_record(material("Ni"), rate_filter=1e-9))
    splat = replace(body, points=points, tets=tets)
    wanted = points - np.outer(lower, [0.0, 0.0, 0.125])
    whole = volumes(points, tets).sum()
    assert volumes(wanted, tets).sum() > 1.1 * whole
    put_right = placing._of_volume(wanted, splat, np.flatnonzero(lower), 1.0)
    assert volumes(put_right, tets).sum() == pytest.approx(whole, rel=placing.FITTED_VOLUME)
    assert (volumes(put_right, tets) >= placing.LEAST_QUALITY * volumes(points, tets)).all()
    assert np.array_equal(put_right[lower], wanted[lower])


def test_a_thin_rim_that_is_moved_out_moves_as_a_whole() -> None:
    """A plate of 4 x 4 x 0.5 whose lower side goes up by nine tenths of its thickness keeps its elements."""
    points, tets = mesher.box((4.0, 4.0, 0.5), 0.5)
    way = np.zeros_like(points)
    way[points[:, 2] < 1e-9, 2] = 0.45
    moved = placing.carried_along(tets, way)
    before = volumes(points, tets)
    assert (volumes(points + way, tets) / before).min() < placing.LEAST_QUALITY
    assert (volumes(points + moved, tets) / before).min() > placing.LEAST_QUALITY
    np.testing.assert_array_equal(moved[way[:, 2] > 0.0], way[way[:, 2] > 0.0])
    far = np.zeros_like(points)
    far[np.linalg.norm(points[:, :2], axis=1) < 1e-9, 2] = 0.1
    reach = points[placing.carried_along(tets, far)[:, 2] > 0.0, :2].max()
    assert 1.0 < reach < 1.5 * placing.MOVED_EDGES * 0.5


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Result]:
    place = tmp_path_factory.mktemp("bonding")
    return {
        name: run(Scene.from_text(ONE + law, name), place / name) for name, law in (("strong", STRONG), ("weak", WEAK))
    }


def test_strong_bonds_hold_and_weak_ones_do_not(runs: dict[str, Result]) -> None:
    strong, weak = runs["strong"].values, runs["weak"].values
    assert (strong["verdict_by_bonds"], strong["verdict"]) == ("sticks", "undecided")  # the formula says 665 m/s
    assert strong["margin_m_s"] > 10.0
    assert not strong["rebounded"]
    assert strong["restitution"] == 0.0
    assert strong["bonded_area_end_m2"] > 0.5 * strong["bonded_area_m2"]
    assert weak["verdict_by_bonds"] == weak["verdict"] == "rebounds"
    assert weak["margin_m_s"] == -weak["velocity_z_m_s"]
    assert weak["rebounded"]
    assert weak["restitution"] == pytest.approx(weak["velocity_z_m_s"] / 500.0)
    assert weak["restitution"] > 0.02
    assert weak["bonded_area_end_m2"] < 0.02 * weak["bonded_area_m2"]  # of bonds that hold a fiftieth of its energy
    # what tearing off has cost is the fracture energy of what was bonded
    spent = weak["energies"]["bond"] * weak["kinetic_energy_0_J"]
    assert spent == pytest.approx(8.0 * weak["bonded_area_m2"], rel=0.02)
    for summary in (strong, weak):
        assert abs(summary["energy_drift"]) < 7e-3
        assert summary["momentum_error"] < 1e-10
    assert weak["deposition_efficiency"] == 0.0
    assert strong["deposition_efficiency"] is None
    assert strong["deposition_efficiency_range"] == [0.0, 1.0]


def test_two_metals_bond_by_the_law_of_their_pair(runs: dict[str, Result], tmp_path: Path) -> None:
    """Nickel on steel by the weak law, all others by the strong one: digit by digit the run with the weak law."""
    pair = '[[adhesion.pair]]\nmetals = ["SS304", "Ni"]\nenergy = "8 J/m2"\n'
    paired = run(Scene.from_text(ONE + STRONG + pair, "paired"), tmp_path / "paired").values
    for name in ("verdict", "bonded_area_m2", "velocity_z_m_s", "energy_drift"):
        assert paired[name] == runs["weak"].values[name]
    assert paired["verdict_criterion"].endswith("; SS304 on Ni by their own law")


def test_a_held_particle_goes_on_from_a_checkpoint(runs: dict[str, Result], tmp_path: Path) -> None:
    def probe(impact: Any) -> None:
        if impact.bonds is not None and impact.time > 45e-9:
            raise Stopped

    with pytest.raises(Stopped):
        run(Scene.from_text(ONE + STRONG, "strong"), tmp_path / "out", probe=probe, checkpoint_every=0.0)
    again = resume(tmp_path / "out").values
    for name in ("bonded_area_end_m2", "height_m", "energy_drift", "velocity_z_m_s"):
        assert again[name] == pytest.approx(runs["strong"].values[name], rel=1e-9)


def test_one_that_leaves_is_not_joined_and_counts(tmp_path: Path) -> None:
    second = scene(("Ni", 25, 500), ("Ni", 25, 500), **COARSE, tied=False)
    result = run(
        Scene.from_text(second, "two"), tmp_path / "two"
    )  # 0.75 of the critical velocity: nothing is tied silently
    s = result.summary
    assert [impact["rebounded"] for impact in s["impacts"]] == [True, True]
    assert s["joins"][0]["bodies"] == 0
    assert result.deposition_efficiency == 0.0
    # the first has hardened the ground: the second pushes it down less far
    assert 0.0 < result.impact(1)["crater_depth_m"] < result.impact(0)["crater_depth_m"]
    assert int(result.fields(-1, "target").data["body"].max()) == 0


def test_efficiency_is_a_share_of_mass() -> None:
    records = [{"particle_mass_kg": 3.0, "verdict": "sticks"}, {"particle_mass_kg": 1.0, "verdict": "rebounds"}]
    assert efficiency_range(records) == (0.75, 0.75)
    undecided = {"particle_mass_kg": 4.0, "verdict": "undecided"}
    assert efficiency_range([*records, undecided]) == pytest.approx((0.375, 0.875))
    assert efficiency_range([*records, undecided | {"detached_mass_kg": 3.0}]) == pytest.approx((0.375, 0.5))
    gone = efficiency_range([*records, undecided | {"detached_mass_kg": 4.0}])
    assert gone == pytest.approx((0.375, 0.375))  # none of it is left
