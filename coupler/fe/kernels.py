"""Kernels of the explicit tetrahedral target: kinematics, averaged nodal pressure, stress, forces, time step.

Each kernel works on a range [lo, hi) of elements or nodes and writes only its own rows, so that any split of the
range over threads gives the same numbers to the last bit. Voigt order everywhere: xx yy zz yz xz xy. The averaged
nodal pressure is that of Bonet & Burton (1998): the volume ratio, and with it the pressure, is a nodal quantity; a
tetrahedron takes the mean of its four nodes, which keeps linear tetrahedra from locking in isochoric flow.
"""

from math import acos, cos, log, sqrt

import numpy as np
from numba import njit

from ..constitutive import bulk_stiffness, harden, mie_gruneisen

BLOCK = 32  # elements laid out side by side: their numbers fit the first-level cache
ROUNDING = {"contract", "arcp", "nsz"}  # of fast arithmetic only what changes the last bits, and not what hides a NaN
CUBE_ROOT = 0x2A9F7893782DA1CE  # with a third of a float's bits: its cube root to 3 % (Kahan, as in fdlibm's cbrt)
SHAPE_LIMIT = 0.5
SHAPE_STIFFNESS = 0.05


@njit(cache=True, nogil=True, inline="always")
def _gradient(a0, a1, a2, a3, B):
    """Sum over the four nodes of a_I (x) dN_I/dX, row by row; node 0 carries minus the gradients of the others."""
    d10, d11, d12 = a1[0] - a0[0], a1[1] - a0[1], a1[2] - a0[2]
    d20, d21, d22 = a2[0] - a0[0], a2[1] - a0[1], a2[2] - a0[2]
    d30, d31, d32 = a3[0] - a0[0], a3[1] - a0[1], a3[2] - a0[2]
    return (
        d10 * B[0, 0] + d20 * B[1, 0] + d30 * B[2, 0],
        d10 * B[0, 1] + d20 * B[1, 1] + d30 * B[2, 1],
        d10 * B[0, 2] + d20 * B[1, 2] + d30 * B[2, 2],
        d11 * B[0, 0] + d21 * B[1, 0] + d31 * B[2, 0],
        d11 * B[0, 1] + d21 * B[1, 1] + d31 * B[2, 1],
        d11 * B[0, 2] + d21 * B[1, 2] + d31 * B[2, 2],
        d12 * B[0, 0] + d22 * B[1, 0] + d32 * B[2, 0],
        d12 * B[0, 1] + d22 * B[1, 1] + d32 * B[2, 1],
        d12 * B[0, 2] + d22 * B[1, 2] + d32 * B[2, 2],
    )


@njit(cache=True, nogil=True, inline="always")
def _cofactor(f00, f01, f02, f10, f11, f12, f20, f21, f22):
    """Cofactor matrix of F (that is J F^-T), row by row, and J."""
    c00 = f11 * f22 - f12 * f21
    c01 = f12 * f20 - f10 * f22
    c02 = f10 * f21 - f11 * f20
    c10 = f02 * f21 - f01 * f22
    c11 = f00 * f22 - f02 * f20
    c12 = f01 * f20 - f00 * f21
    c20 = f01 * f12 - f02 * f11
    c21 = f02 * f10 - f00 * f12
    c22 = f00 * f11 - f01 * f10
    return c00, c01, c02, c10, c11, c12, c20, c21, c22, f00 * c00 + f01 * c01 + f02 * c02


@njit(cache=True, nogil=True)
def volumes(lo, hi, x, conn, volume):
    """Current volume of each tetrahedron, m3; volume (m,) is written. Returns the smallest."""
    smallest = 1e300
    for e in range(lo, hi):
        a, b, c, d = x[conn[e, 0]], x[conn[e, 1]], x[conn[e, 2]], x[conn[e, 3]]
        u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        w0, w1, w2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
        vol = (u0 * (v1 * w2 - v2 * w1) + u1 * (v2 * w0 - v0 * w2) + u2 * (v0 * w1 - v1 * w0)) / 6.0
        volume[e] = vol
        smallest = min(smallest, vol)
    return smallest


@njit(cache=True, nogil=True)
def nodal_pressure(lo, hi, start, table, volume, heat, V0_node, laws, law_of_node, J, p, energy):
    """Averaged nodal volume ratio and the pressure that goes with it.

    start (n+1,), table: rows 4 e + local of the elements around each node. volume (m,) m3 now; heat (m,) J put into
    each element during the last step. J, p (Pa), energy (J per reference m3) of shape (n,) move on in place.
    """
    for a in range(lo, hi):
        vol = 0.0
        q = 0.0
        for r in range(start[a], start[a + 1]):
            e = table[r] >> 2
            vol += volume[e]
            q += heat[e]
        J_new = 0.25 * vol / V0_node[a]
        law = laws[law_of_node[a]]
        p[a], energy[a] = mie_gruneisen(law, J[a], J_new, p[a], energy[a], 0.25 * q / V0_node[a])
        J[a] = J_new


