"""Maps of a sweep: measures over diameter, velocity and temperature, interpolated by a Gaussian process with its uncertainty (Rasmussen
& Williams 2006, Gaussian Processes for Machine Learning, chapters 2, 4.2 and 5.4). Velocity and diameter enter as logarithms."""

import itertools
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, KDTree
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from .. import units
from ..errors import StoreError
from ..files.inputs import read_toml
from ..measures import UNDECIDED, VERDICTS, measure
from ..scene.toml import set_key, toml_text
from .runs import run_point
from .runs_table import AXES, COLUMNS, KEYS, MEASURES, Row, scene_file
from .sweep import point_name

LOGARITHMIC = ("velocity_m_s", "diameter_m")
FEWEST_VALUES = 4  # along each axis, for an interpolation
POINTS_PER_AXIS = 10  # Loeppky, Sacks & Welch (2009), Technometrics 51, 366
FEWEST_IN_PLANE = 12  # points over two axes: three quarters of the smallest grid
# least ratio of the smallest to the largest singular value of the scaled points; 0.25: a correlation of 0.88
SPREAD = 0.25
NARROW = 0.05  # width over middle of a bracket of the critical velocity that is not divided again
FORMULAS = ("velocity_ratio",)  # measures that follow from the scene without a run
LONGEST = 3.0  # largest correlation length over the range of its axis
BAND = 1.96  # standard deviations: 95 % of a normal distribution
DIGITS = 4  # of the coordinates of a new point
_ALIKE = "all runs have the same input: vary at least one axis"
Place = tuple[float, ...]  # a parameter point: values of the axes, SI


@dataclass(frozen=True)
class Interpolation:
    """A Gaussian process through the points of a map, over the columns `axes`. Errors are in SI units of the quantity.

    loo_rms: root mean square error of predicting each point from all others (leave-one-out); loo_inside: share of the points inside
    the 95 % band of this prediction; gap_rms: for each axis, the same error if all points with one value of this axis are left out
    together. Only inner values count, of axes with at least four values and on average two points for each value. spread: standard
    deviation of the values; warnings: text on correlation lengths that the points do not resolve. _hull (k,d+1): half spaces n, b
    with n x + b <= 0 inside the convex hull of the points; x (d,) is scaled by _centre and _scale.
    """

    axes: tuple[str, ...]
    loo_rms: float
    loo_inside: float
    gap_rms: dict[str, float]
    spread: float
    warnings: tuple[str, ...]
    _model: GaussianProcessRegressor
    _centre: NDArray
    _scale: NDArray
    _hull: NDArray

    def __call__(self, *at: ArrayLike) -> tuple[NDArray, NDArray]:
        """Mean and standard deviation, SI, at values of the axes (numbers, or arrays of one shape). The standard deviation is that of
        a new run, including its scatter."""
        x, shape = self._scaled(at)
        mean, std = self._model.predict(x, return_std=True)
        return mean.reshape(shape), std.reshape(shape)

    def inside(self, *at: ArrayLike) -> NDArray:
        """Whether values of the axes (SI; numbers, or arrays of one shape) lie in the convex hull of the points."""
        x, shape = self._scaled(at)
        return np.all(x @ self._hull[:, :-1].T + self._hull[:, -1] <= 1e-9, axis=1).reshape(shape)

    def _scaled(self, at: Sequence[ArrayLike]) -> tuple[NDArray, tuple[int, ...]]:
        """Points (n,d) in the scaled coordinates of the model, and the shape of the given values."""
        points = np.broadcast_arrays(*(np.asarray(value, float) for value in at))
        flat = np.stack([value.ravel() for value in points], axis=1)
        return (_logs(flat, self.axes) - self._centre) / self._scale, points[0].shape


