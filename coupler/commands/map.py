"""The command `coldspray map`: the table of a sweep, and maps of it with their uncertainty."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..measures import MEASURES, REBOUNDS, STICKS, UNDECIDED, axis_label, measure
from .arguments import Commands, add_command, add_force, path, working

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from numpy.typing import NDArray

    from ..studies.maps import Interpolation, NextPoint
    from ..studies.runs_table import Row

# measure -> colour map (all of them in even steps of lightness)
COLOURS = {
    "flattening_ratio": "viridis", "T_p99_K": "inferno", "restitution": "cividis", "velocity_ratio": "PuOr_r",
    "T_mean_K": "inferno", "eps_p_mean": "viridis", "crater_depth_m": "viridis", "splat_diameter_m": "viridis",
    "rebound_velocity_m_s": "cividis", "bonded_area_end_m2": "viridis", "numerical_dissipation": "viridis",
}  # fmt: skip
DRAWN = ("flattening_ratio", "T_p99_K", "restitution", "velocity_ratio")
GRID = 121  # places along each side of a map
MOST_SLICES = 6  # values of a third axis that have a row of panels each
MOST_LINES = 8  # in a picture of lines; more are drawn as points in a plane
NO_VALUE = "failed or without a value"
# verdict -> marker of a point
MARKERS = {STICKS: "o", REBOUNDS: "v", UNDECIDED: "s", "no verdict": "D", NO_VALUE: "X"}


def add(commands: Commands) -> None:
    """Add the command to a parser's subcommands."""
    option = add_command(commands, "map", run, "draw maps of a sweep, or of any folder of runs")
    option(
        "folder", type=path, metavar="DIR", help="folder of a sweep, finished or not, or any folder of runs' folders"
    )
    option("--show", nargs="+", choices=tuple(COLOURS), default=DRAWN, metavar="QUANTITY",
           help=f"what to draw, of {', '.join(COLOURS)} (default: {', '.join(DRAWN)})")  # fmt: skip
    option("--axes", nargs="+", default=(), metavar="KEY",
           help="keys of the scene, such as particle.velocity contact.friction (default: velocity, diameter and temperature,"
           " those that vary)")  # fmt: skip
    option("--refine", type=int, default=0, metavar="N",
           help="first run the N points that tell most of the first quantity, one after another")  # fmt: skip
    add_force(option)
    option("--out", type=path, metavar="DIR", help="where map.csv and the pictures go (default: the same folder)")


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Returns the exit code. Raises ColdsprayError for what a user can mend."""
    from ..errors import StoreError
    from ..files.outputs import MARK, check_folder, claim_file, kind_of
    from ..studies import maps, runs_table

    if kind_of(arguments.folder) == "run":
        raise StoreError(f"{arguments.folder} is the folder of a single run: name the folder that holds several")
    if arguments.refine < 0:
        raise StoreError(f"--refine {arguments.refine}: give the number of points to run, zero or more")
    rows, axes = _table(arguments)
    for number in range(arguments.refine):
        point, _, _ = maps.best_point(rows, arguments.show[0], axes)
        if not point.at:
            print(f"no point to run: {point.why}")
            break
        print(f"running {number + 1} of {arguments.refine}: {_in_words(point)}", flush=True)
        maps.run_next(arguments.folder, rows, point.at)
        rows, axes = _table(arguments)
    out = arguments.out or arguments.folder
    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    for name in ("map.csv", *(drawn.name for drawn in out.glob("map_*.png"))):
        claim_file(out / name, (".csv", ".png"), force=arguments.force)
    count = {
        status: sum(row["status"] == status for row in rows) for status in ("done", "undecided", "failed", "unfinished")
    }
    print(f"{len(rows)} points: " + ", ".join(f"{n} {status}" for status, n in count.items()))
    kinds = {kind: len(points) for kind, points in _by_verdict(rows).items() if kind != NO_VALUE and points}
    if kinds:
        print("verdicts: " + ", ".join(f"{kind} {n}" for kind, n in kinds.items()))
    for row in rows:
        if row["status"] != "done":
            print(f"  {row['point']}: {row['status']}" + (f": {row['reason'][:160]}" if row["reason"] else ""))
    with working("interpolating and drawing"):
        lines = draw(rows, out, arguments.show, axes)
    print("\n".join(lines))
    # last: whoever waits for the table finds the pictures beside it
    runs_table.write_table(rows, out / "map.csv", f"{MARK} map; SI units", axes)
    print(f"table in {out / 'map.csv'}")
    return 0


def _table(arguments: argparse.Namespace) -> "tuple[list[Row], tuple[str, ...]]":
    """The rows of the folder, and the axes that were asked for."""
    from ..files.inputs import reading
    from ..studies import runs_table

    with reading(arguments.folder), working("reading the runs"):
        rows = runs_table.table(arguments.folder)
        return rows, runs_table.add_axes(rows, arguments.axes)


def draw(rows: "Sequence[Row]", out: Path, quantities: Sequence[str] = DRAWN, axes: Sequence[str] = ()) -> list[str]:
    """Draw quantities of a map's table into out/map_<material>_<quantity>.png.

    Two or three axes whose points support it (`maps.sparse`): a surface and its band inside the convex hull of the points, a row of
    panels for each value of a third axis; one axis: a curve, divided where the verdict changes; else points and straight lines.
    axes: `runs_table.add_axes`; those of its AXES that vary by default. Returns remarks: file and errors of each interpolation,
    what it cannot tell, and the next point worth a run.
    """
    from ..errors import StoreError
    from ..files.inputs import reading
    from ..studies import maps, runs_table

    remarks = []
    for material in dict.fromkeys(row["material"] for row in rows if row["status"] == "done"):
        own = [row for row in rows if row["material"] == material]
        done = [row for row in own if row["status"] == "done"]
        used = tuple(axes) or maps.varying(done)
        if not used or any(row[axis] is None for axis in used for row in done) or len(done) < 2:
            remarks.append(
                f"{material}: no map; its {len(done)} points that are done vary in none of the axes: name keys of the scene with --axes"
            )
            continue
        if others := runs_table.others_that_vary(done, used):
            remarks.append(f"{material}: points of the same place differ in {', '.join(others[:5])}, which is no axis")
        for quantity in quantities:
            path, m = out / f"map_{material}_{quantity}.png", MEASURES[quantity]
            if all(row[quantity] is None for row in done):
                remarks.append(f"{material}, {m.label}: no map; no point has this measure")
                continue
            try:
                with reading(path.name):
                    point, fit, problem = maps.best_point(own, quantity, used)
                    if fit is not None and len(used) in (2, 3):
                        _figure(path, own, used, quantity, fit)
                    elif len(used) > 1 and not _form_lines(maps.with_value(own, quantity), used):
                        _plane(path, own, used, quantity)
                    else:
                        _lines(path, own, used, quantity)
            except StoreError as error:
                remarks.append(f"{material}, {m.label}: no map; {error}")
                continue
            remarks.append(f"{material}, {m.label}: {_quality(fit, m.factor, m.unit) if fit else problem}; {path}")
            remarks += [f"  {text}" for text in (fit.warnings if fit else ())]
            if fit is not None and len(used) > 1 and quantity not in maps.FORMULAS and maps.brackets(done, used):
                remarks.append(
                    "  the verdict changes between points: the surface is smooth there, where the measure can jump"
                )
            if point.at:
                remarks.append(f"  next point worth a run: {_in_words(point)}; --refine 1 runs it")
            elif quantity in maps.FORMULAS:
                remarks.append(f"  no next point: {point.why}")
    return remarks or ["no map: no point is done"]


def place(at: Mapping[str, float]) -> str:
    """A place on the axes in words."""
    from ..studies.maps import shown

    return ", ".join(shown(axis, value) for axis, value in at.items())


def _in_words(point: "NextPoint") -> str:
    return place(point.at) + (f" ({point.why})" if point.why else "")


def _quality(fit: "Interpolation", factor: float, unit: str) -> str:
    gaps = "".join(f", all of one {measure(axis).short} {factor * rms:.3g}" for axis, rms in fit.gap_rms.items())
    return (
        f"rms error leaving out one point {factor * fit.loo_rms:.3g}{gaps} {unit}".rstrip()
        + f" (spread {factor * fit.spread:.3g}), {fit.loo_inside:.0%} inside their 95 % band"
    )


def _by_verdict(rows: "Sequence[Row]", quantity: str | None = None) -> "dict[str, list[Row]]":
    """The rows by what MARKERS tells apart; quantity: rows without a number of it have no verdict here, but NO_VALUE."""
    kinds: dict[str, list[Row]] = {kind: [] for kind in MARKERS}
    for row in rows:
        is_over = row["status"] in ("done", "undecided") and (quantity is None or row[quantity] is not None)
        kinds[(row["verdict"] if row["verdict"] in MARKERS else "no verdict") if is_over else NO_VALUE].append(row)
    return kinds


def _form_lines(rows: "Sequence[Row]", axes: tuple[str, ...]) -> bool:
    """Whether `_lines` draws few lines, of more than one point each in the mean."""
    x_axis = _longest(rows, axes)
    number = len({tuple(row[axis] for axis in axes if axis != x_axis) for row in rows})
    return number <= MOST_LINES and len(rows) > number


def _longest(rows: "Sequence[Row]", axes: tuple[str, ...]) -> str:
    """The axis with the most values."""
    return max(axes, key=lambda axis: len({row[axis] for row in rows}))


def _lines(path: Path, rows: "Sequence[Row]", axes: tuple[str, ...], quantity: str) -> None:
    """A quantity over the axis with the most values, a line for each place on the others: straight between points; of one axis the
    interpolation with its band where the points support it, each side of a change of the verdict (`maps.sides`) alone."""
    from matplotlib.ticker import FuncFormatter

    from ..report.picture import blank, save
    from ..studies import maps

    m, done = MEASURES[quantity], maps.with_value(rows, quantity)
    x_axis = _longest(done, axes)
    others = [axis for axis in axes if axis != x_axis]
    figure = blank(6.4, 4.3, dpi=130, layout="constrained")
    at = figure.subplots()
    edges: dict[tuple[float, ...], str] = {}
    for key in sorted({tuple(row[axis] for axis in others) for row in done}):
        line = [row for row in done if tuple(row[axis] for axis in others) == key]
        parts = [line] if others or quantity in maps.FORMULAS else maps.sides(line, x_axis)
        colour, label = None, place(dict(zip(others, key, strict=True)))
        for number, part in enumerate(parts):
            fit = None if others or maps.sparse(part, axes) else maps.interpolate(part, quantity, axes)
            colour = _side(at, part, x_axis, quantity, fit, colour, "" if number else label)
        edges[key] = colour if others and colour else "k"
    kinds = _by_verdict(rows, quantity)
    low = at.get_ylim()[0]
    for kind, marker in MARKERS.items():
        points = [row for row in kinds[kind] if row[x_axis] is not None]
        y = [low if kind == NO_VALUE else m.factor * row[quantity] for row in points]
        edge = [edges.get(tuple(row[axis] for axis in others), "k") for row in points]
        _scatter(at, [row[x_axis] for row in points], y, kind, marker, edgecolors=edge)
    at.set_ylim(bottom=low)
    if quantity in maps.FORMULAS:
        at.axhline(1.0, color="k", linewidth=2.0, zorder=1)
    if x_axis in maps.FORMULAS:
        at.axvline(1.0, color="k", linewidth=2.0, zorder=1)
    legend = at.legend(fontsize=7)
    for handle in legend.legend_handles:
        if handle is not None and handle.get_label() in MARKERS:
            handle.set(edgecolor="k")
    at.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v * measure(x_axis).factor:.4g}"))
    at.set_xlabel(axis_label(x_axis))
    at.set_ylabel(f"{m.label} ({m.unit})" if m.unit else m.label)
    figure.suptitle(_heading(rows, done), fontsize=11)
    save(figure, path)


def _side(
    at: "Axes",
    rows: "Sequence[Row]",
    x_axis: str,
    quantity: str,
    fit: "Interpolation | None",
    colour: str | None,
    label: str,
) -> str:
    """Draw one side of a line: the interpolation and its band, or straight lines. colour: None for the next one. Returns it."""
    import numpy as np
    from matplotlib.colors import to_hex

    from ..studies.maps import BAND, LOGARITHMIC

    factor = MEASURES[quantity].factor
    line = sorted(rows, key=lambda row: row[x_axis])
    x, y = np.array([row[x_axis] for row in line]), np.array([row[quantity] for row in line])
    band = np.zeros(len(x))
    if fit is not None:
        x = (np.geomspace if x_axis in LOGARITHMIC else np.linspace)(x.min(), x.max(), 4 * GRID)
        y, std = fit(x)
        band = BAND * std
    (drawn,) = at.plot(x, factor * y, linewidth=1.2 if fit else 0.8, color=colour, label=label or None, zorder=2)
    if fit is not None:
        shown_before = any(text == "95 % band" for text in at.get_legend_handles_labels()[1])
        at.fill_between(
            x, factor * (y - band), factor * (y + band), alpha=0.2, color=drawn.get_color(), linewidth=0.0,
            label=None if shown_before else "95 % band",
        )  # fmt: skip
    return to_hex(drawn.get_color())


def _plane(path: Path, rows: "Sequence[Row]", axes: tuple[str, ...], quantity: str) -> None:
    """The points over the first two axes, in colours of the quantity: of points that support no surface and form no lines."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    from ..report.picture import blank, save
    from ..studies import maps

    m, done = MEASURES[quantity], maps.with_value(rows, quantity)
    values = [m.factor * row[quantity] for row in done]
    figure = blank(6.4, 4.6, dpi=130, layout="constrained")
    at = figure.subplots()
    low, high = min(values), max(values)
    if quantity in maps.FORMULAS:
        reach = max(high - 1.0, 1.0 - low)
        low, high = 1.0 - reach, 1.0 + reach
    colours = ScalarMappable(Normalize(low, high), COLOURS[quantity])
    _points(at, rows, axes[0], axes[1], quantity, colours)
    at.set_xlabel(axis_label(axes[0]))
    at.set_ylabel(axis_label(axes[1]))
    bar = figure.colorbar(colours, ax=at)
    bar.ax.set_ylabel(f"{m.label} ({m.unit})" if m.unit else m.label)
    if quantity in maps.FORMULAS:
        bar.ax.axhline(1.0, color="k", linewidth=2.0)
    figure.legend(loc="outside lower left", ncols=5, fontsize=8, frameon=False)
    figure.suptitle(_heading(rows, done), fontsize=11)
    save(figure, path)


