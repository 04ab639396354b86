"""In which tetrahedron a place lies."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .tetrahedra import gradients

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
