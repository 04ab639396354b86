"""Operations on vectors of three numbers in kernels (numba). The compiler inlines them."""

from ..compiling import njit
from ..core.arrays import Floats, Vector
from .matrix_kernels import ROUNDING


@njit(cache=True, nogil=True, inline="always")
def cross(u: Vector, v: Vector) -> Vector:
    """Vector product u x v."""
    return u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@njit(cache=True, nogil=True, inline="always")
def area_vector(A: Floats, B: Floats, C: Floats) -> Vector:
    """(B - A) x (C - A): vector along the normal of a triangle, by the right-hand rule, whose length is twice the area."""
    u0, u1, u2 = B[0] - A[0], B[1] - A[1], B[2] - A[2]
    v0, v1, v2 = C[0] - A[0], C[1] - A[1], C[2] - A[2]
    return u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0


@njit(cache=True, nogil=True, inline="always")
def from_foot(p: Floats, A: Floats, B: Floats, C: Floats, a: float, b: float, c: float) -> Vector:
    """Vector to p from the point of triangle ABC with the barycentric coordinates a, b, c: p - (a A + b B + c C)."""
    return (
        p[0] - (a * A[0] + b * B[0] + c * C[0]),
        p[1] - (a * A[1] + b * B[1] + c * C[1]),
        p[2] - (a * A[2] + b * B[2] + c * C[2]),
    )


@njit(cache=True, nogil=True, inline="always")
def add(f: Floats, i: int, f0: float, f1: float, f2: float) -> None:
    """Add the vector (f0, f1, f2) to row i of f (n,3)."""
    f[i, 0] += f0
    f[i, 1] += f1
    f[i, 2] += f2


@njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING)
def vector_of(a: Floats, i: int) -> Vector:
    """Row i of a (n,3), as a tuple."""
    return a[i, 0], a[i, 1], a[i, 2]


@njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING)
def apart(a: Floats, i: int, j: int) -> Vector:
    """The vector a[j] - a[i] from point i to point j of a (n,3)."""
    return a[j, 0] - a[i, 0], a[j, 1] - a[i, 1], a[j, 2] - a[i, 2]


@njit(cache=True, nogil=True, forceinline=True, fastmath=ROUNDING)
def dot(a: Vector, b: Vector) -> float:
    """Scalar product of a and b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
