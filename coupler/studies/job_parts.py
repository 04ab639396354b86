"""The runs of a job: searches of critical velocities in OUT/bonds, coatings in OUT/coatings. Finished runs are not computed again."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..errors import ColdsprayError, StoreError
from ..files.inputs import parse_toml, read_toml
from ..files.outputs import claim_folder, write_text
from ..measures import STICKS
from ..plan.job import WITHIN, Choice, Job
from ..spray.window import Spray
from . import critical
from .coating import CoatingMeasures, SeedError, measure
from .coating import read as read_coating
from .coating_seeds import seed_error
from .runs import Log, results

FILES = ("job.toml", "job.json", "job.html", "window.png", "micrograph.png")
OTHER = 0.1  # width of a bracket over its middle, for searches that measure an error


@dataclass(frozen=True)
class Bonds:
    """Critical velocity of the median particle on the metal `base`, from computed bonds. folder: folder of the runs; found: bracket;
    error: resolution error, m/s, None if not measured; sets: bracket for each other strength set of the powder; failed: why there is
    no bracket."""

    base: str
    folder: str
    found: critical.Bracket
    error: float | None = None
    sets: Mapping[str, critical.Bracket] = field(default_factory=dict)
    failed: str = ""

    @property
    def velocity(self) -> float:
        """The critical velocity, m/s: the middle of the bracket, or its only known end; infinite if the particle rebounds at all
        velocities."""
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


def ends(found: critical.Bracket) -> tuple[float, float]:
    """Smallest and largest critical velocity (m/s) of a bracket. If the particle rebounds at all velocities, the largest is infinite.
    If it sticks at all, both are the velocity of the slowest run. Without any verdict they are 0 and infinite."""
    return found.low or found.high or 0.0, math.inf if found.high is None else found.high


@dataclass(frozen=True)
class Coating:
    """Coatings of several seeds. measures: measures of each coating by its folder; failed: reason for each point without a
    coating."""

    measures: Mapping[str, CoatingMeasures]
    failed: Mapping[str, str]

    def over(self, value: Callable[[CoatingMeasures], float]) -> SeedError:
        """A measure as mean over the seeds, with its error. At least one seed must have measures. value: function that gives the
        measure of a coating."""
        return seed_error([value(each) for each in self.measures.values()])


def folder_of(text: str, out: Path) -> None:
    """Write the text of a job into its folder `out`. Raises StoreError if the folder holds a job that differs in other keys than
    `within`."""
    claim_folder(out, "job", FILES)
    kept = out / FILES[0]
    if kept.exists() and {**read_toml(kept), "within": ""} != {**parse_toml(text), "within": ""}:
        raise StoreError(f"{out} holds another job: choose another folder with --out, or remove this one")
    write_text(kept, text)


def search(
    job: Job, base: str, points: int, tolerance: float, placements: int, out: Path, jobs: int, log: Log, strength: str = ""
) -> critical.Bracket:  # fmt: skip
    """Search the critical velocity of the median particle on a metal. points, tolerance, placements: as in `Choice`; strength:
    another strength set of the powder. Raises ColdsprayError if no velocity can be computed."""
    v = float(job.arrived.velocity[len(job.arrived.velocity) // 2])
    name = "_".join([f"{points}", *([strength] if strength else [])])
    log(f"critical velocity on {base}: {points} points{', ' + strength if strength else ''}")
    folder, limits = out / "bonds" / f"on_{base}" / name, (WITHIN[0] * v, WITHIN[1] * v)
    return critical.search(job.on(base, points, strength), folder, limits, tolerance, log, placements, jobs)[0]


def bonds(job: Job, choice: Choice, base: str, out: Path, jobs: int, log: Log) -> Bonds:
    """The critical velocity on a metal, with its bracket as the only error. If the search fails, `failed` has the reason."""
    folder = f"bonds/on_{base}/{choice.bonds}"
    try:
        return Bonds(base, folder, search(job, base, choice.bonds, choice.tolerance, choice.placements, out, jobs, log))
    except ColdsprayError as error:
        return Bonds(base, folder, critical.Bracket(None, None), failed=str(error))


def with_errors(job: Job, choice: Choice, known: Bonds, out: Path, jobs: int, log: Log) -> Bonds:
    """The critical velocity `known`, completed by the other errors of the choice: those of the resolution and of the powder's
    strength."""
    error, sets = None, {}
    wanted = [(choice.coarser, "")] * (choice.coarser > 0)
    wanted += [(choice.sets, name) for name in job.other_sets if choice.sets]
    for points, strength in wanted:
        try:
            other = search(job, known.base, points, OTHER, 1, out, jobs, log, strength)
        except ColdsprayError as problem:
            log(f"the error does not include: {problem}")
            continue
        if strength:
            sets[strength] = other
        else:
            error = critical.resolution_error(job.on(known.base, choice.bonds), known.found, {points: other})
    return replace(known, error=error, sets=sets)


def coatings(job: Job, choice: Choice, out: Path, jobs: int, log: Log) -> Coating:
    """Compute the coatings of all seeds, and measure them."""
    folder = out / "coatings"
    name = f"{choice.number}x{choice.points}_seed_{{}}"
    points = {name.format(k): job.coating(choice, k).to_toml() for k in range(1, choice.seeds + 1)}
    found, failed = results(folder, points, jobs, log)
    measures = {}
    for point, result in found.items():
        try:
            measures[f"coatings/{point}"] = measure(read_coating(result))
        except ColdsprayError as error:
            failed[point] = str(error)
    return Coating(measures, failed)


def efficiency(spray: Spray, bonds: Bonds) -> tuple[float, float, float]:
    """Mass fraction that sticks on a metal by computed bonds, with its smallest and largest value. The critical velocity is computed
    for the median particle; for other sizes and temperatures it is scaled as in the formula."""
    formula = float(spray.critical[len(spray.critical) // 2])

    def share(velocity: float) -> float:
        return 1.0 if velocity == 0.0 else 0.0 if math.isinf(velocity) else spray.fates(velocity / formula)[STICKS]

    low, high = bonds.band
    between = np.linspace(low, high, 9).tolist() if math.isfinite(high) else [low, high]
    each = [share(velocity) for velocity in (bonds.velocity, *between)]
    return each[0], min(each), max(each)


def thickness(job: Job, share: float, porosity: float) -> float:
    """Mean thickness (m) of one pass over the width of the spray spot: feed rate times `share`, divided by density, (1 - porosity),
    traverse speed and spot diameter."""
    track = job.data.spray
    return track.feed_rate * share / (job.metal.rho * (1.0 - porosity) * track.traverse_speed * track.spot)
