"""Shared by the scripts of this folder: the places of tables and pages, and the parts of pages that are written from tables."""

import argparse
import math
import os
import platform
import re
import resource
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coupler import Result, Scene, __version__, run
from coupler.errors import ColdsprayError
from coupler.studies.table import Row, StudyTable, read_rows, write_rows

ROOT = Path(__file__).resolve().parents[1]
DOCS, TABLES = ROOT / "docs", ROOT / "docs" / "tables"
EVIDENCE = DOCS / "evidence"


def fill(table: StudyTable, keys: Iterable[tuple[str, ...]], row_of: Callable[..., Mapping[str, object]]) -> None:
    """Compute the rows of a table that it lacks, by their keys, and print them. row_of: of the values of a key, the other columns.

    The reason of a run that ends with an error goes into the column `failed` of a table that has one.
    """
    for key in keys:
        if key not in table:
            row: dict[str, object] = dict(zip(table.key, key, strict=True))
            try:
                row |= row_of(*key)
            except ColdsprayError as problem:
                if "failed" not in table.columns:
                    raise
                row["failed"] = " ".join(str(problem).split())[:200]
            print(*filter(None, table.add(row).values()), sep=" | ", flush=True)


def measurements(section: str) -> dict[str, Any]:
    """A table of workflows/measurements.toml: measured values, how they were read, and what was fixed before the runs."""
    known: dict[str, Any] = tomllib.loads((ROOT / "workflows" / "measurements.toml").read_text(encoding="utf-8"))
    return known[section]  # type: ignore[no-any-return]


def study_table(name: str, columns: Sequence[str], key: Sequence[str], remake: str) -> StudyTable:
    """The table docs/tables/NAME.csv of a study that can be resumed. remake: the command."""
    return StudyTable(
        TABLES / f"{name}.csv", columns, key, f"remake: {remake} (rows in this table are not computed again)"
    )


def table_rows(name: str) -> list[Row]:
    """The rows of docs/tables/NAME.csv, none if it does not exist."""
    path = TABLES / f"{name}.csv"
    return read_rows(path) if path.exists() else []


def write_table(path: Path, rows: Sequence[Mapping[str, object]], about: str) -> None:
    """Write a table whose rows are all of this version. about: lines above the header, the first says how to remake it."""
    write_rows(path, [*rows[0], "version"], [{**row, "version": __version__} for row in rows], about)


def spent() -> float:
    """Processor time so far of this process and its finished children, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def options(about: str, *switches: str, **values: object) -> argparse.Namespace:
    """The options of a script, which its docstring explains: switches, and others with a value of the type of their default."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in switches:
        parser.add_argument(f"--{name}", action="store_true")
    for name, default in values.items():
        several = isinstance(default, (list, tuple))
        kind = type(default[0] if isinstance(default, (list, tuple)) else default)
        parser.add_argument(f"--{name}", type=kind, nargs="*" if several else None, default=default)
    return parser.parse_args()


def single_impact(
    metal: str, diameter: float, velocity: float, base: str = "SS304", spacing: float = 0.0, more: str = ""
) -> str:
    """The scene of one impact: diameter and spacing um (that of the preset if 0), velocity m/s; more: further tables."""
    points = f'[resolution]\nspacing = "{spacing!r} um"\n' if spacing else ""
    particle = f'[[particle]]\nmaterial = "{metal}"\ndiameter = "{diameter:g} um"\nvelocity = "{velocity:g} m/s"\n'
    return f'{particle}[substrate]\nmaterial = "{base}"\n{points}{more}'


@contextmanager
def computed(scene: Scene, folder: Path | None = None, **more: Any) -> Iterator[tuple[Result, float]]:
    """Run a scene in one thread: its result and the processor time, s. folder: None for one that is removed behind; more: options of
    `run`."""
    started = time.process_time()
    with tempfile.TemporaryDirectory() as place:
        result = run(scene, folder or Path(place) / "run", force=True, threads=1, quiet=True, **more)
        yield result, time.process_time() - started


def spacing_of(points: int, diameter: float = 25.0) -> float:
    """Spacing (um) of so many points in a sphere of a diameter (um)."""
    return (math.pi / 6.0 * diameter**3 / points) ** (1.0 / 3.0)


def reference(now: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of a loop in numpy that fits into the cache of one core, the fastest of a few: times over it compare between machines."""
    a = np.random.default_rng(1).standard_normal((200, 200))

    def once() -> float:
        start = now()
        for _ in range(40):
            a.T.copy().sum()
            np.sqrt(np.abs(a)).sum()
        return now() - start

    return min(once() for _ in range(5))


def machine() -> str:
    """The machine that times were taken on, for the head of a table."""
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"


def number(row: Mapping[str, str], column: str) -> float:
    """A value of a table, nan where there is none."""
    return float(row.get(column) or "nan")


def column(rows: Iterable[Mapping[str, str]], name: str) -> NDArray[np.float64]:
    """A column of a table as numbers (k,), nan where there is none."""
    return np.array([number(row, name) for row in rows])


def markdown(
    head: str | Sequence[str], rows: Iterable[Sequence[object]], of: Sequence[Mapping[str, str]] = ()
) -> list[str]:
    """Lines of a Markdown table. head: the headings, or one text with "|" between them; of: rows whose `versions` stand below."""
    headings = [text.strip() for text in head.split("|")] if isinstance(head, str) else head
    table = [f"| {' | '.join(map(str, line))} |" for line in (headings, ["---"] * len(headings), *rows)]
    return [*table, "", versions(of)] if of else table


def versions(rows: Iterable[Mapping[str, str]]) -> str:
    """A sentence about the versions that computed some rows."""
    count = Counter(row.get("version", "unknown") for row in rows)
    if len(count) == 1:
        return f"Computed with version {next(iter(count))}."
    return f"Computed with versions {', '.join(f'{name} ({n} rows)' for name, n in sorted(count.items()))}."


def write_parts(page: str, parts: Mapping[str, Sequence[str]]) -> None:
    """Put lines between the comments `<!-- NAME: ... -->` and `<!-- end of NAME -->` of a page of docs/evidence, for each name.

    Raises SystemExit if the page lacks one of them.
    """
    path = EVIDENCE / f"{page}.md"
    text = path.read_text(encoding="utf-8")
    for name, lines in parts.items():
        place = re.compile(rf"(<!-- {re.escape(name)}: [^\n]*-->\n).*?(<!-- end of {re.escape(name)} -->)", re.DOTALL)
        body = "\n".join(["", *lines, ""])
        text, count = place.subn(lambda match, body=body: f"{match[1]}{body}\n{match[2]}", text)  # type: ignore[misc]
        if count != 1:
            raise SystemExit(
                f"{path} has no place for {name}: it needs <!-- {name}: ... --> and <!-- end of {name} -->"
            )
    path.write_text(text, encoding="utf-8")
