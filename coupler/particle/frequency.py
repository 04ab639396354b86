"""Stable time step of the points of the enriched scheme: the operator of the power iteration for their highest frequency
(`EnrichedParticle.stable_dt`).

The smallest principal stretch is a poor estimate: a crushed point at the rim with few neighbours can have a low frequency, and a
point compressed from all sides has a higher one than its stretch suggests. As in `fe.stability`, a few iterations with the
linearised operator find the fastest mode. They start from the last vector plus a random motion of the stiffest points. The operator
is elastic: plastic flow only reduces the frequency. The safety factor (`Numerics.frequency`) allows for stress and viscosity (0.01
of critical damping).
"""

from typing import NamedTuple

from ..compiling import njit
from ..core.arrays import Floats, Ints, Laws
from ..core.loops import ranges
from ..geometry.matrix_kernels import ZERO, add_outer, applied, inverse, matrix_of, product, transposed
from ..geometry.vector_kernels import apart, dot, vector_of
from ..physics.constitutive import bulk_stiffness
from . import compiled_kernels as k
from .compiled_kernels import gradient_of
from .enriched_kernels import ACROSS
from .model import Sides

FIRST, NEXT = 40, 4  # iterations from a random vector, and from the vector of the last chunk of steps
LEAST_POINTS = 2000  # in a range of a shared loop
STIRRED = 0.3  # share of random motion in the first vector
GRID = 128.0  # steps are rounded down to powers of 2^(1 / GRID): then the last bits of sums over ranks have no effect on them


class Small(NamedTuple):
    """A small motion u (N,3) of the points, and the forces side_force (s,3) that it causes. N, s and the order of rows: see `model`."""

    u: Floats
    side_force: Floats


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
    """Pass 1 of `enriched_kernels`, linearised about F (N,9) and J (n,): write the forces of the sides for the small motion u of n
    points to `small`, in all threads. law_of (n,): law of each point."""
    for lo, hi, _ in ranges(team, 0, n, k.LEAST_POINTS):
        for i in range(lo, hi):
            law = laws[law_of[i]]
            G = law.G
            f = gradient_of(i, sides, small.u)
            span, H = 0.0, ZERO
            for row in range(sides.first[i], sides.first[i + 1]):
                d, u, w = apart(X, i, sides.neighbour[row]), apart(small.u, i, sides.neighbour[row]), sides.w[row]
                e = (
                    w * (u[0] - f[0] * d[0] - f[1] * d[1] - f[2] * d[2]),
                    w * (u[1] - f[3] * d[0] - f[4] * d[1] - f[5] * d[2]),
                    w * (u[2] - f[6] * d[0] - f[7] * d[1] - f[8] * d[2]),
                )
                small.side_force[row, 0], small.side_force[row, 1], small.side_force[row, 2] = e
                span, H = span + w * dot(d, d), add_outer(H, e, d)
            B, _ = inverse(matrix_of(F, i))
            e00, e01, e02, e10, e11, e12, e20, e21, e22 = product(f, B)
            mean = (bulk_stiffness(law, J[i]) * J[i] - 2.0 / 3.0 * G) * (e00 + e11 + e22)
            xy, xz, yz = G * (e01 + e10), G * (e02 + e20), G * (e12 + e21)
            sigma = mean + 2.0 * G * e00, xy, xz, xy, mean + 2.0 * G * e11, yz, xz, yz, mean + 2.0 * G * e22
            P, c, spring = product(sigma, transposed(B)), V * J[i], V * ACROSS * G / span
            for row in range(sides.first[i], sides.first[i + 1]):
                g, e = vector_of(sides.gradient, row), vector_of(small.side_force, row)
                for r in range(3):
                    q = (c * P[3 * r] - spring * H[3 * r]) * g[0] + (c * P[3 * r + 1] - spring * H[3 * r + 1]) * g[1]
                    small.side_force[row, r] = spring * e[r] + q + (c * P[3 * r + 2] - spring * H[3 * r + 2]) * g[2]
