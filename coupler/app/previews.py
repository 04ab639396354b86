"""Texts and figures that the local web page shows about a scene or a job during typing, and about a run during its computation."""

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ..core.process import cores
from ..errors import ColdsprayError, SceneError
from ..files.inputs import last_lines, reading
from ..files.result import HISTORY, Result
from ..plan.job import from_text
from ..plan.planning import plan
from ..plan.reading import Scene
from ..plan.text import describe, duration
from ..report import picture, screen
from ..studies import coating, coating_files, pace
from ..studies.job_numbers import Number, numbers
from ..studies.job_parts import Coating
from . import figures
from .workspace import FINISHED, JOB, LOG, UNDECIDED, Row, Workspace

_DRAWING = threading.Lock()  # matplotlib draws in one thread at a time


@dataclass(frozen=True)
class Preview:
    """Preview of a scene or a job. problems: problems of the input; if there are any, all other values are empty. lines: expected
    time and error; more: description of the computation; numbers, drawn: results and figures of the gas; classes: text of a CSV table
    of the powder's size classes at impact."""

    problems: Iterable[str] = ()
    lines: str = ""
    more: str = ""
    numbers: tuple[Number, ...] = ()
    drawn: tuple[figures.Figure, ...] = ()
    classes: str = ""


@dataclass(frozen=True)
class Now:
    """Present state of a run, from its files. text: its results, or the last lines of its log; pictures: web addresses of its
    pictures."""

    row: Row
    text: str
    energy: figures.Figure | None = None
    pictures: tuple[str, ...] = ()


def preview(text: str, path: Path, verb: str, here: pace.Pace) -> Preview:
    """The preview of a scene or a job. text: its TOML text; path: file in which it would be saved; verb: "run" for a scene, "job" for a
    job, "" for a job if its parts and time limit are not shown. Problems of the input are part of the result."""
    try:
        if verb == "run":
            planned = plan(Scene.from_text(text, str(path)))
            lines = pace.lines(planned, here, verbose=False)
            flat = "\n".join(" ".join(line.split()) for line in lines.splitlines())
            return Preview(lines=flat, more=describe(planned, lines, brief=True))
        job = from_text(text, path)
        lines, more = "; ".join(job.flow.notes), ""
        if verb:
            job.check()
            lines = f"at most {duration(job.data.within)} on {cores()} cores"
            more = f"in this order while there is time: {'; '.join(part.words for part in job.parts)}"
        windows = [figures.deposition_window(job, name) for name, p in job.powders.items() if not p.metal.is_ceramic]
        drawn = (*windows, *(figures.flights(job, name) for name in job.powders))
        classes = "powder,share,diameter_um,velocity_m_s,temperature_K,critical_velocity_m_s\n"
        for name, at in job.arrived.items():
            columns = at.share, 1e6 * at.diameter, at.velocity, at.temperature, at.critical
            classes += "".join(
                ",".join([name, *map("{:.7g}".format, row)]) + "\n" for row in zip(*columns, strict=True)
            )
        return Preview((), lines, more, tuple(numbers(job, {}, Coating({}, {}))), drawn, classes)
    except SceneError as error:
        return Preview(error.problems)
    except ColdsprayError as error:
        return Preview([str(error)])


def now(workspace: Workspace, folder: Path) -> Now:
    """The present state of a run or a job, finished or not. For a damaged run, the text begins with the error message."""
    row, log = workspace.row(folder), last_lines(folder / "run.log", 6) or last_lines(folder / LOG, 6)
    text, energy, done = log or row.words, None, row.state in (FINISHED, UNDECIDED)
    if row.kind != JOB and (folder / HISTORY).is_file():
        try:
            with reading(folder):
                result = Result(folder)
                energy = figures.energies(result)
                _draw(folder, picture.stored_steps(result), int(result.history("impact")[-1:].sum()) + done)
                text = screen(result) if done else log
        except (ColdsprayError, OSError) as error:
            text = f"{error}\n\n{log}"
    patterns = "live*.png", "coating/*.png", "micrograph.png"
    pictures = (workspace.address(path) for pattern in patterns for path in sorted(folder.glob(pattern)))
    return Now(row, text, energy, tuple(pictures))


@lru_cache(maxsize=32)
def _draw(folder: Path, steps: int, impact: int) -> None:
    """Draw the cross-section at the last stored step and, after two impacts or more, the growth of the coating. steps: number of stored
    steps; impact: number of finished impacts plus 1. A repeated call with the same arguments has no effect."""
    with _DRAWING:
        if steps:
            picture.section_picture(Result(folder), folder / "live.png")
        if impact > 2:
            coating_files.draw_growth(coating.growth(Result(folder)), folder / "live_growth.png")
