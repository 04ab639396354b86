"""Another mesh inside the base of a domain: its surface stays as it is, state is carried over.

Elements of the new mesh take the mean over the mass of the old ones whose middles lie in them, those with fewer than FEW that over
the old ones that hold four places in them; then all temperatures are shifted alike, so that their mean over the mass stays. Volume
ratios and energies of the nodes inside are interpolated. As where a body joins (`assemble`), reference volumes are V / J, all together
those of before, and the reference shape of a tetrahedron is its present one, shrunk by J^(1/3).
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..errors import SplatError
from ..geometry.locate import containing
from ..geometry.tetrahedra import boundary_faces, gradients, lumped, oriented, volumes
from ..physics.constitutive import pressures, yield_stresses
from ..state.arrays import occurring
from ..state.records import concatenate, new_rows, take
from .assemble import Domain
from .state import ElementState, NodeState

MATCH = 1e-6  # of an edge: so far from its node may a point of the kept surface be
FEW = 4  # old elements: fewer are no mean
ROUNDS = 30  # in which reference volumes of elements come to give the volume ratios of the nodes
# barycentric coordinates of the four places that integrate a quadratic exactly
PLACES = np.full((4, 4), 0.1381966) + 0.4472136 * np.eye(4)
OTHER_SURFACE = "the mesh has another surface than the body that it is to fill"
_MEANS = ("s", "eps_p", "T", "thermal_stress", "eps_gradient")


def base_surface(domain: Domain) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (k,) of the surface of the first body, and its triangles (f,3) on them."""
    facets = domain.mesh.facets[domain.body[domain.mesh.facet_element] == 0]
    nodes = occurring(facets, len(domain.mesh.points))
    return nodes, np.searchsorted(nodes, facets)


def with_base(domain: Domain, points: np.ndarray, tets: np.ndarray) -> tuple[Domain, np.ndarray]:
    """A domain, its first body at rest, with the mesh points (k,3) m, tets (j,4) in that body: inside the same surface, where it lies.

    Returns it, its numbers in no order, and the number in it of each node (n,) of before, -1 where it is gone. Raises SplatError where
    the mesh has another surface.
    """
    mesh, x, old = domain.mesh, domain.nodes.x, domain.body == 0
    base, tets = mesh.conn[old], oriented(points, tets)
    surface, _ = base_surface(domain)
    kept = np.union1d(surface, occurring(mesh.conn[~old], len(x)))
    number = np.full(len(x), -1)
    number[kept] = np.arange(len(kept))
    at = _matched(points, x[surface], MATCH * float(np.cbrt(mesh.V0[old].min())))
    inside = np.ones(len(points), bool)
    inside[at] = False
    more = int(inside.sum())
    own = np.zeros(len(points), np.int64)
    own[at], own[inside] = number[surface], len(kept) + np.arange(more)

    within, weights = containing(x, base, points[inside])
    between = {
        name: np.einsum("kc,kc->k", weights, getattr(domain.nodes, name)[base[within]]) for name in ("J", "energy")
    }
    nodes = concatenate([take(domain.nodes, kept), new_rows(NodeState, more, x=points[inside], **between)])
    conn, V = own[tets], volumes(points, tets)
    V0, share, now = _reference_volumes(conn, V, nodes.J, mesh.V0[old].sum())
    is_base, node_volume = now > 0.0, np.concatenate([mesh.node_volume[kept], np.zeros(more)])
    node_volume[is_base] = share[is_base]
    nodes.J[is_base] = now[is_base] / share[is_base]
    nodes.p[is_base] = pressures(domain.laws[:1], nodes.J[is_base], nodes.energy[is_base])

    elements = _carried_over(domain, base, points, tets, V0)
    facet_element = np.empty(len(mesh.facets), np.int64)
    of_base = old[mesh.facet_element]
    facet_element[of_base] = _behind(number[mesh.facets[of_base]], conn)
    facet_element[~of_base] = len(conn) + (np.cumsum(~old) - 1)[mesh.facet_element[~of_base]]
    B = gradients(points, tets) * ((V / V0) ** (1.0 / 3.0))[:, None, None]
    new = replace(
        mesh, points=np.concatenate([mesh.points[kept], points[inside]]),
        conn=np.concatenate([conn, number[mesh.conn[~old]]]).astype(np.int32), B=np.concatenate([B, mesh.B[~old]]),
        V0=np.concatenate([V0, mesh.V0[~old]]), node_volume=node_volume, facets=number[mesh.facets].astype(np.int32),
        facet_element=facet_element.astype(np.int32), reach_node=np.zeros(len(node_volume)),
        reach_element=np.zeros(len(conn) + int((~old).sum())),
    )  # fmt: skip
    body = np.concatenate([np.zeros(len(conn), np.int32), domain.body[~old]])
    return Domain(new, nodes, concatenate([elements, take(domain.elements, ~old)]), body, domain.laws), number


