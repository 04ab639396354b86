"""The passes of `particle.compiled_kernels` with residuals in place of hourglass control (`particle.enriched`)."""

from math import sqrt

import numpy as np

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints, Laws
from ..core.loops import ranges
from ..geometry.matrix_kernels import ROUNDING
from ..geometry.vector_kernels import apart, dot
from .blocks import BLOCK, ROWS, block_of, deform, forces, gather, residuals, scatter, six_of, strain
from .compiled_kernels import (
    J_MAX,
    J_MIN,
    LEAST_POINTS,
    exchanged,
    flow,
    harden_and_press,
    lost,
    squared,
    viscosity,
)  # fmt: skip
from .model import Deformation, Losses, Motion, Residuals, Scheme, Sides, State

ACROSS = 10.0 / 9.0  # stiffness of a residual divided by G: mean of 1, 1 (two directions across a pair), 4/3 (along it)


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def stress_points(
    lo: int, hi: int, dt: float, laws: Laws, scheme: Scheme, s: Sides, m: Motion, d: Deformation, state: State, r: Residuals,
    side_force: Floats,
) -> int:  # fmt: skip
    """As `compiled_kernels.stress_points`, but with residuals. The strain increment follows from U at n and n+1, not from v.

    Deviator and residuals enter one yield condition, and one factor returns both to it. The forces of the sides come from the
    residuals, the stress, and a skew stress that balances their moment. `particle.blocks` computes all but the plastic flow.
    """
    failed = -1
    w = np.zeros((ROWS, BLOCK))
    b = block_of(w)
    S = b.S
    for first in range(lo, hi, BLOCK):
        most = gather(first, hi, laws, s, m, d, state, r.plastic, b)
        deform(most, b)
        strain(b)
        residuals(most, b)
        for c in range(min(BLOCK, hi - first)):
            i = first + c
            law, J = laws[state.law_of[i]], b.J[c]
            if not J_MIN <= J <= J_MAX and failed < 0:
                failed = i
            unseen = b.square[c] / b.span[c]
            trial = six_of(S, c)
            square = squared(trial) + 2.0 * ACROSS * law.G * law.G * unseen
            returned, back, deps = flow(i, law, trial, square, state.sigma_y)
            for k in range(6):
                S[k, c] = returned[k]
            r.unseen[i] = 0.5 * ACROSS * law.G * back * back * unseen
            b.back[c], b.mean[c] = back, harden_and_press(i, dt, law, J, deps, state)
        forces(most, scheme.V, ACROSS, b)
        scatter(first, hi, s, d, state, r.plastic, side_force, b)
    return failed


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def point_forces(
    lo: int, hi: int, dt: float, is_last: bool, scheme: Scheme, s: Sides, m: Motion, losses: Losses, side_force: Floats, f: Floats,
) -> None:  # fmt: skip
    """As `compiled_kernels.point_forces`, but without hourglass control."""
    for i in range(lo, hi):
        f0 = f1 = f2 = work = 0.0
        for k in range(s.first[i], s.first[i + 1]):
            j = s.neighbour[k]
            x, v = apart(m.x, i, j), apart(m.v, i, j)
            r = sqrt(dot(x, x))
            viscous, _ = viscosity(scheme, s.slope[k], s.c[k], r, dot(x, v))
            viscous *= 1.0 / (r + 0.01 * scheme.h)
            before, now = exchanged(dt, is_last, x, v, apart(m.v_half, i, j))
            work += lost(k, 0, dt, viscous, before, now, losses)
            own = apart(side_force, s.reverse[k], k)
            f0, f1, f2 = f0 + own[0] + viscous * x[0], f1 + own[1] + viscous * x[1], f2 + own[2] + viscous * x[2]
        f[i, 0], f[i, 1], f[i, 2] = f0, f1, f2
        losses.work[0, i] += work


@njit(cache=True, nogil=True)
def stress_of_all(team: Ints, n: int, failed: Ints, of_points: Arrays) -> None:
    """Do `stress_points` for n points in all threads. failed (PARTS,): the first point that fails in each part, or -1."""
    for lo, hi, part in ranges(team, 0, n, LEAST_POINTS):
        failed[part] = stress_points(lo, hi, *of_points)


@njit(cache=True, nogil=True)
def forces_of_all(team: Ints, n: int, of_points: Arrays) -> None:
    """Do `point_forces` for n points in all threads."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        point_forces(lo, hi, *of_points)
