"""Stable time step of the points of the enriched scheme: their highest frequency by power iteration.

The smallest principal stretch is a poor estimate: a crushed point at the rim with few neighbours can have a low frequency, and a
point compressed from all sides has a higher one than its stretch suggests. As in `fe.stability`, a few iterations with the
linearised operator find the fastest mode. They start from the last vector plus a random motion of the stiffest points. The operator
is elastic: plastic flow only reduces the frequency. The safety factor (`Numerics.frequency`) allows for stress and viscosity (0.01
of critical damping).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..compiling import njit
from ..core.arrays import Floats, Ints, Laws
from ..core.loops import PARTS, ranges
from ..core.threads import share, together
from ..geometry.matrix_kernels import ZERO, add_outer, applied, inverse, matrix_of, product, transposed
from ..geometry.vector_kernels import apart, dot
from ..physics.constitutive import bulk_stiffness
from . import compiled_kernels as k
from .compiled_kernels import gradient_of, stress_force
from .enriched_kernels import ACROSS
from .model import Pairs, Sides

Fetch = Callable[..., None]
FIRST, NEXT = 40, 4  # iterations from a random vector, and from the vector of the last chunk of steps
LEAST_POINTS = 2000  # in a range of a shared loop
STIRRED = 0.3  # share of random motion in the first vector
GRID = 128.0  # steps are powers of 2^(1 / GRID): so they do not depend on the last bits of sums over ranks


class Small(NamedTuple):
    """A small motion u (N,3), and the response of the operator: Q (N,9), residual (sides,3), force (pairs,3), as in `model`."""

    u: Floats
    Q: Floats
    residual: Floats
    force: Floats


@njit(cache=True, nogil=True, error_model="numpy")
def stiffness_points(lo: int, hi: int, s: Sides, F: Floats, stiffness: Floats) -> None:
    """Write sum |F^-T g|^2 over the gradients g of each point to stiffness (n,) 1/m2. It is a measure of the stiffness of the point's
    cell."""
    for i in range(lo, hi):
        B, _ = inverse(matrix_of(F, i))
        total = 0.0
        for row in range(s.first[i], s.first[i + 1]):
            t = applied(transposed(B), s.gradient[row, 0], s.gradient[row, 1], s.gradient[row, 2])
            total += dot(t, t)
        stiffness[i] = total


@njit(cache=True, nogil=True, error_model="numpy")
def linear_stress(
    team: Ints, n: int, laws: Laws, law_of: Ints, V: float, sides: Sides, X: Floats, F: Floats, J: Floats, small: Small
) -> None:
    """Pass 1 of `enriched_kernels`, linearised about F (N,9) and J (n,): write Q and residual of the small motion u of n points to
    `small`, in all threads. law_of (n,): law of each point."""
    for lo, hi, _ in ranges(team, 0, n, k.LEAST_POINTS):
        for i in range(lo, hi):
            law = laws[law_of[i]]
            G = law.G
            f = gradient_of(i, sides, small.u)
            span = 0.0
            for row in range(sides.first[i], sides.first[i + 1]):
                d = apart(X, i, sides.neighbour[row])
                span += sides.w[row] * dot(d, d)
            H, spring = ZERO, V * ACROSS * G / span
            for row in range(sides.first[i], sides.first[i + 1]):
                d, u = apart(X, i, sides.neighbour[row]), apart(small.u, i, sides.neighbour[row])
                c = spring * sides.w[row]
                e = (
                    c * (u[0] - f[0] * d[0] - f[1] * d[1] - f[2] * d[2]),
                    c * (u[1] - f[3] * d[0] - f[4] * d[1] - f[5] * d[2]),
                    c * (u[2] - f[6] * d[0] - f[7] * d[1] - f[8] * d[2]),
                )
                small.residual[row, 0], small.residual[row, 1], small.residual[row, 2] = e
                H = add_outer(H, e, d)
            B, _ = inverse(matrix_of(F, i))
            e00, e01, e02, e10, e11, e12, e20, e21, e22 = product(f, B)
            mean = (bulk_stiffness(law, J[i]) * J[i] - 2.0 / 3.0 * G) * (e00 + e11 + e22)
            xy, xz, yz = G * (e01 + e10), G * (e02 + e20), G * (e12 + e21)
            sigma = mean + 2.0 * G * e00, xy, xz, xy, mean + 2.0 * G * e11, yz, xz, yz, mean + 2.0 * G * e22
            P = product(sigma, transposed(B))
            for r in range(9):
                small.Q[i, r] = -V * J[i] * P[r] + H[r]


@njit(cache=True, nogil=True, error_model="numpy")
def linear_forces(team: Ints, n: int, sides: Sides, p: Pairs, small: Small, total: Floats) -> None:
    """Pass 2 of `enriched_kernels` without viscosity: write forces to `small`, and their sums at n points to total (n,3), in all
    threads."""
    for lo, hi, _ in ranges(team, 0, len(p.points), k.LEAST_PAIRS):
        for row in range(lo, hi):
            residual = apart(small.residual, p.sides[row, 1], p.sides[row, 0])
            f = stress_force(row, p.points[row, 0], p.points[row, 1], p.gradient, small.Q, residual)
            small.force[row, 0], small.force[row, 1], small.force[row, 2] = f
    for lo, hi, _ in ranges(team, 1, n, k.LEAST_POINTS):
        k.sum_forces(lo, hi, sides, small.force, total)


@njit(cache=True, nogil=True)
def stir(team: Ints, stiffest: float, stiffness: Floats, random: Floats, mode: Floats, u: Floats, sums: Floats) -> None:
    """Write the random motion (n,3) of the points, weighted with (stiffness / stiffest)^2, to u, and the squares of u and of the mode
    (n,3) to sums (PARTS,2), part by part, in all threads."""
    for lo, hi, part in ranges(team, 0, len(stiffness), LEAST_POINTS):
        own = before = 0.0
        for i in range(lo, hi):
            weight = (stiffness[i] / stiffest) ** 2
            for d in range(3):
                u[i, d] = weight * random[i, d]
                own += u[i, d] * u[i, d]
                before += mode[i, d] * mode[i, d]
        sums[part, 0], sums[part, 1] = own, before


@njit(cache=True, nogil=True)
def combine(team: Ints, a: float, x: Floats, b: float, y: Floats, out: Floats, sums: Floats) -> None:
    """Write a x + b y to out (n,3), and its square to sums (PARTS,), part by part, in all threads."""
    for lo, hi, part in ranges(team, 0, len(x), LEAST_POINTS):
        square = 0.0
        for i in range(lo, hi):
            for d in range(3):
                out[i, d] = a * x[i, d] + b * y[i, d]
                square += out[i, d] * out[i, d]
        sums[part] = square


@njit(cache=True, nogil=True)
def respond(team: Ints, size: float, mass: Floats, f: Floats, out: Floats, sums: Floats) -> None:
    """Write -f / (mass size) to out (n,3), and its square to sums (PARTS,), part by part, in all threads. mass (n,)."""
    for lo, hi, part in ranges(team, 0, len(f), LEAST_POINTS):
        square = 0.0
        for i in range(lo, hi):
            a = -1.0 / (mass[i] * size)
            for d in range(3):
                out[i, d] = a * f[i, d]
                square += out[i, d] * out[i, d]
        sums[part] = square


class PointFrequency:
    """Power iteration on the points of one rank, together with the points of all other ranks."""

    def __init__(
        self, laws: tuple[Laws, Ints], volume: float, sides: Sides, pairs: Pairs, X: np.ndarray, count: int, random: np.ndarray,
        gather: Callable[[float], list[float]], fetch: Fetch, slow: Callable[[np.ndarray], None],
    ):  # fmt: skip
        """laws: LAW records, and number (n,) of the law of each point; volume (m3): volume of each point; X (N,3) m; count: number of
        sides, including those of other ranks; random (n,3): random motion of the points; gather(number): the numbers of all ranks with
        points; fetch(points, sides): get rows of points (N,k), and of sides (count,3) if given, from other ranks; slow(forces (n,3)
        N): `inertia.CellInertia.slow`."""
        self._slow = slow
        self._laws, self._volume, self._sides, self._pairs, self._X = laws, volume, sides, pairs, X
        self._random = random
        self._gather, self._fetch = gather, fetch
        self._mass = volume * laws[0]["rho"][laws[1]]
        n, everyone = len(random), len(X)
        self._small = Small(
            np.zeros((everyone, 3)), np.zeros((everyone, 9)), np.zeros((count, 3)), np.zeros((len(pairs.points), 3))
        )
        self._f, self._stiffness = np.zeros((n, 3)), np.zeros(n)

    def longest_step(self, F: np.ndarray, J: np.ndarray, mode: np.ndarray) -> float:
        """The time step (s) at which the points of all ranks become unstable; NaN if the frequency is not finite.

        F (N,9), J (n,): deformation gradients and volume ratios; mode (n,3) s: vector of the last chunk, with its step as norm, zero at
        the start; updated. While the step decreases, the returned step is extrapolated from the last two to the end of the next chunk.
        """
        share(lambda lo, hi: stiffness_points(lo, hi, self._sides, F, self._stiffness), len(J), LEAST_POINTS)
        largest = max(self._gather(float(self._stiffness.max(initial=0.0))))
        u, sums = self._small.u[: len(J)], np.zeros((PARTS, 2))
        together(stir, largest, self._stiffness, self._random, mode, u, sums)
        stirred, before = (self._total(parts) for parts in sums.T)
        if before > 0.0:
            size = self._combine(1.0 / before, mode, STIRRED / stirred, u, u)
        else:
            size = self._combine(1.0, self._random, 0.0, self._random, u)
        for _ in range(NEXT if before > 0.0 else FIRST):
            size = self._accelerate(F, J, size)
        omega2 = size
        limit = 2.0 / np.sqrt(omega2)
        if not limit > 0.0:
            return np.nan
        self._combine(limit / omega2, u, 0.0, u, mode)
        ahead = limit * min(1.0, limit / before) if before > 0.0 else limit
        return float(2.0 ** (np.floor(GRID * np.log2(ahead)) / GRID))

    def _combine(self, a: float, x: np.ndarray, b: float, y: np.ndarray, out: np.ndarray) -> float:
        """Write a x + b y to out (n,3). Returns the root of its sum of squares over all points of all ranks."""
        sums = np.zeros(PARTS)
        together(combine, a, x, b, y, out, sums)
        return self._total(sums)

    def _total(self, parts: np.ndarray) -> float:
        """Root of the sum of squares (PARTS,) over all ranks."""
        return float(np.sqrt(sum(self._gather(float(parts.sum())))))

    def _accelerate(self, F: np.ndarray, J: np.ndarray, size: float) -> float:
        """Replace the small motion u of the points, of this size, by minus the accelerations that it causes, divided by `size`.
        Returns the new size."""
        n, small = len(J), self._small
        self._fetch(small.u)
        together(linear_stress, n, *self._laws, self._volume, self._sides, self._X, F, J, small)
        self._fetch(small.Q, small.residual)
        together(linear_forces, n, self._sides, self._pairs, small, self._f)
        self._slow(self._f)
        sums = np.zeros(PARTS)
        together(respond, size, self._mass, self._f, small.u[:n], sums)
        return self._total(sums)
