"""The tables of the validation page, from docs/tables/validation*.csv and paper_values.toml."""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import validation_figures as figures
from pages import PAGES, column, markdown, marked, number, table_rows, versions, write_parts

from coupler.studies.table import Row

METHODS = ("hybrid", "ale", "experiment")  # of the paper
PAPER = tomllib.loads((Path(__file__).parent / "paper_values.toml").read_text())
#: The readings of a splat's thickness, and of the instant, that a flattening ratio can be of: column, words.
READINGS = (
    ("flattening_end", "height above the surface, end of the run"),
    ("flattening_own", "height above the surface, after its own impact"),
    ("flattening_greatest", "height above the surface, greatest deformation"),
    ("flattening_total_end", "whole thickness, end of the run"),
    ("flattening_total_own", "whole thickness, after its own impact"),
    ("axial_end", "thickness on the axis, end of the run"),
)


def with_axial(rows: Sequence[Row]) -> list[Row]:
    """The rows with a column more, axial_end: flattening by the thickness on the axis."""
    ends = 1.0 - column(rows, "axial_um_end") / column(rows, "diameter_um")
    return [row | {"axial_end": str(end)} for row, end in zip(rows, ends, strict=True)]


def digits(value: float, count: int = 2) -> str:
    """A number for a table, a dash for none."""
    return f"{value:.{count}f}" if np.isfinite(value) else "-"


def cells(row: Row, names: Sequence[str], count: int = 2) -> list[str]:
    """Columns of a row for a table."""
    return [digits(number(row, name), count) for name in names]


def seven(rows: Sequence[Row], suffix: str = "") -> list[tuple[str, Row, dict[str, float]]]:
    """The seven particles of cases A to D, so far as they are computed: name, row, and the flattening by METHODS."""
    particles = []
    for letter, case in PAPER["case"].items():
        for k, particle in enumerate(case["impacts"]):
            own = [row for row in rows if row["run"] == letter + suffix and row["impact"] == str(k + 1)]
            if own and not own[0]["failed"]:
                number_ = k + 1 if len(case["impacts"]) > 1 else ""
                name = f"{letter}{number_}: {particle['diameter_um']:.0f} µm {particle['material']}"
                particles.append((name, own[0], {who: values[k] for who, values in case["flattening"].items()}))
    return particles


def errors(rows: Sequence[Row]) -> list[str]:
    """Mean absolute error of flattening against the experiment, of each reading of ours and of the paper's two."""
    particles = seven(with_axial(rows))
    truth = np.array([paper["experiment"] for _, _, paper in particles])
    ours = [row for _, row, _ in particles]
    values = {f"the paper's {name}": np.array([paper[who] for _, _, paper in particles])
              for who, name in (("hybrid", "hybrid"), ("ale", "ALE"))}  # fmt: skip
    values |= {f"ours, {words}": column(ours, name) for name, words in READINGS}
    lines = []
    for name, value in values.items():
        off = value - truth
        lines.append([name, digits(np.abs(off).mean(), 3), f"{off.mean():+.3f}", digits(np.abs(off).max(), 2)])
    lines[2] = [f"**{cell}**" for cell in lines[2]]
    return [
        *markdown(f"| mean absolute error, {len(particles)} particles | mean error | largest", lines),
        "",
        versions(rows),
    ]


def flattening(rows: Sequence[Row]) -> list[str]:
    """Flattening of each particle: ours in its readings, the paper's, the experiment's."""
    rows = with_axial(rows)
    draft = {name: row for name, row, _ in seven(rows, "-draft")}
    names = [name for name, _ in READINGS]
    lines = []
    for name, row, paper in seven(rows):
        ours, coarse = cells(row, names), cells(draft.get(name, {}), names)
        ours[0] = f"**{ours[0]}** ({coarse[0]})"
        ours[3] += f" ({coarse[3]})"
        lines.append([marked(name, row), *ours, *(f"{paper[who]:.2f}" for who in METHODS)])
    head = "| height: end (draft) | own | greatest | whole: end (draft) | own | on the axis: end"
    return markdown(f"{head} | hybrid | ALE | experiment", lines)


