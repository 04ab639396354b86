"""Where an impact has distorted the target its mesh is made new: what is kept, and when nothing is done."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coupler import Scene, run
from coupler.deposition.equilibrium import settle
from coupler.deposition.remeshing import Gate, crater_diameter, remeshed
from coupler.errors import SplatError
from coupler.fe.patch import patch_of, pinched
from coupler.geometry.apart import apart
from coupler.geometry.mesher import fill
from coupler.geometry.raycast import RaySurface
from coupler.geometry.tetrahedra import volumes
from coupler.geometry.triangles import open_or_double
from coupler.impact.bodies import Bodies
from coupler.impact.domains import Domains, build_target, restored_target
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.splat.renew import renewed_surface

SCENE = """
[[particle]]
material = "Ni"
diameter = "25 um"
velocity = "1000 m/s"
dwell = "0 us"
[[particle]]
material = "Ni"
diameter = "25 um"
velocity = "1000 m/s"
[adhesion]
kind = "tied"
[end]
at = "rest"
[substrate]
material = "SS304"
diameter = "120 um"
height = "60 um"
[resolution]
spacing = "3 um"
element_size = "4.5 um"
"""
ORIGIN = (0.0, 0.0, 0.0)
ELEMENT = 4.5e-6  # m, edge of the elements at the top


class Seen(Exception):
    pass


@pytest.fixture(scope="module")
def hit(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Bodies after a first impact at 1000 m/s, before they are joined."""
    found: dict[str, Any] = {}

    def look(what: Any, i: int, domains: Domains, *_: Any) -> None:
        found.update(what=what, whole=domains.bodies.state())
        raise Seen

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("coupler.deposition.run.join", look)
        with pytest.raises(Seen):
            run(Scene.from_text(SCENE, "remeshing"), Path(tmp_path_factory.mktemp("run")) / "out", threads=1)
    return found


def gate_of(what: Any) -> Gate:
    return Gate.of(what.impacts[1].spacing, what.impacts[1].material.wave_speed)


@pytest.fixture(scope="module")
def cured(hit: dict[str, Any]) -> tuple[Bodies, Bodies, dict[str, Any]]:
    old = restored_target(hit["what"], hit["whole"])
    new, report = remeshed(old, gate_of(hit["what"]), ORIGIN)
    return old, new, report


def test_a_distorted_crater_is_remeshed(cured: tuple[Bodies, Bodies, dict[str, Any]]) -> None:
    old, new, report = cured
    before, after = report["before"], report["after"]
    assert report["remeshed"]
    assert new is not old
    assert before["step_s"] < report["gate_step_s"] or before["quality"] < report["gate_quality"]
    assert after["step_s"] > 1.5 * before["step_s"]
    assert after["quality"] > 2.0 * before["quality"]
    mesh = new.target.mesh
    assert volumes(new.target.x, mesh.conn).min() > 0.0
    assert open_or_double(mesh.facets.astype(np.int64)) == ""
    assert np.all(np.diff(mesh.reach_element) >= 0)
    behind = mesh.conn[mesh.facet_element]
    assert all(np.isin(facet, tet).all() for facet, tet in zip(mesh.facets, behind, strict=True))
    assert sum(len(ids) for ids in mesh.sets.values()) == len(mesh.facets)


def test_what_is_conserved(cured: tuple[Bodies, Bodies, dict[str, Any]]) -> None:
    old, new, report = cured
    before, after = report["before"], report["after"]
    for name in ("mass_kg", "energy_J", "mass_eps_p_kg"):
        assert after[name] == pytest.approx(before[name], rel=1e-12), name
    # stresses made smooth hold less: what they have lost is heat now
    lost = sum(patch["smoothed_J"] for patch in report["patches"])
    warmer = material("SS304").cp_at(600.0) * (after["mass_temperature_kg_K"] - before["mass_temperature_kg_K"])
    assert warmer == pytest.approx(lost, rel=0.25)
    assert after["volume_m3"] == pytest.approx(before["volume_m3"], rel=1e-10)
    mass, speed = old.target.mass, np.linalg.norm(old.target.v, axis=1)
    for name, size in (
        ("momentum_N_s", mass @ speed),
        ("angular_momentum_N_m_s", mass @ (speed * np.linalg.norm(old.target.x, axis=1))),
    ):
        np.testing.assert_allclose(after[name], before[name], atol=1e-12 * size)
    assert after["kinetic_J"] == pytest.approx(before["kinetic_J"], rel=0.02)
    assert new.target.eps_p.min() >= 0.0
    assert np.all(new.target.mass > 0.0)


