"""The decorator `njit` of numba for all kernels, with a lock, so that simultaneous compilations do not damage the cache.

numba numbers the cache files of a function by an index file, which it reads and writes without a lock. If two processes save kernels
for different argument types at the same time, they can use the same number; a later process then loads the wrong kernel.
"""

import fcntl
import os
import threading
from pathlib import Path

from numba import njit
from numba.core import event

__all__ = ["LOCK", "njit", "uncounted"]

LOCK = "lock"  # file in the folder of the kernels

#: Decorator of kernels that get tables of arrays in loops over rows. They do not count references to these arrays: threads wait for
#: each other to count, and for many arrays it takes longer than the arithmetic of a row. Such a kernel may make and return no array.
uncounted = njit(cache=True, nogil=True, _nrt=False)  # type: ignore[call-overload]  # an option that numba does not document


class _Lock(event.Listener):
    """Locks the file LOCK against other processes while a thread of this process loads, compiles or saves a kernel."""

    def __init__(self, path: Path):
        self._path, self._mutex, self._depth = path, threading.Lock(), 0
        self._descriptor: int | None = None

    def on_start(self, event: event.Event) -> None:
        with self._mutex:
            self._depth += 1
            if self._depth == 1:
                self._hold(fcntl.LOCK_EX)

    def on_end(self, event: event.Event) -> None:
        with self._mutex:
            self._depth -= 1
            if self._depth == 0:
                self._hold(fcntl.LOCK_UN)

    def _hold(self, command: int) -> None:
        try:
            if self._descriptor is None:
                self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            fcntl.lockf(self._descriptor, command)  # per process: a forked process has its own lock
        except OSError:
            return  # a file system without locks


event.register("numba:compiler_lock", _Lock(Path(os.environ["NUMBA_CACHE_DIR"]) / LOCK))
