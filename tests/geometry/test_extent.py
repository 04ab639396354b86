"""Measures of a splat by its volume: spheres, affine images, jets."""

import numpy as np
import pytest

from coupler.geometry.extent import SHARE, UP, extent, shape_measures
from coupler.particle.packing import surface

D = 25e-6


def test_a_sphere_has_its_diameter_in_every_direction() -> None:
    """The polyhedron of 3920 triangles lies 0.1 % inside its sphere."""
    points, triangles = surface(D, 1e-6)
    m = shape_measures(points + np.array([3e-6, 0.0, 0.5 * D]), triangles, D)
    assert m["thickness_m"] == pytest.approx(D, rel=2e-3)
    assert m["height_m"] == pytest.approx(D, rel=2e-3)
    assert m["splat_diameter_m"] == pytest.approx(D, rel=2e-3)
    assert m["flattening_ratio_total"] == pytest.approx(0.0, abs=2e-3)
    assert m["jet_length_m"] == pytest.approx(0.0, abs=2e-3 * D)


def test_measures_follow_an_affine_deformation() -> None:
    """Planes stay planes and shares of a volume stay: an ellipsoid has its axes. Seen from above its mean
    width is the perimeter of the ellipse over pi (Cauchy): 1.27463 for axes of 1.6 and 0.9."""
    points, triangles = surface(D, 1e-6)
    m = shape_measures(points * np.array([1.6, 0.9, 0.4]) + np.array([0.0, 0.0, 1e-6]), triangles, D)
    assert m["thickness_m"] == pytest.approx(0.4 * D, rel=2e-3)
    assert m["height_m"] == pytest.approx(0.2 * D + 1e-6, rel=2e-3)
    assert m["splat_diameter_m"] == pytest.approx(1.27463 * D, rel=3e-3)


def test_planes_cut_off_their_share_of_a_box() -> None:
    """Of a box 2 high 0.99 lie within 1.98, which is stretched as for a sphere: caps of 0.005 of its volume are 0.0828 radii high."""
    box = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 2.0)])
    faces = np.array([[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]])
    triangles = np.concatenate([faces[:, :3], faces[:, [0, 2, 3]]])
    low, high = extent(box, triangles, UP)
    assert high - low == pytest.approx(2.0 * SHARE / (1.0 - 0.0828), rel=1e-4)
    assert 0.5 * (low + high) == pytest.approx(1.0)


def test_a_jet_sets_no_measure_of_the_splat() -> None:
    """One vertex that is pulled out by a diameter makes a spike of 0.2 % of the volume: it is a jet of that length, and the thickness
    grows by less than 2 %, as the spike is a part of what lies beyond the planes."""
    points, triangles = surface(D, 1e-6)
    top = int(points[:, 2].argmax())
    points[top, 2] += D
    m = shape_measures(points, triangles, D)
    assert m["thickness_m"] == pytest.approx(D, rel=0.02)
    assert m["jet_length_m"] == pytest.approx(D, rel=0.02)
