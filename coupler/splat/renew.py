"""The surface of a patch of a body, remeshed on itself: its free part made even, its cut left as it is."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from ..errors import SplatError
from ..sph.carried_surface import volume
from . import remesh
from .surface import area, open_or_double

NEAR = 24  # triangles, by their centres, that the closest point of a surface is looked for on
VOLUME = 1e-9  # of the patch: how well its volume is kept
GROWTH = 0.5  # of edges with the distance from the cut, from what they are there to the size wanted
MOST = 0.1  # of an edge: how far the surface may be moved to keep it


class Original:
    """A surface (k,3) m, (m,3) that vertices are put back on."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray):
        self.corners = vertices[triangles]
        self.tree = cKDTree(self.corners.mean(axis=1))

    def settle(self, x: np.ndarray, _triangles: np.ndarray | None = None) -> np.ndarray:
        """The point of the surface closest to each of x (n,3) m."""
        near = self.tree.query(x, k=min(NEAR, len(self.corners)))[1].reshape(len(x), -1)
        found = closest(x[:, None], self.corners[near])
        best = np.argmin(np.sum((found - x[:, None]) ** 2, axis=2), axis=1)
        return found[np.arange(len(x)), best]


def closest(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The point of each triangle (...,3,3) closest to x (...,3): Ericson (2005), section 5.1.5, without branches."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]

    def dot(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.sum(p * q, axis=-1)

    def on_edge(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        t = np.clip(dot(x - p, q - p) / np.maximum(dot(q - p, q - p), 1e-300), 0.0, 1.0)
        return p + t[..., None] * (q - p)

    n = np.cross(b - a, c - a)
    nn = np.maximum(dot(n, n), 1e-300)
    foot = x - (dot(x - a, n) / nn)[..., None] * n
    sides = [dot(np.cross(q - p, foot - p), n) for p, q in ((a, b), (b, c), (c, a))]
    within = (sides[0] >= 0.0) & (sides[1] >= 0.0) & (sides[2] >= 0.0)
    edges = np.stack([on_edge(a, b), on_edge(b, c), on_edge(c, a)])
    distance = np.sum((edges - x) ** 2, axis=-1)
    nearest = np.take_along_axis(edges, np.argmin(distance, axis=0)[None, ..., None], axis=0)[0]
    return np.where(within[..., None], foot, nearest)


def towards(vertices: np.ndarray, cut: np.ndarray, size: float) -> Callable[[np.ndarray], np.ndarray]:
    """Edges over `size` m, as a function of places, that run from those of the triangles `cut` (c,3) to 1, GROWTH by distance."""
    sides = np.concatenate([cut[:, [0, 1]], cut[:, [1, 2]], cut[:, [2, 0]]])
    length = np.linalg.norm(vertices[sides[:, 0]] - vertices[sides[:, 1]], axis=1)
    nodes = np.unique(cut)
    mean = (np.bincount(sides.ravel(), np.repeat(length, 2)) / np.maximum(np.bincount(sides.ravel()), 1))[nodes]
    tree = cKDTree(vertices[nodes])

    def scale(x: np.ndarray) -> np.ndarray:
        distance, i = tree.query(x)
        off = mean[i] - size
        return 1.0 + np.sign(off) * np.maximum(0.0, np.abs(off) - GROWTH * distance) / size

    return scale


def renewed_surface(
    vertices: np.ndarray, triangles: np.ndarray, fixed: int, free: int, size: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """A closed surface (k,3) m, (m,3) with the edges of its last `free` triangles made even, of about `size` m.

    The first `fixed` vertices and the other triangles stay as they are. The new vertices lie on the old surface, then are moved
    along its normals, all alike, until the volume is the old one. Returns vertices, triangles, and how far they were moved,
    m. Raises SplatError where the surface is not a closed one, or would have to be moved too far.
    """
    if wrong := open_or_double(triangles):
        raise SplatError(f"the surface of the patch is not closed: {wrong}")
    target = volume(vertices, triangles)
    if not target > 0.0:
        raise SplatError("the surface of the patch encloses no volume")
    old = Original(vertices, triangles[len(triangles) - free :])
    scale = towards(vertices, triangles[: len(triangles) - free], size)
    x, t = remesh.even(vertices, triangles, size, old.settle, fixed, scale)
    moved = 0.0
    for _ in range(20):
        missing = target - volume(x, t)
        if abs(missing) < VOLUME * target:
            break
        normal = remesh.normals(x, t)
        normal[:fixed] = 0.0
        loose = (t >= fixed).any(axis=1)
        step = missing / area((x, t[loose]))
        x = x + step * normal
        moved += step
        if abs(moved) > MOST * size:
            raise SplatError(f"keeping the volume would move the surface by {moved / size:+.2f} of an edge")
    return x, t, moved
