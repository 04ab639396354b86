"""The tables of the validation page, from docs/tables/validation*.csv and paper_values.toml."""

import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import validation_figures as figures
from pages import PAGES, markdown, marked, table_rows, versions, write_parts

from coupler.studies.table import Row

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


def number(row: Row, column: str) -> float:
    """A value of a table, nan where there is none; "axial_end": flattening by the thickness on the axis."""
    if column == "axial_end":
        return 1.0 - number(row, "axial_um_end") / number(row, "diameter_um")
    return float(row.get(column) or "nan")


def said(value: float, digits: int = 2) -> str:
    """A number for a table, a dash for none."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def seven(rows: Sequence[Row], suffix: str = "") -> list[tuple[str, Row, dict[str, float]]]:
    """The seven particles of cases A to D, as far as they are computed: name, row, and the paper's flattening by who found it."""
    found = []
    for letter, case in PAPER["case"].items():
        for k, particle in enumerate(case["impacts"]):
            mine = [row for row in rows if row["run"] == letter + suffix and row["impact"] == str(k + 1)]
            if mine and not mine[0]["failed"]:
                name = f"{letter}{k + 1 if len(case['impacts']) > 1 else ''}: {particle['diameter_um']:.0f} µm {particle['material']}"
                found.append((name, mine[0], {who: values[k] for who, values in case["flattening"].items()}))
    return found


def errors(rows: Sequence[Row]) -> list[str]:
    """Mean absolute error of flattening against the experiment, of each reading of ours and of the paper's two."""
    found = seven(rows)
    truth = np.array([paper["experiment"] for _, _, paper in found])
    lines = [
        [f"the paper's {name}", *_error(np.array([paper[who] for _, _, paper in found]), truth)]
        for who, name in (("hybrid", "hybrid"), ("ale", "ALE"))
    ]
    lines += [
        [f"ours, {words}", *_error(np.array([number(row, column) for _, row, _ in found]), truth)]
        for column, words in READINGS
    ]
    lines[2] = [f"**{cell}**" for cell in lines[2]]
    head = ["", f"mean absolute error, {len(found)} particles", "mean error", "largest"]
    return [*markdown(head, lines), "", versions(rows)]


def _error(values: np.ndarray, truth: np.ndarray) -> list[str]:
    off = values - truth
    return [said(float(np.abs(off).mean()), 3), f"{off.mean():+.3f}", said(float(np.abs(off).max()), 2)]


def flattening(rows: Sequence[Row]) -> list[str]:
    """Flattening of each particle: ours in its readings, the paper's, the experiment's."""
    draft = {name: row for name, row, _ in seven(rows, "-draft")}
    lines = []
    for name, row, paper in seven(rows):
        coarse = [number(draft[name], column) if name in draft else np.nan for column, _ in READINGS]
        ours = [said(number(row, column)) for column, _ in READINGS]
        ours[0] = f"**{ours[0]}** ({said(coarse[0])})"
        ours[3] += f" ({said(coarse[3])})"
        lines.append([marked(name, row), *ours, *(f"{paper[who]:.2f}" for who in ("hybrid", "ale", "experiment"))])
    head = ["", "height: end (draft)", "own", "greatest", "whole: end (draft)", "own", "on the axis: end"]
    return markdown([*head, "hybrid", "ALE", "experiment"], lines)


def spread(rows: Sequence[Row]) -> list[str]:
    """Cases A and B over the measured spread of impact velocities."""
    lines = []
    for letter, key in (("A", "Ni_25um"), ("B", "Ti_30um")):
        runs = {
            float(row["speed_m_s"]): row for row in rows if row["run"][:2] == f"{letter}-" and row["run"][2:].isdigit()
        }
        runs |= {float(row["speed_m_s"]): row for row in rows if row["run"] == f"{letter}-draft"}
        for speed, row in sorted(runs.items()):
            measured, case = PAPER["experiment_spread"][key], PAPER["case"][letter]["flattening"]["experiment"][0]
            off = speed - measured["velocity"]
            what = "mean" if off == 0 else f"{off:+.0f} m/s" + (" (nominal)" if speed == 500 else "")
            values = (said(number(row, f"flattening_{w}"), 3) for w in ("end", "total_end"))
            shape = (said(number(row, c)) for c in ("crater_um", "diameter_um_end"))
            lines.append(
                [
                    f"{letter}: {key.replace('_', ' ').replace('um', ' µm')}",
                    f"{speed:.0f}",
                    what,
                    *values,
                    *shape,
                    f"{case:.2f}",
                ]
            )
    head = ["", "m/s", "of the measured", "flattening, height", "whole", "crater µm", "diameter µm", "experiment"]
    return markdown(head, lines)


