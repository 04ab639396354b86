"""Parts of the page in HTML: tables, tiles, lists. Everything that comes from a run is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from ..errors import StoreError
from ..files.inputs import parse_toml
from ..files.result import Result
from ..files.summary import Summary, Values
from ..measures import measure
from .words import Block, bands, columns, impacts, remarks, shown, table_lines

TILES = ("flattening_ratio", "crater_depth_m", "splat_diameter_m", "eps_p_p99", "T_p99_K", "rebound_velocity_m_s")
# Of a material: name, what it is, factor to the unit it is shown in, unit.
CONSTANTS = (
    ("rho", "density", 1.0, "kg/m³"),
    ("G", "shear modulus", 1e-9, "GPa"),
    ("K", "bulk modulus, ρ c₀²", 1e-9, "GPa"),
    ("c0", "sound speed c₀ of the shock relation", 1.0, "m/s"),
    ("s", "slope s of the shock relation", 1.0, ""),
    ("Gamma0", "Grüneisen coefficient", 1.0, ""),
    ("T_m", "melting point", 1.0, "K"),
    ("taylor_quinney", "share of plastic work that heats", 1.0, ""),
)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table of texts. numbers: columns that are set to the right; a head of empty texts is left out."""
    kinds = ["n" if k in numbers else "" for k in range(len(head))]
    above = f"<thead>{_row(head, kinds, 'th')}</thead>" if any(head) else ""
    return f'<div class="wide"><table>{above}<tbody>{"".join(_row(row, kinds) for row in rows)}</tbody></table></div>'


def _row(cells: Sequence[str], kinds: Sequence[str], tag: str = "td", kind: str = "") -> str:
    """A row of a table. kinds: the class of each cell, "" for none; kind: that of the row."""

    def of(name: str) -> str:
        return f' class="{name}"' if name else ""

    inner = "".join(f"<{tag}{of(k)}>{escape(cell)}</{tag}>" for cell, k in zip(cells, kinds, strict=True))
    return f"<tr{of(kind)}>{inner}</tr>"


def tiles(summary: Summary) -> str:
    """The measures most asked for, large."""
    width, values = bands(summary), ([*columns(summary).values()] or [{}])[-1]
    parts = []
    for key in TILES:
        if values.get(key) is not None:
            record, number = measure(key), escape(shown(key, values[key], width.get(key, (None,))[0]))
            label = escape(record.label)
            parts.append(f'<div class="tile"><b>{number} <small>{record.unit}</small></b><span>{label}</span></div>')
    return f'<div class="tiles">{"".join(parts)}</div>' if parts else ""


def measures(summary: Summary) -> str:
    """All measures of a summary, a table for each group, with bands where there are any."""
    blocks, band = columns(summary), bands(summary)
    tables = []
    for group, lines in table_lines(list(blocks.values()), band).items():
        used = [k for k in range(len(blocks)) if any(line.cells[k] for line in lines)]
        heads = [list(blocks)[k] for k in used] if len(used) > 1 else [""] * len(used)
        rows = [[line.label, *(line.cells[k] for k in used), line.unit] for line in lines]
        tables.append(table([group.capitalize(), *heads, ""], rows, numbers=range(1, 1 + len(used))))
    drives = [f"{measure(key).label}: {why}" for key, (_, why) in band.items() if why]
    note = f'<p class="caption">What drives the bands: {escape("; ".join(drives))}.</p>' if drives else ""
    items = "".join(f"<li>{escape(text)}</li>" for text in remarks(summary))
    note += f'<ul class="caption">{items}</ul>' if items else ""
    return f'<div class="measures">{"".join(tables)}</div>{note}' if tables else ""


def several(entries: Sequence[Block], headings: Sequence[str]) -> str:
    """Measures of several impacts or runs, one column each; without the keys that none has a number for."""
    numeric = {key for entry in entries for key, value in entry.items() if isinstance(value, int | float)}
    kinds, rows = ["", *["n"] * len(entries), "u"], []
    for group, lines in table_lines([{k: v for k, v in entry.items() if k in numeric} for entry in entries]).items():
        rows.append(f'<tr class="group"><th colspan="{len(entries) + 2}">{escape(group.capitalize())}</th></tr>')
        rows += [_row([line.label, *line.cells, line.unit], kinds) for line in lines]
    head = _row(["", *headings, ""], [*kinds[:-1], ""], "th")
    body = f"<table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"
    return f'<div class="wide">{body}</div>' if rows else ""


def each_impact(summary: Summary) -> str:
    """The impacts of a run of several, side by side; nothing for a run of one."""
    entries = impacts(summary)
    return several(entries, [f"impact {k + 1}" for k in range(len(entries))]) if len(entries) > 1 else ""


def scene_of(result: Result) -> Values:
    """The scene as nested dicts of its own words; empty if there is none that can be read."""
    try:
        return parse_toml(result.scene_text)
    except (StoreError, ValueError):
        return {}