def interpolate(rows: Sequence[Row], quantity: str, axes: Sequence[str] | None = None) -> Interpolation:
    """Interpolate a column of the table over `axes` (default: the axes that vary), from the rows with status "done".

    Matern kernel (nu = 5/2) with a correlation length for each standardised axis, and white noise; the constants maximise the marginal
    likelihood. A length lies between the distance of the points (`_distances`) and LONGEST times the range of its axis. loo_rms is the
    error at a point that is left out (Rasmussen & Williams, eq. 5.12, with the same constants). On a grid the other points of the same
    velocity nearly determine that point: gap_rms leaves out all of them. Raises StoreError if the points do not support an
    interpolation (`sparse`) or the quantity is unknown.
    """
    used = with_value(rows, quantity)
    names = tuple(axes) if axes is not None else varying(rows)
    if quantity not in COLUMNS:
        raise StoreError(f"{quantity} is not a column of a map's table; known: {', '.join(MEASURES)}")
    if not names or (problem := sparse(used, names)):
        raise StoreError(f"{quantity}: {problem if names else _ALIKE}")
    x = np.array([[row[name] for name in names] for row in used], float)
    y = np.array([row[quantity] for row in used], float)
    logs = _logs(x, names)
    centre, scale = logs.mean(axis=0), logs.std(axis=0)
    scale[scale == 0.0] = 1.0
    standard = (logs - centre) / scale
    ranges = np.ptp(standard, axis=0)
    bounds = list(zip(_distances(standard).tolist(), (LONGEST * ranges).tolist(), strict=True))
    kernel = ConstantKernel(1.0, (1e-2, 1e3)) * Matern(ranges.tolist(), bounds, nu=2.5) + WhiteKernel(1e-3, (1e-7, 1.0))
    model = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=4, random_state=0)
    with warnings.catch_warnings():  # lengths at their bounds: `told` says so
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(standard, y)
    lengths = np.atleast_1d(model.kernel_.k1.k2.length_scale)
    short = [measure(name).short for name, n, (low, _) in zip(names, lengths, bounds, strict=True) if n <= 1.01 * low]
    end = "between neighbouring points: compute more points"
    told = tuple(f"{measure(quantity).label} changes along {name} {end}" for name in short)
    inverse, unit = np.linalg.inv(model.kernel_(model.X_train_)), float(y.std()) or 1.0
    off = inverse @ model.y_train_ / np.diag(inverse)
    std = np.sqrt(1.0 / np.diag(inverse))
    gaps = {}
    for column, name in enumerate(names):
        inner = np.unique(x[:, column])[1:-1]
        if len(inner) >= 2 and len(x) >= 2 * (len(inner) + 2):
            groups = [np.flatnonzero(x[:, column] == value) for value in inner]
            errors = [np.linalg.solve(inverse[np.ix_(g, g)], (inverse @ model.y_train_)[g]) for g in groups]
            gaps[name] = float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) * unit
    rms, inside = float(np.sqrt(np.mean(off**2))) * unit, float(np.mean(np.abs(off) <= BAND * std))
    hull = np.asarray(ConvexHull(standard).equations) if len(names) > 1 else np.array(
        [[-1.0, float(standard.min())], [1.0, -float(standard.max())]]
    )  # fmt: skip
    return Interpolation(names, rms, inside, gaps, unit, told, model, centre, scale, hull)


def sparse(rows: Sequence[Row], axes: Sequence[str]) -> str:
    """Text: why the points do not support an interpolation over the axes; "" if they do. Each axis needs FEWEST_VALUES values. Two
    axes need FEWEST_IN_PLANE points, more axes need POINTS_PER_AXIS points for each axis. The points must not lie near one line or
    plane (SPREAD)."""
    x = np.array([[row[axis] for axis in axes] for row in rows], float).reshape(-1, len(axes))
    counts = {axis: len(np.unique(column)) for axis, column in zip(axes, x.T, strict=True)}
    few = [f"{count} values of {measure(axis).short}" for axis, count in counts.items() if count < FEWEST_VALUES]
    if few:
        return f"{' and '.join(few)}; an interpolation needs {FEWEST_VALUES} along each axis"
    if len(axes) == 1:
        return ""
    places = np.unique(_unit(_logs(x, axes)).round(9), axis=0)
    needed = FEWEST_IN_PLANE if len(axes) == 2 else POINTS_PER_AXIS * len(axes)
    if len(places) < needed:
        return f"there are {len(places)} different points, but an interpolation over {len(axes)} axes needs {needed} points"
    sizes = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if sizes[-1] < SPREAD * sizes[0]:
        where = "one line" if len(axes) == 2 else "one plane"
        words = " and ".join(measure(axis).short for axis in axes)
        return f"the points lie near {where} of {words}; an interpolation needs points spread over all axes"
    return ""


def _distances(standard: NDArray) -> NDArray:
    """Shortest length (d,) along each axis that the points (n,d) can resolve. It is the lower quartile of the distances to the nearest
    neighbour, but not less than the smallest difference between two values on the axis."""
    places = np.unique(standard.round(9), axis=0)
    nearest = float(np.quantile(KDTree(places).query(places, k=2)[0][:, 1], 0.25))
    return np.array([max(float(np.diff(np.unique(column)).min()), nearest) for column in places.T])


def with_value(rows: Sequence[Row], quantity: str) -> list[Row]:
    """The rows that have status "done" and a number for the quantity."""
    return [row for row in rows if row["status"] == "done" and isinstance(row.get(quantity), int | float)]