def shape(rows: Sequence[Row]) -> list[str]:
    """Diameters, thicknesses and their ratio, and craters."""
    lines = []
    for name, row, _ in seven(rows):
        case, k = PAPER["case"][name[0]], int(row["impact"]) - 1
        ratios = case.get("diameter_over_thickness", {})
        width, high, whole, axis = (
            number(row, f"{c}_end") for c in ("diameter_um", "height_um", "thickness_um", "axial_um")
        )
        lines.append(
            [
                name,
                said(width, 1),
                said(high, 1),
                said(whole, 1),
                said(axis, 1),
                said(width / high),
                said(width / whole),
            ]
            + [said(width / axis)]
            + [f"{ratios[who][k]:.2f}" if who in ratios else "-" for who in ("hybrid", "ale", "experiment")]
            + [said(number(row, "crater_um")), said(number(row, "rebound_m_s"), 0)]
        )
    head = ["", "diameter µm", "height µm", "whole µm", "on the axis µm", "d / height", "d / whole", "d / axis"]
    return markdown([*head, "hybrid", "ALE", "experiment", "crater µm", "leaves at m/s"], lines)


def contact(rows: Sequence[Row]) -> list[str]:
    """Case A against the paper's table 3."""
    row, wave = seven(rows)[0][1], table_rows("validation_wave")
    paper = PAPER["contact"]

    def line(what: str, ours: str, key: str) -> list[str]:
        return [what, ours, *(f"{paper[who][key]:g}" for who in ("hybrid", "ale"))]

    lines = []
    if wave:
        pressure, force, time, area = (
            figures.column(wave, c) for c in ("pressure_MPa", "force_mN", "time_ns", "contact_um2")
        )
        peak, rest = int(force.argmax()), (time > 20) & (time < 30)
        text = f"{pressure[peak]:.0f} at the greatest force ({force[peak]:.0f} mN, {time[peak]:.1f} ns, {area[peak]:.0f} µm²); "
        lines.append(
            line(
                "mean contact pressure, MPa",
                text + f"{pressure[rest].mean():.0f} from 20 to 30 ns",
                "contact_pressure_MPa",
            )
        )
    peak_stress, end_stress = number(row, "von_mises_greatest_MPa"), number(row, "von_mises_MPa")
    stress = f"particle {peak_stress:.0f} at greatest deformation, {end_stress:.0f} at the end; "
    stress += f"target {number(row, 'target_von_mises_MPa'):.0f}"
    lines.append(line("largest von Mises stress, MPa", stress, "max_von_mises_MPa"))
    radius = f"{number(row, 'plastic_radius_um'):.0f} (0.2 % strain), {number(row, 'strained_radius_um'):.0f} (20 %)"
    lines.append(line("plastic radius, µm", radius, "plastic_radius_um"))
    depth = f"{number(row, 'crater_greatest_um'):.2f} greatest, {number(row, 'crater_um'):.2f} at the end"
    lines.append(line("largest penetration, crater, µm", depth, "max_penetration_um"))
    return markdown(["25 µm Ni, 500 m/s", "ours", "hybrid", "ALE"], lines)


def wave(rows: Sequence[Row]) -> list[str]:
    """The stress over time at the first point of contact."""
    given = table_rows("validation_wave")
    if not given:
        return ["Not computed."]
    paper, lines = PAPER["single_Ni_500"], []
    time = figures.column(given, "time_ns")
    for column, name in (("particle_MPa", "particle, at its lowest point"), ("target_MPa", "target, below it")):
        y = figures.column(given, column)
        late = time > 120
        frequency, amplitude = figures.ringing(time, y, 60.0, 150.0)
        lines.append([name, f"{y.max():.0f}", f"{y[late].mean():.0f}", f"{frequency:.0f}", f"{amplitude:.0f}"])
    y = figures.column(given, "particle_mean_MPa")
    frequency, amplitude = figures.ringing(time, y, 60.0, 150.0)
    lines.append(
        ["particle, mean", f"{y.max():.0f}", f"{y[time > 120].mean():.0f}", f"{frequency:.0f}", f"{amplitude:.0f}"]
    )
    known = [
        paper["von_mises_peak_near_interface_MPa"],
        paper["von_mises_residual_MPa"],
        *paper["stress_wave"].values(),
    ]
    lines.append(["the paper", *(f"{value:.0f}" for value in known)])
    return markdown(["von Mises stress, MPa", "peak", "120 to 150 ns, mean", "ringing MHz", "its amplitude"], lines)


