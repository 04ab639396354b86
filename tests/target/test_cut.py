"""An impact on its own cut of the target, and impacts side by side."""

import itertools
import math
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scenes
from blocks import block, substrate
from runs import SharedRuns, assert_same_files, assert_same_numbers, break_off
from threadpoolctl import threadpool_info, threadpool_limits

from coupler import Result, Scene
from coupler.contact.bodies import ContactPast
from coupler.contact.contact import ContactSums
from coupler.contact.model import new_history
from coupler.core.records import copied, rows_of
from coupler.core.threads import RANGES, share
from coupler.deposition import batches as deposition_batches
from coupler.deposition import task as deposition_task
from coupler.deposition.replay import BatchReplay
from coupler.deposition.run import resume, run
from coupler.deposition.task import Task, attempt, prepare
from coupler.errors import ColdsprayError
from coupler.fe.explicit import Target
from coupler.fe.mesh import prepare as prepare_mesh
from coupler.files import checkpoint
from coupler.geometry import mesher
from coupler.impact.domains import build_domains, build_target
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_chunk
from coupler.impact.run import RunOptions
from coupler.impact.summary import peak_memory
from coupler.particle.inertia import ENOUGH
from coupler.physics.adhesion import Adhesion
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.batches import LARGEST_BATCH, MEET, Landing, batches_of, side_by_side
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


def three(*offsets: float) -> str:
    """200-point particles for 10 ns, windows of 32 um, at these places (um) along x."""
    head, *particles = scenes.scene(
        ("Ni", 20, 550), ("Ni", 20, 550), ("Ti", 20, 500), spacing=2.7, element_size=5.0, diameter=180, height=50, end=10, every=5,
        of_substrate='window = "32 um"\n',
    ).split("[[particle]]\n")  # fmt: skip
    placed = [f'[[particle]]\noffset = ["{x} um", "0 um"]\n{p}' for x, p in zip(offsets, particles, strict=True)]
    return head + "".join(placed)


SIDE = three(-42, 42, -36)  # two side by side, then one on the first splat


def ranges_of(impacts: Sequence[Landing]) -> list[range]:
    """The numbers of the impacts of each batch."""
    return [range(each.first, each.stop) for each in batches_of(impacts, False)]


@pytest.mark.parametrize(
    ("offsets", "sizes"), [((-42, 42, -36), [2, 1]), ((-42, -36, 42), [1, 2]), ((0, 42, -36), [1, 2])]
)
def test_batches_lie_apart_and_keep_the_order_of_arrival(offsets: tuple[int, ...], sizes: list[int]) -> None:
    """Windows of 32 um and half a diameter between them: 74 um from centre to centre."""
    ranges = ranges_of(plan(Scene.from_text(three(*offsets), "x")).impacts)
    assert [len(r) for r in ranges] == sizes
    assert [i for r in ranges for i in r] == [0, 1, 2]


def test_impacts_pass_only_those_that_their_splats_do_not_meet() -> None:
    dice = np.random.default_rng(4)
    places = [Landing((x, y), 30e-6, 20e-6) for x, y in dice.uniform(-200e-6, 200e-6, (120, 2))]
    order = side_by_side(places)
    assert sorted(order) == list(range(120))
    rank = np.argsort(order)
    apart = np.array([[math.dist(a.offset, b.offset) for b in places] for a in places])
    meet, joined = apart <= MEET * 20e-6, apart <= 70e-6  # half a diameter between windows
    assert all(rank[i] < rank[k] for k in range(120) for i in range(k) if meet[i][k])
    longest = np.ones(120, int)  # chain of impacts that ends with each, whose windows overlap one after the other
    for k in range(120):
        longest[k] += max((longest[i] for i in range(k) if joined[i][k]), default=0)
    ordered = [places[i] for i in order]
    ranges = ranges_of(ordered)
    # an order that only windows decide has as many batches as the longest chain
    assert len(ranges) < 0.9 * longest.max() < 0.9 * len(ranges_of(places))
    for now, then in itertools.pairwise(ranges):  # none can be put off to the next batch, but where that is full
        assert len(then) == LARGEST_BATCH or all(any(joined[order[i]][order[k]] for k in then) for i in now)
    everywhere = [Landing(p.offset, math.inf, p.diameter) for p in places]
    assert side_by_side(everywhere) == list(range(120))


