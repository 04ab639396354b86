"""Points to a surface that they carry, and forces on it back to them: a sparse matrix and its transpose (numba)."""

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints
from ..core.loops import ranges

LEAST_ROWS = 50  # in a range of a loop that threads share


@njit(cache=True, nogil=True)
def combine(rows: Ints, start: Ints, columns: Ints, weights: Floats, x: Floats, out: Floats) -> None:
    """out (k,3) = W x at the given rows of W; x (n,3). start (k+1,), columns, weights: W in compressed rows."""
    for q in range(len(rows)):
        r = rows[q]
        a = 0.0
        b = 0.0
        c = 0.0
        for m in range(start[r], start[r + 1]):
            w, j = weights[m], columns[m]
            a += w * x[j, 0]
            b += w * x[j, 1]
            c += w * x[j, 2]
        out[r, 0], out[r, 1], out[r, 2] = a, b, c


@njit(cache=True, nogil=True)
def combine_both(team: Ints, rows: Ints, W: Arrays, x: Floats, v: Floats, out_x: Floats, out_v: Floats) -> None:
    """`combine` of x and of v with the matrix W, (start, columns, weights), in all threads."""
    start, columns, weights = W
    for lo, hi, _ in ranges(team, 0, len(rows), LEAST_ROWS):
        combine(rows[lo:hi], start, columns, weights, x, out_x)
        combine(rows[lo:hi], start, columns, weights, v, out_v)


@njit(cache=True, nogil=True)
def spread(rows: Ints, start: Ints, columns: Ints, weights: Floats, forces: Floats, out: Floats) -> None:
    """out (n,3) += W^T forces, of the given rows of forces (k,3) alone, in their order. W as in `combine`."""
    for q in range(len(rows)):
        r = rows[q]
        a, b, c = forces[r, 0], forces[r, 1], forces[r, 2]
        if a == 0.0 and b == 0.0 and c == 0.0:
            continue
        for m in range(start[r], start[r + 1]):
            w, j = weights[m], columns[m]
            out[j, 0] += w * a
            out[j, 1] += w * b
            out[j, 2] += w * c
