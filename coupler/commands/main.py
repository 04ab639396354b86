"""The command `coldspray`. Large packages are imported only inside the functions that use them, so that --help is fast."""

import argparse
import errno
import io
import os
import re
import signal
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from .. import __version__
from ..core.process import interrupted_by, search_cycles_less
from ..errors import ColdsprayError, is_first_rank, is_only_process
from ..files.inputs import bounded_memory, reading
from ..files.outputs import RUN_FILES, check_folder, claim_file, claim_folder, keep_inputs
from ..units import nearest
from . import accuracy, app, coating, critical, gas, job, materials, mesh, new, properties, sweep, track, watch, window
from . import arguments as options
from . import map as maps
from .arguments import Option

if TYPE_CHECKING:
    from ..files.result import Result
    from ..progress import Progress

# shared libraries of the system that wheels need
_SYSTEM = ["GLU", "Xft", "Xcursor", "Xinerama", "Xrender", "Xext", "Xfixes", "fontconfig", "gomp", "X11", "GL", "EGL"]
# optional package -> its extra
_EXTRAS = {"sklearn": "maps", "pandas": "fields", "pyvista": "fields", "nicegui": "app"}
_BROKEN_PIPE = 141
_UNDECIDED = 4  # exit code of a run that ends before its end criterion is met
_NOT_WRITTEN = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EBADF)
_MORE_MEMORY = "use a coarser resolution, a smaller file, or a machine with more memory"
_FURTHER = "continue until there is a verdict: coldspray resume {} --until TIME"


def main(argv: list[str] | None = None) -> int:
    """Execute the command line. argv: arguments without the name of the program. Returns the exit code."""
    _prepare()
    words = sys.argv[1:] if argv is None else argv
    for word in words:
        if re.search("[\udc80-\udcff]", word):  # bytes that are not UTF-8
            return _fail(f"the file name {word!a} is not in UTF-8: rename the file", 2)
    try:
        parser = _parser()
        if not words:
            if is_first_rank():
                parser.print_help()
            return 2
        arguments = parser.parse_args(words)
        arguments.words = words
        # the signals act as Ctrl-C: the runs of a study end, too
        with bounded_memory(), interrupted_by(signal.SIGTERM, signal.SIGHUP):
            code = arguments.command(arguments)
        sys.stdout.flush()
        return code
    except SystemExit:  # from argparse, which has printed its message
        if not _flush():
            return 2
        raise
    except ColdsprayError as error:
        return _fail(str(error), error.exit_code)
    except BrokenPipeError:
        _flush()
        return _BROKEN_PIPE  # the reader has closed the pipe (`| head`)
    except KeyboardInterrupt as interrupt:
        return _fail("stopped", _code(interrupt))
    except MemoryError as error:
        return _fail(f"out of memory{f': {error}' if str(error) else ''}; {_MORE_MEMORY}", 2)
    except (OSError, ImportError) as error:
        message = missing_library(error)
        if message is None and isinstance(error, OSError) and error.filename and error.strerror:
            message = f"{error.filename}: {error.strerror}"
        if message is None and isinstance(error, OSError) and error.errno in _NOT_WRITTEN:
            _flush()
            message = f"the output cannot be written: {error.strerror}"
        if message is None:
            raise
        return _fail(message, 2)


def _code(interrupt: KeyboardInterrupt) -> int:
    """Exit code of a command that a signal has interrupted: 128 plus the number of the signal, as in shells."""
    return 128 + (int(interrupt.args[0]) if interrupt.args else signal.SIGINT)


