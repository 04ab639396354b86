"""The work-precision diagram: error of each measure over processor time, as a picture (PNG) and as a page (HTML)."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..files.outputs import write_text
from ..measures import CONVERGING, axis_label
from ..measures import measure as record
from ..plan import cost as estimates
from ..report import charts, parts
from ..report.page import Page, embedded
from ..report.picture import axes_at, blank, label_log, save
from ..report.words import shown
from . import accuracy_fit as fit
from .ladder import KNOBS
from .table import in_columns, other_version

AXES = ("points", *KNOBS, "effects")
MARKS = ("o", "s", "D", "^", "v", "P", "X")  # of matplotlib, one for each axis
Rows = Sequence[Mapping[str, str]]


def preset_of(row: Mapping[str, str]) -> str:
    """The preset with the resolution of a row, "" if none."""
    plain = row["axis"] in ("points", "reference")
    return next((name for name, n in estimates.PRESETS.items() if plain and int(row["points"]) == n), "")


def order_of(rows: Rows, measure: str, T_0: float) -> str:
    """The fitted order in words, or the reason why there is none. T_0: K, of the last particle before its impact."""
    try:
        order, low, high = fit.fit_order(*fit.resolutions(rows, measure, T_0))
    except ValueError:
        return f"fewer than {fit.FEWEST} resolutions, no order"
    below, above = ("below " if low <= fit.ORDERS[0] else ""), ("above " if high >= fit.ORDERS[-1] else "")
    if below and above:
        return "order not determined"
    return f"order {order:.2g} ({below}{low:.2g} to {above}{high:.2g})"


def write(rows: Rows, folder: Path, heading: str, T_0: float) -> tuple[Path, Path]:
    """Write accuracy.png and accuracy.html into a folder; their paths. heading: of the scene; T_0: K, of its last particle. Raises
    StoreError if a file cannot be written."""
    picture, page = folder / "accuracy.png", folder / "accuracy.html"
    save(figure := diagram(rows, heading, T_0), picture)
    write_text(page, html(rows, heading, T_0, figure))
    return picture, page


def diagram(rows: Rows, heading: str, T_0: float) -> Figure:
    """Figure with a panel for each measure."""
    across, wide, tall, top = 3, 4.0, 3.1, 0.95  # the last ones in inches
    size = (across * wide, -(-len(CONVERGING) // across) * tall + top)
    figure = blank(*size, dpi=110)
    for k, measure in enumerate(CONVERGING):
        column, row = k % across, k // across
        left, bottom = column * wide + 0.62, size[1] - top - (row + 1) * tall + 0.55
        panel = axes_at(figure, left, bottom, wide - 0.8, tall - 0.9)
        _panel(panel, rows, measure, T_0)
        if k == 0:
            lines = panel.get_legend_handles_labels()
    figure.text(0.02, 1 - 0.22 / size[1], heading, fontsize=13, weight="bold", va="center", parse_math=False)
    caption = (
        "difference from the reference, %, over processor time of one core, s; crosses at the top: settings that failed"
    )
    figure.text(0.02, 1 - 0.48 / size[1], caption, fontsize=9.5, va="center")
    place = (0.015, 1 - 0.76 / size[1])
    figure.legend(*lines, loc="center left", bbox_to_anchor=place, ncol=8, frameon=False, fontsize=9)
    return figure


def _panel(panel: Axes, rows: Rows, measure: str, T_0: float) -> None:
    errors = fit.errors(rows, measure, T_0)
    panel.set_title(f"{record(measure).short}: {order_of(rows, measure, T_0)}", fontsize=9, loc="left")
    if not errors:  # no reference, or a measure that is zero in it
        panel.text(0.5, 0.5, "nothing to compare with", ha="center", fontsize=9, transform=panel.transAxes)
    places = [(row, (float(row["cpu_s"]), max(abs(error), fit.PERCENT_AT_LEAST))) for row, error in errors]
    for axis, mark, colour in zip(AXES, MARKS, charts.LINES, strict=True):
        own = np.array(sorted(at for row, at in places if row["axis"] == axis)).reshape(-1, 2)
        style = {"lw": 1.4, "ls": "-"} if axis == "points" else {"lw": 0.0}
        panel.plot(*own.T, marker=mark, ms=5, color=colour, label=axis, **style)
    for row, at in places:
        if name := preset_of(row):
            panel.annotate(name, at, xytext=(5, 5), textcoords="offset points", fontsize=8.5, color=charts.LINES[0])
    best = fit.reference(rows)
    if best is not None:
        panel.axvline(float(best["cpu_s"]), color="#888888", lw=0.9, ls="--")
        words = f"reference ({preset_of(best)}) " if preset_of(best) else "reference "
        panel.text(float(best["cpu_s"]), 0.03, words, rotation=90, fontsize=8, color="#666666", ha="right", va="bottom",
                   transform=panel.get_xaxis_transform())  # fmt: skip
    for row in (row for row in rows if row["failed"] and float(row["cpu_s"])):
        panel.plot(float(row["cpu_s"]), 0.97, marker="x", color="#b00020", ms=6, transform=panel.get_xaxis_transform())
    if not errors:
        return
    panel.set(xscale="log", yscale="log")
    for axis_ in (panel.xaxis, panel.yaxis):
        label_log(axis_)
    panel.set_xlabel("processor time (s)", fontsize=8)
    panel.set_ylabel("difference (%)", fontsize=8)
    panel.grid(True, which="major", color="#e8ebef", lw=0.8)
    panel.tick_params(labelsize=8)


def lines(rows: Rows) -> list[str]:
    """The ladder as lines of a terminal: a column for each number of points, with its processor time and the measures with their
    errors."""
    cells = [["points"], ["processor time, s"], *([axis_label(measure)] for measure in CONVERGING)]
    for k, measure in enumerate(CONVERGING):
        for row, error in fit.errors_of_ladder(rows, measure):
            if k == 0:
                cells[0].append(row["points_used"])
                cells[1].append(f"{float(row['cpu_s']):.3g}")
            cells[k + 2].append(shown(measure, float(row[measure]) if row[measure] else None, error))
    return in_columns(cells)


def html(rows: Rows, heading: str, T_0: float, figure: Figure) -> str:
    """The page: the diagram, the table, and what failed. Opens offline."""
    page, image = Page(), f'<img src="{embedded(figure)}" alt="work-precision diagram">'
    page.section("diagram", "Work and precision", f"<figure>{image}</figure>")
    page.section("table", "All settings", _table(rows, T_0))
    failed = [(row["axis"], row["setting"], row["points"], row["failed"]) for row in rows if row["failed"]]
    listed = parts.table(("axis", "setting", "points", "why"), failed) if failed else "<p>None.</p>"
    page.section("failed", "Settings that failed", listed)
    local = (
        "<p>Greatest strain and highest temperature are local maxima: finer points find higher ones, without end. They have no error"
        " and no band; the 99th percentiles take their place.</p>"
    )
    page.section("maxima", "What does not converge", local)
    under = "difference from the reference over processor time of one core"
    return page.html(f"Accuracy against time: {heading}", escape(under), "", "Computed by coldspray.")


def _table(rows: Rows, T_0: float) -> str:
    """All settings with their costs and the difference of each measure from the reference."""
    by_measure = {
        m: {row["axis"] + row["setting"]: error for row, error in fit.errors(rows, m, T_0)} for m in CONVERGING
    }
    lines = []
    for row in rows:
        cells = [by_measure[m].get(row["axis"] + row["setting"]) for m in CONVERGING]
        shown = ["" if error is None else f"{error:+.2f}" for error in cells]
        notes = (preset_of(row), f"version {other_version(row)}" if other_version(row) else "")
        name = " ".join([row["setting"], *(f"({note})" for note in notes if note)])
        lines.append((row["axis"], name, row["points"], row["steps"], f"{float(row['cpu_s']):.3g}", *shown))
    head = ("axis", "setting", "points", "steps", "s", *(f"{record(m).short}, %" for m in CONVERGING))
    return parts.table(head, lines, numbers=range(2, len(head)))
