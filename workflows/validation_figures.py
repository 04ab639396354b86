"""The figures of the validation page, and their data."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pages import column, figure_path, number, table_rows

from coupler.studies.table import Row

matplotlib.use("Agg")

# Ours dark and full, the paper's grey or hatched by its marks: told apart without colour too.
INK, BLUE, ORANGE, GREY = "#1a1a1a", "#1f5fa8", "#c7540a", "#8a8a8a"
TREND_COLUMNS = (
    ("flattening_end", "flattening, height"),
    ("flattening_total_end", "whole"),
    ("eps_p_mean", "eps_p mean"),
    ("eps_p_p99", "eps_p 99 %"),
    ("T_p99", "T 99 % K"),
    ("T_max", "T max K"),
    ("crater_um", "crater µm"),
    ("rebound_m_s", "leaves at m/s"),
)
# What the paper says of each trend, in short, for the panels.
PAPER_SAYS = {
    ("flattening", "diameter_um"): "paper: rises, then falls for large ones",
    ("flattening", "speed_m_s"): "paper: rises, falls at the high end",
    ("flattening", "temperature_K"): "paper: rises",
    ("strain", "diameter_um"): "paper: rises",
    ("strain", "speed_m_s"): "paper: rises",
    ("strain", "temperature_K"): "paper: 600 K does more\nthan 1000 m/s",
    ("heat", "diameter_um"): "paper: rises a little",
    ("heat", "speed_m_s"): "paper: rises",
    ("heat", "temperature_K"): "paper: rises",
}


def ringing(time: NDArray, y: NDArray, start: float, end: float) -> tuple[float, float]:
    """Frequency (MHz) of the strongest oscillation of y over time (ns) from start to end, and half its largest swing there.

    The straight trend is taken off; a Hann window and zeros behind make the peak of the spectrum a number.
    """
    t = np.linspace(start, end, 2048)
    even = np.interp(t, time, y)
    rest = even - np.polyval(np.polyfit(t, even, 1), t)
    spectrum = np.abs(np.fft.rfft(rest * np.hanning(len(t)), 8 * len(t)))
    frequency = np.fft.rfftfreq(8 * len(t), t[1] - t[0]) * 1e3
    heard = frequency > 2e3 / (end - start)  # two periods at least
    return float(frequency[heard][spectrum[heard].argmax()]), float(0.5 * np.ptp(rest))


def trend_rows(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows of the trends by the variable and the constants, in order of the variable. The runs with a similar target apart."""
    plain = [r for r in rows if "-similar" not in r["run"] and not r["run"].startswith("shape-") and not r["failed"]]

    def chosen(rows: Iterable[Row], by: str, **constant: float) -> list[Row]:
        used = [row for row in rows if all(abs(float(row[name]) - value) < 1e-6 for name, value in constant.items())]
        return sorted(used, key=lambda row: float(row[by]))

    return {
        "diameter, 500 m/s, 300 K": chosen(plain, "diameter_um", speed_m_s=500, temperature_K=300),
        "diameter, 1000 m/s, 300 K": chosen(plain, "diameter_um", speed_m_s=1000, temperature_K=300),
        "diameter, 500 m/s, 600 K": chosen(plain, "diameter_um", speed_m_s=500, temperature_K=600),
        "velocity, 25 µm, 300 K": chosen(plain, "speed_m_s", diameter_um=25, temperature_K=300),
        "temperature, 25 µm, 500 m/s": chosen(plain, "temperature_K", diameter_um=25, speed_m_s=500),
        "similar": chosen((row for row in rows if "-similar" in row["run"]), "diameter_um"),
    }


def trend_lines(runs: dict[str, list[Row]]) -> list[list[str]]:
    """Lines of the table of trends: some runs of each series."""
    wanted = {
        "diameter, 500 m/s, 300 K": (5, 10, 25, 40, 60), "similar": (10, 40), "diameter, 500 m/s, 600 K": (5, 25, 60),
        "velocity, 25 µm, 300 K": (125, 250, 375, 750, 1000, 1250), "temperature, 25 µm, 500 m/s": (450, 600),
    }  # fmt: skip
    places = {"T_p99": 0, "T_max": 0, "rebound_m_s": 0, "flattening_end": 3, "flattening_total_end": 3}
    lines = []
    for series, values in wanted.items():
        by = {"v": "speed_m_s", "t": "temperature_K"}.get(series[0], "diameter_um")
        for row in (row for row in runs[series] if round(float(row[by])) in values):
            name = "{:.0f} µm, {:.0f} m/s, {:.0f} K".format(
                *(number(row, c) for c in ("diameter_um", "speed_m_s", "temperature_K"))
            )
            name += ", target in proportion" if series == "similar" else ""
            lines.append(
                [
                    name,
                    *(f"{number(row, c):.{places.get(c, 2)}f}" for c, _ in TREND_COLUMNS),
                    f"{row['version']}, {row['engine']}",
                ]
            )
    return lines


