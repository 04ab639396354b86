"""Parts of the report as HTML: tables and lists. Texts that come from a run are escaped here."""

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape

from numpy.typing import NDArray

from ..errors import StoreError
from ..files.inputs import parse_toml, read_json_object
from ..files.result import PROPERTIES_FILE, Result
from ..files.summary import Summary, Values
from ..measures import PROPERTIES, measure
from . import words
from .words import Line, brief, columns, errors_of, impacts, plain, shown, span, table_lines

FRONT_ROWS = 8  # most particles in the first section of the page
SIDE_BY_SIDE = 6  # most impacts that are columns of one table
# Constants of a material: name, meaning, factor from SI to the display unit, unit.
CONSTANTS = (
    ("rho", "density", 1.0, "kg/m³"),
    ("G", "shear modulus", 1e-9, "GPa"),
    ("K", "bulk modulus, ρ c₀²", 1e-9, "GPa"),
    ("c0", "sound speed c₀ of the shock relation", 1.0, "m/s"),
    ("s", "slope s of the shock relation", 1.0, ""),
    ("Gamma0", "Grüneisen coefficient", 1.0, ""),
    ("T_m", "melting point", 1.0, "K"),
    ("taylor_quinney", "share of plastic work that becomes heat", 1.0, ""),
)


class Html(str):
    """HTML text of a cell, which `table` does not escape."""


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: Sequence[int] = (),
    off: Sequence[int] = (),
    stack: bool = False,
) -> str:
    """A table of texts. numbers: indices of right-aligned columns; off: indices of grey rows; a head whose texts are all empty is
    left out. stack: on a narrow screen the cells of a row appear one below the other, each after its column heading."""
    kinds = ["n" if k in numbers else "" for k in range(len(head))]
    above = f"<thead>{_row(head, kinds, 'th')}</thead>" if any(head) else ""
    heads = head if stack else ()
    body = "".join(_row(row, kinds, kind="off" * (k in off), heads=heads) for k, row in enumerate(rows))
    return f'<div class="wide{" stack" * stack}"><table>{above}<tbody>{body}</tbody></table></div>'


def _row(cells: Sequence[str], kinds: Sequence[str], tag: str = "td", kind: str = "", heads: Sequence[str] = ()) -> str:
    """A row of a table. kinds: CSS class of each cell or ""; kind: class of the row; heads: headings of columns, for stacked cells."""

    def of(name: str, attribute: str = "class") -> str:
        return f' {attribute}="{escape(name)}"' if name else ""

    inner = "".join(
        f"<{tag}{of(kinds[k])}{of(heads[k] if heads else '', 'data-head')}>"
        f"{cell if isinstance(cell, Html) else escape(cell)}</{tag}>"
        for k, cell in enumerate(cells)
    )
    return f"<tr{of(kind)}>{inner}</tr>"


def front(summary: Summary) -> str:
    """The main measures with their errors. For several impacts there is a row for each of the first FRONT_ROWS impacts."""
    (head, *rows), count = brief(summary, FRONT_ROWS, with_errors=True), len(summary["impacts"])
    more = f"{count - len(rows)} more in the section Impacts" if 1 < count > len(rows) else ""
    note = escape("; ".join(text for text in (more, words.of_run(summary), words.error_note(summary)) if text))
    below = f'<p class="caption">{note}</p>' if note else ""
    return table(head, rows, range(1, len(head) - (count == 1)), stack=count > 1) + below


def so_far(history: Mapping[str, NDArray]) -> str:
    """The last row of the history, for a run without a summary."""
    rows = words.last_row(history)
    return table(("last line of the history", "", ""), rows, numbers=(1,)) if rows else ""


def measures(summary: Summary) -> str:
    """All measures of a run, with one table for each group. For a single impact: with their errors, if these are known. For several
    impacts: only the measures of the whole run."""
    is_one = len(summary.get("impacts", [])) == 1
    blocks = columns(summary) if is_one or not summary else {"": plain(summary["run"])}
    errors = errors_of(summary) if is_one else {}
    tables = []
    for group, lines in table_lines(list(blocks.values()), errors).items():
        used = [k for k in range(len(blocks)) if any(line.cells[k] for line in lines)]
        heads = [list(blocks)[k] for k in used] if len(used) > 1 else [""] * len(used)
        rows = [[line.label, *(line.cells[k] for k in used), line.unit] for line in lines]
        tables.append(table([group.capitalize(), *heads, ""], rows, numbers=range(1, 1 + len(used))))
    note = items(words.remarks(summary), "caption")
    return f'<div class="measures">{"".join(tables)}</div>{note}' if tables or note else ""


