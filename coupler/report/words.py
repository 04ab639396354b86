"""The summary in words, units and an order that people read: one source for terminal, page and comparison."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from rich.table import Table
from rich.text import Text

from ..errors import StoreError
from ..files.inputs import parse_toml
from ..files.result import Result
from ..files.summary import Summary, impact_values, run_values
from ..measures import DISSIPATION_LIMIT, GROUPS, measure

SAID = 3  # particles that a title names
NOTES = ("effects", "warnings")  # lists of words, below the table
_ABOVE = (*NOTES, "undecided")  # not in the tables


def columns(summary: Summary) -> dict[str, dict[str, object]]:
    """Heading -> values: the greatest deformation of the last impact, and its end with all else of it and of the run.

    Lists of words, tables and lists of tables are left out.
    """
    if not summary:
        return {}
    greatest, end = summary["impacts"][-1].get("greatest"), plain(run_values(summary))
    return {"greatest deformation": dict(greatest), "end": end} if greatest else {"": end}


def plain(values: Mapping[str, object]) -> dict[str, object]:
    """What stands in a table of measures: without lists of words, tables and lists of tables."""
    return {key: value for key, value in values.items() if key not in _ABOVE and not _nested(value)}


def grouped(keys: Iterable[str]) -> list[tuple[str, list[str]]]:
    """Keys of a summary in reading order, under the headings of their groups; without empty groups."""
    all_keys = list(dict.fromkeys(keys))
    groups = [(group, [key for key in all_keys if measure(key).group == group]) for group in GROUPS]
    return [(group, inside) for group, inside in groups if inside]


def words(key: str) -> tuple[str, str]:
    """A key's label and the unit its values are shown in."""
    record = measure(key)
    return record.label, record.unit


def shown(key: str, value: object, band: float | None = None) -> str:
    """A value of the summary in the unit of its label, with its band where there is one: "0.566 ± 0.012"."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and measure(key).factor == 1.0:
        return f"{value:,}".replace(",", " ")
    if isinstance(value, float | int):
        factor = measure(key).factor
        return f"{value * factor:.4g}" if band is None else with_band(value * factor, band * factor)
    if isinstance(value, list):
        return ", ".join(shown(key, item) for item in value)
    return str(value)


def cell(key: str, values: Mapping[str, object], band: float | None = None) -> str:
    """A value of a table as `shown`; nothing where the table has no such key."""
    return shown(key, values[key], band) if key in values else ""


def with_band(value: float, band: float) -> str:
    """Value and band to the digits that the band leaves of the value: two of its own."""
    if not (band > 0 and math.isfinite(band) and math.isfinite(value)):
        return f"{value:.4g}"
    digits = min(max(1 - math.floor(math.log10(band)), 0), 12)
    return f"{value:.{digits}f} ± {band:.{digits}f}"


def bands(summary: Summary) -> dict[str, tuple[float, str]]:
    """Key -> half-width of its band in the last impact, in the key's own unit, and what drives it ("" if not said).

    An entry of `bands` is a number, or a table with `half_width` and `why`.
    """
    given, found = (summary["impacts"][-1].get("bands") if summary else None) or {}, {}
    for key, entry in given.items():
        table = entry if isinstance(entry, Mapping) else {"half_width": entry}
        width = table.get("half_width")
        if isinstance(width, int | float) and not isinstance(width, bool) and width > 0:
            found[str(key)] = (float(width), str(table.get("why", "")))
    return found


def impacts(summary: Summary) -> list[dict[str, object]]:
    """The measures of each impact at its end, and all else of it, in order."""
    return [plain(impact_values(summary, i)) for i in range(len(summary.get("impacts", [])))]


def alerts(summary: Summary) -> list[str]:
    """The warnings that make a result doubtful as a whole: they stand first in the run's, and before its numbers."""
    warnings = summary["run"].get("warnings") if summary else None
    shares = [impact.get("numerical_dissipation") for impact in summary.get("impacts", [])]
    doubtful = any(isinstance(share, int | float) and share > DISSIPATION_LIMIT for share in shares)
    return [str(warnings[0])] if doubtful and isinstance(warnings, list) and warnings else []


