"""A splat's cloud of points becomes tetrahedral bodies with its state.

The work is done by `worker` in a separate process, because gmsh ends with a segmentation fault on some surfaces. If the
process dies or exceeds the time limit, the strategy it was trying counts as failed and a new process continues with the next.
"""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import time as clock
from pathlib import Path

import numpy as np

from ..errors import SplatError
from ..geometry.tetrahedra import TETS_PER_H3
from .cloud import Body, Cloud, Splat
from .worker import Attempts, Task, write_task

METHODS = ("auto", "carried", "density", "stuffing", "paper")
WORKER = "coupler.splat.worker"
MAX_ELEMENTS = 5e6
START_TIME = 300.0  # s, before the first attempt: imports, and the kernels where they must be compiled


def convert(cloud: Cloud, element_size: float, method: str = "auto", time_limit: float = 120.0) -> Splat:
    """Mesh a cloud with elements of about element_size m and transfer its state.

    method: "auto" takes the carried surface where there is one, else the density of the points, and isosurface stuffing where
    neither can be filled; the others force one source. time_limit: s, for one attempt.
    Raises SplatError for a cloud that cannot be meshed, or when every strategy has failed.
    """
    if method not in METHODS:
        raise SplatError(f"unknown method {method!r}: choose one of {', '.join(METHODS)}")
    if method == "carried" and cloud.surface is None:
        raise SplatError(
            "method 'carried' needs the carried surface of the body, and the cloud has none: use 'density'"
        )
    if method == "paper" and importlib.util.find_spec("open3d") is None:
        raise SplatError("method 'paper' needs the package open3d, which is not installed: install it, or use 'auto'")
    cloud.check()
    if not (np.isfinite(element_size) and element_size > 0.0):
        raise SplatError(f"element_size must be positive, is {element_size:g}")
    expected = TETS_PER_H3 * cloud.solid_volume / element_size**3
    if expected > MAX_ELEMENTS:
        raise SplatError(
            f"elements of {element_size:.3g} m would be {expected:.2g} in this body: give a larger size, "
            f"at least {(TETS_PER_H3 * cloud.solid_volume / MAX_ELEMENTS) ** (1 / 3):.3g} m"
        )
    start = clock.perf_counter()
    with tempfile.TemporaryDirectory(prefix="splat-") as name:
        folder = Path(name)
        write_task(folder, cloud, Task(element_size, method))
        _run_workers(folder, time_limit)
        splat = _read_splat(folder, cloud)
    splat.report["wall_s"] = clock.perf_counter() - start
    return splat


def _run_workers(folder: Path, time_limit: float) -> None:
    """Run workers until one ends by itself; each continues where the one before it died."""
    for _ in range(100):
        code, reason = _run_worker(folder, time_limit)
        if code == 0:
            return
        if code > 0:
            log = (folder / "log.txt").read_text(errors="replace")
            raise RuntimeError(f"the conversion's worker process failed:\n{log}")
        if not Attempts(folder).close_last(reason):
            raise SplatError(f"{reason} before the first attempt: give more time, or a larger element size")
    raise SplatError("a hundred worker processes died: try method 'stuffing'")


def _run_worker(folder: Path, time_limit: float) -> tuple[int, str]:
    """The exit code of a worker, and how it was ended if not by itself."""
    root = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join(p for p in (root, os.environ.get("PYTHONPATH")) if p)
    attempts = Attempts(folder).path
    with open(folder / "log.txt", "wb") as log:
        worker = subprocess.Popen(
            [sys.executable, "-m", WORKER, str(folder)],
            stdin=subprocess.DEVNULL, stdout=log, stderr=log, env={**os.environ, "PYTHONPATH": paths},
        )  # fmt: skip
        before = known = attempts.stat().st_size if attempts.exists() else 0
        since = clock.monotonic()
        try:
            while True:
                try:
                    code = worker.wait(0.05)
                    return code, f"the mesher was ended by {signal.Signals(-code).name}" if code < 0 else ""
                except subprocess.TimeoutExpired:
                    size = attempts.stat().st_size if attempts.exists() else 0
                    if size != known:  # the next attempt has begun
                        known, since = size, clock.monotonic()
                    limit = time_limit if known != before else max(time_limit, START_TIME)
                    if clock.monotonic() - since > limit:
                        return -1, f"not done after {limit:g} s"
        finally:  # an interrupt does not leave the worker behind
            if worker.poll() is None:
                worker.kill()
                worker.wait()


def _read_splat(folder: Path, cloud: Cloud) -> Splat:
    summary = json.loads((folder / "summary.json").read_text())
    if summary["error"]:
        raise SplatError(summary["error"])
    bodies = []
    for i, report in enumerate(summary["bodies"]):
        with np.load(folder / f"body_{i}.npz", allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        bodies.append(Body(**arrays, mass_scale=report["mass_scale"], report=report))
    lost = np.setdiff1d(np.arange(len(cloud.x)), np.concatenate([body.cloud_index for body in bodies]))
    return Splat(bodies, float(cloud.mass[lost].sum()), {**summary["report"], "lost_points": len(lost)})
