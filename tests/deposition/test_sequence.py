"""Several impacts: a finished splat becomes part of the target, and the next particle hits it."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import meshio
import numpy as np
import pytest
from blocks import Blocks, block, substrate
from runs import SharedRuns, assert_goes_on, assert_same_files, assert_same_numbers, break_off
from scenes import SHORT_DOUBLE, scene
from scipy.spatial import Delaunay

from coupler import Result, Scene, run
from coupler.commands.main import main
from coupler.contact.overlap import displacements_out, overlaps
from coupler.deposition import joining
from coupler.deposition.joining import cloud_of, release_time
from coupler.deposition.run import resume
from coupler.deposition.summary import summary
from coupler.errors import SplatError
from coupler.fe import explicit, heat, stability
from coupler.fe import mesh as meshes
from coupler.fe.explicit import Target
from coupler.fe.heat import EVERY
from coupler.files.result import first_step
from coupler.geometry import mesher
from coupler.geometry.points import morton
from coupler.geometry.tetrahedra import boundary_faces, volumes
from coupler.geometry.triangles import enclosed_volume
from coupler.impact.ending import EndCriterion
from coupler.impact.folding import whole_surface
from coupler.impact.summary import ImpactRecord
from coupler.impact.verdict import efficiency_range
from coupler.particle import compiled, frequency, shapes
from coupler.particle.carried_surface import CarriedSurface
from coupler.physics.adhesion import Adhesion
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.ranks.ranks import Ranks
from coupler.report.page import write_report
from coupler.splat.convert import convert
from coupler.target.bodies import Bodies
from coupler.target.domain import domain_now, domain_of, merge
from coupler.target.equilibrium import settle
from coupler.target.positions import level_under, points_of_impact

DOUBLE = scene(("Ni", 25, 500), ("Ti", 22, 450), of_substrate='window = "50 um"\n', every=2)


COMPOSITE = scene(("Cu", 20, 500), ("Ni", 20, 500), spacing=2.3, element_size=3.5, of_substrate='window = "50 um"\n')
COMPOSITE = COMPOSITE.replace("dwell", 'core = { material = "Al2O3", share = 0.2 }\ndwell', 1).replace("rest", "cold")


@pytest.mark.slow
def test_a_splat_with_a_core_is_two_bodies_that_hold_together(shared_run: SharedRuns) -> None:
    """Shell and core have the volumes of their points within 2 %, and stay bonded at nine tenths of their interface or more while the
    next particle hits them. The ledger of both impacts closes, and no material is taken for the other."""
    result = shared_run(COMPOSITE)
    planned = plan(Scene.from_text(COMPOSITE))
    assert [abs(impact["energy_drift"]) < 0.01 for impact in result.summary["impacts"]] == [True, True]
    assert not any(join["detached"] for join in result.summary["joins"])
    cold = result.fields(-1, "cold")
    own, core = cold.data["impact"] == 1, cold.data["core"] > 0.5
    size = volumes(cold.points, cold.cells)
    assert not core[~own].any()
    assert planned.impacts[0].core is not None
    assert size[core].sum() / size[own].sum() == pytest.approx(planned.impacts[0].core.share, abs=0.02)
    surface = np.unique(boundary_faces(cold.cells[core])[0])
    assert np.mean(cold.data["bonded"][surface] > 0.5) > 0.9


def test_a_body_keeps_its_state_as_it_joins() -> None:
    law = law_record(material("Ni"), rate_filter=1e-9)
    body = block((-10e-6, -10e-6, 0.0), 50e6, 0.98, law)
    domain = domain_of(body, "splat1")
    mesh = domain.mesh
    assert float(domain.laws["rho"][0] * mesh.V0.sum()) == pytest.approx(body.mass, rel=1e-12)
    np.testing.assert_allclose(domain.nodes.J, 0.98, rtol=1e-12)
    eta = 0.02
    hugoniot = law["K"][0] * eta / (1 - law["s"][0] * eta) ** 2 * (1 - 0.5 * law["Gamma0"][0] * eta)
    np.testing.assert_allclose(domain.nodes.p, hugoniot, rtol=1e-12)
    F = np.einsum("eni,enj->eij", mesh.points[mesh.conn[:, 1:]] - mesh.points[mesh.conn[:, :1]], mesh.B)
    np.testing.assert_allclose(np.linalg.det(F), 0.98, rtol=1e-12)  # the reference shape is the present one, larger
    np.testing.assert_allclose(domain.elements.s[:, 0], 50e6)
    # and the solver finds the same pressure after a step of no motion
    target = Target(mesh, law, domain.elements.T, fixed=(), track_wave=False)
    target.start_from(domain.nodes, domain.elements, target)
    target.advance(1e-15)
    np.testing.assert_allclose(target.nodes.p, hugoniot, rtol=1e-9)
    heavier = domain_of(replace(body, mass=1.01 * body.mass), "splat1")
    np.testing.assert_allclose(heavier.nodes.p, domain.nodes.p, rtol=1e-12)
    assert heavier.laws["rho"][0] == pytest.approx(1.01 * domain.laws["rho"][0])


@pytest.mark.parametrize("shell", [0.0, 15e-6])
def test_numbering_anew_changes_nothing(shell: float) -> None:
    bodies = substrate()
    rng = np.random.default_rng(3)
    bodies.target.nodes.x[:] += 1e-7 * rng.standard_normal(bodies.target.nodes.x.shape)
    bodies.target.elements.s[:] = 1e7 * rng.standard_normal(bodies.target.elements.s.shape)
    before = domain_now(bodies.target, bodies.body)
    after, rank = merge([before], (20e-6, -10e-6, 0.0), shell=shell)
    np.testing.assert_array_equal(after.nodes.x[rank], before.nodes.x)
    volume = np.linalg.det(after.nodes.x[after.mesh.conn[:, 1:]] - after.nodes.x[after.mesh.conn[:, :1]]) / 6
    assert volume.min() > 0
    assert np.all(np.diff(after.mesh.reach_node) >= 0)
    assert np.all(np.diff(after.mesh.reach_element) >= 0)
    away = np.linalg.norm(after.nodes.x - (20e-6, -10e-6, 0.0), axis=1)
    assert np.all(after.mesh.reach_node <= away * (1 + 1e-12))
    assert np.all(after.mesh.reach_node >= away - shell)
    near = np.searchsorted(after.mesh.reach_element, 25e-6)  # elements with a node so near are the first ones
    assert away[after.mesh.conn[near:]].min() >= 25e-6
    assert {k: len(v) for k, v in after.mesh.sets.items()} == {k: len(v) for k, v in before.mesh.sets.items()}
    np.testing.assert_allclose(sorted(after.elements.s[:, 0]), sorted(before.elements.s[:, 0]))


def test_points_in_the_order_of_the_curve() -> None:
    """Morton's curve through the corners of a cube goes through x first, then y, then z; twice as fine it stays in each eighth."""
    corners = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
    assert np.argsort(morton(corners)).tolist() == list(range(8))
    fine = np.array([[x, y, z] for x in range(4) for y in range(4) for z in range(4)], float)[
        np.random.default_rng(1).permutation(64)
    ]
    eighth = (fine[np.argsort(morton(fine))] // 2).astype(int) @ [1, 2, 4]
    assert eighth.tolist() == np.repeat(range(8), 8).tolist()


@pytest.mark.parametrize("kind", ["tied", "none"])
def test_what_was_in_a_splat_is_there_after(kind: str) -> None:
    law = law_record(material("Ni"), rate_filter=1e-9)
    # 0.5 um off its place: the nodes are put on the facets
    body = block((-10e-6, -10e-6, 0.5e-6), 0.0, 1.0, law)
    new = substrate().joined([body], Adhesion(kind=kind), 5e-6, (0.0, 0.0, 0.0), 1.0, 1)
    own = new.body == 1
    nodes = np.unique(new.target.mesh.conn[own])
    assert new.target.nodes.x[nodes, 2].min() == pytest.approx(0.0, abs=1e-12)
    assert (new.bond is not None) == (kind == "tied")
    report = settle(new, 1e-5)
    assert report["released"] < 1e-6
    np.testing.assert_allclose(new.target.elements.eps_p[own], 0.3, rtol=1e-6)
    np.testing.assert_allclose(new.target.elements.T[own], 400.0, rtol=1e-4)
    assert new.target.mass[nodes].sum() == pytest.approx(body.mass, rel=1e-12)
    # the facets between them can no longer be hit
    reachable = new.target.mesh.facets[new.reachable()]
    low = new.target.nodes.x[reachable].mean(axis=1)
    under = (np.abs(low[:, :2]) < 3e-6).all(axis=1) & (low[:, 2] < 1e-6)  # a ring inside the rim stays
    assert not under.any()


def test_a_splat_is_moved_out_of_what_it_lies_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block with nodes deeper in the substrate than those that are put on facets: nothing overlaps, and its volume is kept."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    body = block((-10e-6, -10e-6, -0.5e-6), 0.0, 1.0, law)
    low = (body.points[:, 2] < 0.0) & (np.hypot(body.points[:, 0], body.points[:, 1]) < 3e-6)
    body.points[low, 2] -= 3e-6

    def joined() -> tuple[Bodies, float]:
        new = substrate().joined([body], Adhesion(kind="none"), 5e-6, (0.0, 0.0, 0.0), 1.0, 1)
        return new, float(overlaps(new.surfaces, new.target.nodes.x, [1]).max())

    new, deepest = joined()
    assert deepest < 0.1e-6
    assert new.target.elements.volume[new.body == 1].sum() == pytest.approx(
        volumes(body.points, body.tets).sum(), rel=0.05
    )
    monkeypatch.setattr("coupler.target.placing.ROUNDS", 0)
    assert joined()[1] > 3e-6


def test_overlap_is_that_of_the_deepest_node() -> None:
    """A cube 0.3 into another: its four corners lie 0.3 deep, the other's nodes in it count too."""
    b = Blocks(((1.0,) * 3, 0.3, (0, 0, 0)), ((0.5,) * 3, 0.25, (0.25, 0.25, 0.7)))
    depth = overlaps(b.surfaces, b.target.nodes.x, [1])
    assert depth.max() == pytest.approx(0.3, rel=1e-3)
    way = displacements_out(b.surfaces, b.target.nodes.x, 1)
    assert not way[b.nodes(0)].any()
    assert np.linalg.norm(way, axis=1).max() == pytest.approx(0.3, rel=1e-3)


def test_no_heat_flows_while_bodies_come_to_rest() -> None:
    """The time that takes is none of the spray's; after it heat flows again."""
    points, tets = mesher.box((60e-6, 60e-6, 20e-6), 6e-6)
    mesh = meshes.prepare(points - np.array([30e-6, 30e-6, 20e-6]), tets)
    T = np.where(mesh.points[mesh.conn].mean(axis=1)[:, 0] > 0.0, 310.0, 300.0)
    target = Target(mesh, law_record(material("SS304"), rate_filter=1e-9), T, track_wave=False, conduction=True)
    bodies = Bodies(target, np.zeros(len(mesh.conn), np.int32), ("bottom",), (), 0.3)
    settle(bodies, 1e-9)
    np.testing.assert_array_equal(bodies.target.elements.T, T)
    for _ in range(2 * EVERY):
        bodies.target.advance(1e-11)
        bodies.target.finish()
    assert np.ptp(bodies.target.elements.T) == pytest.approx(10.0, abs=0.5)
    assert np.any(bodies.target.elements.T != T)


def test_released_energy_is_watched_for_as_long_as_a_wave_takes() -> None:
    def of(*diameters: float) -> float:
        return release_time(cast(Any, SimpleNamespace(impacts=[SimpleNamespace(diameter=d) for d in diameters])))

    assert of(2.5e-6, 1e-6) == pytest.approx(of(25e-6) / 10)
    assert of(60e-6) == of(25e-6)


def test_a_residual_stress_stays() -> None:
    """Equal and opposite layers of stress in a free block stay what they are, up to the rim."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    body = block((-10e-6, -10e-6, 0.0), 0.0, 0.999, law)
    new = substrate().joined([body], Adhesion(kind="tied"), 5e-6, (0.0, 0.0, 0.0), 1.0, 1)
    own = new.body == 1
    before = new.target.nodes.p[new.target.mesh.conn[own]].mean()
    report = settle(new, 1e-9)
    after = new.target.nodes.p[new.target.mesh.conn[own]].mean()
    assert before == pytest.approx(0.001 * law["K"][0], rel=0.01)
    assert abs(after) < 0.5 * before  # free faces let pressure go: it is not frozen in
    assert report["taken_J"] > 0
    assert report["released_J"] < 0.05 * report["taken_J"]


def test_the_next_one_starts_above_the_surface() -> None:
    x = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 5], [4, 0, 5], [0, 4, 5.0]])
    facets = np.array([[0, 1, 2], [3, 4, 5]])
    ball = np.array([[1, 1, -2.0], [6, 1, -2.0]])
    assert level_under(ball, x, facets) == pytest.approx(5 + 2)
    assert level_under(ball[1:], x, facets) == pytest.approx(2.0)
    assert level_under(ball + 100.0, x, facets) == -np.inf


def test_waves_are_reckoned_from_where_the_axis_meets_the_surface() -> None:
    law = law_record(material("Ni"), rate_filter=1e-9)
    bodies = substrate().joined(
        [block((-10e-6, -10e-6, 0.0), 0.0, 1.0, law)], Adhesion("tied"), 5e-6, (0, 0, 0), 1.0, 1
    )
    on, beside, away = points_of_impact(bodies, [(2e-6, 3e-6), (18e-6, 0.0), (90e-6, 0.0)])
    assert on == pytest.approx((2e-6, 3e-6, 20e-6))  # on the block
    assert beside == pytest.approx((18e-6, 0.0, 0.0), abs=1e-12)  # beside it
    assert away == (90e-6, 0.0, 0.0)  # beside everything


def test_a_particle_that_creeps_has_come_to_rest() -> None:
    """Pressed into a heap that gives way it may sink slowly for long; on a plain target it stops or turns."""
    creeping, plain = EndCriterion(1e-6, "rest", 1e-8, 500.0, slow=3.0), EndCriterion(1e-6, "rest", 1e-8, 500.0)
    for time, sinking, force in ((1e-9, 500.0, 1.0), (2e-9, 2.0, 0.1), (4e-9, 1.5, 1e-3)):
        creeping.observe(time, sinking, force)
        plain.observe(time, sinking, force)
    assert creeping.turned == 2e-9
    assert plain.turned is None
    for ending in (creeping, plain):
        ending.observe(5e-9, 1.0, 1e-3)
    assert creeping.reached(5e-9)
    assert not plain.reached(5e-9)


@pytest.fixture
def double(shared_run: SharedRuns) -> Result:
    return shared_run(DOUBLE)


def test_a_double(double: Result) -> None:
    s = double.summary
    first, second = double.impact(0), double.impact(1)
    assert (first["material"], second["material"]) == ("Ni", "Ti")
    for impact in (first, second):
        assert abs(impact["energy_drift"]) < 5e-3
        assert impact["momentum_error"] < 1e-10
    assert (
        double.impacts[0]["at_end"]["flattening_ratio"] > first["flattening_ratio"]
    )  # the second one has pressed it flatter
    assert second["surface_level_m"] == pytest.approx(first["height_m"], abs=1.5e-6)
    assert double.flattening_ratio == second["flattening_ratio"]
    # Its crater is its own, not the hole that the first has left: how far nodes have gone down since; a paraboloid through 16 nodes,
    # some 5 um apart on the splat, lies within a fifth of the lowest.
    met, end = double.fields(first_step(double, 2), "target"), double.fields(-1, "target")
    lowered = (met.points - end.points)[:, 2].max()
    assert second["crater_depth_m"] == pytest.approx(lowered, rel=0.2)
    assert abs(second["crater_depth_m"] - first["crater_depth_m"]) > 0.05 * lowered
    (join,) = s["joins"]
    assert join["bodies"] == 1
    assert join["bonds"] > 20
    assert join["released"] < 0.005
    assert abs(join["conversion"]["volume_error_before"]) < 0.1
    for name in ("eps_p", "T_K"):
        assert join["after"][name] == pytest.approx(join["before"][name], rel=0.01)
    times = double.times("target")
    assert np.all(np.diff(times) > 0)
    assert len(double.fields(-1, "target").cells) > len(double.fields(0, "target").cells)
    assert set(double.history("impact")) == {1.0, 2.0}


def test_fragments_that_no_mesh_holds_count_as_lost(double: Result) -> None:
    """A fifth of the first particle, half of the powder's mass or so: the efficiency is lower by its share, and the user is told."""
    records = [ImpactRecord(values, [], [], 0.0) for values in double.impacts]
    masses = [values["particle_mass_kg"] for values in double.impacts]
    joins = [{**double.summary["joins"][0], "lost_mass_kg": 0.2 * masses[0]}]
    standing = [values.get("at_end", values["end"]) for values in double.impacts]
    made = summary(plan(Scene.from_text(double.scene_text, "double")), records, joins, standing, 1.0, Ranks())
    assert made["impacts"][0]["detached_mass_kg"] == pytest.approx(0.2 * masses[0])
    whole = efficiency_range(double.impacts)
    assert efficiency_range(made["impacts"])[1] == pytest.approx(whole[1] - 0.2 * masses[0] / sum(masses))
    assert any("impact 1: 20.0% of the particle has separated as fragments" in text for text in made["run"]["warnings"])


def test_a_splat_that_cannot_be_meshed_is_a_failed_computation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3, as the scene has no mistake; what was computed can be read."""

    def fails(*_: object) -> None:
        raise SplatError("no mesh of a body of 276 points is good enough")

    monkeypatch.setattr(joining, "convert", fails)
    (tmp_path / "two.toml").write_text(SHORT_DOUBLE)
    assert main(["run", str(tmp_path / "two.toml"), "--out", str(tmp_path / "two"), "--quiet"]) == 3
    assert "impact 1 is computed, but its splat cannot join the target: no mesh of a body" in capsys.readouterr().err
    assert len(Result(tmp_path / "two").times("particle")) > 3


@pytest.mark.usefixtures("eight_cores")
def test_threads_give_the_numbers_of_one(
    shared_run: SharedRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All loops are shared, those of a target this small too: the same to the last bit."""
    one = shared_run(SHORT_DOUBLE)
    for module in (explicit, stability, heat, frequency, compiled):
        for name in filter(lambda name: name.startswith("LEAST"), vars(module)):
            monkeypatch.setattr(module, name, 20)
    two = run(Scene.from_text(SHORT_DOUBLE, "shared"), tmp_path / "two", threads=3)
    assert_same_numbers(one.summary, two.summary, rel=0.0)
    assert_same_files(one, two)


@pytest.mark.parametrize("at", [pytest.param(20e-9, marks=pytest.mark.slow), None], ids=["second", "joined"])
def test_a_sequence_goes_on_to_the_same_end(shared_run: SharedRuns, tmp_path: Path, at: float | None) -> None:
    """Broken off in the second impact of 15 ns, and right after the join."""
    assert_goes_on(SHORT_DOUBLE, shared_run(SHORT_DOUBLE), tmp_path / "out", at)


@pytest.mark.parametrize(
    "ground",
    [
        'height_map = { file = "map.csv" }',
        *(
            pytest.param(shape, marks=pytest.mark.slow)
            for shape in (
                'height_map = { file = "map.stl" }',
                'groove = { width = "40 um", depth = "10 um", angle = "50 deg" }',
                'step = { height = "8 um" }',
            )
        ),
    ],
    ids=["map", "patch", "groove", "step"],
)
def test_a_sequence_on_shaped_ground_goes_on_to_the_same_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ground: str
) -> None:
    """Broken off in the second impact, and resumed where the file of heights is not: the plan has the surface. The report needs no file
    either."""
    axis = 4e-6 * np.arange(-15.0, 16.0)
    x, y = (each.ravel() for each in np.meshgrid(axis, axis))
    waves = np.column_stack([x, y, 2e-6 * np.sin(x / 12e-6) + 1e-6 * np.sin(y / 15e-6)])
    (tmp_path / "scene").mkdir()
    monkeypatch.chdir(tmp_path / "scene")
    np.savetxt("map.csv", 1e6 * waves, delimiter=",")
    meshio.Mesh(1e6 * waves, [("triangle", Delaunay(waves[:, :2]).simplices)]).write("map.stl")
    text = SHORT_DOUBLE.replace("[substrate]", f"[substrate]\n{ground}")
    for old, new in (
        ('diameter = "100 um"', 'diameter = "90 um"'),
        ('"15 ns"', '"10 ns"'),
        ('every = "2 ns"', 'every = "5 ns"'),
    ):
        assert old in text
        text = text.replace(old, new)
    whole = run(Scene.from_text(text, "shared"), tmp_path / "whole", quiet=True)
    break_off(Scene.from_text(text, "shared"), tmp_path / "out", 5e-9, after=1)
    monkeypatch.chdir(tmp_path)
    shutil.rmtree("scene")
    result = resume(tmp_path / "out", quiet=True)
    assert_same_numbers(whole.summary, result.summary, rel=1e-9)
    assert_same_files(whole, result)
    assert write_report(result).stat().st_size > 1_000_000


