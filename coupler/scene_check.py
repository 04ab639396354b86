"""Reading a scene as a whole: every problem at once, in the words of the scene; and writing it out again."""

import copy
import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from . import estimates, materials, units
from .errors import SceneError
from .materials import Material
from .scene import Quantity, Scene, safe_name

_EXAMPLES = {  # what a required field looks like; stands in for a faulty one while others are checked
    "particle": {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"},
    "substrate": {"material": "SS304"},
}
_GAS_EXAMPLE = {"gas": {"pressure": "40 bar", "temperature": "800 degC", "nozzle": "D42PBI"}}
_EXTENT = ("particle.diameter", "particle.shape", "particle.tilt")
_MOST_RECORDS = 5000
_LEAST_LAYERS = 2.0  # spacings across the thinnest part of a shape
_HOTTEST = 0.95  # of the melting point: beyond it Johnson-Cook has no strength left


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
    if "gas" in given or "nozzles" in given:
        from .scene_gas import fill

        problems += fill(given, catalogue)
    faulty: set[str] = set()
    try:
        scene: Scene | None = Scene.model_validate(given)
    except ValidationError as error:
        for entry in error.errors(include_url=False):
            problems.append(_in_words(entry))
            faulty.add(_dotted(entry["loc"]))
        scene = _without(given, faulty)
    problems += material_problems
    if scene is not None:
        own = {f"materials.{name}" for name in tables if name not in catalogue}
        for fields, problem in _whole(scene, catalogue, own):
            if not any(_covers(bad, field) for bad in faulty for field in fields):
                problems.append(problem)
    if problems or scene is None:
        raise SceneError(problems, source)
    return scene


def _whole(scene: Scene, catalogue: Mapping[str, Material], broken: set[str]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Problems that only several fields together have, each with the fields it looked at."""
    particle, substrate = scene.particle, scene.substrate
    D = particle.diameter
    size = f"a particle of {units.rounded(max(D, scene.width), 'um')}"
    for where, body in (("particle", particle), ("substrate", substrate)):
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
    wide = max(D, scene.width)
    for name, extent, least in (("diameter", substrate.diameter, wide + 2 * D), ("height", substrate.height, 2 * D)):
        if extent < least * (1 - 1e-9):
            yield (
                (*_EXTENT, f"substrate.{name}"),
                f"substrate.{name} = {_text(extent, 'um')}: too small for {size} and its crater;"
                f" at least {units.rounded(least, 'um')} is needed",
            )
    away = math.hypot(*particle.offset)
    room = (substrate.diameter - D - wide) / 2
    if away and away > room:
        yield (
            (*_EXTENT, "particle.offset", "substrate.diameter"),
            f"particle.offset: {units.rounded(away, 'um')} off the axis takes {size} and its crater"
            f" to the target's edge; at most {units.rounded(max(room, 0.0), 'um')}",
        )
    if scene.gap > D:
        yield ("particle.gap", "particle.diameter"), f"particle.gap: more than the diameter of {size}"
    yield from _resolution(scene, size)
    records = scene.end_time / scene.output_every
    if records > _MOST_RECORDS:
        yield (
            ("output.every", "end.time", "particle.diameter", "particle.velocity"),
            f"output.every = {_text(scene.output_every, 'ns')}: would write {records:.3g} steps;"
            f" at most {_MOST_RECORDS}, so at least {units.rounded(scene.end_time / _MOST_RECORDS, 'ns')}",
        )


def _resolution(scene: Scene, size: str) -> Iterator[tuple[tuple[str, ...], str]]:
    D = scene.particle.diameter
    spacing, element_size = _text(scene.spacing, "um"), _text(scene.element_size, "um")
    needs = ("particle.diameter", "preset", "resolution.spacing")
    if scene.points < estimates.LEAST_POINTS:
        largest = estimates.spacing(estimates.sphere_volume(D), estimates.LEAST_POINTS)
        yield (
            needs,
            f"resolution.spacing = {spacing}: gives {size} {scene.points} points;"
            f" at least {estimates.LEAST_POINTS} are needed, so at most {units.rounded(largest, 'um')}",
        )
    elif scene.form.thinnest < _LEAST_LAYERS * scene.spacing:
        thin = f"{units.rounded(scene.form.thinnest, 'um')}, the thinnest part of this {scene.particle.shape}"
        yield (
            (*needs, "particle.shape"),
            f"resolution.spacing = {spacing}: too coarse for {thin};"
            f" at most {units.rounded(scene.form.thinnest / _LEAST_LAYERS, 'um')}",
        )
    if scene.resolution.element_size is not None and scene.element_size > D / 4:
        yield (
            ("particle.diameter", "resolution.element_size"),
            f"resolution.element_size = {element_size}: too coarse for the crater of {size};"
            f" at most {units.rounded(D / 4, 'um')}",
        )
    memory, there = estimates.memory(scene.points, scene.elements), estimates.machine_memory()
    if memory > there:
        yield (
            (*needs, "resolution.element_size", "substrate.diameter", "substrate.height"),
            f"resolution: {scene.points:.3g} points and {scene.elements:.3g} elements need about"
            f" {memory / 1e9:.3g} GB of memory, this machine has {there / 1e9:.3g} GB;"
            " take a larger spacing and element_size, or a coarser preset",
        )


def _without(given: dict[str, Any], faulty: set[str]) -> Scene | None:
    """The scene with its faulty fields replaced, so that the others can be checked against each other."""
    mended = copy.deepcopy(given)
    particle = mended.get("particle")
    if isinstance(particle, list):
        mended["particle"] = particle[0] if particle else {}
    for dotted in faulty:
        section, _, field = dotted.partition(".")
        if section in ("gas", "nozzles"):  # what they say of the particle is in it already
            mended.pop(section, None)
            continue
        if field and isinstance(mended.get(section), dict):
            mended[section].pop(field.partition("[")[0], None)
        elif not field:
            mended.pop(section, None)
    for section, example in _EXAMPLES.items():
        mended[section] = example | mended.get(section, {}) if isinstance(mended.get(section, {}), dict) else example
    try:
        return Scene.model_validate(mended)
    except ValidationError:
        return None


def _covers(bad: str, field: str) -> bool:
    return bad == field or field.startswith((f"{bad}.", f"{bad}[")) or bad.startswith(f"{field}[")


def _dotted(loc: tuple[int | str, ...]) -> str:
    parts = [p for i, p in enumerate(loc) if not (i == 1 and loc[0] == "particle" and isinstance(p, int))]
    text = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in parts)
    return text.removeprefix(".")


def _in_words(entry: Any) -> str:
    """One of pydantic's errors as a line a process engineer understands."""
    kind, loc = entry["type"], entry["loc"]
    field = _dotted(loc) if kind != "extra_forbidden" else _dotted((*loc[:-1], _shown(loc[-1])[1:-1]))
    model = _model_at(loc[:-1])
    if kind == "extra_forbidden":
        known = [info.alias or name for name, info in model.model_fields.items()]
        return f"{field}: unknown key{units.nearest(str(loc[-1]), known)}; known: {', '.join(known)}"
    if field.startswith("particle.offset") and kind != "value_error":
        return 'particle.offset: expected two lengths, such as ["0 um", "0 um"]'
    if kind == "missing":
        if field in _EXAMPLES:
            return f"{field}: missing; add a table [{field}]"
        example = (_EXAMPLES | _GAS_EXAMPLE).get(str(loc[0]), {}).get(str(loc[-1]), "...")
        return f'{field}: missing; add for example {loc[-1]} = "{example}"'
    start = f"{field} = {_shown(entry['input'])}"
    if kind == "literal_error":
        info = model.model_fields[str(loc[-1])]
        choices = [choice for choice in _choices(info.annotation) if choice is not None]
        return f"{start}: expected one of {', '.join(choices)}{units.nearest(str(entry['input']), choices)}"
    if kind == "value_error":
        text = str(entry["ctx"]["error"])
        return f"{start} {text}" if text.startswith(("is ", "has ", "needs ", "would ")) else f"{start}: {text}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"{start}: expected a table [{field}]"
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
    derived = {
        "gap": (scene.gap, "um", "half a spacing"),
        "spacing": (scene.spacing, "um", "preset"),
        "element_size": (scene.element_size, "um", "spacing"),
        "every": (scene.output_every, "ns", "diameter / velocity / 25"),
        "time": (scene.end_time, "ns", "3 diameter / velocity at most"),
    }
    lines = [f'name = "{scene.name}"', f'preset = "{scene.preset}"', f"effects = {json.dumps(scene.effects)}"]
    for section in ("particle", "gas", "substrate", "contact", "resolution", "end", "output"):
        table: BaseModel | None = getattr(scene, section)
        if table is None:
            continue
        lines += ["", f"[{section}]"]
        if section == "gas":
            lines.append("# takes effect again once the particle's velocity and temperature above are deleted")
        for field, info in type(table).model_fields.items():
            value = getattr(table, field)
            quantity = next((m for m in info.metadata if isinstance(m, Quantity)), None)
            if field == "offset":
                lines.append(f"offset = {json.dumps([units.show(x, 'um') for x in value])}")
            elif value is not None:
                lines.append(f"{field} = {json.dumps(units.show(value, quantity.unit) if quantity else value)}")
            elif field in derived:
                number, unit, why = derived[field]
                lines.append(f'# {field} = "{units.rounded(number, unit, 6)}"  (from: {why})')
    for kind in ("materials", "nozzles"):
        for name, fields in getattr(scene, kind).items():
            lines += ["", f"[{kind}.{json.dumps(name)}]"]
            lines += [f"{json.dumps(field)} = {json.dumps(value)}" for field, value in fields.items()]
    return "\n".join(lines) + "\n"
