"""The summary as text with labels and display units. Terminal, report and comparison all use these texts."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from numpy.typing import NDArray
from rich.table import Table
from rich.text import Text

from ..files.result import Result
from ..files.summary import Summary, impact_values, run_values
from ..measures import (
    CONVERGING,
    DISSIPATION_LIMIT,
    GROUPS,
    STICKS,
    UNDECIDED,
    VERBS,
    VERDICT_BY,
    Measure,
    axis_label,
    measure,
)

NAMED = 3  # most numbers that a title lists
MOST_VERDICTS = 6  # most particles with a line each for their verdicts
KEYS = (
    *CONVERGING, "numerical_dissipation", "energy_drift", "deposition_efficiency", "deposition_efficiency_range", "wall_s",
)  # fmt: skip
OF_EACH = (
    "verdict", "flattening_ratio", "crater_depth_m", "splat_diameter_m", "eps_p_mean", "T_mean_K", "rebound_velocity_m_s",
)  # fmt: skip
_ABOVE = (  # not in the tables
    "effects", "warnings", "undecided", "verdict_criterion", "verdict_by", "verdict_by_bonds", "verdict_rests_on",
)  # fmt: skip
_BLOCKS = {"greatest": "at the greatest deformation", "end": "at the end", "at_end": "at the end of the run"}
Block = Mapping[str, object]  # measures of one impact or run at one time


@dataclass(frozen=True)
class Line:
    """A line of a table of measures. cells: text for each column (each `Block`), "" for a column without a value."""

    key: str
    label: str
    cells: list[str]
    unit: str


def table_lines(blocks: Sequence[Block], errors: Mapping[str, float] | None = None) -> dict[str, list[Line]]:
    """The measures of several blocks in one table: the lines of each group. errors: of the measures in the last block (`errors_of`)."""
    groups: dict[str, list[Line]] = {group: [] for group in GROUPS}
    for key in dict.fromkeys(key for block in blocks for key in block):
        record, last = measure(key), (errors or {}).get(key)
        widths = [*[None] * (len(blocks) - 1), last]
        cells = [shown(key, block[key], w) if key in block else "" for block, w in zip(blocks, widths, strict=True)]
        groups[record.group].append(Line(key, record.label, cells, record.unit))
    return {group: lines for group, lines in groups.items() if lines}


def columns(summary: Summary) -> dict[str, Block]:
    """Columns of a table by heading: the last impact at its greatest deformation; its end together with all other values of the run."""
    if not summary:
        return {}
    greatest, end = summary["impacts"][-1].get("greatest"), plain(run_values(summary))
    return {"greatest deformation": dict(greatest), "end": end} if greatest else {"": end}


def plain(values: Block) -> Block:
    """The values that a table of measures shows. Left out are texts of the verdict, tables, lists of tables, and the rebound velocity
    of a particle that sticks."""
    hidden = {*_ABOVE, *(("rebound_velocity_m_s",) if values.get("rebounded") is False else ())}
    first = {k: next(iter(value), {}) if isinstance(value, list) else value for k, value in values.items()}
    return {k: values[k] for k, item in first.items() if k not in hidden and not isinstance(item, Mapping | list)}


def shown(key: str, value: object, error: float | None = None) -> str:
    """A value of the summary in its display unit, with its error (SI) if given: "0.566 ± 0.012"."""
    factor = measure(key).factor
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and factor == 1.0:
        return f"{value:,}".replace(",", " ")
    if isinstance(value, float | int):
        return f"{value * factor:.4g}" if error is None else with_error(value * factor, error * factor)
    return ", ".join(shown(key, item) for item in value) if isinstance(value, list) else str(value)


def with_error(value: float, error: float) -> str:
    """Value and error as text, rounded to two significant digits of the error."""
    # rounding errors do not count
    if not (error > 1e-9 * abs(value) and math.isfinite(error) and math.isfinite(value)):
        return f"{value:.4g}"
    digits = min(max(1 - math.floor(math.log10(error)), 0), 12)
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def errors_of(summary: Summary, i: int = -1) -> dict[str, float]:
    """The error of each measure at the end of impact i, SI."""
    entries = (summary["impacts"][i].get("errors") if summary else None) or {}
    return {key: float(entry["half_width"]) for key, entry in entries.items()}


def error_note(summary: Summary) -> str:
    """Text: how the errors of a run are measured, and which coarser runs failed; "" if the run has no errors."""
    record = (summary["run"].get("error") if summary else None) or {}
    failed = [str(text) for text in record.get("failed", [])]
    points = [str(n) for n in record.get("points", [])]
    if not points:
        return ""
    text = f"± error of the resolution, by the same scene with {' and '.join(points)} points (docs: accuracy)"
    return f"{text}; not computed: {'; '.join(failed)}" if failed else text


def impacts(summary: Summary) -> list[Block]:
    """The values of each impact: its measures at the end, and all other values (`plain`)."""
    return [plain(impact_values(summary, i)) for i in range(len(summary.get("impacts", [])))]


def verdict(summary: Summary) -> list[str]:
    """Text lines with the verdict of a run; no lines if there is no verdict. One particle: the verdict and the values that decide it.
    Several particles: how many stick, how many come off later, and a line for each particle. More than MOST_VERDICTS particles: how
    many verdicts each method decides, and the smallest margin."""
    records = summary.get("impacts", [])
    counts = {word: sum(r.get("verdict") == word for r in records) for word in VERBS}
    if sum(counts.values()) == 0:
        return []
    criterion = records[0].get("verdict_criterion")  # of the scene, the same for all
    adhesion = f" (adhesion: {criterion})" if criterion else ""
    if len(records) == 1:
        return [_with_reason(records[0]) + adhesion]
    words = ", ".join(f"{n} {VERBS[word][n > 1]}" for word, n in counts.items() if n)
    head = "; ".join([f"of {len(records)} particles {words}", *_come_off(records)]) + adhesion
    if len(records) > MOST_VERDICTS:
        return [head, *_decided_by(records), *_closest(records)]
    return [head, *(f"particle {k} {_with_reason(record, of_several=True)}" for k, record in enumerate(records, 1))]


_WHOLE = 0.999  # share of its mass from which a splat counts as lost completely


def _with_reason(record: Block, of_several: bool = False) -> str:
    """Text: verdict of a particle with reason, margin and bonded area, as in "sticks: REASON; margin +12.3 m/s"."""
    word = str(record.get("verdict"))
    text = VERBS.get(word, (word,))[0] if of_several else word
    if lost := _lost_share(record):
        text += " at its impact and " + ("has come off later" if lost >= _WHOLE else "parts of it have come off later")
    if record.get("verdict_rests_on"):
        text += f": {record['verdict_rests_on']}"
    if word != UNDECIDED and isinstance(margin := record.get("margin_m_s"), int | float):
        text += f"; margin {margin:+.3g} m/s"
    return text + _bonded(record)


def _bonded(record: Block) -> str:
    """Text: area that bonded in an impact, and bonded area at its end: "; bonded area 120 µm², 98 µm² at the end"; "" without bonds."""
    first, last = record.get("bonded_area_m2"), record.get("bonded_area_end_m2")
    if first is None:
        return ""
    area = f"; bonded area {shown('bonded_area_m2', first)} µm²"
    return area if first == 0.0 or last is None else f"{area}, {shown('bonded_area_end_m2', last)} µm² at the end"


def _lost_share(record: Block) -> float:
    """Fraction of a particle's mass that comes off after its impact."""
    lost, whole = record.get("detached_mass_kg"), record.get("particle_mass_kg")
    if not isinstance(lost, int | float):
        return 0.0
    return lost / whole if isinstance(whole, int | float) and whole > 0.0 else 1.0


