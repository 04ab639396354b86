"""The folder of one run (docs/guide/files.md). It is readable at any time, and only one process writes to it. summary.json is written
last: if it exists, the run is finished."""

import contextlib
import errno
import fcntl
import itertools
import json
import os
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, TextIO

import numpy as np
from numpy.typing import ArrayLike
from pydantic_core import to_json

from ..core.records import Shape, unfit
from ..errors import StoreError, UnreadableError
from . import checkpoint
from .fields import opened, times_of
from .outputs import ELSEWHERE, REPLACE, RUN_FILES, check_folder, claim_folder, write_text
from .result import HISTORY, PROPERTIES_FILE, STORED, fields_file
from .vtkhdf import Data, VtkHdfWriter, first_steps

SCENE, PLAN, LOG = "scene.toml", "plan.json", "run.log"
SUMMARY, PICTURE = "summary.json", "section.png"


@dataclass(frozen=True)
class StoreState:
    """Data that a run has written. steps: number of stored steps of each domain; columns, history (rows, columns): of history.csv."""

    steps: dict[str, int]
    columns: list[str]
    history: Annotated[np.ndarray, Shape(-1, -1)]


class Store:
    """The files of one run, from `Store.create` or `Store.reopen`; a context manager that closes them. A failure to write raises
    StoreError with the name of the file; earlier steps stay readable."""

    def __init__(self, directory: Path, lock: int | None = None):
        self.directory = directory
        self._lock = lock
        self._writers: dict[str, VtkHdfWriter] = {}
        self._history: TextIO | None = None
        self._columns: list[str] = []
        self._rows = array("d")  # all values of the history, row by row, for checkpoints

    @classmethod
    def create(cls, out_dir: str | Path, scene_toml: str, force: bool = False, plan_json: str = "") -> "Store":
        """Create the folder of a new run and write scene and plan. Run files that were in the folder are removed, all others stay.

        force: accept a folder with a finished or unfinished run, or with other files that have names of run files. Raises StoreError
        for such a folder without `force`, if another run writes there, or if the folder is not writable.
        """
        directory = Path(out_dir)
        with _named(directory, is_folder=True):
            check_folder(directory)
            remedies = f"add {REPLACE} to replace it, or choose {ELSEWHERE}"
            if (directory / SUMMARY).exists() and not force:
                raise StoreError(f"{directory} holds a finished run; {remedies}")
            if checkpoint.stored(directory) and not force:
                resume = f"continue it with coldspray resume {directory}"
                raise StoreError(f"{directory} holds an unfinished run; {resume}, {remedies}")
            claim_folder(directory, "run", (*RUN_FILES, "checkpoint-*.ckpt"), force=force)
            store = cls(directory, lock_folder(directory))
            try:
                # the summary first: without it the new run counts as unfinished
                for name in (
                    SUMMARY,
                    PROPERTIES_FILE,
                    PLAN,
                    PICTURE,
                    HISTORY,
                    LOG,
                    *(f"{domain}.vtkhdf" for domain in STORED),
                ):
                    (directory / name).unlink(missing_ok=True)
                checkpoint.clear(directory)
                if plan_json:
                    write_text(directory / PLAN, plan_json)
                write_text(directory / SCENE, scene_toml)
            except BaseException:
                store.close()
                raise
        return store

    @classmethod
    def reopen(cls, out_dir: str | Path) -> "Store":
        """Open the folder of an unfinished run. Raises StoreError if another run writes there, or it is not writable."""
        directory = Path(out_dir)
        with _named(directory, is_folder=True):
            return cls(directory, lock_folder(directory))

    def state(self) -> StoreState:
        """The numbers of steps and the history written so far, for `go_on`."""
        steps = {domain: writer.steps for domain, writer in self._writers.items()}
        history = np.array(self._rows).reshape(-1, max(len(self._columns), 1))
        return StoreState(steps, list(self._columns), history)

    def go_on(self, state: StoreState | None, log: Callable[[str], None]) -> None:
        """Reset the files to an earlier `state`; None: remove them. New files replace the old ones only when they are complete, so that
        an interruption loses nothing. A damaged file is renamed, and a new one is started; log(text) receives a line about it."""
        self._close_files()
        steps = state.steps if state else {}
        with _named(self.directory / SUMMARY):  # it exists if the run was undecided
            for name in (SUMMARY, PROPERTIES_FILE):
                (self.directory / name).unlink(missing_ok=True)
        for domain in STORED:
            path = fields_file(self.directory, domain)
            with _named(path):
                if steps.get(domain):
                    self._copy_steps(domain, path, steps[domain], log)
                else:
                    path.unlink(missing_ok=True)
        path = self.directory / HISTORY
        with _named(path):
            if state and len(state.history):
                if state.history.shape[1] != len(state.columns):
                    raise unfit("history.csv has another number of columns than of names")
                self._columns = list(state.columns)
                self._rows = array("d", state.history.ravel().tobytes())
                write_text(path, "".join(map(_line, [self._columns, *state.history])))
                self._history = open(path, "a", encoding="ascii")  # noqa: SIM115  (closed by close)
            else:
                path.unlink(missing_ok=True)

    def _copy_steps(self, domain: str, path: Path, steps: int, log: Callable[[str], None]) -> None:
        part = path.with_suffix(".part")
        try:
            with opened(path) as file:
                there = len(times_of(file))
            if there < steps:  # a retry has removed steps after the checkpoint
                log(f"{path} has {there} steps, but the checkpoint has {steps}: the others are missing")
            writer = first_steps(path, part, min(there, steps))
        except UnreadableError:
            part.unlink(missing_ok=True)
            raise
        except StoreError as error:
            end = "a new file starts at the checkpoint"
            if path.exists():
                names = (path.with_suffix(f".vtkhdf.damaged{k or ''}") for k in itertools.count())
                kept = next(name for name in names if not name.exists())
                os.replace(path, kept)
                end += f"; the old file is kept as {kept.name}"
            log(f"{path} cannot be read ({error}): {end}")
            writer = VtkHdfWriter(part)
        os.replace(part, path)
        writer.path = path
        self._writers[domain] = writer

    def write(self, domain: str, time: float, points: ArrayLike, cells: ArrayLike, *data: Data) -> None:
        """Append one time step to `DIR/<domain>.vtkhdf`. domain: "particle" (cells (n, 1)), "surface" (triangles (m, 3)), "target" or
        "cold" (tetrahedra (m, 4)). Other arguments as for `VtkHdfWriter.write`. Raises StoreError, such as for a full disk."""
        path = fields_file(self.directory, domain)
        with _named(path):
            if domain not in self._writers:
                self._writers[domain] = VtkHdfWriter(path)
            self._writers[domain].write(time, points, cells, *data)

    def record(self, row: Mapping[str, float]) -> None:
        """Append one row to history.csv. The keys of the first row are the columns; later rows must have the same keys."""
        path = self.directory / HISTORY
        with _named(path):
            if self._history is None:
                self._columns = list(row)
                self._history = open(path, "w", encoding="ascii")  # noqa: SIM115  (closed by close)
                self._history.write(_line(self._columns))
            if row.keys() != set(self._columns):
                raise ValueError(f"the history has the columns {self._columns}, but the new row has {list(row)}")
            values = [float(row[name]) for name in self._columns]
            self._history.write(_line(values))
            self._history.flush()
            self._rows.extend(values)

    def log(self, text: str) -> None:
        """Append text to run.log, with date and time. A failure to write is ignored."""
        stamp = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
        log = self.directory / LOG
        with contextlib.suppress(OSError), open(log, "a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{stamp}  {text}\n")

    def finish(self, summary: Mapping[str, object]) -> None:
        """Write summary.json with the number of rows of the history, completely or not at all. Infinite numbers and NaN become null."""
        rows = {"history_rows": len(self._rows) // len(self._columns)} if self._columns else {}
        plain = to_json({**summary, **rows}, inf_nan_mode="null", fallback=lambda value: value.tolist())
        with _named(self.directory / SUMMARY):
            write_text(self.directory / SUMMARY, json.dumps(json.loads(plain), indent=2) + "\n")

    def close(self) -> None:
        """Close all files. Errors in closing are ignored, because a failed write has already raised an error."""
        self._close_files()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _close_files(self) -> None:
        for file in (self._history, *self._writers.values()):
            with contextlib.suppress(Exception):
                if file is not None:
                    file.close()
        self._writers, self._history, self._rows = {}, None, array("d")

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class WithoutFields(Store):
    """The folder of a run that needs only a summary: fields and history are not written."""

    def write(self, domain: str, time: float, points: ArrayLike, cells: ArrayLike, *data: Data) -> None: ...

    def record(self, row: Mapping[str, float]) -> None: ...


def _line(cells: Iterable[str | float]) -> str:
    """A row of history.csv. The first number, the time, has all digits: a stored step is found by its time."""
    texts = (
        cell if isinstance(cell, str) else f"{cell:.10g}" if i else repr(float(cell)) for i, cell in enumerate(cells)
    )
    return ",".join(texts) + "\n"


def lock_folder(directory: Path, wait: bool = False) -> int | None:
    """Lock the folder for this process; the system releases the lock when the process ends. Returns the descriptor, None on a file
    system without locks. wait: wait for a process that has locked it. Raises StoreError without `wait` if there is such a process."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        os.close(descriptor)
        raise StoreError(f"another run is writing to {directory}; choose {ELSEWHERE}") from None
    except OSError:  # a file system without locks: the run continues
        os.close(descriptor)
        return None
    return descriptor


@contextlib.contextmanager
def locked(directory: Path) -> Iterator[None]:
    """Context in which only this process writes to the folder. Raises StoreError if another process does (`lock_folder`)."""
    lock = lock_folder(directory)
    try:
        yield
    finally:
        if lock is not None:
            os.close(lock)


@contextlib.contextmanager
def _named(path: Path, is_folder: bool = False) -> Iterator[None]:
    """Context that turns an error of writing into a StoreError with the path. is_folder: it is the folder of a new run."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        where, kept = ("to the folder ", "") if is_folder else ("", "; steps that were written before are kept")
        raise StoreError(f"cannot write {where}{path}: {_reason(error)}{kept}") from error


def _reason(error: Exception) -> str:
    # HDF5 gives the error number only in its text
    match = re.search(r"errno = (\d+)", str(error))
    number = int(match[1]) if match else error.errno if isinstance(error, OSError) else None
    if number == errno.ENOSPC:
        return "no space left on the disk"
    if number == errno.EBADF or number is None:
        return str(error)
    return os.strerror(number)
