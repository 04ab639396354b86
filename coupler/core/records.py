"""The state of a simulation as records: dataclasses of arrays and numbers, and operations on all fields of a record.

A field of a record is an array (annotated with its `Shape` or as `Rows`), a number, a string, another record, None, or a list or
dict of these. A class with a state derives from its record, as `Target` from `TargetState`: a new field of the record needs one line,
and checkpoints contain it. `copied` and `put` save and restore all fields, also of records inside the record. `take` and
`concatenate` act on all arrays that have a row for each node, element or point.
"""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Self, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import DTypeLike

from ..errors import CheckpointError

R = TypeVar("R")


class Sums:
    """Base class of records whose fields are sums over time. Two such records can be added and subtracted, field by field."""

    def __add__(self, other: Self) -> Self:
        return type(self)(*(vars(self)[name] + value for name, value in vars(other).items()))

    def __sub__(self, other: Self) -> Self:
        return type(self)(*(vars(self)[name] - value for name, value in vars(other).items()))


class Shape:
    """Annotation of an array field: its shape, with -1 for a free length, and its type.

    index_of: name of the objects that the indices in the array refer to, see `check_indices`.
    """

    def __init__(self, *shape: int, dtype: DTypeLike = np.float64, index_of: str = ""):
        self.shape, self.dtype, self.index_of = shape, np.dtype(dtype), index_of


class Rows(Shape):
    """Annotation of an array field that has a row of this shape for each node, element or point. fill: initial value.

    lammps: whether LAMMPS stores the array. least: lower bound of the values after the transfer from points to the mesh of a splat;
    None: the smallest value of the points. dtype, index_of: as in `Shape`.
    """

    def __init__(
        self, *shape: int, dtype: DTypeLike = np.float64, fill: float = 0.0, index_of: str = "", lammps: bool = False,
        least: float | None = None,
    ):  # fmt: skip
        super().__init__(-1, *shape, dtype=dtype, index_of=index_of)
        self.fill, self.lammps, self.least = fill, lammps, least

    def new(self, n: int) -> np.ndarray:
        """A new array of n rows in which all values are the fill value."""
        shape = (n, *self.shape[1:])  # zeros take no time until they are written
        return np.full(shape, self.fill, self.dtype) if self.fill else np.zeros(shape, self.dtype)


@cache
def _shapes(kind: type[object]) -> dict[str, Shape]:
    hints = get_type_hints(kind, include_extras=True)
    specs = {name: [m for m in get_args(hint)[1:] if isinstance(m, Shape)] for name, hint in hints.items()}
    return {name: shapes[0] for name, shapes in specs.items() if shapes}


def shapes_of(record: object) -> dict[str, Shape]:
    """The annotations of the array fields of a record, or of its class, by name."""
    return _shapes(record if isinstance(record, type) else type(record))


def rows_of(record: object) -> dict[str, Rows]:
    """The annotations of the array fields that have a row for each node, element or point, by name."""
    return {name: spec for name, spec in shapes_of(record).items() if isinstance(spec, Rows)}


def new_rows(kind: type[R], n: int, **known: np.ndarray) -> R:
    """A new record of n rows. known: arrays by name; all other arrays contain their fill value."""
    return kind(**{name: spec.new(n) for name, spec in rows_of(kind).items() if name not in known}, **known)


def arrays_of(record: object) -> dict[str, np.ndarray]:
    """The arrays of a record that have a row for each node, element or point, by name."""
    return {name: vars(record)[name] for name in rows_of(record)}


def unfit(problem: str) -> CheckpointError:
    """The error for a checkpoint that does not fit its run."""
    return CheckpointError(f"the checkpoint does not fit the run: {problem}; start again with coldspray run --force")


def copied(record: R) -> R:
    """A copy of a record, with copies of its arrays, dicts and parts. The copy of an object whose class derives
    from a record has only the fields of the record. Other objects, such as None and numbers, are returned unchanged."""
    if isinstance(record, np.ndarray | dict):
        return record.copy()  # type: ignore[return-value]
    if not hasattr(record, "__dataclass_fields__"):
        return record
    kind = next(each for each in type(record).__mro__ if "__dataclass_fields__" in vars(each))
    return kind(**{f.name: copied(vars(record)[f.name]) for f in fields(kind)})


def put(record: R, into: R) -> None:
    """Write all fields of a record into an object of its class or of a derived class. Arrays and parts of the object keep their place
    in memory, but an empty array is replaced by one with rows. None is not written. Raises CheckpointError if a shape does not fit."""
    for name in (f.name for f in fields(record)):  # type: ignore[arg-type]
        value, own = vars(record)[name], vars(into)[name]
        if isinstance(value, np.ndarray) and value.shape == own.shape:
            own[...] = value
        elif isinstance(value, np.ndarray) and (len(own) or value.shape[1:] != own.shape[1:]):
            raise unfit(f"{name} has the shape {value.shape}, but {own.shape} is needed")
        elif is_dataclass(value):
            put(value, own)
        elif value is not None:
            setattr(into, name, copied(value))


def take(record: R, index: np.ndarray) -> R:
    """A record with the rows `index` (indices or a mask) of all arrays that have a row for each node, element or point."""
    rows = index.nonzero()[0] if index.dtype == bool else index
    return replace(record, **{name: np.take(array, rows, axis=0) for name, array in arrays_of(record).items()})  # type: ignore[type-var]


def concatenate(records: Sequence[R]) -> R:
    """A record with the rows of several records of one class, in their order. Other fields are from the first record. A single
    record is not copied."""
    if len(records) == 1:
        return records[0]
    arrays = [arrays_of(record) for record in records]
    joined = {name: np.concatenate([each[name] for each in arrays]) for name in arrays[0]}
    return replace(records[0], **joined)  # type: ignore[type-var]


def check_indices(record: object, **counts: int) -> None:
    """Raise CheckpointError if an index refers to an object that does not exist. counts: number of objects by `index_of`."""
    for name, spec in shapes_of(record).items():
        value, count = vars(record)[name], counts.get(spec.index_of)
        if count is not None and value.size and not (value.min() >= 0 and value.max() < count):
            raise unfit(f"{name} refers to {spec.index_of} that do not exist")
