"""Extents of a body, defined by volume, so that a thin jet of material has little effect on them."""

from math import acos, cos, pi

import numpy as np

from ..compiling import njit
from ..core.arrays import Floats, Ints
from .vector_kernels import area_vector, dot

#: Fraction of the volume within an extent. The remaining fraction is larger than the volume of a jet.
SHARE = 0.99
#: Distance over diameter of two planes with this fraction of a sphere between them. Each cap has the volume fraction
#: h^2 (3 R - h) / 4 R^3; the value is the root of this cubic, by cosines.
OF_SPHERE = -2.0 * cos((acos(SHARE) + 4.0 * pi) / 3.0)
CLOSE = 1e-10  # tolerance of the volume below a plane, over the whole volume
UP = np.array([0.0, 0.0, 1.0])
DIRECTIONS = 8  # in which the width in the top view is measured, over 180 degrees


@njit(cache=True, nogil=True, error_model="numpy")
def extent(points: Floats, triangles: Ints, direction: Floats) -> tuple[float, float]:
    """Both ends of a body along a direction, m. Two planes normal to the direction have SHARE of the volume between them and equal
    parts of the rest on both sides. Their distance is divided by OF_SPHERE, so that the extent of a sphere is its diameter.

    points (n,3) m and triangles (m,3) of the closed surface, normals outwards; direction (3,), a unit vector. For a body without
    volume: the limits of its corners.
    """
    height, shade = np.empty((len(triangles), 3)), np.empty(len(triangles))
    d = direction[0], direction[1], direction[2]
    for t in range(len(triangles)):
        A, B, C = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        a, b, c = dot(A, d), dot(B, d), dot(C, d)
        height[t, 0], height[t, 2] = min(a, b, c), max(a, b, c)
        height[t, 1] = max(min(a, b), min(max(a, b), c))
        shade[t] = 0.5 * dot(area_vector(A, B, C), d)
    low, high = height[:, 0].min(), height[:, 2].max()
    whole = _volume_below(high, height, shade)
    if not whole > 0.0:
        return low, high
    share = 0.5 * (1.0 - SHARE)
    first = _level(share, low, high, whole, height, shade)
    last = _level(1.0 - share, low, high, whole, height, shade)
    middle, half = 0.5 * (first + last), 0.5 * (last - first) / OF_SPHERE
    return middle - half, middle + half


@njit(cache=True, nogil=True, error_model="numpy")
def _level(share: float, low: float, high: float, whole: float, height: Floats, shade: Floats) -> float:
    """Height (m) in [low, high] with `share` of the volume `whole` (m3) below it (Illinois: Dowell & Jarratt 1971, BIT 11, 168)."""
    a, f_a, b, f_b = low, -share, high, 1.0 - share
    for _ in range(100):
        z = (a * f_b - b * f_a) / (f_b - f_a)
        f = _volume_below(z, height, shade) / whole - share
        if abs(f) < CLOSE:
            return z
        if (f > 0.0) == (f_b > 0.0):
            f_a *= 0.5
        else:
            a, f_a = b, f_b
        b, f_b = z, f
    return b


@njit(cache=True, nogil=True, error_model="numpy")
def _volume_below(z: float, height: Floats, shade: Floats) -> float:
    """Volume (m3) of a body below the plane at z (m): divergence theorem for the field (height - z) normal to the plane.

    height (m,3) m: heights of the corners of each triangle of the surface, ascending; shade (m,) m2: signed area projected on the
    plane. The integral of min(height - z, 0) over a triangle is its area times a cubic of the heights.
    """
    volume = 0.0
    for t in range(len(shade)):
        a, b, c = height[t, 0] - z, height[t, 1] - z, height[t, 2] - z
        if c <= 0.0:
            volume += shade[t] * (a + b + c) / 3.0
        elif b <= 0.0:  # only the highest corner is above
            volume += shade[t] * ((a + b + c) / 3.0 - c * c * c / (3.0 * (c - a) * (c - b)))
        elif a < 0.0:  # only the lowest corner is below
            volume += shade[t] * a * a * a / (3.0 * (b - a) * (c - a))
    return volume


def shape_measures(points: Floats, triangles: Ints, diameter: float) -> dict[str, float]:
    """Measures of a deformed particle of initial diameter D0 (m) on a target whose initial surface is the plane z = 0.

    Height above this plane, thickness from the lowest to the highest point, and diameter in the top view (mean of widths), each from an
    `extent`. Flattening ratios: 1 - height / D0, and in total 1 - thickness / D0. jet_length_m: largest distance of a corner above the
    height or beyond an end of a width. points (n,3) m and triangles (m,3) of the closed surface; diameter: D0.
    """
    skin = points[np.unique(triangles)]
    bottom, top = extent(points, triangles, UP)
    jet, widths = max(0.0, float(skin[:, 2].max()) - top), []
    for angle in np.arange(DIRECTIONS) * (np.pi / DIRECTIONS):
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        low, high = extent(points, triangles, direction)
        along = skin @ direction
        jet = max(jet, float(along.max()) - high, low - float(along.min()))
        widths.append(high - low)
    return {
        "flattening_ratio": 1.0 - top / diameter,
        "flattening_ratio_total": 1.0 - (top - bottom) / diameter,
        "height_m": top,
        "thickness_m": top - bottom,
        "splat_diameter_m": float(np.mean(widths)),
        "jet_length_m": jet,
    }
