"""Impacts side by side: the tasks of a batch in this process or in those of an executor, and their files in the order of arrival."""

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from concurrent.futures import BrokenExecutor, Executor, wait
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ColdsprayError, WorkerError
from ..files.result import Result
from ..files.store import Store
from ..impact.bodies import Bodies
from ..impact.recorder import cell_fields
from ..impact.run import RunOptions
from ..impact.stop import Stopped, StopSignals
from ..plan.batches import batch, batches
from ..plan.planning import Plan
from ..ranks.executors import executor
from .cut import Cut, cut_out
from .joining import points_of_impact
from .task import STOP, Task, TaskResult, attempt, run_alone

TASKS = "impacts"  # folder of the tasks in that of the run
_LOOK = 0.5  # s between two looks for a signal


@contextlib.contextmanager
def workers(plan: Plan, options: RunOptions, folder: Path) -> Iterator[Executor | None]:
    """The executor for batches; None where all is computed in this process."""
    widest = max(map(len, batches(plan.impacts)))
    if min(options.jobs, widest) == 1 or options.ranks.size > 1 or options.probe is not None:
        yield None
        return
    with executor("processes", min(options.jobs, widest), folder) as pool:
        yield pool


def threads_of(place: int, count: int, options: RunOptions) -> int:
    """Threads of the task at a place of a batch of `count`: two for the last ones, where so few are left over that cores are idle
    beside them. They do not change the numbers."""
    left = count % options.jobs
    return 2 if options.threads > 1 and place >= count - left and 2 * left <= options.jobs else 1


@dataclass(frozen=True)
class Batches:
    """The batches of a run. folder, about: of it, as in `Task`; pool: its executor, None where all is computed in this process."""

    plan: Plan
    folder: Path
    about: Mapping[str, str]
    options: RunOptions
    pool: Executor | None

    def tasks(self, first: int, whole: Bodies) -> Iterator[tuple[Task, Cut]]:
        """The batch that begins with an impact, as far as its cuts share no node; each cut is made when it is asked for."""
        taken = np.zeros(len(whole.target.x), bool)
        numbers = batch(self.plan.impacts, first)
        places = points_of_impact(whole, [self.plan.impacts[i].offset for i in numbers])
        for i, place in zip(numbers, places, strict=True):
            part, cut = cut_out(whole, place, self.plan.impacts[i].window)
            if taken[cut.nodes].any():
                break
            taken[cut.nodes] = True
            own = {**self.about, "impact": str(i + 1)}
            yield Task(self.plan, i, part.state(), place, self.folder / TASKS / f"{i + 1:05d}", own), cut

    def compute(self, first: int, whole: Bodies) -> tuple[list[tuple[Task, Cut]], list[TaskResult | ColdsprayError]]:
        """The tasks of the batch that begins with an impact, with their cuts, and their results, in order; the error in the place of
        one that fails. whole: the bodies before the batch.

        Raises Stopped after a signal, WorkerError where a process is ended from outside."""
        stop = self.folder / TASKS / STOP
        stop.parent.mkdir(exist_ok=True)
        stop.unlink(missing_ok=True)
        count = len(batch(self.plan.impacts, first))
        if self.pool is not None and count > 1:
            return self._side_by_side(self.pool, first, count, whole, stop)
        tasks: list[tuple[Task, Cut]] = []
        results: list[TaskResult | ColdsprayError] = []
        for task, cut in self.tasks(first, whole):
            tasks.append((task, cut))
            results.append(attempt(task, self.options))
        return tasks, results

    def _side_by_side(
        self, pool: Executor, first: int, count: int, whole: Bodies, stop: Path
    ) -> tuple[list[tuple[Task, Cut]], list[TaskResult | ColdsprayError]]:
        """`compute` of a batch of `count` impacts in processes, which the file `stop` ends. Each task begins as soon as its cut is
        made: workers do not wait for the cuts of others."""
        options, tasks, futures = self.options, [], []
        with StopSignals() as signals:
            try:
                for place, (task, cut) in enumerate(self.tasks(first, whole)):
                    tasks.append((task, cut))
                    threads = threads_of(place, count, options)
                    futures.append(
                        pool.submit(
                            run_alone, task, dict(options.numerics), options.checkpoint_every, options.until, threads
                        )
                    )
                words = f"impacts {first + 1} to {first + len(tasks)} side by side"
                options.progress.stage(words, of_impact=False, done=self.plan.shares[first][0])
                left = set(futures)
                while left:
                    left = wait(left, _LOOK).not_done
                    if signals.number and not stop.exists():
                        stop.touch()
                if signals.number:
                    raise Stopped(signals.number)
                return tasks, [future.result() for future in futures]
            except BrokenExecutor as error:
                which = f"impacts {first + 1} to {first + len(tasks)}"
                raise WorkerError(
                    f"a process that computed one of the {which} was ended from outside, perhaps for want of memory. What was computed"
                    f" is kept: go on with coldspray resume {self.folder}, with fewer --jobs where memory is short"
                ) from error


class BatchReplay:
    """What is written of the whole where the impacts of a batch are written one after another, each on the bodies as those before it
    have left them. before, after: the bodies before and after the batch."""

    def __init__(self, before: Bodies, after: Bodies):
        self.points, self.cells, self.fields = before.target.x.copy(), before.target.mesh.conn, cell_fields(before)
        self._after, self._fields_after = after.target, cell_fields(after)

    def replay(self, store: Store, task: Task, result: TaskResult, before: float) -> None:
        """Append what a task has written to the files of the run, its target as a part of the whole. before: simulated time (s) of the
        impacts before it."""
        own, nodes = Result(task.folder), task.bodies.target.nodes.node_number
        elements = task.bodies.target.elements.element_number
        for row in result.store.history:
            values = dict(zip(result.store.columns, row.tolist(), strict=True))
            store.record({**values, "time": before + values["time"]})
        for domain, steps in result.store.steps.items():
            for step in range(steps):
                fields = own.fields(step, domain)
                points, cells, (at_points, inside) = fields.points, fields.cells, fields.split()
                if domain == "target":
                    points, cells = self.points.copy(), self.cells
                    points[nodes] = fields.points
                    velocity = np.zeros_like(points)
                    velocity[nodes] = at_points["velocity"]
                    whole = {name: values.copy() for name, values in self.fields.items()}
                    for name in inside.keys() - {"body"}:
                        whole[name][elements] = inside[name]
                    at_points, inside = {"velocity": velocity}, whole
                store.write(domain, before + fields.time, points, cells, at_points, inside)

    def go_on(self, task: Task, cut: Cut, result: TaskResult) -> None:
        """Go on to the next impact: a task has changed its cut, and its splat is the next one of the bodies after the batch."""
        more = len(result.bodies.target.nodes.x) - len(task.bodies.target.nodes.x)
        n, m = len(self.points), len(self.cells)
        changed = np.zeros(n, bool)
        changed[cut.nodes] = True
        near = changed[self.cells].any(axis=1)  # pressures are of nodes
        self.points[cut.nodes] = self._after.x[cut.nodes]
        self.points = np.concatenate([self.points, self._after.x[n : n + more]])
        more = len(result.bodies.target.elements.T) - len(task.bodies.target.elements.T)
        self.cells = self._after.mesh.conn[: m + more]
        for name, values in self.fields.items():
            now = self._fields_after[name][: m + more]
            self.fields[name] = np.concatenate([values, now[m:]])
            self.fields[name][:m][near] = now[:m][near]


def clear(folder: Path) -> None:
    """Remove the folders of all tasks of a run."""
    shutil.rmtree(folder / TASKS, ignore_errors=True)
