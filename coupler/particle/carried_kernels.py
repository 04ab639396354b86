"""Transfer of positions and velocities from points to the surface that they carry, and of forces from the surface to the points: a
sparse matrix and its transpose (numba)."""

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints
from ..core.loops import ranges
from ..geometry.products import products_of_rows

LEAST_ROWS = 50  # in a range of a loop that threads share


@njit(cache=True, nogil=True)
def combine_both(
    team: Ints, rows: Ints, W: Arrays, x: Floats, v: Floats, out_x: Floats, out_v: Floats, zero: Floats
) -> None:
    """Write W x, W v and zero to the given rows of out_x, out_v and `zero` (k,3), in all threads. x, v (n,3); W: sparse matrix, given
    by start (k+1,), columns, weights (CSR)."""
    start, columns, weights = W
    for lo, hi, _ in ranges(team, 0, len(rows), LEAST_ROWS):
        for r in rows[lo:hi]:
            products_of_rows(r, r + 1, start, columns, weights, x, out_x)
            products_of_rows(r, r + 1, start, columns, weights, v, out_v)
            zero[r, 0] = zero[r, 1] = zero[r, 2] = 0.0


@njit(cache=True, nogil=True)
def spread(rows: Ints, start: Ints, columns: Ints, weights: Floats, forces: Floats, out: Floats) -> None:
    """Add W^T forces to out (n,3), for the given rows of forces (k,3), in the order of the rows. W: as in `combine_both`."""
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
