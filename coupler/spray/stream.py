"""The stream of powder: how often particles hit a place on the target while the spray spot passes over it."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Stream:
    """Powder that falls evenly on a circular spot. feed_rate kg/s of the particles that count; mass kg: mean of a particle; spot m:
    diameter; traverse_speed m/s: of the spot over the target."""

    feed_rate: float
    mass: float
    spot: float
    traverse_speed: float

    @property
    def flux(self) -> float:
        """Impacts per area and time within the spot, 1/(m2 s)."""
        return self.feed_rate / self.mass / (0.25 * math.pi * self.spot**2)

    def time_between(self, radius: float) -> float:
        """Mean time (s) between two impacts whose centres fall on a disc of `radius` m under the spot."""
        return 1.0 / (self.flux * math.pi * radius**2)

    @property
    def time_of_pass(self) -> float:
        """Time (s) for which the spot covers a place in one pass, the mean over its chords: pi/4 d / v."""
        return 0.25 * math.pi * self.spot / self.traverse_speed
