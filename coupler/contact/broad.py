"""Which points and triangles may come near each other: boxes and a grid (numba)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..state.arrays import Floats, Ints


@njit(cache=True, nogil=True)
def facet_boxes(x: Floats, facets: Ints, ids: Ints, low: Floats, high: Floats) -> None:
    """Boxes, low and high (k,3), around the triangles `ids`."""
    for r in range(len(ids)):
        t = facets[ids[r]]
        for d in range(3):
            u, v, w = x[t[0], d], x[t[1], d], x[t[2], d]
            low[r, d] = min(u, v, w)
            high[r, d] = max(u, v, w)


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