def _come_off(records: Sequence[Block]) -> list[str]:
    """Texts: which particles come off completely or partly after their impact."""
    shares = {number: share for number, record in enumerate(records, 1) if (share := _lost_share(record))}
    whole = [number for number, share in shares.items() if share >= _WHOLE]
    stuck = [number for number in whole if records[number - 1].get("verdict") == STICKS]
    others = [number for number in whole if number not in stuck]
    parts = [number for number, share in shares.items() if share < _WHOLE]
    verbs = "sticks at its impact and has" if len(stuck) == 1 else "stick at their impact and have"
    texts = [f"{_numbers(stuck)} {verbs} come off later"] if stuck else []
    texts += [f"{_numbers(others)} {'has' if len(others) == 1 else 'have'} come off after the impact"] if others else []
    return texts + ([f"parts of {_numbers(parts)} have come off later"] if parts else [])


def _decided_by(records: Sequence[Block]) -> list[str]:
    """Text line: how many verdicts each method decides; empty if the records do not name the method."""
    each = [str(by) for record in records if (by := record.get("verdict_by"))]
    order = [by for by in dict.fromkeys([*VERDICT_BY, *each]) if by in each]
    texts = [f"{each.count(by)} by {VERDICT_BY.get(by, by)}" for by in order]
    unsettled = sum("verdict_by" in record and record["verdict_by"] is None for record in records)
    texts += [f"{unsettled} still in contact at the end"] if unsettled else []
    return [f"verdicts: {', '.join(texts)}"] if texts else []


