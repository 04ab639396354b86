"""The distribution of each measure over the runs of an ensemble: quantiles, rank correlations, figure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from ..measures import Measure, axis_label, measure
from ..report.figure import blank, save
from .runs_table import MEASURES, Row, errors_of
from .table import write_rows

SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)
LEFT_OUT = ("wall_s", "energy_drift", "velocity_ratio")  # of MEASURES: they do not describe the splat
FEWEST = 3  # runs


@dataclass(frozen=True)
class Spread:
    """The distribution of a measure in the runs. values (n,): SI, ascending; quantiles: at SHARES, SI; correlations: Spearman's rank
    correlation with each key of the scene; error: median of the resolution errors, SI, None if no run measures it."""

    measure: Measure
    values: NDArray[np.float64]
    quantiles: tuple[float, ...]
    correlations: dict[str, float]
    error: float | None

    @property
    def strongest(self) -> str:
        """Text: the key with the strongest rank correlation, and this correlation; "" if there is none."""
        if not self.correlations:
            return ""
        key = max(self.correlations, key=lambda name: abs(self.correlations[name]))
        return f"{key} {self.correlations[key]:+.2f}"


def varied_numbers(rows: Sequence[Row], varied: Sequence[str]) -> tuple[str, ...]:
    """Keys of the numbers that differ between rows and belong to one of the keys `varied`: "particle.offset[1]" belongs to
    "particle.offset"."""
    keys = {key: None for row in rows for key in row["keys"] if key in varied or key.partition("[")[0] in varied}
    return tuple(key for key in keys if len({row["keys"].get(key) for row in rows if row["keys"]}) > 1)


def spreads(rows: Sequence[Row], keys: Sequence[str]) -> list[Spread]:
    """The distribution of each measure that at least FEWEST finished runs have. keys: names of the numbers that vary between the
    scenes (`varied_numbers`)."""
    result = []
    for name in MEASURES:
        used = [row for row in rows if row["status"] == "done" and row[name] is not None]
        if name in LEFT_OUT or len(used) < FEWEST:
            continue
        y = np.array([row[name] for row in used], float)
        correlations = {}
        for key in keys:
            x = np.array([row["keys"].get(key, np.nan) for row in used], float)
            if np.ptp(x) > 0.0 and np.ptp(y) > 0.0:  # false for nan, too
                correlations[key] = float(spearmanr(x, y).statistic)
        quantiles = tuple(float(q) for q in np.quantile(y, SHARES))
        error = float(np.median(errors)) if (errors := errors_of(rows, name)) else None
        result.append(Spread(measure(name), np.sort(y), quantiles, correlations, error))
    return result


def write_spreads(path: Path, measures: Sequence[Spread], about: str) -> None:
    """Write a row for each measure as CSV, SI units. Raises StoreError."""
    keys = dict.fromkeys(key for spread in measures for key in spread.correlations)
    names, of_keys = [f"quantile_{share:g}" for share in SHARES], [f"rank_correlation {key}" for key in keys]
    columns, rows = ("measure", "runs", "mean", "deviation", "error", *names, *of_keys), []
    for s in measures:
        mean, deviation = float(s.values.mean()), float(s.values.std(ddof=1))
        numbers = s.measure.key, len(s.values), mean, deviation, s.error, *s.quantiles, *map(s.correlations.get, keys)
        rows.append(dict(zip(columns, numbers, strict=True)))
    write_rows(path, columns, rows, about)


def draw_spreads(path: Path, measures: Sequence[Spread], heading: str) -> None:
    """Draw the cumulative distribution of each measure in a panel. The range between the first and the last of SHARES is shaded."""
    columns = min(3, len(measures))
    rows = math.ceil(len(measures) / columns)
    figure = blank(3.6 * columns, 2.7 * rows + 0.3, dpi=130, layout="constrained")
    for place, spread in enumerate(measures, 1):
        at, m = figure.add_subplot(rows, columns, place), spread.measure
        n, scaled = len(spread.values), m.factor * np.array(spread.quantiles)
        at.axvspan(scaled[0], scaled[-1], color="#0072b2", alpha=0.15, linewidth=0)
        at.axvline(scaled[len(SHARES) // 2], color="#0072b2", linewidth=1.0)
        at.step(m.factor * spread.values, np.arange(1, n + 1) / n, where="post", color="k", linewidth=1.0)
        at.set_ylim(0.0, 1.02)
        at.margins(x=0.04)
        at.set_xlabel(axis_label(m.key, whole=True), fontsize=8)
        at.tick_params(labelsize=7)
        if (place - 1) % columns == 0:
            at.set_ylabel("share of the runs below this value", fontsize=8)
    figure.suptitle(heading, fontsize=10)
    save(figure, path)
