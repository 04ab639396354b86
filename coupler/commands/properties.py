"""The command `coldspray properties`: effective stiffness, conductivities and strength of a cold coating, and a coated strip."""

import argparse
import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ..files.inputs import reading
from ..files.outputs import claim_folder, write_text
from ..measures import PROPERTIES
from ..studies.table import write_rows
from . import arguments as options
from .arguments import Commands

if TYPE_CHECKING:
    from rich.table import Table

    from ..properties.measure import Properties
    from ..studies.coating import SeedError

NAMES = ("properties.json", "properties.csv")
ALMEN = 31.75e-3  # m: distance of the feet of an Almen gauge


def add(commands: Commands) -> None:
    text = (
        "compute Young's modulus, thermal and electrical conductivity, strength and strip curvature of a cold coating"
    )
    option = options.add_command(commands, "properties", run, text)
    option("runs", type=options.path, nargs="+", metavar="DIR",
           help="folder of a run with a cold coating; several folders, with different seeds, give the error of the mean")  # fmt: skip
    option("--out", type=options.path, metavar="DIR", help="output folder (default: properties in the first run)")
    option("--side", type=options.quantity("--side", "length"), metavar="L",
           help="horizontal edge length of the block (default: the square in the disc that `coating` measures)")  # fmt: skip
    option("--heights", type=options.quantity("--heights", "length"), nargs=2, metavar=("LOW", "HIGH"),
           help="lowest, highest z of the block (default: above 99 %% of the substrate, below 90 %% of the coating's top)")  # fmt: skip
    option("--conductance", type=options.quantity("--conductance", "heat transfer"), metavar="H",
           help='thermal conductance of facets that touch without a bond, such as "5e7 W/(m2 K)" (default: 1.5e7'
           ' and 5.5e8)')  # fmt: skip
    option("--pull", action="store_true",
           help="pull the block of the first run until it breaks: across, at the substrate, in the plane (minutes)")  # fmt: skip
    option("--strip", type=options.quantity("--strip", "length"), metavar="H",
           help="compute a strip of this thickness with the coating of the first run: curvature, stresses, CalculiX file")  # fmt: skip
    option("--length", type=options.quantity("--length", "length"), metavar="L", default=ALMEN,
           help="length over which the strip's deflection is measured (default: 31.75 mm, as an Almen gauge)")  # fmt: skip
    option("--sprayed-at", type=options.quantity("--sprayed-at", "temperature"), metavar="T",
           help="temperature of strip and coating during spraying, before they cool (default: cooling as in the run)")  # fmt: skip
    options.add_force(option)


