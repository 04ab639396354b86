"""The spot of the spray: mass flow of the powder as a function of the distance from the axis of the gun."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

_RINGS, _FINE = 400, 2001  # number of rings; points of tables

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spot:
    """Rings, each with a constant mass flow density. radius (n + 1,): radii of the edges of the rings, m, the first is 0; flow (n,)
    1/m2: mass flow density of each ring divided by the total mass flow."""

    radius: Array
    flow: Array

    @classmethod
    def of_points(cls, radius: Array, flow: Array) -> "Spot":
        """The spot with given mass flow densities, in any unit, at ascending radii (m), linear between them. Raises ValueError if the
        radii do not ascend, a value is negative, or all densities are zero."""
        ascend = len(radius) > 1 and radius[0] >= 0.0 and bool((np.diff(radius) > 0.0).all())
        if not (ascend and flow.min() >= 0.0 and 0.0 < flow.max() < math.inf):
            raise ValueError(
                "needs ascending radii and mass flows, all of them zero or more, and one mass flow above zero"
            )
        edges = np.linspace(0.0, radius[-1], _RINGS + 1)
        mean = np.interp(0.5 * (edges[1:] + edges[:-1]), radius, flow)
        return cls(edges, mean / (math.pi * float(mean @ np.diff(edges**2))))

    @property
    def reach(self) -> float:
        """Radius of the spot, m."""
        return float(self.radius[-1])

    def across(self, x: ArrayLike) -> Array:
        """Mass of a pass per unit of width at distances x (k,) m from the line of the gun, divided by the mass of the pass, 1/m. A
        parallel to this line at x crosses the rings: the result is the sum of flow times length of the parallel in each ring."""
        chords = 2.0 * np.sqrt(np.maximum(self.radius**2 - np.asarray(x, np.float64)[..., None] ** 2, 0.0))
        return np.asarray(np.diff(chords) @ self.flow, np.float64)

    @cached_property
    def table(self) -> tuple[Array, Array, Array]:
        """Distances (k,) m from the line of a pass, ascending from -reach to reach; `across` at each distance; and the share, 0 to 1,
        of the mass at smaller distances."""
        s = np.linspace(-self.reach, self.reach, _FINE)
        density = self.across(s)
        left = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
        return s, density, left / left[-1]

    def along(self, x: float, shares: Array) -> Array:
        """Positions (k,) m of the gun on its line at which a point has received the shares (k,), 0 to 1, of the mass that it gets
        from the pass. x: distance of the point from the line, m, within the spot."""
        half = math.sqrt(self.reach**2 - x**2)
        y = np.linspace(-half, half, _FINE)
        middles = 0.5 * (self.radius[1:] + self.radius[:-1])
        flow = np.interp(np.hypot(x, 0.5 * (y[1:] + y[:-1])), middles, self.flow)
        got = np.concatenate([[0.0], np.cumsum(flow)])
        return np.asarray(np.interp(shares, got / got[-1], y), np.float64)
