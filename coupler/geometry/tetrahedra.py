"""Tetrahedra (m,4) on points (n,3): volumes, faces and the boundary. Lengths in whatever unit the points have."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

COARSEST = 1 / 6  # largest element of a graded mesh over the smaller dimension of the body
TETS_PER_H3 = 4.2  # tetrahedra in a volume h^3, counted in gmsh's meshes: half as many as regular ones of edge h
PLACES = 4096  # looked for at once in `depths`: some 100 MB
#: Faces of a tetrahedron of positive volume, normals outwards; face i lies opposite corner i.
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


def volumes(points: NDArray, tets: NDArray) -> NDArray[np.float64]:
    """Signed volumes (m,)."""
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    return np.einsum("ij,ij->i", edges[:, 0], np.cross(edges[:, 1], edges[:, 2])) / 6.0


def oriented(points: NDArray, tets: NDArray) -> NDArray:
    """The tetrahedra with the last two corners of those of negative volume swapped, so that no volume is negative."""
    return np.where((volumes(points, tets) < 0.0)[:, None], tets[:, [0, 1, 3, 2]], tets)


def boundary_faces(tets: NDArray) -> tuple[NDArray, NDArray[np.int64]]:
    """Faces (k,3) that belong to one tetrahedron only, and the tetrahedron of each (k,).

    Normals point outwards where volumes are positive. Faces come in the order of `FACES`, then of the tetrahedra.
    """
    faces = np.concatenate([tets[:, corners] for corners in FACES])
    if len(faces) == 0:
        return faces, np.zeros(0, np.int64)
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    twin = np.all(corners[order][1:] == corners[order][:-1], axis=1)
    single = np.sort(order[~(np.append(twin, False) | np.insert(twin, 0, False))])
    return faces[single], single % len(tets)


def depths(x: NDArray, points: NDArray, tets: NDArray, near: int = 32) -> NDArray[np.float64]:
    """Distance (k,) m of places x (k,3) inside the tetrahedra (m,4) of points (n,3) from the nearest node of their boundary; 0 outside.

    Only the `near` tetrahedra with the nearest centres are looked at.
    """
    centres, inside = cKDTree(points[tets].mean(axis=1)), np.zeros(len(x), bool)
    for rows in np.array_split(np.arange(len(x)), len(x) // PLACES + 1):
        candidates = centres.query(x[rows], np.arange(1, min(near, len(tets)) + 1))[1]
        corner = points[tets[candidates]]
        edges = np.moveaxis(corner[:, :, 1:] - corner[:, :, :1], -1, -2)
        weights = np.linalg.solve(edges, (x[rows, None] - corner[:, :, 0])[..., None])[..., 0]
        inside[rows] = np.any((weights.min(axis=2) > -1e-9) & (weights.sum(axis=2) < 1.0 + 1e-9), axis=1)
    depth = np.zeros(len(x))
    if inside.any():
        boundary = points[np.unique(boundary_faces(tets)[0])]
        depth[inside] = cKDTree(boundary).query(x[inside])[0]
    return depth
