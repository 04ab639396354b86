"""Libraries of records (materials, nozzles): tables of numbers and texts with units, from the package or from a scene."""

import re
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from importlib.resources import files
from typing import TypeVar

from .. import units
from ..errors import SceneError

R = TypeVar("R")

PLAIN_TEXT = re.compile(r"[^\n]{0,600}")
SAFE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}", re.ASCII)


def load(package: str, file: str, read: Callable[[str, Mapping[str, object]], R]) -> dict[str, R]:
    """The records of a TOML file of a package, by name. read(name, table): makes a record."""
    text = files(package).joinpath(file).read_text(encoding="utf-8")
    return {name: read(name, table) for name, table in tomllib.loads(text).items()}


def read_record(
    kind: type[R], name: str, table: Mapping[str, object], read: Callable[[str, object], object], values: Mapping[str, object],
    hint: str = "", found: Collection[str] = (), lacks: Collection[str] = (),
) -> R:  # fmt: skip
    """Make a record, which is a dataclass with a name, from a table of its other fields.

    read(field, value): reads a value, raises ValueError with the problem. values: values of fields that are missing in the table.
    hint: text for the message about missing fields. found, lacks: known problems and missing fields of the same table. Raises
    SceneError with all problems; each begins with the name of the field.
    """
    known = [field.name for field in fields(kind) if field.name != "name"]  # type: ignore[arg-type]
    problems, values = list(found), dict(values)
    if not SAFE_NAME.fullmatch(name):
        problems.append("its name must be made of letters, digits, '_', '.' and '-' (at most 40)")
    for key, value in table.items():
        if key not in known:
            problems.append(f"{key[:40]!r}: unknown key{units.nearest(key, known)}; known: {', '.join(known)}")
            continue
        try:
            values[key] = read(key, value)
        except ValueError as error:
            problems.append(f"{key} {error}")
    if missing := [*(key for key in known if key not in values and key not in table), *lacks]:
        problems.append(f"missing: {', '.join(missing)}{hint}")
    refuse(problems, name)
    return kind(**{"name": name, **values})


def refuse(problems: list[str], name: str) -> None:
    """Raise SceneError if the list of problems is not empty. name: name of the record."""
    if problems:
        raise SceneError(problems, name)


def read_number(value: object, unit: str, low: float, high: float) -> float:
    """SI value of a text with a unit, or of a plain number if unit is "". Raises ValueError otherwise, and outside low to high (SI)."""
    if unit:
        number = units.parse(value, units.dimension_of(unit))
    elif isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("must be a plain number")
    else:
        number = value
    if not low <= number <= high:
        limits = f"{units.rounded(low, unit)} to {units.rounded(high, unit)}" if unit else f"{low:g} to {high:g}"
        raise ValueError(f"is outside {limits}")
    return float(number)


def read_text(value: object, pattern: re.Pattern[str] = PLAIN_TEXT, allowed: str = "no control characters") -> str:
    """A text that matches the pattern. allowed: the permitted characters, for the message. Raises ValueError for other values."""
    if not isinstance(value, str) or not (value.isprintable() and pattern.fullmatch(value)):
        raise ValueError(f"must be a text of at most 600 characters: {allowed}")
    return value
