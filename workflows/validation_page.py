"""The tables of the validation page, from docs/tables/validation*.csv and paper_values.toml."""

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import validation_figures as figures
from numpy.typing import ArrayLike, NDArray
from pages import PAGES, column, markdown, number, table_rows, write_parts

from coupler.studies.table import Row

METHODS = ("hybrid", "ale", "experiment")  # of the paper
PAPER = tomllib.loads((Path(__file__).parent / "paper_values.toml").read_text())
PURE_TI = "-CP_Ti"  # ending of runs with the titanium of the library
#: The readings of a splat's thickness, and of the instant, that a flattening ratio can be of: column, words.
READINGS = (
    ("flattening_end", "height above the surface, end of the run"),
    ("flattening_own", "height above the surface, after its own impact"),
    ("flattening_total_end", "whole thickness, end of the run"),
    ("flattening_total_own", "whole thickness, after its own impact"),
    ("axial_end", "thickness on the axis, end of the run"),
)


@dataclass(frozen=True)
class Splat:
    """A particle of cases A to D: its name, our row, and the paper's numbers of it by METHODS, nan where there is none."""

    name: str
    row: Row
    flattening: dict[str, float]
    ratio: dict[str, float]

    @property
    def our_ratio(self) -> float:
        """Largest diameter over whole thickness at the end of the run."""
        return widest(self.row) / number(self.row, "thickness_um_end")

    @property
    def version(self) -> str:
        """The version that computed the row, and its engine."""
        return made_by(self.row)


def made_by(row: Row) -> str:
    """The version that computed a row, and its engine."""
    return ", ".join(word for word in (row.get("version", "unknown"), row.get("engine", "")) if word)


def widest(row: Row) -> float:
    """Largest diameter at the end of the run, um; in rows that have only the circle of the same area, its diameter."""
    return number(row, "widest_um_end") if row.get("widest_um_end") else number(row, "diameter_um_end")


def bound(ratio: ArrayLike) -> NDArray:
    """Flattening 1 - h / D of the sphere, diameter D, that holds as much as a full cylinder with this diameter over thickness h."""
    return 1.0 - (1.5 * np.square(ratio)) ** (-1.0 / 3.0)


def log_error(ratios: ArrayLike, truth: ArrayLike) -> float:
    """Mean |ln(ratio / experiment)| over the particles that have both."""
    off = np.abs(np.log(np.asarray(ratios) / np.asarray(truth)))
    return float(np.nanmean(off))


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


def seven(rows: Sequence[Row], suffix: str = "", pure: bool = False) -> list[Splat]:
    """The seven particles of cases A to D, so far as they are computed. suffix: of the runs. pure: with the library's titanium."""
    rows, splats = with_axial(rows), []
    for letter, case in PAPER["case"].items():
        metals = [particle["material"] for particle in case["impacts"]]
        run = letter + (PURE_TI if pure and "Ti" in metals else "") + suffix
        for k, particle in enumerate(case["impacts"]):
            own = [row for row in rows if row["run"] == run and row["impact"] == str(k + 1)]
            if own and not own[0]["failed"]:
                place = k + 1 if len(metals) > 1 else ""
                name = f"{letter}{place}: {particle['diameter_um']:.0f} µm {own[0]['material']}"
                ratios = case["diameter_over_thickness"]
                values = [
                    {who: table[who][k] if who in table else np.nan for who in METHODS}
                    for table in (case["flattening"], ratios)
                ]
                splats.append(Splat(name, own[0], *values))
    return splats


def both_titaniums(rows: Sequence[Row]) -> list[Splat]:
    """The seven particles, and those with the library's titanium beside."""
    return sorted(
        {s.name + s.row["run"]: s for s in seven(rows) + seven(rows, pure=True)}.values(), key=lambda s: s.name[:2]
    )


def of(splats: Sequence[Splat], who: str) -> NDArray:
    """Diameter over thickness of some particles, by one of METHODS or "ours"."""
    return np.array([s.our_ratio if who == "ours" else s.ratio[who] for s in splats])


def score(rows: Sequence[Row]) -> list[str]:
    """Mean |ln(ratio / experiment)| of the paper's methods and of ours."""
    splats, lines = seven(rows), []
    kinds = {
        "the paper's hybrid": (splats, "hybrid"), "the paper's ALE, where it is given": (splats, "ale"),
        "**ours, the paper's titanium**": (splats, "ours"), "**ours, CP_Ti**": (seven(rows, pure=True), "ours"),
        "ours, draft": (seven(rows, "-draft"), "ours"),
    }  # fmt: skip
    for name, (some, who) in kinds.items():
        values, truth = of(some, who), of(some, "experiment")
        last = np.array([s.name.startswith("D3") for s in some], bool)
        given = int(np.isfinite(values).sum())
        if given and len(some) == len(splats):
            apart = log_error(values[~last], truth[~last]) if (~last).any() else np.nan
            versions_of = sorted({s.version for s in some}) if who == "ours" else ["-"]
            lines.append([name, given, digits(log_error(values, truth)), digits(apart), ", ".join(versions_of)])
    return markdown("| particles | mean abs ln(ratio / experiment) | without D3 | version", lines)


