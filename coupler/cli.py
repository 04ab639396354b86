"""The command `coldspray`. Heavy packages are imported where used, so that --help answers at once."""

import argparse
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import ColdsprayError

if TYPE_CHECKING:
    from .progress import Progress

# shared library that a wheel expects from the system -> Debian package
_PACKAGES = {
    "libGLU.so.1": "libglu1-mesa",
    "libXft.so.2": "libxft2",
    "libXcursor.so.1": "libxcursor1",
    "libXinerama.so.1": "libxinerama1",
    "libXrender.so.1": "libxrender1",
    "libXext.so.6": "libxext6",
    "libXfixes.so.3": "libxfixes3",
    "libfontconfig.so.1": "libfontconfig1",
    "libgomp.so.1": "libgomp1",
    "libX11.so.6": "libx11-6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
}
_INTERRUPTED = 130  # as shells do for SIGINT
_BROKEN_PIPE = 141


def main(argv: list[str] | None = None) -> int:
    """Run the command line. argv: arguments without the program's name. Returns the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        code = arguments.command(arguments)
        sys.stdout.flush()
        return code
    except ColdsprayError as error:
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:
        # the reader went away (`| head`): also keep the interpreter from flushing into it at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except KeyboardInterrupt:
        return _fail("stopped", _INTERRUPTED)
    except (OSError, ImportError) as error:
        message = missing_library(error) or _file_problem(error)
        if message is None:
            raise
        return _fail(message, 2)


def missing_library(error: Exception) -> str | None:
    """What to install when an import lacked a shared library; None if that is not what happened."""
    match = re.match(r"(\S+\.so[.\d]*): cannot open shared object file", str(error))
    if match is None:
        return None
    library = match.group(1)
    if library in _PACKAGES:
        return f"the system library {library} is missing: apt-get install {_PACKAGES[library]}"
    return f"the library {library} is missing: set the environment up again with `make setup`"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="coldspray", description="Cold spray impacts: SPH particle, FE target.")
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    check = commands.add_parser("check", help="print what a scene would compute, and its cost; run nothing")
    check.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    check.set_defaults(command=_check)
    run = commands.add_parser("run", help="compute a scene")
    run.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    run.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default: runs/<scene name>)")
    run.add_argument("--force", action="store_true", help="overwrite a finished run")
    run.add_argument("--quiet", action="store_true", help="print errors only")
    run.set_defaults(command=_run)
    return parser


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        from importlib.metadata import version

        print(f"coldspray {version('coldspray')}")
        parser.exit()


def _check(arguments: argparse.Namespace) -> int:
    from .plan import describe, plan
    from .scene import Scene

    print(describe(plan(Scene.load(arguments.scene))))
    return 0


def _run(arguments: argparse.Namespace) -> int:
    from .progress import Progress
    from .scene import Scene

    scene = Scene.load(arguments.scene)
    out = arguments.out or Path("runs") / scene.name
    progress = Progress(quiet=arguments.quiet)
    try:
        from .deposition import run

        result = run(scene, out=out, force=arguments.force, progress=progress)
    except KeyboardInterrupt:
        return _fail(_stopped(progress, out), _INTERRUPTED)
    finally:
        progress.stop()
    if not arguments.quiet:
        from rich.console import Console

        from .report import summary_table

        Console().print(summary_table(result))
        print(f"results in {out}")
    return 0


def _stopped(progress: "Progress", out: Path) -> str:
    if progress.time != progress.time:  # nan
        return "stopped before the first step"
    return f"stopped at t = {progress.time * 1e9:.1f} ns, files in {out} are readable"


def _file_problem(error: Exception) -> str | None:
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return None


def _fail(message: str, code: int) -> int:
    try:
        print(f"coldspray: {message}", file=sys.stderr)
    except BrokenPipeError:
        return _BROKEN_PIPE
    return code
