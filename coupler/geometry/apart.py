"""Function calls in a separate process, which may crash or hang: gmsh ends with a segmentation fault on some surfaces."""

import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

from ..errors import ColdsprayError, SplatError

T = TypeVar("T")
ROOT = str(Path(__file__).resolve().parents[2])


def apart(call: Callable[[], T], time_limit: float) -> T:
    """The result of call() in a separate process. call: the `functools.partial` of a function of a module.

    Raises the ColdsprayError of the call; SplatError if the process dies, or runs longer than time_limit s and is killed.
    """
    paths = os.pathsep.join(path for path in (ROOT, os.environ.get("PYTHONPATH")) if path)
    with tempfile.TemporaryDirectory(prefix="apart-") as name:
        result_file = Path(name) / "result"
        try:
            done = subprocess.run(
                [sys.executable, "-P", "-m", __name__, str(result_file)], input=pickle.dumps(call), capture_output=True,
                timeout=time_limit, env={**os.environ, "PYTHONPATH": paths}, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise SplatError(f"the mesher did not finish within {time_limit:g} s: try another element size") from None
        if done.returncode < 0:
            remedy = "try a larger element size, or more memory"
            number = -done.returncode
            which = signal.Signals(number).name if number in set(signal.Signals) else str(number)
            raise SplatError(f"the mesher was ended by the signal {which}: {remedy}")
        if done.returncode > 0:
            last = (done.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {done.returncode}"])[-1]
            raise SplatError(f"the mesher failed: {last}")
        result = pickle.loads(result_file.read_bytes())
    if isinstance(result, ColdsprayError):
        raise result
    return cast(T, result)


if __name__ == "__main__":
    try:
        result = pickle.load(sys.stdin.buffer)()
    except ColdsprayError as problem:
        result = problem
    Path(sys.argv[1]).write_bytes(pickle.dumps(result))
