"""Growth of a coating: thickness, roughness and porosity after each impact, from the stored steps of a run, finished or not."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import StoreError
from ..files.result import Result
from ..report.picture import MICRO, blank, save
from .coating import COLUMN, disc_radius, read, shape
from .splats import Splats

COARSE = 2.0  # distance of the columns over their distance for the final measures
MOST = 60  # rows of the table
Row = dict[str, float]


def growth(result: Result, radius: float | None = None) -> list[Row]:
    """A row (see `row`) for each finished impact, at most MOST rows. radius (m): radius of the measured disc; default: the disc of
    the coating."""
    built = read(result)
    radius = radius or disc_radius(built)
    finished = len(built.mass)
    numbers = np.unique(np.linspace(2, finished, min(MOST, finished) - 1).round().astype(int))
    rows = [row(read(result, number), radius) for number in numbers.tolist()]
    return [*rows, row(built, radius)]


def latest(result: Result) -> Row:
    """The row after the impacts that are finished so far. Raises StoreError if no impact is finished."""
    number = int(result.history("impact").max(initial=0.0))
    if number < 2:
        raise StoreError(f"{result.directory}: no impact is finished yet: try again later")
    built = read(result, number)
    return row(built, disc_radius(built))


def row(built: Splats, radius: float) -> Row:
    """A row of the growth table. impacts: number of finished impacts; splats: number of splats in the coating; deposition_efficiency;
    measures of `coating.shape`."""
    counts = {"impacts": len(built.mass), "splats": float(np.count_nonzero(built.stayed))}
    measures = shape(built, radius, COARSE * COLUMN * built.element_size)
    return {**counts, "deposition_efficiency": built.deposition_efficiency, **measures}


def line(now: Row) -> str:
    """A row of the growth table as a text line."""
    return (
        f"after impact {now['impacts']:.0f}: splats {now['splats']:.0f}, thickness {now['thickness_mean_m'] * MICRO:.1f} um"
        f" (bare {now['bare_share']:.0%}), Sa {now['Sa_m'] * MICRO:.1f} um, porosity {now['porosity_closed']:.1%} closed,"
        f" {now['porosity_open']:.1%} open, deposition efficiency {now['deposition_efficiency']:.0%}"
    )


def draw(rows: list[Row], path: Path) -> Path:
    """Draw thickness with its range, roughness and porosity against the number of impacts, as PNG. Returns the path."""
    impacts = [each["impacts"] for each in rows]
    um = {key: np.array([each[key] for each in rows]) * MICRO for key in rows[0] if key.endswith("_m")}
    share = {key: 100.0 * np.array([each[key] for each in rows]) for key in ("porosity_open", "porosity_closed")}
    figure = blank(5.0, 5.5, 160, "constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.fill_between(impacts, um["thickness_min_m"], um["thickness_max_m"], color="0.88", label="smallest to largest")
    above.plot(impacts, um["thickness_mean_m"], "o-", color="black", markersize=3, label="mean thickness")
    above.plot(impacts, um["Sa_m"], color="#0072b2", label="roughness Sa")
    above.set(ylabel="µm", ylim=(0.0, None))
    below.plot(impacts, share["porosity_closed"], "o-", color="#d55e00", markersize=3, label="closed")
    below.plot(impacts, share["porosity_open"], color="#0072b2", label="open")
    below.set(xlabel="impacts", ylabel="porosity (%)", ylim=(0.0, None))
    for axis in (above, below):
        axis.legend(fontsize=8)
    save(figure, path)
    return path
