"""Error of the resolution: scenes with fewer points, and the error of each measure from runs at several spacings."""

import math
import tomllib
from collections.abc import Mapping, Sequence

import numpy as np

from . import cost
from .reading import Scene

# Points of a run over points of its coarsest companion; the middle one has the geometric mean. Spacings differ by 16^(1/6) = 1.6, more
# than the factor 1.3 of Celik et al. (2008), J. Fluids Eng. 130, 078001. Both companions together cost a fifth of the run's steps.
REDUCTION = 16
COARSEST = 250  # points: with fewer points a sphere is less than eight spacings wide
LEAST_REDUCTION = 1.5  # ratio of the points of two compared resolutions
# Eca & Hoekstra (2014), J. Comput. Phys. 262, 104. They use the second factor also if the observed order is outside ORDERS, which
# doubles the errors here (docs/evidence/accuracy.md).
SAFETY, SAFETY_UNCERTAIN = 1.25, 3.0
ORDERS = np.linspace(0.5, 2.0, 61)  # orders of an extrapolation
FORMAL_ORDER = 1.0  # of the particle's viscosity and of the contact's penalty
FIXED_ORDERS = FORMAL_ORDER, 2.0  # orders if the best fit is at an end of ORDERS
# Median, over the scenes of docs/tables/errors.csv, of error over value (for temperatures over their rise), at FORECAST_AT points
FORECAST_AT = 1000
FORECAST = {
    "flattening_ratio": 0.061, "flattening_ratio_total": 0.13, "crater_depth_m": 0.18, "splat_diameter_m": 0.038, "eps_p_mean": 0.17,
    "T_mean_K": 0.26, "rebound_velocity_m_s": 0.19,
}  # fmt: skip
TAIL_POINTS = 2000  # least points for the error of a 99th percentile: 20 of them are above it
SHAPE = ("flattening_ratio", "crater_depth_m", "splat_diameter_m")  # measures of --accuracy
LEAST, MOST = 300, 64000  # limits of the points that --accuracy and --within choose


def at_points(scene: Scene, points: int, changes: Mapping[str, object] | None = None) -> Scene:
    """The scene with about this number of points in its largest particle, and with the same ratio of element sizes to the spacing.
    changes: changes of other keys. Raises SceneError if the spacing is too large for the scene."""
    data = tomllib.loads(scene.to_toml()) | dict(changes or {})
    spacing = cost.spacing(max(p.volume for p in scene.particles), points)
    ratio = spacing / scene.derived.spacing
    data.setdefault("resolution", {})["spacing"] = f"{spacing * 1e6!r} um"
    for table, size in {"resolution": scene.resolution.element_size, "splat": scene.splat.element_size}.items():
        if size is not None:
            data[table]["element_size"] = f"{ratio * size * 1e6!r} um"
    return Scene.from_dict(data, scene.name)


def companions(scene: Scene) -> tuple[int, ...]:
    """Numbers of points of the coarser runs that measure the error of a scene, the finer run first. The list is empty for a coating,
    whose error is measured by other seeds, and for a scene that is too coarse for a coarser run."""
    volumes = [p.volume for p in scene.particles]
    least = max(COARSEST, math.ceil(1.1 * cost.LEAST_POINTS * max(volumes) / min(volumes)))
    points = scene.derived.points
    coarsest = max(points / REDUCTION, least)
    if len(volumes) >= cost.MANY or points < LEAST_REDUCTION * coarsest:
        return ()
    middle = math.sqrt(points * coarsest)
    between = (round(middle),) if middle > LEAST_REDUCTION * coarsest else ()
    return (*between, round(coarsest))


def error(h: Sequence[float], values: Sequence[float]) -> tuple[float, float]:
    """Error of the first of several values, in their unit, and the order p of the extrapolation.

    h: spacings, in any unit, the finest first. The fit is v + a h^p (Eca & Hoekstra 2014). p is the best of ORDERS if it is not at an
    end of them, otherwise the better of FIXED_ORDERS. e = |a| h^p at the finest spacing; s: standard deviation of the fit; d: distance
    of the first value from the fit; R: range of the values divided by their number less 1. If s < R, the error is SAFETY e + s + d.
    Otherwise it is SAFETY_UNCERTAIN (s / R) (e + s + d). If all values are equal, it is 0. For two values p is FORMAL_ORDER and the
    error is SAFETY_UNCERTAIN e (Roache 1994, J. Fluids Eng. 116, 405).
    """
    H, y = np.asarray(h, float), np.asarray(values, float)
    if len(y) == 2:
        return SAFETY_UNCERTAIN * abs(line(H, y, FORMAL_ORDER)[1]) * float(H[0]), FORMAL_ORDER
    best = min(range(len(ORDERS)), key=lambda k: _scatter(H, y, float(ORDERS[k]), 3))
    inside = 0 < best < len(ORDERS) - 1
    unknowns, orders = (3, (float(ORDERS[best]),)) if inside else (2, FIXED_ORDERS)
    p = min(orders, key=lambda p: _scatter(H, y, p, unknowns))
    _, a, residuals = line(H, y, p)
    scatter, spread = _scatter(H, y, p, unknowns), float(np.ptp(y)) / (len(y) - 1)
    distance, off = abs(a) * float(H[0]) ** p, abs(float(residuals[0]))
    if scatter < spread:
        return SAFETY * distance + scatter + off, p
    return (SAFETY_UNCERTAIN * scatter / spread * (distance + scatter + off) if spread else 0.0), p


def line(h: np.ndarray, y: np.ndarray, p: float) -> tuple[float, float, np.ndarray]:
    """Limit v, slope a and residuals (k,) of the fit y = v + a h^p."""
    power = h**p
    (v, a), *_ = np.linalg.lstsq(np.stack([np.ones_like(h), power], axis=1), y, rcond=None)
    return float(v), float(a), y - v - a * power


def _scatter(h: np.ndarray, y: np.ndarray, p: float, unknowns: int) -> float:
    """Standard deviation of the values from the fit v + a h^p with a number of unknowns."""
    residuals = line(h, y, p)[2]
    return float(np.sqrt(residuals @ residuals / max(len(y) - unknowns, 1)))


def forecast(points: float) -> dict[str, float]:
    """Expected relative error of each measure at a number of points, before any computation."""
    return {key: share * (FORECAST_AT / points) ** (FORMAL_ORDER / 3.0) for key, share in FORECAST.items()}


def has_error(key: str, points: float) -> bool:
    """Whether coarser runs can give the error of a measure of a run with this number of points per particle. Percentiles need many
    points."""
    return points >= TAIL_POINTS or "_p99" not in key


def points_for(share: float) -> int:
    """The least number of points for which the expected relative errors of the measures SHAPE are at most `share`."""
    worst = max(forecast(1.0)[key] for key in SHAPE)
    return max(math.ceil((worst / share) ** (3.0 / FORMAL_ORDER)), LEAST)
