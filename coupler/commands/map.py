"""The command `coldspray map`: the table of a sweep, and maps of it with their uncertainty."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..measures import MEASURES, REBOUNDS, UNDECIDED, axis_label, measure
from .arguments import Commands, add_command, add_force, path, working

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from ..studies.maps import Interpolation
    from ..studies.runs_table import Row

# measure -> colour map (all of them in even steps of lightness)
COLOURS = {
    "flattening_ratio": "viridis", "T_p99_K": "inferno", "restitution": "cividis", "velocity_ratio": "PuOr_r",
    "T_mean_K": "inferno", "eps_p_mean": "viridis", "crater_depth_m": "viridis", "splat_diameter_m": "viridis",
    "rebound_velocity_m_s": "cividis", "bonded_area_end_m2": "viridis", "numerical_dissipation": "viridis",
}  # fmt: skip
DRAWN = ("flattening_ratio", "T_p99_K", "restitution", "velocity_ratio")
GRID = 61  # places along each side of a map


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
        at, _ = maps.best_point(rows, arguments.show[0], axes)
        if not at:
            print("no point to run: it needs two neighbours with results")
            break
        print(f"running {number + 1} of {arguments.refine}: {place(at)}", flush=True)
        maps.run_next(arguments.folder, rows, at)
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

    Two axes and more with values enough: a surface and its band, a row of panels for each value of a third axis; one axis: a curve;
    fewer values: points and straight lines. axes: `runs_table.add_axes`; those of its AXES that vary by default. Returns remarks: file
    and errors of each interpolation, what it cannot tell, and the next point worth a run.
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
                    at, fit = maps.best_point(own, quantity, used)
                    if fit is not None and len(used) in (2, 3):
                        _figure(path, own, used, quantity, fit)
                    else:
                        _lines(path, own, used, quantity, fit)
            except StoreError as error:
                remarks.append(f"{material}, {m.label}: no map; {error}")
                continue
            remarks.append(
                f"{material}, {m.label}: {_quality(fit, m.factor, m.unit) if fit else maps.sparse(done, used)}; {path}"
            )
            remarks += [f"  {text}" for text in (fit.warnings if fit else ())]
            if at:
                band = (
                    f" (band +- {m.factor * maps.BAND * float(fit(*at.values())[1]):.3g} {m.unit}".rstrip() + ")"
                    if fit
                    else ""
                )
                remarks.append(f"  next point worth a run: {place(at)}{band}; --refine 1 runs it")
    return remarks or ["no map: no point is done"]


def place(at: Mapping[str, float]) -> str:
    """A place on the axes in words."""
    values = ((measure(axis), value) for axis, value in at.items())
    return ", ".join(f"{m.short} {value * m.factor:.4g} {m.unit}".rstrip() for m, value in values)


def _quality(fit: "Interpolation", factor: float, unit: str) -> str:
    gaps = "".join(f", all of one {measure(axis).short} {factor * rms:.3g}" for axis, rms in fit.gap_rms.items())
    return (
        f"rms error leaving out one point {factor * fit.loo_rms:.3g}{gaps} {unit}".rstrip()
        + f" (spread {factor * fit.spread:.3g}), {fit.loo_inside:.0%} inside their 95 % band"
    )


def _lines(
    path: Path, rows: "Sequence[Row]", axes: tuple[str, ...], quantity: str, fit: "Interpolation | None"
) -> None:
    """A quantity over the axis with the most values, a line for each place on the others: straight, or the interpolation of one axis
    with its band."""
    import numpy as np

    from ..report.picture import blank, save
    from ..studies.maps import BAND, LOGARITHMIC

    m, done = MEASURES[quantity], [row for row in rows if row["status"] == "done" and row[quantity] is not None]
    x_axis = max(axes, key=lambda axis: len({row[axis] for row in done}))
    others = [axis for axis in axes if axis != x_axis]
    across = measure(x_axis).factor
    figure = blank(6.4, 4.3, dpi=130, layout="constrained")
    at = figure.subplots()
    for key in sorted({tuple(row[axis] for axis in others) for row in done}):
        line = sorted((row for row in done if tuple(row[axis] for axis in others) == key), key=lambda row: row[x_axis])
        x, y = np.array([row[x_axis] for row in line]), m.factor * np.array([row[quantity] for row in line])
        (drawn,) = at.plot(
            across * x, y, "o" if fit else "o-", linewidth=0.8, label=place(dict(zip(others, key, strict=True)))
        )
        if fit is not None:
            fine = (np.geomspace if x_axis in LOGARITHMIC else np.linspace)(x.min(), x.max(), 4 * GRID)
            mean, std = fit(fine)
            at.plot(across * fine, m.factor * mean, color=drawn.get_color())
            band = BAND * std
            at.fill_between(
                across * fine, m.factor * (mean - band), m.factor * (mean + band), alpha=0.2, label="95 % band"
            )
    if others or fit is not None:
        at.legend(fontsize=7)
    at.set_xlabel(axis_label(x_axis))
    at.set_ylabel(f"{m.label} ({m.unit})" if m.unit else m.label)
    figure.suptitle(
        f"{rows[0]['material']} on {', '.join(dict.fromkeys(row['substrate'] for row in done))}", fontsize=11
    )
    save(figure, path)


def _figure(path: Path, rows: "Sequence[Row]", axes: tuple[str, ...], quantity: str, fit: "Interpolation") -> None:
    """Mean and half width of the 95 % band side by side, a row for each value of the third axis."""
    from ..report.picture import blank, save

    factor = MEASURES[quantity].factor
    x_axis, y_axis, *third = axes
    done = [row for row in rows if row["status"] == "done" and row[quantity] is not None]
    slices = sorted({row[third[0]] for row in done}) if third else [None]
    figure = blank(10.8, 4.3 * len(slices), dpi=130, layout="constrained")
    panels = figure.subplots(len(slices), 2, squeeze=False, sharex=True, sharey=True)
    fields = [_fields(done, axes, value, fit) for value in slices]
    for number in range(2):
        levels = _levels([factor * field[2 + number] for field in fields], quantity, number == 1)
        for at, value, (x, y, *values) in zip(panels[:, number], slices, fields, strict=True):
            here = [row for row in rows if not third or row[third[0]] == value]
            _panel(at, (x, y, factor * values[number]), levels, number == 1, quantity)
            _points(at, here, x_axis, y_axis)
            at.set_xlabel(axis_label(x_axis))
            at.set_ylabel(axis_label(y_axis) if number == 0 else "")
            if number == 0 and value == slices[0]:
                figure.legend(loc="outside lower left", ncols=4, fontsize=8, frameon=False)
            heading = f"{axis_label(third[0])} {value:g}" if third else "95 % band, half width" if number else ""
            at.set_title(heading, fontsize=9)
    substrates = ", ".join(dict.fromkeys(row["substrate"] for row in done))
    figure.suptitle(f"{rows[0]['material']} on {substrates}: {MEASURES[quantity].label}", fontsize=11)
    save(figure, path)


def _fields(
    done: "Sequence[Row]", axes: tuple[str, ...], value: float | None, fit: "Interpolation"
) -> "tuple[NDArray, ...]":
    """x, y, mean and half width of the band on a grid over the range of the points."""
    import numpy as np

    from ..studies.maps import BAND, LOGARITHMIC

    sides = []
    for axis in axes[:2]:
        values = [row[axis] for row in done]
        space = np.geomspace if axis in LOGARITHMIC else np.linspace
        sides.append(space(min(values), max(values), GRID))
    x, y = np.meshgrid(*sides)
    at = (x, y) if value is None else (x, y, np.full_like(x, value))
    mean, std = fit(*at)
    return x, y, mean, BAND * std


def _levels(fields: "Sequence[NDArray]", quantity: str, band: bool) -> "NDArray":
    """Round levels over the range of several fields; about 1 in the middle for a ratio to a critical value."""
    import numpy as np
    from matplotlib.ticker import MaxNLocator

    low, high = min(float(np.min(f)) for f in fields), max(float(np.max(f)) for f in fields)
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


def _points(at: "Axes", rows: "Sequence[Row]", x_axis: str, y_axis: str) -> None:
    """The points by their verdicts, crosses where failed."""
    from matplotlib.ticker import FuncFormatter, NullLocator

    from ..report.picture import label_log
    from ..studies.maps import LOGARITHMIC

    done = [r for r in rows if r["status"] == "done"]
    kinds = {
        "sticks": ([r for r in done if r["verdict"] not in (REBOUNDS, UNDECIDED)], "o", "w"),
        "rebounds": ([r for r in done if r["verdict"] == REBOUNDS], "v", "w"),
        "undecided": ([r for r in done if r["verdict"] == UNDECIDED], "s", "w"),
        "failed": ([r for r in rows if r["status"] != "done"], "X", "#d55e00"),
    }  # fmt: skip
    for label, (points, marker, colour) in kinds.items():
        points = [row for row in points if row[x_axis] is not None and row[y_axis] is not None]
        if points:
            at.scatter([r[x_axis] for r in points], [r[y_axis] for r in points], s=22, edgecolors="k", linewidths=0.8,
                       label=label, zorder=3, clip_on=False, marker=marker, c=colour)  # fmt: skip
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
