"""Parts of a job: ordinary runs in a small folder that answer one question of a process engineer.

OUT/job.toml is the question, OUT/bonds/ has searches of critical velocities, OUT/coatings/
runs of coatings, each with its scene; what is there is not computed again. `job` makes the numbers of OUT/job.json and OUT/job.html.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..errors import ColdsprayError, StoreError
from ..files.inputs import parse_toml, read_toml
from ..files.outputs import claim_folder, write_text
from ..files.result import Result
from ..measures import STICKS
from ..plan.job import WITHIN, Choice, Job
from ..spray.window import Spray
from . import critical
from .coating import CoatingMeasures, SeedError, measure
from .coating import read as read_coating
from .coating_seeds import seed_error
from .runs import how_ended, run_points

FILES = ("job.toml", "job.json", "job.html", "window.png", "micrograph.png")
OTHER = 0.1  # width of a bracket over its middle, of the searches that measure an error
Log = Callable[[str], None]


@dataclass(frozen=True)
class Bonds:
    """Critical velocity of the median particle on a metal by computed bonds. found: its bracket; error: of the resolution, m/s,
    None where it is not measured; sets: the bracket with each other strength set of the powder; failed: why there is none."""

    base: str
    folder: str
    found: critical.Bracket
    error: float | None = None
    sets: Mapping[str, critical.Bracket] = field(default_factory=dict)
    failed: str = ""

    @property
    def velocity(self) -> float:
        """The critical velocity, m/s: the middle of the bracket, or its one end; infinite where the particle rebounds at all."""
        return 0.5 * sum(ends(self.found))

    @property
    def band(self) -> tuple[float, float]:
        """Least and greatest critical velocity, m/s: of the bracket, with the error of the resolution, and of the other sets."""
        low, high = ends(self.found)
        if self.error is not None and self.found.velocity is not None:
            low, high = min(low, self.found.velocity - self.error), max(high, self.found.velocity + self.error)
        others = [ends(each) for each in self.sets.values()]
        return min([low, *(a for a, _ in others)]), max([high, *(b for _, b in others)])


def ends(found: critical.Bracket) -> tuple[float, float]:
    """The velocities (m/s) between which a bracket has the critical one; the upper one is infinite where the particle rebounds at all,
    the lower one is that of the slowest run where it sticks at all, and 0 where no run has a verdict."""
    return found.low or found.high or 0.0, math.inf if found.high is None else found.high


@dataclass(frozen=True)
class Coating:
    """Coatings of several seeds. measures: of each, by its folder; failed: seeds that have none -> why."""

    measures: Mapping[str, CoatingMeasures]
    failed: Mapping[str, str]

    def over(self, value: Callable[[CoatingMeasures], float]) -> SeedError:
        """A measure over the seeds, one at least."""
        return seed_error([value(each) for each in self.measures.values()])


def folder_of(text: str, out: Path) -> None:
    """Write the file of a job, `text`, into its folder `out`. Raises StoreError if the folder holds a job that differs in more than
    `within`."""
    claim_folder(out, "job", FILES)
    kept = out / FILES[0]
    if kept.exists() and {**read_toml(kept), "within": ""} != {**parse_toml(text), "within": ""}:
        raise StoreError(f"{out} holds another job: name another folder with --out, or remove it")
    write_text(kept, text)


def search(
    job: Job, base: str, points: int, tolerance: float, placements: int, out: Path, jobs: int, log: Log, strength: str = ""
) -> critical.Bracket:  # fmt: skip
    """The critical velocity of the median particle on a metal. strength: a set of the powder in place of its own. Raises
    ColdsprayError."""
    v = float(job.arrived.velocity[len(job.arrived.velocity) // 2])
    name = "_".join([f"{points}", *([strength] if strength else [])])
    log(f"critical velocity on {base}: {points} points{', ' + strength if strength else ''}")
    folder, limits = out / "bonds" / f"on_{base}" / name, (WITHIN[0] * v, WITHIN[1] * v)
    return critical.search(job.on(base, points, strength), folder, limits, tolerance, log, placements, jobs)[0]


def bonds(job: Job, choice: Choice, base: str, out: Path, jobs: int, log: Log) -> Bonds:
    """The critical velocity on a metal, without its errors beyond the bracket. A search that fails is told."""
    folder = f"bonds/on_{base}/{choice.bonds}"
    try:
        return Bonds(base, folder, search(job, base, choice.bonds, choice.tolerance, choice.placements, out, jobs, log))
    except ColdsprayError as error:
        return Bonds(base, folder, critical.Bracket(None, None), failed=str(error))


def with_errors(job: Job, choice: Choice, known: Bonds, out: Path, jobs: int, log: Log) -> Bonds:
    """A critical velocity with the errors that the choice asks for: of the resolution and of the strength of the powder."""
    error, sets = None, {}
    wanted = [(choice.coarser, "")] * (choice.coarser > 0)
    wanted += [(choice.sets, name) for name in job.other_sets if choice.sets]
    for points, strength in wanted:
        try:
            other = search(job, known.base, points, OTHER, 1, out, jobs, log, strength)
        except ColdsprayError as problem:
            log(f"left out of the error: {problem}")
            continue
        if strength:
            sets[strength] = other
        else:
            error = critical.resolution_error(job.on(known.base, choice.bonds), known.found, {points: other})
    return replace(known, error=error, sets=sets)


def coatings(job: Job, choice: Choice, out: Path, jobs: int, log: Log) -> Coating:
    """The coatings of all seeds, computed unless they are there."""
    folder = out / "coatings"
    name = f"{choice.number}x{choice.points}_seed_{{}}"
    points = {name.format(k): job.coating(choice, k).to_toml() for k in range(1, choice.seeds + 1)}
    statuses = run_points(folder, points, jobs, log)
    measures, failed = {}, {}
    for point, status in statuses.items():
        try:
            if status not in ("done", "undecided"):
                raise StoreError(str((how_ended(folder / f"{point}.json") or {}).get("reason", "it was stopped")))
            measures[f"coatings/{point}"] = measure(read_coating(Result(folder / point)))
        except ColdsprayError as error:
            failed[point] = str(error)
    return Coating(measures, failed)


def efficiency(spray: Spray, bonds: Bonds) -> tuple[float, float, float]:
    """Share of the mass that sticks on a metal by computed bonds, and its least and greatest value. The critical velocity of the median
    particle is computed; those of other sizes and temperatures are in the ratio of the formula to it."""
    formula = float(spray.critical[len(spray.critical) // 2])

    def share(velocity: float) -> float:
        return 1.0 if velocity == 0.0 else 0.0 if math.isinf(velocity) else spray.fates(velocity / formula)[STICKS]

    low, high = bonds.band
    between = np.linspace(low, high, 9).tolist() if math.isfinite(high) else [low, high]
    each = [share(velocity) for velocity in (bonds.velocity, *between)]
    return each[0], min(each), max(each)


def thickness(job: Job, share: float, porosity: float) -> float:
    """Mean thickness (m) of one pass over the width of the spot: feed * efficiency / (density (1 - porosity) * gun speed * spot)."""
    track = job.data.spray
    return track.feed_rate * share / (job.metal.rho * (1.0 - porosity) * track.traverse_speed * track.spot)
