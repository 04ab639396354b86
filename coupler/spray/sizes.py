"""Size distribution of a powder: cumulative mass fractions by diameter."""

from collections.abc import Sequence
from math import exp, log
from statistics import NormalDist
from typing import NamedTuple

SIEVED = 0.05  # mass fraction below a sieve range, and above it, as suppliers allow

_NORMAL = NormalDist()


class Sizes(NamedTuple):
    """A size distribution. known (n,): diameters, m; share (n,): mass fraction of the particles smaller than each diameter, above 0 and
    below 1. Both ascend, n >= 2. The logarithm of the diameter is linear in the quantile of the normal distribution (log-normal)
    between these points and beyond them."""

    share: tuple[float, ...]
    known: tuple[float, ...]

    @classmethod
    def of_diameters(cls, *known: float) -> "Sizes":
        """The size distribution for known diameters, m: D10, D50 and D90 by mass, or two sieve sizes. In the second case the mass
        fraction SIEVED lies below the smaller sieve size, and the same fraction above the larger one."""
        return cls((SIEVED, 1.0 - SIEVED) if len(known) == 2 else (0.1, 0.5, 0.9), known)

    @classmethod
    def of_classes(cls, edges: Sequence[float], shares: Sequence[float]) -> "Sizes":
        """The distribution with n mass fractions, in any unit, between n + 1 ascending diameters (m). Raises ValueError if fewer than
        three size classes contain powder."""
        whole, below = sum(shares), 0.0
        known: list[tuple[float, float]] = []
        for edge, share in zip(edges[1:], shares, strict=True):
            below += share
            if 0.0 < below < (1.0 - 1e-9) * whole and (not known or below / whole > known[-1][0]):
                known.append((below / whole, edge))
        if len(known) < 2:
            raise ValueError("fewer than three size classes contain powder: give more classes, or D10, D50 and D90")
        return cls(*zip(*known, strict=True))

    def diameter(self, share: float) -> float:
        """Diameter, m, at a cumulative mass fraction, 0 < share < 1."""
        k = min(max(sum(known <= share for known in self.share), 1), len(self.share) - 1)
        z, low, high = (_NORMAL.inv_cdf(u) for u in (share, self.share[k - 1], self.share[k]))
        a, b = log(self.known[k - 1]), log(self.known[k])
        return exp(a + (b - a) * (z - low) / (high - low))
