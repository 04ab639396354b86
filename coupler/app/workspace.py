"""The folder with the scenes, runs and processes of the local web page. Paths outside this folder are refused."""

import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from ..errors import ColdsprayError, StoreError
from ..files import checkpoint
from ..files.inputs import last_lines, leaves, parse_toml, read_text, reading
from ..files.outputs import kind_of, write_text
from ..files.result import Result
from ..files.store import locked
from ..report.words import title, verdict
from ..studies.pace import Pace

LOG, PID = "app.log", "app.pid"  # in a results folder: what its process prints, and the number of the process
KINDS = RUN, JOB = "run", "job"  # as folders are marked
COATING = "coating"  # a run of several impacts
RUNNING, QUEUED, STOPPED = "running", "queued", "stopped"  # states of a folder
FINISHED, UNDECIDED, DAMAGED = "finished", "undecided", "damaged"
RECENT = 60.0  # s: a run that has changed within this time, but has no process of the page, is computed elsewhere
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", re.ASCII)
_OF_FILES = re.compile(r"library|.+\.(files?|sizes|distribution|efficiency)")  # keys whose value may be a path


@dataclass(frozen=True)
class Row:
    """A results folder. name: its path below `runs`; kind: RUN, COATING or JOB; words: its metals and its verdict, or the error
    message if it is damaged; changed: time of the last change, s since 1970."""

    name: str
    kind: str
    state: str
    words: str
    changed: float


