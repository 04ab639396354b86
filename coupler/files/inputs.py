"""Reading of input files, and limits of memory. Only regular files are read; their size is compared with limits and with the free
memory before they are read and parsed."""

import json
import math
import os
import re
import resource
import stat
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from ..errors import StoreError
from ..units import nearest

T = TypeVar("T")
SCENE_LIMIT = 1_000_000  # bytes of a TOML file
TEXT_LIMIT = 256 * 1024**2  # bytes of any other text
DEPTH_LIMIT = 32  # tables within tables
_WITHOUT_QUOTES = re.compile(r"=\s*[-+0-9.]+\s*[A-Za-z\u00b5%]")
_TOO_DEEP = f"its tables are nested more than {DEPTH_LIMIT} levels deep"
INTEGER_LIMIT = 2**63
_LEAST_ADDRESS_SPACE = 2 * 1024**3  # bytes: the libraries reserve about this much before any computation
_LEAST_DESCRIPTORS = 64
_STATUS = "/proc/self/status"
_LIMITS = {"VmSize": resource.RLIMIT_AS, "VmData": resource.RLIMIT_DATA}  # memory in this file -> its limit
_LEAST_FILE = 16 * 1024**2  # bytes: MPI stores messages in files in memory
# tomllib stores every prefix of a dotted key: the memory grows with the square of its length
_DEEP_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){32}""")


class InputError(StoreError):
    """Error: a file cannot be read. reason: text without the name of the file."""

    def __init__(self, path: str | Path, reason: str):
        super().__init__(path, reason)
        self.reason = reason

    def __str__(self) -> str:
        return f"{self.args[0]} {self.reason}"


def check_regular(path: str | Path, limit: int | None = None) -> int:
    """Size of a regular file, bytes. limit: greatest size, bytes. Raises InputError if the file is larger, or the path is missing, a
    folder, a pipe, a device or a loop of links."""
    try:
        status = os.stat(path)
    except FileNotFoundError:
        raise InputError(path, "is missing") from None
    except (OSError, ValueError) as error:  # ValueError: a null byte in the name
        raise InputError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if stat.S_ISDIR(status.st_mode):
        raise InputError(path, "cannot be read: it is a folder, but a file is expected")
    if not stat.S_ISREG(status.st_mode):
        raise InputError(path, "cannot be read: it is a pipe or a device, but a regular file is expected")
    if limit is not None and status.st_size > limit:
        raise _too_large(path, limit)
    return status.st_size


def similar(path: str | Path, is_folder: bool = False) -> str:
    """A hint such as ' (did you mean "first.toml"?)' for a missing file, or folder if `is_folder`; "" without a similar name."""
    try:
        there = [p.name for p in Path(path).parent.iterdir() if p.is_dir() == is_folder and not os.path.exists(path)]
    except (OSError, ValueError):
        there = []
    return nearest(Path(path).name, there)


def open_input(path: str | Path, limit: int | None = None) -> BinaryIO:
    """Open a regular file for reading. limit: greatest size, bytes. Raises InputError."""
    check_regular(path, limit)
    try:
        return os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from None


def _too_large(path: str | Path, limit: int) -> InputError:
    return InputError(path, f"is larger than {_bytes(limit)}, the largest readable size: give a smaller file")


def read_text(path: str | Path, limit: int = TEXT_LIMIT) -> str:
    """The text of a file in UTF-8, without a byte-order mark. limit: greatest size, bytes. Raises InputError."""
    require_memory(2 * min(check_regular(path), limit), f"to read {path}")
    with open_input(path, limit) as stream:
        try:
            raw = stream.read(limit + 1)  # files in /proc report no size
        except OSError as error:
            raise InputError(path, f"cannot be read: {error.strerror or error}") from None
    if len(raw) > limit:
        raise _too_large(path, limit)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        reason = f"is not text in UTF-8 (byte {error.start}): save it in UTF-8, or give another file"
        raise InputError(path, reason) from None


def last_lines(path: Path, most: int = 1) -> str:
    """The last `most` lines of a text file; "" for a file that cannot be read."""
    with suppress(StoreError):
        return "\n".join(read_text(path).strip().splitlines()[-most:])
    return ""


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises ValueError if it is not TOML, nested too deeply, or has an integer of more than 64 bits."""
    if _DEEP_KEY.search(text):
        raise ValueError(_TOO_DEEP)
    return _parsed(tomllib.loads, text.removeprefix("\ufeff"))