def computed(scene: Values, values: Values) -> str:
    """What was computed, in the scene's own words, and how finely. values: of `Result.values`."""
    particles = scene.get("particle", [])
    particles = particles if isinstance(particles, list) else [particles]
    lines = {f"particle {k + 1}" if len(particles) > 1 else "particle": _particle(p) for k, p in enumerate(particles)}
    if target := scene.get("substrate"):
        conditions = "".join(f", {key} {target[key]}" for key in ("sides", "bottom") if key in target)
        lines["target"] = (
            f"{target.get('material', '?')} cylinder, {target.get('diameter', '?')} across and {target.get('height', '?')} high,"
            f" {target.get('temperature', '300 K')}{conditions}"
        )
    for name, word in (("contact", "contact"), ("adhesion", "adhesion"), ("end", "ends")):
        entry = scene.get(name, "")
        lines[word] = entry if isinstance(entry, str) else ", ".join(f"{key} {value}" for key, value in entry.items())
    fineness = [f"preset {scene['preset']}"] if "preset" in scene else []
    for count, size, text in (
        ("points", "spacing_m", "points {} µm apart"),
        ("elements", "element_size_m", "tetrahedra of {} µm and more"),
    ):
        if values.get(count) and values.get(size):
            fineness.append(f"{shown(count, values[count])} {text.format(shown(size, values[size]))}")
    lines["resolution"] = ", ".join(fineness)
    items = (f"<dt>{escape(word)}</dt><dd>{escape(_micro(text))}</dd>" for word, text in lines.items() if text)
    return f"<dl>{''.join(items)}</dl>"


def _particle(particle: Values) -> str:
    shape, tilt = str(particle.get("shape", "sphere")).replace("_", " "), str(particle.get("tilt", "0 deg"))
    return (
        f"{particle.get('material', '?')} {shape}, {particle.get('diameter', '?')}, {particle.get('velocity', '?')}"
        f" at {particle.get('angle', '0 deg')} from the surface normal, {particle.get('temperature', '300 K')}"
        + (f", tilt {tilt}" if tilt != "0 deg" else "")
    )


def effects(result: Result) -> str:
    """The effects that took part, and the reasons, from the plan of the run."""
    if not result.plan:
        return '<p class="note">Not known: this run has no readable plan.json.</p>'
    lines = []
    for row in result.plan["budget"]["rows"]:
        number = f"{row['number']} = {row['value']:.3g}"
        cells = (row["name"].replace("_", " "), "on" if row["on"] else "off", number, row["why"])
        lines.append(_row(cells, [""] * 4, kind="" if row["on"] else "off"))
    head = _row(("effect", "", "decided by", "because"), [""] * 4, "th")
    return f'<div class="wide"><table><thead>{head}</thead><tbody>{"".join(lines)}</tbody></table></div>'


def material_data(result: Result) -> str:
    """The constants of the run's materials with their sources, folded away; nothing without a plan."""
    if not result.plan:
        return ""
    bodies = [body["material"] for body in (*result.plan["impacts"], result.plan["target"])]
    metals = {m["name"]: m | {"K": m["rho"] * m["c0"] ** 2} for m in bodies}
    rows = [
        (label, *(f"{metal[key] * factor:.4g}" for metal in metals.values()), unit)
        for key, label, factor, unit in CONSTANTS
    ]
    for law in dict.fromkeys(metal["strength"]["law"] for metal in metals.values()):
        own = [m["strength"]["numbers"] if m["strength"]["law"] == law else {} for m in metals.values()]
        words = law.replace("_", " ")
        rows += [(f"{words} {key}", *(f"{n[key]:.4g}" if n else "" for n in own), "") for key in max(own, key=len)]
    sources = "".join(
        f'<p class="caption">{escape(name)}: {escape(m["source"] or "no source given")}. {escape(m["note"])}'
        f" Strength: {escape(m['strength']['source'] or 'no source given')}.</p>"
        for name, m in metals.items()
    )
    whole = table(["", *metals, ""], rows, numbers=range(1, len(metals) + 1))
    return f"<details><summary>Material data and their sources</summary>{whole}{sources}</details>"


def warnings(texts: Sequence[object] | None) -> str:
    """The warnings of a run, or of its plan; nothing if there are none."""
    items = "".join(f"<li>{escape(str(text))}</li>" for text in texts or ())
    return f'<div class="warn"><b>Warnings</b><ul>{items}</ul></div>' if items else ""


def timing(values: Values) -> str:
    """Where the seconds went, as far as `Result.values` says."""
    wall, loop, steps = (values.get(key) for key in ("wall_s", "wall_loop_s", "steps"))
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
        if count := values.get(key):
            rows.append((f"a step, over the {word}s", f"{loop / steps / count * 1e6:.2f} µs"))
    if simulated := values.get("sim_time_s"):
        rows.append(("1 ns simulated", f"{loop / (simulated * 1e9):.2f} s"))
    limits = values.get("dt_limited_by") or {}
    if (total := sum(limits.values())) > 0:
        rows.append(("who set the time step", ", ".join(f"{name} {n / total:.0%}" for name, n in limits.items() if n)))
    share = 100 * loop / wall
    bar = "".join(
        f'<span style="width:{part:.1f}%;background:{colour}">{word if part > 20 else ""}</span>'  # no room in a short one
        for part, colour, word in ((share, "#8ecbee", "steps"), (100 - share, "#f0c15c", "before them"))
    )
    return f'<div class="bar">{bar}</div>{table(("", ""), rows, numbers=(1,))}'


def _micro(text: str) -> str:
    return text.replace(" um", " µm")
