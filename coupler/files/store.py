"""The folder of one run (docs/guide/files.md): readable at every moment, written by one process only.

summary.json is written last: its presence says that the run is finished.
"""

import contextlib
import errno
import fcntl
import json
import os
import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Annotated, TextIO

import numpy as np
from numpy.typing import ArrayLike
from pydantic_core import to_json

from ..core.records import Shape, unfit
from ..errors import StoreError, UnreadableError
from . import checkpoint
from .outputs import ELSEWHERE, REPLACE, RUN_FILES, check_folder, claim_folder, write_text
from .result import COLD, DOMAINS, HISTORY
from .vtkhdf import Data, VtkHdfWriter, first_steps

SCENE, PLAN, LOG = "scene.toml", "plan.json", "run.log"
SUMMARY, PICTURE = "summary.json", "section.png"


@dataclass(frozen=True)
class StoreState:
    """Amount of data written to each file. steps: of each domain's fields; columns and history (rows, columns): of history.csv."""

    steps: dict[str, int]
    columns: list[str]
    history: Annotated[np.ndarray, Shape(-1, -1)]


class Store:
    """Files of one run. Make it with `Store.create`; a context manager that closes what it opened. Every failure to write becomes a
    StoreError that names the file; steps written before stay readable."""

    def __init__(self, directory: Path, lock: int | None = None):
        self.directory = directory
        self._lock = lock
        self._writers: dict[str, VtkHdfWriter] = {}
        self._history: TextIO | None = None
        self._columns: list[str] = []
        self._rows = array("d")  # all values of the history, row by row: a checkpoint keeps them

    @classmethod
    def create(cls, out_dir: str | Path, scene_toml: str, force: bool = False, plan_json: str = "") -> "Store":
        """Make the folder, or empty it of an earlier run, and put the scene and the plan in it. Only files with the names of this
        module are ever removed; a finished run, or files of these names that no run has written, only with `force`. Raises StoreError:
        such files are there, another run writes there, or the folder is not writable."""
        directory = Path(out_dir)
        with _named(directory, is_folder=True):
            check_folder(directory)
            ways = f"add {REPLACE} to replace it, or choose {ELSEWHERE}"
            if (directory / SUMMARY).exists() and not force:
                raise StoreError(f"{directory} holds a finished run; {ways}")
            if checkpoint.stored(directory) and not force:
                resume = f"continue it with coldspray resume {directory}"
                raise StoreError(f"{directory} holds an unfinished run; {resume}, {ways}")
            claim_folder(directory, "run", (*RUN_FILES, "checkpoint-*.ckpt"), force=force)
            store = cls(directory, _lock(directory))
            try:
                # The summary first: a run that replaces a finished one is unfinished from its first moment.
                fields = (f"{domain}.vtkhdf" for domain in (*DOMAINS, COLD))
                for name in (SUMMARY, PLAN, PICTURE, HISTORY, LOG, *fields):
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
        """Take the folder of an unfinished run. Raises StoreError: another run writes there, or it is not writable."""
        directory = Path(out_dir)
        with _named(directory, is_folder=True):
            return cls(directory, _lock(directory))

    def state(self) -> StoreState:
        """The history, and how many steps of each domain are written: the argument of `go_on`."""
        steps = {domain: writer.steps for domain, writer in self._writers.items()}
        history = np.array(self._rows).reshape(-1, max(len(self._columns), 1))
        return StoreState(steps, list(self._columns), history)

    def go_on(self, state: StoreState | None, log: Callable[[str], None]) -> None:
        """Set the files back to the time of a `state`: later records are removed. None: start all files again. Files are made new from
        the old, which stay until then: nothing is lost if this is interrupted. A file that can no longer be read starts anew, with a
        line to log(text)."""
        steps = state.steps if state else {}
        with _named(self.directory / SUMMARY):  # of an undecided run
            (self.directory / SUMMARY).unlink(missing_ok=True)
        for domain in (*DOMAINS, COLD):
            path = self.directory / f"{domain}.vtkhdf"
            with _named(path):
                if steps.get(domain):
                    self._copy_steps(domain, path, steps[domain], log)
                else:
                    path.unlink(missing_ok=True)
        path = self.directory / HISTORY
        with _named(path):
            if state and len(state.history):
                if state.history.shape[1] != len(state.columns):
                    raise unfit("the history has other columns")
                self._columns = list(state.columns)
                self._rows = array("d", state.history.ravel().tobytes())
                write_text(path, "".join(map(_line, [self._columns, *state.history])))
                self._history = open(path, "a", encoding="ascii")  # noqa: SIM115  (closed by close)
            else:
                path.unlink(missing_ok=True)

    def go_back(self, state: StoreState | None, log: Callable[[str], None]) -> None:
        """As `go_on`, for a store that has written more since."""
        with _named(self.directory):
            for writer in self._writers.values():
                writer.close()
            if self._history is not None:
                self._history.close()
        self._writers, self._history, self._rows = {}, None, array("d")
        self.go_on(state, log)

    def _copy_steps(self, domain: str, path: Path, steps: int, log: Callable[[str], None]) -> None:
        part = path.with_suffix(".part")
        try:
            writer = first_steps(path, part, steps)
        except UnreadableError:
            part.unlink(missing_ok=True)
            raise
        except (StoreError, IndexError) as error:
            kept = path.with_suffix(".vtkhdf.damaged")
            end = f"the file begins again at the checkpoint, the old one is kept as {kept.name}"
            log(f"{path} cannot be read ({error}): {end}")
            os.replace(path, kept)
            writer = VtkHdfWriter(part)
        os.replace(part, path)
        writer.path = path
        self._writers[domain] = writer

    def write(self, domain: str, time: float, points: ArrayLike, cells: ArrayLike, *data: Data) -> None:
        """Append one time step to `DIR/<domain>.vtkhdf`. domain: "particle" (cells (n, 1)), "surface" (triangles (m, 3)), "target" or
        "cold" (tets (m, 4)). time: s. Shapes and units as in `VtkHdfWriter.write`. Raises StoreError, for example when the disk is
        full."""
        if domain not in (*DOMAINS, COLD):
            raise ValueError(f"unknown domain {domain!r}, have {(*DOMAINS, COLD)}")
        path = self.directory / f"{domain}.vtkhdf"
        with _named(path):
            if domain not in self._writers:
                self._writers[domain] = VtkHdfWriter(path)
            self._writers[domain].write(time, points, cells, *data)

    def record(self, row: Mapping[str, float]) -> None:
        """Append one line to history.csv; the first row names the columns, later rows carry the same ones."""
        path = self.directory / HISTORY
        with _named(path):
            if self._history is None:
                self._columns = list(row)
                self._history = open(path, "w", encoding="ascii")  # noqa: SIM115  (closed by close)
                self._history.write(_line(self._columns))
            if row.keys() != set(self._columns):
                raise ValueError(f"history has the columns {self._columns}, got {list(row)}")
            values = [float(row[name]) for name in self._columns]
            self._history.write(_line(values))
            self._history.flush()
            self._rows.extend(values)

    def log(self, text: str) -> None:
        """Append lines to run.log, with date and time. A log that cannot be written ends no run."""
        stamp = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
        log = self.directory / LOG
        with contextlib.suppress(OSError), open(log, "a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{stamp}  {text}\n")

    def finish(self, summary: Mapping[str, object]) -> None:
        """Write summary.json whole or not at all, with the number of rows of the history. Numbers that are not finite become null."""
        rows = {"history_rows": len(self._rows) // len(self._columns)} if self._columns else {}
        plain = to_json({**summary, **rows}, inf_nan_mode="null", fallback=lambda value: value.tolist())
        with _named(self.directory / SUMMARY):
            write_text(self.directory / SUMMARY, json.dumps(json.loads(plain), indent=2) + "\n")

    def close(self) -> None:
        """Close all files. Never raises: a failed write has raised its own error."""
        with contextlib.suppress(Exception):
            if self._history is not None:
                self._history.close()
        for writer in self._writers.values():
            with contextlib.suppress(Exception):
                writer.close()
        self._writers = {}
        self._history = None
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> "Store":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class WithoutFields(Store):
    """The folder of a run whose summary alone is used: fields and history are not written."""

    def write(self, domain: str, time: float, points: ArrayLike, cells: ArrayLike, *data: Data) -> None:
        """Write nothing."""

    def record(self, row: Mapping[str, float]) -> None:
        """Write nothing."""


def _line(cells: Iterable[str | float]) -> str:
    """A line of the history."""
    return ",".join(cell if isinstance(cell, str) else f"{cell:.10g}" for cell in cells) + "\n"


def _lock(directory: Path) -> int | None:
    """Hold the folder for this process; the system releases it when the process ends, however it ends."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise StoreError(f"another run is writing to {directory}; choose {ELSEWHERE}") from None
    except OSError:  # a file system without locks is no reason to refuse a run
        os.close(descriptor)
        return None
    return descriptor


@contextlib.contextmanager
def _named(path: Path, is_folder: bool = False) -> Iterator[None]:
    """Turn a failure to write into a StoreError that names the file or the folder of a run that begins."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        where, kept = ("to the folder ", "") if is_folder else ("", "; steps written before are kept")
        raise StoreError(f"cannot write {where}{path}: {_reason(error)}{kept}") from error


def _reason(error: Exception) -> str:
    # HDF5 puts the number into its text only.
    match = re.search(r"errno = (\d+)", str(error))
    number = int(match[1]) if match else error.errno if isinstance(error, OSError) else None
    if number == errno.ENOSPC:
        return "no space left on the disk"
    if number == errno.EBADF or number is None:
        return str(error)
    return os.strerror(number)