def ratios(rows: Sequence[Row]) -> list[str]:
    """Largest diameter over largest thickness of each splat."""
    lines = []
    for s in both_titaniums(rows):
        mark = "" if s.row.get("widest_um_end") else " (area)"
        shape = [digits(widest(s.row), 1) + mark, *cells(s.row, ["thickness_um_end"], 1)]
        others = [digits(s.ratio[who]) for who in METHODS]
        ends = [*cells(s.row, ["crater_um"]), *cells(s.row, ["rebound_m_s"], 0), s.version]
        lines.append(
            [
                s.name,
                *shape,
                f"**{s.our_ratio:.2f}**",
                *others,
                f"{np.log(s.our_ratio / s.ratio['experiment']):+.2f}",
                *ends,
            ]
        )
    head = "| diameter µm | thickness µm | ratio | hybrid | ALE | experiment | ln(ours / experiment)"
    return markdown(f"{head} | crater µm | leaves at m/s | version", lines)


def bounds(rows: Sequence[Row]) -> list[str]:
    """Upper bounds of the flattening, with the diameter of a full cylinder of each splat's own size."""
    lines = []
    for s in both_titaniums(rows):
        values = [s.our_ratio, *(s.ratio[who] for who in METHODS)]
        lines.append([s.name, *(digits(float(bound(value))) for value in values), s.version])
    return markdown("| ours | hybrid | ALE | experiment | version", lines)


def errors(rows: Sequence[Row]) -> list[str]:
    """Mean absolute error of 1 - h / D0 against the experiment, of each reading of ours and of the paper's two."""
    splats = seven(rows)
    truth = np.array([s.flattening["experiment"] for s in splats])
    ours = [s.row for s in splats]
    values = {f"the paper's {name}": np.array([s.flattening[who] for s in splats])
              for who, name in (("hybrid", "hybrid"), ("ale", "ALE"))}  # fmt: skip
    values |= {f"ours, {words}": column(ours, name) for name, words in READINGS}
    lines = []
    for name, value in values.items():
        off = value - truth
        version = "-" if "paper" in name else ", ".join(sorted({s.version for s in splats}))
        lines.append([name, digits(np.abs(off).mean(), 3), f"{off.mean():+.3f}", digits(np.abs(off).max(), 2), version])
    return markdown(f"| mean absolute error, {len(splats)} particles | mean error | largest | version", lines)


def flattening(rows: Sequence[Row]) -> list[str]:
    """1 - h / D0 of each particle: ours in its readings, the paper's, the experiment's."""
    draft = {s.name: s.row for s in seven(rows, "-draft") + seven(rows, "-draft", pure=True)}
    names = [name for name, _ in READINGS]
    lines = []
    for s in both_titaniums(rows):
        ours, coarse = cells(s.row, names), cells(draft.get(s.name, {}), names)
        for k in (0, 2):
            ours[k] += f" ({coarse[k]})"
        lines.append([s.name, *ours, *(f"{s.flattening[who]:.2f}" for who in METHODS), s.version])
    head = "| height: end (draft) | own | whole: end (draft) | own | on the axis: end"
    return markdown(f"{head} | hybrid | ALE | experiment | version", lines)


def scatter(rows: Sequence[Row]) -> list[str]:
    """Case D over velocities and misalignments: quantiles of diameter over thickness of each splat."""
    runs = [row for row in table_rows("validation_scatter") if not row["failed"]]
    sampled = [row for row in runs if row["run"] != "D-scatter-0"]
    lines = []
    for s in (s for s in seven(rows) if s.name.startswith("D")):
        k = s.name[1]
        own = [row for row in sampled if row["impact"] == k and number(row, "thickness_um_end") > 0]
        if not own:
            continue
        values = column(own, "widest_um_end") / column(own, "thickness_um_end")
        centred = [row for row in runs if row["run"] == "D-scatter-0" and row["impact"] == k]
        slow = number(centred[0], "widest_um_end") / number(centred[0], "thickness_um_end") if centred else np.nan
        low, middle, high = np.nanquantile(values, (0.1, 0.5, 0.9))
        below = float(np.mean(values <= s.ratio["experiment"]))
        lines.append([s.name, len(own), digits(slow), f"{low:.2f}", f"**{middle:.2f}**", f"{high:.2f}", f"{values.min():.2f}",
                      digits(s.ratio["experiment"]), f"{below:.0%}", ", ".join(sorted({row["version"] for row in own}))])  # fmt: skip
    head = "| runs | on the axis at 483 m/s | 10 % | median | 90 % | least | experiment | runs at or below it | version"
    return markdown(head, lines) if lines else ["Not computed."]


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
            shape = [*cells(row, ("flattening_end", "flattening_total_end"), 3), *cells(row, ["crater_um"])]
            shape.append(digits(widest(row)))
            ratio = digits(widest(row) / number(row, "thickness_um_end"))
            name = f"{letter}: {key.replace('_', ' ').replace('um', ' µm')}"
            truth = [f"{PAPER['case'][letter]['diameter_over_thickness']['experiment'][0]:.2f}", f"{case:.2f}"]
            lines.append([name, f"{speed:.0f}", place, ratio, *shape, *truth, made_by(row)])
    head = "| m/s | of the measured | diameter / thickness | 1 - h / D0, height | whole | crater µm | diameter µm"
    return markdown(f"{head} | experiment: ratio | 1 - h / D0 | version", lines)


