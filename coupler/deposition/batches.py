"""Impacts side by side: the tasks of a batch in this process or in those of an executor, and their files in the order of arrival."""

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ColdsprayError, WorkerError
from ..files.result import Result
from ..files.store import Store, StoreState
from ..impact.bodies import Bodies
from ..impact.recorder import cell_fields
from ..impact.run import RunOptions
from ..impact.stop import Stopped, StopSignals
from ..plan.batches import batch, batches
from ..plan.planning import Plan
from ..ranks.executors import executor
from .cut import Cut, cut_out
from .joining import points_of_impact
from .task import SPARE, STOP, Task, TaskResult, attempt, run_alone

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

    def compute(
        self, first: int, whole: Bodies, meanwhile: Callable[[], None]
    ) -> Iterator[tuple[Task, Cut, TaskResult | ColdsprayError]]:
        """The tasks of the batch that begins with an impact, in order, each with its cut and its result as soon as it is there; the
        error in the place of one that fails. whole: the bodies before the batch; meanwhile(): called once, while workers compute.

        Raises Stopped after a signal, WorkerError where a process is ended from outside."""
        folder = self.folder / TASKS
        folder.mkdir(exist_ok=True)
        for name in (STOP, SPARE):
            (folder / name).unlink(missing_ok=True)
        count = len(batch(self.plan.impacts, first))
        if self.pool is not None and count > 1:
            yield from self._side_by_side(self.pool, first, whole, meanwhile, folder)
            return
        meanwhile()
        for task, cut in self.tasks(first, whole):
            yield task, cut, attempt(task, self.options)

    def _side_by_side(
        self, pool: Executor, first: int, whole: Bodies, meanwhile: Callable[[], None], folder: Path
    ) -> Iterator[tuple[Task, Cut, TaskResult | ColdsprayError]]:
        """`compute` in processes, which the file STOP in a folder ends. Each task begins as soon as its cut is made: workers do not
        wait for the cuts of others. Where so few are left that cores are idle, the file SPARE gives each two threads."""
        options, tasks = self.options, list[tuple[Task, Cut, Future[TaskResult | ColdsprayError]]]()
        stop, spare = folder / STOP, folder / SPARE
        with StopSignals() as signals:
            try:
                for task, cut in self.tasks(first, whole):
                    future = pool.submit(
                        run_alone, task, dict(options.numerics), options.checkpoint_every, options.until
                    )
                    tasks.append((task, cut, future))
                words = f"impacts {first + 1} to {first + len(tasks)} side by side"
                options.progress.stage(words, of_impact=False, done=self.plan.shares[first][0])
                meanwhile()
                for task, cut, future in tasks:
                    while not future.done():
                        left = [each for _, _, each in tasks if not each.done()]
                        if options.threads > 1 and 2 * len(left) <= options.jobs:
                            spare.touch()
                        wait(left, _LOOK, FIRST_COMPLETED)
                        if signals.number and not stop.exists():
                            stop.touch()
                    if not signals.number:
                        yield task, cut, future.result()
                if signals.number:
                    raise Stopped(signals.number)
            except BrokenExecutor as error:
                which = f"impacts {first + 1} to {first + len(tasks)}"
                raise WorkerError(
                    f"a process that computed one of the {which} was ended from outside, perhaps for want of memory. What was computed"
                    f" is kept: go on with coldspray resume {self.folder}, with fewer --jobs where memory is short"
                ) from error
            except BaseException:
                with contextlib.suppress(OSError):
                    stop.touch()  # workers end with a checkpoint
                raise


@dataclass(frozen=True)
class _Written:
    """What a task has written, as a part of the whole. folder, store: of its files; nodes, elements: numbers of its cut in the whole;
    changed: nodes that it can change; more: nodes and elements of its splat; before: simulated time of the impacts before it, s."""

    folder: Path
    store: StoreState
    nodes: np.ndarray
    elements: np.ndarray
    changed: np.ndarray
    more: tuple[int, int]
    before: float


class BatchReplay:
    """What is written of the whole where the impacts of a batch are written one after another, each on the bodies as those before it
    have left them. It may be written later: it does not follow what becomes of the bodies."""

    def __init__(self, before: Bodies, after: Bodies):
        """before, after: the bodies before and after the batch."""
        self._points, self._cells, self._fields = before.target.x.copy(), before.target.mesh.conn, cell_fields(before)
        self._x_after, self._cells_after = after.target.x.copy(), after.target.mesh.conn
        self._fields_after = cell_fields(after)
        self._impacts: list[_Written] = []

    def add(self, task: Task, cut: Cut, result: TaskResult, before: float) -> int:
        """The next impact. before: simulated time (s) of the impacts before it. Returns the elements of the whole after it."""
        met, left = task.bodies.target, result.bodies.target
        more = len(left.nodes.x) - len(met.nodes.x), len(left.elements.T) - len(met.elements.T)
        numbers = met.nodes.node_number, met.elements.element_number
        self._impacts.append(_Written(task.folder, result.store, *numbers, cut.nodes, more, before))
        return len(self._cells) + sum(each.more[1] for each in self._impacts)

    def write(self, store: Store) -> None:
        """Append what the tasks have written to the files of the run, their targets as parts of the whole."""
        for each in self._impacts:
            self._append(store, each)
            self._go_on(each)

    def _append(self, store: Store, part: _Written) -> None:
        own = Result(part.folder)
        for row in part.store.history:
            values = dict(zip(part.store.columns, row.tolist(), strict=True))
            store.record({**values, "time": part.before + values["time"]})
        for domain, steps in part.store.steps.items():
            for step in range(steps):
                fields = own.fields(step, domain)
                points, cells, (at_points, inside) = fields.points, fields.cells, fields.split()
                if domain == "target":
                    points, cells = self._points.copy(), self._cells
                    points[part.nodes] = fields.points
                    velocity = np.zeros_like(points)
                    velocity[part.nodes] = at_points["velocity"]
                    whole = {name: values.copy() for name, values in self._fields.items()}
                    for name in inside.keys() - {"body"}:
                        whole[name][part.elements] = inside[name]
                    at_points, inside = {"velocity": velocity}, whole
                store.write(domain, part.before + fields.time, points, cells, at_points, inside)

    def _go_on(self, part: _Written) -> None:
        """Go on to the next impact: a task has changed its cut, and its splat is the next one of the bodies after the batch."""
        n, m = len(self._points), len(self._cells)
        changed = np.zeros(n, bool)
        changed[part.changed] = True
        near = changed[self._cells].any(axis=1)  # pressures are of nodes
        self._points[part.changed] = self._x_after[part.changed]
        self._points = np.concatenate([self._points, self._x_after[n : n + part.more[0]]])
        self._cells = self._cells_after[: m + part.more[1]]
        for name, values in self._fields.items():
            now = self._fields_after[name][: m + part.more[1]]
            self._fields[name] = np.concatenate([values, now[m:]])
            self._fields[name][:m][near] = now[:m][near]


def clear(folder: Path, impacts: int | None = None) -> None:
    """Remove the folders of the tasks of a run: of its first so many impacts, or all."""
    if impacts is None:
        shutil.rmtree(folder / TASKS, ignore_errors=True)
        return
    for own in (folder / TASKS).glob("[0-9]*"):
        if int(own.stem) > impacts:
            continue
        if own.is_dir():
            shutil.rmtree(own, ignore_errors=True)
        else:
            own.unlink(missing_ok=True)
