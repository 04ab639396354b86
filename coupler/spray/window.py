"""The window of deposition: where a spray's particles lie between critical and erosion velocity, and how much of the powder stays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..measures import REBOUNDS, STICKS, UNDECIDED
from ..physics.adhesion import PairFormula, critical_velocity, pair_formula
from ..physics.materials import Material
from .flight import Flight
from .sizes import Sizes

ERODES = "erodes"  # beside the verdicts
OPTIMAL, EROSION = 1.5, 2.0  # velocities over the critical one: of good coatings, and from which particles erode
FASTEST = 10.0  # velocity over the critical one, beyond which it makes no difference
CLASSES = 25  # of equal mass
_IN_BAND = 10  # steps from the critical velocity to either end of its band
_FINE = 2000  # shares between which velocities are interpolated


@dataclass(frozen=True)
class Spray:
    """A powder at impact, in classes of equal mass (n,): share of the mass that is smaller, diameter m, velocity m/s, temperature K,
    highest temperature in flight K of each, and the formula for each on the substrate."""

    share: NDArray[np.float64]
    diameter: NDArray[np.float64]
    velocity: NDArray[np.float64]
    temperature: NDArray[np.float64]
    hottest: NDArray[np.float64]
    formula: tuple[PairFormula, ...]

    @property
    def critical(self) -> NDArray[np.float64]:
        """Critical velocities of the powder's metal, m/s."""
        return np.array([each.critical for each in self.formula], float)

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Velocity over critical velocity, infinite for a particle at its melting point."""
        with np.errstate(divide="ignore"):
            return self.velocity / self.critical

    def fates(self, factor: float = 1.0, on_substrate: bool = False) -> dict[str, float]:
        """Shares of the mass that rebound, stick, are undecided and erode (at EROSION times the critical velocity and above): on a
        coating of the powder's own kind, or on the substrate by the formula of both metals. factor: on the critical velocities."""
        fine = (np.arange(_FINE) + 0.5) / _FINE
        least = self.velocity / FASTEST  # a particle at its melting point has a critical velocity of zero
        critical = [self.critical]
        if on_substrate and self.formula[0].base_critical is not None:
            critical.append(np.array([each.base_critical for each in self.formula], float))
        own, *base = (np.interp(fine, self.share, self.velocity / np.maximum(factor * v, least)) for v in critical)
        erodes, reached = own >= EROSION, np.mean([ratio >= 1.0 for ratio in (own, *base)], axis=0)
        shares = {REBOUNDS: reached == 0.0, STICKS: reached == 1.0, UNDECIDED: (reached > 0.0) & (reached < 1.0)}
        return {fate: float(np.mean(here & ~erodes)) for fate, here in shares.items()} | {
            ERODES: float(np.mean(erodes))
        }

    def extremes(self, within: float) -> tuple[float, float]:
        """Factors on the critical velocity, at most a share `within` from one, of the least and the greatest efficiency: where
        particles erode, a lower one deposits less. The nearest to 1 of those with the same."""
        factors = sorted(
            (1.0, *(1.0 + within * np.linspace(-0.999, 1.0, 2 * _IN_BAND + 1))), key=lambda f: abs(f - 1.0)
        )
        each = [self.fates(factor)[STICKS] for factor in factors]
        return factors[int(np.argmin(each))], factors[int(np.argmax(each))]


def spray(
    material: Material,
    base: Material | None,
    sizes: Sizes,
    fly: Callable[[Sequence[float]], list[Flight]],
) -> Spray:
    """A powder at impact. base: of the substrate, None where it is not considered; sizes: of the powder; fly: the flights of
    diameters (m).

    Raises ColdsprayError where a particle cannot be followed or the material has no sigma_TS.
    """
    critical_velocity(material, 300.0)  # whether it has one
    share = (np.arange(CLASSES) + 0.5) / CLASSES
    diameter = np.array([sizes.diameter(u) for u in share])
    flights = fly(diameter.tolist())
    velocity, temperature = (np.array([f.velocity for f in flights]), np.array([f.temperature for f in flights]))
    formula = tuple(pair_formula(material, base, T, D) for T, D in zip(temperature, diameter, strict=True))
    return Spray(share, diameter, velocity, temperature, np.array([f.T.max() for f in flights]), formula)
