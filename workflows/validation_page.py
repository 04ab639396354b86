"""Table, sentences and figure of the validation page, from docs/tables/validation*.csv and paper_values.toml."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pages import EVIDENCE, column, markdown, number, table_rows, write_parts

from coupler.report.picture import blank, save
from coupler.studies.table import Row

METHODS = ("hybrid", "ale", "experiment")  # of the paper
PAPER = tomllib.loads((Path(__file__).parent / "paper_values.toml").read_text())
TABLES_USED = ("validation", "validation_trends", "validation_scatter")


@dataclass(frozen=True)
class Splat:
    """A particle of cases A to D: its name, our row, and the paper's numbers of it by METHODS, nan where there is none."""

    name: str
    row: Row
    flattening: dict[str, float]
    ratio: dict[str, float]


def ratio_of(row: Row) -> float:
    """Largest diameter over whole thickness of a splat at the end of the run."""
    return number(row, "widest_um_end") / number(row, "thickness_um_end")


def log_error(ratios: ArrayLike, truth: ArrayLike) -> float:
    """Mean |ln(ratio / experiment)| over the particles that have both."""
    return float(np.nanmean(np.abs(np.log(np.asarray(ratios) / np.asarray(truth)))))


def digits(value: float, count: int = 2) -> str:
    """A number for a table, a dash for none."""
    return f"{value:.{count}f}" if np.isfinite(value) else "-"


def seven(rows: Sequence[Row]) -> list[Splat]:
    """The seven particles of cases A to D, so far as they are computed."""
    splats = []
    for letter, case in PAPER["case"].items():
        for k, particle in enumerate(case["impacts"]):
            own = [row for row in rows if row["run"] == letter and row["impact"] == str(k + 1)]
            if own and not own[0]["failed"]:
                place = k + 1 if len(case["impacts"]) > 1 else ""
                name = f"{letter}{place}: {particle['material']}, {particle['diameter_um']:.0f} µm"
                tables = case["flattening"], case["diameter_over_thickness"]
                values = [{who: table[who][k] if who in table else np.nan for who in METHODS} for table in tables]
                splats.append(Splat(name, own[0], *values))
    return splats


def runs_of(rows: Sequence[Row], by: str, **constant: float) -> list[Row]:
    """Finished single impacts of the trends with these values, in order of the column `by`."""
    plain = [row for row in rows if not row["run"].startswith("shape-") and not row["failed"]]
    used = [r for r in plain if all(abs(number(r, name) - value) < 1e-6 for name, value in constant.items())]
    return sorted(used, key=lambda row: number(row, by))


def errors(splats: Sequence[Splat]) -> dict[str, list[str]]:
    """The rows of mean errors against the experiment, of all seven and in brackets without D3: ours, hybrid, ALE."""
    truth = np.array([s.flattening["experiment"] for s in splats])
    ratio = np.array([s.ratio["experiment"] for s in splats])
    last = np.array([s.name.startswith("D3") for s in splats])
    flat, ratios = [column([s.row for s in splats], "flattening_end")], [np.array([ratio_of(s.row) for s in splats])]
    flat += [np.array([s.flattening[w] for s in splats]) for w in METHODS[:2]]
    ratios += [np.array([s.ratio[w] for s in splats]) for w in METHODS[:2]]
    off = [np.abs(f - truth) for f in flat]
    logs = [(log_error(r, ratio), log_error(r[~last], ratio[~last])) for r in ratios]
    return {
        "mean error of flattening (without D3)": [f"{o.mean():.3f} ({o[~last].mean():.3f})" for o in off],
        "mean error of ln(diameter / thickness) (without D3)": [f"{a:.2f} ({b:.2f})" for a, b in logs],
    }