def _matched(points: np.ndarray, kept: np.ndarray, tolerance: float) -> np.ndarray:
    """Which of the points each of the places `kept` (k,3) is, within tolerance, m. Raises SplatError where one is none of its own."""
    away, at = cKDTree(points).query(kept)
    if away.max() > tolerance or len(np.unique(at)) < len(at):
        raise SplatError(OTHER_SURFACE)
    return at


def _reference_volumes(
    conn: np.ndarray, V: np.ndarray, wanted: np.ndarray, total: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reference volumes (j,) m3, `total` together, of elements of V (j,) m3 now, by which the volume ratios of the nodes are those
    wanted (n,) as nearly as can be; what of them and of V each node has (n,) m3."""
    now, J = lumped(conn, V, len(wanted)), wanted.copy()
    own = now > 0.0
    for _ in range(ROUNDS):
        V0 = V / J[conn].mean(axis=1)
        V0 *= total / V0.sum()
        share = lumped(conn, V0, len(J))
        J[own] *= wanted[own] / (now[own] / share[own])
    return V0, share, now


def _carried_over(
    domain: Domain, base: np.ndarray, points: np.ndarray, tets: np.ndarray, V0: np.ndarray
) -> ElementState:
    """State of the elements tets (j,4) on points (k,3) m, reference volumes V0 (j,) m3, from those of the first body of a domain,
    base (m,4)."""
    x, old, m = domain.nodes.x, domain.body == 0, len(tets)
    state, mass = take(domain.elements, old), domain.mesh.V0[old]
    into, _ = containing(points, tets, x[base].mean(axis=1))
    few = np.flatnonzero(np.bincount(into, minlength=m) < FEW)
    places = np.einsum("pc,ecd->epd", PLACES, points[tets[few]])
    source = containing(x, base, places.reshape(-1, 3))[0].reshape(-1, len(PLACES))
    total, values = np.maximum(np.bincount(into, mass, m), mass.min())[:, None], dict[str, np.ndarray]()
    for name in _MEANS:
        rows = getattr(state, name).reshape(len(mass), -1)
        mean = np.stack([np.bincount(into, mass * column, m) for column in rows.T], axis=1) / total
        mean[few] = rows[source].mean(axis=1)
        values[name] = mean.reshape(m, *getattr(state, name).shape[1:])
    values["T"] += (mass @ state.T - V0 @ values["T"]) / V0.sum()  # with a constant c_p heat is neither lost nor won
    sigma_y = yield_stresses(
        domain.laws[:1], np.zeros(m, np.int32), values["eps_p"], values["T"], values["eps_gradient"]
    )
    return new_rows(
        ElementState, m, **values, sigma_y=sigma_y, volume=volumes(points, tets), heat=np.bincount(into, state.heat, m)
    )


def _behind(facets: np.ndarray, conn: np.ndarray) -> np.ndarray:
    """The element (f,) of conn (j,4) behind each of the facets (f,3), which are its boundary. Raises SplatError where they are not."""
    faces, behind = boundary_faces(conn)
    n = int(conn.max()) + 1
    key, own = (np.sort(each, axis=1) @ np.array([n * n, n, 1]) for each in (faces, facets))
    order = np.argsort(key)
    at = order[np.minimum(np.searchsorted(key[order], own), len(key) - 1)]
    if len(key) != len(own) or np.any(key[at] != own):
        raise SplatError(OTHER_SURFACE)
    return behind[at]
