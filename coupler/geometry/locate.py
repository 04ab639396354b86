"""In which tetrahedron a place lies: of many places by the nearest middles, of a few by looking at all tetrahedra near them."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .tetrahedra import gradients, volumes

CANDIDATES = (4, 16, 64)  # tetrahedra with the nearest centres that are tried, until one holds the place
ROUNDING = 1e-9  # of a barycentric coordinate


def containing(points: NDArray, tets: NDArray, places: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The tetrahedron (k,) of tets (m,4) on points (n,3) that holds each place (k,3), and the place's barycentric coordinates (k,4).

    Of a place that none of CANDIDATES holds, such as one just outside the boundary: that of them in which its least coordinate is the
    largest, and its coordinates there with the negative ones set to 0.
    """
    slope, origin = gradients(points, tets), points[tets[:, 0]]
    tree = cKDTree(points[tets].mean(axis=1))
    element, weights, least = np.zeros(len(places), np.int64), np.zeros((len(places), 4)), np.full(len(places), -np.inf)
    left = np.arange(len(places))
    for count in CANDIDATES:
        near = tree.query(places[left], k=min(count, len(tets)))[1].reshape(len(left), -1)
        for candidate in near.T:
            last = np.einsum("kij,kj->ki", slope[candidate], places[left] - origin[candidate])
            own = np.column_stack([1.0 - last.sum(axis=1), last])
            better = own.min(axis=1) > least[left]
            row = left[better]
            element[row], weights[row], least[row] = candidate[better], own[better], own[better].min(axis=1)
        left = left[least[left] < -ROUNDING]
        if len(left) == 0:
            break
    weights = np.maximum(weights, 0.0)
    return element, weights / weights.sum(axis=1)[:, None]


def in_tets(points: NDArray, tets: NDArray, places: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The tetrahedron (k,) of tets (m,4) on points (n,3) that each place (k,3) lies in, -1 outside of all, and its barycentric
    coordinates there (k,4).

    places: few, as each is held against every tetrahedron near all of them; flat ones hold none.
    """
    corners, owner, share = points[tets], np.full(len(places), -1), np.zeros((len(places), 4))
    near = ((corners.min(1) <= places.max(0)) & (corners.max(1) >= places.min(0))).all(1) & (
        volumes(points, tets) != 0.0
    )
    near_tets = np.flatnonzero(near)
    if not len(near_tets):
        return owner, share
    slope, origin = gradients(points, tets[near]), corners[near, 0]
    for k, place in enumerate(places):
        three = np.einsum("mij,mj->mi", slope, place - origin)
        four = np.column_stack([1 - three.sum(1), three])
        best = int(np.argmax(four.min(1)))
        if four[best].min() > -ROUNDING:
            owner[k], share[k] = near_tets[best], four[best]
    return owner, share
