"""3x3 matrices as tuples, row by row (numba): inverse, products, transpose, rotation of a deformation gradient."""

from math import acos, cos, pi, sqrt

from ..compiling import njit
from ..core.arrays import Floats, Matrix, Vector

ROUNDING = {"contract", "arcp", "nsz"}  # options of fast arithmetic that change only the last bits and keep NaN
ZERO = (0.0,) * 9
LARGEST, SMALLEST = 0.0, 2.0 * pi / 3.0  # rad: angle that selects the root in `eigenvalue`


@njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING)
def matrix_of(a: Floats, i: int) -> Matrix:
    """The 3x3 matrix in row i of the array a (n,9), as a tuple."""
    return a[i, 0], a[i, 1], a[i, 2], a[i, 3], a[i, 4], a[i, 5], a[i, 6], a[i, 7], a[i, 8]


@njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING)
def write_matrix(a: Floats, i: int, b: Matrix) -> None:
    """Write the matrix b to row i of the array a (n,9)."""
    for k in range(9):
        a[i, k] = b[k]


@njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING)
def sum_of(a: Matrix, b: Matrix) -> Matrix:
    """The matrix a + b."""
    return (
        a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6], a[7] + b[7], a[8] + b[8],
    )  # fmt: skip


@njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING)
def scaled(c: float, a: Matrix) -> Matrix:
    """The matrix c a."""
    return c * a[0], c * a[1], c * a[2], c * a[3], c * a[4], c * a[5], c * a[6], c * a[7], c * a[8]


@njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING)
def add_outer(a: Matrix, u: Vector, v: Vector) -> Matrix:
    """The matrix a + u (x) v, where (x) is the outer product."""
    return (
        a[0] + u[0] * v[0], a[1] + u[0] * v[1], a[2] + u[0] * v[2],
        a[3] + u[1] * v[0], a[4] + u[1] * v[1], a[5] + u[1] * v[2],
        a[6] + u[2] * v[0], a[7] + u[2] * v[1], a[8] + u[2] * v[2],
    )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def inverse(a: Matrix) -> tuple[Matrix, float]:
    """Inverse of a 3x3 matrix, row by row, and its determinant."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = a
    c00, c01, c02 = a11 * a22 - a12 * a21, a12 * a20 - a10 * a22, a10 * a21 - a11 * a20
    det = a00 * c00 + a01 * c01 + a02 * c02
    d = 1.0 / det
    return (
        d * c00, d * (a02 * a21 - a01 * a22), d * (a01 * a12 - a02 * a11),
        d * c01, d * (a00 * a22 - a02 * a20), d * (a02 * a10 - a00 * a12),
        d * c02, d * (a01 * a20 - a00 * a21), d * (a00 * a11 - a01 * a10),
    ), det  # fmt: skip


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def product(a: Matrix, b: Matrix) -> Matrix:
    """Product of two 3x3 matrices, row by row."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = a
    b00, b01, b02, b10, b11, b12, b20, b21, b22 = b
    return (
        a00 * b00 + a01 * b10 + a02 * b20, a00 * b01 + a01 * b11 + a02 * b21, a00 * b02 + a01 * b12 + a02 * b22,
        a10 * b00 + a11 * b10 + a12 * b20, a10 * b01 + a11 * b11 + a12 * b21, a10 * b02 + a11 * b12 + a12 * b22,
        a20 * b00 + a21 * b10 + a22 * b20, a20 * b01 + a21 * b11 + a22 * b21, a20 * b02 + a21 * b12 + a22 * b22,
    )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def transposed(a: Matrix) -> Matrix:
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = a
    return a00, a10, a20, a01, a11, a21, a02, a12, a22


@njit(cache=True, nogil=True, fastmath=ROUNDING, error_model="numpy")
def polar(F: Matrix) -> Matrix:
    """Rotation R of the polar decomposition of F: 12 steps of Newton's iteration R <- (R + R^-T) / 2 from R = F (Higham 1986)."""
    R = F
    for _ in range(12):
        (i00, i01, i02, i10, i11, i12, i20, i21, i22), _ = inverse(R)
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = R
        R = (
            0.5 * (r00 + i00), 0.5 * (r01 + i10), 0.5 * (r02 + i20), 0.5 * (r10 + i01), 0.5 * (r11 + i11),
            0.5 * (r12 + i21), 0.5 * (r20 + i02), 0.5 * (r21 + i12), 0.5 * (r22 + i22),
        )  # fmt: skip
    return R


@njit(cache=True, nogil=True, inline="always")
def applied(a: Matrix, x: float, y: float, z: float) -> Vector:
    """Product of a 3x3 matrix and a vector."""
    return a[0] * x + a[1] * y + a[2] * z, a[3] * x + a[4] * y + a[5] * z, a[6] * x + a[7] * y + a[8] * z


@njit(cache=True, nogil=True, inline="always")
def eigenvalue(a: float, b: float, c: float, d: float, e: float, f: float, which: float) -> float:
    """The LARGEST or SMALLEST (`which`) eigenvalue of the symmetric matrix [[a, f, e], [f, b, d], [e, d, c]], by a closed formula."""
    mean = (a + b + c) / 3.0
    off = f * f + e * e + d * d
    spread = sqrt(((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2.0 * off) / 6.0)
    if spread <= 1e-14 * abs(mean):
        return mean
    a, b, c, d, e, f = (a - mean) / spread, (b - mean) / spread, (c - mean) / spread, d / spread, e / spread, f / spread
    half_det = 0.5 * (a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e))
    return mean + 2.0 * spread * cos(acos(min(max(half_det, -1.0), 1.0)) / 3.0 + which)
