"""Protection of files: files that this program did not write are replaced only with --force, input files never.

A file of coldspray has the text MARK in its first or last bytes. A folder of coldspray has a file MARKER that contains its kind.
"""

import contextlib
import os
import stat
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from ..errors import StoreError
from .inputs import parse_toml, read_toml

MARK = "written by coldspray"
MARKER = ".coldspray"
RUN_FILES = (
    "scene.toml", "plan.json", "summary.json", "history.csv", "particle.vtkhdf", "surface.vtkhdf", "target.vtkhdf", "cold.vtkhdf",
    "section.png", "run.log", "log.lammps",
)  # fmt: skip
# texts for messages: options of commands and of Python
REPLACE, ELSEWHERE = "--force (Python: force=True)", "another folder with --out (Python: out=...)"
_ENDS = 8192  # bytes at both ends of a file that are searched for MARK


def claim_file(path: Path, suffixes: Sequence[str], inputs: Iterable[Path] = (), force: bool = False) -> Path:
    """Check, before the computation, that a command may write a file. Returns the path. suffixes: allowed endings, in lower case;
    inputs: files and run folders that the command reads, which are never replaced; force: replace a file that this program did not
    write. Raises StoreError."""
    if path.suffix.lower() not in suffixes:
        raise StoreError(f"cannot write {path}: its name ends in {path.suffix!r}; use {' or '.join(suffixes)}")
    if not path.parent.exists():
        raise StoreError(f"cannot write {path}: there is no folder {path.parent}")
    check_folder(path.parent)
    _refuse_inputs(path, inputs)
    if path.name in RUN_FILES and kind_of(path.parent) == "run":
        raise StoreError(f"cannot write {path}: it is a file of the run in {path.parent}; choose another name")
    if path.exists() and not path.is_file():
        raise StoreError(f"cannot write {path}: it is a folder, a pipe or a device; choose another name")
    if (path.is_symlink() or path.exists()) and not force and not is_ours(path):
        raise StoreError(f"{path} was not {MARK}: add --force to replace it, or choose another name")
    return path


def claim_folder(
    folder: Path, kind: str, names: Sequence[str], inputs: Iterable[Path] = (), force: bool | None = False
) -> None:
    """Check that a command may write files into a folder; create the folder and mark it with its kind. names: patterns of the files
    that may be replaced in a folder of this kind; force: replace these files in any other folder too, None if the command has no
    such option; inputs: files that are never replaced. Raises StoreError."""
    check_folder(folder)
    present = [path for name in names for path in sorted(folder.glob(name))] if folder.is_dir() else []
    keep_inputs(folder, names, inputs)
    for path in present:
        if path.is_dir() and not path.is_symlink():
            raise StoreError(f"cannot write {path}: there is a folder of this name; choose {ELSEWHERE}")
    choice, other = ELSEWHERE + ("" if force is None else f", or add {REPLACE}"), not force and kind_of(folder) != kind
    if present and other:
        there = f"{present[0].name}, which was not {MARK} as part of a {kind}"
        raise StoreError(f"{folder} holds {there}: choose {choice}{' to replace it' if force is not None else ''}")
    if other and folder.is_symlink() and any(folder.iterdir()):
        there = f"{folder.resolve()}, a folder with files that coldspray did not write"
        raise StoreError(f"{folder} is a link to {there}: choose {choice}")
    if kind_of(folder) not in ("", kind) and not force:
        raise StoreError(f"{folder} holds the results of coldspray {kind_of(folder)}: choose {ELSEWHERE}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if kind_of(folder) != kind:
            (folder / MARKER).write_text(f"{MARK}: {kind}\n", encoding="utf-8")
    except OSError as error:
        raise StoreError(f"cannot write to the folder {folder}: {error.strerror or error}") from None


def keep_inputs(folder: Path, names: Sequence[str], inputs: Iterable[Path]) -> None:
    """Raise StoreError if a file of a folder that matches one of the names is an input."""
    sources = list(inputs)
    for path in [path for name in names for path in folder.glob(name)]:
        _refuse_inputs(path, sources)


def check_folder(folder: Path) -> None:
    """Raise StoreError unless files can be written into a folder. If the folder is missing, it must be possible to create it."""
    try:
        mode = folder.stat().st_mode
    except FileNotFoundError:
        if folder.parent != folder:
            check_folder(folder.parent)
        return
    except OSError as error:
        raise StoreError(f"cannot write to the folder {folder}: {error.strerror}") from None
    if not stat.S_ISDIR(mode):
        raise StoreError(f"cannot write to {folder}: it is not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise StoreError(f"cannot write to the folder {folder}: no permission, or a read-only disk")


def kind_of(folder: Path) -> str:
    """The kind of a folder of coldspray, from its marker; "" for other folders."""
    with contextlib.suppress(OSError, ValueError):
        with open(os.open(folder / MARKER, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as stream:
            text = stream.read(200).decode("utf-8")
        if text.startswith(f"{MARK}: "):
            return text.removeprefix(f"{MARK}: ").strip()
    return ""


def is_ours(path: Path) -> bool:
    """Whether a file has MARK near its beginning or end."""
    with contextlib.suppress(OSError):
        if stat.S_ISREG(path.stat().st_mode):
            with path.open("rb") as stream:
                ends = stream.read(_ENDS)
                stream.seek(max(path.stat().st_size - _ENDS, 0))
                return MARK.encode() in ends + stream.read(_ENDS)
    return False


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Context with the path of a temporary file, which replaces `path` at the end. Raises StoreError."""
    part = path.with_name(f".part-{os.getpid()}-{path.name}")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file completely or not at all. Raises StoreError."""
    with replacing(path) as part, part.open("w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())


def keep_toml(path: Path, text: str, what: str, but: Iterable[str] = ()) -> None:
    """Write to `path` the TOML text from which the results in its folder are computed. what: kind of the text, for the message; but:
    keys whose values may differ from those in an existing file. Raises StoreError if the value of another key differs."""
    free = dict.fromkeys(but)
    if path.exists() and {**read_toml(path), **free} != {**parse_toml(text), **free}:
        there = f"{path.parent} already holds another {what}"
        raise StoreError(f"{there}: choose another folder with --out, or remove that {what}")
    write_text(path, text)


def _refuse_inputs(path: Path, inputs: Iterable[Path]) -> None:
    """Raise StoreError if a path (also through links) is an input file, or a run file in an input folder."""
    for item in inputs:
        for source in [item / name for name in RUN_FILES] if item.is_dir() else [item]:
            with contextlib.suppress(OSError):
                if path.samefile(source):
                    same = f"it is the same file as the input {source}"
                    raise StoreError(f"cannot write {path}: {same}; choose another name or folder")
