"""Evaluation of a ladder: errors against the reference, and orders."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..measures import measure as record
from ..plan.refinement import error
from .ladder import finished
from .order import Case, OrderFit, fit_order

ORDERS = np.linspace(0.5, 2.0, 61)  # of the spacing: the schemes converge no faster
USUAL = 1.0  # the order used where the ladder does not exclude it: that of the particle's viscosity and of the contact's penalty
PERCENT_AT_LEAST = 1e-3  # errors are drawn no lower, in percent: a log axis has no zero
Row = Mapping[str, str]


def value(row: Row, measure: str, T_0: float) -> float:
    """Value of a measure in a row; of a temperature its rise over T_0, K, that of the particle before the impact."""
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


def resolutions(rows: Sequence[Row], measure: str, T_0: float) -> tuple[np.ndarray, np.ndarray]:
    """h (k,), the spacing as N^(-1/3), and the measure over the reference's (k,), of the ladder of points and the reference."""
    best = reference(rows)
    ladder = [row for row in finished(rows) if row["axis"] in ("points", "reference")]
    if best is None or not value(best, measure, T_0):
        return np.zeros(0), np.zeros(0)
    ladder.sort(key=lambda row: float(row["points_used"]))
    h = np.array([float(row["points_used"]) ** (-1.0 / 3.0) for row in ladder])
    return h, np.array([value(row, measure, T_0) for row in ladder]) / value(best, measure, T_0)


def errors_of_ladder(rows: Sequence[Row], measure: str) -> list[tuple[Row, float | None]]:
    """The rows of points and reference, the coarse ones first, each with the error of a measure, in its own unit, that follows from it
    and the three next coarser ones (`plan.refinement.error`); None where there is none coarser."""
    ladder = [row for row in finished(rows) if row["axis"] in ("points", "reference")]
    ladder.sort(key=lambda row: float(row["points_used"]))
    found: list[tuple[Row, float | None]] = []
    for k, row in enumerate(ladder):
        levels = ladder[max(k - 3, 0) : k + 1][::-1]
        h = [float(each["points_used"]) ** (-1.0 / 3.0) for each in levels]
        values = [float(each[measure] or "nan") for each in levels]
        known = len(levels) > 1 and all(map(math.isfinite, values))
        found.append((row, error(h, values)[0] if known else None))
    return found


def order(cases: Sequence[Case]) -> tuple[float, OrderFit]:
    """The order to use and its fit: USUAL where the fit does not exclude it, else the fitted one. cases: h (k,), values (k,).

    Raises ValueError without a case of `order.FEWEST` resolutions.
    """
    fit = fit_order(cases, ORDERS)
    return (USUAL if fit.low <= USUAL <= fit.high else fit.order), fit