def top(bodies: Bodies) -> tuple[np.ndarray, np.ndarray]:
    """Positions of all nodes (n,3) m, and the facets (k,3) of the top."""
    mesh = bodies.target.mesh
    return bodies.target.x, mesh.facets[mesh.sets["top"]]


def test_the_crater_keeps_its_shape(cured: tuple[Bodies, Bodies, dict[str, Any]]) -> None:
    """New nodes lie on the old surface, but for the shift along its normals that keeps the volume.

    The shift makes up for what other edges cut off the curved surface: less than the height of an arc over an edge, edge^2 / (8 R).
    R = (diameter / 2)^2 / (2 depth) is the crater's radius of curvature. One of them lies at most the circumradius c of a facet from
    the deepest point, so that the lowest is no higher than the old surface there; remeshing leaves edges up to 1.35 elements,
    c = edge / sqrt(3).
    """
    old, new, report = cured
    (x_old, facets_old), (x_new, facets_new) = top(old), top(new)
    nodes = x_new[np.unique(facets_new)]
    shift = sum(abs(patch["moved_m"]) for patch in report["patches"])
    deepest, lowest = x_old[np.unique(facets_old), 2].min(), nodes[:, 2].min()
    curvature = (0.5 * report["before"]["crater_diameter_m"]) ** 2 / (-2.0 * deepest)
    assert shift < ELEMENT**2 / (8.0 * curvature)
    distance = np.linalg.norm(RaySurface(x_old, facets_old, closed=False).closest(nodes) - nodes, axis=1)
    assert distance.max() < 1.01 * shift
    corners = x_old[facets_old]
    weights = np.random.default_rng(0).dirichlet((1.0, 1.0, 1.0), 50)
    places = np.concatenate([corners.reshape(-1, 3), np.einsum("kj,fjc->fkc", weights, corners).reshape(-1, 3)])
    centre = places[places[:, 2].argmin()]
    near = np.linalg.norm(places - centre, axis=1) < 1.35 * ELEMENT / np.sqrt(3.0)
    assert deepest - shift <= lowest < places[near, 2].max() + shift
    # an area seen from above: second order in the edge, (1 / 8)^2 of the diameter
    assert report["after"]["crater_diameter_m"] == pytest.approx(report["before"]["crater_diameter_m"], rel=0.015)


def test_outside_the_patch_nothing_moves(cured: tuple[Bodies, Bodies, dict[str, Any]]) -> None:
    old, new, _ = cured
    far = old.target.mesh.sets["bottom"]
    was = {tuple(x) for x in old.target.x[np.unique(old.target.mesh.facets[far])]}
    is_now = {tuple(x) for x in new.target.x[np.unique(new.target.mesh.facets[new.target.mesh.sets["bottom"]])]}
    assert was == is_now
    both = {tuple(x): J for x, J in zip(old.target.x, old.target.J, strict=True)}
    same = [both[tuple(x)] == J for x, J in zip(new.target.x, new.target.J, strict=True) if tuple(x) in both]
    assert np.mean(same) > 0.5  # all but the nodes of the cut


