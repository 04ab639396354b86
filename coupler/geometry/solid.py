"""Surfaces that bound a solid: their checks before they are filled, and the cleaning of those of strangers (open3d)."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import SplatError
from .library import open3d
from .triangles import enclosed_volume, open_or_double

if TYPE_CHECKING:
    from open3d.pybind.geometry import TriangleMesh

MOST_TRIANGLES = 4000  # of a cleaned solid: finer ones are decimated
SAME_PLACE = 1e-6  # of the extent: corners so close are one
FRAGMENT = 0.01  # of the surface: smaller parts beside the body are left out


@dataclass(frozen=True)
class Solid:
    """A body by its closed surface: points (n,3), triangles (m,3) outwards; centre of volume at the origin, volume that of a sphere
    of diameter 1."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]


def solid_of(points: NDArray, triangles: NDArray) -> Solid:
    """The solid that a surface of points (n,3), in any unit, and triangles (m,3) bounds, cleaned.

    Corners at one place are joined, double and empty triangles and fragments left out, all turned outwards; a fine surface is
    decimated to MOST_TRIANGLES. Raises SplatError where no solid comes of it, or more than one.
    """
    mesh = _mesh(points, triangles)
    mesh.merge_close_vertices(100.0 * SAME_PLACE)
    mesh.remove_duplicated_triangles().remove_degenerate_triangles()
    label, _, area = (np.asarray(values) for values in mesh.cluster_connected_triangles())
    if not len(area) or not area.sum() > 0.0:
        raise SplatError("the surface has no area: give the triangles of a closed surface")
    parts = np.flatnonzero(area > FRAGMENT * area.sum())
    if len(parts) > 1:
        raise SplatError(
            f"the surface falls into {len(parts)} parts, bodies or cavities: give one body without cavities"
        )
    mesh.remove_triangles_by_mask(label != parts[0])
    mesh.remove_unreferenced_vertices()
    if len(mesh.triangles) > MOST_TRIANGLES:
        mesh = (
            mesh.simplify_quadric_decimation(MOST_TRIANGLES)
            .remove_degenerate_triangles()
            .remove_unreferenced_vertices()
        )
    if not mesh.orient_triangles():
        raise SplatError("the surface bounds no solid: its triangles cannot all be turned outwards")
    x, t = np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int64)
    check_solid(x, t)
    volume = enclosed_volume(x, t)
    if volume < 0.0:
        t, volume = t[:, ::-1].copy(), -volume
    if volume < 1e-9 * float(np.prod(np.ptp(x, axis=0)) or 1.0):
        raise SplatError("the surface encloses no volume")
    a, b, c = (x[t[:, i]] for i in range(3))
    centre = np.einsum("ij,ij,ik->k", a, np.cross(b, c), a + b + c) / (24.0 * volume)
    return Solid((x - centre) * (np.pi / 6.0 / volume) ** (1.0 / 3.0), t)


def _mesh(points: NDArray, triangles: NDArray) -> "TriangleMesh":
    """A surface as open3d has it, 100 units large: open3d has absolute tolerances for numbers near one."""
    o3d = open3d()
    unit = float(np.ptp(points, axis=0).max()) / 100.0 or 1.0
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector((points - points[0]) / unit), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )


def check_solid(points: NDArray, triangles: NDArray) -> None:
    """Raise SplatError where points (n,3) and triangles (m,3) do not bound a solid: open, not manifold, or through itself."""
    problem = open_or_double(np.asarray(triangles, np.int64))
    mesh = _mesh(points, triangles)
    if not problem and not mesh.is_vertex_manifold():
        problem = f"{len(mesh.get_non_manifold_vertices())} corners are where it touches itself"
    if not problem and mesh.is_self_intersecting():
        problem = f"{len(mesh.get_self_intersecting_triangles())} pairs of triangles pass through each other"
    if problem:
        raise SplatError(f"the surface bounds no solid: {problem}")
