"""Signals that ask a run to stop."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from ..core.signals import handled


class Stopped(KeyboardInterrupt):
    """The run was asked to stop, and has written a checkpoint. Its argument: the number of the signal that asked."""


class StopSignals:
    """number: of the signal that has asked the run to stop, 0 so far; a second one interrupts at once."""

    number = 0

    def note(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.number:
            raise KeyboardInterrupt
        self.number = number


@contextmanager
def stop_signals() -> Iterator[StopSignals]:
    """While in use, SIGINT and SIGTERM are noted and the chunk of steps is completed."""
    signals = StopSignals()
    with handled(signals.note, signal.SIGINT, signal.SIGTERM):
        yield signals
