"""The accuracy ladder: one scene at many settings of resolution and scheme, each run in one thread, and their table.

Costs are processor time, which other work on the machine disturbs less than wall time.
"""

import math
import resource
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..core import safety
from ..deposition.run import run
from ..errors import SceneError, SolverError, StoreError
from ..measures import CONVERGING
from ..plan.cost import LEAST_POINTS
from ..plan.reading import Scene
from ..plan.refinement import at_points
from ..progress import Progress
from .table import StudyTable
from .timing import SMALL

POINTS = (500, 1000, 2000, 3500, 5000)
REFERENCE = 16000
KNOBS_AT = 1000
MEASURES = (*CONVERGING, "eps_p_max", "T_max_K")
COLUMNS = (
    "axis", "setting", "points", "points_used", "elements", "steps", "dt_mean_s", "sim_time_s", "cpu_s", "cpu_loop_s", "wall_s",
    *MEASURES, "numerical_dissipation", "energy_drift", "failed",
)  # fmt: skip
STEP = {"courant": safety.COURANT, "stretch": safety.STRETCH, "frequency": safety.POINTS}
# axis -> name in the table -> changed parameters of the scheme
KNOBS: dict[str, dict[str, dict[str, float]]] = {
    "element size": {"1.2 spacings": {"element": 1.2}, "2.5 spacings": {"element": 2.5}},
    "dt": {f"{f:g} dt": {name: f * value for name, value in STEP.items()} for f in (0.5, 1.25, 2.0)},
    "viscosity": {"Q1 0": {"Q1": 0.0}, "Q1 0.2": {"Q1": 0.2}},
    "hourglass": {"hourglass 0.3": {"hourglass": 0.3}, "hourglass 3": {"hourglass": 3.0}},
    "contact stiffness": {"k 0.3": {"contact_stiffness": 0.3}, "k 3": {"contact_stiffness": 3.0}},
}
EFFECTS = ("all", "none")
KEY = ("axis", "setting", "points")  # columns that identify a row


@dataclass(frozen=True)
class LadderPoint:
    """One setting. points: of the largest particle; element: smallest edge of the target's elements over the spacing;
    effects: in place of the scene's; numerics: as `coupler.run` takes them."""

    axis: str
    name: str
    points: int
    element: float | None = None
    effects: str | None = None
    numerics: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str, str]:
        """The values of KEY in the row of the setting."""
        return self.axis, self.name, str(self.points)


def ladder_points(
    points: Sequence[int] = POINTS, reference: int = REFERENCE, knobs_at: int | None = KNOBS_AT
) -> list[LadderPoint]:
    """The settings, the cheap ones first. knobs_at: points at which scheme parameters and effects are varied; None: they are not.
    Raises StoreError for fewer than LEAST_POINTS, and a reference that is not finer than the settings compared with it."""
    for name, numbers in (("points", points), ("reference", [reference]), ("knobs-at", [knobs_at] if knobs_at else [])):
        if numbers and min(numbers) < LEAST_POINTS:
            raise StoreError(f"--{name} {min(numbers)} is too coarse: give {LEAST_POINTS} points or more")
    if reference <= (finest := max([*points, knobs_at or 0])):
        text = f"--reference {reference} must be finer than the settings compared with it: give more than {finest}"
        raise StoreError(text)
    ladder = [LadderPoint("points", f"{n} points", n) for n in sorted(set(points))]
    for axis, tried in KNOBS.items() if knobs_at else ():
        for name, change in tried.items():
            numerics = {k: v for k, v in change.items() if k != "element"}
            ladder.append(LadderPoint(axis, name, knobs_at or 0, change.get("element"), None, numerics))
    ladder += [LadderPoint("effects", f"effects {which}", knobs_at, None, which) for which in EFFECTS if knobs_at]
    return [*ladder, LadderPoint("reference", f"{reference} points", reference)]