def reasons(rows: Sequence[Row], splats: Sequence[Splat]) -> dict[str, str]:
    """Why a row of the table differs, by the start of its name."""
    spread = [number(row, "flattening_end") for row in rows if row["run"].startswith("A-")]
    over = [column(scattered(k), "flattening_end") for k in "123"]
    low, high = ([f"{f(values):.2f}" for values in over] for f in (np.nanmin, np.nanmax))
    of = {splat.name[:2]: splat.row for splat in splats}
    first, before = of["A:"], number(of["C1"], "flattening_own")
    width, yielded = number(first, "diameter_um_end"), number(first, "plastic_radius_um")
    return {
        "A": f"{min(spread):.2f} to {max(spread):.2f} over the measured velocities, 483 ± 70 m/s",
        "B": "this titanium (table 1 of the paper) is too hard in all three computations",
        "C1": f"{before:.2f} before the second impact, which flattens it further",
        "C2": "the titanium of case B",
        "D1": f"{low[0]} to {high[0]} over misalignment and velocity",
        "D2": f"{low[1]} to {high[1]} over misalignment and velocity",
        "D3": f"lands in the hollow of D2, so that its height is no measure; {low[2]} to {high[2]} over the same",
        "contact pressure": "two to three times the yield stress, as in indentation; the paper's time and area are not stated",
        "von Mises": "at 1e7 1/s the law of the paper's steel exceeds the paper's maximum at a strain of 0.1",
        "plastic radius": f"of 20 % strain; that of 0.2 % is {yielded:.0f}; the paper's threshold is not stated",
        "crater": "not explained; more than the error of the resolution",
        "strain": f"the shape alone needs a mean of 2 ln({width:.0f} / 25) = {2 * np.log(width / 25):.2f}",
        "temperature": f"in the rim; plastic work gives a mean of {number(first, 'T_mean'):.0f} K",
    }


def table(rows: Sequence[Row]) -> list[str]:
    """The table of the page: cases A to D, mean errors, and case A against the paper's tables 3 and 4."""
    splats = seven(rows)
    why = reasons(rows, splats)
    lines = [
        [s.name, *(f"{number(s.row, 'flattening_end') if w == 'ours' else s.flattening[w]:.2f}" for w in ("ours", *METHODS)),
         why[s.name.partition(":")[0]]]
        for s in splats
    ]  # fmt: skip
    lines += [[name, *values, "", ""] for name, values in errors(splats).items()]
    first, cost = splats[0].row, PAPER["cost"]
    for name, ours, theirs, key in (
        ("A: contact pressure, MPa", number(first, "contact_pressure_MPa"), "contact_pressure_MPa", "contact pressure"),
        ("A: largest von Mises stress, MPa", number(first, "target_von_mises_MPa"), "max_von_mises_MPa", "von Mises"),
        ("A: plastic radius, µm", number(first, "strained_radius_um"), "plastic_radius_um", "plastic radius"),
        ("A: crater, µm", number(first, "crater_um"), "max_penetration_um", "crater"),
    ):
        count = 1 if key == "crater" else 0
        values = (digits(PAPER["contact"][who][theirs], count) for who in METHODS[:2])
        lines.append([name, digits(ours, count), *values, "-", why[key]])
    for name, ours, theirs, key, count in (
        ("A: largest plastic strain", number(first, "eps_p_max"), "eps_max", "strain", 2),
        ("A: highest temperature, K", number(first, "T_max"), "T_max_K", "temperature", 0),
    ):
        values = (digits(cost[who][theirs][0], count) for who in METHODS[:2])
        lines.append([name, digits(ours, count), *values, "-", why[key]])
    used = [row for name in TABLES_USED for row in table_rows(name)]
    return markdown("| here | hybrid | ALE | experiment | why it differs", lines, used)


def trends(rows: Sequence[Row]) -> list[str]:
    """What the paper says of its trends and of the shapes, and what the runs show."""
    by_size = runs_of(rows, "diameter_um", speed_m_s=500, temperature_K=300)
    by_speed = runs_of(rows, "speed_m_s", diameter_um=25, temperature_K=300)
    by_heat = runs_of(rows, "temperature_K", diameter_um=25, speed_m_s=500)
    flattening, strains, heat = (
        [number(by_size[k], name) for k in (0, -1)] for name in ("flattening_end", "eps_p_mean", "T_p99")
    )
    flat = column(by_speed, "flattening_end")
    peak = int(flat.argmax())
    faster = next(number(row, "eps_p_mean") for row in by_speed if number(row, "speed_m_s") == 1000)
    cold, hot = number(by_heat[0], "eps_p_mean"), number(by_heat[-1], "eps_p_mean")
    strain = {
        name: column([row for row in rows if row["run"] == f"shape-{name}"], "eps_p_mean").mean()
        for name in PAPER["morphology"]["eps_max"]
    }
    order = ", ".join(f"{n.replace('_', ' ')} {strain[n]:.2f}" for n in sorted(strain, key=lambda n: -strain[n]))
    size = f"{number(by_size[0], 'diameter_um'):.0f} to {number(by_size[-1], 'diameter_um'):.0f} µm"
    best, last = (f"{flat[k]:.2f} at {number(by_speed[k], 'speed_m_s'):.0f} m/s" for k in (peak, -1))
    return [
        f"- **Diameter** ({size}): flattening {flattening[0]:.3f} to {flattening[1]:.3f}, mean strain {strains[0]:.2f} to"
        f" {strains[1]:.2f}, temperature of 99 % {heat[0]:.0f} to {heat[1]:.0f} K. The paper's flattening rises and falls;"
        " its law has no length that could do so.",
        f"- **Velocity**: flattening rises to {best} and is {last}; strain and temperature rise. The paper's flattening falls at high"
        " velocity.",
        f"- **Initial temperature**: 600 K raises the mean strain from {cold:.2f} to {hot:.2f}, 1000 m/s raises it to {faster:.2f}."
        " The paper says that 600 K does more. With its constants the strength of nickel falls by 11 % at 600 K;"
        " the energy at 1000 m/s is four times as large.",
        f"- **Shape** (mean strain over three impacts): {order}. The paper has the same order, but oblate before angular.",
    ]


