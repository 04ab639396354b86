"""Points of a face-centred cubic lattice inside a body, and the geodesic surface of a sphere."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

MIN_NEIGHBOURS = 4
LEAST_SPREAD = 0.1  # smallest eigenvalue of the sum of n n^T, n: unit vectors to the neighbours: 4 inside, 0 if they lie in a plane
# points of the unit cell of the lattice, in edges
CELL = np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0]])
EDGE = len(CELL) ** (1.0 / 3.0)  # of the unit cell, in spacings
# Second moment of a point's Voronoi cell along an axis, divided by volume and spacing^2 (Conway & Sloane 1999, chapter 2)
MOMENT = 0.0787451


def lattice(spacing: float, half: Sequence[float], offset: Sequence[float]) -> np.ndarray:
    """Points (k,3) m of the lattice in a box with half extents `half` (m). Each point has the volume spacing^3. offset: shift of the
    lattice, in edges of the unit cell."""
    edge = EDGE * spacing
    axes = [np.arange(-count, count) for count in np.ceil(np.asarray(half) / edge).astype(int) + 1]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    return (grid + (CELL + np.asarray(offset))).reshape(-1, 3) * edge


def sphere(diameter: float, points: int) -> tuple[np.ndarray, float]:
    """About `points` points of the lattice inside a sphere around the origin.

    Returns positions (n,3) m, and the volume of each point (m3), which is the volume of the sphere divided by n. No lattice point
    lies at the centre: this makes the outermost shell more even.
    """
    volume = np.pi / 6.0 * diameter**3
    spacing = (volume / points) ** (1.0 / 3.0)
    cloud = lattice(spacing, [0.5 * diameter] * 3, (0.25, 0.25, 0.25))
    inside = cloud[np.einsum("ij,ij->i", cloud, cloud) < (0.5 * diameter) ** 2]
    inside = inside - inside.mean(axis=0)
    return np.ascontiguousarray(inside), volume / len(inside)


def fill(
    inside: Callable[[np.ndarray], np.ndarray],
    half: tuple[float, float, float],
    volume: float,
    points: int,
    flat: tuple[int, ...] = (),
) -> tuple[np.ndarray, float]:
    """About `points` points of the lattice inside a body, with their mean at the origin. Returns the same as `sphere`.

    inside: function of positions (k,3) m, returns (k,) bool; half: half extents of the body, m; volume: volume of the body, m3,
    divided equally among the points; flat: axes along which the body ends in flat faces. The best of several lattice constants and
    offsets is chosen: volume and second moments of the points with their cells are closest to those of the body, and outermost layers
    lie half a layer inside flat faces. Points whose deformation gradient is undefined (`_connected`) are removed.
    """
    middle = (np.arange(80) + 0.5) / 40 - 1.0
    grid = np.stack(np.meshgrid(*[middle] * 3, indexing="ij"), axis=-1).reshape(-1, 3) * np.asarray(half)
    moments = (grid[inside(grid)] ** 2).mean(axis=0)  # mean squares of x, y and z over the body, by a midpoint rule
    best: tuple[float, np.ndarray] | None = None
    for scale in np.linspace(0.97, 1.03, 21 if points < 20000 else 9):
        spacing = scale * (volume / points) ** (1.0 / 3.0)
        for offset in ((a, b, c) for a in (0.0, 0.25) for b in (0.0, 0.25) for c in (0.0, 0.25)):
            cloud = lattice(spacing, half, offset)
            cloud = cloud[inside(cloud)]
            if len(cloud) == 0:
                continue
            spread = cloud.var(axis=0) + MOMENT * spacing**2
            misfit = abs(len(cloud) * spacing**3 / volume - 1.0) + float(np.abs(spread / moments - 1.0).max())
            misfit += float(np.abs(cloud.mean(axis=0)).max() / spacing) + 0.05 * abs(len(cloud) / points - 1.0)
            for i in flat:
                outside = half[i] - cloud[:, i].max() + cloud[:, i].mean()
                misfit += 0.1 * abs(outside / (0.5 * EDGE * spacing) - 0.5)
            if best is None or misfit < best[0]:
                best = misfit, _connected(cloud, spacing)
    assert best is not None
    cloud = best[1] - best[1].mean(axis=0)
    return np.ascontiguousarray(cloud), volume / len(cloud)


def _connected(cloud: np.ndarray, spacing: float) -> np.ndarray:
    """The points (k,3) without those whose deformation gradient is undefined: with few neighbours, or with all of them in a plane."""
    while True:
        i, j = cKDTree(cloud).query_pairs(1.3 * spacing, output_type="ndarray").T
        along = (cloud[j] - cloud[i]) / np.linalg.norm(cloud[j] - cloud[i], axis=1)[:, None]
        both, products = np.concatenate([i, j]), np.tile(np.einsum("ka,kb->abk", along, along), 2)
        spread = np.array([[np.bincount(both, entry, len(cloud)) for entry in row] for row in products])
        kept = np.bincount(both, minlength=len(cloud)) >= MIN_NEIGHBOURS
        kept &= np.linalg.eigvalsh(spread.transpose(2, 0, 1))[:, 0] > LEAST_SPREAD
        if kept.all():
            return cloud
        cloud = cloud[kept]


def surface(diameter: float, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """A geodesic sphere around the origin with edges of about `edge` m: vertices (n,3) m, triangles (m,3) with normals outwards."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array(
        [[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0], [0, -1, golden], [0, 1, golden],
         [0, -1, -golden], [0, 1, -golden], [golden, 0, -1], [golden, 0, 1], [-golden, 0, -1], [-golden, 0, 1]]
    )  # fmt: skip
    faces = np.array(
        [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2], [10, 7, 6], [7, 1, 8],
         [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]]
    )  # fmt: skip
    parts = max(2, round(0.55 * diameter / edge))  # of each edge of the icosahedron, 0.53 diameters long
    points, triangles = subdivide(corners, faces, parts)
    return points * (0.5 * diameter / np.linalg.norm(points, axis=1))[:, None], triangles


def subdivide(corners: np.ndarray, faces: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Divide each edge of a triangulated surface into `parts`; faces stay flat. Returns vertices (n,3), triangles (m,3).

    corners (c,3): corners, with coordinates of the order of 1; vertices closer than 1e-9 are merged.
    """
    i, j = np.array([(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]).T
    weights = np.stack([parts - i - j, i, j], axis=1) / parts
    number = {pair: n for n, pair in enumerate(zip(i.tolist(), j.tolist(), strict=True))}
    up = [(number[a, b], number[a + 1, b], number[a, b + 1]) for a in range(parts) for b in range(parts - a)]
    down = [
        (number[a + 1, b], number[a + 1, b + 1], number[a, b + 1]) for a in range(parts) for b in range(parts - a - 1)
    ]
    points = np.einsum("kc,fcd->fkd", weights, corners[faces]).reshape(-1, 3)
    triangles = (np.array(up + down)[None] + len(weights) * np.arange(len(faces))[:, None, None]).reshape(-1, 3)
    _, first, number_of = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    return points[first], number_of.ravel()[triangles]
