"""Pictures of a map: a measure over the axes as a surface, as lines or as points. Markers show the verdicts of the runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from numpy.typing import NDArray

from ..errors import StoreError
from ..files.inputs import reading
from ..measures import BROKEN, EMBEDDED, MEASURES, REBOUNDS, STICKS, UNDECIDED, Measure, axis_label, measure
from ..report.figure import blank, label_log, save
from . import maps
from .maps import BAND, FORMULAS, LOGARITHMIC, Interpolation, shown
from .runs_table import Row, errors_of, others_that_vary

# colour maps with uniform steps of lightness
COLOURS = dict.fromkeys(MEASURES, "viridis") | {
    "T_p99_K": "inferno", "T_mean_K": "inferno", "restitution": "cividis", "rebound_velocity_m_s": "cividis",
    "velocity_ratio": "PuOr_r",
}  # fmt: skip
GRID = 121  # grid points along each side of a map
MOST_SLICES = 6  # values of a third axis: each has a row of panels
MOST_LINES = 8  # in one picture; more are drawn as points in a plane
NO_VALUE = "failed or without a value"
# verdict -> marker of a point
MARKERS = {STICKS: "o", REBOUNDS: "v", UNDECIDED: "s", EMBEDDED: "P", BROKEN: "*", "no verdict": "D", NO_VALUE: "X"}
Axes_ = tuple[str, ...]


def draw(rows: Sequence[Row], out: Path, quantities: Sequence[str], axes: Sequence[str] = ()) -> list[str]:
    """Draw quantities of the table of a map as out/map_<material>_<quantity>.png.

    Two or three axes with enough points (`maps.sparse`): a surface and its band inside the convex hull of the points, with a row of
    panels for each value of the third axis. One axis: a curve, divided where the verdict changes. Else: points and straight lines.
    axes: as in `runs_table.add_axes`; by default those of AXES that vary. Returns text lines for each quantity: file, errors and
    warnings of the interpolation or the reason why there is none, and the next point to compute.
    """
    remarks = []
    for material in dict.fromkeys(row["material"] for row in rows if row["status"] == "done"):
        own = [row for row in rows if row["material"] == material]
        done = [row for row in own if row["status"] == "done"]
        used = tuple(axes) or maps.varying(done)
        if not used or any(row[axis] is None for axis in used for row in done) or len(done) < 2:
            none = f"none of the axes varies between its {len(done)} finished points"
            remarks.append(f"{material}: no map; {none}: give keys of the scene with --axes")
            continue
        if others := others_that_vary(done, used):
            remarks.append(
                f"{material}: points with the same axes differ in {', '.join(others[:5])}: add this key with --axes"
            )
        for quantity in quantities:
            remarks += _drawn(out / f"map_{material}_{quantity}.png", own, used, quantity)
    return remarks or ["no map: no point is finished"]


def _drawn(path: Path, rows: Sequence[Row], axes: Axes_, quantity: str) -> list[str]:
    """Draw a quantity of one material. Returns text lines about it."""
    m, done = MEASURES[quantity], [row for row in rows if row["status"] == "done"]
    head = f"{rows[0]['material']}, {m.label}"
    if all(row[quantity] is None for row in done):
        return [f"{head}: no map, because no point has this measure"]
    try:
        with reading(path.name):
            point, fit, problem = maps.best_point(rows, quantity, axes)
            surface = fit if len(axes) in (2, 3) else None
            if surface is not None:
                figure = _surfaces(rows, axes, quantity, surface)
            elif len(axes) > 1 and not _form_lines(maps.with_value(rows, quantity), axes):
                figure = _plane(rows, axes, quantity)
            else:
                figure = _lines(rows, axes, quantity)
            bases = dict.fromkeys(row["substrate"] for row in maps.with_value(rows, quantity))
            of = f": {m.label}" if surface else ""  # the panels of a surface name only the axes
            figure.suptitle(f"{rows[0]['material']} on {', '.join(bases)}{of}", fontsize=11)
            save(figure, path)
    except StoreError as error:
        return [f"{head}: no map; {error}"]
    remarks = [f"{head}: {_quality(fit, m) if fit else problem}; {path}"]
    remarks += [f"  {text}" for text in (fit.warnings if fit else ())]
    if errors := errors_of(rows, quantity):
        middle, most = (f"{m.factor * end:.3g}" for end in (np.median(errors), max(errors)))
        told = f"{middle} {m.unit}".rstrip()
        remarks.append(f"  error of the resolution: {told} median, {most} largest")
    if fit is not None and len(axes) > 1 and quantity not in FORMULAS and maps.brackets(done, axes):
        remarks.append("  the verdict changes between points: the drawn surface is smooth, but the measure can jump")
    if point.at:
        remarks.append(f"  best next point: {point.words}; compute it with --refine 1")
    elif quantity in FORMULAS:
        remarks.append(f"  no next point: {point.why}")
    return remarks


def _quality(fit: Interpolation, m: Measure) -> str:
    gaps = "".join(f", all of one {measure(axis).short} {m.factor * rms:.3g}" for axis, rms in fit.gap_rms.items())
    return (
        f"rms error leaving out one point {m.factor * fit.loo_rms:.3g}{gaps} {m.unit}".rstrip()
        + f" (standard deviation {m.factor * fit.spread:.3g}), {fit.loo_inside:.0%} of the points inside their 95 % band"
    )


def by_verdict(rows: Sequence[Row], quantity: str | None = None) -> dict[str, list[Row]]:
    """The rows for each kind of MARKERS. NO_VALUE: rows that failed, are unfinished, or have no number for `quantity` (if given)."""
    kinds: dict[str, list[Row]] = {kind: [] for kind in MARKERS}
    for row in rows:
        is_over = row["status"] in ("done", "undecided") and (quantity is None or row[quantity] is not None)
        kinds[(row["verdict"] if row["verdict"] in MARKERS else "no verdict") if is_over else NO_VALUE].append(row)
    return kinds


def _form_lines(rows: Sequence[Row], axes: Axes_) -> bool:
    """Whether the points form lines: `_lines` draws at most MOST_LINES lines, with more than one point for each on average."""
    x_axis = _longest(rows, axes)
    count = len({tuple(row[axis] for axis in axes if axis != x_axis) for row in rows})
    return count <= MOST_LINES and len(rows) > count


def _longest(rows: Sequence[Row], axes: Axes_) -> str:
    """The axis that has the most values."""
    return max(axes, key=lambda axis: len({row[axis] for row in rows}))


def _lines(rows: Sequence[Row], axes: Axes_, quantity: str) -> Figure:
    """Draw a quantity against the axis with the most values, one line for each combination of the other axes. Lines are straight
    between points. With a single axis the interpolation and its band are drawn, separately on each side of a change of verdict
    (`maps.sides`)."""
    m, done = MEASURES[quantity], maps.with_value(rows, quantity)
    x_axis = _longest(done, axes)
    others = [axis for axis in axes if axis != x_axis]
    figure = blank(6.4, 4.3, dpi=130, layout="constrained")
    at = figure.subplots()
    edges: dict[tuple[float, ...], str] = {}
    for key in sorted({tuple(row[axis] for axis in others) for row in done}):
        line = [row for row in done if tuple(row[axis] for axis in others) == key]
        parts = [line] if others or quantity in FORMULAS else maps.sides(line, x_axis)
        colour, label = None, maps.place_words(dict(zip(others, key, strict=True))) or None
        for part in parts:
            fit = None if others or maps.sparse(part, axes) else maps.interpolate(part, quantity, axes)
            x, y = np.array(sorted((row[x_axis], row[quantity]) for row in part)).T
            if fit is not None:
                x = _spaced(x, x_axis, 4 * GRID)
                y, std = fit(x)
                named = any(text == "95 % band" for text in at.get_legend_handles_labels()[1])
            (drawn,) = at.plot(x, m.factor * y, linewidth=1.2 if fit else 0.8, color=colour, label=label, zorder=2)
            colour, label = to_hex(drawn.get_color()), None
            if fit is not None:
                ends = (m.factor * (y - BAND * std), m.factor * (y + BAND * std))
                at.fill_between(x, *ends, color=colour, alpha=0.2, linewidth=0.0, label=None if named else "95 % band")
        edges[key] = colour if others and colour else "k"
    low = at.get_ylim()[0]
    for kind, own in by_verdict(rows, quantity).items():
        points = [row for row in own if row[x_axis] is not None]
        y = [low if kind == NO_VALUE else m.factor * row[quantity] for row in points]
        edge = [edges.get(tuple(row[axis] for axis in others), "k") for row in points]
        _scatter(at, [row[x_axis] for row in points], y, kind, edgecolors=edge)
        widths = [m.factor * (row.get(f"{quantity}_error") or 0.0) for row in points]
        if kind != NO_VALUE and any(widths):
            at.errorbar([row[x_axis] for row in points], y, widths, fmt="none", ecolor="0.4", elinewidth=0.8, zorder=1)
    at.set_ylim(bottom=low)
    if quantity in FORMULAS:
        at.axhline(1.0, color="k", linewidth=2.0, zorder=1)
    for handle in at.legend(fontsize=7).legend_handles:
        if handle is not None and handle.get_label() in MARKERS:
            handle.set(edgecolor="k")
    _in_units(at.xaxis, x_axis)
    at.set(xlabel=axis_label(x_axis), ylabel=axis_label(quantity, whole=True))
    return figure


def _plane(rows: Sequence[Row], axes: Axes_, quantity: str) -> Figure:
    """Draw points in the plane of the first two axes, coloured by the quantity. It is used if the points support no surface and form
    no lines."""
    m, done = MEASURES[quantity], maps.with_value(rows, quantity)
    values = [m.factor * row[quantity] for row in done]
    figure = blank(6.4, 4.6, dpi=130, layout="constrained")
    at = figure.subplots()
    colours = ScalarMappable(Normalize(*_ends(min(values), max(values), quantity)), COLOURS[quantity])
    _points(at, rows, axes[0], axes[1], quantity, colours)
    at.set(xlabel=axis_label(axes[0]), ylabel=axis_label(axes[1]))
    bar = figure.colorbar(colours, ax=at)
    bar.ax.set_ylabel(axis_label(quantity, whole=True))
    if quantity in FORMULAS:
        bar.ax.axhline(1.0, color="k", linewidth=2.0)
    figure.legend(loc="outside lower left", ncols=5, fontsize=8, frameon=False)
    return figure


def _surfaces(rows: Sequence[Row], axes: Axes_, quantity: str, fit: Interpolation) -> Figure:
    """Draw mean and half width of the 95 % band side by side, with a row for each value of the third axis. If this axis has more
    than MOST_SLICES values, the rows are its three quartiles over the points."""
    factor = MEASURES[quantity].factor
    x_axis, y_axis, *third = axes
    done = maps.with_value(rows, quantity)
    slices: list[float | None] = sorted({row[third[0]] for row in done}) if third else [None]
    if len(slices) > MOST_SLICES:
        slices = [float(f"{value:.3g}") for value in np.quantile([row[third[0]] for row in done], (0.25, 0.5, 0.75))]

    def nearest(place: float | None) -> float | None:
        """The slice in which a point is drawn: the one nearest to its value `place` on the third axis. None if the point has no such
        value."""
        known = [each for each in slices if each is not None]
        return None if place is None else min(known, key=lambda each: abs(each - place))

    figure = blank(10.8, 4.3 * len(slices), dpi=130, layout="constrained")
    panels = figure.subplots(len(slices), 2, squeeze=False, sharex=True, sharey=True)
    fields = [_fields(done, axes, value, fit) for value in slices]
    for column in range(2):
        levels = _levels([factor * field[2 + column] for field in fields], quantity, column == 1)
        for at, value, (x, y, *values) in zip(panels[:, column], slices, fields, strict=True):
            here = [row for row in rows if value is None or nearest(row[third[0]]) == value]
            _contours(at, (x, y, factor * values[column]), levels, column == 1, quantity)
            _points(at, here, x_axis, y_axis, quantity)
            at.set(xlabel=axis_label(x_axis), ylabel=axis_label(y_axis) if column == 0 else "")
            heading = "95 % band, half width" if column and value is None else ""
            at.set_title(shown(third[0], value) if value is not None else heading, fontsize=9)
    entries = dict(pair[::-1] for at in panels[:, 0] for pair in zip(*at.get_legend_handles_labels(), strict=True))
    figure.legend(entries.values(), entries.keys(), loc="outside lower left", ncols=5, fontsize=8, frameon=False)
    return figure


def _fields(done: Sequence[Row], axes: Axes_, value: float | None, fit: Interpolation) -> tuple[NDArray, ...]:
    """x, y, mean and half width of the band on a grid over the range of the points, (GRID,GRID) each; NaN outside their convex hull.
    value: value of the third axis."""
    x, y = np.meshgrid(*(_spaced(np.array([row[axis] for row in done]), axis, GRID) for axis in axes[:2]))
    at = (x, y) if value is None else (x, y, np.full_like(x, value))
    mean, std = (np.where(fit.inside(*at), values, np.nan) for values in fit(*at))
    return x, y, mean, BAND * std


def _spaced(values: NDArray, axis: str, count: int) -> NDArray:
    """`count` values over the range of `values`, evenly spaced on the scale of the axis."""
    return (np.geomspace if axis in LOGARITHMIC else np.linspace)(values.min(), values.max(), count)


def _ends(low: float, high: float, quantity: str) -> tuple[float, float]:
    """Limits of the colour scale. For a ratio to a critical value, 1 lies in the middle."""
    reach = max(high - 1.0, 1.0 - low)
    return (1.0 - reach, 1.0 + reach) if quantity in FORMULAS else (low, high)


def _levels(fields: Sequence[NDArray], quantity: str, band: bool) -> NDArray:
    """Contour levels at round numbers over the range of several fields (`_ends`), with `band` from 0."""
    low, high = min(float(np.nanmin(f)) for f in fields), max(float(np.nanmax(f)) for f in fields)
    low, high = (0.0, high) if band else _ends(low, high, quantity)
    if high - low < 1e-12 * max(abs(high), 1e-12):
        high = low + max(abs(low), 1e-12)
    return np.asarray(MaxNLocator(6 if band else 10).tick_values(low, high))


def _contours(at: Axes, field: tuple[NDArray, NDArray, NDArray], levels: NDArray, band: bool, quantity: str) -> None:
    x, y, values = field
    colours = at.contourf(x, y, values, levels, cmap="Greys" if band else COLOURS[quantity], extend="neither")
    is_light = band or quantity in FORMULAS  # in the middle of the colours
    lines = at.contour(x, y, values, levels, colors="k" if is_light else "w", linewidths=0.5)
    for label in at.clabel(lines, fontsize=7, fmt=lambda v: f"{v:.4g}"):
        label.set_path_effects([withStroke(linewidth=1.5, foreground="w" if is_light else "k")])
    if quantity in FORMULAS:
        at.contour(x, y, values, [1.0], colors="k", linewidths=2.0)
    bar = at.figure.colorbar(colours, ax=at)
    bar.ax.set_ylabel(MEASURES[quantity].unit, rotation=0, labelpad=10)


def _points(
    at: Axes, rows: Sequence[Row], x_axis: str, y_axis: str, quantity: str, colours: ScalarMappable | None = None
) -> None:
    """Draw the points with the markers of their verdicts. colours: colour scale of the quantity; without it the points are white."""
    for kind, points in by_verdict(rows, quantity).items():
        points = [row for row in points if row[x_axis] is not None and row[y_axis] is not None]
        values = [MEASURES[quantity].factor * row[quantity] for row in points] if colours and kind != NO_VALUE else None
        _scatter(at, [row[x_axis] for row in points], [row[y_axis] for row in points], kind, values, colours)
    for name, axis, side in (("x", at.xaxis, x_axis), ("y", at.yaxis, y_axis)):
        _in_units(axis, side)
        if side in LOGARITHMIC:
            at.set(**{f"{name}scale": "log"})
            label_log(axis, measure(side).factor)
        ticks = sorted({row[side] for row in rows if row[side] is not None})
        if len(ticks) <= 8:
            axis.set_ticks(ticks)
            axis.set_minor_locator(NullLocator())


def _scatter(
    at: Axes, x: Sequence[float], y: Sequence[float], kind: str, values: Sequence[float] | None = None,
    colours: ScalarMappable | None = None, edgecolors: str | Sequence[str] = "k",
) -> None:  # fmt: skip
    """Draw the points of one kind of MARKERS, with an entry in the legend. Their colours show `values`; without values they are
    white, or orange for NO_VALUE."""
    if not x:
        return
    style: dict[str, Any] = {"c": "#d55e00" if kind == NO_VALUE else "w", "s": 22, "edgecolors": edgecolors}
    if values is not None and colours is not None:
        style = {"c": values, "cmap": colours.cmap, "norm": colours.norm, "s": 45, "edgecolors": "k"}
    at.scatter(x, y, linewidths=0.8, label=kind, zorder=3, clip_on=False, marker=MARKERS[kind], **style)


def _in_units(axis: Axis, key: str) -> None:
    """Label an axis, whose values are in SI, in the display unit of a measure."""
    factor = measure(key).factor
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v * factor:.4g}"))
