"""Two passes of total-Lagrangian SPH in MACHDYN's form, compiled: stress of each point, then its force.

The letters are those of the equations (Ganzenmueller 2015, Comput. Methods Appl. Mech. Eng. 286, 87-106): X, x reference and
present positions; V volume; g_ij = w K^-1 (X_j - X_i) with w = W'(|X_j - X_i|) / |X_j - X_i|, K = sum_j w (X_j - X_i) (x) (X_j -
X_i); F = sum_j (x_j - x_i) (x) g_ij and its rate Fdot; R the rotation of F = R U; J = det F; sigma the unrotated Cauchy stress.

Each kernel works on a range [lo, hi) of points and writes only their rows and those of their sides: any division among threads gives
the same numbers to the last bit. `particle.model` describes the arrays. SI units.
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
from .model import Control, Deformation, Losses, Motion, Scheme, Sides, State, Step

LEAST_POINTS = 100  # in a range of a loop that threads share
SWEEPS = 30  # of the iteration for a rotation, at most
TURNED = 1e-14  # rad: with a smaller correction the rotation is exact to rounding
NEAR = 1e-8  # rad: after a smaller correction the rotation is exact to rounding, because the next correction is about its square
FAR = 0.3  # rad: for a larger first correction the iteration restarts from Newton's polar decomposition
J_MIN, J_MAX = 0.2, 2.0  # volume ratios that MACHDYN accepts
PLASTIC = 1e-3  # effective plastic strain of LAMMPS above which MACHDYN's hourglass control is viscous
LEAST_ERROR = 0.05  # smallest hourglass error in the viscous control
SLOW = 0.01  # limit of the closing velocity in the viscosity, divided by the wave speed


_inlined = njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING, error_model="numpy")


@_inlined
def correction(A: Matrix) -> tuple[float, float, float, float]:
    """Components of the rotation vector omega that makes A = R^T F nearly symmetric, and |omega|^2. With S = sym A, omega solves
    (tr(S) 1 - S) omega = axial vector of A - A^T."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = A
    s01, s02, s12 = 0.5 * (a01 + a10), 0.5 * (a02 + a20), 0.5 * (a12 + a21)
    W, _ = inverse((a11 + a22, -s01, -s02, -s01, a00 + a22, -s12, -s02, -s12, a00 + a11))
    o0, o1, o2 = applied(W, a21 - a12, a02 - a20, a10 - a01)
    return o0, o1, o2, o0 * o0 + o1 * o1 + o2 * o2


@_inlined
def cayley(o0: float, o1: float, o2: float) -> Matrix:
    """Rotation 1 + (4 w + 2 w w) / (4 + |omega|^2), w the skew matrix of omega."""
    c = 1.0 / (4.0 + o0 * o0 + o1 * o1 + o2 * o2)
    x, y, z = 4.0 * c * o0, 4.0 * c * o1, 4.0 * c * o2
    c *= 2.0
    return (
        1.0 - c * (o1 * o1 + o2 * o2), c * o0 * o1 - z, c * o0 * o2 + y,
        c * o0 * o1 + z, 1.0 - c * (o0 * o0 + o2 * o2), c * o1 * o2 - x,
        c * o0 * o2 - y, c * o1 * o2 + x, 1.0 - c * (o0 * o0 + o1 * o1),
    )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def rotation(F: Matrix, R: Matrix) -> tuple[Matrix, Matrix]:
    """Rotation R and stretch U of F = R U, by iteration from the rotation R of the last step: R <- R Cayley(omega) until the
    `correction` omega of A = R^T F vanishes."""
    A = product(transposed(R), F)
    for sweep in range(SWEEPS):
        o0, o1, o2, square = correction(A)
        if square < TURNED * TURNED:
            break
        R = product(R, cayley(o0, o1, o2)) if sweep > 0 or square < FAR * FAR else polar(F)
        A = product(transposed(R), F)
        if square < NEAR * NEAR:
            break
    return R, A


@_inlined
def gradient_of(i: int, s: Sides, u: Floats) -> Matrix:
    """Reference gradient of a field u (N,3) at point i: sum over j of (u_j - u_i) (x) g_ij."""
    F = ZERO
    for k in range(s.first[i], s.first[i + 1]):
        F = add_outer(F, apart(u, i, s.neighbour[k]), vector_of(s.gradient, k))
    return F


@_inlined
def six(stress: Floats, i: int) -> Symmetric:
    """Row i of stress (n,6), as a tuple."""
    return stress[i, 0], stress[i, 1], stress[i, 2], stress[i, 3], stress[i, 4], stress[i, 5]