def sides(rows: Sequence[Row], axis: str) -> list[list[Row]]:
    """The rows with status "done", sorted by an axis and divided where the verdict changes between neighbouring values. A value whose
    rows have different verdicts counts as undecided."""
    done = sorted((row for row in rows if row["status"] == "done"), key=lambda row: row[axis])
    places = [list(group) for _, group in itertools.groupby(done, key=lambda row: row[axis])]
    return [[row for here in part for row in here] for _, part in itertools.groupby(places, key=_common_verdict)]


def brackets(rows: Sequence[Row], axes: Sequence[str]) -> list[tuple[Place, Place, str, str]]:
    """Pairs of neighbouring points between which the verdict changes, with both verdicts; the widest first, without pairs closer than
    NARROW. "undecided" counts as a verdict."""
    at: dict[Place, list[Row]] = {}
    for row in rows:
        if row.get("verdict") in VERDICTS and all(row[axis] is not None for axis in axes):
            at.setdefault(tuple(float(row[axis]) for axis in axes), []).append(row)
    verdicts = {place: _common_verdict(here) for place, here in at.items()}

    def is_wide(a: Place, b: Place) -> bool:
        return any(abs(p - q) > NARROW * 0.5 * abs(p + q) for p, q in zip(a, b, strict=True))

    pairs = _neighbours(list(at), axes)
    found = [(distance, a, b) for distance, a, b in pairs if verdicts[a] != verdicts[b] and is_wide(a, b)]
    return [(a, b, verdicts[a], verdicts[b]) for _, a, b in sorted(found, key=lambda each: (-each[0], *each[1:]))]


def _common_verdict(rows: Sequence[Row]) -> str:
    """The verdict of rows of one parameter point; "undecided" if they differ."""
    words = {str(row.get("verdict") or "") for row in rows}
    return words.pop() if len(words) == 1 else UNDECIDED


def _neighbours(places: Sequence[Place], axes: Sequence[str]) -> list[tuple[float, Place, Place]]:
    """Neighbouring points (Gabriel graph): the sphere whose diameter is the line between the two contains no third point. On a grid
    these are the neighbours along the axes. Returns (distance, a, b), a < b; for the distance each axis is scaled to 0..1."""
    places = sorted(places)
    logs = _logs(np.array(places, float).reshape(-1, len(axes)), axes)
    if len(logs) < 2:
        return []
    x = _unit(logs)
    pairs = []
    for i in range(len(x) - 1):
        radius = 0.5 * np.linalg.norm(x[i + 1 :] - x[i], axis=1)
        middle = 0.5 * (x[i + 1 :] + x[i])
        inside = np.linalg.norm(x[None] - middle[:, None], axis=2) <= radius[:, None] + 1e-9
        alone = inside.sum(axis=1) == 2  # both ends lie on the sphere
        pairs += [(2.0 * float(radius[k]), places[i], places[i + 1 + k]) for k in np.flatnonzero(alone)]
    return pairs


@dataclass(frozen=True)
class NextPoint:
    """The next point to compute. at: SI value of each axis, empty if there is no such point; why: the reason, "" for the midpoint of
    the two neighbours whose values differ most."""

    at: dict[str, float]
    why: str = ""

    @property
    def words(self) -> str:
        return place_words(self.at) + (f" ({self.why})" if self.why else "")


def next_point(rows: Sequence[Row], quantity: str, fit: Interpolation | None, axes: Sequence[str]) -> NextPoint:
    """The next point to compute, which is not yet in `rows`. Empty for a quantity of FORMULAS, or if no point remains. The first
    choice is the midpoint of the widest of `brackets`, then that midpoint of two points at which the confidence band is widest.
    Without an interpolation the second choice is the midpoint of the two neighbours whose values differ most."""
    label = measure(quantity).label
    if quantity in FORMULAS:
        return NextPoint({}, f"{label} is a formula of the scene and needs no run")
    used = {tuple(row[axis] for axis in axes) for row in rows if row["status"] != "unfinished"}
    for a, b, below, above in brackets(rows, axes):
        if (place := _between(a, b, axes)) not in used:
            differing = [k for k in range(len(axes)) if a[k] != b[k]]
            ends = [", ".join(shown(axes[k], end[k]) for k in differing) for end in (a, b)]
            return NextPoint(dict(zip(axes, place, strict=True)), f"{below} at {ends[0]}, {above} at {ends[1]}")
    known = {tuple(float(row[axis]) for axis in axes): float(row[quantity]) for row in with_value(rows, quantity)}
    best: tuple[float, Place] = (-1.0, ())
    if fit is not None:
        ordered = sorted({_between(a, b, axes) for a, b in itertools.combinations(sorted(known), 2)} - used)
        for part in (ordered[k : k + 4096] for k in range(0, len(ordered), 4096)):
            band = fit(*np.array(part).T)[1]
            best = max(best, (float(band.max()), part[int(band.argmax())]))
        why = f"band +- {shown(quantity, BAND * best[0], digits=3, named=False)}"
    else:
        for _, a, b in _neighbours(list(known), axes):
            if (place := _between(a, b, axes)) not in used:
                best = max(best, (abs(known[b] - known[a]), place))
        why = ""
    if not best[1]:
        return NextPoint({}, "no two neighbouring points have results")
    return NextPoint(dict(zip(axes, best[1], strict=True)), why)