def spread(rows: Sequence[Row]) -> list[str]:
    """Cases A and B over the measured spread of impact velocities."""
    lines = []
    for letter, key in (("A", "Ni_25um"), ("B", "Ti_30um")):
        measured, case = PAPER["experiment_spread"][key], PAPER["case"][letter]["flattening"]["experiment"][0]
        runs = [
            row
            for row in rows
            if row["run"] == f"{letter}-draft" or (row["run"].startswith(f"{letter}-") and row["run"][2:].isdigit())
        ]
        for row in sorted(runs, key=lambda row: float(row["speed_m_s"])):
            speed = float(row["speed_m_s"])
            off = speed - measured["velocity"]
            place = "mean" if off == 0 else f"{off:+.0f} m/s" + (" (nominal)" if speed == 500 else "")
            shape = cells(row, ("flattening_end", "flattening_total_end"), 3) + cells(
                row, ("crater_um", "diameter_um_end")
            )
            lines.append(
                [
                    f"{letter}: {key.replace('_', ' ').replace('um', ' µm')}",
                    f"{speed:.0f}",
                    place,
                    *shape,
                    f"{case:.2f}",
                ]
            )
    return markdown(
        "| m/s | of the measured | flattening, height | whole | crater µm | diameter µm | experiment", lines
    )


def shape(rows: Sequence[Row]) -> list[str]:
    """Diameters, thicknesses and their ratio, and craters."""
    lines = []
    for name, row, _ in seven(rows):
        ratios, k = PAPER["case"][name[0]].get("diameter_over_thickness", {}), int(row["impact"]) - 1
        names = ("diameter_um_end", "height_um_end", "thickness_um_end", "axial_um_end")
        over = [digits(number(row, names[0]) / number(row, thickness)) for thickness in names[1:]]
        others = [f"{ratios[who][k]:.2f}" if who in ratios else "-" for who in METHODS]
        lines.append(
            [name, *cells(row, names, 1), *over, *others, *cells(row, ["crater_um"]), *cells(row, ["rebound_m_s"], 0)]
        )
    head = "| diameter µm | height µm | whole µm | on the axis µm | d / height | d / whole | d / axis"
    return markdown(f"{head} | hybrid | ALE | experiment | crater µm | leaves at m/s", lines)


def contact(rows: Sequence[Row]) -> list[str]:
    """Case A against the paper's table 3."""
    row, wave_rows = seven(rows)[0][1], table_rows("validation_wave")
    texts = {
        "largest von Mises stress, MPa": ("max_von_mises_MPa", "particle {von_mises_greatest_MPa:.0f} at greatest deformation,"
                                          " {von_mises_MPa:.0f} at the end; target {target_von_mises_MPa:.0f}"),
        "plastic radius, µm": ("plastic_radius_um", "{plastic_radius_um:.0f} (0.2 % strain), {strained_radius_um:.0f} (20 %)"),
        "largest penetration, crater, µm": (
            "max_penetration_um", "{crater_greatest_um:.2f} greatest, {crater_um:.2f} at the end"),
    }  # fmt: skip
    values = {name: float(value) for name, value in row.items() if name.endswith(("_MPa", "_um")) and value}
    ours = {label: (key, text.format(**values)) for label, (key, text) in texts.items()}
    if wave_rows:
        pressure, force, time, area = (
            column(wave_rows, c) for c in ("pressure_MPa", "force_mN", "time_ns", "contact_um2")
        )
        peak, rest = int(force.argmax()), (time > 20) & (time < 30)
        text = f"{pressure[peak]:.0f} at the greatest force ({force[peak]:.0f} mN, {time[peak]:.1f} ns, {area[peak]:.0f} µm²); "
        text += f"{pressure[rest].mean():.0f} from 20 to 30 ns"
        ours = {"mean contact pressure, MPa": ("contact_pressure_MPa", text)} | ours
    lines = [
        [label, text, *(f"{PAPER['contact'][who][key]:g}" for who in METHODS[:2])]
        for label, (key, text) in ours.items()
    ]
    return markdown("25 µm Ni, 500 m/s | ours | hybrid | ALE", lines)


def wave(rows: Sequence[Row]) -> list[str]:
    """The stress over time at the first point of contact."""
    wave_rows = table_rows("validation_wave")
    if not wave_rows:
        return ["Not computed."]
    paper, time, lines = PAPER["single_Ni_500"], column(wave_rows, "time_ns"), []
    for name, label in (("particle_MPa", "particle, at its lowest point"), ("target_MPa", "target, below it"),
                        ("particle_mean_MPa", "particle, mean")):  # fmt: skip
        y = column(wave_rows, name)
        values = (y.max(), y[time > 120].mean(), *figures.ringing(time, y, 60.0, 150.0))
        lines.append([label, *(f"{value:.0f}" for value in values)])
    known = [
        paper["von_mises_peak_near_interface_MPa"],
        paper["von_mises_residual_MPa"],
        *paper["stress_wave"].values(),
    ]
    lines.append(["the paper", *(f"{value:.0f}" for value in known)])
    return markdown("von Mises stress, MPa | peak | 120 to 150 ns, mean | ringing MHz | its amplitude", lines)


