"""The cheapest settings for an accuracy: a grid of points, elements and contact stiffness over the cases of the accuracy page.

    python workflows/presets.py             # docs/tables/presets.csv, its figure and its part of the accuracy page
    python workflows/presets.py --docs      # runs nothing: from the table that exists

The limits are those of the ladders (`workflows/accuracy.py`), by their four finest rows. Rows in the table are not computed again.
"""

from collections.abc import Sequence
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from accuracy import STUDIES, table_of
from matplotlib.ticker import NullFormatter
from pages import PAGES, ROOT, figure_path, markdown, number, options, study_table, table_rows, versions, write_parts

from coupler.measures import MEASURES
from coupler.plan.cost import ELEMENT_SIZE_OVER_SPACING, PRESETS
from coupler.plan.refinement import line
from coupler.report.picture import save
from coupler.studies import ladder, ladder_runs
from coupler.studies.table import Row

POINTS = (300, 500, 700, 1000, 1400, 2000, 3500, 5000)
ELEMENTS = (1.2, 1.45, 1.7, 2.1)  # smallest edge of the target's elements over the spacing
STIFFNESS = (1.0, 3.0)
MOST = {"ni500": 5000, "ti500": 5000, "ni1000": 1000, "al725": 700, "triple": 2000}  # points
JUDGED = ("flattening_ratio", "crater_depth_m", "splat_diameter_m")
WITHOUT_LIMIT = {"ni1000": ("flattening_ratio",), "al725": ("splat_diameter_m",)}  # no ladder shows one
ACCURACY = {"draft": 0.05, "standard": 0.02, "fine": 0.01}  # what each preset is compared with
FINEST = 4  # rows of a ladder that its limit rests on


class Entry(NamedTuple):
    """A setting of a case: time of its loop (s), worst error (percent), and that of it and all finer ones with its elements and
    stiffness; points and label."""

    time: float
    error: float
    from_here: float
    points: int
    label: str


def settings(case: str) -> list[ladder.LadderPoint]:
    """The grid of one case, the cheap settings first."""
    return [
        ladder.LadderPoint(case, f"e{element:g} k{k:g}", n, element, None, {"contact_stiffness": k})
        for n in POINTS
        for element in ELEMENTS
        for k in STIFFNESS
        if n <= MOST[case]
    ]


def compute(only: Sequence[str]) -> None:
    """Compute the settings that the table lacks."""
    table = study_table("presets", ladder.COLUMNS, ladder.KEY, "python workflows/presets.py")
    for case in only:
        ladder_runs.compute_missing(STUDIES[case].load(), ROOT / "runs" / "presets", settings(case), table, print)


def ladder_of(case: str) -> list[Row]:
    """Finished rows of the ladder of points of a case, the reference last."""
    rows = [row for row in ladder.finished(table_of(case).rows) if row["axis"] in ("points", "reference")]
    return sorted(rows, key=lambda row: number(row, "points_used"))


def limits(case: str) -> dict[str, tuple[float, float]]:
    """Measure -> its limit at zero spacing (first order through the FINEST rows), and how far the finest row is off it, percent."""
    rows = ladder_of(case)[-FINEST:]
    h = np.array([number(row, "points_used") ** (-1.0 / 3.0) for row in rows])
    found = {}
    for name in JUDGED:
        if name not in WITHOUT_LIMIT.get(case, ()):
            values = np.array([number(row, name) for row in rows])
            limit, _, _ = line(h, values, 1.0)
            found[name] = float(limit), 100.0 * abs(values[-1] / limit - 1.0)
    return found


def entries(case: str) -> list[Entry]:
    """All settings of a case, by time; ladder and grid."""
    at = limits(case)
    grid = [row for row in ladder.finished(table_rows("presets")) if row["axis"] == case]
    ladders = [{**row, "setting": f"e{ELEMENT_SIZE_OVER_SPACING:g} k1"} for row in ladder_of(case)]
    found: dict[tuple[str, int], tuple[float, float]] = {}
    for row in [*grid, *ladders]:
        worst = max(100.0 * abs(number(row, name) / limit - 1.0) for name, (limit, _) in at.items())
        found[row["setting"], int(row["points"])] = number(row, "cpu_loop_s"), worst
    listed = []
    for (kind, points), (time, error) in found.items():
        finer = max(worst for (other, n), (_, worst) in found.items() if other == kind and n >= points)
        listed.append(Entry(time, error, finer, points, f"{points} points, {kind}"))
    return sorted(listed)


def front(listed: Sequence[Entry]) -> list[Entry]:
    """Settings that no cheaper one beats."""
    best: list[Entry] = []
    for entry in sorted(listed):
        if not best or entry.error < best[-1].error:
            best.append(entry)
    return best


def own(preset: str, listed: Sequence[Entry]) -> Entry | None:
    """The setting that a preset takes, if it is computed."""
    label = f"{PRESETS[preset]} points, e{ELEMENT_SIZE_OVER_SPACING:g} k1"
    return next((entry for entry in listed if entry.label == label), None)


def part() -> list[str]:
    """Of each case: the limits, and the cheapest setting for the accuracy of each preset beside the preset's own error."""
    cells, bounds = [], []
    for case, study in STUDIES.items():
        listed = entries(case)
        for preset, asked in ACCURACY.items():
            usual = own(preset, listed)
            best = next(
                (f"{each.label}: {each.time:.3g} s" for each in listed if each.from_here <= 100.0 * asked), "none"
            )
            error = f"{usual.error:.1f} % in {usual.time:.3g} s" if usual else "not computed"
            cells.append([study.heading, f"{preset}, {100.0 * asked:g} %", error, best])
        at, values = limits(case), []
        for name in JUDGED:
            m = MEASURES[name]
            values.append(f"{at[name][0] * m.factor:.4g} {m.unit} ({at[name][1]:.1f} %)" if name in at else "none")
        bounds.append([study.heading, *values])
    return [
        *markdown("case | preset, accuracy | worst error of the preset | cheapest setting with this accuracy", cells), "",
        *markdown(["limit (the finest row is off it by)", *(MEASURES[name].short for name in JUDGED)], bounds), "",
        versions(table_rows("presets")),
    ]  # fmt: skip


def draw() -> None:
    """Error over time of all settings, the front, the presets and what they are asked for, a panel for each case."""
    figure, axes = plt.subplots(1, len(STUDIES), figsize=(3.1 * len(STUDIES), 3.4), sharey=True, layout="constrained")
    for axis, (case, study) in zip(axes, STUDIES.items(), strict=True):
        listed = entries(case)
        axis.loglog(
            [each.time for each in listed], [each.error for each in listed], ".", color="0.65", label="settings"
        )
        best = front(listed)
        axis.loglog([each.time for each in best], [each.error for each in best], "-", color="C0", label="front")
        for i, preset in enumerate(PRESETS, start=1):
            if (usual := own(preset, listed)) is not None:
                axis.loglog(usual.time, usual.error, "D", color=f"C{i}", label=preset)
            axis.axhline(100.0 * ACCURACY[preset], color=f"C{i}", linewidth=0.7, linestyle=":")
        axis.set(title=study.heading, xlabel="time of the loop (s)")
        axis.title.set_fontsize(9)
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("worst error of flattening,\ncrater, diameter (%)")
    axes[0].legend(fontsize=7)
    save(figure, figure_path("accuracy", "presets.png"))


if __name__ == "__main__":
    a = options(__doc__, "docs", only=list(STUDIES))
    if not a.docs:
        compute(a.only)
    draw()
    write_parts(PAGES["accuracy"], {"presets": part()})
