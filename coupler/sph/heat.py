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
from scipy.sparse import csr_matrix, identity
from scipy.spatial import cKDTree

from ..physics.constitutive import conductivities, heat_capacities

SUPPORT = 1.6  # spacings: of a face-centred cubic lattice (nearest 1.12) the 12 and 6 nearest neighbours
MIN_NEIGHBOURS = 10
SMOOTHING = 0.5  # c, in units of V tr(k J F^-1 F^-T) / spacing^2
CONDUCTION_SAFETY = 0.9  # of the stable step
_MIN_J = 0.1  # volume ratio: a smaller one is an error of the gradient


class PointConduction:
    """Conduction among all points of one particle. X (n,3) m: reference positions; spacing m; volume (n,) m3; law: LAW (1,)."""

    def __init__(self, X: np.ndarray, spacing: float, volume: np.ndarray, law: np.ndarray):
        self.volume, self.law, self.spacing = volume, law[0], spacing
        self.G, self.R = _fits(X, spacing)
        self._G1 = [abs(G).tocsr() for G in self.G]
        self._R1 = abs(self.R).tocsr()
        self._GT = [G.T.tocsr() for G in self.G]
        self._RT = self.R.T.tocsr()
        self._G1T, self._R1T = [G.T.tocsr() for G in self._G1], self._R1.T.tocsr()

    def share(self, time: float, x: np.ndarray, T: np.ndarray) -> np.ndarray:
        """Heat (n,) J that points gain by conduction over `time` s at positions x (n,3) m from temperatures T (n,) K.

        Explicit steps, as many as stability needs. The sum over the points is zero to rounding.
        """
        law = self.law
        D = self.volume[:, None, None] * _pulled_back(np.stack([G @ x for G in self.G], axis=2))
        gained, current, left = np.zeros(len(T)), np.array(T, float), time
        while left > 0.0:
            capacity = law["rho"] * self.volume * heat_capacities(law, current)
            kD = conductivities(law, current)[:, None, None] * D
            c = SMOOTHING * np.trace(kD, axis1=1, axis2=2) / self.spacing**2
            dt = left / ceil(left * self._fastest(kD, c, capacity) / (2.0 * CONDUCTION_SAFETY))
            flow = dt * self._flow(kD, c, current)
            gained += flow
            current += flow / capacity
            left = left - dt if left > 1.5 * dt else 0.0
        return gained

    def _flow(self, kD: np.ndarray, c: np.ndarray, T: np.ndarray) -> np.ndarray:
        """Heat that flows into points, W."""
        g = np.stack([G @ T for G in self.G], axis=1)
        q = np.einsum("nab,nb->na", kD, g)
        return -sum(GT @ q[:, a] for a, GT in enumerate(self._GT)) - self._RT @ (c * (self.R @ T))

    def _fastest(self, kD: np.ndarray, c: np.ndarray, capacity: np.ndarray) -> float:
        """A bound on the fastest decay, 1/s (Gershgorin, with the absolute values of the operators of `_flow`)."""
        ones = np.ones(len(c))
        g = np.stack([G @ ones for G in self._G1], axis=1)
        q = np.einsum("nab,nb->na", np.abs(kD), g)
        rows = sum(GT @ q[:, a] for a, GT in enumerate(self._G1T)) + self._R1T @ (c * (self._R1 @ ones))
        return float(np.max(rows / capacity))


def _fits(X: np.ndarray, spacing: float) -> tuple[list[csr_matrix], csr_matrix]:
    """Gradient operators along x, y, z (1/m), and the operator R of the excess over the estimate from the neighbours.

    Weighted least squares T_j = T_i + g . (X_j - X_i) for the gradients; the excess is T_i less the mean of T_j - g . (X_j - X_i).
    """
    n, tree = len(X), cKDTree(X)
    groups = [np.array(group) for group in tree.query_ball_point(X, SUPPORT * spacing)]
    for i, group in enumerate(groups):
        if len(group) < MIN_NEIGHBOURS + 1:
            groups[i] = np.asarray(tree.query(X[i], k=min(MIN_NEIGHBOURS + 1, n))[1])
    rows = np.repeat(np.arange(n), [len(group) for group in groups])
    columns = np.concatenate(groups)
    rows, columns = rows[columns != rows], columns[columns != rows]
    d = (X[columns] - X[rows]) / spacing
    w = np.clip(1.0 - np.linalg.norm(d, axis=1) / (1.2 * SUPPORT), 0.05, None) ** 2
    A = np.zeros((n, 3, 3))
    np.add.at(A, rows, w[:, None, None] * d[:, :, None] * d[:, None, :])
    gradient = w[:, None] * np.linalg.solve(A[rows], d[:, :, None])[:, :, 0] / spacing
    G = []
    for a in range(3):
        off = csr_matrix((gradient[:, a], (rows, columns)), shape=(n, n))
        G.append((off - _diagonal(np.bincount(rows, gradient[:, a], n))).tocsr())
    w /= np.bincount(rows, w, n)[rows]
    mean = csr_matrix((w, (rows, columns)), shape=(n, n))
    off = [_diagonal(np.bincount(rows, w * d[:, a], n) * spacing) @ G[a] for a in range(3)]
    return G, (identity(n, format="csr") - mean + off[0] + off[1] + off[2]).tocsr()


def _diagonal(values: np.ndarray) -> csr_matrix:
    n = len(values)
    return csr_matrix((values, (np.arange(n), np.arange(n))), shape=(n, n))


def _pulled_back(F: np.ndarray) -> np.ndarray:
    """J F^-1 F^-T (n,3,3) of deformation gradients F (n,3,3): cof(F)^T cof(F) / J."""
    a, b, c = F[:, :, 0], F[:, :, 1], F[:, :, 2]
    cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    J = np.maximum(np.einsum("ni,ni->n", a, cofactor[:, :, 0]), _MIN_J)
    return np.einsum("nia,nib->nab", cofactor, cofactor) / J[:, None, None]
