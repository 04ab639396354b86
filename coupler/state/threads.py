"""A second thread on a second core, for work that releases Python's lock (compiled kernels).

A process has one second thread or none (`second_thread`). Loops over points, pairs, nodes and elements are divided into ranges
(`share`), and either thread takes the next range as soon as it is free. A kernel writes only the rows of its range, so that numbers
do not depend on how many threads there are.
"""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Condition, Thread

PARTS = 8  # ranges that a loop is divided into, at most


class Task:
    """Work that the second thread does. error: what it raised."""

    def __init__(self, work: Callable[[], None]):
        self.work, self.done = work, False
        self.error: BaseException | None = None


class _Loop:
    """A loop over ranges that are taken one by one. helpers: how many other threads work on it; error: the first that was raised."""

    def __init__(self, work: Callable[[int], None], parts: int):
        self._work, self._left = work, iter(range(parts))
        self.helpers = 0
        self.error: BaseException | None = None

    def take(self) -> None:
        """Do parts until none is left."""
        for part in self._left:
            try:
                self._work(part)
            except BaseException as error:
                self.error = self.error or error


class SecondThread:
    """Does the tasks that are submitted, in their order, and helps with loops that are shared when it has no task."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._tasks: deque[Task] = deque()
        self._loops: list[_Loop] = []  # that have ranges left
        self._closing = False
        self._thread = Thread(target=self._serve, daemon=True)
        self._thread.start()

    def submit(self, work: Callable[[], None]) -> Task:
        """Have work done there."""
        task = Task(work)
        with self._changed:
            self._tasks.append(task)
            self._changed.notify_all()
        return task

    def wait(self, task: Task) -> None:
        """Help with the loops of a task until it is done. Raises what it raised."""
        self._help(lambda: task.done)
        if task.error is not None:
            raise task.error

    def share(self, work: Callable[[int], None], parts: int) -> None:
        """Do work(0) to work(parts - 1), each once, here and there; all are done on return. Raises what one of them raised."""
        loop = _Loop(work, parts)
        with self._changed:
            self._loops.append(loop)
            self._changed.notify_all()
        loop.take()
        with self._changed:
            self._loops.remove(loop)
            self._changed.notify_all()
            self._changed.wait_for(lambda: loop.helpers == 0)
        if loop.error is not None:
            raise loop.error

    def close(self) -> None:
        """End it, after what it has to do."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _help(self, enough: Callable[[], bool]) -> None:
        """Take ranges of shared loops until `enough`."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: enough() or bool(self._loops))
                if enough():
                    return
                loop = self._loops[-1]
                loop.helpers += 1
            loop.take()
            with self._changed:
                loop.helpers -= 1
                self._changed.notify_all()
                while loop in self._loops and not enough():  # nothing is left of it
                    self._changed.wait()

    def _serve(self) -> None:
        while True:
            self._help(lambda: bool(self._tasks) or self._closing)
            with self._changed:
                if not self._tasks:
                    return
                task = self._tasks.popleft()
            try:
                task.work()
            except BaseException as error:
                task.error = error
            with self._changed:
                task.done = True
                self._changed.notify_all()


_second: SecondThread | None = None


@contextmanager
def second_thread(threads: int) -> Iterator[None]:
    """With threads = 2, this process has a second thread meanwhile."""
    global _second
    before = _second
    _second = SecondThread() if threads > 1 else None
    try:
        yield
    finally:
        if _second is not None:
            _second.close()
        _second = before


def second() -> SecondThread | None:
    """The second thread of this process, where it has one."""
    return _second


def share(work: Callable[[int, int], None], count: int, least: int, sums: bool = False) -> None:
    """Do work(lo, hi) over ranges that make up [0, count), `least` long or longer, in both threads where there are two.

    sums: work sums over each range; the ranges are then the same with one thread, so that the sums have the same value.
    """
    parts = max(1, min(PARTS, count // least)) if sums or _second is not None else 1
    bounds = [count * i // parts for i in range(parts + 1)]
    if _second is None or parts == 1:
        for i in range(parts):
            work(bounds[i], bounds[i + 1])
    else:
        _second.share(lambda i: work(bounds[i], bounds[i + 1]), parts)
