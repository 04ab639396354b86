"""The command `coldspray critical`: the critical velocity of a scene, bracketed by runs."""

import argparse
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..measures import REBOUNDS, STICKS, UNDECIDED
from .arguments import Commands, add_command, add_force, add_quiet, add_scene, at_least_one, path, quantity, scene_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..studies.critical import Bracket

_NAMES = ("scene.toml", "critical.csv", "critical.png")
_LIMITS = "10 m/s", "2000 m/s"  # those of a scene's particle
_MOST_PLACEMENTS = 100
_MARKERS = {STICKS: "o", REBOUNDS: "v", UNDECIDED: "s"}


def add(commands: Commands) -> None:
    """Add the command to a parser's subcommands."""
    option = add_command(
        commands, "critical", run, "bracket the velocity from which a particle with cohesive bonds sticks"
    )
    add_scene(option)
    option(
        "--out",
        type=path,
        metavar="DIR",
        help="folder of runs, table and picture (default: runs/critical-<scene name>)",
    )
    option("--within", default="5%", metavar="PERCENT", help='width of the bracket over its middle (default: "5%%")')
    for name, text in (("low", "lowest"), ("high", "highest")):
        option(f"--{name}", type=quantity(f"--{name}", "velocity", limits=_LIMITS), metavar="VELOCITY",
               help=f'{text} velocity to compute, such as "300 m/s"')  # fmt: skip
    option("--repeat", type=partial(at_least_one, most=_MOST_PLACEMENTS), default=3, metavar="N",
           help="placements at each velocity, by which points and elements lie otherwise (default: 3)")  # fmt: skip
    option("--jobs", type=at_least_one, default=1, metavar="N", help="runs at a time, each on one core (default: 1)")
    add_force(option)
    add_quiet(option)


def run(arguments: argparse.Namespace) -> int:
    """Search the critical velocity of a scene, or continue it, and draw. Returns the exit code."""
    from ..errors import StoreError
    from ..files.outputs import claim_folder
    from ..studies import critical
    from ..studies.table import StudyTable
    from .accuracy import same_scene, share

    scene = scene_of(arguments)
    critical.check(scene)
    tolerance = share(arguments.within, "--within")
    limits = arguments.low or critical.LOWEST, arguments.high or critical.HIGHEST
    if not limits[0] < limits[1]:
        raise StoreError(f"--low {limits[0]:g} m/s must be less than --high {limits[1]:g} m/s")
    out = arguments.out or Path("runs") / f"critical-{scene.name}"
    claim_folder(out, "critical", _NAMES, [arguments.scene], arguments.force)
    same_scene(scene, out)

    def say(text: str) -> None:
        if not arguments.quiet:
            print(text, file=sys.stderr, flush=True)

    table = StudyTable(
        out / "critical.csv",
        critical.COLUMNS,
        critical.KEY,
        f"remake: coldspray critical {shlex.join(_given(arguments, out))} (runs in this table are not computed again)",
    )
    critical.check_rows(table.path, table.rows)
    try:
        bracket = critical.search(scene, out / "runs", table, limits, tolerance, say, arguments.repeat, arguments.jobs)
    except KeyboardInterrupt:
        say(f"stopped; go on with the same command: {table.path} has {len(table.rows)} runs")
        raise
    table.write()  # with the options of this call, also where it has computed nothing
    draw(critical.sorted_rows(table.rows), bracket, scene.particle.diameter, out / "critical.png")
    print(bracket.words)
    if bracket.velocity is None and (slowest := critical.slowest_rebound(table.rows)) is not None:
        print(f"nearest to sticking: {slowest}")
    if arguments.repeat == 1:
        print("one placement at each velocity: that its verdict may be chance is not in the band (--repeat 3)")
    print(critical.resolution_words(scene))
    print(critical.verdict_words(bracket, critical.formula_of(scene)))
    if not arguments.quiet:
        print(f"table in {table.path}\nfigure in {out / 'critical.png'}")
    return 0


def _given(arguments: argparse.Namespace, out: Path) -> list[str]:
    """The scene and the options of a search that decide its runs."""
    options = [f"--set={key}={'' if value is None else value}" for key, value in arguments.settings]
    options += [f"--preset={arguments.preset}"] if arguments.preset is not None else []
    options += [
        f"--{name}={value:.10g} m/s" for name in ("low", "high") if (value := getattr(arguments, name)) is not None
    ]
    return [
        str(arguments.scene),
        f"--out={out}",
        f"--within={arguments.within}",
        f"--repeat={arguments.repeat}",
        *options,
    ]


def draw(rows: "Sequence[Mapping[str, str]]", bracket: "Bracket", diameter: float, picture: Path) -> None:
    """Figure over velocity: restitution, bonded area over the cross section of the particle (diameter, m), and with several placements
    the share that sticks; markers by verdict, lines through the means."""
    import math
    from itertools import groupby

    from ..report.picture import blank, save

    figure = blank(10.0 + 4.0 * bool(bracket.shares), 4.0, dpi=130, layout="constrained")
    left, right, *more = figure.subplots(1, 3 if bracket.shares else 2)
    section = 0.25 * math.pi * diameter**2
    for at, key, factor, colour, label in (
        (left, "restitution", 1.0, "k", "rebound velocity / impact velocity"),
        (right, "bonded_area_m2", 1.0 / section, "0.6", "that bonded"),
        (right, "bonded_area_end_m2", 1.0 / section, "k", "left at the end"),
    ):
        points = [
            (float(row["velocity_m_s"]), factor * float(row[key]), row["verdict_by_bonds"]) for row in rows if row[key]
        ]
        levels = [(v, [y for _, y, _ in own]) for v, own in groupby(points, key=lambda point: point[0])]
        at.plot([v for v, _ in levels], [sum(y) / len(y) for _, y in levels], color=colour, linewidth=0.8)
        for verdict, marker in _MARKERS.items():
            own = [(v, y) for v, y, word in points if word == verdict]
            if own:
                at.scatter(*zip(*own, strict=True), marker=marker, color=colour, s=24, zorder=3,
                           label=verdict if at is left else f"{label}, {verdict}")  # fmt: skip
        at.set_ylim(bottom=0.0)
        at.set_xlabel("impact velocity in m/s")
    left.set_ylabel("coefficient of restitution")
    right.set_ylabel("bonded area / cross section")
    for at in more:
        at.plot(*zip(*sorted(bracket.shares.items()), strict=True), "ko-", markersize=4, linewidth=0.8)
        at.axhline(0.5, color="0.6", linewidth=0.8, linestyle="--")
        at.set_ylim(-0.05, 1.05)
        at.set_xlabel("impact velocity in m/s")
        at.set_ylabel("share of the placements that stick")
    low, high = bracket.band
    for at in (left, right, *more):
        if bracket.velocity is not None:
            at.axvspan(low or at.get_xlim()[0], high or at.get_xlim()[1], color="#d55e00", alpha=0.25, linewidth=0.0)
        if at.get_legend_handles_labels()[0]:
            at.legend(fontsize=7)
    figure.suptitle(bracket.words, fontsize=9)
    save(figure, picture)
