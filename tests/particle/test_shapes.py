"""Particle shapes: equal volume, the paper's aspect ratios, uniform points, closed surfaces; and each of them in an impact."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from scenes import problems_with, scene_with
from scipy.spatial import cKDTree

from coupler import Scene, run
from coupler.geometry.triangles import enclosed_volume, surface_area
from coupler.impact.folding import whole_surface
from coupler.impact.measure import share_inside_itself
from coupler.particle import packing, shapes
from coupler.particle.carried_surface import CarriedSurface
from coupler.physics import shapes as morphology
from coupler.plan.planning import plan
from coupler.plan.text import describe
from coupler.scene.tables import Shape

D = 25e-6
V = np.pi / 6 * D**3
# lengths over the diameter of the sphere of equal volume, and the aspect ratio (doi:10.1016/j.jestch.2023.101579)
ASPECT = {"sphere": 1.0, "hollow_sphere": 1.0, "oblate": 1.67, "rod": 6.17, "flake": 2.41, "angular": 1.31}
OTHERS = [name for name in ASPECT if name != "sphere"]


@pytest.fixture(scope="module", params=list(ASPECT))
def body(request: pytest.FixtureRequest) -> tuple[str, shapes.Body]:
    return request.param, shapes.shape(request.param, D, 2000)


def edges_of(triangles: np.ndarray) -> np.ndarray:
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def solid_angle(at: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Winding number (n,) of a closed surface about points (n,3): 1 inside, 0 outside (Van Oosterom & Strackee 1983)."""
    total = np.zeros(len(at))
    for i, point in enumerate(at):
        a, b, c = (vertices[triangles[:, k]] - point for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        det = np.einsum("ij,ij->i", a, np.cross(b, c))
        dot = np.einsum("ij,ij->i", a, b) * lc + np.einsum("ij,ij->i", b, c) * la + np.einsum("ij,ij->i", c, a) * lb
        total[i] = np.arctan2(det, la * lb * lc + dot).sum() / (2 * np.pi)
    return total


def test_the_names_are_one_list() -> None:
    assert get_args(Shape) == morphology.SHAPES == tuple(morphology.ASPECT)
    assert morphology.ASPECT == ASPECT


def test_a_sphere_is_what_it_was() -> None:
    b = shapes.shape("sphere", D, 1000)
    points, v = packing.sphere(D, 1000)
    skin, triangles = packing.surface(D, 0.8 * v ** (1 / 3))
    for got, want in ((b.points, points), (b.vertices, skin), (b.triangles, triangles)):
        assert np.array_equal(got, want)
    assert (b.volume, b.area, b.half_height) == (v, np.pi * D**2, 0.5 * D)


def test_volume_centre_and_number(body: tuple[str, shapes.Body]) -> None:
    _, b = body
    assert len(b.points) * b.volume == pytest.approx(V, rel=1e-12)
    assert len(b.points) == pytest.approx(2000, rel=0.12)
    assert np.abs(b.points.mean(0)).max() < 1e-9 * D


def test_aspect_ratio_of_surface_and_points(body: tuple[str, shapes.Body]) -> None:
    name, b = body
    lengths = np.array(morphology.form(name, D).lengths)
    extent = np.ptp(b.vertices, axis=0)
    assert extent == pytest.approx(lengths, rel=5e-3)
    assert extent.max() / extent.min() == pytest.approx(ASPECT[name], rel=5e-3)
    assert np.argmax(lengths) == 0  # the longest lies in the plane of the target, the shortest stands on it
    assert np.argmin(lengths[::-1]) == 0
    # the points fill the whole of it: their second moments are the surface's own, within the roughness of a lattice
    inner = [(*b.inner,)] if b.inner else []
    moments = sum(_moments(v, t) for v, t in [(b.vertices, b.triangles), *inner])
    cell = 0.0787 * b.spacing**2
    assert np.sqrt(b.points.var(axis=0) + cell) == pytest.approx(np.sqrt(moments / V), rel=0.025)


def _moments(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Integral (3,) of x^2, y^2, z^2 inside a closed surface, over tetrahedra from the origin."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    v = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    return (v[:, None] * (a**2 + b**2 + c**2 + a * b + b * c + c * a)).sum(0) / 10


def test_spacing_is_uniform(body: tuple[str, shapes.Body]) -> None:
    _, b = body
    tree = cKDTree(b.points)
    nearest = tree.query(b.points, 2)[0][:, 1]
    assert np.ptp(nearest) < 1e-9 * nearest.mean()  # a lattice
    assert nearest.mean() == pytest.approx(2 ** (1 / 6) * b.spacing, rel=0.015)  # fcc: cell over root 2
    neighbours = tree.query_ball_point(b.points, 1.3 * b.spacing, return_length=True) - 1
    assert neighbours.min() >= 3
    assert np.percentile(neighbours, 70) == 12


def test_the_moment_of_a_lattices_cells(rng: np.random.Generator) -> None:
    """Mean square distance from the nearest point, of places all over a cell."""
    x = rng.uniform(0, 1, (200_000, 3)) * packing.EDGE
    far = cKDTree(packing.lattice(1.0, [5.0] * 3, (0.0, 0.0, 0.0))).query(x)[0]
    assert (far**2).mean() / 3 == pytest.approx(packing.MOMENT, rel=5e-3)


def test_surface_is_closed_outward_and_even(body: tuple[str, shapes.Body]) -> None:
    name, b = body
    parts = [(b.vertices, b.triangles)] + ([b.inner] if b.inner else [])
    for vertices, triangles in parts:
        directed, counts = np.unique(edges_of(triangles), axis=0, return_counts=True)
        assert counts.max() == 1  # each edge once in each direction: closed, and all triangles turn the same way
        assert {tuple(e) for e in directed} == {tuple(e) for e in directed[:, ::-1]}
        assert len(vertices) - len(directed) // 2 + len(triangles) == 2
        assert len(np.unique(triangles)) == len(vertices)
        ends = edges_of(triangles)
        length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1) / b.spacing
        assert 0.5 < length.min() < length.max() < 1.45
        assert length.mean() == pytest.approx(0.8, abs=0.12)
    assert sum(enclosed_volume(*part) for part in parts) == pytest.approx(V, rel=0.01)
    assert (b.inner is not None) == (name == "hollow_sphere")
    assert b.area == pytest.approx(surface_area(b.vertices, b.triangles), rel=0.01)
    assert b.half_height == pytest.approx(-b.vertices[:, 2].min(), rel=2e-3)


def test_points_are_inside_the_surface(body: tuple[str, shapes.Body]) -> None:
    _, b = body
    chosen = b.points[:: max(1, len(b.points) // 400)] * (1 - 1e-9)
    winding = solid_angle(chosen, b.vertices, b.triangles)
    strays = chosen[winding < 0.5]
    # facets are chords: a point just under a curved surface may lie outside one, by less than the facet's sagitta
    assert len(strays) < 0.05 * len(chosen)
    if len(strays):
        assert cKDTree(b.vertices).query(strays)[0].max() < 0.7 * b.spacing
    if b.inner:
        assert np.abs(solid_angle(chosen, *b.inner)).max() < 0.5
        assert enclosed_volume(*b.inner) < 0


@pytest.mark.parametrize("name", ["sphere", "angular", "rod"])
def test_pores_have_their_share_and_lie_in_the_metal(name: str) -> None:
    """The volume of metal is that of the dense shape, the centre of mass the origin; pores touch neither each other nor the surface."""
    outer = morphology.form(name, D).scaled(0.92 ** (-1.0 / 3.0))
    pores = morphology.pores(outer, V, 0.08, 5e-6, 3)
    assert pores == morphology.pores(outer, V, 0.08, 5e-6, 3) != morphology.pores(outer, V, 0.08, 5e-6, 4)
    assert pores.volume / (pores.volume + V) == pytest.approx(0.08, rel=1e-12)
    apart = np.linalg.norm(np.array(pores.centres)[:, None] - pores.centres, axis=2)
    assert apart[apart > 0.0].min() > 1.1 * pores.diameter
    b = shapes.shape(name, D, 800, 0.3, pores=pores)
    assert b.inner is not None
    assert len(b.points) * b.volume == pytest.approx(V, rel=1e-12)
    assert enclosed_volume(b.vertices, b.triangles) + enclosed_volume(*b.inner) == pytest.approx(V, rel=0.01)
    assert -enclosed_volume(*b.inner) == pytest.approx(pores.volume, rel=1e-6)
    middles = b.inner[0].reshape(len(pores.centres), -1, 3).mean(axis=1)
    nearest = np.linalg.norm(b.points[:, None] - middles, axis=2).min()
    assert nearest > 0.5 * pores.diameter - 0.3 * b.spacing  # the lattice is moved to its centre of mass
    assert solid_angle(b.inner[0][::5], b.vertices, b.triangles).min() > 0.5
    weights = [enclosed_volume(v, t) * _centroid(v, t) for v, t in ((b.vertices, b.triangles), b.inner)]
    np.testing.assert_allclose(sum(weights) / V, 0.0, atol=0.02 * b.spacing)
    with pytest.raises(ValueError, match="give a smaller porosity or pore_diameter"):
        morphology.pores(outer, V, 0.4, 9e-6, 1)


@pytest.mark.parametrize(("name", "seed"), [("sphere", 1), ("flake", 5)])
def test_walls_of_pores_hold_no_points_in_a_plane(name: str, seed: int) -> None:
    """A point whose neighbours all lie in a plane has no deformation gradient: MACHDYN's scheme fails in its first step."""
    outer = morphology.form(name, D).scaled(0.9 ** (-1.0 / 3.0))
    b = shapes.shape(name, D, 420, pores=morphology.pores(outer, V, 0.1, 9e-6, seed))
    around = cKDTree(b.points).query_ball_point(b.points, 1.3 * b.spacing)
    away = [b.points[near] - x for near, x in zip(around, b.points, strict=True)]
    assert min(np.linalg.matrix_rank(r, tol=0.1 * b.spacing) for r in away) == 3


def _centroid(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Centre (3,) of the volume inside a closed surface."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    v = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    return (v[:, None] * (a + b + c)).sum(0) / 4 / v.sum()


@pytest.mark.parametrize("name", list(ASPECT))
@pytest.mark.parametrize("tilt", [0.0, 0.4, np.pi / 2, -0.7])
def test_extents_when_tilted(name: str, tilt: float) -> None:
    form, b = morphology.form(name, D), shapes.shape(name, D, 1000, tilt)
    extent = np.ptp(b.vertices, axis=0)
    assert form.height(tilt) == pytest.approx(extent[2], rel=0.01)
    assert form.width(tilt) == pytest.approx(max(extent[:2]), rel=0.01)
    assert b.half_height == pytest.approx(0.5 * form.height(tilt), rel=0.01)
    assert enclosed_volume(b.vertices, b.triangles) > 0


def test_a_positive_tilt_dips_the_end_ahead() -> None:
    b = shapes.shape("rod", D, 500, 0.3)
    assert b.vertices[b.vertices[:, 0].argmax(), 2] < 0


def test_a_shape_is_carried_exactly_through_affine_motion(
    body: tuple[str, shapes.Body], rng: np.random.Generator
) -> None:
    _, b = body
    surface = CarriedSurface(b.points, b.vertices, b.triangles, b.spacing)
    F = np.eye(3) + 0.5 * rng.standard_normal((3, 3))
    assert np.abs(surface.positions(b.points @ F.T) - b.vertices @ F.T).max() < 1e-9 * D


def test_a_cylinder_stands_on_z() -> None:
    b = shapes.cylinder(6.4e-3, 32.4e-3, 1000)
    assert np.ptp(b.vertices, axis=0) == pytest.approx([6.4e-3, 6.4e-3, 32.4e-3], rel=0.01)
    assert len(b.points) * b.volume == pytest.approx(np.pi / 4 * 6.4e-3**2 * 32.4e-3)
    assert np.ptp(b.points[:, 2]) == pytest.approx(32.4e-3, abs=1.2 * b.spacing)


@pytest.mark.parametrize("turn", [0.8, 1.2])
def test_a_rod_that_is_bent_through_itself_is_found(turn: float) -> None:
    """Bent round a circle, its length once round `turn` times. A place of it is taken twice where the straight rod reaches once round
    further, or back; both ends overlap within a circle that is shorter than the rod."""
    b = shapes.shape("rod", D, 4000)
    length, _, d = morphology.form("rod", D).lengths
    once = turn * length
    radius = once / (2 * np.pi)
    far = b.points + radius * np.array([0.0, 0.0, 1.0])
    bent = np.stack(
        [far[:, 2] * np.sin(b.points[:, 0] / radius), far[:, 1], far[:, 2] * np.cos(b.points[:, 0] / radius)], 1
    )

    def holds(x: np.ndarray) -> np.ndarray:
        beyond = np.maximum(np.abs(x[:, 0]) - 0.5 * (length - d), 0.0)
        return np.hypot(np.hypot(x[:, 1], x[:, 2]), beyond) < 0.5 * d

    there = np.array([once, 0.0, 0.0])
    twice = np.mean(holds(b.points + there) | holds(b.points - there))
    assert (twice > 0.3) == (turn < 1.0)
    surface = CarriedSurface(b.points, b.vertices, b.triangles, b.spacing)
    share = share_inside_itself(surface, bent)
    assert share == pytest.approx(twice, rel=0.05)  # of the outermost layer a few points lie outside facets


def test_no_shape_is_in_itself_as_it_begins_and_as_it_is_pressed(body: tuple[str, shapes.Body]) -> None:
    _, b = body
    outer = CarriedSurface(b.points, b.vertices, b.triangles, b.spacing)
    surface = whole_surface(b, outer, np.zeros(3))
    for height in (1.0, 0.3):
        assert share_inside_itself(surface, b.points * [1.5, 1.5, height]) == 0.0


# through the scene


@pytest.mark.parametrize("name", OTHERS)
def test_a_scene_may_ask_for_it(name: str) -> None:
    scene = scene_with(particle__shape=name, particle__tilt="30 deg")
    assert Scene.from_text(scene.to_toml()) == scene
    made = plan(scene)
    assert (made.impact.shape, made.impact.tilt) == (name, pytest.approx(np.pi / 6))
    assert made.impact.points == plan(scene_with()).impact.points  # equal volume, equal spacing
    assert name.replace("_", " ") in describe(made)
    assert max(map(len, describe(made).splitlines())) <= 125


def test_a_long_particle_needs_a_wider_target_and_more_time() -> None:
    lying, standing = scene_with(particle__shape="rod"), scene_with(particle__shape="rod", particle__tilt="90 deg")
    assert lying.particle.width == pytest.approx(6.17 * 12.13e-6, rel=1e-3)
    assert lying.derived.refined_radius > 0.5 * lying.particle.width
    assert standing.derived.refined_radius == pytest.approx(scene_with().derived.refined_radius)
    assert standing.derived.end_time_of(standing.particle) > 2.5 * scene_with().derived.end_time_of(
        scene_with().particle
    )
    (problem,) = problems_with(particle__shape="rod", substrate__diameter="100 um")
    assert "at least 125 um" in problem
    assert scene_with(particle__shape="rod", particle__tilt="90 deg", substrate__diameter="100 um")
    (problem,) = problems_with(particle__shape="rod", particle__offset=["60 um", "0 um"])
    assert "edge" in problem


def test_a_thin_wall_needs_points_across_it() -> None:
    (problem,) = problems_with(particle__shape="hollow_sphere", resolution__spacing="3.4 um")
    assert "thinnest part of this hollow_sphere: set resolution.spacing to at most 3.27 um" in problem


def test_shapes_that_are_not_known() -> None:
    (problem,) = problems_with(particle__shape="flakes")
    assert 'did you mean "flake"' in problem
    (problem,) = problems_with(particle__tilt="120 deg")
    assert "outside -90 deg to 90 deg" in problem


COARSE = """
[particle]
material = "Ni"
shape = "{name}"
tilt = "{tilt}"
diameter = "25 um"
velocity = "500 m/s"
[substrate]
material = "SS304"
diameter = "126 um"
height = "50 um"
[resolution]
spacing = "3 um"
element_size = "6 um"
[end]
time = "12 ns"
[output]
every = "12 ns"
"""


@pytest.mark.parametrize(
    ("name", "tilt"), [*((name, "0 deg") for name in OTHERS), ("rod", "90 deg"), ("flake", "60 deg")]
)
def test_it_hits_and_the_ledger_closes(name: str, tilt: str, tmp_path: Path) -> None:
    s = run(Scene.from_text(COARSE.format(name=name, tilt=tilt), "shape"), tmp_path / "out")
    assert 250 < s.points < 400
    assert abs(s.energy_drift) < 1e-2
    assert s.momentum_error < 1e-10
    start = s.fields(0, "surface").points
    assert start[:, 2].min() == pytest.approx(0.5 * 3e-6, rel=1e-6)  # the lowest vertex is half a spacing above
    assert s.energies["plastic_particle"] > 0.02
    assert s.eps_p_max > 0.3
