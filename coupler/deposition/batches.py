"""The impacts of a batch, computed at the same time in processes, each on its own sub-domain of the target (`target.cut`)."""

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.executors import executor
from ..errors import ColdsprayError
from ..impact.run import RunOptions
from ..impact.stop import Stopped, stop_signals
from ..plan.batches import Batch
from ..plan.cost import forecast
from ..plan.planning import Plan
from ..target.bodies import Bodies
from ..target.cut import Cut, cut_out
from ..target.positions import points_of_impact
from .task import SPARE, STOP, Task, TaskResult, run_alone

TASKS = "impacts"  # folder of the tasks, in the folder of the run
_POLL = 0.5  # s between two checks for a signal


@dataclass(frozen=True)
class Done:
    """A finished task. cut: its sub-domain; result: its result, or its error if it failed."""

    task: Task
    cut: Cut
    result: TaskResult | ColdsprayError

    @property
    def of(self) -> TaskResult:
        """The result of the task. Raises the error of a task that failed."""
        if isinstance(self.result, ColdsprayError):
            raise self.result
        return self.result


@contextlib.contextmanager
def workers(plan: Plan, options: RunOptions, folder: Path) -> Iterator[Executor | None]:
    """Context with the executor for batches; None if all impacts are computed in this process."""
    widest = max(batch.stop - batch.first for batch in plan.batches)
    if min(options.jobs, widest) == 1 or options.ranks.size > 1 or options.probe is not None:
        yield None
        return
    with executor("processes", min(options.jobs, widest), folder) as pool:
        yield pool


def tasks(
    plan: Plan, batch: Batch, whole: Bodies, folder: Path, about: Mapping[str, str]
) -> Iterator[tuple[Task, Cut]]:
    """The impacts of a batch with their sub-domains. An impact whose sub-domain shares a node with an earlier one is left out, and all
    after it. whole: full domain; folder: that of the run; about: as in `Task`. A generator: each sub-domain is made on request."""
    occupied = np.zeros(len(whole.target.nodes.x), bool)
    indices = range(batch.first, batch.stop)
    places = points_of_impact(whole, [plan.impacts[i].offset for i in indices])
    for i, place in zip(indices, places, strict=True):
        part, cut = cut_out(whole, place, plan.impacts[i].window)
        if occupied[cut.nodes].any():
            break
        occupied[cut.nodes] = True
        own = folder / TASKS / f"{i + 1:05d}"
        yield Task(plan, i, part.state(), place, 0.0, None, own, {**about, "impact": str(i + 1)}), cut


def side_by_side(
    pool: Executor, found: Iterator[tuple[Task, Cut]], folder: Path, options: RunOptions, meanwhile: Callable[[], None]
) -> list[Done]:
    """Compute the tasks `found` in parallel processes. Returns the finished tasks, in their order.

    Each task starts as soon as its sub-domain is made. The running tasks share the threads of the run. When tasks end, the file SPARE
    contains a greater number of threads for each of the others. The file STOP stops all tasks. meanwhile(): called once while the
    tasks run. Raises Stopped after a signal to this process, ColdsprayError if a process of the pool is killed.
    """
    begun = list[tuple[Task, Cut, Future[TaskResult | ColdsprayError]]]()
    stop, spare = folder / STOP, folder / SPARE
    threads = max(options.threads // options.jobs, 1)
    for file in (stop, spare):
        file.unlink(missing_ok=True)
    with stop_signals() as signals:
        try:
            for task, cut in found:
                of_run = dict(options.numerics), options.checkpoint_every, options.until
                future = pool.submit(run_alone, task, *of_run, threads)
                begun.append((task, cut, future))
            first, last = begun[0][0].i + 1, begun[-1][0].i + 1
            before = forecast(begun[0][0].plan).shares[first - 1][0]
            options.progress.stage(f"impacts {first} to {last} at the same time", of_impact=False, done=before)
            meanwhile()
            while left := [future for _, _, future in begun if not future.done()]:
                if options.threads // len(left) > threads:
                    threads = options.threads // len(left)
                    spare.write_text(str(threads))
                wait(left, _POLL, FIRST_COMPLETED)
                if signals and not stop.exists():
                    stop.touch()
            if signals:
                raise Stopped(signals[0])
            return [Done(task, cut, future.result()) for task, cut, future in begun]
        except BrokenExecutor as error:
            which = f"impacts {begun[0][0].i + 1} to {begun[-1][0].i + 1}" if begun else "impacts"
            raise ColdsprayError(
                f"a process that computed {which} was killed, perhaps because memory ran out. The results so far are"
                f" stored: continue with coldspray resume {folder.parent}, with fewer --jobs if memory is short"
            ) from error
        except BaseException:
            with contextlib.suppress(OSError):
                stop.touch()  # workers end with a checkpoint
            raise


def clear(folder: Path, impacts: int | None = None) -> None:
    """Remove the folders of the tasks of a run. impacts: only the folders of the first `impacts` impacts; None: all."""
    if impacts is None:
        shutil.rmtree(folder / TASKS, ignore_errors=True)
        return
    for own in (path for path in (folder / TASKS).glob("[0-9]*") if int(path.stem) <= impacts):
        if own.is_dir():
            shutil.rmtree(own, ignore_errors=True)
        else:
            own.unlink(missing_ok=True)
