"""Shared by the scripts of this folder: the places of tables and pages, and the parts of pages that are written from tables."""

import argparse
import math
import os
import platform
import re
import resource
import tempfile
import time
import timeit
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from study_table import Row, StudyTable, read_rows

from coupler import Result, Scene, __version__, run
from coupler.errors import ColdsprayError
from coupler.studies.table import write_rows

ROOT = Path(__file__).resolve().parents[1]
DOCS, TABLES = ROOT / "docs", ROOT / "docs" / "tables"
EVIDENCE = DOCS / "evidence"


def study(
    name: str,
    key: Sequence[str],
    remake: str,
    keys: Iterable[tuple[str, ...]] = (),
    row_of: Callable[..., Mapping[str, object]] = dict,
    may_fail: bool = False,
) -> StudyTable:
    """The table docs/tables/NAME.csv of a study, with the rows of keys computed and printed that it lacks. remake: the command.

    key: the columns that identify a row; row_of: of the values of a key, the other columns. may_fail: a run can end with an error, its
    reason is then in the column `failed`.
    """
    about = f"remake: {remake} (rows in this table are not computed again)"
    table = StudyTable(TABLES / f"{name}.csv", key, about)
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
    """What a table says of an error, in one line."""
    return " ".join(str(problem).split())[:200]


def measurements(section: str, file: str = "measurements") -> dict[str, Any]:
    """A table of workflows/FILE.toml: measured values, how they were read, and what was fixed before the runs; or scenes."""
    known: dict[str, Any] = tomllib.loads((ROOT / "workflows" / f"{file}.toml").read_text(encoding="utf-8"))
    return known[section]  # type: ignore[no-any-return]


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


def impact_tables(
    metal: str,
    diameter: float,
    velocity: float,
    base: str = "SS304",
    size: tuple[float, float] = (200.0, 100.0),
    spacing: float = 0.0,
    **particle: object,
) -> dict[str, Any]:
    """The tables of a scene of one impact. diameter um, velocity m/s; size: diameter and height of the target, um; spacing: um, that of
    the preset if 0; particle: further keys of its table."""
    width, height = size
    return {
        "particle": {"material": metal, "diameter": f"{diameter:g} um", "velocity": f"{velocity:g} m/s", **particle},
        "substrate": {"material": base, "diameter": f"{width:g} um", "height": f"{height:g} um"},
        "resolution": {"spacing": f"{spacing!r} um"} if spacing else {},
    }


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

    def work() -> None:
        a.T.copy().sum()
        np.sqrt(np.abs(a)).sum()

    return min(timeit.repeat(work, number=40, repeat=5, timer=now))


def machine() -> str:
    """The machine that times were taken on, for the head of a table."""
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"


def number(row: Mapping[str, str], column: str) -> float:
    """A value of a table, nan where there is none."""
    return float(row.get(column) or "nan")


def column(rows: Iterable[Mapping[str, str]], name: str) -> NDArray[np.float64]:
    """A column of a table as numbers (k,), nan where there is none."""
    return np.array([number(row, name) for row in rows])


def with_error(value: float, error: float, digits: int) -> str:
    """A value and its error, without the error where it is not known."""
    return f"{value:.{digits}f}" + (f" ± {error:.{digits}f}" if math.isfinite(error) else "")


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
