"""The same scene at fewer points, and the error that follows from it: what a run computes beside itself to say how far off it is."""

import math
import tomllib
from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import ColdsprayError
from . import cost
from .reading import Scene

# Points of a run over those of its coarsest companion; the one between has their geometric mean. Spacings differ by 16^(1/6) = 1.6,
# more than the 1.3 that Celik et al. (2008), J. Fluids Eng. 130, 078001, ask for; both together cost a fifth of the steps.
REDUCTION = 16
COARSEST = 250  # points: fewer, and a sphere is six spacings wide
LEAST_REDUCTION = 1.5  # of points, between two resolutions that are compared
# Eca & Hoekstra (2014), J. Comput. Phys. 262, 104; they take the second also where the observed order lies outside ORDERS: that doubles
# the errors here (docs/evidence/accuracy.md)
SAFETY, SAFETY_UNCERTAIN = 1.25, 3.0
# Orders that an error is extrapolated with where the values have one of them; else one of FIXED_ORDERS, the first that of the
# particle's viscosity and of the contact's penalty
ORDERS = np.linspace(0.5, 2.0, 61)
FIXED_ORDERS = FORMAL_ORDER, _ = 1.0, 2.0
# Median over the scenes of docs/tables/errors.csv of the error over the value (of temperatures: over their rise), at FORECAST_AT points
FORECAST_AT = 1000
FORECAST = {
    "flattening_ratio": 0.061, "flattening_ratio_total": 0.13, "crater_depth_m": 0.18, "splat_diameter_m": 0.038, "eps_p_mean": 0.17,
    "T_mean_K": 0.26, "rebound_velocity_m_s": 0.19,
}  # fmt: skip
TAIL_POINTS = 2000  # of which twenty lie above the 99th percentile: fewer, and the error of that is not measured
SHAPE = ("flattening_ratio", "crater_depth_m", "splat_diameter_m")  # what --accuracy is about
LEAST, MOST = 300, 64000  # points that a choice may fall on


class AccuracyError(ColdsprayError):
    """No setting gives this accuracy or takes this time; the message names the nearest that is possible."""


def at_points(
    scene: Scene, points: int, changes: Mapping[str, object] | None = None, element: float | None = None
) -> Scene:
    """The scene with about so many points in its largest particle, and its elements in the same ratio to their spacing. changes: of
    other keys; element: smallest edge of the target's elements over the spacing, in place of the scene's ratio. Raises SceneError where
    such points are too coarse for the scene."""
    data = tomllib.loads(scene.to_toml()) | dict(changes or {})
    spacing = cost.spacing(max(p.volume for p in scene.particles), points)
    ratio = spacing / scene.derived.spacing
    sizes = {"resolution": scene.resolution.element_size, "splat": scene.splat.element_size}
    lengths = {table: ratio * size for table, size in sizes.items() if size is not None}
    if element is not None:
        lengths["resolution"] = element * spacing
    data.setdefault("resolution", {})["spacing"] = f"{spacing * 1e6!r} um"
    for table, size in lengths.items():
        data[table]["element_size"] = f"{size * 1e6!r} um"
    return Scene.from_dict(data, scene.name)


def companions(scene: Scene) -> tuple[int, ...]:
    """Points of the coarser runs that measure the error of a scene, the finer first; none for a coating, whose error comes from other
    seeds, and for a scene too coarse for a coarser one."""
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
    """Error of the first of several values, in their unit, and the order that it is extrapolated with.

    h: spacings, in any unit, the finest first. The fit is v + a h^p (Eca & Hoekstra 2014), with p in ORDERS where the best lies between
    their ends, else with that of FIXED_ORDERS which scatters less. The error is the distance a h^p of the first value to zero spacing,
    times a safety factor, plus the standard deviation of the fit and the distance of the first value from it; where the standard
    deviation is not below the range of the values per step of refinement, the sum without this factor is multiplied by 3 and by their
    ratio; it is 0 if all values are equal. Of two values the order is the formal one and the factor is 3 (Roache 1994, J. Fluids Eng.
    116, 405). Raises ValueError for fewer than two values.
    """
    H, y = np.asarray(h, float), np.asarray(values, float)
    if len(y) < 2:
        raise ValueError("an error estimate needs values at two spacings or more")
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
    """Limit v, slope a and residuals (k,) of y = v + a h^p."""
    power = h**p
    (v, a), *_ = np.linalg.lstsq(np.stack([np.ones_like(h), power], axis=1), y, rcond=None)
    return float(v), float(a), y - v - a * power


def _scatter(h: np.ndarray, y: np.ndarray, p: float, unknowns: int) -> float:
    """Standard deviation about the fit of v + a h^p."""
    residuals = line(h, y, p)[2]
    return float(np.sqrt(residuals @ residuals / max(len(y) - unknowns, 1)))


def forecast(points: float) -> dict[str, float]:
    """Measure -> the error over the value that may be expected at so many points, before anything is computed."""
    return {key: share * (FORECAST_AT / points) ** (FORMAL_ORDER / 3.0) for key, share in FORECAST.items()}


def has_error(key: str, points: float) -> bool:
    """Whether coarser runs give the error of a measure, for a run of this many points per particle: percentiles need many points."""
    return points >= TAIL_POINTS or "_p99" not in key


def points_for(share: float) -> int:
    """The fewest points for which the forecast of the errors of the shape is `share` of the value or less."""
    worst = max(forecast(1.0)[key] for key in SHAPE)
    return max(math.ceil((worst / share) ** (3.0 / FORMAL_ORDER)), LEAST)
