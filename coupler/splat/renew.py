"""Remeshing of the surface of a patch of a body: its free part becomes even, its cut stays as it is."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from ..errors import SplatError
from ..geometry import remesh
from ..geometry.raycast import RaySurface
from ..geometry.triangles import VOLUME_TOLERANCE, correct_volume, edges, enclosed_volume, open_or_double

GROWTH = 0.5  # of the edge length with the distance from the cut, from its edges to the size asked for
MAX_OFFSET = 0.1  # of an edge, by which the surface is moved to correct the volume


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
    old = RaySurface(vertices, triangles[len(triangles) - free :], closed=False)
    scale = graded_scale(vertices, triangles[: len(triangles) - free], size)
    x, t = remesh.even(vertices, triangles, size, old.closest, fixed, scale)
    x, moved = correct_volume(x, t, target, MAX_OFFSET * size, np.arange(len(x)) < fixed)
    if abs(enclosed_volume(x, t) - target) > VOLUME_TOLERANCE * target:
        raise SplatError(f"keeping the volume would move the surface by more than {MAX_OFFSET} of an edge")
    return x, t, moved