def canvas(rows: int, columns: int, width: float, height: float, **shared: str | bool) -> tuple[Figure, NDArray]:
    """A figure and its panels (rows, columns), with a faint grid. width, height: inches."""
    figure, axes = plt.subplots(
        rows, columns, figsize=(width, height), dpi=130, layout="constrained", squeeze=False, **shared
    )
    for axis in axes.flat:
        axis.grid(alpha=0.25)
    return figure, axes


def save(figure: Figure, path: Path) -> None:
    figure.savefig(path)
    plt.close(figure)


def draw_trends(rows: Sequence[Row], path: Path) -> None:
    """Flattening, mean plastic strain and temperature over diameter, velocity and temperature, nine panels."""
    runs = trend_rows(rows)
    figure, axes = canvas(3, 3, 10.5, 8.6, sharex="col", sharey="row")
    series = {  # variable -> label, and series with colour and mark
        "diameter_um": ("diameter (µm)", {
            "diameter, 500 m/s, 300 K": (INK, "o"), "diameter, 1000 m/s, 300 K": (BLUE, "s"),
            "diameter, 500 m/s, 600 K": (ORANGE, "^")}),
        "speed_m_s": ("velocity (m/s)", {"velocity, 25 µm, 300 K": (INK, "o")}),
        "temperature_K": ("initial temperature (K)", {"temperature, 25 µm, 500 m/s": (INK, "o")}),
    }  # fmt: skip
    kinds = {  # kind -> label, columns with the style of their line, their words, room above for words
        "flattening": ("flattening", {"flattening_end": "-", "flattening_total_end": ":"},
                       "full: height above surface, dotted: whole thickness", 0.12),
        "strain": ("mean plastic strain", {"eps_p_mean": "-"}, "", 0.12),
        "heat": ("temperature of the particle (K)", {"T_p99": "-", "T_max": ":"}, "full: 99 %, dotted: maximum", 0.10),
    }  # fmt: skip
    for across, (variable, (below, lines)) in enumerate(series.items()):
        for down, (kind, (_, columns, _, _)) in enumerate(kinds.items()):
            axis = axes[down, across]
            for name, (colour, mark) in lines.items():
                for where, style in columns.items():
                    label = name.partition(", ")[2] if style == "-" else None
                    x, y = column(runs[name], variable), column(runs[name], where)
                    axis.plot(x, y, style, color=colour, marker=mark, ms=4, lw=1.4, label=label)
            words = {"transform": axis.transAxes, "va": "top", "fontsize": 8, "color": "#444444"}
            axis.text(0.02, 0.98, PAPER_SAYS[kind, variable], **words)
        axes[2, across].set_xlabel(below)
    x, y = (column(runs["similar"], name) for name in ("diameter_um", "flattening_end"))
    handle = axes[0, 0].plot(x, y, "x", color=GREY, ms=7, mew=1.6, label="target in proportion")
    axes[1, 0].legend(fontsize=8, loc="center right")
    axes[0, 0].legend(handles=handle, fontsize=8, loc="lower left", frameon=False)
    for down, (label, _, words, room) in enumerate(kinds.values()):
        axes[down, 0].set_ylabel(label)
        axes[down, 2].text(0.98, 0.03, words, transform=axes[down, 2].transAxes, ha="right", fontsize=8)
        low, high = axes[down, 0].get_ylim()
        axes[down, 0].set_ylim(low, high + room * (high - low))
    save(figure, path)


