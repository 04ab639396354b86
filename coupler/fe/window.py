"""A window on the target: elements beyond a radius round the point of impact are not computed.

These elements are at rest, in equilibrium, and their forces are added up only once. In an impact the nodes on the edge of the
window have springs and dashpots, which replace the elements beyond it (`Edge`). In a relaxation these nodes are fixed.
"""

import numpy as np

from ..geometry.tetrahedra import boundary_faces
from ..geometry.triangles import areas_and_normals
from .boundary import add_matrices
from .mesh import FiniteElements, TetMesh
from .state import EdgeState

NORMAL = 2.0  # stiffness of the edge in radial direction, divided by G / R
UNDISTURBED = 0.9  # share of the radius within which the edge does not affect the target


def outside(mesh: TetMesh, elements: int, nodes: int) -> np.ndarray:
    """Nodes (k,) at the edge of the window: active nodes (the first `nodes`) of inactive elements (all after the first `elements`)."""
    others = np.unique(mesh.conn[elements:])
    return others[others < nodes]


class Edge(EdgeState):
    """Springs and dashpots at the edge of a window, for waves and static displacements of a source at `origin` (3,) m.

    A viscous-spring boundary (Deeks & Randolph 1994, J. Eng. Mech. 120, 25; Liu et al. 2006, Earthq. Eng. Eng. Vib. 5, 93). Per
    area of a sphere of radius R: stiffness NORMAL G / R along the radius and half of this across it, damping rho c_p and rho c_s.
    nodes (k,); rest (k,3) m: rest positions; stiffness (k,3,3) N/m; damping (k,3,3) kg/s; static (k,3) N: forces of the elements
    beyond the edge.
    """

    def __init__(
        self, t: FiniteElements, elements: int, among: np.ndarray, origin: np.ndarray, rest: np.ndarray | None = None
    ):
        """The edge of the first `elements` of a target: facets whose nodes are all in `among` (a,). rest (k,3) m: rest positions,
        by default the present ones."""
        n = len(t.nodes.x)
        chosen = np.zeros(n, bool)
        chosen[among] = True
        faces, behind = boundary_faces(t.mesh.conn[:elements])
        inner = chosen[faces].all(axis=1) & ~np.isin(_keys(faces, n), _keys(t.mesh.facets, n))
        faces, law = faces[inner], t.laws[t.law_of[behind[inner]]]
        nodes, x = np.unique(faces), t.nodes.x
        if rest is not None:
            x = x.copy()
            x[nodes] = rest
        area, normal = areas_and_normals(x, faces)
        away = x[faces].mean(axis=1) - origin
        R = np.linalg.norm(away, axis=1)
        radial = away / R[:, None]
        area = area * np.einsum("ij,ij->i", normal, radial)  # projected on the sphere: the edge is not smooth
        c_p, c_s = np.sqrt((law["K"] + 4.0 / 3.0 * law["G"]) / law["rho"]), np.sqrt(law["G"] / law["rho"])
        matrices = np.zeros((2, n, 3, 3))
        add_matrices(faces, area, radial, NORMAL * law["G"] / R, 0.5 * NORMAL * law["G"] / R, matrices[0])
        add_matrices(faces, area, radial, law["rho"] * c_p, law["rho"] * c_s, matrices[1])
        has_no_area = np.bincount(faces.T.ravel(), np.tile(area, 3), n) <= 0.0
        matrices[:, has_no_area] = 0.0
        super().__init__(origin, x[nodes])
        self.nodes, (self.stiffness, self.damping) = nodes, matrices[:, nodes]
        self.load(t, elements)

    def load(self, t: FiniteElements, elements: int) -> None:
        """Store the present forces of the elements beyond the first `elements` as the static forces."""
        forces = np.zeros((len(t.nodes.x), 3))
        np.add.at(forces, t.mesh.conn[elements:].ravel(), t.elements.fe[elements:].reshape(-1, 3))
        self.static = forces[self.nodes]

    def pull(self, x: np.ndarray) -> np.ndarray:
        """Forces (k,3) N of the springs at the edge. x (N,3) m: positions of all nodes."""
        return -np.einsum("aij,aj->ai", self.stiffness, x[self.nodes] - self.rest)

    def energy(self, x: np.ndarray) -> float:
        """Energy of the springs less the work of the static forces, J."""
        u = x[self.nodes] - self.rest
        return float(0.5 * np.einsum("ai,aij,aj->", u, self.stiffness, u) - np.einsum("ai,ai->", self.static, u))


def _keys(faces: np.ndarray, n: int) -> np.ndarray:
    """A unique integer (k,) for each triangle (k,3) of n nodes, the same for any order of its corners."""
    a, b, c = np.sort(faces, axis=1).T.astype(np.int64)
    return (a * n + b) * n + c
