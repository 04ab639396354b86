"""Write a moving unstructured grid as VTKHDF (version 2.0, UnstructuredGrid with a `Steps` group): all time steps in one file.

A file stays readable if the process is killed at any moment: a step is first written and flushed completely, and then counted in
`NSteps`; readers use only counted steps. The oldest HDF5 layout is used because it has no mark for an open file.
"""

import contextlib
import errno
import hashlib
import math
import os
import resource
import shutil
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.threads import share
from .fields import CELL_TYPES, opened, read_arrays, times_of

Data = Mapping[str, ArrayLike]

# Name of a data set -> unit; number of columns -> their names: attributes `units` and `components` of the data sets
UNITS = {
    "Points": "m", "Values": "s", "velocity": "m/s", "stress": "Pa", "von_mises": "Pa", "eps_p": "1", "eps_p_rate": "1/s", "T": "K",
    "body": "1", "impact": "1", "thermal_stress": "Pa", "from_points": "m",
}  # fmt: skip
COMPONENTS = {3: ["x", "y", "z"], 6: ["xx", "yy", "zz", "xy", "yz", "xz"]}
SPARE = 2**20  # bytes that a step may need for headers and indices
CHUNK = 2**16  # most rows of a chunk


@dataclass
class _State:
    """Number of valid rows of each data set. A new step changes a copy of this record, so that an interrupted step has no effect."""

    steps: int = 0
    rows: dict[str, int] = field(default_factory=dict)  # data set -> rows in use
    cells: NDArray[np.int64] | None = None
    points: int = -1
    part: int = -1
    cell_offset: int = 0
    connectivity_offset: int = 0
    names: tuple[list[str], list[str]] | None = None


