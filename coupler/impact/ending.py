"""Criteria for the end of an impact: the particle is at rest, it has its greatest deformation, or a given time is reached."""

import math
from dataclasses import dataclass
from typing import Literal

Grip = Literal["free", "failing", "held", "secure", "embedded"]
STILL = 0.005  # of the impact speed: a particle on earlier splats with a smaller downward speed is at rest
QUIET_FORCE = 0.02  # of the peak contact force: below it the contact counts as having no force
QUIET_TIME = 0.1  # of D / v: time without contact force at the end
# A bonded particle oscillates: it is at rest after its speed has been below HELD_STILL of the impact speed for HELD_TIME of D / v,
# about one period.
HELD_STILL, HELD_TIME = 0.02, 0.5
SPENT = 0.01  # of the energy of the impact: a tied particle is at rest if it would dissipate less than this in the next D / v
# of the impact speed: at a smaller downward speed the downward motion has less than 5 % of the kinetic energy of the impact
GLANCING = math.sqrt(0.05)


@dataclass
class EndState:
    """State of an `EndCriterion`. at: criterion for the end, "rest", "greatest" or "time"; end_time (s): time limit.

    peak (N): largest contact force so far; turned (s): time of the greatest deformation, None before it; loud (s): last time with a
    contact force above QUIET_FORCE times peak, bonds that could break, or the grip "embedded" (grips: see `EndCriterion.observe`);
    fast (s): last time at which the grip was "free", bonds could break, or the speed along the normal was above HELD_STILL of the
    impact speed with the grip "held" or "embedded"; above (s): last time with the particle's centre above the target, inside the rim;
    risen: the particle has moved upwards after the greatest deformation, and from then on its bonds count as able to break; arrested:
    it has then stopped, held by bonds or embedded; time (s), work (J): of the last `observe`; power (W): mean rate of work.
    """

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


class EndCriterion(EndState):
    """Decides when an impact has reached its greatest deformation and when it is over.

    Greatest deformation: the centre of mass stops sinking, or sinks more slowly than `slow`; or it sinks more slowly than GLANCING
    times the impact speed after `held_quiet` s without contact force (the particle has glanced off the flank of a splat). End of the
    impact: for "rest", when the particle has `settled`; for "greatest", at the greatest deformation; for "time", at end_time. The first
    two also end at end_time, or when the particle has slid over the rim of the target (`slid_off`).
    """

    def __init__(self, end_time: float, at: str, crossing: float, speed: float, slow: float = 0.0, energy: float = 0.0):
        """end_time, at: as in `EndState`; crossing (s): diameter / speed; speed (m/s): of impact; slow (m/s): speed taken as zero;
        energy (J): kinetic energy of the impact if the scene ties the particle to the target, else 0."""
        super().__init__(at, end_time)
        self.slow = slow
        self.quiet, self.held_quiet, self.held_slow = QUIET_TIME * crossing, HELD_TIME * crossing, HELD_STILL * speed
        self.glancing, self.spent = GLANCING * speed, SPENT * energy / crossing

    def observe(
        self, time: float, sinking: float, force: float, grip: Grip = "free", is_above: bool = True, work: float = 0.0
    ) -> None:
        """Record the state at `time` s. sinking (m/s): speed of the centre of mass towards the ground; force (N): upward contact force
        on the particle; grip: state of its bonds: "free" (no bond holds it), "failing" (bonds can break), "held" (bonds hold it),
        "secure" (bonds can absorb far more energy than can break them), "embedded" (a ceramic without bonds is in contact); is_above:
        whether the particle's centre is above the target; work (J): energy dissipated so far."""
        if self.time > 0.0:  # mean over about `quiet` s
            share = -math.expm1((self.time - time) / self.quiet)
            self.power = (1.0 - share) * self.power + share * (work - self.work) / (time - self.time)
        self.peak, self.time, self.work = max(self.peak, force), time, work
        is_loud = abs(force) > QUIET_FORCE * self.peak
        glanced_off = time - self.loud > self.held_quiet and not is_loud and sinking <= self.glancing
        if self.turned is None and self.touched and (sinking <= self.slow or glanced_off):
            self.turned = time
        self.risen |= self.turned is not None and sinking < 0.0
        self.arrested |= self.risen and sinking >= 0.0 and grip in ("held", "secure", "embedded")
        # energy of waves and of rotation can still break bonds
        is_tearing = grip == "failing" or (grip in ("held", "secure") and self.risen)
        if grip == "free" or is_tearing or (grip in ("held", "embedded") and abs(sinking) > self.held_slow):
            self.fast = time
        if is_above:
            self.above = time
        if is_tearing or is_loud or grip == "embedded":
            self.loud = time

    def reached(self, time: float) -> bool:
        """Whether the impact is over at `time` s, the time of the last observation: its criterion is met, its time limit is reached, or
        the particle has `slid_off` (not with the criterion "time")."""
        return self.met(time) or self.at_limit(time) or (self.at != "time" and self.slid_off(time))

    def met(self, time: float) -> bool:
        """Whether the end criterion, not only the time limit, is met at `time` s."""
        if self.at == "time":
            return self.at_limit(time)
        return self.settled(time) if self.at == "rest" else self.turned is not None

    def settled(self, time: float) -> bool:
        """Whether the particle has left or is at rest after the greatest deformation. One of these is enough: `loud` is more than
        `quiet` s ago; `fast` is more than `held_quiet` s ago; it is `arrested`; the scene ties it and `power` is below `spent`."""
        is_quiet = time - self.loud > self.quiet or time - self.fast > self.held_quiet
        return self.turned is not None and (self.arrested or is_quiet or self.power < self.spent)

    def slid_off(self, time: float) -> bool:
        """Whether the particle has left over the rim of the target: after contact, `above` and `loud` are more than `quiet` s ago."""
        return self.touched and time - max(self.above, self.loud) > self.quiet

    def at_limit(self, time: float) -> bool:
        """Whether `time` s is at or after the time limit."""
        return time >= self.end_time * (1 - 1e-12)

    @property
    def touched(self) -> bool:
        """Whether there has been any contact force."""
        return self.peak > 0.0

    def undecided(self, time: float, sinking: float) -> str | None:
        """Why the impact ended at `time` s without meeting its criterion; None if it is met. sinking (m/s): as in `observe`."""
        if self.met(time):
            return None
        aim = {"rest": "at rest", "greatest": "at its greatest deformation"}[self.at]
        if self.slid_off(time):
            return f"not {aim} when it slid over the rim of the target: increase substrate.diameter"
        motion = f"sinks at {sinking:.3g} m/s" if sinking > 0.0 else f"rises at {-sinking:.3g} m/s"
        return f"not {aim} at its time limit of {self.end_time * 1e9:.4g} ns: the particle {motion}"

    def extend(self, time: float, until: float | None) -> None:
        """Let an impact that has ended at `time` s continue to `until` s. None: to twice `time`, if it has reached its time limit but
        has not met its criterion; else it does not continue. An impact that ended by `slid_off` alone does not continue."""
        if until is None:
            if self.at_limit(time) and not self.met(time):
                self.end_time += time
        elif self.at_limit(time):
            self.end_time = until
        elif self.met(time):  # its verdict is undecided
            self.at, self.end_time = "time", until
