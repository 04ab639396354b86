"""Heat conduction among the points of the particle: Fourier's law with the fixed reference neighbours.

Gradients in the reference configuration, g = G T, are moving least squares over the neighbours. They are exact for linear fields,
also at the free surface; so is the deformation gradient F = G x. Conduction in the deformed body is conduction in the reference
body with the conductivity k J F^-1 F^-T. The heat flow into the points is minus the derivative, by the temperatures T, of

    sum V g . (k J F^-1 F^-T) g / 2  +  sum c (R T)^2 / 2.

The second term (c: SMOOTHING) damps fields that alternate from point to point, for which the first one is zero. R T is the
temperature of a point less its estimate from the neighbours and their gradient. It is zero for a linear field, so that its
contribution falls with the square of the spacing. Both terms are sums of squares: conduction conserves heat to rounding and only
reduces differences of temperature. The surface is adiabatic. Symmetric tensors D, kD: xx yy zz yz xz xy.
"""

from math import ceil, sqrt
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..compiling import njit
from ..core import safety
from ..core.arrays import Floats, Ints, Laws, Symmetric, Vector
from ..core.loops import PARTS, ranges
from ..core.threads import together
from ..geometry.matrix_kernels import ZERO, add_outer, applied, inverse
from ..geometry.points import points_near
from ..geometry.vector_kernels import apart, dot
from ..physics.constitutive import conductivity, heat_capacity

LEAST = 11  # smallest number of points in the fit of a gradient, including the point itself
LEAST_POINTS = 200  # in a range of a loop that threads share
SUPPORT = 1.6  # spacings: the 12 nearest and 6 second neighbours of a face-centred cubic lattice (nearest at 1.12)
SMOOTHING = 0.5  # c, in units of V tr(k J F^-1 F^-T) / spacing^2
LEAST_J = 0.1  # smallest volume ratio; smaller values are errors of the gradient and replaced by this one


class Operators(NamedTuple):
    """The matrices G (components x, y, z, in 1/m) and R of `PointConduction`, or their transposes, in compressed rows. Row i has
    the weights weights[start[i]:start[i + 1]] (m,4) for the points columns[start[i]:start[i + 1]]."""

    start: Ints
    columns: Ints
    weights: Floats


class Conduction(NamedTuple):
    """Arrays of n points. law_of (n,): index of the law of each point; volume (m3); reach (n,4): sums of the absolute weights in each
    row of G and R; D (n,6) m3: V J F^-1 F^-T; kD (n,6) W m2/K: conductivity times D; c (W/K): factor of the damping term; capacity
    (J/K); q (n,4): kD G T (W m) and c R T (W); T (K); gained (J): heat. D, kD: xx yy zz yz xz xy."""

    law_of: Ints
    volume: Floats
    reach: Floats
    D: Floats
    kD: Floats
    c: Floats
    capacity: Floats
    q: Floats
    T: Floats
    gained: Floats


class PointConduction:
    """Conduction among all points of one particle. X (n,3) m: reference positions; spacing (m); volume (n,) m3; law (k,): LAW
    records; law_of (n,): index of the law of each point; default: the first law for all points."""

    def __init__(
        self, X: np.ndarray, spacing: float, volume: np.ndarray, law: np.ndarray, law_of: np.ndarray | None = None
    ):
        n, near = len(X), points_near(cKDTree(X), X, SUPPORT * spacing, LEAST, LEAST)
        self.law, self.spacing = law, spacing
        start, columns = near.indptr.astype(np.uint32), near.indices.astype(np.uint32)
        reach, weights = np.zeros((n, 4)), np.zeros((len(columns), 4))
        self.operators = Operators(start, columns, weights)
        together(fit, n, spacing, X, self.operators, reach)
        near.data = np.arange(len(columns))
        back = near.tocsc()
        self._transposed = Operators(back.indptr.astype(np.uint32), back.indices.astype(np.uint32), weights[back.data])
        (D, kD), (c, capacity, T, gained) = np.zeros((2, n, 6)), np.zeros((4, n))
        law_of = np.zeros(n, np.int32) if law_of is None else law_of
        self._flow = Conduction(law_of, volume, reach, D, kD, c, capacity, np.zeros((n, 4)), T, gained)

    def share(self, time: float, x: np.ndarray, T: np.ndarray) -> np.ndarray:
        """Heat (n,) J that points gain by conduction over `time` s. x (n,3) m: positions; T (n,) K: temperatures before.

        Explicit steps, as many as stability requires. The sum over all points is zero to rounding.
        """
        n, left, flow, operators = len(T), time, self._flow, (self.operators, self._transposed)
        flow.T[:], flow.gained[:] = T, 0.0
        while left > 0.0:
            rates = np.zeros(PARTS)
            together(prepare, n, self.law, self.spacing, x, *operators, flow, rates)
            dt = left / ceil(left * rates.max() / (2.0 * safety.CONDUCTION))
            together(conduct, n, dt, *operators, flow)
            left = left - dt if left > 1.5 * dt else 0.0
        return flow.gained.copy()


