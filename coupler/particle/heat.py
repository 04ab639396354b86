"""Heat conduction among the points of the particle: Fourier's law with the fixed reference neighbours.

Gradients in the reference configuration, g = G T, are moving least squares over the neighbours. They are exact for linear fields,
also at the free surface; so is the deformation gradient F = G x. Conduction in the deformed body is conduction in the reference
body with the conductivity k J F^-1 F^-T. The heat flow into the points is minus the derivative of

    sum V g . (k J F^-1 F^-T) g / 2  +  sum c (R T)^2 / 2.

The second term damps fields that alternate from point to point, for which the first term is zero. R T is the temperature of a point
less its estimate from the neighbours and their gradient. It is zero for a linear field, so that its contribution falls with the
square of the spacing. Both terms are sums of squares: conduction conserves heat to rounding and only reduces differences of
temperature. The surface is adiabatic.
"""

from math import ceil

import numpy as np
from scipy.spatial import cKDTree

from ..core import safety
from ..core.loops import PARTS
from ..core.threads import together
from ..geometry.points import points_near
from . import heat_kernels as k

LEAST = 11  # smallest number of points in the fit of a gradient, including the point itself


class PointConduction:
    """Conduction among all points of one particle. X (n,3) m: reference positions; spacing (m); volume (n,) m3; law (k,): LAW
    records; law_of (n,): number of the law of each point, default that of one law."""

    def __init__(
        self, X: np.ndarray, spacing: float, volume: np.ndarray, law: np.ndarray, law_of: np.ndarray | None = None
    ):
        n, near = len(X), points_near(cKDTree(X), X, k.SUPPORT * spacing, LEAST, LEAST)
        self.law, self.spacing = law, spacing
        start, columns = near.indptr.astype(np.uint32), near.indices.astype(np.uint32)
        reach, weights = np.zeros((n, 4)), np.zeros((len(columns), 4))
        self.operators = k.Operators(start, columns, weights)
        together(k.fit, n, spacing, X, self.operators, reach)
        near.data = np.arange(len(columns))
        back = near.tocsc()
        self._transposed = k.Operators(
            back.indptr.astype(np.uint32), back.indices.astype(np.uint32), weights[back.data]
        )
        (D, kD), (c, capacity, T, gained) = np.zeros((2, n, 6)), np.zeros((4, n))
        law_of = np.zeros(n, np.int32) if law_of is None else law_of
        self._flow = k.Conduction(law_of, volume, reach, D, kD, c, capacity, np.zeros((n, 4)), T, gained)

    def share(self, time: float, x: np.ndarray, T: np.ndarray) -> np.ndarray:
        """Heat (n,) J that points gain by conduction over `time` s. x (n,3) m: positions; T (n,) K: temperatures before.

        Explicit steps, as many as stability requires. The sum over all points is zero to rounding.
        """
        n, left, flow, operators = len(T), time, self._flow, (self.operators, self._transposed)
        flow.T[:], flow.gained[:] = T, 0.0
        while left > 0.0:
            rates = np.zeros(PARTS)
            together(k.prepare, n, self.law, self.spacing, x, *operators, flow, rates)
            dt = left / ceil(left * rates.max() / (2.0 * safety.CONDUCTION))
            together(k.conduct, n, dt, *operators, flow)
            left = left - dt if left > 1.5 * dt else 0.0
        return flow.gained.copy()
