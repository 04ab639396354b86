"""Coarse grid for the dynamic relaxation. Without it a long wave needs a step for each element on its way across the bodies.

A grid of boxes lies over the mesh. Displacements that are linear between grid points get an additional inverse mass, proportional
to their flexibility, so that all of them have about the same frequency:

    M^-1 = D^-1 + P (A / s + e P^T D P)^-1 P^T,   A = P^T K P,   s = (omega dt)^2 / dt^2

D: masses of the nodes; P: interpolation from the grid; K: elastic stiffness of the elements, of the half-space and of the springs
between bodies; e: small number that gives a mass to motions without stiffness. M is positive definite, and the increase of the
highest squared frequency is at most s: the additive two-level method of domain decomposition (Toselli & Widlund 2005, Domain
Decomposition Methods), used as a mass matrix. This bound requires all springs in K, also the bonds at the edge of the free nodes.
"""

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ..compiling import njit
from ..core.arrays import Bools, Floats, Ints, Laws, Links, occurring
from ..core.threads import share
from ..geometry.products import times_rows
from .blocks import edge_cofactors
from .explicit import Target

FREQUENCY = 0.7  # omega dt of the displacements of the grid: adds an eighth to the bound on omega^2, 4 / dt^2
# Approximate number of nodes in a box, and largest number of boxes. With 1500 boxes an equilibrium of 92,000 nodes takes a sixth
# fewer steps but the same time, because a single thread solves for the grid.
NODES, MOST = 100, 350
MOST_ACROSS = 20  # boxes in one direction, at most
CORNERS = 8  # of a box
RANGES = 16  # of the loop over points of the grid, at most
LEAST = 1e-4  # the small number e above
ALONE = 1e-9  # mass of points of the grid on which no free node depends, divided by the largest mass


@njit(cache=True, nogil=True)
def _stiffness(
    low: int, high: int, m: int, x: Floats, conn: Ints, laws: Laws, law_of: Ints, points: Ints, weights: Floats, A: Floats,
    occurs: Bools,
) -> None:  # fmt: skip
    """Add the elastic stiffness (N/m) of the first m elements to A (g,g,3,3): a block for each pair of grid points. The stiffness
    matrix for displacements of the grid is A + A^T, with A as (3g,3g). Writes only rows [low, high) of A and occurs (g,g), the mask
    of nonzero blocks.

    points, weights (n,8): grid points of each node, ascending, and their weights, 0 for a fixed node.
    """
    own, gradients = np.empty(4 * CORNERS, np.int64), np.empty((4 * CORNERS, 3))
    shape = np.empty((4, 3))
    for e in range(m):
        n0, n1, n2, n3 = conn[e, 0], conn[e, 1], conn[e, 2], conn[e, 3]
        if min(points[n0, 0], points[n1, 0], points[n2, 0], points[n3, 0]) >= high:
            continue
        if max(points[n0, -1], points[n1, -1], points[n2, -1], points[n3, -1]) < low:
            continue
        c00, c01, c02, c10, c11, c12, c20, c21, c22, det = edge_cofactors(x[n0], x[n1], x[n2], x[n3])
        shape[1, 0], shape[1, 1], shape[1, 2] = c00 / det, c01 / det, c02 / det
        shape[2, 0], shape[2, 1], shape[2, 2] = c10 / det, c11 / det, c12 / det
        shape[3, 0], shape[3, 1], shape[3, 2] = c20 / det, c21 / det, c22 / det
        for d in range(3):
            shape[0, d] = -shape[1, d] - shape[2, d] - shape[3, d]
        count = 0
        for corner in range(4):
            a = conn[e, corner]
            for c in range(CORNERS):
                w = weights[a, c]
                if w == 0.0:
                    continue
                slot = 0
                while slot < count and own[slot] != points[a, c]:
                    slot += 1
                if slot == count:
                    own[slot] = points[a, c]
                    gradients[slot] = 0.0
                    count += 1
                for d in range(3):
                    gradients[slot, d] += w * shape[corner, d]
        law = laws[law_of[e]]
        for i in range(count):
            if not low <= own[i] < high:
                continue
            g = gradients[i]
            for j in range(i, count):
                h, V = gradients[j], det / 6.0 if i < j else det / 12.0
                G, lame = V * law.G, V * (law.K - 2.0 / 3.0 * law.G)
                occurs[own[i], own[j]] = True
                dot = G * (g[0] * h[0] + g[1] * h[1] + g[2] * h[2])
                block = A[own[i], own[j]]  # contiguous in memory
                for d in range(3):
                    for k in range(3):
                        block[d, k] += lame * g[d] * h[k] + G * g[k] * h[d]
                    block[d, d] += dot


