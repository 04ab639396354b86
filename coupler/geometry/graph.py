"""Search for the connected parts of a graph."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def connected_parts(pairs: NDArray, n: int) -> tuple[int, NDArray[np.int32]]:
    """Number of connected parts of n nodes linked by pairs (p,2), and the part of each node (n,)."""
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), shape=(n, n))
    return connected_components(graph, directed=False)