@njit(cache=True, nogil=True, inline="always")
def shape_stress(law, J):
    """Mean stress (Pa) that keeps a tetrahedron from collapsing or blowing up while the nodes around it keep their volume.

    Averaged nodal pressure leaves single elements free to trade volume: in a fast crater some sink to a twentieth of
    theirs and take the time step with them. psi = SHAPE_STIFFNESS K/2 ln^2(J / J_limit) acts only outside [SHAPE_LIMIT,
    1 / SHAPE_LIMIT] (a small share of the element's own bulk stiffness, as in Puso & Solberg 2006, but only where needed).
    """
    if J < SHAPE_LIMIT:
        return SHAPE_STIFFNESS * law.K * log(J / SHAPE_LIMIT) / J
    if J * SHAPE_LIMIT > 1.0:
        return SHAPE_STIFFNESS * law.K * log(J * SHAPE_LIMIT) / J
    return 0.0


@njit(cache=True, nogil=True, inline="always")
def _nine(rows, i):
    """Column i of nine rows: a matrix, row by row."""
    return (
        rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i], rows[5, i], rows[6, i], rows[7, i], rows[8, i]
    )  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def _turned(wx, wy, wz, sxx, syy, szz, syz, sxz, sxy):
    """R s R^T with the rotation R = (1 - W/2)^-1 (1 + W/2) (Cayley) of a step; (wx, wy, wz): axial vector of W/2."""
    ww = 2.0 / (1.0 + wx * wx + wy * wy + wz * wz)
    r00, r11, r22 = 1.0 - ww * (wy * wy + wz * wz), 1.0 - ww * (wx * wx + wz * wz), 1.0 - ww * (wx * wx + wy * wy)
    r01, r10 = ww * (wx * wy - wz), ww * (wx * wy + wz)
    r02, r20 = ww * (wx * wz + wy), ww * (wx * wz - wy)
    r12, r21 = ww * (wy * wz - wx), ww * (wy * wz + wx)
    t00, t01, t02 = _row_times(r00, r01, r02, sxx, syy, szz, syz, sxz, sxy)
    t10, t11, t12 = _row_times(r10, r11, r12, sxx, syy, szz, syz, sxz, sxy)
    t20, t21, t22 = _row_times(r20, r21, r22, sxx, syy, szz, syz, sxz, sxy)
    return (
        t00 * r00 + t01 * r01 + t02 * r02, t10 * r10 + t11 * r11 + t12 * r12, t20 * r20 + t21 * r21 + t22 * r22,
        t10 * r20 + t11 * r21 + t12 * r22, t00 * r20 + t01 * r21 + t02 * r22, t00 * r10 + t01 * r11 + t02 * r12,
    )  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def _row_times(a, b, c, sxx, syy, szz, syz, sxz, sxy):
    """The row (a, b, c) times a symmetric matrix."""
    return a * sxx + b * sxy + c * sxz, a * sxy + b * syy + c * syz, a * sxz + b * syz + c * szz