def draw_ratios(names: Sequence[str], ratios: Mapping[str, NDArray], scatter: Sequence[Row], path: Path) -> None:
    """Largest diameter over largest thickness of the seven particles: ours, the paper's two methods, the experiment's.

    ratios: values (k,) of "ours", "pure" (with the library's titanium), "hybrid", "ale" and "experiment". scatter: rows of case D.
    """
    figure, axes = canvas(1, 1, 9, 3.8)
    axis, x = axes[0, 0], np.arange(len(names))
    for who, mark, colour, size, full, label in (
        ("hybrid", "s", GREY, 6, True, "paper, hybrid"),
        ("ale", "D", GREY, 6, False, "paper, ALE"),
        ("experiment", "_", ORANGE, 26, True, "experiment"),
        ("ours", "o", BLUE, 8, True, "ours"),
        ("pure", "^", BLUE, 8, False, "ours, CP_Ti"),
    ):
        values = ratios[who]
        width = 3 if mark == "_" else 1
        axis.plot(
            x[: len(values)],
            values,
            mark,
            color=colour,
            mfc=colour if full else "none",
            ms=size,
            mew=width,
            label=label,
        )
    for place, name in enumerate(names):
        own = [row for row in scatter if name.startswith("D") and row["impact"] == name[1] and not row["failed"]]
        if own:
            values = column(own, "widest_um_end") / column(own, "thickness_um_end")
            at = np.full(len(values), place + 0.22)
            axis.plot(
                at, values, ".", color=INK, ms=4, alpha=0.6, label="ours, over the scatter" if name[1] == "1" else ""
            )
    axis.set_yscale("log")
    axis.set_yticks((1, 1.5, 2, 3, 5, 8), ("1", "1.5", "2", "3", "5", "8"))
    axis.minorticks_off()
    axis.set_xticks(x, [name.replace(": ", "\n") for name in names])
    axis.set_ylabel("largest diameter / thickness")
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    save(figure, path)


def draw_depth(rows: Sequence[Row], path: Path) -> None:
    """Plastic strain, temperature, von Mises stress and the stress components of case A along its axis."""
    figure, axes = canvas(1, 4, 11.5, 3.9, sharey=True)
    splat = [row for row in rows if row["body"] == "splat"]
    depths = column(splat, "depth_um")
    panels = {
        "plastic strain": [("eps_p", INK, "-", "")],
        "temperature (K)": [("T_K", INK, "-", "")],
        "von Mises stress (MPa)": [("von_mises_MPa", INK, "-", "")],
        "stress (MPa), tension positive": [
            ("xx_MPa", BLUE, "-", "xx"), ("yy_MPa", BLUE, ":", "yy"), ("zz_MPa", ORANGE, "-", "zz, along the impact")],
    }  # fmt: skip
    for axis, (label, lines) in zip(axes[0], panels.items(), strict=True):
        for name, colour, style, words in lines:
            for part in (splat, [row for row in rows if row["body"] == "substrate"]):
                axis.plot(column(part, name), column(part, "depth_um"), style, color=colour, lw=1.4, label=words)
                words = ""
        axis.axhspan(depths.min(), depths.max(), color="#e8eef5", zorder=0)
        axis.axhline(0.0, color=GREY, lw=0.8, ls="--")
        axis.set_xlabel(label)
    axes[0, 0].set(ylabel="depth below the undeformed surface (µm)", ylim=(45, -13))
    axes[0, 0].text(0.97, 0.97, "splat", transform=axes[0, 0].transAxes, ha="right", va="top", fontsize=9)
    axes[0, 3].axvline(0.0, color=GREY, lw=0.8)
    axes[0, 3].legend(fontsize=8, loc="lower left")
    save(figure, path)


def draw_wave(rows: Sequence[Row], path: Path) -> None:
    """Von Mises stress at the first point of contact, and mean contact pressure, over time."""
    figure, axes = canvas(1, 2, 10.5, 3.6, sharex=True)
    stress, pressure = axes[0]
    for axis, name, colour, width, style, label in (
        (stress, "particle_MPa", BLUE, 1.0, "-", "particle, at its lowest point"),
        (stress, "target_MPa", ORANGE, 1.0, "-", "target, below it"),
        (stress, "particle_mean_MPa", INK, 1.2, "--", "particle, mean"),
        (pressure, "pressure_MPa", INK, 1.0, "-", "contact force over area of contact"),
    ):
        axis.plot(column(rows, "time_ns"), column(rows, name), color=colour, lw=width, ls=style, label=label)
    stress.axhline(380, color=GREY, lw=1, ls=":", label="paper: 380 MPa after 150 ns")
    pressure.axhline(777, color=GREY, lw=1, ls=":", label="paper: 777 MPa (hybrid)")
    stress.set_ylabel("von Mises stress (MPa)")
    pressure.set_yscale("symlog", linthresh=100)
    pressure.set(ylabel="mean contact pressure (MPa)", ylim=(0, None))
    for axis in (stress, pressure):
        axis.set_xlabel("time (ns)")
        axis.legend(fontsize=8)
    save(figure, path)


def draw_all(names: Sequence[str], ratios: Mapping[str, NDArray], scatter: Sequence[Row]) -> None:
    """All figures whose tables exist, beside the page. Arguments as of `draw_ratios`."""
    draw_ratios(names, ratios, scatter, figure_path("validation", "validation_ratios.png"))
    for name, draw in (("trends", draw_trends), ("profiles", draw_depth), ("wave", draw_wave)):
        if rows := table_rows(f"validation_{name}"):
            draw(rows, figure_path("validation", f"validation_{name}.png"))