def _heading(rows: "Sequence[Row]", done: "Sequence[Row]") -> str:
    return f"{rows[0]['material']} on {', '.join(dict.fromkeys(row['substrate'] for row in done))}"


def _figure(path: Path, rows: "Sequence[Row]", axes: tuple[str, ...], quantity: str, fit: "Interpolation") -> None:
    """Mean and half width of the 95 % band side by side, a row for each value of the third axis, or of three where there are many."""
    import numpy as np

    from ..report.picture import blank, save
    from ..studies.maps import shown

    factor = MEASURES[quantity].factor
    x_axis, y_axis, *third = axes
    done = [row for row in rows if row["status"] == "done" and row[quantity] is not None]
    slices: list[float | None] = sorted({row[third[0]] for row in done}) if third else [None]
    if len(slices) > MOST_SLICES:
        slices = [float(f"{value:.3g}") for value in np.quantile([row[third[0]] for row in done], (0.25, 0.5, 0.75))]
    figure = blank(10.8, 4.3 * len(slices), dpi=130, layout="constrained")
    panels = figure.subplots(len(slices), 2, squeeze=False, sharex=True, sharey=True)
    fields = [_fields(done, axes, value, fit) for value in slices]
    for number in range(2):
        levels = _levels([factor * field[2 + number] for field in fields], quantity, number == 1)
        for at, value, (x, y, *values) in zip(panels[:, number], slices, fields, strict=True):
            here = [row for row in rows if value is None or _nearest(row[third[0]], slices) == value]
            _panel(at, (x, y, factor * values[number]), levels, number == 1, quantity)
            _points(at, here, x_axis, y_axis, quantity)
            at.set_xlabel(axis_label(x_axis))
            at.set_ylabel(axis_label(y_axis) if number == 0 else "")
            heading = "95 % band, half width" if number and value is None else ""
            heading = shown(third[0], value) if value is not None else heading
            at.set_title(heading, fontsize=9)
    entries = {
        label: handle for at in panels[:, 0] for handle, label in zip(*at.get_legend_handles_labels(), strict=True)
    }
    figure.legend(entries.values(), entries.keys(), loc="outside lower left", ncols=5, fontsize=8, frameon=False)
    figure.suptitle(f"{_heading(rows, done)}: {MEASURES[quantity].label}", fontsize=11)
    save(figure, path)