def _prepare() -> None:
    """Open missing standard streams, show "?" for characters that the terminal lacks, ignore a matplotlib backend for notebooks, and
    let the garbage collector run less often."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:  # closed: else the next file that is opened gets its number
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r"))
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    os.environ.pop("MPLBACKEND", None)
    search_cycles_less()


def _flush() -> bool:
    """Flush the standard streams. Text that cannot be written is lost. Returns whether all text was written."""
    done = True
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            done = False
    return done


def missing_library(error: Exception) -> str | None:
    """The message, with a remedy, for a missing package or shared library; None for other errors."""
    if isinstance(error, ModuleNotFoundError) and error.name and error.name.split(".")[0] != "coupler":
        extra = _EXTRAS.get(error.name.split(".")[0])
        remedy = f"pip install coldspray[{extra}]" if extra else "repeat the installation with `make setup`"
        return f"the Python package {error.name} is missing: {remedy}"
    match = re.match(r"((?:lib)?(\S+)\.so[.]?([.\d]*)): cannot open shared object file", str(error))
    if match is None:
        return None
    library, name, version = match.groups()
    if name in _SYSTEM:  # Debian's names: libxft2, libx11-6
        package = f"lib{name.lower()}{'-' if name[-1].isdigit() else ''}{version}{'-mesa' if name == 'GLU' else ''}"
        return f"the system library {library} is missing: apt-get install {package}"
    return f"the library {library} is missing: repeat the installation with `make setup`"


def _parser() -> argparse.ArgumentParser:
    about = "Simulate cold spray: particles by SPH, target by finite elements."
    parser: argparse.ArgumentParser = _Parser(prog="coldspray", description=about)
    text = "print the version and exit"
    parser.add_argument("--version", action="version", version=f"coldspray {__version__}", help=text)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    text = "print the plan and the cost of a scene without computing it"
    option = options.add_command(commands, "check", _check, text)
    options.add_scene(option)
    text = "print also why each effect is on or off, and the sources of the material data"
    option("-v", "--verbose", action="store_true", help=text)
    option("--recalibrate", action="store_true", help="measure the speed of this machine again")
    option = options.add_command(commands, "run", _run, "compute a scene")
    options.add_scene(option)
    option("--out", type=options.path, metavar="DIR", help="folder of the results (default: runs/<scene name>)")
    option("--force", action="store_true", help="replace a finished run, or other files with the same names")
    accuracy.add_to_run(option)
    _add_running(option)
    option = options.add_command(commands, "report", _report, "write the results of a run as one HTML page")
    option("run", type=options.path, metavar="DIR", help="folder of a run, finished or not")
    option("--out", type=options.path, metavar="FILE", help="file of the page (default: DIR/report.html)")
    options.add_force(option)
    option = options.add_command(
        commands, "animate", _animate, "write an animation of the cross-section through particle and target"
    )
    option("run", type=options.path, metavar="DIR", help="folder of a run, finished or not")
    text = "an .mp4 or .gif file (default: DIR/<field>.mp4; .gif without ffmpeg)"
    option("--out", type=options.path, metavar="FILE", help=text)
    option("--field", default="T", help="field to draw: T, eps_p or von_mises (default: T)")
    option("--fps", type=float, metavar="N", help="pictures per second (default: the animation lasts 4 seconds)")
    options.add_force(option)
    text = "write the fields as .vtu and .pvd files, for tools that do not read time steps of VTKHDF"
    option = options.add_command(commands, "export", _export, text)
    option("run", type=options.path, metavar="DIR", help="folder of a run, finished or not")
    option("--out", type=options.path, metavar="DIR", help="folder of the files (default: DIR/pvd)")
    options.add_force(option)
    option = options.add_command(commands, "compare", _compare, "compare several runs in a table and a picture")
    option("runs", type=options.path, nargs="+", metavar="DIR", help="folders of runs, two or more")
    option("--out", type=options.path, default=Path("comparison.png"), metavar="FILE",
           help="file of the comparison, .png or .html (default: comparison.png)")  # fmt: skip
    options.add_force(option)
    text = "continue a run that is unfinished or undecided"
    option = options.add_command(commands, "resume", _resume, text)
    option("folder", type=options.path, metavar="DIR", help="folder of the run")
    option("--until", type=options.quantity("--until", "time"), metavar="TIME",
           help='new end time of the last impact, such as "300 ns" (default: twice its time limit; required if it met its end'
           " criterion without a verdict)")  # fmt: skip
    _add_running(option)
    studies = accuracy, sweep, maps, critical
    for command in (new, job, app, watch, materials, gas, window, track, mesh, coating, properties, *studies):
        command.add(commands)
    option = options.add_command(commands, "completion", _completion, "print the completion script of a shell")
    option("shell", choices=("bash", "zsh"), help='bash: eval "$(coldspray completion bash)" in ~/.bashrc')
    return parser


def _add_running(option: Option) -> None:
    options.add_quiet(option)
    text = "print all measures, not only those that converge with the resolution"
    option("-v", "--verbose", action="store_true", help=text)
    option("--threads", type=options.at_least_one, metavar="N",
           help="threads that share the work (default: by cores and number of points)")  # fmt: skip
    options.add_jobs(option, "number of simultaneous impacts, on shared threads; `check` prints the largest number")
    option("--checkpoint", type=options.seconds, default=60.0, metavar="SECONDS",
           help="wall time between two checkpoints, s (default: 60)")  # fmt: skip
    option("--skip-failed", action="store_true", help="in a scene with several impacts, leave out an impact that fails")
    option("--no-error", action="store_true", help="compute no coarser runs, so that the error is not measured")


class _Parser(argparse.ArgumentParser):
    """Argument parser whose errors are printed only by the first MPI rank."""

    def error(self, message: str) -> NoReturn:
        if not is_first_rank():
            self.exit(2)
        choice = r"argument COMMAND: invalid choice: '(.*)' \(choose from (.*)\)"
        if unknown := re.fullmatch(choice, message, re.DOTALL):
            hint = nearest(unknown[1], re.findall(r"[\w-]+", unknown[2]))
            self.exit(2, f"coldspray: there is no command {unknown[1]!r}{hint}; coldspray --help lists all commands\n")
        super().error(message)


def _check(arguments: argparse.Namespace) -> int:
    from ..plan.planning import plan
    from ..plan.text import describe
    from ..studies import pace

    planned, here = plan(options.scene_of(arguments)), accuracy.here(arguments.recalibrate)
    print(describe(planned, pace.lines(planned, here, arguments.verbose), brief=not arguments.verbose))
    return 0


def _run(arguments: argparse.Namespace) -> int:
    scene = options.scene_of(arguments)
    out = arguments.out or Path("runs") / scene.name
    check_folder(out)
    keep_inputs(out, RUN_FILES, [arguments.scene])
    if arguments.within or arguments.accuracy:
        scene, remark = accuracy.chosen(scene, arguments.within, arguments.accuracy)
        if not arguments.quiet and is_first_rank():
            print(remark)

    from ..geometry import apart

    if is_only_process():
        apart.begin()  # gmsh loads meanwhile
    from ..deposition.run import run

    error = not arguments.no_error and scene.resolution.error is not False
    computed = partial(run, scene, out=out, force=arguments.force, skip_failed=arguments.skip_failed, error=error)
    code = _compute(arguments, out, computed)
    if arguments.spread and code in (0, _UNDECIDED) and is_first_rank():
        accuracy.spread_of(arguments.spread, scene, out, options.jobs_of(arguments), arguments.quiet)
    return code


def _resume(arguments: argparse.Namespace) -> int:
    from ..deposition.run import resume
    from ..files.result import Result

    if arguments.until is None and (result := Result(arguments.folder)).at_own_end:
        resume(arguments.folder, quiet=True)  # completes missing files
        if is_first_rank():
            end = f"the run has met its end criterion ({result.end['time_s'] * 1e9:.4g} ns)"
            text = f"{end}, and its verdict is undecided; {_FURTHER.format(arguments.folder)}"
            print(text, file=sys.stderr if arguments.quiet else sys.stdout)
        return 0
    more = {"until": arguments.until, "skip_failed": arguments.skip_failed, "error": not arguments.no_error}
    return _compute(arguments, arguments.folder, partial(resume, arguments.folder, **more))


def _compute(arguments: argparse.Namespace, out: Path, work: "Callable[..., Result]") -> int:
    """Execute `work`, a run or its continuation; show the progress and print the results. Returns the exit code."""
    from ..files import checkpoint
    from ..files.store import SUMMARY
    from ..progress import Progress

    progress = Progress(quiet=arguments.quiet)
    every, jobs = arguments.checkpoint, options.jobs_of(arguments)
    try:
        result = work(progress=progress, threads=arguments.threads, checkpoint_every=every, jobs=jobs)
    except KeyboardInterrupt as interrupt:
        saved = bool(checkpoint.stored(out)) or (out / SUMMARY).is_file()  # a summary: only the error is missing
        return _fail(_stopped(progress, out, saved), _code(interrupt))
    finally:
        progress.stop()
    if result.undecided is not None and is_first_rank():
        hint = f"; continue with coldspray resume {out}" if result.at_limit else ""
        print(f"undecided: {result.undecided}{hint}", file=sys.stderr if arguments.quiet else sys.stdout)
    if not arguments.quiet and is_first_rank():
        from ..report import screen

        print(screen(result, arguments.verbose))
        if result.at_own_end:
            print(_FURTHER.format(out))
        print(f"results in {out}{'' if arguments.verbose else f'; all measures: coldspray report {out}'}")
    return 0 if result.undecided is None else _UNDECIDED


def _report(arguments: argparse.Namespace) -> int:
    from ..files.result import Result
    from ..report.page import write_report
    from ..studies.coating_seeds import lines_of

    result, out = Result(arguments.run), arguments.out or arguments.run / "report.html"
    claim_file(out, (".html", ".htm"), [arguments.run], arguments.force)
    with reading(arguments.run), options.working("reading the run") as progress:
        page = write_report(result, out, progress.stage, lines_of(result))
    print(f"page in {page}")
    return 0


def _animate(arguments: argparse.Namespace) -> int:
    from ..files.result import Result
    from ..report.animation import SUFFIXES, animate, ffmpeg

    result = Result(arguments.run)
    out = arguments.out or arguments.run / f"{arguments.field}{SUFFIXES[ffmpeg() is None]}"
    claim_file(out, SUFFIXES, [arguments.run], arguments.force)
    with reading(arguments.run), options.working("computing the cross-section at each step") as progress:
        film = animate(result, out, arguments.field, arguments.fps, progress.stage)
    print(f"animation in {film}")
    return 0


def _export(arguments: argparse.Namespace) -> int:
    from ..files.export import NAMES, write_fields
    from ..files.result import Result

    result, out = Result(arguments.run), arguments.out or arguments.run / "pvd"
    claim_folder(out, "export", NAMES, [arguments.run], arguments.force)
    with reading(arguments.run), options.working("reading the run") as progress:
        written = write_fields(result, out, progress.stage)
    print(f"{', '.join(file.name for file in written)} written to {out}")
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from ..files.result import Result
    from ..report.compare import check_count, compare, comparison_table

    check_count(len(arguments.runs))
    claim_file(arguments.out, (".png", ".html", ".htm"), arguments.runs, arguments.force)
    with reading("the runs"), options.working("drawing the runs"):
        results = [Result(folder) for folder in arguments.runs]
        table = comparison_table(results)
        compare(results, arguments.out)
    Console().print(table)
    print(f"comparison written to {arguments.out}")
    return 0


def _completion(arguments: argparse.Namespace) -> int:
    import shtab

    parser = _parser()
    commands = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    for command in commands.choices.values():
        for action in command._actions:
            if action.type is options.path:
                action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE
    print(shtab.complete(parser, arguments.shell))
    return 0


def _stopped(progress: "Progress", out: Path, saved: bool) -> str:
    go_on = f"; continue with coldspray resume {out}" if saved else ""
    if progress.time != progress.time:  # nan: no step, or a rank without the time
        return ("stopped" if saved else "stopped before the first time step") + go_on
    return f"stopped at t = {progress.time * 1e9:.1f} ns, files in {out} are readable{go_on}"


def _fail(message: str, code: int) -> int:
    if not is_first_rank():  # every rank ends with the same error; the first prints it
        return code
    try:
        print(f"coldspray: {message}", file=sys.stderr)
    except BrokenPipeError:
        return _BROKEN_PIPE
    except OSError:  # a full disk
        _flush()
    return code
