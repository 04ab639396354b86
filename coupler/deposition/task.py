"""One impact on its cut of the target, in a folder of its own: a function for any process, which goes on where it has ended."""

import signal
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import ColdsprayError, NoContactError, SolverError
from ..fe.assemble import Point
from ..files import checkpoint
from ..files.store import Store, StoreState
from ..files.summary import Values
from ..impact.bodies import BodiesState
from ..impact.domains import restored_target
from ..impact.run import ImpactStart, RunningState, RunOptions, run_impact
from ..impact.summary import ImpactRecord
from ..plan.planning import Plan
from ..progress import Progress
from ..state.threads import add_second_thread, second_thread
from .joining import join
from .mass_scaling import prepare

# files beside the folders of tasks, which those that run look for at each window of steps
STOP = "stop"  # they stop
SPARE = "spare"  # cores are idle: each has a second thread from now on


@dataclass(frozen=True)
class Task:
    """Impact i of a plan on a cut: its bodies, numbered outwards from `place` (m). folder: for its files; about: what these belong to,
    as in `files.checkpoint`."""

    plan: Plan
    i: int
    bodies: BodiesState
    place: Point
    folder: Path
    about: Mapping[str, str]


@dataclass(frozen=True)
class TaskResult:
    """bodies: with the splat, at rest; as the impact has left them where it is undecided, or the last and its splat is not asked for:
    `joined` is empty then. record: of the impact; prepared, joined: reports of `mass_scaling.prepare` and of `join`; store: what is in
    its files."""

    bodies: BodiesState
    record: ImpactRecord
    prepared: Values
    joined: Values
    store: StoreState


@dataclass(frozen=True)
class TaskState:
    """What a checkpoint of a task holds: the impact on its way, where it may go on; the result, once there is one."""

    running: RunningState | None
    prepared: Values
    store: StoreState
    result: TaskResult | None


def run_task(task: Task, options: RunOptions) -> TaskResult:
    """Compute a task, or return the result that its folder holds; an impact that has ended undecided goes on.

    Raises what `run_impact` and `join` raise."""
    plan, i, log = task.plan, task.i, options.progress.log
    kept = checkpoint.latest(task.folder, TaskState, task.about, log) if task.folder.is_dir() else None
    if kept is not None and kept.result is not None:
        is_undecided = kept.result.record.values["undecided"] is not None
        if kept.running is None or not (is_undecided or options.until is not None):
            return kept.result
    running = kept.running if kept is not None else None
    with Store.create(task.folder, "", force=True) if kept is None else Store.reopen(task.folder) as store:
        if kept is not None:
            store.go_on(kept.store, log)
        bodies = restored_target(plan, task.bodies)
        prepared = prepare(plan, i, bodies, task.place)
        start = ImpactStart(bodies.state(), None)
        last = running

        def save(state: RunningState | None, result: TaskResult | None = None) -> None:
            nonlocal last
            last = state
            checkpoint.write(task.folder, TaskState(state, prepared, store.state(), result), task.about)

        outcome = run_impact(plan, i, start, store, 0.0, options, save, running)
        try:
            record, after = outcome.record, outcome.domains.bodies
            joined: Values = {}
            undecided = record.values["undecided"] is not None
            if not undecided and not (i + 1 == len(plan.impacts) and plan.ambient is None):
                after, joined = join(plan, i, outcome, options.progress, task.place)
        finally:
            outcome.domains.particle.close()
        result = TaskResult(after.state(), record, prepared, joined, store.state())
        save(last if undecided or record.values["rebounded"] is None else None, result)
    return result


def attempt(task: Task, options: RunOptions) -> TaskResult | ColdsprayError:
    """`run_task`; the error of an impact that fails."""
    try:
        return run_task(task, options)
    except (SolverError, NoContactError) as error:
        return error


def run_alone(
    task: Task, numerics: Mapping[str, float], every: float, until: float | None
) -> TaskResult | ColdsprayError:
    """`run_task` in a process of an executor; the error of an impact that fails."""
    stop, spare = task.folder.parent / STOP, task.folder.parent / SPARE

    def look(_: object) -> None:
        if stop.exists():
            signal.raise_signal(signal.SIGTERM)  # the impact writes a checkpoint and ends with `Stopped`
        if spare.exists():
            add_second_thread()  # it does not change the numbers

    options = RunOptions(
        Progress(True), task.folder.parent / f"{task.folder.name}.log", numerics=numerics, probe=look, checkpoint_every=every,
        until=until, threads=1,
    )  # fmt: skip
    with second_thread(options.threads):
        return attempt(task, options)
