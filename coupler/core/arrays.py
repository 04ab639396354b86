"""Types of arrays and of small matrices in the kernels."""

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.integer]
Bools: TypeAlias = NDArray[np.bool_]
Laws: TypeAlias = NDArray[np.void]  # records of `physics.constitutive.LAW`
Faces: TypeAlias = NDArray[np.void]  # records of `contact.model.FACE`
Histories: TypeAlias = NDArray[np.void]  # records of `contact.model.HISTORY`
History: TypeAlias = Any  # one of these
Arrays: TypeAlias = tuple[Any, ...]  # arguments of a kernel, as they follow each other
Vector: TypeAlias = tuple[float, float, float]
Symmetric: TypeAlias = tuple[float, float, float, float, float, float]  # xx yy zz yz xz xy
Matrix: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]  # row by row


def occurring(ids: Ints, n: int) -> NDArray[np.int64]:
    """The numbers below n that occur in an array, ascending: as `numpy.unique`, ten times as fast."""
    has = np.zeros(n, np.bool_)
    has[ids] = True
    return np.flatnonzero(has)


class SpringTable(NamedTuple):
    """Springs between nodes and points on triangles. ends (k,4): the node and the corners; weights (k,4): 1 and minus the barycentric
    coordinates, so that the weighted sum of positions is the distance vector; stiffness (k,) N/m: the largest of all directions."""

    ends: Ints
    weights: Floats
    stiffness: Floats

    @classmethod
    def of(cls, nodes: Ints, triangles: Ints, weights: Floats, stiffness: Floats) -> "SpringTable":
        """Table of springs between nodes (k,) and points with barycentric coordinates weights (k,3) on triangles (k,3)."""
        return cls(
            np.concatenate([nodes[:, None], triangles], axis=1),
            np.concatenate([np.ones((len(nodes), 1)), -weights], axis=1),
            stiffness,
        )