def best_point(rows: Sequence[Row], quantity: str, axes: Sequence[str]) -> tuple[NextPoint, Interpolation | None, str]:
    """The next point (`next_point`); the interpolation of the quantity, None if the points do not support one; the reason for None.
    axes: empty for those of AXES that vary. Over one axis there is no interpolation across a change of the verdict, where a
    measure can jump (`sides`)."""
    used = with_value(rows, quantity)
    names = tuple(axes) or varying([row for row in rows if row["status"] == "done"])
    if not names:
        return NextPoint({}, _ALIKE), None, _ALIKE
    problem = sparse(used, names)
    if not problem and len(names) == 1 and quantity not in FORMULAS and len(sides(used, names[0])) > 1:
        pairs = [(a[-1][names[0]], b[0][names[0]]) for a, b in itertools.pairwise(sides(used, names[0]))]
        ends = [" and ".join(shown(names[0], end, named=False) for end in pair) for pair in pairs[:3]]
        problem = (
            f"the verdict changes between {', '.join(ends)}, and a measure can jump there: each side has its"
            f" own curve, or straight lines with fewer than {FEWEST_VALUES} values"
        )
    fit = None if problem else interpolate(rows, quantity, names)
    return next_point(rows, quantity, fit, names), fit, problem


def shown(key: str, value: float, digits: int = 4, named: bool = True) -> str:
    """A value (SI) of a measure or an axis as text in its display unit: "velocity 670.8 m/s". named: include its short name."""
    m = measure(key)
    return f"{m.short + ' ' if named else ''}{value * m.factor:.{digits}g} {m.unit}".rstrip()


def place_words(at: Mapping[str, float]) -> str:
    """The values of a parameter point as text."""
    return ", ".join(shown(axis, value) for axis, value in at.items())


def _between(a: Place, b: Place, axes: Sequence[str]) -> Place:
    """The midpoint of two points on each axis. Where the points differ, it is rounded to DIGITS digits."""
    middles = ((p * q) ** 0.5 if axis in LOGARITHMIC else 0.5 * (p + q) for p, q, axis in zip(a, b, axes, strict=True))
    return tuple(p if p == q else float(f"{m:.{DIGITS}g}") for p, q, m in zip(a, b, middles, strict=True))


def run_next(folder: Path, rows: Sequence[Row], at: dict[str, float]) -> str:
    """Run the scene of the finished point nearest to `at` (axis -> value, SI), changed to these values. Returns the name of the new
    point. Ratios of target size to particle diameter are kept if the same in all finished points. Raises StoreError."""
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
    words = {"particle.material": near["material"]}
    for key, value in sorted(changes.items()):  # diameter, then velocity, as a sweep
        unit = near["units"].get(key, "")
        try:
            set_key(data, key, units.show(value, unit) if unit else value)
        except ValueError as problem:
            raise StoreError(f"a new point cannot be computed ({problem}): choose other axes with --axes") from None
        if KEYS.get(key, key) in at:
            words[key] = units.rounded(value, unit, DIGITS) if unit else f"{value:.{DIGITS}g}"
    run_point(folder, point := point_name(words), toml_text(data))
    return point


def varying(rows: Sequence[Row]) -> tuple[str, ...]:
    """Those of AXES whose value differs between the rows."""
    return tuple(axis for axis in AXES if len({row[axis] for row in rows if row[axis] is not None}) > 1)


def _logs(x: NDArray, names: Sequence[str]) -> NDArray:
    logarithmic = np.array([name in LOGARITHMIC for name in names])
    return np.where(logarithmic, np.log(np.where(logarithmic, x, 1.0)), x)


def _unit(logs: NDArray) -> NDArray:
    """Points (n,d), each axis scaled to 0..1. logs (n,d): points, with logarithms of the values on the axes LOGARITHMIC."""
    low, high = logs.min(axis=0), logs.max(axis=0)
    return (logs - low) / np.where(high > low, high - low, 1.0)
