"""The passes of `particle.compiled_kernels` with residuals in place of hourglass control (`particle.enriched`)."""

from math import sqrt

import numpy as np

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints, Laws
from ..core.loops import ranges
from ..geometry.matrix_kernels import ROUNDING
from ..geometry.vector_kernels import add, apart, dot
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
from .model import Deformation, Losses, Motion, Residuals, Scheme, Sides, State, Step

ACROSS = 10.0 / 9.0  # stiffness of a residual divided by G: mean of 1, 1 (two directions across a pair), 4/3 (along it)


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def add_viscosity(
    lo: int, hi: int, step: Step, scheme: Scheme, s: Sides, m: Motion, losses: Losses, side_force: Floats
) -> None:
    """Add the viscous force of each pair to the row of side_force that belongs to the point with the smaller number. Write half (J) of
    the energy that this force dissipates to column 3 of the row."""
    for i in range(lo, hi):
        for k in range(s.later[i], s.first[i + 1]):
            j = s.neighbour[k]
            x, v_half = apart(m.x, i, j), apart(m.v_half, i, j)
            r, approach = sqrt(dot(x, x)), dot(x, apart(m.v, i, j))
            strength, _ = viscosity(scheme, s.slope[k], s.c[k], r, approach)
            strength *= 1.0 / (r + 0.01 * scheme.h)
            add(side_force, k, strength * x[0], strength * x[1], strength * x[2])
            before, now = exchanged(step, approach, dot(x, v_half), dot(v_half, v_half))
            side_force[k, 3] = lost(step.dt, losses.strength[0, k], strength, before, now)
            losses.strength[0, k] = strength


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def stress_points(
    lo: int, hi: int, step: Step, laws: Laws, scheme: Scheme, s: Sides, m: Motion, d: Deformation, state: State,
    losses: Losses, r: Residuals, side_force: Floats,
) -> int:  # fmt: skip
    """As `compiled_kernels.stress_points`, but with residuals, and with viscosity. The strain increment follows from U at n and n+1,
    not from v.

    Deviator and residuals enter one yield condition, and one factor returns both to it. The forces of the sides come from the
    residuals, the stress, and a skew stress that balances their moment. `particle.blocks` computes all of that but the plastic flow.
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
            b.back[c], b.mean[c] = back, harden_and_press(i, step.dt, law, J, deps, state)
        forces(most, scheme.V, ACROSS, b)
        scatter(first, hi, s, d, state, r.plastic, side_force, b)
        add_viscosity(first, min(first + BLOCK, hi), step, scheme, s, m, losses, side_force)
    return failed


@njit(cache=True, nogil=True)
def point_forces(lo: int, hi: int, s: Sides, side_force: Floats, f: Floats, work: Floats) -> None:
    """Pass 2: write the sum over j of side_force_ij - side_force_ji, columns 0 to 2, to f (n,3) N for each point i. Add column 3 (J) of
    both sides of its pairs to work (n,)."""
    for i in range(lo, hi):
        f0 = f1 = f2 = energy = 0.0
        for k in range(s.first[i], s.first[i + 1]):
            other = s.reverse[k]
            own = apart(side_force, other, k)
            f0, f1, f2 = f0 + own[0], f1 + own[1], f2 + own[2]
            energy += side_force[k, 3] + side_force[other, 3]
        f[i, 0], f[i, 1], f[i, 2] = f0, f1, f2
        work[i] += energy


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
