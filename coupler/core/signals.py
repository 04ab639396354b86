"""Signals that end a computation in the same way as Ctrl-C."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType


@contextlib.contextmanager
def handled(handler: Callable[[int, FrameType | None], None], *numbers: int) -> Iterator[None]:
    """Context in which these signals call the handler. Without effect outside the main thread, which alone receives signals."""
    is_main = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, handler) for number in numbers if is_main}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


def interrupted_by(*numbers: int) -> contextlib.AbstractContextManager[None]:
    """Context in which each of these signals raises KeyboardInterrupt with its number, except those that the process ignores, as under
    nohup."""

    def end(number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt(number)

    return handled(end, *(number for number in numbers if signal.getsignal(number) != signal.SIG_IGN))
