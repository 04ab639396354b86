"""Signals that ask a run to stop."""

import signal
import threading
from collections.abc import Callable
from signal import Handlers
from types import FrameType


class Stopped(KeyboardInterrupt):
    """The run was asked to stop, and has written a checkpoint. Its argument: the number of the signal that asked."""


class StopSignals:
    """While in use, SIGINT and SIGTERM are noted and the chunk of steps is completed; a second one interrupts at once."""

    def __init__(self) -> None:
        self.number = 0
        self._before: dict[int, Callable[[int, FrameType | None], object] | int | Handlers | None] = {}

    def __enter__(self) -> "StopSignals":
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if self.number:
            raise KeyboardInterrupt
        self.number = number

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
