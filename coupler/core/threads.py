"""Threads for compiled kernels, which release Python's lock.

`threads_of` and `at_least` set the number of threads of a run. `together` calls a compiled function with shared loops (`loops`) in all
threads. `share` divides a loop in Python over kernels into ranges. A free thread does the next range. A kernel writes only the rows of
its range, so that results do not depend on the number of threads.

numba's `prange` is not used: with OpenMP a loop waits for cores that other processes use (up to 19 times as long), with numba's own
queue each loop takes 40 us more, and TBB, which is as fast as this module, needs one more package.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from queue import SimpleQueue
from threading import Thread
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from .arrays import Ints
from .loops import FAILED, wait_for
from .process import cores

RANGES = 4  # of a loop in Python, for each thread, at most
LEAST_ROWS = 4000  # in a range of `rows_at`, at least
R = TypeVar("R")


class Team:
    """The calling thread and `count` more threads. Each thread runs all submitted tasks in order. A task whose work is already done
    by other threads returns at once."""

    def __init__(self, count: int):
        self.count = count
        self._next: Ints = np.zeros(FAILED + 1, np.int64)  # `team` of the next task, see `loops.ranges`
        self._begun = [SimpleQueue[tuple[Callable[[Ints], object], Ints] | None]() for _ in range(count)]
        self._threads = [Thread(target=self._serve, args=(q, self._next), daemon=True) for q in self._begun]
        for thread in self._threads:
            thread.start()

    def join(self, work: Callable[[Ints], object]) -> Ints:
        """Give the call work(team) to the other threads. Returns `team` (`loops.ranges`) for the same call in the calling thread."""
        team, self._next = self._next, np.zeros(FAILED + 1, np.int64)
        for queue in self._begun:
            queue.put((work, self._next))
        return team

    def share(self, work: Callable[[int], object], parts: int) -> None:
        """Call work(0) to work(parts - 1), each once, in any thread, and wait for all. Raises an error of one of the calls."""
        left, done = iter(range(parts)), SimpleQueue[BaseException | None]()

        def do_parts(_: Ints | None = None) -> None:
            for part in left:
                try:
                    work(part)
                    done.put(None)
                except BaseException as error:
                    done.put(error)

        self.join(do_parts)[0] = 1
        do_parts()
        for error in [done.get() for _ in range(parts)]:
            if error is not None:
                raise error

    def close(self) -> None:
        """End the threads after all submitted tasks are done."""
        for queue in self._begun:
            queue.put(None)
        for thread in self._threads:
            thread.join()

    def _serve(self, queue: "SimpleQueue[tuple[Callable[[Ints], object], Ints] | None]", team: Ints) -> None:
        wait_for(team)
        while (begun := queue.get()) is not None:
            work, next_team = begun
            del begun
            with suppress(BaseException):  # the calling thread raises it
                work(team)
            del work  # it holds arrays
            team = next_team
            wait_for(team)


#: Team of the run in this thread of Python: two runs in one process have two teams.
_current: ContextVar[Team] = ContextVar("_current")
_ALONE = Team(0)


def _of(count: int) -> Team:
    return Team(min(count, cores()) - 1)  # more threads than cores would only wait


@contextmanager
def threads_of(count: int) -> Iterator[None]:
    """Context with `count` threads, at most one per core. BLAS has one thread: several would change the order of long sums, and wait
    for busy cores."""
    before = _current.set(_of(count))
    try:
        with threadpool_limits(1, "blas"):
            yield
    finally:
        _current.get().close()
        _current.reset(before)


def at_least(count: int) -> None:
    """Increase the number of threads to `count`, at most one per core, until the enclosing `threads_of` ends."""
    if _current.get().count < min(count, cores()) - 1:
        _current.get().close()
        _current.set(_of(count))


def together(function: Callable[..., R], *arguments: object) -> R:
    """Call a compiled function(team, *arguments) in all threads, which share its loops over `loops.ranges(team, ...)`.

    Returns the result of the call in this thread. Raises an error of one of the threads.
    """
    errors: list[BaseException] = []

    def call(team: Ints) -> R:
        try:
            return function(team, *arguments)
        except BaseException as error:
            errors.append(error)
            team[FAILED] = 1
            raise

    result = call(_current.get(_ALONE).join(call))
    if errors:
        raise errors[0]
    return result


def share(work: Callable[[int, int], object], count: int, least: int) -> None:
    """Call work(lo, hi) for ranges of [0, count), each of at least `least` rows, in all threads."""
    team = _current.get(_ALONE)
    parts = max(1, min(RANGES * (team.count + 1), count // least)) if team.count else 1
    if parts == 1:
        work(0, count)
        return
    bounds = [count * i // parts for i in range(parts + 1)]
    team.share(lambda i: work(bounds[i], bounds[i + 1]), parts)


def rows_at(array: np.ndarray, rows: Ints) -> np.ndarray:
    """The rows array[rows], copied in all threads."""
    found = np.empty((len(rows), *array.shape[1:]), array.dtype)

    def fill(lo: int, hi: int) -> None:
        found[lo:hi] = np.take(array, rows[lo:hi], axis=0)

    share(fill, len(rows), LEAST_ROWS)
    return found