def test_the_ledger_and_the_rest(cured: tuple[Bodies, Bodies, dict[str, Any]]) -> None:
    """The remeshed target comes to rest without released energy, its ledger closed over the steps to it."""
    _, new, report = cured  # last of those that use it, for it goes on
    t, kinetic_0 = new.target, 0.5 * 8906.0 * np.pi / 6 * (25e-6) ** 3 * 1e6
    assert abs(sum(patch["smoothed_J"] for patch in report["patches"])) < 0.01 * kinetic_0
    t.rest()
    held, work = t.elastic() + t.sums[0] + t.sums[1], t.internal_work
    settled = settle(new, kinetic_0)
    assert settled["released"] < 0.005
    # what the forces inside have taken up is what is stored and dissipated there
    gained = t.elastic() + t.sums[0] + t.sums[1] - held
    assert gained == pytest.approx(t.internal_work - work, abs=0.002 * kinetic_0)


def test_where_nothing_is_distorted_nothing_is_done(hit: dict[str, Any]) -> None:
    what = plan(Scene.from_text(SCENE, "remeshing"))
    fresh = build_target(what)
    same, report = remeshed(fresh, gate_of(what), ORIGIN)
    assert same is fresh
    assert not report["remeshed"]
    # nor where the gate lets pass what the impact has left
    old = restored_target(hit["what"], hit["whole"])
    same, report = remeshed(old, Gate(step=1e-15, quality=0.0), ORIGIN)
    assert same is old
    assert not report["remeshed"]


def test_a_mesher_that_fails_leaves_the_target(hit: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def no(*_: Any, **__: Any) -> None:
        raise SplatError("gmsh was ended by SIGSEGV")

    monkeypatch.setattr("coupler.deposition.remeshing.apart", no)
    old = restored_target(hit["what"], hit["whole"])
    same, report = remeshed(old, gate_of(hit["what"]), ORIGIN)
    assert same is old
    assert not report["remeshed"]
    assert all("SIGSEGV" in why for patch in report["patches"] for why in patch["failed"])


def test_nothing_is_tried_where_the_worst_elements_must_stay(
    hit: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the step would stay what it is: every try would cost a mesher's run after every impact."""
    monkeypatch.setattr(
        "coupler.deposition.remeshing._loose", lambda bodies: np.zeros(len(bodies.target.mesh.conn), bool)
    )
    monkeypatch.setattr("coupler.deposition.remeshing._remesh_patch", lambda *_: pytest.fail("tried"))
    old = restored_target(hit["what"], hit["whole"])
    same, report = remeshed(old, gate_of(hit["what"]), ORIGIN)
    assert same is old
    assert "touch what is bonded" in report["kept"]


def test_a_patch_that_would_touch_what_is_held_is_none(hit: dict[str, Any]) -> None:
    old = restored_target(hit["what"], hit["whole"]).target.mesh
    allowed = np.zeros(len(old.conn), bool)
    assert patch_of(old, ~allowed, allowed, 0) is None


def test_pinched_surfaces_are_seen() -> None:
    one = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert len(pinched(one)) == 0
    at_a_corner = np.concatenate([one, np.where(one == 0, 0, one + 3)])
    assert pinched(at_a_corner).tolist() == [0]
    at_an_edge = np.concatenate([one, np.where(one <= 1, one, one + 2)])
    assert set(pinched(at_an_edge)) >= {0, 1}


def test_crater_diameter_of_a_cone() -> None:
    """A cone of depth 1 and radius 2: deeper than d it has the radius 2 (1 - d)."""
    phi = np.linspace(0.0, 2.0 * np.pi, 721)
    rim = np.stack([2.0 * np.cos(phi), 2.0 * np.sin(phi), 0.0 * phi], axis=1)
    tip = np.broadcast_to([0.0, 0.0, -1.0], rim[1:].shape)
    cone = np.stack([tip, rim[:-1], rim[1:]], axis=1)
    assert crater_diameter(cone, 0.25) == pytest.approx(3.0, rel=1e-4)
    assert crater_diameter(cone, 2.0) == 0.0


def test_an_open_surface_is_refused() -> None:
    x, t = np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3]])
    with pytest.raises(SplatError, match="not closed"):
        renewed_surface(x, t, 0, 3, 0.5)
    with pytest.raises(SplatError):
        apart(partial(fill, [(x, t)], 0.5), 60.0)
