"""Handling of the signals that ask a run to stop."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from ..core.process import handled


class Stopped(KeyboardInterrupt):
    """The run has stopped after a signal and has written a checkpoint. Its argument is the number of the signal."""


class StopSignals:
    """The signals so far. number: number of the first signal, 0 if there is none. A second signal interrupts the program at once."""

    number = 0

    def note(self, number: int, _frame: FrameType | None) -> None:
        """Record a received signal."""
        if self.number:
            raise KeyboardInterrupt
        self.number = number


@contextmanager
def stop_signals() -> Iterator[StopSignals]:
    """Context manager in which SIGINT and SIGTERM are only recorded, so that the current chunk of steps is completed."""
    signals = StopSignals()
    with handled(signals.note, signal.SIGINT, signal.SIGTERM):
        yield signals