@njit(cache=True, nogil=True, error_model="numpy")
def fit(team: Ints, n: int, spacing: float, X: Floats, G: Operators, reach: Floats) -> None:
    """Write the weights of G and R of n points at X (n,3) m to G, and the sums of their absolute values to reach (n,4), in all threads.

    G: weighted least squares T_j = T_i + g . (X_j - X_i). R: T_i less the weighted mean of T_j - g . (X_j - X_i).
    """
    w = G.weights
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        for i in range(lo, hi):
            A, total, m0, m1, m2 = ZERO, 0.0, 0.0, 0.0, 0.0
            for s in range(G.start[i], G.start[i + 1]):
                d = apart(X, i, G.columns[s])
                if G.columns[s] != i:
                    w[s, 3] = max(1.0 - sqrt(dot(d, d)) / (1.2 * SUPPORT * spacing), 0.05) ** 2
                f = w[s, 3] * d[0], w[s, 3] * d[1], w[s, 3] * d[2]
                A, total, m0, m1, m2 = add_outer(A, f, d), total + w[s, 3], m0 + f[0], m1 + f[1], m2 + f[2]
            B, _ = inverse(A)
            g0, g1, g2 = applied(B, -m0, -m1, -m2)  # weights of the point itself
            for s in range(G.start[i], G.start[i + 1]):
                is_own, c, d = G.columns[s] == i, w[s, 3], apart(X, i, G.columns[s])
                a = (g0, g1, g2) if is_own else applied(B, c * d[0], c * d[1], c * d[2])
                w[s, 0], w[s, 1], w[s, 2] = a
                w[s, 3] = (1.0 if is_own else -c / total) + (m0 * a[0] + m1 * a[1] + m2 * a[2]) / total
                for column in range(4):
                    reach[i, column] += abs(w[s, column])


@njit(cache=True, nogil=True, inline="always")
def _applied(a: Floats | Symmetric, g0: float, g1: float, g2: float) -> Vector:
    """Product of a symmetric tensor a (6,), xx yy zz yz xz xy, and a vector (g0, g1, g2)."""
    return a[0] * g0 + a[5] * g1 + a[4] * g2, a[5] * g0 + a[1] * g1 + a[3] * g2, a[4] * g0 + a[3] * g1 + a[2] * g2


@njit(cache=True, nogil=True, error_model="numpy")
def pull_back(lo: int, hi: int, G: Operators, x: Floats, h: Conduction) -> None:
    """Write V J F^-1 F^-T = V cof(F)^T cof(F) / J, with F = G x, to h.D."""
    D = h.D
    for i in range(lo, hi):
        f00 = f01 = f02 = f10 = f11 = f12 = f20 = f21 = f22 = 0.0
        for s in range(G.start[i], G.start[i + 1]):
            j = G.columns[s]
            g0, g1, g2 = G.weights[s, 0], G.weights[s, 1], G.weights[s, 2]
            f00, f01, f02 = f00 + g0 * x[j, 0], f01 + g1 * x[j, 0], f02 + g2 * x[j, 0]
            f10, f11, f12 = f10 + g0 * x[j, 1], f11 + g1 * x[j, 1], f12 + g2 * x[j, 1]
            f20, f21, f22 = f20 + g0 * x[j, 2], f21 + g1 * x[j, 2], f22 + g2 * x[j, 2]
        a0, a1, a2 = f11 * f22 - f21 * f12, f21 * f02 - f01 * f22, f01 * f12 - f11 * f02
        b0, b1, b2 = f12 * f20 - f22 * f10, f22 * f00 - f02 * f20, f02 * f10 - f12 * f00
        c0, c1, c2 = f10 * f21 - f20 * f11, f20 * f01 - f00 * f21, f00 * f11 - f10 * f01
        J = max(f00 * a0 + f10 * a1 + f20 * a2, LEAST_J)
        V = h.volume[i]
        D[i, 0], D[i, 1] = V * ((a0 * a0 + a1 * a1 + a2 * a2) / J), V * ((b0 * b0 + b1 * b1 + b2 * b2) / J)
        D[i, 2], D[i, 3] = V * ((c0 * c0 + c1 * c1 + c2 * c2) / J), V * ((b0 * c0 + b1 * c1 + b2 * c2) / J)
        D[i, 4], D[i, 5] = V * ((a0 * c0 + a1 * c1 + a2 * c2) / J), V * ((a0 * b0 + a1 * b1 + a2 * b2) / J)


