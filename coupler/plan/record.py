"""Frozen records as JSON and back: the plan in a run's folder.

Numbers that JSON does not have (an infinite window) are written as text, "inf"; tuples as lists.
"""

import dataclasses
import hashlib
import json
import math
import types
import typing
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TypeVar

from .. import __version__
from ..errors import StoreError
from ..files.inputs import read_json_object
from .planning import Plan

FILE = "plan.json"
FORMAT = 2
Json = dict[str, object] | list[object] | str | float | int | bool | None
T = TypeVar("T")


def plan_text(plan: Plan) -> str:
    """The plan as the text of plan.json."""
    data = to_json(plan)
    return (
        json.dumps({"format": FORMAT, "version": __version__, "sha256": _checksum(data), "plan": data}, indent=1) + "\n"
    )


def plan_from(data: Mapping[str, object]) -> Plan:
    """The plan from the contents of plan.json, equal to the one that the run was started with.

    Raises ValueError for another format, or a plan that is damaged.
    """
    if data.get("format") != FORMAT:
        raise ValueError(f"is not a plan of format {FORMAT}")
    try:
        if data["sha256"] != _checksum(data["plan"]):
            raise ValueError("its checksum does not fit")
        return from_json(Plan, data["plan"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"is damaged: {error}") from error


def read_plan(folder: Path) -> Plan:
    """The plan that a run was started with. Raises StoreError: there is none, it is damaged, or of another format."""
    path = folder / FILE
    if not path.exists():
        raise StoreError(f"{folder} has no {FILE}, as runs of version 0.1: compute the scene anew with this version")
    try:
        return plan_from(read_json_object(path))
    except ValueError as error:
        raise StoreError(f"{path} {error}: this version cannot go on with it") from error


def _checksum(data: object) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def to_json(value: object) -> Json:
    """A record, or what records hold, as JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_json(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, tuple | list):
        return [to_json(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    if value is None or isinstance(value, str | int | float):
        return value
    raise TypeError(f"{type(value).__name__} has no form in a record")


def from_json(kind: type[T], value: object) -> T:
    """A record of the class `kind` from JSON. Raises TypeError, ValueError or KeyError for JSON of another shape."""
    return typing.cast(T, _read(kind, value))


@cache
def _hints(kind: type) -> dict[str, object]:
    return typing.get_type_hints(kind)


def _read(kind: object, value: object) -> object:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        inner = next(a for a in arguments if a is not type(None))
        return None if value is None else _read(inner, value)
    if origin is typing.Literal:
        if value not in arguments:
            raise ValueError(f"{value!r:.40} is none of {arguments}")
        return value
    if origin is tuple:
        if not isinstance(value, list):
            raise TypeError("expected a list")
        kinds = [arguments[0]] * len(value) if arguments[-1] is Ellipsis else list(arguments)
        return tuple(_read(k, item) for k, item in zip(kinds, value, strict=True))
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        if not isinstance(value, dict):
            raise TypeError(f"expected an object for {kind.__name__}")
        return kind(
            **{field.name: _read(_hints(kind)[field.name], value[field.name]) for field in dataclasses.fields(kind)}
        )
    if kind is float and (value in ("inf", "-inf") or (isinstance(value, int | float) and not isinstance(value, bool))):
        return float(typing.cast(float, value))
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):  # type: ignore[arg-type]
        raise TypeError(f"expected {kind}, not {value!r:.40}")
    return value
