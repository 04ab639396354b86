"""Boxes of tetrahedra, and layers of them one on another: what the tests of properties of a block share."""

import numpy as np

from coupler.geometry.tetrahedra import volumes
from coupler.properties.block import Block, extract_block

UM = 1e-6


def box(cells: tuple[int, int, int], low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A box in tetrahedra, six for each cell."""
    nx, ny, nz = cells
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, cells, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.arange(len(points)).reshape(nx + 1, ny + 1, nz + 1)
    unit = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T
    cube = np.stack([corner[i : nx + i, j : ny + j, k : nz + k].ravel() for i, j, k in unit], axis=1)
    ways = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
    tets = cube[:, ways].reshape(-1, 4)
    return points, np.where((volumes(points, tets) < 0)[:, None], tets[:, [0, 1, 3, 2]], tets)


def stack(
    heights: list[float], n: int = 4, side: float = 10 * UM, joint: str = "bonded", radius: float = np.inf
) -> Block:
    """Layers one on another, bodies of their own with equal meshes of n by n cells, joined within a radius of the axis."""
    points, tets, body, z = [], [], [], 0.0
    for number, height in enumerate(heights):
        layers = max(round(n * height / side), 1)
        x, t = box((n, n, layers), np.array([-side / 2, -side / 2, z]), np.array([side / 2, side / 2, z + height]))
        tets.append(t + sum(map(len, points)))
        points.append(x)
        body.append(np.full(len(t), number))
        z += height
    x = np.concatenate(points)
    near = np.hypot(x[:, 0], x[:, 1]) <= radius
    at_nodes = np.stack([near * (joint == "bonded"), near * (joint == "touching")], axis=1).astype(float)
    corner = np.array([side / 2, side / 2, 0.0])
    top = np.array([0.0, 0.0, z])
    return extract_block(
        x, np.concatenate(tets), np.concatenate(body), at_nodes, -corner, corner + top, 1e-2 * side / n
    )
