"""Checkpoints of a run: the whole state in one file, whole or not at all, and known to be whole when it is read.

A file is an uncompressed .npz of arrays with checksums; "header" is a JSON text: format, what the file belongs to, and the tree of the
state, a record (see `core.records`). It is read by the type hints of the record: each field must have the type and shape that it says.
"""

import contextlib
import json
import os
import re
import shutil
import types
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.lib.npyio import NpzFile

from ..core.records import rows_of, shapes_of
from ..errors import CheckpointError, StoreError, UnreadableError

FORMAT = 24
KEPT = 2
_NAME = re.compile(r"checkpoint-(\d{6})\.ckpt")
_OF_AN_ARRAY = 600  # bytes beside its numbers, at most
R = TypeVar("R")


class OtherVersion(CheckpointError):
    """A checkpoint of another format or run."""


def write(directory: Path, state: object, about: Mapping[str, str]) -> Path:
    """Write the record `state` as the next checkpoint of a run and remove all but the last KEPT. about: data that identify the run, for
    `latest`. Raises StoreError when it cannot be written (a full disk); earlier checkpoints are then untouched."""
    numbers = [number for number, _ in stored(directory)]
    path = directory / f"checkpoint-{(numbers[-1] + 1 if numbers else 1):06d}.ckpt"
    temporary = path.with_suffix(".part")
    arrays: dict[str, np.ndarray] = {}
    header = {"format": FORMAT, "about": dict(about), "tree": _flatten(state, "", arrays)}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
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
    """State, a record of class `kind`, of the last checkpoint that is complete; None if there is no checkpoint. A damaged one is passed
    over, with a line to log(text). Raises CheckpointError when a checkpoint belongs to another version or another scene (a key of
    `about` differs), or when all are damaged."""
    damaged = []
    for _, path in reversed(stored(directory)):
        try:
            return read(path, kind, about)
        except OtherVersion:
            raise
        except CheckpointError as error:
            damaged.append(str(error))
            if log is not None:
                log(f"{error}; trying the one before")
    if damaged:
        raise CheckpointError(f"no checkpoint in {directory} can be read: start again with coldspray run --force")
    return None


def read(path: Path, kind: type[R], about: Mapping[str, str] | None = None) -> R:
    """State of a checkpoint file, a record of class `kind`. about: data of the run to which it must belong. Raises CheckpointError if
    it is not whole or not such a record, OtherVersion if it belongs to another version or scene."""
    try:
        with open(path, "rb") as stream, NpzFile(stream) as arrays:
            header = json.loads(arrays["header"].tobytes())
            _check_origin(path, header, about or {})
            return _decode(kind, header["tree"], arrays, "")
    except CheckpointError:
        raise
    except PermissionError as error:
        raise UnreadableError(f"{path} cannot be read: {error.strerror}") from error
    except Exception as error:  # whatever is wrong inside a file that anybody may have written
        raise CheckpointError(f"{path} is damaged ({type(error).__name__}: {str(error)[:200]})") from error


def _check_origin(path: Path, header: Mapping[str, Any], about: Mapping[str, str]) -> None:
    """Raise OtherVersion where a header has another format, or another value of a key of `about`."""
    its, again = dict(header["about"]), "or start again with coldspray run --force"
    if header["format"] != FORMAT:
        raise OtherVersion(
            f"{path} was written by coldspray {_short(its.get('version'))} in format {_short(header['format'])}, this version"
            f" reads format {FORMAT}: continue with that version, {again}"
        )
    for key, wanted in about.items():
        if its.get(key) != wanted:
            other = f"another {key} ({_short(its.get(key))}, now {_short(wanted)})"
            raise OtherVersion(f"{path} was written with {other}: continue with that one, {again}")


