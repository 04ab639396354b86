"""When the particles of a coating arrive under a gun that moves.

The patch of a coating is small compared with the spot. Each pass covers all of it, at a rate that follows from the distance of the
spot.
"""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np

from .. import units
from ..scene.coating import Coating
from ..scene.spray import GunPath
from ..scene.values import DWELL
from ..spray.spot import Spot
from .powder import table_of

_ROOM = 4.0  # least length of a line over the radius of the spot
_LEAST = 1e-3  # least rate of the best pass over the rate under the middle of the spot


def spot_of(path: GunPath, folder: Path) -> Spot:
    """The spot of a spray. folder: folder to which a file name is relative. Raises ValueError; the message begins with the name of
    the field."""
    if path.distribution == "uniform":
        return Spot.of_points(np.array([0.0, 0.5 * path.spot]), np.ones(2))
    if path.distribution == "gaussian":  # truncated at four standard deviations, where 3e-4 of the mass are outside
        r = np.linspace(0.0, 1.0, 1001)
        return Spot.of_points(r * path.spot, np.exp(-8.0 * r**2))
    try:
        table = table_of(path.distribution, folder)
        (name, radius), (_, flow) = list(table.columns.items())[:2]
        return Spot.of_points(units.parse(f"1 {table.units.get(name, 'mm')}", "length") * radius, flow)
    except ValueError as error:  # also of units
        kinds = '"uniform", "gaussian" or a file with radius and mass flow'
        raise ValueError(f'distribution = "{path.distribution[:60]}": {error}; give {kinds}') from None


def divided(number: int, weights: np.ndarray) -> np.ndarray:
    """A number of particles, distributed in proportion to weights (k,): whole numbers (k,), by the largest remainders."""
    exact = number * weights / weights.sum()
    counts = np.floor(exact).astype(int)
    counts[np.argsort(counts - exact, kind="stable")[: number - counts.sum()]] += 1
    return counts


def arrivals(path: GunPath, table: Coating, folder: Path) -> tuple[list[int], list[float | None]]:
    """Numbers of particles in the passes of a layer, without empty passes. Returns also for each particle of the coating the time (s)
    until the next particle, None if it is not known.

    A layer is one run of the gun over all lines. The numbers are in proportion to the mass that each pass brings to the coated area;
    in a pass, the same mass arrives from each particle to the next. If the gun does not move, each time is `table.dwell`. folder:
    folder to which a file name is relative. Raises ValueError; the message begins with the name of the field.
    """
    number = table.number // table.layers
    if path.passes is None:
        return [number], [table.dwell] * table.number
    if table.dwell is not None:
        raise ValueError("passes: the path of the gun gives the times between impacts: remove coating.dwell")
    spot, away, length = spot_of(path, folder), np.abs(path.lines) * math.cos(path.angle), units.show(path.length, "mm")
    rate, reach = spot.across(away), units.rounded(spot.reach, "mm")
    if rate.max() < _LEAST * float(spot.across(0.0)):
        field, nearest = "step" if path.first is None else "first", units.rounded(float(away.min()), "mm")
        text = f"the nearest line is {nearest} from the coated area, beyond the spot of radius {reach}: move it closer"
        raise ValueError(f"{field}: {text}")
    if path.length < _ROOM * spot.reach:
        text = f"the spot does not leave the coated area between passes: give at least {units.rounded(_ROOM * spot.reach, 'mm')}"
        raise ValueError(f"length = {length}: {text}")
    counts = divided(number, rate)
    times = [
        (layer * len(away) + k) * path.time_between_passes + y / path.traverse_speed
        for layer in range(table.layers)
        for k, count in enumerate(counts) if count
        for y in spot.along(float(away[k]), (np.arange(count) + 0.5) / count)
    ]  # fmt: skip
    waits = [float(after - before) for before, after in pairwise(times)]
    if max(waits, default=0.0) > units.parse(DWELL.high, "time"):
        long = units.rounded(max(waits), "s")
        raise ValueError(f"length = {length}: the gun returns after {long}, but {DWELL.high} is the limit: give less")
    return [int(count) for count in counts if count], [*waits, None]
