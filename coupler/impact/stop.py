"""Handling of the signals that ask a run to stop."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from ..core.process import handled


class Stopped(KeyboardInterrupt):
    """The run has stopped after a signal and has written a checkpoint. Its argument is the number of the signal."""


@contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Context in which a first SIGINT or SIGTERM is only recorded, in the list that the context gives: the current chunk of steps is
    completed. A second one interrupts the program at once."""
    signals = list[int]()

    def note(number: int, _frame: FrameType | None) -> None:
        if signals:
            raise KeyboardInterrupt
        signals.append(number)

    with handled(note, signal.SIGINT, signal.SIGTERM):
        yield signals
