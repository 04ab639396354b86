"""The command `coldspray accuracy`, and what `check` and `run` say and choose of accuracy and time."""

import argparse
import math
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from .arguments import Commands, Option, add_study, quantity, scene_of, share, study_folder, teller, working

if TYPE_CHECKING:
    from ..plan.planning import Plan
    from ..plan.reading import Scene
    from ..studies.pace import Pace

_NAMES = ("scene.toml", "accuracy.csv", "accuracy.png", "accuracy.html")


def add(commands: Commands) -> None:
    """Add the command to a parser's subcommands."""
    option = add_study(commands, "accuracy", run, "compute a scene at many resolutions: what accuracy costs in time")
    option("--points", type=int, nargs="+", metavar="N", help="points of the ladder (default: 500 1000 2000 3500 5000)")
    option("--reference", type=int, metavar="N", help="points of the reference (default: 16000)")
    option("--knobs-at", type=int, metavar="N",
           help="points at which the other settings are tried; 0: not at all (default: 1000)")  # fmt: skip


def add_to_run(option: Option) -> None:
    """The options of `run` that choose the resolution."""
    option("--within", metavar="TIME", help='choose the resolution that takes this long here: "60s", "5min", "1h"')
    text = 'choose the resolution for this error of the splat\'s shape, as forecast: "2%%"'
    option("--accuracy", metavar="PERCENT", help=text)
    option("--spread", choices=("strength", "friction"),
           help="compute the scene with the other strength sets of its metals, or without friction and with the greatest, too, and"
           " print the range")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Compute the ladder of a scene, or continue it, and draw. Returns the exit code."""
    from ..studies import ladder
    from ..studies.accuracy_figures import lines, write
    from ..studies.table import StudyTable

    scene = scene_of(arguments)
    knobs = ladder.KNOBS_AT if arguments.knobs_at is None else arguments.knobs_at
    reference = ladder.REFERENCE if arguments.reference is None else arguments.reference
    points = ladder.ladder_points(arguments.points or ladder.POINTS, reference, knobs or None)
    out, say = study_folder(arguments, scene, "accuracy", _NAMES), teller(arguments.quiet)
    about = "remake: coldspray accuracy (rows in this table are not computed again)"
    table = StudyTable(out / "accuracy.csv", ladder.COLUMNS, ladder.KEY, about)
    try:
        ladder.compute_missing(scene, out, points, table, say, arguments.quiet)
    except KeyboardInterrupt:
        say(f"stopped; go on with the same command: {table.path} has {len(table.rows)} of {len(points)} settings")
        raise
    wanted = {point.key for point in points}
    rows = [row for row in table.rows if tuple(row[name] for name in ladder.KEY) in wanted]
    picture, page = write(rows, out, scene.name, scene.particles[-1].temperature)
    if not arguments.quiet:
        print(*lines(rows), sep="\n")
        print(f"table in {table.path}\nfigure in {picture}\npage in {page}")
    return 0


def here(recalibrate: bool = False) -> "Pace":
    """The pace of this machine; measured where it is not known."""
    from ..studies import pace

    def measure() -> float:
        from ..studies.timing import measure

        with working("timing a small impact, once for this machine"):
            return measure()

    return pace.of_this_machine(measure, recalibrate)


def forecast(plan: "Plan", pace: "Pace", verbose: bool = True) -> str:
    """Wall time of a plan on this machine and the error to be expected, as lines for `check`. verbose: with their sources."""
    from ..measures import CONVERGING, MEASURES
    from ..plan import refinement
    from ..plan.text import duration

    shares = refinement.forecast(plan.impacts[-1].points)
    cells = [f"{MEASURES[name].short} {100 * shares[name]:.2g} %" for name in CONVERGING if name in shares]
    text = f"a forecast: +- {', '.join(cells)}; the run measures its own"
    lines = [
        f"  wall time  about {duration(pace.seconds(plan))} on one core here, after compilation; {pace.source}",
        fill(text, 119, initial_indent="  error      ", subsequent_indent=" " * 13),
    ]
    if verbose:
        lines.append("             of the discretisation alone, the median of 24 scenes (docs/evidence/accuracy.md)")
    return "\n".join(lines)


def spread_of(choice: str, scene: "Scene", out: Path, jobs: int, quiet: bool) -> None:
    """Compute a scene with the other values of a choice of the model, and print the range of each measure. out: folder of its run."""
    from ..files.result import Result
    from ..studies import spread

    say, (others, none) = teller(quiet, "stdout"), spread.SPREADS[choice]
    if not (scenes := others(scene)):
        say(f"--spread {choice}: {none}")
        return
    say("\n".join(spread.lines(Result(out), spread.compute(scenes, out / choice, jobs, say))))


def chosen(scene: "Scene", within: str | None, accuracy: str | None) -> tuple["Scene", str]:
    """The scene with the resolution that was asked for, and a line about it. within, accuracy: as on the command line; with both, the
    accuracy is met if there is time for it. Raises ColdsprayError for text that is no time or percentage, AccuracyError where no
    resolution will do."""
    from ..plan import cost as estimates
    from ..plan import refinement
    from ..plan.planning import plan
    from ..plan.refinement import LEAST, MOST, SHAPE, AccuracyError, at_points
    from ..plan.text import duration

    limit = quantity("--within", "time")(within) if within else math.inf
    asked = share(accuracy, "--accuracy") if accuracy else None
    volumes = [p.volume for p in scene.particles]
    largest, last = max(volumes), volumes[-1]
    # the smallest needs points too
    coarsest = max(LEAST, math.ceil(1.1 * estimates.LEAST_POINTS * largest / min(volumes)))
    pace = here() if within else None

    def takes(points: int) -> float:
        return pace.seconds(plan(at_points(scene, points))) if pace else 0.0

    if asked is not None:
        if (needed_points := round(refinement.points_for(asked) * largest / last)) > MOST:
            least = 100.0 * max(refinement.forecast(MOST)[key] for key in SHAPE)
            raise AccuracyError(
                f"--accuracy {accuracy} cannot be reached: the error of the shape at {MOST} points, the most allowed, is about"
                f" {least:.2g} %; give that or more (docs/evidence/accuracy.md)"
            )
        points = max(needed_points, coarsest)
        if (needed := takes(points)) > limit:
            raise AccuracyError(
                f"--accuracy {accuracy} needs {points} points and about {duration(needed)} on this machine, more than --within"
                f" {within}: increase --within or --accuracy"
            )
    else:
        if (needed := takes(coarsest)) > limit:
            raise AccuracyError(
                f"--within {within} is too short: at {coarsest} points, the fewest allowed, this scene takes about"
                f" {duration(needed)} on this machine; increase --within, or reduce [end] time"
            )
        low, high = coarsest, max(MOST, coarsest)
        while high - low > 0.02 * high:
            middle = round(math.sqrt(low * high))
            low, high = (middle, high) if takes(middle) <= limit else (low, middle)
        points = high if takes(high) <= limit else low
    resolved = at_points(scene, points)
    forecast = refinement.forecast(resolved.derived.points_of(resolved.particles[-1]))
    text = f"resolution chosen: {points} points" + (f", about {duration(takes(points))} here" if pace else "")
    text += f"; shape within {100.0 * max(forecast[key] for key in SHAPE):.2g} %, a forecast"
    given = [f"resolution.{key}" for key in ("spacing", "element_size") if dict(scene.resolution)[key] is not None]
    return resolved, text + (f"; in place of {' and '.join(given)} of the scene" if given else "")
