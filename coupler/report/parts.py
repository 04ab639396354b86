"""Pieces of the page in HTML: tables, tiles, lists. Everything that comes from a run is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

from ..errors import StoreError
from ..files.inputs import parse_toml
from ..files.result import Result
from ..files.summary import Summary
from .words import bands, cell, columns, grouped, impacts, remarks, shown, words

TILES = ("flattening_ratio", "crater_depth_m", "splat_diameter_m", "eps_p_p99", "T_p99_K", "rebound_velocity_m_s")
# Of a material: name, what it is, factor to the unit it is shown in, unit.
CONSTANTS = (
    ("rho", "density", 1.0, "kg/m³"),
    ("G", "shear modulus", 1e-9, "GPa"),
    ("K", "bulk modulus, ρ c₀²", 1e-9, "GPa"),
    ("c0", "sound speed c₀ of the shock relation", 1.0, "m/s"),
    ("s", "slope s of the shock relation", 1.0, ""),
    ("Gamma0", "Grüneisen coefficient", 1.0, ""),
    ("A", "Johnson-Cook A", 1e-6, "MPa"),
    ("B", "Johnson-Cook B", 1e-6, "MPa"),
    ("n", "Johnson-Cook n", 1.0, ""),
    ("C", "Johnson-Cook C", 1.0, ""),
    ("m", "Johnson-Cook m", 1.0, ""),
    ("eps_dot_0", "reference strain rate", 1.0, "1/s"),
    ("T_ref", "reference temperature", 1.0, "K"),
    ("T_m", "melting point", 1.0, "K"),
    ("taylor_quinney", "share of plastic work that heats", 1.0, ""),
)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table of texts. numbers: columns that are set to the right; a head of empty texts is left out."""
    kinds = [' class="n"' if k in numbers else "" for k in range(len(head))]
    top = "".join(f"<th{kind}>{escape(text)}</th>" for text, kind in zip(head, kinds, strict=True))
    above = f"<thead><tr>{top}</tr></thead>" if any(head) else ""
    body = "".join(
        "<tr>" + "".join(f"<td{kind}>{escape(text)}</td>" for text, kind in zip(row, kinds, strict=True)) + "</tr>"
        for row in rows
    )
    return f'<div class="wide"><table>{above}<tbody>{body}</tbody></table></div>'


def tiles(summary: Summary) -> str:
    """The measures most asked for, large."""
    width = bands(summary)
    values = list(columns(summary).values())[-1:] or [{}]
    found = []
    for key in TILES:
        if values[0].get(key) is not None:
            label, unit = words(key)
            number = escape(shown(key, values[0][key], width.get(key, (None,))[0]))
            found.append(f'<div class="tile"><b>{number} <small>{unit}</small></b><span>{escape(label)}</span></div>')
    return f'<div class="tiles">{"".join(found)}</div>' if found else ""


def measures(summary: Summary) -> str:
    """All measures of a summary, a table for each group, with bands where there are any."""
    blocks, band = columns(summary), bands(summary)
    tables = []
    for group, keys in grouped(key for block in blocks.values() for key in block):
        used = {name: block for name, block in blocks.items() if any(key in block for key in keys)}
        rows = []
        for key in keys:
            label, unit = words(key)
            width = band.get(key, (None,))[0]
            rows.append([label, *(cell(key, block, width) for block in used.values()), unit])
        heads = list(used) if len(used) > 1 else [""] * len(used)
        if used:
            tables.append(table([group.capitalize(), *heads, ""], rows, numbers=range(1, 1 + len(used))))
    drives = [f"{words(key)[0]}: {why}" for key, (_, why) in band.items() if why]
    note = f'<p class="caption">What drives the bands: {escape("; ".join(drives))}.</p>' if drives else ""
    items = "".join(f"<li>{escape(text)}</li>" for text in remarks(summary))
    note += f'<ul class="caption">{items}</ul>' if items else ""
    return f'<div class="measures">{"".join(tables)}</div>{note}' if tables else ""


