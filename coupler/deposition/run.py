"""From a scene to a result: run, resume, and the impacts one after another."""

import hashlib
import math
import time as clock
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from .. import __version__, report
from ..errors import CheckpointError, ColdsprayError, NoContactError, SolverError, is_first_rank
from ..files import checkpoint
from ..files.outputs import write_text
from ..files.provenance import command, provenance
from ..files.result import COLD, Result
from ..files.store import PICTURE, PLAN, Store, WithoutFields
from ..files.summary import Summary, Values, problem_of
from ..impact.bodies import Bodies, BodiesState
from ..impact.domains import build_particle, build_target, restored_target
from ..impact.exchange import Impact
from ..impact.recorder import VTK_ORDER, cell_fields
from ..impact.run import ImpactStart, RunningState, RunOptions, run_impact
from ..impact.stop import terminable
from ..impact.summary import ImpactRecord
from ..plan.planning import Plan, plan
from ..plan.reading import Scene
from ..plan.record import plan_text, read_plan
from ..plan.text import describe
from ..progress import Progress
from ..ranks import ranks as parallel
from ..sph.start import whole_process
from ..state.threads import cores, second_thread
from .batches import Batches, BatchReplay, clear, workers
from .cut import Cut, put_back
from .detaching import without_detached
from .error import Companions
from .joining import join, rest, splats_at_end
from .log import logged
from .pause import cool_to_ambient
from .state import DepositionState
from .summary import simulated, summary, unsettled
from .task import Task, TaskResult

CHECKPOINT_EVERY = 60.0  # s of wall time
FEW_POINTS = 2000  # up to which a second thread saves some percent of a run (docs/evidence/speed.md)

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
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    skip_failed: bool = False,
    jobs: int = 1,
    error: bool | None = None,
) -> Result:
    """Compute a scene (a Scene or the path of one) and return its Result.

    out: folder for the files, runs/<scene name> by default. force: replace a finished run there. progress: told how far it is; a bar
    or lines on standard error by default, nothing with quiet. threads: 2 computes the target beside the particle on a second core, 1
    in turn with it (default: 2 where there are two cores); the numbers are the same. numerics: for studies of the scheme, values in
    place of the defaults of `coupler.sph.particle.Numerics`. probe(impact): called after every few steps with the
    `impact.exchange.Impact`, on the rank that has the target. checkpoint_every: s of wall time.
    skip_failed: of several impacts, leave out those that fail, in one process. jobs: impacts of a batch at a time (`plan.batches`),
    each in a process of its own; the numbers are the same. error: measure the error of each measure by coarser runs beside this one
    (None: as the scene says, not by default).

    Started by mpiexec, all ranks call it: the last has the target, the others share the particle. Raises SceneError, StoreError or
    SolverError, on all ranks; whatever was written before an error or an interrupt stays readable.
    """
    scene = scene if isinstance(scene, Scene) else Scene.load(scene)
    folder = Path(out) if out is not None else Path("runs") / scene.name
    knobs = dict(numerics or {})
    decided = plan(scene, knobs.pop("contact_stiffness", None), scene.resolution.error if error is None else error)
    if threads is None and decided.companions and max(impact.points for impact in decided.impacts) <= FEW_POINTS:
        threads = 1  # the coarser runs make better use of the other core
    options = _options(
        folder, progress or Progress(quiet), threads, knobs, probe, checkpoint_every, None, skip_failed, jobs
    )
    companions = Companions(decided, folder, knobs, _alone)

    def create() -> Store:
        store = Store.create(folder, scene.to_toml(), force, plan_text(decided))
        companions.begin(
            on_another_core=options.ranks.size == 1 and cores() > max(min(options.threads, 2), options.jobs)
        )
        return store

    try:
        return _complete(Deposition(decided, folder, options).run(create), companions, options)
    finally:
        companions.end()


