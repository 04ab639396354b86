"""The gas of cold spray: one-dimensional flow through a de Laval nozzle, into a free jet, up to the target.

The flow in the nozzle is isentropic and chokes in the throat; nothing acts back on it. Positions x in m along the axis, 0 in
the throat. What this leaves out, and what it comes to, is in docs/guide/gas.md.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from ..errors import ColdsprayError
from .nozzles import Nozzle

R_MOLAR = 8.314462618  # J/(mol K)
T_AMBIENT = 293.15  # K, of the air around the jet
SEPARATES = 0.4  # Summerfield, Foster & Swan (1954): flow leaves the wall where p falls below this part of the ambient


@dataclass(frozen=True)
class Gas:
    """A calorically perfect gas. molar_mass kg/mol; gamma; Pr; viscosity mu_ref (Pa s) at T_ref (K), then by Sutherland's
    law with S (K), or as T^n where S is None."""

    name: str
    molar_mass: float
    gamma: float
    Pr: float
    mu_ref: float
    T_ref: float
    S: float | None
    n: float = 0.0

    @property
    def R(self) -> float:
        """J/(kg K)."""
        return R_MOLAR / self.molar_mass

    @property
    def cp(self) -> float:
        """J/(kg K)."""
        return self.gamma / (self.gamma - 1) * self.R

    def viscosity(self, T: float) -> float:
        """Pa s, at T (K)."""
        theta = T / self.T_ref
        if self.S is None:
            return self.mu_ref * theta**self.n
        return self.mu_ref * theta**1.5 * (self.T_ref + self.S) / (T + self.S)

    def conductivity(self, T: float) -> float:
        """W/(m K), at T (K): mu cp / Pr."""
        return self.viscosity(T) * self.cp / self.Pr

    def sound(self, T: float) -> float:
        """Speed of sound, m/s, at T (K)."""
        return math.sqrt(self.gamma * self.R * T)


# White, Viscous Fluid Flow (1991), tables 1-2 and A: viscosity; Pr near 300 K. Helium follows the power law better.
GASES = {
    "N2": Gas("N2", 28.0134e-3, 1.4, 0.72, 1.663e-5, 273.0, 107.0),
    "He": Gas("He", 4.0026e-3, 5 / 3, 0.68, 1.865e-5, 273.0, None, 0.666),
    "air": Gas("air", 28.9647e-3, 1.4, 0.71, 1.716e-5, 273.0, 111.0),
}


# ---- relations of one-dimensional gas dynamics (NACA report 1135, 1953) --------------------------------


def temperature_ratio(M: float, gamma: float) -> float:
    """Total over static temperature."""
    return 1 + (gamma - 1) / 2 * M**2


def pressure_ratio(M: float, gamma: float) -> float:
    """Total over static pressure."""
    return temperature_ratio(M, gamma) ** (gamma / (gamma - 1))


def area_ratio(M: float, gamma: float) -> float:
    """Area over the throat's area at which the flow has Mach number M."""
    return (2 / (gamma + 1) * temperature_ratio(M, gamma)) ** ((gamma + 1) / (2 * (gamma - 1))) / M


def mach(ratio: float, gamma: float, supersonic: bool) -> float:
    """Mach number where the area is `ratio` times the throat's area: the inverse of `area_ratio` on one of its branches.

    ratio: at least 1. Raises ColdsprayError below. Newton's method on the root of log(area), which is nearly straight
    where the area itself has its minimum; it starts on the side from which it cannot overshoot.
    """
    if ratio < 1:
        raise ColdsprayError(
            f"area ratio {ratio:g}: must be 1 or more, because the throat is the narrowest section of the nozzle"
        )
    wanted = math.sqrt(math.log(ratio))
    if wanted < 1e-8:
        return 1.0
    step = math.sqrt((gamma + 1) / 2) * wanted
    M = 1 + step if supersonic else max(1 - step, area_ratio(1e-9, gamma) * 1e-9 / ratio)
    for _ in range(60):
        root = math.sqrt(max(math.log(area_ratio(M, gamma)), 0.0))
        change = 2 * root * (root - wanted) * M * temperature_ratio(M, gamma) / (M**2 - 1)
        M -= change
        if abs(change) < 1e-13 * M:
            break
    return M