def run(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from ..files.result import Result
    from ..properties import pull, strip
    from ..properties.measure import of_seeds

    folder, first = arguments.out or arguments.runs[0] / "properties", Result(arguments.runs[0])
    names = [*NAMES, *pull.NAMES * arguments.pull, *strip.NAMES * (arguments.strip is not None)]
    claim_folder(folder, "properties", names, arguments.runs, arguments.force)
    found: dict[str, Properties] = {}
    heights = None if arguments.heights is None else tuple(arguments.heights)
    of_block = {"side": arguments.side, "heights": heights}
    for path in arguments.runs:
        with reading(path), options.working(f"computing the properties of {path}"):
            found[str(path)] = Result(path).properties(**of_block, conductance=arguments.conductance)
    seeds, about = of_seeds(list(found.values())), options.remake(arguments)
    whole: dict[str, Any] = {
        "runs": {name: asdict(each) for name, each in found.items()},
        "seeds": {k: vars(v) for k, v in seeds.items()},
    }
    rows: list[dict[str, Any]] = [
        {"run": name, "property": key, **vars(value)}
        for name, each in found.items()
        for key, value in each.values.items()
    ]
    write_rows(folder / NAMES[1], list(rows[0]), rows, about)
    write_text(folder / NAMES[0], json.dumps(whole, indent=2) + "\n")  # pulls may fail
    console = Console(width=shutil.get_terminal_size((120, 30)).columns, highlight=False)
    for name, each in found.items():
        console.print(_head(name, each), table(each, seeds), sep="\n")
    with reading(first.directory), options.working("pulling the block apart, or bending the strip"):
        if arguments.pull:
            pulls = pull.strengths(first, **of_block)
            pull.write_pulls(folder, pulls, about)
            whole["pull"] = [{k: v for k, v in vars(p).items() if k not in ("rows", "opened")} for p in pulls]
        if arguments.strip is not None:
            coated = strip.strip_of(first, next(iter(found.values())), arguments.strip, arguments.sprayed_at)
            strip.write(coated, arguments.length, folder, about)
            whole["strip"] = coated.values(arguments.length)
    print(*_lines(whole.get("pull", []), whole.get("strip")), sep="\n")
    write_text(folder / NAMES[0], json.dumps(whole, indent=2) + "\n")
    print(f"{', '.join(names)} in {folder}")
    return 0


def _lines(pulls: list[dict[str, Any]], strip: dict[str, float] | None) -> Iterator[str]:
    """Text lines about the pull tests and the bent coated strip (None: no strip), both from properties.json."""
    from ..properties.pull import WORDS

    for direction, words in WORDS.items() if pulls else ():
        central, *others = [p for p in pulls if p["direction"] == direction]
        ends = " to ".join(f"{1e-6 * value:.0f}" for value in sorted(p["strength_Pa"] for p in others))
        yield (
            f"strength {words}: {1e-6 * central['strength_Pa']:.0f} MPa{f' ({ends} with thinner and thicker films)' if ends else ''} at"
            f" {central['strain']:.2%} strain; bonds absorb {central['brittle']:.0%} of the work"
        )
    if pulls and pulls[0]["film"] is None:
        yield "warning: bonds of this run never break: plastic flow between the pores limits the strengths"
    if strip is not None:
        yield (
            f"strip of {1e3 * strip['thickness_m']:.3g} mm, coating {1e6 * strip['coating_m']:.0f} um, initial stress"
            f" {1e-6 * strip['arriving_Pa']:+.0f} MPa: curvature {strip['deposited_1_m']:+.3g} 1/m by deposition,"
            f" {strip['misfit_1_m']:+.3g} 1/m by misfit; deflection {1e6 * strip['deflection_m']:+.1f} um over"
            f" {1e3 * strip['length_m']:.4g} mm (positive: the coated side is convex)"
        )


def _head(name: str, of: "Properties") -> str:
    size = f"{1e6 * of.side_m:.0f} x {1e6 * of.side_m:.0f} x {1e6 * of.height_m:.0f} um"
    lines = [
        f"{name}: block of {size}, {of.splats:.0f} splats, {of.elements} elements; {of.solid:.1%} metal, {of.open_share:.0%} of"
        f" its top above the coating; {of.bonded:.0%} of the joints bonded; gaps counted as metal: {of.gap:.1%}",
        *(f"warning: {text}" for text in of.warnings),
    ]
    return "\n".join(lines)


def table(of: "Properties", seeds: "dict[str, SeedError]") -> "Table":
    """A table of the properties in percent of the bulk value. seeds: mean and error of several runs, by property; empty for one run."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from ..report.words import with_error

    shown = Table(box=SIMPLE_HEAD, pad_edge=False)
    heads = ("% of the bulk value", "bulk", "kinematic", "mixed", "static", "error", "of size")
    for text in (*heads, *(["mean of runs"] if seeds else [])):
        shown.add_column(text, justify="left" if text == heads[0] else "right")
    for key, value in of.values.items():
        kind, _, where = key.partition("_")
        label, _, factor, unit = PROPERTIES[kind]
        percent = 100.0 / value.bulk
        columns = (value.kinematic, value.mixed, value.static, value.error, value.size)
        cells = ["-" if x is None else f"{percent * x:.1f}" for x in columns]
        if key in seeds:
            cells.append(with_error(percent * seeds[key].mean, percent * seeds[key].error))
        shown.add_row(f"{label}, {where.replace('_', ' ')}", f"{factor * value.bulk:.4g} {unit}", *cells)
    return shown