def _nearest(value: float | None, slices: "Sequence[float | None]") -> float | None:
    """The slice that a point is drawn in; None for a point without a value of the axis."""
    known = [each for each in slices if each is not None]
    return None if value is None else min(known, key=lambda each: abs(each - value))


def _fields(
    done: "Sequence[Row]", axes: tuple[str, ...], value: float | None, fit: "Interpolation"
) -> "tuple[NDArray, ...]":
    """x, y, mean and half width of the band on a grid over the range of the points, (GRID,GRID) each; NaN outside their hull."""
    import numpy as np

    from ..studies.maps import BAND, LOGARITHMIC

    sides = []
    for axis in axes[:2]:
        values = [row[axis] for row in done]
        space = np.geomspace if axis in LOGARITHMIC else np.linspace
        sides.append(space(min(values), max(values), GRID))
    x, y = np.meshgrid(*sides)
    at = (x, y) if value is None else (x, y, np.full_like(x, value))
    mean, std = (np.where(fit.inside(*at), values, np.nan) for values in fit(*at))
    return x, y, mean, BAND * std


def _levels(fields: "Sequence[NDArray]", quantity: str, band: bool) -> "NDArray":
    """Round levels over the range of several fields; about 1 in the middle for a ratio to a critical value."""
    import numpy as np
    from matplotlib.ticker import MaxNLocator

    low, high = min(float(np.nanmin(f)) for f in fields), max(float(np.nanmax(f)) for f in fields)
    if band:
        low = 0.0
    elif quantity == "velocity_ratio":
        reach = max(high - 1.0, 1.0 - low)
        low, high = 1.0 - reach, 1.0 + reach
    if high - low < 1e-12 * max(abs(high), 1e-12):
        high = low + max(abs(low), 1e-12)
    return np.asarray(MaxNLocator(6 if band else 10).tick_values(low, high))


