"""Stable time step of the points of the enriched scheme: their highest frequency by power iteration.

The smallest principal stretch alone tells it badly: a point at the rim with few neighbours may be crushed and yet be slow, and
one that is pressed from all sides is faster than its stretch says. As in `fe.stability` a few iterations with the linearised
operator, started from the last vector with motion of the stiffest points stirred in, find the fastest mode. The operator is
elastic: plastic flow only makes it softer; stress and viscosity (0.01 of critical damping) are
left to the safety factor (`Numerics.frequency`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints, Laws, Matrix
from ..core.loops import ranges
from ..core.threads import share, together
from ..physics.constitutive import bulk_stiffness
from . import compiled_kernels as k

LONGEST = 3.0  # times the bound of the smallest stretch: the most that is ever taken
Fetch = Callable[..., None]
FIRST, NEXT = 40, 4  # iterations from nothing, and from the vector of the chunk of steps before
LEAST_POINTS = 2000  # in a range of a shared loop
STIRRED = 0.3  # share of random motion in the vector that an iteration starts from
GRID = 128.0  # steps are powers of 2^(1 / GRID): sums over ranks differ in their last bits, steps do not


@njit(cache=True, nogil=True)
def _row(F: Floats, i: int) -> Matrix:
    """Matrix i of F (n,9)."""
    return F[i, 0], F[i, 1], F[i, 2], F[i, 3], F[i, 4], F[i, 5], F[i, 6], F[i, 7], F[i, 8]


@njit(cache=True, nogil=True, error_model="numpy")
def stiffness_points(lo: int, hi: int, start: Ints, gradient: Floats, F: Floats, stiffness: Floats) -> None:
    """sum |F^-T g|^2 (1/m2) of each point over its gradients g (sides,3), into stiffness (n,): how stiff its cell is."""
    for i in range(lo, hi):
        (b00, b01, b02, b10, b11, b12, b20, b21, b22), _ = k.inverse(_row(F, i))
        total = 0.0
        for s in range(start[i], start[i + 1]):
            g0, g1, g2 = gradient[s, 0], gradient[s, 1], gradient[s, 2]
            t0, t1, t2 = (
                b00 * g0 + b10 * g1 + b20 * g2,
                b01 * g0 + b11 * g1 + b21 * g2,
                b02 * g0 + b12 * g1 + b22 * g2,
            )
            total += t0 * t0 + t1 * t1 + t2 * t2
        stiffness[i] = total


@njit(cache=True, nogil=True, error_model="numpy")
def linear_stress(
    lo: int, hi: int, laws: Laws, V: float, start: Ints, neighbour: Ints, u: Floats, w: Floats, X: Floats, gradient: Floats,
    F: Floats, J: Floats, Q: Floats, residual: Floats,
) -> None:  # fmt: skip
    """Pass 1 of `compiled_kernels.stress_points`, linearised about F (N,9) for a small motion u (N,3): Q (N,9), residual (sides,3)."""
    law = laws[0]
    for i in range(lo, hi):
        u0, u1, u2 = u[i, 0], u[i, 1], u[i, 2]
        f00 = f01 = f02 = f10 = f11 = f12 = f20 = f21 = f22 = 0.0
        span = 0.0
        for s in range(start[i], start[i + 1]):
            j = neighbour[s]
            g0, g1, g2 = gradient[s, 0], gradient[s, 1], gradient[s, 2]
            d0, d1, d2 = u[j, 0] - u0, u[j, 1] - u1, u[j, 2] - u2
            f00 += d0 * g0
            f01 += d0 * g1
            f02 += d0 * g2
            f10 += d1 * g0
            f11 += d1 * g1
            f12 += d1 * g2
            f20 += d2 * g0
            f21 += d2 * g1
            f22 += d2 * g2
            X0, X1, X2 = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1], X[j, 2] - X[i, 2]
            span += w[s] * (X0 * X0 + X1 * X1 + X2 * X2)
        h00 = h01 = h02 = h10 = h11 = h12 = h20 = h21 = h22 = 0.0
        spring = V * k.ACROSS * law.G / span
        for s in range(start[i], start[i + 1]):
            j = neighbour[s]
            X0, X1, X2 = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1], X[j, 2] - X[i, 2]
            c = spring * w[s]
            e0 = c * (u[j, 0] - u0 - f00 * X0 - f01 * X1 - f02 * X2)
            e1 = c * (u[j, 1] - u1 - f10 * X0 - f11 * X1 - f12 * X2)
            e2 = c * (u[j, 2] - u2 - f20 * X0 - f21 * X1 - f22 * X2)
            residual[s, 0], residual[s, 1], residual[s, 2] = e0, e1, e2
            h00 += e0 * X0
            h01 += e0 * X1
            h02 += e0 * X2
            h10 += e1 * X0
            h11 += e1 * X1
            h12 += e1 * X2
            h20 += e2 * X0
            h21 += e2 * X1
            h22 += e2 * X2
        B, _ = k.inverse(_row(F, i))
        e00, e01, e02, e10, e11, e12, e20, e21, e22 = k.product((f00, f01, f02, f10, f11, f12, f20, f21, f22), B)
        trace = e00 + e11 + e22
        mean = (bulk_stiffness(law, J[i]) * J[i] - 2.0 / 3.0 * law.G) * trace
        G = law.G
        sxy, sxz, syz = G * (e01 + e10), G * (e02 + e20), G * (e12 + e21)
        c = -V * J[i]
        P = k.product(
            (
                c * (mean + 2.0 * G * e00), c * sxy, c * sxz, c * sxy, c * (mean + 2.0 * G * e11), c * syz,
                c * sxz, c * syz, c * (mean + 2.0 * G * e22),
            ),
            k.transposed(B),
        )  # fmt: skip
        H = (h00, h01, h02, h10, h11, h12, h20, h21, h22)
        for r in range(9):
            Q[i, r] = P[r] + H[r]


@njit(cache=True, nogil=True, error_model="numpy")
def linear_forces(
    lo: int, hi: int, pairs: Ints, Q: Floats, gradients: Floats, residual: Floats, rows: Ints, force: Floats
) -> None:
    """Pass 2 of `compiled_kernels.pair_forces` without viscosity: force (pairs,3) on the first point of each pair."""
    for s in range(lo, hi):
        i, j, p, q = pairs[s, 0], pairs[s, 1], rows[s, 0], rows[s, 1]
        a0, a1, a2, b0, b1, b2 = (
            gradients[s, 0], gradients[s, 1], gradients[s, 2], gradients[s, 3], gradients[s, 4], gradients[s, 5],
        )  # fmt: skip
        for d in range(3):
            force[s, d] = (
                residual[p, d] - residual[q, d] + Q[j, 3 * d] * b0 + Q[j, 3 * d + 1] * b1 + Q[j, 3 * d + 2] * b2
                - Q[i, 3 * d] * a0 - Q[i, 3 * d + 1] * a1 - Q[i, 3 * d + 2] * a2
            )  # fmt: skip


@njit(cache=True, nogil=True)
def stress_of_all(team: Ints, n: int, of_points: Arrays) -> None:
    """`linear_stress` of n points in all threads."""
    for lo, hi, _ in ranges(team, 0, n, k.LEAST_POINTS):
        linear_stress(lo, hi, *of_points)


@njit(cache=True, nogil=True)
def forces_of_all(team: Ints, n: int, of_pairs: Arrays, of_sum: Arrays) -> None:
    """`linear_forces` of all pairs, and their sums at n points, in all threads."""
    for lo, hi, _ in ranges(team, 0, len(of_pairs[0]), k.LEAST_PAIRS):
        linear_forces(lo, hi, *of_pairs)
    for lo, hi, _ in ranges(team, 1, n, k.LEAST_POINTS):
        k.sum_forces(lo, hi, *of_sum)


@dataclass(frozen=True)
class Sides:
    """The neighbours of this rank's n points, as the passes of the particle read them.

    first (n+1,), neighbour, w, gradient (sides,3) 1/m: those of each point; X (N,3) m. pairs (pairs,2), signed: rows of each point's
    pairs; gradients (pairs,6) of both points, rows (pairs,2) of both sides, of `count` with the copies of other ranks' sides.
    """

    first: Ints
    neighbour: Ints
    w: Floats
    gradient: Floats
    X: Floats
    pairs: Ints
    signed: Ints
    gradients: Floats
    rows: Ints
    count: int


class PointFrequency:
    """Power iteration on the points of one rank, which take part together with those of the others."""

    def __init__(
        self, law: Laws, volume: float, sides: Sides, random: np.ndarray, gather: Callable[[float], list[float]], fetch: Fetch,
        slow: Callable[[np.ndarray], None],
    ):  # fmt: skip
        """law (1,); volume m3 of each point; random (n,3): random motion of the points. gather(number): that of each rank with points.
        fetch(points, sides): bring rows of points (N,k), and of sides (count,3) where they are given, from other ranks.
        slow(forces (n,3) N): `inertia.CellInertia.slow`."""
        self._slow = slow
        self._law, self._volume, self._sides, self._random = law, volume, sides, random
        self._gather, self._fetch = gather, fetch
        self._mass = volume * float(law[0]["rho"])
        n, everyone = len(random), len(sides.X)
        self._u, self._Q, self._residual = np.zeros((everyone, 3)), np.zeros((everyone, 9)), np.zeros((sides.count, 3))
        self._force, self._f, self._stiffness = np.zeros((len(sides.pairs), 3)), np.zeros((n, 3)), np.zeros(n)

    def longest_step(self, F: np.ndarray, J: np.ndarray, mode: np.ndarray) -> float:
        """The step in s at which the points of all ranks become unstable, NaN where there is none.

        F (N,9), J (n,): deformation gradients and volume ratios. mode (n,3) s: the vector of the chunk before, as long as its result,
        zero at the beginning; the new one is written. While the step falls, that of the end of the next chunk is returned,
        extrapolated from the last two.
        """
        n, s = len(J), self._sides
        share(lambda lo, hi: stiffness_points(lo, hi, s.first, s.gradient, F, self._stiffness), n, LEAST_POINTS)
        largest = max(self._gather(float(self._stiffness.max(initial=0.0))))
        stirred = (self._stiffness / largest)[:, None] ** 2 * self._random
        stirred *= STIRRED / self._size(stirred)
        before = self._size(mode)
        u = mode / before + stirred if before > 0.0 else self._random
        omega2 = 0.0
        for _ in range(NEXT if before > 0.0 else FIRST):
            u = self._accelerations(F, J, u / self._size(u))
            omega2 = self._size(u)
        limit = 2.0 / np.sqrt(omega2)
        if not limit > 0.0:
            return np.nan
        mode[:] = u * (limit / omega2)
        ahead = limit * min(1.0, limit / before) if before > 0.0 else limit
        return float(2.0 ** (np.floor(GRID * np.log2(ahead)) / GRID))

    def _size(self, a: np.ndarray) -> float:
        """Root of the sum of squares over all points of all ranks."""
        return float(np.sqrt(sum(self._gather(float(np.einsum("ij,ij->", a, a))))))

    def _accelerations(self, F: np.ndarray, J: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Minus the accelerations (n,3) that a small motion u (n,3) makes."""
        n, s = len(J), self._sides
        self._u[:n] = u
        self._fetch(self._u)

        together(
            stress_of_all, n,
            (self._law, self._volume, s.first, s.neighbour, self._u, s.w, s.X, s.gradient, F, J, self._Q, self._residual),
        )  # fmt: skip
        self._fetch(self._Q, self._residual)
        together(
            forces_of_all, n, (s.pairs, self._Q, s.gradients, self._residual, s.rows, self._force),
            (s.first, s.signed, self._force, self._f),
        )  # fmt: skip
        self._slow(self._f)
        return self._f / -self._mass
