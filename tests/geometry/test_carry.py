"""The carried surface: exact for affine motion, conservative in both directions."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from coupler.geometry.points import points_near
from coupler.geometry.triangles import enclosed_volume
from coupler.impact.measure import crater_depth
from coupler.particle import packing
from coupler.particle.carried_surface import CarriedSurface

D = 25e-6


@pytest.fixture(scope="module")
def body() -> tuple[np.ndarray, np.ndarray, np.ndarray, CarriedSurface]:
    points, v = packing.sphere(D, 1000)
    skin, triangles = packing.surface(D, 0.8 * v ** (1 / 3))
    return points, skin, triangles, CarriedSurface(points, skin, triangles, v ** (1 / 3))


def test_points_under_the_surface_share_what_they_carry_among_the_vertices_above_them(
    body: tuple[np.ndarray, np.ndarray, np.ndarray, CarriedSurface],
) -> None:
    points, skin, _, surface = body
    shared = np.asarray(surface.under.sum(axis=0))[0]
    outermost = shared > 0.5
    assert np.unique(shared.round(12)).tolist() == [0.0, 1.0]
    assert np.linalg.norm(points[~outermost], axis=1).max() < 0.47 * D  # a spacing is 0.08 D
    at_vertices = surface.at_vertices(np.concatenate([np.zeros(len(skin)), np.ones(len(points))]))
    assert at_vertices.sum() == pytest.approx(outermost.sum())
    assert at_vertices.min() > 0.0


def test_packing_has_the_spheres_volume_centre_and_points() -> None:
    for n in (300, 1000, 4000, 20000):
        points, v = packing.sphere(D, n)
        assert len(points) == pytest.approx(n, rel=0.05)
        assert len(points) * v == pytest.approx(np.pi / 6 * D**3)
        assert np.abs(points.mean(0)).max() < 1e-6 * D
        assert np.linalg.norm(points, axis=1).max() < 0.52 * D


def test_surface_is_closed_and_faces_outwards(body) -> None:
    _, skin, triangles, _ = body
    assert len(skin) - 3 * len(triangles) // 2 + len(triangles) == 2  # Euler
    assert enclosed_volume(skin, triangles) == pytest.approx(np.pi / 6 * D**3, rel=0.03)
    assert np.linalg.norm(skin, axis=1) == pytest.approx(D / 2)


def test_affine_motion_is_carried_exactly(body, rng: np.random.Generator) -> None:
    points, skin, _, surface = body
    F, shift = np.eye(3) + 0.5 * rng.standard_normal((3, 3)), rng.standard_normal(3)
    assert np.abs(surface.positions(points @ F.T + shift) - (skin @ F.T + shift)).max() < 1e-12


def test_forces_spread_with_their_resultant_moment_and_power(body, rng: np.random.Generator) -> None:
    points, _, _, surface = body
    x = points + 1e-6 * rng.standard_normal(points.shape)
    v = rng.standard_normal(points.shape)
    f = rng.standard_normal((len(surface.contacts(x)), 3))
    g = np.zeros_like(points)
    surface.spread(f, np.arange(len(f)), g)
    assert g.sum(0) == pytest.approx(f.sum(0))
    assert np.cross(x, g).sum(0) == pytest.approx(np.cross(surface.contacts(x), f).sum(0))
    assert np.sum(g * v) == pytest.approx(np.sum(f * surface.contacts(v)))
    heat = rng.uniform(0, 1, len(f))
    assert surface.spread_heat(heat).sum() == pytest.approx(heat.sum())
    local = np.zeros(len(f))
    local[[3, len(f) - 2]] = 2.0, 5.0  # a vertex and a point
    around = surface.spread_heat(local)
    assert around == pytest.approx(surface.average[[3]].toarray()[0] * 2.0 + np.eye(len(points))[-2] * 5.0)
    T = rng.uniform(300, 500, len(points))
    assert 300 <= surface.values(T).min() <= surface.values(T).max() <= 500


def test_a_few_rows_are_those_of_all_and_need_only_their_support(body, rng: np.random.Generator) -> None:
    points, skin, _, surface = body
    v = rng.standard_normal(points.shape)
    whole = surface.contacts(v)
    assert whole == pytest.approx(np.concatenate([surface.positions(v), v]), abs=1e-13)
    rows = np.flatnonzero(np.concatenate([skin, points])[:, 2] < -0.42 * D)
    need = surface.support(rows)
    assert 0 < len(need) < len(points) / 2
    blind = np.full_like(v, np.nan)
    blind[need] = v[need]
    out, twice = np.full_like(whole, 7.0), np.full_like(whole, 7.0)
    surface.moving_contacts(blind, 2.0 * blind, rows, out, twice, force := np.ones_like(out))
    assert np.array_equal(out[rows], whole[rows])
    assert np.array_equal(twice[rows], 2.0 * whole[rows])
    assert not force[rows].any()
    assert np.all(np.delete(force, rows, axis=0) == 1.0)
    assert np.all(np.delete(out, rows, axis=0) == 7.0)
    f = np.zeros_like(whole)
    f[rows] = rng.standard_normal((len(rows), 3))
    g, same = np.zeros_like(v), np.zeros_like(v)
    surface.spread(f, rows, g)
    surface.spread(f, np.arange(len(f)), same)
    assert np.array_equal(g, same)
    assert np.array_equal(np.flatnonzero(np.any(g != 0.0, axis=1)), need)
    assert np.sum(g * v) == pytest.approx(np.sum(f * whole), rel=1e-12)
    surface.spread(f, rows, same)
    assert same == pytest.approx(2.0 * g, rel=1e-12)
    assert len(surface.support(np.zeros(0, np.int64))) == 0


def test_where_few_points_are_near_the_nearest_take_their_place() -> None:
    """Points 1 apart on a line: two within 1.1 of one end, none near a place beyond the other end."""
    x = np.arange(10.0)[:, None] * [1.0, 0.0, 0.0]
    near = points_near(cKDTree(x), np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]]), 1.1, 2, 3)
    assert [near[[i]].indices.tolist() for i in (0, 1)] == [[0, 1], [7, 8, 9]]


def test_crater_depth_is_the_bottom_of_the_bowl_wherever_the_nodes_lie(rng: np.random.Generator) -> None:
    for _ in range(5):
        x = np.zeros((900, 3))
        x[:, :2] = rng.uniform(-1, 1, (900, 2))
        x[:, 2] = np.minimum(-0.3 + 0.8 * ((x[:, 0] - 0.1) ** 2 + 1.2 * (x[:, 1] + 0.05) ** 2), 0.05)
        assert crater_depth(x) == pytest.approx(0.3, rel=0.02)
        assert abs(crater_depth(x + np.array([0, 0, 0.01 * rng.standard_normal()])) - 0.3) < 0.05
    assert crater_depth(np.concatenate([rng.uniform(-1, 1, (100, 2)), np.zeros((100, 1))], axis=1)) == 0.0
