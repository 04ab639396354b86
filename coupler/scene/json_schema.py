"""The tables of a scene as a JSON schema (Draft 4). With it editors complete and check keys (for TOML, for example, taplo)."""

import re
import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

from .. import units
from .effects import NAMES, WHOLE
from .job import JobData
from .model import SceneData

DRAFT = "http://json-schema.org/draft-04/schema#"


def scene_schema() -> dict[str, Any]:
    """The schema of a scene, as nested dicts. It has no conditions that relate several keys; `coldspray check` tests these."""
    whole = SceneData.model_json_schema(ref_template="#/definitions/{model}")
    schema: dict[str, Any] = {"$schema": DRAFT, "title": "a scene of coldspray", "description": ""} | _draft_4(whole)
    properties, tables = schema["properties"], schema["definitions"]
    properties["particle"] = {}
    names = [*WHOLE, *(sign + name for sign in ("", "+", "-") for name in NAMES)]
    properties["effects"] = {"anyOf": [{"enum": [*WHOLE]}, {"type": "array", "items": {"enum": names}}]}
    tables["AdhesionTable"]["properties"]["threshold"] = {"type": ["number", "string"]}
    for name, entry in properties.items():
        model = "Particle" if name == "particle" else str(entry.get("$ref", "")).rpartition("/")[2]
        _described(f"{name}.about" if model in tables else name, entry)
        for key, of_key in tables.get(model, {"properties": {}})["properties"].items():
            _described(f"{name}.{key}", of_key)
    for key, of_key in tables["Share"]["properties"].items():
        _described(f"coating.powder.{key}" if key == "share" else f"coating.{key}", of_key)
    # [coating] replaces the particles, [gas] gives their velocities, [[coating.powder]] its metals
    schema["required"] = ["substrate"]
    tables["Coating"]["required"].remove("material")
    tables["Share"]["required"] = ["share"]
    tables["Particle"]["required"].remove("velocity")
    properties["particle"] |= _one_or_several("Particle", tables)
    return schema


def job_schema() -> dict[str, Any]:
    """The schema of the file of a job, as nested dicts. Tables that are also in scenes have the same descriptions."""
    whole = JobData.model_json_schema(ref_template="#/definitions/{model}")
    schema: dict[str, Any] = {"$schema": DRAFT, "title": "a job of coldspray", "description": ""} | _draft_4(whole)
    tables = schema["definitions"]
    models = {"gas": "GasConditions", "spray": "GunPath", "substrate": "Substrate", "coating": "Powder"}
    for name, table in models.items():
        for key, entry in tables[table]["properties"].items():
            _described("coating.powder.share" if key == "share" else f"{name}.{key}", entry)
    for key in ("diameter", "height", "sides", "bottom"):  # follow from the particles
        del tables["Substrate"]["properties"][key]["default"]
    schema["properties"]["powder"] = _one_or_several("Powder", tables)
    return schema


def _one_or_several(name: str, tables: dict[str, Any]) -> dict[str, Any]:
    """The schema entry of a table that may also be an array of tables. name: its key in `tables`, the definitions of the schema."""
    table = tables[name]
    # the keys of the table and its array in one entry, without anyOf: an editor then marks only the wrong key
    return {key: table[key] for key in ("properties", "required", "additionalProperties")} | {
        "type": ["object", "array"], "minItems": 1, "items": {"$ref": f"#/definitions/{name}"},
    }  # fmt: skip


def words(key: str) -> str:
    """The meaning of a key or a table, in Markdown: words("particle.gap"), words("gas.about"). "" if it is not known."""
    table, _, name = key.partition(".") if "." in key else ("", "", key)
    return str((_words().get(table, {}) if table else _words()).get(name, ""))


@cache
def _words() -> dict[str, Any]:
    return tomllib.loads((files(__package__) / "words.toml").read_text(encoding="utf-8"))


def _described(key: str, entry: dict[str, Any]) -> None:
    """Add to the schema entry of a key its meaning as description, without links."""
    plain = re.sub(r" \(\[.*?\]\(.*?\)\)", "", words(key))
    entry["description"] = "; ".join(text for text in (plain, entry.get("description", "")) if text)


def _draft_4(node: Any) -> Any:
    """Convert a part of a schema from Draft 2020-12 to Draft 4. Defaults with a unit become texts. Null is removed; TOML lacks it."""
    if isinstance(node, list):
        return [_draft_4(item) for item in node]
    if not isinstance(node, dict):
        return node
    node = {
        {"$defs": "definitions", "prefixItems": "items"}.get(key, key): _draft_4(value) for key, value in node.items()
    }
    for limit in ("minimum", "maximum"):  # in Draft 4 an exclusive limit is a limit and a boolean
        if isinstance(own := node.get(exclusive := f"exclusive{limit.title()}"), float | int):
            node |= {limit: own, exclusive: True}
    choices = [choice for choice in node.get("anyOf", ()) if choice != {"type": "null"}]
    if len(choices) == 1:
        node = {**choices[0], **{key: value for key, value in node.items() if key != "anyOf"}}
    if "const" in node:
        node["enum"] = [node.pop("const")]
    unit = node.pop("unit", None)
    if isinstance(node.get("title"), str):  # pydantic repeats the key
        del node["title"]
    default = node.get("default")
    if unit is not None and isinstance(default, float):
        node["default"] = units.show(default, unit)
    elif default is None or not isinstance(default, str | bool | int | float):
        node.pop("default", None)
    if isinstance(node.get("description"), str):
        node["description"] = " ".join(node["description"].split())
    return node
