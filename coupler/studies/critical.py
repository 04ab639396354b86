"""The critical velocity of a scene, from runs at several velocities. The search finds a bracket between rebound and sticking, and
halves it.

Near the critical velocity a verdict depends on the positions of points and elements (the placement). The critical velocity is the
velocity at which half of the placements stick.
"""

import itertools
import math
import re
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

from ..errors import SceneError, StoreError
from ..files.result import Result
from ..measures import REBOUNDS, STICKS, UNDECIDED
from ..physics.adhesion import PairFormula
from ..plan import refinement
from ..plan.planning import plan
from ..plan.reading import Scene
from ..plan.text import duration
from ..report.figure import blank, save
from ..scene.toml import toml_text
from .runs import Log, holds, how_ended, results
from .table import write_rows

LOWEST, HIGHEST = 50.0, 1500.0  # m/s, default limits of the search
STEP = 1.25  # ratio of successive velocities while there is no bracket
TABLE = "critical.csv"
_NAME = re.compile(r"([\d.e+]+)ms(?:_(\d+))?")  # see `point_name`
BELOW = 3  # steps that are tried below the first velocity if the particle rebounds at all higher velocities
TOLERANCE = 0.05  # width of the bracket over its middle
UNKNOWN_START = 600.0  # m/s, first velocity if no formula gives one
_MARKERS = {STICKS: "o", REBOUNDS: "v", UNDECIDED: "s"}
BAND = 0.16, 0.84  # shares of the placements that stick, at the ends of the band: one standard deviation
# Steps of an additive sequence in three dimensions: powers of the plastic number, and the golden ratio
SEQUENCE = 0.7548776662466927, 0.5698402909980532, 0.6180339887498949
_MEASURES = (
    "verdict_by_bonds", "margin_m_s", "restitution", "rebound_velocity_m_s", "bonded_area_m2", "bonded_area_end_m2",
    "verdict_rests_on", "version",
)  # fmt: skip
COLUMNS = ("velocity_m_s", "placement", *_MEASURES)
Row = Mapping[str, Any]  # COLUMNS of a run


@dataclass(frozen=True)
class Bracket:
    """The velocities (m/s) between which the critical velocity lies. high: the lowest velocity at which the particle sticks, above a
    rebound if there is one; low: the highest velocity, below `high`, at which it rebounds. An end that no run shows is None. undecided:
    undecided velocities between low and high. shares: velocity -> fraction of the placements that stick; empty for one placement."""

    low: float | None
    high: float | None
    undecided: tuple[float, ...] = ()
    shares: Mapping[float, float] = field(default_factory=dict)

    @property
    def velocity(self) -> float | None:
        """The critical velocity, m/s: the middle of the bracket; None if there is no bracket."""
        return None if self.low is None or self.high is None else 0.5 * (self.low + self.high)

    @property
    def half_width(self) -> float:
        """Half the width of the bracket, m/s; infinite if there is no bracket."""
        return math.inf if self.low is None or self.high is None else 0.5 * (self.high - self.low)

    @property
    def band(self) -> tuple[float | None, float | None]:
        """The two velocities (m/s) at which the fractions BAND of the placements stick, by linear interpolation between runs. The
        band is at least as wide as the bracket. None for an end that no run shows. With a single placement it is the bracket."""
        if self.low is None or self.high is None or not self.shares:
            return self.low, self.high
        below = _reached((v for v in sorted(self.shares, reverse=True) if v <= self.high), self.shares, BAND[0])
        above = _reached((v for v in sorted(self.shares) if v >= self.low), self.shares, BAND[1])
        return below and min(below, self.low), above and max(above, self.high)

    @property
    def words(self) -> str:
        """The result of the search as one line of text."""
        if self.low is not None and self.high is not None:
            between = f"; undecided at {', '.join(f'{v:.4g}' for v in self.undecided)} m/s" if self.undecided else ""
            answer = f"critical velocity {self.velocity:.4g} m/s +- {self.half_width:.2g} m/s"
            if not self.shares:
                return f"{answer}: rebounds at {self.low:.4g}, sticks at {self.high:.4g} m/s{between}"
            places = ("no velocity is computed yet" if v is None else f"{v:.4g} m/s" for v in self.band)
            ends = (f"{share:.0%} at {place}" for share, place in zip(BAND, places, strict=True))
            return f"{answer}, where half of the placements stick ({' and '.join(ends)})"
        if self.low is not None:
            return f"no critical velocity: rebounds at all velocities up to {self.low:.4g} m/s"
        if self.high is not None:
            return f"no critical velocity: sticks at all velocities down to {self.high:.4g} m/s"
        return "no critical velocity: no run has a verdict"


