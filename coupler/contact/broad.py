"""Search for pairs of points and triangles that are near each other, by bounding boxes and a grid (numba)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..compiling import njit, uncounted
from ..core.arrays import Floats, Ints
from ..core.loops import PARTS, ranges
from ..core.threads import together

LEAST_BOXES = 100  # in a range of a loop that threads share
PAIRS = 64  # points near a box for which there is room at first; with more, the search is repeated with more room


@njit(cache=True, nogil=True, inline="always")
def box_of(x: Floats, t: Ints, low: Floats, high: Floats) -> None:
    """Write the bounding box of the triangle of nodes t (3,) to low and high (3,), m."""
    for d in range(3):
        u, v, w = x[t[0], d], x[t[1], d], x[t[2], d]
        low[d] = min(u, v, w)
        high[d] = max(u, v, w)


@njit(cache=True, nogil=True)
def bounds(low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Smallest values (3,) of low (n,3) and largest values (3,) of high (n,3)."""
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(low)):
        for d in range(3):
            least[d] = min(least[d], low[i, d])
            most[d] = max(most[d], high[i, d])
    return least, most


@njit(cache=True, nogil=True)
def boxes_of(x: Floats, facets: Ints) -> tuple[Floats, Floats]:
    """Bounding boxes of triangles (k,3) of nodes x (N,3): low and high (k,3), m."""
    low, high = np.empty((len(facets), 3)), np.empty((len(facets), 3))
    for r in range(len(facets)):
        box_of(x, facets[r], low[r], high[r])
    return low, high


@njit(cache=True, nogil=True)
def boxes_within(low: Floats, high: Floats, ids: Ints, least: Floats, most: Floats) -> NDArray[np.int64]:
    """Indices of the boxes among `ids` that overlap the box [least, most]. low, high (k,3): all boxes."""
    overlapping = np.empty(len(ids), np.int64)
    count = 0
    for i in ids:
        if (
            low[i, 0] <= most[0] and high[i, 0] >= least[0]
            and low[i, 1] <= most[1] and high[i, 1] >= least[1]
            and low[i, 2] <= most[2] and high[i, 2] >= least[2]
        ):  # fmt: skip
            overlapping[count] = i
            count += 1
    return overlapping[:count]


@njit(cache=True, nogil=True)
def _sorted(points: Floats, low: Floats, high: Floats, cell: float) -> tuple[Floats, Ints, Ints, Ints]:
    """Sort the points in the box [low, high] into cells of a grid. Returns the origin of the grid (3,) m, its number of cells in each
    direction (3,), begin, and members: members[begin[i]:begin[i + 1]] are the indices of the points in cell i."""
    near = boxes_within(points, points, np.arange(len(points)), low, high)
    if len(near) == 0:
        return np.zeros(3), np.ones(3, np.int64), np.zeros(2, np.int64), near
    origin, end = bounds(points[near], points[near])
    shape = np.empty(3, np.int64)
    for d in range(3):
        shape[d] = int((end[d] - origin[d]) / cell) + 1
    cell_of = np.empty(len(near), np.int64)
    count = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for q in range(len(near)):
        i = near[q]
        a = int((points[i, 0] - origin[0]) / cell)
        b = int((points[i, 1] - origin[1]) / cell)
        c = int((points[i, 2] - origin[2]) / cell)
        cell_of[q] = (a * shape[1] + b) * shape[2] + c
        count[cell_of[q] + 1] += 1
    for q in range(len(count) - 1):
        count[q + 1] += count[q]
    slot = count[:-1].copy()
    members = np.empty(len(near), np.int64)
    for q in range(len(near)):
        members[slot[cell_of[q]]] = near[q]
        slot[cell_of[q]] += 1
    return origin, shape, count, members


class _Pairing(NamedTuple):
    """Arguments of `pairs_within`, with the largest reach (m) and the points sorted into cells (`_sorted`)."""

    points: Floats
    reach: Floats
    own: Ints
    low: Floats
    high: Floats
    of: Ints
    cell: float
    most: float
    origin: Floats
    shape: Ints
    begin: Ints
    members: Ints