def heat(rows: Sequence[Row]) -> list[str]:
    """Plastic strain and temperature of each particle after its own impact, and of the target that it hit."""
    cost, lines = PAPER["cost"], []
    for name, row, _ in seven(rows):
        ours = cells(row, ("eps_p_mean", "eps_p_p99", "eps_p_max")) + cells(row, ("T_mean", "T_p99", "T_max"), 0)
        k = {"A": 0, "D2": 1, "D3": 2}.get(name.split(":")[0])
        paper = ["-" if k is None else f"{cost[who][m][k]:g}" for m in ("eps_max", "T_max_K") for who in METHODS[:2]]
        lines.append([name, *ours, *cells(row, ["target_eps_p_max"]), *cells(row, ["target_T_max"], 0), *paper])
    head = "| eps_p mean | 99 % | max | T mean K | 99 % | max | target: eps_p max | T max K"
    return markdown(f"{head} | hybrid: eps_p max | ALE | hybrid: T max K | ALE", lines)


def cost(rows: Sequence[Row]) -> list[str]:
    """Points and elements, time steps and wall time; the paper's hours."""
    paper, lines = PAPER["cost"], []
    for letter, k in (("A", 0), ("B", None), ("C", None), ("D", 2)):
        own = [row for row in rows if row["run"] == letter and not row["failed"]]
        if not own:
            continue
        busy = number(own[-1], "run_cpu_s")
        line = [letter, " + ".join(row["points"] for row in own), own[-1]["elements"]]
        line += [
            ", ".join(digits(number(row, "dt_ps"), 1) for row in own),
            *cells(own[-1], ("run_wall_s", "run_cpu_s"), 0),
        ]
        if k is None:
            line += ["-"] * 5
        else:
            line += [
                f"{paper['elements'][k]:,}".replace(",", " "),
                *(f"{paper[who]['dt_ns'][k] * 1e3:g}" for who in METHODS[:2]),
            ]
            line += [f"{h:g} h: {h * 3600 / busy:.0f}" for h in (paper[who]["hours"][k] for who in METHODS[:2])]
        lines.append(line)
    head = "| points | elements | time step ps | wall s | processor s | paper: elements | hybrid: ps | ALE: ps"
    return markdown(f"{head} | hybrid: hours, times ours | ALE: hours, times ours", lines)


def trends(rows: Sequence[Row]) -> list[str]:
    """What the paper says of its trends, and what ours do."""
    runs = figures.trend_rows(table_rows("validation_trends"))
    return markdown(["run", *(name for _, name in figures.TREND_COLUMNS)], figures.trend_lines(runs))


def shapes(rows: Sequence[Row]) -> list[str]:
    """Six shapes, three impacts each: strain of the particles."""
    lines, runs = [], table_rows("validation_trends")
    columns = {"eps_p_mean": 2, "eps_p_p99": 2, "eps_p_max": 2, "T_p99": 0, "crater_um": 1, "rebound_m_s": 0}
    for name, strain in PAPER["morphology"]["eps_max"].items():
        own = [row for row in runs if row["run"] == f"shape-{name}"]
        if own and own[0]["failed"]:
            lines.append([name.replace("_", " "), own[0]["failed"], *["-"] * 5, f"{strain:g}"])
        elif own:
            values = [", ".join(digits(number(row, c), n) for row in own) for c, n in columns.items()]
            lines.append([name.replace("_", " "), *values, f"{strain:g}"])
    return markdown(
        "| eps_p mean of impacts 1, 2, 3 | 99 % | max | T 99 % K | crater µm | leaves at m/s | paper: eps_p max", lines
    )


PARTS: dict[str, Callable[[Sequence[Row]], list[str]]] = {
    "errors": errors, "flattening": flattening, "spread": spread, "shape": shape, "contact": contact, "wave": wave,
    "heat": heat, "cost": cost, "trends": trends, "shapes": shapes,
}  # fmt: skip


def write_page() -> None:
    """Write the tables into the page and draw its figures."""
    rows = table_rows("validation")
    if not seven(rows):
        raise SystemExit("docs/tables/validation.csv has none of the cases A to D yet: make validate")
    write_parts(PAGES["validation"], {name: part(rows) for name, part in PARTS.items()})
    figures.draw_all(seven(rows))
