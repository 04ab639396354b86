"""From a scene to a result: run, resume, and the impacts one after another."""

import hashlib
import os
import sys
import time as clock
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from .. import __version__
from ..errors import CheckpointError, ColdsprayError, is_first_rank
from ..files import checkpoint
from ..files.result import Result
from ..files.store import PICTURE, Store, StoreState
from ..files.summary import Summary, Values, problem_of
from ..impact.bodies import Bodies, BodiesState
from ..impact.domains import build_particle, build_target, restored_target
from ..impact.exchange import Impact
from ..impact.run import RunningState, RunOptions, run_impact
from ..impact.summary import ImpactRecord
from ..plan.planning import CONTACT_STIFFNESS, Plan, plan
from ..plan.reading import Scene
from ..plan.record import plan_text, read_plan
from ..progress import Progress
from ..ranks import ranks as parallel
from ..report import section_picture
from .joining import join, splats_at_end
from .summary import simulated, summary

CHECKPOINT_EVERY = 60.0  # s of wall time

Probe = Callable[[Impact], None]


def run(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    force: bool = False,
    progress: Progress | None = None,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
    placement: str | None = None,
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
) -> Result:
    """Compute a scene (a Scene or the path of one) and return its Result.

    out: folder for the files, runs/<scene name> by default. force: replace a finished run there. progress: told how
    far it is; see `coupler.progress`. threads: 2 computes the target beside the particle on a second core, 1 in
    turn with it (default: 2 where there are two cores); the numbers are the same. numerics: for studies of the
    scheme, values in place of the defaults of `coupler.sph.particle.Numerics`. probe(impact): called after every few steps
    with the `impact.exchange.Impact`, on the rank that has the target. checkpoint_every: s of wall time.

    Started by mpiexec, all ranks call it; placement: "split" (the default: the particle on all ranks but the last, the target
    there) or "spread" (the particle on all). Raises SceneError, StoreError, PlacementError or SolverError, on all ranks;
    whatever was written before an error or an interrupt stays readable.
    """
    scene = scene if isinstance(scene, Scene) else Scene.load(scene)
    folder = Path(out) if out is not None else Path("runs") / scene.name
    knobs = dict(numerics or {})
    decided = plan(scene, knobs.pop("contact_stiffness", CONTACT_STIFFNESS))
    requested = _Requested(progress, threads, knobs, placement, probe, checkpoint_every)
    return _compute(
        decided, folder, requested, lambda: Store.create(folder, scene.to_toml(), force, plan_text(decided))
    )


def resume(
    out: str | Path,
    *,
    progress: Progress | None = None,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
    placement: str | None = None,
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    until: float | None = None,
) -> Result:
    """Go on with the unfinished run in a folder from its last whole checkpoint, or from its start if there is none.

    The number of ranks and their placement may differ from before. A finished run is returned as it is; an undecided one goes on: its
    last impact until `until` (s, of that impact), or for as long again as it has had. Arguments and errors as for `run`; raises
    CheckpointError for a checkpoint of another version or another scene, or where `until` has passed.
    """
    folder = Path(out)
    result = Result(folder)
    if result.finished and not result.undecided:
        _complete(result)
        return result
    if result.undecided and until is not None and until <= float(result.end["time_s"]):
        raise CheckpointError(
            f"impact {len(result.impacts)} has come to {float(result.end['time_s']) * 1e9:.4g} ns: give a later time"
        )
    decided = read_plan(folder)
    knobs = {name: value for name, value in (numerics or {}).items() if name != "contact_stiffness"}  # in the plan
    requested = _Requested(progress, threads, knobs, placement, probe, checkpoint_every, until)
    return _compute(decided, folder, requested, None)


def _complete(result: Result) -> None:
    """Do what a run does after its summary, where it was ended before."""
    if is_first_rank():
        checkpoint.clear(result.directory)
        if not (result.directory / PICTURE).exists():
            section_picture(result)


@dataclass(frozen=True)
class _Requested:
    """What the caller of `run` or `resume` has asked for; only `numerics` changes the numbers."""

    progress: Progress | None
    threads: int | None
    numerics: dict[str, float]
    placement: str | None
    probe: Probe | None
    checkpoint_every: float
    until: float | None = None


