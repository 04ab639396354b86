"""One impact as a function: target in, outcome out, with its retries and its checkpoints."""

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..contact.hold import Hold
from ..errors import NoContactError, SolverError
from ..files.store import Store, StoreState
from ..plan.planning import Plan
from ..progress import Progress
from ..ranks.ranks import Ranks
from .bodies import Bodies
from .domains import Domains, build_domains, restored_target
from .ending import STILL, EndCriterion, EndState
from .exchange import Impact, ImpactState
from .loop import advance_to_end
from .recorder import Recorder, RecorderState
from .retry import Retries, Retry
from .stop import Stopped, StopSignals
from .summary import ImpactRecord, summarise
from .verdict import is_tied


@dataclass(frozen=True)
class RunOptions:
    """How to run; `progress`, `ranks`, `threads`, `jobs` and files do not change the numbers.

    threads: 2 divides loops between both; numerics: values in place of the defaults of `sph.particle.Numerics`; probe:
    called with the `Impact` after every window of steps; checkpoint_every: s of wall time; log_file: LAMMPS's; until: time limit (s)
    of an impact that goes on after its own one, None for as long again;
    skip_failed: impacts that fail are left out; jobs: impacts of a batch at a time.
    """

    progress: Progress
    log_file: Path
    ranks: Ranks = field(default_factory=Ranks)
    threads: int = 1
    numerics: Mapping[str, float] = field(default_factory=dict)
    probe: Callable[[Impact], None] | None = None
    checkpoint_every: float = 60.0
    until: float | None = None
    skip_failed: bool = False
    jobs: int = 1


@dataclass(frozen=True)
class ImpactOutcome:
    """A finished impact: its domains, LAMMPS still running; the bond of its particle, or None; its record for summary.json."""

    domains: Domains
    hold: Hold | None
    record: ImpactRecord


@dataclass(frozen=True)
class RunningState:
    """An impact on its way. level: height of the surface where the particle first touches it, m; wall, looped: s of wall time so far,
    in all and in the time loop."""

    impact: ImpactState
    ending: EndState
    recorder: RecorderState
    retries: list[Retry]
    level: float
    wall: float
    looped: float


@dataclass(frozen=True)
class _Kept:
    """What a retry goes back to: the impact, and how much of each file was written."""

    state: RunningState
    store: StoreState


def run_impact(
    plan: Plan,
    i: int,
    bodies: Bodies,
    store: Store,
    before: float,
    options: RunOptions,
    save: Callable[[RunningState], None],
    resume_from: RunningState | None = None,
) -> ImpactOutcome:
    """Impact i of a plan on the target `bodies`, to its end.

    before: simulated time (s) of the impacts before. save(state): writes a checkpoint; resume_from: such a state, whose bodies are
    `bodies`. After a failure the impact goes back to a kept state and tries the next remedy (`impact.retry`); all domains are built
    anew for it. An impact that has not met its end criterion at its time limit is undecided: it writes a checkpoint, and goes on when
    it is resumed from it; so does one whose verdict is undecided. Raises SolverError when no remedy is left, NoContactError,
    StoreError, or Stopped after a signal.
    """
    p = plan.impacts[i]
    state, retries, watch = resume_from, Retries[_Kept](options.numerics), _WallClock()
    if state is not None:
        retries, watch = Retries[_Kept](options.numerics, state.retries), _WallClock(state.wall, state.looped)
        options.progress.log(f"going on from {(before + state.impact.time) * 1e9:.1f} ns")
    with StopSignals() as signals:
        while True:
            level = None if state is None else state.level
            options.progress.start(p.expected, p.end_time, i, before, plan.shares, p.dt_expected)
            options.progress.stage("building the particle")
            domains = build_domains(plan, i, bodies, options.log_file, retries.numerics, options.ranks, level)
            impact = Impact(domains)
            try:
                ending = _end_criterion(plan, i, impact.ledger.kinetic_0)
                recorder = Recorder(plan, i, store, options.progress, before)
                if state is not None:
                    impact.restore(state.impact)
                    ending.restore(state.ending)
                    if state is resume_from:  # a retry goes on to the same end
                        ending.extend(impact.time, options.until)
                    recorder.restore(state.recorder)
                    impact.dt_factor = retries.applied[-1].dt_factor if retries.applied else 1.0
                keeper = _Keeper(impact, ending, recorder, retries, watch, signals, options.checkpoint_every, save)
                recorder.start(impact)
                watch.start_loop()
                advance_to_end(impact, ending, recorder, keeper.keep, options.probe)
                if not ending.touched:
                    raise NoContactError(
                        f"particle {i + 1} has not touched the target in {impact.time * 1e9:.4g} ns: look at the gap, the angle and the"
                        " offset in its files, or give it more time (end.time)"
                    )
                # a coating goes on without a particle that has slid off it
                is_lost = len(plan.impacts) > 1 and ending.slid_off(impact.time)
                undecided = None if is_lost else ending.undecided(impact.time, impact.sinking)
                settled = ending.settled(impact.time)
                record = summarise(
                    impact, recorder, retries.applied, watch.wall, watch.looped, undecided, settled, is_lost
                )
                if undecided is not None or record.values["rebounded"] is None:
                    save(keeper.state())
                return ImpactOutcome(domains, impact.hold, record)
            except SolverError as error:
                _give_up(impact)
                retry, kept = retries.next_remedy(error, i + 1, before + impact.time)
                options.progress.log(str(retry))
                state = kept.state
                bodies = restored_target(plan, state.impact.bodies)
                store.go_back(kept.store, options.progress.log)
            except BaseException:
                _give_up(impact)
                raise


