"""The table of a study: a CSV file of rows with a key, each with the version of the program that computed it."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from coupler import __version__
from coupler.errors import StoreError
from coupler.files.inputs import read_text
from coupler.studies.table import cell, write_rows

Row = dict[str, str]


class StudyTable:
    """The rows of a study in a CSV file, which is written again with each new row. Its columns are those of its rows, then `version`.
    key: the columns that identify a row. about: lines above the header; the first gives the command that computes the table. Rows of a
    file without versions get "unknown". Raises StoreError for a file without the columns of the key."""

    def __init__(self, path: Path, key: Sequence[str], about: str):
        self.path, self.key, self.about = path, tuple(key), about
        self.rows: list[Row] = read_rows(path) if path.exists() else []
        for row in self.rows:
            row.setdefault("version", "unknown")
            if not row.keys() >= set(key) or None in row or None in row.values():
                raise StoreError(
                    f"{path} has other columns than this study writes: move or rename the file, then start the study again"
                )

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the file."""
        names = dict.fromkeys(name for row in self.rows for name in row)
        return (*(name for name in names if name != "version"), "version")

    def __contains__(self, key: tuple[str, ...]) -> bool:
        return any(self._key_of(row) == key for row in self.rows)

    def add(self, row: Mapping[str, object]) -> Row:
        """Add a row with the version of this program, or replace the row with the same key, and write the file. Returns the row."""
        new = {name: cell(value) for name, value in row.items()} | {"version": __version__}
        same = [k for k, old in enumerate(self.rows) if self._key_of(old) == self._key_of(new)]
        self.rows[same[0] if same else len(self.rows) :] = [new, *self.rows[same[0] + 1 :]] if same else [new]
        blank = dict.fromkeys(self.columns, "")
        self.rows = [blank | known for known in self.rows]
        self.write()
        return blank | new

    def write(self) -> None:
        """Write the table to its file. Raises StoreError."""
        write_rows(self.path, self.columns, self.rows, self.about)

    def _key_of(self, row: Row) -> tuple[str, ...]:
        return tuple(row[name] for name in self.key)


def read_rows(path: Path) -> list[Row]:
    """The rows of a CSV file without lines that begin with #. Raises StoreError if the file cannot be read."""
    text = read_text(path)
    try:
        return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    except csv.Error as error:
        raise StoreError(f"{path} is damaged: {error}") from None