def test_an_impact_on_its_cut_is_that_on_the_whole_target() -> None:
    """With the same window, to the last bit."""
    planned = plan(Scene.from_text(SIDE, "x"))
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


def test_bodies_are_searched_as_far_as_their_surfaces_move_in_a_window_of_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two surfaces move against each other by twice the way of the fastest node at most, from the first touch on."""
    planned, searched, shares = plan(Scene.from_text(SIDE, "x")), list[float](), list[float]()
    search = Bodies.search

    def note(self: Bodies, travel: float, by_speed: bool = False, time: float = 0.0) -> None:
        searched.append(travel)
        search(self, travel, by_speed, time)

    monkeypatch.setattr(Bodies, "search", note)
    domains = build_domains(planned, 0, build_target(planned).renumbered((0.0, 0.0, 0.0)))
    impact = Impact(domains)
    try:
        while impact.time < 15e-9:
            before = impact.target.nodes.x.copy()
            advance_chunk(impact)
            shares.append(2.0 * float(np.linalg.norm(impact.target.nodes.x - before, axis=1).max()) / searched[-1])
    finally:
        domains.particle.close()
    assert 0.5 < max(shares) <= 1.0  # not much farther than it must


def test_the_edge_gives_way_in_the_impact_and_is_led_back_after_it(tmp_path: Path) -> None:
    """What lies beyond has not moved: so the cut can be put back."""
    planned = plan(Scene.from_text(SIDE, "x"))
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


@pytest.mark.parametrize(("after", "jobs"), [(0, 2), pytest.param(2, 1, marks=pytest.mark.slow)])
def test_one_process_and_two_make_the_same_coating_over_a_stop(
    shared_run: SharedRuns, tmp_path: Path, after: int, jobs: int
) -> None:
    """Broken off in the first impact, then two processes, one of which goes on with it; or on a splat that a cut has put back: equal
    to the last bit."""
    whole = shared_run(SIDE)
    assert [join["bodies"] for join in whole.summary["joins"]] == [1, 1]
    assert [impact["numerics"]["inertia"] for impact in whole.summary["impacts"]] == [0.0, ENOUGH, ENOUGH]
    break_off(Scene.from_text(SIDE, "shared"), tmp_path / "out", 4e-9, after=after)
    assert max(path.name for path in (tmp_path / "out" / "impacts").iterdir()) == f"{after + 1:05d}"
    own = peak_memory()
    result = resume(tmp_path / "out", jobs=jobs)
    assert result.summary["run"]["memory_peak_bytes"] >= own  # of this process, too, where others compute the impacts
    assert_same_numbers(whole.summary, result.summary, rel=0.0)
    assert_same_files(whole, result)


def test_a_run_that_ends_after_a_batch_goes_on_from_the_results_of_its_tasks(
    shared_run: SharedRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the pause, before files and checkpoint of the batch are written, and again while its files are: equal to the last bit."""

    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    def impacts() -> set[float]:
        return set(Result(tmp_path / "out").history()["impact"].tolist())

    with monkeypatch.context() as patched:
        patched.setattr("coupler.deposition.fold.rest", ended)
        with pytest.raises(KeyboardInterrupt):
            run(Scene.from_text(SIDE, "shared"), tmp_path / "out", quiet=True)
    assert impacts() == {1.0, 2.0}  # what was computed can be read
    with monkeypatch.context() as patched:
        patched.setattr(BatchReplay, "_go_on", ended)
        with pytest.raises(KeyboardInterrupt):
            resume(tmp_path / "out", quiet=True)
    assert impacts() == {1.0}
    result = resume(tmp_path / "out", quiet=True)
    whole = shared_run(SIDE)
    assert_same_numbers(whole.summary, result.summary, rel=0.0)
    assert_same_files(whole, result)


