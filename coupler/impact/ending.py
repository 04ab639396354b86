"""When an impact is over: at rest, at its greatest deformation, or at a given time."""

import math
from dataclasses import dataclass
from typing import Literal

Grip = Literal["free", "failing", "held", "secure"]
STILL = 0.005  # of the impact speed: a particle on earlier splats that sinks more slowly is at rest
QUIET_FORCE = 0.02  # of the peak contact force: below it the contact counts as silent
QUIET_TIME = 0.1  # of D / v: how long the contact must be silent
# A bonded particle swings on its bonds: it is at rest when it has swung more slowly than this part of the impact speed ...
HELD_STILL = 0.02
HELD_TIME = 0.5  # ... for this part of D / v, about a period
SPENT = 0.01  # of the impact's energy: a tied particle that would dissipate less in the next D / v rests
# of the impact speed: a particle that touches nothing and sinks more slowly has less than 5 % of its energy to land with
GLANCING = math.sqrt(0.05)


@dataclass
class EndState:
    """peak: largest contact force so far, N; turned: time (s) of the greatest deformation, None before it; loud: last time (s) with a
    contact force above QUIET_FORCE of the peak; fast: last time (s) at which the particle was not bonded, or moved faster than
    HELD_STILL of its impact speed with energy that its bonds may not stop; above: last time (s) at which its centre was above the
    target, not beyond the rim; risen: whether it has moved off after the greatest deformation; arrested: whether its bonds have then
    stopped it; time, work: last observed, s and J; power: mean of what is dissipated, W; at, end_time: of `EndCriterion`."""

    at: str
    end_time: float

    peak: float = 0.0
    turned: float | None = None
    loud: float = 0.0
    fast: float = 0.0
    above: float = 0.0
    risen: bool = False
    arrested: bool = False
    time: float = 0.0
    work: float = 0.0
    power: float = 0.0


class EndCriterion:
    """Decides when an impact has reached its greatest deformation and when it is over.

    Greatest deformation: the centre of mass stops sinking, or sinks more slowly than `slow`, or than GLANCING of the impact speed
    with a contact that has been silent for `held_quiet` s: it has glanced off the flank of a splat. Over: at "rest", the contact force
    has then stayed below QUIET_FORCE of its peak for `quiet` seconds (the particle has left, or rests); at "greatest", at once; at
    "time", and in any case, at end_time. A particle that has slid over the rim of the target has left it: no criterion is met.
    """

    def __init__(self, end_time: float, at: str, crossing: float, speed: float, slow: float = 0.0, energy: float = 0.0):
        """end_time, crossing (D / v): s; speed: of the impact, m/s; slow: m/s; at: "rest", "greatest" (deformation) or "time"; energy:
        of the impact, J, where its particle is tied to what it lies on at the end; 0 of others."""
        self.slow = slow
        self.quiet, self.held_quiet, self.held_slow = QUIET_TIME * crossing, HELD_TIME * crossing, HELD_STILL * speed
        self.glancing, self.spent = GLANCING * speed, SPENT * energy / crossing
        self.seen = EndState(at, end_time)

    def observe(
        self, time: float, sinking: float, force: float, grip: Grip = "free", above: bool = True, work: float = 0.0
    ) -> None:
        """Take note of an instant. sinking: downward speed of the centre of mass, m/s; force: on the particle, upwards, N; grip: of its
        bonds: "free" (none that count), "failing" (they may part), "held", "secure" (they take up far more than there is left); above:
        whether its centre is above the target; work: dissipated so far, J."""
        s = self.seen
        if s.time > 0.0:  # the mean over about `quiet` s
            share = -math.expm1((s.time - time) / self.quiet)
            s.power = (1.0 - share) * s.power + share * (work - s.work) / (time - s.time)
        s.peak, s.time, s.work = max(s.peak, force), time, work
        is_loud = abs(force) > QUIET_FORCE * s.peak
        glanced_off = time - s.loud > self.held_quiet and not is_loud and sinking <= self.glancing
        if s.turned is None and s.peak > 0.0 and (sinking <= self.slow or glanced_off):
            s.turned = time
        s.risen |= s.turned is not None and sinking < 0.0
        s.arrested |= s.risen and sinking >= 0.0 and grip in ("held", "secure")
        # energy of waves and of rotation may still part bonds
        is_tearing = grip == "failing" or (grip != "free" and s.risen)
        if grip == "free" or is_tearing or (grip == "held" and abs(sinking) > self.held_slow):
            s.fast = time
        if above:
            s.above = time
        if is_tearing or is_loud:
            s.loud = time

    @property
    def turned(self) -> float | None:
        """Time of the greatest deformation, s; None before it."""
        return self.seen.turned

    def reached(self, time: float) -> bool:
        """Whether the impact is over at `time` s, the time last observed: its criterion is met, or its time limit has come."""
        return self.met(time) or self.at_limit(time) or (self.seen.at != "time" and self.slid_off(time))

    def met(self, time: float) -> bool:
        """Whether the criterion itself is met at `time` s."""
        return {"rest": self.settled(time), "greatest": self.turned is not None, "time": self.at_limit(time)}[
            self.seen.at
        ]

    def settled(self, time: float) -> bool:
        """Whether the particle has left, or rests: past the greatest deformation the contact has been silent for `quiet` s, bonds have
        stopped its rebound, a bonded particle has moved little for `held_quiet` s, or one to be tied hardly deforms any more."""
        s = self.seen
        is_quiet = time - s.loud > self.quiet or time - s.fast > self.held_quiet
        return s.turned is not None and (s.arrested or is_quiet or s.power < self.spent)

    def slid_off(self, time: float) -> bool:
        """Whether the particle has left over the rim of the target: beyond it the contact has been silent for `quiet` s."""
        return self.touched and time - max(self.seen.above, self.seen.loud) > self.quiet

    def at_limit(self, time: float) -> bool:
        """Whether the time limit has come at `time` s."""
        return time >= self.seen.end_time * (1 - 1e-12)

    @property
    def touched(self) -> bool:
        """Whether there has been any contact force."""
        return self.seen.peak > 0.0

    def undecided(self, time: float, sinking: float) -> str | None:
        """Why the impact ended at `time` s without its criterion; None where it is met. sinking: m/s."""
        if self.met(time):
            return None
        aim = {"rest": "at rest", "greatest": "at its greatest deformation"}[self.seen.at]
        if self.slid_off(time):
            return f"not {aim} when it slid over the rim of the target: increase substrate.diameter"
        motion = f"sinks at {sinking:.3g} m/s" if sinking > 0.0 else f"rises at {-sinking:.3g} m/s"
        return f"not {aim} at its time limit of {self.seen.end_time * 1e9:.4g} ns: the particle {motion}"

    def extend(self, time: float, until: float | None) -> None:
        """Continue an impact that has ended at `time` s until `until` s. Without `until`, an impact that has not met its criterion
        continues for the same time again, and one that has met it is over: its run was stopped later."""
        if until is None:
            if self.at_limit(time) and not self.met(time):
                self.seen.end_time += time
        elif self.at_limit(time):
            self.seen.end_time = until
        elif self.met(time):  # its verdict is undecided
            self.seen.at, self.seen.end_time = "time", until