def several(entries: Sequence[Mapping[str, object]], headings: Sequence[str]) -> str:
    """Measures of several impacts or runs, one column each; without the keys that none has a number for."""
    rows = []
    for group, keys in grouped(key for entry in entries for key in entry):
        lines = []
        for key in keys:
            if any(isinstance(entry.get(key), int | float) for entry in entries):
                label, unit = words(key)
                cells = "".join(f'<td class="n">{escape(cell(key, entry))}</td>' for entry in entries)
                lines.append(f'<tr><td>{escape(label)}</td>{cells}<td class="u">{escape(unit)}</td></tr>')
        if lines:
            rows += [
                f'<tr class="group"><th colspan="{len(entries) + 2}">{escape(group.capitalize())}</th></tr>',
                *lines,
            ]
    head = "".join(f'<th class="n">{escape(heading)}</th>' for heading in headings)
    head = f"<thead><tr><th></th>{head}<th></th></tr></thead>"
    return f'<div class="wide"><table>{head}<tbody>{"".join(rows)}</tbody></table></div>' if rows else ""


def each_impact(summary: Summary) -> str:
    """The impacts of a run of several, side by side; nothing for a run of one."""
    entries = impacts(summary)
    return several(entries, [f"impact {k + 1}" for k in range(len(entries))]) if len(entries) > 1 else ""


def scene_of(result: Result) -> dict[str, object]:
    """The scene as nested dicts of its own words; empty if there is none that can be read."""
    try:
        return parse_toml(result.scene_text)
    except (StoreError, ValueError, RecursionError):
        return {}


def asked(scene: Mapping[str, object], values: Mapping[str, object]) -> str:
    """What was computed, in the scene's own words, and how finely. values: of `Result.values`."""
    given = scene.get("particle")
    bodies = [one for one in (given if isinstance(given, list) else [given]) if isinstance(one, Mapping)]
    lines = [("particle" if len(bodies) == 1 else f"particle {k + 1}", _particle(one)) for k, one in enumerate(bodies)]
    substrate = scene.get("substrate")
    if isinstance(substrate, Mapping):
        lines.append(("target", _target(substrate)))
    for name, word in (("contact", "contact"), ("adhesion", "adhesion"), ("end", "ends")):
        entry = scene.get(name)
        if isinstance(entry, Mapping) and entry:
            lines.append((word, ", ".join(f"{key} {value}" for key, value in entry.items())))
        elif isinstance(entry, str):
            lines.append((word, entry))
    lines.append(("resolution", _resolution(scene, values)))
    return (
        "<dl>"
        + "".join(f"<dt>{escape(word)}</dt><dd>{escape(_micro(said))}</dd>" for word, said in lines if said)
        + "</dl>"
    )


