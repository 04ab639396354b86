"""Computation of one impact: from a target to its outcome, with retries and checkpoints."""

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..core.records import copied, put
from ..errors import NoContactError, SolverError
from ..files.store import Store, StoreState
from ..plan.cost import forecast
from ..plan.planning import Plan
from ..progress import Progress
from ..ranks.ranks import Ranks
from ..target.bodies import BodiesState
from .domains import build_domains, restored_target
from .ending import STILL, EndCriterion, EndState
from .exchange import Impact, ImpactState
from .loop import Probe, advance_to_end
from .recorder import Recorded, Recorder
from .retry import Retry, next_retry
from .stop import Stopped, stop_signals
from .summary import ImpactRecord, summarise
from .verdict import is_tied


@dataclass(frozen=True)
class RunOptions:
    """Options of a run. The options `progress`, `ranks`, `threads` and `jobs`, and the files, do not change the results.

    log_file: log file of LAMMPS; threads: number of threads that share the loops of a step and the work between impacts; numerics:
    values in place of the defaults of `particle.particle.Numerics`; probe: function called with the `Impact` after each chunk of
    steps; checkpoint_every: wall time between checkpoints, s; until (s): new time limit of an impact that continues after its first
    limit, None: the time is doubled; skip_failed: leave out impacts that fail; jobs: impacts of a batch at the same time.
    """

    progress: Progress
    log_file: Path
    ranks: Ranks = field(default_factory=Ranks)
    threads: int = 1
    numerics: Mapping[str, float] = field(default_factory=dict)
    probe: Probe | None = None
    checkpoint_every: float = 60.0
    until: float | None = None
    skip_failed: bool = False
    jobs: int = 1


@dataclass(frozen=True)
class RunningState:
    """State of an unfinished impact. level (m): height of the surface where the particle first touches it; wall, looped (s): wall
    time so far, in total and in the time loop only."""

    impact: ImpactState
    ending: EndState
    recorder: Recorded
    retries: list[Retry]
    level: float
    wall: float
    looped: float


def run_impact(
    plan: Plan,
    i: int,
    bodies: BodiesState,
    written: StoreState | None,
    store: Store,
    before: float,
    options: RunOptions,
    save: Callable[[RunningState], None],
    resume_from: RunningState | None = None,
) -> tuple[Impact, ImpactRecord]:
    """Compute impact i of a plan to its end, from its start or a state. Returns the impact, whose LAMMPS still runs, and its record.

    bodies: target before the impact; written: amount of data in each file before the impact, None if there is none; before (s):
    simulated time of earlier impacts; save(state): writes a checkpoint; resume_from: such a state. After a failure the impact is
    computed again from its start with the next remedy (`impact.retry`). An impact whose record has a text in `undecided` or None in
    `rebounded` writes a checkpoint at its end, from which it can continue. Raises SolverError when no remedy is left,
    NoContactError, StoreError, or Stopped after a signal.
    """
    retries: list[Retry] = []
    watch = _WallClock()
    if resume_from is not None:
        retries, watch = list(resume_from.retries), _WallClock(resume_from.wall, resume_from.looped)
        options.progress.log(f"continuing from {(before + resume_from.impact.course.time) * 1e9:.1f} ns")
    p = plan.impacts[i]
    with stop_signals() as signals:
        while True:
            met, level = (resume_from.impact.bodies, resume_from.level) if resume_from is not None else (bodies, None)
            target = restored_target(plan, met)
            options.progress.start(p.expected, p.end_time, i, before, forecast(plan).shares, p.dt_expected)
            options.progress.stage("making the particle")
            numerics, dt_factor = (retries[-1].numerics, retries[-1].dt_factor) if retries else (options.numerics, 1.0)
            impact = Impact(build_domains(plan, i, target, options.log_file, numerics, options.ranks, level))
            impact.dt_factor = dt_factor
            ending = _end_criterion(plan, i, impact.ledger.kinetic_0)
            recorder = Recorder(plan, i, store, options.progress, before)
            try:
                if resume_from is not None:
                    impact.restore(resume_from.impact)
                    put(resume_from.ending, ending)
                    recorder.seen = resume_from.recorder
                    ending.extend(impact.time, options.until)
                return impact, _record(impact, ending, recorder, retries, options, watch, signals, save)
            except BaseException as error:
                impact.particle.close()
                if not isinstance(error, SolverError):
                    raise
                retry = next_retry(retries, options.numerics, error, i + 1, before + impact.time)
                options.progress.log(str(retry))
                retries.append(retry)
                store.go_on(written, options.progress.log)
                resume_from = None


def _record(
    impact: Impact, ending: EndCriterion, recorder: Recorder, retries: list[Retry], options: RunOptions, watch: "_WallClock",
    signals: list[int], save: Callable[[RunningState], None],
) -> ImpactRecord:  # fmt: skip
    """Compute the impact to its end. Write a checkpoint there if the impact can continue later."""
    saved = clock.perf_counter()

    def save_state() -> None:
        done = impact.state(), copied(ending), recorder.seen, list(retries)
        save(RunningState(*done, impact.domains.level, watch.wall, watch.looped))

    def keep() -> None:
        """Write a checkpoint if one is due. After a signal, write one and raise Stopped."""
        nonlocal saved
        if signals or clock.perf_counter() - saved >= options.checkpoint_every:
            save_state()
            saved = clock.perf_counter()
        if signals:
            raise Stopped(signals[0])

    recorder.start(impact)
    watch.start_loop()
    advance_to_end(impact, ending, recorder, keep, options.probe)
    if not ending.touched:
        raise NoContactError(
            f"particle {recorder.i + 1} has not touched the target in {impact.time * 1e9:.4g} ns: check gap, angle and offset of"
            " [particle], or give a larger end.time"
        )
    if signals:
        keep()
    record = summarise(impact, recorder, ending, retries, watch.wall, watch.looped)
    if record.values["undecided"] is not None or record.values["rebounded"] is None:
        save_state()
    return record


def _end_criterion(plan: Plan, i: int, energy: float) -> EndCriterion:
    """The end criterion of impact i. energy (J): kinetic energy. After the first impact, a slow downward speed counts as
    zero: a particle can slide slowly on splats for long. On a coating, a tied particle may still have a contact force at the end."""
    p = plan.impacts[i]
    speed = float(np.linalg.norm(p.velocity))
    slow, tied = STILL * speed if i else 0.0, energy if plan.is_on_coating(i) and is_tied(plan.adhesion, p) else 0.0
    return EndCriterion(p.end_time, p.end_at, p.diameter / speed, speed, slow, tied)


class _WallClock:
    """Wall time of an impact, s, in total and in the time loop. Both times include retries and the parts before a resumption."""

    def __init__(self, wall: float = 0.0, looped: float = 0.0):
        self._began, self._looped, self._loop_began = clock.perf_counter() - wall, looped, 0.0

    def start_loop(self) -> None:
        """Start the clock of the time loop. In a retry it already runs."""
        self._loop_began = self._loop_began or clock.perf_counter() - self._looped

    @property
    def wall(self) -> float:
        return clock.perf_counter() - self._began

    @property
    def looped(self) -> float:
        return clock.perf_counter() - self._loop_began
