"""Fit of a finished splat to the surfaces under it, so that it does not overlap other bodies."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix

from ..contact.overlap import displacements_out
from ..contact.surfaces import Surfaces, interface
from ..errors import SolverError
from ..fe.explicit import Target
from ..geometry.tetrahedra import boundary_faces, volumes
from ..geometry.triangles import correct_volume
from .domain import BodyState

NEAR = 0.6  # element sizes: surfaces closer than this are in contact when a splat joins
CLEAR, ROUNDS = 0.02, 6  # element sizes: largest remaining overlap of a new splat; number of attempts to remove it
MOVED_EDGES = 6  # edges: largest distance of nodes that move with the displaced ones
LEAST_QUALITY = 0.1  # smallest volume of a tetrahedron after a displacement, divided by its volume before
FITTED_VOLUME = 0.01  # relative change of a splat's volume that its density corrects; else the free surface is moved
MOST_OFFSET = 0.25  # element sizes: largest such motion of the free surface
LOST_VOLUME = 0.05  # largest relative change of a splat's volume after the correction


def placed_on(splat: BodyState, target: Target, body: np.ndarray, size: float) -> BodyState:
    """A splat whose nodes near the bodies of a target are moved onto their facets, as far as the quality of its tetrahedra allows.

    body (m,): body of each element of the target; size (m): size of the splat's elements. Raises SolverError if the splat has no
    elements, or its volume cannot be kept.
    """
    n, new = len(target.nodes.x), int(body.max()) + 1
    if len(splat.tets) == 0:
        raise SolverError(
            "a splat without elements cannot join the target: try a finer preset, or another [splat] method"
        )
    facets, element = boundary_faces(splat.tets)
    x, mesh = np.concatenate([target.nodes.x, splat.points]), target.mesh
    surfaces = Surfaces(
        np.concatenate([mesh.facets, facets + n]).astype(np.int64),
        np.concatenate([body[mesh.facet_element], np.full(len(facets), new)]).astype(np.int64),
        np.concatenate([mesh.facet_element, element + len(mesh.conn)]).astype(np.int64),
    )
    contact_pairs = interface(surfaces, x, new, NEAR * size)
    points = _as_far_as_possible(splat, splat.points, contact_pairs.fitted(x, surfaces)[n:])
    placed = contact_pairs.nodes - n
    try:
        cleared = _cleared(splat, points, placed, target.nodes.x, surfaces, new, size)
    except SolverError:  # displaced nodes cannot correct the volume: correct it before, when more nodes are free
        points = _of_volume(points, splat, placed, size)
        try:
            cleared = _cleared(splat, points, placed, target.nodes.x, surfaces, new, size)
        except SolverError:  # the overlap is better than the loss of volume
            cleared = points
    return replace(splat, points=cleared)


def _cleared(
    splat: BodyState, points: np.ndarray, placed: np.ndarray, before: np.ndarray, surfaces: Surfaces, new: int, size: float
) -> np.ndarray:  # fmt: skip
    """Points (n,3) m of a splat, the body `new`, moved out of the bodies that it overlaps, without change of its volume. placed:
    its nodes on other bodies; before (N,3) m: nodes of the other bodies."""
    for _ in range(ROUNDS):
        out = displacements_out(surfaces, np.concatenate([before, points]), new)[len(before) :]
        depth = np.linalg.norm(out, axis=1)
        if depth.max() < CLEAR * size:
            break
        placed = np.union1d(placed, np.flatnonzero(depth))
        points = _as_far_as_possible(splat, points, points + carried_along(splat.tets, out))
    return _of_volume(points, splat, placed, size)


def carried_along(tets: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Displacements (n,3) m of the nodes of tetrahedra (m,4). Nodes with a zero displacement in `given` (n,3) m get the mean of
    their neighbours, up to MOVED_EDGES edges away: a thin rim moves as a whole."""
    edges = np.concatenate([tets[:, pair] for pair in combinations(range(4), 2)])
    both = np.concatenate([edges, edges[:, ::-1]])
    beside = coo_matrix((np.ones(len(both)), both.T), shape=(len(given), len(given))).tocsr()
    beside.data[:] = 1.0
    moved, free = given.copy(), ~given.any(axis=1)
    for _ in range(MOVED_EDGES):
        moved[free] = (beside @ moved)[free] / np.maximum(np.diff(beside.indptr), 1)[free, None]
    return moved


def _of_volume(points: np.ndarray, splat: BodyState, placed: np.ndarray, size: float) -> np.ndarray:
    """Points (n,3) m of a splat after its free surface has moved so that the splat has its original volume. placed: nodes on other
    bodies, which do not move; size (m): size of the elements. Raises SolverError if the volume cannot be restored."""
    whole, facets = float(volumes(splat.points, splat.tets).sum()), boundary_faces(splat.tets)[0]
    fixed = np.zeros(len(points), bool)
    fixed[placed] = True
    left = MOST_OFFSET * size
    for _ in range(ROUNDS):  # more than one: some nodes cannot move in full, and the others must compensate
        if abs(volumes(points, splat.tets).sum() / whole - 1.0) <= FITTED_VOLUME:
            break
        corrected, offset = correct_volume(points, facets, whole, left, fixed)
        points = _as_far_as_possible(splat, points, corrected)
        left = max(left - abs(offset), 0.0)
    if abs(error := volumes(points, splat.tets).sum() / whole - 1.0) > LOST_VOLUME:
        raise SolverError(
            f"a splat changed its volume by {error:+.1%} when it was fitted to the surface below it (limit {LOST_VOLUME:.0%}):"
            " try a finer preset, or another [splat] method"
        )
    return points


def _as_far_as_possible(splat: BodyState, points: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The nodes of a splat, moved from `points` towards `wanted` (n,3) m, each as far as the quality of its tetrahedra allows."""
    least = LEAST_QUALITY * volumes(splat.points, splat.tets)
    share = np.ones(len(wanted))
    for _ in range(8):
        moved = points + share[:, None] * (wanted - points)
        bad = volumes(moved, splat.tets) < least
        if not bad.any():
            return moved
        share[np.unique(splat.tets[bad])] *= 0.5
    return points
