"""Two passes of total-Lagrangian SPH in MACHDYN's form, compiled: stress of each point, then forces of each pair.

The letters are those of the equations (Ganzenmueller 2015, Comput. Methods Appl. Mech. Eng. 286, 87-106): X, x reference and
present positions; V volume; g_ij = w K^-1 (X_j - X_i) with w = W'(|X_j - X_i|) / |X_j - X_i|, K = sum_j w (X_j - X_i) (x) (X_j -
X_i); F = sum_j (x_j - x_i) (x) g_ij and its rate Fdot; R the rotation of F = R U; J = det F; sigma the unrotated Cauchy stress.

Each kernel works on a range [lo, hi) of points or of pairs and writes only its own rows: any division among threads gives the same
numbers to the last bit. `particle.model` describes the arrays. SI units.
"""

from math import sqrt

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints, Laws, Matrix, Symmetric, Vector
from ..core.loops import ranges
from ..geometry.matrix_kernels import (
    ROUNDING,
    ZERO,
    add_outer,
    applied,
    inverse,
    matrix_of,
    polar,
    product,
    transposed,
    write_matrix,
)  # fmt: skip
from ..geometry.vector_kernels import add, apart, dot, vector_of
from ..physics.constitutive import Law, harden, hugoniot_pressure, mie_gruneisen, norm, on
from .model import Deformation, Losses, Motion, Pairs, Scheme, Sides, State

LEAST_POINTS, LEAST_PAIRS = 100, 600  # in a range of a loop that threads share
TURNED = 1e-14  # rad: with a smaller correction the rotation is exact to rounding
NEAR = 1e-8  # rad: after a smaller correction the rotation is exact to rounding: the next one would be about its square
FAR = 0.3  # rad: for a larger first correction the iteration restarts from Newton's polar decomposition
J_MIN, J_MAX = 0.2, 2.0  # volume ratios that MACHDYN accepts
PLASTIC = 1e-3  # effective plastic strain of LAMMPS above which MACHDYN's hourglass control is viscous
LEAST_ERROR = 0.05  # smallest hourglass error in the viscous control
SLOW = 0.01  # largest closing velocity in the viscosity, over the wave speed


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def rotation(F: Matrix, R: Matrix) -> tuple[Matrix, Matrix]:
    """Rotation R and stretch U of F = R U, by iteration from the rotation R of the last step.

    With A = R^T F and S = sym A, omega solves (tr(S) 1 - S) omega = axial vector of A. R <- R Cayley(omega) until omega vanishes.
    """
    A = product(transposed(R), F)
    for sweep in range(30):
        a00, a01, a02, a10, a11, a12, a20, a21, a22 = A
        s01, s02, s12 = 0.5 * (a01 + a10), 0.5 * (a02 + a20), 0.5 * (a12 + a21)
        t0, t1, t2 = a21 - a12, a02 - a20, a10 - a01
        W, _ = inverse((a11 + a22, -s01, -s02, -s01, a00 + a22, -s12, -s02, -s12, a00 + a11))
        o0, o1, o2 = applied(W, t0, t1, t2)
        square = o0 * o0 + o1 * o1 + o2 * o2
        if square < TURNED * TURNED:
            break
        if sweep == 0 and not square < FAR * FAR:
            R = polar(F)
            A = product(transposed(R), F)
            continue
        c = 1.0 / (4.0 + square)  # Cayley: 1 + (4 w + 2 w w) / (4 + |omega|^2), w the skew matrix of omega
        x, y, z = 4.0 * c * o0, 4.0 * c * o1, 4.0 * c * o2
        c *= 2.0
        R = product(
            R,
            (
                1.0 - c * (o1 * o1 + o2 * o2), c * o0 * o1 - z, c * o0 * o2 + y,
                c * o0 * o1 + z, 1.0 - c * (o0 * o0 + o2 * o2), c * o1 * o2 - x,
                c * o0 * o2 - y, c * o1 * o2 + x, 1.0 - c * (o0 * o0 + o1 * o1),
            ),
        )  # fmt: skip
        A = product(transposed(R), F)
        if square < NEAR * NEAR:
            break
    return R, A


_inlined = njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING, error_model="numpy")


@_inlined
def gradient_of(i: int, s: Sides, u: Floats) -> Matrix:
    """Reference gradient of a field u (N,3) at point i: sum over j of (u_j - u_i) (x) g_ij."""
    F = ZERO
    for k in range(s.first[i], s.first[i + 1]):
        F = add_outer(F, apart(u, i, s.neighbour[k]), vector_of(s.gradient, k))
    return F