class VtkHdfWriter:
    """Appends time steps of one grid to one file. path: file to create or replace. Raises OSError if it cannot be created."""

    def __init__(self, path: Path):
        self.path = path
        # without a lock, a viewer can open the file while it grows
        self._file = h5py.File(path, "w", libver="earliest", locking=False)
        self._root = self._file.create_group("VTKHDF", track_order=True)
        self._root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
        kind = np.bytes_("UnstructuredGrid")
        self._root.attrs.create("Type", kind, dtype=h5py.string_dtype("ascii", len(kind)))
        steps = self._root.create_group("Steps")
        steps.attrs["NSteps"] = np.int64(0)
        self._count = h5py.h5a.open(steps.id, b"NSteps")
        for name in ("PointData", "CellData"):
            self._root.create_group(name)
            steps.create_group(f"{name}Offsets")
        # Data sets stay open: a failure to write when a data set is closed would not be reported
        self._data: dict[str, h5py.Dataset] = {}
        self._state = _State()
        # (data set, first row) -> digest of the values, packed chunk, of the last step: many chunks do not change between steps
        self._chunks: dict[tuple[str, int], tuple[bytes, bytes]] = {}

    def write(self, time: float, points: ArrayLike, cells: ArrayLike, *data: Data) -> None:
        """Append one time step to the file.

        time: s. points: (n, 3) m. cells: (m, 1 | 3 | 4) indices into points; cells are stored again only if they change. data: a
        dict of data at points, then one of data in cells: name -> (n,) or (n, k); integers stay integers; (n, 6) are symmetric
        tensors xx yy zz xy yz xz, as in VTK. All steps have the same names. Raises ValueError for wrong shapes or names, OSError if
        the file cannot be written; the file then accepts no more steps and keeps the earlier ones.
        """
        if not self._file:
            raise OSError(errno.EBADF, "the file is closed, perhaps after an earlier error")
        try:
            self._append_step(time, np.ascontiguousarray(points, np.float64), cells, *(*data, {}, {})[:2])
        except (OSError, RuntimeError):  # HDF5 reports some failed writes as RuntimeError
            self._give_up()
            raise

    @property
    def steps(self) -> int:
        """Number of time steps in the file."""
        return self._state.steps

    def close(self) -> None:
        self._file.close()

    def _give_up(self) -> None:
        """Stop using the file after an error. HDF5 aborts the process if it cannot write its buffers, even at exit. Therefore the
        file descriptor is redirected to a file in memory, which is discarded."""
        with contextlib.suppress(Exception):
            descriptor, size = self._file.id.get_vfd_handle(), self._file.id.get_filesize()
            sink = os.memfd_create(self.path.name)
            # the header may already have the length with the new step; a hole at the end needs no space
            os.ftruncate(descriptor, max(size, os.fstat(descriptor).st_size))
            os.dup2(sink, descriptor)
            os.close(sink)
            self._file.close()

    def _append_step(self, time: float, xyz: NDArray, cells: ArrayLike, point_data: Data, cell_data: Data) -> None:
        if xyz.ndim != 2 or xyz.shape[1] != 3:
            raise ValueError(f"points must be (n, 3), got {xyz.shape}")
        fields = {"PointData": _fields(point_data, len(xyz), "point"),
                  "CellData": _fields(cell_data, len(np.asarray(cells)), "cell")}  # fmt: skip
        size = xyz.nbytes + np.asarray(cells).nbytes
        size += sum(values.nbytes for data in fields.values() for values in data.values())
        # a step that breaks off for lack of space could damage an index
        if shutil.disk_usage(self.path.parent).free < size + SPARE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self._file.id.get_filesize() + size + SPARE > _longest_file():
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
        state = replace(self._state, rows=dict(self._state.rows), steps=self._state.steps + 1)
        connectivity = self._topology(state, cells, len(xyz))
        names = (sorted(fields["PointData"]), sorted(fields["CellData"]))
        if names != (state.names or names):
            raise ValueError(f"the fields of a file must stay the same: had {state.names}, got {names}")
        state.names = names

        def put(name: str, value: float) -> None:
            kind = np.float64 if name == "Values" else np.int64
            # these two have a column for each kind of topology; an unstructured grid has one
            shape = (1, 1) if name in ("CellOffsets", "ConnectivityIdOffsets") else (1,)
            self._append(state, f"Steps/{name}", np.full(shape, value, dtype=kind))

        long = {"Points": xyz, **connectivity}
        long |= {f"{group}/{name}": values for group, data in fields.items() for name, values in data.items()}
        packed = self._packed(long)
        for name, ids in connectivity.items():
            state.connectivity_offset = self._append(state, name, ids, packed[name])
        put("PartOffsets", state.part)
        put("NumberOfParts", 1)
        put("PointOffsets", self._append(state, "Points", xyz, packed["Points"]))
        put("CellOffsets", state.cell_offset)
        put("ConnectivityIdOffsets", state.connectivity_offset)
        for group, data in fields.items():
            for i, name in enumerate(sorted(data)):
                start = self._append(state, f"{group}/{name}", data[name], packed[f"{group}/{name}"])
                if i == 0 and group == "CellData":
                    put(f"{group}Offsets/{name}", start)
        if state.steps == 1:  # points and all fields begin at the same rows, because their chunks have the same length
            for group, fields_ in zip(("PointData", "CellData"), names, strict=True):
                offsets = self._root[f"Steps/{group}Offsets"]
                for name in fields_[group == "CellData" :]:
                    offsets[name] = self._root["Steps/PointOffsets"] if group == "PointData" else offsets[fields_[0]]
        self._file.flush()
        # the count comes before the time: VTK fails if there are more times than steps
        self._count.write(np.array(state.steps))
        put("Values", time)
        self._file.flush()
        self._state = state

    def _topology(self, state: _State, cells: ArrayLike, points: int) -> dict[str, NDArray]:
        """Start a new part of the file if the cells or the number of points differ from those of the last step. Returns the
        connectivity arrays to store, by name."""
        if points == state.points and state.cells is not None and np.array_equal(cells, state.cells):
            return {}
        table = np.array(cells, dtype=np.int64)  # a copy: the caller may change its array later
        if table.ndim != 2 or table.shape[1] not in CELL_TYPES:
            raise ValueError(f"cells must be (m, 1), (m, 3) or (m, 4), got {table.shape}")
        if table.size and (table.min() < 0 or table.max() >= points):
            raise ValueError(f"cells refer to points outside 0..{points - 1}")
        state.cells, state.points = table, points
        count, columns = table.shape
        state.cell_offset = self._append(state, "Types", np.full(count, CELL_TYPES[columns], dtype=np.uint8))
        self._append(state, "Offsets", np.arange(count + 1, dtype=np.int64) * columns)
        # VTK expects the offsets of a part at CellOffsets + number of the part: each topology is a part
        state.part = self._append(state, "NumberOfPoints", np.array([points], dtype=np.int64))
        self._append(state, "NumberOfCells", np.array([count], dtype=np.int64))
        self._append(state, "NumberOfConnectivityIds", np.array([table.size], dtype=np.int64))
        return {"Connectivity": table.ravel()}

    def _packed(self, arrays: Mapping[str, NDArray]) -> dict[str, list[bytes]]:
        """The data of a step as compressed chunks. Threads compress them in parallel."""
        rows = {name: self._chunk(name, values) for name, values in arrays.items()}
        work = [(name, first) for name, values in arrays.items() for first in range(0, len(values), rows[name])]

        def pack(lo: int, hi: int) -> None:
            for name, first in work[lo:hi]:
                values = arrays[name][first : first + rows[name]]
                digest = hashlib.sha256(values.data).digest()
                if self._chunks.get((name, first), (b"",))[0] != digest:
                    self._chunks[name, first] = digest, _deflated(values, rows[name])

        share(pack, len(work), 1)
        packed: dict[str, list[bytes]] = {name: [] for name in arrays}
        for name, first in work:
            packed[name].append(self._chunks[name, first][1])
        return packed

    def _chunk(self, name: str, values: NDArray) -> int:
        """Rows of a chunk: the length of the data in the first step, at most CHUNK."""
        return int(self._data[name].chunks[0]) if name in self._data else min(max(len(values), 1), CHUNK)

    def _append(self, state: _State, name: str, values: NDArray, packed: list[bytes] | None = None) -> int:
        """Append rows to a data set, which is created at first use. Returns the index of the first row. packed: the data as compressed
        chunks (`_packed`); they start at a new chunk. A written chunk never changes, so that a crash cannot damage older steps."""
        start, tail = state.rows.get(name, 0), values.shape[1:]
        if name not in self._data:
            long = packed is not None or len(values) > 1
            self._data[name] = self._root.create_dataset(
                name, (0, *tail), values.dtype, maxshape=(None, *tail), chunks=(self._chunk(name, values) if long else 256, *tail),
                compression=1 if long else None, shuffle=long,
            )  # fmt: skip
            if (unit := UNITS.get(name.rpartition("/")[2])) is not None and "Offsets" not in name:
                self._data[name].attrs["units"] = np.bytes_(unit)
                if (names := COMPONENTS.get(sum(tail))) is not None:
                    self._data[name].attrs["components"] = np.array(names, dtype="S2")
        data = self._data[name]
        zeros = (0,) * len(tail)
        # low-level functions of h5py: assignment to a data set takes ten times as long for a single number
        if packed is not None:
            rows = data.chunks[0]
            start += -start % rows
            data.id.set_extent((start + len(values), *tail))
            for i, chunk in enumerate(packed):
                data.id.write_direct_chunk((start + i * rows, *zeros), chunk)
        elif len(values):
            data.id.set_extent((start + len(values), *tail))
            space = data.id.get_space()
            space.select_hyperslab((start, *zeros), values.shape)
            data.id.write(h5py.h5s.create_simple(values.shape), space, np.ascontiguousarray(values))
        state.rows[name] = start + len(values)
        return start


