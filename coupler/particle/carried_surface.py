"""The surface of the undeformed particle, which moves with the points ("carried surface").

Contact, measures and figures of the particle use it. Each vertex of the undeformed surface is a fixed linear combination of nearby
points (linear moving least squares in the reference configuration). The deformed surface is exact for any affine motion, and lies
on the material surface, not half a spacing inside it.
"""

from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack
from scipy.spatial import cKDTree

from ..core.arrays import occurring
from ..core.threads import together
from ..geometry.points import points_near
from ..geometry.products import combine_both, spread, times, times_rows
from ..geometry.triangles import edges

SUPPORT = 2.2  # spacings: about 20 points on the inner side of a vertex
LEAST, INSTEAD = 8, 12  # a vertex with fewer than LEAST points within SUPPORT uses its INSTEAD nearest points
BESIDE = 1.0  # spacings: a point closer to a vertex than this lies under it, in the outermost layer


class CarriedSurface:
    """Surface that the points X (n,3) m of a body carry. vertices (k,3) m, triangles (m,3): surface of the undeformed body; spacing
    (m): spacing of the points."""

    def __init__(self, X: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, spacing: float):
        self.triangles = triangles
        tree = cKDTree(X)
        near = points_near(tree, vertices, SUPPORT * spacing, LEAST, INSTEAD)
        rows, columns = np.repeat(np.arange(len(vertices)), np.diff(near.indptr)), near.indices
        d = (X[columns] - vertices[rows]) / spacing
        r = np.linalg.norm(d, axis=1) / SUPPORT
        w = np.clip(1.0 - r, 0.02, None) ** 2
        p = np.concatenate([np.ones((len(d), 1)), d], axis=1)
        M = np.stack([np.bincount(rows, w * a * b) for a in p.T for b in p.T], axis=1).reshape(-1, 4, 4)
        c = np.linalg.solve(M, np.broadcast_to(np.array([[1.0], [0], [0], [0]]), (len(vertices), 4, 1)))[:, :, 0]
        phi = w * np.einsum("ij,ij->i", c[rows], p)
        shape = (len(vertices), len(X))
        self.weights = csr_matrix((phi, (rows, columns)), shape=shape)
        # The points are contact nodes too: the surface is an average, and a single point can pass through it.
        self.touching = W = vstack([self.weights, identity(len(X), format="csr")], format="csr")
        # unsigned integers: numba then does not test for negative indices
        self._touching = W.indptr.astype(np.uint32), W.indices.astype(np.uint32), W.data
        self.under = _under(tree, vertices, spacing)
        shepard = w / np.bincount(rows, w)[rows]
        self.average = csr_matrix((shepard, (rows, columns)), shape=shape)
        self._from_vertices = self.average.T

    @cached_property
    def neighbours(self) -> csr_matrix:
        """Adjacency matrix (k,k): 1 for two vertices of a common triangle."""
        vertices, (a, b) = self.weights.shape[0], edges(self.triangles).T  # of a closed surface: once in each direction
        return csr_matrix((np.ones(len(a)), (a, b)), shape=(vertices, vertices))

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Positions (k,3) m of the vertices, from the positions x (n,3) m of the points."""
        return times_rows(self.weights, x)

    def contacts(self, x: np.ndarray) -> np.ndarray:
        """Positions or velocities (k+n,3) of the contact nodes: first the vertices, then the points. x (n,3): positions or velocities
        of the points."""
        return times_rows(self.touching, x)

    def moving_contacts(
        self, x: np.ndarray, v: np.ndarray, rows: np.ndarray, out_x: np.ndarray, out_v: np.ndarray, out_f: np.ndarray
    ) -> None:
        """Write `contacts` for positions x and velocities v (n,3) to the given rows of out_x and out_v, and zero to these rows of
        out_f, in all threads."""
        together(combine_both, rows, self._touching, x, v, out_x, out_v, out_f)

    def spread(self, forces: np.ndarray, rows: np.ndarray, out: np.ndarray) -> None:
        """Add forces (k+n,3) on the given rows of `contacts` to the forces out (n,3) on the points `support(rows)`. Resultant,
        moment and power do not change."""
        spread(rows, *self._touching, forces, out)

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Sums (k,) of values (k+n,) of the contact nodes, such as forces, at each vertex: the value of the vertex plus shares of the
        values of the points under it."""
        vertices = len(self.weights.indptr) - 1
        return values[:vertices] + self.under @ values[vertices:]

    def support(self, rows: np.ndarray) -> np.ndarray:
        """Points (p,), ascending, on which the given rows of `contacts` depend and which receive their forces."""
        return occurring(self.touching[rows].indices, self.touching.shape[1])

    def spread_heat(self, heat: np.ndarray) -> np.ndarray:
        """Distribute heat (k+n,) J at `contacts` to the points (n,)."""
        vertices = self.average.shape[0]
        return heat[vertices:] + self._from_vertices @ heat[:vertices]

    def softness(self, mass: np.ndarray) -> float:
        """Largest inverse effective mass of a contact node, 1/kg: sum of weight^2 / mass over its points. mass (n,) kg: of the
        points."""
        return float((self.touching.multiply(self.touching) @ (1.0 / mass)).max())

    def values(self, field: np.ndarray) -> np.ndarray:
        """Averages at the vertices of a field (n, ...) of the points; they lie within the range of the points' values."""
        if field.ndim == 1:
            return times(self.average, field)
        return times_rows(self.average, field) if field.shape[1] == 3 else self.average @ field


def _under(tree: cKDTree, vertices: np.ndarray, spacing: float) -> csr_matrix:
    """Matrix (k,n) that divides the value of each of n points equally among the vertices within BESIDE spacings of the point.
    The column of a point sums to one, or to zero for a point deep in the body."""
    near = tree.sparse_distance_matrix(cKDTree(vertices), BESIDE * spacing, output_type="coo_matrix").tocsr()
    near.data[:] = 1.0
    shares = near.multiply(1.0 / np.maximum(near.sum(axis=1), 1.0))
    return shares.T.tocsr()
