"""The command `coldspray accuracy`. Also for `check` and `run`: the estimate of error and time, and the choice of the resolution."""

import argparse
import math
from bisect import bisect_left, bisect_right
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ColdsprayError, SceneError, is_only_process
from ..studies.table import write_rows
from . import arguments as options
from .arguments import Commands, Option

if TYPE_CHECKING:
    from ..plan.reading import Scene
    from ..studies.pace import Pace

_NAMES = ("scene.toml", "accuracy.csv", "accuracy.png")


def add(commands: Commands) -> None:
    option = options.add_study(
        commands, "accuracy", run, "compute a scene at several numbers of points: accuracy against time"
    )
    text = "numbers of points of the particle (default: 500 1000 2000 3500 5000 16000)"
    option("--points", type=int, nargs="+", metavar="N", help=text)
    options.add_jobs(option, "number of simultaneous runs")


def add_to_run(option: Option) -> None:
    """Add the options of `run` that choose the resolution."""
    option("--within", metavar="TIME", help='choose the finest resolution for this wall time: "60s", "5min", "1h"')
    text = 'choose the coarsest resolution whose expected error of the splat shape is at most this: "2%%"'
    option("--accuracy", metavar="PERCENT", help=text)
    option("--spread", choices=("strength", "friction"),
           help="also compute the scene with the other strength sets of its metals, or with the smallest and largest friction, and"
           " print the range")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Compute a scene at several numbers of points, or continue such a study, and draw the result. Returns the exit code."""
    from ..studies import accuracy

    scene = options.scene_of(arguments)
    out, say = options.study_folder(arguments, scene, "accuracy", _NAMES), options.teller(arguments.quiet)
    with options.continuing(out, say):
        rows = accuracy.compute(scene, out, arguments.points or accuracy.POINTS, options.jobs_of(arguments), say)
    write_rows(out / "accuracy.csv", accuracy.COLUMNS, rows, options.remake(arguments))
    accuracy.draw(rows, out / "accuracy.png", scene.name)
    if not arguments.quiet:
        print(*accuracy.lines(rows), sep="\n")
        print(f"table in {out / 'accuracy.csv'}\nfigure in {out / 'accuracy.png'}")
    return 0


def here(recalibrate: bool = False) -> "Pace":
    """The speed of this machine, which is measured if it is not known. recalibrate: measure it again."""
    from ..studies import pace

    def measure() -> float:
        from ..deposition.run import run

        with options.working("measuring the speed of this machine with a small impact (only once)"):
            return pace.measure(run)

    return pace.of_this_machine(measure, recalibrate)


def spread_of(choice: str, scene: "Scene", out: Path, jobs: int, quiet: bool) -> None:
    """Compute a scene with the other values of a model choice, and print the range of each measure. choice: key in `spread.SPREADS`;
    out: folder of the run of the scene."""
    from ..files.result import Result
    from ..studies import spread

    say, (others, none) = options.teller(quiet, "stdout"), spread.SPREADS[choice]
    if not (scenes := others(scene)):
        say(f"--spread {choice}: {none}")
        return
    say("\n".join(spread.lines(Result(out), spread.compute(scenes, out / choice, jobs, say))))


def chosen(scene: "Scene", within: str | None, accuracy: str | None) -> tuple["Scene", str]:
    """Return the scene with a new resolution, and a text line about this resolution. within, accuracy: texts of --within and
    --accuracy. --within alone determines the resolution; with --accuracy it only limits the wall time. Raises ColdsprayError for a text
    that is not a time or a percentage, and if no allowed resolution satisfies the options."""
    from ..plan import cost as estimates
    from ..plan import refinement
    from ..plan.planning import plan
    from ..plan.refinement import LEAST, MOST, SHAPE, at_points
    from ..plan.text import duration

    limit = options.quantity("--within", "time")(within) if within else math.inf
    if within and not is_only_process():
        raise ColdsprayError("--within is for one process: under mpiexec give resolution.spacing, or --accuracy")
    asked = options.share(accuracy, "--accuracy") if accuracy else None
    volumes = [p.volume for p in scene.particles]
    largest, last = max(volumes), volumes[-1]
    # the smallest particle needs enough points, too
    coarsest = max(LEAST, math.ceil(1.1 * estimates.LEAST_POINTS * largest / min(volumes)))
    pace = here() if within else None

    def is_allowed(points: int) -> bool:
        try:
            at_points(scene, points)
        except SceneError:
            return False
        return True

    fine = coarsest  # a number that the scene allows: large ones can need too much memory, small ones are too coarse for its details
    while fine < MOST and not is_allowed(fine):
        fine = min(2 * fine, MOST)
    between = range(max(coarsest, fine // 2), fine + 1)
    if is_allowed(fine):
        coarsest = between[bisect_left(between, True, key=is_allowed)]

    def time_of(points: int) -> float:
        return pace.seconds(plan(at_points(scene, points))) if pace else 0.0

    if asked is not None:
        if (needed_points := round(refinement.points_for(asked) * largest / last)) > MOST:
            forecast = refinement.forecast(round(MOST * last / largest))  # of the last particle
            least = math.ceil(1000.0 * max(forecast[key] for key in SHAPE)) / 10.0
            raise ColdsprayError(
                f"--accuracy {accuracy} cannot be reached: with {MOST} points, the largest allowed number, the error of the shape"
                f" is about {least:g} %. Give at least this percentage (docs/evidence/accuracy.md)"
            )
        points = max(needed_points, coarsest)
        if (needed := time_of(points)) > limit:
            raise ColdsprayError(
                f"--accuracy {accuracy} needs {points} points and about {duration(needed)} on this machine, which exceeds --within"
                f" {within}: increase --within or --accuracy"
            )
    else:
        allowed = range(coarsest, max(MOST, coarsest) + 1)
        if not (fitting := bisect_right(allowed, limit, key=time_of)):
            raise ColdsprayError(
                f"--within {within} is too short: with {coarsest} points, the smallest allowed number, this scene takes about"
                f" {duration(time_of(coarsest))} on this machine; increase --within, or reduce [end] time"
            )
        points = allowed[fitting - 1]
    resolved = at_points(scene, points)
    forecast = refinement.forecast(resolved.derived.points_of(resolved.particles[-1]))
    text = f"resolution chosen: {points} points" + (f", about {duration(time_of(points))} here" if pace else "")
    text += f"; shape within {100.0 * max(forecast[key] for key in SHAPE):.2g} % (expected)"
    given = [f"resolution.{key}" for key in ("spacing", "element_size") if dict(scene.resolution)[key] is not None]
    return resolved, text + (f"; this replaces {' and '.join(given)} in the scene" if given else "")
