"""The two main functions: `run` computes a scene, `resume` continues an unfinished run. Both return the result."""

import math
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from numba.core import event

from .. import __version__, report
from ..core.process import cores, interrupted_by
from ..core.threads import threads_of
from ..errors import CheckpointError, is_first_rank
from ..files import checkpoint
from ..files.provenance import command
from ..files.result import Result
from ..files.store import PICTURE, Store, WithoutFields, locked
from ..impact.domains import build_particle
from ..impact.loop import Probe
from ..impact.run import RunOptions
from ..particle.start import whole_process
from ..plan.planning import Plan, plan
from ..plan.reading import Scene
from ..plan.record import plan_text, read_plan
from ..plan.text import describe
from ..progress import Progress
from ..ranks import ranks as parallel
from .batches import workers
from .error import Companions
from .fold import Deposition

CHECKPOINT_EVERY = 60.0  # s of wall time
FEW_POINTS = 2000  # for fewer points a second thread saves little time (docs/evidence/speed.md)
POINTS_OF_THREAD = 250  # least points for each thread: to wake a thread in every step takes about 10 us


def run(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    force: bool = False,
    progress: Progress | None = None,
    quiet: bool = False,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    skip_failed: bool = False,
    jobs: int = 1,
    error: bool | None = None,
) -> Result:
    """Compute a scene (a Scene or its path). Returns its Result.

    out: folder for the files; default: runs/<scene name>. force: replace a finished run there. progress: receives the progress;
    default: a bar or lines on standard error, nothing with quiet. threads: number of threads that share the loops of a step;
    default: from the numbers of cores and points. numerics: values that replace defaults of `coupler.particle.particle.Numerics`, for
    studies of the scheme. probe(impact): called after each chunk of steps with the `impact.exchange.Impact`, on the rank that has the
    target. checkpoint_every: wall time between checkpoints, s. skip_failed: leave out an impact that fails or is undecided; only for
    a scene of several impacts on one MPI rank. jobs: how many impacts of a batch (`plan.batches`) are computed at the same time, each
    in its own process. The results do not depend on threads and jobs. error: compute coarser runs, which give the error of each
    measure; None: as the scene says, by default not.

    With mpiexec all ranks call this function: the last rank has the target, the others share the particle. Raises SceneError,
    StoreError, SolverError or NoContactError, on all ranks; files written before an error or an interrupt stay readable.
    """
    scene = scene if isinstance(scene, Scene) else Scene.load(scene)
    folder = Path(out) if out is not None else Path("runs") / scene.name
    knobs = dict(numerics or {})
    decided = plan(scene, knobs.pop("contact_stiffness", None), scene.resolution.error if error is None else error)
    asked = {"numerics": knobs, "probe": probe, "checkpoint_every": checkpoint_every, "skip_failed": skip_failed}
    options = _options(decided, folder, progress, quiet, threads, **asked, jobs=jobs)
    companions = Companions(decided, folder, knobs, _alone)

    def create() -> Store:
        store = Store.create(folder, scene.to_toml(), force, plan_text(decided))
        companions.begin(on_another_core=options.ranks.size == 1 and cores() > max(options.threads, options.jobs))
        return store

    try:
        return _complete(deposit(decided, folder, options, create), companions, options)
    finally:
        companions.end()


def _alone(scene: Scene, folder: Path, contact_stiffness: float, numerics: Mapping[str, float], threads: int) -> None:
    """Compute a scene in this process, and write only its summary."""
    decided, quiet = plan(scene, contact_stiffness), Progress(quiet=True)
    options = RunOptions(quiet, folder / "log.lammps", threads=threads, numerics=numerics, checkpoint_every=math.inf)
    create = partial(WithoutFields.create, folder, scene.to_toml(), force=True, plan_json=plan_text(decided))
    deposit(decided, folder, options, create)


def resume(
    out: str | Path,
    *,
    progress: Progress | None = None,
    quiet: bool = False,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    until: float | None = None,
    skip_failed: bool = False,
    jobs: int = 1,
    error: bool = True,
) -> Result:
    """Continue the unfinished run in a folder from its last complete checkpoint; if there is none, from the start of the run.

    The number of ranks may change. A finished run is returned unchanged. An undecided run continues its last impact until `until` (s,
    time of this impact); by default the time limit is doubled. A run that met its end criterion without a verdict
    (`Result.at_own_end`) continues only with `until`. error: compute coarser runs if the run was started with `error`. Other arguments
    and errors as for `run`; also raises CheckpointError for a checkpoint of another version or scene, or if `until` is already reached.
    """
    folder = Path(out)
    result = Result(folder)
    knobs = {name: value for name, value in (numerics or {}).items() if name != "contact_stiffness"}  # in the plan
    decided = read_plan(folder)
    asked = {"numerics": knobs, "probe": probe, "checkpoint_every": checkpoint_every, "skip_failed": skip_failed}
    options = _options(decided, folder, progress, quiet, threads, **asked, jobs=jobs, until=until)
    if result.finished and not result.undecided and (until is None or result.has_verdict):
        measured = not error or "error" in result.summary["run"] or not result.plan.get("companions")
        return _complete(result, None if measured else Companions(decided, folder, knobs, _alone), options)
    if result.finished and until is not None and until <= float(result.end["time_s"]):
        raise CheckpointError(
            f"impact {len(result.impacts)} is already computed up to {float(result.end['time_s']) * 1e9:.4g} ns:"
            f" give a later time with --until"
        )
    if until is not None and not (result.finished and checkpoint.stored(folder)):
        begun = "is not finished: first resume it without --until"
        why = "has no checkpoint: compute the scene again with a larger end.time" if result.finished else begun
        raise CheckpointError(f"{folder} {why}")
    companions = Companions(decided, folder, knobs, _alone) if error else None
    return _complete(deposit(decided, folder, options), companions, options)


