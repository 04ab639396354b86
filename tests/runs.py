"""Runs that tests share, compare, stop and start on several ranks."""

import fcntl
import hashlib
import json
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from coupler import Result, Scene, run
from coupler.deposition.run import resume
from coupler.geometry.apart import apart

MPIEXEC = Path(sys.executable).parent / "mpiexec"
OF_THE_MACHINE = {
    "wall_s", "wall_loop_s", "cpu_s", "seconds", "meshing_s", "joining_s", "ranks", "idle_share", "memory_peak_bytes",
    "provenance",
}  # fmt: skip


class SharedRuns:
    """Finished runs by scene and options: the first test that asks computes one, in whichever process of pytest it is.

    They live as long as the session of pytest. A test that changes files of a run works on a copy.
    """

    def __init__(self, folder: Path):
        self.folder = folder

    def __call__(self, text: str, name: str = "shared", **options: Any) -> Result:
        """The run of a scene (TOML) with options of `coupler.run`."""
        key = hashlib.sha256(repr((text, name, sorted(options.items()))).encode()).hexdigest()[:16]
        out = self.folder / key
        with alone(out):
            if not (out / "summary.json").exists():
                run(Scene.from_text(text, name), out, force=True, **options)
        return Result(out)


class SharedMeshes:
    """In place of `apart`: meshes of substrates, each computed once in a session of pytest.

    They are known by function and arguments to the last bit. What fails is not kept. Processes that tests start call gmsh.
    """

    def __init__(self, folder: Path):
        self.folder = folder

    def __call__(self, call: Callable[[], Any], time_limit: float) -> Any:
        path = self.folder / hashlib.sha256(pickle.dumps(call)).hexdigest()[:16]
        with alone(path):
            if not path.exists():
                path.write_bytes(pickle.dumps(apart(call, time_limit)))
            return pickle.loads(path.read_bytes())


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """No other process of pytest is at the same path."""
    path.parent.mkdir(exist_ok=True)
    with open(path.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # released as the file is closed
        yield


def in_this_process(scene: Path, threads: int = 1) -> dict[str, object]:
    """In place of `studies.runs.compute`: to start a process for each run costs more than these runs."""
    run(scene, scene.with_suffix(""), quiet=True)
    ended: dict[str, object] = {"status": "done", "reason": "", "exit_code": 0}
    scene.with_suffix(".json").write_text(json.dumps(ended))
    return ended


class Stopped(Exception):
    """Raised by a probe to break a run off."""


def break_off(scene: Scene | Path, out: Path, at: float, every: float = 0.0, after: int = 0) -> None:
    """Run to the time `at` s of the impact that comes after so many others, and stop there as a crash would; every: s of wall
    time between checkpoints."""
    seen: list[object] = []

    def probe(impact: Any) -> None:
        if not any(impact is other for other in seen):
            seen.append(impact)
        if len(seen) > after and impact.time > at:
            raise Stopped

    with pytest.raises(Stopped):
        run(scene, out, probe=probe, checkpoint_every=every)


def numbers(summary: dict[str, Any], prefix: str = "", ignore: tuple[str, ...] = ()) -> dict[str, float]:
    """All numbers of a summary by their path, but for those of the machine; impacts by their index."""
    values: dict[str, float] = {}
    for name, value in summary.items():
        if name in OF_THE_MACHINE or name in ignore:
            continue
        if isinstance(value, dict):
            values |= numbers(value, f"{prefix}{name}.", ignore)
        elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            for index, item in enumerate(value):
                values |= numbers(item, f"{prefix}{name}.{index}.", ignore)
        elif isinstance(value, (int, float)):
            values[prefix + name] = value
    return values


def assert_same_numbers(one: dict[str, Any], other: dict[str, Any], rel: float, ignore: tuple[str, ...] = ()) -> None:
    """Two summaries hold the same numbers within a relative tolerance."""
    expected, got = (numbers(summary, ignore=ignore) for summary in (one, other))
    assert got.keys() == expected.keys()
    different = {k: (v, expected[k]) for k, v in got.items() if v != pytest.approx(expected[k], rel=rel, abs=1e-25)}
    assert different == {}
    assert [
        k for k, v in got.items() if type(v) is not type(expected[k])
    ] == []  # 12 and 12.0 are other bytes of a file


def data_sets(path: Path) -> dict[str, bytes]:
    """Names, types, shapes and values of all data sets of a file."""
    found: dict[str, bytes] = {}

    def keep(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if isinstance(item, h5py.Dataset):
            found[f"{name} {item.dtype} {item.shape}"] = item[()].tobytes()

    with h5py.File(path) as file:
        file.visititems(keep)
    return found


def assert_same_files(one: Result, other: Result) -> None:
    """History and all stored steps of two runs are equal to the last bit."""
    assert (one.directory / "history.csv").read_text() == (other.directory / "history.csv").read_text()
    for domain in ("particle", "surface", "target"):
        left_file, right_file = (run.directory / f"{domain}.vtkhdf" for run in (one, other))
        if data_sets(left_file) == data_sets(right_file):
            continue
        np.testing.assert_array_equal(one.times(domain), other.times(domain))
        for step in range(len(one.times(domain))):
            left, right = one.fields(step, domain), other.fields(step, domain)
            np.testing.assert_array_equal(left.points, right.points)
            np.testing.assert_array_equal(left.cells, right.cells)
            assert left.data.keys() == right.data.keys()
            for name in left.data:
                np.testing.assert_array_equal(left.data[name], right.data[name])


def start(ranks: int, *arguments: str, code: str | None = None) -> subprocess.Popen[str]:
    """The command line, or a program of Python, on several ranks."""
    program = [sys.executable, "-c", code] if code else [sys.executable, "-m", "coupler"]
    return subprocess.Popen(
        [str(MPIEXEC), "-n", str(ranks), *program, *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def finish(process: subprocess.Popen[str], timeout: float = 240) -> tuple[int, str, str]:
    """Exit code and what was written to stdout and stderr."""
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, out, err


def on_ranks(ranks: int, code: str) -> None:
    """Run a program on several ranks, which must end well."""
    status, _, err = finish(start(ranks, code=code))
    assert status == 0, err


def summary_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())  # type: ignore[no-any-return]


def assert_goes_on(text: str, whole: Result, out: Path, at: float | None, every: float = 0.0) -> None:
    """Broken off at `at` s after the start of the run, or right after the join, and resumed: the same to 1e-9. every: s of wall time
    between checkpoints within an impact; there is one after each join."""
    seen = []

    def probe(impact: Any) -> None:
        seen.append(impact.time)
        joined = len(seen) > 1 and seen[-1] < seen[-2]
        if (at is None and joined) or (at is not None and sum(np.diff([0.0, *seen]).clip(0)) > at):
            raise Stopped

    with pytest.raises(Stopped):
        run(Scene.from_text(text, "shared"), out, probe=probe, checkpoint_every=every)
    result = resume(out)
    assert_same_numbers(whole.summary, result.summary, rel=1e-9)
    assert_same_files(whole, result)
