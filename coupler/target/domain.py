"""Domains of the target: a joining body with its state, several bodies with one numbering, and a part of a domain.

A joining body is meshed in its deformed position. Its reference volumes are V / J: so it has the right volume ratio and pressure
from the first step. The reference shape of each tetrahedron is the present one, scaled by J^(-1/3). The density corrects the small
error of the mesh volume (below one percent): so the mass is exact, and there is no additional pressure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ..core.arrays import occurring
from ..core.records import arrays_of, concatenate, new_rows, take
from ..core.threads import rows_at
from ..fe.explicit import Target
from ..fe.mesh import TetMesh, prepare_ordered
from ..fe.state import ElementState, NodeState
from ..geometry.points import morton
from ..geometry.tetrahedra import boundary_faces, least_at_corners, lumped
from ..physics.constitutive import pressures, yield_stresses
from ..physics.metal import MetalState, carried

Point = tuple[float, float, float]
R = TypeVar("R")
SPLAT = "splat"  # the facet set of body 1 has the name "splat1", and so on


@dataclass(frozen=True)
class BodyState(MetalState):
    """A body that joins the target. points (n,3) m; tets (m,4); stress (m,6) Pa: Voigt xx yy zz yz xz xy; J (m,); state of the metal
    (m,); velocity (n,3) m/s; energy (n,) J per reference m3; mass (kg); law (1,): LAW record."""

    points: np.ndarray
    tets: np.ndarray
    stress: np.ndarray
    J: np.ndarray
    velocity: np.ndarray
    energy: np.ndarray
    mass: float
    law: np.ndarray


@dataclass(frozen=True)
class Domain:
    """One or several bodies in one mesh: state of nodes and elements; body (m,): body of each element; laws (bodies,): LAW records."""

    mesh: TetMesh
    nodes: NodeState
    elements: ElementState
    body: np.ndarray
    laws: np.ndarray


def domain_of(body: BodyState, name: str) -> Domain:
    """The domain of a single joining body. name: name of its facet set. Raises SolverError for an empty tetrahedron."""
    mesh, node, element = prepare_ordered(body.points, body.tets)
    J = body.J[element]
    V = mesh.V0
    V0 = V / J
    law = body.law.copy()
    law["rho"] = body.mass / float(V0.sum())
    share = lumped(mesh.conn, V0, len(mesh.points))
    mesh = replace(
        mesh, V0=V0, B=mesh.B * ((V / V0) ** (1.0 / 3.0))[:, None, None], node_volume=share,
        sets={name: np.arange(len(mesh.facets))},
    )  # fmt: skip
    now = lumped(mesh.conn, V, len(mesh.points))
    n, m = len(mesh.points), len(mesh.conn)
    stress = body.stress[element]
    deviator = stress.copy()
    deviator[:, :3] -= stress[:, :3].mean(axis=1)[:, None]
    J, energy = now / share, body.energy[node]
    p = pressures(law, J, energy)
    nodes = new_rows(NodeState, n, x=mesh.points.copy(), v=body.velocity[node], J=J, energy=energy, p=p)
    metal = MetalState(**{name: values[element] for name, values in carried(body).items()})
    sigma_y = yield_stresses(law, np.zeros(m, np.int32), metal.eps_p, metal.T, metal.eps_gradient)
    elements = new_rows(ElementState, m, s=deviator, volume=V.copy(), sigma_y=sigma_y, **carried(metal))
    return Domain(mesh, nodes, elements, np.zeros(m, np.int32), law)


def merge(domains: Sequence[Domain], *origins: Point, shell: float = 0.0) -> tuple[Domain, np.ndarray]:
    """One domain from several, numbered outwards from the nearest of the origins (m) in present positions; without origins the
    order of nodes and elements does not change. Bodies and laws have the order of the domains.

    shell (m): thickness of shells. If positive, the distance of a node is that of the inner face of its shell, and indices in a shell
    follow a space-filling curve: neighbours in space are neighbours in memory. Returns also the new index (n,) of each node.
    """
    nodes = np.cumsum([0, *(len(d.mesh.points) for d in domains)])
    elements = np.cumsum([0, *(len(d.mesh.conn) for d in domains)])
    facets = np.cumsum([0, *(len(d.mesh.facets) for d in domains)])
    bodies = np.cumsum([0, *(len(d.laws) for d in domains)])

    def put(arrays: list[np.ndarray], order: np.ndarray) -> np.ndarray:
        return rows_at(arrays[0] if len(arrays) == 1 else np.concatenate(arrays), order)

    def put_record(records: list[R], order: np.ndarray) -> R:
        joined = concatenate(records)
        return replace(joined, **{name: rows_at(array, order) for name, array in arrays_of(joined).items()})  # type: ignore[type-var]

    x = np.concatenate([d.nodes.x for d in domains])
    distance = np.min([np.linalg.norm(x - np.asarray(o), axis=1) for o in origins] or np.zeros((1, len(x))), axis=0)
    if shell > 0.0:
        distance = shell * np.floor(distance / shell)
        by_node = np.lexsort([morton(x), distance])
    else:
        by_node = np.argsort(distance, kind="stable")
    rank = new_indices(by_node, len(x))
    conn = np.concatenate([rank[d.mesh.conn + at] for d, at in zip(domains, nodes, strict=False)])
    reach = least_at_corners(distance[by_node], conn)
    by_element = np.argsort(least_at_corners(np.arange(len(x)), conn) if shell > 0.0 else reach, kind="stable")
    element_rank = new_indices(by_element, len(conn))
    facet_nodes = np.concatenate([rank[d.mesh.facets + at] for d, at in zip(domains, nodes, strict=False)])
    behind = np.concatenate([element_rank[d.mesh.facet_element + at] for d, at in zip(domains, elements, strict=False)])

    mesh = TetMesh(
        points=put([d.mesh.points for d in domains], by_node), conn=np.ascontiguousarray(conn[by_element], np.int32),
        B=put([d.mesh.B for d in domains], by_element), V0=put([d.mesh.V0 for d in domains], by_element),
        node_volume=put([d.mesh.node_volume for d in domains], by_node), facets=facet_nodes.astype(np.int32),
        facet_element=behind.astype(np.int32),
        sets={name: ids + at for d, at in zip(domains, facets, strict=False) for name, ids in d.mesh.sets.items()},
        reach_node=distance[by_node], reach_element=reach[by_element], axis=domains[0].mesh.axis,
    )  # fmt: skip
    node_state = put_record([d.nodes for d in domains], by_node)
    element_state = put_record([d.elements for d in domains], by_element)
    body = put([d.body + at for d, at in zip(domains, bodies, strict=False)], by_element).astype(np.int32)
    return Domain(mesh, node_state, element_state, body, np.concatenate([d.laws for d in domains])), rank


def new_indices(kept: np.ndarray, n: int) -> np.ndarray:
    """New index (n,) of each of n rows if only the rows `kept` remain, in their order; -1 for removed rows."""
    index = np.full(n, -1)
    index[kept] = np.arange(len(kept))
    return index


def domain_now(target: Target, body: np.ndarray) -> Domain:
    """The present state of a target as a domain, with the same arrays: use it before the next step. body (m,): of each element."""
    return Domain(target.mesh, target.nodes, target.elements, body, target.laws)


@dataclass(frozen=True)
class Selection:
    """A part of a domain, as a new domain. nodes, elements, facets, bodies: indices in the original domain, ascending. The new
    faces between it and the rest come after the facets, in the set "cut"."""

    domain: Domain
    nodes: np.ndarray
    elements: np.ndarray
    facets: np.ndarray
    bodies: np.ndarray


def select(domain: Domain, chosen: np.ndarray) -> Selection:
    """The part of a domain with the elements of the mask `chosen` (m,).

    Nodes keep their volumes, including shares of elements outside. Facet sets "splat1" and so on have the new indices of the bodies.
    """
    mesh, body = domain.mesh, domain.body
    elements, facets = np.flatnonzero(chosen), np.flatnonzero(chosen[mesh.facet_element])
    nodes, bodies = occurring(mesh.conn[elements], len(mesh.points)), occurring(body[elements], len(domain.laws))

    node, element = new_indices(nodes, len(mesh.points)), new_indices(elements, len(mesh.conn))
    facet, of_body = new_indices(facets, len(mesh.facets)), new_indices(bodies, len(domain.laws))
    names = {f"{SPLAT}{b}": of_body[b] for b in range(1, len(domain.laws))}
    kept = {name: facet[ids][facet[ids] >= 0] for name, ids in mesh.sets.items()}
    conn = node[mesh.conn[elements]]
    faces, behind = boundary_faces(conn)
    own = node[mesh.facets[facets]]
    key = np.sort(np.concatenate([own, faces]), axis=1) @ np.array([len(nodes) ** 2, len(nodes), 1])
    new = ~np.isin(key[len(own) :], key[: len(own)])
    if new.any():
        kept["cut"] = len(own) + np.arange(int(new.sum()))
    new_mesh = TetMesh(
        points=mesh.points[nodes], conn=conn.astype(np.int32), B=mesh.B[elements], V0=mesh.V0[elements],
        node_volume=mesh.node_volume[nodes], facets=np.concatenate([own, faces[new]]).astype(np.int32),
        facet_element=np.concatenate([element[mesh.facet_element[facets]], behind[new]]).astype(np.int32),
        sets={(f"{SPLAT}{names[n]}" if n in names else n): ids for n, ids in kept.items() if names.get(n, 0) >= 0},
        reach_node=mesh.reach_node[nodes], reach_element=mesh.reach_element[elements], axis=mesh.axis,
    )  # fmt: skip
    part = Domain(
        new_mesh, take(domain.nodes, nodes), take(domain.elements, elements), of_body[body[elements]].astype(np.int32),
        domain.laws[bodies],
    )  # fmt: skip
    return Selection(part, nodes, elements, facets, bodies)