def normal_shock(M: float, gamma: float) -> tuple[float, float]:
    """Mach number behind a normal shock, and the pressure behind it over that before. M: before, at least 1."""
    behind = math.sqrt(temperature_ratio(M, gamma) / (gamma * M**2 - (gamma - 1) / 2))
    return behind, 1 + 2 * gamma / (gamma + 1) * (M**2 - 1)


# ---- the flow ------------------------------------------------------------------------------------------


class State(NamedTuple):
    """The gas in one place: velocity m/s, temperature K, density kg/m^3."""

    u: float
    T: float
    rho: float


class Piece(NamedTuple):
    """A stretch of the axis, m, in which the gas's state is a smooth function of x."""

    start: float
    stop: float
    state: Callable[[float], State]


@dataclass(frozen=True)
class Flow:
    """Gas of total pressure p0 (Pa) and temperature T0 (K) through a nozzle into a free jet, up to a target.

    ambient: pressure outside, Pa. standoff: from nozzle to target, m. bow_shock: whether the jet is stopped by a normal
    shock before the target, or reaches it as if there were none.
    Raises ColdsprayError if the nozzle does not run full of supersonic flow, or if the shock would reach into it.
    """

    gas: Gas
    nozzle: Nozzle
    p0: float
    T0: float
    standoff: float
    ambient: float = 101325.0
    bow_shock: bool = False

    def __post_init__(self) -> None:
        if self.p0 < (1 - 1e-12) * self.least_pressure:
            raise ColdsprayError(
                f"pressure = {self.p0 / 1e5:.4g} bar: too low for nozzle {self.nozzle.name}, a shock would stand inside"
                f" it: give at least {self.least_pressure / 1e5:.4g} bar, or a nozzle with a smaller exit"
            )
        if self.layer > 0.9 * self.standoff:
            raise ColdsprayError(
                f"standoff = {self.standoff * 1e3:.3g} mm: too short for the bow shock,"
                f" which stands {self.layer * 1e3:.3g} mm before the target: increase standoff"
            )

    @cached_property
    def exit_mach(self) -> float:
        """Mach number at the nozzle's exit."""
        return mach(self.nozzle.area_ratio(self.nozzle.end), self.gas.gamma, True)

    @cached_property
    def exit_pressure(self) -> float:
        """Pressure at the nozzle's exit, Pa."""
        return self.p0 / pressure_ratio(self.exit_mach, self.gas.gamma)

    @cached_property
    def least_pressure(self) -> float:
        """The total pressure, Pa, at which a normal shock would stand right in the exit."""
        g = self.gas.gamma
        return self.ambient * pressure_ratio(self.exit_mach, g) / normal_shock(self.exit_mach, g)[1]

    @cached_property
    def mass_flow(self) -> float:
        """Mass flow of the choked throat, kg/s."""
        throat = self._expanded(1.0)
        return throat.rho * throat.u * math.pi / 4 * self.nozzle.throat**2

    def inside(self, x: float) -> State:
        """The gas in the nozzle: isentropic from p0, T0."""
        return self._expanded(mach(self.nozzle.area_ratio(x), self.gas.gamma, x > 0))

    def _expanded(self, M: float) -> State:
        T = self.T0 / temperature_ratio(M, self.gas.gamma)
        p = self.p0 / pressure_ratio(M, self.gas.gamma)
        return State(M * self.gas.sound(T), T, p / (self.gas.R * T))

    @cached_property
    def jet(self) -> State:
        """The jet once it has the ambient pressure: mass, momentum and energy of the exit.

        Yuceil & Otugen (2002), Phys. Fluids 14, 4206, for under-expanded jets; used here for over-expanded ones too, where it
        ends, as it must, in the state behind a normal shock once that stands in the exit.
        """
        exit_ = self.inside(self.nozzle.end)
        u = exit_.u + (self.exit_pressure - self.ambient) / (exit_.rho * exit_.u)
        T = self.T0 - u**2 / (2 * self.gas.cp)
        return State(u, T, self.ambient / (self.gas.R * T))

    @cached_property
    def jet_diameter(self) -> float:
        """Diameter of a jet with the nozzle's mass flow in the state `jet`, m."""
        return math.sqrt(4 / math.pi * self.mass_flow / (self.jet.rho * self.jet.u))

    @cached_property
    def core(self) -> float:
        """Length of the potential core, m: Lau, Morris & Fisher (1979), J. Fluid Mech. 93, 1."""
        return self.jet_diameter * (4.2 + 1.1 * (self.jet.u / self.gas.sound(self.jet.T)) ** 2)

    def outside(self, x: float) -> State:
        """The gas on the axis of the free jet: constant in the core, then Lau, Morris & Fisher's decay; the total
        temperature mixes as the velocity does (Crocco-Busemann). The density is the density of the gas, not of a mixture."""
        s = (x - self.nozzle.end) / self.core
        share = 1 - math.exp(1.35 / (1 - s)) if s > 1 else 1.0
        u = share * self.jet.u
        T = T_AMBIENT + share * (self.T0 - T_AMBIENT) - u**2 / (2 * self.gas.cp)
        return State(u, T, self.ambient / (self.gas.R * T))

    @cached_property
    def layer(self) -> float:
        """Distance of the bow shock from the target, m; 0 without one.

        The mass that enters a disk of the jet's size leaves over its rim at the speed of sound, as in the continuity argument of
        Moeckel (1949), NACA TN 1921, for a layer of constant thickness: an estimate.
        """
        before = self.outside(self.target)
        M = before.u / self.gas.sound(before.T)
        if not self.bow_shock or M <= 1:
            return 0.0
        sonic = self._behind_shock(before)[1] * (2 / (self.gas.gamma + 1)) ** (1 / (self.gas.gamma - 1))
        total = before.T + before.u**2 / (2 * self.gas.cp)
        a = self.gas.sound(2 / (self.gas.gamma + 1) * total)
        diameter = math.sqrt(4 / math.pi * self.mass_flow / (before.rho * before.u))
        return diameter / 4 * before.rho * before.u / (sonic * a)

    def _behind_shock(self, before: State) -> tuple[float, float]:
        """Velocity behind a normal shock, m/s, and the density the gas has when it then comes to rest, kg/m^3."""
        g, M = self.gas.gamma, before.u / self.gas.sound(before.T)
        M2, p2 = normal_shock(M, g)
        rest = before.rho * before.T * p2 * pressure_ratio(M2, g)  # p / R
        total = before.T + before.u**2 / (2 * self.gas.cp)
        u2 = M2 * self.gas.sound(total / temperature_ratio(M2, g))
        return u2, rest / total

    def stopped(self, x: float) -> State:
        """The gas between bow shock and target: its velocity falls linearly to nothing, without loss."""
        before = self.outside(self.target)
        u2, rest = self._behind_shock(before)
        u = u2 * (self.target - x) / self.layer
        total = before.T + before.u**2 / (2 * self.gas.cp)
        T = total - u**2 / (2 * self.gas.cp)
        return State(u, T, rest * (T / total) ** (1 / (self.gas.gamma - 1)))

    @property
    def target(self) -> float:
        """Position of the target, m from the throat."""
        return self.nozzle.end + self.standoff

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """The axis from where the powder is fed to the target."""
        nozzle, shock = self.nozzle, self.target - self.layer
        inside = [x for x in nozzle.corners if x > nozzle.feed]
        sections = [Piece(a, b, self.inside) for a, b in zip([nozzle.feed, *inside], inside, strict=False)]
        sections.append(Piece(nozzle.end, shock, self.outside))
        return (*sections, Piece(shock, self.target, self.stopped)) if self.layer else tuple(sections)

    @property
    def notes(self) -> list[str]:
        """Limits of validity of this flow, as sentences."""
        notes, end = [], self.exit_pressure / self.ambient
        if end < SEPARATES:
            notes.append(
                f"over-expanded: {self.exit_pressure / 1e5:.2g} bar at the exit against {self.ambient / 1e5:.3g} outside;"
                f" below {SEPARATES:g} of it a real flow separates from the wall before the exit, and particles are slower"
            )
        if self.standoff > self.core:
            notes.append(f"the target stands beyond the jet's core, {self.core * 1e3:.3g} mm long: the jet has slowed")
        return notes
