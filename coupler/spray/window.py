"""The deposition window: particle velocities relative to critical and erosion velocity, and the deposition efficiency."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ColdsprayError
from ..measures import REBOUNDS, STICKS, UNDECIDED
from ..physics.adhesion import PairFormula, critical_velocity, pair_formula
from ..physics.materials import Material
from .flight import Flight
from .sizes import Sizes

Fly = Callable[[Sequence[float]], list[Flight]]  # flights of particles of these diameters, m
ERODES = "erodes"  # in addition to the verdicts
OPTIMAL, EROSION = 1.5, 2.0  # velocity over critical velocity: of good coatings, and the limit of erosion
FASTEST = 10.0  # limit of velocity over critical velocity
CLASSES = 25  # of equal mass
_IN_BAND = 10  # steps from 1 to an end of the range of factors in `extremes`
_FINE = 2000  # mass fractions at which velocities are interpolated


@dataclass(frozen=True)
class Spray:
    """A powder at impact, in classes of equal mass (n,). share: cumulative mass fraction; diameter (m); velocity (m/s); temperature
    (K); hottest: highest temperature in flight, K; formula: critical-velocity formula of each class on the substrate."""

    share: NDArray[np.float64]
    diameter: NDArray[np.float64]
    velocity: NDArray[np.float64]
    temperature: NDArray[np.float64]
    hottest: NDArray[np.float64]
    formula: tuple[PairFormula, ...]

    @property
    def critical(self) -> NDArray[np.float64]:
        """Critical velocities (n,) of the powder's metal, m/s; NaN for a ceramic."""
        return np.array([each.critical for each in self.formula], float)

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Velocity divided by critical velocity (n,); infinite for a particle at its melting point."""
        with np.errstate(divide="ignore"):
            return self.velocity / self.critical

    def fates(self, factor: float = 1.0, on_substrate: bool = False) -> dict[str, float]:
        """Mass fractions of the particles that rebound, stick, are undecided, or erode (at EROSION times the critical velocity or
        more). on_substrate: True on the substrate, by the formula of both metals; False on a coating of the powder's metal. factor:
        factor on the critical velocities."""
        fine = (np.arange(_FINE) + 0.5) / _FINE
        least = self.velocity / FASTEST  # a particle at its melting point has a critical velocity of zero
        critical = [self.critical]
        if on_substrate and self.formula[0].base_critical is not None:
            critical.append(np.array([each.base_critical for each in self.formula], float))
        own, *base = (np.interp(fine, self.share, self.velocity / np.maximum(factor * v, least)) for v in critical)
        erodes, reached = own >= EROSION, np.mean([ratio >= 1.0 for ratio in (own, *base)], axis=0)
        fates = {REBOUNDS: reached == 0.0, STICKS: reached == 1.0, UNDECIDED: (reached > 0.0) & (reached < 1.0)}
        masks = {fate: here & ~erodes for fate, here in fates.items()} | {ERODES: erodes}
        return {fate: float(np.mean(here)) for fate, here in masks.items()}

    def extremes(self, within: float) -> tuple[float, float]:
        """Two factors on the critical velocity, between 1 - within and 1 + within, that give the least and the greatest deposition
        efficiency. Because of erosion, a lower critical velocity can decrease the efficiency. If several factors give the same
        efficiency, the one nearest to 1 counts."""
        steps = within * np.linspace(-0.999, 1.0, 2 * _IN_BAND + 1)
        factors = sorted((1.0, *(1.0 + steps)), key=lambda f: abs(f - 1.0))
        each = [self.fates(factor)[STICKS] for factor in factors]
        return factors[int(np.argmin(each))], factors[int(np.argmax(each))]


def spray(
    material: Material, base: Material | None, sizes: Sizes, fly: Fly, keys: tuple[str, str] = ("powder", "substrate")
) -> Spray:
    """A powder of a metal at impact. Arguments as in `at_impact`; keys: of the two materials, for messages.

    Raises ColdsprayError if a flight cannot be computed, the material has no critical velocity, or no metal bonds to the base.
    """
    try:
        critical_velocity(material, 300.0)
    except ColdsprayError as error:
        raise ColdsprayError(f"{keys[0]}: {error}") from None
    if base is not None and (base.is_ceramic or base.is_polymer):
        why = f"{base.name} is a {'ceramic' if base.is_ceramic else 'polymer'}: no metallic bond forms on it"
        remedy = "compute an impact on it with coldspray run"
        raise ColdsprayError(f"{keys[1]}: {why}, so that there is no deposition window; {remedy}")
    return at_impact(material, base, sizes, fly)


def at_impact(material: Material, base: Material | None, sizes: Sizes, fly: Fly) -> Spray:
    """A powder at impact. base: metal of the substrate, None: not considered; sizes: sizes of the powder; fly: gives flights of
    diameters (m). A ceramic has no critical velocity (NaN), and nothing of it sticks. Raises ColdsprayError if a flight fails."""
    share = (np.arange(CLASSES) + 0.5) / CLASSES
    diameter = np.array([sizes.diameter(u) for u in share])
    flights = fly(diameter.tolist())
    velocity, temperature = np.array([(f.velocity, f.temperature) for f in flights]).T
    formula = tuple(pair_formula(material, base, T, D) for T, D in zip(temperature, diameter, strict=True))
    return Spray(share, diameter, velocity, temperature, np.array([f.T.max() for f in flights]), formula)