def side_by_side(groups: Mapping[str, Sequence[Line]], headings: Sequence[str]) -> str:
    """Table of groups of measures (`words.table_lines`), with one column for each heading; "" if there are no groups."""
    rows: list[list[str]] = []
    heads = []  # rows with the name of a group, in grey
    for group, lines in groups.items():
        heads.append(len(rows))
        rows.append([group.capitalize(), *[""] * len(headings)])
        rows += [[f"{line.label}, {line.unit}" if line.unit else line.label, *line.cells] for line in lines]
    return table(["", *headings], rows, range(1, len(headings) + 1), off=heads, stack=True) if rows else ""


def each_impact(summary: Summary) -> str:
    """Table of all impacts: up to SIDE_BY_SIDE as columns with all measures; more as rows with the main measures. "" for one impact."""
    entries = impacts(summary)
    if len(entries) > SIDE_BY_SIDE:
        head, *rows = brief(summary)
        return table(head, rows, range(1, len(head)), stack=True)
    numeric = {key for entry in entries for key, value in entry.items() if isinstance(value, int | float)}
    groups = table_lines([{k: v for k, v in entry.items() if k in numeric} for entry in entries])
    return side_by_side(groups, [f"impact {k + 1}" for k in range(len(entries))]) if len(entries) > 1 else ""


def cold(summary: Summary, coating: Sequence[tuple[str, str]]) -> str:
    """Results of the closing stage, and the lines of `coating` about stress."""
    closing, lines = summary.get("closing", {}), [c for c in coating if "stress" in c[0] or c[0] == "measured"]
    for key, label in (
        ("T_max_before_K", "highest temperature before cooling to ambient"), ("ambient_K", "ambient temperature"),
        ("overlap_m", "deepest overlap of bodies"),
    ):  # fmt: skip
        if key in closing:
            lines.append((label, f"{closing[key] * measure(key).factor:.4g} {measure(key).unit}"))
    return definitions(lines)


def properties(result: Result) -> str:
    """Effective properties of the coating, from `properties.json`; "" if there is no such file. Raises StoreError if it is damaged."""
    path = result.directory / PROPERTIES_FILE
    if not path.is_file():
        return ""
    data: Values = read_json_object(path)
    try:
        values = next(iter(data["runs"].values()))["values"].items()
        lines = [
            (f"{PROPERTIES[kind][0]}, {' '.join(where)}", f"{of['mixed'] / of['bulk']:.0%} of the bulk")
            for (kind, *where), of in ((key.split("_"), of) for key, of in values)
        ]
        lines += [
            (f"strength, {pull['direction'].replace('_', ' ')}", f"{1e-6 * pull['strength_Pa']:.0f} MPa")
            for pull in data.get("pull", []) if pull["film"] in (None, 1.0)
        ]  # fmt: skip
    except (AttributeError, KeyError, StopIteration, TypeError, ZeroDivisionError) as error:
        raise StoreError(f"{path} is damaged: compute the properties again") from error
    return definitions(lines)


def scene_of(result: Result) -> Values:
    """The scene of a run as nested dicts; empty if it cannot be read."""
    try:
        return parse_toml(result.scene_text)
    except (StoreError, ValueError):
        return {}