def _panel(at: "Axes", field: "tuple[NDArray, NDArray, NDArray]", levels: "NDArray", band: bool, quantity: str) -> None:
    from matplotlib.patheffects import withStroke

    x, y, values = field
    colours = at.contourf(x, y, values, levels, cmap="Greys" if band else COLOURS[quantity], extend="neither")
    is_light = band or quantity == "velocity_ratio"  # in the middle of the colours
    lines = at.contour(x, y, values, levels, colors="k" if is_light else "w", linewidths=0.5)
    for label in at.clabel(lines, fontsize=7, fmt=lambda v: f"{v:.4g}"):
        label.set_path_effects([withStroke(linewidth=1.5, foreground="w" if is_light else "k")])
    if quantity == "velocity_ratio":
        at.contour(x, y, values, [1.0], colors="k", linewidths=2.0)
    bar = at.figure.colorbar(colours, ax=at)
    bar.ax.set_ylabel(MEASURES[quantity].unit, rotation=0, labelpad=10)


def _points(
    at: "Axes", rows: "Sequence[Row]", x_axis: str, y_axis: str, quantity: str, colours: "ScalarMappable | None" = None
) -> None:
    """The points by their verdicts, crosses without a value of the quantity. colours: of the quantity; white without."""
    from matplotlib.ticker import FuncFormatter, NullLocator

    from ..report.picture import label_log
    from ..studies.maps import FORMULAS, LOGARITHMIC

    for kind, points in _by_verdict(rows, quantity).items():
        points = [row for row in points if row[x_axis] is not None and row[y_axis] is not None]
        values = [MEASURES[quantity].factor * row[quantity] for row in points] if colours and kind != NO_VALUE else None
        x, y = [row[x_axis] for row in points], [row[y_axis] for row in points]
        _scatter(at, x, y, kind, MARKERS[kind], values, colours)
    if x_axis in FORMULAS:
        at.axvline(1.0, color="k", linewidth=2.0)
    if y_axis in FORMULAS:
        at.axhline(1.0, color="k", linewidth=2.0)
    for name, axis, side in (("x", at.xaxis, x_axis), ("y", at.yaxis, y_axis)):
        factor = measure(side).factor
        axis.set_major_formatter(FuncFormatter(lambda v, _, f=factor: f"{v * f:.4g}"))
        if side in LOGARITHMIC:
            getattr(at, f"set_{name}scale")("log")
            label_log(axis, factor)
        ticks = sorted({row[side] for row in rows if row[side] is not None})
        if len(ticks) <= 8:
            axis.set_ticks(ticks)
            axis.set_minor_locator(NullLocator())


def _scatter(
    at: "Axes",
    x: Sequence[float],
    y: Sequence[float],
    kind: str,
    marker: str,
    values: Sequence[float] | None = None,
    colours: "ScalarMappable | None" = None,
    edgecolors: str | Sequence[str] = "k",
) -> None:
    """Markers of one kind of points, with an entry of the legend; white, orange without a value, or in the colours of values."""
    if not x:
        return
    style: dict[str, Any] = {"c": "#d55e00" if kind == NO_VALUE else "w", "s": 22, "edgecolors": edgecolors}
    if values is not None and colours is not None:
        style = {"c": values, "cmap": colours.cmap, "norm": colours.norm, "s": 45, "edgecolors": "k"}
    at.scatter(x, y, linewidths=0.8, label=kind, zorder=3, clip_on=False, marker=marker, **style)
