"""The resolution error of a run, from coarser runs: the same scene with fewer points, computed at the same time or afterwards."""

import contextlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType

from ..core.executors import begin_worker, without_interrupts
from ..errors import ColdsprayError
from ..files.inputs import read_json_object
from ..files.outputs import write_text
from ..files.result import Result
from ..files.store import SUMMARY
from ..files.summary import Summary, Values, impact_values, read_summary
from ..measures import CONVERGING
from ..plan.planning import Plan
from ..plan.reading import Scene
from ..plan.record import read_plan
from ..plan.refinement import at_points, error, has_error

FOLDER = "coarser"  # folder of the coarser runs, in the folder of the run; removed once the error is known
# arguments: scene, folder, contact stiffness, numerics, threads
Compute = Callable[[Scene, Path, float, Mapping[str, float], int], None]


@dataclass
class Companions:
    """The coarser runs of a run, from which its error is computed. plan, folder, numerics: plan, folder and numerics of the run;
    compute: function that computes a scene; it can be sent to another process."""

    plan: Plan
    folder: Path
    numerics: Mapping[str, float]
    compute: Compute
    _process: BaseProcess | None = None

    def begin(self, on_another_core: bool) -> None:
        """Remove coarser runs of an earlier run. on_another_core: whether to start a process that computes the coarser runs."""
        shutil.rmtree(self.folder / FOLDER, ignore_errors=True)
        if on_another_core and self.plan.companions:
            process = get_context("spawn").Process(target=_in_own_process, args=(self, os.getpid()))
            script = sys.modules["__main__"]
            # else the new process would execute a script without a main guard again
            sys.modules["__main__"] = ModuleType("__main__")
            try:
                with without_interrupts():
                    process.start()
            finally:
                sys.modules["__main__"] = script
            self._process = process

    def end(self) -> None:
        """End the process that computes the coarser runs, whether it has finished or not."""
        if self._process is not None:
            self._process.terminate()
            self._process.join()
            self._process = None

    def measure(self, threads: int) -> None:
        """Add the error of each measure to the summary of the finished run. Missing coarser runs are computed in this process."""
        if self._process is not None:
            self._process.join()
        found = self.all(threads)
        path = self.folder / SUMMARY
        summary = read_summary(path)
        add_errors(summary, found, bool(read_plan(self.folder).skipped))
        write_text(path, json.dumps(summary, indent=2, allow_nan=False) + "\n")
        shutil.rmtree(self.folder / FOLDER, ignore_errors=True)

    def all(self, threads: int) -> dict[int, Summary | str]:
        """The summary of each coarser run, or the reason why it failed, by its number of points."""
        scene = Scene.from_text(Result(self.folder).scene_text, self.plan.name)
        return {n: self._one(scene, n, threads) for n in self.plan.companions}

    def _one(self, scene: Scene, points: int, threads: int) -> Summary | str:
        folder = self.folder / FOLDER / str(points)
        end = folder.with_suffix(".json")
        if not end.is_file():
            end.parent.mkdir(parents=True, exist_ok=True)
            try:
                changes = {"effects": self.plan.effects.active or "none", "output": {"at": "ends"}}
                coarse = at_points(scene, points, changes)
                self.compute(coarse, folder, self.plan.contact_stiffness, self.numerics, threads)
                reason = None
            except ColdsprayError as failure:
                reason = " ".join(str(failure).split())
            write_text(end, json.dumps({"failed": reason}) + "\n")
        failed = read_json_object(end).get("failed")
        return read_summary(folder / SUMMARY) if failed is None else str(failed)


def _in_own_process(companions: Companions, parent: int) -> None:
    """Compute the coarser runs in this process, which ends when its parent process ends. parent: process id of the parent."""
    begin_worker(parent)
    with contextlib.suppress(KeyboardInterrupt):
        companions.all(threads=1)


def add_errors(summary: Summary, coarser: Mapping[int, Summary | str], skipped: bool = False) -> None:
    """Add to a summary the errors that follow from coarser runs: `errors` of each impact, `error` of the run, and a warning if a
    verdict depends on the resolution. coarser: number of points -> summary or reason of the failure, the finer run first. skipped:
    whether the run has skipped impacts: its impacts are then not those of the coarser runs."""
    whole, reasons = list[Summary](), list[str]()
    for points, found in coarser.items():
        if isinstance(found, str):
            reasons.append(f"{points} points: {found}")
        elif skipped or len(found["impacts"]) != len(summary["impacts"]):
            done = f"{len(found['impacts'])} impacts in place of {len(summary['impacts'])}"
            reasons.append(f"{points} points: {'the run has skipped impacts' if skipped else done}")
        else:
            whole.append(found)
    summary["run"]["error"] = {"points": list(coarser), "failed": reasons}
    warnings = summary["run"].setdefault("warnings", [])
    for i, impact in enumerate(summary["impacts"]):
        levels = [impact_values(each, i) for each in (summary, *whole)]
        impact["errors"] = errors(levels)
        verdicts = [level.get("verdict") for level in levels]
        if len(set(verdicts)) > 1:
            pairs = zip(verdicts, levels, strict=True)
            told = ", ".join(f"{word} with {level['points']} points" for word, level in pairs)
            warnings.append(f"impact {i + 1}: the verdict depends on the resolution: {told}")


def errors(levels: Sequence[Values]) -> dict[str, dict[str, object]]:
    """The error of each measure: {"half_width": error, SI; "order": order of the extrapolation; "coarser": values of the coarser
    runs}. levels: measures of an impact at each resolution, finest first. Measures are left out if the finest value
    or all coarser values are unknown, or if they have no error (`has_error`)."""
    found: dict[str, dict[str, object]] = {}
    for key in CONVERGING:
        known = [(level["points"] ** (-1.0 / 3.0), level[key]) for level in levels if level.get(key) is not None]
        if levels[0].get(key) is None or len(known) < 2 or not has_error(key, levels[0]["points"]):
            continue
        h, values = zip(*known, strict=True)
        half_width, order = error(h, values)
        found[key] = {"half_width": half_width, "order": order, "coarser": list(values[1:])}
    return found
