"""The command `coldspray watch`: it shows the state of a running computation, which it reads from the files of the run."""

import argparse
import time
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import StoreError
from ..files.inputs import last_lines, reading
from ..files.outputs import claim_file
from .arguments import Commands, add_command, add_force, path, seconds

if TYPE_CHECKING:
    from ..files.result import Result

SILENT = 60.0  # s without a change of its files, after which a run has possibly been stopped
_LEDGER = ("kinetic", "elastic", "plastic", "numerical", "contact", "friction", "boundary", "bodies", "bond")


def add(commands: Commands) -> None:
    text = "show measures, energies and remaining time of a run in progress; writes nothing into its folder"
    option = add_command(commands, "watch", run, text)
    option("run", type=path, metavar="DIR", help="folder of a run")
    option("--every", type=seconds, default=5.0, metavar="SECONDS", help="time between two updates, s (default: 5)")
    option("--picture", type=path, metavar="FILE", help=".png file for the cross-section, updated at each stored step")
    option("--once", action="store_true", help="show the state once, then end")
    add_force(option)


def run(arguments: argparse.Namespace) -> int:
    """Show a run until it is finished. Returns the exit code. Raises ColdsprayError for an error of the user."""
    from rich.console import Console
    from rich.live import Live

    from ..files.result import Result
    from ..report import screen, section_picture

    if arguments.picture is not None:
        claim_file(arguments.picture, (".png",), [arguments.run], arguments.force)
    console, drawn = Console(highlight=False, markup=False), 0
    with Live(console=console, auto_refresh=False, transient=True) as live:
        while not (result := Result(arguments.run)).finished:
            with reading(arguments.run):
                text = state(result)
                if (result.directory / "history.csv").is_file():
                    text += _coating(arguments.run, int(result.history("impact")[-1:].sum()))
                steps = min(len(result.times(domain)) for domain in ("particle", "surface", "target"))
                if arguments.picture is not None and steps > drawn:
                    section_picture(result, arguments.picture)
                    drawn = steps
            if arguments.once or not console.is_terminal:
                console.print(text)
            else:
                live.update(text, refresh=True)
            if arguments.once:
                return 0
            time.sleep(min(arguments.every, 86400.0))
    if arguments.picture is not None:
        section_picture(result, arguments.picture)
    print(screen(result))
    return 0


@lru_cache(maxsize=1)
def _coating(run: Path, impact: int) -> str:
    """A line break and a text line about the coating before an impact; "" before the second impact. The text is cached, because the
    coating changes only between impacts."""
    from ..files.result import Result
    from ..studies.coating import growth_line, latest

    with suppress(StoreError):  # no fields after the first splat yet
        return f"\n  coating {growth_line(latest(Result(run)))}" if impact > 1 else ""
    return ""


def _written(path: Path) -> float:
    """Time of the last change of a file; 0 if the file does not exist any more, such as an old checkpoint."""
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def state(result: "Result") -> str:
    """Text: last line of the log, last row of the history, and the terms of the energy balance divided by the kinetic energy at the
    start of the impact."""
    from ..report.words import last_row

    history = result.history() if (result.directory / "history.csv").is_file() else {}
    lines = [last_lines(result.directory / "run.log")]
    age = time.time() - max(map(_written, result.directory.iterdir()), default=time.time())
    if age > SILENT:
        remedy = f"if the run was stopped, coldspray resume {result.directory} continues it"
        lines.append(f"no new data for {age:.0f} s: {remedy}")
    if not len(history.get("time", ())):
        return "\n".join([*lines, "no time step is written yet"])
    lines += [f"  {label:30} {value} {unit}" for label, value, unit in last_row(history)]
    of_impact = history["impact"] == history["impact"][-1]
    whole = history["kinetic_particle"][of_impact][0]
    parts = {}  # energy of each term, from one column or from a column for each domain
    for name in _LEDGER:
        columns = [name] if name in history else [column for column in history if column.startswith(f"{name}_")]
        parts[name] = sum(history[column][-1] for column in columns)
    lines.append("  energy, % of the particle's initial kinetic energy: " + ", ".join(
        f"{name} {100.0 * value / whole:.3g}" for name, value in parts.items() if abs(value) > 1e-4 * whole))  # fmt: skip
    return "\n".join(lines)
