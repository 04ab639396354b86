"""The deposition: each batch of impacts adds its splats to the target, and gives a record of each impact."""

import hashlib
import time as clock
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

from .. import __version__, report
from ..errors import CheckpointError, ColdsprayError, SolverError
from ..files import checkpoint
from ..files.outputs import write_text
from ..files.provenance import provenance
from ..files.result import COLD, Result
from ..files.store import PICTURE, PLAN, Store, StoreState
from ..files.summary import Summary, Values, problem_of
from ..impact.domains import build_target, restored_target
from ..impact.recorder import VTK_ORDER, cell_fields, joint_fields
from ..impact.run import RunOptions
from ..impact.summary import ImpactRecord
from ..plan.batches import Batch
from ..plan.cost import forecast
from ..plan.planning import Plan
from ..plan.record import plan_text
from ..target.bodies import Bodies, BodiesState
from ..target.cut import put_back
from ..target.positions import splats_at_end
from .batches import TASKS, Done, clear, side_by_side, tasks
from .detaching import without_detached
from .joining import rest
from .pause import cool_to_ambient
from .replay import BatchReplay
from .summary import simulated, summary, unsettled
from .task import Task, TaskFiles, TaskState, attempt


@dataclass(frozen=True)
class DepositionState:
    """State of a run before a batch of impacts. bodies: the target; store: state of the files; records, joins: records of the
    finished impacts, and reports of the joining of their splats; wall: wall time so far, s; within: state of an unfinished impact that
    is computed on the full domain, or None."""

    bodies: BodiesState
    store: StoreState
    records: list[ImpactRecord]
    joins: list[Values]
    wall: float
    within: TaskState | None


