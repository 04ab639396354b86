"""Tables of studies: CSV files, and aligned columns for a terminal."""

import csv
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from ..errors import StoreError
from ..files.outputs import replacing


def cell(value: object) -> str:
    """The text of a value in a table: six digits for a float, empty for None."""
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def in_columns(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """The rows of cells as aligned lines for a terminal. right: indices of the right-aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    forms = [f"{{:{'>' if k in right else '<'}{width}}}" for k, width in enumerate(widths)]
    return ["  ".join(forms).format(*row).rstrip() for row in rows]


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
