"""One impact on its sub-domain of the target, computed in any process; it continues from its last checkpoint."""

import math
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.threads import at_least, threads_of
from ..errors import ColdsprayError, NoContactError, SolverError
from ..files import checkpoint
from ..files.store import Store, StoreState
from ..files.summary import Values
from ..impact.domains import restored_target
from ..impact.run import RunningState, RunOptions, run_impact
from ..impact.summary import ImpactRecord
from ..particle.inertia import ENOUGH
from ..plan.planning import Plan
from ..progress import Progress
from ..target.bodies import Bodies, BodiesState
from ..target.domain import Point
from .joining import join

# files beside the folders of tasks; running tasks check them after each chunk of steps
STOP = "stop"  # the tasks stop
SPARE = "spare"  # number of threads for each task, greater when cores are idle
SPRINGS = 2.5  # time step with which contact springs must be stable, divided by the step that is enough for a particle (ENOUGH)


@dataclass(frozen=True)
class Task:
    """Impact i of a plan on a sub-domain. bodies: bodies of the sub-domain, numbered outwards from the impact point `place`, m.

    before: simulated time of the earlier impacts in its files, s; written: state of these files at the start, None for new files;
    folder: for its own files; about: data that identify its checkpoints (`files.checkpoint`).
    """

    plan: Plan
    i: int
    bodies: BodiesState
    place: Point
    before: float
    written: StoreState | None
    folder: Path
    about: Mapping[str, str]


@dataclass(frozen=True)
class TaskResult:
    """Result of a task. bodies: bodies with the new splat, at rest. If the impact is undecided, or is the last of a plan without
    closing stage, they are the bodies at the end of the impact, and `joined` is empty. record: record of the impact; prepared, joined:
    reports of `prepare` and `join`; store: state of the files."""

    bodies: BodiesState
    record: ImpactRecord
    prepared: Values
    joined: Values
    store: StoreState


@dataclass(frozen=True)
class TaskState:
    """Checkpoint of a task. running: state of the impact, None if it cannot continue; result: None before the end of the impact."""

    running: RunningState | None
    store: StoreState
    result: TaskResult | None


@dataclass(frozen=True)
class TaskFiles:
    """Output files of a task. kept: its last checkpoint, or None; store: result files, set back to the time of `kept`; save:
    function that writes a checkpoint."""

    store: Store
    kept: TaskState | None
    save: Callable[[TaskState], object]


@contextmanager
def own_files(task: Task, log: Callable[[str], None]) -> Iterator[TaskFiles]:
    """Context manager: the files of a task, in the folder of this task."""
    kept = checkpoint.latest(task.folder, TaskState, task.about, log) if task.folder.is_dir() else None
    with Store.create(task.folder, "", force=True) if kept is None else Store.reopen(task.folder) as store:
        if kept is not None:
            store.go_on(kept.store, log)
        yield TaskFiles(store, kept, lambda state: checkpoint.write(task.folder, state, task.about))


def run_task(task: Task, options: RunOptions, files: TaskFiles) -> TaskResult:
    """Compute a task, or return the result in its files. An undecided impact continues; with `options.until` also the
    last one of the plan without a verdict. Raises as `run_impact` and `join`."""
    plan, i, store, kept = task.plan, task.i, files.store, files.kept
    if kept is not None and kept.result is not None:
        is_undecided = kept.result.record.values["undecided"] is not None
        goes_on = is_undecided or (options.until is not None and i + 1 == len(plan.impacts))
        if kept.running is None or not goes_on:
            return kept.result
    last = kept.running if kept is not None else None
    bodies = restored_target(plan, task.bodies)
    prepared = prepare(plan, i, bodies, task.place)

    def save(state: RunningState) -> None:
        nonlocal last
        last = state
        files.save(TaskState(state, store.state(), None))

    impact, record = run_impact(plan, i, bodies.state(), task.written, store, task.before, options, save, last)
    try:
        after, joined = impact.bodies, Values()
        undecided = record.values["undecided"] is not None
        if not undecided and not (i + 1 == len(plan.impacts) and plan.ambient is None):
            after, joined = join(impact, record.values, options.progress, task.place)
    finally:
        impact.particle.close()
    result = TaskResult(after.state(), record, prepared, joined, store.state())
    can_continue = undecided or record.values["rebounded"] is None
    if joined or can_continue:  # else the run ends here
        files.save(TaskState(last if can_continue else None, store.state(), result))
    return result


def attempt(task: Task, options: RunOptions, files: TaskFiles | None = None) -> TaskResult | ColdsprayError:
    """The result of `run_task`, or the error if the impact fails. files: output files; None: the files in the folder of the task."""
    try:
        with own_files(task, options.progress.log) if files is None else nullcontext(files) as own:
            return run_task(task, options, own)
    except (SolverError, NoContactError) as error:
        return error


def run_alone(
    task: Task, numerics: Mapping[str, float], every: float, until: float | None, threads: int
) -> TaskResult | ColdsprayError:
    """Result of `attempt` in a process of an executor. numerics, every (s between checkpoints), until, threads: as in `RunOptions`."""
    stop, spare = task.folder.parent / STOP, task.folder.parent / SPARE

    def check(_: object) -> None:
        if stop.exists():
            signal.raise_signal(signal.SIGTERM)  # the impact writes a checkpoint and ends with `Stopped`
        if spare.exists():
            at_least(int(spare.read_text() or 1))  # the file is empty while it is written

    options = RunOptions(
        Progress(True), task.folder.parent / f"{task.folder.name}.log", numerics=numerics, probe=check, checkpoint_every=every,
        until=until, threads=threads,
    )  # fmt: skip
    with threads_of(options.threads):
        return attempt(task, options)


def prepare(plan: Plan, i: int, bodies: Bodies, place: Point) -> Values:
    """Prepare bodies at rest for impact i, so that its cost does not grow with the number of earlier impacts. place: impact point, m,
    from which nodes and elements are numbered outwards. Returns entries of the report.

    A few strongly deformed elements of splats would determine the time step of all later impacts: inertia is added to their
    deformation (`fe.inertia`). The lightest surface nodes get mass, so that the contact springs are stable with a larger time step.
    The domain far from the impact is not computed: it is in equilibrium and acts as an elastic body (`Target.set_window`).
    """
    report: Values = {}
    if i and plan.mass_scaling:
        p = plan.impacts[i]
        most = plan.mass_scaling * p.rho * math.pi / 6.0 * p.diameter**3
        bodies.target.inertia.most = most
        if bodies.contact is not None:
            step = SPRINGS * ENOUGH * p.spacing / p.wave_speed
            report["added_mass_kg"] = bodies.target.weigh_surface(bodies.contact.pairs.mass_for(step), most)
    within = bodies.target.set_window(plan.impacts[i].window, np.array(place))
    if within < len(bodies.target.mesh.conn):
        report |= {"window_m": plan.impacts[i].window, "elements_in_window": within}
    return report