def cost(rows: Sequence[Row]) -> list[str]:
    """Processor time of cases A and D beside the paper's hours."""
    texts = []
    for letter, k in (("A", 0), ("D", 2)):
        own = next(row for row in rows if row["run"] == letter)
        hours = [PAPER["cost"][who]["hours"][k] for who in METHODS[:2]]
        texts.append(
            f"case {letter} {number(own, 'run_cpu_s'):.0f} s of processor time (hybrid {hours[0]:g} h, ALE {hours[1]:g} h)"
        )
    fewer = PAPER["cost"]["elements"][0] / sum(number(rows[0], name) for name in ("points", "elements"))
    return [f"Cost: {'; '.join(texts)}. The paper uses {fewer:.0f} times as many points and elements."]


def scattered(impact: str) -> list[Row]:
    """The rows of one impact of case D over velocities and misalignments."""
    rows = [row for row in table_rows("validation_scatter") if row["impact"] == impact and not row["failed"]]
    return [row for row in rows if number(row, "thickness_um_end") > 0.0]


def scatter(splats: Sequence[Splat]) -> list[str]:
    """How many runs of the scatter of case D reach the measured splats."""
    texts = []
    for splat in (s for s in splats if s.name.startswith("D")):
        ratios, measured = np.array([ratio_of(row) for row in scattered(splat.name[1])]), splat.ratio["experiment"]
        reached = np.sum(ratios <= measured) if measured < ratios.mean() else np.sum(ratios >= measured)
        span = f"{ratios.min():.1f} to {ratios.max():.1f}"
        texts.append(f"{splat.name[:2]} {span} (experiment {measured:.2f}, reached by {reached} runs)")
    return [f"Diameter over thickness: {'; '.join(texts)}."]


def draw(splats: Sequence[Splat], path: Path) -> None:
    """Largest diameter over thickness of the seven particles: ours, the paper's two methods, the experiment's; scatter of case D."""
    figure = blank(9.0, 3.8, 130, "constrained")
    axis, x = figure.subplots(), np.arange(len(splats))
    values: Mapping[str, NDArray] = {w: np.array([s.ratio[w] for s in splats]) for w in METHODS}
    style = {"lw": 0}
    axis.plot(x, values["hybrid"], "s", color="#8a8a8a", label="paper, hybrid", **style)
    axis.plot(x, values["ale"], "D", color="#8a8a8a", mfc="none", label="paper, ALE", **style)
    axis.plot(x, values["experiment"], "_", color="#c7540a", ms=26, mew=3, label="experiment", **style)
    axis.plot(x, [ratio_of(s.row) for s in splats], "o", color="#1f5fa8", ms=8, label="here", **style)
    for place, splat in enumerate(splats):
        if splat.name.startswith("D"):
            ratios = [ratio_of(row) for row in scattered(splat.name[1])]
            label = "here, over the scatter" if splat.name[1] == "1" else ""
            axis.plot(np.full(len(ratios), place + 0.22), ratios, ".", color="#1a1a1a", ms=4, alpha=0.6, label=label)
    axis.set_yscale("log")
    axis.set_yticks((1, 1.5, 2, 3, 5, 8), ("1", "1.5", "2", "3", "5", "8"))
    axis.minorticks_off()
    axis.grid(alpha=0.25)
    axis.set_xticks(x, [s.name.replace(": ", "\n") for s in splats])
    axis.set_ylabel("largest diameter / thickness")
    axis.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    save(figure, path)


def write_page() -> None:
    """Write the parts of the page and draw its figure."""
    rows = table_rows("validation")
    splats = seven(rows)
    if len(splats) < 7:
        raise SystemExit("docs/tables/validation.csv lacks some of the cases A to D: make validate")
    parts = {
        "table": table(rows),
        "scatter": scatter(splats),
        "trends": trends(table_rows("validation_trends")),
        "cost": cost(rows),
    }
    write_parts("validation", parts)
    draw(splats, EVIDENCE / "validation_ratios.png")
