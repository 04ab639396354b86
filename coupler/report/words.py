"""The summary in words, units and an order that people read: one source for terminal, page and comparison."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from rich.table import Table
from rich.text import Text

from ..errors import StoreError
from ..files.inputs import parse_toml
from ..files.result import Result
from ..measures import GROUPS, measure

TOGETHER = ("steps", "sim_time_s", "wall_s", "wall_loop_s")  # of a run of several impacts: the sum of all
SAID = 3  # particles that a title names
NOTES = ("effects", "warnings")  # lists of words, below the table


def columns(summary: Mapping[str, object]) -> dict[str, dict[str, object]]:
    """Heading -> values of a summary: what "greatest_deformation" and "end" hold side by side, all else in the last.

    Lists of words and of impacts, bands and tables within the summary are left out, and lists of nothing.
    """
    peak, end = (summary.get(name) for name in ("greatest_deformation", "end"))
    named = (*NOTES, "greatest_deformation", "end")
    single = {key: value for key, value in summary.items() if key not in named and not _nested(value)}
    end = end if isinstance(end, Mapping) else {}
    last = {**end, **single, **end}  # in the order of `end`, then what only the summary itself has
    if isinstance(peak, Mapping):
        return {"greatest deformation": dict(peak), "end": last}
    return {"": last} if last else {}


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
        return ""
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


def with_band(value: float, band: float) -> str:
    """Value and band to the digits that the band leaves of the value: two of its own."""
    if not (band > 0 and math.isfinite(band) and math.isfinite(value)):
        return f"{value:.4g}"
    digits = min(max(1 - math.floor(math.log10(band)), 0), 12)
    return f"{value:.{digits}f} ± {band:.{digits}f}"


def bands(summary: Mapping[str, object]) -> dict[str, tuple[float, str]]:
    """Key -> half-width of its band, in the key's own unit, and what drives it ("" if not said).

    Read from summary["bands"]: a number, or a table with `half_width` and `why`, for each key.
    """
    given, found = summary.get("bands"), {}
    for key, entry in given.items() if isinstance(given, Mapping) else ():
        table = entry if isinstance(entry, Mapping) else {"half_width": entry}
        width = table.get("half_width")
        if isinstance(width, int | float) and not isinstance(width, bool) and width > 0:
            found[str(key)] = (float(width), str(table.get("why", "")))
    return found


def impacts(summary: Mapping[str, object]) -> list[dict[str, object]]:
    """The measures of each impact of a run of several, in order; empty for a run of one."""
    given = summary.get("impacts")
    entries = [entry for entry in given if isinstance(entry, Mapping)] if isinstance(given, list) else []
    return [{key: value for heading in columns(entry).values() for key, value in heading.items()} for entry in entries]


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

    What the blocks "greatest_deformation" and "end" hold stands side by side, all else in the last column. Of a run of several
    impacts each has a column with its own end, and what they took together stands below.
    """
    summary = result.summary
    several = impacts(summary)
    blocks, band = columns(summary), bands(summary)
    if len(several) > 1:
        blocks = {f"impact\u00a0{k + 1} {_whose(one)}".strip(): one for k, one in enumerate(several)}
        band = {}  # those of the summary are of its last impact
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
            cells = [shown(key, block.get(key), width) for block in blocks.values()]
            table.add_row(Text("  " + label), *(Text(cell) for cell in cells), Text(unit))
    if len(several) > 1:
        table.add_section()
        table.add_row(Text("all impacts", style="bold"))
        for key in TOGETHER:
            if key in summary:
                label, unit = words(key)
                spaces = [Text("")] * (len(several) - 1)
                table.add_row(Text("  " + label), *spaces, Text(shown(key, summary[key])), Text(unit))
    notes = [f"{name}: {shown(name, summary[name])}" for name in NOTES if summary.get(name)]
    table.caption = Text("\n".join(notes), justify="left")
    return table


def _nested(value: object) -> bool:
    of_tables = isinstance(value, list) and (not value or any(isinstance(item, Mapping) for item in value))
    return isinstance(value, Mapping) or of_tables
