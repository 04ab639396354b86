"""Spheres of points on other lattices than the face-centred cubic one of the program, and turned, for tests."""

import numpy as np
from scipy.spatial.transform import Rotation

from coupler.particle import packing

HCP = (
    np.array([[0, 0, 0], [0.5, 0.5, 0], [0.5, 5 / 6, 0.5], [0, 1 / 3, 0.5]]),
    np.array([1.0, 3.0**0.5, (8 / 3) ** 0.5]),
)
BCC = np.array([[0, 0, 0], [0.5, 0.5, 0.5]]), np.ones(3)
FCC = packing.CELL, np.ones(3)


def ball(
    diameter: float,
    points: int,
    lattice: tuple[np.ndarray, np.ndarray] = FCC,
    turn: tuple[float, float, float] = (0, 0, 0),
) -> tuple[np.ndarray, float]:
    """As `packing.sphere`. lattice: points in its cell, in edges, and the edges, any unit; turn: rotation vector, rad."""
    cell, edges = lattice
    volume = np.pi / 6.0 * diameter**3
    edges = edges * (len(cell) / edges.prod() * volume / points) ** (1.0 / 3.0)
    count = int(np.ceil(diameter / edges.min()))
    grid = np.stack(np.meshgrid(*[np.arange(-count, count)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    x = Rotation.from_rotvec(turn).apply((grid + cell + 0.25).reshape(-1, 3) * edges)
    x = x[np.linalg.norm(x, axis=1) < 0.5 * diameter]
    return x - x.mean(axis=0), volume / len(x)
