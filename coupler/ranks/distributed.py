"""All points of the particle on the root rank, which computes the target. Other ranks compute the points."""

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from ..core.records import arrays_of
from ..particle.particle import LocalState, Particle, PointState, PointTotals
from .ranks import STEP, Ranks, RemoteFailure, caught

R = TypeVar("R")


@dataclass(frozen=True)
class ParticleState:
    """State of the whole particle. whole: all points as on one rank, in the given order. totals: sums and extremes of all points."""

    whole: LocalState
    totals: PointTotals


class DistributedParticle:
    """The particle on the root: all its points, on one rank or on several. It has the attributes of `particle.particle.Particle`.

    x, v, f_ext (n,3): arrays of all points, in the order in which they were given. Within a chunk of steps x and v are updated only
    at points that may be in contact. All other points, and totals, have the values at the end of the last chunk. dt (s): of the last
    steps; steps: number of steps made; waited: time (s) for which this rank has waited for other ranks in steps.
    """

    def __init__(self, ranks: Ranks, local: Particle | None, points: int, spacing: float):
        """local: the particle in one process, None if other ranks have it. points: number of points of all ranks. spacing m."""
        self.ranks, self.local, self.n, self.spacing = ranks, local, points, spacing
        self.steps, self.dt, self.waited = 0, 0.0, 0.0
        self._points: PointState | None = None  # gathered since the last step
        if local is not None:
            self.x, self.v, self.f_ext = local.points.x, local.points.v, local.f_ext
            self._owner = [np.arange(self.n)]
        else:
            self.f_ext = np.zeros((self.n, 3))
            self._owner = self.ask("get", "ids")
            self.x, self.v = self.whole("x"), self.whole("v")
        self.mass = self.whole("mass")
        self.numerics = self.ask("get", "numerics")[0]
        self.law: np.ndarray = self.ask("get", "law")[0]
        self.law_of: np.ndarray = self.whole("law_of")
        self.totals = self._sum_up()

    # ---- between chunks of steps ------------------------------------------------------------------------------------------

    def ask(self, method: str, *arguments: object, each: Sequence[object] | None = None) -> list[Any]:
        """Call a method of the particle's part on every rank that has one. Returns the results by rank. each: one more argument for
        each rank. Raises the error of the first rank that failed."""
        if self.local is not None:
            return [getattr(self.local, method)(*arguments, *((each[0],) if each else ()))]
        r = self.ranks
        r.comm.bcast((method, arguments, each), root=r.root)
        answers = self._answers()
        for answer in answers:
            if isinstance(answer, BaseException):
                raise answer
        return answers

    def _answers(self) -> list[Any]:
        """Results or errors of the other ranks, by rank."""
        values = self.ranks.comm.gather(None, root=self.ranks.root)
        assert values is not None, "only the root gathers"
        return values[:-1]

    def whole(self, name: str) -> np.ndarray:
        """A field of all points (n, ...), by its name in `particle.particle.Particle`."""
        return self._joined(self.ask("get", name))

    def _joined(self, parts: list[np.ndarray]) -> np.ndarray:
        """An array of all points (n, ...) from the arrays of the ranks."""
        if self.local is not None:
            return parts[0]
        whole = np.empty((self.n, *parts[0].shape[1:]), parts[0].dtype)
        for ids, part in zip(self._owner, parts, strict=True):
            whole[ids] = part
        return whole

    def _all(self, parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        return {name: self._joined([part[name] for part in parts]) for name in parts[0]}

    def _sum_up(self) -> PointTotals:
        self._points = None
        return PointTotals.over(self.ask("totals"))

    @property
    def points(self) -> PointState:
        """State of all points between two chunks of steps, in the order in which they were given. Read only."""
        if self.local is not None:
            return self.local.points
        if self._points is None:
            self._points = self.state().whole.points
        return self._points

    def stress(self) -> np.ndarray:
        """True Cauchy stress (n,6) Pa in Voigt order xx yy zz yz xz xy."""
        return self.whole("stress")

    def carried(self) -> dict[str, np.ndarray]:
        """State of the metal at the points: arrays (n, ...) by name (`physics.metal`). A mesh of the points in their current positions
        inherits it."""
        return self._all(self.ask("carried"))

    def warm(self, heat: np.ndarray) -> None:
        """Add heat (n,) J to the points of the particle."""
        self.ask("warm", each=[heat[ids] for ids in self._owner])
        self._points = None

    def state(self) -> ParticleState:
        """The state of the full particle, points in the order in which they were given."""
        parts: list[LocalState] = self.ask("state")
        points = replace(parts[0].points, **self._all([arrays_of(part.points) for part in parts]))
        sums, work = np.sum([part.sums for part in parts], axis=0), sum(part.internal_work for part in parts)
        return ParticleState(replace(parts[0], points=points, sums=sums, internal_work=work), self.totals)

    def restore(self, state: ParticleState) -> None:
        """Set the particle, which must be newly distributed, to a state. The number of ranks may differ from that of the run that
        saved the state. Raises CheckpointError if the state does not fit."""
        self.ask("restore", state.whole, each=[i == 0 for i in range(len(self._owner))])
        self.steps, self.dt = state.whole.steps, state.whole.dt
        self.totals = state.totals  # cannot be computed yet: LAMMPS computes the strains only in the next step
        self._points = None
        if self.local is None:
            self.x, self.v = self.whole("x"), self.whole("v")

    # ---- steps ---------------------------------------------------------------------------------------------------

    def run(
        self, steps: int, dt: float, begin: Callable[[], None], meet: Callable[[], None], needed: np.ndarray | None
    ) -> None:
        """Make `steps` steps of dt seconds. Each step from n to n+1 calls begin(), which needs no data of the particle, then meet(),
        which computes f_ext. In meet(), the points `needed` (k,) have x at n+1 and v at n+1/2. needed: indices; None for all points.

        Raises the error of one of these functions or of a rank, after all ranks have ended the chunk.
        """
        self.dt = dt
        if self.local is not None:

            def on_step() -> None:
                begin()
                meet()

            self.local.run(steps, dt, on_step)
        else:
            self._run(steps, dt, begin, meet, np.arange(self.n) if needed is None else needed)
        self.steps += steps
        self.totals = self._sum_up()
        if self.local is None:
            self.x[:], self.v[:] = self.whole("x"), self.whole("v")

    def _run(
        self, steps: int, dt: float, begin: Callable[[], None], meet: Callable[[], None], needed: np.ndarray
    ) -> None:
        r = self.ranks
        mark = np.zeros(self.n, bool)
        mark[needed] = True
        rows = [np.flatnonzero(mark[ids]) for ids in self._owner]
        where = [ids[row] for ids, row in zip(self._owner, rows, strict=True)]
        inbox = [np.zeros(1 + 6 * len(w)) for w in where]
        outbox = [np.zeros(1 + 3 * len(w)) for w in where]
        failure: BaseException | None = None
        r.comm.bcast(("run_steps", (steps, dt), rows), root=r.root)
        for _ in range(steps):
            requests = [r.comm.Irecv(inbox[rank], source=rank, tag=STEP) for rank in r.sph]
            failure = failure or caught(begin)
            started = clock.perf_counter()
            failed = failure is not None
            for i, request in enumerate(requests):
                request.Wait()
                failed |= bool(inbox[i][0])
                k = 3 * len(where[i])
                self.x[where[i]] = inbox[i][1 : 1 + k].reshape(-1, 3)
                self.v[where[i]] = inbox[i][1 + k :].reshape(-1, 3)
            self.waited += clock.perf_counter() - started
            self.f_ext[:] = 0.0
            if not failed:
                failure = caught(meet)
                failed = failure is not None  # the other ranks wait for this answer
            for rank in r.sph:
                outbox[rank][0] = float(failed)
                outbox[rank][1:] = self.f_ext[where[rank]].ravel()
                r.comm.Send(outbox[rank], dest=rank, tag=STEP)
        answers = self._answers()
        if failure is not None:
            raise failure
        for answer in answers:
            if isinstance(answer, BaseException) and not isinstance(answer, RemoteFailure):
                raise answer

    def idle(self, loop: float) -> list[float]:
        """Share of the wall time `loop` (s) in which each rank waited for others in steps, by rank. Empty in one process."""
        waited = [] if self.local is not None else [*self.ask("waiting"), self.waited]
        return [seconds / loop for seconds in waited]

    def everywhere(self, work: Callable[[], R]) -> list[R]:
        """Call work(), a function at the top level of a module, on every rank. Returns the results by rank."""
        return [*([] if self.local is not None else self.ask("call", work)), work()]

    def close(self) -> None:
        """Close the LAMMPS instance of this rank."""
        if self.local is not None:
            self.local.close()
