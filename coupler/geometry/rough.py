"""Heights of the surface of a substrate: a random field, straight profiles, a grid."""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ..core.arrays import Floats

WAVES = 256  # plane waves in the field: the distribution of the heights is normal to 1 % of their standard deviation
SAMPLES = 64  # points across the disc from which mean and Sa are computed
SEEN = 15  # samples of the surface on each side of the centre of a sphere, along x and y, over 1.5 radii


@dataclass(frozen=True)
class Ground:
    """Heights (m) of a surface, the sum of its parts.

    profiles: each the angle (rad) from x to a direction, and corners (s, z) m with s along this direction, ascending; heights are
    linear between the corners and constant outside. grid: heights (m) in rows along x, from the smallest x and y on; pitch m:
    distance of its points; the middle of the grid is at x = y = 0.
    """

    profiles: tuple[tuple[float, tuple[tuple[float, float], ...]], ...] = ()
    grid: tuple[tuple[float, ...], ...] = ()
    pitch: float = 1.0

    def heights(self, at: Floats) -> Floats:
        """Heights (k,) m at points (k,2) m."""
        z = np.zeros(len(at))
        for angle, corners in self.profiles:
            z += np.interp(at @ np.array([math.cos(angle), math.sin(angle)]), *np.array(corners).T)
        if self.grid:
            from scipy.ndimage import map_coordinates  # its import takes long, see plan.ground

            middle = 0.5 * (np.array([[len(self.grid)], [len(self.grid[0])]]) - 1.0)
            z += map_coordinates(np.array(self.grid), at.T[::-1] / self.pitch + middle, order=1, mode="nearest")
        return z

    def extremes(self, diameter: float, step: float) -> tuple[float, float, float]:
        """Lowest and highest height (m), and steepest slope (a ratio) between points `step` m apart, on a disc about the axis."""
        axis = np.arange(-0.5 * diameter, 0.5 * diameter + step, step)
        places = np.stack(np.meshgrid(axis, axis), axis=-1)
        z = self.heights(places.reshape(-1, 2)).reshape(places.shape[:2])
        inside = np.hypot(places[..., 0], places[..., 1]) <= 0.5 * diameter
        slope = np.hypot(np.diff(z, axis=0)[:, :-1], np.diff(z, axis=1)[:-1]) / step
        return float(z[inside].min()), float(z[inside].max()), float(slope[inside[:-1, :-1]].max())


def normal_under(
    heights: Callable[[Floats], Floats], at: tuple[float, float], radius: float, velocity: tuple[float, float, float], gap: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Upward unit normal of a surface where a sphere first touches it.

    heights: heights (k,) m at points (k,2) m; at (x, y) m, radius (m), velocity (m/s): centre, size and motion of the sphere; gap (m):
    vertical distance of the sphere from the surface at the start. Slopes are central differences over 0.2 radii.
    """
    step = 1.5 * radius / SEEN
    side = step * np.arange(-SEEN, SEEN + 1)
    away = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    z, room = heights(away + at), radius**2 - (away**2).sum(axis=1)
    under = room >= 0.0
    start = float((z[under] + np.sqrt(room[under])).max()) + gap  # height of the centre
    p = np.column_stack([away, z - start])
    along = p @ (np.array(velocity) / np.linalg.norm(velocity))
    room = radius**2 - (p**2).sum(axis=1) + along**2  # negative: beside the path of the sphere
    path = np.where(room >= 0.0, along - np.sqrt(np.maximum(room, 0.0)), np.inf)
    touched = away[np.argmin(path)] + at
    h = heights(touched + step * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]))
    slopes = (h[0] - h[1]) / (2.0 * step), (h[2] - h[3]) / (2.0 * step)
    length = math.hypot(*slopes, 1.0)
    return -float(slopes[0]) / length, -float(slopes[1]) / length, 1.0 / length


def heights(at: Floats, diameter: float, Sa: float, length: float, seed: int) -> Floats:
    """Heights (k,) m of the rough surface at points (k,2) m of a disc about the axis. Over the disc of `diameter` m the mean height
    is 0 and the mean absolute deviation is Sa (m).

    The field is the sum of WAVES plane waves. It has a normal distribution and the autocorrelation exp(-(distance / length)^2)
    (Garcia & Stoll 1984, Phys. Rev. Lett. 52, 1798). A seed gives the same field on all meshes and machines.
    """
    dice, normal = random.Random(seed), NormalDist(0.0, math.sqrt(2.0) / length)
    wave = np.array([[normal.inv_cdf(dice.random() or 0.5) for _ in range(2)] for _ in range(WAVES)])
    phase = np.array([2.0 * math.pi * dice.random() for _ in range(WAVES)])

    def field(places: Floats) -> Floats:
        return np.cos(places @ wave.T + phase).sum(axis=1)

    axis = (np.arange(SAMPLES) + 0.5) / SAMPLES * diameter - 0.5 * diameter
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    disc = field(grid[np.hypot(*grid.T) <= 0.5 * diameter])
    return (field(at) - disc.mean()) * (Sa / np.abs(disc - disc.mean()).mean())