class CoarseGrid:
    """Coarse grid that covers the active part of a target."""

    def __init__(self, t: Target, free: np.ndarray, mass: np.ndarray, dt: float, links: Sequence[Links] = ()):
        """free (n,) bool: nodes that can move; mass (n,) kg; dt (s): stable time step with these masses; links: springs between
        bodies."""
        n, m = t.active_nodes, t.active_elements
        points, weights = _interpolation(t.nodes.x[:n])
        weights[~free[:n]] = 0.0
        used = occurring(points, int(points.max()) + 1)
        points = np.searchsorted(used, points)
        P = sparse.csr_array(
            (weights.ravel(), points.ravel(), np.arange(0, weights.size + 1, CORNERS)), shape=(n, len(used))
        )
        self._P, self._PT = P, P.T.tocsr()
        g = len(used)
        A, occurs = np.zeros((g, g, 3, 3)), np.zeros((g, g), bool)

        def add(low: int, high: int) -> None:
            _stiffness(low, high, m, t.nodes.x, t.mesh.conn, t.laws, t.law_of, points, weights, A, occurs)

        share(add, g, max(g // RANGES, 1))  # each range reads all elements
        row, column = occurs.nonzero()
        starts = np.searchsorted(row, np.arange(g + 1))
        stiff = sparse.bsr_array((A[row, column], column, starts), shape=(3 * g, 3 * g)).tocsr()
        stiff = stiff + stiff.T + _of_half_space(P, t)
        if links:
            stiff = stiff + sparse.kron(_between(P, Links.joined(links)), sparse.eye_array(3), format="csr")
        heavy = sparse.kron(self._PT @ P.multiply(mass[:n, None]).tocsr(), sparse.eye_array(3), format="csr")
        alone = sparse.diags_array(np.full(3 * g, ALONE * heavy.diagonal().max()))
        inertia = stiff * (dt / FREQUENCY) ** 2 + LEAST * heavy + alone
        self._inertia = splu(
            inertia.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def acceleration(self, force: np.ndarray) -> np.ndarray:
        """Acceleration (n,3) m/s2 that forces (n,3) N cause through the grid, in addition to the acceleration by the nodal masses."""
        return times_rows(self._P, self._inertia.solve(times_rows(self._PT, force).ravel()).reshape(-1, 3))


def _interpolation(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each node x (n,3), the grid points (n,8) at the corners of its box, and their weights (n,8).

    The same number of nodes lies between any two neighbouring planes of the grid: boxes are small where elements are small.
    """
    extent = x.std(axis=0)
    across = np.cbrt(min(len(x) / NODES, MOST) / extent.prod()) * extent
    points, weights = np.zeros((len(x), 1), np.int64), np.ones((len(x), 1))
    for values, boxes in zip(x.T, np.clip(across.round(), 1, MOST_ACROSS).astype(int), strict=True):
        planes = np.unique(np.quantile(values, np.linspace(0.0, 1.0, boxes + 1)))
        box = np.clip(np.searchsorted(planes, values, side="right") - 1, 0, len(planes) - 2)[:, None]
        part = (values[:, None] - planes[box]) / (planes[box + 1] - planes[box])
        points = np.concatenate([points * len(planes) + box, points * len(planes) + box + 1], axis=1)
        weights = np.concatenate([weights * (1.0 - part), weights * part], axis=1)
    return points, weights


def _between(P: sparse.csr_array, springs: Links) -> sparse.csr_array:
    """Stiffness matrix (g,g) N/m of springs between bodies, the same for each direction. P (n,g): weights of the grid points. Only
    springs whose ends the grid moves apart add stiffness: springs at the edge of the free nodes, or after a slip."""
    n, (ends, weights, stiffness) = P.shape[0], springs
    row, end = np.nonzero(ends < n)  # other nodes do not move
    apart = sparse.csr_array((weights[row, end], (row, ends[row, end])), shape=(len(ends), n)) @ P
    return (apart.T @ sparse.diags_array(stiffness) @ apart).tocsr()


def _of_half_space(P: sparse.csr_array, t: Target) -> sparse.csr_array:
    """Stiffness matrix (3g,3g) N/m of the half-space around the target, for displacements of the grid. P (n,g): as in `_between`."""
    active = t.spring_nodes < t.active_nodes
    own = sparse.kron(P[t.spring_nodes[active]], sparse.eye_array(3), format="csr")
    springs = t.springs[active]
    size = len(springs)
    return own.T @ sparse.bsr_array((springs, np.arange(size), np.arange(size + 1)), shape=(3 * size, 3 * size)) @ own