@_inlined
def trial(stress: Floats, i: int, c: float, L: Matrix) -> Symmetric:
    """Trial deviator of point i, xx xy xz yy yz zz: deviator of its stress plus c times the deviator of sym L."""
    mean_rate = (L[0] + L[4] + L[8]) / 3.0
    mean = (stress[i, 0] + stress[i, 3] + stress[i, 5]) / 3.0
    return (
        stress[i, 0] - mean + c * (L[0] - mean_rate), stress[i, 1] + 0.5 * c * (L[1] + L[3]), stress[i, 2] + 0.5 * c * (L[2] + L[6]),
        stress[i, 3] - mean + c * (L[4] - mean_rate), stress[i, 4] + 0.5 * c * (L[5] + L[7]),
        stress[i, 5] - mean + c * (L[8] - mean_rate),
    )  # fmt: skip


@_inlined
def squared(S: Symmetric) -> float:
    """The double contraction S : S of a symmetric tensor."""
    return S[0] * S[0] + S[3] * S[3] + S[5] * S[5] + 2.0 * (S[1] * S[1] + S[2] * S[2] + S[4] * S[4])


@_inlined
def flow(i: int, law: Law, S: Symmetric, square: float, sigma_y: Floats) -> tuple[Symmetric, float, float]:
    """Radial return of a trial deviator S to the yield stress of the last step. square: S : S, including residuals. Returns the new
    deviator, its ratio to S, and the increment of plastic strain."""
    q, sy = sqrt(1.5 * square), sigma_y[i]
    deps, back = 0.0, 1.0
    if q > sy:
        deps, back = (q - sy) / (3.0 * law.G), sy / q
        S = back * S[0], back * S[1], back * S[2], back * S[3], back * S[4], back * S[5]
    return S, back, deps


@_inlined
def harden_and_press(i: int, dt: float, law: Law, J: float, deps: float, a: State) -> float:
    """Update the plastic state and the pressure of point i. Returns the mean stress, from the Hugoniot pressure of step n+1 and the
    thermal pressure of step n."""
    mean = -hugoniot_pressure(law, J)
    if on(law.Gamma0) and law.Gamma0 > 0.0:
        mean += (hugoniot_pressure(law, a.J[i]) - a.p[i]) * a.J[i] / J
    sy, eta = a.sigma_y[i], norm(a.eps_gradient, i) if on(law.gradient_length) else 0.0
    a.eps_p[i], a.rate[i], a.T[i], a.sigma_y[i], work = harden(
        law, deps, dt, J, sy, sy, a.eps_p[i], a.rate[i], a.T[i], eta
    )
    heat = 0.0
    if on(law.taylor_quinney) and on(law.expansion):
        heat = law.expansion * law.taylor_quinney * work
    a.p[i], a.energy[i] = mie_gruneisen(law, a.J[i], J, a.p[i], a.energy[i], heat)
    a.J[i] = J
    a.work[i] += work
    return mean


@_inlined
def write_stress(stress: Floats, i: int, S: Symmetric, mean: float) -> Symmetric:
    """Write the stress S + mean of a point to row i of `stress`, and return it."""
    sigma = S[0] + mean, S[1], S[2], S[3] + mean, S[4], S[5] + mean
    for k in range(6):
        stress[i, k] = sigma[k]
    return sigma


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def stress_points(
    lo: int, hi: int, dt: float, laws: Laws, scheme: Scheme, sides: Sides, m: Motion, d: Deformation, state: State
) -> int:
    """Pass 1: deformation, stress and plastic state of points from n to n+1. Returns the first point that fails, or -1.

    Q receives -V J R sigma U^-1. A point fails if J leaves [J_MIN, J_MAX]. As in MACHDYN the deviator returns to the yield stress
    of the last step, and the thermal pressure lags by one step.
    """
    failed = -1
    for i in range(lo, hi):
        law, F = laws[state.law_of[i]], gradient_of(i, sides, m.x)
        R, U = rotation(F, matrix_of(d.R, i))
        B, J = inverse(U)
        if not J_MIN <= J <= J_MAX and failed < 0:
            failed = i
        write_matrix(d.F, i, F)
        write_matrix(d.R, i, R)
        # rate of deformation in the unrotated frame, D = sym(R^T Fdot B) = sym(Udot B)
        D = product(product(transposed(R), gradient_of(i, sides, m.v)), B)
        S = trial(state.stress, i, 2.0 * law.G * dt, D)
        S, _, deps = flow(i, law, S, squared(S), state.sigma_y)
        d.effective[i] = state.sigma_y[i] / scheme.H + deps
        mean = harden_and_press(i, dt, law, J, deps, state)
        xx, xy, xz, yy, yz, zz = write_stress(state.stress, i, S, mean)
        P = product(product(R, (xx, xy, xz, xy, yy, yz, xz, yz, zz)), B)
        for k in range(9):
            d.Q[i, k] = -scheme.V * J * P[k]
    return failed


