"""Kernels of the conduction among points (`particle.heat`), over ranges [lo, hi) of points (numba).

D, kD: symmetric tensors xx yy zz yz xz xy. SI units.
"""

from math import sqrt
from typing import NamedTuple

from ..compiling import njit
from ..core.arrays import Floats, Ints, Laws, Symmetric, Vector
from ..core.loops import ranges
from ..geometry.matrix_kernels import ZERO, add_outer, applied, inverse
from ..geometry.vector_kernels import apart, dot
from ..physics.constitutive import conductivity, heat_capacity

LEAST_POINTS = 200  # in a range of a loop that threads share
SUPPORT = 1.6  # spacings: the 12 nearest and 6 second neighbours of a face-centred cubic lattice (nearest at 1.12)
SMOOTHING = 0.5  # c, in units of V tr(k J F^-1 F^-T) / spacing^2
LEAST_J = 0.1  # volume ratio: a smaller one is an error of the gradient


class Operators(NamedTuple):
    """The matrices G (components x, y, z, in 1/m) and R of `heat.PointConduction`, or their transposes, in compressed rows. Row i has
    the weights weights[start[i]:start[i + 1]] (m,4) for the points columns[start[i]:start[i + 1]]."""

    start: Ints
    columns: Ints
    weights: Floats


class Conduction(NamedTuple):
    """Arrays of n points. law_of (n,): number of the law of each point; volume (m3); reach (n,4): sums of the absolute weights in
    each row of G and R; D (n,6) m3: V J F^-1 F^-T; kD (n,6) W m/K; c (W/K); capacity (J/K); q (n,4): kD G T and c R T; T (K);
    gained (J): heat."""

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
            g0, g1, g2 = applied(B, -m0, -m1, -m2)  # of the point itself
            for s in range(G.start[i], G.start[i + 1]):
                is_own, c, d = G.columns[s] == i, w[s, 3], apart(X, i, G.columns[s])
                a = (g0, g1, g2) if is_own else applied(B, c * d[0], c * d[1], c * d[2])
                w[s, 0], w[s, 1], w[s, 2] = a
                w[s, 3] = (1.0 if is_own else -c / total) + (m0 * a[0] + m1 * a[1] + m2 * a[2]) / total
                for column in range(4):
                    reach[i, column] += abs(w[s, column])


@njit(cache=True, nogil=True, inline="always")
def _applied(a: Floats | Symmetric, g0: float, g1: float, g2: float) -> Vector:
    """Product of a symmetric tensor a (6,) and a vector (g0, g1, g2)."""
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
def weigh(lo: int, hi: int, laws: Laws, spacing: float, h: Conduction) -> None:
    """Write the conduction tensors kD, c and capacity at the temperatures T. Write also the largest flow for temperature differences
    of 1 K to q."""
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


@njit(cache=True, nogil=True)
def fastest(lo: int, hi: int, transposed: Operators, h: Conduction) -> float:
    """Upper bound on the fastest rate of decay, 1/s (Gershgorin, with absolute values of the operators)."""
    t, most = transposed, 0.0
    for i in range(lo, hi):
        total = 0.0
        for s in range(t.start[i], t.start[i + 1]):
            for d in range(4):
                total += abs(t.weights[s, d]) * h.q[t.columns[s], d]
        most = max(most, total / h.capacity[i])
    return most


@njit(cache=True, nogil=True)
def flow_of_points(lo: int, hi: int, G: Operators, h: Conduction) -> None:
    """Write kD G T and c R T to h.q."""
    for i in range(lo, hi):
        g0 = g1 = g2 = r = 0.0
        for s in range(G.start[i], G.start[i + 1]):
            t, w = h.T[G.columns[s]], G.weights[s]
            g0, g1, g2, r = g0 + w[0] * t, g1 + w[1] * t, g2 + w[2] * t, r + w[3] * t
        h.q[i, 0], h.q[i, 1], h.q[i, 2] = _applied(h.kD[i], g0, g1, g2)
        h.q[i, 3] = h.c[i] * r


@njit(cache=True, nogil=True)
def collect(lo: int, hi: int, dt: float, transposed: Operators, h: Conduction) -> None:
    """Add the heat of the flow q over dt s, -dt (G^T q[:, :3] + R^T q[:, 3]), to h.gained, and the rise of temperature to h.T."""
    t = transposed
    for i in range(lo, hi):
        a0 = a1 = a2 = r = 0.0
        for s in range(t.start[i], t.start[i + 1]):
            q, w = h.q[t.columns[s]], t.weights[s]
            a0, a1, a2, r = a0 + w[0] * q[0], a1 + w[1] * q[1], a2 + w[2] * q[2], r + w[3] * q[3]
        heat = dt * (-(a0 + a1 + a2) - r)
        h.gained[i] += heat
        h.T[i] += heat / h.capacity[i]


@njit(cache=True, nogil=True)
def prepare(
    team: Ints, n: int, laws: Laws, spacing: float, x: Floats, G: Operators, transposed: Operators, h: Conduction, rates: Floats,
) -> None:  # fmt: skip
    """Do `pull_back`, `weigh` and `fastest` for n points at x (n,3) m, in all threads. rates (PARTS,) 1/s: result of `fastest` for
    each part."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        pull_back(lo, hi, G, x, h)
        weigh(lo, hi, laws, spacing, h)
    for lo, hi, part in ranges(team, 1, n, LEAST_POINTS):
        rates[part] = fastest(lo, hi, transposed, h)


@njit(cache=True, nogil=True)
def conduct(team: Ints, n: int, dt: float, G: Operators, transposed: Operators, h: Conduction) -> None:
    """Do `flow_of_points` and `collect` for n points, in all threads."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        flow_of_points(lo, hi, G, h)
    for lo, hi, _ in ranges(team, 1, n, LEAST_POINTS):
        collect(lo, hi, dt, transposed, h)
