"""Runs of many scenes, each in its own folder, with any executor. All studies use this module for their computations.

OUT/<point>.toml is a scene, OUT/<point>/ the folder of its run, OUT/<point>.json its status once the run has ended. A point with a
status is not computed again; a point without one is computed, or its run continues. A stopped study therefore continues with the
same command.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from pathlib import Path

from ..core.executors import executor, own_environment
from ..core.process import cores
from ..errors import InterruptedRunError, SceneError
from ..files.inputs import InputError, parse_toml, read_json_object, read_text, read_toml
from ..files.outputs import claim_folder, write_text
from ..files.result import Result
from ..files.store import lock_folder
from ..plan.reading import Scene
from ..plan.text import duration

Log = Callable[[str], None]
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # a run that these end has no status: it continues later
REFUSED = 2  # exit code of a run whose scene or folder is refused
_STATUS = {0: "done", 4: "undecided"}  # by exit code; all others: "failed"
_running: set[subprocess.Popen[str]] = set()  # of this process


def results(
    folder: Path, points: Mapping[str, str], jobs: int, log: Log, again: bool = False
) -> tuple[dict[str, Result], dict[str, str]]:
    """Run the points of a folder as in `run_points`. Returns the result of each point, or the reason why a point has none. again: an
    undecided run continues once, for the same time again."""
    statuses = run_points(folder, points, jobs, log)
    for point in [point for point, status in statuses.items() if status == "undecided" and again]:
        statuses[point] = str(compute(folder / f"{point}.toml")["status"])
    found = {point: Result(folder / point) for point, status in statuses.items() if status in _STATUS.values()}
    ended = {point: how_ended(folder / f"{point}.json") or {} for point in statuses if point not in found}
    return found, {point: str(status.get("reason") or "the run was stopped") for point, status in ended.items()}


def run_points(
    folder: Path, points: Mapping[str, str], jobs: int = 1, log: Log = print,
    refused: Mapping[str, str] | None = None, pool: Executor | None = None,
) -> dict[str, str]:  # fmt: skip
    """Run the points (name -> scene as TOML) of a folder that have no status yet. Returns the status of each.

    Status: "done", "undecided", "failed", or "stopped": the run is not finished and continues with the next call. A point that fails
    does not stop the others. jobs: number of runs at the same time on this machine; they share its cores. pool: an executor to use
    instead; it is shut down. log: receives a line when a point ends. refused: points whose scene is not valid -> reason; they fail.
    """
    folder = folder.resolve()
    pool = pool or executor("processes", max(jobs, 1), folder, starts_processes=True)
    statuses: dict[str, str] = {}
    for point, reason in (refused or {}).items():
        verdict: dict[str, object] = {"status": "failed", "reason": " ".join(reason.split()), "exit_code": REFUSED}
        path = write_scene(folder, point, points[point]).with_suffix(".json")
        if how_ended(path) != verdict:
            write_text(path, json.dumps(verdict, indent=1) + "\n")
        statuses[point] = "failed"
        log(f"{len(statuses)}/{len(points)} {point}: {status_text(verdict)}")
    kept = {point: str(known["status"]) for point, text in points.items() if (known := _kept(folder, point, text))}
    statuses = kept | statuses
    if kept:
        log(f"{len(kept)} of {len(points)} points are already computed")
    begun, ended_before = time.monotonic(), len(statuses)
    wanted = {point: text for point, text in points.items() if point not in statuses}
    here = isinstance(pool, ThreadPoolExecutor)  # a worker elsewhere has one core
    threads = max(cores() // max(min(jobs, len(wanted)), 1), 1) if here else 1
    try:
        futures = {pool.submit(run_point, folder, *each, threads=threads): each[0] for each in wanted.items()}
        for future in as_completed(futures):
            point = futures[future]
            try:
                ended: Mapping[str, object] = future.result()
            except InterruptedRunError as error:
                ended = {"status": "stopped", "reason": str(error)}
            except Exception as error:  # the worker itself was lost
                ended = {"status": "stopped", "reason": f"its process ended early ({error or type(error).__name__})"}
            statuses[point] = str(ended["status"])
            left = len(points) - len(statuses)
            to_go = left * (time.monotonic() - begun) / (len(statuses) - ended_before)
            after = f"; about {duration(to_go)} remaining" if left else ""
            log(f"{len(statuses)}/{len(points)} {point}: {status_text(ended)}{after}")
    except BaseException:
        with contextlib.suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Parsl warns that it cannot cancel a run, but its jobs are cancelled
            pool.shutdown(wait=False, cancel_futures=True)
        for run in list(_running):
            run.terminate()  # it writes a checkpoint
        raise
    pool.shutdown()
    return statuses


def run_point(folder: Path, point: str, text: str, threads: int = 1) -> dict[str, object]:
    """Run a scene (TOML) as a point of a folder, unless it already has a status. Returns its status as `compute` does."""
    ended = _kept(folder, point, text)
    return compute(write_scene(folder, point, text), threads) if ended is None else ended


def _kept(folder: Path, point: str, text: str) -> dict[str, object] | None:
    """Stored status of a point with this scene (TOML). None if there is no status, or the scene was refused, because a new attempt
    costs nothing."""
    known, scene = folder / f"{point}.json", write_scene(folder, point, text)
    fresh = known.is_file() and known.stat().st_mtime_ns >= scene.stat().st_mtime_ns
    ended = how_ended(known) if fresh else None
    return None if ended is None or ended.get("exit_code") == REFUSED else ended


def of_another_scene(folder: Path, points: Mapping[str, str]) -> list[str]:
    """Names of those `points` (name -> scene as TOML) for which the folder has results of another scene."""
    others = []
    for point, text in points.items():
        scene = folder / f"{point}.toml"
        if scene.is_file() and not holds(scene, text):
            ended = how_ended(folder / f"{point}.json")
            if (folder / point / "scene.toml").is_file() or (ended is not None and ended.get("exit_code") != REFUSED):
                others.append(point)
    return others


def write_scene(folder: Path, point: str, text: str) -> Path:
    """Write the scene (TOML) of a point, unless its file has the same data. Returns the path. Raises StoreError."""
    path = folder / f"{point}.toml"
    if not path.is_file() or not holds(path, text):
        claim_folder(folder, "sweep", [path.name], force=None)
        write_text(path, text)
    return path


def holds(path: Path, text: str) -> bool:
    """Whether the file of a scene has the same data as a TOML text."""
    return read_text(path) == text or read_toml(path) == parse_toml(text)


def compute(scene: Path, threads: int = 1) -> dict[str, object]:
    """Run the file of a scene in the folder of the same name, or continue the run there. Returns its status, and writes this to the
    .json file of the same name: {"status": "done", "undecided" or "failed", "reason": message, "exit_code": int}. If the run is stopped
    from outside, raises InterruptedRunError and writes no status; the next call then continues the run."""
    folder = scene.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    # a run may outlive its study for some time, if that was killed
    if (lock := lock_folder(folder, wait=True)) is not None:
        os.close(lock)
    with subprocess.Popen(_command(scene, folder, threads), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                          env=own_environment()) as run:  # fmt: skip
        _running.add(run)
        try:
            _, errors = run.communicate()
        except BaseException:
            run.terminate()
            run.communicate()
            raise
        finally:
            _running.discard(run)
    code = run.returncode
    if code in {*(-number for number in STOPS), *(128 + number for number in STOPS)}:
        raise InterruptedRunError(f"the run in {folder} was stopped; repeat the command to continue it")
    ended = {"status": _STATUS.get(code, "failed"), "reason": _reason(code, errors), "exit_code": code}
    write_text(scene.with_suffix(".json"), json.dumps(ended, indent=1) + "\n")
    return ended


def _command(scene: Path, folder: Path, threads: int) -> list[str]:
    """The command that computes a scene. If the scene's folder has a run of the same scene, the command continues it."""
    verb: list[object] = ["run", scene, "--out", folder, "--force"]
    measured = False
    with contextlib.suppress(SceneError, InputError):  # a scene that cannot be read is refused by its run
        known = Scene.load(scene)
        measured = known.resolution.error is True
        if read_text(folder / "scene.toml") == known.to_toml():
            verb = ["resume", folder]
    more = [*([] if measured else ["--no-error"]), "--threads", str(threads), "--jobs", str(threads), "--quiet"]
    return [sys.executable, "-m", "coupler", *map(str, verb), *more]


def _reason(code: int, errors: str) -> str:
    """Why a run failed or is undecided: its message on standard error, or the signal that killed it."""
    if code == 0:
        return ""
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    at = errors.rfind("coldspray: ")
    text = errors[at + len("coldspray: ") :] if at >= 0 else (errors.strip().splitlines() or [f"exit code {code}"])[-1]
    return " ".join(text.split())


def how_ended(path: Path) -> dict[str, object] | None:
    """The status in a .json file that `compute` has written; None if the file is missing or damaged."""
    try:
        ended = read_json_object(path)
    except InputError:
        return None
    return ended if isinstance(ended.get("status"), str) else None


def status_text(ended: Mapping[str, object]) -> str:
    """A status as text: "done", "failed: its reason"."""
    status, reason = str(ended["status"]), str(ended.get("reason") or "")
    return f"{status}: {reason.removeprefix(f'{status}: ')}" if reason else status
