"""Writes docs/guide/scene.md, a scene key by key, from the models that read scenes: python workflows/scene_page.py [FILE]

Types, units, limits and defaults are those of the models; the descriptions are in coupler/scene/words.toml. `make docs` runs it first.
"""

import dataclasses
import json
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from coupler import units
from coupler.physics import materials
from coupler.physics.strength import LAWS, Parameter
from coupler.plan import cost as estimates
from coupler.plan.reading import Scene
from coupler.scene.json_schema import words
from coupler.spray import nozzles

Entry = Mapping[str, Any]  # of a key in the schema
SCHEMA = Scene.model_json_schema()
PAGE = Path(__file__).parents[1] / "docs" / "guide" / "scene.md"
SAME = "as in `[particle]`"  # words of keys that share a row
DEFAULTS = {  # numbers of the plan, in words
    "preset": "; points of the largest particle: " + ", ".join(f"`{p}` {n}" for p, n in estimates.PRESETS.items()),
    "substrate.window": f"; {estimates.WINDOW_OVER_DIAMETER:g} diameters from {estimates.MANY} particles on, else the whole target",
    "resolution.element_size": f"; {estimates.ELEMENT_SIZE_OVER_SPACING} spacings by default",
}


def page() -> str:
    """The page as Markdown."""
    used = {units.dimension_of(unit) for unit in re.findall(r'"unit": "(.*?)"', json.dumps(SCHEMA))}
    known = (f"{name} `{'` `'.join(of)}`" for name, (_, of) in units._DIMENSIONS.items() if name in used)
    lines = [
        f"""# A scene, key by key

<!-- written by workflows/scene_page.py from the tables of coupler/scene and words.toml: change those -->

A scene is a TOML file. Values with a unit are texts, `"25 um"`, in any unit of the same dimension. The `scene.toml` of a run
also has the defaults.

Units: {"; ".join(known)}.
"""
    ]
    for name, table in tables():
        lines += [f"## `[{name}]`", "", words(f"{name}.about")] if name else ["## Before the first table"]
        lines += ["", "| key | values | default | |", "|---|---|---|---|"]
        for key, entry in table["properties"].items():
            full = f"{name}.{key}" if name else key
            if words(full) == SAME:
                continue
            default = "needed" if key in table["required"] else "" if full == "name" else _default(entry)
            lines.append(f"| `{key}` | {_values(entry)} | {default} | {words(full)}{DEFAULTS.get(full, '')} |")
        if same := [f"`{key}`" for key in table["properties"] if words(f"{name}.{key}") == SAME]:
            lines.append(f"| {', '.join(same)} | | | {SAME} |")
        lines.append("")
    own = "A material of your own, or one of the library (`coldspray materials`) with other numbers, which needs only these."
    lines += ["## `[materials.NAME]`", "", own, "", "```toml", *words("material.example").splitlines(), "```", "",
              *_plain(materials.Material, materials.DEFAULTS | {"strength": ""}, lambda k: materials.UNITS.get(k, "")),
              *_laws()]  # fmt: skip
    own = "A nozzle of your own, beside those of the library (`coldspray nozzles`)."
    lines += ["## `[nozzles.NAME]`", "", own, "",
              *_plain(nozzles.Nozzle, nozzles._DEFAULTS, lambda name: "mm" if name in nozzles._LIMITS else "")]  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"


def tables() -> Iterator[tuple[str, Entry]]:
    """The tables of a scene by name, "" for the keys before the first, each with its `properties` and the `required` ones."""
    top, found = dict[str, Entry](), dict[str, Entry]()
    for name, entry in SCHEMA["properties"].items():
        if of := re.search(r"#/\$defs/(\w+)", json.dumps(entry)):
            found[name] = {"required": (), **SCHEMA["$defs"][of[1]]}
        elif name not in ("materials", "nozzles"):
            top[name] = entry
    yield "", {"properties": top, "required": ()}
    yield from found.items()


