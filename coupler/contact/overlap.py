"""How far bodies lie in each other, and how a new one is moved out of those that are there."""

from collections.abc import Iterable, Iterator

import numpy as np

from ..geometry.raycast import RaySurface
from . import broad
from .surfaces import Surfaces, neighbours


def lying_inside(
    surfaces: Surfaces, x: np.ndarray, bodies: Iterable[int]
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Of each body, the surface nodes (k,) of others that lie inside it, how deep (k,) m, and its facet (k,) closest to each, where one
    of both is in `bodies`. x (N,3) m."""
    asked = np.zeros(surfaces.bodies, bool)
    asked[list(bodies)] = True
    low, high = surfaces.boxes(x)
    owner = surfaces.body_of_node
    nodes = np.flatnonzero(owner >= 0)
    # cells of the size of most bodies: a few can be tiny
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
    """Depth (N,) m to which each surface node lies inside another body, where one of both is in `bodies`; 0 outside. x (N,3) m."""
    depth = np.zeros(len(x))
    for _, nodes, own, _ in lying_inside(surfaces, x, bodies):
        np.maximum.at(depth, nodes, own)
    return depth


def displacements_out(surfaces: Surfaces, x: np.ndarray, body: int) -> np.ndarray:
    """Displacements (N,3) m of the surface nodes of `body` that take it out of the others, to first order; 0 elsewhere.

    A node of it inside another body goes to the closest point of that body's surface; where a node of another lies in it, the corners
    of the closest facet go in by the least displacements that put the facet on the node. Of several the largest counts.
    """
    found = np.zeros((len(x), 3))
    low, high = surfaces.boxes(x)
    others = neighbours(low, high, body, 0.0)

    def put(nodes: np.ndarray, moves: np.ndarray) -> None:
        for node, move in zip(nodes, moves, strict=True):
            if move @ move > found[node] @ found[node]:
                found[node] = move

    for other in others:
        near = broad.points_within(x, surfaces.nodes_of(body), low[other], high[other])
        put(*_inside(surfaces, x, other, near)[:2])
    near = broad.points_within(x, surfaces.nodes_of(*others), low[body], high[body])
    _, out, facets, weights = _inside(surfaces, x, body, near)
    share = weights / np.einsum("ij,ij->i", weights, weights)[:, None]
    put(surfaces.facets[facets].ravel(), (-share[:, :, None] * out[:, None, :]).reshape(-1, 3))
    return found


def _inside(
    surfaces: Surfaces, x: np.ndarray, body: int, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Those (k,) of the nodes of others in the box round a body that lie inside it, the displacement (k,3) m out of it, the facet (k,)
    there, its weights (k,3)."""
    if len(nodes) == 0:
        return nodes, np.zeros((0, 3)), nodes, np.zeros((0, 3))
    own = surfaces.facets_of(body)
    surface = RaySurface(x, surfaces.facets[own])
    nodes = nodes[surface.inside(x[nodes])]
    feet, triangle, weights = surface.feet(x[nodes])
    return nodes, feet - x[nodes], own[triangle], weights
