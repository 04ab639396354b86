"""Penetration depths of bodies in each other, and displacements that move a new body out of existing ones."""

from collections.abc import Iterable, Iterator

import numpy as np

from ..geometry.raycast import RaySurface
from . import broad
from .surfaces import Surfaces, neighbours


def lying_inside(
    surfaces: Surfaces, x: np.ndarray, bodies: Iterable[int]
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """For each body, yield its index, the surface nodes (k,) of other bodies that lie inside it, their depths (k,) m, and the closest
    facet (k,) of the body. Only pairs of bodies with at least one in `bodies` count. x (N,3) m."""
    asked = np.zeros(surfaces.bodies, bool)
    asked[list(bodies)] = True
    low, high = surfaces.boxes(x)
    owner = surfaces.body_of_node
    nodes = np.flatnonzero(owner >= 0)
    # the median gives cells of the size of most bodies: a few bodies can be very small
    cell = float(np.median((high - low).max(axis=1)))
    start, box = broad.pairs_within(
        x[nodes], np.zeros(len(nodes)), owner[nodes], low, high, np.arange(surfaces.bodies), cell
    )
    node = np.repeat(nodes, np.diff(start))
    within = ((x[node] > low[box]) & (x[node] < high[box])).all(axis=1)
    within &= asked[owner[node]] | asked[box]
    node, box = node[within], box[within]
    node, start = node[np.argsort(box, kind="stable")], np.cumsum([0, *np.bincount(box, minlength=surfaces.bodies)])
    for body in range(surfaces.bodies):
        inside, away, facets, _ = _inside(surfaces, x, body, node[start[body] : start[body + 1]])
        yield body, inside, np.linalg.norm(away, axis=1), facets


def overlaps(surfaces: Surfaces, x: np.ndarray, bodies: Iterable[int]) -> np.ndarray:
    """Depth (N,) m of each surface node in another body, else 0. Only pairs with at least one body in `bodies` count. x (N,3) m."""
    depth = np.zeros(len(x))
    for _, nodes, own, _ in lying_inside(surfaces, x, bodies):
        np.maximum.at(depth, nodes, own)
    return depth


def displacements_out(surfaces: Surfaces, x: np.ndarray, body: int) -> np.ndarray:
    """Displacements (N,3) m of the surface nodes of `body` that move it out of the other bodies, to first order; 0 elsewhere.

    A node of `body` inside another body moves to the closest point of that body's surface. If a node of another body lies inside
    `body`, the corners of the closest facet move inwards by the smallest displacements that put the facet on the node. The largest
    of several displacements counts.
    """
    found = np.zeros((len(x), 3))
    low, high = surfaces.boxes(x)
    others = neighbours(low, high, body, 0.0)

    def put(nodes: np.ndarray, moves: np.ndarray) -> None:
        for node, move in zip(nodes, moves, strict=True):
            if move @ move > found[node] @ found[node]:
                found[node] = move

    for other in others:
        near = broad.boxes_within(x, x, surfaces.nodes_of(body), low[other], high[other])
        put(*_inside(surfaces, x, other, near)[:2])
    near = broad.boxes_within(x, x, surfaces.nodes_of(*others), low[body], high[body])
    _, out, facets, weights = _inside(surfaces, x, body, near)
    share = weights / np.einsum("ij,ij->i", weights, weights)[:, None]
    put(surfaces.facets[facets].ravel(), (-share[:, :, None] * out[:, None, :]).reshape(-1, 3))
    return found


def _inside(
    surfaces: Surfaces, x: np.ndarray, body: int, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The nodes (k,) among `nodes` that lie inside a body, their displacements (k,3) m to its surface, and the closest point: facet
    (k,) and barycentric coordinates (k,3)."""
    if len(nodes) == 0:
        return nodes, np.zeros((0, 3)), nodes, np.zeros((0, 3))
    own = surfaces.facets_of(body)
    surface = RaySurface(x, surfaces.facets[own])
    nodes = nodes[surface.inside(x[nodes])]
    feet, triangle, weights = surface.feet(x[nodes])
    return nodes, feet - x[nodes], own[triangle], weights
