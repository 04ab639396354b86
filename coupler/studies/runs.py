"""Points of a study: many scenes, each a run in its own folder, wherever an executor computes them.

OUT/<point>.toml is the scene, OUT/<point>/ the folder of its `coldspray run`, OUT/<point>.json how that ended. A point that
has its .json is finished with, well or badly; one that has not is run, or gone on with. So a study that was killed is started
again by the same command, whoever runs it: `run_points`, or workflows/Snakefile, whose rules call this file.
"""

import contextlib
import fcntl
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

from ..core.cores import cores
from ..core.executors import executor, own_environment
from ..core.signals import interrupted_by
from ..errors import InterruptedRunError, SceneError
from ..files.inputs import InputError, read_json_object, read_text
from ..files.outputs import claim_folder, write_text
from ..plan.reading import Scene
from ..plan.text import duration

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # somebody wanted to stop: no verdict on the point
REFUSED = 2  # exit code of a run whose scene or folder is refused
_STATUS = {0: "done", 4: "undecided"}  # by the exit code of a run; "failed" else
_running: set[subprocess.Popen[str]] = set()  # of this process


def run_points(
    folder: Path, points: Mapping[str, str], jobs: int = 1, log: Callable[[str], None] = print,
    refused: Mapping[str, str] | None = None, pool: Executor | None = None,
) -> dict[str, str]:  # fmt: skip
    """Run the points (name -> scene as TOML) of a folder that have not been. Returns the status of each.

    A point that fails is marked and does not stop the others; "stopped": unfinished, the next call continues it. jobs: at a time, as
    processes here that share its cores, unless an executor is given as `pool`, which is shut down. log: called with a line as each
    point ends. refused: points whose scene cannot be computed -> why; they are marked as failed.
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
        log(f"{len(kept)} of {len(points)} points have ended before")
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
                ended = {"status": "stopped", "reason": f"its worker was lost ({error or type(error).__name__})"}
            statuses[point] = str(ended["status"])
            left = len(points) - len(statuses)
            to_go = left * (time.monotonic() - begun) / (len(statuses) - ended_before)
            after = f"; about {duration(to_go)} to go" if left else ""
            log(f"{len(statuses)}/{len(points)} {point}: {status_text(ended)}{after}")
    except BaseException:
        with contextlib.suppress(Exception), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that Parsl cannot cancel a run by itself: its jobs are cancelled
            pool.shutdown(wait=False, cancel_futures=True)
        for run in list(_running):
            run.terminate()  # it writes a checkpoint
        raise
    pool.shutdown()
    return statuses


def run_point(folder: Path, point: str, text: str, again: bool = False, threads: int = 1) -> dict[str, object]:
    """Run a scene (TOML) as a point of a folder, unless it is finished; how it ended (`compute`). again: continue an undecided one."""
    ended = None if again else _kept(folder, point, text)
    return compute(write_scene(folder, point, text), folder / f"{point}.json", threads) if ended is None else ended


def _kept(folder: Path, point: str, text: str) -> dict[str, object] | None:
    """Stored end of a point of this scene; None if it has not ended, or was refused, which costs nothing to repeat."""
    known, scene = folder / f"{point}.json", write_scene(folder, point, text)
    fresh = known.is_file() and known.stat().st_mtime_ns >= scene.stat().st_mtime_ns
    ended = how_ended(known) if fresh else None
    return None if ended is None or ended.get("exit_code") == REFUSED else ended


def of_another_scene(folder: Path, points: Mapping[str, str]) -> list[str]:
    """The points whose results in a folder belong to another scene (TOML)."""
    others = []
    for point, text in points.items():
        scene, known = folder / f"{point}.toml", folder / f"{point}.json"
        if scene.is_file() and read_text(scene) != text:
            ended = how_ended(known) if known.is_file() else None
            if (folder / point / "scene.toml").is_file() or (ended is not None and ended.get("exit_code") != REFUSED):
                others.append(point)
    return others


def write_scene(folder: Path, point: str, text: str) -> Path:
    """The file of a point's scene, written unless it is there. Raises StoreError."""
    path = folder / f"{point}.toml"
    if not path.is_file() or read_text(path) != text:
        claim_folder(folder, "sweep", [path.name], force=None)
        write_text(path, text)
    return path


def compute(scene: Path, status: Path, threads: int = 1) -> dict[str, object]:
    """Run a scene into the folder of its name, or continue there; write how it ended to `status` and return it. {"status": "done",
    "undecided" or "failed", "reason": the message, "exit_code": int}. A run that was stopped from outside raises InterruptedRunError
    and leaves no status, so that the next attempt continues it."""
    folder = scene.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    _wait_for(folder)
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
        raise InterruptedRunError(f"the run in {folder} was stopped; the same command continues it")
    ended = {"status": _STATUS.get(code, "failed"), "reason": _reason(code, errors), "exit_code": code}
    write_text(status, json.dumps(ended, indent=1) + "\n")
    return ended


def main(arguments: list[str]) -> int:
    """`python -m coupler.studies.runs SCENE STATUS`: what workflows/Snakefile calls for each point. Returns the exit code."""
    scene, status = map(Path, arguments)
    with interrupted_by(*STOPS):
        try:
            print(f"{scene.stem}: {status_text(compute(scene, status))}")
        except (KeyboardInterrupt, InterruptedRunError):
            return 128 + signal.SIGTERM
    return 0


def _wait_for(folder: Path) -> None:
    """Wait until no other process writes to the folder: a run of a sweep whose main process was killed may continue to its end."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)  # the lock that a run holds; see coupler.files.store
    except OSError:  # a file system without locks: as there
        pass
    finally:
        os.close(descriptor)


def _command(scene: Path, folder: Path, threads: int) -> list[str]:
    """Command that computes a scene, or continues it if its folder has a run of the same scene."""
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
    """The message of a run that failed or is undecided: from its last line with the program's name, or the signal that killed it."""
    if code == 0:
        return ""
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    at = errors.rfind("coldspray: ")
    text = errors[at + len("coldspray: ") :] if at >= 0 else (errors.strip().splitlines() or [f"exit code {code}"])[-1]
    return " ".join(text.split())


def how_ended(path: Path) -> dict[str, object] | None:
    """How a point ended; None if its file is damaged."""
    try:
        ended = read_json_object(path)
    except InputError:
        return None
    return ended if isinstance(ended.get("status"), str) else None


def status_text(ended: Mapping[str, object]) -> str:
    """How a point ended, in words."""
    status, reason = str(ended["status"]), str(ended.get("reason") or "")
    return f"{status}: {reason.removeprefix(f'{status}: ')}" if reason else status


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
