"""Surfaces of several bodies in one domain, and the interface of one body with the others."""

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
    """Boundary triangles of bodies that share no nodes; body 0 is the substrate.

    facets (k,3): nodes, normal outwards; body (k,): body of each facet; element (k,): element behind each facet.
    """

    facets: np.ndarray
    body: np.ndarray
    element: np.ndarray

    @classmethod
    def of(cls, facets: np.ndarray, facet_element: np.ndarray, body_of_element: np.ndarray) -> "Surfaces":
        """The surfaces of a mesh. facets (k,3): nodes of the facets; facet_element (k,): element behind each facet; body_of_element
        (m,): body of each element."""
        body = np.asarray(body_of_element)[facet_element]
        return cls(np.ascontiguousarray(facets, np.int64), body.astype(np.int64), np.asarray(facet_element, np.int64))

    @cached_property
    def bodies(self) -> int:
        """Number of bodies."""
        return int(self.body.max()) + 1

    @cached_property
    def _by_body(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns order and start: order[start[b]:start[b + 1]] are the indices of the facets of body b, ascending."""
        return np.argsort(self.body, kind="stable"), np.cumsum([0, *np.bincount(self.body)])

    def facets_of(self, *bodies: int) -> np.ndarray:
        """Indices of the facets of these bodies, ascending."""
        order, start = self._by_body
        parts = [order[start[b] : start[b + 1]] for b in bodies if b < self.bodies]
        if len(parts) < 2:  # each part is ascending
            return parts[0] if parts else order[:0]
        return np.sort(np.concatenate(parts), kind="stable")

    def boxes(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounding box of each body: lowest and highest corner (bodies,3) m. x (N,3) m."""
        order, start = self._by_body
        corners, first = x[self.facets[order]], start[:-1]
        return np.minimum.reduceat(corners.min(axis=1), first), np.maximum.reduceat(corners.max(axis=1), first)

    @cached_property
    def body_of_node(self) -> np.ndarray:
        """Body (n,) of each node, up to the surface node with the largest index; -1 for inner nodes."""
        owner = np.full(int(self.facets.max(initial=-1)) + 1, -1)
        owner[self.facets] = self.body[:, None]
        return owner

    def nodes_of(self, *bodies: int) -> np.ndarray:
        """Indices of the surface nodes of these bodies, ascending."""
        return self.corners_of(self.facets_of(*bodies))

    def corners_of(self, ids: np.ndarray) -> np.ndarray:
        """Indices of the nodes of the facets `ids`, ascending."""
        return occurring(self.facets[ids], len(self.body_of_node))

    def spacing(self, x: np.ndarray, body: int) -> float:
        """Edge length (m) of an equilateral triangle with the mean area of a body's facets."""
        area = float(np.mean(np.linalg.norm(area_vectors(x, self.facets[self.facets_of(body)]), axis=1)))
        return float(np.sqrt(4.0 / np.sqrt(3.0) * area))


@dataclass(frozen=True)
class Interface:
    """Surface nodes of one body, each with the facet of another body on which it lies.

    nodes (n,); facet (n,): indices in `Surfaces.facets`; weights (n,3): barycentric coordinates of the closest point; gap (n,) m:
    signed distance to it; area (n,) m2: a third of the area of the covered facets around the node: facets of its body whose three nodes
    all lie on other bodies. own (p,2): row of a node in these arrays, and index of a covered facet around it.
    """

    nodes: Annotated[np.ndarray, Rows(dtype=np.int64)]
    facet: Annotated[np.ndarray, Rows(dtype=np.int64)]
    weights: Annotated[np.ndarray, Rows(3)]
    gap: Annotated[np.ndarray, Rows()]
    area: Annotated[np.ndarray, Rows()]
    own: np.ndarray

    def only(self, which: np.ndarray) -> "Interface":
        """The part of the interface whose rows a mask (n,) selects. Areas of rows do not change."""
        row = np.cumsum(which) - 1
        own = self.own[which[self.own[:, 0]]]
        return replace(take(self, which), own=np.stack([row[own[:, 0]], own[:, 1]], axis=1))

    def behind(self, surfaces: Surfaces, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of an element field (m,) on both sides: mean behind each node's own facets (n,), value behind the facet (n,)."""
        n = len(self.nodes)
        count = np.bincount(self.own[:, 0], minlength=n)
        own_side = np.bincount(self.own[:, 0], field[surfaces.element[self.own[:, 1]]], n) / np.maximum(count, 1)
        return own_side, field[surfaces.element[self.facet]]

    def fitted(self, x: np.ndarray, surfaces: Surfaces) -> np.ndarray:
        """Positions x (N,3) with the nodes of the interface moved to their closest points: neither gap nor overlap."""
        moved = x.copy()
        moved[self.nodes] = np.einsum("ij,ijd->id", self.weights, x[surfaces.facets[self.facet]])
        return moved


def neighbours(low: np.ndarray, high: np.ndarray, body: int, reach: float) -> tuple[int, ...]:
    """Other bodies whose bounding boxes lie within `reach` m of the box of `body`. low, high (bodies,3) m: all boxes."""
    near = (low <= high[body] + reach).all(axis=1) & (high >= low[body] - reach).all(axis=1)
    near[body] = False
    return tuple(np.flatnonzero(near).tolist())


def earlier_neighbours(
    surfaces: Surfaces, x: np.ndarray, reach: float, among: np.ndarray | None = None
) -> list[tuple[int, ...]]:
    """For each body, the bodies with a smaller index whose bounding boxes lie within `reach` m of its box. x (N,3) m; among: mask
    (bodies,) of the bodies to consider, default all."""
    boxes, counts = surfaces.boxes(x), np.ones(surfaces.bodies, bool) if among is None else among
    return [
        tuple(b for b in neighbours(*boxes, body, reach) if b < body and counts[b]) if counts[body] else ()
        for body in range(surfaces.bodies)
    ]


def interface(
    surfaces: Surfaces, x: np.ndarray, body: int, tolerance: float, others: tuple[int, ...] | None = None
) -> Interface:
    """Interface of the nodes of `body` that lie within `tolerance` m of a facet of `others` (default: bodies with a smaller index).

    A node must face its facet: this excludes the far side of a thin lip. Raises SolverError when positions x (N,3) are not finite.
    """
    others = tuple(range(body)) if others is None else others
    nodes, ids = surfaces.nodes_of(body), surfaces.facets_of(*others)
    if not np.isfinite(x).all():
        raise SolverError("positions of the bodies are not finite numbers: try a finer preset")
    own_ids = surfaces.facets_of(body)
    corners = surfaces.facets[own_ids]
    rows, outward = np.searchsorted(nodes, corners), vertex_normals(x, corners)[nodes]
    face, weights, gap = _facing(x[nodes], outward, x, surfaces.facets, ids, tolerance, surfaces.spacing(x, body))
    touching = (face >= 0) & (np.abs(gap) <= tolerance)

    flat = touching[rows].all(axis=1)
    area = vertex_areas(x, corners[flat])[nodes]
    own = np.stack([rows[flat].ravel(), np.repeat(own_ids[flat], 3)], axis=1)
    return Interface(nodes, face, weights, gap, area, own).only(touching)


def _facing(
    points: np.ndarray, outward: np.ndarray, x: np.ndarray, facets: np.ndarray, ids: np.ndarray, reach: float, cell: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """For each point, the closest facet within `reach` m among those of `ids` that face the point.

    points (n,3) m; outward (n,3): normals at the points; x (N,3) m; facets (k,3); cell (m): size of the search grid. Returns the
    facet (n,), -1 for none, the barycentric coordinates (n,3) of the closest point, and the gap (n,) m, negative inside.
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
