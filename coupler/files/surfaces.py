"""Read closed surfaces from the user's files: STL, OBJ and PLY, in the variants that common programs write.

Libraries are not sufficient: open3d ignores polygons of OBJ, trimesh misreads relative indices, meshio refuses other properties of
faces, and none of them reads a binary STL with bytes after its end.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .inputs import InputError, check_regular, open_input, require_memory

LARGEST_SURFACE = 512 * 1024**2  # bytes
SURFACES = (".stl", ".ply", ".obj")
LARGEST = 1e30  # magnitude of a coordinate
_MEMORY = 12  # memory while reading over the size of the file
_HEAD = 84  # bytes of a binary STL before its triangles
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_FACET = re.compile(rb"^\s*facet\s+normal\b", re.IGNORECASE | re.MULTILINE)
_VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE | re.MULTILINE)
_ORDER = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}  # format of PLY -> byte order
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
_DAMAGED = "the file is damaged or incomplete: write it again"

Surface = tuple[NDArray[np.float64], NDArray[np.int64]]
Column = tuple[str, str, str]  # property in PLY: name, type of its values, type of their count or "" for one value


def read_surface(path: Path) -> Surface:
    """Points (n,3) and triangles (m,3) of a surface in a file, in the unit and the order of the file. Polygons are divided into
    triangles. A file that has only points gives no triangles. Raises InputError, StoreError."""
    kind = path.suffix.lower()
    if kind not in SURFACES:
        raise InputError(path, f"is not a surface file: its name must end in {', '.join(SURFACES)}")
    require_memory(_MEMORY * check_regular(path, LARGEST_SURFACE), f"to read {path}")
    with open_input(path) as stream:
        raw = stream.read()
    try:
        return {".stl": _stl, ".obj": _obj, ".ply": _ply}[kind](raw)
    except (LookupError, OverflowError, ValueError) as problem:
        reason = f"it has no {problem}" if isinstance(problem, KeyError) else str(problem)[:300]
        raise InputError(path, f"cannot be read as {kind[1:].upper()}: {reason}") from problem


def _stl(raw: bytes) -> Surface:
    """Points and triangles of an STL file. A file that contains facets as text is a text STL. Others are binary: 84 bytes, the last
    four for the number of triangles, then 50 bytes each; the rest is ignored. Both can begin with "solid"."""
    lines = raw.replace(b"\r", b"\n")
    if (facets := len(_FACET.findall(lines))) > 0:
        corners = np.array([[float(word) for word in words] for words in _VERTEX.findall(lines)]).reshape(-1, 3)
        if len(corners) != 3 * facets:
            raise ValueError(f"it has {len(corners)} corners for {facets} facets; {_DAMAGED}")
    else:
        count = int.from_bytes(raw[80:_HEAD], "little")
        room = (len(raw) - _HEAD) // _STL.itemsize
        if room < 1:
            raise ValueError("it is not a text STL with facets, and too short for a binary STL")
        if not room - 1 <= count <= room:
            stated = f"the header states {count} triangles, but the size of the file is that of {room}"
            raise ValueError(f"{stated}; {_DAMAGED}")
        corners = np.frombuffer(raw, _STL, count, _HEAD)["corners"].reshape(-1, 3).astype(float)
    return _triangles(corners, np.arange(len(corners)).reshape(-1, 3).tolist())


def _obj(raw: bytes) -> Surface:
    """Points ("v") and polygons ("f") of the text of an OBJ file. The first number of a corner, such as 3/1/7, is the index of its
    point. It counts from 1; a negative index counts backwards, where -1 is the last point above the line."""
    points: list[list[float]] = []
    polygons: list[list[int]] = []
    text = re.sub(r"\\\r?\n", " ", raw.decode("utf-8-sig", errors="replace"))  # continued lines
    for number, line in enumerate(text.splitlines(), 1):
        kind, *words = line.partition("#")[0].split() or [""]
        try:
            if kind == "v":
                x, y, z = (float(word) for word in words[:3])
                points.append([x, y, z])
            elif kind == "f":
                corners = [int(word.partition("/")[0]) for word in words]
                polygons.append([i - 1 if i > 0 else i + len(points) if i < 0 else -1 for i in corners])
        except ValueError:
            needs = "a point needs three numbers, and a face needs whole numbers"
            raise ValueError(f"line {number}, {line[:60]!r}: {needs}") from None
    return _triangles(np.array(points).reshape(-1, 3), polygons)


def _ply(raw: bytes) -> Surface:
    """Points and polygons of a text or binary PLY file: only elements "vertex" and "face" (Turk 1994, The PLY Polygon File Format)."""
    head = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\r|\n)", raw)
    if not raw.startswith(b"ply") or head is None:
        raise ValueError("its header is missing or not terminated")
    form, elements = "", dict[str, tuple[int, list[Column]]]()
    columns: list[Column] = []
    for line in raw[: head.start()].decode("latin-1").splitlines():
        match line.split():
            case ["format", form, _]:
                pass
            case ["element", element, count]:
                columns = []
                elements[element] = int(count), columns
            case ["property", "list", counted, kind, name]:
                columns.append((name, kind, counted))
            case ["property", kind, name]:
                columns.append((name, kind, ""))
    body = _Body(raw[head.end() :], _ORDER[form])
    tables = {element: body.table(count, columns) for element, (count, columns) in elements.items()}
    points = np.array([tables["vertex"][axis] for axis in "xyz"], float).reshape(3, -1).T
    if not elements.get("face", (0, []))[0]:
        return points, np.zeros((0, 3), np.int64)
    faces = tables["face"]
    polygons = faces["vertex_indices" if "vertex_indices" in faces else "vertex_index"]
    return _triangles(points, [np.asarray(polygon).tolist() for polygon in polygons])


class _Body:
    """The values after the header of a PLY file, read one after another. order: byte order, "" for text."""

    def __init__(self, raw: bytes, order: str):
        self.order, self.at = order, 0
        self.values: NDArray = np.frombuffer(raw, np.uint8) if order else np.array(raw.split(), object)

    def next_values(self, dtype: np.dtype, count: int) -> NDArray:
        """The next values (count,) of a type. Raises ValueError if the file has fewer."""
        length = count * (dtype.itemsize if self.order else 1)
        if not 0 <= length <= len(self.values) - self.at:
            raise ValueError(f"it has fewer values than its header states; {_DAMAGED}")
        part = self.values[self.at : self.at + length]
        self.at += length
        return part.view(dtype) if self.order else part.astype(float)

    def table(self, count: int, columns: list[Column]) -> dict[str, Sequence[NDArray] | NDArray]:
        """The next `count` rows of an element: name of a column -> values of each row."""
        types = {kind: np.dtype(self.order + _TYPES[kind]) for column in columns for kind in column[1:] if kind}
        if not any(counted for _, _, counted in columns):
            if not self.order:
                block = self.next_values(np.dtype(float), count * len(columns)).reshape(count, -1)
                return {name: block[:, k] for k, (name, _, _) in enumerate(columns)}
            rows = self.next_values(np.dtype([(name, types[kind]) for name, kind, _ in columns]), count)
            return {name: rows[name] for name, _, _ in columns}
        found: dict[str, list[NDArray]] = {name: [] for name, _, _ in columns}
        for _ in range(count):
            for name, kind, counted in columns:
                number = int(self.next_values(types[counted], 1)[0]) if counted else 1
                found[name].append(self.next_values(types[kind], number))
        return dict(found)


def _triangles(x: NDArray[np.float64], polygons: Sequence[Sequence[float]]) -> Surface:
    """Points x (n,3) and triangles (m,3), into which polygons are divided. Raises ValueError for invalid points or polygons."""
    if not (np.abs(x) < LARGEST).all():
        raise ValueError("it has points that are not numbers")
    for polygon in polygons:
        if len(polygon) < 3 or not (min(polygon) >= 0 and max(polygon) < len(x)):
            raise ValueError(f"it has a face of fewer than three points, or with an index outside its {len(x)} points")
    triangles = [triangle for polygon in polygons for triangle in _triangulated([int(i) for i in polygon], x)]
    return x, np.array(triangles, np.int64).reshape(-1, 3)


def _triangulated(polygon: list[int], x: NDArray[np.float64]) -> list[list[int]]:
    """Triangles that fill a plane polygon of points x (n,3), also a concave one: divided at convex corners ("ears"; Meisters 1975)."""
    triangles: list[list[int]] = []
    while len(polygon) > 3:
        ring = x[polygon] - x[polygon[0]]
        normal = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
        corners = [[polygon[k - 1], polygon[k], polygon[(k + 1) % len(polygon)]] for k in range(len(polygon))]
        ear = next((corner for corner in corners if _is_ear(corner, polygon, normal, x)), corners[0])
        triangles.append(ear)
        polygon = [i for i in polygon if i != ear[1]]
    return [*triangles, polygon] if len(polygon) == 3 else triangles


def _is_ear(corner: list[int], polygon: list[int], normal: NDArray, x: NDArray) -> bool:
    """Whether the middle one of three successive corners is convex, and their triangle contains no other. normal: of the polygon."""
    ends = x[corner]
    inwards = np.cross(normal, np.roll(ends, -1, axis=0) - ends)
    others = x[[i for i in polygon if i not in corner]]
    inside = np.all([(others - end) @ inward >= 0.0 for end, inward in zip(ends, inwards, strict=True)], axis=0)
    return bool((ends[2] - ends[0]) @ inwards[0] > 0.0) and not inside.any()