@njit(cache=True, nogil=True, error_model="numpy", fastmath=ROUNDING)
def element_forces(
    lo, hi, dt, b1, b2, x, v, conn, B, V0, volume, p, J_node, laws, law_of, s, sigma_y, eps_p, rate, T, heat, fe, sums
):  # fmt: skip
    """Stress update and internal nodal forces of each tetrahedron, from n to n+1.

    x (n,3) positions at n+1, v (n,3) velocities at n+1/2; B (m,3,3) reference gradients of nodes 1 to 3; s (m,6)
    Cauchy deviator, updated by a Jaumann rate with an exact (Cayley) rotation and a radial return to sigma_y (m,).
    fe (m,4,3) receives the force each element puts on its nodes, -V0 P B with P = J sigma F^-T. heat (m,) receives
    the heat of the step in J that makes pressure. sums (3,) is increased by the plastic work, the work of the bulk
    viscosity and that heat, J.

    BLOCK elements at a time are laid out side by side, so that what has neither branches nor scattered memory is
    done with the processor's vectors. A block that is not full is filled up with its last element: each element is
    treated alike, wherever the range begins.
    """
    plastic = 0.0
    warmth = 0.0
    viscous = 0.0
    half = 0.5 * dt
    w = np.empty((51, BLOCK))
    F, G, C, S = w[0:9], w[9:18], w[18:27], w[27:33]  # F, its rate, its cofactors, the deviator
    P = w[33:42]  # -V0 times the first Piola-Kirchhoff stress
    two_G_dt, pressure, jacobian, div, q_squared, along, V = w[42], w[43], w[44], w[45], w[46], w[47], w[48]
    now, length = w[49], w[50]  # volume and its cube root
    bits = length.view(np.int64)
    for first in range(lo, hi, BLOCK):
        count = min(BLOCK, hi - first)
        for i in range(BLOCK):
            e = min(first + i, hi - 1)
            n0, n1, n2, n3 = conn[e, 0], conn[e, 1], conn[e, 2], conn[e, 3]
            F[0, i], F[1, i], F[2, i], F[3, i], F[4, i], F[5, i], F[6, i], F[7, i], F[8, i] = _gradient(
                x[n0], x[n1], x[n2], x[n3], B[e]
            )
            G[0, i], G[1, i], G[2, i], G[3, i], G[4, i], G[5, i], G[6, i], G[7, i], G[8, i] = _gradient(
                v[n0], v[n1], v[n2], v[n3], B[e]
            )
            S[0, i], S[1, i], S[2, i], S[3, i], S[4, i], S[5, i] = s[e, 0], s[e, 1], s[e, 2], s[e, 3], s[e, 4], s[e, 5]
            two_G_dt[i] = 2.0 * laws[law_of[e]].G * dt
            pressure[i] = 0.25 * (p[n0] + p[n1] + p[n2] + p[n3])
            V[i] = V0[e]
            now[i] = length[i] = volume[e]
            bits[i] = bits[i] // 3 + CUBE_ROOT

        for i in range(BLOCK):
            f00, f01, f02, f10, f11, f12, f20, f21, f22 = _nine(F, i)
            g00, g01, g02, g10, g11, g12, g20, g21, g22 = _nine(G, i)
            # velocity gradient at mid-step: L = Fdot F^-1, F at n+1/2
            m00, m01, m02, m10, m11, m12, m20, m21, m22, Jm = _cofactor(
                f00 - half * g00, f01 - half * g01, f02 - half * g02,
                f10 - half * g10, f11 - half * g11, f12 - half * g12,
                f20 - half * g20, f21 - half * g21, f22 - half * g22,
            )  # fmt: skip
            inv = 1.0 / Jm
            l00 = (g00 * m00 + g01 * m01 + g02 * m02) * inv
            l01 = (g00 * m10 + g01 * m11 + g02 * m12) * inv
            l02 = (g00 * m20 + g01 * m21 + g02 * m22) * inv
            l10 = (g10 * m00 + g11 * m01 + g12 * m02) * inv
            l11 = (g10 * m10 + g11 * m11 + g12 * m12) * inv
            l12 = (g10 * m20 + g11 * m21 + g12 * m22) * inv
            l20 = (g20 * m00 + g21 * m01 + g22 * m02) * inv
            l21 = (g20 * m10 + g21 * m11 + g22 * m12) * inv
            l22 = (g20 * m20 + g21 * m21 + g22 * m22) * inv
            div[i] = l00 + l11 + l22
            third = (l00 + l11 + l22) / 3.0
            # the rotated old deviator, kept for the work it does on the plastic strain of this step
            oxx, oyy, ozz, oyz, oxz, oxy = _turned(
                0.5 * half * (l21 - l12), 0.5 * half * (l02 - l20), 0.5 * half * (l10 - l01),
                S[0, i], S[1, i], S[2, i], S[3, i], S[4, i], S[5, i],
            )  # fmt: skip
            a = two_G_dt[i]
            sxx, syy, szz = oxx + a * (l00 - third), oyy + a * (l11 - third), ozz + a * (l22 - third)
            syz, sxz, sxy = oyz + 0.5 * a * (l12 + l21), oxz + 0.5 * a * (l02 + l20), oxy + 0.5 * a * (l01 + l10)
            q_squared[i] = 1.5 * (sxx * sxx + syy * syy + szz * szz + 2.0 * (syz * syz + sxz * sxz + sxy * sxy))
            along[i] = oxx * sxx + oyy * syy + ozz * szz + 2.0 * (oyz * syz + oxz * sxz + oxy * sxy)
            S[0, i], S[1, i], S[2, i], S[3, i], S[4, i], S[5, i] = sxx, syy, szz, syz, sxz, sxy
            C[0, i], C[1, i], C[2, i], C[3, i], C[4, i], C[5, i], C[6, i], C[7, i], C[8, i], jacobian[i] = _cofactor(
                f00, f01, f02, f10, f11, f12, f20, f21, f22
            )
            for _ in range(3):  # Halley: the error goes with its cube, 3e-2, 2e-5, 6e-15
                cube = length[i] * length[i] * length[i]
                length[i] *= (cube + 2.0 * now[i]) / (2.0 * cube + now[i])

        for i in range(count):
            e = first + i
            law = laws[law_of[e]]
            # radial return to the yield stress the last step left behind
            sy = sigma_y[e]
            deps = 0.0
            flow = sy
            if q_squared[i] > sy * sy:
                q_trial = sqrt(q_squared[i])
                deps = (q_trial - sy) / (3.0 * law.G)
                # the step's mean stress along the plastic flow: what makes stored and dissipated energy add up to the work done
                flow = 0.5 * (sy + 1.5 * along[i] / q_trial)
                for k in range(6):
                    S[k, i] *= sy / q_trial
            if deps > 0.0 or rate[e] > 0.0:
                eps_p[e], rate[e], T[e], sy, work = harden(
                    law, deps, dt, jacobian[i], flow, sy, eps_p[e], rate[e], T[e]
                )
                sigma_y[e] = sy
                plastic += V[i] * work
                heat[e] = V[i] * law.expansion * law.taylor_quinney * work
                warmth += heat[e]
            else:
                heat[e] = 0.0
            for k in range(6):
                s[e, k] = S[k, i]
            # bulk viscosity, linear and quadratic in the rate of compression, over the element's length
            if div[i] < 0.0:
                c = sqrt((law.K + 4.0 / 3.0 * law.G) / law.rho)
                qv = law.rho * length[i] * (b2 * b2 * length[i] * div[i] * div[i] - b1 * c * div[i])
                viscous -= qv * div[i] * dt * now[i]
                pressure[i] += qv
            pressure[i] -= shape_stress(law, jacobian[i])

        # P = sigma cof(F); f_I = -V0 P B_I
        for i in range(BLOCK):
            c00, c01, c02, c10, c11, c12, c20, c21, c22 = _nine(C, i)
            a = -V[i]
            sxx, syy, szz = a * (S[0, i] - pressure[i]), a * (S[1, i] - pressure[i]), a * (S[2, i] - pressure[i])
            syz, sxz, sxy = a * S[3, i], a * S[4, i], a * S[5, i]
            P[0, i], P[3, i], P[6, i] = _row_times(c00, c10, c20, sxx, syy, szz, syz, sxz, sxy)
            P[1, i], P[4, i], P[7, i] = _row_times(c01, c11, c21, sxx, syy, szz, syz, sxz, sxy)
            P[2, i], P[5, i], P[8, i] = _row_times(c02, c12, c22, sxx, syy, szz, syz, sxz, sxy)
        for i in range(count):
            e = first + i
            Be = B[e]
            P00, P01, P02, P10, P11, P12, P20, P21, P22 = _nine(P, i)
            q0 = 0.0
            q1 = 0.0
            q2 = 0.0
            for k in range(3):
                bx, by, bz = Be[k, 0], Be[k, 1], Be[k, 2]
                h0 = P00 * bx + P01 * by + P02 * bz
                h1 = P10 * bx + P11 * by + P12 * bz
                h2 = P20 * bx + P21 * by + P22 * bz
                fe[e, k + 1, 0], fe[e, k + 1, 1], fe[e, k + 1, 2] = h0, h1, h2
                q0 -= h0
                q1 -= h1
                q2 -= h2
            fe[e, 0, 0], fe[e, 0, 1], fe[e, 0, 2] = q0, q1, q2
    sums[0] += plastic
    sums[1] += viscous
    sums[2] += warmth


