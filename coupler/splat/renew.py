"""Remeshing of the surface of a patch of a body: its free part becomes even, its cut stays as it is."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from ..errors import SplatError
from ..geometry.triangles import VOLUME_TOLERANCE, correct_volume, edges, enclosed_volume
from . import remesh
from .surface import open_or_double

NEAREST = 24  # triangles, by their centres, among which the closest point is searched
GROWTH = 0.5  # of the edge length with the distance from the cut, from its edges to the size asked for
MAX_OFFSET = 0.1  # of an edge, by which the surface is moved to correct the volume


class Original:
    """A surface, vertices (k,3) m and triangles (m,3), to which points are projected."""

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray):
        self.corners = vertices[triangles]
        self.tree = cKDTree(self.corners.mean(axis=1))

    def project(self, x: np.ndarray) -> np.ndarray:
        """The point of the surface closest to each of x (n,3) m."""
        near = self.tree.query(x, k=min(NEAREST, len(self.corners)))[1].reshape(len(x), -1)
        candidates = closest(x[:, None], self.corners[near])
        best = np.argmin(np.sum((candidates - x[:, None]) ** 2, axis=2), axis=1)
        return candidates[np.arange(len(x)), best]


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


def graded_scale(vertices: np.ndarray, cut: np.ndarray, size: float) -> Callable[[np.ndarray], np.ndarray]:
    """Edge length over `size` m as a function of places (e,3) m: that of the triangles `cut` (c,3) there, 1 far from them."""
    sides = edges(cut)
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
    """A closed surface (k,3) m, (m,3) whose last `free` triangles are remeshed with edges of about `size` m.

    The first `fixed` vertices and the other triangles stay as they are. The new vertices are projected to the old surface and
    moved along its normals by one offset, until the volume is that of the old surface. Returns vertices, triangles, and the
    offset, m. Raises SplatError where the surface is not closed, or the offset exceeds MAX_OFFSET.
    """
    if wrong := open_or_double(triangles):
        raise SplatError(f"the surface of the patch is not closed: {wrong}")
    target = enclosed_volume(vertices, triangles)
    if not target > 0.0:
        raise SplatError("the surface of the patch encloses no volume")
    old = Original(vertices, triangles[len(triangles) - free :])
    scale = graded_scale(vertices, triangles[: len(triangles) - free], size)
    x, t = remesh.even(vertices, triangles, size, old.project, fixed, scale)
    x, moved = correct_volume(x, t, target, MAX_OFFSET * size, np.arange(len(x)) < fixed)
    if abs(enclosed_volume(x, t) - target) > VOLUME_TOLERANCE * target:
        raise SplatError(f"keeping the volume would move the surface by more than {MAX_OFFSET} of an edge")
    return x, t, moved
