"""Sparse matrices: products with vectors, and solution of linear systems, in all threads (numba)."""

import numpy as np
from scipy.sparse import csr_array, csr_matrix

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints
from ..core.loops import PARTS, ranges
from ..core.threads import share, together

LEAST = 2000  # least number of rows in a range of a shared loop
LEAST_ROWS = 50  # the same in `combine_both`, which computes two products for each row


def times(A: csr_matrix | csr_array, x: np.ndarray) -> np.ndarray:
    """The product A x (n,) of a sparse matrix A (n,k) and a vector x (k,)."""
    product = np.empty(A.shape[0])
    share(lambda lo, hi: _products(lo, hi, A.indptr, A.indices, A.data, x, product), len(product), LEAST)
    return product


def times_rows(A: csr_matrix | csr_array, x: np.ndarray) -> np.ndarray:
    """The product A x (n,3) of a sparse matrix A (n,k) and x (k,3)."""
    product = np.empty((A.shape[0], 3))
    share(lambda lo, hi: products_of_rows(lo, hi, A.indptr, A.indices, A.data, x, product), len(product), LEAST)
    return product


def solve(A: csr_array, b: np.ndarray, x: np.ndarray, tolerance: float, most: int) -> bool:
    """Solve A x = b by conjugate gradients (Hestenes & Stiefel 1952, J. Res. NBS 49, 409) with the diagonal as preconditioner. A:
    positive definite; the first entry of each row is its diagonal.

    x (n,): the start value, overwritten by the solution with a residual of at most `tolerance` |b|. Returns whether the solution is
    found in `most` iterations.
    """
    inverse, r, beta = 1.0 / A.data[A.indptr[:-1]], b - times(A, x), 0.0
    (p, q), sums = np.zeros((2, len(b))), np.zeros((PARTS, 3))
    rz, rr, enough = float(r @ (inverse * r)), float(r @ r), tolerance**2 * float(b @ b)
    while rr > enough:
        if most == 0:
            return False
        together(_iterate, A.indptr, A.indices, A.data, inverse, beta, rz, x, r, p, q, sums)
        _, next_rz, rr = sums.sum(axis=0)
        beta, rz, most = next_rz / rz, next_rz, most - 1
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _iterate(
    team: Ints, indptr: Ints, indices: Ints, data: Floats, inverse: Floats, beta: float, rz: float, x: Floats, r: Floats, p: Floats,
    q: Floats, sums: Floats,
) -> None:  # fmt: skip
    """One iteration of `solve`. Writes p . A p, and r . (inverse r) and r . r of the new residual r, by parts to sums (PARTS,3)."""
    for lo, hi, _ in ranges(team, 0, len(x), LEAST):
        for i in range(lo, hi):
            p[i] = inverse[i] * r[i] + beta * p[i]
    for lo, hi, part in ranges(team, 1, len(x), LEAST):
        _products(lo, hi, indptr, indices, data, p, q)
        sums[part, 0] = 0.0
        for i in range(lo, hi):
            sums[part, 0] += p[i] * q[i]
    pq = 0.0
    for part in range(len(sums)):
        pq += sums[part, 0]
    alpha = rz / pq
    for lo, hi, part in ranges(team, 2, len(x), LEAST):
        next_rz = rr = 0.0
        for i in range(lo, hi):
            x[i] += alpha * p[i]
            r[i] -= alpha * q[i]
            next_rz += inverse[i] * r[i] * r[i]
            rr += r[i] * r[i]
        sums[part, 1], sums[part, 2] = next_rz, rr


@njit(cache=True, nogil=True)
def _products(lo: int, hi: int, indptr: Ints, indices: Ints, data: Floats, x: Floats, product: Floats) -> None:
    """Rows lo to hi of a sparse matrix times x (k,), into product (n,)."""
    for i in range(lo, hi):
        total = 0.0
        for z in range(indptr[i], indptr[i + 1]):
            total += data[z] * x[indices[z]]
        product[i] = total


@njit(cache=True, nogil=True)
def products_of_rows(lo: int, hi: int, indptr: Ints, indices: Ints, data: Floats, x: Floats, product: Floats) -> None:
    """Rows lo to hi of a sparse matrix times x (k,3), into product (n,3)."""
    for i in range(lo, hi):
        x0 = x1 = x2 = 0.0
        for z in range(indptr[i], indptr[i + 1]):
            j, value = indices[z], data[z]
            x0 += value * x[j, 0]
            x1 += value * x[j, 1]
            x2 += value * x[j, 2]
        product[i, 0], product[i, 1], product[i, 2] = x0, x1, x2


@njit(cache=True, nogil=True)
def combine_both(
    team: Ints, rows: Ints, W: Arrays, x: Floats, v: Floats, out_x: Floats, out_v: Floats, zero: Floats
) -> None:
    """Write W x, W v and 0 to the given rows of out_x, out_v and `zero` (k,3). W: start (k+1,), columns, weights (CSR); x, v (n,3)."""
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
