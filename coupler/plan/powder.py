"""The sizes of a powder, from a scene or job, or from the file of a particle-size analyser."""

import os
from pathlib import Path

import numpy as np

from .. import units
from ..files.inputs import InputError, similar
from ..files.tables import Table, read_any_text, read_table
from ..spray.sizes import Sizes

_LARGEST = 10_000_000  # bytes
_SIZE, _SHARE = ("size", "diam", "größe", "durchmesser"), ("vol", "mass", "%", "q3")
_CUMULATIVE = ("under", "cum", "passing", "undersize")


def sizes_of(sizes: tuple[float, ...] | str, folder: Path) -> Sizes:
    """The size distribution of a powder, from its value in a scene. folder: folder to which a file name is relative. Raises
    ValueError with the problem of the file."""
    return sizes_in(table_of(sizes, folder)) if isinstance(sizes, str) else Sizes.of_diameters(*sizes)


def table_of(name: str, folder: Path) -> Table:
    """The table of a file with two or more columns. folder: folder to which the file name is relative. Raises ValueError with the
    problem of the file."""
    path = folder / os.path.expanduser(name)
    try:
        return read_table(read_any_text(path, _LARGEST), axes="xy")
    except InputError as error:
        raise ValueError(f"the file {error.reason}{similar(path)}") from None


def sizes_in(table: Table) -> Sizes:
    """The size distribution in the table of a particle-size analyser.

    Each row has a diameter and a volume fraction, which is also the mass fraction. The fraction is that of the size class above this
    diameter. In a cumulative column it is the fraction of all particles below this diameter. A column is cumulative if its name says so
    (_CUMULATIVE) or if it rises to 100. Diameters are in µm, or in the unit of their column. Raises ValueError with the problem of the
    table.
    """
    names, share = list(table.columns), _column(table, _CUMULATIVE) or _column(table, _SHARE)
    sizes = [name for name in names if name != share and not any(word in name.lower() for word in _CUMULATIVE)]
    size = next((name for name in sizes if any(word in name.lower() for word in _SIZE)), names[0])
    share = share if share and share != size else next((name for name in names if name != size), "")
    if not share:
        raise ValueError("the file needs a column with sizes and a column with volume fractions")
    if "number" in share.lower() and "vol" not in share.lower():
        raise ValueError(f"column {share!r} has numbers of particles: give a file with volume fractions")
    try:
        scale = units.parse(f"1 {table.units.get(size, 'um')}", "length")
    except units.UnitError as error:
        raise ValueError(f"column {size!r} {error}") from None
    D, y = scale * table.columns[size], table.columns[share]
    order = np.argsort(D)
    D, y = D[order], y[order]
    if len(D) < 2 or not (np.diff(D) > 0.0).all() or D[0] < 0.0 or not (y >= 0.0).all():
        needed = "need two or more different sizes, and fractions of zero or more"
        raise ValueError(f"columns {size!r} and {share!r} {needed}")
    rises = bool(np.all(np.diff(y) >= 0.0)) and 99.0 <= y[-1] <= 101.0
    if rises or any(word in share.lower() for word in _CUMULATIVE):
        return Sizes.of_classes([0.0, *D.tolist()], [float(y[0]), *np.diff(y).tolist()])
    return Sizes.of_classes([*D.tolist(), float(D[-1] ** 2 / D[-2])], y.tolist())


def _column(table: Table, words: tuple[str, ...]) -> str:
    """The first column whose name contains one of the words; "" if there is none."""
    return next((name for name in table.columns if any(word in name.lower() for word in words)), "")
