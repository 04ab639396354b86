"""Evaluation of a ladder: errors against the reference, and the observed order of convergence with its confidence interval."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri  # the quantile of Fisher's distribution

from ..measures import measure as record
from ..plan.refinement import ORDERS, error, line
from .ladder import finished

FEWEST = 4  # resolutions of an order: one more than its fit has unknowns
PERCENT_AT_LEAST = 1e-3  # errors are drawn no lower, in percent: a log axis has no zero
Row = Mapping[str, str]


def value(row: Row, measure: str, T_0: float) -> float:
    """Value of a measure in a row; of a temperature its rise over T_0, K, the temperature of the particle before the impact."""
    return float(row[measure]) - record(measure).initial(T_0)


def reference(rows: Sequence[Row]) -> Row | None:
    """The row of the reference, if it is there and finished."""
    return next((row for row in finished(rows) if row["axis"] == "reference"), None)


def errors(rows: Sequence[Row], measure: str, T_0: float) -> list[tuple[Row, float]]:
    """Finished rows but the reference, each with its difference from the reference in percent of it; empty without one."""
    best = reference(rows)
    if best is None:
        return []
    whole = value(best, measure, T_0)
    if whole == 0.0:
        return []
    judged = [row for row in finished(rows) if row["axis"] != "reference"]
    return [(row, 100.0 * (value(row, measure, T_0) - whole) / abs(whole)) for row in judged]


def _by_points(rows: Sequence[Row]) -> list[Row]:
    """The finished rows of points and reference, the coarse ones first."""
    ladder = [row for row in finished(rows) if row["axis"] in ("points", "reference")]
    return sorted(ladder, key=lambda row: float(row["points_used"]))


def _spacing(row: Row) -> float:
    """The spacing in units that are the same for all rows of a scene."""
    return float(row["points_used"]) ** (-1.0 / 3.0)


def resolutions(rows: Sequence[Row], measure: str, T_0: float) -> tuple[np.ndarray, np.ndarray]:
    """h (k,), the spacing as N^(-1/3), and the measure over the reference's (k,), of the ladder of points and the reference."""
    best = reference(rows)
    if best is None or not value(best, measure, T_0):
        return np.zeros(0), np.zeros(0)
    ladder = _by_points(rows)
    h = np.array([_spacing(row) for row in ladder])
    return h, np.array([value(row, measure, T_0) for row in ladder]) / value(best, measure, T_0)


def errors_of_ladder(rows: Sequence[Row], measure: str) -> list[tuple[Row, float | None]]:
    """The rows of points and reference, the coarse ones first, each with the error of a measure, in its own unit, that follows from it
    and the three next coarser ones (`plan.refinement.error`); None where there is none coarser."""
    ladder = _by_points(rows)
    found: list[tuple[Row, float | None]] = []
    for k, row in enumerate(ladder):
        levels = ladder[max(k - 3, 0) : k + 1][::-1]
        h = [_spacing(each) for each in levels]
        values = [float(each[measure] or "nan") for each in levels]
        known = len(levels) > 1 and all(map(math.isfinite, values))
        found.append((row, error(h, values)[0] if known else None))
    return found


def fit_order(h: NDArray, values: NDArray) -> tuple[float, float, float]:
    """Fit value = v + a h^p by least squares, p among ORDERS. h (k,): the spacing in any unit, values (k,). Returns the best order, and
    the least and the greatest that an F test at 95 % does not tell from it. Raises ValueError for fewer than FEWEST resolutions."""
    if len(h) < FEWEST:
        raise ValueError(f"an order needs at least {FEWEST} resolutions, not {len(h)}")
    squares = np.array([float(np.sum(line(h, values, p)[2] ** 2)) for p in ORDERS])
    best, free = int(squares.argmin()), len(h) - 3
    same = ORDERS[squares <= squares[best] * (1.0 + fdtri(1, free, 0.95) / free)]
    return float(ORDERS[best]), float(same.min()), float(same.max())
