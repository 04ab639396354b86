"""Tables: rows of studies in docs/tables, with a key and the version of the program that computed each; measured values."""

import csv
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coupler import __version__
from coupler.errors import ColdsprayError, StoreError
from coupler.files.inputs import read_text, read_toml
from coupler.studies.table import cell, write_rows

WORKFLOWS = Path(__file__).resolve().parent
DOCS = WORKFLOWS.parent / "docs"
TABLES = DOCS / "tables"
REMAKE = f"python workflows/{Path(sys.argv[0]).name}"  # this script
Row = dict[str, str]


class StudyTable:
    """The rows of a study in a CSV file, which is written again with each new row. Its columns are those of its rows, then `version`.
    key: the columns that identify a row. about: lines above the header; the first gives the command that computes the table. Rows of a
    file without versions get "unknown". Raises StoreError for a file without the columns of the key."""

    def __init__(self, path: Path, key: Sequence[str], about: str):
        self.path, self.key, self.about = path, tuple(key), about
        self.rows = read_rows(path) if path.exists() else []
        for row in self.rows:
            row.setdefault("version", "unknown")
            if not row.keys() >= set(key) or None in row or None in row.values():
                raise StoreError(
                    f"{path} has other columns than this study writes: move or rename the file, then start the study again"
                )

    def __contains__(self, key: tuple[str, ...]) -> bool:
        return any(self._key_of(row) == key for row in self.rows)

    def add(self, row: Mapping[str, object]) -> Row:
        """Add a row with the version of this program, or replace the row with the same key, and write the file. Returns the row."""
        new = {name: cell(value) for name, value in row.items()} | {"version": __version__}
        at = next((k for k, old in enumerate(self.rows) if self._key_of(old) == self._key_of(new)), len(self.rows))
        self.rows[at : at + 1] = [new]
        names = dict.fromkeys(name for known in self.rows for name in known if name != "version")
        blank_row = dict.fromkeys([*names, "version"], "")
        self.rows = [blank_row | known for known in self.rows]
        write_rows(self.path, list(blank_row), self.rows, self.about)
        return self.rows[at]

    def _key_of(self, row: Row) -> tuple[str, ...]:
        return tuple(row[name] for name in self.key)


def read_rows(path: Path) -> list[Row]:
    """The rows of a CSV file without lines that begin with #. Raises StoreError if the file cannot be read."""
    text = read_text(path)
    try:
        return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    except csv.Error as error:
        raise StoreError(f"{path} is damaged: {error}") from None


def study(
    name: str, key: Sequence[str], keys: Iterable[tuple[str, ...]] = (), row_of: Callable[..., Mapping[str, object]] = dict,
    may_fail: bool = False, remake: str = REMAKE,
) -> StudyTable:  # fmt: skip
    """The table docs/tables/NAME.csv of a study. For each of `keys` that it lacks, a row is computed, added and printed.

    key: the columns that identify a row; row_of: function of the values of a key that returns the other columns; may_fail: if a run
    ends with an error, the reason is in the column `failed`; remake: the command that computes the table.
    """
    table = StudyTable(TABLES / f"{name}.csv", key, f"remake: {remake} (rows in this table are not computed again)")
    for values in keys:
        if values not in table:
            row: dict[str, object] = dict(zip(key, values, strict=True))
            try:
                row |= row_of(*values)
                if may_fail:
                    row["failed"] = ""
            except ColdsprayError as problem:
                if not may_fail:
                    raise
                row["failed"] = reason(problem)
            print(*filter(None, table.add(row).values()), sep=" | ", flush=True)
    return table


def reason(problem: Exception) -> str:
    """The text of an error in one line, for a table."""
    return " ".join(str(problem).split())[:200]


def measurements(section: str, file: str = "measurements") -> dict[str, Any]:
    """A table of workflows/FILE.toml: measured values, how they were read, and what was fixed before the runs; or scenes."""
    known: dict[str, Any] = read_toml(WORKFLOWS / f"{file}.toml")[section]
    return known


def table_rows(name: str) -> list[Row]:
    """The rows of docs/tables/NAME.csv, none if it does not exist."""
    path = TABLES / f"{name}.csv"
    return read_rows(path) if path.exists() else []


def write_table(name: str, rows: Sequence[Mapping[str, object]], about: str = f"remake: {REMAKE}") -> None:
    """Write docs/tables/NAME.csv with rows that are all of this version. about: lines above the header, the first: how to remake it."""
    write_rows(TABLES / f"{name}.csv", [*rows[0], "version"], [{**row, "version": __version__} for row in rows], about)


def number(row: Mapping[str, str], column: str) -> float:
    """A value of a table, nan where there is none."""
    return float(row.get(column) or "nan")


def column(rows: Iterable[Mapping[str, str]], name: str) -> NDArray[np.float64]:
    """A column of a table as numbers (k,), nan where there is none."""
    return np.array([number(row, name) for row in rows])