class Deposition:
    """The deposition of all particles of a plan, batch by batch. It runs on the MPI rank that has the target.

    plan: the plan without skipped impacts; pool: executor for simultaneous impacts, None if all are computed in this process;
    records: records of the finished impacts; joins: reports of the joining of their splats; closing: report of the closing stage.
    """

    def __init__(self, plan: Plan, folder: Path, options: RunOptions, store: Store, pool: Executor | None = None):
        self.plan, self.folder, self.options, self.store, self.pool = plan, folder, options, store, pool
        self._began = clock.perf_counter()  # s, earlier by the wall time before a resumption
        self.records: list[ImpactRecord] = []
        self.joins: list[Values] = []
        self.closing: Values | None = None
        self._resumed: DepositionState | None = None  # a checkpoint within an impact
        self._unwritten: BatchReplay | None = None  # files of the last batch that are not merged yet
        self._about = self._identity()

    @property
    def undecided(self) -> bool:
        """Whether the last impact so far ended before its end criterion was met."""
        return bool(self.records) and self.records[-1].values["undecided"] is not None

    @property
    def can_continue(self) -> bool:
        """Whether the last impact so far can continue: it is undecided, or it is not known whether the particle rebounds."""
        return self.undecided or self.records[-1].values["rebounded"] is None

    @property
    def _may_skip(self) -> bool:
        """Whether the run leaves out an impact that fails or is undecided."""
        return self.options.skip_failed and self.options.ranks.size == 1 and len(self.plan.impacts) > 1

    # ---- the fold ------------------------------------------------------------------------------------------------

    def substrate(self) -> Bodies:
        """The target before the first impact."""
        clear(self.folder)
        return build_target(self.plan)

    def next_batch(self) -> Batch | None:
        """The next batch; None after the last impact, and after an undecided impact, because the target is not at rest."""
        self._batch_began = clock.perf_counter()
        return None if self.undecided else self.plan.batch_from(len(self.records))

    def compute(self, batch: Batch, target: Bodies) -> list[Done]:
        """Compute the impacts of a batch, each on its own sub-domain of the target. Returns the results up to and including the first
        undecided impact. If the run may skip impacts, the first failed or undecided one is removed from the plan, and the list is
        empty: no result of the batch is kept. Otherwise the error of a failed impact is raised."""
        done = self._done(batch, target)
        for k, each in enumerate(done):
            error = each.result if isinstance(each.result, ColdsprayError) else None
            undecided = None if error is not None else each.of.record.values["undecided"]
            if undecided is not None and self._may_skip:
                error = SolverError(str(undecided))
            if error is not None:
                self._skip(each.task, error)
                self._save(target, self.store.state())
                clear(self.folder)
                return []
            if undecided is not None:
                return done[: k + 1]
        return done

    def _done(self, batch: Batch, target: Bodies) -> list[Done]:
        """The results of `compute` before failed impacts are handled."""
        found, folder = tasks(self.plan, batch, target, self.folder, self._about), self.folder / TASKS
        if batch.is_whole:  # the impact writes into the files of the run
            self._catch_up(batch, target)
            ((task, cut),) = found
            before, resumed, self._resumed = simulated(self.records), self._resumed, None
            written, within = (resumed.store, resumed.within) if resumed is not None else (self.store.state(), None)
            files = TaskFiles(self.store, within, lambda state: self._save(target, written, state))
            return [Done(task, cut, attempt(replace(task, before=before, written=written), self.options, files))]
        folder.mkdir(exist_ok=True)
        if self.pool is not None and batch.stop - batch.first > 1:
            return side_by_side(self.pool, found, folder, self.options, lambda: self._catch_up(batch, target))
        self._catch_up(batch, target)
        return [Done(task, cut, attempt(task, self.options)) for task, cut in found]

    def rest(self, batch: Batch, target: Bodies, done: Sequence[Done]) -> Bodies:
        """The target at rest, with all splats that stay, after a batch and the pause after it. done: result of `compute`."""
        if not done:
            return target
        first, computed = len(self.records), clock.perf_counter()
        whole = put_back(target, [(each.cut, restored_target(self.plan, each.of.bodies)) for each in done])
        self._record(target, whole, done, is_written=batch.is_whole)
        if self.undecided:
            return whole
        number = len(self.records)
        if not done[-1].of.joined:  # the last impact: its particle still consists of points
            left, gone = without_detached(self.plan, whole, number, "impact")
            self.joins += [{"impact": number, "detached": gone}] if gone else []
            return left
        self.options.progress.stage("heat conduction, and preparation of the next impact")
        kinetic_0 = sum(record.values["kinetic_energy_0_J"] for record in self.records[first:])
        # an impact whose sub-domain meets another one belongs to the next batch
        batch = replace(batch, stop=number, pause=self.plan.pause_after(first, number))
        whole = rest(self.plan, batch, whole, [each.task.place for each in done], kinetic_0, self.joins[-1])
        pause = self.joins[-1].get("cooling", {}).get("seconds", {})
        bodies = clock.perf_counter() - computed - sum(pause.values())  # assembly, numbering, search for overlaps
        self.joins[-1]["seconds"] = {"impacts": computed - self._batch_began, **pause, "bodies": bodies}
        took = ", ".join(f"{piece} {seconds:.2f} s" for piece, seconds in self.joins[-1]["seconds"].items())
        self.options.progress.record(f"impacts {first + 1} to {number} and the pause after them: {took}")
        for text in unsettled(self.joins[-1]):
            self.options.progress.log(text)
        if not batch.is_whole and number < len(self.plan.impacts):
            self.options.progress.batch_ended(forecast(self.plan).shares[number][0])
        return whole

    def _record(self, before: Bodies, after: Bodies, done: Sequence[Done], is_written: bool) -> None:
        """Store the records of a batch. before, after: the bodies before and after the batch; is_written: whether the batch has
        written into the files of the run."""
        replay, elements = BatchReplay(self.plan, before, after), len(before.target.mesh.conn)
        for each in done:
            replay.add(each.task, each.cut, each.of, simulated(self.records))
            elements += len(each.of.bodies.target.elements.T) - len(each.task.bodies.target.elements.T)
            self.records.append(each.of.record)
            if each.of.joined:
                self.joins.append({**each.of.joined, "elements": elements, "mass_scaling": each.of.prepared})
        self._unwritten = None if is_written else replay

    def cool(self, target: Bodies) -> Bodies:
        """The bodies after the closing stage, without detached splats; they are also written. Without this stage: `target`."""
        if self.plan.ambient is None or self.undecided:
            return target
        if not self.can_continue:
            self._save(target, self.store.state())
        self.options.progress.stage("cooling to ambient temperature")
        target, self.closing = cool_to_ambient(self.plan, target, self.records[-1].values["kinetic_energy_0_J"])
        t = target.target
        e, fields = t.elements, cell_fields(self.plan, target)
        hardening = {"eps_recovered": fields["eps_p"] - e.eps_p, "eps_gradient": e.eps_gradient}
        thermal = {"thermal_stress": e.thermal_stress[:, VTK_ORDER], **fields}
        thermal |= {name: values for name, values in hardening.items() if values.any()}
        joints = joint_fields(target, self.plan.adhesion.kind == "cohesive")
        self.store.write(COLD, simulated(self.records), t.nodes.x, t.mesh.conn, joints, thermal)
        return target

    def finish(self, target: Bodies) -> None:
        """Write the summary of the run. Remove the checkpoints, unless the last impact can continue (`can_continue`)."""
        (self.folder / PICTURE).unlink(missing_ok=True)  # from an earlier end of this run
        origin = provenance(Result(self.folder).scene_text, self.plan.engine)
        self.store.finish({**self._summary(target), "provenance": origin})
        if not self.can_continue:
            checkpoint.clear(self.folder)
            clear(self.folder)
        self.options.progress.record(report.screen(Result(self.folder), verbose=True))

    # ---- impacts that fail ---------------------------------------------------------------------------------------

    def _skip(self, task: Task, error: ColdsprayError) -> None:
        """Remove a failed impact from the plan, from plan.json and from the files of the run. Raises its error if the run may not skip
        impacts, or if no impact would be left."""
        if not self._may_skip:
            raise error
        text = f"particle {task.i + 1 + len(self.plan.skipped)} of the scene's sequence was skipped: {error}"
        self.options.progress.log(text)
        if task.written is not None:
            self.store.go_on(task.written, self.options.progress.log)
        self.plan = self.plan.without(task.i, text)
        write_text(self.folder / PLAN, plan_text(self.plan))
        self._about = self._identity()

    # ---- checkpoints ---------------------------------------------------------------------------------------------

    def restored(self) -> Bodies:
        """The target of the last complete checkpoint, from which the next batch starts; without a checkpoint, the initial target."""
        log = self.options.progress.log
        state = checkpoint.latest(self.folder, DepositionState, self._about, log)
        if state is None:
            log(f"{self.folder} has no checkpoint: the run starts from its beginning")
            self.store.go_on(None, log)
            return build_target(self.plan)
        self.store.go_on(state.store if state.within is None else state.within.store, log)
        self.records, self.joins = state.records, state.joins
        self._began -= state.wall
        if len(self.joins) != len(self.records) or len(self.records) > len(self.plan.impacts):
            raise CheckpointError(f"the checkpoint in {self.folder} is damaged: start again with coldspray run --force")
        target = restored_target(self.plan, state.bodies)
        self._check_records(target)
        self._resumed = state if state.within is not None else None
        return target

    def _check_records(self, bodies: Bodies) -> None:
        """Raise CheckpointError if the records of a checkpoint give no valid summary."""
        try:
            if self.records and (problem := problem_of(self._summary(bodies))) is not None:
                raise ValueError(problem)
        except (KeyError, ValueError, TypeError, AttributeError, IndexError, ZeroDivisionError) as error:
            raise CheckpointError(
                f"the checkpoint in {self.folder} is damaged (its records of impacts: {type(error).__name__}"
                f" {error}): start the run again"
                " with coldspray run --force"
            ) from error

    def _catch_up(self, batch: Batch, target: Bodies) -> None:
        """Write the files of the last batch and a checkpoint of `target`, and remove the folders of finished tasks. A resumed run
        continues from the remaining folders. batch: the next batch; worker processes, if any, already compute it."""
        self.write_files()
        if self._resumed is None and (self.records or not batch.is_whole):
            self._save(target, self.store.state())
        clear(self.folder, len(self.records))

    def write_files(self) -> None:
        """Write the files of the last batch, unless they are written."""
        unwritten, self._unwritten = self._unwritten, None
        if unwritten is not None:
            unwritten.write(self.store)

    def _save(self, target: Bodies, written: StoreState, within: TaskState | None = None) -> None:
        wall = clock.perf_counter() - self._began
        state = DepositionState(target.state(), written, self.records, self.joins, wall, within)
        checkpoint.write(self.folder, state, self._about)

    def _identity(self) -> dict[str, str]:
        """Data that identify the run; a checkpoint contains them."""
        scene = (Result(self.folder).scene_text + plan_text(self.plan)).encode()
        return {
            "version": __version__, "scene": hashlib.sha256(scene).hexdigest(),
            "numerics": repr(sorted(self.options.numerics.items())),
        }  # fmt: skip

    # ---- summary -------------------------------------------------------------------------------------------------

    def _summary(self, bodies: Bodies) -> Summary:
        """The summary of the impacts so far. bodies: target with their splats."""
        # the report of a last impact that still consists of points has no key "elements"
        each = zip(self.plan.impacts, self.records, self.joins, strict=False)
        joined = [(impact, record) for impact, record, join in each if "elements" in join]
        diameters = [impact.diameter for impact, _ in joined]
        standing = splats_at_end(bodies, diameters, [record.values["surface_level_m"] for _, record in joined])
        wall = clock.perf_counter() - self._began
        return summary(self.plan, self.records, self.joins, standing, wall, self.options.ranks, self.closing)
