"""A second thread on a second core, for work that releases Python's lock (compiled kernels)."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor


class SecondThread:
    """Does what is submitted, in that order, and helps with what is shared as soon as it has nothing else to do."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1)

    def submit(self, work: Callable[[], None]) -> "Future[None]":
        """Have work done there."""
        return self._pool.submit(work)

    def share(self, work: Callable[[int], None], parts: int) -> None:
        """Do work(0) to work(parts - 1), each once, here and there; all are done on return. Raises what one of them raised."""
        left = iter(range(parts))

        def take() -> None:
            for part in left:
                work(part)

        helping = self._pool.submit(take)
        try:
            take()
        finally:
            if not helping.cancel():
                helping.result()

    def close(self) -> None:
        """End it, after what it has to do."""
        self._pool.shutdown(wait=True)
