"""Queries of triangulated surfaces by ray casting (open3d, Embree).

Embree computes in single precision. Coordinates are relative to the middle of the surface and scaled by its size: their error is 1e-7
of the size.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import occurring
from ..errors import SplatError
from .library import open3d
from .triangles import area_vectors, open_or_double

if TYPE_CHECKING:
    from open3d.core import Tensor


class RaySurface:
    """A surface of points (n,3) m and triangles (m,3) for queries of rays and distances. The constructor loads open3d.

    closed: the surface must be closed and oriented; raises SplatError if it is not.
    """

    def __init__(self, points: NDArray, triangles: NDArray, closed: bool = True):
        o3d = open3d()
        if closed and (problem := open_or_double(np.asarray(triangles, np.int64))):
            raise SplatError(f"the surface is not closed: {problem}")
        self._tensor: Callable[[NDArray], Tensor] = o3d.core.Tensor.from_numpy
        used = occurring(triangles, len(points))  # a surface may use few of the points
        index = np.zeros(len(points), np.uint32)
        index[used] = np.arange(len(used))
        points, triangles = points[used], index[triangles]
        self._upwards = np.sign(area_vectors(points, triangles)[:, 2])
        low, high = points.min(axis=0), points.max(axis=0)
        self.middle, self.unit = 0.5 * (low + high), float((high - low).max()) / 100.0
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(self._single(points), self._tensor(np.ascontiguousarray(triangles)))

    def _single(self, x: NDArray) -> "Tensor":
        """The points x, relative to `middle` and divided by `unit`, as an open3d tensor in single precision."""
        return self._tensor(np.ascontiguousarray((x - self.middle) / self.unit, np.float32))

    def distance_outside(self, x: NDArray) -> NDArray[np.float64]:
        """Distance (k,) m of points x (k,3) m from the closed surface; 0 for points inside."""
        distance, out = np.zeros(len(x)), np.flatnonzero(~self.inside(x))
        distance[out] = self._scene.compute_distance(self._single(x[out]), nthreads=1).numpy()
        return distance * self.unit

    def inside(self, x: NDArray) -> NDArray[np.bool_]:
        """Mask (k,) of the points x (k,3) m inside the closed surface."""
        return self._scene.compute_occupancy(self._single(x), nthreads=1).numpy() > 0.5

    def windings(self, x: NDArray) -> NDArray[np.int64]:
        """Winding number (k,) of the closed surface about points x (k,3) m: 0 outside, 1 inside, 2 where the surface overlaps
        itself."""
        # with this offset no line passes through an edge of a symmetric surface
        aside = 1e-3 * self.unit * np.array([0.731, 1.237])
        line, height, triangle = self.on_verticals(*(x[:, :2] + aside).T)
        above = height > x[line, 2]
        return np.bincount(line[above], self._upwards[triangle[above]], len(x)).astype(np.int64)

    def feet(self, x: NDArray) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """For points x (k,3) m, the closest points (k,3) m of the surface, the indices of their triangles (k,) and their barycentric
        coordinates (k,3)."""
        closest = self._scene.compute_closest_points(self._single(x), nthreads=1)
        points = closest["points"].numpy().astype(float) * self.unit + self.middle
        uv = closest["primitive_uvs"].numpy().astype(float)
        weights = np.concatenate([1.0 - uv.sum(axis=1, keepdims=True), uv], axis=1)
        return points, closest["primitive_ids"].numpy().astype(np.int64), weights

    def on_verticals(self, x: NDArray, y: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
        """Points at which vertical lines at x, y (k,) m cross the surface: line (c,), height (c,) m and triangle (c,) of each
        crossing."""
        low = -60.0  # start of the lines, below the surface
        rays = np.zeros((len(x), 6), np.float32)
        rays[:, 0], rays[:, 1] = (x - self.middle[0]) / self.unit, (y - self.middle[1]) / self.unit
        rays[:, 2], rays[:, 5] = low, 1.0
        hit = self._scene.list_intersections(self._tensor(rays), nthreads=1)
        height = (hit["t_hit"].numpy().astype(float) + low) * self.unit + self.middle[2]
        return hit["ray_ids"].numpy().astype(np.int64), height, hit["primitive_ids"].numpy().astype(np.int64)
