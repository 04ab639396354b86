"""The figures of the validation page, and their data."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray
from pages import figure_path, table_rows

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


def column(rows: Sequence[dict[str, str]], name: str) -> NDArray[np.float64]:
    """A column of a table as numbers (k,), nan where there is none."""
    return np.array([float(row.get(name) or "nan") for row in rows])


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


def trend_rows(rows: Sequence[dict[str, str]]) -> dict[str, list[dict[str, str]]]:
    """Rows of the trends by what they vary and what they hold, in its order. The runs with a similar target apart."""
    plain = [
        row
        for row in rows
        if "-similar" not in row["run"] and not row["run"].startswith("shape-") and not row["failed"]
    ]

    def chosen(by: str, **held: float) -> list[dict[str, str]]:
        mine = [row for row in plain if all(abs(float(row[name]) - value) < 1e-6 for name, value in held.items())]
        return sorted(mine, key=lambda row: float(row[by]))

    return {
        "diameter, 500 m/s, 300 K": chosen("diameter_um", speed_m_s=500, temperature_K=300),
        "diameter, 1000 m/s, 300 K": chosen("diameter_um", speed_m_s=1000, temperature_K=300),
        "diameter, 500 m/s, 600 K": chosen("diameter_um", speed_m_s=500, temperature_K=600),
        "velocity, 25 µm, 300 K": chosen("speed_m_s", diameter_um=25, temperature_K=300),
        "temperature, 25 µm, 500 m/s": chosen("temperature_K", diameter_um=25, speed_m_s=500),
        "similar": sorted((row for row in rows if "-similar" in row["run"]), key=lambda row: float(row["diameter_um"])),
    }


def trend_lines(runs: dict[str, list[dict[str, str]]]) -> list[list[str]]:
    """Lines of the table of trends: some runs of each series."""
    wanted = {
        "diameter, 500 m/s, 300 K": (5, 10, 25, 40, 60), "similar": (10, 40), "diameter, 500 m/s, 600 K": (5, 25, 60),
        "velocity, 25 µm, 300 K": (125, 250, 375, 750, 1000, 1250), "temperature, 25 µm, 500 m/s": (450, 600),
    }  # fmt: skip
    lines = []
    for series, values in wanted.items():
        by = {"v": "speed_m_s", "t": "temperature_K"}.get(series[0], "diameter_um")
        for row in runs[series]:
            if round(float(row[by])) in values:
                name = f"{float(row['diameter_um']):.0f} µm, {float(row['speed_m_s']):.0f} m/s, {float(row['temperature_K']):.0f} K"
                name += ", target in proportion" if series == "similar" else ""
                digits = {"T_p99": 0, "T_max": 0, "rebound_m_s": 0}
                cells = [
                    f"{float(row[c] or 'nan'):.{digits.get(c, 3 if 'flat' in c else 2)}f}" for c, _ in TREND_COLUMNS
                ]
                lines.append([name, *cells])
    return lines


def draw_trends(rows: Sequence[dict[str, str]], path: Path) -> None:
    """Flattening, mean plastic strain and temperature over diameter, velocity and temperature, nine panels."""
    runs = trend_rows(rows)
    figure, axes = plt.subplots(3, 3, figsize=(10.5, 8.6), dpi=130, sharex="col", sharey="row", layout="constrained")
    series = {
        "diameter_um": [
            ("diameter, 500 m/s, 300 K", INK, "o", "500 m/s, 300 K"),
            ("diameter, 1000 m/s, 300 K", BLUE, "s", "1000 m/s, 300 K"),
            ("diameter, 500 m/s, 600 K", ORANGE, "^", "500 m/s, 600 K"),
        ],
        "speed_m_s": [("velocity, 25 µm, 300 K", INK, "o", "25 µm, 300 K")],
        "temperature_K": [("temperature, 25 µm, 500 m/s", INK, "o", "25 µm, 500 m/s")],
    }
    kinds: dict[str, list[tuple[str, str, str]]] = {
        "flattening": [
            ("flattening_end", "-", "height above surface"),
            ("flattening_total_end", ":", "whole thickness"),
        ],
        "strain": [("eps_p_mean", "-", "mean")],
        "heat": [("T_p99", "-", "99 %"), ("T_max", ":", "maximum")],
    }
    labels = {"flattening": "flattening", "strain": "mean plastic strain", "heat": "temperature of the particle (K)"}
    bottom = {"diameter_um": "diameter (µm)", "speed_m_s": "velocity (m/s)", "temperature_K": "initial temperature (K)"}
    for across, (variable, lines) in enumerate(series.items()):
        for down, (kind, columns) in enumerate(kinds.items()):
            axis = axes[down, across]
            for name, colour, mark, words in lines:
                x = column(runs[name], variable)
                for where, style, _ in columns:
                    label = words if style == "-" else None
                    axis.plot(x, column(runs[name], where), style, color=colour, marker=mark, ms=4, lw=1.4, label=label)
            if variable == "diameter_um" and kind == "flattening":
                x = column(runs["similar"], "diameter_um")
                axis.plot(
                    x,
                    column(runs["similar"], "flattening_end"),
                    "x",
                    color=GREY,
                    ms=7,
                    mew=1.6,
                    label="target in proportion",
                )
            axis.text(
                0.02, 0.98, PAPER_SAYS[kind, variable], transform=axis.transAxes, va="top", fontsize=8, color="#444444"
            )
            axis.grid(alpha=0.25)
            if across == 0:
                axis.set_ylabel(labels[kind])
            if down == 2:
                axis.set_xlabel(bottom[variable])
    for down, columns in enumerate(kinds.values()):
        if len(columns) > 1:
            words = "full: " + columns[0][2] + ", dotted: " + columns[1][2]
            axes[down, 2].text(0.98, 0.03, words, transform=axes[down, 2].transAxes, ha="right", fontsize=8)
    axes[1, 0].legend(fontsize=8, loc="center right")
    handle = [line for line in axes[0, 0].lines if line.get_label() == "target in proportion"]
    axes[0, 0].legend(handles=handle, fontsize=8, loc="center left", bbox_to_anchor=(0.0, 0.67), frameon=False)
    for down, room in enumerate((0.12, 0.12, 0.10)):  # for the words at the top
        low, high = axes[down, 0].get_ylim()
        axes[down, 0].set_ylim(low, high + room * (high - low))
    figure.savefig(path)
    plt.close(figure)


def draw_flattening(found: Sequence[tuple[str, Row, dict[str, float]]], path: Path) -> None:
    """Flattening of the seven particles: ours in two readings, the paper's two, the experiment's."""
    figure, axis = plt.subplots(figsize=(9, 3.8), dpi=130, layout="constrained")
    y = np.arange(len(found))
    for mark, colour, name, who in (("s", GREY, "paper, hybrid", "hybrid"), ("D", GREY, "paper, ALE", "ale")):
        face = GREY if who == "hybrid" else "none"
        axis.plot(y, [paper[who] for _, _, paper in found], mark, color=colour, mfc=face, ms=6, label=name)
    axis.plot(y, [paper["experiment"] for _, _, paper in found], "_", color=ORANGE, ms=26, mew=3, label="experiment")
    rows = [row for _, row, _ in found]
    axis.plot(y, column(rows, "flattening_end"), "o", color=BLUE, ms=8, label="ours, height above surface, at the end")
    axis.plot(y, column(rows, "flattening_own"), "o", color=BLUE, mfc="none", ms=8, label="after its own impact")
    axis.plot(y, column(rows, "flattening_total_end"), "^", color=INK, ms=7, label="ours, whole thickness, at the end")
    axis_thickness = 1 - column(rows, "axial_um_end") / column(rows, "diameter_um")
    axis.plot(y, axis_thickness, "v", color=INK, mfc="none", ms=7, label="ours, on the axis, at the end")
    axis.set_xticks(y, [name.replace(": ", "\n") for name, _, _ in found])
    axis.set_ylabel("flattening")
    axis.grid(axis="y", alpha=0.3)
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path)
    plt.close(figure)


def draw_depth(rows: Sequence[dict[str, str]], path: Path) -> None:
    """Plastic strain, temperature, von Mises stress and the stress components of case A along its axis."""
    figure, axes = plt.subplots(1, 4, figsize=(11.5, 3.9), dpi=130, sharey=True, layout="constrained")
    panels = [
        ("plastic strain", [("eps_p", INK, "-", "")]),
        ("temperature (K)", [("T_K", INK, "-", "")]),
        ("von Mises stress (MPa)", [("von_mises_MPa", INK, "-", "")]),
        (
            "stress (MPa), tension positive",
            [("xx_MPa", BLUE, "-", "xx"), ("yy_MPa", BLUE, ":", "yy"), ("zz_MPa", ORANGE, "-", "zz, along the impact")],
        ),
    ]
    for axis, (label, lines) in zip(axes, panels, strict=True):
        for body in ("splat", "substrate"):
            mine = [row for row in rows if row["body"] == body]
            depth = column(mine, "depth_um")
            for name, colour, style, words in lines:
                axis.plot(
                    column(mine, name), depth, style, color=colour, lw=1.4, label=words if body == "splat" else None
                )
        ends = [row for row in rows if row["body"] == "splat"]
        axis.axhspan(
            float(column(ends, "depth_um").min()), float(column(ends, "depth_um").max()), color="#e8eef5", zorder=0
        )
        axis.axhline(0.0, color=GREY, lw=0.8, ls="--")
        axis.set_xlabel(label)
        axis.grid(alpha=0.25)
    axes[0].set_ylabel("depth below the undeformed surface (µm)")
    axes[0].set_ylim(45, -13)
    axes[0].text(0.97, 0.97, "splat", transform=axes[0].transAxes, ha="right", va="top", fontsize=9)
    axes[3].axvline(0.0, color=GREY, lw=0.8)
    axes[3].legend(fontsize=8, loc="lower left")
    figure.savefig(path)
    plt.close(figure)


def draw_wave(rows: Sequence[dict[str, str]], path: Path) -> None:
    """Von Mises stress at the first point of contact, and mean contact pressure, over time."""
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 3.6), dpi=130, sharex=True, layout="constrained")
    time = column(rows, "time_ns")
    axes[0].plot(time, column(rows, "particle_MPa"), color=BLUE, lw=1.0, label="particle, at its lowest point")
    axes[0].plot(time, column(rows, "target_MPa"), color=ORANGE, lw=1.0, label="target, below it")
    axes[0].plot(time, column(rows, "particle_mean_MPa"), color=INK, lw=1.2, ls="--", label="particle, mean")
    axes[0].axhline(380, color=GREY, lw=1, ls=":", label="paper: 380 MPa after 150 ns")
    axes[0].set_ylabel("von Mises stress (MPa)")
    axes[1].plot(time, column(rows, "pressure_MPa"), color=INK, lw=1.0, label="contact force over area of contact")
    axes[1].axhline(777, color=GREY, lw=1, ls=":", label="paper: 777 MPa (hybrid)")
    axes[1].set_ylabel("mean contact pressure (MPa)")
    axes[1].set_yscale("symlog", linthresh=100)
    axes[1].set_ylim(0, None)
    for axis in axes:
        axis.set_xlabel("time (ns)")
        axis.grid(alpha=0.25)
        axis.legend(fontsize=8)
    figure.savefig(path)
    plt.close(figure)


def draw_all(splats: Sequence[tuple[str, Row, dict[str, float]]]) -> None:
    """All figures whose tables exist, beside the page."""
    draw_flattening(splats, figure_path("validation", "validation_flattening.png"))
    for name, draw in (("trends", draw_trends), ("profiles", draw_depth), ("wave", draw_wave)):
        if rows := table_rows(f"validation_{name}"):
            draw(rows, figure_path("validation", f"validation_{name}.png"))
