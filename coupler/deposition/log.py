"""The log file of a run."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from numba.core import event

from ..files.store import Store
from ..progress import Progress


@contextmanager
def logged(progress: Progress, store: Store) -> Iterator[None]:
    """Context that writes all lines of the progress, and an error that ends the run, to the log file of the run. The compilation of
    kernels is shown as a stage of the progress."""
    compiling = _Compiling(progress)
    progress.record = store.log
    event.register("numba:compile", compiling)
    try:
        yield
    except KeyboardInterrupt as stop:
        by = f"the signal {signal.Signals(stop.args[0]).name}" if stop.args else "the user"
        progress.record(f"stopped by {by}")
        raise
    except BaseException as error:
        progress.record(f"{type(error).__name__}: {error}")
        raise
    finally:
        event.unregister("numba:compile", compiling)
        progress.stop()
        progress.record = lambda text: None


class _Compiling(event.TimingListener):
    """Shows the compilation of kernels as a stage, and records its duration."""

    def __init__(self, progress: Progress):
        super().__init__()
        self.progress = progress

    def on_start(self, event: event.Event) -> None:
        self.progress.stage("compiling the kernels (only once on this machine)")
        super().on_start(event)

    def on_end(self, event: event.Event) -> None:
        super().on_end(event)
        if self.done:
            self.progress.compiling = self.duration
