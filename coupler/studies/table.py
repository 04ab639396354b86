"""Tables of studies as CSV files; each row has the version of the program that computed it."""

import csv
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from .. import __version__
from ..errors import StoreError
from ..files.inputs import read_text
from ..files.outputs import replacing

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


def cell(value: object) -> str:
    """The text of a value in a table: six digits for a float, empty for None."""
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def in_columns(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """The rows of cells as aligned lines for a terminal. right: indices of the right-aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    forms = [f"{{:{'>' if k in right else '<'}{width}}}" for k, width in enumerate(widths)]
    return ["  ".join(forms).format(*row).rstrip() for row in rows]


def read_rows(path: Path) -> list[Row]:
    """The rows of a CSV file without lines that begin with #. Raises StoreError if the file cannot be read."""
    text = read_text(path)
    try:
        return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    except csv.Error as error:
        raise StoreError(f"{path} is damaged: {error}") from None


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]], about: str = "") -> None:
    """Write a complete CSV file. about: lines above the header, each after "# ". Raises StoreError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error.strerror}") from error
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in about.splitlines())
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([cell(row.get(name)) for name in columns] for row in rows)
