"""The critical velocity of a scene by runs at several velocities: bracketed between rebound and sticking, then halved."""

import itertools
import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import ColdsprayError, SceneError, StoreError
from ..files.result import Result
from ..measures import REBOUNDS, STICKS, UNDECIDED
from ..physics.adhesion import critical_velocity
from ..plan.planning import plan
from ..plan.reading import Scene
from .points import run_point
from .sweep import toml_text
from .table import StudyTable

LOWEST, HIGHEST = 50.0, 1500.0  # m/s, limits of the search unless said
STEP = 1.25  # ratio of velocities while there is no bracket
BELOW = 3  # steps below the start that are tried where the particle rebounds at all velocities above
TOLERANCE = 0.05  # width of the bracket over its middle
UNKNOWN_START = 600.0  # m/s, where there is no formula to begin with
COLUMNS = (
    "velocity_m_s", "verdict", "margin_m_s", "restitution", "rebound_velocity_m_s", "bonded_area_m2", "bonded_area_end_m2",
    "verdict_rests_on",
)  # fmt: skip
_MEASURES = COLUMNS[2:]


@dataclass(frozen=True)
class Bracket:
    """low, high: m/s, the highest velocity at which the particle rebounds and the lowest above it at which it sticks; None where the
    runs show none; undecided: velocities between them without a verdict."""

    low: float | None
    high: float | None
    undecided: tuple[float, ...] = ()

    @property
    def velocity(self) -> float | None:
        """The middle, m/s: the critical velocity, whose band is half of the width."""
        return None if self.low is None or self.high is None else 0.5 * (self.low + self.high)

    @property
    def half_width(self) -> float:
        """m/s; infinite without a bracket."""
        return math.inf if self.low is None or self.high is None else 0.5 * (self.high - self.low)

    @property
    def words(self) -> str:
        """The bracket in a line."""
        if self.low is not None and self.high is not None:
            between = f"; undecided at {', '.join(f'{v:.4g}' for v in self.undecided)} m/s" if self.undecided else ""
            return (
                f"critical velocity {self.velocity:.4g} m/s +- {self.half_width:.2g} m/s: rebounds at {self.low:.4g}, sticks at"
                f" {self.high:.4g} m/s{between}"
            )
        if self.low is not None:
            return f"no critical velocity: rebounds at all velocities up to {self.low:.4g} m/s"
        if self.high is not None:
            return f"no critical velocity: sticks at all velocities down to {self.high:.4g} m/s"
        return "no critical velocity: no run has a verdict"


def bracket(verdicts: Mapping[float, str]) -> Bracket:
    """The bracket that verdicts by velocity (m/s) show: the lowest sticking one above the highest rebound below it."""
    rebounds = [v for v, word in verdicts.items() if word == REBOUNDS]
    sticks = [v for v, word in verdicts.items() if word == STICKS]
    above = [v for v in sticks if not rebounds or v > min(rebounds)]
    if not above:
        return Bracket(max(rebounds, default=None), None) if rebounds else Bracket(None, min(sticks, default=None))
    high = min(above)
    low = max((v for v in rebounds if v < high), default=None)
    between = [v for v, word in verdicts.items() if word == UNDECIDED and (low or 0.0) < v < high]
    return Bracket(low, high, tuple(sorted(between)))


def next_velocity(
    verdicts: Mapping[float, str], start: float, limits: tuple[float, float], tolerance: float
) -> float | None:
    """The velocity (m/s) to compute next, rounded to 1 m/s; None when the bracket is narrow enough or a limit has been reached.

    start: the first one; limits: of the search, m/s; tolerance: width of the bracket over its middle. Between undecided runs the
    wider part of the bracket is halved. A particle that rebounds up to the upper limit may stick at velocities below the first one.
    """
    if not verdicts:
        return float(round(min(max(start, limits[0]), limits[1])))
    found = bracket(verdicts)
    if found.low is not None and found.high is not None:
        edges = [found.low, *found.undecided, found.high]
        width, low = max((b - a, a) for a, b in itertools.pairwise(edges))
        wanted = low + 0.5 * width
        if width <= tolerance * wanted or width <= 2.0:
            return None
    elif found.high is not None:  # it sticks: go down
        wanted = max(min(verdicts) / STEP, limits[0])
    elif max(verdicts) < limits[1]:  # it rebounds: go up
        wanted = min(max(verdicts) * STEP, limits[1])
    else:  # at all velocities above: where it sticks below, go on to the rebound that ends this
        lowest = min(verdicts)
        if verdicts[lowest] != STICKS and lowest <= round(start / STEP**BELOW):
            return None
        wanted = max(lowest / STEP, limits[0])
    wanted = float(round(wanted))
    return None if wanted in verdicts else wanted