@_inlined
def stress_force(k: int, i: int, j: int, gradient: Floats, Q: Floats, f: Vector) -> Vector:
    """The force f + Q_j g_ji - Q_i g_ij of pair k: `f` plus the force from the stresses of both points."""
    g = gradient[k]
    return (
        f[0] + Q[j, 0] * g[3] + Q[j, 1] * g[4] + Q[j, 2] * g[5] - (Q[i, 0] * g[0] + Q[i, 1] * g[1] + Q[i, 2] * g[2]),
        f[1] + Q[j, 3] * g[3] + Q[j, 4] * g[4] + Q[j, 5] * g[5] - (Q[i, 3] * g[0] + Q[i, 4] * g[1] + Q[i, 5] * g[2]),
        f[2] + Q[j, 6] * g[3] + Q[j, 7] * g[4] + Q[j, 8] * g[5] - (Q[i, 6] * g[0] + Q[i, 7] * g[1] + Q[i, 8] * g[2]),
    )


@_inlined
def viscosity(scheme: Scheme, p: Pairs, k: int, r: float, approach: float) -> tuple[float, float]:
    """Viscous force (N) of pair k, and Monaghan's mu (m/s), about h dx . dv / r^2. approach: dx . dv, m2/s."""
    c, soft = p.c[k], 1.0 / (r + 0.1 * scheme.h)
    mu = scheme.h * min(max(approach * soft, -SLOW * c), SLOW * c) * soft
    return p.slope[k] * (scheme.Q2 * mu - scheme.Q1 * c) * mu, mu


@_inlined
def hourglass(scheme: Scheme, p: Pairs, k: int, r: float, x: Vector, e: Vector, is_plastic: bool, mu: float) -> float:
    """MACHDYN's force (N) against the hourglass error e (m) of pair k: viscous in plastic flow, else elastic."""
    along, r0 = dot(e, x), p.r0[k]
    if is_plastic:
        if not mu * along < 0.0:
            return 0.0
        return -p.slope[k] * max(sqrt(dot(e, e)) / r0, LEAST_ERROR) * scheme.hourglass * p.c[k] * mu
    along = 0.5 * min(max(along, -0.1 * r), 0.1 * r) / (r + 0.1 * scheme.h)
    return -scheme.V * scheme.V * p.W[k] * p.E[k] * scheme.hourglass * along / (r0 * r0 + 0.01 * scheme.h * scheme.h)


@_inlined
def exchanged(dt: float, is_last: bool, x: Vector, v: Vector, v_half: Vector) -> tuple[float, float]:
    """The products x . v_half (m2/s) with x at n and at n+1, for the work of pair forces (`lose`). In the last step of a chunk the
    second one includes the following half step."""
    now = dot(x, v_half)
    before = now - dt * dot(v_half, v_half)  # x_j - x_i at n is its value at n+1 less dt v_half
    return before, now + dot(x, v) if is_last else now


@_inlined
def lose(k: int, kind: int, dt: float, strength: float, before: float, now: float, losses: Losses) -> None:
    """Add the work of a force, dt (f_n + f_n+1) / 2 . v_n+1/2, to the losses of pair k. before, now: `exchanged`."""
    losses.work[k, kind] += 0.5 * dt * (losses.strength[k, kind] * before + strength * now)
    losses.strength[k, kind] = strength


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def pair_forces(
    lo: int, hi: int, dt: float, is_last: bool, scheme: Scheme, p: Pairs, m: Motion, d: Deformation, losses: Losses, force: Floats,
) -> None:  # fmt: skip
    """Pass 2: the force on the first point of each pair, force (m,3) N; the force on the second point is opposite.

    f = Q_j g_ji - Q_i g_ij + viscosity + hourglass control, the last two along x_j - x_i. The hourglass error is
    (F_i + F_j) (X_j - X_i) / 2 - (x_j - x_i). is_last: last step of a chunk, whose forces also act in the half step after it.
    """
    for k in range(lo, hi):
        i, j = p.points[k, 0], p.points[k, 1]
        x, v = apart(m.x, i, j), apart(m.v, i, j)
        r = sqrt(dot(x, x))
        viscous, mu = viscosity(scheme, p, k, r, dot(x, v))
        X0, X1, X2 = apart(m.X, i, j)
        e = (
            0.5 * ((d.F[i, 0] + d.F[j, 0]) * X0 + (d.F[i, 1] + d.F[j, 1]) * X1 + (d.F[i, 2] + d.F[j, 2]) * X2) - x[0],
            0.5 * ((d.F[i, 3] + d.F[j, 3]) * X0 + (d.F[i, 4] + d.F[j, 4]) * X1 + (d.F[i, 5] + d.F[j, 5]) * X2) - x[1],
            0.5 * ((d.F[i, 6] + d.F[j, 6]) * X0 + (d.F[i, 7] + d.F[j, 7]) * X1 + (d.F[i, 8] + d.F[j, 8]) * X2) - x[2],
        )
        is_plastic = max(d.effective[i], d.effective[j]) > PLASTIC
        control = hourglass(scheme, p, k, r, x, e, is_plastic, mu)
        per_length = 1.0 / (r + 0.01 * scheme.h)
        viscous, control = viscous * per_length, control * per_length
        before, now = exchanged(dt, is_last, x, v, apart(m.v_half, i, j))
        lose(k, 0, dt, viscous, before, now, losses)
        lose(k, 1, dt, control, before, now, losses)
        f, a = stress_force(k, i, j, p.gradient, d.Q, (0.0, 0.0, 0.0)), viscous + control
        force[k, 0], force[k, 1], force[k, 2] = f[0] + a * x[0], f[1] + a * x[1], f[2] + a * x[2]