def test_a_process_of_a_batch_lets_blas_have_one_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the run has in one process: sums over many nodes are the same to the last bit."""

    def threads(*_: object) -> set[int]:
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    monkeypatch.setattr(deposition_task, "attempt", threads)
    with threadpool_limits(2, "blas"):
        assert deposition_task.run_alone(SimpleNamespace(folder=tmp_path / "00001"), {}, 60.0, None, 1) == {1}


@pytest.mark.parametrize(
    ("jobs", "threads", "each"), [(2, 2, "2"), (4, 4, "4 2"), (8, 8, "8 4 2 2"), (2, 1, ""), (2, 8, "8")]
)
def test_the_last_impacts_of_a_batch_share_the_threads(
    jobs: int, threads: int, each: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """each: how many threads an impact has when one, two ... of five tasks are left, as far as they are more than at the beginning."""

    class Waiting(Executor):
        def submit(self, *arguments: object, **options: object) -> Future[Any]:  # type: ignore[override]
            return Future()

    spare, seen = tmp_path / deposition_task.SPARE, {}

    def wait(left: list[Future[Any]], *_: object) -> None:
        seen[len(left)] = spare.read_text() if spare.exists() else None
        left[-1].set_result(None)

    monkeypatch.setattr(deposition_batches, "wait", wait)
    spare.touch()  # of a batch before
    options = RunOptions(Progress(True), Path("log"), threads=threads, jobs=jobs)
    monkeypatch.setattr(deposition_batches, "forecast", lambda _: SimpleNamespace(shares=[(0.0, 0.0)]))
    task = SimpleNamespace(i=0, plan=None)
    found = iter([(task, None)] * 5)
    assert len(deposition_batches.side_by_side(Waiting(), found, tmp_path, options, lambda: None)) == 5
    said = dict(enumerate(each.split(), 1))
    assert seen == {left: said.get(left) for left in range(1, 6)}


@pytest.mark.usefixtures("eight_cores")
def test_a_task_is_given_threads_on_its_way_and_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def pieces(task: SimpleNamespace, options: RunOptions) -> list[int]:
        """How many ranges work is divided into: before the first window, and after it."""
        counts = []
        for _ in range(2):
            ranges: list[tuple[int, int]] = []
            share(lambda lo, hi, ranges=ranges: ranges.append((lo, hi)), 100, 10)
            counts.append(len(ranges))
            (tmp_path / deposition_task.SPARE).write_text("2")
            options.probe(None)
        return counts

    monkeypatch.setattr(deposition_task, "attempt", pieces)
    assert deposition_task.run_alone(SimpleNamespace(folder=tmp_path / "00001"), {}, 60.0, None, 1) == [1, 2 * RANGES]
    ranges: list[tuple[int, int]] = []
    share(lambda lo, hi: ranges.append((lo, hi)), 100, 10)
    assert len(ranges) == 1  # it is gone with the task


def test_a_process_of_a_batch_that_is_ended_is_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Ended(Executor):
        def submit(self, *arguments: object, **options: object) -> Future[Any]:  # type: ignore[override]
            future: Future[Any] = Future()
            future.set_exception(BrokenProcessPool("ended"))
            return future

    monkeypatch.setattr(deposition_batches, "executor", lambda *arguments: Ended())
    with pytest.raises(
        ColdsprayError, match=f"impacts 1 to 2 was ended from outside.*coldspray resume {tmp_path / 'out'}"
    ):
        run(Scene.from_text(SIDE, "x"), tmp_path / "out", quiet=True, jobs=2)
    assert checkpoint.stored(tmp_path / "out")


def test_an_impact_on_a_cut_that_is_undecided_at_its_limit_goes_on(tmp_path: Path) -> None:
    """For as long again as it has had."""
    limited = SIDE.replace('time = "10 ns"', 'at = "rest"\ntime = "3 ns"')
    result = run(Scene.from_text(limited, "x"), tmp_path / "out", quiet=True)
    assert result.undecided is not None
    before = float(result.end["time_s"])
    again = resume(tmp_path / "out", quiet=True)
    assert len(result.impacts) == len(again.impacts) == 1
    assert 1.5 * before < again.end["time_s"] < 2.3 * before