@uncounted
def _cells(r: int, d: int, p: _Pairing) -> tuple[int, int]:
    """First and last cell in direction d whose points can have box r within their reach; last < first if there is none."""
    start, stop = p.low[r, d] - p.most - p.origin[d], p.high[r, d] + p.most - p.origin[d]
    return max(int(start / p.cell), 0), min(int(stop / p.cell), p.shape[d] - 1) if stop >= 0.0 else -1


@uncounted
def _points_of_box(r: int, p: _Pairing, found: Ints, at: int) -> int:
    """Count the points of other bodies that have box r within their reach. Write their indices to `found` from index `at` on, if
    there is room."""
    (a0, a1), (b0, b1), (c0, c1) = _cells(r, 0, p), _cells(r, 1, p), _cells(r, 2, p)
    if a1 < a0 or b1 < b0 or c1 < c0:
        return 0
    pairs = 0
    for a in range(a0, a1 + 1):
        for b in range(b0, b1 + 1):
            base = (a * p.shape[1] + b) * p.shape[2]
            for q in range(p.begin[base + c0], p.begin[base + c1 + 1]):
                i = p.members[q]
                x, far = p.points[i], p.reach[i]
                if (
                    p.own[i] != p.of[r]
                    and p.low[r, 0] - far <= x[0] <= p.high[r, 0] + far
                    and p.low[r, 1] - far <= x[1] <= p.high[r, 1] + far
                    and p.low[r, 2] - far <= x[2] <= p.high[r, 2] + far
                ):
                    if at + pairs < len(found):
                        found[at + pairs] = i
                    pairs += 1
    return pairs


@uncounted
def _points_of_boxes(team: Ints, p: _Pairing, count: Ints, used: Ints, found: Ints) -> None:
    """Do `_points_of_box` for all boxes, in all threads. Writes the numbers of points to count (k,). found (PARTS, room): indices of
    the points, one row for each range of boxes; used (PARTS,): number of points of each range, which can be larger than room."""
    for lo, hi, part in ranges(team, 0, len(count), LEAST_BOXES):
        for r in range(lo, hi):
            count[r] = _points_of_box(r, p, found[part], used[part])
            used[part] += count[r]


def pairs_within(
    points: Floats, reach: Floats, own: Ints, low: Floats, high: Floats, of: Ints, cell: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each point, the boxes of other bodies within its reach. points (n,3) m; reach (n,) m; low, high (k,3) m: the boxes; own
    (n,), of (k,): body of each point and of each box; cell: size of the search grid, m.

    Returns start (n+1,) and boxes: boxes[start[i]:start[i + 1]] are the boxes of point i, ascending.
    """
    most = float(reach.max(initial=0.0))
    least, greatest = bounds(low, high)
    pairing = _Pairing(
        points, reach, own, low, high, of, cell, most, *_sorted(points, least - most, greatest + most, cell)
    )
    count, needed, room = np.zeros(len(low), np.int64), PAIRS * max(2 * LEAST_BOXES, len(low) // PARTS + 1), 0
    while needed > room:
        room, used = needed, np.zeros(PARTS, np.int64)
        found = np.empty((PARTS, room), np.int64)
        together(_points_of_boxes, pairing, count, used, found)
        needed = int(used.max())
    near = np.concatenate([part[:n] for part, n in zip(found, used, strict=True)])
    first = np.append(0, np.cumsum(count))
    by_box = csr_array((np.ones(len(near), np.int8), near, first), shape=(len(low), len(points)))
    by_point = by_box.tocsc()
    return by_point.indptr.astype(np.int64), by_point.indices.astype(np.int64)


def facets_within(x: Floats, facets: Ints, ids: Ints, least: Floats, most: Floats) -> NDArray[np.int64]:
    """Indices of the triangles among `ids` whose bounding boxes overlap the box [least, most]."""
    return np.asarray(ids[boxes_within(*boxes_of(x, facets[ids]), np.arange(len(ids)), least, most)], np.int64)
