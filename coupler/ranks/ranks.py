"""Who runs where: one process, or ranks under mpiexec. Only this package imports mpi4py, beside what LAMMPS needs.

The last rank, the *root*, holds the target, the contact, the ledger and the files; the others share the particle in equal parts. The
root leads: between chunks of steps it asks them for what it needs (`DistributedParticle.ask`); within a chunk LAMMPS runs on each
of them, and in every step they send positions and velocities of the points that may touch to the root and receive forces. In one
process the root has the whole particle, and the same code exchanges nothing.
"""

import os
import signal
import sys
import time as clock
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from mpi4py.MPI import COMM_SELF, COMM_WORLD, Comm, Intracomm

from ..errors import ColdsprayError, SolverError
from ..particle.particle import Particle

STEP = 7  # tag of the messages of a step
R = TypeVar("R")
_LAUNCHERS = ("PMI_SIZE", "PMIX_RANK", "OMPI_COMM_WORLD_SIZE")


@dataclass(frozen=True)
class Ranks:
    """The roles of the ranks. comm: communicator of all ranks; sph_comm: of the ranks that share the particle, None on others."""

    rank: int = 0
    size: int = 1
    comm: Intracomm = field(default_factory=lambda: COMM_SELF, repr=False)
    sph_comm: Comm | None = field(default_factory=lambda: COMM_SELF, repr=False)

    @property
    def root(self) -> int:
        """The rank of the target, the last."""
        return self.size - 1

    @property
    def sph(self) -> range:
        """The ranks that share the particle."""
        return range(max(self.size - 1, 1))

    @property
    def is_root(self) -> bool:
        return self.rank == self.root

    @property
    def has_points(self) -> bool:
        return self.rank in self.sph


def world() -> Intracomm | None:
    """The communicator of all processes that mpiexec started, or None in a single one."""
    if not any(name in os.environ for name in _LAUNCHERS):
        return None
    return COMM_WORLD if COMM_WORLD.size > 1 else None


def arrange(comm: Intracomm | None) -> Ranks:
    """Decide who runs where.

    Parts of the particle are equal: all ranks that have one meet inside LAMMPS twice in each step, before its forces and between its
    stresses and its forces.
    """
    if comm is None:
        return Ranks()
    is_root = comm.rank == comm.size - 1
    sph_comm = comm.Split(int(is_root), comm.rank)
    return Ranks(comm.rank, comm.size, comm, None if is_root else sph_comm)


class RemoteFailure(SolverError):
    """A step was given up because another rank failed."""


def begin_impact(ranks: Ranks, i: int, place: np.ndarray, numerics: Mapping[str, float]) -> None:
    """On the root rank: make the others build their parts of the particle of impact i, its centre at place (3,) m.

    numerics: of `particle.particle.Numerics`, which a retry changes: all ranks compute by the same.
    """
    if ranks.size > 1:
        ranks.comm.bcast(("impact", (i, place, dict(numerics)), None), root=ranks.root)


@contextmanager
def leading(ranks: Ranks) -> Iterator[None]:
    """Context on the root rank in which the others `serve`; at its end they stop, with the error (if any) that ended the run.

    An error that is not of the program takes all ranks down.
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
            abort(ranks.comm, "coldspray: the rank with the target failed; all ranks are stopped", 1)
        raise
    finally:
        if ranks.size > 1:
            ranks.comm.bcast(("end", (ended,), None), root=ranks.root)


def serve(ranks: Ranks, build: Callable[[int, np.ndarray, Mapping[str, float]], Particle]) -> None:
    """Main loop of a rank without the target: build its part of each particle and serve the root's requests until the end.

    build(i, place, numerics): this rank's part of the particle of impact i.

    Raises the error that ended the run, if any. Anything else that goes wrong here takes all ranks down.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the root stops the run and reports it
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
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
            elif order == "waited":
                comm.gather(worker.waited, root=root)
            elif order == "everywhere":
                comm.gather(arguments[0](), root=root)
            else:
                comm.gather(attempt(worker, order, arguments, each), root=root)
        except BaseException as error:
            if not isinstance(error, ColdsprayError):
                traceback.print_exc()
            abort(comm, f"coldspray: rank {ranks.rank} failed: {error}", getattr(error, "exit_code", 1))


class _Worker:
    """A rank's part of the particle and its side of the exchange."""

    def __init__(self, ranks: Ranks, local: Particle | None):
        self.ranks, self.local, self.waited = ranks, local, 0.0
        if local is not None:
            local.is_shared = True

    def run_steps(self, steps: int, dt: float, rows: np.ndarray) -> None:
        p, comm, root = self.local, self.ranks.comm, self.ranks.root
        assert p is not None, "only ranks with points make steps"
        k = 3 * len(rows)
        outbox, inbox = np.zeros(1 + 2 * k), np.zeros(1 + k)

        done = 0

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
                raise RemoteFailure("given up")

        try:
            p.run(steps, dt, on_step)
        finally:
            outbox[0] = 1.0
            for _ in range(steps - done):  # LAMMPS has stopped early: the root still counts to the end of the chunk
                comm.Send(outbox, dest=root, tag=STEP)
                comm.Recv(inbox, source=root, tag=STEP)


def attempt(worker: _Worker, method: str, arguments: tuple[object, ...], each: Sequence[object] | None) -> object:
    """Call a method of a rank's part of the particle, or its side of a chunk of steps; the result or the error."""
    if each is not None:
        arguments = (*arguments, each[worker.ranks.rank])
    return caught(lambda: getattr(worker if method == "run_steps" else worker.local, method)(*arguments))


def caught(work: Callable[[], R]) -> R | BaseException:
    """The result of work, or the error it raised, in a form that can travel."""
    try:
        return work()
    except (ColdsprayError, KeyboardInterrupt) as error:
        return error
    except Exception as error:
        traceback.print_exc()
        return SolverError(f"{type(error).__name__}: {error}")


def abort(comm: Intracomm, message: str, code: int) -> None:
    """Say what happened, once, and take all ranks down."""
    print(message, file=sys.stderr, flush=True)
    comm.Abort(code)