def _give_up(impact: Impact) -> None:
    """Stop what still runs of an impact."""
    impact.particle.close()


def _end_criterion(plan: Plan, i: int, energy: float) -> EndCriterion:
    """What the plan says of the end of impact i, of so much energy, J. On earlier splats a particle may creep: there a slow one counts
    as at rest. On a coating, one that the scene ties is not waited for until its contact is silent."""
    p = plan.impacts[i]
    speed = float(np.linalg.norm(p.velocity))
    slow, tied = STILL * speed if i else 0.0, energy if plan.is_on_coating(i) and is_tied(plan.adhesion, p) else 0.0
    return EndCriterion(p.end_time, p.end_at, p.diameter / speed, speed, slow, tied)


class _WallClock:
    """Wall time of an impact, s: all of it, and in the time loop; both go on over retries and resumptions."""

    def __init__(self, wall: float = 0.0, looped: float = 0.0):
        self._began, self._looped, self._loop_began = clock.perf_counter() - wall, looped, 0.0

    def start_loop(self) -> None:
        """The loop begins, for the first time or after a retry."""
        self._loop_began = self._loop_began or clock.perf_counter() - self._looped

    @property
    def wall(self) -> float:
        return clock.perf_counter() - self._began

    @property
    def looped(self) -> float:
        return clock.perf_counter() - self._loop_began


@dataclass
class _Keeper:
    """Keeps the state of an impact: in memory for a retry, in a checkpoint for a resumption."""

    impact: Impact
    ending: EndCriterion
    recorder: Recorder
    retries: "Retries[_Kept]"
    watch: _WallClock
    signals: StopSignals
    checkpoint_every: float
    save: Callable[[RunningState], None]
    saved: float = field(default_factory=clock.perf_counter)

    def keep(self) -> None:
        """Keep what is due. Raises Stopped, with a checkpoint written, when a signal has asked for it."""
        if self.retries.due():
            self.impact.update_ledger()
            if self.impact.ledger.is_sound:
                time = self.recorder.before + self.impact.time
                self.retries.keep(time, _Kept(self.state(), self.recorder.store.state()))
        now = clock.perf_counter()
        if self.signals.number or now - self.saved >= self.checkpoint_every:
            self.save(self.state())
            self.saved = clock.perf_counter()
        if self.signals.number:
            raise Stopped(self.signals.number)

    def state(self) -> RunningState:
        """Everything from which the impact goes on as if nothing had happened."""
        impact, retries, watch = self.impact, list(self.retries.applied), self.watch
        states = impact.state(), self.ending.state(), self.recorder.state()
        return RunningState(*states, retries, impact.domains.level, watch.wall, watch.looped)
