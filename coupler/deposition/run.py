"""From a scene to a result: run, resume, and the impacts one after another."""

import hashlib
import os
import time as clock
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from numba.core import event

from .. import __version__, report
from ..errors import CheckpointError, is_first_rank
from ..files import checkpoint
from ..files.provenance import command, provenance
from ..files.result import COLD, Result
from ..files.store import PICTURE, Store, StoreState
from ..files.summary import Summary, Values, problem_of
from ..impact.bodies import Bodies, BodiesState
from ..impact.domains import build_particle, build_target, restored_target
from ..impact.exchange import Impact
from ..impact.recorder import VTK_ORDER, cell_fields
from ..impact.run import RunningState, RunOptions, run_impact
from ..impact.summary import ImpactRecord
from ..measures import UNDECIDED
from ..plan.planning import CONTACT_STIFFNESS, Plan, plan
from ..plan.reading import Scene
from ..plan.record import plan_text, read_plan
from ..plan.text import describe
from ..progress import Progress
from ..ranks import ranks as parallel
from .joining import join, splats_at_end
from .pause import cool_to_ambient
from .summary import simulated, summary

CHECKPOINT_EVERY = 60.0  # s of wall time

Probe = Callable[[Impact], None]


def run(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    force: bool = False,
    progress: Progress | None = None,
    quiet: bool = False,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
    placement: str | None = None,
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
) -> Result:
    """Compute a scene (a Scene or the path of one) and return its Result.

    out: folder for the files, runs/<scene name> by default. force: replace a finished run there. progress: told how far it is; a bar
    or lines on standard error by default, nothing with quiet. threads: 2 computes the target beside the particle on a second core, 1
    in turn with it (default: 2 where there are two cores); the numbers are the same. numerics: for studies of the scheme, values in
    place of the defaults of `coupler.sph.particle.Numerics`. probe(impact): called after every few steps with the
    `impact.exchange.Impact`, on the rank that has the target. checkpoint_every: s of wall time.

    Started by mpiexec, all ranks call it; placement: "split" (the default: the particle on all ranks but the last, the target
    there) or "spread" (the particle on all). Raises SceneError, StoreError, PlacementError or SolverError, on all ranks;
    whatever was written before an error or an interrupt stays readable.
    """
    scene = scene if isinstance(scene, Scene) else Scene.load(scene)
    folder = Path(out) if out is not None else Path("runs") / scene.name
    knobs = dict(numerics or {})
    decided = plan(scene, knobs.pop("contact_stiffness", CONTACT_STIFFNESS))
    options = _options(folder, progress or Progress(quiet), threads, knobs, placement, probe, checkpoint_every)
    deposition = Deposition(decided, folder, options)
    return deposition.run(lambda: Store.create(folder, scene.to_toml(), force, plan_text(decided)))


def resume(
    out: str | Path,
    *,
    progress: Progress | None = None,
    quiet: bool = False,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
    placement: str | None = None,
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    until: float | None = None,
) -> Result:
    """Go on with the unfinished run in a folder from its last whole checkpoint, or from its start if there is none.

    The number of ranks and their placement may differ from before. A finished run is returned as it is; an undecided one goes on: its
    last impact until `until` (s, of that impact), or for as long again as it has had. One whose end criterion is met and whose verdict
    is undecided goes on where `until` is said. Arguments and errors as for `run`; raises
    CheckpointError for a checkpoint of another version or another scene, or where `until` has passed.
    """
    folder = Path(out)
    result = Result(folder)
    if result.finished and not result.undecided and (until is None or result.has_verdict):
        _complete(result)
        return result
    if result.finished and until is not None and until <= float(result.end["time_s"]):
        raise CheckpointError(
            f"impact {len(result.impacts)} has come to {float(result.end['time_s']) * 1e9:.4g} ns: give a later time"
        )
    decided = read_plan(folder)
    knobs = {name: value for name, value in (numerics or {}).items() if name != "contact_stiffness"}  # in the plan
    options = _options(folder, progress or Progress(quiet), threads, knobs, placement, probe, checkpoint_every, until)
    return Deposition(decided, folder, options).run()


