"""The passes of `particle.compiled_kernels` with residuals in place of hourglass control (`particle.enriched`)."""

from math import sqrt

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints, Laws, Matrix
from ..core.loops import ranges
from ..geometry.matrix_kernels import (
    ROUNDING,
    ZERO,
    add_outer,
    applied,
    inverse,
    matrix_of,
    product,
    sum_of,
    transposed,
    write_matrix,
)
from ..geometry.vector_kernels import apart, dot, vector_of
from .compiled_kernels import (
    J_MAX,
    J_MIN,
    LEAST_PAIRS,
    LEAST_POINTS,
    exchanged,
    flow,
    gradient_of,
    harden_and_press,
    lose,
    rotation,
    squared,
    stress_force,
    sum_forces,
    trial,
    viscosity,
    write_stress,
)  # fmt: skip
from .model import Deformation, Losses, Motion, Pairs, Residuals, Scheme, Sides, State

ACROSS = 10.0 / 9.0  # stiffness of a residual over G: mean over directions of 1 across a pair and 4/3 along it


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def _strain_residuals(
    i: int, s: Sides, m: Motion, F: Matrix, R: Matrix, plastic: Floats, residual: Floats
) -> tuple[float, float]:
    """Write the elastic residuals e = R^T (x_j - x_i - F (X_j - X_i)) - e_p of point i to its rows of residual, m.

    Returns sum w e^2 / sum w r^2, and sum w r^2 (1/m3).
    """
    total = span = 0.0
    for k in range(s.first[i], s.first[i + 1]):
        X0, X1, X2 = apart(m.X, i, s.neighbour[k])
        x0, x1, x2 = apart(m.x, i, s.neighbour[k])
        d0 = x0 - F[0] * X0 - F[1] * X1 - F[2] * X2
        d1 = x1 - F[3] * X0 - F[4] * X1 - F[5] * X2
        d2 = x2 - F[6] * X0 - F[7] * X1 - F[8] * X2
        e0 = R[0] * d0 + R[3] * d1 + R[6] * d2 - plastic[k, 0]
        e1 = R[1] * d0 + R[4] * d1 + R[7] * d2 - plastic[k, 1]
        e2 = R[2] * d0 + R[5] * d1 + R[8] * d2 - plastic[k, 2]
        residual[k, 0], residual[k, 1], residual[k, 2] = e0, e1, e2
        total += s.w[k] * (e0 * e0 + e1 * e1 + e2 * e2)
        span += s.w[k] * (X0 * X0 + X1 * X1 + X2 * X2)
    return total / span, span


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def _residual_forces(
    i: int, s: Sides, X: Floats, R: Matrix, back: float, stiffness: float, plastic: Floats, residual: Floats
) -> tuple[Matrix, float, float, float]:
    """Multiply the elastic residuals of point i by the factor `back` of the radial return, and compute their forces.

    plastic: plastic residuals, updated; residual: trial residuals in m, replaced by forces stiffness w R e in N. Returns
    sum f (x) (X_j - X_i), which is minus the derivative of their energy by F, and the moment sum e_p x f of the unrotated forces.
    """
    H = ZERO
    t0 = t1 = t2 = 0.0
    for k in range(s.first[i], s.first[i + 1]):
        e0, e1, e2 = vector_of(residual, k)
        p0, p1, p2 = (
            plastic[k, 0] + (1.0 - back) * e0,
            plastic[k, 1] + (1.0 - back) * e1,
            plastic[k, 2] + (1.0 - back) * e2,
        )
        plastic[k, 0], plastic[k, 1], plastic[k, 2] = p0, p1, p2
        c = stiffness * s.w[k] * back
        e0, e1, e2 = c * e0, c * e1, c * e2
        t0 += p1 * e2 - p2 * e1
        t1 += p2 * e0 - p0 * e2
        t2 += p0 * e1 - p1 * e0
        f = applied(R, e0, e1, e2)
        residual[k, 0], residual[k, 1], residual[k, 2] = f
        H = add_outer(H, f, apart(X, i, s.neighbour[k]))
    return H, t0, t1, t2


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def stress_points(
    lo: int, hi: int, dt: float, laws: Laws, scheme: Scheme, sides: Sides, m: Motion, d: Deformation, state: State, r: Residuals,
) -> int:  # fmt: skip
    """As `compiled_kernels.stress_points`, but with residuals. The strain increment follows from U at n and n+1, not from v.

    Deviator and residuals form one yield condition and return to it by one factor. Q receives -V J R sigma U^-1 plus the term that
    balances the forces of the residuals.
    """
    failed = -1
    for i in range(lo, hi):
        law = laws[state.law_of[i]]
        F, F_n, R_n = gradient_of(i, sides, m.x), matrix_of(d.F, i), matrix_of(d.R, i)
        R, U = rotation(F, R_n)
        B, J = inverse(U)
        if not J_MIN <= J <= J_MAX and failed < 0:
            failed = i
        write_matrix(d.F, i, F)
        write_matrix(d.R, i, R)
        # dt Udot B at n+1/2 is (U - U_n) ((U + U_n) / 2)^-1 = 4 U (U + U_n)^-1 - 2; the last term has no deviator
        both, _ = inverse(sum_of(U, product(transposed(R_n), F_n)))
        S = trial(state.stress, i, 8.0 * law.G, product(U, both))
        unseen, span = _strain_residuals(i, sides, m, F, R, r.plastic, r.force)
        square = squared(S) + 2.0 * ACROSS * law.G * law.G * unseen
        S, back, deps = flow(i, law, S, square, state.sigma_y)
        d.effective[i] = state.sigma_y[i] / scheme.H + deps
        r.unseen[i] = 0.5 * ACROSS * law.G * back * back * unseen
        mean = harden_and_press(i, dt, law, J, deps, state)
        xx, xy, xz, yy, yz, zz = write_stress(state.stress, i, S, mean)
        c = -scheme.V * J
        H, t0, t1, t2 = _residual_forces(i, sides, m.X, R, back, scheme.V * ACROSS * law.G / span, r.plastic, r.force)
        t0, t1, t2 = 0.5 * t0 / c, 0.5 * t1 / c, 0.5 * t2 / c  # a skew stress that balances their moment
        P = product(product(R, (xx, xy - t2, xz + t1, xy + t2, yy, yz - t0, xz - t1, yz + t0, zz)), B)
        for k in range(9):
            d.Q[i, k] = c * P[k] + H[k]
    return failed


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def pair_forces(
    lo: int, hi: int, dt: float, is_last: bool, scheme: Scheme, p: Pairs, m: Motion, d: Deformation, losses: Losses,
    residuals: Residuals, force: Floats,
) -> None:  # fmt: skip
    """As `compiled_kernels.pair_forces`, but with the forces of the residuals of both sides in place of hourglass control."""
    for k in range(lo, hi):
        i, j = p.points[k, 0], p.points[k, 1]
        x, v = apart(m.x, i, j), apart(m.v, i, j)
        r = sqrt(dot(x, x))
        f = stress_force(k, i, j, p.gradient, d.Q, apart(residuals.force, p.sides[k, 1], p.sides[k, 0]))
        viscous, _ = viscosity(scheme, p, k, r, dot(x, v))
        viscous *= 1.0 / (r + 0.01 * scheme.h)
        before, now = exchanged(dt, is_last, x, v, apart(m.v_half, i, j))
        lose(k, 0, dt, viscous, before, now, losses)
        force[k, 0], force[k, 1], force[k, 2] = f[0] + viscous * x[0], f[1] + viscous * x[1], f[2] + viscous * x[2]


@njit(cache=True, nogil=True)
def stress_of_all(team: Ints, n: int, failed: Ints, of_points: Arrays) -> None:
    """Do `stress_points` for n points in all threads. failed (PARTS,): the first point that fails in each part, or -1."""
    for lo, hi, part in ranges(team, 0, n, LEAST_POINTS):
        failed[part] = stress_points(lo, hi, *of_points)


@njit(cache=True, nogil=True)
def forces_of_all(team: Ints, n: int, of_pairs: Arrays, of_sum: Arrays) -> None:
    """Do `pair_forces` for all pairs and `sum_forces` for n points, in all threads."""
    for lo, hi, _ in ranges(team, 0, len(of_pairs[-1]), LEAST_PAIRS):
        pair_forces(lo, hi, *of_pairs)
    for lo, hi, _ in ranges(team, 1, n, LEAST_POINTS):
        sum_forces(lo, hi, *of_sum)
