"""Heights of the surface of a substrate: a random field, straight profiles, a grid."""

import math
import random
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from scipy.ndimage import map_coordinates

from ..core.arrays import Floats

WAVES = 256  # in the field: the heights are normal to 1 % of their standard deviation
SAMPLES = 64  # across the disc, for mean and Sa


@dataclass(frozen=True)
class Ground:
    """Heights (m) of a surface, the sum of its parts.

    profiles: each the angle (rad) of its axis from x, and its corners (s, z) m with s along this axis, ascending; heights are linear
    between the corners and constant outside. grid: heights (m) in rows along x, from the smallest x and y on; pitch m: of the grid,
    whose middle is the axis.
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
            middle = 0.5 * (np.array([[len(self.grid)], [len(self.grid[0])]]) - 1.0)
            z += map_coordinates(np.array(self.grid), at.T[::-1] / self.pitch + middle, order=1, mode="nearest")
        return z

    def extremes(self, diameter: float, step: float) -> tuple[float, float, float]:
        """Lowest and highest height (m) and steepest slope (a ratio) on a disc about the axis, over distances of `step` m."""
        axis = np.arange(-0.5 * diameter, 0.5 * diameter + step, step)
        places = np.stack(np.meshgrid(axis, axis), axis=-1)
        z = self.heights(places.reshape(-1, 2)).reshape(places.shape[:2])
        inside = np.hypot(places[..., 0], places[..., 1]) <= 0.5 * diameter
        slope = np.hypot(np.diff(z, axis=0)[:, :-1], np.diff(z, axis=1)[:-1]) / step
        return float(z[inside].min()), float(z[inside].max()), float(slope[inside[:-1, :-1]].max())


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
