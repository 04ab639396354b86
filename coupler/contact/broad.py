"""Search for pairs of points and triangles that are near each other, by bounding boxes and a grid (numba)."""

import numpy as np
from numpy.typing import NDArray

from ..compiling import njit
from ..core.arrays import Floats, Ints


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
def points_within(x: Floats, ids: Ints, low: Floats, high: Floats) -> NDArray[np.int64]:
    """Numbers of the points among `ids` that lie in the box [low, high]; x (n,3): positions."""
    inside = np.empty(len(ids), np.int64)
    count = 0
    for i in ids:
        p = x[i]
        if low[0] <= p[0] <= high[0] and low[1] <= p[1] <= high[1] and low[2] <= p[2] <= high[2]:
            inside[count] = i
            count += 1
    return inside[:count]


@njit(cache=True, nogil=True)
def boxes_of(x: Floats, facets: Ints) -> tuple[Floats, Floats]:
    """Bounding boxes of triangles (k,3) of nodes x (N,3): low and high (k,3), m."""
    low, high = np.empty((len(facets), 3)), np.empty((len(facets), 3))
    for r in range(len(facets)):
        box_of(x, facets[r], low[r], high[r])
    return low, high


@njit(cache=True, nogil=True)
def boxes_within(low: Floats, high: Floats, ids: Ints, least: Floats, most: Floats) -> NDArray[np.int64]:
    """Numbers of the boxes among `ids` that overlap the box [least, most]. low, high (k,3): all boxes."""
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
def _pairs(
    points: Floats, reach: Floats, own: Ints, low: Floats, high: Floats, of: Ints, cell: float, room: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """As `pairs_within`, but it stores at most `room` pairs. Also returns the number of all pairs."""
    n, most = len(points), reach.max()
    least, greatest = bounds(low, high)
    near = points_within(points, np.arange(n), least - most, greatest + most)
    if len(near) == 0:
        return np.zeros(n + 1, np.int64), np.empty(0, np.int64), 0
    origin, end = bounds(points[near], points[near])
    shape = np.empty(3, np.int64)
    for d in range(3):
        shape[d] = int((end[d] - origin[d]) / cell) + 1
    cells = shape[0] * shape[1] * shape[2]
    cell_of = np.empty(len(near), np.int64)
    count = np.zeros(cells + 1, np.int64)
    for q in range(len(near)):
        i = near[q]
        a = int((points[i, 0] - origin[0]) / cell)
        b = int((points[i, 1] - origin[1]) / cell)
        c = int((points[i, 2] - origin[2]) / cell)
        cell_of[q] = (a * shape[1] + b) * shape[2] + c
        count[cell_of[q] + 1] += 1
    for q in range(cells):
        count[q + 1] += count[q]
    slot = count[:-1].copy()
    members = np.empty(len(near), np.int64)
    for q in range(len(near)):
        members[slot[cell_of[q]]] = near[q]
        slot[cell_of[q]] += 1
    pair_point, pair_box = np.empty(room, np.int64), np.empty(room, np.int64)
    pairs = 0
    degree = np.zeros(n + 1, np.int64)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for r in range(len(low)):
        outside = False
        for d in range(3):
            start, stop = low[r, d] - most - origin[d], high[r, d] + most - origin[d]
            outside = outside or stop < 0.0 or start > shape[d] * cell
            first[d], last[d] = max(int(start / cell), 0), min(int(stop / cell), shape[d] - 1)
        if outside:
            continue
        for a in range(first[0], last[0] + 1):
            for b in range(first[1], last[1] + 1):
                base = (a * shape[1] + b) * shape[2]
                for q in range(count[base + first[2]], count[base + last[2] + 1]):
                    i = members[q]
                    p, far = points[i], reach[i]
                    if (
                        own[i] != of[r]
                        and low[r, 0] - far <= p[0] <= high[r, 0] + far
                        and low[r, 1] - far <= p[1] <= high[r, 1] + far
                        and low[r, 2] - far <= p[2] <= high[r, 2] + far
                    ):
                        if pairs < room:
                            pair_point[pairs], pair_box[pairs] = i, r
                            degree[i + 1] += 1
                        pairs += 1
    stored = min(pairs, room)
    for i in range(n):
        degree[i + 1] += degree[i]
    free = degree[:-1].copy()
    boxes = np.empty(stored, np.int64)
    for q in range(stored):
        i = pair_point[q]
        boxes[free[i]] = pair_box[q]
        free[i] += 1
    return degree, boxes, pairs


def pairs_within(
    points: Floats, reach: Floats, own: Ints, low: Floats, high: Floats, of: Ints, cell: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each point, the boxes of other bodies within its reach. points (n,3) m; reach (n,) m; low, high (k,3) m: the boxes; own
    (n,), of (k,): body of each point and of each box; cell: size of the search grid, m.

    Returns start (n+1,) and boxes: boxes[start[i]:start[i + 1]] are the boxes of point i, ascending.
    """
    room = 64 * len(points)
    while True:
        start, boxes, needed = _pairs(points, reach, own, low, high, of, cell, room)
        if needed <= room:
            return start, boxes
        room = 2 * needed


def facets_within(x: Floats, facets: Ints, ids: Ints, least: Floats, most: Floats) -> NDArray[np.int64]:
    """Numbers of the triangles among `ids` whose bounding boxes overlap the box [least, most]."""
    return np.asarray(ids[boxes_within(*boxes_of(x, facets[ids]), np.arange(len(ids)), least, most)], np.int64)