def _flatten(value: object, name: str, arrays: dict[str, np.ndarray]) -> dict[str, object]:
    """The tree with each array replaced by its key in `arrays`."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = {f.name: _flatten(vars(value)[f.name], f"{name}/{f.name}", arrays) for f in fields(value)}
        return {"record": parts, "kind": type(value).__name__}
    if isinstance(value, Mapping):
        return {"dict": {key: _flatten(item, f"{name}/{key}", arrays) for key, item in value.items()}}
    if isinstance(value, (list, tuple)):
        return {"list": [_flatten(item, f"{name}/{i}", arrays) for i, item in enumerate(value)]}
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError(f"{name} is an array of Python objects: a checkpoint stores numbers and texts only")
        arrays[name] = value
        return {"array": name}
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return {"value": value}
    raise TypeError(f"{name}: a checkpoint cannot store a {type(value).__name__}")


def _decode(hint: Any, tree: Any, arrays: Mapping[str, np.ndarray], name: str) -> Any:
    """The value of a tree as its type hint says. Raises ValueError where it is of another type."""
    if hint is Any or hint is object:
        return _plain(tree, arrays)
    origin, options = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        wanted = tree.get("kind") if "record" in tree else None
        chosen = [option for option in options if isinstance(option, type) and option.__name__ == wanted]
        if not chosen:  # None, a number or a list
            empty = "value" in tree and tree["value"] is None
            chosen = [o for o in options if (o is type(None)) == empty and (wanted is None) != is_dataclass(o)]
        if len(chosen) != 1:
            raise ValueError(f"{name or 'the state'} has the wrong type, expected {hint}")
        return _decode(chosen[0], tree, arrays, name)
    if isinstance(hint, type) and is_dataclass(hint):
        kinds = {kind.__name__: kind for kind in _kinds(hint)}
        hint = kinds.get(str(tree.get("kind")), hint) if isinstance(tree, dict) else hint
        parts, hints = _part(tree, "record", name), get_type_hints(hint)
        if set(parts) != {f.name for f in fields(hint)}:
            text = f"{name or 'the state'} has the fields {_short(sorted(parts))}"
            raise ValueError(f"{text}, expected the fields of {hint.__name__}")
        values = {key: _decode(hints[key], part, arrays, f"{name}/{key}") for key, part in parts.items()}
        for key, spec in shapes_of(hint).items():
            value, shape = values[key], values[key].shape
            fits = len(shape) == len(spec.shape) and all(n in (-1, m) for n, m in zip(spec.shape, shape, strict=True))
            if value.dtype != spec.dtype or not fits:
                expected = f"expected {spec.shape} of {spec.dtype}"
                raise ValueError(f"{name}/{key} is an array {shape} of {value.dtype}, {expected}")
        if len({len(values[key]) for key in rows_of(hint)}) > 1:
            raise ValueError(f"{name} has arrays of different lengths")
        return hint(**values)
    if origin is list or origin is tuple:
        items = _part(tree, "list", name)
        return origin(_decode(options[0], item, arrays, f"{name}/{i}") for i, item in enumerate(items))
    if origin is dict:
        items = _part(tree, "dict", name).items()
        return {key: _decode(options[1], item, arrays, f"{name}/{key}") for key, item in items}
    if hint is np.ndarray or origin is np.ndarray:
        return arrays[_part(tree, "array", name)]
    value = tree["value"] if isinstance(tree, dict) and "value" in tree else tree
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is not (type(None) if hint is None else hint):
        raise ValueError(f"{name} is not of the type {getattr(hint, '__name__', hint)}")
    return value


def _kinds(record: type[object]) -> list[type[object]]:
    """A class and all that derive from it."""
    derived: list[type[object]] = record.__subclasses__()
    return [record, *(kind for each in derived for kind in _kinds(each))]


def _part(tree: object, kind: str, name: str) -> Any:
    if not isinstance(tree, dict) or kind not in tree:
        raise ValueError(f"{name or 'the state'} is not a {kind}")
    return tree[kind]


def _plain(tree: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """A value without a type of its own: dicts, lists, arrays and numbers."""
    if "dict" in tree:
        return {key: _plain(item, arrays) for key, item in tree["dict"].items()}
    if "list" in tree:
        return [_plain(item, arrays) for item in tree["list"]]
    return arrays[tree["array"]] if "array" in tree else tree["value"]


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 24 else text[:12] + "..."