class Workspace:
    """A workspace: scenes are in the folder `root`, results in `root`/runs. templates: start text of the forms, by kind; here: speed
    of this machine. All methods raise ColdsprayError."""

    def __init__(self, root: Path, templates: Mapping[str, str], here: Pace):
        self.root, self.templates, self.here = root.resolve(), templates, here
        self.runs = self.root / "runs"
        self.runs.mkdir(parents=True, exist_ok=True)

    def inside(self, name: str) -> Path:
        """Return the path of a file below `root`. name: its path relative to `root`. Raises StoreError if the path leads out of
        `root`, by ".." or by a link."""
        path = self.root / name
        if "\0" in name or not path.resolve().is_relative_to(self.root):
            raise StoreError(f"{name[:80]!r} lies outside the workspace: copy it into {self.root}")
        return path

    def folder(self, name: str) -> Path:
        """Return the path of a results folder. name: its path below `runs`. Raises StoreError if the path is not inside `runs`."""
        path = self.inside(f"runs/{name}")
        if self.runs not in path.resolve().parents:
            raise StoreError(f"there is no folder {name[:80]!r} in {self.runs}: choose a folder of the list")
        return path

    def address(self, path: Path) -> str:
        """Return the web address of a results file. The address is different after each change of the file, so that a browser loads
        it again."""
        return f"/files/{quote(path.relative_to(self.runs).as_posix())}?{path.stat().st_mtime_ns}"

    def outside(self, text: str) -> list[str]:
        """Return a problem for each file outside the workspace that a scene or job names. text: TOML text of the scene or job."""
        problems = []
        with suppress(ValueError):  # its reader reports this error
            for key, value in leaves(parse_toml(text)):
                if _OF_FILES.fullmatch(key) and isinstance(value, str):
                    try:
                        self.inside(value)
                    except StoreError as error:
                        problems.append(f"{key} = {error}")
        return problems

    def save(self, name: str, text: str, suffix: str = ".toml") -> Path:
        """Write a new file into `root`. Raises StoreError if the name is not valid or already in use."""
        if not _NAME.fullmatch(name):
            rule = "use letters, digits, '_', '.', '-' (at most 64, a letter or digit first)"
            raise StoreError(f"name = {name[:80]!r}: {rule}")
        path = self.inside(name + suffix)
        if path.exists() or path.is_symlink():
            raise StoreError(f"name = {name!r}: {path.name} exists, choose another name")
        write_text(path, text)
        return path

    def free(self, stem: str) -> str:
        """Return a name, beginning with `stem`, that no scene and no results folder has."""
        numbers = (f"{stem}-{k}" for k in range(1, 10**6))
        return next(n for n in numbers if not (self.root / f"{n}.toml").exists() and not (self.runs / n).exists())

    def start(self, folder: Path, *words: str) -> None:
        """Put the command `coldspray WORDS` into the queue. folder: its results folder, in which the process is registered. Raises
        StoreError if the folder already has a process."""
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / LOG).open("a") as log:
            try:
                fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)  # locked by the process, and by what it starts
            except BlockingIOError:
                raise StoreError(f"{folder.name} is already in the queue or running: stop it first") from None
            log.truncate(0)
            process = subprocess.Popen(
                [sys.executable, "-m", "coupler.app.queued", str(self.runs / ".queue"), *words], cwd=self.root,
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True, env=_environment(),
            )  # fmt: skip
        write_text(folder / PID, str(process.pid))

    def begin(self, verb: str, name: str, text: str) -> Path:
        """Save a new scene or job, and put its computation into the queue. Returns the results folder."""
        folder = self.folder(name)
        if problems := self.outside(text):
            raise StoreError("\n".join(problems))
        if os.path.lexists(folder):
            raise StoreError(f"runs/{name} exists: choose another name")
        self.start(folder, verb, str(self.save(name, text)), "--out", str(folder))
        return folder

    def resume(self, folder: Path) -> None:
        """Put a stopped run, an undecided run or a job into the queue again. Raises StoreError if it has a process, or for a folder
        without run or job."""
        if not _is_ours(folder):
            raise StoreError(f"{folder.name} is not the folder of a run or a job, and cannot be continued")
        scene = self.root / f"{folder.relative_to(self.runs)}.toml"
        if kind_of(folder) == JOB:
            kept = scene if scene.is_file() else folder / "job.toml"
            self.start(folder, "job", str(kept), "--out", str(folder))
        elif checkpoint.stored(folder) or (folder / "summary.json").is_file() or not scene.is_file():
            self.start(folder, "resume", str(folder))
        else:
            self.start(folder, "run", str(scene), "--out", str(folder))

    def stop(self, folder: Path) -> None:
        """Stop the process of a folder as Ctrl-C does; its results so far are kept. A process that still waits in the queue has no
        results and is killed, because it may ignore an interrupt. Raises StoreError for a process that this page has not started."""
        if alive(folder):
            with suppress(ProcessLookupError, ValueError):
                kind = signal.SIGINT if last_lines(folder / LOG) else signal.SIGKILL
                os.killpg(int(read_text(folder / PID)), kind)
        else:
            with _locked(folder):
                pass

    def call(self, *words: str) -> str:
        """Run a command of coldspray that ends within seconds and return its printed text. words: the words after `coldspray`. Raises
        ColdsprayError with the message of the command."""
        done = subprocess.run(
            [sys.executable, "-m", "coupler", *words], cwd=self.root, env=_environment(), stdin=subprocess.DEVNULL,
            capture_output=True, text=True,
        )  # fmt: skip
        if done.returncode:
            raise ColdsprayError(done.stderr.strip().removeprefix("coldspray: "))
        return done.stdout

    def delete(self, folder: Path) -> None:
        """Delete a results folder. Raises StoreError for other folders, and for a folder with a process."""
        if alive(folder) or not _is_ours(folder):
            raise StoreError(f"{folder.name} cannot be deleted: it is running, a link, or not a run")
        with _locked(folder):
            shutil.rmtree(folder)

    def rows(self, below: Path | None = None) -> list[Row]:
        """All results folders below the folder `below` (default: `runs`), latest first. Results folders inside another one are parts
        of it and not listed."""
        found = []
        for place, folders, _ in os.walk(below or self.runs):
            for name in sorted(folders):
                if _is_ours(folder := Path(place, name)):
                    found.append(self.row(folder))
                    folders.remove(name)
        return sorted(found, key=lambda row: -row.changed)

    def row(self, folder: Path) -> Row:
        """The data of a results folder. For a damaged folder, `words` is the error message."""
        kind, state, words, changed = kind_of(folder) or RUN, STOPPED, "", 0.0
        with suppress(OSError):
            changed = max(path.stat().st_mtime for path in folder.iterdir())
        log = last_lines(folder / LOG)
        if alive(folder):
            state = RUNNING if log else QUEUED
        elif kind == JOB and (folder / "job.json").is_file():
            state = FINISHED
        elif time.time() - changed < RECENT and not (folder / LOG).exists():
            state = RUNNING
        try:
            with reading(folder):
                if kind == RUN and (folder / "plan.json").is_file():
                    result = Result(folder)
                    kind = COATING if len(result.plan.get("impacts", ())) > 1 else RUN
                    words = " · ".join([title(result), *verdict(result.summary)[:1]])
                    if result.finished and not alive(folder):
                        state = FINISHED if result.undecided is None else UNDECIDED
                elif log:
                    words = log.splitlines()[-1]
        except ColdsprayError as error:
            state, words = DAMAGED, str(error)
        return Row(folder.relative_to(self.runs).as_posix(), kind, state, words, changed)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Context in which no process computes in a folder. Raises StoreError if one does, which this page has not started."""
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(folder))
        except StoreError:
            raise StoreError(
                f"{folder.name} is computed by a process that was not started here: stop it where it runs"
            ) from None
        yield


def _is_ours(folder: Path) -> bool:
    # False for a folder without permission, where Path.is_file raises an error
    return not folder.is_symlink() and (kind_of(folder) in KINDS or os.path.isfile(folder / LOG))


def _environment() -> dict[str, str]:
    # Python must not import from the workspace: files of the user can have the names of modules
    return {**os.environ, "PYTHONSAFEPATH": "1"}


def alive(folder: Path) -> bool:
    """Whether a process of the web page computes in a folder. Such a process holds the lock on the log file, whichever server has
    started it."""
    try:
        with (folder / LOG).open() as log:
            fcntl.flock(log, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    return False
