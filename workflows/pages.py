"""Shared by the scripts of this folder: their options, scenes and runs, and the parts and figures of pages that are made of tables."""

import argparse
import math
import os
import platform
import re
import resource
import tempfile
import time
import timeit
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from study_table import DOCS, WORKFLOWS

from coupler import Result, Scene, run
from coupler.report.figure import blank, save

EVIDENCE = DOCS / "evidence"


def scene_file(name: str, **changes: object) -> Scene:
    """The scene workflows/NAME.toml with changes of its tables."""
    return Scene.load(WORKFLOWS / f"{name}.toml").with_(**changes)


@contextmanager
def drawing(
    name: str, width: float, height: float, layout: Literal["constrained"] | None = None, dpi: float = 110.0
) -> Iterator[Figure]:
    """A figure of width x height inches. At the end it is written to docs/evidence/NAME.png."""
    figure = blank(width, height, dpi, layout)
    yield figure
    save(figure, EVIDENCE / f"{name}.png")


def spent() -> float:
    """Processor time so far of this process and its finished children, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def options(about: str, *switches: str, argv: Sequence[str] | None = None, **values: object) -> argparse.Namespace:
    """The options of a script: switches, and `values`, options whose value has the type of the default. about: docstring of the script;
    argv: words of the command line, by default those of this process."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in switches:
        parser.add_argument(f"--{name}", action="store_true")
    for name, default in values.items():
        several = isinstance(default, (list, tuple))
        kind = type(default[0] if isinstance(default, (list, tuple)) else default)
        parser.add_argument(f"--{name}", type=kind, nargs="*" if several else None, default=default)
    return parser.parse_args(argv)


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
    """Run a scene in one thread: its result and the processor time, s. folder: None for a temporary one; more: options of `run`."""
    started = time.process_time()
    with tempfile.TemporaryDirectory() as place:
        result = run(scene, folder or Path(place) / "run", force=True, threads=1, quiet=True, **more)
        yield result, time.process_time() - started


def spacing_of(points: int, diameter: float = 25.0) -> float:
    """Spacing (um) of a number of points in a sphere of a given diameter (um)."""
    return (math.pi / 6.0 * diameter**3 / points) ** (1.0 / 3.0)


def reference(now: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of a numpy loop whose data fit into the cache of a core, to compare times between machines; the fastest of five."""
    a = np.random.default_rng(1).standard_normal((200, 200))

    def work() -> None:
        a.T.copy().sum()
        np.sqrt(np.abs(a)).sum()

    return min(timeit.repeat(work, number=40, repeat=5, timer=now))


def machine() -> str:
    """Text: the machine on which times are measured, for the head of a table."""
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"


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
