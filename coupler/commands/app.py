"""The command `coldspray app`: a local web page with forms, runs and results."""

import argparse
import re
from importlib.resources import files
from pathlib import Path

from ..files.outputs import check_folder
from .arguments import Commands, add_command, path


def add(commands: Commands) -> None:
    option = add_command(commands, "app", run, "open a local web page with forms, runs and results")
    option("folder", type=path, nargs="?", default=Path(), metavar="DIR",
           help="folder of the scenes; results are in DIR/runs (default: this folder)")  # fmt: skip
    option("--port", type=_port, default=8501, metavar="N", help="port number; 0: any free port (default: 8501)")
    option("--no-browser", action="store_true", help="print the address without opening a browser")


def run(arguments: argparse.Namespace) -> int:
    """Run the web server until Ctrl-C. Returns the exit code. Raises ColdsprayError for an error that the user can correct."""
    from ..app.server import Workspace, serve
    from .accuracy import here

    check_folder(arguments.folder)
    texts = {kind: files(__package__) / "templates" / f"{kind}.toml" for kind in ("single", "coating", "job")}
    templates = {kind: re.sub("(?m)^#.*\n", "", text.read_text(encoding="utf-8")) for kind, text in texts.items()}
    serve(Workspace(arguments.folder, templates, here()), arguments.port, not arguments.no_browser)
    return 0


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port number: give a whole number from 0 to 65535")
    return int(text)
