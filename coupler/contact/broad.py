"""Which points and triangles may come near each other: boxes and a grid (numba)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..state.arrays import Bools, Floats, Ints


@njit(cache=True, nogil=True, inline="always")
def box_of(x: Floats, t: Ints, low: Floats, high: Floats) -> None:
    """Box around a triangle of nodes t (3,) into low, high (3,), m."""
    for d in range(3):
        u, v, w = x[t[0], d], x[t[1], d], x[t[2], d]
        low[d] = min(u, v, w)
        high[d] = max(u, v, w)


@njit(cache=True, nogil=True)
def facet_boxes(x: Floats, facets: Ints, ids: Ints, low: Floats, high: Floats) -> None:
    """Boxes, low and high (k,3), around the triangles `ids`."""
    for r in range(len(ids)):
        box_of(x, facets[ids[r]], low[r], high[r])


@njit(cache=True, nogil=True)
def bounds(low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Smallest of low (n,3) and largest of high (n,3)."""
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(low)):
        for d in range(3):
            least[d] = min(least[d], low[i, d])
            most[d] = max(most[d], high[i, d])
    return least, most


@njit(cache=True, nogil=True)
def corners(facets: Ints, ids: Ints, n: int) -> NDArray[np.int64]:
    """Nodes of the triangles `ids`, ascending; n: how many nodes there are in all."""
    has, nodes = np.zeros(n, np.bool_), np.empty(3 * len(ids), np.int64)
    count = 0
    for r in range(len(ids)):
        for i in range(3):
            node = facets[ids[r], i]
            if not has[node]:
                has[node] = True
                nodes[count] = node
                count += 1
    return np.sort(nodes[:count])


@njit(cache=True, nogil=True)
def candidates_of(rows: Ints, start: Ints, boxes: Ints, count: int) -> Ints:
    """Which of `count` facets are candidates of the points `rows`, ascending; boxes is renumbered to places among these, -1 for the
    others."""
    place = np.full(count, -1)
    for q in range(len(rows)):
        for r in range(start[rows[q]], start[rows[q] + 1]):
            place[boxes[r]] = 0
    used = np.flatnonzero(place == 0)
    for k in range(len(used)):
        place[used[k]] = k
    for r in range(len(boxes)):
        boxes[r] = place[boxes[r]]
    return used


@njit(cache=True, nogil=True)
def least_corners(rows: Ints, start: Ints, boxes: Ints, ids: Ints, facets: Ints) -> NDArray[np.int64]:
    """The least node of all candidate triangles of each of the points `rows`; start, boxes, ids as in `candidates_of`."""
    least = np.empty(len(rows), np.int64)
    for q in range(len(rows)):
        first = np.iinfo(np.int64).max
        for r in range(start[rows[q]], start[rows[q] + 1]):
            for i in range(3):
                first = min(first, facets[ids[boxes[r]], i])
        least[q] = first
    return least


@njit(cache=True, nogil=True)
def points_within(points: Floats, low: Floats, high: Floats) -> Ints:
    """Which of points (n,3) lie in the box [low, high], ascending."""
    inside = np.empty(len(points), np.int64)
    count = 0
    for i in range(len(points)):
        p = points[i]
        if low[0] <= p[0] <= high[0] and low[1] <= p[1] <= high[1] and low[2] <= p[2] <= high[2]:
            inside[count] = i
            count += 1
    return inside[:count]


