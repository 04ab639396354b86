"""Maps of a sweep: what came out over diameter, velocity and temperature, interpolated, with the uncertainty of that.

Reads folders of runs and imports no solver. The interpolation is a Gaussian process over the logarithms of velocity and
diameter: Rasmussen & Williams (2006), Gaussian Processes for Machine Learning, chapters 2, 4.2 and 5.4.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import StoreError
from ..files.inputs import read_toml, reading
from ..files.result import Result
from ..plan.record import read_plan
from .sweep import how_ended
from .table import write_rows

AXES = ("velocity_m_s", "diameter_m", "temperature_K")  # in the order in which they become x and y of a map
LOGARITHMIC = ("velocity_m_s", "diameter_m")
MEASURES = ("flattening_ratio", "T_mean_K", "T_p99_K", "eps_p_mean", "crater_depth_m", "splat_diameter_m",
            "rebound_velocity_m_s", "bonded_area_end_m2", "numerical_dissipation", "energy_drift", "wall_s", "restitution",
            "velocity_ratio")  # fmt: skip
COLUMNS = ("point", "material", "substrate", *AXES, "status", "reason", *MEASURES, "verdict", "version")
LEAST_POINTS = 6  # of which a map is drawn
LARGEST = 1e30  # a measure beyond it is damage
BAND = 1.96  # standard deviations: 95 % of a normal distribution
Row = dict[str, Any]


def table(folder: str | Path) -> list[Row]:
    """One row for each point of a sweep, or each run, in a folder: COLUMNS, SI units, in the order of material and axes.

    status: "done", "failed" or "undecided" (then `reason` says why), or "unfinished"; measures, as in the summaries, of points that
    are not done are missing. verdict: of the run; version: of the program that computed the run. Raises
    StoreError if the folder is not there or holds no point.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise StoreError(f"{folder} is not a folder of runs")
    names = {path.name for path in folder.iterdir() if path.is_dir() and (path / "scene.toml").is_file()}
    names |= {path.stem for path in folder.glob("*.toml") if _is_scene(path)}
    rows = [_readable_row(folder, name) for name in names]
    if not rows:
        raise StoreError(f"{folder} holds no points of a sweep and no folders of runs")
    return sorted(rows, key=lambda row: (row["material"], *(row[axis] or 0.0 for axis in AXES[::-1]), row["point"]))


def _readable_row(folder: Path, name: str) -> Row:
    """The row of a point; one whose files make no sense has failed, and does not end the map."""
    try:
        with reading(folder / name):
            return _row(folder, name)
    except StoreError as error:
        nothing = {"point": name, "material": "", "substrate": "", "status": "failed", "reason": str(error)}
        return dict.fromkeys(COLUMNS) | nothing


def _row(folder: Path, name: str) -> Row:
    """The row of a point: from its plan, its end status and its summary."""
    scene, run = folder / f"{name}.toml", folder / name
    row = dict.fromkeys(COLUMNS) | {"point": name, "status": "unfinished", "reason": ""}
    row |= _as_written(scene if scene.is_file() else run / "scene.toml")
    ended = how_ended(folder / f"{name}.json") or {}
    if ended.get("status") == "failed":
        return row | {"status": "failed", "reason": str(ended.get("reason") or "unknown")}
    result = Result(run) if (run / "scene.toml").is_file() else None
    if result is None or not result.finished:
        return row
    values, plan = result.values, read_plan(run)
    if len(plan.impacts) > 1:
        return row | {"status": "failed", "reason": f"has {len(plan.impacts)} impacts; a point of a map is one"}
    impact = plan.impact
    status = "done" if result.undecided is None else "undecided"
    row |= {"status": status, "version": str(values["version"]), "reason": result.undecided or ""}
    row |= {"material": impact.material.name, "substrate": plan.target.material.name}
    row |= dict(zip(AXES, (float(np.linalg.norm(impact.velocity)), impact.diameter, impact.temperature), strict=True))
    row |= {key: _number(values.get(key)) for key in MEASURES}
    row["verdict"] = str(values.get("verdict") or "")
    return row


def _number(value: object) -> float | None:
    """A measure; None where a summary has no number, or one that no run gives."""
    return value if isinstance(value, int | float) and abs(value) < LARGEST else None


def _is_scene(path: Path) -> bool:
    try:
        return "particle" in read_toml(path)
    except StoreError:
        return False


def _as_written(path: Path) -> Row:
    """Material and axes as a scene says them, so far as they can be read."""
    row: Row = {"material": "", "substrate": ""}
    with contextlib.suppress(StoreError, ValueError, LookupError, TypeError):
        data = read_toml(path)
        row["material"], row["substrate"] = str(data["particle"]["material"]), str(data["substrate"]["material"])
        for axis, dimension in zip(AXES, ("velocity", "length", "temperature"), strict=True):
            row[axis] = units.parse(data["particle"][axis.split("_")[0]], dimension)
    return row


