"""Checkpoints of a run: the complete state in one file, which is written completely or not at all and checked when it is read.

A file is an uncompressed .npz of arrays with checksums. Its array "header" is a JSON text: format, data that identify the run, and the
state, a record (`core.records`). Records are created by their class, whose fields define type and shape of each value.
"""

import contextlib
import json
import os
import re
import shutil
import types
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.lib.npyio import NpzFile

from ..core.records import rows_of, shapes_of
from ..errors import CheckpointError, StoreError, UnreadableError

FORMAT = 26
KEPT = 2
_NAME = re.compile(r"checkpoint-(\d{6})\.ckpt")
_OF_AN_ARRAY = 600  # most bytes for the header of an array
_AFTER_JSON: dict[type[Any], type[Any]] = {int: float, list: tuple}  # type after JSON -> type before
_RECORD, _ARRAY = "@record", "@array"  # keys in the JSON text: the class of a record, the name of an array
R = TypeVar("R")


class OtherVersion(CheckpointError):
    """Error: a checkpoint has another format, or belongs to another run."""


def write(directory: Path, state: object, about: Mapping[str, str]) -> Path:
    """Write the record `state` as the next checkpoint of a run, and remove all but the last KEPT. about: data that identify the
    run, for `latest`. Returns the path. Raises StoreError if it cannot be written (full disk); earlier checkpoints then stay."""
    numbers = [number for number, _ in stored(directory)]
    path = directory / f"checkpoint-{(numbers[-1] + 1 if numbers else 1):06d}.ckpt"
    temporary = path.with_suffix(".part")
    arrays: dict[str, np.ndarray] = {}
    header = {"format": FORMAT, "about": dict(about), "state": state}
    text = json.dumps(header, default=partial(_for_json, arrays))
    arrays["header"] = np.frombuffer(text.encode(), np.uint8)
    try:
        if shutil.disk_usage(directory).free < sum(array.nbytes + _OF_AN_ARRAY for array in arrays.values()):
            raise OSError(28, "no space left on the disk")
        with open(temporary, "wb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        hint = f"free some space, then continue with coldspray resume {directory}"
        raise StoreError(f"cannot write {path}: {error.strerror or error}; {hint}") from error
    for _, old in stored(directory)[:-KEPT]:
        old.unlink(missing_ok=True)
    return path


def stored(directory: Path) -> list[tuple[int, Path]]:
    """The checkpoints of a run, oldest first: (number, path)."""
    matches = [(_NAME.fullmatch(path.name), path) for path in directory.glob("checkpoint-*.ckpt") if path.is_file()]
    return sorted((int(match[1]), path) for match, path in matches if match)


def clear(directory: Path) -> None:
    """Remove all checkpoints of a run."""
    for path in [path for _, path in stored(directory)] + list(directory.glob("checkpoint-*.part")):
        path.unlink(missing_ok=True)


def latest(
    directory: Path, kind: type[R], about: Mapping[str, str], log: Callable[[str], None] | None = None
) -> R | None:
    """The state of the last complete checkpoint, a record of class `kind`; None if there is no checkpoint. A damaged checkpoint is
    skipped, with a line to log(text). Raises CheckpointError if the format or a value in `about` differs, or all are damaged."""
    damaged = []
    for _, path in reversed(stored(directory)):
        try:
            return read(path, kind, about)
        except OtherVersion:
            raise
        except CheckpointError as error:
            damaged.append(str(error))
            if log is not None:
                log(f"{error}; the previous checkpoint is tried")
    if damaged:
        raise CheckpointError(f"no checkpoint in {directory} can be read: start again with coldspray run --force")
    return None


def read(path: Path, kind: type[R], about: Mapping[str, str] | None = None) -> R:
    """The state in a checkpoint file, a record of class `kind`. about: data that identify the run. Raises CheckpointError if the file
    is damaged or its record has another class, OtherVersion if its format or its value for a key of `about` differs."""
    try:
        with open(path, "rb") as stream, NpzFile(stream) as arrays:
            text = arrays["header"].tobytes()
            _check_origin(path, json.loads(text), about or {})
            state = json.loads(text, object_hook=partial(_from_json, arrays, _kinds(kind)))["state"]
            if not isinstance(state, kind):
                raise ValueError(f"the state is not a {kind.__name__}")
            return state
    except CheckpointError:
        raise
    except PermissionError as error:
        raise UnreadableError(f"{path} cannot be read: {error.strerror}") from error
    except Exception as error:  # a damaged file can raise any exception
        raise CheckpointError(f"{path} is damaged ({type(error).__name__}: {str(error)[:200]})") from error


def _check_origin(path: Path, header: Mapping[str, Any], about: Mapping[str, str]) -> None:
    """Raise OtherVersion if a header has another format, or another value for a key of `about`."""
    its, again = dict(header["about"]), "or start the run again with coldspray run --force"
    if header["format"] != FORMAT:
        by = f"coldspray {_short(its.get('version'))} in format {_short(header['format'])}"
        ours = f"this version reads format {FORMAT}: continue with that version, {again}"
        raise OtherVersion(f"{path} was written by {by}, but {ours}")
    for key, wanted in about.items():
        if its.get(key) != wanted:
            other = f"another {key} ({_short(its.get(key))}, now {_short(wanted)})"
            raise OtherVersion(f"{path} was written with {other}: continue with that {key}, {again}")


def _for_json(arrays: dict[str, np.ndarray], value: object) -> object:
    """Convert a value that JSON cannot hold. A record becomes a dict with the name of its class. An array is added to `arrays` and
    becomes a dict with its key there. A number of numpy becomes a number."""
    if is_dataclass(value) and not isinstance(value, type):
        return {_RECORD: type(value).__name__, **{f.name: vars(value)[f.name] for f in fields(value)}}
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        arrays[key := str(len(arrays))] = value
        return {_ARRAY: key}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a checkpoint cannot store a {type(value).__name__}")


def _from_json(arrays: Mapping[str, np.ndarray], kinds: Mapping[str, type[Any]], part: dict[str, Any]) -> object:
    """The inverse of `_for_json`. Raises ValueError or TypeError for a record that does not match its class."""
    if _ARRAY in part:
        return arrays[part[_ARRAY]]
    return _record(kinds[part.pop(_RECORD)], part) if _RECORD in part else part


def _kinds(hint: Any) -> dict[str, type[Any]]:
    """The classes of all records that a value of this type hint can contain, by name."""
    own: dict[str, type[Any]] = {hint.__name__: hint} if isinstance(hint, type) and is_dataclass(hint) else {}
    inner = (*get_type_hints(hint).values(), *hint.__subclasses__()) if own else get_args(hint)
    return own | {name: kind for each in inner for name, kind in _kinds(each).items()}


def _record(kind: type[Any], values: dict[str, Any]) -> object:
    """A record from the values of its fields. Raises ValueError or TypeError if a type or shape does not match the class."""
    hints = get_type_hints(kind)
    for name, value in values.items():
        allowed = _types(hints[name])
        if not isinstance(value, allowed):
            made = _AFTER_JSON.get(type(value))
            if made is None or made not in allowed:
                wanted = " or ".join(each.__name__ for each in allowed)
                raise ValueError(f"{name} of {kind.__name__} is a {type(value).__name__}, expected {wanted}")
            values[name] = made(value)
    for name, spec in shapes_of(kind).items():
        value, shape = values[name], values[name].shape
        fits = len(shape) == len(spec.shape) and all(n in (-1, m) for n, m in zip(spec.shape, shape, strict=True))
        if value.dtype != spec.dtype or not fits:
            raise ValueError(f"{name} is an array {shape} of {value.dtype}, expected {spec.shape} of {spec.dtype}")
    if len({len(values[name]) for name in rows_of(kind)}) > 1:
        raise ValueError(f"{kind.__name__} has arrays of different lengths")
    return kind(**values)


def _types(hint: Any) -> tuple[type[Any], ...]:
    """The classes of the values that a type hint allows."""
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(kind for option in get_args(hint) for kind in _types(option))
    return (object,) if hint is Any else (get_origin(hint) or hint,)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 24 else text[:12] + "..."
