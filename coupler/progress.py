"""How far a run has come: a bar on a terminal, a line every few seconds elsewhere."""

import sys
import time
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

_BAR_EVERY = 0.1  # s of wall time between two drawings of the bar
_LINE_EVERY = 5.0  # between two log lines
_FIRST_LINE = 0.5  # after the start


class Progress:
    """Shows simulated time, kinetic energy left, dt and time to go. An update costs little and may come at every step.

    stream: where it goes, standard error by default. quiet: show nothing, but keep the time reached.
    `time` is the simulated time reached, s; nan before the first update.
    """

    def __init__(self, quiet: bool = False, stream: TextIO | None = None):
        self.quiet = quiet
        self.stream = stream if stream is not None else sys.stderr
        self.time = float("nan")
        self._end_time = float("nan")
        self._running = False
        self._state = (float("nan"), float("nan"), 0)  # kinetic fraction, dt, step
        self._bar: Bar | None = None
        self._first = (0.0, float("nan"))  # wall clock and simulated time of the first update
        self._next = 0.0

    def start(self, end_time: float) -> None:
        """Begin. end_time: the longest simulated time, s."""
        self._end_time, self.time, self._running = end_time, float("nan"), True
        self._first = (time.monotonic(), float("nan"))
        terminal = not self.quiet and self.stream.isatty()
        self._next = time.monotonic() + (0.0 if terminal else _FIRST_LINE)
        if terminal:
            self._bar = _bar(self.stream)
            self._bar.add_task("", total=end_time, status="starting")
            self._bar.start()

    def update(self, time_: float, kinetic_fraction: float, dt: float, step: int) -> None:
        """Report the state. time_, dt: s, simulated; kinetic_fraction: of the initial kinetic energy."""
        self.time = time_
        self._state = (kinetic_fraction, dt, step)
        now = time.monotonic()
        if self._first[1] != self._first[1]:  # nan: time to go is counted from here, without compilation and meshing
            self._first = (now, time_)
        if self.quiet or now < self._next:
            return
        self._show(now)
        self._next = now + (_BAR_EVERY if self._bar else _LINE_EVERY)

    def log(self, text: str) -> None:
        """A line of its own, above the bar."""
        if self.quiet:
            return
        if self._bar:
            self._bar.console.print(text, markup=False, highlight=False)
        else:
            print(text, file=self.stream, flush=True)

    def stop(self) -> None:
        """End, and leave the last state on the screen. May be called more than once."""
        if self._running and self.time == self.time and not self.quiet:
            self._show(time.monotonic())
        if self._bar:
            self._bar.stop()
            self._bar = None
        self._running = False

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def status(self, now: float) -> str:
        """The state as text. now: time.monotonic()."""
        kinetic, dt, step = self._state
        text = f"{self.time * 1e9:.1f} ns  kinetic energy left {kinetic:.1%}  dt {dt * 1e12:.1f} ps  step {step}"
        wall, simulated = now - self._first[0], self.time - self._first[1]
        if wall > 1 and simulated > 0:
            text += f"  at most {max(wall * (self._end_time - self.time) / simulated, 0):.0f} s to go"
        return text

    def _show(self, now: float) -> None:
        if self._bar:
            task = self._bar.task_ids[0]
            self._bar.update(task, completed=self.time, status=self.status(now))
        else:
            print(self.status(now), file=self.stream, flush=True)


def _bar(stream: TextIO) -> Bar:
    columns = (BarColumn(bar_width=30), TextColumn("{task.fields[status]}", markup=False))
    return Bar(*columns, console=Console(file=stream), refresh_per_second=10)
