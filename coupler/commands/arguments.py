"""Options that several commands share, and the types of their values."""

import argparse
import contextlib
import math
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from ..core.process import cores
from ..errors import ColdsprayError, StoreError
from ..files.outputs import claim_folder, keep_toml
from ..units import UnitError, parse

if TYPE_CHECKING:
    from ..plan.reading import Scene
    from ..progress import Progress

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # the subcommands of a parser
Option: TypeAlias = Callable[..., argparse.Action]  # `add_argument` of a command


def path(text: str) -> Path:
    """Option type: a path. An empty text is refused, because it would mean the current folder."""
    if not text.strip() or "\0" in text:
        raise argparse.ArgumentTypeError("the path is empty or has a null character; give '.' for the current folder")
    return Path(text)


def seconds(text: str) -> float:
    """Option type: a positive, finite number of seconds."""
    with contextlib.suppress(ValueError):
        if 0.0 < (value := float(text)) < math.inf:
            return value
    raise argparse.ArgumentTypeError(f"{text!r} is not a positive number of seconds: give a number such as 5")


def quantity(
    option: str, dimension: str, positive: bool = True, form: str = "{}", limits: tuple[str, str] | None = None
) -> Callable[[str], float]:
    """Make the option type for a text with a unit, such as "300 ns". The type returns an SI value, and raises ColdsprayError.
    positive: zero and negative values are refused; form: format string that completes the text, such as "1 {}" for a text that is
    only a unit; limits: smallest and largest allowed value, as text."""

    def read(text: str) -> float:
        try:
            value = parse(form.format(text), dimension)
        except UnitError as error:
            raise ColdsprayError(f"{option} {text}: {error}") from None
        if positive and not value > 0.0:
            raise ColdsprayError(f"{option} {text}: the value must be above zero")
        if limits is not None and not parse(limits[0], dimension) <= value <= parse(limits[1], dimension):
            raise ColdsprayError(f"{option} {text}: the value must be between {limits[0]} and {limits[1]}")
        return value

    return read


def add_command(commands: Commands, name: str, run: Callable[[argparse.Namespace], int], text: str) -> Option:
    """Add a command to the parser. run: function that executes it; text: its help line. Returns the function that adds arguments to
    it."""
    parser = commands.add_parser(name, help=text)
    parser.set_defaults(command=run)
    return parser.add_argument


def add_scene(option: Option) -> None:
    """Add the argument and the options of a command that reads a scene; `scene_of` evaluates them."""
    option("scene", type=path, metavar="SCENE", help="scene file (TOML)")
    option("--set", type=_setting, action="append", default=[], dest="settings", metavar="KEY=VALUE",
           help="change a key of the scene (may be repeated): particle.velocity='600 m/s', contact.friction=0.3,"
           " 'particle[2].material=Ti'; KEY= removes the key")  # fmt: skip
    text = "draft, standard or fine: replaces preset, spacing and element_size of the scene"
    option("--preset", metavar="NAME", help=text)


def add_study(commands: Commands, verb: str, run: Callable[[argparse.Namespace], int], text: str) -> Option:
    """Add a command that computes a scene many times; `study_folder` makes its folder. verb: name of the command. Other arguments and
    result: as in `add_command`."""
    option = add_command(commands, verb, run, text)
    add_scene(option)
    option("--out", type=path, metavar="DIR",
           help=f"folder of runs, table and figures (default: runs/{verb}-<scene name>)")  # fmt: skip
    add_force(option)
    add_quiet(option)
    return option


def scene_of(arguments: argparse.Namespace) -> "Scene":
    """The scene of a command, with the changes by its options. Raises SceneError with all problems."""
    from ..plan.reading import Scene

    settings = list(arguments.settings)
    if arguments.preset is not None:
        finer = ("resolution.spacing", "resolution.element_size")
        settings = [("preset", arguments.preset), *((key, None) for key in finer), *settings]
    return Scene.load(arguments.scene, settings)


def _setting(text: str) -> tuple[str, str | None]:
    """Option type of `--set`: a key and its value; None if the value is empty."""
    key, sign, value = text.partition("=")
    if not sign:
        form = "KEY=VALUE, such as particle.velocity='600 m/s'"
        raise argparse.ArgumentTypeError(f"{text!r} has no '=': expected {form}")
    return key.strip(), value.strip() or None


def at_least_one(text: str, most: int | None = None) -> int:
    """Option type: a whole number, at least 1 and at most `most`. None: no upper limit."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    if most is not None and int(text) > most:
        raise argparse.ArgumentTypeError(f"{text} is too large: the largest allowed number is {most}")
    return int(text)


def add_jobs(option: Option, text: str) -> None:
    """Add the option --jobs; `jobs_of` evaluates it. text: help text."""
    option("--jobs", type=at_least_one, metavar="N", help=f"{text} (default: all cores that this process may use)")


def jobs_of(arguments: argparse.Namespace) -> int:
    """Number of simultaneous computations: --jobs, by default the number of cores."""
    return arguments.jobs or cores()


def share(text: str, option: str) -> float:
    """Convert a percentage such as "2%" to a number above 0 and up to 1. option: name of the option, for the message. Raises StoreError
    for other text."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*%\s*", text)
    if match is None or not 0.0 < float(match.group(1)) <= 100.0:
        raise StoreError(f'{option} {text!r} is not valid: give a percentage above 0 and up to 100, such as "2%"')
    return float(match.group(1)) / 100.0


def study_folder(arguments: argparse.Namespace, scene: "Scene", verb: str, names: tuple[str, ...]) -> Path:
    """Make the folder of a study (--out, or runs/<verb>-<scene name>) and write the scene into it. Returns the folder. names:
    patterns of the files that it may replace. Raises StoreError if the folder holds other results or the study of another scene."""
    out: Path = arguments.out or Path("runs") / f"{verb}-{scene.name}"
    claim_folder(out, verb, names, [arguments.scene], arguments.force)
    keep_toml(out / "scene.toml", scene.to_toml(), "study")
    return out


def remake(arguments: argparse.Namespace) -> str:
    """Text for the head of a table: "remake: coldspray ", followed by the words of this command line."""
    return f"remake: coldspray {shlex.join(arguments.words)}"


def teller(quiet: bool, to: str = "stderr") -> Callable[[str], None]:
    """Return a function that prints a line to sys.stdout or sys.stderr (`to`). With `quiet` the function does nothing."""
    return lambda text: None if quiet else print(text, file=vars(sys)[to], flush=True)


def add_quiet(option: Option) -> None:
    """Add the option --quiet."""
    option("-q", "--quiet", action="store_true", help="print errors only")


@contextmanager
def working(text: str, quiet: bool = False) -> "Iterator[Progress]":
    """Context manager that shows the present work and its duration. text: name of the work; quiet: show nothing."""
    from ..progress import Progress

    with Progress(quiet) as progress:
        progress.stage(text)
        yield progress


@contextmanager
def continuing(out: Path, say: Callable[[str], None]) -> Iterator[None]:
    """Context manager for a study in the folder `out`. On an interrupt it prints that the same command continues the study. say:
    function that prints a line."""
    try:
        yield
    except KeyboardInterrupt:
        say(f"stopped; the same command continues the computation in {out}")
        raise


def add_force(option: Option) -> None:
    """Add the option --force of a command that writes files."""
    option("--force", action="store_true", help="replace a file that coldspray did not write")