@njit(cache=True, nogil=True)
def candidates(
    points: Floats, low: Floats, high: Floats, cell: float, capacity: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Pairs of points and boxes that overlap, by a hash-free grid over the points within the bounds of all boxes.

    points (n,3); low, high (k,3) boxes; cell: grid spacing. Returns (start (n+1,), box indices, needed): CSR of the
    boxes around each point in ascending order; needed > capacity asks for another call with more room.
    """
    n, boxes = len(points), len(low)
    near = points_within(points, *bounds(low, high))
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
    pair_point = np.empty(capacity, np.int64)
    pair_box = np.empty(capacity, np.int64)
    pairs = 0
    degree = np.zeros(n + 1, np.int64)
    for r in range(boxes):
        outside = False
        for d in range(3):
            if high[r, d] < origin[d] or low[r, d] > origin[d] + shape[d] * cell:
                outside = True
        if outside:
            continue
        a0, a1 = max(int((low[r, 0] - origin[0]) / cell), 0), min(int((high[r, 0] - origin[0]) / cell), shape[0] - 1)
        b0, b1 = max(int((low[r, 1] - origin[1]) / cell), 0), min(int((high[r, 1] - origin[1]) / cell), shape[1] - 1)
        c0, c1 = max(int((low[r, 2] - origin[2]) / cell), 0), min(int((high[r, 2] - origin[2]) / cell), shape[2] - 1)
        for a in range(a0, a1 + 1):
            for b in range(b0, b1 + 1):
                base = (a * shape[1] + b) * shape[2]
                for m in range(count[base + c0], count[base + c1 + 1]):
                    i = members[m]
                    if (
                        low[r, 0] <= points[i, 0] <= high[r, 0]
                        and low[r, 1] <= points[i, 1] <= high[r, 1]
                        and low[r, 2] <= points[i, 2] <= high[r, 2]
                    ):
                        if pairs < capacity:
                            pair_point[pairs], pair_box[pairs] = i, r
                            degree[i + 1] += 1
                        pairs += 1
    stored = min(pairs, capacity)
    for i in range(n):
        degree[i + 1] += degree[i]
    slot2 = degree[:-1].copy()
    out = np.empty(stored, np.int64)
    for q in range(stored):
        i = pair_point[q]
        out[slot2[i]] = pair_box[q]
        slot2[i] += 1
    return degree, out, pairs


def pairs_within(
    points: Floats, low: Floats, high: Floats, cell: float, room: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """`candidates`, with room for all of them; room: for so many pairs at first. Returns start, box indices, and the room taken."""
    while True:
        start, boxes, needed = candidates(points, low, high, cell, room)
        if needed <= room:
            return start, boxes, room
        room = 2 * needed


@njit(cache=True, nogil=True)
def boxes_within(ids: Ints, low: Floats, high: Floats, least: Floats, most: Floats) -> NDArray[np.int64]:
    """Those of the boxes `ids`, rows of low and high (k,3), that overlap the box [least, most]."""
    overlapping = np.empty(len(ids), np.int64)
    count = 0
    for r in range(len(ids)):
        i = ids[r]
        if (
            low[i, 0] <= most[0] and high[i, 0] >= least[0]
            and low[i, 1] <= most[1] and high[i, 1] >= least[1]
            and low[i, 2] <= most[2] and high[i, 2] >= least[2]
        ):  # fmt: skip
            overlapping[count] = i
            count += 1
    return overlapping[:count]


@njit(cache=True, nogil=True)
def facets_within(x: Floats, facets: Ints, ids: Ints, least: Floats, most: Floats) -> NDArray[np.int64]:
    """Those of the triangles `ids` whose boxes overlap the box [least, most]."""
    overlapping = np.empty(len(ids), np.int64)
    count = 0
    for i in ids:
        t, apart = facets[i], False
        for d in range(3):
            u, v, w = x[t[0], d], x[t[1], d], x[t[2], d]
            apart = apart or min(u, v, w) > most[d] or max(u, v, w) < least[d]
        if not apart:
            overlapping[count] = i
            count += 1
    return overlapping[:count]


@njit(cache=True, nogil=True)
def nodes_within(x: Floats, nodes: Ints, least: Floats, most: Floats) -> NDArray[np.int64]:
    """Those of the nodes that lie inside the box [least, most]."""
    inside = np.empty(len(nodes), np.int64)
    count = 0
    for i in nodes:
        p = x[i]
        if (p > least).all() and (p < most).all():
            inside[count] = i
            count += 1
    return inside[:count]


@njit(cache=True, nogil=True)
def farthest(x: Floats, rows: Ints, before: Floats) -> float:
    """The farthest that any of the points `rows` of x (N,3) is from where it was before (k,3), m."""
    most = 0.0
    for q in range(len(rows)):
        a, b = x[rows[q]], before[q]
        u, v, w = a[0] - b[0], a[1] - b[1], a[2] - b[2]
        most = max(most, u * u + v * v + w * w)
    return float(np.sqrt(most))


@njit(cache=True, nogil=True)
def ways(x: Floats, nodes: Ints, bounds: Ints, before: Floats, way: Floats) -> None:
    """Add the farthest that a node of each body has moved to way (bodies,) m.

    bounds (bodies+1,): of each body in `nodes`; before (k,3): where they were, which is brought up to now.
    """
    for b in range(len(way)):
        lo, hi = bounds[b], bounds[b + 1]
        way[b] += farthest(x, nodes[lo:hi], before[lo:hi])
        for q in range(lo, hi):
            for d in range(3):
                before[q, d] = x[nodes[q], d]


@njit(cache=True, nogil=True)
def nearest_box(x: Floats, nodes: Ints, ids: Ints, known: Bools, low: Floats, high: Floats) -> float:
    """Distance (m) from the box around nodes to the closest box `ids` of low, high (f,3) that is not known (len(ids),); the largest of
    its three components."""
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for a in nodes:
        for d in range(3):
            least[d] = min(least[d], x[a, d])
            most[d] = max(most[d], x[a, d])
    nearest = np.inf
    for k in range(len(ids)):
        if not known[k]:
            i = ids[k]
            apart = 0.0
            for d in range(3):
                apart = max(apart, low[i, d] - most[d], least[d] - high[i, d])
            nearest = min(nearest, apart)
    return nearest


@njit(cache=True, nogil=True)
def largest(values: Floats, rows: Ints) -> float:
    """The largest of the values (N,) at `rows`, 0 where there is none larger."""
    most = 0.0
    for a in rows:
        most = max(most, values[a])
    return most
