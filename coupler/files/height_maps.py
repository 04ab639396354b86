"""Surfaces from files of heights: columns x, y, z or a matrix in a text, grey images, and the files of surfaces."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import Delaunay, QhullError

from .inputs import InputError, check_regular, require_memory
from .surfaces import SURFACES, Surface, read_surface
from .tables import read_any_text

IMAGES = (".png", ".tif", ".tiff")
TEXTS = (".csv", ".txt", ".tsv")
LARGEST_MAP = 64 * 1024**2  # bytes
_MEMORY = 40  # memory while reading over the size of the file
_MOST_ROWS = 1000  # of a matrix; of larger ones, blocks are averaged


def read_heights(path: Path) -> Surface:
    """Points (n,3) and triangles (m,3) of a surface in a file, in the units of the file. Values in a matrix or image are 1 apart,
    and the first row has the largest y. Heights in an image of integers: 0 is black, 1 is white. Raises InputError, StoreError."""
    kind = path.suffix.lower()
    if kind in SURFACES:
        x, triangles = read_surface(path)
        if len(triangles) == 0:
            raise InputError(path, "has no triangles: a surface is needed")
        return x, triangles
    if kind not in (*IMAGES, *TEXTS):
        raise InputError(path, f"is no file of heights: its name must end in {', '.join((*TEXTS, *IMAGES, *SURFACES))}")
    require_memory(_MEMORY * check_regular(path, LARGEST_MAP), f"to read {path}")
    try:
        values = _image(path) if kind in IMAGES else _numbers(read_any_text(path, LARGEST_MAP))
        if not np.isfinite(values).all():
            raise ValueError(f"it has {int((~np.isfinite(values)).sum())} values that are not numbers: replace them")
        if min(values.shape) < 3:
            raise ValueError("it has fewer than three rows or columns: give columns x, y, z or a matrix")
        if values.shape[1] == 3:
            return values, np.asarray(Delaunay(values[:, :2]).simplices, np.int64)
        return _of_matrix(values)
    except (OSError, ValueError, SyntaxError, QhullError, Image.DecompressionBombError) as problem:
        raise InputError(path, f"cannot be read as heights: {' '.join(str(problem).split())[:200]}") from problem


def _numbers(text: str) -> NDArray[np.float64]:
    """Numbers (rows, columns) of a text. All lines have the separator of the last. Comments and a line of column names are left out."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("#", "%"))]
    if not lines:
        raise ValueError("it is empty")
    separator = next((mark for mark in "\t;," if mark in lines[-1]), None)
    if separator != "," and "." not in lines[-1]:
        lines = [line.replace(",", ".") for line in lines]
    if any(letter.isalpha() for letter in lines[0].lower().replace("e", "").replace("nan", "")):
        lines = lines[1:]
    return np.genfromtxt(lines, delimiter=separator, ndmin=2)


def _image(path: Path) -> NDArray[np.float64]:
    with Image.open(path) as image:
        require_memory(16 * image.width * image.height, f"to read {path}")
        grey = np.asarray(image if image.mode.startswith(("I", "F")) else image.convert("L"))
    most = 1.0 if grey.dtype.kind == "f" else 255.0 if grey.dtype == np.uint8 else 65535.0
    return grey.astype(float) / most


def _of_matrix(z: NDArray[np.float64]) -> Surface:
    block = -(-max(z.shape) // _MOST_ROWS)
    rows, columns = (n // block for n in z.shape)
    if min(rows, columns) < 2:
        raise ValueError(f"is too narrow: {z.shape[0]} rows and {z.shape[1]} columns become means of {block} x {block}")
    z = z[: rows * block, : columns * block].reshape(rows, block, columns, block).mean(axis=(1, 3))
    x, y = np.meshgrid(block * np.arange(columns), -block * np.arange(rows))
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    triangles = np.concatenate([np.column_stack([a, d, c]), np.column_stack([a, c, b])])
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()]).astype(float), triangles
