"""Figures of the validation page: sections of the paper's cases, curves at the first contact and along the axis, trends."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import EVIDENCE
from PIL import Image
from study_table import Row, column, number, table_rows

from coupler import Result
from coupler.report.fields import FIELDS
from coupler.report.figure import blank, save
from coupler.report.picture import View, colour_bar, colour_range, cross_section, draw, scale_bar, stage
from coupler.report.profiles import profiles

AXIS = "validation_axis"  # the table of the curves
SHOWN = ("eps_p", "T", "von_mises")
# Runs of one or two nickel particles, by velocity (m/s) and initial temperature.
COLOURS = {"500-300K": "#1f5fa8", "500-600K": "#c7540a", "1000-300K": "#1a1a1a"}
DEPTH = 25e-6  # m below the undeformed surface, of the curves
NUMBERS = "6a 6b 6c 6d 6e 8a 8a 8a 9a 9b 8b 8b 8b 10a 10b"  # of the paper's figures
TRENDS = {"eps_p_mean": "7a: mean plastic strain", "flattening_end": "7b: flattening", "T_p99": "9c: T of 99 % (K)"}


def axis_rows(name: str, result: Result) -> list[dict[str, object]]:
    """Values (SI) of an impact: over time (ns) at the particle's lowest point and the element under it; over depth (um)."""
    particle, target = result.fields(0, "particle"), result.fields(0, "target")
    places = particle.points, target.points[target.cells].mean(axis=1)
    first = [int(np.linalg.norm(place, axis=1).argmin()) for place in places]

    def row(over: str, body: str, at: float, values: Mapping[str, NDArray], k: int) -> dict[str, object]:
        where = {"run": name, "over": over, "body": body, "at": at, **{key: values[key][k] for key in SHOWN}}
        return {**where, "in_plane": values["stress"][k, :2].mean(), "along": values["stress"][k, 2]}

    rows = []
    for step, time in enumerate(result.times()):
        for body, domain, k in zip(("splat", "substrate"), ("particle", "target"), first, strict=True):
            rows.append(row("time", body, time * 1e9, result.fields(step, domain).data, k))
    for line in profiles(result, -1, (*SHOWN, "stress"), stage(result), DEPTH):
        rows += [row("depth", line.body, depth * 1e6, line.values, k) for k, depth in enumerate(line.depth)]
    return rows


def draw_sections(axes: NDArray, runs: Mapping[str, Result], view: View, names: Sequence[str]) -> None:
    """Draw the sections of runs at their end: a column for each run, a row for each field. runs: by heading; axes (rows, runs + 1)."""
    sections = [cross_section(result, -1, names, stage(result), view) for result in runs.values()]
    for row, name in zip(axes, names, strict=True):
        ends = colour_range(sections, name)
        for axis, section in zip(row[:-1], sections, strict=True):
            draw(axis, section, name, ends)
        colour_bar(row[-1], name, ends, 1.9)
    for axis, words in zip(axes[0], runs, strict=False):
        axis.set_title(words, fontsize=11)
    scale_bar(axes[0, 0], view, 9)


def draw_cases(runs: Mapping[str, Result]) -> None:
    """Figures 3 to 5 of the paper. runs: by the words above their pictures."""
    figure = blank(11.5, 4.6, 100, "constrained")
    axes = figure.subplots(2, 5, width_ratios=[1, 1, 1, 1, 0.04])
    draw_sections(axes, runs, (-33.0, 33.0, -22.0, 34.0), SHOWN[:2])
    write(figure, "validation_cases")


def draw_pairs(runs: Mapping[str, Result]) -> None:
    """Figures 6, 8, 9 and 10 of the paper. runs: pairs of particles, by the keys of COLOURS."""
    figure, rows = blank(13.5, 7.8, 96, "constrained"), table_rows(AXIS)
    axes = figure.subplots(3, 6, width_ratios=[1.3, 1.3, 1.3, 0.05, 0.9, 0.9])
    named = {condition(run): result for run, result in runs.items()}
    draw_sections(axes[:, :4], named, (-32.0, 32.0, -26.0, 20.0), SHOWN)
    plots, places = axes[:, 4:], {"time": "time (ns)", "depth": "depth on the axis (µm)"}
    for axis, (name, (over, words)) in zip(plots.flat, product(SHOWN, places.items()), strict=True):
        for (run, colour), (body, dash) in product(COLOURS.items(), {"splat": "-", "substrate": "--"}.items()):
            own = [row for row in rows if (row["run"], row["over"], row["body"]) == (run, over, body)]
            values = column(own, name) * FIELDS[name].factor
            axis.plot(column(own, "at"), values, dash, color=colour, lw=1.3, label=f"{condition(run)}, {body}")
        label(axis, words, FIELDS[name].words)
    for axis, words in zip(axes[:, [0, 1, 2, 4, 5]].flat, NUMBERS.split(), strict=True):
        axis.set_title(words, loc="left", weight="bold", fontsize=10)
    handles = plots[0, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower right", ncols=3, fontsize=9, frameon=False)
    write(figure, "validation_pairs")


def runs_of(rows: Sequence[Row], by: str, **constant: float) -> list[Row]:
    """Finished single impacts of the trends with these values, in order of the column `by`."""
    plain = [row for row in rows if not row["run"].startswith("shape-") and not row["failed"]]
    used = [r for r in plain if all(abs(number(r, name) - value) < 1e-6 for name, value in constant.items())]
    return sorted(used, key=lambda row: number(row, by))


def draw_trends() -> None:
    """Draw figures 7a, 7b and 9c of the paper: measures against diameter, for COLOURS, and against velocity."""
    figure, rows = blank(11.0, 5.2, 100, "constrained"), table_rows("validation_trends")
    axes = figure.subplots(2, 3)
    for (name, words), (upper, lower) in zip(TRENDS.items(), axes.T, strict=True):
        for run, colour in COLOURS.items():
            speed, temperature = (float(part) for part in run.strip("K").split("-"))
            own = runs_of(rows, "diameter_um", speed_m_s=speed, temperature_K=temperature)
            upper.plot(column(own, "diameter_um"), column(own, name), "o-", color=colour, ms=4, label=condition(run))
        own = runs_of(rows, "speed_m_s", diameter_um=25, temperature_K=300)
        x, style = column(own, "speed_m_s"), {"color": COLOURS["500-300K"], "label": "25 µm, 300 K"}
        lower.plot(x, column(own, name), "o-", ms=4, **style)
        label(upper, "diameter (µm)", words)
        label(lower, "velocity of 25 µm, 300 K (m/s)", words)
    for axis in axes[:, :2].flat:
        axis.set_ylim(bottom=0.0)
    axes[0, 1].legend(fontsize=8, loc="lower right")
    write(figure, "validation_trends")


def write(figure: Figure, name: str) -> None:
    """Write a figure of the page. Colours are rounded to steps of 4 of 256, which halves the size of the file."""
    path = EVIDENCE / f"{name}.png"
    save(figure, path)
    Image.open(path).convert("RGB").point(lambda value: value | 3).save(path, optimize=True)


def condition(run: str) -> str:
    """Velocity and initial temperature of a run in words."""
    return run.replace("-", " m/s, ").replace("K", " K")


def label(axis: Axes, across: str, up: str) -> None:
    """Label a plot."""
    axis.set(xlabel=across, ylabel=up)
    axis.grid(alpha=0.25)
