"""Function calls in a separate process, which may crash or hang: gmsh ends with a segmentation fault on some surfaces.

One process with gmsh loaded waits for calls, and forks for each of them: only the first call waits for imports.
"""

import atexit
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from subprocess import PIPE
from threading import Lock
from typing import BinaryIO, NoReturn, TypeVar, cast

from ..core.executors import own_environment
from ..errors import ColdsprayError, SplatError

T = TypeVar("T")
ROOT = str(Path(__file__).resolve().parents[2])
RESULT, ERRORS = "result", "errors"  # files of a call
_one_call = Lock()
_waiting: list[subprocess.Popen[bytes]] = []  # the process that waits for calls; empty before the first


def begin() -> subprocess.Popen[bytes]:
    """The process that waits for calls; it starts if there is none."""
    if not _waiting or _waiting[0].poll() is not None:
        paths = os.pathsep.join(path for path in (ROOT, os.environ.get("PYTHONPATH")) if path)
        _waiting[:] = [
            subprocess.Popen(
                [sys.executable, "-P", "-m", "coupler.geometry.apart"], stdin=PIPE, stdout=PIPE, stderr=PIPE,
                env=own_environment() | {"PYTHONPATH": paths},
                start_new_session=True,  # end() reaches a call, and an interrupt of the terminal does not reach it
            )
        ]  # fmt: skip
    return _waiting[0]


@atexit.register
def end() -> None:
    """End the process that waits for calls, and a call in it."""
    while _waiting:
        with _waiting.pop() as process, suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def apart(call: Callable[[], T], time_limit: float) -> T:
    """The result of call() in a separate process. call: the `functools.partial` of a function of a module.

    Raises the ColdsprayError of the call; SplatError if the process dies, or runs longer than time_limit s and is killed.
    """
    with _one_call, tempfile.TemporaryDirectory(prefix="apart-") as name:
        code, error = _done(begin(), (pickle.dumps(call), name, time_limit))
        if code == -signal.SIGALRM:
            raise SplatError(f"the mesher did not finish within {time_limit:g} s: try another element size")
        if code < 0:
            remedy = "try a larger element size, or more memory"
            which = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
            raise SplatError(f"the mesher was ended by the signal {which}: {remedy}")
        if code > 0:
            raise SplatError(f"the mesher failed: {(error.strip().splitlines() or [f'exit code {code}'])[-1]}")
        result = pickle.loads((Path(name) / RESULT).read_bytes())
    if isinstance(result, ColdsprayError):
        raise result
    return cast(T, result)


def _done(process: subprocess.Popen[bytes], call: tuple[bytes, str, float]) -> tuple[int, str]:
    """Exit code of a call, and what it has written to stderr; those of the waiting process if that dies."""
    stdin, stdout, stderr = (cast(BinaryIO, pipe) for pipe in (process.stdin, process.stdout, process.stderr))
    try:
        with suppress(BrokenPipeError):
            pickle.dump(call, stdin)
            stdin.flush()
        code = int(answer) if (answer := stdout.readline()) else None
    except BaseException:  # an interrupt: the answer of this call must not become that of the next
        end()
        raise
    if code is not None:
        return code, (Path(call[1]) / ERRORS).read_text(errors="replace")
    return process.wait(), stderr.read().decode(errors="replace")


def _fork(call: bytes, name: str, time_limit: float) -> int:
    """Exit code of a fork of this process that writes the result of the call to the folder `name`."""
    child = os.fork()
    if child == 0:
        _compute(call, Path(name), time_limit)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _compute(call: bytes, folder: Path, time_limit: float) -> NoReturn:
    """Write the result of the call, and what it prints, to the folder, and end this process; time_limit s."""
    signal.setitimer(signal.ITIMER_REAL, time_limit)  # its signal ends the process, also inside gmsh
    code = 1
    try:
        with open(folder / ERRORS, "wb") as errors:
            for stream in (1, 2):
                os.dup2(errors.fileno(), stream)
        try:
            result = pickle.loads(call)()
        except ColdsprayError as problem:
            result = problem
        (folder / RESULT).write_bytes(pickle.dumps(result))
        code = 0
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(code)


if __name__ == "__main__":
    from . import mesher

    with os.fdopen(os.dup(1), "w") as answers, suppress(EOFError):  # the process that makes the calls has ended
        os.dup2(2, 1)  # gmsh may print when it loads
        mesher.load()
        while True:
            print(_fork(*pickle.load(sys.stdin.buffer)), file=answers, flush=True)