@njit(cache=True, nogil=True)
def grow_gradients(n: int, grown: Floats, s: Sides, d: Deformation, eps_gradient: Floats) -> None:
    """Add the gradient of the plastic strain of a chunk of steps to eps_gradient (n,3) 1/m of n points.

    grown (N,): plastic strain of the chunk. The gradient is taken in the current configuration and stored in the unrotated frame,
    R^T F^-T = U^-1, as Huang et al. (2004) integrate it.
    """
    for i in range(n):
        a = b = c = 0.0
        for k in range(s.first[i], s.first[i + 1]):
            u = grown[s.neighbour[k]] - grown[i]
            a, b, c = a + u * s.gradient[k, 0], b + u * s.gradient[k, 1], c + u * s.gradient[k, 2]
        B, _ = inverse(product(transposed(matrix_of(d.R, i)), matrix_of(d.F, i)))
        a, b, c = applied(B, a, b, c)
        add(eps_gradient, i, a, b, c)


@njit(cache=True, nogil=True)
def green_lagrange(lo: int, hi: int, F: Floats, strain: Floats) -> None:
    """Write the Green-Lagrange strain of deformation gradients F (n,9) to strain (n,6), in the order xx yy zz xy xz yz."""
    for i in range(lo, hi):
        f = F[i]
        strain[i, 0] = 0.5 * (f[0] * f[0] + f[3] * f[3] + f[6] * f[6] - 1.0)
        strain[i, 1] = 0.5 * (f[1] * f[1] + f[4] * f[4] + f[7] * f[7] - 1.0)
        strain[i, 2] = 0.5 * (f[2] * f[2] + f[5] * f[5] + f[8] * f[8] - 1.0)
        strain[i, 3] = 0.5 * (f[0] * f[1] + f[3] * f[4] + f[6] * f[7])
        strain[i, 4] = 0.5 * (f[0] * f[2] + f[3] * f[5] + f[6] * f[8])
        strain[i, 5] = 0.5 * (f[1] * f[2] + f[4] * f[5] + f[7] * f[8])


@njit(cache=True, nogil=True)
def share_losses(team: Ints, n: int, s: Sides, losses: Losses, heat: Floats, sums: Floats) -> None:
    """Give half of the energy loss of each pair to each of its two points, in all threads. Writes heat (n,) J. Adds to sums (PARTS,2)
    J, for each part, the losses by viscosity and by hourglass control. Afterwards the losses are zero."""
    for lo, hi, part in ranges(team, 0, n, LEAST_POINTS):
        for i in range(lo, hi):
            viscous = control = 0.0
            for k in range(s.first[i], s.first[i + 1]):
                row = s.pair[k] if s.pair[k] >= 0 else ~s.pair[k]
                viscous += 0.5 * losses.work[row, 0]
                control += 0.5 * losses.work[row, 1]
            heat[i] = viscous + control
            sums[part, 0] += viscous
            sums[part, 1] += control
    for lo, hi, _ in ranges(team, 1, len(losses.work), LEAST_PAIRS):
        losses.work[lo:hi] = 0.0
        losses.strength[lo:hi] = 0.0


@njit(cache=True, nogil=True)
def sum_forces(lo: int, hi: int, s: Sides, force: Floats, f: Floats) -> None:
    """Write the sum of the pair forces on each point to f (n,3)."""
    for i in range(lo, hi):
        f0 = f1 = f2 = 0.0
        for k in range(s.first[i], s.first[i + 1]):
            row = s.pair[k]
            if row >= 0:
                f0 += force[row, 0]
                f1 += force[row, 1]
                f2 += force[row, 2]
            else:
                row = ~row
                f0 -= force[row, 0]
                f1 -= force[row, 1]
                f2 -= force[row, 2]
        f[i, 0], f[i, 1], f[i, 2] = f0, f1, f2


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
