"""Particles as points of uniform spacing."""

import numpy as np


def sphere(diameter: float, points: int) -> tuple[np.ndarray, float]:
    """Points of a face-centred cubic lattice inside a sphere, about `points` of them, centred on the origin.

    Returns (n,3) positions in m and the volume each point carries (m3), the sphere's volume over n. The lattice is
    put so that no point lies on the centre: the outermost shell is then closer to even.
    """
    volume = np.pi / 6.0 * diameter**3
    spacing = (volume / points) ** (1.0 / 3.0)
    cell = 4.0 ** (1.0 / 3.0) * spacing  # four points to a cell
    reach = int(np.ceil(0.5 * diameter / cell)) + 1
    base = np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]]) + 0.25
    grid = np.stack(np.meshgrid(*[np.arange(-reach, reach)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    lattice = ((grid + base).reshape(-1, 3)) * cell
    inside = lattice[np.einsum("ij,ij->i", lattice, lattice) < (0.5 * diameter) ** 2]
    inside = inside - inside.mean(axis=0)
    return np.ascontiguousarray(inside), volume / len(inside)


def surface(diameter: float, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """The undeformed outer surface: a geodesic sphere with edges of about `edge` m, vertices (n,3), triangles (m,3), outwards."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array(
        [[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0], [0, -1, golden], [0, 1, golden],
         [0, -1, -golden], [0, 1, -golden], [golden, 0, -1], [golden, 0, 1], [-golden, 0, -1], [-golden, 0, 1]]
    )  # fmt: skip
    faces = np.array(
        [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6], [7, 1, 8],
         [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]]
    )  # fmt: skip
    parts = max(2, round(0.55 * diameter / edge))  # each edge of the icosahedron, 0.53 diameters long, in so many
    i, j = np.array([(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]).T
    weights = np.stack([parts - i - j, i, j], axis=1) / parts
    number = {pair: n for n, pair in enumerate(zip(i.tolist(), j.tolist(), strict=True))}
    up = [(number[a, b], number[a + 1, b], number[a, b + 1]) for a in range(parts) for b in range(parts - a)]
    down = [
        (number[a + 1, b], number[a + 1, b + 1], number[a, b + 1]) for a in range(parts) for b in range(parts - a - 1)
    ]
    points = np.einsum("kc,fcd->fkd", weights, corners[faces]).reshape(-1, 3)
    triangles = (np.array(up + down)[None] + len(weights) * np.arange(len(faces))[:, None, None]).reshape(-1, 3)
    _, first, which = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    points = points[first]
    return points * (0.5 * diameter / np.linalg.norm(points, axis=1))[:, None], which.ravel()[triangles]
