"""The last search of each body's points, and whether it is still valid (numba)."""

from collections.abc import Sequence
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from ..compiling import uncounted
from ..core.arrays import Bools, Faces, Floats, Ints, occurring
from ..core.loops import ranges
from .model import Points

LEAST_BODIES = 2  # in a range of a loop that threads share
WIDE = 2.0  # a search that reaches this many times as far as a new one has too many candidates: it is renewed


class Searches(NamedTuple):
    """Data of the last search of the points of each body. Body b has the points bounds[b] to bounds[b + 1] - 1.

    reach (bodies,) m, active (bodies,): the search of body b is valid while its points and the faces near them have moved less than
    reach[b] relative to each other, and only the first active[b] nodes, or fewer, move. x (n,3) m: positions of the points at the
    search. facing[first_face[b]:first_face[b + 1]]: faces that the points of body b can ever touch; known: mask of those that were
    near. nodes[first_node[b]:first_node[b + 1]]: nodes of these near faces; node_x (m): their positions at the search.
    """

    bounds: Ints
    reach: Floats
    active: Floats
    x: Floats
    facing: Ints
    first_face: Ints
    known: Bools
    nodes: Ints
    first_node: Ints
    node_x: Floats

    @classmethod
    def none_yet(cls, bounds: Ints, facing: Sequence[Ints]) -> "Searches":
        """Searches of bodies of which none has been searched."""
        bodies, faces = len(bounds) - 1, np.concatenate([np.zeros(0, np.int64), *facing])
        first_face = np.cumsum([0, *map(len, facing)])
        first_node, nodes = np.zeros(bodies + 1, np.int64), np.zeros(0, np.int64)
        return cls(
            bounds, np.full(bodies, -inf), np.full(bodies, inf), np.zeros((bounds[-1], 3)), faces, first_face,
            np.zeros(len(faces), bool), nodes, first_node, np.zeros((0, 3)),
        )  # fmt: skip

    def faces_near(self, body: int) -> Ints:
        """The faces that were near the points of a body."""
        here = slice(self.first_face[body], self.first_face[body + 1])
        return self.facing[here][self.known[here]]

    def nodes_near(self, body: int) -> Ints:
        """The nodes of the faces `faces_near` of a body."""
        return self.nodes[self.first_node[body] : self.first_node[body + 1]]

    def begun(self, near: dict[int, Ints], faces: Faces, points: Floats, x: Floats) -> "Searches":
        """The data after new searches of some bodies have started, at the positions points (n,3), x (N,3) m. near: for each of these
        bodies, the faces near its points. Sets `reach` of these bodies to -inf. Only nodes, first_node and node_x are new arrays."""
        is_near, nodes, node_x = np.zeros(len(faces), bool), list[Ints](), list[Floats]()
        for body in range(len(self.reach)):
            if body in near:
                here = slice(self.first_face[body], self.first_face[body + 1])
                is_near[:] = False
                is_near[near[body]] = True
                self.known[here] = is_near[self.facing[here]]
                nodes.append(occurring(faces["nodes"][near[body]], len(x)))
                node_x.append(x[nodes[-1]])
                own = slice(self.bounds[body], self.bounds[body + 1])
                self.x[own], self.active[body], self.reach[body] = points[own], inf, -inf
            else:
                nodes.append(self.nodes_near(body))
                node_x.append(self.node_x[self.first_node[body] : self.first_node[body + 1]])
        first_node = np.cumsum([0, *map(len, nodes)])
        return self._replace(nodes=np.concatenate(nodes), first_node=first_node, node_x=np.concatenate(node_x))


@uncounted
def own_travel(body: int, travel: float, part: Floats, points: Points, s: Searches) -> float:
    """Upper bound (m) on the displacement of a body relative to the faces near it. travel: this bound for any two surfaces, m;
    part (N,): speed of each node divided by that of the fastest node."""
    own = near = 0.0
    for i in range(s.bounds[body], s.bounds[body + 1]):
        own = max(own, part[points.node[i]])
    for q in range(s.first_node[body], s.first_node[body + 1]):
        near = max(near, part[s.nodes[q]])
    return travel * min(1.0, own + near)


@uncounted
def _is_valid(
    body: int,
    travel: float,
    part: Floats,
    active: int,
    spacing: float,
    skin: float,
    x: Floats,
    points: Points,
    faces: Faces,
    s: Searches,
) -> bool:
    """Whether the last search of a body stays valid while surfaces move by `travel` m, so that no other face comes near. False also if
    it reaches more than WIDE times as far as a new one. Arguments as in `valid_searches`; spacing: of this body."""
    own = own_travel(body, travel, part, points, s)
    if active > s.active[body] or s.reach[body] <= own or s.reach[body] > WIDE * (own + skin * spacing):
        return False
    moved = moved_node = 0.0  # squares, m2
    l0 = l1 = l2 = inf
    h0 = h1 = h2 = -inf
    for i in range(s.bounds[body], s.bounds[body + 1]):
        a, b, c = points.x[i, 0], points.x[i, 1], points.x[i, 2]
        moved = max(moved, (a - s.x[i, 0]) ** 2 + (b - s.x[i, 1]) ** 2 + (c - s.x[i, 2]) ** 2)
        l0, l1, l2, h0, h1, h2 = min(l0, a), min(l1, b), min(l2, c), max(h0, a), max(h1, b), max(h2, c)
    for q in range(s.first_node[body], s.first_node[body + 1]):
        a, b, c = x[s.nodes[q], 0], x[s.nodes[q], 1], x[s.nodes[q], 2]
        distance2 = (a - s.node_x[q, 0]) ** 2 + (b - s.node_x[q, 1]) ** 2 + (c - s.node_x[q, 2]) ** 2
        moved_node = max(moved_node, distance2)
    if own + sqrt(moved) + sqrt(moved_node) > s.reach[body]:
        return False
    far = 0.5 * spacing + travel
    for q in range(s.first_face[body], s.first_face[body + 1]):
        if s.known[q]:
            continue
        low, high = faces[s.facing[q]].low, faces[s.facing[q]].high
        if (
            low[0] <= h0 + far and high[0] >= l0 - far
            and low[1] <= h1 + far and high[1] >= l1 - far
            and low[2] <= h2 + far and high[2] >= l2 - far
        ):  # fmt: skip
            return False
    return True


@uncounted
def valid_searches(
    team: Ints, travel: float, part: Floats, active: int, spacing: Floats, skin: float, x: Floats, points: Points, faces: Faces, s:
    Searches, valid: Bools,
) -> None:  # fmt: skip
    """Write to valid (bodies,) whether the last search of each body stays valid while surfaces move by `travel` m, in all threads.

    part: as in `own_travel`; active: number of nodes that move, the first ones; spacing (bodies,) m; skin: a search covers this many
    spacings more than the displacement in its first chunk of steps; x (N,3) m: nodes.
    """
    for lo, hi, _ in ranges(team, 0, len(valid), LEAST_BODIES):
        for body in range(lo, hi):
            valid[body] = _is_valid(body, travel, part, active, spacing[body], skin, x, points, faces, s)
