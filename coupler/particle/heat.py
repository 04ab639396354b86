"""Heat conduction among the points of the particle: Fourier's law with the fixed reference neighbours.

Gradients in the reference configuration are moving least squares over the neighbours, g = G T, exact for any linear
field at the free surface too; so is the deformation gradient F = G x. Conduction in the deformed body is conduction in the
reference one with the conductivity k J F^-1 F^-T, and the heat that flows into points is minus the derivative of

    sum V g . (k J F^-1 F^-T) g / 2  +  sum c (R T)^2 / 2.

The first term is zero for a field that alternates from point to point; the second is not: R T is the temperature of a point
less the estimate from its neighbours and their gradient. It is zero for a linear field, so its contribution falls with the
square of the spacing. Both terms are sums of squares: their derivatives conserve heat to rounding and only reduce differences
of temperature. The surface is adiabatic.
"""

from math import ceil

import numpy as np
from scipy.spatial import cKDTree

from ..core import safety
from ..core.loops import PARTS
from ..core.threads import together
from . import heat_kernels as k

SUPPORT = 1.6  # spacings: of a face-centred cubic lattice (nearest 1.12) the 12 and 6 nearest neighbours
MIN_NEIGHBOURS = 10


class PointConduction:
    """Conduction among all points of one particle. X (n,3) m: reference positions; spacing m; volume (n,) m3; law: LAW (1,)."""

    def __init__(self, X: np.ndarray, spacing: float, volume: np.ndarray, law: np.ndarray):
        n = len(X)
        self.law, self.spacing = law, spacing
        rows, columns, weights = _fits(X, spacing)
        places, back = np.arange(n + 1), np.lexsort((rows, columns))
        self.operators = k.Operators(
            np.searchsorted(rows, places).astype(np.uint32), columns.astype(np.uint32), weights
        )
        self._transposed = k.Operators(
            np.searchsorted(columns[back], places).astype(np.uint32), rows[back].astype(np.uint32), weights[back]
        )
        reach = np.stack([np.bincount(rows, column, n) for column in np.abs(weights).T], axis=1)
        (D, kD), (c, capacity, T, gained) = np.zeros((2, n, 6)), np.zeros((4, n))
        self._flow = k.Conduction(volume, np.asarray(reach, float), D, kD, c, capacity, np.zeros((n, 4)), T, gained)

    def share(self, time: float, x: np.ndarray, T: np.ndarray) -> np.ndarray:
        """Heat (n,) J that points gain by conduction over `time` s at positions x (n,3) m from temperatures T (n,) K.

        Explicit steps, as many as stability needs. The sum over the points is zero to rounding.
        """
        n, left, flow, operators = len(T), time, self._flow, (self.operators, self._transposed)
        flow.T[:], flow.gained[:] = T, 0.0
        while left > 0.0:
            rates = np.zeros(PARTS)
            together(k.prepare, n, self.law, self.spacing, x, *operators, flow, rates)
            dt = left / ceil(left * rates.max() / (2.0 * safety.CONDUCTION))
            together(k.conduct, n, dt, *operators, flow)
            left = left - dt if left > 1.5 * dt else 0.0
        return flow.gained.copy()


def _fits(X: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gradient operators along x, y, z (1/m), and the operator R of the excess over the estimate from the neighbours: rows (m,),
    columns (m,), ascending, and weights (m,4).

    Weighted least squares T_j = T_i + g . (X_j - X_i) for the gradients; the excess is T_i less the mean of T_j - g . (X_j - X_i).
    """
    n, tree = len(X), cKDTree(X)
    near = tree.query_pairs(SUPPORT * spacing, output_type="ndarray")
    pairs = np.concatenate([near, near[:, ::-1], np.tile(np.arange(n)[:, None], 2)])
    few = np.bincount(pairs[:, 0], minlength=n) < MIN_NEIGHBOURS + 1
    nearest = tree.query(X[few], k=min(MIN_NEIGHBOURS + 1, n))[1].reshape(few.sum(), -1)
    more = np.column_stack([np.repeat(np.flatnonzero(few), nearest.shape[1]), nearest.ravel()])
    rows, columns = np.concatenate([pairs[~few[pairs[:, 0]]], more]).T
    order = np.lexsort((columns, rows))
    rows, columns = rows[order], columns[order]
    own = columns == rows
    d = (X[columns] - X[rows]) / spacing
    w = np.where(own, 0.0, np.clip(1.0 - np.linalg.norm(d, axis=1) / (1.2 * SUPPORT), 0.05, None) ** 2)
    A = np.zeros((n, 3, 3))
    np.add.at(A, rows, w[:, None, None] * d[:, :, None] * d[:, None, :])
    gradient = w[:, None] * np.einsum("mij,mj->mi", np.linalg.inv(A)[rows], d) / spacing
    w /= np.bincount(rows, w, n)[rows]
    for a in range(3):  # of a point itself: minus those of its neighbours
        gradient[own, a] = -np.bincount(rows, gradient[:, a], n)
    weights = np.column_stack([gradient, np.where(own, 1.0, -w)])
    for a in range(3):
        weights[:, 3] += np.bincount(rows, w * d[:, a], n)[rows] * spacing * gradient[:, a]
    return rows, columns, weights