def missing_words() -> list[str]:
    """Keys of a scene that have no words."""
    keys = [f"{name}.{key}" if name else key for name, table in tables() for key in table["properties"]]
    for kind in (materials.Material, nozzles.Nozzle):
        keys += [f"{kind.__name__.lower()}.{field.name}" for field in dataclasses.fields(kind) if field.name != "name"]
    return [key for key in keys if not words(key)]


def _plain(kind: Any, defaults: dict[str, Any], unit_of: Any) -> list[str]:
    lines = ["| key | unit | default | |", "|---|---|---|---|"]
    for field in dataclasses.fields(kind):
        if field.name != "name":
            default = defaults.get(field.name, "needed")
            default = default[0][1] if isinstance(default, tuple) else default
            shown = "" if default in (None, "") else f"{default:g}" if isinstance(default, float) else default
            lines.append(
                f"| `{field.name}` | {unit_of(field.name)} | {shown} | {words(f'{kind.__name__.lower()}.{field.name}')} |"
            )
    return [*lines, ""]


def _laws() -> list[str]:
    """The keys of a strength law, in the table of its material: key, unit and default in brackets, meaning."""
    texts = {name: [_parameter(key, p) for key, p in law.parameters.items()] for name, law in LAWS.items()}
    *_, last = texts.values()
    shared = [text for text in last if all(text in own for name, own in texts.items() if name != "johnson_cook")]
    lines = ["Keys of its strength law, in the same table (needed unless a default is given):", ""]
    lines += [f"- `law`: {words('law.law')}", f"- `fitted`: {words('law.fitted')}"]
    lines += [f"- `{name}`: {'; '.join(text for text in own if text not in shared)}." for name, own in texts.items()]
    lines.append(f"- all but `johnson_cook`: {'; '.join(shared)}.")
    return [*lines, ""]


def _parameter(key: str, parameter: Parameter) -> str:
    default = "" if parameter.default is None else f"default {parameter.default:g}"
    about = ", ".join(text for text in (parameter.unit, default) if text)
    return f"`{key}`{f' ({about})' if about else ''} {parameter.about}"


def _values(entry: Entry) -> str:
    """What a key can be."""
    choices = [choice for choice in entry.get("anyOf", [entry]) if choice.get("type") != "null"]
    if "unit" in choices[0]:
        return str(choices[0]["description"]) + (", or pairs" if len(choices) > 1 else "")
    if choices[0] is not entry:
        return " or ".join(dict.fromkeys(_values(choice) for choice in choices))
    if "$ref" in entry:
        return "table"
    if "enum" in entry:
        return " ".join(f"`{value}`" for value in entry["enum"])
    if "prefixItems" in entry:
        return f"two of {_values(entry['prefixItems'][0])}"
    if entry["type"] == "array":
        return "tables" if "$ref" in entry["items"] else "list of texts"
    kinds = {"string": "text", "number": "number", "integer": "whole number", "object": "table"}
    limits = {"minimum": "", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below"}
    bounds = (f"{word} {_written(entry[name])}".strip() for name, word in limits.items() if name in entry)
    return " ".join([kinds.get(entry["type"], "`true` `false`"), *bounds])


def _default(entry: Entry) -> str:
    value, quantity = entry.get("default"), entry.get("prefixItems", [entry])[0]
    if value is None:
        return ""
    if isinstance(value, dict):
        return "`{ " + ", ".join(f"{name} = {item:g}" for name, item in value.items()) + " }`"
    items = value if isinstance(value, list) else [value]
    if "unit" in quantity:
        return ", ".join(f"`{units.rounded(item, quantity['unit'], 8)}`" for item in items)
    return ", ".join(f"`{_written(item)}`" for item in items)


def _written(value: object) -> str:
    """A value without a unit, as in TOML."""
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


if __name__ == "__main__":
    Path(*sys.argv[1:] or [PAGE]).write_text(page(), encoding="utf-8")
