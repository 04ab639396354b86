"""Queries of surfaces by ray casting against closed forms."""

import numpy as np
import pytest

from coupler.errors import SplatError
from coupler.geometry.raycast import RaySurface
from coupler.geometry.solid import check_solid
from coupler.particle import packing

UM = 1e-6


def test_the_closest_point_of_a_triangle() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    x = np.array([[0.2, 0.2, 1.0], [-1, -1, 0], [0.5, -1, 2], [1, 1, 0], [3, -0.1, 1]])
    wanted = np.array([[0.2, 0.2, 0], [0, 0, 0], [0.5, 0, 0], [0.5, 0.5, 0], [1, 0, 0]])
    surface = RaySurface(corners * UM, np.array([[0, 1, 2]]), closed=False)
    np.testing.assert_allclose(surface.feet(x * UM)[0], wanted * UM, atol=1e-6 * UM)


def test_distances_from_a_ball(rng: np.random.Generator) -> None:
    """Far from the origin too: single precision is kept to the extent of the surface."""
    at = np.array([300.0, -200.0, 50.0]) * UM
    vertices, triangles = packing.surface(20.0 * UM, 0.3 * UM)
    direction = rng.normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    r = np.linspace(2.0, 18.0, 200) * UM
    distance = RaySurface(vertices + at, triangles).distance_outside(at + r[:, None] * direction)
    # facets lie up to edge^2 / (8 R) inside the ball
    np.testing.assert_allclose(distance, np.maximum(r - 10.0 * UM, 0.0), atol=0.3**2 / 80.0 * 2.0 * UM)


def test_verticals_through_a_ball_enter_and_leave(rng: np.random.Generator) -> None:
    vertices, triangles = packing.surface(20.0 * UM, 0.3 * UM)
    phi, r = 2.0 * np.pi * rng.random(300), 9.0 * UM * np.sqrt(rng.random(300))
    line, z, _ = RaySurface(vertices, triangles).on_verticals(r * np.cos(phi), r * np.sin(phi))
    assert np.bincount(line, minlength=300).tolist() == [2] * 300
    half = np.sqrt((10.0 * UM) ** 2 - r[line] ** 2)
    np.testing.assert_allclose(np.abs(z), half, atol=0.01 * UM)
    line, _, _ = RaySurface(vertices, triangles).on_verticals(np.array([11.0 * UM]), np.zeros(1))
    assert len(line) == 0


def test_places_in_two_balls_at_once_are_surrounded_twice(rng: np.random.Generator) -> None:
    """A ball with a cavity and another ball that overlaps both; none of the places is nearer to a surface than its facets are."""
    ball, triangles = packing.surface(20.0 * UM, 0.5 * UM)
    hole = 0.5 * ball
    points = np.concatenate([ball, hole, ball + np.array([12.0 * UM, 0.0, 0.0])])
    shifted = [triangles, triangles[:, ::-1] + len(ball), triangles + 2 * len(ball)]
    x = 30.0 * UM * (rng.random((3000, 3)) - 0.5)
    r, s = np.linalg.norm(x, axis=1) / UM, np.linalg.norm(x - [12.0 * UM, 0.0, 0.0], axis=1) / UM
    clear = (abs(r - 10.0) > 0.1) & (abs(r - 5.0) > 0.1) & (abs(s - 10.0) > 0.1)
    wanted = ((r < 10.0) & (r > 5.0)).astype(int) + (s < 10.0)
    found = RaySurface(points, np.concatenate(shifted)).windings(x)
    assert wanted[clear].max() == 2
    np.testing.assert_array_equal(found[clear], wanted[clear])


def test_an_open_surface_has_no_inside() -> None:
    vertices, triangles = packing.surface(20.0 * UM, 2.0 * UM)
    with pytest.raises(SplatError, match="not closed: 3 edges have only one triangle"):
        RaySurface(vertices, triangles[1:])


def test_what_bounds_no_solid_is_refused() -> None:
    vertices, triangles = packing.surface(20.0 * UM, 2.0 * UM)
    check_solid(vertices, triangles)
    pole = int(np.argmax(vertices[:, 2]))
    through = vertices.copy()
    through[pole, 2] = -11.0 * UM
    with pytest.raises(SplatError, match="pass through each other"):
        check_solid(through, triangles)
    with pytest.raises(SplatError, match="not enclose a solid: 3 edges"):
        check_solid(vertices, triangles[1:])
    two = np.concatenate([vertices, vertices + np.array([0.0, 0.0, 20.0 * UM])])
    lowest = len(vertices) + int(np.argmin(vertices[:, 2]))
    joined = np.concatenate([triangles, np.where(triangles + len(vertices) == lowest, pole, triangles + len(vertices))])
    with pytest.raises(SplatError, match="1 corners"):
        check_solid(two, joined)


def test_points_that_no_triangle_has_change_nothing(rng: np.random.Generator) -> None:
    """A body's surface has a few of the points of all bodies: not even its scale, which bounds the precision, knows of the others."""
    vertices, triangles = packing.surface(20.0 * UM, 1.0 * UM)
    others = 5e-3 * rng.normal(size=(5000, 3))
    place = np.sort(rng.choice(len(vertices) + len(others), len(vertices), replace=False))
    many = np.zeros((len(vertices) + len(others), 3))
    many[place] = vertices
    many[np.setdiff1d(np.arange(len(many)), place)] = others
    x = 12.0 * UM * rng.normal(size=(500, 3))
    alone, among = RaySurface(vertices, triangles), RaySurface(many, place[triangles])
    for found, wanted in zip(among.feet(x), alone.feet(x), strict=True):
        np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(among.inside(x), alone.inside(x))
