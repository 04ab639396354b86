"""A rectangular block of a coating: its tetrahedra, and the places where the bodies in it are bonded or touch each other."""

from dataclasses import dataclass
from itertools import combinations
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from ..contact.surfaces import Surfaces, earlier_neighbours, interface
from ..core.records import Rows, concatenate, new_rows, take
from ..geometry.tetrahedra import boundary_faces, volumes
from ..geometry.triangles import area_vectors, compact

EDGES = np.array(list(combinations(range(4), 2)))
SNAP = 0.02  # element sizes: nodes closer than this to a face of the block are moved onto the face, so that no sliver is left
SLIVER = 1e-9  # element sizes cubed: elements with a smaller volume, made flat by this motion, are left out


@dataclass(frozen=True)
class Joints:
    """Pairs of a node of one body and a facet of another body opposite to it. nodes (n,); triangles (n,3), weights (n,3): facet and
    barycentric coordinates of the opposite point; normal (n,3): outward normal of the facet; gap (n,) m; area (n,) m2; bonded (n,):
    True if both sides have the same displacement, False if they only touch; law (n,k): further values of the node's bond."""

    nodes: Annotated[NDArray, Rows(dtype=int)]
    triangles: Annotated[NDArray, Rows(3, dtype=int)]
    weights: Annotated[NDArray, Rows(3)]
    normal: Annotated[NDArray, Rows(3)]
    gap: Annotated[NDArray, Rows()]
    area: Annotated[NDArray, Rows()]
    bonded: Annotated[NDArray, Rows(dtype=bool)]
    law: Annotated[NDArray, Rows(-1)]


@dataclass(frozen=True)
class Block:
    """A block of a coating. points (n,3) m; tets (m,4); body (m,): body of each tetrahedron (bodies share no nodes); parent (m,): the
    tetrahedron of the coating of which it is a part; low, high (3,) m: corners of the block; walls: facets (k,3) on the faces of the
    block, normals outwards; joints: joints between the bodies."""

    points: NDArray
    tets: NDArray
    body: NDArray
    parent: NDArray
    low: NDArray
    high: NDArray
    walls: NDArray
    joints: Joints

    @property
    def volume(self) -> float:
        """Volume of the block including its pores, m3."""
        return float(np.prod(self.high - self.low))

    @property
    def solid(self) -> float:
        """Fraction of the block's volume that is metal."""
        return float(volumes(self.points, self.tets).sum()) / self.volume


def extract_block(
    points: NDArray, tets: NDArray, body: NDArray, at_nodes: NDArray, low: NDArray, high: NDArray, size: float
) -> Block:
    """The block between the corners low and high (3,) m of a mesh with several bodies.

    body (m,): body of each tetrahedron; at_nodes (n,2+k): 1 in the first column for a bonded node, 1 in the second for a node that
    touches another body without a bond, else 0; then k further values of bonds, 0 for other nodes; size (m): element size. Nodes
    closer than 0.6 element sizes to another body (as when a splat joins the target) belong to a joint.
    """
    parent = np.arange(len(tets))
    for axis in range(3):
        for wall, sign in ((low[axis], -1.0), (high[axis], 1.0)):
            off = sign * (points[:, axis] - wall)
            near = np.abs(off) < SNAP * size
            points, off = points.copy(), np.where(near, 0.0, off)
            points[near, axis] = wall
            points, tets, parent, at_nodes = clip(points, tets, parent, at_nodes, off, SLIVER * size**3)
    body = body[parent]
    faces, behind = boundary_faces(tets)
    ends = np.stack([low, high])  # all corners of a facet on a face share a coordinate of low or high
    on_wall = (abs(points[faces][:, :, None] - ends) < 1e-9 * (high - low).max()).all(axis=1).any(axis=(1, 2))
    inner, behind = faces[~on_wall], behind[~on_wall]
    index = np.unique(body[behind], return_inverse=True)[1]  # of the bodies with a surface inside the block
    joints = _joints(Surfaces(inner, index, behind), points, at_nodes, 0.6 * size)
    return Block(points, tets, body, parent, low, high, faces[on_wall], joints)


def clip(
    points: NDArray, tets: NDArray, parent: NDArray, values: NDArray, off: NDArray, least: float
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Part of a mesh where a linear field, `off` (n,) at the nodes, is negative: its points, tets, parent (m,) and values (n,k).

    Nodal values are interpolated at new nodes. Parts of a tetrahedron have its parent. Parts with a volume below `least` are left out.
    Each edge that crosses the plane gets a new node. A tetrahedron is divided at the first of its crossing edges, in the order of
    their indices, until no edge crosses. Neighbours divide their common face in the same order, so that the mesh stays conforming.
    """
    ends = np.sort(tets[:, EDGES], axis=-1).reshape(-1, 2)
    crossing = ends[off[ends].prod(axis=1) < 0.0]
    n = len(points)
    keys = np.unique(crossing[:, 0] * n + crossing[:, 1])
    a, b = np.divmod(keys, n)
    share = (off[a] / (off[a] - off[b]))[:, None]
    points = np.concatenate([points, points[a] + share * (points[b] - points[a])])
    values = np.concatenate([values, values[a] + share * (values[b] - values[a])])
    off = np.concatenate([off, np.zeros(len(keys))])
    while True:
        ends = np.sort(tets[:, EDGES], axis=-1)
        key = np.where(off[ends].prod(axis=2) < 0.0, ends[..., 0] * n + ends[..., 1], np.iinfo(np.int64).max)
        first = key.argmin(axis=1)
        halved = np.flatnonzero(key.min(axis=1) < np.iinfo(np.int64).max)
        if len(halved) == 0:
            break
        middle = n + np.searchsorted(keys, key[halved, first[halved]])
        other = tets[halved]
        tets, parent = np.concatenate([tets, other]), np.concatenate([parent, parent[halved]])
        tets[halved, EDGES[first[halved], 0]] = middle
        tets[np.arange(len(tets) - len(other), len(tets)), EDGES[first[halved], 1]] = middle
    kept = (off[tets] <= 0.0).all(axis=1) & (off[tets] < 0.0).any(axis=1) & (volumes(points, tets) > least)
    used = np.zeros(len(points), bool)
    used[tets[kept]] = True
    points, tets = compact(points, tets[kept])
    return points, tets, parent[kept], values[used]


def _joints(surfaces: Surfaces, points: NDArray, at_nodes: NDArray, reach: float) -> Joints:
    """Joints between each body and earlier bodies. A bonded node belongs to the later body; a touching node to either of the two."""
    found = [new_rows(Joints, 0, law=at_nodes[:0, 2:])]
    near = earlier_neighbours(surfaces, points, reach) if len(surfaces.facets) else []
    for later in (number for number, earlier in enumerate(near) if earlier):
        pairs = interface(surfaces, points, later, reach, near[later])
        triangles = surfaces.facets[pairs.facet]
        bonded = at_nodes[pairs.nodes, 0] > 0.5
        touches = np.maximum(at_nodes[pairs.nodes, 1], at_nodes[triangles, 1].max(axis=1)) > 0.5
        normal = area_vectors(points, triangles)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        kept = (pairs.area > 0.0) & (bonded | touches)
        # at a node on a face of the block the mark `bonded` is interpolated, so that the values are divided by it
        law = at_nodes[pairs.nodes, 2:] / np.maximum(at_nodes[pairs.nodes, :1], 0.5)
        joints = Joints(pairs.nodes, triangles, pairs.weights, normal, pairs.gap, pairs.area, bonded, law)
        found.append(take(joints, kept))
    return concatenate(found)
