"""Progress of a command: a bar on a terminal, elsewhere a line every few seconds."""

import math
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

_BAR_EVERY = 0.1  # s of wall time between two drawings of the bar
_LINE_EVERY = 5.0  # between two log lines
_FIRST_LINE = 0.5  # after the start
_STAGE_AFTER = 2.0  # without a terminal, a stage that takes longer is shown
_TELLS_AFTER = 1.0  # s of wall time in the time loop, after which the remaining time is shown
_OVERDUE = 0.1  # least remaining time of an impact, over its time so far


class Progress:
    """Shows the stage of a command; for an impact: simulated time, remaining kinetic energy, dt and remaining wall time.

    An update is cheap and can come at every step. stream: output, by default standard error, in a notebook standard output; quiet: show
    nothing. time: simulated time over all impacts, s, nan before the first update; compiling: wall time for the compilation of kernels,
    s, which the remaining time excludes; record: function that receives every line, for example to write a log file.
    """

    def __init__(self, quiet: bool = False, stream: TextIO | None = None):
        in_notebook = type(sys.stderr).__module__.startswith("ipykernel")  # it shows standard error as a fault, in red
        self.stream = stream if stream is not None else sys.stdout if in_notebook else sys.stderr
        self.quiet = quiet or self.stream is None  # a program without a terminal may have no standard error
        self.time, self.compiling = float("nan"), 0.0
        self.record: Callable[[str], None] = lambda text: None
        self._impact = ""
        self._before, self._expected, self._limit = 0.0, float("nan"), float("inf")  # s, simulated
        self._dt_expected, self._dt_first = float("inf"), 0.0
        self._done, self._share = 0.0, 1.0  # shares of the whole: of the earlier impacts, and of this one
        self._running = False
        self._state = (float("nan"), float("nan"), 0)  # kinetic fraction, dt, step
        self._shown: tuple[float, int] | None = None  # simulated time and step of the last output
        self._stage: tuple[str, float] | None = None  # text and time of its start
        self._bar: Bar | None = None
        # clock without compilation, and share done, at the first update of an impact; clock at the last update
        self._first: tuple[float, float] | None = None
        self._clock = 0.0
        self._looped, self._part = 0.0, 0.0  # of the earlier impacts: wall time of their loops, share of the whole
        self._batches: tuple[float, float] | None = None  # clock and share done at the end of the first batch
        self._next = 0.0
        self._ticker: threading.Thread | None = None
        self._stopped = threading.Event()

    def start(
        self,
        expected: float,
        limit: float = float("inf"),
        i: int = 0,
        before: float = 0.0,
        shares: Sequence[tuple[float, float]] = ((0.0, 1.0),),
        dt_expected: float = float("inf"),
    ) -> None:
        """Begin impact i. expected, limit: its expected and its greatest simulated time, s; before: simulated time of the earlier
        impacts, s; shares: for each impact, the share of the expected wall time before it and its own share; dt_expected: mean time
        step, s."""
        self._impact = f"impact {i + 1} of {len(shares)}  " if len(shares) > 1 else ""
        self._before, self._expected, self._limit = before, expected, limit
        is_new = shares[i] != (self._done, self._share)  # else it starts again: the first attempt does not count
        if self._first is not None and is_new:
            self._looped += self._clock - self._first[0]
            self._part += self._done + self._share - self._first[1]
        self._first = None
        self._done, self._share = shares[i]
        self._dt_expected, self._dt_first = dt_expected, 0.0
        self.time, self._running = before if i else float("nan"), True
        self._open()

    def update(self, time_: float, kinetic_fraction: float, dt: float, step: int) -> None:
        """Report the state of the impact. time_: simulated, s; kinetic_fraction: kinetic energy divided by its initial value; dt:
        s."""
        self.time, self._stage = self._before + time_, None
        self._dt_first = max(self._dt_first, dt)
        self._state = (kinetic_fraction, dt, step)
        now = time.monotonic()
        self._clock = now - self.compiling
        self._first = self._first or (self._clock, self._fraction())
        if now >= self._next:
            self._show_state(now)
            self._next = now + (_BAR_EVERY if self._bar else _LINE_EVERY)

    def stage(self, text: str, of_impact: bool = True, done: float | None = None) -> None:
        """Begin work without simulated time. It lasts until the next call of `stage`, `update` or `stop`; a call with the same text
        continues it. of_impact: the work belongs to the last started impact; done: share of all work that is finished."""
        again = self._stage is not None and self._stage[0] == text
        if not again:
            self._show_last()
        if done is not None:
            self._done, self._share = done, 0.0
        if again:
            return
        self._stage = (text, time.monotonic())
        self._impact = self._impact if of_impact else ""
        self.record(f"{self._impact}{text}")
        self._open()
        self._draw(f"{self._impact}{text}")
        if self._ticker is None and not self.quiet:
            self._stopped.clear()
            self._ticker = threading.Thread(target=self._tick, daemon=True)
            self._ticker.start()

    def batch_ended(self, done: float) -> None:
        """Report the end of a batch of simultaneous impacts. done: share of all work that is finished. The remaining time is estimated
        from the later batches: the first one includes the compilation of the code in each process."""
        if self._batches is None:
            self._batches = time.monotonic() - self.compiling, done

    def log(self, text: str) -> None:
        """Show a line of text; on a terminal it appears above the bar."""
        self.record(text)
        if self._bar:
            self._bar.console.print(text, markup=False, highlight=False)
        else:
            self._print(text)

    def stop(self) -> None:
        """End the display; the last state stays on the screen. Further calls have no effect."""
        self._stopped.set()
        if self._ticker is not None:
            self._ticker.join()
            self._ticker = None
        self._show_last()
        self._stage = None
        if self._bar:
            self._bar.live.transient = not self._running  # the bar of a command without an impact disappears
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
        text = f"{self._impact}{self.time * 1e9:.1f} ns  remaining kinetic energy {kinetic:.1%}  dt {dt * 1e12:.1f} ps  step {step}"
        return f"{text}{_words(self.time_to_go(now))}"

    def time_to_go(self, now: float) -> float:
        """Remaining wall time, s; nan while it cannot be estimated. now: time.monotonic().

        The estimate assumes that the rest of the work is as fast as the work so far. Only the time in loops over steps counts, because
        the forecast of the time between impacts is less accurate. For impacts in batches, all time after the first batch counts.
        """
        if self._batches is not None:
            return self._to_go_of_batches(now, self._fraction())
        begun, at_first = self._first or (math.inf, 0.0)
        done = self._fraction()
        spent, part = self._looped + now - self.compiling - begun, self._part + done - at_first
        return spent * (1.0 - done) / part if spent > _TELLS_AFTER and part > 0.0 else math.nan

    def _to_go_of_batches(self, now: float, done: float) -> float:
        begun, first = self._batches or (math.inf, 1.0)
        return (now - self.compiling - begun) * (1.0 - done) / (done - first) if done > first else math.nan

    def _fraction(self) -> float:
        """The fraction of the expected wall time of all impacts that is already done.

        The remaining simulated time of an impact is at least _OVERDUE times its time so far, unless its limit comes earlier. The number
        of steps per simulated time, 1 / dt, rises as kinetic energy is converted. Its mean over the rest of the impact is estimated as
        its current value plus (expected mean - first value) times the remaining share of kinetic energy.
        """
        gone, (kinetic, dt, step) = self.time - self._before, self._state
        if not gone > 0.0:
            return self._done
        left = max(self._expected - gone, min(_OVERDUE * gone, self._limit - gone), 0.0)
        rise = max(1.0 / self._dt_expected - 1.0 / self._dt_first, 0.0)
        steps_left = left * (1.0 / dt + min(kinetic, 1.0) * rise)
        return self._done + self._share * step / (step + steps_left)

    def _open(self) -> None:
        is_terminal = getattr(self.stream, "isatty", lambda: False)  # other stream classes may lack it
        if self._bar is None and not self.quiet and is_terminal():
            columns = (BarColumn(bar_width=30), TextColumn("{task.fields[status]}", markup=False))
            self._bar = Bar(*columns, console=Console(file=self.stream), refresh_per_second=10)
            self._bar.add_task("", total=1.0, status="")
            self._bar.start()
        self._next = self._next or time.monotonic() + (0.0 if self._bar else _FIRST_LINE)

    def _show_last(self) -> None:
        """Show the last state of an impact, before other work begins."""
        if self._running and self._stage is None and self.time > self._before:
            self._show_state(time.monotonic())

    def _show_state(self, now: float) -> None:
        """Show the state of an impact; without a bar, only if it has changed."""
        state = (self.time, self._state[2])
        if self._bar or state != self._shown:
            text = self.status(now)
            if not self._draw(text):
                self.record(text)
                self._print(text)
        self._shown = state

    def _print(self, text: str) -> None:
        """Print a line to the stream. After a line that cannot be written, such as on a full disk, no more lines are printed."""
        if self.quiet:
            return
        try:
            print(text, file=self.stream, flush=True)
        except BrokenPipeError:
            raise
        except (OSError, ValueError):  # ValueError: a stream that is closed
            self.quiet = True

    def _draw(self, text: str) -> bool:
        """Show a text beside the bar. Returns whether there is a bar."""
        if self._bar:
            self._bar.update(self._bar.task_ids[0], completed=self._fraction(), status=text)
        return self._bar is not None

    def _tick(self) -> None:
        """Show the duration of a stage: on a terminal every second, else every _LINE_EVERY seconds."""
        while not self._stopped.wait(1.0):
            stage, now = self._stage, time.monotonic()
            if stage is None or now - stage[1] < _STAGE_AFTER:
                continue
            left = math.nan if self._impact else self._to_go_of_batches(stage[1], self._done)
            text = f"{self._impact}{stage[0]} ... {now - stage[1]:.0f} s{_words(left)}"
            if not self._draw(text) and now >= self._next:
                self._print(text)
                self._next = now + _LINE_EVERY


def _words(left: float) -> str:
    """The remaining time as text; "" if it is unknown."""
    return "" if math.isnan(left) else f"  about {left:.0f} s remaining"
