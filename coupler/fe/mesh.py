"""The mesh of the target, with gradients, volumes and facets from scikit-fem."""

from dataclasses import dataclass, field
from typing import Annotated, Protocol

import numpy as np
from skfem import Basis, ElementTetP1, LinearForm, MeshTet, asm

from ..core.records import Shape
from ..errors import SolverError
from ..geometry.graph import around
from ..geometry.tetrahedra import oriented, volumes
from ..geometry.triangles import area_vectors
from .model import Cells, Metals
from .state import Balance, ElementState, NodeState

UPWARDS = 0.25  # smallest z component of the unit normal of a facet at the top: that of a slope of 75 degrees


@dataclass(frozen=True)
class TetMesh:
    """Mesh of the explicit solver, numbered outwards from the point of impact.

    points (n,3) m; conn (m,4): corners; B (m,3,3) 1/m: reference gradients of the shape functions of corners 1 to 3; V0 (m,) m3:
    reference volumes; node_volume (n,) m3: lumped volumes; facets (k,3): boundary triangles, normals outwards; facet_element (k,):
    element behind each; sets: indices of facets by name; reach_node (n,), reach_element (m,) m: distance from the point of impact,
    ascending; if numbered in shells (`target.domain.merge`), that of the inner face of the shell; axis (2,) m: x and y of the
    half-space's axis.
    """

    points: Annotated[np.ndarray, Shape(-1, 3)]
    conn: Annotated[np.ndarray, Shape(-1, 4, dtype=np.int32, index_of="nodes")]
    B: Annotated[np.ndarray, Shape(-1, 3, 3)]
    V0: Annotated[np.ndarray, Shape(-1)]
    node_volume: Annotated[np.ndarray, Shape(-1)]
    facets: Annotated[np.ndarray, Shape(-1, 3, dtype=np.int32, index_of="nodes")]
    facet_element: Annotated[np.ndarray, Shape(-1, dtype=np.int32, index_of="elements")]
    sets: dict[str, np.ndarray]
    reach_node: Annotated[np.ndarray, Shape(-1)]
    reach_element: Annotated[np.ndarray, Shape(-1)]
    axis: Annotated[np.ndarray, Shape(2)] = field(default_factory=lambda: np.zeros(2))


class FiniteElements(Protocol):
    """The attributes of `fe.explicit.Target` that its parts (heat, stability, window ...) use. `Target` describes them."""

    mesh: TetMesh
    laws: np.ndarray
    law_of: np.ndarray
    cells: Cells
    metals: Metals
    nodes: NodeState
    elements: ElementState
    mass: np.ndarray
    inv_mass: np.ndarray
    dt_of: np.ndarray
    balance: Balance
    active_nodes: int
    active_elements: int


def prepare(points: np.ndarray, tets: np.ndarray, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> TetMesh:
    """The mesh of tetrahedra, numbered outwards from `origin` (m). points (n,3) m; tets (m,4). Raises SolverError for an empty
    tetrahedron."""
    return prepare_ordered(points, tets, origin)[0]


def prepare_ordered(
    points: np.ndarray, tets: np.ndarray, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> tuple[TetMesh, np.ndarray, np.ndarray]:
    """As `prepare`. Returns also the index of each node (n,) among `points`, and of each element (m,) among `tets`."""
    distance = np.linalg.norm(points - np.asarray(origin), axis=1)
    order = np.argsort(distance, kind="stable")
    rank = np.argsort(order)
    points, reach_node = np.ascontiguousarray(points[order]), distance[order]
    tets = rank[tets]
    reach = reach_node[tets].min(axis=1)
    by_reach = np.argsort(reach, kind="stable")
    tets, reach = tets[by_reach], reach[by_reach]

    size = np.abs(volumes(points, tets))
    if not np.all(size > 0.0):
        bad = int(np.argmin(size))
        raise SolverError(f"tetrahedron {bad} of the mesh has no volume: change the element size of the target")
    tets = oriented(points, tets)

    mesh = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tets.T), sort_t=False)
    basis = Basis(mesh, ElementTetP1(), intorder=1)
    gradients = np.stack(
        [np.broadcast_to(basis.basis[i][0].grad, (3, len(tets), 1))[:, :, 0].T for i in (1, 2, 3)], axis=1
    )
    V0 = basis.dx.sum(axis=1)
    node_volume = asm(LinearForm(lambda v, w: v), basis)

    facet_ids = mesh.boundary_facets()
    element = mesh.f2t[0, facet_ids]
    corners = mesh.facets[:, facet_ids].T
    inside = points[tets[element]].mean(axis=1)
    flip = np.einsum("ij,ij->i", area_vectors(points, corners), points[corners[:, 0]] - inside) < 0
    corners[flip] = corners[flip][:, [0, 2, 1]]
    sets = name_sides(points, corners)
    gradients, V0, node_volume = (np.ascontiguousarray(values) for values in (gradients, V0, node_volume))
    conn, facets, behind = (np.ascontiguousarray(ids, np.int32) for ids in (tets, corners, element))
    prepared = TetMesh(points, conn, gradients, V0, node_volume, facets, behind, sets, reach_node, reach)
    return prepared, order, by_reach


def cells_of(mesh: TetMesh) -> Cells:
    """The arrays of a mesh as arguments of kernels."""
    return Cells(mesh.conn, mesh.B, mesh.V0, mesh.node_volume, *around(mesh.conn, len(mesh.points)))


def name_sides(points: np.ndarray, corners: np.ndarray) -> dict[str, np.ndarray]:
    """Facets of a cylinder or box by their normals: top (upwards), bottom (downwards), sides (all others). A slope up to 75 degrees
    still counts as top (`plan.ground`)."""
    normal = area_vectors(points, corners)
    steep = normal[:, 2] / np.linalg.norm(normal, axis=1)
    top, bottom = steep > UPWARDS, steep < -UPWARDS
    return {"top": np.flatnonzero(top), "bottom": np.flatnonzero(bottom), "sides": np.flatnonzero(~top & ~bottom)}