def _alone(scene: Scene, folder: Path, contact_stiffness: float, numerics: Mapping[str, float], threads: int) -> None:
    """Compute a scene in this process alone; nothing but its summary is written."""
    decided, quiet = plan(scene, contact_stiffness), Progress(quiet=True)
    options = RunOptions(quiet, folder / "log.lammps", threads=threads, numerics=numerics, checkpoint_every=math.inf)
    create = partial(WithoutFields.create, folder, scene.to_toml(), force=True, plan_json=plan_text(decided))
    Deposition(decided, folder, options).run(create)


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
    """Go on with the unfinished run in a folder from its last whole checkpoint, or from its start if there is none.

    The number of ranks may differ from before. A finished run is returned as it is; an undecided one goes on: its
    last impact until `until` (s, of that impact), or for as long again as it has had. One whose end criterion is met and whose verdict
    is undecided (`Result.at_own_end`) goes on where `until` is said, and is returned as it is without. error: measure it where the run
    was to. Arguments and errors as for `run`; raises CheckpointError for a checkpoint of another version or another scene, or where
    `until` has passed.
    """
    folder = Path(out)
    result = Result(folder)
    knobs = {name: value for name, value in (numerics or {}).items() if name != "contact_stiffness"}  # in the plan
    options = _options(
        folder, progress or Progress(quiet), threads, knobs, probe, checkpoint_every, until, skip_failed, jobs
    )  # fmt: skip
    if result.finished and not result.undecided and (until is None or result.has_verdict):
        measured = not error or "error" in result.summary["run"] or not result.plan.get("companions")
        return _complete(result, None if measured else Companions(read_plan(folder), folder, knobs, _alone), options)
    if result.finished and until is not None and until <= float(result.end["time_s"]):
        raise CheckpointError(
            f"impact {len(result.impacts)} has come to {float(result.end['time_s']) * 1e9:.4g} ns: give a later time"
        )
    if until is not None and not (result.finished and checkpoint.stored(folder)):
        why = (
            "has no checkpoint to go on from" if result.finished else "is not finished: resume it without --until first"
        )
        raise CheckpointError(f"{folder} {why}")
    decided = read_plan(folder)
    companions = Companions(decided, folder, knobs, _alone) if error else None
    return _complete(Deposition(decided, folder, options).run(), companions, options)


def _complete(result: Result, companions: Companions | None, options: RunOptions) -> Result:
    """Do what a run does after its summary: clear the checkpoints, draw the section, measure the error."""
    if not is_first_rank():
        return result
    if result.has_verdict and not result.undecided:
        checkpoint.clear(result.directory)
    with terminable(), options.progress:
        if not (result.directory / PICTURE).exists():
            options.progress.stage("drawing the section", of_impact=False)
            report.section_picture(result)
        if companions is not None and companions.plan.companions and not result.undecided:
            options.progress.stage("measuring the error: the scene at fewer points", of_impact=False)
            companions.measure(options.threads)
    return Result(result.directory)


def _options(
    folder: Path,
    progress: Progress,
    threads: int | None,
    numerics: dict[str, float],
    probe: Probe | None,
    checkpoint_every: float,
    until: float | None = None,
    skip_failed: bool = False,
    jobs: int = 1,
) -> RunOptions:
    """What the caller of `run` or `resume` has asked for, on the ranks there are."""
    ranks = parallel.arrange(parallel.world())
    threads = (threads or cores()) if ranks.size == 1 else 1
    return RunOptions(
        progress,
        folder / "log.lammps",
        ranks,
        threads,
        numerics,
        probe,
        checkpoint_every,
        until,
        skip_failed,
        max(jobs, 1),
    )


