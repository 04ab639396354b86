"""Roles of the processes: one process, or ranks under mpiexec.

The last rank, the *root*, computes the target, the contact and the ledger, and writes the files. The other ranks share the particle in
equal parts. Between chunks of steps the root calls methods on the other ranks (`DistributedParticle.ask`). Within a chunk each other
rank computes its part; in every step it sends to the root the positions and velocities of the points that may be in contact, and
receives forces. In one process the root has the full particle and exchanges no data.
"""

import os
import signal
import sys
import time as clock
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import TypeVar

import numpy as np
from mpi4py.MPI import COMM_SELF, COMM_WORLD, Comm, Intracomm

from ..core.process import handled
from ..errors import ColdsprayError, SolverError
from ..particle.particle import Particle

STEP = 7  # tag of the messages of a step
R = TypeVar("R")
_LAUNCHERS = ("PMI_SIZE", "PMIX_RANK", "OMPI_COMM_WORLD_SIZE")


@dataclass(frozen=True)
class Ranks:
    """The roles of the ranks. comm: communicator of all ranks. sph_comm: communicator of the ranks that share the particle, None on the
    root."""

    rank: int = 0
    size: int = 1
    comm: Intracomm = field(default_factory=lambda: COMM_SELF, repr=False)
    sph_comm: Comm | None = field(default_factory=lambda: COMM_SELF, repr=False)

    @property
    def root(self) -> int:
        """Number of the last rank, which computes the target."""
        return self.size - 1

    @property
    def sph(self) -> range:
        """The ranks that share the particle."""
        return range(max(self.size - 1, 1))

    @property
    def is_root(self) -> bool:
        return self.rank == self.root


def arrange() -> Ranks:
    """The roles of this process and of all others that mpiexec started.

    Parts of the particle are equal, because their ranks wait for each other in LAMMPS twice in each step: before the stresses and
    between stresses and forces.
    """
    comm = COMM_WORLD
    if not any(name in os.environ for name in _LAUNCHERS) or comm.size == 1:
        return Ranks()
    is_root = comm.rank == comm.size - 1
    sph_comm = comm.Split(int(is_root), comm.rank)
    return Ranks(comm.rank, comm.size, comm, None if is_root else sph_comm)


class RemoteFailure(SolverError):
    """A step was stopped because another rank failed."""


def begin_impact(ranks: Ranks, i: int, place: np.ndarray, numerics: Mapping[str, float]) -> None:
    """Called on the root: make the other ranks build their parts of the particle of impact i. place (3,) m: centre of the particle.
    numerics: changed fields of `particle.particle.Numerics` by name, as after a retry."""
    if ranks.size > 1:
        ranks.comm.bcast(("impact", (i, place, dict(numerics)), None), root=ranks.root)


@contextmanager
def leading(ranks: Ranks) -> Iterator[None]:
    """Context manager on the root, in which the other ranks `serve`. At its end the other ranks stop, and raise the error that ended
    the run, if there is one.

    An unexpected error, one that is not a ColdsprayError or an interrupt, ends all ranks.
    """
    ended: BaseException | None = None
    try:
        yield
    except (ColdsprayError, KeyboardInterrupt) as error:
        ended = error
        raise
    except BaseException:
        if ranks.size > 1:
            traceback.print_exc()
            abort(ranks.comm, "coldspray: the rank of the target failed; all ranks are stopped", 1)
        raise
    finally:
        if ranks.size > 1:
            ranks.comm.bcast(("end", (ended,), None), root=ranks.root)


def serve(ranks: Ranks, build: Callable[[int, np.ndarray, Mapping[str, float]], Particle]) -> None:
    """Main loop of a rank other than the root: build its part of each particle and execute the root's requests until the run ends.

    build(i, place, numerics): makes this rank's part of the particle of impact i, with its centre at place (3,) m. If the run fails,
    the root sends its error, and this function raises it. An error of this rank outside of its particle, or in `build`, ends all ranks.
    """
    # the root stops the run and reports it
    with handled(lambda *_: None, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        _serve(ranks, build)


def _serve(ranks: Ranks, build: Callable[[int, np.ndarray, Mapping[str, float]], Particle]) -> None:
    worker = _Worker(ranks, None)
    comm, root = ranks.comm, ranks.root
    while True:
        order, arguments, each = comm.bcast(None, root=root)
        if order == "end":
            if worker.local is not None:
                worker.local.close()
            if arguments[0] is not None:
                raise arguments[0]
            return
        try:
            if order == "impact":
                if worker.local is not None:
                    worker.local.close()
                worker = _Worker(ranks, build(*arguments))
            else:
                own = () if each is None else (each[ranks.rank],)  # the last argument of this rank
                party = worker if order in vars(_Worker) else worker.local
                comm.gather(caught(partial(getattr(party, order), *arguments, *own)), root=root)
        except BaseException as error:
            if not isinstance(error, ColdsprayError):
                traceback.print_exc()
            abort(comm, f"coldspray: rank {ranks.rank} failed: {error}", getattr(error, "exit_code", 1))


class _Worker:
    """A rank's part of the particle, and its exchange of data with the root."""

    def __init__(self, ranks: Ranks, local: Particle | None):
        self.ranks, self.local, self.waited = ranks, local, 0.0
        if local is not None:
            local.is_shared = True

    def waiting(self) -> float:
        return self.waited

    def call(self, work: Callable[[], R]) -> R:
        return work()

    def run_steps(self, steps: int, dt: float, rows: np.ndarray) -> None:
        p, comm, root = self.local, self.ranks.comm, self.ranks.root
        assert p is not None, "only ranks with points make steps"
        k, done = 3 * len(rows), 0
        outbox, inbox = np.zeros(1 + 2 * k), np.zeros(1 + k)

        def on_step() -> None:
            nonlocal done
            done += 1
            outbox[0] = float(p.failure is not None)
            outbox[1 : 1 + k] = p.points.x[rows].ravel()
            outbox[1 + k :] = p.points.v[rows].ravel()
            comm.Send(outbox, dest=root, tag=STEP)
            started = clock.perf_counter()
            comm.Recv(inbox, source=root, tag=STEP)
            self.waited += clock.perf_counter() - started
            p.f_ext[rows] = inbox[1:].reshape(-1, 3)
            if inbox[0] and p.failure is None:
                raise RemoteFailure("stopped: another rank failed")

        try:
            p.run(steps, dt, on_step)
        finally:
            outbox[0] = 1.0
            for _ in range(steps - done):  # LAMMPS has stopped early: the root waits for all steps of the chunk
                comm.Send(outbox, dest=root, tag=STEP)
                comm.Recv(inbox, source=root, tag=STEP)


def caught(work: Callable[[], R]) -> R | BaseException:
    """Call work() and return its result, or the error that it raised in a form that can be sent to another rank."""
    try:
        return work()
    except (ColdsprayError, KeyboardInterrupt) as error:
        return error
    except Exception as error:
        traceback.print_exc()
        return SolverError(f"{type(error).__name__}: {error}")


def abort(comm: Intracomm, message: str, code: int) -> None:
    """Print a message and end all ranks with an exit code."""
    print(message, file=sys.stderr, flush=True)
    comm.Abort(code)
