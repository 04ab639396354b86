"""Reading a scene as a whole: every problem at once, in the words of the scene; and writing it out again."""

import copy
import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from .. import units
from ..errors import ColdsprayError, SceneError
from ..physics import materials
from ..physics.adhesion import critical_velocity
from ..physics.materials import Material
from ..plan import cost as estimates
from .model import Scene, safe_name
from .tables import BySize, Particle, Quantity, Substrate

_EXAMPLES = {  # what a required field looks like; stands in for a faulty one while others are checked
    "particle": {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"},
    "substrate": {"material": "SS304"},
}
_COATING_EXAMPLE = {
    "coating": {"material": "Ni", "number": "40", "radius": "35 um", "diameter": "22 um", "velocity": "600 m/s"}
}
_GAS_EXAMPLE = {"gas": {"pressure": "40 bar", "temperature": "800 degC", "nozzle": "D42PBI"}}
_LEAST_WINDOW = 0.6  # particles' widths: the footprint of a splat
_EXTENT = ("diameter", "shape", "tilt")
_MOST_RECORDS = 5000
_LEAST_LAYERS = 2.0  # spacings across the thinnest part of a shape
_HOTTEST = 0.95  # of the melting point: beyond it Johnson-Cook has no strength left

Problem = tuple[tuple[str, ...], str]  # the fields it looked at, what is wrong


def checked(data: Mapping[str, Any], source: str) -> Scene:
    """A scene from nested dicts, or a SceneError with all its problems. source: what messages call it."""
    given = copy.deepcopy(dict(data))
    tables = given.get("materials", {})
    problems = []
    if not isinstance(tables, dict) or not all(isinstance(table, dict) for table in tables.values()):
        problems.append("materials: expected tables, such as [materials.MyNi]")
        given["materials"] = tables = {}
    catalogue, material_problems = materials.from_scene(tables)
    given.setdefault("name", safe_name(source))
    if "coating" in given:
        from .coating import expand

        problems += expand(given)
    if "gas" in given or "nozzles" in given:
        from .gas import fill

        problems += fill(given, catalogue)
    faulty: set[str] = set()
    try:
        scene: Scene | None = Scene.model_validate(given)
    except ValidationError as error:
        several = isinstance(given.get("particle"), list) and len(given["particle"]) > 1
        entries = error.errors(include_url=False)
        for entry in entries:
            problems.append(_in_words(entry, several))
            faulty.add(_dotted(entry["loc"], several))
        scene = _without(given, [entry["loc"] for entry in entries])
    problems += material_problems
    if scene is not None:
        own = {f"materials.{name}" for name in tables if name not in catalogue}
        for fields, problem in _whole(scene, catalogue, own):
            if not any(_covers(bad, field) for bad in faulty for field in fields):
                problems.append(problem)
    if problems or scene is None:
        raise SceneError(problems, source)
    return scene


def _whole(scene: Scene, catalogue: Mapping[str, Material], broken: set[str]) -> Iterator[Problem]:
    """Problems that only several fields together have, each with the fields it looked at."""
    bodies: list[tuple[str, Particle | Substrate]] = [("substrate", scene.substrate)]
    bodies[:0] = zip(scene.labels, scene.particles, strict=True)
    for where, body in bodies:
        material = catalogue.get(body.material)
        if material is None:
            if f"materials.{body.material}" not in broken:  # else its own problems are in the list already
                yield (
                    (f"{where}.material",),
                    f"{where}.material = {_shown(body.material)}: {materials.unknown(body.material, catalogue)}",
                )
        elif body.temperature > _HOTTEST * material.T_m:
            yield (
                (f"{where}.material", f"{where}.temperature"),
                f"{where}.temperature = {_text(body.temperature, 'K')}: must stay below {_HOTTEST:g} of the"
                f" melting point of {material.name}, {_HOTTEST * material.T_m:.0f} K",
            )
    yield from _room(scene)
    yield from _resolution(scene)
    yield from _adhesion(scene, catalogue)
    records = sum(scene.end_time_of(p) / scene.output_every_of(p) for p in scene.particles)
    if records > _MOST_RECORDS:
        yield (
            ("output.every", "end.time", *_fields(scene, "diameter", "velocity", "shape", "tilt")),
            f"output.every = {_text(scene.output_every_of(scene.particle), 'ns')}: would write {records:.3g} steps;"
            f" at most {_MOST_RECORDS}, so at least {units.rounded(scene.end_time / _MOST_RECORDS, 'ns')}",
        )


def _fields(scene: Scene, *names: str) -> tuple[str, ...]:
    """Fields of all particles, as messages call them."""
    return tuple(f"{label}.{name}" for label in scene.labels for name in names)


def _size(particle: Particle) -> str:
    return f"a particle of {units.rounded(max(particle.diameter, particle.width), 'um')}"


def _room(scene: Scene) -> Iterator[Problem]:
    """Whether every particle and its crater find room on the target."""
    substrate = scene.substrate
    across = [(max(p.diameter, p.width) + 2 * p.diameter, p) for p in scene.particles]
    deep = [(2 * p.diameter, p) for p in scene.particles]
    for name, extent, needs in (("diameter", substrate.diameter, across), ("height", substrate.height, deep)):
        least, particle = max(needs, key=lambda need: need[0])
        if extent < least * (1 - 1e-9):
            yield (
                (*_fields(scene, *_EXTENT), f"substrate.{name}"),
                f"substrate.{name} = {_text(extent, 'um')}: too small for {_size(particle)} and its crater;"
                f" at least {units.rounded(least, 'um')} is needed",
            )
    widest = max(scene.particles, key=lambda p: max(p.diameter, p.width))
    least = _LEAST_WINDOW * max(widest.diameter, widest.width)
    if substrate.window is not None and substrate.window < least * (1 - 1e-9):
        yield (
            (*_fields(scene, *_EXTENT), "substrate.window"),
            f"substrate.window = {_text(substrate.window, 'um')}: holds less than what {_size(widest)} covers;"
            f" at least {units.rounded(least, 'um')} is needed, and twice the diameter is of use",
        )
    for where, particle in zip(scene.labels, scene.particles, strict=True):
        D = particle.diameter
        away = math.hypot(*particle.offset)
        room = (substrate.diameter - D - max(D, particle.width)) / 2
        if away and away > room:
            yield (
                (*(f"{where}.{name}" for name in (*_EXTENT, "offset")), "substrate.diameter"),
                f"{where}.offset: {units.rounded(away, 'um')} off the axis takes {_size(particle)} and its crater"
                f" to the target's edge; at most {units.rounded(max(room, 0.0), 'um')}",
            )
        if scene.gap_of(particle) > D:
            yield (f"{where}.gap", f"{where}.diameter"), f"{where}.gap: more than the diameter of {_size(particle)}"


def _resolution(scene: Scene) -> Iterator[Problem]:
    """Whether the points and elements are fine enough for the smallest particle, and few enough for the machine."""
    smallest = min(scene.particles, key=lambda p: p.diameter)
    flattest = min(scene.particles, key=lambda p: p.form.thinnest)
    thinnest, spacing = flattest.form.thinnest, _text(scene.spacing, "um")
    needs = (*_fields(scene, "diameter"), "preset", "resolution.spacing")
    if scene.points_of(smallest) < estimates.LEAST_POINTS:
        largest = estimates.spacing(smallest.volume, estimates.LEAST_POINTS)
        yield (
            needs,
            f"resolution.spacing = {spacing}: gives {_size(smallest)} {scene.points_of(smallest)} points;"
            f" at least {estimates.LEAST_POINTS} are needed, so at most {units.rounded(largest, 'um')}",
        )
    elif thinnest < _LEAST_LAYERS * scene.spacing:
        yield (
            (*needs, *_fields(scene, "shape")),
            f"resolution.spacing = {spacing}: too coarse for {units.rounded(thinnest, 'um')}, the thinnest part of"
            f" this {flattest.shape}; at most {units.rounded(thinnest / _LEAST_LAYERS, 'um')}",
        )
    coarsest = smallest.diameter / 4
    for field, said in (("resolution", scene.resolution.element_size), ("splat", scene.splat.element_size)):
        if said is not None and said > coarsest:
            what = "crater" if field == "resolution" else "splat"
            yield (
                (*_fields(scene, "diameter"), f"{field}.element_size"),
                f"{field}.element_size = {_text(said, 'um')}: too coarse for the {what} of {_size(smallest)};"
                f" at most {units.rounded(coarsest, 'um')}",
            )
    # while the last impact runs, all splats before it are elements
    splats = sum(map(scene.splat_elements_of, scene.particles[:-1]))
    memory, there = estimates.memory(scene.points, scene.elements + splats), estimates.machine_memory()
    if memory > there:
        joined = f", {splats:.3g} of them in {len(scene.particles) - 1} splats," if splats else ""
        offsets = _fields(scene, "offset") if len(scene.particles) > 1 else ()
        yield (
            (
                *needs,
                *offsets,
                "resolution.element_size",
                "splat.element_size",
                "substrate.diameter",
                "substrate.height",
            ),
            f"resolution: {scene.points:.3g} points and {scene.elements + splats:.3g} elements{joined} need about"
            f" {memory / 1e9:.3g} GB of memory, this machine has {there / 1e9:.3g} GB;"
            " take a larger spacing and element_size, or a coarser preset",
        )


def _adhesion(scene: Scene, catalogue: Mapping[str, Material]) -> Iterator[Problem]:
    """Whether the table [adhesion] makes a law, and the materials have what its criterion looks at."""
    try:
        law = scene.adhesion_law
    except SceneError as error:
        for problem in error.problems:
            field = f"adhesion.{problem.split()[0]}"
            yield (field, "adhesion.kind", "adhesion.criterion"), f"adhesion.{problem}"
        return
    if law.criterion != "velocity" or law.kind == "none":
        return
    hits = {p.material: (label, p.temperature) for label, p in zip(scene.labels, scene.particles, strict=True)}
    for name, (label, temperature) in hits.items():
        try:
            if name in catalogue:
                critical_velocity(catalogue[name], temperature)
        except ColdsprayError as error:
            yield ("adhesion.criterion", f"{label}.material"), f'adhesion.criterion = "velocity": {error}'


def _without(given: dict[str, Any], faulty: list[tuple[int | str, ...]]) -> Scene | None:
    """The scene with its faulty fields replaced, so that the others can be checked against each other."""
    mended = copy.deepcopy(given)
    particles = mended.get("particle")
    mended["particle"] = particles if isinstance(particles, list) else [particles]
    for section, *inner in faulty:
        table = mended.get(str(section))
        if section == "particle" and inner and isinstance(table, list):
            table, *inner = table[int(inner[0])], *inner[1:]
            if inner and isinstance(table, dict):
                table.pop(inner[0], None)
        elif (
            section in ("gas", "nozzles", "coating") or not inner
        ):  # what those two say of the particle is in it already
            mended.pop(str(section), None)
        elif isinstance(table, dict):
            table.pop(inner[0], None)
    mended["particle"] = [
        _EXAMPLES["particle"] | (particle if isinstance(particle, dict) else {})
        for particle in mended.get("particle") or [{}]
    ]
    substrate = mended.get("substrate")
    mended["substrate"] = _EXAMPLES["substrate"] | (substrate if isinstance(substrate, dict) else {})
    try:
        return Scene.model_validate(mended)
    except ValidationError:
        return None


def _covers(bad: str, field: str) -> bool:
    return bad == field or field.startswith((f"{bad}.", f"{bad}[")) or bad.startswith(f"{field}[")


def _dotted(loc: tuple[int | str, ...], several: bool) -> str:
    """A field as people write it, counted from 1; several: the scene has more than one particle."""
    parts = [p for i, p in enumerate(loc) if several or not (i == 1 and loc[0] == "particle" and isinstance(p, int))]
    text = "".join(f"[{p + 1}]" if isinstance(p, int) else f".{p}" for p in parts)
    return text.removeprefix(".")


def _in_words(entry: Any, several: bool) -> str:
    """One of pydantic's errors as a line a process engineer understands."""
    kind, loc = entry["type"], entry["loc"]
    field = _dotted(loc if kind != "extra_forbidden" else (*loc[:-1], _shown(loc[-1])[1:-1]), several)
    model = _model_at(loc[:-1])
    if kind == "extra_forbidden":
        known = [info.alias or name for name, info in model.model_fields.items()]
        return f"{field}: unknown key{units.nearest(str(loc[-1]), known)}; known: {', '.join(known)}"
    if "offset" in loc and kind != "value_error":
        where = _dotted(loc[: loc.index("offset") + 1], several)
        return f'{where}: expected two lengths, such as ["0 um", "0 um"]'
    if kind == "missing":
        if field in _EXAMPLES:
            return f"{field}: missing; add a table [{field}]"
        example = (_EXAMPLES | _GAS_EXAMPLE | _COATING_EXAMPLE).get(str(loc[0]), {}).get(str(loc[-1]), "...")
        return f'{field}: missing; add for example {loc[-1]} = "{example}"'
    start = f"{field} = {_shown(entry['input'])}"
    if kind == "literal_error":
        info = model.model_fields[str(loc[-1])]
        choices = [choice for choice in _choices(info.annotation) if choice is not None]
        return f"{start}: expected one of {', '.join(choices)}{units.nearest(str(entry['input']), choices)}"
    if kind == "value_error":
        text = str(entry["ctx"]["error"])
        if loc in (("particle",), ("coating",)):  # a whole table is no answer to what is wrong with it
            return f"{field} {text}"
        return f"{start} {text}" if text.startswith(("is ", "has ", "needs ", "would ")) else f"{start}: {text}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        table = f"[[{loc[0]}]]" if several and loc[0] == "particle" else f"[{field}]"
        return f"{start}: expected a table {table}"
    if kind == "string_pattern_mismatch":
        return f"{start}: use letters, digits, '_', '.', '-', spaces (at most 64, a letter or digit first)"
    if kind in ("float_type", "finite_number", "greater_than_equal", "less_than_equal") and field == "contact.friction":
        return f"{start}: expected a number without unit, from 0 to 2"
    return f"{start}: {entry['msg'][0].lower()}{entry['msg'][1:]}"


def _model_at(loc: tuple[int | str, ...]) -> type[BaseModel]:
    if not loc or loc[0] not in (names := {info.alias or n: n for n, info in Scene.model_fields.items()}):
        return Scene
    annotation = Scene.model_fields[names[str(loc[0])]].annotation
    inner = getattr(annotation, "__args__", (annotation,))[0]
    return inner if isinstance(inner, type) and issubclass(inner, BaseModel) else Scene


def _choices(annotation: Any) -> list[Any]:
    """The values of a Literal, or of a union with one in it."""
    found: list[Any] = []
    for arg in getattr(annotation, "__args__", ()):
        found += _choices(arg) if getattr(arg, "__args__", None) else [arg] if isinstance(arg, str) else []
    return found


def _shown(value: object) -> str:
    """A stranger's value in a message: short, and without control characters."""
    try:
        text = json.dumps(value, default=str)
    except (ValueError, RecursionError):
        text = "..."
    return text if len(text) <= 60 else f"{text[:56]}..."


def _text(value: float, unit: str) -> str:
    return f'"{units.rounded(value, unit, 6)}"'


def to_toml(scene: Scene) -> str:
    """The scene as TOML with its defaults written out; what follows from other values stands in comments."""
    lines = [f'name = "{scene.name}"', f'preset = "{scene.preset}"', f"effects = {json.dumps(scene.effects)}"]
    head = "[particle]" if len(scene.particles) == 1 else "[[particle]]"
    tables: list[tuple[str, BaseModel | None]] = [(head, particle) for particle in scene.particles]
    for section in ("coating", "gas", "substrate", "contact", "adhesion", "splat", "resolution", "end", "output"):
        tables.append((f"[{section}]", getattr(scene, section)))
    for head, table in tables:
        if table is None:
            continue
        lines += ["", head]
        if head == "[gas]":
            lines.append("# takes effect again once the particle's velocity and temperature above are deleted")
        if head == "[coating]":
            lines.append("# takes effect again once the tables [[particle]] above are deleted: they are made of it")
        derived = _derived(scene, head, table)
        for field in type(table).model_fields:
            value = getattr(table, field)
            if value is not None:
                lines.append(f"{field} = {_written(table, field, value)}")
            elif field in derived:
                lines.append(f"# {field} = {derived[field]}")
    for kind in ("materials", "nozzles"):
        for name, fields in getattr(scene, kind).items():
            lines += ["", f"[{kind}.{json.dumps(name)}]"]
            lines += [f"{json.dumps(field)} = {json.dumps(value)}" for field, value in fields.items()]
    return "\n".join(lines) + "\n"


def _written(table: BaseModel, field: str, value: Any) -> str:
    """A value as the scene says it."""
    by_size = next((m for m in type(table).model_fields[field].metadata if isinstance(m, BySize)), None)
    if by_size is not None:
        pairs = [[units.show(size, "um"), units.show(number, by_size.of.unit)] for size, number in value]
        return json.dumps(pairs[0][1] if len(value) == 1 and value[0][0] == 0.0 else pairs)
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(name)} = {json.dumps(item)}" for name, item in value.items()) + " }"
    quantity = next((m for m in type(table).model_fields[field].metadata if isinstance(m, Quantity)), None)
    if field == "offset":
        return json.dumps([units.show(x, "um") for x in value])
    if field == "threshold" and getattr(table, "criterion", "") == "pressure":
        return json.dumps(units.show(value, "MPa"))
    return json.dumps(units.show(value, quantity.unit) if quantity else value)


def _derived(scene: Scene, head: str, table: BaseModel) -> dict[str, str]:
    """What takes the place of the fields that a table leaves out, each with where it comes from."""
    if isinstance(table, Particle):
        return {"gap": f"{_text(scene.gap_of(table), 'um')}  (from: half a spacing)"}
    first, each = scene.particle, ", of the first impact" if len(scene.particles) > 1 else ""
    every, end = scene.output_every_of(first), scene.end_time_of(first)
    return {
        "[adhesion]": {"kind": f'"{scene.adhesion_law.kind}"  (from: the number of particles)'},
        "[splat]": {"element_size": f"{_text(scene.splat_element_size, 'um')}  (from: the target's)"},
        "[resolution]": {
            "spacing": f"{_text(scene.spacing, 'um')}  (from: preset)",
            "element_size": f"{_text(scene.element_size, 'um')}  (from: spacing)",
        },
        "[end]": {"time": f"{_text(end, 'ns')}  (from: 3 diameter / velocity at most{each})"},
        "[output]": {"every": f"{_text(every, 'ns')}  (from: diameter / velocity / 25{each})"},
    }.get(head, {})
