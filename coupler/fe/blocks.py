"""Kinematics and nodal forces of tetrahedra, in blocks of elements whose values lie side by side in memory: loops without branches
and without scattered access to memory compile to vector instructions.

This module does not depend on the effects of the law: numba compiles it once for all choices of effects. `kinematics` and
`nodal_forces` must be inlined into the function that allocates w: only there the compiler sees that the rows of w do not overlap.
Without vector instructions an elastic step takes 1.6 times as long.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiling import njit
from ..core.arrays import Floats, Ints, Matrix, Symmetric
from ..geometry.matrix_kernels import ROUNDING
from ..physics.constitutive import von_mises_squared
from .model import Cells, Elements, Nodes

BLOCK = 32  # elements in a block: their values fit into the first-level cache
CUBE_ROOT = 0x2A9F7893782DA1CE  # plus a third of the bits of a float: bits of its cube root, to 3 % (Kahan, as in fdlibm's cbrt)


@njit(cache=True, nogil=True, inline="always")
def _gradient(a0: Floats, a1: Floats, a2: Floats, a3: Floats, B: Floats) -> Matrix:
    """Sum over the four nodes of a_I (x) dN_I/dX, row by row, where (x) is the outer product. The gradient of node 0 is minus the sum
    of the others."""
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
def _cofactor(
    f00: float, f01: float, f02: float, f10: float, f11: float, f12: float, f20: float, f21: float, f22: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float]:  # fmt: skip
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


@njit(cache=True, nogil=True, inline="always")
def edge_cofactors(
    o: Floats, a: Floats, b: Floats, c: Floats,
) -> tuple[float, float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """Cofactors and determinant (6 V) of the matrix whose rows are the edges of a tetrahedron from corner o to a, b and c."""
    return _cofactor(
        a[0] - o[0], a[1] - o[1], a[2] - o[2], b[0] - o[0], b[1] - o[1], b[2] - o[2], c[0] - o[0], c[1] - o[1], c[2] - o[2]
    )  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def _nine(rows: Floats, i: int) -> Matrix:
    """The 3 x 3 matrix in column i of `rows` (9,BLOCK), its entries in the order 00 01 02 10 ..."""
    return rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i], rows[5, i], rows[6, i], rows[7, i], rows[8, i]


@njit(cache=True, nogil=True, inline="always")
def _turned(
    wx: float, wy: float, wz: float, sxx: float, syy: float, szz: float, syz: float, sxz: float, sxy: float,
) -> Symmetric:  # fmt: skip
    """R s R^T with the rotation R = (1 - W/2)^-1 (1 + W/2) (Cayley). W: spin times dt; (wx, wy, wz): axial vector of W/2."""
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
def _row_times(
    a: float, b: float, c: float, sxx: float, syy: float, szz: float, syz: float, sxz: float, sxy: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Product of the row (a, b, c) and a symmetric matrix."""
    return a * sxx + b * sxy + c * sxz, a * sxy + b * syy + c * syz, a * sxz + b * syz + c * szz


class Rows(NamedTuple):
    """Values of a block by name, one column for each element: views of one array (ROWS, BLOCK)."""

    F: NDArray  # (9,BLOCK) deformation gradient at n+1, row by row
    Fdot: NDArray  # (9,BLOCK) its rate at n+1/2, 1/s
    C: NDArray  # (9,BLOCK) cofactors of F
    S: NDArray  # (6,BLOCK) deviator at n, then trial deviator, then deviator after the radial return; Pa
    P: NDArray  # (9,BLOCK) -V0 times the first Piola-Kirchhoff stress, J
    two_G_dt: NDArray  # Pa s
    pressure: NDArray  # Pa
    J: NDArray
    div: NDArray  # divergence of the velocity, 1/s
    q_squared: NDArray  # square of the trial deviator's von Mises stress, Pa^2
    along: NDArray  # old deviator : trial deviator, Pa^2
    V0: NDArray  # m3
    volume: NDArray  # now, m3
    length: NDArray  # cube root of the volume now, m


ROWS = 51


@njit(cache=True, nogil=True, inline="always")
def rows_of(w: Floats) -> Rows:
    """The rows of w (ROWS, BLOCK) by name."""
    return Rows(
        w[0:9], w[9:18], w[18:27], w[27:33], w[33:42],
        w[42], w[43], w[44], w[45], w[46], w[47], w[48], w[49], w[50],
    )  # fmt: skip