@njit(cache=True, nogil=True)
def gather_forces(lo, hi, start, table, fe, f):
    """Sum the element forces at each node: f (n,3) is overwritten for nodes [lo, hi)."""
    for a in range(lo, hi):
        f0 = 0.0
        f1 = 0.0
        f2 = 0.0
        for r in range(start[a], start[a + 1]):
            e, k = table[r] >> 2, table[r] & 3
            f0 += fe[e, k, 0]
            f1 += fe[e, k, 1]
            f2 += fe[e, k, 2]
        f[a, 0], f[a, 1], f[a, 2] = f0, f1, f2


@njit(cache=True, nogil=True, inline="always")
def _largest_eigenvalue(a, b, c, d, e, f):
    """Largest eigenvalue of the symmetric matrix [[a, f, e], [f, b, d], [e, d, c]] (closed form)."""
    mean = (a + b + c) / 3.0
    off = f * f + e * e + d * d
    spread = sqrt(((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2.0 * off) / 6.0)
    if spread <= 1e-14 * abs(mean):
        return mean
    a, b, c, d, e, f = (a - mean) / spread, (b - mean) / spread, (c - mean) / spread, d / spread, e / spread, f / spread
    half_det = 0.5 * (a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e))
    return mean + 2.0 * spread * cos(acos(min(max(half_det, -1.0), 1.0)) / 3.0)


