"""numba's `njit` for all kernels, with a lock: processes that compile at the same time leave a sound cache.

numba numbers the files of a function's compiled kernels by an index that it reads and writes without a lock. Two processes that save
kernels for other types of arguments at once can both take one number: who loads one of them later gets the other, without an error.
"""

import fcntl
import os
import threading
from pathlib import Path

from numba import njit
from numba.core import event

__all__ = ["LOCK", "njit"]

LOCK = "lock"  # file in the folder of the kernels


class _Lock(event.Listener):
    """Holds the file LOCK, against other processes, while this one loads, compiles or saves a kernel in any of its threads."""

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
            fcntl.lockf(self._descriptor, command)  # of this process: those that it forks have locks of their own
        except OSError:
            return  # a file system without locks


event.register("numba:compiler_lock", _Lock(Path(os.environ["NUMBA_CACHE_DIR"]) / LOCK))