def _parsed(load: Callable[[str], T], text: str) -> T:
    """Parse a text with the function `load`, and check the data by `check_nesting`. Raises ValueError."""
    try:
        data = load(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    check_nesting(data)
    return data


def read_toml(path: str | Path) -> dict[str, Any]:
    """The tables of a TOML file of at most SCENE_LIMIT bytes. Raises InputError."""
    return toml_of(read_text(path, SCENE_LIMIT), path)


def toml_of(text: str, path: str | Path) -> dict[str, Any]:
    """The tables in the text of a TOML file. Raises InputError with the name of the file."""
    try:
        return parse_toml(text)
    except ValueError as error:
        raise InputError(path, f"is not valid TOML: {error}{line_of(text, str(error))}") from None


def line_of(text: str, problem: str) -> str:
    """Text to append to the TOML error `problem`: the line with the error, and a hint on missing quotes; "" if no line is named."""
    place, lines = re.search(r"at line (\d+)", problem), text.splitlines()
    if place is None or not 0 < int(place[1]) <= len(lines):
        return ""
    line = lines[int(place[1]) - 1].strip()
    hint = '; write a value with its unit in quotes, such as "25 um"' if _WITHOUT_QUOTES.search(line) else ""
    return f": {''.join(c if c.isprintable() else '?' for c in line[:60])}{hint}" if line else ""


def parse_json(text: str) -> object:
    """The data of a JSON text. Raises ValueError if it is damaged or nested too deeply, or for a number that is not finite."""
    return _parsed(partial(json.loads, parse_constant=_finite, parse_float=_finite), text)


def read_json_object(path: str | Path) -> dict[str, object]:
    """The JSON object that a file holds, as a dict. Raises InputError."""
    try:
        data = parse_json(read_text(path))
    except ValueError as error:
        raise InputError(path, f"is damaged: {error}") from None
    if not isinstance(data, dict):
        raise InputError(path, "is damaged: not a JSON object")
    return data


def check_nesting(data: object) -> None:
    """Raise ValueError for dicts and lists nested more than DEPTH_LIMIT deep, and integers of more than 64 bits."""
    level = [data]
    for _ in range(DEPTH_LIMIT + 1):
        below: list[object] = []
        for item in level:
            if isinstance(item, dict):
                below += item.values()
            elif isinstance(item, list):
                below += item
            elif isinstance(item, int) and abs(item) >= INTEGER_LIMIT:
                raise ValueError("an integer has more than 64 bits")
        if not below:
            return
        level = below
    raise ValueError(_TOO_DEEP)


def leaves(table: Mapping[str, object], above: str = "") -> Iterator[tuple[str, object]]:
    """Each value in nested dicts with its key, such as "particle[2].velocity" (no index in a list of one). above: prefix of keys."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{above}{name}.")
        elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            for number, item in enumerate(value, 1):
                yield from leaves(item, f"{above}{name}{f'[{number}]' if len(value) > 1 else ''}.")
        else:
            yield above + name, value


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:20]} is not a number or too large")
    return value


@contextmanager
def reading(folder: str | Path) -> Iterator[None]:
    """Context for reading a run: errors from damaged files or files of different runs become InputError. Warnings are suppressed."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {error}"[:200]
        raise InputError(folder, f"cannot be read: its files are damaged or from different runs ({reason})") from error


# --- limits of the machine


def free_memory() -> int:
    """Memory that this process can still allocate, bytes: the least of the limits of the machine, its cgroup and the process."""
    return min(_field("/proc/meminfo", "MemAvailable") or 2**62, _cgroup(), _own_limits())


def require_memory(needed: float, purpose: str) -> None:
    """Raise StoreError if `needed` bytes are not free. purpose: for the message, such as "to read cloud.npz"."""
    if needed > 2**20 and needed > (free := free_memory()):
        remedy = "use a machine with more memory, raise the limit (ulimit -v, cgroup), or use a smaller file"
        numbers = f"about {_bytes(needed)} are needed, {_bytes(free)} are free"
        raise StoreError(f"not enough memory {purpose}: {numbers}; {remedy}")


@contextmanager
def bounded_memory() -> Iterator[None]:
    """Context in which an allocation beyond the free memory raises MemoryError, so that the system does not kill processes. It sets the
    soft RLIMIT_DATA (private writable memory) until the end. Raises StoreError if RLIMIT_NOFILE, _FSIZE or _AS is too small."""
    _check_own_limits()
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    used = _field(_STATUS, "VmData") + _field(_STATUS, "VmStk")
    bound = used + free_memory()
    if used and (hard == resource.RLIM_INFINITY or bound < hard):
        if soft != resource.RLIM_INFINITY:
            bound = min(bound, soft)
        resource.setrlimit(resource.RLIMIT_DATA, (bound, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _check_own_limits() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= soft < _LEAST_DESCRIPTORS:
        if 0 <= hard < _LEAST_DESCRIPTORS:
            needed = f"{_LEAST_DESCRIPTORS} are needed: raise this limit with ulimit -n"
            raise StoreError(f"the system allows only {hard} open files, but {needed}")
        resource.setrlimit(resource.RLIMIT_NOFILE, (_LEAST_DESCRIPTORS, hard))
    for limit, least, words, option in (
        (resource.RLIMIT_FSIZE, _LEAST_FILE, "files are limited", "-f"),
        (resource.RLIMIT_AS, _LEAST_ADDRESS_SPACE, "the address space is limited", "-v"),
    ):
        if 0 <= (bound := resource.getrlimit(limit)[0]) < least:
            raise StoreError(f"{words} to {_bytes(bound)}, {_bytes(least)} are needed: raise ulimit {option}")


def _cgroup() -> int:
    """Least free memory, bytes, of the cgroup (version 2) of this process and of the cgroups above it; 2**62 without a limit."""
    left, root = 2**62, Path("/sys/fs/cgroup")
    try:
        lines = Path("/proc/self/cgroup").read_text().splitlines()
    except OSError:
        return left
    folder = root / next((line[4:] for line in lines if line.startswith("0::/")), "")
    for level in (folder, *folder.parents):
        with suppress(OSError, ValueError):  # ValueError: "max", no limit
            bound, used = (int((level / f"memory.{name}").read_text()) for name in ("max", "current"))
            # the system frees pages of files when memory is short
            cached = _field(level / "memory.stat", "inactive_file", unit=1)
            left = min(left, max(bound - used + cached, 0))
    return left


def _own_limits() -> int:
    soft = {used: resource.getrlimit(kind)[0] for used, kind in _LIMITS.items()}
    own = (max(bound - _field(_STATUS, used), 0) for used, bound in soft.items() if bound != resource.RLIM_INFINITY)
    return min(own, default=2**62)


def _field(path: str | Path, name: str, unit: int = 1024) -> int:
    """A number from a file with lines "name: number kB" or "name number", times `unit` (bytes); 0 if it is missing."""
    with suppress(OSError):
        if found := re.search(rf"^{re.escape(name)}:?\s+(\d+)", Path(path).read_text(), re.MULTILINE):
            return int(found[1]) * unit
    return 0


def _bytes(count: float) -> str:
    return f"{count / 1e9:.3g} GB" if count >= 1e8 else f"{count / 1e6:.3g} MB"
