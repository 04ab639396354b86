"""The runs of a job: searches of critical velocities in OUT/bonds, coatings in OUT/coatings. Finished runs are not computed again."""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ColdsprayError, StoreError
from ..measures import STICKS
from ..plan.job import Coatings, Job, Search
from ..spray.window import EROSION, Spray
from . import critical
from .coating import CoatingMeasures, measure
from .coating import read as read_coating
from .critical import Bracket
from .runs import Log, results

Range = tuple[float, float, float]  # value, least, greatest
Found = Mapping[tuple[str, str], "Bonds"]  # by the names of powder and metal


@dataclass(frozen=True)
class Bonds:
    """Critical velocity of the median particle of a powder on the metal `base`, from computed bonds. folder: folder of the runs; found:
    bracket; error: resolution error, m/s, None if not measured; sets: bracket for each other strength set of the powder."""

    powder: str
    base: str
    folder: str
    found: Bracket
    error: float | None = None
    sets: Mapping[str, Bracket] = field(default_factory=dict)

    @property
    def velocity(self) -> float:
        """The critical velocity, m/s: the middle of the bracket; `found.high` if no rebound is known; infinite if no run shows that the
        particle sticks."""
        return 0.5 * sum(ends(self.found))

    @property
    def band(self) -> tuple[float, float]:
        """Smallest and largest critical velocity, m/s. The range includes the bracket, the resolution error and the other strength
        sets."""
        low, high = ends(self.found)
        if self.error is not None and self.found.velocity is not None:
            low, high = min(low, self.found.velocity - self.error), max(high, self.found.velocity + self.error)
        others = [ends(each) for each in self.sets.values()]
        return min([low, *(a for a, _ in others)]), max([high, *(b for _, b in others)])


def ends(found: Bracket) -> tuple[float, float]:
    """Smallest and largest critical velocity (m/s) of a bracket. If the particle rebounds at every velocity, the largest is infinite.
    If it sticks at every velocity, both are the slowest at which it sticks. Without any verdict they are 0 and infinite."""
    return found.low or found.high or 0.0, math.inf if found.high is None else found.high


@dataclass(frozen=True)
class Coating:
    """Coatings of several seeds. measures: measures of each coating by its folder; failed: name of a run without measures -> reason;
    properties: `coupler.properties.measure.Properties` of each coating by its folder."""

    measures: Mapping[str, CoatingMeasures]
    failed: Mapping[str, str]
    properties: Mapping[str, Any] = field(default_factory=dict)


def search(job: Job, part: Search, out: Path, jobs: int, log: Log, more: Callable[[float], bool]) -> Bracket | None:
    """Search the critical velocity of the median particle on a metal within the velocities of the powder (`Job.reach`). If the particle
    sticks at all of them, continue down to the greatest of them divided by EROSION: if it sticks even there, the fastest particle
    erodes the surface. Returns None if the search ends before it shows a rebound or reaches the least velocity of the powder. more: as
    in `critical.search`. Raises ColdsprayError if no velocity can be computed."""
    scene, folder = job.scene_on(part.powder, part.base, part.points, part.strength), out / part.folder
    slowest, fastest = job.reach(part.powder)
    for least in (slowest, fastest / EROSION):
        found, rows = critical.search(
            scene, folder, (least, fastest), part.tolerance, log, part.placements, jobs, start=fastest, more=more
        )
        if found.low is not None:
            return found
        if min((row["velocity_m_s"] for row in rows), default=math.inf) > slowest:
            return None
    return found


def bonds(job: Job, found: Mapping[Search, Bracket]) -> dict[tuple[str, str], Bonds]:
    """Critical velocity with its errors, for each pair of names (powder, metal). found: brackets of all searches."""
    known = {}
    for powder, base in job.hits:
        of_pair = {part: each for part, each in found.items() if (part.powder, part.base) == (powder, base)}
        own = {part: each for part, each in of_pair.items() if not part.strength}
        if not own:
            continue
        best = max(own, key=lambda part: (part.points, part.placements))
        coarser = {part.points: each for part, each in own.items() if part.points < best.points}
        error = critical.resolution_error(job.scene_on(powder, base, best.points), own[best], coarser)
        sets = {part.strength: each for part, each in of_pair.items() if part.strength}
        known[powder, base] = Bonds(powder, base, best.folder, own[best], error, sets)
    return known


def coatings(job: Job, part: Coatings, out: Path, jobs: int, log: Log) -> Coating:
    """Compute the coatings of all seeds, and measure them."""
    folder = out / "coatings"
    name = f"{part.number}x{part.points}x{part.layers}_seed_{{}}"
    points = {name.format(k): job.coating(part, k).to_toml() for k in range(1, part.seeds + 1)}
    found, failed = results(folder, points, jobs, log)
    measures, properties = {}, {}
    for point, result in found.items():
        try:
            measures[f"coatings/{point}"] = measure(read_coating(result))
            with suppress(StoreError):  # its block may have too few splats
                properties[f"coatings/{point}"] = result.properties()
        except ColdsprayError as error:
            failed[point] = str(error)
    return Coating(measures, failed, properties)


def efficiency(spray: Spray, bonds: Bonds) -> Range:
    """Mass fraction that sticks on a metal by computed bonds, with its smallest and largest value. The critical velocity is computed
    for the median particle; for other sizes and temperatures it is scaled as in the formula."""
    formula = float(spray.critical[len(spray.critical) // 2])
    low, high = bonds.band
    return sticking(spray, bonds.velocity / formula, low / formula, high / formula)


def sticking(spray: Spray, factor: float, low: float, high: float, on_substrate: bool = False) -> Range:
    """Mass fraction that sticks if the critical velocities are `factor` times those of the formula, with its smallest and largest
    value for factors from `low` to `high`. on_substrate: as in `Spray.fates`."""
    between = np.linspace(low, high, 9).tolist() if math.isfinite(high) else [low, high]
    each = []
    for f in (factor, *between):
        each.append(float(f == 0.0) if f in (0.0, math.inf) else spray.fates(f, on_substrate)[STICKS])
    return each[0], min(each), max(each)


def thickness(job: Job, stays: Mapping[str, Range], porosity: float) -> Range:
    """Mean thickness (m) of one pass over the width of the spray spot: the sum over the powders of feed rate times the fraction that
    stays, divided by density, (1 - porosity), traverse speed and width of the spot."""
    track = job.data.spray
    layers = [
        [
            track.feed_rate * fed.table.share * x
            / (fed.flying.rho * (1.0 - porosity) * track.traverse_speed * track.spot * job.slant)
            for x in stays[name]
        ]
        for name, fed in job.powders.items()
    ]  # fmt: skip
    value, least, most = map(sum, zip(*layers, strict=True))
    return value, least, most
