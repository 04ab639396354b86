"""Checkpoints of a run: the whole state in one file, whole or not at all, and known to be whole when it is read.

A file is a line of JSON (format, checksum, what it belongs to) and an uncompressed .npz of arrays. The state is nested dicts of
arrays, numbers, strings and None; numbers travel exactly.
"""

import contextlib
import hashlib
import io
import json
import os
import re
import shutil
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..errors import StoreError

FORMAT = 4
KEPT = 2
_NAME = re.compile(r"checkpoint-(\d{6})\.ckpt")
_HEADER = 65536  # bytes at most of the first line


class CheckpointError(StoreError):
    """A checkpoint that cannot be gone on from: says why, and what to do."""


def write(directory: Path, state: dict[str, Any], about: dict[str, Any]) -> Path:
    """Write the next checkpoint of a run and remove all but the last KEPT. about: what it belongs to, for `latest`.

    Raises StoreError when it cannot be written (a full disk); earlier ones are then untouched.
    """
    numbers = [number for number, _ in found(directory)]
    path = directory / f"checkpoint-{(numbers[-1] + 1 if numbers else 1):06d}.ckpt"
    temporary = path.with_suffix(".part")
    arrays: dict[str, np.ndarray] = {}
    tree = _flatten(state, "", arrays)
    try:
        payload = io.BytesIO()
        np.savez(payload, **arrays)  # type: ignore[arg-type]
        content = payload.getbuffer()
        header = {"format": FORMAT, "sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
        line = json.dumps(header | {"about": about, "tree": tree}).encode() + b"\n"
        if shutil.disk_usage(directory).free < len(content) + len(line):
            raise OSError(28, "no space left on the disk")
        with open(temporary, "wb") as stream:
            stream.write(hashlib.sha256(line).hexdigest().encode() + b"\n" + line)
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise StoreError(
            f"cannot write {path}: {error.strerror or error}; make room, then go on with coldspray resume {directory}"
        ) from error
    for _, old in found(directory)[:-KEPT]:
        old.unlink(missing_ok=True)
    return path


def found(directory: Path) -> list[tuple[int, Path]]:
    """The checkpoints of a run, oldest first: (number, path)."""
    files = [path for path in directory.glob("checkpoint-*.ckpt") if path.is_file()]
    matches = [(match, path) for path in files if (match := _NAME.fullmatch(path.name))]
    return sorted((int(match[1]), path) for match, path in matches)


def clear(directory: Path) -> None:
    """Remove all checkpoints of a run."""
    for path in [path for _, path in found(directory)] + list(directory.glob("checkpoint-*.part")):
        path.unlink(missing_ok=True)


def latest(directory: Path, about: dict[str, Any], log: Any = None) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """State and `about` of the last checkpoint that is whole; None if there is none at all.

    A damaged one is passed over, with a line to log(text). Raises CheckpointError when a checkpoint belongs to another version
    or another scene (a key of `about` differs), or when all are damaged.
    """
    damaged = []
    for _, path in reversed(found(directory)):
        try:
            state, its = read(path)
        except CheckpointError as error:
            damaged.append(str(error))
            if log is not None:
                log(f"{error}; trying the one before")
            continue
        for key, wanted in about.items():
            if its.get(key) != wanted:
                raise CheckpointError(
                    f"{path} was written with another {key} ({_short(its.get(key))}, now {_short(wanted)}):"
                    " go on with that one, or start anew with coldspray run --force"
                )
        return state, its
    if damaged:
        raise CheckpointError(f"no checkpoint in {directory} is whole: start anew with coldspray run --force")
    return None


def read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """State and `about` of a checkpoint file. Raises CheckpointError if it is not whole."""
    try:
        with open(path, "rb") as stream:
            header = _header(stream, path)
            content = stream.read(int(header["bytes"]) + 1)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"{path} is damaged ({error})") from error
    if len(content) != header["bytes"] or hashlib.sha256(content).hexdigest() != header["sha256"]:
        raise CheckpointError(f"{path} is damaged (its checksum does not fit)")
    if header["format"] != FORMAT:
        raise CheckpointError(f"{path} has format {header['format']}, this version reads {FORMAT}")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return _restore(header["tree"], arrays), header["about"]
    except (ValueError, KeyError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"{path} is damaged ({error})") from error


def _header(stream: BinaryIO, path: Path) -> dict[str, Any]:
    checksum = stream.readline(_HEADER).strip().decode("ascii", "replace")
    line = stream.readline(2**26)
    if hashlib.sha256(line).hexdigest() != checksum:
        raise CheckpointError(f"{path} is damaged (its checksum does not fit)")
    return json.loads(line)


def _flatten(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """The tree with each array replaced by where it is kept."""
    if isinstance(value, dict):
        return {"dict": {key: _flatten(item, f"{name}/{key}", arrays) for key, item in value.items()}}
    if isinstance(value, (list, tuple)):
        return {"list": [_flatten(item, f"{name}/{i}", arrays) for i, item in enumerate(value)]}
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError(f"{name} holds objects")
        arrays[name] = value
        return {"array": name}
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return {"value": value}
    raise TypeError(f"{name}: a checkpoint cannot hold {type(value).__name__}")


def _restore(tree: Any, arrays: Any) -> Any:
    kind, value = next(iter(tree.items()))
    if kind == "dict":
        return {key: _restore(item, arrays) for key, item in value.items()}
    if kind == "list":
        return [_restore(item, arrays) for item in value]
    return arrays[value] if kind == "array" else value


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 24 else text[:12] + "..."
