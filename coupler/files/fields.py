"""Read the fields of a VTKHDF file: one domain at one time. Trusts no file.

A file cannot make the reader open another file or fill the memory.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import ColdsprayError, StoreError, UnreadableError
from .inputs import check_regular, require_memory

CELL_COLUMNS = {1: 1, 5: 3, 10: 4}  # VTK cell type -> points per cell
DEFLATE_LIMIT = 1100  # gzip cannot shrink further: a file that claims more data than this times its size is not honest
FARTHEST = 1e3  # m from the origin: no run has a point beyond it
H = TypeVar("H", h5py.Group, h5py.Dataset)


@dataclass(frozen=True)
class Fields:
    """One domain at one time. time: s. points: (n, 3) m. cells: (m, 1 | 3 | 4) indices into points. data: name -> (n, ...) for values
    at points, (m, ...) for values in cells, float32 (int32: whole numbers); SI units; stress (.., 6) in the order xx yy zz xy yz xz. A
    name that is given both at points and in cells holds the values at points."""

    time: float
    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    data: dict[str, NDArray]

    def split(self) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
        """Data at points and data in cells. A particle's cells are its points: all of its data is at points."""
        inside = {} if self.cells.shape[1] == 1 else {n: v for n, v in self.data.items() if len(v) != len(self.points)}
        return {name: values for name, values in self.data.items() if name not in inside}, inside


@contextmanager
def opened(path: Path) -> Iterator["Root"]:
    """The VTKHDF group of a file. Raises StoreError for any fault of the file."""
    check_regular(path)
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield Root(child(file, "VTKHDF", h5py.Group), path)
    except (IndexError, ColdsprayError, MemoryError):
        raise
    except PermissionError as error:
        raise UnreadableError(f"{path} cannot be read: no permission") from error
    except Exception as error:  # h5py raises whatever comes up on a damaged file
        raise StoreError(f"{path} is damaged or not a coldspray file: {error}") from error


@dataclass(frozen=True)
class Root:
    """The VTKHDF group of a file. The size that a data set states is compared with its stored bytes and with the free memory."""

    group: h5py.Group
    path: Path

    def rows(self, name: str, start: int = 0, count: int | None = None, kinds: str = "iuf") -> NDArray:
        """Rows start..start+count of a plain numeric data set (all without count)."""
        data = self.plain(name, start, count, kinds)
        count = len(data) - start if count is None else count
        row = math.prod(data.shape[1:]) * data.dtype.itemsize
        chunk = math.prod(data.chunks) * data.dtype.itemsize if data.chunks else 0
        if max(count * row, chunk) > DEFLATE_LIMIT * data.id.get_storage_size() + 2**20:
            raise ValueError(f"{name} states more data than the file contains")
        require_memory(3 * count * row + chunk, f"to read {name} of {self.path}")
        return data[start : start + count]

    def plain(self, name: str, start: int, count: int | None, kinds: str = "iuf") -> h5py.Dataset:
        """A plain numeric data set that has rows start..start+count. Raises ValueError for any other."""
        *folders, last = name.split("/")
        group = self.group
        for folder in folders:
            group = child(group, folder, h5py.Group)
        data = child(group, last, h5py.Dataset)
        if data.is_virtual or data.external:
            raise ValueError(f"{name} points to another file")
        if data.dtype.kind not in kinds or data.ndim not in (1, 2):
            raise ValueError(f"{name} has an unexpected type or shape")
        end = len(data) if count is None else start + count
        if not 0 <= start <= end <= len(data):
            raise ValueError(f"{name} has {len(data)} rows, rows {start} to {end} are needed")
        return data

    def number(self, name: str, row: int) -> int:
        return int(self.rows(name, row, 1, kinds="iu").ravel()[0])

    def names(self, name: str) -> list[str]:
        return list(child(self.group, name, h5py.Group))


def child(group: h5py.Group, name: str, kind: type[H]) -> H:
    # A link may lead into another file of the reader's machine; ours never do.
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"{name} is missing or a link to another file")
    item = group[name]
    if not isinstance(item, kind):
        raise ValueError(f"{name} is not an HDF5 {kind.__name__.lower()}")
    return item


def times_of(root: Root) -> NDArray[np.float64]:
    attributes = child(root.group, "Steps", h5py.Group).attrs
    if attributes.get_id("NSteps").shape not in ((), (1,)):
        raise ValueError("NSteps is not a number")
    count = int(np.ravel(attributes["NSteps"])[0])
    if count == 0:  # a run that died before its first step
        return np.zeros(0)
    # One that died at the wrong moment has counted a step and not yet given it a time.
    times = root.rows("Steps/Values")[: max(count, 0)].astype(np.float64)
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError("a time is not a number")
    return times


def read_step(root: Root, step: int, times: NDArray[np.float64]) -> Fields:
    part = root.number("Steps/PartOffsets", step)
    point_count, cell_count = root.number("NumberOfPoints", part), root.number("NumberOfCells", part)
    id_count = root.number("NumberOfConnectivityIds", part)
    points = root.rows("Points", root.number("Steps/PointOffsets", step), point_count).astype(np.float64)
    types = root.rows("Types", root.number("Steps/CellOffsets", step), cell_count, kinds="iu")
    kind = int(types[0]) if cell_count else 1
    if points.ndim != 2 or points.shape[1] != 3 or kind not in CELL_COLUMNS or (types != kind).any():
        raise ValueError("points are not an array (n, 3), or cells are of an unknown type or of several types")
    if (np.abs(points) > FARTHEST).any():
        raise ValueError(f"points lie more than {FARTHEST:g} m from the origin")
    columns = CELL_COLUMNS[kind]
    if id_count != columns * cell_count:
        raise ValueError(f"the connectivity must have {columns} points for each of {cell_count} cells")
    start = root.number("Steps/ConnectivityIdOffsets", step)
    cells = root.rows("Connectivity", start, id_count, kinds="iu").astype(np.int64).reshape(-1, columns)
    if cells.size and (cells.min() < 0 or cells.max() >= point_count):
        raise ValueError("cells refer to points that do not exist")
    data: dict[str, NDArray] = {}
    for group, count in (("CellData", cell_count), ("PointData", point_count)):
        for name in root.names(group):
            offset = root.number(f"Steps/{group}Offsets/{name}", step)
            values = root.rows(f"{group}/{name}", offset, count)
            data[name] = values.astype(np.float32 if values.dtype.kind == "f" else np.int32)
    return Fields(float(times[step]), points, cells, data)
