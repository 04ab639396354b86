"""The summary in words, units and an order that people read: one source for terminal, page and comparison."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ..errors import StoreError
from ..result import Result

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
    "kinetic_energy_0_J": "kinetic energy at the start",
    "sim_time_s": "simulated time",
    "wall_s": "wall time",
    "wall_loop_s": "wall time of the steps",
    "dt_mean_s": "mean time step",
    "version": "coldspray",
}
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
    ),
    "particle": ("eps_p", "T_", "von_mises"),
    "balance, of the initial energy": ("energy", "momentum", "numerical"),
    "target": ("target",),
    "run": ("",),  # whatever is left
}


def columns(summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Heading -> values of a summary: what "greatest_deformation" and "end" hold side by side, all else in the last.

    Lists of words and of impacts, bands and tables within the summary are left out.
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
    if isinstance(value, int):
        return f"{value:,}".replace(",", " ")
    if isinstance(value, float):
        factor = _scale(key)[1]
        return f"{value * factor:.4g}" if band is None else with_band(value * factor, band * factor)
    if isinstance(value, list):
        return ", ".join(str(item) for item in value)
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
        particle = particles[0] if isinstance(particles, list) else particles
        said = [particle["diameter"], particle["material"], "on", substrate["material"]]
        said += ["at", particle["velocity"]]
        angle = str(particle.get("angle", "0 deg"))
        if float(angle.split()[0]) != 0.0:
            said += ["and", angle.replace(" deg", "°")]
        if isinstance(particles, list) and len(particles) > 1:
            said += [f"and {len(particles) - 1} more"]
    except (StoreError, tomllib.TOMLDecodeError, LookupError, TypeError, ValueError, AttributeError):
        return result.directory.resolve().name
    return " ".join(str(word)[:40] for word in said).replace(" um ", " µm ")


def summary_table(result: Result) -> Table:
    """The summary for a terminal, in units that people use, as a rich table.

    What the blocks "greatest_deformation" and "end" hold stands side by side, all else in the last column.
    """
    from rich.table import Table
    from rich.text import Text

    summary = result.summary
    blocks, band = columns(summary), bands(summary)
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
    notes = [f"{name}: {shown(name, summary[name])}" for name in NOTES if summary.get(name)]
    table.caption = Text("\n".join(notes), justify="left")
    return table


def _nested(value: Any) -> bool:
    return isinstance(value, Mapping) or (isinstance(value, list) and any(isinstance(item, Mapping) for item in value))


def _scale(key: str) -> tuple[str, float, str]:
    """Key without its unit, factor and unit to show it in."""
    if key in SPECIAL:
        return key, *SPECIAL[key]
    for ending, (factor, unit) in UNITS.items():
        if key.endswith(ending):
            return key.removesuffix(ending), factor, unit
    return key, 1.0, ""