def _closest(records: Sequence[Block]) -> list[str]:
    """Text line: the particle with the smallest margin; empty if no margins are known."""
    decided = [k for k, record in enumerate(records) if record.get("verdict") != UNDECIDED]
    margins = {k: abs(margin) for k in decided if isinstance(margin := records[k].get("margin_m_s"), int | float)}
    k = min(margins, key=margins.__getitem__, default=None)
    return [] if k is None else [f"smallest margin: particle {k + 1} {_with_reason(records[k], of_several=True)}"]


_DISSIPATED = "hourglass control took"  # of `deposition.summary.LIMITS`; that of the kinetic energy comes first


def alerts(summary: Summary) -> list[str]:
    """[warning about it] if the numerical dissipation of an impact exceeds DISSIPATION_LIMIT; otherwise []."""
    warnings = summary["run"].get("warnings") if summary else None
    shares = [impact.get("numerical_dissipation") for impact in summary.get("impacts", [])]
    doubtful = any(isinstance(share, int | float) and share > DISSIPATION_LIMIT for share in shares)
    found = [str(text) for text in warnings if _DISSIPATED in str(text)] if isinstance(warnings, list) else []
    return found[:1] if doubtful else []


def remarks(summary: Summary) -> list[str]:
    """Text lines: measures without a value with the reason, and the meaning of unusual values; equal lines of impacts are merged."""
    records = summary.get("impacts", [])
    lines: dict[str, list[int]] = {}  # text -> impacts
    for number, impact in enumerate(records, 1):
        reasons: dict[str, list[str]] = {}
        for path, reason in (impact.get("refused") or {}).items():
            if path in ("rebound_velocity_m_s", "restitution") and impact.get("rebounded") is False:
                continue  # the verdict implies it
            reasons.setdefault(str(reason), []).append(_label(str(path)))
        for reason, names in reasons.items():
            of_end = {_label(f"end.{key}") for key in impact["end"] if key != "time_s"}
            if of_end and of_end <= set(names):
                names = [_label("end"), *(name for name in names if name not in of_end)]
            verb = "are" if len(names) > 1 or names[0].startswith("all") else "is"
            lines.setdefault(f"{', '.join(names)} {verb} undefined: {reason}", []).append(number)
        said: set[str] = set()  # a remark that holds at the end and at the greatest deformation appears once
        for block, moment in reversed(_BLOCKS.items()):
            for key, value in (impact.get(block) or {}).items():
                remark = measure(key).remark(value) if isinstance(value, int | float) else None
                if remark is not None and key not in said:
                    said.add(key)
                    lines.setdefault(f"{moment}, {remark}", []).append(number)
    several = len(records) > 1
    return [f"{_numbers(numbers, 'impact')}: {text}" if several else text for text, numbers in lines.items()]


def _numbers(numbers: Sequence[int], name: str = "particle") -> str:
    """Ascending numbers as text: [1, 2, 3, 5] gives "particles 1 to 3, 5"."""
    # within a run of successive numbers, the difference from their position is constant
    runs = [[number for _, number in run] for _, run in groupby(enumerate(numbers), lambda each: each[1] - each[0])]
    text = ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)
    return f"{name}{'s' * (len(numbers) > 1)} {text}"


_OF_ROW = {  # column of the history -> its measure
    "time": "time_s", "step": "steps", "height": "height_m", "thickness": "thickness_m", "crater_depth": "crater_depth_m",
    "velocity_z": "velocity_z_m_s", "T_max": "T_max_K", "eps_p_mean": "eps_p_mean", "drift": "energy_drift",
    "momentum_error": "momentum_error",
}  # fmt: skip


def last_row(history: Mapping[str, NDArray]) -> list[tuple[str, str, str]]:
    """The last row of the history of a run that is not finished: label, value and unit of each measure; empty before the first row."""
    known = {name: measure(key) for name, key in _OF_ROW.items()}
    known["contact_force"] = Measure("contact_force", unit="mN", factor=1e3)
    return [(m.label, f"{history[k][-1] * m.factor:.4g}", m.unit) for k, m in known.items() if len(history.get(k, ()))]


def _label(path: str) -> str:
    """The label of a key in the record of an impact: "end.T_max_K" gives "highest temperature at the end"."""
    if path in _BLOCKS:
        return f"all measures {_BLOCKS[path]}"
    block, _, key = path.rpartition(".")
    return f"{measure(key).label} {_BLOCKS[block]}" if block in _BLOCKS else measure(path).label


