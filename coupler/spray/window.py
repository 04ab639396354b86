"""The window of deposition: where a spray's particles lie between critical and erosion velocity, and how much of the powder stays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from ..physics.adhesion import critical_velocity
from ..physics.materials import Material
from .flight import Flight

OPTIMAL, EROSION = 1.5, 2.0  # velocities over the critical one: of good coatings, and from which particles erode
REFERENCE, EXPONENT = 25e-6, -0.18  # m: diameter of the formula's particles; of the critical velocity in the diameter
FASTEST = 10.0  # velocity over the critical one, beyond which it makes no difference
CLASSES = 25  # of equal mass
_IN_BAND = 10  # steps from the critical velocity to either end of its band
_FINE = 2000  # shares between which velocities are interpolated


def critical_at(material: Material, temperature: float, diameter: float) -> float:
    """Critical velocity, m/s, of a particle of `diameter` m at `temperature` K: Schmidt's formula times (D / 25 um)^-0.18.

    The power of the diameter: Assadi, Schmidt, Richter et al. (2011), J. Therm. Spray Technol. 20, 1161, whose factor k1 = 0.64
    (D / 10 um)^-0.18 is that of Schmidt's formula at 25 um. Raises ColdsprayError where the material has no sigma_TS.
    """
    return critical_velocity(material, temperature) * (diameter / REFERENCE) ** EXPONENT


def quantile(d10: float, d50: float, d90: float, share: float) -> float:
    """Diameter, m, below which `share` of the mass is: log-normal on each side of the median, through the three given ones."""
    step = NormalDist().inv_cdf(share) / NormalDist().inv_cdf(0.9)
    return d50 * (d90 / d50 if step > 0.0 else d50 / d10) ** step


@dataclass(frozen=True)
class Spray:
    """A powder at impact, in classes of equal mass (n,): share of the mass that is smaller, diameter m, velocity m/s, temperature K,
    critical velocity m/s, highest temperature in flight K of each."""

    share: NDArray[np.float64]
    diameter: NDArray[np.float64]
    velocity: NDArray[np.float64]
    temperature: NDArray[np.float64]
    critical: NDArray[np.float64]
    hottest: NDArray[np.float64]

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Velocity over critical velocity, infinite for a particle at its melting point."""
        with np.errstate(divide="ignore"):
            return self.velocity / self.critical

    def efficiency(self, factor: float = 1.0) -> float:
        """Deposition efficiency: share of the mass between `factor` times the critical velocity and the erosion velocity."""
        fine = (np.arange(_FINE) + 0.5) / _FINE
        least = self.velocity / FASTEST  # a particle at its melting point has a critical velocity of zero
        ratio = np.interp(fine, self.share, self.velocity / np.maximum(factor * self.critical, least))
        return float(np.mean((ratio >= 1.0) & (ratio < EROSION)))

    def band(self, within: float) -> tuple[float, float]:
        """Least and greatest efficiency with a critical velocity up to a share `within` lower or higher: where particles erode, a lower
        one deposits less."""
        each = [self.efficiency(factor) for factor in 1.0 + within * np.linspace(-0.999, 1.0, 2 * _IN_BAND + 1)]
        return min(*each, self.efficiency()), max(*each, self.efficiency())


def spray(
    material: Material, sizes: tuple[float, float, float], fly: Callable[[Sequence[float]], list[Flight]]
) -> Spray:
    """A powder at impact. sizes: diameters (m) below which 10, 50 and 90 % of its mass are; fly: the flights of diameters (m).

    Raises ColdsprayError where a particle cannot be followed or the material has no sigma_TS.
    """
    share = (np.arange(CLASSES) + 0.5) / CLASSES
    diameter = np.array([quantile(*sizes, u) for u in share])
    flights = fly(diameter.tolist())
    velocity, temperature = (
        np.array([getattr(flight, name) for flight in flights]) for name in ("velocity", "temperature")
    )
    critical = [critical_at(material, T, D) for T, D in zip(temperature, diameter, strict=True)]
    return Spray(share, diameter, velocity, temperature, np.array(critical), np.array([f.T.max() for f in flights]))
