"""Tables of numbers in text files: separator, decimal comma, names and units of columns are detected."""

import csv
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .. import units
from .inputs import open_input

# these patterns take linear time in the length of a line
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_UNIT = re.compile(r"[\[(]([^][()]*)[])]$")
_COMMENT = ("#", "%", "!", "//")
_LONGEST = 100_000  # characters of a line
_COUNTED = 10  # least number of rows for which a first column 1, 2, 3 ... counts as row number
Columns = dict[int, NDArray[np.float64]]  # numbers of each numeric column by its index


@dataclass(frozen=True)
class Table:
    """A table of numbers. columns: name -> numbers (n,); columns of words are left out; units: name -> unit, if the heading has one;
    notes: remarks about uncertain interpretations. Without column names, the first columns get the letters of `axes` (`read_table`)."""

    columns: dict[str, NDArray[np.float64]]
    units: dict[str, str]
    notes: list[str]


def read_any_text(path: Path, limit: int) -> str:
    """The text of a file in UTF-8, UTF-16 or Latin-1. limit: greatest size, bytes. Raises InputError."""
    with open_input(path, limit) as stream:
        raw = stream.read()
    try:
        return raw.decode("utf-16" if raw.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig")
    except UnicodeDecodeError:  # names of columns from older spreadsheets; numbers do not depend on it
        return raw.decode("latin-1")


def read_table(text: str, names: list[str] | None = None, axes: str = "xyz") -> Table:
    """Read the table in a text. names: names of the columns in their order, where "-" leaves a column out; default: the names above the
    numbers. axes: a letter for each required column of numbers; without any names, the letters are the names. Raises ValueError."""
    lines = [line.strip() for line in text.splitlines()]
    numbers = (sum(map(_is_number, _fields(line, _separator(line)))) for line in lines)
    first = next((k for k, count in enumerate(numbers) if count >= len(axes)), None)
    if first is None:
        raise ValueError(f"none of its lines has {_listed(axes, 'numbers')}" if text.strip() else "it is empty")
    separator = _separator(lines[first])
    kept = [k for k in range(first, len(lines)) if lines[k] and not lines[k].startswith(_COMMENT)]
    rows = [_fields(lines[k], separator) for k in kept]
    for k, row in zip(kept, rows, strict=True):
        if len(row) != len(rows[0]):
            raise ValueError(f"line {first + 1} has {len(rows[0])} columns, line {k + 1} has {len(row)}")
    columns, notes = _values(rows, kept, separator)
    if names is None:
        above = {line: _titles(line, separator, len(rows[0]), axes) for line in lines[:first] if line}
        left_out = [line for line, titles in above.items() if titles is None and not line.startswith(_COMMENT)]
        notes += [f"a line above the numbers is ignored: {line[:60]!r}" for line in left_out]
        # the last line of names; above two columns a comment only if there is no other
        order = sorted(reversed(above), key=lambda line: axes == "xy" and line.startswith(_COMMENT))
        names = next((above[line] for line in order if above[line] is not None), None)
        if names is None:
            x, told = _unnamed(columns, axes)
            return Table(x, {}, [*notes, *told])
    if len(names) > len(rows[0]):
        raise ValueError(f"it has {len(rows[0])} columns, but {len(names)} names are given")
    given = [_UNIT.search(name) for name in names]
    plain = [_UNIT.sub("", name).strip() for name in names]
    wanted = [(k, name) for k, name in enumerate(plain) if name != "-"]
    if len({name.lower() for _, name in wanted}) < len(wanted):
        raise ValueError("two of its columns have the same name: name them with --columns, where - leaves a column out")
    words = [(name, rows[0][k][:30]) for k, name in wanted if k not in columns]
    notes += [f"column {name!r} is left out: {word!r} is not a number" for name, word in words]
    chosen = {name: columns[k] for k, name in wanted if k in columns}
    units = {name: unit[1].strip() for name, unit in zip(plain, given, strict=True) if unit is not None}
    return Table(chosen, units, notes)


def _separator(line: str) -> str:
    """Column separator: tab, semicolon or comma; "" (blanks) if the line has no commas, or only decimal commas in 3 or more words."""
    for separator in "\t;":
        if separator in line:
            return separator
    words = line.split()
    decimal = len(words) >= 3 and all(_DECIMAL_COMMA.fullmatch(word) or "," not in word for word in words)
    return "" if "," not in line or decimal else ","


def _fields(line: str, separator: str) -> list[str]:
    """The cells of a line, without quotes and blanks around them; empty for a line of more than _LONGEST characters."""
    if len(line) > _LONGEST:
        return []
    if separator:
        fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        return [field.strip() for field in (fields[:-1] if fields and not fields[-1] else fields)]
    return [word.strip('"') for word in re.findall(r'"[^"]*"|\S+', line)]


def _is_number(word: str) -> bool:
    try:
        float(word.replace(",", ".", 1))
    except ValueError:
        return False
    return True


def _values(rows: list[list[str]], lines: list[int], separator: str) -> tuple[Columns, list[str]]:
    """The numbers of each numeric column by its index, and remarks. lines: line number of each row."""
    of_numbers = [k for k, word in enumerate(rows[0]) if _is_number(word)]
    words = [[row[k] for row in rows] for k in of_numbers]
    comma = any("," in word for column in words for word in column)
    point = any("." in word for column in words for word in column)
    if comma and point:
        raise ValueError("it has numbers with a decimal comma and with a decimal point: use only one of these forms")
    if separator == "," and not comma and not point and len(of_numbers) >= 6 and len(of_numbers) % 2 == 0:
        raise ValueError("its commas may separate columns or be decimal commas: separate the columns by semicolons")
    columns = {}
    for k, column in zip(of_numbers, words, strict=True):
        try:
            columns[k] = np.array([word.replace(",", ".") for word in column] if comma else column).astype(float)
        except ValueError:
            at = next(i for i, word in enumerate(column) if not _is_number(word))
            raise ValueError(f"line {lines[at] + 1}, column {k + 1}: {column[at][:30]!r} is not a number") from None
    return columns, ["its commas are read as decimal commas"] if comma else []


def _titles(line: str, separator: str, count: int, axes: str) -> list[str] | None:
    """The `count` column names in a line above the numbers; None if it is no heading. A comment is one if it names x, y and z; in a
    table of two columns, if a name has a unit of length."""
    is_comment = line.startswith(_COMMENT)
    line = line.lstrip("#%!/ \t")
    for between in dict.fromkeys((separator, _separator(line), "")):
        names = _fields(line if between else re.sub(r"(?<!\s)\s+(?=[\[(])", "", line), between)
        bare = {_UNIT.sub("", name).strip().lower() for name in names}
        said = {"x", "y", "z"} <= bare if axes == "xyz" else any(map(_has_length, names))
        if len(names) == count and (said or not is_comment):
            return names
    return None


def _has_length(name: str) -> bool:
    unit = _UNIT.search(name)
    with suppress(units.UnitError):
        return unit is not None and units.parse(f"1 {unit[1].strip()}", "length") > 0.0
    return False


def _unnamed(columns: Columns, axes: str) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """Numbers by axis, for unnamed columns; row numbers in the first are skipped. If not all are used, a remark says which are."""
    places = list(columns)
    values = columns[places[0]]
    count = len(axes)
    counted = len(values) >= _COUNTED and bool(np.all(np.diff(values) == 1.0))
    if counted and not (axes == "xy" and len(places) == count):  # sizes can be 1 um apart
        places = places[1:]
    if len(places) < count:
        raise ValueError(f"the table needs {_listed(axes, 'columns')}, besides a column of line numbers")
    used = ", ".join(str(k + 1) for k in places[:count])
    told = f"columns {used} are used as {', '.join(axes)}, the others are left out: to choose, use --columns"
    return dict(zip(axes, (columns[k] for k in places[:count]), strict=True)), [told] if len(columns) > count else []


def _listed(axes: str, what: str) -> str:
    return f"{ {2: 'two', 3: 'three'}[len(axes)] } {what}, {', '.join(axes[:-1])} and {axes[-1]}"
