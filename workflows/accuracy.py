"""What accuracy costs in time: five cases at many resolutions, with the presets marked.

    python workflows/accuracy.py             # docs/tables/accuracy_*.csv and presets.csv, the figure, the page
    python workflows/accuracy.py --docs      # runs nothing: from the tables that exist

Each case has a ladder of points (accuracy_*.csv), whose limit at zero spacing the errors refer to, and a grid of points, element size
and contact stiffness (presets.csv). Rows in the tables are not computed again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.ticker import NullFormatter
from pages import PAGES, ROOT, figure_path, markdown, number, options, study_table, table_rows, versions, write_parts

from coupler.measures import MEASURES
from coupler.plan.cost import ELEMENT_SIZE_OVER_SPACING, PRESETS
from coupler.plan.reading import Scene
from coupler.plan.refinement import line
from coupler.report.picture import blank, save
from coupler.studies import ladder, ladder_runs
from coupler.studies.table import Row, StudyTable

POINTS = (300, 500, 700, 1000, 1400, 2000, 3500, 5000)
ELEMENTS = (1.2, 1.45, 1.7, 2.1)  # smallest edge of the target's elements over the spacing
STIFFNESS = (1.0, 3.0)  # of the contact, over the default
JUDGED = ("flattening_ratio", "crater_depth_m", "splat_diameter_m")
FINEST = 4  # rows of a ladder that its limit rests on
TICKS = (1, 2, 5, 10, 20)  # percent
USUAL = f"e{ELEMENT_SIZE_OVER_SPACING:g} k1"  # elements and contact stiffness of the presets


@dataclass(frozen=True)
class Study:
    """A case of the page. grid: most points of its grid; without_limit: measures whose ladder shows no limit."""

    heading: str
    scene: str
    grid: int
    points: tuple[int, ...]
    reference: int
    without_limit: tuple[str, ...] = ()

    def load(self) -> Scene:
        return Scene.load(ROOT / "workflows" / f"{self.scene}.toml")


FINE = (500, 1000, 2000, 5000, 12000, 16000)
STUDIES = {
    "ni500": Study("Ni, 500 m/s", "single_ni", 5000, FINE, 24000),
    "ti500": Study("Ti, 500 m/s", "single_ti", 5000, FINE, 24000),
    "ni1000": Study("Ni, 1000 m/s", "fast_ni", 1000, (500, 1000, 2000, 5000), 12000, ("flattening_ratio",)),
    "al725": Study("Al, 725 m/s", "al_on_steel", 700, (500, 1000, 2000), 5000, ("splat_diameter_m",)),
    "triple": Study("three Ni, 500 to 610 m/s", "triple_ni", 2000, (700, 1000, 2000), 4000),
}


class Entry(NamedTuple):
    """A setting of a case: time of its loop, s; largest error of the judged measures, percent; points, and the other settings."""

    time: float
    error: float
    points: int
    kind: str


def table_of(name: str) -> StudyTable:
    about = "remake: make accuracy (rows in this table are not computed again)"
    return ladder.ladder_table(ROOT / "docs" / "tables" / f"accuracy_{name}.csv", about)


def compute(names: Sequence[str]) -> None:
    """Compute the rows that the tables lack, the cheap ones first."""
    grid = study_table("presets", ladder.COLUMNS, ladder.KEY, "make accuracy")
    for name in names:
        study, scene = STUDIES[name], STUDIES[name].load()
        rungs = ladder.ladder_points(study.points, study.reference, None)
        ladder_runs.compute_missing(scene, ROOT / "runs" / "accuracy" / name, rungs, table_of(name), print)
        settings = [
            ladder.LadderPoint(name, f"e{element:g} k{k:g}", n, element, None, {"contact_stiffness": k})
            for n in POINTS
            for element in ELEMENTS
            for k in STIFFNESS
            if n <= study.grid
        ]
        ladder_runs.compute_missing(scene, ROOT / "runs" / "presets", settings, grid, print)


def ladder_of(name: str) -> list[Row]:
    """Finished rows of the ladder of a case, the finest last."""
    return sorted(ladder.finished(table_of(name).rows), key=lambda row: number(row, "points_used"))


def limits(name: str) -> dict[str, tuple[float, float]]:
    """Measure -> its limit at zero spacing (first order through the FINEST rows), and how far the finest row is off it, percent."""
    rows = ladder_of(name)[-FINEST:]
    h = np.array([number(row, "points_used") ** (-1.0 / 3.0) for row in rows])
    found = {}
    for measure in JUDGED:
        if measure not in STUDIES[name].without_limit:
            values = np.array([number(row, measure) for row in rows])
            limit = float(line(h, values, 1.0)[0])
            found[measure] = limit, 100.0 * abs(values[-1] / limit - 1.0)
    return found


def entries(name: str) -> list[Entry]:
    """All settings of a case, by time; grid and ladder."""
    at = limits(name)
    grid = [row for row in ladder.finished(table_rows("presets")) if row["axis"] == name]
    found: dict[tuple[str, int], Entry] = {}
    for row in [*grid, *({**row, "setting": USUAL} for row in ladder_of(name))]:
        worst = max(100.0 * abs(number(row, measure) / limit - 1.0) for measure, (limit, _) in at.items())
        kind, points = row["setting"], int(row["points"])
        found[kind, points] = Entry(number(row, "cpu_loop_s"), worst, points, kind)
    return sorted(found.values())


def of_preset(preset: str, listed: Sequence[Entry]) -> Entry | None:
    """The setting that a preset takes, if it is computed."""
    return next((each for each in listed if (each.points, each.kind) == (PRESETS[preset], USUAL)), None)


def presets_part() -> list[str]:
    """Of each case: error and time of the presets, the limits that the errors refer to, and how far the finest run is off them."""
    lines = []
    for name, study in STUDIES.items():
        listed, at, cells = entries(name), limits(name), []
        for preset in PRESETS:
            own = of_preset(preset, listed)
            cells.append(f"{own.error:.1f} % in {own.time:.{1 if own.time < 9.95 else 0}f} s" if own else "-")
        for measure in JUDGED:
            m = MEASURES[measure]
            cells.append(f"{at[measure][0] * m.factor:.3g} ({at[measure][1]:.1f} %)" if measure in at else "none")
        lines.append([study.heading, *cells])
    head = ["case", *PRESETS, "flattening", "crater, µm", "diameter, µm"]
    rows = [row for name in STUDIES for row in table_of(name).rows]
    return [*markdown(head, lines), "", versions([*rows, *table_rows("presets")])]


def pace_part() -> list[str]:
    """The estimates of time (workflows/pace.py) against the times taken."""
    rows = table_rows("pace")
    steps = [abs(number(row, "steps_said") / number(row, "steps") - 1.0) for row in rows]
    within = [sum(x <= 0.3 for x in off) for off in (steps, [abs(number(row, "off_percent")) / 100.0 for row in rows])]
    return [
        f"Of {len(rows)} scenes that its constants are not fitted to, the estimate of `coldspray check` is within 30 % in"
        f" {within[0]} for the number of steps and in {within[1]} for the time ([table](../tables/pace.csv))."
    ]


def draw() -> None:
    """Error over time of all settings, with the presets; a panel for each case."""
    figure = blank(3.1 * len(STUDIES), 3.4, 100, "constrained")
    axes = figure.subplots(1, len(STUDIES), sharey=True)
    for axis, (name, study) in zip(axes, STUDIES.items(), strict=True):
        listed = entries(name)
        axis.loglog([each.time for each in listed], [each.error for each in listed], ".", color="0.7", label="settings")
        own = sorted((each for each in listed if each.kind == USUAL), key=lambda each: each.points)
        axis.loglog([each.time for each in own], [each.error for each in own], "-", color="C0", label="more points")
        for k, preset in enumerate(PRESETS, start=1):
            if each := of_preset(preset, listed):
                axis.loglog(each.time, each.error, "D", color=f"C{k}", label=preset)
        axis.set_title(study.heading, fontsize=10)
        axis.set_xlabel("time of the loop (s)")
        axis.xaxis.set_major_formatter("{x:g}")
        axis.set_yticks(TICKS, [str(tick) for tick in TICKS])
        axis.yaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("largest error of flattening,\ncrater, diameter (%)")
    axes[0].legend(fontsize=7)
    save(figure, figure_path("accuracy", "presets.png"))


def main() -> None:
    """Compute what is missing; write figure and page."""
    a = options(__doc__, "docs", only=list(STUDIES))
    if not a.docs:
        compute(a.only)
    draw()
    write_parts(PAGES["accuracy"], {"presets": presets_part(), "pace": pace_part()})


if __name__ == "__main__":
    main()
