"""The command `coldspray critical`: the critical velocity of a scene from runs at several velocities."""

import argparse
from functools import partial

from ..errors import ColdsprayError, StoreError
from ..studies.table import write_rows
from . import arguments as options
from .arguments import Commands, continuing, jobs_of, quantity, remake, scene_of, share, study_folder, teller

_NAMES = ("scene.toml", "critical.csv", "critical.png")
_MOST_PLACEMENTS = 100
_LIMITS = "10 m/s", "2000 m/s"  # as of particle.velocity in a scene


def add(commands: Commands) -> None:
    text = "compute the critical velocity: the lowest velocity at which a particle with cohesive bonds sticks"
    option = options.add_study(commands, "critical", run, text)
    option(
        "--within", default="5%", metavar="PERCENT", help='width of the bracket relative to its middle (default: "5%%")'
    )
    for name, text in (("low", "lowest"), ("high", "highest")):
        option(f"--{name}", type=quantity(f"--{name}", "velocity", limits=_LIMITS), metavar="VELOCITY",
               help=f'{text} velocity to compute, such as "300 m/s"')  # fmt: skip
    option("--repeat", type=partial(options.at_least_one, most=_MOST_PLACEMENTS), default=3, metavar="N",
           help="number of placements (runs with other positions of points and elements) at each velocity (default: 3)")  # fmt: skip
    options.add_jobs(option, "number of simultaneous runs")


def run(arguments: argparse.Namespace) -> int:
    """Search the critical velocity of a scene, or continue the search, and draw the result. Returns the exit code."""
    from ..plan.planning import plan
    from ..plan.refinement import at_points, companions
    from ..studies import critical

    scene = scene_of(arguments)
    critical.check(scene)
    tolerance = share(arguments.within, "--within")
    limits = arguments.low or critical.LOWEST, arguments.high or critical.HIGHEST
    if not limits[0] < limits[1]:
        raise StoreError(f"--low {limits[0]:g} m/s must be less than --high {limits[1]:g} m/s")
    out, say = study_folder(arguments, scene, "critical", _NAMES), teller(arguments.quiet)
    about = f"{remake(arguments)} (finished runs are not computed again)"
    how = (limits, tolerance, say, arguments.repeat, jobs_of(arguments), about)
    coarser = dict[int, critical.Bracket]()
    with continuing(out, say):
        bracket, rows = critical.search(scene, out, *how)
        for points in companions(scene) if scene.resolution.error and bracket.velocity else ():
            say(f"measuring the error of the resolution: the same search with {points} points")
            try:
                coarser[points] = critical.search(at_points(scene, points), out / f"{points}_points", *how)[0]
            except ColdsprayError as problem:
                say(f"the error of the resolution is measured without {points} points: {problem}")
    error = critical.resolution_error(scene, bracket, coarser)
    critical.draw(rows, bracket, scene.particle.diameter, out / "critical.png", error)
    print(bracket.words)
    if bracket.velocity is None and (slowest := critical.slowest_rebound(rows)) is not None:
        print(f"slowest rebound: {slowest}")
    if arguments.repeat == 1:
        print("the error (+-) does not include the scatter between placements: to measure it, use --repeat 3")
    print(resolution := critical.resolution_words(scene, bracket, coarser))
    if coarser:
        write_rows(out / critical.TABLE, critical.COLUMNS, rows, f"{about}\n{bracket.words}\n{resolution}")
    print(critical.verdict_words(bracket, plan(scene).impact.formula))
    if not arguments.quiet:
        print(f"table in {out / critical.TABLE}\nfigure in {out / 'critical.png'}")
    return 0
