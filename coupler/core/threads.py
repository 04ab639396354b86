"""A second thread on a second core, for work that releases Python's lock (compiled kernels).

A process has one second thread or none (`second_thread`, `add_second_thread`). Compiled functions whose loops are divided (`loops`)
are called by both threads (`together`); loops over kernels in Python are divided into ranges (`share`). Either thread takes the next
range as soon as it is free. A kernel writes only the rows of its range, so that numbers do not depend on how many threads there are.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from threading import Lock, Thread
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from .arrays import Ints
from .loops import LOOPS, wait_for

PARTS = 8  # ranges that a loop in Python is divided into, at most
R = TypeVar("R")


class _Loop:
    """A loop over ranges that are taken one by one. error: the first that was raised; done: released when all parts are done."""

    def __init__(self, work: Callable[[int], None], parts: int):
        self._work, self._next, self._left = work, iter(range(parts)), parts
        self._lock, self.done = Lock(), Lock()
        self.done.acquire()
        self.error: BaseException | None = None

    def take(self) -> None:
        """Do parts until none is left."""
        for part in self._next:
            try:
                self._work(part)
            except BaseException as error:
                self.error = self.error or error
            with self._lock:
                self._left -= 1
                if not self._left:
                    self.done.release()


def _team() -> Ints:
    return np.zeros(2 * LOOPS + 1, np.int64)


class SecondThread:
    """Runs each submitted task, in order. It returns at once from one that the main thread has already finished."""

    def __init__(self) -> None:
        self._begun: SimpleQueue[tuple[Callable[[Ints], object], Ints] | None] = SimpleQueue()
        self._next = _team()  # of the work to come
        self._thread = Thread(target=self._serve, args=(self._next,), daemon=True)
        self._thread.start()

    def join(self, work: Callable[[Ints], object]) -> Ints:
        """Submit work(team) to the second thread. Returns the team, which the caller passes to its own call."""
        team, self._next = self._next, _team()
        self._begun.put((work, self._next))
        return team

    def share(self, work: Callable[[int], None], parts: int) -> None:
        """Do work(0) to work(parts - 1), each once, here and there; all are done on return. Raises what one of them raised."""
        loop = _Loop(work, parts)
        self.join(lambda team: loop.take())[0] = 1
        loop.take()
        loop.done.acquire()
        if loop.error is not None:
            raise loop.error

    def close(self) -> None:
        """End it, after what was begun."""
        self._begun.put(None)
        self._thread.join()

    def _serve(self, team: Ints) -> None:
        wait_for(team)
        while (begun := self._begun.get()) is not None:
            work, following = begun
            del begun
            with suppress(BaseException):  # the other thread raises it
                work(team)
            del work  # it holds arrays
            team = following
            wait_for(team)


_second: SecondThread | None = None


@contextmanager
def second_thread(threads: int) -> Iterator[None]:
    """With threads = 2, this process has a second thread meanwhile. BLAS has one: two would add up long products in another order,
    and wait for a core that the second thread keeps busy."""
    global _second
    before = _second
    _second = SecondThread() if threads > 1 else None
    try:
        with threadpool_limits(1, "blas"):
            yield
    finally:
        if _second is not None:
            _second.close()
        _second = before


def add_second_thread() -> None:
    """Give this process a second thread until the end of the `second_thread` that it is in, where it has none."""
    global _second
    if _second is None:
        _second = SecondThread()


def together(function: Callable[..., R], *arguments: object) -> R:
    """function(team, *arguments), compiled, whose loops are `loops.ranges` of the team, in both threads where there are two.

    Raises what it raises in one of them.
    """
    errors: list[BaseException] = []

    def call(team: Ints) -> R:
        try:
            return function(team, *arguments)
        except BaseException as error:
            errors.append(error)
            team[-1] = 1
            raise

    result = call(_second.join(call) if _second is not None else _team())
    if errors:
        raise errors[0]
    return result


def share(work: Callable[[int, int], None], count: int, least: int) -> None:
    """Do work(lo, hi) over ranges that make up [0, count), `least` long or longer, in both threads where there are two."""
    parts = max(1, min(PARTS, count // least)) if _second is not None else 1
    bounds = [count * i // parts for i in range(parts + 1)]
    if _second is None or parts == 1:
        work(0, count)
    else:
        _second.share(lambda i: work(bounds[i], bounds[i + 1]), parts)


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0))