def remarks(summary: Summary) -> list[str]:
    """The measures that have no value, each with the reason, and the meaning of unusual values."""
    records, lines = summary.get("impacts", []), []
    for number, impact in enumerate(records, 1):
        whose = f"impact {number}: " if len(records) > 1 else ""
        reasons: dict[str, list[str]] = {}
        for path, reason in (impact.get("refused") or {}).items():
            reasons.setdefault(str(reason), []).append(_named(str(path)))
        for reason, names in reasons.items():
            of_end = {_named(f"end.{key}") for key in impact["end"] if key != "time_s"}
            if of_end and of_end <= set(names):
                names = ["all measures of the end", *(name for name in names if name not in of_end)]
            lines.append(f"{whose}no value of {', '.join(names)}: {reason}")
        for block in _PLACES:
            for key, value in (impact.get(block) or {}).items():
                remark = measure(key).remark(value) if isinstance(value, int | float) else None
                if remark is not None:
                    lines.append(f"{whose}{_PLACES[block]}, {remark}")
    return lines


_PLACES = {"greatest": "at the greatest deformation", "end": "at the end", "at_end": "at the end of the run"}


def _named(path: str) -> str:
    """The label of a key in an impact's record, with its block: "end.T_max_K" is "highest temperature at the end"."""
    block, _, key = path.rpartition(".")
    return f"{words(key)[0]} {_PLACES[block]}" if block in _PLACES else words(path)[0]


def title(result: Result) -> str:
    """Material, size and speed in the scene's own words; what the scene does not say is left out."""
    try:
        scene = parse_toml(result.scene_text)
        particles, substrate = scene["particle"], scene["substrate"]
        bodies = particles if isinstance(particles, list) else [particles]
        whats = [_short(one["diameter"]) + " " + _short(one["material"]) for one in bodies]
        said = [", ".join(whats[:SAID]), *([f"and {len(bodies) - SAID} more"] if len(bodies) > SAID else [])]
        said += ["on", _short(substrate["material"]), "at", _alike([one["velocity"] for one in bodies])]
        angles = [str(one.get("angle", "0 deg")) for one in bodies]
        if any(float(angle.split()[0]) != 0.0 for angle in angles):
            said += ["and", _alike(angles).replace(" deg", "°")]
    except (StoreError, LookupError, TypeError, ValueError, AttributeError):
        return result.directory.resolve().name
    return " ".join(said).replace(" um ", " µm ")


def _whose(impact: Mapping[str, object]) -> str:
    """The particle of an impact, for the head of its column; its spaces do not break."""
    known = [shown(key, impact[key]) for key in ("diameter_m", "material") if impact.get(key) is not None]
    return "\u00a0µm\u00a0".join(known) if len(known) == 2 else ""


def _short(text: object) -> str:
    return str(text)[:40]


def _alike(quantities: Sequence[object]) -> str:
    """Quantities of one unit in a row, said once where they are equal: "500 m/s" or "500, 546, 610 m/s"."""
    texts = list(dict.fromkeys(_short(one) for one in quantities))
    number, unit = zip(*(text.split(maxsplit=1) for text in texts), strict=True)
    if len(set(unit)) > 1 or len(texts) > SAID:
        return f"{texts[0]} to {texts[-1]}"
    return f"{', '.join(number)} {unit[0]}"


def summary_table(result: Result) -> Table:
    """The summary for a terminal, in units that people use, as a rich table.

    Of one impact its greatest deformation and its end stand side by side, with all else in the last column. Of several impacts each
    has a column with its own end, and what belongs to the whole run stands below.
    """
    summary = result.summary
    several = impacts(summary)
    blocks, band = columns(summary), bands(summary)
    if len(several) > 1:
        blocks = {f"impact\u00a0{k + 1} {_whose(one)}".strip(): one for k, one in enumerate(several)}
        band = {}  # those of the last impact
    table = Table(title=Text(title(result)), title_justify="left", title_style="bold")
    table.add_column("")
    for heading in blocks or {"": {}}:
        table.add_column(heading.replace(" ", "\n"), justify="right")
    table.add_column("")
    for group, keys in grouped(key for block in blocks.values() for key in block):
        table.add_section()
        table.add_row(Text(group, style="bold"))
        for key in keys:
            label, unit = words(key)
            width = band[key][0] if key in band else None
            cells = [cell(key, block, width) for block in blocks.values()]
            table.add_row(Text("  " + label), *(Text(text) for text in cells), Text(unit))
    if len(several) > 1:
        table.add_section()
        table.add_row(Text("all impacts", style="bold"))
        for key, value in plain(summary["run"]).items():
            label, unit = words(key)
            table.add_row(Text("  " + label), *[Text("")] * (len(several) - 1), Text(shown(key, value)), Text(unit))
    values = result.values
    notes = [f"{name}: {shown(name, values[name])}" for name in NOTES if values.get(name)]
    table.caption = Text("\n".join([*remarks(summary), *notes]), justify="left")
    return table


def _nested(value: object) -> bool:
    of_tables = isinstance(value, list) and (not value or any(isinstance(item, Mapping) for item in value))
    return isinstance(value, Mapping) or of_tables