@njit(cache=True, nogil=True)
def stable_dt(lo, hi, x, conn, J_node, laws, law_of, dt_of):
    """Bound on the stable time step of each element, s, into dt_of (m,); returns (smallest, its element).

    omega^2 <= (4 / rho) (lambda tr M + 2 G lambda_max(M)), M = sum_I b_I (x) b_I with current gradients b: the
    element's largest eigenvalue bounds the mesh's. K stiffens with compression.
    """
    smallest = 1e300
    where = -1
    for e in range(lo, hi):
        n0, n1, n2, n3 = conn[e, 0], conn[e, 1], conn[e, 2], conn[e, 3]
        law = laws[law_of[e]]
        x0, x1, x2, x3 = x[n0], x[n1], x[n2], x[n3]
        c00, c01, c02, c10, c11, c12, c20, c21, c22, det = _cofactor(
            x1[0] - x0[0], x1[1] - x0[1], x1[2] - x0[2],
            x2[0] - x0[0], x2[1] - x0[1], x2[2] - x0[2],
            x3[0] - x0[0], x3[1] - x0[1], x3[2] - x0[2],
        )  # fmt: skip
        i2 = 1.0 / (det * det)
        s0, s1, s2 = c00 + c10 + c20, c01 + c11 + c21, c02 + c12 + c22
        xx = (c00 * c00 + c10 * c10 + c20 * c20 + s0 * s0) * i2
        yy = (c01 * c01 + c11 * c11 + c21 * c21 + s1 * s1) * i2
        zz = (c02 * c02 + c12 * c12 + c22 * c22 + s2 * s2) * i2
        yz = (c01 * c02 + c11 * c12 + c21 * c22 + s1 * s2) * i2
        xz = (c00 * c02 + c10 * c12 + c20 * c22 + s0 * s2) * i2
        xy = (c00 * c01 + c10 * c11 + c20 * c21 + s0 * s1) * i2
        J = 0.25 * (J_node[n0] + J_node[n1] + J_node[n2] + J_node[n3])
        lame = bulk_stiffness(law, J) / J - 2.0 / 3.0 * law.G
        stiffness = lame * (xx + yy + zz) + 2.0 * law.G * _largest_eigenvalue(xx, yy, zz, yz, xz, xy)
        omega2 = 4.0 * J / law.rho * stiffness  # density now is rho0 / J
        dt = 2.0 / sqrt(omega2) if det > 0.0 else 0.0
        dt_of[e] = dt
        if dt < smallest:
            smallest, where = dt, e
    return smallest, where


@njit(cache=True, nogil=True)
def elastic_shear_energy(lo, hi, volume, V0, laws, law_of, s):
    """Recoverable energy of the elements, sum of v s:s / 4G over the volumes now, and of `shape_stress`, in J."""
    total = 0.0
    for e in range(lo, hi):
        law = laws[law_of[e]]
        ss = s[e, 0] ** 2 + s[e, 1] ** 2 + s[e, 2] ** 2 + 2.0 * (s[e, 3] ** 2 + s[e, 4] ** 2 + s[e, 5] ** 2)
        total += volume[e] * ss / (4.0 * law.G)
        J = volume[e] / V0[e]
        if J < SHAPE_LIMIT:
            total += V0[e] * 0.5 * SHAPE_STIFFNESS * law.K * log(J / SHAPE_LIMIT) ** 2
        elif J * SHAPE_LIMIT > 1.0:
            total += V0[e] * 0.5 * SHAPE_STIFFNESS * law.K * log(J * SHAPE_LIMIT) ** 2
    return total


def node_to_element(conn: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows 4 e + local around each node: (start (nodes+1,), table (4 m,)), in element order, so that sums have one order."""
    flat = np.asarray(conn).ravel()
    table = np.argsort(flat, kind="stable").astype(np.int32)
    start = np.zeros(nodes + 1, np.int64)
    np.cumsum(np.bincount(flat, minlength=nodes), out=start[1:])
    return start, table
