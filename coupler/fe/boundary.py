"""Artificial boundaries of a target: dashpots that absorb waves, and springs with the stiffness of the surrounding half-space."""

import numpy as np

from ..geometry.triangles import areas_and_normals
from .mesh import TetMesh

HALF_SPACE = "half_space"  # name of the set of facets at which a half-space surrounds the target


def nodes_of(mesh: TetMesh, names: tuple[str, ...]) -> np.ndarray:
    """Indices of the nodes of facet sets, ascending."""
    ids = [mesh.facets[mesh.sets[name]].ravel() for name in names]
    return np.unique(np.concatenate(ids)) if ids else np.zeros(0, np.int64)


def dashpots(
    mesh: TetMesh, laws: np.ndarray, law_of: np.ndarray, names: tuple[str, ...], fixed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Absorbing boundary of Lysmer & Kuhlemeyer (1969) at facet sets: the nodes (k,) that are not fixed, and the damping matrix
    (k,3,3) kg/s of each. The matrix is the sum of rho (c_p n n^T + c_s (1 - n n^T)) area / 3 over the facets of the node. laws: LAW
    records; law_of (m,): law of each element; names: names of the facet sets; fixed: indices of the fixed nodes."""
    nodes = np.setdiff1d(nodes_of(mesh, names), fixed)
    matrix = np.zeros((len(mesh.points), 3, 3))
    for name in names:
        ids = mesh.sets[name]
        law = laws[law_of[mesh.facet_element[ids]]]
        cp = np.sqrt((law["K"] + 4.0 / 3.0 * law["G"]) / law["rho"])
        cs = np.sqrt(law["G"] / law["rho"])
        _add(mesh, ids, law["rho"] * cp, law["rho"] * cs, matrix)
    return nodes, matrix[nodes]


def foundation(mesh: TetMesh, G: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Static stiffness of a half-space at the facets HALF_SPACE: nodes (k,), and the stiffness matrix (k,3,3) N/m of each. G (m,) Pa.

    The forces of a coating on its substrate have no resultant: displacements fall with the square of the distance R. For such a centre
    of dilatation the normal traction on a sphere is -4 G u / R; the tangential stiffness is half of this, as in viscous-spring
    boundaries (Liu et al. 2006, Earthq. Eng. Eng. Vib. 5, 93). R is the distance from the point of the mesh's axis at z = 0.
    """
    ids = mesh.sets.get(HALF_SPACE, np.zeros(0, np.int64))
    matrix = np.zeros((len(mesh.points), 3, 3))
    nodes = np.unique(mesh.facets[ids])
    if len(ids):
        R = np.linalg.norm(mesh.points[mesh.facets[ids]].mean(axis=1) - [*mesh.axis, 0.0], axis=1)
        shear = G[mesh.facet_element[ids]] / R
        _add(mesh, ids, 4.0 * shear, 2.0 * shear, matrix)
    return nodes, matrix[nodes]


def _add(mesh: TetMesh, ids: np.ndarray, normal: np.ndarray, tangential: np.ndarray, matrix: np.ndarray) -> None:
    """Do `add_matrices` for the facets ids (k,) of a mesh. normal, tangential: coefficients of each facet."""
    corners = mesh.facets[ids]
    add_matrices(corners, *areas_and_normals(mesh.points, corners), normal, tangential, matrix)


def add_matrices(
    faces: np.ndarray, area: np.ndarray, n: np.ndarray, along: np.ndarray, across: np.ndarray, matrix: np.ndarray
) -> None:
    """Add (along n n^T + across (I - n n^T)) area / 3 of each face to the matrices (N,3,3) of its three nodes. faces (k,3); n (k,3):
    normals of the faces; along, across: coefficients."""
    nn = n[:, :, None] * n[:, None, :]
    share = (area / 3.0)[:, None, None] * (along[:, None, None] * nn + across[:, None, None] * (np.eye(3) - nn))
    for i in range(3):
        np.add.at(matrix, faces[:, i], share)