class Deposition:
    """Impacts one after another: each takes a target and leaves one with a splat more. All ranks make one and run it."""

    def __init__(self, plan: Plan, folder: Path, options: RunOptions):
        self.plan, self.folder, self.options = plan, folder, options
        self._started, self._before = clock.perf_counter(), 0.0
        self.records: list[ImpactRecord] = []  # of the finished impacts
        self.joins: list[Values] = []  # reports of the joining of their splats
        self.closing: Values | None = None  # report of the closing stage
        self._start: ImpactStart | None = None  # of the impact that is computed
        self._unwritten: BatchReplay | None = None  # files of the last batch

    @property
    def wall(self) -> float:
        """Wall time so far, s, that before a resumption included."""
        return self._before + clock.perf_counter() - self._started

    @property
    def undecided(self) -> bool:
        """Whether the last impact so far has ended without its end criterion."""
        return bool(self.records) and self.records[-1].values["undecided"] is not None

    @property
    def _may_skip(self) -> bool:
        """Whether an impact that fails, or ends undecided, is left out."""
        return self.options.skip_failed and self.options.ranks.size == 1 and len(self.plan.impacts) > 1

    def run(self, create: Callable[[], Store] | None = None) -> Result:
        """Compute all impacts and write summary.json and the picture. create: makes the folder's files; None: go on with those that
        are there, and with the impacts that its checkpoint has not seen finished."""
        plan, options, ranks = self.plan, self.options, self.options.ranks
        if not ranks.is_root:
            parallel.follow(
                ranks, lambda i, place, numerics: build_particle(plan, i, place, ranks, numerics, options.log_file)
            )
            return Result(self.folder)
        with (
            whole_process(),
            terminable(),
            parallel.leading(ranks),
            create() if create is not None else Store.reopen(self.folder) as self.store,
            logged(options.progress, self.store),
            second_thread(options.threads),
            workers(plan, options, self.folder) as pool,
        ):
            options.progress.record(f"coldspray {__version__}: {command()}\n{describe(plan)}")
            self._belongs_to = self._identity()
            batches = Batches(plan, self.folder, self._belongs_to, options, pool)
            options.progress.stage("meshing the target")
            if create is not None:
                clear(self.folder)
            bodies, running = (build_target(plan), None) if create is not None else self._restored()
            while len(self.records) < len(self.plan.impacts):
                if math.isfinite(self.plan.impacts[len(self.records)].window):
                    try:
                        bodies = self._batch(bodies, batches)
                    except (SolverError, KeyboardInterrupt):
                        self._write_batch()  # what was computed is there to be looked at
                        raise
                    if self.undecided:
                        break
                    continue
                if running is None or self._start is None:
                    self._start = ImpactStart(bodies.state(), self.store.state())
                try:
                    bodies, running = self._impact(self._start, running), None
                except (SolverError, NoContactError) as error:
                    bodies, running = self._without_impact(error), None
                    self._save(None, bodies.state())
                if self.undecided:
                    break  # what comes next has no target at rest; the checkpoint stays, and a resumption goes on
                if len(self.records) < len(self.plan.impacts):
                    self._save(None, bodies.state())
            self._write_batch()
            if plan.ambient is not None and not self.undecided:
                if self.records[-1].values["rebounded"] is not None:  # without that an impact can go on
                    self._save(None, bodies.state())
                bodies = self._close(bodies)
            origin = provenance(Result(self.folder).scene_text, plan.engine)
            (self.folder / PICTURE).unlink(missing_ok=True)  # of an earlier end
            self.store.finish({**self._summary(bodies), "provenance": origin})
            if not self.undecided and self.records[-1].values["rebounded"] is not None:
                checkpoint.clear(self.folder)
                clear(self.folder)
            result = Result(self.folder)
            options.progress.record(report.screen(result, verbose=True))
        return result

    def _impact(self, start: ImpactStart, running: RunningState | None) -> Bodies:
        """Compute the next impact; returns the bodies after it, with its splat where it joins them."""
        plan, options, i, outcome = self.plan, self.options, len(self.records), None
        kept = list(self.records)
        try:
            before = simulated(self.records)
            outcome = run_impact(plan, i, start, self.store, before, options, self._save_within, running)
            self.records.append(outcome.record)
            if self.undecided:
                if self._may_skip:
                    raise SolverError(str(self.records[-1].values["undecided"]))
                return outcome.domains.bodies
            if i + 1 == len(plan.impacts) and plan.ambient is None:  # its particle stays one of points
                left, gone = without_detached(plan, outcome.domains.bodies, i + 1, "impact")
                self.joins += [{"impact": i + 1, "detached": gone}] if gone else []
                return left
            new, joined = join(plan, i, outcome, options.progress)
            self.joins.append(joined)
            for text in unsettled(joined):
                options.progress.log(text)
            return new
        except SolverError:
            self.records = kept
            raise
        finally:
            if outcome is not None:
                outcome.domains.particle.close()

    def _batch(self, met: Bodies, batches: Batches) -> Bodies:
        """Compute the next impacts side by side, each on its own cut of the bodies that they meet; returns these with all splats that
        stay. What the batch writes is written beside the next one, see `_catch_up`."""
        plan, options, first = self.plan, self.options, len(self.records)
        tasks: list[tuple[Task, Cut]] = []
        results: list[TaskResult] = []  # up to one that is undecided: what comes next has no target at rest
        parts: list[tuple[Cut, Bodies]] = []
        failed: tuple[int, ColdsprayError] | None = None
        for task, cut, result in batches.compute(first, met, lambda: self._catch_up(met)):
            if failed is not None or (results and results[-1].record.values["undecided"] is not None):
                continue
            tasks.append((task, cut))
            error = result if isinstance(result, ColdsprayError) else self._failure(result)
            if error is not None:
                failed = task.i, error
            elif isinstance(result, TaskResult):
                results.append(result)
                parts.append((cut, restored_target(plan, result.bodies)))
        if failed is not None:
            self._skip(*failed)
            self._save(None, met.state())
            clear(self.folder)
            return met
        whole = put_back(met, parts)
        self._unwritten = BatchReplay(met, whole)
        for (task, cut), result in zip(tasks, results, strict=True):
            elements = self._unwritten.add(task, cut, result, simulated(self.records))
            self.records.append(result.record)
            if self.undecided:
                return whole
            if not result.joined:  # the last, whose particle stays one of points
                left, gone = without_detached(plan, whole, len(self.records), "impact")
                self.joins += [{"impact": len(self.records), "detached": gone}] if gone else []
                return left
            self.joins.append({**result.joined, "elements": elements, "mass_scaling": result.prepared})
        options.progress.stage("cooling, and preparing the next impact")
        kinetic_0 = sum(record.values["kinetic_energy_0_J"] for record in self.records[first:])
        places = [task.place for task, _ in tasks]
        whole = rest(plan, range(first, len(self.records)), whole, places, kinetic_0, self.joins[-1])
        for text in unsettled(self.joins[-1]):
            options.progress.log(text)
        if len(self.records) < len(self.plan.impacts):
            options.progress.batch_ended(self.plan.shares[len(self.records)][0])
        return whole

    def _failure(self, result: TaskResult) -> ColdsprayError | None:
        """The error of an impact that is left out because it has ended undecided; None of all others."""
        undecided = result.record.values["undecided"]
        return SolverError(str(undecided)) if undecided is not None and self._may_skip else None

    def _catch_up(self, bodies: Bodies) -> None:
        """Write the files of the last batch and a checkpoint of the bodies after it, while workers compute the next one: until then
        a run that is ended goes on from the results that the tasks of that batch have left in their folders."""
        self._write_batch()
        self._save(None, bodies.state())
        clear(self.folder, len(self.records))

    def _write_batch(self) -> None:
        """Write what the last batch has left to be written."""
        unwritten, self._unwritten = self._unwritten, None
        if unwritten is not None:
            unwritten.write(self.store)

    def _without_impact(self, error: ColdsprayError) -> Bodies:
        """The bodies as the impact that has failed met them, where it is left out of the plan; raises the error otherwise."""
        start = self._start
        if start is None or not self._may_skip:
            raise error
        self.store.go_back(start.store, self.options.progress.log)
        self._skip(len(self.records), error)
        return restored_target(self.plan, start.bodies)

    def _skip(self, i: int, error: ColdsprayError) -> None:
        """Take an impact that has failed out of the plan, which is written anew.

        Raises the error where nobody has asked for that, or nothing else would be left.
        """
        options = self.options
        if not self._may_skip:
            raise error
        text = f"particle {i + 1} of the scene's sequence was skipped: {error}"
        options.progress.log(text)
        impacts = (*self.plan.impacts[:i], *self.plan.impacts[i + 1 :])
        self.plan = replace(self.plan, impacts=impacts, skipped=(*self.plan.skipped, text))
        write_text(self.folder / PLAN, plan_text(self.plan))
        self._belongs_to = self._identity()

    def _identity(self) -> dict[str, str]:
        """What a checkpoint belongs to."""
        scene = (Result(self.folder).scene_text + plan_text(self.plan)).encode()
        return {
            "version": __version__, "scene": hashlib.sha256(scene).hexdigest(),
            "numerics": repr(sorted(self.options.numerics.items())),
        }  # fmt: skip

    def _close(self, bodies: Bodies) -> Bodies:
        """The closing stage: the bodies cool to ambient, come to equilibrium and are written. Returns those that are left."""
        self.options.progress.stage("cooling to ambient")
        if math.isfinite(bodies.target.horizon):  # made ready for an impact that was skipped
            bodies = bodies.renumbered((0.0, 0.0, 0.0))
        kinetic_0 = self.records[-1].values["kinetic_energy_0_J"]
        bodies, self.closing = cool_to_ambient(self.plan, bodies, kinetic_0)
        t = bodies.target
        thermal = {"thermal_stress": t.thermal_stress[:, VTK_ORDER], **cell_fields(bodies)}
        self.store.write(COLD, simulated(self.records), t.x, t.mesh.conn, {}, thermal)
        return bodies

    def _restored(self) -> tuple[Bodies, RunningState | None]:
        """The bodies that the last whole checkpoint holds, and the impact that was interrupted, or None; from the start without one."""
        state = self._last_checkpoint()
        if state is None:
            return build_target(self.plan), None
        self.records, self.joins, self._before, running = state.records, state.joins, state.wall, state.running
        kept = running.impact.bodies if running is not None else state.bodies
        left = len(self.plan.impacts) - len(self.records)
        if kept is None or len(self.joins) != len(self.records) or left < (1 if running is not None else 0):
            raise CheckpointError(f"the checkpoint in {self.folder} is damaged: start anew with coldspray run --force")
        bodies, self._start = restored_target(self.plan, kept), state.start
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
        standing = splats_at_end(self.plan, levels, len(self.joins), bodies)
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
        start = self._start if running is not None else None
        state = DepositionState(running, bodies, self.store.state(), self.records, self.joins, self.wall, start)
        checkpoint.write(self.folder, state, self._belongs_to)
