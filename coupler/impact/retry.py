"""What a run in trouble does: back to a good state, and on with a smaller time step; never in silence.

Good states of an impact are kept in memory while it runs. When a domain breaks down, or the books go wrong, the next of
MEASURES is taken; when there is none left the error stands.
"""

import copy
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ..errors import SolverError

EVERY = 10  # chunks of steps between two states that are kept
SOUND = 0.25  # of the bounds on the books: a state beyond that may carry the trouble already and is not kept


@dataclass(frozen=True)
class Measure:
    """back: which of the kept states to go back to, -1 the last; dt_factor: on the time step both domains agree on from then on;
    numerics: the least that the particle's `Numerics` are raised to; words: what is said of it."""

    back: int
    dt_factor: float
    words: str
    numerics: Mapping[str, float] = field(default_factory=dict)

    def raised(self, numerics: Mapping[str, float]) -> dict[str, float]:
        """Numerics as they were asked for, raised to the least that this measure wants."""
        return {**numerics, **{name: max(least, numerics.get(name, least)) for name, least in self.numerics.items()}}


# The last one changes the scheme: at 4000 points Q1 0.2 takes 1.2 % and hourglass 3 takes 0.9 % of the flattening (docs/solvers.md).
MEASURES = (
    Measure(-1, 0.5, "half the time step, from the last good state"),
    Measure(-2, 0.25, "a quarter of the time step, from the good state before"),
    Measure(
        0, 0.25, "a quarter of the time step, viscosity Q1 0.2 and hourglass control 3, from the first state kept",
        {"Q1": 0.2, "hourglass": 3.0},
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Rescue:
    """One that has been made. Times in s, from the start of the run; numerics: the particle's from then on."""

    impact: int
    time_s: float
    back_to_s: float
    reason: str
    measure: str
    dt_factor: float
    numerics: dict[str, float]

    def __str__(self) -> str:
        return f"rescued at {self.time_s * 1e9:.2f} ns: {self.reason}; {self.measure} ({self.back_to_s * 1e9:.2f} ns)"


class Rescuer:
    """Good states of one impact, and what has been done with them. numerics: what the run was asked to change in the scheme.

    made: the rescues so far, as `Rescue`.
    """

    def __init__(self, numerics: Mapping[str, float]):
        self.numerics = dict(numerics)
        self.made: list[Rescue] = []
        self._kept: list[tuple[float, dict[str, Any]]] = []
        self._chunks = 0

    def due(self) -> bool:
        """Count a chunk; whether a state should be kept after it."""
        self._chunks += 1
        return not self._kept or self._chunks % EVERY == 0

    def keep(self, time: float, state: dict[str, Any]) -> None:
        """Remember a good state at `time` s: the first and the last two are kept."""
        self._kept.append((time, copy.deepcopy(state)))
        del self._kept[1:-2]

    def way_out(self, error: SolverError, impact: int, time: float) -> tuple[Rescue, dict[str, Any]]:
        """The next measure, and the state to go back to. time: s, when `error` came. Raises the error when there is none left."""
        if len(self.made) >= len(MEASURES) or not self._kept:
            raise error
        measure = MEASURES[len(self.made)]
        which = max(measure.back, -len(self._kept))
        back, state = self._kept[which]
        # what came after it may be what led here
        self._kept = self._kept[: which % len(self._kept) + 1]
        reason = str(error).split(". Try ")[0].split(": try ")[0]
        rescue = Rescue(
            impact, time, back, reason, measure.words, measure.dt_factor, measure.raised(self.numerics)
        )  # fmt: skip
        self.made.append(rescue)
        return rescue, copy.deepcopy(state)

    def state(self) -> list[dict[str, Any]]:
        return [asdict(rescue) for rescue in self.made]

    def restore(self, state: list[dict[str, Any]]) -> None:
        self.made = [Rescue(**made) for made in state]


def numerics_of(state: Mapping[str, Any] | None, numerics: Mapping[str, float]) -> dict[str, float]:
    """Numerics of the particle of an interrupted impact (`running.Running.state`): those of its last rescue, if there was one."""
    made = state["rescues"] if state is not None else []
    return dict(made[-1]["numerics"]) if made else dict(numerics)