def write_table(rows: Iterable[Row], path: Path, about: str = "") -> None:
    """The rows as CSV; about: a first line after "# ". Raises StoreError."""
    write_rows(path, COLUMNS, rows, about)


class Regressor(Protocol):
    """The part of scikit-learn's regressors that is used."""

    def predict(self, X: NDArray, *, return_std: bool) -> tuple[NDArray, NDArray]: ...


@dataclass(frozen=True)
class Interpolation:
    """A Gaussian process through the points of a map. axes: the columns it goes over; rows: its points.

    loo_rms: root mean square of what each point is off the prediction from all others; loo_inside: share of the points
    that lie in the 95 % band of that prediction; gap_rms: axis -> the same as loo_rms with all points of one value of that axis
    left out together, over the inner values of axes that have four or more; spread: standard deviation of the values. In units
    of the quantity.
    kernel: the fitted one, in words.
    """

    quantity: str
    axes: tuple[str, ...]
    rows: tuple[Row, ...]
    loo_rms: float
    loo_inside: float
    gap_rms: dict[str, float]
    spread: float
    kernel: str
    _model: Regressor
    _centre: NDArray
    _scale: NDArray

    def __call__(self, *at: ArrayLike) -> tuple[NDArray, NDArray]:
        """Mean and standard deviation at values of the axes, each an array of one shape or a number; SI units.

        The standard deviation is that of a run that would be made there, its scatter included.
        """
        points = np.broadcast_arrays(*(np.asarray(value, float) for value in at))
        flat = np.stack([value.ravel() for value in points], axis=1)
        mean, std = self._model.predict(_scaled(flat, self.axes, self._centre, self._scale), return_std=True)
        return mean.reshape(points[0].shape), std.reshape(points[0].shape)


def interpolate(rows: Sequence[Row], quantity: str, axes: Sequence[str] | None = None) -> Interpolation:
    """Interpolate a column of the table over the axes that vary (or `axes`), from the rows that are done.

    Matern kernel (nu 5/2) with a length for each standardised axis, and white noise; constants by the greatest marginal
    likelihood. Errors of leaving points out by Rasmussen & Williams, eq. 5.12, with these constants kept: on a grid a point's
    neighbours of the same velocity tell nearly all of it, so that only leaving them out too tests what lies between. Raises
    StoreError where there are too few points or the quantity is unknown.
    """
    used = [row for row in rows if row["status"] == "done" and isinstance(row.get(quantity), int | float)]
    names = tuple(axes) if axes is not None else varying(rows)
    if quantity not in COLUMNS:
        raise StoreError(f"{quantity} is no column of a map's table; known: {', '.join(MEASURES)}")
    if len(used) < LEAST_POINTS or not names:
        raise StoreError(
            f"{quantity}: {len(used)} points that are done have it; a map needs at least {LEAST_POINTS}, and an axis that varies"
        )
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    x = np.array([[row[name] for name in names] for row in used], float)
    y = np.array([row[quantity] for row in used], float)
    logs = _logs(x, names)
    centre, scale = logs.mean(axis=0), logs.std(axis=0)
    scale[scale == 0.0] = 1.0
    kernel = ConstantKernel(1.0, (1e-2, 1e3)) * Matern(np.ones(len(names)), (0.2, 50.0), nu=2.5) + WhiteKernel(
        1e-3, (1e-7, 1.0)
    )
    model = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=4, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a length at its bound: the axis has no influence, or all
        model.fit(_scaled(x, names, centre, scale), y)
    K = model.kernel_(model.X_train_)
    inverse = np.linalg.inv(K)
    unit = float(y.std()) or 1.0
    off = inverse @ model.y_train_ / np.diag(inverse)
    std = np.sqrt(1.0 / np.diag(inverse))
    gaps = {}
    for column, name in enumerate(names):
        inner = np.unique(x[:, column])[1:-1]
        if len(inner) >= 2:
            groups = [np.flatnonzero(x[:, column] == value) for value in inner]
            errors = [np.linalg.solve(inverse[np.ix_(g, g)], (inverse @ model.y_train_)[g]) for g in groups]
            gaps[name] = float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) * unit
    return Interpolation(
        quantity, names, tuple(used), float(np.sqrt(np.mean(off**2))) * unit, float(np.mean(np.abs(off) <= BAND * std)),
        gaps,
        unit, str(model.kernel_), model, centre, scale,
    )  # fmt: skip


def varying(rows: Sequence[Row]) -> tuple[str, ...]:
    """The axes with more than one value among the rows."""
    return tuple(axis for axis in AXES if len({row[axis] for row in rows if row[axis] is not None}) > 1)


def _logs(x: NDArray, names: Sequence[str]) -> NDArray:
    logarithmic = np.array([name in LOGARITHMIC for name in names])
    return np.where(logarithmic, np.log(np.where(logarithmic, x, 1.0)), x)


def _scaled(x: NDArray, names: Sequence[str], centre: NDArray, scale: NDArray) -> NDArray:
    return (_logs(x, names) - centre) / scale