@_inlined
def trial(S: Symmetric, c: float, L: Matrix) -> Symmetric:
    """Trial deviator, xx xy xz yy yz zz: deviator of the stress S plus c times the deviator of sym L."""
    rate, mean = (L[0] + L[4] + L[8]) / 3.0, (S[0] + S[3] + S[5]) / 3.0
    return (
        S[0] - mean + c * (L[0] - rate), S[1] + 0.5 * c * (L[1] + L[3]), S[2] + 0.5 * c * (L[2] + L[6]),
        S[3] - mean + c * (L[4] - rate), S[4] + 0.5 * c * (L[5] + L[7]), S[5] - mean + c * (L[8] - rate),
    )  # fmt: skip


@_inlined
def squared(S: Symmetric) -> float:
    """The double contraction S : S of a symmetric tensor."""
    return S[0] * S[0] + S[3] * S[3] + S[5] * S[5] + 2.0 * (S[1] * S[1] + S[2] * S[2] + S[4] * S[4])


@_inlined
def flow(i: int, law: Law, S: Symmetric, square: float, sigma_y: Floats) -> tuple[Symmetric, float, float]:
    """Radial return of a trial deviator S to the yield stress of the last step. square (Pa2): S : S, plus the term of the residuals
    if the scheme has them. Returns the new deviator, its ratio to S, and the increment of plastic strain."""
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
    lo: int, hi: int, dt: float, laws: Laws, scheme: Scheme, s: Sides, m: Motion, d: Deformation, state: State, side_force: Floats,
) -> int:  # fmt: skip
    """Pass 1: deformation, stress and plastic state of points from n to n+1. Returns the first point that fails, or -1.

    Writes side_force = V J R sigma U^-1 g of the sides of the points. A point fails if J leaves [J_MIN, J_MAX]. As in MACHDYN the
    deviator returns to the yield stress of the last step, and the thermal pressure lags by one step.
    """
    failed = -1
    for i in range(lo, hi):
        law, F = laws[state.law_of[i]], gradient_of(i, s, m.x)
        R, U = rotation(F, matrix_of(d.R, i))
        B, J = inverse(U)
        if not J_MIN <= J <= J_MAX and failed < 0:
            failed = i
        write_matrix(d.F, i, F)
        write_matrix(d.R, i, R)
        # rate of deformation in the unrotated frame, D = sym(R^T Fdot B) = sym(Udot B)
        D = product(product(transposed(R), gradient_of(i, s, m.v)), B)
        S = trial(six(state.stress, i), 2.0 * law.G * dt, D)
        S, _, deps = flow(i, law, S, squared(S), state.sigma_y)
        d.effective[i] = state.sigma_y[i] / scheme.H + deps
        mean = harden_and_press(i, dt, law, J, deps, state)
        xx, xy, xz, yy, yz, zz = write_stress(state.stress, i, S, mean)
        P = product(product(R, (xx, xy, xz, xy, yy, yz, xz, yz, zz)), B)
        c = scheme.V * J
        for k in range(s.first[i], s.first[i + 1]):
            g0, g1, g2 = vector_of(s.gradient, k)
            side_force[k, 0], side_force[k, 1], side_force[k, 2] = applied(P, c * g0, c * g1, c * g2)
    return failed


@_inlined
def viscosity(scheme: Scheme, slope: float, c: float, r: float, approach: float) -> tuple[float, float]:
    """Viscous force (N) of a side, positive: attraction; Monaghan's mu (m/s), about h dx . dv / r^2. approach (m2/s): dx . dv."""
    soft = 1.0 / (r + 0.1 * scheme.h)
    mu = scheme.h * min(max(approach * soft, -SLOW * c), SLOW * c) * soft
    return slope * (scheme.Q2 * mu - scheme.Q1 * c) * mu, mu


@_inlined
def hourglass(
    scheme: Scheme, slope: float, c: float, r0: float, WE: float, r: float, x: Vector, e: Vector, is_plastic: bool, mu: float
) -> float:  # fmt: skip
    """MACHDYN's hourglass force (N), attraction positive; viscous in plastic flow, else elastic. e (m): error; WE: W E of `Control`."""
    along = dot(e, x)
    if is_plastic:
        viscous = -slope * max(sqrt(dot(e, e)) / r0, LEAST_ERROR) * scheme.hourglass * c * mu
        return viscous if mu * along < 0.0 else 0.0
    along = 0.5 * min(max(along, -0.1 * r), 0.1 * r) / (r + 0.1 * scheme.h)
    return -scheme.V * scheme.V * WE * scheme.hourglass * along / (r0 * r0 + 0.01 * scheme.h * scheme.h)


