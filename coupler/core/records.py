"""The state of a simulation as records: dataclasses of arrays and numbers, and what is done with all their fields alike.

A field of a record is an array (annotated with its `Shape` or as `Rows`), a number, a string, another record, None, or a list or
dict of these. What has a state derives from its record, as a target from `TargetState`: its attributes are the fields, and a line with
a field is all that a checkpoint needs. `copied` and `put` save and restore all fields, parts included; `take`, `concatenate` and
`scatter` treat all arrays with a row for each node, element or point.
"""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any, Protocol, TypeVar, get_args, get_type_hints, runtime_checkable

import numpy as np
from numpy.typing import DTypeLike

from ..errors import CheckpointError

R = TypeVar("R")
S = TypeVar("S", bound="Sums")


@runtime_checkable
class Kept(Protocol):
    """A part of a simulation whose state needs more than to copy fields."""

    def state(self) -> object:
        """The state of the part, for a checkpoint."""

    def restore(self, state: Any) -> None:
        """Put a `state` into the part."""


class Sums:
    """Base of records of sums from a start: those of two times can be added and subtracted, field by field."""

    def __add__(self: S, other: S) -> S:
        return type(self)(*(vars(self)[name] + value for name, value in vars(other).items()))

    def __sub__(self: S, other: S) -> S:
        return type(self)(*(vars(self)[name] - value for name, value in vars(other).items()))


class Shape:
    """Says of an array field, in its annotation, which shape (-1 where the length is free) and type it has.

    index_of: the objects that its numbers refer to, by the names of `check_indices`.
    """

    per_row = False

    def __init__(self, *shape: int, dtype: DTypeLike = np.float64, index_of: str = ""):
        self.shape, self.dtype, self.index_of = shape, np.dtype(dtype), index_of


class Rows(Shape):
    """Says of an array field that it has a row of this shape for each node, element or point, `fill` to begin with.

    lammps: whether LAMMPS stores it. least: none of its values is smaller on a mesh made of points (None: than that of any point).
    """

    per_row = True

    def __init__(
        self,
        *shape: int,
        dtype: DTypeLike = np.float64,
        fill: float = 0.0,
        index_of: str = "",
        lammps: bool = False,
        least: float | None = None,
    ):
        super().__init__(-1, *shape, dtype=dtype, index_of=index_of)
        self.fill, self.lammps, self.least = fill, lammps, least

    def new(self, n: int) -> np.ndarray:
        """An array of n rows of the fill value."""
        shape = (n, *self.shape[1:])  # zeros take no time until they are written
        return np.full(shape, self.fill, self.dtype) if self.fill else np.zeros(shape, self.dtype)


@cache
def _shapes(kind: type[object]) -> dict[str, Shape]:
    hints = get_type_hints(kind, include_extras=True)
    specs = {name: [m for m in get_args(hint)[1:] if isinstance(m, Shape)] for name, hint in hints.items()}
    return {name: shapes[0] for name, shapes in specs.items() if shapes}


def shapes_of(record: object) -> dict[str, Shape]:
    """The array fields of a record, or of its class, by name."""
    return _shapes(record if isinstance(record, type) else type(record))


def rows_of(record: object) -> dict[str, Rows]:
    """The array fields that have a row for each node, element or point."""
    return {name: spec for name, spec in shapes_of(record).items() if isinstance(spec, Rows)}


def new_rows(kind: type[R], n: int, **known: np.ndarray) -> R:
    """A record of n rows: the arrays `known`, all others with their fill value."""
    return kind(**{name: spec.new(n) for name, spec in rows_of(kind).items() if name not in known}, **known)


def arrays_of(record: object) -> dict[str, np.ndarray]:
    """The arrays of a record that have a row for each node, element or point, by name."""
    return {name: vars(record)[name] for name in rows_of(record)}


def unfit(problem: str) -> CheckpointError:
    """The error of a checkpoint that does not fit its run."""
    return CheckpointError(f"the checkpoint does not fit: {problem}; start again with coldspray run --force")


def copied(record: R) -> R:
    """The record that an object is or derives from, with arrays, dicts and parts of its own; None for None."""
    if record is None:
        return record
    kind = next(each for each in type(record).__mro__ if "__dataclass_fields__" in vars(each))
    return kind(**{f.name: _copied(vars(record)[f.name]) for f in fields(kind)})


def _copied(value: object) -> object:
    if isinstance(value, (np.ndarray, dict)):
        return value.copy()
    if isinstance(value, Kept):
        return value.state()
    return copied(value) if is_dataclass(value) else value


def put(record: R, into: R) -> None:
    """Write all fields of a record into those of an object that is such a record or derives from it. Arrays and parts keep their
    place in memory; an array without rows takes any number of them. None is not written. Raises CheckpointError where a shape does
    not fit."""
    for name in (f.name for f in fields(record)):  # type: ignore[arg-type]
        value, own = vars(record)[name], vars(into)[name]
        if isinstance(value, np.ndarray) and value.shape == own.shape:
            own[...] = value
        elif isinstance(value, np.ndarray) and (len(own) or value.shape[1:] != own.shape[1:]):
            raise unfit(f"{name} has the shape {value.shape}, needed {own.shape}")
        elif is_dataclass(value) and isinstance(own, Kept):
            own.restore(value)
        elif is_dataclass(value):
            put(value, own)
        elif value is not None:
            setattr(into, name, _copied(value))


def take(record: R, index: np.ndarray) -> R:
    """The rows `index` of a record of arrays with a row for each node, element or point; its other fields stay."""
    rows = index.nonzero()[0] if index.dtype == bool else index
    return replace(record, **{name: np.take(array, rows, axis=0) for name, array in arrays_of(record).items()})  # type: ignore[type-var]


def concatenate(records: Sequence[R]) -> R:
    """All rows of several records of one kind, in their order, other fields as in the first; a single record is not copied."""
    if len(records) == 1:
        return records[0]
    arrays = [arrays_of(record) for record in records]
    joined = {name: np.concatenate([each[name] for each in arrays]) for name in arrays[0]}
    return replace(records[0], **joined)  # type: ignore[type-var]


def scatter(parts: Sequence[R], owners: Sequence[np.ndarray], n: int) -> R:
    """One record of n rows out of parts of it: row k of part i is row owners[i][k]."""
    whole = new_rows(type(parts[0]), n)
    for ids, part in zip(owners, parts, strict=True):
        for name, array in arrays_of(whole).items():
            array[ids] = arrays_of(part)[name]
    return whole


def check_indices(record: object, **counts: int) -> None:
    """Raise CheckpointError where an index refers to an object that does not exist. counts: number of objects by `index_of`."""
    for name, spec in shapes_of(record).items():
        value, count = vars(record)[name], counts.get(spec.index_of)
        if count is not None and value.size and not (value.min() >= 0 and value.max() < count):
            raise unfit(f"{name} refers to {spec.index_of} that do not exist")