@njit(cache=True, nogil=True, forceinline=True, error_model="numpy", fastmath=ROUNDING)
def kinematics(
    first: int, hi: int, dt: float, c: Cells, nodes: Nodes, elements: Elements, two_G: Floats, law_of: Ints, w: Floats
) -> None:
    """Write the state and the kinematics from n to n+1 of the block of elements that begins with `first` to w (ROWS, BLOCK).

    two_G (k,) Pa: twice the shear modulus of each law; law_of (m,): law of each element; hi: end of the range of elements. Copies
    of element hi - 1 fill the last block, so that the result for an element does not depend on where the range begins.
    """
    half = 0.5 * dt
    b = rows_of(w)
    F, G, C, S, now, length = b.F, b.Fdot, b.C, b.S, b.volume, b.length
    bits = length.view(np.int64)
    x, v, p, s = nodes.x, nodes.v, nodes.p, elements.s
    for i in range(BLOCK):
        e = min(first + i, hi - 1)
        n0, n1, n2, n3 = c.conn[e, 0], c.conn[e, 1], c.conn[e, 2], c.conn[e, 3]
        F[0, i], F[1, i], F[2, i], F[3, i], F[4, i], F[5, i], F[6, i], F[7, i], F[8, i] = _gradient(
            x[n0], x[n1], x[n2], x[n3], c.B[e]
        )
        G[0, i], G[1, i], G[2, i], G[3, i], G[4, i], G[5, i], G[6, i], G[7, i], G[8, i] = _gradient(
            v[n0], v[n1], v[n2], v[n3], c.B[e]
        )
        S[0, i], S[1, i], S[2, i], S[3, i], S[4, i], S[5, i] = s[e, 0], s[e, 1], s[e, 2], s[e, 3], s[e, 4], s[e, 5]
        b.pressure[i] = 0.25 * (p[n0] + p[n1] + p[n2] + p[n3])
        b.two_G_dt[i] = two_G[law_of[e]] * dt
        b.V0[i] = c.V0[e]
        now[i] = length[i] = elements.volume[e]
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
        b.div[i] = l00 + l11 + l22
        third = (l00 + l11 + l22) / 3.0
        # the rotated old deviator: its work on the plastic strain of this step is needed
        oxx, oyy, ozz, oyz, oxz, oxy = _turned(
            0.5 * half * (l21 - l12), 0.5 * half * (l02 - l20), 0.5 * half * (l10 - l01),
            S[0, i], S[1, i], S[2, i], S[3, i], S[4, i], S[5, i],
        )  # fmt: skip
        a = b.two_G_dt[i]
        sxx, syy, szz = oxx + a * (l00 - third), oyy + a * (l11 - third), ozz + a * (l22 - third)
        syz, sxz, sxy = oyz + 0.5 * a * (l12 + l21), oxz + 0.5 * a * (l02 + l20), oxy + 0.5 * a * (l01 + l10)
        b.q_squared[i] = von_mises_squared(sxx, syy, szz, syz, sxz, sxy)
        b.along[i] = oxx * sxx + oyy * syy + ozz * szz + 2.0 * (oyz * syz + oxz * sxz + oxy * sxy)
        S[0, i], S[1, i], S[2, i], S[3, i], S[4, i], S[5, i] = sxx, syy, szz, syz, sxz, sxy
        C[0, i], C[1, i], C[2, i], C[3, i], C[4, i], C[5, i], C[6, i], C[7, i], C[8, i], b.J[i] = _cofactor(
            f00, f01, f02, f10, f11, f12, f20, f21, f22
        )
        for _ in range(3):  # Halley's iteration, of third order: errors 3e-2, 2e-5, 6e-15
            cube = length[i] * length[i] * length[i]
            length[i] *= (cube + 2.0 * now[i]) / (2.0 * cube + now[i])


@njit(cache=True, nogil=True, forceinline=True, error_model="numpy", fastmath=ROUNDING)
def nodal_forces(first: int, hi: int, B: Floats, w: Floats, fe: Floats) -> None:
    """Write the nodal forces of a block, f_I = -V0 P B_I with P = sigma cof(F), to fe (m,4,3)."""
    b = rows_of(w)
    C, S, P, pressure = b.C, b.S, b.P, b.pressure
    for i in range(BLOCK):
        c00, c01, c02, c10, c11, c12, c20, c21, c22 = _nine(C, i)
        a = -b.V0[i]
        sxx, syy, szz = a * (S[0, i] - pressure[i]), a * (S[1, i] - pressure[i]), a * (S[2, i] - pressure[i])
        syz, sxz, sxy = a * S[3, i], a * S[4, i], a * S[5, i]
        P[0, i], P[3, i], P[6, i] = _row_times(c00, c10, c20, sxx, syy, szz, syz, sxz, sxy)
        P[1, i], P[4, i], P[7, i] = _row_times(c01, c11, c21, sxx, syy, szz, syz, sxz, sxy)
        P[2, i], P[5, i], P[8, i] = _row_times(c02, c12, c22, sxx, syy, szz, syz, sxz, sxy)
    for i in range(min(BLOCK, hi - first)):
        e = first + i
        Be = B[e]
        P00, P01, P02, P10, P11, P12, P20, P21, P22 = _nine(P, i)
        q0 = q1 = q2 = 0.0
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
