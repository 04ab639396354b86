"""In which tetrahedron a point lies."""

import numpy as np
from numpy.typing import NDArray

from .tetrahedra import gradients, volumes

ROUNDING = 1e-9  # of a barycentric coordinate


def in_tets(points: NDArray, tets: NDArray, x: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The tetrahedron (k,) of tets (m,4) on points (n,3) that each of x (k,3) lies in, -1 outside of all, and its barycentric
    coordinates there (k,4).

    x: few, as each is compared with every tetrahedron near all of them; flat ones contain none.
    """
    corners, owner, share = points[tets], np.full(len(x), -1), np.zeros((len(x), 4))
    near = ((corners.min(1) <= x.max(0)) & (corners.max(1) >= x.min(0))).all(1) & (volumes(points, tets) != 0.0)
    near_tets = np.flatnonzero(near)
    if not len(near_tets):
        return owner, share
    slope, origin = gradients(points, tets[near]), corners[near, 0]
    for k, point in enumerate(x):
        three = np.einsum("mij,mj->mi", slope, point - origin)
        four = np.column_stack([1 - three.sum(1), three])
        best = int(np.argmax(four.min(1)))
        if four[best].min() > -ROUNDING:
            owner[k], share[k] = near_tets[best], four[best]
    return owner, share
