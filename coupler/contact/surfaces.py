"""Boundaries of several bodies in one domain, and the interface where one of them lies on the others."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from ..core.arrays import occurring
from ..core.records import Rows, take
from ..errors import SolverError
from ..geometry.triangles import area_vectors, vertex_areas, vertex_normals
from . import broad, closest
from .model import Candidates, faces_of


@dataclass(frozen=True)
class Surfaces:
    """The boundary triangles of bodies that share no nodes, in the order in which they came: body 0 is the base.

    facets (k,3) nodes, outward normals; body (k,): whose each facet is; element (k,): the one behind each facet.
    """

    facets: np.ndarray
    body: np.ndarray
    element: np.ndarray

    @classmethod
    def of(cls, facets: np.ndarray, facet_element: np.ndarray, body_of_element: np.ndarray) -> "Surfaces":
        """The surfaces of a joined mesh: its facets (k,3), facet_element (k,), and the body (m,) of each element."""
        body = np.asarray(body_of_element)[facet_element]
        return cls(np.ascontiguousarray(facets, np.int64), body.astype(np.int64), np.asarray(facet_element, np.int64))

    @cached_property
    def bodies(self) -> int:
        """Number of bodies."""
        return int(self.body.max()) + 1

    @cached_property
    def _by_body(self) -> tuple[np.ndarray, np.ndarray]:
        """Ids of all facets, body by body, and where each body begins."""
        return np.argsort(self.body, kind="stable"), np.cumsum([0, *np.bincount(self.body)])

    def facets_of(self, *bodies: int) -> np.ndarray:
        """Ids of the facets of these bodies, ascending."""
        order, start = self._by_body
        parts = [order[start[b] : start[b + 1]] for b in bodies if b < self.bodies]
        if len(parts) < 2:  # each is in order
            return parts[0] if parts else order[:0]
        return np.sort(np.concatenate(parts), kind="stable")

    def boxes(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (bodies,3) m of a box round each body; x (N,3) m."""
        order, start = self._by_body
        corners = x[self.facets[order]]
        return np.minimum.reduceat(corners.min(axis=1), start[:-1]), np.maximum.reduceat(
            corners.max(axis=1), start[:-1]
        )

    @cached_property
    def body_of_node(self) -> np.ndarray:
        """Body of each node (n,), up to the last node of a surface; -1 of inner nodes."""
        owner = np.full(self._nodes, -1)
        owner[self.facets] = self.body[:, None]
        return owner

    @cached_property
    def _nodes(self) -> int:
        return int(self.facets.max(initial=-1)) + 1

    def nodes_of(self, *bodies: int) -> np.ndarray:
        """Surface nodes of these bodies, ascending."""
        return self.corners_of(self.facets_of(*bodies))

    def corners_of(self, ids: np.ndarray) -> np.ndarray:
        """Nodes of facets, ascending."""
        return occurring(self.facets[ids], self._nodes)

    def spacing(self, x: np.ndarray, body: int) -> float:
        """Edge (m) of the equilateral triangles that would give a body's surface its number of facets."""
        area = float(np.mean(np.linalg.norm(area_vectors(x, self.facets[self.facets_of(body)]), axis=1)))
        return float(np.sqrt(4.0 / np.sqrt(3.0) * area))