def _compute(decided: Plan, folder: Path, requested: _Requested, create: Callable[[], Store] | None) -> Result:
    """Compute a plan into a folder. create: makes the folder's files; None: go on with those that are there."""
    ranks = parallel.arrange(parallel.world(), requested.placement)
    progress = requested.progress
    options = RunOptions(
        log=progress.log if progress is not None else _to_stderr,
        log_file=folder / "log.lammps",
        ranks=ranks,
        progress=progress,
        threads=(requested.threads or cores()) if ranks.size == 1 else 1,
        numerics=requested.numerics,
        probe=requested.probe,
        checkpoint_every=requested.checkpoint_every,
        until=requested.until,
    )
    if not ranks.is_root:
        parallel.follow(
            ranks, lambda i, place: build_particle(decided, i, place, ranks, requested.numerics, options.log_file)
        )
        return Result(folder)
    try:
        with create() if create is not None else Store.reopen(folder) as store:
            Deposition(decided, store, options).run(anew=create is not None)
        result = Result(folder)
        section_picture(result)
    except (ColdsprayError, KeyboardInterrupt) as error:
        parallel.dismiss(ranks, error)
        raise
    except BaseException:
        if ranks.size > 1:
            traceback.print_exc()
            parallel.abort(ranks.comm, "coldspray: the rank with the target failed; all ranks are stopped", 1)
        raise
    parallel.dismiss(ranks)
    return result


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
    """Impacts one after another, on the rank of the target: each takes a target and leaves one with a splat more."""

    def __init__(self, plan: Plan, store: Store, options: RunOptions):
        self.plan, self.store, self.options = plan, store, options
        scene = Result(store.directory).scene_text
        self._belongs_to = {
            "version": __version__, "scene": hashlib.sha256((scene + plan_text(plan)).encode()).hexdigest(),
            "numerics": repr(sorted(options.numerics.items())),
        }  # fmt: skip
        self._started, self._before = clock.perf_counter(), 0.0
        self.records: list[ImpactRecord] = []  # of the finished impacts
        self.joins: list[Values] = []  # reports of the joining of their splats

    @property
    def wall(self) -> float:
        """Wall time so far, s, that before a resumption included."""
        return self._before + clock.perf_counter() - self._started

    @property
    def undecided(self) -> bool:
        """Whether the last impact so far has ended without its end criterion."""
        return self.records[-1].values["undecided"] is not None

    def run(self, anew: bool) -> None:
        """Compute all impacts, or those that a checkpoint has not seen finished, and write summary.json."""
        state = None if anew else self._last_checkpoint()
        running = None  # the impact that was interrupted
        if state is None:
            bodies = build_target(self.plan)
        else:
            self.records, self.joins, self._before, running = state.records, state.joins, state.wall, state.running
            kept = running.impact.bodies if running is not None else state.bodies
            if kept is None or not len(self.joins) == len(self.records) < len(self.plan.impacts):
                raise CheckpointError(
                    f"the checkpoint in {self.store.directory} is damaged: start anew with coldspray run --force"
                )
            bodies = restored_target(self.plan, kept)
            self._check_records(bodies)
        for i in range(len(self.records), len(self.plan.impacts)):
            bodies = self._impact(i, bodies, running)
            running = None
            if self.undecided:
                break  # what comes next has no target at rest; the checkpoint stays, and a resumption goes on
        self.store.finish(self._summary(bodies))
        if not self.undecided:
            checkpoint.clear(self.store.directory)

    def _summary(self, bodies: Bodies) -> Summary:
        """The summary of the impacts so far, whose splats are `bodies`."""
        levels = [record.values["surface_level_m"] for record in self.records]
        standing = splats_at_end(self.plan, levels, self.joins, bodies)
        return summary(self.plan, self.records, self.joins, standing, self.wall, self.options.ranks)

    def _check_records(self, bodies: Bodies) -> None:
        """Raise CheckpointError where the records of a checkpoint are not those of finished impacts: they make no summary."""
        try:
            if self.records and (problem := problem_of(self._summary(bodies))) is not None:
                raise ValueError(problem)
        except (KeyError, ValueError, TypeError, AttributeError, IndexError, ZeroDivisionError) as error:
            raise CheckpointError(
                f"the checkpoint in {self.store.directory} is damaged (its records: {type(error).__name__} {error}): start anew with"
                " coldspray run --force"
            ) from error

    def _impact(self, i: int, bodies: Bodies, resume_from: RunningState | None) -> Bodies:
        """Impact i on the bodies, and the joining of its splat: the bodies of the next impact."""
        before = simulated(self.records)
        outcome = None
        try:
            outcome = run_impact(self.plan, i, bodies, self.store, before, self.options, self._save_within, resume_from)
            domains = outcome.domains
            self.records.append(outcome.record)
            if i + 1 == len(self.plan.impacts) or self.undecided:
                return domains.bodies
            bodies, report = join(self.plan, i, domains, self.options.log, outcome.hold)
            self.joins.append(report)
        finally:
            if outcome is not None:
                outcome.domains.particle.close()
            if self.options.progress is not None:
                self.options.progress.stop()
        self._save(None, bodies.state())
        return bodies

    def _last_checkpoint(self) -> DepositionState | None:
        """State of the last whole checkpoint, the files brought to its moment; None if there is none."""
        log, folder = self.options.log, self.store.directory
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
        checkpoint.write(self.store.directory, state, self._belongs_to)


def _to_stderr(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0))
