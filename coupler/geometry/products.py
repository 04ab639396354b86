"""Products of sparse matrices, their rows divided among the threads (numba)."""

import numpy as np
from scipy.sparse import csr_array, csr_matrix

from ..compiling import njit
from ..core.arrays import Floats, Ints
from ..core.threads import share

LEAST = 2000  # rows in a range, at least


def times(A: csr_matrix | csr_array, x: np.ndarray) -> np.ndarray:
    """A x of a matrix (n,k) and x (k,)."""
    product = np.empty(A.shape[0])
    share(lambda lo, hi: _products(lo, hi, A.indptr, A.indices, A.data, x, product), len(product), LEAST)
    return product


def times_rows(A: csr_matrix | csr_array, x: np.ndarray) -> np.ndarray:
    """A x of a matrix (n,k) and x (k,3)."""
    product = np.empty((A.shape[0], 3))
    share(lambda lo, hi: _products_of_rows(lo, hi, A.indptr, A.indices, A.data, x, product), len(product), LEAST)
    return product


@njit(cache=True, nogil=True)
def _products(lo: int, hi: int, indptr: Ints, indices: Ints, data: Floats, x: Floats, product: Floats) -> None:
    """Rows lo to hi of a sparse matrix times x (k,), into product (n,)."""
    for i in range(lo, hi):
        total = 0.0
        for z in range(indptr[i], indptr[i + 1]):
            total += data[z] * x[indices[z]]
        product[i] = total


@njit(cache=True, nogil=True)
def _products_of_rows(lo: int, hi: int, indptr: Ints, indices: Ints, data: Floats, x: Floats, product: Floats) -> None:
    """Rows lo to hi of a sparse matrix times x (k,3), into product (n,3)."""
    for i in range(lo, hi):
        x0 = x1 = x2 = 0.0
        for z in range(indptr[i], indptr[i + 1]):
            j, value = indices[z], data[z]
            x0 += value * x[j, 0]
            x1 += value * x[j, 1]
            x2 += value * x[j, 2]
        product[i, 0], product[i, 1], product[i, 2] = x0, x1, x2
