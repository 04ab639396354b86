"""Two passes of total-Lagrangian SPH in MACHDYN's form, compiled: stress of each point, then forces of each pair.

The letters are those of the equations (Ganzenmueller 2015, Comput. Methods Appl. Mech. Eng. 286, 87-106): X, x reference and
present positions; V volume; g = w (X_j - X_i) with w = W'(|X_j - X_i|) / |X_j - X_i| the kernel gradient; K = sum_j g (x) (X_j - X_i);
F = sum_j (x_j - x_i) (x) g K^-1 and its rate Fdot; R the rotation of F = R U; J = det F; sigma the unrotated Cauchy stress.

Each kernel works on a range [lo, hi) of points or of pairs and writes only its own rows: any split of the range over threads
gives the same numbers to the last bit. Arrays n of this rank's points, N of these and of the neighbours' copies. SI units.
"""

from math import sqrt

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints, Laws, Matrix
from ..core.loops import ranges
from ..geometry.matrix_kernels import ROUNDING, applied, inverse, polar, product, transposed
from ..geometry.vector_kernels import add
from ..physics.constitutive import harden, hugoniot_pressure, mie_gruneisen, norm, on

LEAST_POINTS, LEAST_PAIRS = 100, 600  # in a range of a loop that threads share
TURNED = 1e-14  # rad: the rotation is exact to rounding
NEAR = 1e-8  # rad: it is after this correction, for the next would be of the square
FAR = 0.3  # rad: a rotation farther from the last one is sought by Newton's iteration of the polar decomposition
J_MIN, J_MAX = 0.2, 2.0  # volume ratios that MACHDYN accepts
PLASTIC = 1e-3  # effective plastic strain of LAMMPS beyond which MACHDYN's hourglass control is viscous
LEAST_ERROR = 0.05  # hourglass error that the viscous control assumes at the least
ACROSS = 10.0 / 9.0  # shear stiffness of a residual over G: 1 across a pair, 4/3 along it, in the mean over directions
SLOW = 0.01  # of the wave speed: what viscosity sees of a closing velocity at the most


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def rotation(F: Matrix, R: Matrix) -> tuple[Matrix, Matrix]:
    """Rotation of F = R U and the stretch U, from the rotation of the step before.

    A = R^T F, S = sym A: (tr(S) 1 - S) omega is the axial vector of A, and R <- R Cayley(omega) until omega vanishes.
    """
    A = product(transposed(R), F)
    for sweep in range(30):
        a00, a01, a02, a10, a11, a12, a20, a21, a22 = A
        s01, s02, s12 = 0.5 * (a01 + a10), 0.5 * (a02 + a20), 0.5 * (a12 + a21)
        t0, t1, t2 = a21 - a12, a02 - a20, a10 - a01
        W, _ = inverse((a11 + a22, -s01, -s02, -s01, a00 + a22, -s12, -s02, -s12, a00 + a11))
        o0, o1, o2 = (
            W[0] * t0 + W[1] * t1 + W[2] * t2,
            W[3] * t0 + W[4] * t1 + W[5] * t2,
            W[6] * t0 + W[7] * t1 + W[8] * t2,
        )
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