@njit(cache=True, nogil=True)
def prepare(
    team: Ints, n: int, laws: Laws, spacing: float, x: Floats, G: Operators, transposed: Operators, h: Conduction, rates: Floats,
) -> None:  # fmt: skip
    """Do `pull_back` for n points at x (n,3) m, and write kD, c and capacity at the temperatures h.T, in all threads. Write to h.q an
    upper bound of the flow for temperatures between -1 and 1 K. Write to rates (PARTS,) 1/s, for each part of the points, the bound on
    the fastest rate of decay that follows from h.q (Gershgorin, with absolute values of the operators)."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        pull_back(lo, hi, G, x, h)
        for i in range(lo, hi):
            law = laws[h.law_of[i]]
            h.capacity[i] = law.rho * h.volume[i] * heat_capacity(law, h.T[i])
            k = conductivity(law, h.T[i])
            for d in range(6):
                h.kD[i, d] = k * h.D[i, d]
            h.c[i] = SMOOTHING * (h.kD[i, 0] + h.kD[i, 1] + h.kD[i, 2]) / (spacing * spacing)
            most = h.kD[i, 0], h.kD[i, 1], h.kD[i, 2], abs(h.kD[i, 3]), abs(h.kD[i, 4]), abs(h.kD[i, 5])
            h.q[i, 0], h.q[i, 1], h.q[i, 2] = _applied(most, h.reach[i, 0], h.reach[i, 1], h.reach[i, 2])
            h.q[i, 3] = h.c[i] * h.reach[i, 3]
    for lo, hi, part in ranges(team, 1, n, LEAST_POINTS):
        rates[part] = 0.0
        for i in range(lo, hi):
            total = 0.0
            for s in range(transposed.start[i], transposed.start[i + 1]):
                for d in range(4):
                    total += abs(transposed.weights[s, d]) * h.q[transposed.columns[s], d]
            rates[part] = max(rates[part], total / h.capacity[i])


@njit(cache=True, nogil=True)
def conduct(team: Ints, n: int, dt: float, G: Operators, transposed: Operators, h: Conduction) -> None:
    """Write the flow kD G T and c R T of n points to h.q, and add its heat over dt s, -dt (G^T q[:, :3] + R^T q[:, 3]), to h.gained,
    and the rise of temperature to h.T, in all threads."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        for i in range(lo, hi):
            g0 = g1 = g2 = r = 0.0
            for s in range(G.start[i], G.start[i + 1]):
                t, w = h.T[G.columns[s]], G.weights[s]
                g0, g1, g2, r = g0 + w[0] * t, g1 + w[1] * t, g2 + w[2] * t, r + w[3] * t
            h.q[i, 0], h.q[i, 1], h.q[i, 2] = _applied(h.kD[i], g0, g1, g2)
            h.q[i, 3] = h.c[i] * r
    for lo, hi, _ in ranges(team, 1, n, LEAST_POINTS):
        for i in range(lo, hi):
            a0 = a1 = a2 = r = 0.0
            for s in range(transposed.start[i], transposed.start[i + 1]):
                q, w = h.q[transposed.columns[s]], transposed.weights[s]
                a0, a1, a2, r = a0 + w[0] * q[0], a1 + w[1] * q[1], a2 + w[2] * q[2], r + w[3] * q[3]
            heat = dt * (-(a0 + a1 + a2) - r)
            h.gained[i] += heat
            h.T[i] += heat / h.capacity[i]
