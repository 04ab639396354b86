"""The summary in words, units and an order that people read: one source for terminal, page and comparison."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..errors import StoreError
from ..files.result import Result

if TYPE_CHECKING:
    from rich.table import Table

# Ending of a key -> factor and unit in which people read it; the longest ending that fits counts.
UNITS = {
    "_m_s": (1.0, "m/s"),
    "_m": (1e6, "µm"),
    "_Pa": (1e-6, "MPa"),
    "_K": (1.0, "K"),
    "_kg": (1e12, "ng"),
    "_J": (1e9, "nJ"),
    "_s": (1e9, "ns"),
}
SPECIAL = {
    "dt_mean_s": (1e12, "ps"),
    "wall_s": (1.0, "s"),
    "wall_loop_s": (1.0, "s"),
    "energy_drift": (100.0, "%"),
    "momentum_error": (1.0, ""),
    "numerical_dissipation": (100.0, "%"),
    "memory_peak_bytes": (1e-6, "MB"),
    "idle_share": (100.0, "%"),
}
LABELS = {
    "time_s": "time",
    "flattening_ratio": "flattening, above surface",
    "flattening_ratio_total": "flattening, whole",
    "eps_p_mean": "mean plastic strain",
    "eps_p_p99": "plastic strain, 99 %",
    "eps_p_max": "greatest plastic strain",
    "T_mean_K": "mean temperature",
    "T_p99_K": "temperature, 99 %",
    "T_max_K": "highest temperature",
    "von_mises_max_Pa": "highest von Mises stress",
    "target_eps_p_max": "greatest plastic strain",
    "target_T_max_K": "highest temperature",
    "target_von_mises_max_Pa": "highest von Mises stress",
    "penetration_max_m": "greatest penetration",
    "plastic_radius_m": "radius of the yielded zone",
    "plastic_depth_m": "depth of the yielded zone",
    "surface_level_m": "surface met at",
    "speed_m_s": "impact speed",
    "material": "material of the particle",
    "diameter_m": "diameter before impact",
    "velocity_z_m_s": "mean velocity upwards",
    "rebound_velocity_m_s": "rebound velocity",
    "element_size_m": "smallest elements",
    "spacing_m": "spacing of the points",
    "ranks": "processes",
    "placement": "where they run",
    "idle_share": "idle, by process",
    "memory_peak_bytes": "most memory",
    "kinetic_energy_0_J": "kinetic energy at the start",
    "sim_time_s": "simulated time",
    "wall_s": "wall time",
    "wall_loop_s": "wall time of the steps",
    "dt_mean_s": "mean time step",
    "version": "coldspray",
}
TOGETHER = ("steps", "sim_time_s", "wall_s", "wall_loop_s")  # of a run of several impacts: the sum of all
SAID = 3  # particles that a title names
NOTES = ("effects", "warnings")  # lists of words, below the table
GROUPS = {
    "shape": (
        "time",
        "flattening",
        "height",
        "thickness",
        "splat",
        "crater",
        "velocity",
        "rebound",
        "penetration",
        "surface",
    ),
    "particle": ("material", "diameter", "speed", "eps_p", "T_", "von_mises"),
    "balance, of the initial energy": ("energy", "momentum", "numerical"),
    "target": ("target", "plastic"),
    "run": ("",),  # whatever is left
}


def columns(summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
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
    left, groups = list(dict.fromkeys(keys)), []
    for group, starts in GROUPS.items():
        inside = [key for key in left if key.startswith(starts)]
        left = [key for key in left if key not in inside]
        if inside:
            groups.append((group, inside))
    return groups


def words(key: str) -> tuple[str, str]:
    """A key's label and the unit its values are shown in."""
    name, _, unit = _scale(key)
    return LABELS.get(key, name.replace("_", " ")), unit


def shown(key: str, value: Any, band: float | None = None) -> str:
    """A value of the summary in the unit of its label, with its band where there is one: "0.566 ± 0.012"."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and key not in SPECIAL:
        return f"{value:,}".replace(",", " ")
    if isinstance(value, float | int):
        factor = _scale(key)[1]
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


def bands(summary: Mapping[str, Any]) -> dict[str, tuple[float, str]]:
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


def impacts(summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The measures of each impact of a run of several, in order; empty for a run of one."""
    given = summary.get("impacts")
    entries = [entry for entry in given if isinstance(entry, Mapping)] if isinstance(given, list) else []
    return [{key: value for heading in columns(entry).values() for key, value in heading.items()} for entry in entries]


def title(result: Result) -> str:
    """Material, size and speed in the scene's own words; what the scene does not say is left out."""
    try:
        scene = tomllib.loads(result.scene_text)
        particles, substrate = scene["particle"], scene["substrate"]
        bodies = particles if isinstance(particles, list) else [particles]
        whats = [_short(one["diameter"]) + " " + _short(one["material"]) for one in bodies]
        said = [", ".join(whats[:SAID]), *([f"and {len(bodies) - SAID} more"] if len(bodies) > SAID else [])]
        said += ["on", _short(substrate["material"]), "at", _alike([one["velocity"] for one in bodies])]
        angles = [str(one.get("angle", "0 deg")) for one in bodies]
        if any(float(angle.split()[0]) != 0.0 for angle in angles):
            said += ["and", _alike(angles).replace(" deg", "°")]
    except (StoreError, tomllib.TOMLDecodeError, LookupError, TypeError, ValueError, AttributeError):
        return result.directory.resolve().name
    return " ".join(said).replace(" um ", " µm ")


def _whose(impact: Mapping[str, Any]) -> str:
    """The particle of an impact, for the head of its column; its spaces do not break."""
    known = [shown(key, impact[key]) for key in ("diameter_m", "material") if impact.get(key) is not None]
    return "\u00a0µm\u00a0".join(known) if len(known) == 2 else ""


def _short(text: Any) -> str:
    return str(text)[:40]


def _alike(quantities: Sequence[Any]) -> str:
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
    from rich.table import Table
    from rich.text import Text

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


def _nested(value: Any) -> bool:
    of_tables = isinstance(value, list) and (not value or any(isinstance(item, Mapping) for item in value))
    return isinstance(value, Mapping) or of_tables


def _scale(key: str) -> tuple[str, float, str]:
    """Key without its unit, factor and unit to show it in."""
    if key in SPECIAL:
        return key, *SPECIAL[key]
    for ending, (factor, unit) in UNITS.items():
        if key.endswith(ending):
            return key.removesuffix(ending), factor, unit
    return key, 1.0, ""