def _reached(velocities: Iterable[float], shares: Mapping[float, float], share: float) -> float | None:
    """First velocity (m/s), in the order of `velocities`, at which the linearly interpolated shares reach `share`; None if there is
    no such velocity."""
    for v, w in itertools.pairwise(velocities):
        a, b = shares[v] - share, shares[w] - share
        if a * b <= 0.0 and a != b:
            return v + (w - v) * a / (a - b)
    return None


def bracket(verdicts: Mapping[float, str]) -> Bracket:
    """The bracket (ends as in `Bracket`) that verdicts show. verdicts: velocity (m/s) -> verdict."""
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
    """The velocity (m/s) for the next run, rounded to 1 m/s; None if the bracket is narrow enough or a limit is reached.

    verdicts: velocity -> verdict; start: the first velocity, m/s; limits: limits of the search, m/s. Undecided velocities divide the
    bracket; the next velocity is the middle of its widest part. A part of 2 m/s, or of `tolerance` times its middle, is narrow enough.
    If the particle rebounds up to the upper limit, the search continues below the first velocity.
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
    else:  # it rebounds at all higher velocities: go down until it sticks, then until it rebounds again
        lowest = min(verdicts)
        if verdicts[lowest] != STICKS and lowest <= round(start / STEP**BELOW):
            return None
        wanted = max(lowest / STEP, limits[0])
    wanted = float(round(wanted))
    return None if wanted in verdicts else wanted


def at_velocity(scene: Scene, velocity: float, placement: int = 0) -> str:
    """The scene (TOML) with its particle at `velocity` m/s. placement 0 is the scene itself. Other placements change only the
    discretisation: they move the particle by up to half an element in x and y, make a new mesh of the target, and rotate the points
    of a sphere by up to 45 degrees about y."""
    data = tomllib.loads(scene.to_toml())
    particle = data["particle"][0] if isinstance(data["particle"], list) else data["particle"]
    particle["velocity"] = f"{velocity:.6g} m/s"
    if placement:
        x, y, turn = (placement * step % 1.0 for step in SEQUENCE)
        size, offset = scene.derived.element_size, scene.particle.offset
        particle["offset"] = [f"{1e6 * (at + (u - 0.5) * size):.5g} um" for at, u in zip(offset, (x, y), strict=True)]
        if scene.particle.shape == "sphere":
            particle["tilt"] = f"{45.0 * turn:.4g} deg"
    data.pop("name", None)
    data.get("resolution", {}).pop("error", None)  # the search measures the error of the critical velocity instead
    return toml_text(data)


def check(scene: Scene) -> None:
    """Raise SceneError unless the scene is a single impact whose verdict follows from computed bonds."""
    law, many = scene.derived.adhesion_law, f"this scene has {len(scene.particles)} particles: keep only one"
    no_bonds = f"with this law ({law.words}) bonds are not computed, so that runs show no critical velocity"
    problems = {
        f"particle: a critical velocity belongs to a single impact, but {many}": len(scene.particles) != 1,
        "gas: remove this table, because the search sets the velocity": scene.gas is not None,
        f'adhesion: {no_bonds}: give kind = "cohesive" and a criterion': not law.in_impact,
    }
    if any(problems.values()):
        raise SceneError([text for text, holds in problems.items() if holds], scene.name)


def verdict_words(found: Bracket, formula: PairFormula) -> str:
    """Text line: the velocities at which computed bonds and the formula both give rebound, and at which both give sticking."""
    limits = list(formula.known.values()) if formula.critical is not None else []
    if found.low is None or found.high is None:
        return f"verdict: from the runs alone; {formula.words()}"
    low, high = min([found.low, *limits]), max([found.high, *limits])
    return f"verdict: rebounds up to {low:.0f} m/s, sticks from {high:.0f} m/s on, undecided between; {formula.words()}"


def resolution_words(scene: Scene, found: Bracket, coarser: Mapping[int, Bracket]) -> str:
    """Text: the error that comes from the resolution, which the band does not include. coarser: number of points -> bracket of the
    same search."""
    if coarser:
        error = resolution_error(scene, found, coarser)
        told = "; ".join(f"with {points} points: {each.words}" for points, each in coarser.items())
        return f"error of the resolution: {'not measured' if error is None else f'+- {error:.2g} m/s'}; {told}"
    return "the error (+-) does not include that of the resolution: to measure it, set resolution.error = true"


def resolution_error(scene: Scene, found: Bracket, coarser: Mapping[int, Bracket]) -> float | None:
    """Resolution error (m/s) of the critical velocity, from the critical velocities of the same scene with fewer points
    (`refinement.error`). It is at least half the width of the widest bracket. None if fewer than two critical velocities are known,
    or that of the scene is not known. coarser: as in `resolution_words`."""
    brackets = {scene.derived.points: found} | dict(coarser)
    known = [(points ** (-1.0 / 3.0), each.velocity) for points, each in brackets.items() if each.velocity is not None]
    if found.velocity is None or len(known) < 2:
        return None
    widest = max(each.half_width for each in brackets.values() if each.velocity is not None)
    return max(refinement.error(*zip(*known, strict=True))[0], widest)


def search(
    scene: Scene, folder: Path, limits: tuple[float, float] = (LOWEST, HIGHEST), tolerance: float = TOLERANCE,
    log: Log = print, repeat: int = 1, jobs: int = 1, about: str = "",
    start: float | None = None, more: Callable[[float], bool] = lambda _: True,
) -> tuple[Bracket, list[Row]]:  # fmt: skip
    """Compute runs of the scene in folder/runs until the critical velocity is bracketed. Returns the bracket and a row for each run.

    folder/critical.csv is written after each velocity, with `about` above its rows. Finished runs in the folder are used. limits
    (m/s), tolerance: as in `next_velocity`. repeat: number of placements at each velocity; jobs: number of runs at the same time. The
    majority of the placements decides the verdict at a velocity. An undecided run continues once, for the same time again; if it
    stays undecided it counts as one half in the fraction that sticks. log: receives a line for each velocity. start: first velocity,
    m/s (default: critical velocity of the formula); more(seconds): whether the search continues after a velocity that took this time.
    Raises SceneError for a scene without computed bonds, StoreError when a run fails.
    """
    check(scene)
    start, runs = start or plan(scene).impact.formula.critical or UNKNOWN_START, folder / "runs"
    # runs of an earlier scene do not count, such as that of a metal whose library has changed
    rows, seconds = [row for row in rows_of(runs) if _is_of(row, scene, runs)], 0.0
    while more(seconds):
        shares = shares_of(rows, repeat)
        if (velocity := next_velocity(verdicts_of(shares), start, limits, tolerance)) is None:
            break
        which = f"velocity {len(shares) + 1}: {velocity:.4g} m/s"
        log(f"{which}{f', {repeat} placements' if repeat > 1 else ''} ...")
        begun = time.monotonic()
        try:
            here = rows_at(scene, velocity, runs, repeat, jobs, log)
        except StoreError as error:
            if not shares:
                raise
            log(f"{error}; the answer uses the velocities up to {max(shares):.4g} m/s")
            if velocity <= max(shares):
                break
            limits = limits[0], max(shares)
            continue
        rows = [*(row for row in rows if row["velocity_m_s"] != velocity), *here]
        write_rows(folder / TABLE, COLUMNS, rows, about)
        sticking, found = [row["verdict_by_bonds"] for row in here].count(STICKS), answer_of(rows, repeat)
        told = f"{sticking} of {repeat} stick" if repeat > 1 else here[0]["verdict_by_bonds"]
        seconds, left = time.monotonic() - begun, 0  # left: halvings of the bracket
        if found.velocity is not None:
            left = max(math.ceil(math.log2(2.0 * found.half_width / (tolerance * found.velocity))), 0)
        to_go = f"{duration(seconds)} for each velocity"
        to_go += f", about {duration(left * seconds)} remaining" if left else ""
        log(f"{which} {told}; {found.words}; {to_go}")
    rows.sort(key=lambda row: (row["velocity_m_s"], row["placement"]))
    write_rows(folder / TABLE, COLUMNS, rows, about)
    return answer_of(rows, repeat), rows


def shares_of(rows: Iterable[Row], repeat: int) -> dict[float, float]:
    """For each velocity (m/s) with `repeat` placements or more, the fraction of the placements that stick. An undecided placement
    counts as one half."""
    counts: dict[float, list[float]] = {}
    for row in rows:
        sticks = {STICKS: 1.0, REBOUNDS: 0.0}.get(row["verdict_by_bonds"], 0.5)
        counts.setdefault(row["velocity_m_s"], []).append(sticks)
    return {v: sum(each) / len(each) for v, each in counts.items() if len(each) >= repeat}


def verdicts_of(shares: Mapping[float, float]) -> dict[float, str]:
    """For each velocity (m/s), the verdict of the majority of the placements. shares: as in `shares_of`."""
    return {v: STICKS if share > 0.5 else REBOUNDS if share < 0.5 else UNDECIDED for v, share in shares.items()}


def answer_of(rows: Iterable[Row], repeat: int) -> Bracket:
    """The bracket that the rows of a table show. Velocities with fewer than `repeat` placements are ignored."""
    shares = shares_of(rows, repeat)
    return replace(bracket(verdicts_of(shares)), shares=shares if repeat > 1 else {})


def slowest_rebound(rows: Iterable[Row]) -> str | None:
    """Text: the impact velocity at which the rebound is slowest, and this rebound velocity as mean over the placements; None if no
    particle rebounds."""
    rebounds: dict[float, list[float]] = {}
    for row in rows:
        if row["verdict_by_bonds"] == REBOUNDS:
            rebounds.setdefault(row["velocity_m_s"], []).append(row["rebound_velocity_m_s"])
    if not rebounds:
        return None
    velocity, each = min(rebounds.items(), key=lambda item: fmean(item[1]))
    spread = f" +- {stdev(each):.2g}" if len(each) > 1 else ""
    return f"at {velocity:.4g} m/s it rebounds with {fmean(each):.3g}{spread} m/s"


def point_name(velocity: float, placement: int) -> str:
    """The name of the folder of a run at a velocity (m/s)."""
    return f"{velocity:.6g}ms" + (f"_{placement}" if placement else "")


def rows_at(scene: Scene, velocity: float, folder: Path, repeat: int = 1, jobs: int = 1, log: Log = print) -> list[Row]:
    """Compute `repeat` placements at a velocity (m/s), `jobs` at the same time, unless they are already in the folder. Returns their
    rows. An undecided run continues once, for the same time again. Raises StoreError if a run fails."""
    points = {point_name(velocity, k): at_velocity(scene, velocity, k) for k in range(repeat)}
    _, failed = results(folder, points, jobs, log if repeat > 1 else lambda _: None, again=True)
    for reason in failed.values():
        raise StoreError(f"the run at {velocity:.4g} m/s failed: {reason}")
    return [_row(folder / name, velocity, k) for k, name in enumerate(points)]


def _is_of(row: Row, scene: Scene, folder: Path) -> bool:
    """Whether a row is that of a run of the scene."""
    velocity, placement = float(row["velocity_m_s"]), int(row["placement"])
    file = folder / f"{point_name(velocity, placement)}.toml"
    return not file.is_file() or holds(file, at_velocity(scene, velocity, placement))


def rows_of(folder: Path) -> list[Row]:
    """The rows of all runs in a folder that have a result."""
    found = []
    for path in folder.glob("*ms*.json"):
        name, ended = _NAME.fullmatch(path.stem), how_ended(path) or {}
        if name and ended.get("status") in ("done", "undecided"):
            found.append(_row(path.with_suffix(""), float(name[1]), int(name[2] or 0)))
    return found


def _row(run: Path, velocity: float, placement: int) -> Row:
    """The table row of a finished run."""
    values = Result(run).values
    return {"velocity_m_s": velocity, "placement": placement} | {key: values.get(key) for key in _MEASURES}


def draw(rows: Sequence[Row], bracket: Bracket, diameter: float, picture: Path, error: float | None = None) -> None:
    """Draw three quantities against the impact velocity: the coefficient of restitution; the bonded area divided by the cross-section
    of the particle (diameter in m); with several placements the fraction that sticks. Markers show verdicts, lines connect means.
    error: error from the resolution, m/s, None if not measured."""
    figure = blank(10.0 + 4.0 * bool(bracket.shares), 4.0, dpi=130, layout="constrained")
    left, right, *more = figure.subplots(1, 3 if bracket.shares else 2)
    section = 0.25 * math.pi * diameter**2
    for at, key, factor, colour, label in (
        (left, "restitution", 1.0, "k", "rebound velocity / impact velocity"),
        (right, "bonded_area_m2", 1.0 / section, "0.6", "largest"),
        (right, "bonded_area_end_m2", 1.0 / section, "k", "at the end"),
    ):
        points = [
            (row["velocity_m_s"], factor * row[key], row["verdict_by_bonds"]) for row in rows if row[key] is not None
        ]
        levels = [(v, [y for _, y, _ in own]) for v, own in itertools.groupby(points, key=lambda point: point[0])]
        at.plot([v for v, _ in levels], [sum(y) / len(y) for _, y in levels], color=colour, linewidth=0.8)
        for verdict, marker in _MARKERS.items():
            own = [(v, y) for v, y, word in points if word == verdict]
            if own:
                at.scatter(*zip(*own, strict=True), marker=marker, color=colour, s=24, zorder=3,
                           label=verdict if at is left else f"{label}, {verdict}")  # fmt: skip
        at.set(xlabel="impact velocity in m/s", ylim=(0.0, None))
    left.set_ylabel("coefficient of restitution")
    right.set_ylabel("bonded area / cross section")
    for at in more:
        at.plot(*zip(*sorted(bracket.shares.items()), strict=True), "ko-", markersize=4, linewidth=0.8)
        at.axhline(0.5, color="0.6", linewidth=0.8, linestyle="--")
        at.set(xlabel="impact velocity in m/s", ylabel="share of the placements that stick", ylim=(-0.05, 1.05))
    low, high = bracket.band
    for at in (left, right, *more):
        if bracket.velocity is not None:
            at.axvspan(low or at.get_xlim()[0], high or at.get_xlim()[1], color="#d55e00", alpha=0.25, linewidth=0.0)
            if error is not None:
                ends = bracket.velocity - error, bracket.velocity + error
                at.axvspan(*ends, color="0.5", alpha=0.15, linewidth=0.0, zorder=0, label="error of the resolution")
        if at.get_legend_handles_labels()[0]:
            at.legend(fontsize=7)
    figure.suptitle(bracket.words, fontsize=9)
    save(figure, picture)
