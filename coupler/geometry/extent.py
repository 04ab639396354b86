"""Extents of a body by its volume: what a few vertices of a thin jet cannot set."""

import numpy as np
from scipy.optimize import brentq

from ..compiling import njit
from ..core.arrays import Floats, Ints

#: Share of the volume that lies within an extent. A jet has less than the rest of it, and a section shows the splat as wide and high.
SHARE = 0.99
#: Of the diameter of a sphere: the part between two planes, half of the rest beyond each, caps h^2 (3 R - h) / 4 R^3 high.
OF_SPHERE = 1.0 - brentq(lambda h: h * h * (3.0 - h) / 4.0 - 0.5 * (1.0 - SHARE), 0.0, 1.0)
UP = np.array([0.0, 0.0, 1.0])
DIRECTIONS = 8  # in which a width is taken, over half a turn


def extent(points: Floats, triangles: Ints, direction: Floats) -> tuple[float, float]:
    """Where a body begins and ends along a direction, m: SHARE of its volume lies between two planes, half of the rest beyond each, and
    their distance is stretched about its middle as much as that of a sphere has to be to give its diameter.

    points (n,3) m and triangles (m,3) of a closed surface, facing outwards; direction (3,), a unit vector.
    """
    corners = points[triangles]
    height = np.sort(corners @ direction, axis=1)
    shade = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ direction
    low, high = float(height.min()), float(height.max())
    whole = _volume_below(high, height, shade)
    if not whole > 0.0:
        return low, high

    def level(share: float) -> float:
        return float(
            brentq(lambda z: _volume_below(z, height, shade) - share * whole, low, high, xtol=1e-7 * (high - low))
        )

    first, last = level(0.5 * (1.0 - SHARE)), level(0.5 * (1.0 + SHARE))
    middle, half = 0.5 * (first + last), 0.5 * (last - first) / OF_SPHERE
    return middle - half, middle + half


@njit(cache=True, nogil=True, error_model="numpy")
def _volume_below(z: float, height: Floats, shade: Floats) -> float:
    """Volume (m3) of a body below the plane at z m, by the divergence theorem for the field (height - z) normal to that plane.

    height (m,3) m of the corners of each triangle of the surface, ascending; shade (m,) m2: its area seen along the normal, signed.
    The integral of min(height - z, 0) over a triangle is its area times a cubic of the corners' heights.
    """
    volume = 0.0
    for t in range(len(shade)):
        a, b, c = height[t, 0] - z, height[t, 1] - z, height[t, 2] - z
        if c <= 0.0:
            volume += shade[t] * (a + b + c) / 3.0
        elif b <= 0.0:  # the highest corner alone is above
            volume += shade[t] * ((a + b + c) / 3.0 - c * c * c / (3.0 * (c - a) * (c - b)))
        elif a < 0.0:  # the lowest alone is below
            volume += shade[t] * a * a * a / (3.0 * (b - a) * (c - a))
    return volume


def shape_measures(points: Floats, triangles: Ints, diameter: float) -> dict[str, float]:
    """Measures of a deformed particle of initial diameter D0 (m) on a target whose initial surface is the plane z = 0.

    Height above that plane, thickness from the lowest to the highest point, diameter seen from above (mean of widths), each an
    `extent`; both flattening ratios: 1 - height / D0, and 1 - thickness / D0. jet_length_m: how far the surface reaches beyond these
    extents. points (n,3) m and triangles (m,3) of its closed surface.
    """
    corners = points[np.unique(triangles)]
    bottom, top = extent(points, triangles, UP)
    jet, widths = max(0.0, float(corners[:, 2].max()) - top), []
    for angle in np.arange(DIRECTIONS) * (np.pi / DIRECTIONS):
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        low, high = extent(points, triangles, direction)
        along = corners @ direction
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
