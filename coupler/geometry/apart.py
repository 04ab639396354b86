"""A call in a process of its own, which may die or hang: gmsh ends with a segmentation fault on some surfaces."""

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
    """The result of call() in a process of its own. call: the `functools.partial` of a function of a module.

    Raises the ColdsprayError of the call; SplatError where the process dies, or takes more than time_limit s and is killed.
    """
    with tempfile.TemporaryDirectory(prefix="apart-") as name:
        folder = Path(name)
        (folder / "call").write_bytes(pickle.dumps(call))
        paths = os.pathsep.join(path for path in (ROOT, os.environ.get("PYTHONPATH")) if path)
        try:
            done = subprocess.run(
                [sys.executable, "-m", __name__, name], stdin=subprocess.DEVNULL, capture_output=True, timeout=time_limit,
                env={**os.environ, "PYTHONPATH": paths}, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise SplatError(f"the mesher did not finish within {time_limit:g} s: try another element size") from None
        if done.returncode < 0:
            raise SplatError(
                f"the mesher was ended by the signal {signal.Signals(-done.returncode).name}: try a larger element size, or more memory"
            )
        if done.returncode > 0:
            raise SplatError(f"the mesher failed: {done.stderr.decode(errors='replace').strip().splitlines()[-1]}")
        result = pickle.loads((folder / "result").read_bytes())
    if isinstance(result, ColdsprayError):
        raise result
    return cast(T, result)


def main(folder: Path) -> None:
    """Main function of the process: make the call and write its result or ColdsprayError into the folder."""
    call = pickle.loads((folder / "call").read_bytes())
    try:
        result = call()
    except ColdsprayError as problem:
        result = problem
    (folder / "result").write_bytes(pickle.dumps(result))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
