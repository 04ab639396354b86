"""Measures of a tetrahedral mesh: element quality, dihedral angles, stable time step, connected parts, fit to its cloud."""

import numpy as np
from scipy.spatial import ConvexHull

from ..geometry.graph import connected_parts
from ..geometry.raycast import RaySurface
from ..geometry.tetrahedra import FACES, boundary_faces, volumes
from ..geometry.triangles import compact
from .cloud import Cloud, Report

_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def _face_normals(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Outward normals (m,4,3) of the faces opposite to each corner, with a length of twice the area."""
    corner = points[tets]
    return np.stack([np.cross(corner[:, b] - corner[:, a], corner[:, c] - corner[:, a]) for a, b, c in FACES], axis=1)


def gamma(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Quality gamma (m,) of gmsh: the radius of the inscribed sphere divided by the longest edge, scaled to 1 for a regular
    tetrahedron. It is negative for an inverted tetrahedron."""
    area = 0.5 * np.linalg.norm(_face_normals(points, tets), axis=2).sum(axis=1)
    longest = np.max([np.linalg.norm(points[tets[:, i]] - points[tets[:, j]], axis=1) for i, j in _EDGES], axis=0)
    return 6.0 * np.sqrt(6.0) * volumes(points, tets) / np.maximum(area * longest, 1e-300)


def dihedral_angles(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Dihedral angles (m,6) between the faces, rad."""
    n = _face_normals(points, tets)
    n /= np.maximum(np.linalg.norm(n, axis=2), 1e-300)[:, :, None]
    return np.stack([np.pi - np.arccos(np.clip(np.einsum("ij,ij->i", n[:, i], n[:, j]), -1, 1)) for i, j in _EDGES], 1)


def step_lengths(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Stable explicit time step of each element, multiplied by the longitudinal wave speed: a length (m,) m.

    The step is 2 / omega, with the bound omega^2 <= 4 c^2 (0.43 tr M + 0.57 lambda_max(M)), M = sum of b (x) b over the gradients b
    of the shape functions: the bound of `coupler.fe.kernels.stable_dt` for Poisson's ratio 0.3, where lambda / (lambda + 2 G) =
    0.43.
    """
    b = -_face_normals(points, tets) / (6.0 * np.maximum(volumes(points, tets), 1e-300))[:, None, None]
    M = np.einsum("eki,ekj->eij", b, b)
    return 1.0 / np.sqrt(3.0 / 7.0 * np.trace(M, axis1=1, axis2=2) + 4.0 / 7.0 * np.linalg.eigvalsh(M)[:, 2])


def pieces(points: np.ndarray, tets: np.ndarray) -> int:
    """Number of separate parts of a mesh, which share no nodes; a node without a tetrahedron is a part."""
    pairs = np.concatenate([tets[:, [0, 1]], tets[:, [1, 2]], tets[:, [2, 3]]])
    return int(connected_parts(pairs, len(points))[0])


def fit_of(points: np.ndarray, tets: np.ndarray, cloud: Cloud) -> Report:
    """How well a mesh fits its cloud. width_m, top_m: width and top of the mesh; source_width_m, source_top_m: those of the carried
    surface, or of the points if there is no surface; outside_half: fraction of the points that are more than half a spacing outside
    the mesh; outside_max: largest such distance, in spacings. A width is the diameter of the circle with the area of the body seen
    from above."""
    x, triangles = compact(points, boundary_faces(tets)[0])
    source = cloud.x if cloud.surface is None else cloud.surface[0]
    out = RaySurface(x, triangles).distance_outside(cloud.x) / cloud.spacing

    def width(x: np.ndarray) -> float:
        return float(np.sqrt(4.0 / np.pi * ConvexHull(x[:, :2]).volume))

    return {
        "width_m": width(x), "top_m": float(x[:, 2].max()),
        "source_width_m": width(source), "source_top_m": float(source[:, 2].max()),
        "outside_half": float(np.mean(out > 0.5)), "outside_max": float(out.max()),
    }  # fmt: skip
