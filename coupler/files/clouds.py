"""Points and their fields from a file of any format: text, .npz, or what meshio reads; surfaces of triangles."""

import contextlib
import io
import math
import zipfile
from pathlib import Path
from typing import IO

import meshio
import numpy as np
from numpy.typing import NDArray

from ..errors import ColdsprayError
from .inputs import InputError, check_regular, open_input, read_text, require_memory

LARGEST_FILE = 2 * 1024**3  # bytes
_TEXT = (".csv", ".xyz", ".txt", ".dat")
_TEXT_MEMORY = 12  # bytes while reading over bytes of the file: the words of the text as objects
_MESHIO_MEMORY = 8
_MOST_ARRAYS = 1000  # in one .npz

Fields = dict[str, NDArray]


def read_points(path: Path, known: tuple[str, ...]) -> tuple[NDArray, Fields]:
    """Coordinates (n,3) and the fields of n points, as the file has them. known: fields that are read from an .npz.

    Raises InputError, or LimitError before anything is read that the memory cannot hold.
    """
    size = check_regular(path)
    if size > LARGEST_FILE:
        raise InputError(path, f"is larger than {LARGEST_FILE // 1024**3} GiB")
    try:
        if path.suffix == ".npz":
            points, fields = _npz(path, known)
        elif path.suffix in _TEXT:
            require_memory(_TEXT_MEMORY * size, f"to read {path}")
            points, fields = _table(path)
        else:
            require_memory(_MESHIO_MEMORY * size, f"to read {path}")
            points, fields = _meshio(path)
    except (ColdsprayError, MemoryError):
        raise
    except Exception as problem:  # the readers of a damaged file raise whatever comes up
        kind = "" if isinstance(problem, ValueError | OSError) else f"{type(problem).__name__}: "
        raise InputError(path, f"cannot be read: {kind}{str(problem)[:300]}") from problem
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or points.dtype.kind not in "iuf":
        raise InputError(path, f"has no points with x, y and z (an array of shape {points.shape}, {points.dtype})")
    numbers = {name: values for name, values in fields.items() if values.dtype.kind in "iufb"}
    return np.ascontiguousarray(points, float), numbers


def _npz(path: Path, known: tuple[str, ...]) -> tuple[NDArray, Fields]:
    """Arrays of an .npz: their headers are read first, so that an archive that unpacks to terabytes is refused."""
    with open_input(path) as stream, zipfile.ZipFile(stream) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        if len(members) > _MOST_ARRAYS:
            raise ValueError(f"it has {len(members)} arrays")
        heads = {}
        for name, member in members.items():
            with archive.open(member) as file:
                heads[name] = _header(file)
        of_points = next((name for name in ("points", "x") if name in heads), None)
        if of_points is None:
            raise ValueError("it has no array 'points' or 'x'")
        count = heads[of_points][0][:1]
        wanted = [name for name, (shape, _) in heads.items() if len(shape) in (1, 2) and shape[:1] == count]
        wanted = [name for name in wanted if name == of_points or name.lower() in known]
        require_memory(2 * sum(math.prod(heads[n][0]) * heads[n][1].itemsize for n in wanted), f"to read {path}")
        arrays = {}
        for name in wanted:
            with archive.open(members[name]) as file:
                arrays[name] = np.lib.format.read_array(file, allow_pickle=False)
    return arrays.pop(of_points), arrays


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type that an array of an .npz claims."""
    version = np.lib.format.read_magic(file)
    read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"it has an array of version {version}")
    shape, _, dtype = read(file)
    if dtype.hasobject or any(length < 0 for length in shape):
        raise ValueError("it holds objects, or a negative number of rows")
    return shape, dtype


def _table(path: Path) -> tuple[NDArray, Fields]:
    """Columns x, y, z and others by the names in the first line; without names the first three (of .xyz: after the element)."""
    lines = [line.replace(",", " ").replace(";", " ").split() for line in read_text(path, LARGEST_FILE).splitlines()]
    lines = [line for line in lines if line and not line[0].startswith("#")]
    if path.suffix == ".xyz" and lines and len(lines[0]) == 1 and lines[0][0].isdecimal():
        count = int(lines[0][0])
        lines = lines[len(lines) - count :]  # the comment line may be empty and gone
    if not lines:
        raise ValueError("it is empty")
    names: list[str] = []
    if not any(_is_number(word) for word in lines[0]):
        names, lines = [word.strip('"') for word in lines[0]], lines[1:]
    elif lines[0] and not _is_number(lines[0][0]):  # the element's symbol of an .xyz file
        lines = [line[1:] for line in lines]
    widths = {len(line) for line in lines}
    if len(widths) != 1 or (names and widths != {len(names)}):
        raise ValueError("its lines have different numbers of columns")
    table = np.array([[float(word) for word in line] for line in lines])
    if not names:
        return table[:, :3], {}
    at = {name.lower(): i for i, name in enumerate(names)}
    if not {"x", "y", "z"} <= at.keys():
        raise ValueError(f"its columns are {', '.join(names)[:200]}: x, y and z are needed")
    data = {name: table[:, i] for i, name in enumerate(names) if name.lower() not in ("x", "y", "z")}
    return table[:, [at["x"], at["y"], at["z"]]], data


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _mesh_of(path: Path) -> meshio.Mesh:
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output), np.errstate(all="ignore"):
            return meshio.read(path)
    except SystemExit:  # meshio leaves by sys.exit where several readers have failed
        raise ValueError("not in a format meshio reads") from None


def _meshio(path: Path) -> tuple[NDArray, Fields]:
    mesh = _mesh_of(path)
    return np.asarray(mesh.points), {name: np.asarray(values) for name, values in mesh.point_data.items()}
