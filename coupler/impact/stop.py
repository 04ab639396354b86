"""Signals that ask a run to stop."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from ..core.signals import handled


class Stopped(KeyboardInterrupt):
    """The run has stopped after a signal and written a checkpoint. Argument: number of the signal."""


class StopSignals:
    """Signals that ask a run to stop. number: of the first signal, 0 before it; a second signal interrupts at once."""

    number = 0

    def note(self, number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.number:
            raise KeyboardInterrupt
        self.number = number


@contextmanager
def stop_signals() -> Iterator[StopSignals]:
    """Context in which SIGINT and SIGTERM are only recorded, so that the chunk of steps is completed."""
    signals = StopSignals()
    with handled(signals.note, signal.SIGINT, signal.SIGTERM):
        yield signals