def conditions(result: Result) -> str:
    """Particles, target, contact, adhesion, end and resolution from the plan of the run; "" if there is no plan."""
    plan = result.plan
    if not plan:
        return ""
    bodies, target, gas = plan["impacts"], plan["target"], plan["gas"]
    lines = [(f"particle {k}" if len(bodies) > 1 else "particle", _particle(body)) for k, body in enumerate(bodies, 1)]
    if len(bodies) > FRONT_ROWS:
        reach = max(math.hypot(*body["offset"]) for body in bodies)
        heat = span([body["temperature"] for body in bodies])
        lines = [("particles", f"{words.title(result)}; {heat} K, centres within {reach * 1e6:.3g} µm of the axis")]
    faces = f"sides {target['sides']}, bottom {target['bottom']}"
    size = f"{target['diameter'] * 1e6:g} µm across, {target['height'] * 1e6:g} µm high, {target['temperature']:g} K"
    layers = "".join(f", {metal['name']} {1e6 * thick:g} µm" for metal, thick in target.get("layers") or ())
    lines += [("target", f"{target['material']['name']} cylinder, {size}{layers}, {faces}")]
    lines += [("gas", "; ".join(map(str, gas)))] if gas and len(gas) <= 2 else []
    lines += [("spray", str(plan.get("spray", "")))]
    can_bond = plan["adhesion"]["kind"] != "none"
    bond = {key: value for key, value in plan["adhesion"].items() if can_bond and value not in (None, [])}
    law = (f"{key.replace('_', ' ')} {shown(key, value)}".removeprefix("kind ") for key, value in bond.items())
    lines += [("adhesion", ", ".join(law) or "none"), ("contact", f"friction {plan['friction']:g}")]
    ends = {"rest": "at rest, at most ", "greatest": "at the greatest deformation, at most "}
    times = f"{span([1e9 * body['end_time'] for body in bodies])} ns after the start of an impact"
    lines += [("ends", ends.get(bodies[0]["end_at"], "") + times)]
    resolution = (f"preset {plan['preset']}", *_resolution(plan, result.summary), f"engine {plan['engine']}")
    lines += [("resolution", ", ".join(resolution))]
    off = [name.replace("_", " ") for name, on in plan["effects"].items() if on is False]
    lines += [("effects", f"without {', '.join(off)}" if off else "all on")]
    return definitions(lines)


def _resolution(plan: Values, summary: Summary) -> list[str]:
    """Two texts: the numbers of points of all particles with their spacings, and the element sizes of the substrate."""
    both = list(zip(plan["impacts"], summary.get("impacts") or [{}] * len(plan["impacts"]), strict=False))
    points = [own.get("points", planned["points"]) for planned, own in both]
    spacings = [own.get("spacing_m", planned["spacing"]) for planned, own in both]
    ends = [f"{n:,}".replace(",", " ") for n in sorted({min(points), max(points)})]
    size = plan["target"]["element_size"]
    return [
        f"{' to '.join(ends)} points{' each' * (len(points) > 1)}, spacing {span([1e6 * s for s in spacings])} µm",
        f"elements of {1e6 * size:.3g} µm in the substrate",
    ]


def definitions(lines: Iterable[tuple[str, str]]) -> str:
    """A definition list of (term, text); empty texts are left out."""
    return f"<dl>{''.join(f'<dt>{escape(word)}</dt><dd>{escape(text)}</dd>' for word, text in lines if text)}</dl>"


def _particle(body: Values) -> str:
    speed, (x, y) = math.hypot(*body["velocity"]), (1e6 * each for each in body["offset"])
    towards = -math.fsum(v * n for v, n in zip(body["velocity"], body.get("normal", (0.0, 0.0, 1.0)), strict=True))
    angle = math.degrees(math.acos(min(towards / speed, 1.0)))
    texts = [
        f"{1e6 * body['diameter']:.3g} µm {body['material']['name']} {body['shape'].replace('_', ' ')}",
        f"{speed:.4g} m/s at {angle:.3g}° from the surface normal",
        f"{body['temperature']:.4g} K",
        f"offset ({x:.3g}, {y:.3g}) µm" if x or y else "",
        f"tilt {math.degrees(body['tilt']):.3g}°" if body["tilt"] else "",
        f"initial plastic strain {body['initial_strain']:.3g}" if body["initial_strain"] else "",
        f"core of {core['material']['name']}, {core['share']:.3g} of its volume" if (core := body.get("core")) else "",
    ]
    return ", ".join(text for text in texts if text)


