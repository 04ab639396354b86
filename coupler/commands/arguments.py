"""Values of command-line options, checked where they are read."""

import argparse
import math
from pathlib import Path
from typing import TypeAlias

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"  # what a command is added to


def path(text: str) -> Path:
    """A path; an empty one is refused, because it would mean the current folder."""
    if not text.strip() or "\0" in text:
        raise argparse.ArgumentTypeError("the name is empty or has a null character; give '.' for the current folder")
    return Path(text)


def seconds(text: str) -> float:
    """A positive, finite number of seconds."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds above zero")
    return value


def simulated_time(text: str) -> float:
    """A positive simulated time with its unit, in s, for argparse. Raises ArgumentTypeError."""
    from ..units import parse

    try:
        value = parse(text, "time")
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be positive")
    return value


def add_force(parser: argparse.ArgumentParser) -> None:
    """The option that lets a command replace files that this program did not write."""
    parser.add_argument("--force", action="store_true", help="replace a file that coldspray did not write")