def title(result: Result) -> str:
    """Text: sizes, metals, velocities, angles of particles, metals of the target from the top; without a plan: the folder."""
    try:
        plan, velocities, angles = result.plan, [], []
        groups: dict[str, list[float]] = {}
        for body in plan["impacts"]:
            words = f"{str(body['material']['name'])[:40]} {_SHAPES.get(body['shape'], body['shape'])[:20]}".strip()
            words += f" with {body['core']['material']['name'][:40]} core" if body.get("core") else ""
            groups.setdefault(words, []).append(1e6 * body["diameter"])
            velocities.append(math.hypot(*body["velocity"]))
            angles.append(math.degrees(math.acos(-body["velocity"][2] / velocities[-1])))
        bodies = ", ".join(
            f"{span(sizes)} µm {words}" if len(sizes) == 1 else f"{len(sizes)} {words} of {span(sizes)} µm"
            for words, sizes in groups.items()
        )
        ground = [*(layer for layer, _ in plan["target"].get("layers", ())), plan["target"]["material"]]
        base = " / ".join(metal["name"][:40] for metal in ground)
        text = f"{bodies} on {base} at {span(velocities)} m/s"
        return text + (f" and {span(angles)}°" if span(angles) != "0" else "")
    except (LookupError, TypeError, ValueError, AttributeError, ZeroDivisionError):
        return result.directory.resolve().name


_SHAPES = {"sphere": "", "hollow_sphere": "hollow sphere", "file": ""}


def span(values: Sequence[float]) -> str:
    """Numbers from 0 up as short text, equal ones once: "500, 546, 610"; if more than NAMED, least and greatest: "18.4 to 26.9"."""

    def text(value: float) -> str:
        return f"{value:.0f}" if value >= 100 or value < 1e-3 else f"{value:.3g}"

    texts = list(dict.fromkeys(map(text, values)))
    return ", ".join(texts) if len(texts) <= NAMED else f"{text(min(values))} to {text(max(values))}"


def brief(summary: Summary, most: int | None = None, with_errors: bool = False) -> list[list[str]]:
    """The main measures as rows of texts; the first row is the heading. One impact: a row for each measure. Several impacts: a row
    for each of the first `most` impacts."""
    if len(summary["impacts"]) == 1:
        groups = table_lines(list(columns(summary).values()), errors_of(summary))
        lines = [line for lines in groups.values() for line in lines if line.key in KEYS]
        return [["", *columns(summary), ""], *([line.label, *line.cells, line.unit] for line in lines)]
    blocks = impacts(summary)
    keys = [key for key in OF_EACH if any(key in block for block in blocks)]
    rows = [["", *(axis_label(key).replace(" above surface", "").replace("T rise", "T") for key in keys)]]
    for k, block in enumerate(blocks[:most]):
        widths = errors_of(summary, k) if with_errors else {}
        cells = (shown(key, block.get(key), widths.get(key)) for key in keys)
        rows.append([f"{k + 1}  {_particle_of(block)}".replace("\u00a0", " ").strip(), *cells])
    return rows


def of_run(summary: Summary) -> str:
    """Text line: the main measures of a whole run with several impacts; "" for a single impact."""
    whole = plain(summary["run"]) if len(summary["impacts"]) > 1 else {}
    known = [(measure(key), shown(key, whole[key])) for key in KEYS if whole.get(key) is not None]
    return ", ".join(f"{m.label} {value} {m.unit}".strip() for m, value in known)


def fill_table(table: Table, groups: Mapping[str, Iterable[Line]]) -> None:
    """Add lines of measures to a table for a terminal, each group under its heading."""
    for group, lines in groups.items():
        table.add_section()
        table.add_row(Text(group, style="bold"))
        for line in lines:
            table.add_row(Text("  " + line.label), *map(Text, line.cells), Text(line.unit))


def summary_table(result: Result) -> Table:
    """The summary as a table for a terminal, in display units. One impact: a column for its greatest deformation, and one for its end
    with all other values. Several: a column for each impact at its end, with the values of the whole run below."""
    summary = result.summary
    several = impacts(summary)
    blocks, errors = columns(summary), errors_of(summary)
    if len(several) > 1:
        heads = (f"impact\u00a0{k + 1} {_particle_of(block)}".strip() for k, block in enumerate(several))
        blocks, errors = dict(zip(heads, several, strict=True)), {}
    table = Table(title=Text(title(result)), title_justify="left", title_style="bold")
    table.add_column("")
    for heading in blocks or {"": {}}:
        table.add_column(heading.replace(" ", "\n"), justify="right")
    table.add_column("")
    fill_table(table, table_lines(list(blocks.values()), errors))
    if len(several) > 1:
        run = [line for lines in table_lines([plain(summary["run"])]).values() for line in lines]
        before = [""] * (len(several) - 1)
        fill_table(table, {"all impacts": [Line(r.key, r.label, [*before, *r.cells], r.unit) for r in run]})
    return table


def _particle_of(impact: Block) -> str:
    """Diameter and material of the particle of an impact as column heading, with non-breaking spaces; "" if they are unknown."""
    known = [shown(key, impact[key]) for key in ("diameter_m", "material") if impact.get(key) is not None]
    return "\u00a0µm\u00a0".join(known) if len(known) == 2 else ""
