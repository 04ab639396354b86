"""Types of arrays and of small matrices in the kernels."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.integer]
Bools: TypeAlias = NDArray[np.bool_]
Laws: TypeAlias = NDArray[np.void]  # records of `physics.constitutive.LAW`
Arrays: TypeAlias = tuple[Any, ...]  # arguments of a kernel, as they follow each other
Vector: TypeAlias = tuple[float, float, float]
Symmetric: TypeAlias = tuple[float, float, float, float, float, float]  # xx yy zz yz xz xy
Matrix: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]  # row by row