def provenance(summary: Summary) -> str:
    """Date, program, machine, scene and command of a result; "" if they are not known."""
    record = summary.get("provenance") or {}
    if not record:
        return ""
    versions = {str(k): str(v) for k, v in (record.get("versions") or {}).items()}
    commit, seed = (str(record.get(key) or "") for key in ("commit", "seed"))
    program = f"coldspray {versions.pop('coldspray', '')}, commit {commit[:12] or 'unknown'}{commit[40:]}"
    lines = [
        ("computed", f"{record.get('date')} by {program}"),
        ("on", f"{record.get('host')}, {record.get('processor')}, {record.get('cores')} cores, {record.get('system')}"),
        ("with", ", ".join(f"{name} {version}" for name, version in versions.items())),
        ("scene", f"sha256 {str(record.get('scene_sha256'))[:16]}" + (f", seed {seed}" if seed else "")),
        ("command", str(record.get("command"))[:200]),
    ]
    return definitions(lines)


def effects(result: Result) -> str:
    """The effects that are on or off in the run, with the reasons, from the plan of the run."""
    if not result.plan:
        return '<p class="note">Not known: this run has no readable plan.json.</p>'
    rows = []
    for row in result.plan["decisions"]:
        number = f"{row['number']} = {row['value']:.3g}"
        rows.append((row["name"].replace("_", " "), "on" if row["on"] else "off", number, row["why"]))
    off = [k for k, row in enumerate(rows) if row[1] == "off"]
    return table(("effect", "", "decided by", "because"), rows, off=off, stack=True)


def material_data(result: Result) -> str:
    """The constants of the materials with their sources, as a part that the reader can open; "" if there is no plan."""
    if not result.plan:
        return ""
    cores = [body["core"] for body in result.plan["impacts"] if body.get("core")]
    target = result.plan["target"]
    layers = [{"material": metal} for metal, _ in target.get("layers") or ()]
    bodies = [body["material"] for body in (*result.plan["impacts"], *cores, *layers, target)]
    metals = {m["name"]: m | {"K": m["rho"] * m["c0"] ** 2} for m in bodies}
    each = metals.values()
    rows = [(label, *(f"{m[key] * factor:.4g}" for m in each), unit) for key, label, factor, unit in CONSTANTS]
    for law in dict.fromkeys(metal["strength"]["law"] for metal in metals.values()):
        own = [m["strength"]["numbers"] if m["strength"]["law"] == law else {} for m in metals.values()]
        name = law.replace("_", " ")
        rows += [(f"{name} {key}", *(f"{n[key]:.4g}" if n else "" for n in own), "") for key in max(own, key=len)]
    sources = "".join(
        f'<p class="caption">{escape(name)}: {escape(m["source"] or "no source given")}. {escape(m["note"])}'
        f" Strength: {escape(m['strength']['source'] or 'no source given')}.</p>"
        for name, m in metals.items()
    )
    whole = table(["", *metals, ""], rows, numbers=range(1, len(metals) + 1))
    return f"<details><summary>Material data and their sources</summary>{whole}{sources}</details>"


def warnings(texts: Sequence[object] | None) -> str:
    """The warnings of a run or of its plan; "" if there are none."""
    return f'<div class="warn">{items(map(str, texts))}</div>' if texts else ""


def items(texts: Iterable[str], kind: str = "") -> str:
    """A list of texts; "" if there are none. kind: CSS class."""
    lines = "".join(f"<li>{escape(text)}</li>" for text in texts)
    head = f'<ul class="{kind}">' if kind else "<ul>"
    return f"{head}{lines}</ul>" if lines else ""


def pace(values: Values) -> str:
    """Text with the wall time of a step and what limits the time step, from `Result.values`; "" if these are not known."""
    loop, steps, simulated = (values.get(key) for key in ("wall_loop_s", "steps", "sim_time_s"))
    if not (loop and steps and simulated):
        return ""
    limits = {name: n for name, n in (values.get("dt_limited_by") or {}).items() if n}
    limited = ", ".join(f"{name} {n / sum(limits.values()):.0%}" for name, n in limits.items())
    text = f"{shown('steps', int(steps))} steps of {loop / steps * 1e3:.3g} ms"
    text = f"{text}; 1 ns took {loop / (simulated * 1e9):.3g} s. The time step is set by: {limited}."
    return f'<p class="caption">{escape(text)}</p>'
