"""Rough surface: a random height field with a given mean deviation and correlation length, and a mesh whose top face has these
heights."""

import math
import random
from statistics import NormalDist

import numpy as np

from ..core.arrays import Floats

WAVES = 256  # in the field: the heights are normal to 1 % of their standard deviation
SAMPLES = 64  # across the disc, for mean and Sa


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


def roughened(points: Floats, height: float, diameter: float, Sa: float, length: float, seed: int) -> Floats:
    """Points (n,3) m of a cylinder between z = -height and 0, with `heights` on its top face. The displacement decreases linearly to
    zero at the bottom."""
    moved = points.copy()
    moved[:, 2] += heights(points[:, :2], diameter, Sa, length, seed) * (1.0 + points[:, 2] / height)
    return moved
