"""An impact on its own cut of the target, and impacts side by side."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import scenes
from blocks import block, substrate

from coupler import Scene
from coupler.contact.bodies import ContactPast
from coupler.contact.contact import ContactSums
from coupler.contact.model import new_history
from coupler.core.records import copied, rows_of
from coupler.deposition.task import Task, attempt, prepare
from coupler.fe.explicit import Target
from coupler.fe.mesh import prepare as prepare_mesh
from coupler.geometry import mesher
from coupler.impact.domains import build_domains, build_target
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_chunk
from coupler.impact.run import RunOptions
from coupler.physics.adhesion import Adhesion
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.progress import Progress
from coupler.target.bodies import Bodies
from coupler.target.cut import cut_out, put_back
from coupler.target.positions import points_of_impact


@pytest.fixture(scope="module")
def whole() -> Bodies:
    """Two cubes on a block, bonded; with a history of friction."""
    law = law_record(material("Ni"))
    cubes = [block((-25e-6 + 30e-6 * i, -10e-6, 0.0), 1e8, 1.0, law) for i in range(2)]
    bodies = substrate().joined(cubes, Adhesion(kind="tied"), 5e-6, (0.0, 0.0, 0.0), None, 1)
    assert bodies.contact is not None
    springs = bodies.contact.past().nodes
    springs["spring"] = np.random.default_rng(1).normal(size=(len(springs), 3)) * 1e-9
    bodies.contact.continue_from(ContactPast(springs, ContactSums(friction_heat=2e-9)))
    return bodies


def test_nodes_of_the_mass_for_a_step_bear_it(whole: Bodies) -> None:
    contact = whole.contact
    assert contact is not None
    mass = np.full(len(whole.target.nodes.x), contact.pairs.mass_for(1e-9))
    assert contact.stable_dt(mass) == pytest.approx(1e-9)
    moving = int(contact.surfaces.facets.max()) // 2
    lighter = np.where(np.arange(len(mass)) < moving, 1.0, 0.01) * mass  # of nodes that never move
    assert contact.stable_dt(lighter, moving=moving) == pytest.approx(1e-9)
    assert contact.stable_dt(lighter) == pytest.approx(1e-10)
    assert contact.stable_dt(mass, 1e-9) == pytest.approx(1e-9 / np.sqrt(2.0))
    assert contact.stable_dt(mass, 1e-9, 0) == 1e-9  # nothing moves


def test_a_cut_put_back_changes_nothing(whole: Bodies) -> None:
    part, cut = cut_out(whole, (-24e-6, 0.0, 10e-6), 10e-6)
    assert part.count == 2
    assert 0 < len(cut.elements) < len(part.target.mesh.conn) < len(whole.target.mesh.conn)
    same = put_back(whole, [(cut, part)])
    for name in ("nodes", "elements"):
        before, after = getattr(whole.target, name), getattr(same.target, name)
        for row in rows_of(before):
            if "number" not in row:
                np.testing.assert_array_equal(getattr(after, row), getattr(before, row), err_msg=row)
    assert whole.bond is not None
    assert same.bond is not None
    assert same.contact is not None
    assert whole.contact is not None
    assert {(a, *b) for a, b in zip(same.bond.nodes, same.bond.triangles.tolist(), strict=True)} == {
        (a, *b) for a, b in zip(whole.bond.nodes, whole.bond.triangles.tolist(), strict=True)
    }
    np.testing.assert_array_equal(same.contact.past().nodes, whole.contact.past().nodes)
    np.testing.assert_array_equal(same.buried, whole.buried)
    assert same.energy == pytest.approx(whole.energy, rel=1e-12)


def test_a_cut_holds_all_elements_round_the_nodes_that_move() -> None:
    """Where elements grow fast outwards, too: the pressure of a node is that of all elements round it."""
    points, tets = mesher.cylinder(160e-6, 80e-6, 4e-6, 4e-6, 1.0)
    mesh = prepare_mesh(points, tets)
    target = Target(mesh, law_record(material("SS304")), 300.0, fixed=("bottom",), track_wave=False)
    bodies = Bodies(target, np.zeros(len(mesh.conn), np.int32), ("bottom",), (), 0.3)
    part, cut = cut_out(bodies, (0.0, 0.0, 0.0), 25e-6)
    distance = np.linalg.norm(target.nodes.x, axis=1)
    moving = distance <= distance[cut.nodes].max()
    needed = np.flatnonzero(moving[mesh.conn].any(axis=1))
    assert np.isin(needed, part.target.elements.element_number).all()
    assert len(part.target.mesh.conn) < 0.8 * len(mesh.conn)


def test_what_faces_nothing_in_a_cut_keeps_its_contact(whole: Bodies) -> None:
    """At the rim of a cut what lies opposite is not there: nodes at rest are not looked at, and lose no spring."""
    part, _ = cut_out(whole, (-24e-6, 0.0, 10e-6), 10e-6)
    contact, x = part.contact, part.target.nodes.x
    assert contact is not None
    moving = int(np.count_nonzero(np.linalg.norm(x - (-24e-6, 0.0, 10e-6), axis=1) < 10e-6))
    springs = contact.past().nodes
    springs[np.linalg.norm(x - (-24e-6, 0.0, 10e-6), axis=1) < 20e-6] = new_history(1)
    contact.continue_from(ContactPast(springs))
    held = contact.pairs.penalty_energy
    contact.search(x, 1e-7, part.bond, moving)
    contact.forces(0.0, x, np.zeros_like(x), np.zeros_like(x), moving)
    assert contact.pairs.sums.dropped == 0
    assert 0.0 < 0.9 * held < contact.pairs.penalty_energy <= held  # some pass to bonds


def test_cuts_put_back_together_are_those_put_back_one_after_another(whole: Bodies, rng: np.random.Generator) -> None:
    """Two cuts that share no node, each changed in what its impact can change."""
    parts = []
    for x in (-24e-6, 24e-6):
        part, cut = cut_out(whole, (x, 0.0, 10e-6), 10e-6)
        own = np.isin(part.state().target.nodes.node_number, cut.nodes)
        part.target.nodes.x[own] += rng.normal(scale=1e-9, size=(int(own.sum()), 3))
        part.target.balance.plastic += 2.0**-30
        parts.append((cut, part))
    assert not np.intersect1d(parts[0][0].nodes, parts[1][0].nodes).size
    together, turn_by_turn = put_back(whole, parts), whole
    for part in parts:
        turn_by_turn = put_back(turn_by_turn, [part])
    assert np.abs(together.target.nodes.x - whole.target.nodes.x).max() > 1e-9
    assert together.target.balance.plastic == whole.target.balance.plastic + 2.0**-29
    np.testing.assert_equal(asdict(together.state()), asdict(turn_by_turn.state()))


def test_a_cut_stores_what_its_own_bonds_and_contacts_hold(whole: Bodies, rng: np.random.Generator) -> None:
    """Of two cubes whose bonds and friction springs are under load one is in the cut: its energy is that of its first step, and the
    whole has its own again once the cut is put back."""
    loaded = Bodies.from_state(whole.state(), whole.fixed, whole.absorbing, whole.friction, conduction=False)
    loaded.target.nodes.x[:] += rng.normal(scale=2e-9, size=loaded.target.nodes.x.shape)

    def one_step(bodies: Bodies) -> None:
        bodies.search(1e-8)
        bodies.forces(0.0)

    one_step(loaded)
    assert loaded.bond is not None
    assert loaded.contact is not None
    assert loaded.contact.pairs.penalty_energy > 0.0
    part, cut = cut_out(loaded, (-24e-6, 0.0, 10e-6), 10e-6)
    assert part.bond is not None
    assert 0.2 * loaded.bond.stored < part.bond.stored < 0.8 * loaded.bond.stored
    before, stored = part.energy, part.bond.stored
    one_step(part)
    assert part.bond.stored == pytest.approx(stored, rel=1e-9)
    assert part.energy == pytest.approx(before, rel=1e-9)
    again = put_back(loaded, [(cut, part)])
    assert again.energy == pytest.approx(loaded.energy, rel=1e-9)
    one_step(again)
    assert again.energy == pytest.approx(loaded.energy, rel=1e-9)


@pytest.mark.parametrize("way", ["numbered anew", "cut out and put back"])
def test_heat_of_friction_is_not_lost_where_bodies_are_made_anew(whole: Bodies, way: str) -> None:
    bodies = Bodies.from_state(whole.state(), whole.fixed, whole.absorbing, whole.friction, conduction=False)
    t = bodies.target
    t.nodes.v[bodies.contact.surfaces.nodes_of(1) if bodies.contact else []] = [300.0, 0.0, -20.0]
    t.nodes.x[np.unique(t.mesh.conn[bodies.body == 1])] -= [0.0, 0.0, 3e-8]
    bodies.bond = None
    bodies.search(1e-7)
    assert bodies.contact is not None
    rubbed, before = bodies.contact.pairs.sums.friction_heat, t.balance.heat
    for _ in range(3):
        bodies.forces(1e-10)
    heat = bodies.contact.pairs.sums.friction_heat - rubbed
    assert heat > 1e-14
    if way == "numbered anew":
        after = bodies.renumbered((0.0, 0.0, 0.0))
    else:
        part, cut = cut_out(bodies, (-24e-6, 0.0, 10e-6), 10e-6)
        after = put_back(bodies, [(cut, part)])
    assert after.target.balance.heat - before == pytest.approx(heat, rel=1e-9)


def test_the_step_of_contacts_does_not_depend_on_the_last_search(whole: Bodies) -> None:
    """A resumed run searches at other times than one in one piece, and takes the same steps."""
    contact, target = whole.contact, whole.target
    assert contact is not None
    steps = []
    for travel in (1e-9, 2e-6, 2e-5):
        contact.restore(copied(contact))
        contact.search(target.nodes.x, travel, whole.bond)
        steps.append(contact.stable_dt(target.mass * np.linspace(1.0, 2.0, len(target.mass)), 1e-9))
    assert steps[0] < 1e-9
    assert steps[1:] == steps[:1] * 2


def test_an_impact_on_its_cut_is_that_on_the_whole_target() -> None:
    """With the same window, to the last bit."""
    planned = plan(Scene.from_text(scenes.SIDE, "x"))
    whole = build_target(planned).renumbered((0.0, 0.0, 0.0))
    (place,) = points_of_impact(whole, [planned.impacts[0].offset])
    positions = []
    for bodies in (whole.renumbered(place), cut_out(whole, place, planned.impacts[0].window)[0]):
        prepare(planned, 0, bodies, place)
        domains = build_domains(planned, 0, bodies)
        impact = Impact(domains)
        try:
            for _ in range(6):
                advance_chunk(impact)
            assert impact.force[2] != 0.0
            positions.append((np.array(domains.particle.x), bodies.target.nodes.x[: bodies.target.active_nodes].copy()))
        finally:
            domains.particle.close()
    for on_whole, on_cut in zip(*positions, strict=True):
        np.testing.assert_array_equal(on_cut, on_whole)


def test_the_edge_gives_way_in_the_impact_and_is_led_back_after_it(tmp_path: Path) -> None:
    """What lies beyond has not moved: so the cut can be put back."""
    planned = plan(Scene.from_text(scenes.SIDE, "x"))
    whole = build_target(planned).renumbered((0.0, 0.0, 0.0))
    (place,) = points_of_impact(whole, [planned.impacts[0].offset])
    part, cut = cut_out(whole, place, planned.impacts[0].window)
    moved: list[float] = []
    rest: dict[int, np.ndarray] = {}

    def watch(impact: Impact) -> None:
        t = impact.target
        assert t.edge is not None
        rest.update(zip(t.nodes.node_number[t.edge.nodes].tolist(), t.edge.rest, strict=True))
        moved.append(float(np.abs(t.nodes.x[t.edge.nodes] - t.edge.rest).max()))

    options = RunOptions(Progress(True), tmp_path / "log", probe=watch)
    result = attempt(Task(planned, 0, part.state(), place, 0.0, None, tmp_path / "task", {}), options)
    assert max(moved) > 1e-9
    after = result.bodies.target.nodes
    place_of = {number: i for i, number in enumerate(after.node_number.tolist()) if number >= 0}
    x = np.array([after.x[place_of[number]] for number in rest])
    np.testing.assert_allclose(x, np.array(list(rest.values())), rtol=0.0, atol=1e-18)
    assert np.isin(list(rest), cut.nodes).all()