@_inlined
def exchanged(step: Step, approach: float, now: float, square: float) -> tuple[float, float]:
    """Returns x . v_half (m2/s) with x at n, and with x at n+1, for `lost`. In the last step of a chunk x . v at n+1 is added to the
    second value, because the force also acts in the half step after the chunk. x, v, v_half are those of j relative to i. approach:
    x . v at n+1; now: x . v_half with x at n+1; square: v_half . v_half."""
    before = now - step.dt * square  # x_j - x_i at n is its value at n+1 less dt v_half
    return before, now + approach if step.is_last else now


@_inlined
def lost(dt: float, former: float, strength: float, before: float, now: float) -> float:
    """Half (J) of the energy dt (f_n + f_n+1) / 2 . v_n+1/2 that a pair force f dissipates in the step. former, strength (N/m): f at n
    and at n+1, divided by the distance; before, now: from `exchanged`."""
    return 0.25 * dt * (former * before + strength * now)


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def point_forces(
    lo: int, hi: int, step: Step, scheme: Scheme, s: Sides, control: Control, m: Motion, d: Deformation,
    losses: Losses, side_force: Floats, f: Floats,
) -> None:  # fmt: skip
    """Pass 2: write the forces on points to f (n,3) N: sums over j of side_force_ij - side_force_ji, viscous and hourglass force.

    The last two act along x_j - x_i. Hourglass error: (F_i + F_j) (X_j - X_i) / 2 - (x_j - x_i). Both points compute the same numbers.
    """
    for i in range(lo, hi):
        f0 = f1 = f2 = by_viscosity = by_control = 0.0
        for k in range(s.first[i], s.first[i + 1]):
            j = s.neighbour[k]
            x, v_half = apart(m.x, i, j), apart(m.v_half, i, j)
            r, approach = sqrt(dot(x, x)), dot(x, apart(m.v, i, j))
            viscous, mu = viscosity(scheme, s.slope[k], s.c[k], r, approach)
            X0, X1, X2 = apart(m.X, i, j)
            e = (
                0.5 * ((d.F[i, 0] + d.F[j, 0]) * X0 + (d.F[i, 1] + d.F[j, 1]) * X1 + (d.F[i, 2] + d.F[j, 2]) * X2)
                - x[0],
                0.5 * ((d.F[i, 3] + d.F[j, 3]) * X0 + (d.F[i, 4] + d.F[j, 4]) * X1 + (d.F[i, 5] + d.F[j, 5]) * X2)
                - x[1],
                0.5 * ((d.F[i, 6] + d.F[j, 6]) * X0 + (d.F[i, 7] + d.F[j, 7]) * X1 + (d.F[i, 8] + d.F[j, 8]) * X2)
                - x[2],
            )
            is_plastic = max(d.effective[i], d.effective[j]) > PLASTIC
            per_length = 1.0 / (r + 0.01 * scheme.h)
            viscous = viscous * per_length
            r0, WE = control.r0[k], control.W[k] * control.E[k]
            against = hourglass(scheme, s.slope[k], s.c[k], r0, WE, r, x, e, is_plastic, mu) * per_length
            before, now = exchanged(step, approach, dot(x, v_half), dot(v_half, v_half))
            by_viscosity += lost(step.dt, losses.strength[0, k], viscous, before, now)
            by_control += lost(step.dt, losses.strength[1, k], against, before, now)
            losses.strength[0, k], losses.strength[1, k] = viscous, against
            own, a = apart(side_force, s.reverse[k], k), viscous + against
            f0, f1, f2 = f0 + own[0] + a * x[0], f1 + own[1] + a * x[1], f2 + own[2] + a * x[2]
        f[i, 0], f[i, 1], f[i, 2] = f0, f1, f2
        losses.work[0, i] += by_viscosity
        losses.work[1, i] += by_control


@njit(cache=True, nogil=True)
def grow_gradients(n: int, grown: Floats, s: Sides, d: Deformation, eps_gradient: Floats) -> None:
    """Add the gradient of the plastic strain of a chunk of steps to eps_gradient (n,3) 1/m of n points.

    grown (N,): plastic strain of the chunk. Its gradient in the current configuration is turned back by R^T, as Huang et al. (2004)
    integrate it: the reference gradient is multiplied by R^T F^-T = U^-1.
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
def stress_of_all(team: Ints, n: int, failed: Ints, of_points: Arrays) -> None:
    """Do `stress_points` for n points in all threads. failed (PARTS,): the first point that fails in each part, or -1."""
    for lo, hi, part in ranges(team, 0, n, LEAST_POINTS):
        failed[part] = stress_points(lo, hi, *of_points)


@njit(cache=True, nogil=True)
def forces_of_all(team: Ints, n: int, of_points: Arrays) -> None:
    """Do `point_forces` for n points in all threads."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        point_forces(lo, hi, *of_points)