def deposit(plan: Plan, folder: Path, options: RunOptions, create: Callable[[], Store] | None = None) -> Result:
    """Compute all impacts of a plan and write the summary. create: makes the files of the folder; None: continue from the files and the
    checkpoint there. All ranks call this function."""
    ranks = options.ranks
    if not ranks.is_root:
        with threads_of(options.threads):
            parallel.serve(
                ranks, lambda i, place, numerics: build_particle(plan, i, place, ranks, numerics, options.log_file)
            )
        return Result(folder)
    with (
        whole_process(),
        interrupted_by(signal.SIGTERM),
        parallel.leading(ranks),
        create() if create is not None else Store.reopen(folder) as store,
        logged(options.progress, store),
        threads_of(options.threads),
        workers(plan, options, folder) as pool,
    ):
        options.progress.record(f"coldspray {__version__}: {command()}\n{describe(plan)}")
        options.progress.stage("meshing the target")
        deposition = Deposition(plan, folder, options, store, pool)
        target = deposition.substrate() if create is not None else deposition.restored()
        try:
            while (batch := deposition.next_batch()) is not None:
                splats = deposition.compute(batch, target)
                target = deposition.rest(batch, target, splats)
        finally:
            deposition.write_files()  # also after an error: the results so far are readable
        deposition.finish(deposition.cool(target))
    return Result(folder)


@contextmanager
def logged(progress: Progress, store: Store) -> Iterator[None]:
    """Context that writes all lines of the progress, and an error that ends the run, to the log file of the run. The compilation of
    kernels is shown as a stage of the progress."""
    progress.record = store.log
    try:
        with event.install_listener("numba:compile", _Compiling(progress)):
            yield
    except KeyboardInterrupt as stop:
        by = f"the signal {signal.Signals(stop.args[0]).name}" if stop.args else "the user"
        progress.record(f"stopped by {by}")
        raise
    except BaseException as error:
        progress.record(f"{type(error).__name__}: {error}")
        raise
    finally:
        progress.stop()
        progress.record = lambda text: None


class _Compiling(event.TimingListener):
    """Shows the compilation of kernels as a stage, and records its duration."""

    def __init__(self, progress: Progress):
        super().__init__()
        self.progress = progress

    def on_start(self, event: event.Event) -> None:
        self.progress.stage("compiling the kernels (only once on this machine)")
        super().on_start(event)

    def on_end(self, event: event.Event) -> None:
        super().on_end(event)
        if self.done:
            self.progress.compiling = self.duration


def _complete(result: Result, companions: Companions | None, options: RunOptions) -> Result:
    """After the summary: clear checkpoints if there is a verdict, draw the cross-section, measure the error. Returns the new Result."""
    if not is_first_rank():
        return result
    if result.has_verdict and not result.undecided:
        checkpoint.clear(result.directory)
    with locked(result.directory), interrupted_by(signal.SIGTERM), options.progress:
        if not (result.directory / PICTURE).exists():
            options.progress.stage("drawing the cross-section", of_impact=False)
            report.section_picture(result)
        if companions is not None and companions.plan.companions and not result.undecided:
            options.progress.stage("measuring the error with coarser runs of the scene", of_impact=False)
            companions.measure(options.threads)
    return Result(result.directory)


def _options(
    plan: Plan, folder: Path, progress: Progress | None, quiet: bool, threads: int | None, jobs: int, **asked: Any
) -> RunOptions:
    """Options of a run from the arguments of `run` or `resume` and the number of ranks."""
    ranks = parallel.arrange()
    if threads is None:
        points = max(impact.points for impact in plan.impacts)
        free = cores() // ranks.size
        if plan.companions and ranks.size == 1 and (points <= FEW_POINTS or free > 2):
            free -= 1  # for the coarser runs
        threads = max(min(free, points // POINTS_OF_THREAD), 1)
    asked["jobs"] = max(min(jobs, len(plan.impacts)), 1)
    return RunOptions(progress or Progress(quiet), folder / "log.lammps", ranks, threads, **asked)
