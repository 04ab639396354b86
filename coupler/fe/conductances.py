"""Matrix of heat conduction between the nodes of a target at rest, with a fixed sparsity pattern (numba).

Elements and links (thermal contacts) conduct in the same way, between each pair of four nodes. Threads share the rows of the matrix.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from ..compiling import njit
from ..core.arrays import Floats, Ints, Links
from ..core.threads import share
from ..geometry.graph import around
from ..physics.constitutive import conductivity
from .blocks import edge_cofactors
from .heat import LEAST
from .model import Cells, Metals

# resistance of a perfect contact, divided by that of a cube whose faces have its area: 0.01 takes 1.5 times as many iterations
LINK_RESISTANCE = 0.03
FIRST, SECOND = np.triu_indices(4, 1)  # corners of the six pairs of four nodes
PAIR = np.array([[0, 0, 1, 2], [0, 0, 3, 4], [1, 3, 0, 5], [2, 4, 5, 0]])  # number of the pair of two corners


class Conductors(NamedTuple):
    """Elements or links that conduct heat. conn (k,4): nodes; w (k,6) m: conductance of each pair of nodes for a conductivity of 1;
    start, table: conductors around each node, as in `Cells`; slot (4k,4): for each entry of table, the places of the conductor's
    four nodes in the matrix row of the node."""

    conn: Ints
    w: Floats
    start: Ints
    table: Ints
    slot: Ints


@dataclass(frozen=True)
class Conductances:
    """Thermal conductances between n nodes, and from the gas to each node, from_gas (n,) W/K. indptr (n+1,), indices: sparsity
    pattern of the matrix (CSR); the diagonal comes first in each row."""

    elements: Conductors
    links: Conductors
    from_gas: np.ndarray
    indptr: np.ndarray
    indices: np.ndarray

    @classmethod
    def of(cls, x: np.ndarray, c: Cells, links: Links, from_gas: np.ndarray) -> "Conductances":
        """Conductances of elements c with nodes at x (n,3) m, of links between bodies, and from the gas."""
        n, m, d = len(x), len(c.conn), links.weights
        conn = links.ends.astype(np.int32)
        between = -d[:, FIRST] * d[:, SECOND] * links.strength[:, None]  # off-diagonal entries of -strength d d^T
        of_elements = Conductors(c.conn, np.empty((m, 6)), c.start, c.table, np.empty((4 * m, 4), np.int16))
        of_links = Conductors(conn, between, *around(conn, n), np.empty((4 * len(conn), 4), np.int16))
        share(lambda lo, hi: _between_corners(lo, hi, x, c.conn, of_elements.w), m, LEAST)
        # a row has its own node, and at most three nodes of each element and link around it
        first = 3 * (c.start + of_links.start) + np.arange(n + 1)
        count, found = np.ones(n, np.int32), np.full(first[-1], -1, np.int32)
        found[first[:-1]] = np.arange(n)

        def find(lo: int, hi: int) -> None:
            for each in (of_elements, of_links):
                _find_nodes(lo, hi, each, first, count, found)

        share(find, n, LEAST)
        indptr = np.zeros(n + 1, np.int32)
        np.cumsum(count, out=indptr[1:])
        return cls(of_elements, of_links, from_gas, indptr, found[found >= 0])

    def explicit(self, k: np.ndarray) -> csr_array:
        """Conductance matrix (n,n) W/K for conductivities k (m,) W/(m K) of the elements; links have the smallest of these."""
        data, of_link = np.empty(len(self.indices)), np.full(len(self.links.conn), k.min())

        def add(lo: int, hi: int) -> None:
            data[self.indptr[lo] : self.indptr[hi]] = 0.0
            data[self.indptr[lo:hi]] = self.from_gas[lo:hi]
            _add_rows(lo, hi, self.elements, k, self.indptr, data)
            _add_rows(lo, hi, self.links, of_link, self.indptr, data)

        share(add, len(self.from_gas), LEAST)
        return self._of(data)

    def implicit(self, K: csr_array, time: float, free: np.ndarray, capacity: np.ndarray) -> csr_array:
        """The matrix diag(capacity) + time K of an implicit step of `time` s. Rows of fixed nodes, with free (n,) = 0, are those of
        the identity matrix. capacity (n,) J/K."""
        data = np.empty(len(self.indices))

        def write(lo: int, hi: int) -> None:
            _write_implicit(lo, hi, time, free, capacity, self.indptr, self.indices, K.data, data)

        share(write, len(free), LEAST)
        return self._of(data)

    def _of(self, data: np.ndarray) -> csr_array:
        return csr_array((data, self.indices, self.indptr), shape=(len(self.from_gas),) * 2)


@njit(cache=True, nogil=True)
def _between_corners(lo: int, hi: int, x: Floats, conn: Ints, w: Floats) -> None:
    """Write the conductance -grad N_a . grad N_b V (for a conductivity of 1) of each pair of corners of the elements to w (m,6) m."""
    for e in range(lo, hi):
        # gradients of the shape functions of nodes 1 to 3, times six volumes
        p0, p1, p2, q0, q1, q2, r0, r1, r2, det = edge_cofactors(
            x[conn[e, 0]], x[conn[e, 1]], x[conn[e, 2]], x[conn[e, 3]]
        )
        s0, s1, s2, f = p0 + q0 + r0, p1 + q1 + r1, p2 + q2 + r2, 1.0 / (6.0 * det)
        w[e, 0] = f * (s0 * p0 + s1 * p1 + s2 * p2)
        w[e, 1] = f * (s0 * q0 + s1 * q1 + s2 * q2)
        w[e, 2] = f * (s0 * r0 + s1 * r1 + s2 * r2)
        w[e, 3] = -f * (p0 * q0 + p1 * q1 + p2 * q2)
        w[e, 4] = -f * (p0 * r0 + p1 * r1 + p2 * r2)
        w[e, 5] = -f * (q0 * r0 + q1 * r1 + q2 * r2)


@njit(cache=True, nogil=True)
def _find_nodes(lo: int, hi: int, c: Conductors, first: Ints, count: Ints, found: Ints) -> None:
    """Append the nodes of the conductors around each node a, once each, to found[first[a]:first[a] + count[a]]; write count, c.slot."""
    for a in range(lo, hi):
        for r in range(c.start[a], c.start[a + 1]):
            nodes = c.conn[c.table[r] >> 2]
            for j in range(4):
                slot = 0
                while slot < count[a] and found[first[a] + slot] != nodes[j]:
                    slot += 1
                if slot == count[a]:
                    found[first[a] + slot] = nodes[j]
                    count[a] += 1
                c.slot[r, j] = slot


@njit(cache=True, nogil=True)
def _add_rows(lo: int, hi: int, c: Conductors, k: Floats, indptr: Ints, data: Floats) -> None:
    """Add conductors with conductivities k (m,) to the rows [lo, hi) of the matrix."""
    for a in range(lo, hi):
        for r in range(c.start[a], c.start[a + 1]):
            e, i = c.table[r] >> 2, c.table[r] & 3
            for j in range(4):
                if j != i:
                    between = k[e] * c.w[e, PAIR[i, j]]
                    data[indptr[a] + c.slot[r, j]] -= between
                    data[indptr[a]] += between


@njit(cache=True, nogil=True)
def _write_implicit(
    lo: int, hi: int, time: float, free: Floats, capacity: Floats, indptr: Ints, indices: Ints, K: Floats, data: Floats
) -> None:
    """Write the rows [lo, hi) of `Conductances.implicit` to data."""
    for a in range(lo, hi):
        for z in range(indptr[a], indptr[a + 1]):
            data[z] = time * K[z] * free[a] * free[indices[z]]
        data[indptr[a]] += free[a] * capacity[a] + (1.0 - free[a])


@njit(cache=True, nogil=True)
def levels(
    lo: int, hi: int, c: Conductors, metals: Metals, nodal: Floats, T: Floats, share: Floats, k: Floats, excess: Floats, rate: Floats,
) -> None:  # fmt: skip
    """Write for each element: k (m,) W/mK: conductivity at the mean temperature of its nodes; excess (m,) K: its temperature minus this
    mean; rate (m,) 1/s at which the excess decays, 2 k sum(w) / capacity (w: see `Conductors`). nodal (n,) K, T (m,) K: temperatures
    of nodes and elements; share (m,) J/K: a quarter of each element's heat capacity."""
    for e in range(lo, hi):
        n, w = c.conn[e], c.w[e]
        mean = 0.25 * (nodal[n[0]] + nodal[n[1]] + nodal[n[2]] + nodal[n[3]])
        k[e] = conductivity(metals.laws[metals.of_element[e]], mean)
        excess[e] = T[e] - mean
        rate[e] = 0.5 * k[e] * (w[0] + w[1] + w[2] + w[3] + w[4] + w[5]) / share[e]
