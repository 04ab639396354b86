"""The command `coldspray properties`: effective stiffness and conductivities of a cold coating."""

import argparse
from typing import TYPE_CHECKING, Any

from ..files.inputs import reading
from . import arguments as options
from .arguments import Commands

if TYPE_CHECKING:
    from rich.table import Table

    from ..properties.measure import Properties
    from ..studies.coating import SeedError

NAMES = ("properties.json", "properties.csv")


def add(commands: Commands) -> None:
    """Add the command to a parser's subcommands."""
    text = "compute Young's modulus and the thermal and electrical conductivity of a cold coating"
    option = options.add_command(commands, "properties", run, text)
    option("runs", type=options.path, nargs="+", metavar="DIR",
           help="folder of a run with a cold coating; several folders, with different seeds, give the error of the mean")  # fmt: skip
    option("--out", type=options.path, metavar="DIR", help="output folder (default: properties in the first run)")
    option("--side", type=options.quantity("--side", "length"), metavar="L",
           help="horizontal edge length of the block (default: the square in the disc that `coating` measures)")  # fmt: skip
    option("--heights", type=options.quantity("--heights", "length"), nargs=2, metavar=("LOW", "HIGH"),
           help="lowest and highest z of the block (default: above 99 %% of the substrate, below 90 %% of the tops)")  # fmt: skip
    option("--conductance", type=options.quantity("--conductance", "heat transfer"), metavar="H",
           help='thermal conductance of facets that touch without a bond, such as "5e7 W/(m2 K)" (default: 1.5e7'
           ' and 5.5e8)')  # fmt: skip
    options.add_force(option)


def run(arguments: argparse.Namespace) -> int:
    """Execute the command. Returns the exit code. Raises ColdsprayError for an error that the user can correct."""
    import json
    import shutil
    from dataclasses import asdict

    from rich.console import Console

    from ..files.outputs import claim_folder, write_text
    from ..files.result import Result
    from ..properties.measure import of_seeds
    from ..studies.table import write_rows

    folder = arguments.out or arguments.runs[0] / "properties"
    claim_folder(folder, "properties", NAMES, arguments.runs, arguments.force)
    found: dict[str, Properties] = {}
    for path in arguments.runs:
        with reading(path), options.working(f"computing the properties of {path}"):
            heights = None if arguments.heights is None else tuple(arguments.heights)
            asked = {"side": arguments.side, "heights": heights, "conductance": arguments.conductance}
            found[str(path)] = Result(path).properties(**asked)
    seeds = of_seeds(list(found.values()))
    whole = {
        "runs": {name: asdict(each) for name, each in found.items()},
        "seeds": {k: vars(v) for k, v in seeds.items()},
    }
    write_text(folder / NAMES[0], json.dumps(whole, indent=2) + "\n")
    rows: list[dict[str, Any]] = [
        {"run": name, "property": key, **vars(value)}
        for name, each in found.items()
        for key, value in each.values.items()
    ]
    write_rows(folder / NAMES[1], list(rows[0]), rows, options.remake(arguments))
    console = Console(width=shutil.get_terminal_size((120, 30)).columns, highlight=False)
    for name, each in found.items():
        console.print(_head(name, each), table(each, seeds), sep="\n")
    print(f"{', '.join(NAMES)} in {folder}")
    return 0


def _head(name: str, of: "Properties") -> str:
    size = f"{1e6 * of.side_m:.0f} x {1e6 * of.side_m:.0f} x {1e6 * of.height_m:.0f} um"
    lines = [
        f"{name}: block of {size}, {of.splats:.0f} splats, {of.elements} elements; {of.solid:.1%} metal, {of.open_share:.0%} of"
        f" its top open; {of.bonded:.0%} of the joints bonded; gaps that count as metal: {of.gap:.1%}",
        *(f"warning: {text}" for text in of.warnings),
    ]
    return "\n".join(lines)


def table(of: "Properties", seeds: "dict[str, SeedError]") -> "Table":
    """The properties in percent of the values of the bulk metal, with their error if there are several runs."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from ..properties.measure import KINDS
    from ..report.words import with_error

    shown = Table(box=SIMPLE_HEAD, pad_edge=False)
    heads = ("% of the bulk value", "bulk", "kinematic", "mixed", "static", "error", "of size")
    for text in (*heads, *(["mean of runs"] if seeds else [])):
        shown.add_column(text, justify="left" if text == heads[0] else "right")
    for key, value in of.values.items():
        kind, _, where = key.partition("_")
        label, _, factor, unit = KINDS[kind]
        percent = 100.0 / value.bulk
        columns = (value.kinematic, value.mixed, value.static, value.error, value.size)
        cells = ["-" if x is None else f"{percent * x:.1f}" for x in columns]
        if key in seeds:
            cells.append(with_error(percent * seeds[key].mean, percent * seeds[key].error))
        shown.add_row(f"{label}, {where.replace('_', ' ')}", f"{factor * value.bulk:.4g} {unit}", *cells)
    return shown
