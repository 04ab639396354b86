"""Evaluation of a ladder: errors against the reference, orders, and the rows of `coupler/plan/bands.csv`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..measures import BANDED
from ..measures import measure as record
from .ladder import KNOBS, finished
from .order import Case, OrderFit, fit_order, line

ORDERS = np.linspace(0.5, 2.0, 61)  # of the spacing: the schemes converge no faster
USUAL = 1.0  # the order taken where the ladder does not exclude it: that of the particle's viscosity and of the contact's penalty
PERCENT_AT_LEAST = 1e-3  # errors are drawn no lower, in percent: a log axis has no zero
Row = Mapping[str, str]


def value(row: Row, measure: str, T_0: float) -> float:
    """A measure of a row; temperatures as their rise over T_0, K, the particle's before the impact."""
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


def order(cases: Sequence[Case]) -> tuple[float, OrderFit]:
    """The order to use and its fit: USUAL where the fit does not exclude it, else the fitted one. cases: h (k,), values (k,).

    Raises ValueError without a case of `order.FEWEST` resolutions.
    """
    fit = fit_order(cases, ORDERS)
    return (USUAL if fit.low <= USUAL <= fit.high else fit.order), fit


@dataclass(frozen=True)
class StudyCase:
    """A scene of the accuracy study. impacts: of the run; speed m/s and temperature K: of its last particle; rows: of its ladder."""

    name: str
    impacts: int
    speed: float
    temperature: float
    rows: Sequence[Row]


def packaged(cases: Sequence[StudyCase]) -> list[dict[str, object]]:
    """Rows of `coupler/plan/bands.csv`: what bands are made of, for each case and measure that converges.

    Single impacts share the order of each measure; a sequence takes theirs.
    """
    packed: list[dict[str, object]] = []
    for measure in BANDED:
        used, fit = order([resolutions(c.rows, measure, c.temperature) for c in cases if c.impacts == 1])
        for case in cases:
            h, y = resolutions(case.rows, measure, case.temperature)
            if len(h) < 3:
                continue
            limit, slope, residuals = line(h, y, used)
            best = reference(case.rows)
            packed.append({
                "case": case.name, "impacts": case.impacts, "speed": case.speed, "measure": measure,
                "points_from": round(float(h.max()) ** -3), "points_to": round(float(h.min()) ** -3),
                "reference": value(best, measure, case.temperature) if best else math.nan, "limit": limit,
                "order": used, "fitted": fit.order, "low": fit.low, "high": fit.high,
                "slope": abs(slope), "scatter": float(np.sqrt(np.mean(residuals**2))),
                **_knobs(case.rows, measure, case.temperature),
            })  # fmt: skip
    return packed


def _knobs(rows: Sequence[Row], measure: str, T_0: float) -> dict[str, object]:
    """Half of what each knob of the scheme moves a measure by over the values tried, over the reference; and at how many points."""
    best = reference(rows)
    shares: dict[str, object] = {"knobs_at": ""}
    for axis in KNOBS:
        tried = [row for row in finished(rows) if row["axis"] == axis]
        shares[axis] = ""
        if not tried or best is None:
            continue
        plain = [r for r in finished(rows) if r["axis"] == "points" and r["points"] == tried[0]["points"]]
        values = [value(row, measure, T_0) for row in (*tried, *plain)]
        shares[axis] = 0.5 * (max(values) - min(values)) / abs(value(best, measure, T_0))
        shares["knobs_at"] = round(float(tried[0]["points_used"]))
    return shares