def contact(rows: Sequence[Row]) -> list[str]:
    """Case A against the paper's table 3."""
    row, wave_rows = seven(rows)[0].row, table_rows("validation_wave")
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
        [label, text, *(f"{PAPER['contact'][who][key]:g}" for who in METHODS[:2]), made_by(row)]
        for label, (key, text) in ours.items()
    ]
    return markdown("25 µm Ni, 500 m/s | ours | hybrid | ALE | version", lines)


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
        lines.append([label, *(f"{value:.0f}" for value in values), wave_rows[0]["version"]])
    known = [
        paper["von_mises_peak_near_interface_MPa"],
        paper["von_mises_residual_MPa"],
        *paper["stress_wave"].values(),
    ]
    lines.append(["the paper", *(f"{value:.0f}" for value in known), "-"])
    return markdown("von Mises stress, MPa | peak | 120 to 150 ns, mean | ringing MHz | its amplitude | version", lines)


def heat(rows: Sequence[Row]) -> list[str]:
    """Plastic strain and temperature of each particle after its own impact, and of the target that it hit."""
    cost, lines = PAPER["cost"], []
    for splat in both_titaniums(rows):
        name, row = splat.name, splat.row
        ours = cells(row, ("eps_p_mean", "eps_p_p99", "eps_p_max")) + cells(row, ("T_mean", "T_p99", "T_max"), 0)
        k = {"A": 0, "D2": 1, "D3": 2}.get(name.split(":")[0])
        paper = ["-" if k is None else f"{cost[who][m][k]:g}" for m in ("eps_max", "T_max_K") for who in METHODS[:2]]
        lines.append(
            [name, *ours, *cells(row, ["target_eps_p_max"]), *cells(row, ["target_T_max"], 0), *paper, splat.version]
        )
    head = "| eps_p mean | 99 % | max | T mean K | 99 % | max | target: eps_p max | T max K"
    return markdown(f"{head} | hybrid: eps_p max | ALE | hybrid: T max K | ALE | version", lines)


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
        lines.append([*line, made_by(own[-1])])
    head = "| points | elements | time step ps | wall s | processor s | paper: elements | hybrid: ps | ALE: ps"
    return markdown(f"{head} | hybrid: hours, times ours | ALE: hours, times ours | version", lines)


def trends(rows: Sequence[Row]) -> list[str]:
    """What the paper says of its trends, and what ours do."""
    runs = figures.trend_rows(table_rows("validation_trends"))
    return markdown(["run", *(name for _, name in figures.TREND_COLUMNS), "version"], figures.trend_lines(runs))


def shapes(rows: Sequence[Row]) -> list[str]:
    """Six shapes, three impacts each: strain of the particles."""
    lines, runs = [], table_rows("validation_trends")
    columns = {"eps_p_mean": 2, "eps_p_p99": 2, "eps_p_max": 2, "T_p99": 0, "crater_um": 1, "rebound_m_s": 0}
    for name, strain in PAPER["morphology"]["eps_max"].items():
        own = [row for row in runs if row["run"] == f"shape-{name}"]
        if own and own[0]["failed"]:
            lines.append([name.replace("_", " "), own[0]["failed"], *["-"] * 5, f"{strain:g}", made_by(own[0])])
        elif own:
            values = [", ".join(digits(number(row, c), n) for row in own) for c, n in columns.items()]
            lines.append([name.replace("_", " "), *values, f"{strain:g}", made_by(own[0])])
    head = "| eps_p mean of impacts 1, 2, 3 | 99 % | max | T 99 % K | crater µm | leaves at m/s | paper: eps_p max"
    return markdown(f"{head} | version", lines)


PARTS: dict[str, Callable[[Sequence[Row]], list[str]]] = {
    "score": score, "ratios": ratios, "bounds": bounds, "errors": errors, "flattening": flattening, "scatter": scatter,
    "spread": spread, "contact": contact, "wave": wave, "heat": heat, "cost": cost, "trends": trends, "shapes": shapes,
}  # fmt: skip


def write_page() -> None:
    """Write the tables into the page and draw its figures."""
    rows = table_rows("validation")
    if not seven(rows):
        raise SystemExit("docs/tables/validation.csv has none of the cases A to D yet: make validate")
    write_parts(PAGES["validation"], {name: part(rows) for name, part in PARTS.items()})
    figures.draw_all(
        [s.name for s in seven(rows)],
        {"ours": of(seven(rows), "ours"), "pure": of(seven(rows, pure=True), "ours")}
        | {who: of(seven(rows), who) for who in METHODS},
        table_rows("validation_scatter"),
    )
