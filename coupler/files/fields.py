"""Read the fields of a domain at one time from a VTKHDF file. A damaged file cannot make the program open others or fill memory."""

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

CELL_TYPES = {1: 1, 3: 5, 4: 10}  # points of a cell -> VTK cell type: vertex, triangle, tetrahedron
_COLUMNS = {kind: columns for columns, kind in CELL_TYPES.items()}
DEFLATE_LIMIT = 1100  # greatest compression ratio of gzip: a file that states more data is damaged
FARTHEST = 1e3  # m from the origin: farther points count as damage
H = TypeVar("H", h5py.Group, h5py.Dataset)
Data = dict[str, NDArray]  # by name


@dataclass(frozen=True)
class Fields:
    """One domain at one time. time: s; points: (n, 3) m; cells: (m, 1 | 3 | 4) indices into points; data: name -> values at points
    (n, ...) or in cells (m, ...), float32 or int32, SI units; stress (.., 6) in the order xx yy zz xy yz xz."""

    time: float
    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    data: dict[str, NDArray]

    def split(self) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
        """The data at points, and the data in cells. The cells of a particle are its points, so that all its data are at points."""
        inside = {} if self.cells.shape[1] == 1 else {n: v for n, v in self.data.items() if len(v) != len(self.points)}
        return {name: values for name, values in self.data.items() if name not in inside}, inside


@contextmanager
def opened(path: Path) -> Iterator["Root"]:
    """Context with the VTKHDF group of a file. Raises StoreError if the file is missing, damaged or of another kind."""
    check_regular(path)
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield Root(child(file, "VTKHDF", h5py.Group), path)
    except (IndexError, ColdsprayError, MemoryError):
        raise
    except PermissionError as error:
        raise UnreadableError(f"{path} cannot be read: no permission") from error
    except Exception as error:  # h5py raises any exception for a damaged file
        raise StoreError(f"{path} is damaged or not a coldspray file: {error}") from error


@dataclass(frozen=True)
class Root:
    """The VTKHDF group of a file. Before data are read, their stated size is compared with the bytes in the file and free memory."""

    group: h5py.Group
    path: Path

    def rows(self, name: str, start: int = 0, count: int | None = None, kinds: str = "iuf") -> NDArray:
        """`count` rows (None: all) of a numeric data set from index `start`. kinds: allowed values of dtype.kind. Raises ValueError
        if the file is damaged, StoreError if memory is too small."""
        *folders, last = name.split("/")
        group = self.group
        for folder in folders:
            group = child(group, folder, h5py.Group)
        data = child(group, last, h5py.Dataset)
        if data.is_virtual or data.external:
            raise ValueError(f"{name} refers to another file, which is not allowed")
        if data.dtype.kind not in kinds or data.ndim not in (1, 2):
            raise ValueError(f"{name} has an unexpected type or shape")
        count = len(data) - start if count is None else count
        if not 0 <= start <= start + count <= len(data):
            raise ValueError(f"{name} has {len(data)} rows, rows {start} to {start + count} are needed")
        row = math.prod(data.shape[1:]) * data.dtype.itemsize
        chunk = math.prod(data.chunks) * data.dtype.itemsize if data.chunks else 0
        if max(count * row, chunk) > DEFLATE_LIMIT * data.id.get_storage_size() + 2**20:
            raise ValueError(f"{name} states more data than the file contains")
        require_memory(3 * count * row + chunk, f"to read {name} of {self.path}")
        return data[start : start + count]

    def number(self, name: str, row: int) -> int:
        return int(self.rows(name, row, 1, kinds="iu").ravel()[0])

    def names(self, name: str) -> list[str]:
        return list(child(self.group, name, h5py.Group))


def child(group: h5py.Group, name: str, kind: type[H]) -> H:
    # a link may lead to another file; files of this program have none
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
    if count == 0:  # a run that ended before its first step
        return np.zeros(0)
    # A run that was killed between two writes has counted a step, but has not stored its time.
    times = root.rows("Steps/Values")[: max(count, 0)].astype(np.float64)
    if times.ndim != 1 or not np.isfinite(times).all():
        raise ValueError("Steps/Values has a time that is not a finite number")
    return times


def read_step(root: Root, step: int, times: NDArray[np.float64]) -> Fields:
    """One stored step of a file. times: of all steps, s. If points and cells have data of the same name, those at points are used."""
    points, cells, point_data, cell_data = read_arrays(root, step)
    return Fields(float(times[step]), points, cells, cell_data | point_data)


def read_arrays(root: Root, step: int) -> tuple[NDArray[np.float64], NDArray[np.int64], Data, Data]:
    """Points, cells, data at points and data in cells of one step, as in `Fields`. Raises ValueError for a damaged file."""
    part = root.number("Steps/PartOffsets", step)
    point_count, cell_count = root.number("NumberOfPoints", part), root.number("NumberOfCells", part)
    id_count = root.number("NumberOfConnectivityIds", part)
    points = root.rows("Points", root.number("Steps/PointOffsets", step), point_count).astype(np.float64)
    types = root.rows("Types", root.number("Steps/CellOffsets", step), cell_count, kinds="iu")
    kind = int(types[0]) if cell_count else 1
    if points.ndim != 2 or points.shape[1] != 3 or kind not in _COLUMNS or (types != kind).any():
        raise ValueError("points are not an array (n, 3), or cells are of an unknown type or of several types")
    if (np.abs(points) > FARTHEST).any():
        raise ValueError(f"points lie more than {FARTHEST:g} m from the origin")
    columns = _COLUMNS[kind]
    if id_count != columns * cell_count:
        raise ValueError(f"the connectivity must have {columns} points for each of {cell_count} cells")
    start = root.number("Steps/ConnectivityIdOffsets", step)
    cells = root.rows("Connectivity", start, id_count, kinds="iu").astype(np.int64).reshape(-1, columns)
    if cells.size and (cells.min() < 0 or cells.max() >= point_count):
        raise ValueError("cells refer to points that do not exist")

    def data(group: str, count: int) -> dict[str, NDArray]:
        found = {}
        for name in root.names(group):
            values = root.rows(f"{group}/{name}", root.number(f"Steps/{group}Offsets/{name}", step), count)
            found[name] = values.astype(np.float32 if values.dtype.kind == "f" else np.int32)
        return found

    return points, cells, data("PointData", point_count), data("CellData", cell_count)