@njit(cache=True, nogil=True, inline="always")
def _sum(a: Matrix, b: Matrix) -> Matrix:
    return (
        a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6], a[7] + b[7], a[8] + b[8],
    )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def _residuals(
    i: int, lo: int, hi: int, neighbour: Ints, w: Floats, X: Floats, x: Floats, F: Matrix, R: Matrix, plastic: Floats, residual:
    Floats,
) -> tuple[float, float]:  # fmt: skip
    """The elastic residuals e = R^T (x_j - x_i - F (X_j - X_i)) - e_p of a point: what its F does not see of its neighbours.

    residual (m,3) m is written in rows [lo, hi); plastic (m,3) m: e_p. Returns sum w e^2 / sum w r^2, and sum w r^2 (1/m3).
    """
    total = span = 0.0
    for k in range(lo, hi):
        j = neighbour[k]
        X0, X1, X2 = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1], X[j, 2] - X[i, 2]
        d0 = x[j, 0] - x[i, 0] - F[0] * X0 - F[1] * X1 - F[2] * X2
        d1 = x[j, 1] - x[i, 1] - F[3] * X0 - F[4] * X1 - F[5] * X2
        d2 = x[j, 2] - x[i, 2] - F[6] * X0 - F[7] * X1 - F[8] * X2
        e0 = R[0] * d0 + R[3] * d1 + R[6] * d2 - plastic[k, 0]
        e1 = R[1] * d0 + R[4] * d1 + R[7] * d2 - plastic[k, 1]
        e2 = R[2] * d0 + R[5] * d1 + R[8] * d2 - plastic[k, 2]
        residual[k, 0], residual[k, 1], residual[k, 2] = e0, e1, e2
        total += w[k] * (e0 * e0 + e1 * e1 + e2 * e2)
        span += w[k] * (X0 * X0 + X1 * X1 + X2 * X2)
    return total / span, span


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def _residual_forces(
    i: int, lo: int, hi: int, back: float, stiffness: float, neighbour: Ints, w: Floats, X: Floats, R: Matrix, plastic: Floats,
    residual: Floats,
) -> tuple[Matrix, float, float, float]:  # fmt: skip
    """Return elastic residuals by the factor `back` of the deviator, and turn them into forces.

    plastic (m,3) m grows; residual (m,3): elastic residuals of the trial in m, on return forces stiffness w R e in N. Returns
    sum f (x) (X_j - X_i), minus the derivative of their energy by F, and the moment sum e_p x f of the unrotated forces.
    """
    h00 = h01 = h02 = h10 = h11 = h12 = h20 = h21 = h22 = 0.0
    t0 = t1 = t2 = 0.0
    for k in range(lo, hi):
        j = neighbour[k]
        e0, e1, e2 = residual[k, 0], residual[k, 1], residual[k, 2]
        p0, p1, p2 = (
            plastic[k, 0] + (1.0 - back) * e0,
            plastic[k, 1] + (1.0 - back) * e1,
            plastic[k, 2] + (1.0 - back) * e2,
        )
        plastic[k, 0], plastic[k, 1], plastic[k, 2] = p0, p1, p2
        c = stiffness * w[k] * back
        e0, e1, e2 = c * e0, c * e1, c * e2
        t0 += p1 * e2 - p2 * e1
        t1 += p2 * e0 - p0 * e2
        t2 += p0 * e1 - p1 * e0
        f0 = R[0] * e0 + R[1] * e1 + R[2] * e2
        f1 = R[3] * e0 + R[4] * e1 + R[5] * e2
        f2 = R[6] * e0 + R[7] * e1 + R[8] * e2
        residual[k, 0], residual[k, 1], residual[k, 2] = f0, f1, f2
        X0, X1, X2 = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1], X[j, 2] - X[i, 2]
        h00 += f0 * X0
        h01 += f0 * X1
        h02 += f0 * X2
        h10 += f1 * X0
        h11 += f1 * X1
        h12 += f1 * X2
        h20 += f2 * X0
        h21 += f2 * X1
        h22 += f2 * X2
    return (h00, h01, h02, h10, h11, h12, h20, h21, h22), t0, t1, t2


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def stress_points(
    lo: int, hi: int, dt: float, laws: Laws, V: float, H: float, start: Ints, neighbour: Ints, w: Floats, K_inverse: Floats,
    X: Floats, x: Floats, v: Floats, R: Floats, F: Floats, Q: Floats, stress: Floats, effective: Floats, sigma_y: Floats,
    eps_p: Floats, rate: Floats, T: Floats, J: Floats, p: Floats, energy: Floats, work: Floats, eps_gradient: Floats,
    gradient: Floats = None, plastic: Floats = None, residual: Floats = None, unseen: Floats = None,  # type: ignore[assignment]
) -> int:  # fmt: skip
    """Pass 1: deformation, stress and plastic state of points from n to n+1. Returns the first point that fails, or -1.

    start (n+1,), neighbour, w (m,) 1/m5: neighbours of each point and their W'/r; K_inverse (n,3,3) m3; X (N,3). x, v (N,3):
    positions and velocities at n+1. R, F (N,9); Q (N,9) receives -V J R sigma B K^-1 with B = U^-1; stress (n,6):
    unrotated Cauchy stress, xx xy xz yy yz zz, as LAMMPS keeps it; effective (N,): sigma_y / H and the plastic strain of the
    step, by which MACHDYN chooses its hourglass control. The plastic state is that of `physics.constitutive`; work (n,) J/m3 grows by
    the plastic work; eps_gradient (n,3) 1/m: `grow_gradients`. A point fails where J leaves [J_MIN, J_MAX].

    As in MACHDYN the deviator returns to the yield stress of the step before, and the heat in the pressure lags by one step.

    The enriched scheme (`particle.enriched`) has four arrays more: gradient (m,3) 1/m in place of w (X_j - X_i) K^-1;
    plastic and residual (m,3) of `_residuals` and `_residual_forces`; unseen (n,) J/m3
    receives the elastic energy of the residuals. Q then
    is -V J R sigma B, and what balances the residuals' forces. Its strain increment is that of U from n to n+1, not of v.
    """
    failed = -1
    for i in range(lo, hi):
        law = laws[0]
        X0, X1, X2 = X[i, 0], X[i, 1], X[i, 2]
        x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
        f00 = f01 = f02 = f10 = f11 = f12 = f20 = f21 = f22 = 0.0
        r00 = r01 = r02 = r10 = r11 = r12 = r20 = r21 = r22 = 0.0
        for k in range(start[i], start[i + 1]):
            j = neighbour[k]
            if gradient is not None:
                g0, g1, g2 = gradient[k, 0], gradient[k, 1], gradient[k, 2]
            else:
                g0, g1, g2 = w[k] * (X[j, 0] - X0), w[k] * (X[j, 1] - X1), w[k] * (X[j, 2] - X2)
            d0, d1, d2 = x[j, 0] - x0, x[j, 1] - x1, x[j, 2] - x2
            f00 += d0 * g0
            f01 += d0 * g1
            f02 += d0 * g2
            f10 += d1 * g0
            f11 += d1 * g1
            f12 += d1 * g2
            f20 += d2 * g0
            f21 += d2 * g1
            f22 += d2 * g2
            if gradient is None:
                d0, d1, d2 = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
                r00 += d0 * g0
                r01 += d0 * g1
                r02 += d0 * g2
                r10 += d1 * g0
                r11 += d1 * g1
                r12 += d1 * g2
                r20 += d2 * g0
                r21 += d2 * g1
                r22 += d2 * g2
        M = K_inverse[i]
        K1 = M[0, 0], M[0, 1], M[0, 2], M[1, 0], M[1, 1], M[1, 2], M[2, 0], M[2, 1], M[2, 2]
        Fi = f00, f01, f02, f10, f11, f12, f20, f21, f22
        if gradient is None:
            Fi = product(Fi, K1)
        R_n = R[i, 0], R[i, 1], R[i, 2], R[i, 3], R[i, 4], R[i, 5], R[i, 6], R[i, 7], R[i, 8]
        F_n = F[i, 0], F[i, 1], F[i, 2], F[i, 3], F[i, 4], F[i, 5], F[i, 6], F[i, 7], F[i, 8]
        Ri, U = rotation(Fi, R_n)
        B, Ji = inverse(U)
        if not J_MIN <= Ji <= J_MAX and failed < 0:
            failed = i
        for k in range(9):
            F[i, k] = Fi[k]
            R[i, k] = Ri[k]

        # rate of deformation in the unrotated frame, D = sym(R^T Fdot B) = sym(Udot B), and the trial deviator
        if gradient is None:
            L = product(product(transposed(Ri), product((r00, r01, r02, r10, r11, r12, r20, r21, r22), K1)), B)
            c = 2.0 * law.G * dt
        else:  # dt Udot B at n+1/2, (U - U_n) ((U + U_n) / 2)^-1 = 4 U (U + U_n)^-1 - 2: of the last term there is no deviator
            both, _ = inverse(_sum(U, product(transposed(R_n), F_n)))
            L = product(U, both)
            c = 8.0 * law.G
        mean_rate = (L[0] + L[4] + L[8]) / 3.0
        mean = (stress[i, 0] + stress[i, 3] + stress[i, 5]) / 3.0
        sxx = stress[i, 0] - mean + c * (L[0] - mean_rate)
        syy = stress[i, 3] - mean + c * (L[4] - mean_rate)
        szz = stress[i, 5] - mean + c * (L[8] - mean_rate)
        sxy = stress[i, 1] + 0.5 * c * (L[1] + L[3])
        sxz = stress[i, 2] + 0.5 * c * (L[2] + L[6])
        syz = stress[i, 4] + 0.5 * c * (L[5] + L[7])
        squared = sxx * sxx + syy * syy + szz * szz + 2.0 * (sxy * sxy + sxz * sxz + syz * syz)
        span = 1.0
        if gradient is not None:
            unseen[i], span = _residuals(i, start[i], start[i + 1], neighbour, w, X, x, Fi, Ri, plastic, residual)
            squared += 2.0 * ACROSS * law.G * law.G * unseen[i]
        q = sqrt(1.5 * squared)
        sy = sigma_y[i]
        deps, back = 0.0, 1.0
        if q > sy:
            deps = (q - sy) / (3.0 * law.G)
            back = sy / q
            sxx, syy, szz, sxy, sxz, syz = back * sxx, back * syy, back * szz, back * sxy, back * sxz, back * syz
        effective[i] = sy / H + deps

        # the mean stress: the Hugoniot of now, the rest of the pressure of the step before
        mean = -hugoniot_pressure(law, Ji)
        if on(law.Gamma0) and law.Gamma0 > 0.0:
            mean += (hugoniot_pressure(law, J[i]) - p[i]) * J[i] / Ji
        eta = norm(eps_gradient, i) if on(law.gradient_length) else 0.0
        eps_p[i], rate[i], T[i], sigma_y[i], done = harden(law, deps, dt, Ji, sy, sy, eps_p[i], rate[i], T[i], eta)
        heat = 0.0
        if on(law.taylor_quinney) and on(law.expansion):
            heat = law.expansion * law.taylor_quinney * done
        p[i], energy[i] = mie_gruneisen(law, J[i], Ji, p[i], energy[i], heat)
        J[i] = Ji
        work[i] += done

        sxx, syy, szz = sxx + mean, syy + mean, szz + mean
        stress[i, 0], stress[i, 1], stress[i, 2] = sxx, sxy, sxz
        stress[i, 3], stress[i, 4], stress[i, 5] = syy, syz, szz
        c = -V * Ji
        if gradient is not None:
            unseen[i] *= 0.5 * ACROSS * law.G * back * back
            stiffness = V * ACROSS * law.G / span
            balance, t0, t1, t2 = _residual_forces(
                i, start[i], start[i + 1], back, stiffness, neighbour, w, X, Ri, plastic, residual
            )
            t0, t1, t2 = 0.5 * t0 / c, 0.5 * t1 / c, 0.5 * t2 / c  # a skew stress that balances their moment
            P = product(Ri, (sxx, sxy - t2, sxz + t1, sxy + t2, syy, syz - t0, sxz - t1, syz + t0, szz))
            P = product(P, B)
            for k in range(9):
                Q[i, k] = c * P[k] + balance[k]
        else:
            P = product(product(Ri, (sxx, sxy, sxz, sxy, syy, syz, sxz, syz, szz)), B)
            P = product(P, K1)
            for k in range(9):
                Q[i, k] = c * P[k]
    return failed


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def pair_forces(
    lo: int, hi: int, pairs: Ints, r0: Floats, w: Floats, W: Floats, X: Floats, x: Floats, v: Floats, F: Floats, Q: Floats,
    effective: Floats, h: float, c: float, E: float, V: float, rho: float, Q1: float, Q2: float, hourglass: float, dt: float,
    is_last: bool, v_half: Floats, strength: Floats, loss: Floats, force: Floats,
    gradients: Floats = None, residual: Floats = None, rows: Ints = None,  # type: ignore[assignment]
) -> None:  # fmt: skip
    """Pass 2: the force (N) on the first point of each pair; on the second it is the opposite.

    pairs (m,2); r0 (m,) m, w (m,) 1/m5, W (m,) 1/m3: distance, W'/r and W of the reference; force (m,3) is written. h m: reach of
    the kernel; c m/s: longitudinal wave speed; E Pa; V m3 and rho kg/m3 of each point; Q1, Q2, hourglass: MACHDYN's numbers.

    f = -(Q_i + Q_j) g + viscosity + hourglass, the last two along x_j - x_i. The hourglass error is
    gamma = (F_i + F_j) (X_j - X_i) / 2 - (x_j - x_i).

    loss (m,2) J grows by the work that viscosity and hourglass control dissipate: dt (f_n + f_n+1) / 2 . v_n+1/2, as the
    leapfrog exchanges energy. v_half (N,3): v_n+1/2; strength (m,2) N/m: both forces over x_j - x_i, of n on entry (zero in the first
    step of a chunk), of n+1 on return. is_last: the last step of a chunk, whose forces also act in the half step after it.

    The enriched scheme: gradients (m,6) of both points of the pair, and in place of the hourglass control the forces residual
    (sides,3) N; rows (m,2): of the first point's side and of the second's.
    """
    m2 = (rho * V) ** 2 / rho
    for k in range(lo, hi):
        i, j = pairs[k, 0], pairs[k, 1]
        X0, X1, X2 = X[j, 0] - X[i, 0], X[j, 1] - X[i, 1], X[j, 2] - X[i, 2]
        x0, x1, x2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        v0, v1, v2 = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
        r = sqrt(x0 * x0 + x1 * x1 + x2 * x2)
        if gradients is not None:
            a0, a1, a2, b0, b1, b2 = (
                gradients[k, 0], gradients[k, 1], gradients[k, 2], gradients[k, 3], gradients[k, 4], gradients[k, 5],
            )  # fmt: skip
            p, q = rows[k, 0], rows[k, 1]
            f0 = residual[p, 0] - residual[q, 0] + Q[j, 0] * b0 + Q[j, 1] * b1 + Q[j, 2] * b2
            f1 = residual[p, 1] - residual[q, 1] + Q[j, 3] * b0 + Q[j, 4] * b1 + Q[j, 5] * b2
            f2 = residual[p, 2] - residual[q, 2] + Q[j, 6] * b0 + Q[j, 7] * b1 + Q[j, 8] * b2
            f0 -= Q[i, 0] * a0 + Q[i, 1] * a1 + Q[i, 2] * a2
            f1 -= Q[i, 3] * a0 + Q[i, 4] * a1 + Q[i, 5] * a2
            f2 -= Q[i, 6] * a0 + Q[i, 7] * a1 + Q[i, 8] * a2
        else:
            g0, g1, g2 = w[k] * X0, w[k] * X1, w[k] * X2
            f0 = -((Q[i, 0] + Q[j, 0]) * g0 + (Q[i, 1] + Q[j, 1]) * g1 + (Q[i, 2] + Q[j, 2]) * g2)
            f1 = -((Q[i, 3] + Q[j, 3]) * g0 + (Q[i, 4] + Q[j, 4]) * g1 + (Q[i, 5] + Q[j, 5]) * g2)
            f2 = -((Q[i, 6] + Q[j, 6]) * g0 + (Q[i, 7] + Q[j, 7]) * g1 + (Q[i, 8] + Q[j, 8]) * g2)

        soft = 1.0 / (r + 0.1 * h)
        closing = min(max((x0 * v0 + x1 * v1 + x2 * v2) * soft, -SLOW * c), SLOW * c)
        mu = h * closing * soft
        gradient = m2 * w[k] * r0[k]
        viscous = gradient * (Q2 * mu - Q1 * c) * mu  # times the unit vector: the viscous force
        control = 0.0
        if gradients is None:
            e0 = 0.5 * ((F[i, 0] + F[j, 0]) * X0 + (F[i, 1] + F[j, 1]) * X1 + (F[i, 2] + F[j, 2]) * X2) - x0
            e1 = 0.5 * ((F[i, 3] + F[j, 3]) * X0 + (F[i, 4] + F[j, 4]) * X1 + (F[i, 5] + F[j, 5]) * X2) - x1
            e2 = 0.5 * ((F[i, 6] + F[j, 6]) * X0 + (F[i, 7] + F[j, 7]) * X1 + (F[i, 8] + F[j, 8]) * X2) - x2
            along = e0 * x0 + e1 * x1 + e2 * x2  # gamma . dx
            if max(effective[i], effective[j]) > PLASTIC:
                if closing * along < 0.0:
                    error = max(sqrt(e0 * e0 + e1 * e1 + e2 * e2) / r0[k], LEAST_ERROR)
                    control = -gradient * error * hourglass * c * mu
            else:
                along = 0.5 * min(max(along, -0.1 * r), 0.1 * r) * soft
                control = -V * V * W[k] * E * hourglass * along / (r0[k] * r0[k] + 0.01 * h * h)
        viscous, control = viscous / (r + 0.01 * h), control / (r + 0.01 * h)
        a = viscous + control

        u0, u1, u2 = v_half[j, 0] - v_half[i, 0], v_half[j, 1] - v_half[i, 1], v_half[j, 2] - v_half[i, 2]
        now = x0 * u0 + x1 * u1 + x2 * u2
        before = now - dt * (u0 * u0 + u1 * u1 + u2 * u2)  # x_j - x_i of n is that of n+1 less dt v
        if is_last:
            now += x0 * v0 + x1 * v1 + x2 * v2
        loss[k, 0] += 0.5 * dt * (strength[k, 0] * before + viscous * now)
        loss[k, 1] += 0.5 * dt * (strength[k, 1] * before + control * now)
        strength[k, 0], strength[k, 1] = viscous, control
        force[k, 0], force[k, 1], force[k, 2] = f0 + a * x0, f1 + a * x1, f2 + a * x2


