"""Messages about errors in the tables of a scene, with the names of the scene's fields."""

import copy
import json
import re
from collections.abc import Mapping
from typing import Any, get_args

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from .. import units
from .model import SceneData
from .values import read_table

# of required fields; those of particle and substrate replace faulty ones while other fields are checked
_EXAMPLES: dict[str, dict[str, object]] = {
    "particle": {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"},
    "substrate": {"material": "SS304"},
    "coating": {"material": "Ni", "number": 40, "radius": "35 um", "diameter": "22 um", "velocity": "600 m/s"},
    "powder": {"material": "Cu", "sizes": "15-45 um"},
    "gas": {"pressure": "40 bar", "temperature": "800 degC", "nozzle": "D42PBI"},
}
_SEVERAL = "particle", "powder"  # tables that a file has once or several times
# expected values, by pydantic's kinds of error
_EXPECTED = {
    "float_type": "a number without unit or quotes", "int_type": "a whole number, without unit or quotes",
    "int_from_float": "a whole number", "bool_type": "true or false", "string_type": "a text in quotes",
    "tuple_type": 'a list, such as ["..."]', "list_type": 'a list, such as ["..."]',
}  # fmt: skip


def without(raw: Mapping[str, object], faulty: list[tuple[int | str, ...]]) -> SceneData | None:
    """The scene with valid values instead of the faulty fields, so that relations between the other fields can be checked. faulty:
    paths of the fields. None if the scene is not valid with these values."""
    mended: dict[str, Any] = copy.deepcopy(dict(raw))
    particles = mended.get("particle")
    mended["particle"] = particles if isinstance(particles, list) else [particles]
    for section, *inner in faulty:
        table = mended.get(str(section))
        if section == "particle" and inner and isinstance(table, list):
            table, *inner = table[int(inner[0])], *inner[1:]
        elif section in ("gas", "nozzles", "coating") or not inner:  # the particles already have their data
            mended.pop(str(section), None)
        if inner and isinstance(table, dict):
            table.pop(inner[0], None)

    def filled(name: str, table: object) -> dict[str, object]:
        return _EXAMPLES[name] | (table if isinstance(table, dict) else {})

    mended["particle"] = [filled("particle", table) for table in mended.get("particle", [{}])]
    mended["substrate"] = filled("substrate", mended.get("substrate"))
    return read_table(SceneData, mended)[0]


def covers(bad: str, field: str) -> bool:
    """Whether a faulty field is `field` itself, contains it, or is an element of it."""
    return bad == field or field.startswith((f"{bad}.", f"{bad}[")) or bad.startswith(f"{field}[")


def dotted(loc: tuple[int | str, ...], several: bool) -> str:
    """Name of a field in messages, with indices from 1: "particle[2].velocity". With one particle, or one powder of a job (`several`
    is False), it is "particle.velocity"."""
    parts = [p for i, p in enumerate(loc) if several or not (i == 1 and loc[0] in _SEVERAL and isinstance(p, int))]
    text = "".join(f"[{p + 1}]" if isinstance(p, int) else f".{p}" for p in parts)
    return text.removeprefix(".")


def in_words(entry: ErrorDetails, several: bool, whole: type[BaseModel] = SceneData) -> str:
    """The message for an error of pydantic. several: whether the scene has several particles, or the job several powders; whole: model
    of the file."""
    kind, loc = entry["type"], entry["loc"]
    field = dotted(loc if kind != "extra_forbidden" else (*loc[:-1], shown(loc[-1])[1:-1]), several)
    if kind == "extra_forbidden":
        known = [info.alias or name for name, info in _model_at(loc[:-1], whole).model_fields.items()]
        return f"{field}: unknown key{units.nearest(str(loc[-1]), known)}; known: {', '.join(known)}"
    if "offset" in loc and kind != "value_error":
        where = dotted(loc[: loc.index("offset") + 1], several)
        return f'{where}: expected two lengths, such as ["0 um", "0 um"]'
    if kind == "missing":
        if field in _EXAMPLES:
            return f"{field}: missing; add a table [{field}]"
        example = _EXAMPLES.get(str(loc[0]), {}).get(str(loc[-1]), "...")
        return f"{field}: missing; add for example {loc[-1]} = {json.dumps(example)}"
    start = f"{field} = {shown(entry['input'])}"
    if kind == "literal_error":
        choices = re.findall("'(.*?)'", entry["ctx"]["expected"])
        return f"{start}: expected one of {', '.join(choices)}{units.nearest(str(entry['input']), choices)}"
    if kind == "value_error":
        text = str(entry["ctx"]["error"])
        if loc in (("particle",), ("coating",), ("powder",)) or loc[:-1] in (("coating", "powder"), ("powder",)):
            return f"{field} {text}"
        return f"{start} {text}" if text.startswith(("is ", "has ", "needs ", "would ")) else f"{start}: {text}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        table = f"[[{loc[0]}]]" if several and loc[0] in _SEVERAL else f"[{field}]"
        return f"{start}: expected a table {table}"
    if kind == "string_pattern_mismatch":
        return f"{start}: use letters, digits, '_', '.', '-', spaces (at most 64, a letter or digit first)"
    if kind in ("float_type", "finite_number", "greater_than_equal", "less_than_equal") and field == "contact.friction":
        return f"{start}: expected a number without unit, from 0 to 2"
    if kind == "tuple_type" and _model_at(loc, whole) is not whole:
        return f"{start}: expected tables [[{field}]]"
    if kind in _EXPECTED:
        return f"{start}: expected {_EXPECTED[kind]}"
    return f"{start}: {entry['msg'][0].lower()}{entry['msg'][1:]}"


def _model_at(loc: tuple[int | str, ...], whole: type[BaseModel]) -> type[BaseModel]:
    """The model of the table at a path in a file. whole: the model of the whole file."""
    if not loc or loc[0] not in (names := {info.alias or n: n for n, info in whole.model_fields.items()}):
        return whole
    inner = whole.model_fields[names[str(loc[0])]].annotation
    while arguments := get_args(inner):  # of a list, of an optional table
        inner = arguments[0]
    if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
        return whole
    return _model_at(tuple(part for part in loc[1:] if not isinstance(part, int)), inner)


def shown(value: object) -> str:
    """A value of the input for a message: at most 60 characters, without control characters."""
    try:
        text = json.dumps(value, default=str)
    except (ValueError, RecursionError):
        text = "..."
    return text if len(text) <= 60 else f"{text[:56]}..."


def text_of(value: float, unit: str) -> str:
    """An SI value as text in a unit, in quotation marks."""
    return f'"{units.rounded(value, unit, 6)}"'