def effects(result: Result) -> str:
    """The effects that took part, and the reasons, from the plan of the run."""
    rows = plan_rows(result.plan, "effects", "rows")
    if not rows:
        used = _taking_part(result.values.get("effects"))
        text = f"Taking part: {', '.join(map(_plain, used))}. " if used else ""
        return f'<p class="note">{escape(text)}The reasons are not known: this run has no readable plan.json.</p>'
    lines = []
    for row in rows:
        value, threshold = _number(row, "value") or 0.0, _number(row, "threshold") or 0.0
        number = f"{row['number']} = {value:.3g} {'>' if value > threshold else '≤'} {threshold:g}"
        cells = (_plain(str(row["name"])), "on" if row["on"] else "off", number, str(row["why"]))
        off = "" if row["on"] else ' class="off"'
        lines.append(f"<tr{off}>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
    head = "".join(f"<th>{text}</th>" for text in ("effect", "", "decided by", "because"))
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'


def material_data(result: Result) -> str:
    """The constants of the run's materials with their sources, folded away; nothing without a plan."""
    bodies = [*plan_rows(result.plan, "impacts"), *plan_rows({"target": [result.plan.get("target")]}, "target")]
    metals = {str(m["name"]): m for body in bodies if isinstance(m := body.get("material"), Mapping) and "name" in m}
    if not metals:
        return ""
    rows = [
        (label, *(f"{float(metal[key]) * factor:.4g}" if key in metal else "" for metal in metals.values()), unit)
        for key, label, factor, unit in CONSTANTS
    ]
    sources = "".join(
        f'<p class="caption">{escape(name)}: {escape(str(m.get("source") or "no source given"))}. {escape(str(m.get("note", "")))}</p>'
        for name, m in metals.items()
    )
    whole = table(["", *metals, ""], rows, numbers=range(1, len(metals) + 1))
    return f"<details><summary>Material data and their sources</summary>{whole}{sources}</details>"


def plan_rows(plan: Mapping[str, object], *keys: str) -> list[Mapping[str, object]]:
    """The list of objects at a place of a plan.json; empty if there is none."""
    value: object = plan
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return [row for row in value if isinstance(row, Mapping)] if isinstance(value, list) else []


def warnings(given: object) -> str:
    """What the run warned of, a list of texts; nothing if it did not."""
    if not isinstance(given, list) or not given:
        return ""
    items = "".join(f"<li>{escape(str(text))}</li>" for text in given)
    return f'<div class="warn"><b>Warnings</b><ul>{items}</ul></div>'


def planned_warnings(result: Result) -> list[str]:
    """The warnings of the plan of a run that has no summary yet."""
    texts = result.plan.get("warnings")
    return [str(text) for text in texts] if isinstance(texts, list) else []


def timing(values: Mapping[str, object]) -> str:
    """Where the seconds went, as far as `Result.values` says."""
    wall, loop, steps = (_number(values, key) for key in ("wall_s", "wall_loop_s", "steps"))
    if not (wall and loop and steps):
        return ""
    rows = [
        ("whole run", f"{wall:.1f} s"),
        ("meshing, packing, compiling", f"{wall - loop:.1f} s"),
        ("the steps, with writing", f"{loop:.1f} s"),
        ("steps", shown("steps", int(steps))),
        ("a step", f"{loop / steps * 1e3:.2f} ms"),
    ]
    for key, word in (("points", "point"), ("elements", "element")):
        count = _number(values, key)
        if count:
            rows.append((f"a step, over the {word}s", f"{loop / steps / count * 1e6:.2f} µs"))
    simulated = _number(values, "sim_time_s")
    if simulated:
        rows.append(("1 ns simulated", f"{loop / (simulated * 1e9):.2f} s"))
    given = values.get("dt_limited_by")
    limits = {name: _number(given, name) or 0.0 for name in given} if isinstance(given, Mapping) else {}
    if sum(limits.values()) > 0:
        said = ", ".join(f"{name} {value / sum(limits.values()):.0%}" for name, value in limits.items() if value)
        rows.append(("who set the time step", said))
    share = 100 * loop / wall
    pieces = ((share, "#8ecbee", "steps"), (100 - share, "#f0c15c", "before them"))
    bar = "".join(
        f'<span style="width:{part:.1f}%;background:{colour}">{word if part > 20 else ""}</span>'  # no room in a short one
        for part, colour, word in pieces
    )
    bar = f'<div class="bar">{bar}</div>'
    return bar + table(("", ""), rows, numbers=(1,))


def _particle(one: Mapping[str, object]) -> str:
    shape = str(one.get("shape", "sphere")).replace("_", " ")
    said = f"{one.get('material', '?')} {shape}, {one.get('diameter', '?')}, {one.get('velocity', '?')}"
    said += f" at {one.get('angle', '0 deg')} from the surface normal, {one.get('temperature', '300 K')}"
    return said + "".join(f", {key} {one[key]}" for key in ("tilt",) if str(one.get(key, "0 deg")) != "0 deg")


def _target(one: Mapping[str, object]) -> str:
    said = f"{one.get('material', '?')} cylinder, {one.get('diameter', '?')} across and {one.get('height', '?')} high"
    said += f", {one.get('temperature', '300 K')}"
    return said + "".join(f", {key} {one[key]}" for key in ("sides", "bottom") if key in one)


def _resolution(scene: Mapping[str, object], values: Mapping[str, object]) -> str:
    said = [f"preset {scene['preset']}"] if "preset" in scene else []
    for count, size, what in (
        ("points", "spacing_m", "points {} µm apart"),
        ("elements", "element_size_m", "tetrahedra of {} µm and more"),
    ):
        if _number(values, count) and _number(values, size):
            said.append(f"{shown(count, values[count])} {what.format(shown(size, values[size]))}")
    return ", ".join(said)


def _number(values: Mapping[str, object], key: str) -> float | None:
    value = values.get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _taking_part(given: object) -> list[str] | None:
    """Names of effects, of a list of names or of tables with `name` and `on`; None if there is no list."""
    if not isinstance(given, list):
        return None
    tables = [item if isinstance(item, Mapping) else {"name": item} for item in given]
    return [str(item.get("name")) for item in tables if item.get("on", True)]


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _micro(text: str) -> str:
    return text.replace(" um", " µm")