def finished(rows: Sequence[Mapping[str, str]]) -> Iterator[Mapping[str, str]]:
    """The rows that have measures."""
    return (row for row in rows if not row["failed"])


class Clock:
    """Processor time (s) of this process and its finished children; `probe` measures that of the time loop."""

    def __init__(self) -> None:
        self._start, self.loop = spent(), 0.0
        self._last: tuple[object, float] = None, 0.0

    def probe(self, impact: object) -> None:
        """Called after every chunk of steps: the time between chunks of one impact is the time of its loop."""
        now, (before, then) = time.process_time(), self._last
        self.loop += now - then if impact is before else 0.0
        self._last = impact, now

    @property
    def whole(self) -> float:
        return spent() - self._start


def spent() -> float:
    """Processor time so far of this process and its finished children, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def compute_missing(
    scene: Scene,
    out: Path,
    ladder: Sequence[LadderPoint],
    table: StudyTable,
    say: Callable[[str], None],
    quiet: bool = True,
) -> None:
    """Compute the points of the ladder that the table lacks. say(text): called with a line about each; quiet: no progress bars. A
    setting that fails, or that finished only after a retry with other numerics, is a row with its reason and no measures."""
    missing = [point for point in ladder if point.key not in table]
    if missing:
        _warm_up(out, say)
    for number, point in enumerate(missing, start=1):
        at = "" if point.axis in ("points", "reference") else f" at {point.points} points"
        say(f"{number} of {len(missing)}: {point.axis}, {point.name}{at}")
        try:
            changes = {} if point.effects is None else {"effects": point.effects}
            scene_here = at_points(scene, point.points, changes, point.element)
        except SceneError as error:  # such as elements too coarse for the crater
            row = {**dict(zip(KEY, point.key, strict=True)), "cpu_s": 0.0, "failed": "; ".join(error.problems)[:200]}
        else:
            folder = out / "runs" / "_".join(point.key).replace(" ", "-")
            row = compute(scene_here, point, folder, Progress(quiet=quiet))
        new = table.add(row)
        say(f"  {new['failed'] or 'finished'}, {float(new['cpu_s']):.3g} s of processor time")


def compute(scene: Scene, point: LadderPoint, folder: Path, progress: Progress) -> dict[str, object]:
    """Run one point of the ladder; its row. folder: of the run, removed when the row is known."""
    clock = Clock()
    row: dict[str, object] = {"axis": point.axis, "setting": point.name, "points": point.points}
    try:
        result = run(scene, folder, force=True, progress=progress, threads=1, numerics=point.numerics, probe=clock.probe,
                     checkpoint_every=math.inf)  # fmt: skip
    except SolverError as problem:
        row |= {"failed": " ".join(str(problem).split())[:200]}
    else:
        s = result.values
        row |= {name: s[name] for name in COLUMNS if name in s}
        if s["rebound_velocity_m_s"] is None and s["velocity_z_m_s"] is not None:  # of a particle that is tied
            row["rebound_velocity_m_s"] = max(s["velocity_z_m_s"], 0.0)
        row |= {"points": point.points, "points_used": s["points"], "failed": ""}
        if result.undecided is not None:
            row |= dict.fromkeys(MEASURES, "") | {"failed": result.undecided[:200]}
        if s["retries"]:  # the run went on with other numerics than the setting's
            row |= dict.fromkeys(MEASURES, "") | {"failed": str(s["warnings"][-1]).split(";")[0][:200]}
    finally:
        progress.stop()
    shutil.rmtree(folder, ignore_errors=True)
    return row | {"cpu_s": clock.whole, "cpu_loop_s": clock.loop}


def _warm_up(out: Path, say: Callable[[str], None]) -> None:
    """Load or compile all kernels, so that no row pays for it."""
    say("loading or compiling the numba kernels (once)")
    scene = Scene.from_text(SMALL, "warm-up")
    compute(scene, LadderPoint("warm-up", "warm-up", 500), out / "runs" / "warm-up", Progress(quiet=True))
