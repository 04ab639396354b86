"""Runs of the accuracy ladder, each in one thread.

Costs are processor time of one thread (`time.process_time`, and that of the process that makes splats), which other work on the
machine disturbs less than wall time; the wall time is kept beside it.
"""

import json
import math
import resource
import shutil
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from ..deposition.run import resume, run
from ..errors import SceneError, SolverError
from ..plan.reading import Scene
from ..progress import Progress
from .ladder import COLUMNS, KEY, MEASURES, LadderPoint, scene_at
from .table import StudyTable


class Clock:
    """Processor time (s) of this process and its finished children; `probe` measures that of the time loop."""

    def __init__(self) -> None:
        self._start = spent()
        self._impact: object = None
        self._spans: list[list[float]] = []

    def probe(self, impact: object) -> None:
        """Called after every chunk of steps: what lies between the chunks of one impact is its loop."""
        now = time.process_time()
        if impact is not self._impact:
            self._impact = impact
            self._spans.append([now, now])
        self._spans[-1][1] = now

    @property
    def whole(self) -> float:
        return spent() - self._start

    @property
    def loop(self) -> float:
        return sum(last - first for first, last in self._spans)


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
) -> StudyTable:
    """Compute the points of the ladder that the table lacks. say(text): called with a line about each; quiet: no progress bars.

    A run that was stopped by Ctrl-C goes on from its checkpoint. A setting that fails, or that finished only after a retry with
    other numerics, is a row with its reason and no measures.
    """
    missing = [point for point in ladder if point.key not in table]
    if missing:
        _warm_up(out, say)
    for number, point in enumerate(missing, start=1):
        at = "" if point.axis in ("points", "reference") else f" at {point.points} points"
        say(f"{number} of {len(missing)}: {point.axis}, {point.name}{at}")
        try:
            scene_here = scene_at(scene, point)
        except SceneError as error:  # such as elements too coarse for the crater
            row = {**dict(zip(KEY, point.key, strict=True)), "cpu_s": 0.0, "failed": "; ".join(error.problems)[:200]}
        else:
            row = compute(scene_here, point, out / "runs" / _folder(point), Progress(quiet=quiet))
        new = table.add(row)
        say(f"  {new['failed'] or 'finished'}, {float(new['cpu_s']):.3g} s of processor time")
    return table


def compute(scene: Scene, point: LadderPoint, folder: Path, progress: Progress) -> dict[str, object]:
    """Run one point of the ladder; its row. folder: of the run, removed when the row is known."""
    note, clock = folder / "spent.json", Clock()
    before = _spent_before(note)
    row: dict[str, object] = {"axis": point.axis, "setting": point.name, "points": point.points}
    start = partial(resume, folder) if any(before) else partial(run, scene, folder, force=True)
    try:
        result = start(
            progress=progress, threads=1, numerics=point.numerics, probe=clock.probe, checkpoint_every=math.inf
        )
    except SolverError as problem:
        row |= {"failed": " ".join(str(problem).split())[:200]}
    except KeyboardInterrupt:
        folder.mkdir(parents=True, exist_ok=True)
        note.write_text(json.dumps([clock.whole + before[0], clock.loop + before[1]]))
        raise
    else:
        s = result.values
        row |= {name: s[name] for name in COLUMNS if name in s}
        if (
            s["rebound_velocity_m_s"] is None and (upwards := s["velocity_z_m_s"]) is not None
        ):  # of a particle that is tied
            row["rebound_velocity_m_s"] = max(upwards, 0.0)
        row |= {"points": point.points, "points_used": s["points"], "failed": ""}
        if result.undecided is not None:
            row |= dict.fromkeys(MEASURES, "") | {"failed": result.undecided[:200]}
        if s["retries"]:  # the run went on with other numerics than the setting's
            row |= dict.fromkeys(MEASURES, "") | {"failed": str(s["warnings"][-1]).split(";")[0][:200]}
    finally:
        progress.stop()
    shutil.rmtree(folder, ignore_errors=True)
    return row | {"cpu_s": clock.whole + before[0], "cpu_loop_s": clock.loop + before[1]}


def _spent_before(note: Path) -> tuple[float, float]:
    """Processor time of a run before it was stopped, and of its loop, s."""
    try:
        whole, loop = map(float, json.loads(note.read_text()))
    except (OSError, ValueError, TypeError):
        return 0.0, 0.0
    return whole, loop


def _warm_up(out: Path, say: Callable[[str], None]) -> None:
    """Load or compile all kernels, so that no row pays for it."""
    say("compiling")
    text = (
        '[[particle]]\nmaterial = "Ni"\ndiameter = "10 um"\nvelocity = "500 m/s"\n'
        '[substrate]\nmaterial = "SS304"\ndiameter = "60 um"\nheight = "30 um"\n'
        '[end]\ntime = "2 ns"\n[resolution]\nspacing = "1.1 um"\n'
    )
    point = LadderPoint("warm-up", "warm-up", 500)
    compute(Scene.from_text(text, "warm-up"), point, out / "runs" / "warm-up", Progress(quiet=True))


def _folder(point: LadderPoint) -> str:
    return "_".join(point.key).replace(" ", "-")
