"""What follows a failure inside an impact: back to a kept state, and on with a smaller time step; each retry is reported.

Sound states of an impact are kept in memory while it runs. When a domain fails, or the ledger does not close, the next of REMEDIES
is applied; when none is left the error stands.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from ..errors import SolverError

S = TypeVar("S")

KEEP_EVERY = 10  # windows of steps between two states that are kept


@dataclass(frozen=True)
class Remedy:
    """back: index of the kept state to go back to, -1 the last; dt_factor: on the stable time step from then on; numerics: the
    least that the particle's `Numerics` are raised to; words: its description."""

    back: int
    dt_factor: float
    words: str
    numerics: Mapping[str, float] = field(default_factory=dict)

    def raised(self, numerics: Mapping[str, float]) -> dict[str, float]:
        """Numerics as they were asked for, raised to the least that this remedy wants."""
        return {**numerics, **{name: max(least, numerics.get(name, least)) for name, least in self.numerics.items()}}


# The third one gives the enriched scheme hourglass control in place of its residuals, which let a soft rim thin out without end.
# The last one changes every scheme: at 4000 points Q1 0.2 takes 1.2 % and hourglass 3 takes 0.9 % of the flattening
# (docs/evidence/solvers.md).
REMEDIES = (
    Remedy(-1, 0.5, "half the time step, from the last sound state"),
    Remedy(-2, 0.25, "a quarter of the time step, from the sound state before"),
    Remedy(0, 0.5, "half the time step, with hourglass control, from the first state kept", {"control": 1.0}),
    Remedy(
        0, 0.25, "a quarter of the time step, viscosity Q1 0.2 and hourglass control 3, from the first state kept",
        {"Q1": 0.2, "hourglass": 3.0, "control": 1.0},
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Retry:
    """One retry. Times in s, from the start of the run; numerics: the particle's from then on."""

    impact: int
    time_s: float
    back_to_s: float
    reason: str
    remedy: str
    dt_factor: float
    numerics: dict[str, float]

    def __str__(self) -> str:
        return f"retried at {self.time_s * 1e9:.2f} ns: {self.reason}; {self.remedy} ({self.back_to_s * 1e9:.2f} ns)"


class Retries(Generic[S]):
    """Sound states of one impact, and the retries so far.

    S: what is kept, which never changes. requested: numerics that the run was asked to change; applied: the retries so far, in order.
    """

    def __init__(self, requested: Mapping[str, float], applied: Sequence[Retry] = ()):
        self.requested = dict(requested)
        self.applied = list(applied)
        self._kept: list[tuple[float, S]] = []
        self._windows = 0

    @property
    def numerics(self) -> dict[str, float]:
        """Numerics of the particle: those of the last retry, or those requested."""
        return dict(self.applied[-1].numerics if self.applied else self.requested)

    def due(self) -> bool:
        """Whether a state should be kept before the window of steps that comes next, which is counted."""
        due = not self._kept or self._windows % KEEP_EVERY == 0
        self._windows += 1
        return due

    def keep(self, time: float, state: S) -> None:
        """Keep a sound state at `time` s: the first and the last two are kept."""
        self._kept.append((time, state))
        del self._kept[1:-2]

    def next_remedy(self, error: SolverError, impact: int, time: float) -> tuple[Retry, S]:
        """The next retry, and the state to go back to. time: s, of the error. Raises the error when no remedy is left."""
        if len(self.applied) >= len(REMEDIES) or not self._kept:
            raise error
        remedy = REMEDIES[len(self.applied)]
        index = max(remedy.back, -len(self._kept))
        back, state = self._kept[index]
        self._kept = self._kept[: index % len(self._kept) + 1]  # later states may already carry the fault
        reason = str(error).split(". Try ")[0].split(": try ")[0]
        retry = Retry(impact, time, back, reason, remedy.words, remedy.dt_factor, remedy.raised(self.requested))
        self.applied.append(retry)
        return retry, state
