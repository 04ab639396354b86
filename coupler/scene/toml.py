"""A scene as TOML, with its defaults written out."""

import json
from collections.abc import Callable, Mapping
from typing import Any

from .. import units
from .model import SceneData
from .tables import BySize, Quantity, Section


def to_toml(scene: SceneData, derived: Callable[[str, Section], Mapping[str, str]]) -> str:
    """The scene as TOML with its defaults written out.

    derived(heading, table): of the fields that a table leaves out, the value that takes their place; comments in the text.
    """
    lines = [f'name = "{scene.name}"', f'preset = "{scene.preset}"', f"effects = {json.dumps(scene.effects)}"]
    head = "[particle]" if len(scene.particles) == 1 else "[[particle]]"
    tables: list[tuple[str, Section | None]] = [(head, particle) for particle in scene.particles]
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
        defaults = derived(head, table)
        for field in type(table).model_fields:
            value = getattr(table, field)
            if value is not None:
                lines.append(f"{field} = {_written(table, field, value)}")
            elif field in defaults:
                lines.append(f"# {field} = {defaults[field]}")
    for kind in ("materials", "nozzles"):
        for name, fields in getattr(scene, kind).items():
            lines += ["", f"[{kind}.{json.dumps(name)}]"]
            lines += [f"{json.dumps(field)} = {json.dumps(value)}" for field, value in fields.items()]
    return "\n".join(lines) + "\n"


def _written(table: Section, field: str, value: Any) -> str:
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
