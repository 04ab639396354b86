"""A part of the mesh taken out and another put in its place: which part can be, and the seam.

The elements of a patch form one solid whose boundary is one closed surface without pinched edges or corners. Some of its triangles
are free surface of the body; the others, the cut, are faces that elements outside have too. A new mesh of the patch has
the same cut, triangle by triangle.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import SolverError
from ..geometry.graph import connected_parts
from ..geometry.tetrahedra import FACES, boundary_faces
from ..geometry.triangles import edges
from ..physics.constitutive import pressures, von_mises, yield_stresses
from ..state.records import concatenate, take
from .assemble import Domain
from .heat import take_heat
from .kernels import elastic_shear_energy
from .mesh import TetMesh
from .state import ElementState, NodeState

ROUNDS = 12  # at most, to make a patch's boundary sound


@dataclass(frozen=True)
class Patch:
    """elements (p,) of the mesh, ascending; nodes (k,) of its boundary, those of the cut first; cut: how many those are.

    triangles (f,3): boundary, outwards, by position in `nodes`, those of the cut first; free: how many are not of the cut;
    inner (i,): nodes that no element outside the patch has; name: the facet set that its free surface belongs to.
    """

    elements: np.ndarray
    nodes: np.ndarray
    cut: int
    triangles: np.ndarray
    free: int
    inner: np.ndarray
    name: str


def _key(faces: np.ndarray, many: int) -> np.ndarray:
    a, b, c = np.sort(faces, axis=1).astype(np.int64).T
    return (a * many + b) * many + c


def pinched(triangles: np.ndarray) -> np.ndarray:
    """Nodes of a surface (k,3) where it is not one disc: of edges that more than two triangles have, and of corners alone."""
    n, f = int(triangles.max()) + 1, len(triangles)
    low, high = np.sort(edges(triangles), axis=1).T
    key = low * n + high
    order = np.argsort(key, kind="stable")
    values, count = np.unique(key, return_counts=True)
    wrong = values[count != 2]
    bad = np.concatenate([wrong // n, wrong % n])
    # the corners of two triangles at a common edge belong to one fan: in a sound surface each node has one
    flat, corner = triangles.ravel(), np.arange(3 * f).reshape(f, 3)
    first, last = corner.T.ravel(), corner[:, [1, 2, 0]].T.ravel()
    a, b = order[np.repeat(count == 2, count)].reshape(-1, 2).T
    same = flat[first[a]] == flat[first[b]]
    one = np.stack([first[a], np.where(same, first[b], last[b])], axis=1)
    other = np.stack([last[a], np.where(same, last[b], first[b])], axis=1)
    fans, which = connected_parts(np.concatenate([one, other]), 3 * f)
    owner = np.zeros(fans, np.int64)  # a node that is in no triangle has no fan
    owner[which] = flat
    twice = np.flatnonzero(np.bincount(owner, minlength=n) > 1)
    return np.unique(np.concatenate([bad, twice])).astype(np.int64)


def patch_of(mesh: TetMesh, wanted: np.ndarray, allowed: np.ndarray, seed: int) -> Patch | None:
    """The part of the elements wanted (m,) bool that hangs together with the element `seed`, made sound with elements allowed
    (m,) bool.

    None where nothing sound is left, or where its free surface belongs to more than one facet set.
    """
    chosen = wanted & allowed
    conn = mesh.conn
    for turn in range(ROUNDS):
        if not chosen[seed]:
            return None
        chosen = _part(conn, chosen, seed)
        bad = pinched(boundary_faces(conn[chosen])[0])
        if len(bad) == 0:
            break
        touching = np.isin(conn, bad).any(axis=1)
        grown = chosen | (touching & allowed)
        chosen = grown if turn < ROUNDS // 2 and grown.sum() > chosen.sum() else chosen & ~touching
    else:
        return None
    faces = boundary_faces(conn[chosen])[0]
    many = len(mesh.points)
    free = np.isin(_key(faces, many), _key(mesh.facets, many))
    faces = np.concatenate([faces[~free], faces[free]])
    count = int((~free).sum())
    cut = np.unique(faces[:count])
    others = np.setdiff1d(np.unique(faces[count:]), cut)
    nodes = np.concatenate([cut, others])
    place = np.zeros(many, np.int64)
    place[nodes] = np.arange(len(nodes))
    outside = np.zeros(many, bool)
    outside[conn[~chosen]] = True
    inner = np.unique(conn[chosen])
    own = np.isin(_key(mesh.facets, many), _key(faces[count:], many))
    names = [name for name, ids in mesh.sets.items() if own[ids].any()]
    if len(names) != 1 or len(faces) == count:
        return None
    return Patch(
        np.flatnonzero(chosen), nodes, len(cut), place[faces], len(faces) - count, inner[~outside[inner]], names[0]
    )


def _part(conn: np.ndarray, chosen: np.ndarray, seed: int) -> np.ndarray:
    """Those of the chosen elements (m,) bool that hang together with one of them, `seed`, by faces."""
    ids = np.flatnonzero(chosen)
    faces = np.concatenate([conn[ids][:, face] for face in FACES])
    key = _key(faces, int(conn.max()) + 1)
    element = np.tile(np.arange(len(ids)), 4)
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order][1:] == key[order][:-1])
    _, part = connected_parts(np.stack([element[order[twin]], element[order[twin + 1]]], axis=1), len(ids))
    connected = np.zeros(len(conn), bool)
    connected[ids[part == part[np.searchsorted(ids, seed)]]] = True
    return connected


@dataclass(frozen=True)
class Renewal:
    """What comes in a patch's place. points (n,3) m: those of the cut as they are, then new ones; tets (t,4).

    V0 (t,) m3: reference volumes. nodes, elements: state of the new nodes and of all new elements; x, volume, sigma_y and what follows
    from the rest are put in by `renewed`.
    """

    points: np.ndarray
    tets: np.ndarray
    V0: np.ndarray
    nodes: NodeState
    elements: ElementState


def renewed(domain: Domain, patch: Patch, new: Renewal) -> tuple[Domain, np.ndarray, np.ndarray, np.ndarray]:
    """The domain with a patch replaced; the new number of each node (n,) and facet (k,) of before, -1 where it is gone; and
    (2,) J: the elastic energy that the new stresses lack, which has become heat in the patch, and what of it makes pressure.

    What is outside keeps its numbers in order; the new comes after it: `merge` numbers it all outwards. Volumes of the nodes
    of the cut are counted again, all else of theirs stays. Raises SolverError where the new mesh has not the same cut.
    """
    mesh, n = domain.mesh, len(domain.mesh.points)
    gone = np.zeros(n, bool)
    gone[patch.inner] = True
    node = np.where(gone, -1, np.cumsum(~gone) - 1)
    kept_nodes, added = int((~gone).sum()), len(new.points) - patch.cut
    out = np.ones(len(mesh.conn), bool)
    out[patch.elements] = False
    number = np.concatenate([node[patch.nodes[: patch.cut]], kept_nodes + np.arange(added)])
    tets = number[new.tets]
    conn = np.concatenate([node[mesh.conn[out]], tets])

    faces = boundary_faces(conn)[0]
    many = kept_nodes + added
    old = ~np.isin(_key(mesh.facets, n), _key(patch.nodes[patch.triangles[-patch.free :]], n))
    stay = node[mesh.facets[old]]
    fresh = faces[~np.isin(_key(faces, many), _key(stay, many))]
    behind = np.isin(fresh, number).all(axis=1)
    if len(stay) + len(fresh) != len(faces) or not behind.all():
        raise SolverError("a remeshed patch does not meet the mesh round it: the target is kept as it was")
    facet = np.where(old, np.cumsum(old) - 1, -1)
    sets = {name: facet[ids][facet[ids] >= 0] for name, ids in mesh.sets.items()}
    sets[patch.name] = np.concatenate([sets[patch.name], len(stay) + np.arange(len(fresh))])
    facets = np.concatenate([stay, fresh]).astype(np.int32)

    def put(values: np.ndarray, more: np.ndarray, which: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.concatenate([values[which], more]))

    V0 = put(mesh.V0, new.V0, out)
    B, V = _gradients(new.points[new.tets], new.V0)
    law = domain.laws[domain.body[patch.elements[:1]]]
    sigma_y = yield_stresses(law, new.elements.eps_p, new.elements.T)
    s = new.elements.s
    s = s * np.minimum(1.0, sigma_y / np.maximum(von_mises(s), 1.0))[:, None]  # a mean of states may lie beyond yield
    fresh_elements, lost, warmth = _made_up(
        domain, patch, replace(new.elements, s=s, sigma_y=sigma_y, volume=V), new.V0
    )
    nodes = concatenate([take(domain.nodes, ~gone), replace(new.nodes, x=new.points[patch.cut :])])
    elements = concatenate([take(domain.elements, out), fresh_elements])
    share = np.bincount(conn.ravel(), np.repeat(0.25 * V0, 4), many)
    renewed_mesh = TetMesh(
        points=put(mesh.points, new.points[patch.cut :], ~gone), conn=conn.astype(np.int32), B=put(mesh.B, B, out), V0=V0,
        node_volume=share, facets=facets, facet_element=_behind(conn, facets), sets=sets, reach_node=np.zeros(many),
        reach_element=np.zeros(len(conn)),
    )  # fmt: skip
    body = np.concatenate([domain.body[out], np.full(len(tets), domain.body[patch.elements[0]])]).astype(np.int32)
    touched = np.unique(tets)
    now = np.bincount(conn.ravel(), np.repeat(0.25 * elements.volume, 4), many)
    nodes.J[touched] = (now / share)[touched]
    nodes.p[touched] = pressures(law, nodes.J[touched], nodes.energy[touched])
    domain = replace(domain, mesh=renewed_mesh, nodes=nodes, elements=elements, body=body)
    return domain, node, facet, np.array([lost, warmth])


def _made_up(domain: Domain, patch: Patch, new: ElementState, V0: np.ndarray) -> tuple[ElementState, float, float]:
    """The new elements of a patch with the elastic energy of shear that it has lost, as heat; that energy, and what of it makes
    pressure, J."""
    old, laws = patch.elements, domain.laws
    of_old = np.full(len(old), domain.body[old[0]], np.int32)
    of_new = np.full(len(V0), domain.body[old[0]], np.int32)
    before = elastic_shear_energy(
        0, len(old), domain.elements.volume[old], domain.mesh.V0[old], laws, of_old, domain.elements.s[old]
    )
    lost = float(before - elastic_shear_energy(0, len(V0), new.volume, V0, laws, of_new, new.s))
    T, heat, sigma_y = new.T.copy(), new.heat.copy(), new.sigma_y.copy()
    warmth = take_heat(0, len(V0), lost * V0 / V0.sum(), V0, laws, of_new, T, heat, sigma_y, new.eps_p)
    return replace(new, T=T, heat=heat, sigma_y=sigma_y), lost, float(warmth)


def _gradients(corner: np.ndarray, V0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reference gradients (t,3,3) of nodes 1 to 3 and volumes now (t,) of tetrahedra (t,4,3) m whose reference shape is their
    present one, shrunk or swollen to V0 m3. Raises SolverError for an inverted one."""
    edge = corner[:, 1:] - corner[:, :1]
    V = np.linalg.det(edge) / 6.0
    if not V.min() > 0.0:
        raise SolverError("a remeshed patch has an inverted tetrahedron: the target is kept as it was")
    return np.swapaxes(np.linalg.inv(edge), 1, 2) * ((V / V0) ** (1.0 / 3.0))[:, None, None], V


def _behind(conn: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """The element behind each facet (k,3)."""
    many = int(conn.max()) + 1
    faces = np.concatenate([conn[:, face] for face in FACES])
    key = _key(faces, many)
    order = np.argsort(key, kind="stable")
    position = order[np.searchsorted(key, _key(facets, many), sorter=order)]
    return (position % len(conn)).astype(np.int32)
