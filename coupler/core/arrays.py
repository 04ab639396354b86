"""Types of arrays and of small matrices in the kernels."""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.integer]
Bools: TypeAlias = NDArray[np.bool_]
Laws: TypeAlias = NDArray[np.void]  # records of `physics.constitutive.LAW`
Faces: TypeAlias = NDArray[np.void]  # records of `contact.model.FACE`
Histories: TypeAlias = NDArray[np.void]  # records of `contact.model.HISTORY`
History: TypeAlias = Any  # one record of Histories
Arrays: TypeAlias = tuple[Any, ...]  # arguments of a kernel, in their order
Vector: TypeAlias = tuple[float, float, float]
Symmetric: TypeAlias = tuple[float, float, float, float, float, float]  # xx yy zz yz xz xy
Matrix: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]  # row by row


def occurring(ids: Ints, n: int) -> NDArray[np.int64]:
    """The indices below n that occur in an array, ascending. The result is that of `numpy.unique`, in a tenth of the time."""
    has = np.zeros(n, np.bool_)
    has[ids] = True
    return np.flatnonzero(has)


class Links(NamedTuple):
    """Springs or thermal contacts between nodes and points on triangles. ends (k,4): node and corners of the triangle. weights (k,4):
    1, then the negative barycentric coordinates; the weighted sum of positions is the distance vector. strength (k,): stiffness of a
    spring, the largest over all directions, N/m; conductance of a contact for a conductivity of 1, m."""

    ends: Ints
    weights: Floats
    strength: Floats

    @classmethod
    def of(cls, nodes: Ints, triangles: Ints, weights: Floats, strength: Floats) -> "Links":
        """Links between nodes (k,) and points on triangles (k,3). weights (k,3): barycentric coordinates of the points."""
        return cls(np.column_stack([nodes, triangles]), np.column_stack([np.ones(len(nodes)), -weights]), strength)

    @classmethod
    def joined(cls, parts: Sequence["Links"]) -> "Links":
        """One table with the rows of several tables; empty if there are none."""
        none = cls(np.zeros((0, 4), np.int64), np.zeros((0, 4)), np.zeros(0))
        return cls(*map(np.concatenate, zip(none, *parts, strict=True)))

    def row_sums(self) -> Floats:
        """Sums (k,4) of the absolute values in each row of a link's 4 x 4 matrix, in the order of its ends."""
        share = np.abs(self.weights)
        return self.strength[:, None] * share * (1.0 + share[:, 1:].sum(axis=1))[:, None]

    def load(self, size: int) -> Floats:
        """`row_sums` of all links, added at each of `size` nodes: the largest sum / mass is an upper bound on omega^2 (Gershgorin)."""
        return np.asarray(np.bincount(self.ends.ravel(), self.row_sums().ravel(), size), float)
