"""Connected parts of a graph, and cells around points."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_array
from scipy.sparse.csgraph import connected_components


def connected_parts(pairs: NDArray, n: int) -> tuple[int, NDArray[np.int32]]:
    """Number of connected parts of n nodes linked by pairs (p,2), and the part of each node (n,)."""
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), shape=(n, n))
    return connected_components(graph, directed=False)


def around(cells: NDArray, n: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Where each of n points occurs in cells (m,k), as start (n+1,) and places (m k,). The place of corner j of cell c is k c + j. The
    places of point i, ascending, are places[start[i]:start[i + 1]]."""
    m, k = cells.shape
    by_cell = csr_array((np.arange(m * k, dtype=np.int32), cells.ravel(), np.arange(0, m * k + 1, k)), shape=(m, n))
    by_point = by_cell.tocsc()
    return by_point.indptr.astype(np.int64), by_point.data