@dataclass(frozen=True)
class Interface:
    """Pairs of surface nodes of one body and the facets of others that they lie on.

    nodes (n,); facet (n,): ids in `Surfaces`; weights (n,3): of the facet's closest point, within it; gap (n,) m: signed distance to
    it; area (n,) m2: what each node stands for, a third of each of its facets that lie on the others with all three nodes (0 for a
    node at the end of a line of contact, or alone). own (p,2): pairs of row and facet of its own body, for `behind`.
    """

    nodes: Annotated[np.ndarray, Rows(dtype=np.int64)]
    facet: Annotated[np.ndarray, Rows(dtype=np.int64)]
    weights: Annotated[np.ndarray, Rows(3)]
    gap: Annotated[np.ndarray, Rows()]
    area: Annotated[np.ndarray, Rows()]
    own: np.ndarray

    def only(self, which: np.ndarray) -> "Interface":
        """The rows of a boolean mask (n,); their areas do not change."""
        row = np.cumsum(which) - 1
        own = self.own[which[self.own[:, 0]]]
        return replace(take(self, which), own=np.stack([row[own[:, 0]], own[:, 1]], axis=1))

    def behind(self, surfaces: Surfaces, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A field (m,) of the elements on both sides: (mean behind each node's own facets (n,), behind its facet (n,))."""
        n = len(self.nodes)
        count = np.bincount(self.own[:, 0], minlength=n)
        own_side = np.bincount(self.own[:, 0], field[surfaces.element[self.own[:, 1]]], n) / np.maximum(count, 1)
        return own_side, field[surfaces.element[self.facet]]

    def fitted(self, x: np.ndarray, surfaces: Surfaces) -> np.ndarray:
        """Positions x (N,3) with the interface's nodes put on their facets: neither gap nor overlap."""
        moved = x.copy()
        moved[self.nodes] = np.einsum("ij,ijd->id", self.weights, x[surfaces.facets[self.facet]])
        return moved


def neighbours(low: np.ndarray, high: np.ndarray, body: int, reach: float) -> tuple[int, ...]:
    """Other bodies whose boxes low, high (bodies,3) m come within `reach` m of its own."""
    near = (low <= high[body] + reach).all(axis=1) & (high >= low[body] - reach).all(axis=1)
    near[body] = False
    return tuple(np.flatnonzero(near).tolist())


def earlier_neighbours(
    surfaces: Surfaces, x: np.ndarray, reach: float, among: np.ndarray | None = None
) -> list[tuple[int, ...]]:
    """For each body, the earlier bodies whose boxes come within `reach` m of its own: others cannot lie on it. x (N,3) m; among: mask
    (bodies,) of the bodies to consider, default all."""
    boxes, counts = surfaces.boxes(x), np.ones(surfaces.bodies, bool) if among is None else among
    return [
        tuple(b for b in neighbours(*boxes, body, reach) if b < body and counts[b]) if counts[body] else ()
        for body in range(surfaces.bodies)
    ]


def interface(
    surfaces: Surfaces, x: np.ndarray, body: int, tolerance: float, others: tuple[int, ...] | None = None
) -> Interface:
    """Nodes of `body` that lie within `tolerance` m of a facet of the others (default: the bodies before it).

    Only nodes that face their facet count, so that the far side of a thin lip does not. Raises SolverError where
    positions x (N,3) are no numbers.
    """
    others = tuple(range(body)) if others is None else others
    nodes, ids = surfaces.nodes_of(body), surfaces.facets_of(*others)
    if not np.isfinite(x).all():
        raise SolverError("positions of the bodies are not finite numbers: try a smaller time step or a finer preset")
    own_ids = surfaces.facets_of(body)
    corners = surfaces.facets[own_ids]
    rows, outward = np.searchsorted(nodes, corners), vertex_normals(x, corners)[nodes]
    face, weights, gap = _facing(x[nodes], outward, x, surfaces.facets, ids, tolerance, surfaces.spacing(x, body))
    on = (face >= 0) & (np.abs(gap) <= tolerance)

    flat = on[rows].all(axis=1)
    area = vertex_areas(x, corners[flat])[nodes]
    own = np.stack([rows[flat].ravel(), np.repeat(own_ids[flat], 3)], axis=1)
    return Interface(nodes, face, weights, gap, area, own).only(on)


def _facing(
    points: np.ndarray, outward: np.ndarray, x: np.ndarray, facets: np.ndarray, ids: np.ndarray, reach: float, cell: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """For each point, the closest facet within `reach` m, among those of `ids` that face the point.

    points (n,3) m, outward (n,3): normals at the points, x (N,3) m, facets (k,3), cell m: spacing of the search grid. Returns (facet
    (n,), -1 where there is none; weights (n,3) of its closest point; gap (n,) m, negative inside).
    """
    ids = broad.facets_within(x, facets, ids, *broad.bounds(points - reach, points + reach))
    faces = faces_of(facets[ids], np.ones(len(ids), np.int64))
    closest.box_faces(x, faces)
    every, own = np.full(len(points), reach), np.zeros(len(points), np.int64)
    start, near = broad.pairs_within(points, every, own, faces["low"], faces["high"], faces["body"], cell)
    point = np.repeat(np.arange(len(points)), np.diff(start))
    kept = np.einsum("ij,ij->i", area_vectors(x, faces["nodes"])[near], outward[point]) < 0.0
    face, weights, gap = np.full(len(points), -1), np.zeros((len(points), 3)), np.zeros(len(points))
    candidates = Candidates(np.concatenate([[0], np.cumsum(kept)])[start], near[kept])
    closest.closest(points, candidates, faces, x, face, weights, gap)
    return np.append(ids, -1)[face], weights, gap