def at_velocity(scene: Scene, velocity: float) -> str:
    """The TOML of the scene with its particle at `velocity` m/s."""
    data = tomllib.loads(scene.to_toml())
    data["particle"]["velocity"] = f"{velocity:.6g} m/s"
    data.pop("name", None)
    return toml_text(data)


def check(scene: Scene) -> None:
    """Raise SceneError unless the scene is one impact whose verdict follows from bonds computed in it."""
    problems = []
    if len(scene.particles) != 1:
        problems.append(f"particle: a critical velocity is that of one impact; this scene has {len(scene.particles)}")
    if scene.gas is not None:
        problems.append("gas: leave it out; the study gives the velocity itself")
    law = scene.derived.adhesion_law
    if not law.in_impact:
        problems.append(
            f"adhesion: no bond is computed with it ({law.words}), so that runs show no critical velocity: give"
            ' kind = "cohesive" and a criterion'
        )
    if problems:
        raise SceneError(problems, scene.name)


def schmidt(scene: Scene) -> float | None:
    """Critical velocity (m/s) of the particle by Schmidt's formula; None without its data."""
    impact = plan(scene).impact
    try:
        return critical_velocity(impact.material, impact.temperature)
    except ColdsprayError:
        return None


def search(
    scene: Scene,
    folder: Path,
    table: StudyTable,
    limits: tuple[float, float] = (LOWEST, HIGHEST),
    tolerance: float = TOLERANCE,
    log: Callable[[str], None] = print,
) -> Bracket:
    """Compute runs of the scene into `folder` until the critical velocity is bracketed; finished ones are used again.

    table: gets a row for each, COLUMNS; the folder's earlier runs of the same scene take part. An undecided run is continued once, for
    as long again. log: told of each run. Raises SceneError for a scene without computed bonds, StoreError when a run fails.
    """
    check(scene)
    verdicts = {float(row["velocity_m_s"]): row["verdict"] for row in table.rows}
    start = schmidt(scene) or UNKNOWN_START
    while (velocity := next_velocity(verdicts, start, limits, tolerance)) is not None:
        log(f"run {len(verdicts) + 1}: {velocity:.4g} m/s ...")
        try:
            row = table.add(run_at(scene, velocity, folder))
        except StoreError as error:
            if not verdicts:
                raise
            log(str(error))
            if velocity <= max(verdicts):
                break
            limits = limits[0], max(verdicts)
            continue
        verdicts[velocity] = row["verdict"]
        log(f"run {len(verdicts)}: {velocity:.4g} m/s {row['verdict']}; {bracket(verdicts).words}")
    return bracket(verdicts)


def run_at(scene: Scene, velocity: float, folder: Path) -> dict[str, object]:
    """The row of the run at a velocity (m/s), which is computed unless it is there. Raises StoreError when it fails."""
    point, text = f"{velocity:.6g}ms", at_velocity(scene, velocity)
    ended = run_point(folder, point, text)
    if ended["status"] == "undecided":
        ended = run_point(folder, point, text, again=True)
    if ended["status"] == "failed":
        raise StoreError(f"the run at {velocity:.4g} m/s failed: {ended['reason']}")
    values = Result(folder / point).values
    verdict = str(values["verdict"])
    return {"velocity_m_s": velocity, "verdict": verdict} | {key: values.get(key) for key in _MEASURES}


def sorted_rows(rows: Sequence[Mapping[str, str]]) -> list[Mapping[str, str]]:
    """Rows of the table by velocity."""
    return sorted(rows, key=lambda row: float(row["velocity_m_s"]))
