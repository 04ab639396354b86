"""What a ladder's table teaches: errors against the reference, orders, and what is packaged of them for `coupler.plan.bands`."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..measures import BANDED
from ..measures import measure as record
from .ladder import KNOBS, finished

ORDERS = np.linspace(0.5, 2.0, 61)  # of the spacing: slower would be no convergence, faster is beyond both schemes
USUAL = 1.0  # the order taken where the ladder does not exclude it: that of the particle's viscosity and of the contact's penalty
FEWEST = 4  # resolutions, the reference among them: one more than a fit has numbers
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


def order(cases: Sequence[tuple[np.ndarray, np.ndarray]]) -> dict[str, float]:
    """Fit y = v + a h^p by least squares, v and a of each case its own, the order p common, within ORDERS.

    cases: pairs h (k,), y (k,). Returns fitted, low and high (what an F test at 95 % takes for the same), and order: USUAL if
    that lies between them, else the fitted one. Raises ValueError without a case of FEWEST resolutions.
    """
    from scipy.special import fdtri  # the quantile of Fisher's distribution

    cases = [(h, y) for h, y in cases if len(h) >= FEWEST]
    if not cases:
        raise ValueError(f"an order needs {FEWEST} resolutions at least, the reference among them")
    left = np.array([sum(float(np.sum(_line(h, y, p)[2] ** 2)) for h, y in cases) for p in ORDERS])
    best, free = int(left.argmin()), sum(len(h) - 2 for h, _ in cases) - 1
    same = left <= left[best] * (1.0 + fdtri(1, free, 0.95) / free)
    fitted, low, high = (float(p) for p in (ORDERS[best], ORDERS[same].min(), ORDERS[same].max()))
    return {"order": USUAL if low <= USUAL <= high else fitted, "fitted": fitted, "low": low, "high": high}


def _line(h: np.ndarray, y: np.ndarray, p: float) -> tuple[float, float, np.ndarray]:
    """Limit, slope and what is left (k,) of y = v + a h^p."""
    A = np.stack([np.ones_like(h), h**p], axis=1)
    (v, a), *_ = np.linalg.lstsq(A, y, rcond=None)
    return float(v), float(a), y - A @ [v, a]


def packaged(cases: Mapping[str, tuple[Mapping[str, Any], Sequence[Row]]]) -> list[dict[str, Any]]:
    """Rows of `coupler/plan/bands.csv`: what bands are made of, for each case and measure that converges.

    cases: name -> what is said of it (speed m/s, temperature K, impacts) and the rows of its table. Single impacts share the
    order of each measure; a sequence takes theirs.
    """
    singles = [about for about in cases.values() if about[0]["impacts"] == 1]
    found = []
    for measure in BANDED:
        fitted = order([resolutions(rows, measure, about["temperature"]) for about, rows in singles])
        for name, (about, rows) in cases.items():
            h, y = resolutions(rows, measure, about["temperature"])
            if len(h) < 3:
                continue
            limit, slope, left = _line(h, y, fitted["order"])
            best = reference(rows)
            found.append({
                "case": name, "impacts": about["impacts"], "speed": about["speed"], "measure": measure,
                "points_from": round(float(h.max()) ** -3), "points_to": round(float(h.min()) ** -3),
                "reference": value(best, measure, about["temperature"]) if best else math.nan, "limit": limit, **fitted,
                "slope": abs(slope), "scatter": float(np.sqrt(np.mean(left**2))), **_knobs(rows, measure, about["temperature"]),
            })  # fmt: skip
    return found


def _knobs(rows: Sequence[Row], measure: str, T_0: float) -> dict[str, Any]:
    """Half of what each knob of the scheme moves a measure by over the values tried, over the reference; and at how many points."""
    best = reference(rows)
    found: dict[str, Any] = {"knobs_at": ""}
    for axis in KNOBS:
        tried = [row for row in finished(rows) if row["axis"] == axis]
        found[axis] = ""
        if not tried or best is None:
            continue
        plain = [r for r in finished(rows) if r["axis"] == "points" and r["points"] == tried[0]["points"]]
        values = [value(row, measure, T_0) for row in (*tried, *plain)]
        found[axis] = 0.5 * (max(values) - min(values)) / abs(value(best, measure, T_0))
        found["knobs_at"] = round(float(tried[0]["points_used"]))
    return found
