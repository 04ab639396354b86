"""Checks of surfaces before they are filled (open3d)."""

import numpy as np
from numpy.typing import NDArray

from ..errors import SplatError
from .triangles import open_or_double


def check_solid(points: NDArray, triangles: NDArray) -> None:
    """Raise SplatError where points (n,3) and triangles (m,3) do not bound a solid: open, not manifold, or through itself."""
    import open3d as o3d

    unit = float(np.ptp(points, axis=0).max()) / 100.0  # open3d has absolute tolerances for numbers near one
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector((points - points[0]) / unit), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    problem = open_or_double(np.asarray(triangles, np.int64))
    if not problem and not mesh.is_vertex_manifold():
        problem = f"{len(mesh.get_non_manifold_vertices())} corners are where it touches itself"
    if not problem and mesh.is_self_intersecting():
        problem = f"{len(mesh.get_self_intersecting_triangles())} pairs of triangles pass through each other"
    if problem:
        raise SplatError(f"the surface bounds no solid: {problem}")