@njit(cache=True, nogil=True)
def grow_gradients(
    n: int, grown: Floats, start: Ints, neighbour: Ints, gradient: Floats, F: Floats, R: Floats, eps_gradient: Floats
) -> None:  # fmt: skip
    """Add the gradient of the plastic strain of a chunk of steps to that of n points, eps_gradient (n,3) 1/m.

    grown (N,): that strain; gradient (m,3) 1/m: of `stress_points`; F, R (n,9). In the present place, R^T F^-T = U^-1, and in the
    unrotated frame, in which it stays: as Huang et al. (2004) integrate it.
    """
    for i in range(n):
        a = b = c = 0.0
        for k in range(start[i], start[i + 1]):
            d = grown[neighbour[k]] - grown[i]
            a += d * gradient[k, 0]
            b += d * gradient[k, 1]
            c += d * gradient[k, 2]
        f, r = F[i], R[i]
        rotated = product(
            (r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]),
            (f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8]),
        )
        B, _ = inverse(rotated)
        a, b, c = applied(B, a, b, c)
        add(eps_gradient, i, a, b, c)


@njit(cache=True, nogil=True)
def green_lagrange(lo: int, hi: int, F: Floats, strain: Floats) -> None:
    """Green-Lagrange strain (n,6), xx yy zz xy xz yz, of deformation gradients F (n,9)."""
    for i in range(lo, hi):
        f = F[i]
        strain[i, 0] = 0.5 * (f[0] * f[0] + f[3] * f[3] + f[6] * f[6] - 1.0)
        strain[i, 1] = 0.5 * (f[1] * f[1] + f[4] * f[4] + f[7] * f[7] - 1.0)
        strain[i, 2] = 0.5 * (f[2] * f[2] + f[5] * f[5] + f[8] * f[8] - 1.0)
        strain[i, 3] = 0.5 * (f[0] * f[1] + f[3] * f[4] + f[6] * f[7])
        strain[i, 4] = 0.5 * (f[0] * f[2] + f[3] * f[5] + f[6] * f[8])
        strain[i, 5] = 0.5 * (f[1] * f[2] + f[4] * f[5] + f[7] * f[8])


