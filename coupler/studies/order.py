"""The observed order of convergence of a measure, with its confidence interval."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri  # the quantile of Fisher's distribution

from ..plan.refinement import line

FEWEST = 4  # resolutions: one more than the fit of one case has unknowns
Case = tuple[NDArray, NDArray]  # h (k,), the spacing in any unit, and values (k,)


@dataclass(frozen=True)
class OrderFit:
    """order: the best; low, high: the 95 % interval, which ends where the orders tried end; scatter: root mean square of the
    residuals of all cases; at_bound: whether the interval reaches an end of the orders tried (low, high)."""

    order: float
    low: float
    high: float
    scatter: float
    at_bound: tuple[bool, bool]

    @property
    def is_determined(self) -> bool:
        return not all(self.at_bound)

    def interval(self) -> tuple[str, str]:
        """Its ends in words: "0.5", or "below 0.5" at the least order tried."""
        low, high = f"{self.low:.2g}", f"{self.high:.2g}"
        return f"below {low}" if self.at_bound[0] else low, f"above {high}" if self.at_bound[1] else high


def fit_order(cases: Sequence[Case], orders: NDArray, limit: float | None = None) -> OrderFit:
    """Fit value = v + a h^p by least squares; v and a of each case its own, the order p common, among `orders` (q,).

    limit: v where it is known. The interval holds the orders that an F test at 95 % does not tell from the best. Cases of fewer
    than FEWEST resolutions are left out; raises ValueError if none is left.
    """
    used = [(h, y) for h, y in cases if len(h) >= FEWEST]
    if not used:
        raise ValueError(
            f"an order needs at least {FEWEST} resolutions, not {max((len(h) for h, _ in cases), default=0)}"
        )
    squares = np.array([sum(float(np.sum(line(h, y, p, limit)[2] ** 2)) for h, y in used) for p in orders])
    unknowns = 2 if limit is None else 1
    free = sum(len(h) - unknowns for h, _ in used) - 1
    best = int(squares.argmin())
    same = orders[squares <= squares[best] * (1.0 + fdtri(1, free, 0.95) / free)]
    scatter = float(np.sqrt(squares[best] / sum(len(h) for h, _ in used)))
    low, high = float(same.min()), float(same.max())
    return OrderFit(float(orders[best]), low, high, scatter, (low <= orders[0], high >= orders[-1]))
