"""Maps of a sweep: what came out over diameter, velocity and temperature, interpolated, with the uncertainty of that.

Reads folders of runs and imports no solver. The interpolation is a Gaussian process over the logarithms of velocity and
diameter: Rasmussen & Williams (2006), Gaussian Processes for Machine Learning, chapters 2, 4.2 and 5.4.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from .. import units
from ..errors import StoreError
from ..files.inputs import read_toml
from ..measures import measure
from .points import run_point
from .runs_table import AXES, COLUMNS, KEYS, MEASURES, Row, scene_file
from .sweep import set_key, toml_text

LOGARITHMIC = ("velocity_m_s", "diameter_m")
FEWEST_VALUES = 4  # along each axis, of which a map is interpolated
LONGEST = 3.0  # length of the interpolation over the range of an axis
BAND = 1.96  # standard deviations: 95 % of a normal distribution


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
    warnings: lengths that the points cannot tell, in words.
    """

    quantity: str
    axes: tuple[str, ...]
    rows: tuple[Row, ...]
    loo_rms: float
    loo_inside: float
    gap_rms: dict[str, float]
    spread: float
    warnings: tuple[str, ...]
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

    Matern kernel (nu 5/2) with a length for each standardised axis, between the smallest distance of two values and LONGEST times
    their range, and white noise; constants by the greatest marginal likelihood. Errors of leaving points out by Rasmussen &
    Williams, eq. 5.12, with these constants kept: on a grid a point's
    neighbours of the same velocity tell nearly all of it, so that only leaving them out too tests what lies between. Raises
    StoreError where an axis has fewer than FEWEST_VALUES values or the quantity is unknown.
    """
    used = [row for row in rows if row["status"] == "done" and isinstance(row.get(quantity), int | float)]
    names = tuple(axes) if axes is not None else varying(rows)
    if quantity not in COLUMNS:
        raise StoreError(f"{quantity} is no column of a map's table; known: {', '.join(MEASURES)}")
    if not names or (problem := sparse(used, names)):
        raise StoreError(f"{quantity}: {problem if names else 'no axis varies'}")
    x = np.array([[row[name] for name in names] for row in used], float)
    y = np.array([row[quantity] for row in used], float)
    logs = _logs(x, names)
    centre, scale = logs.mean(axis=0), logs.std(axis=0)
    scale[scale == 0.0] = 1.0
    standard = _scaled(x, names, centre, scale)
    values = [np.unique(column.round(9)) for column in standard.T]
    bounds = [(float(np.diff(v).min()), LONGEST * float(np.ptp(v))) for v in values]
    kernel = ConstantKernel(1.0, (1e-2, 1e3)) * Matern(
        [float(np.ptp(v)) for v in values], bounds, nu=2.5
    ) + WhiteKernel(1e-3, (1e-7, 1.0))
    model = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=4, random_state=0)
    with warnings.catch_warnings():  # what it says of lengths at their bounds is said in `told` in words
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(standard, y)
    lengths = np.atleast_1d(model.kernel_.k1.k2.length_scale)
    told = tuple(
        f"{measure(quantity).label} changes along {measure(name).short} within the distance of two points: more of them are needed"
        for name, length, (low, _) in zip(names, lengths, bounds, strict=True)
        if length <= 1.01 * low
    )
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
        unit, told, model, centre, scale,
    )  # fmt: skip


def sparse(rows: Sequence[Row], axes: Sequence[str]) -> str:
    """Which axes have too few values to be interpolated, in words; "" where none has."""
    counts = {axis: len({row[axis] for row in rows}) for axis in axes}
    few = [f"{count} values of {measure(axis).short}" for axis, count in counts.items() if count < FEWEST_VALUES]
    return f"{' and '.join(few)}; an interpolation needs {FEWEST_VALUES} along each axis" if few else ""


def next_point(rows: Sequence[Row], quantity: str, fit: Interpolation | None, axes: Sequence[str]) -> dict[str, float]:
    """The place, axis -> SI value, at which a run tells most of a quantity: of those between two values of each axis and of these
    values themselves the one with the widest band; without an interpolation the middle of the two neighbours along an axis that differ
    most. Empty where every place has its run."""
    used = [row for row in rows if row["status"] == "done" and isinstance(row.get(quantity), int | float)]
    known = {tuple(row[axis] for axis in axes): float(row[quantity]) for row in used}
    values = [sorted({at[k] for at in known}) for k in range(len(axes))]
    best: tuple[float, tuple[float, ...]] = (-1.0, ())
    if fit is not None:
        places = [
            [*v, *(_middle(a, b, axis) for a, b in itertools.pairwise(v))] for v, axis in zip(values, axes, strict=True)
        ]
        for place in itertools.product(*places):
            if place not in known:
                best = max(best, (float(fit(*place)[1]), place))
    else:
        for k, at in itertools.product(range(len(axes)), known):
            later = [b for b in known if b[k] > at[k] and b[:k] + b[k + 1 :] == at[:k] + at[k + 1 :]]
            if later:
                b = min(later, key=lambda other: other[k])
                best = max(best, (abs(known[b] - known[at]), (*at[:k], _middle(at[k], b[k], axes[k]), *at[k + 1 :])))
    return dict(zip(axes, best[1], strict=True)) if best[1] else {}


def best_point(
    rows: Sequence[Row], quantity: str, axes: Sequence[str] = ()
) -> tuple[dict[str, float], Interpolation | None]:
    """The next point (`next_point`), and the interpolation of the quantity, None where the points are too few for it. axes: those of
    AXES that vary by default."""
    done = [row for row in rows if row["status"] == "done"]
    names = tuple(axes) or varying(done)
    fit = None if not names or sparse(done, names) else interpolate(done, quantity, names)
    return (next_point(done, quantity, fit, names) if names else {}), fit


def _middle(a: float, b: float, axis: str) -> float:
    middle = (a * b) ** 0.5 if axis in LOGARITHMIC else 0.5 * (a + b)
    return float(f"{middle:.4g}")


def run_next(folder: Path, rows: Sequence[Row], at: dict[str, float]) -> str:
    """Run the scene of the nearest finished point, changed to the place `at`, as a new point of the folder. Returns its name.

    The target keeps its ratio to the particle's diameter where it has one ratio in all points. Raises StoreError.
    """
    done = [row for row in rows if row["status"] == "done"]
    spread = {axis: float(np.ptp([row[axis] for row in done])) or 1.0 for axis in at}
    near = min(done, key=lambda row: sum(abs(row[axis] - value) / spread[axis] for axis, value in at.items()))
    data = read_toml(scene_file(folder, near["point"]))
    changes = {key: at[axis] for key, axis in KEYS.items() if axis in at} | {k: v for k, v in at.items() if "." in k}
    if "diameter_m" in at:
        for key in ("substrate.diameter", "substrate.height"):
            ratios = {round(row["keys"].get(key, 0.0) / row["diameter_m"], 6) for row in done}
            if len(ratios) == 1 and ratios != {0.0}:
                changes[key] = ratios.pop() * at["diameter_m"]
    for key, value in changes.items():
        unit = near["units"].get(key, "")
        set_key(data, key, units.show(value, unit) if unit else value)
    point = "_".join([near["material"], *(f"{key.rpartition('.')[2]}{value:.4g}" for key, value in changes.items())])
    run_point(folder, point, toml_text(data))
    return point


def varying(rows: Sequence[Row]) -> tuple[str, ...]:
    """The axes with more than one value among the rows."""
    return tuple(axis for axis in AXES if len({row[axis] for row in rows if row[axis] is not None}) > 1)


def _logs(x: NDArray, names: Sequence[str]) -> NDArray:
    logarithmic = np.array([name in LOGARITHMIC for name in names])
    return np.where(logarithmic, np.log(np.where(logarithmic, x, 1.0)), x)


def _scaled(x: NDArray, names: Sequence[str], centre: NDArray, scale: NDArray) -> NDArray:
    return (_logs(x, names) - centre) / scale