def heat(rows: Sequence[Row]) -> list[str]:
    """Plastic strain and temperature of each particle after its own impact, and of the target that it hit."""
    cost, lines = PAPER["cost"], []
    for name, row, _ in seven(rows):
        strain = (said(number(row, f"eps_p_{which}")) for which in ("mean", "p99", "max"))
        T = (said(number(row, f"T_{which}"), 0) for which in ("mean", "p99", "max"))
        target = (said(number(row, "target_eps_p_max")), said(number(row, "target_T_max"), 0))
        k = {"A": 0, "D2": 1, "D3": 2}.get(name.split(":")[0])
        paper = (
            ["-"] * 4
            if k is None
            else [f"{cost[who][m][k]:g}" for m in ("eps_max", "T_max_K") for who in ("hybrid", "ale")]
        )
        lines.append([name, *strain, *T, *target, *paper])
    head = ["", "eps_p mean", "99 %", "max", "T mean K", "99 %", "max", "target: eps_p max", "T max K"]
    return markdown([*head, "hybrid: eps_p max", "ALE", "hybrid: T max K", "ALE"], lines)


def cost(rows: Sequence[Row]) -> list[str]:
    """Points and elements, time steps and wall time; the paper's hours."""
    given, lines = PAPER["cost"], []
    for letter, k in (("A", 0), ("B", None), ("C", None), ("D", 2)):
        mine = [row for row in rows if row["run"] == letter and not row["failed"]]
        if not mine:
            continue
        seconds, busy = number(mine[-1], "run_wall_s"), number(mine[-1], "run_cpu_s")
        line = [letter, " + ".join(row["points"] for row in mine), mine[-1]["elements"]]
        line += [", ".join(said(number(row, "dt_ps"), 1) for row in mine), f"{seconds:.0f}", f"{busy:.0f}"]
        if k is None:
            line += ["-"] * 5
        else:
            both = [(given[who]["hours"][k], given[who]["dt_ns"][k] * 1e3) for who in ("hybrid", "ale")]
            line += [f"{given['elements'][k]:,}".replace(",", " "), *(f"{dt:g}" for _, dt in both)]
            line += [f"{hours:g} h: {hours * 3600 / busy:.0f}" for hours, _ in both]
        lines.append(line)
    head = [
        "",
        "points",
        "elements",
        "time step ps",
        "wall s",
        "processor s",
        "paper: elements",
        "hybrid: ps",
        "ALE: ps",
    ]
    return markdown([*head, "hybrid: hours, times ours", "ALE: hours, times ours"], lines)


def trends(rows: Sequence[Row]) -> list[str]:
    """What the paper says of its trends, and what ours do."""
    runs = figures.trend_rows(table_rows("validation_trends"))
    return markdown(["run", *(name for _, name in figures.TREND_COLUMNS)], figures.trend_lines(runs))


def shapes(rows: Sequence[Row]) -> list[str]:
    """Six shapes, three impacts each: strain of the particles."""
    lines = []
    given = table_rows("validation_trends")
    for name, strain in PAPER["morphology"]["eps_max"].items():
        mine = [row for row in given if row["run"] == f"shape-{name}"]
        if not mine:
            continue
        if mine[0]["failed"]:
            lines.append([name.replace("_", " "), mine[0]["failed"], *["-"] * 5, f"{strain:g}"])
            continue
        values = [", ".join(said(number(row, c)) for row in mine) for c in ("eps_p_mean", "eps_p_p99", "eps_p_max")]
        T = ", ".join(said(number(row, "T_p99"), 0) for row in mine)
        crater = ", ".join(said(number(row, "crater_um"), 1) for row in mine)
        rebound = ", ".join(said(number(row, "rebound_m_s"), 0) for row in mine)
        lines.append([name.replace("_", " "), *values, T, crater, rebound, f"{strain:g}"])
    head = [
        "",
        "eps_p mean of impacts 1, 2, 3",
        "99 %",
        "max",
        "T 99 % K",
        "crater µm",
        "leaves at m/s",
        "paper: eps_p max",
    ]
    return markdown(head, lines)


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
