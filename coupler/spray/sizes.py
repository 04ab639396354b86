"""Sizes of a powder: the diameters below which shares of its mass are."""

from collections.abc import Sequence
from math import exp, log
from statistics import NormalDist
from typing import NamedTuple

SIEVED = 0.05  # of the mass, below and above a sieve range: what suppliers allow on either side

_NORMAL = NormalDist()


class Sizes(NamedTuple):
    """share, diameter (n,), both ascending, n >= 2: below each diameter (m) is this share of the mass, 0 < share < 1. Between them, and
    beyond the first and the last, the logarithm of the diameter is linear in the quantile of the normal distribution: log-normal."""

    share: tuple[float, ...]
    known: tuple[float, ...]

    @classmethod
    def of_quantiles(cls, d10: float, d50: float, d90: float) -> "Sizes":
        """From the diameters (m) below which 10, 50 and 90 % of the mass are."""
        return cls((0.1, 0.5, 0.9), (d10, d50, d90))

    @classmethod
    def of_sieves(cls, smallest: float, largest: float) -> "Sizes":
        """From a range of sieves (m), with SIEVED of the mass on either side of it."""
        return cls((SIEVED, 1.0 - SIEVED), (smallest, largest))

    @classmethod
    def of_classes(cls, edges: Sequence[float], shares: Sequence[float]) -> "Sizes":
        """From n shares, in any unit, of the mass between n + 1 ascending diameters (m). Raises ValueError where fewer than two
        diameters have powder on both sides."""
        whole, below = sum(shares), 0.0
        known: list[tuple[float, float]] = []
        for edge, share in zip(edges[1:], shares, strict=True):
            below += share
            if 0.0 < below < (1.0 - 1e-9) * whole and (not known or below / whole > known[-1][0]):
                known.append((below / whole, edge))
        if len(known) < 2:
            raise ValueError("fewer than three classes of size contain powder: give more classes, or D10, D50 and D90")
        return cls(*zip(*known, strict=True))

    def diameter(self, share: float) -> float:
        """Diameter, m, below which a share of the mass is, 0 < share < 1."""
        k = min(max(sum(known <= share for known in self.share), 1), len(self.share) - 1)
        z, low, high = (_NORMAL.inv_cdf(u) for u in (share, self.share[k - 1], self.share[k]))
        a, b = log(self.known[k - 1]), log(self.known[k])
        return exp(a + (b - a) * (z - low) / (high - low))