def first_steps(path: Path, new: Path, steps: int) -> VtkHdfWriter:
    """Copy the first `steps` steps of the file `path` into the file `new`. Returns the writer of the new file. Raises StoreError if the
    file is damaged, UnreadableError without permission, IndexError if it has fewer steps, OSError of the writer."""
    with opened(path) as old:
        times = times_of(old)
    if len(times) < steps:
        raise IndexError(f"{path} has {len(times)} steps, but {steps} are needed")
    writer = VtkHdfWriter(new)
    try:
        for step in range(steps):
            with opened(path) as old:
                points, cells, point_data, cell_data = read_arrays(old, step)
            writer.write(float(times[step]), points, cells, point_data, cell_data)
    except BaseException:
        writer.close()
        raise
    return writer


def _deflated(values: NDArray, rows: int) -> bytes:
    """An HDF5 chunk of `rows` rows, padded with zeros, in the format of the filters shuffle and deflate. Only sequences of equal bytes
    are compressed: this takes half the time of the fastest level of zlib, and files are 3 % longer."""
    if len(values) < rows:
        values = np.concatenate([values, np.zeros((rows - len(values), *values.shape[1:]), values.dtype)])
    columns = np.ascontiguousarray(values).reshape(-1).view(np.uint8).reshape(-1, values.itemsize).T
    packer = zlib.compressobj(1, strategy=zlib.Z_RLE)
    return packer.compress(columns.tobytes()) + packer.flush()


def _longest_file() -> float:
    """Largest file size, bytes, that the system allows for this process."""
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    return math.inf if limit == resource.RLIM_INFINITY else limit


def _fields(data: Data, count: int, owner: str) -> dict[str, NDArray]:
    """The fields as they are stored: integers as int32, all others as float32. owner: "point" or "cell", for messages."""
    fields = {}
    for name, values in ((name, np.asarray(values)) for name, values in data.items()):
        if values.ndim not in (1, 2) or len(values) != count:
            raise ValueError(f"{owner} data {name!r} must be ({count},) or ({count}, k), got {values.shape}")
        fields[name] = np.ascontiguousarray(values, np.int32 if values.dtype.kind in "iu" else np.float32)
    return fields