def _complete(result: Result) -> None:
    """Do what a run does after its summary, where it was ended before."""
    if is_first_rank():
        if result.has_verdict:
            checkpoint.clear(result.directory)
        if not (result.directory / PICTURE).exists():
            report.section_picture(result)


def _options(
    folder: Path,
    progress: Progress,
    threads: int | None,
    numerics: dict[str, float],
    placement: str | None,
    probe: Probe | None,
    checkpoint_every: float,
    until: float | None = None,
) -> RunOptions:
    """What the caller of `run` or `resume` has asked for, on the ranks there are."""
    ranks = parallel.arrange(parallel.world(), placement)
    threads = (threads or cores()) if ranks.size == 1 else 1
    return RunOptions(progress, folder / "log.lammps", ranks, threads, numerics, probe, checkpoint_every, until)


@dataclass(frozen=True)
class DepositionState:
    """What a checkpoint holds: an impact on its way or, between two of them, the bodies; how much of the files is written; records and
    reports of the finished impacts; wall time so far, s."""

    running: RunningState | None
    bodies: BodiesState | None
    store: StoreState
    records: list[ImpactRecord]
    joins: list[Values]
    wall: float


class Deposition:
    """Impacts one after another: each takes a target and leaves one with a splat more. All ranks make one and run it."""

    def __init__(self, plan: Plan, folder: Path, options: RunOptions):
        self.plan, self.folder, self.options = plan, folder, options
        self._started, self._before = clock.perf_counter(), 0.0
        self.records: list[ImpactRecord] = []  # of the finished impacts
        self.joins: list[Values] = []  # reports of the joining of their splats
        self.closing: Values | None = None  # report of the closing stage

    @property
    def wall(self) -> float:
        """Wall time so far, s, that before a resumption included."""
        return self._before + clock.perf_counter() - self._started

    @property
    def undecided(self) -> bool:
        """Whether the last impact so far has ended without its end criterion."""
        return self.records[-1].values["undecided"] is not None

    def run(self, create: Callable[[], Store] | None = None) -> Result:
        """Compute all impacts and write summary.json and the picture. create: makes the folder's files; None: go on with those that
        are there, and with the impacts that its checkpoint has not seen finished."""
        plan, options, ranks = self.plan, self.options, self.options.ranks
        if not ranks.is_root:
            parallel.follow(
                ranks, lambda i, place: build_particle(plan, i, place, ranks, options.numerics, options.log_file)
            )
            return Result(self.folder)
        with (
            parallel.leading(ranks),
            create() if create is not None else Store.reopen(self.folder) as self.store,
            _logged(options.progress, self.store),
        ):
            options.progress.record(f"coldspray {__version__}: {command()}\n{describe(plan)}")
            scene = (Result(self.folder).scene_text + plan_text(plan)).encode()
            self._belongs_to = {
                "version": __version__, "scene": hashlib.sha256(scene).hexdigest(),
                "numerics": repr(sorted(options.numerics.items())),
            }  # fmt: skip
            options.progress.stage("meshing the target")
            bodies, running = (build_target(plan), None) if create is not None else self._restored()
            for i in range(len(self.records), len(plan.impacts)):
                before, outcome = simulated(self.records), None
                try:
                    outcome = run_impact(plan, i, bodies, self.store, before, options, self._save_within, running)
                    bodies, running = outcome.domains.bodies, None
                    self.records.append(outcome.record)
                    is_last = i + 1 == len(plan.impacts)
                    if self.undecided or (is_last and plan.ambient is None):
                        break  # what comes next has no target at rest; the checkpoint stays, and a resumption goes on
                    bodies, joined = join(plan, i, outcome.domains, options.progress, outcome.hold)
                    self.joins.append(joined)
                    if is_last:
                        self._close(bodies)
                        break
                finally:
                    if outcome is not None:
                        outcome.domains.particle.close()
                self._save(None, bodies.state())
            origin = provenance(Result(self.folder).scene_text, plan.engine)
            self.store.finish({**self._summary(bodies), "provenance": origin})
            if not self.undecided and self.records[-1].values["verdict"] != UNDECIDED:
                checkpoint.clear(self.folder)
            result = Result(self.folder)
            options.progress.stage("drawing the section", of_impact=False)
            report.section_picture(result)
            options.progress.record(report.screen(result, verbose=True))
        return result

    def _close(self, bodies: Bodies) -> None:
        """The closing stage: the bodies cool to ambient, come to equilibrium and are written."""
        self.options.progress.stage("cooling to ambient")
        counts = [join["bodies"] for join in self.joins]
        self.closing = cool_to_ambient(self.plan, bodies, counts, self.records[-1].values["kinetic_energy_0_J"])
        t = bodies.target
        thermal = {"thermal_stress": t.thermal_stress[:, VTK_ORDER], **cell_fields(bodies)}
        self.store.write(COLD, simulated(self.records), t.x, t.mesh.conn, {}, thermal)

    def _restored(self) -> tuple[Bodies, RunningState | None]:
        """The bodies that the last whole checkpoint holds, and the impact that was interrupted, or None; from the start without one."""
        state = self._last_checkpoint()
        if state is None:
            return build_target(self.plan), None
        self.records, self.joins, self._before, running = state.records, state.joins, state.wall, state.running
        kept = running.impact.bodies if running is not None else state.bodies
        if kept is None or not len(self.joins) == len(self.records) < len(self.plan.impacts):
            raise CheckpointError(f"the checkpoint in {self.folder} is damaged: start anew with coldspray run --force")
        bodies = restored_target(self.plan, kept)
        self._check_records(bodies)
        return bodies, running

    def _check_records(self, bodies: Bodies) -> None:
        """Raise CheckpointError where the records of a checkpoint are not those of finished impacts: they make no summary."""
        try:
            if self.records and (problem := problem_of(self._summary(bodies))) is not None:
                raise ValueError(problem)
        except (KeyError, ValueError, TypeError, AttributeError, IndexError, ZeroDivisionError) as error:
            raise CheckpointError(
                f"the checkpoint in {self.folder} is damaged (its records: {type(error).__name__} {error}): start anew with"
                " coldspray run --force"
            ) from error

    def _summary(self, bodies: Bodies) -> Summary:
        """The summary of the impacts so far, whose splats are `bodies`."""
        levels = [record.values["surface_level_m"] for record in self.records]
        standing = splats_at_end(self.plan, levels, self.joins, bodies)
        return summary(self.plan, self.records, self.joins, standing, self.wall, self.options.ranks, self.closing)

    def _last_checkpoint(self) -> DepositionState | None:
        """State of the last whole checkpoint, the files brought to its moment; None if there is none."""
        log, folder = self.options.progress.log, self.folder
        state = checkpoint.latest(folder, DepositionState, self._belongs_to, log)
        if state is None:
            log(f"{folder} has no checkpoint: the run starts from its beginning")
        self.store.go_on(state.store if state else None, log)
        return state

    def _save_within(self, running: RunningState) -> None:
        """Write a checkpoint of an impact on its way, which holds its bodies."""
        self._save(running, None)

    def _save(self, running: RunningState | None, bodies: BodiesState | None) -> None:
        state = DepositionState(running, bodies, self.store.state(), self.records, self.joins, self.wall)
        checkpoint.write(self.folder, state, self._belongs_to)


@contextmanager
def _logged(progress: Progress, store: Store) -> Iterator[None]:
    """Within it, the run's log file takes what the progress shows, and the error that ends the run; kernels that are compiled are a
    stage of the progress."""
    compiling = _Compiling(progress)
    progress.record = store.log
    event.register("numba:compile", compiling)
    try:
        yield
    except BaseException as error:
        progress.record(f"{type(error).__name__}: {error}")
        raise
    finally:
        event.unregister("numba:compile", compiling)
        progress.stop()
        progress.record = lambda text: None


class _Compiling(event.Listener):
    """Shows that kernels are compiled, where the cache does not have them."""

    def __init__(self, progress: Progress):
        self.progress = progress

    def on_start(self, event: event.Event) -> None:
        self.progress.stage("compiling the kernels, once on this machine")

    def on_end(self, event: event.Event) -> None:
        pass


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0))
