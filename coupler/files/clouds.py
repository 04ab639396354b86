"""Points and their fields from a file of any format: text, .npz, or what meshio reads."""

import contextlib
import io
from dataclasses import dataclass, replace
from dataclasses import field as init
from pathlib import Path

import meshio
import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from ..errors import ColdsprayError
from .inputs import InputError, check_regular, open_input, require_memory
from .surfaces import SURFACES, read_surface
from .tables import read_any_text, read_table

LARGEST_FILE = 2 * 1024**3  # bytes
TEXT = (".csv", ".tsv", ".xyz", ".txt", ".dat")
_TEXT_MEMORY = 25  # memory while a text is read, over the size of the file
_MESHIO_MEMORY = 8
_FLAT = ("triangle", "quad", "polygon")  # types of surface cells in meshio
_AXES = {name: axis for k, axis in enumerate("xyz") for name in (axis, f"points:{k}", f"points_{k}")}  # ParaView's too
SURFACE = (
    'is a surface, and points in the whole volume are needed. For a particle of this shape write in a scene: shape = "file", file ='
    ' "..." (STL, PLY, OBJ)'
)


@dataclass(frozen=True)
class Points:
    """Points of a file. x (n,3), fields: name -> (n, ...), in the units of the file; units: units of "x" and of fields, if the file
    gives them; notes: remarks about uncertain interpretations."""

    x: NDArray
    fields: dict[str, NDArray]
    units: dict[str, str] = init(default_factory=dict)
    notes: list[str] = init(default_factory=list)


def read_points(path: Path, known: tuple[str, ...], columns: list[str] | None = None) -> Points:
    """The points of a file. known: names of fields to read from an .npz file; columns: names of the columns of a text file, where "-"
    leaves a column out. Raises InputError, also if the file holds a surface; StoreError if memory is too small."""
    size, kind = check_regular(path, LARGEST_FILE), path.suffix.lower()
    if columns is not None and kind not in TEXT:
        raise InputError(path, f"has no columns to name: leave --columns out, it is only for {', '.join(TEXT)}")
    if kind in SURFACES and len(read_surface(path)[1]):
        raise InputError(path, SURFACE)
    try:
        if kind == ".npz":
            points = _npz(path, known)
        elif kind in TEXT:
            require_memory(_TEXT_MEMORY * size, f"to read {path}")
            points = _table(path, columns)
        else:
            require_memory(_MESHIO_MEMORY * size, f"to read {path}")
            points = _meshio(path)
    except (ColdsprayError, MemoryError):
        raise
    except Exception as problem:  # readers raise any exception for a damaged file
        kind = "" if isinstance(problem, ValueError | OSError) else f"{type(problem).__name__}: "
        raise InputError(path, f"cannot be read: {kind}{str(problem)[:300]}") from problem
    x = points.x
    if x.ndim != 2 or x.shape[1] != 3 or len(x) == 0 or x.dtype.kind not in "iuf":
        raise InputError(path, f"has no points with x, y and z (but an array of shape {x.shape}, {x.dtype})")
    numbers = {name: values for name, values in points.fields.items() if values.dtype.kind in "iufb"}
    return replace(points, x=np.ascontiguousarray(x, float), fields=numbers)


def _npz(path: Path, known: tuple[str, ...]) -> Points:
    """Arrays of an .npz file that have a row for each point. Before reading, the unpacked size is compared with the free memory."""
    with open_input(path) as stream, NpzFile(stream) as archive:
        of_points = next((name for name in ("points", "x") if name in archive), None)
        if of_points is None:
            raise ValueError("the file has neither an array 'points' nor an array 'x'")
        wanted = [name for name in archive if name == of_points or name.lower() in known]
        members = archive.zip.infolist() if archive.zip is not None else []
        sizes = [member.file_size for member in members if member.filename.removesuffix(".npy") in wanted]
        require_memory(2 * sum(sizes), f"to read {path}")
        arrays = {name: archive[name] for name in wanted}
    x = arrays.pop(of_points)
    return Points(x, {name: values for name, values in arrays.items() if values.shape[:1] == x.shape[:1]})


def _table(path: Path, columns: list[str] | None) -> Points:
    """Columns x, y, z and further columns of a text file. An .xyz file begins with the number of its points and a comment line."""
    text = read_any_text(path, LARGEST_FILE)
    if path.suffix.lower() == ".xyz" and (head := text.split("\n", 2))[0].strip().isdecimal() and len(head) == 3:
        count, lines = int(head[0]), head[2].splitlines()
        if count > len(lines):
            raise ValueError(f"its first line states {count} points, but {len(lines)} lines come after it")
        text = "\n".join(lines[:count])
    table = read_table(text, columns)
    axes = {_AXES[name.lower()]: name for name in table.columns if name.lower() in _AXES}
    if len(axes) < 3:
        hint = "name them with --columns, such as --columns 'x y z' (- leaves one out)"
        raise ValueError(f"its columns are {', '.join(table.columns)[:200]}: {hint}")
    units = {table.units.get(name, "") for name in axes.values()}
    if len(units) > 1:
        raise ValueError(
            f"x, y and z have different units: {', '.join(sorted(units))}: give the same unit for all three"
        )
    fields = {name: values for name, values in table.columns.items() if name not in axes.values()}
    x = np.stack([table.columns[axes[axis]] for axis in "xyz"], axis=1)
    return Points(x, fields, {**table.units, "x": units.pop()}, table.notes)


def _meshio(path: Path) -> Points:
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output), np.errstate(all="ignore"):
            mesh = meshio.read(path)
    except SystemExit:  # meshio calls sys.exit if several readers fail
        raise ValueError("not in a format meshio reads") from None
    kinds = {block.type for block in mesh.cells if len(block.data)} - {"vertex", "line"}
    if kinds and all(kind.startswith(_FLAT) for kind in kinds):
        raise InputError(path, SURFACE)
    told = f"the nodes of its cells ({', '.join(sorted(kinds))}) are used as evenly distributed points of the body"
    fields = {name: np.asarray(values) for name, values in mesh.point_data.items()}
    return Points(np.asarray(mesh.points), fields, notes=[told] if kinds else [])
