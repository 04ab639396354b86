"""This process: the processors that it may use, its search for cycles of references, and signals that end it as Ctrl-C does."""

import atexit
import gc
import math
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from types import FrameType

CGROUP = Path("/sys/fs/cgroup")
# New objects before a search for cycles. Modules and kernels are 200 000 objects that stay: with Python's 700 the searches take 0.3 s
# of a short run.
SEARCH_AFTER = 10_000


def cores() -> int:
    """Number of processors that this process may use: the limits are its affinity, its container and its Slurm job."""
    affinity = getattr(os, "sched_getaffinity", None)  # macOS has none
    granted = [float(len(affinity(0)) if affinity is not None else os.cpu_count() or 1)]
    with suppress(OSError, ValueError):
        quota, period = (CGROUP / "cpu.max").read_text().split()
        granted.append(float(quota) / float(period))
    with suppress(KeyError, ValueError):
        granted.append(float(os.environ["SLURM_CPUS_PER_TASK"]))
    return max(1, math.ceil(min(granted) - 1e-9))


def search_cycles_less() -> None:
    """Let this process search for cycles of references less often, and not at its end: there the system frees the memory, and the
    searches would take 0.5 s."""
    gc.set_threshold(SEARCH_AFTER)
    atexit.register(gc.freeze)


@contextmanager
def handled(handler: Callable[[int, FrameType | None], None], *numbers: int) -> Iterator[None]:
    """Context in which the signals `numbers` call the handler. Only the main thread receives signals: no effect in others."""
    is_main = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, handler) for number in numbers if is_main}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


def interrupted_by(*numbers: int) -> AbstractContextManager[None]:
    """Context in which each of the signals `numbers` raises KeyboardInterrupt with its number. Signals that the process ignores, as
    under nohup, remain ignored."""

    def end(number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt(number)

    return handled(end, *(number for number in numbers if signal.getsignal(number) != signal.SIG_IGN))