@njit(cache=True, nogil=True)
def share_losses(lo: int, hi: int, start: Ints, signed: Ints, loss: Floats, heat: Floats) -> None:
    """Half the loss of each pair to each of its points: heat (n,2) J by viscosity and by hourglass control is written."""
    for i in range(lo, hi):
        viscous = control = 0.0
        for k in range(start[i], start[i + 1]):
            row = signed[k] if signed[k] >= 0 else ~signed[k]
            viscous += loss[row, 0]
            control += loss[row, 1]
        heat[i, 0], heat[i, 1] = 0.5 * viscous, 0.5 * control


@njit(cache=True, nogil=True)
def sum_forces(lo: int, hi: int, start: Ints, signed: Ints, force: Floats, f: Floats) -> None:
    """Sum of the forces of each point's pairs: f (n,3) is written. signed: row of a pair, ~row where the point is its second."""
    for i in range(lo, hi):
        f0 = f1 = f2 = 0.0
        for k in range(start[i], start[i + 1]):
            row = signed[k]
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
    """`stress_points` of n points in all threads; failed (PARTS,): the first point that fails of each part, or -1."""
    for lo, hi, part in ranges(team, 0, n, LEAST_POINTS):
        failed[part] = stress_points(lo, hi, *of_points)


@njit(cache=True, nogil=True)
def forces_of_all(team: Ints, n: int, of_pairs: Arrays, of_sum: Arrays) -> None:
    """`pair_forces` of all pairs, and `sum_forces` of n points, in all threads."""
    for lo, hi, _ in ranges(team, 0, len(of_pairs[0]), LEAST_PAIRS):
        pair_forces(lo, hi, *of_pairs)
    for lo, hi, _ in ranges(team, 1, n, LEAST_POINTS):
        sum_forces(lo, hi, *of_sum)