@pytest.mark.slow
@pytest.mark.parametrize("at", [20e-9, None, 85e-9], ids=["first", "joined", "second"])
def test_a_whole_sequence_goes_on_to_the_same_end(double: Result, tmp_path: Path, at: float | None) -> None:
    assert_goes_on(DOUBLE, double, tmp_path / "out", at)


def test_a_hollow_particle_keeps_its_cavity_when_it_is_meshed() -> None:
    """The surface of its cloud encloses the metal alone: the first strategy makes the body, with its cavity."""
    body = shapes.shape("hollow_sphere", 25e-6, 1000)
    state = {"J": 1.0, "energy": 0.0}
    particle = SimpleNamespace(
        x=body.points, v=np.zeros_like(body.points), stress=lambda: np.zeros((len(body.points), 6)), spacing=body.spacing,
        law=law_record(material("Ni"), rate_filter=1e-9), whole=lambda _: np.full(len(body.points), body.volume),
        points=SimpleNamespace(**{name: np.full(len(body.points), value) for name, value in state.items()}),
        carried=lambda: {"eps_p": np.zeros(len(body.points)), "T": np.full(len(body.points), 300.0)},
    )  # fmt: skip
    outer = CarriedSurface(body.points, body.vertices, body.triangles, body.spacing)
    surface = whole_surface(body, outer, np.zeros(3))
    cloud = cloud_of(cast(Any, SimpleNamespace(particle=particle, whole_surface=surface)))
    assert enclosed_volume(*cloud.surface) == pytest.approx(cloud.volume.sum(), rel=0.03)
    (splat,) = convert(cloud, 1.7 * cloud.spacing).bodies
    assert splat.report["failed"] == []
    assert len(splat.report["surface"]) == 2
