"""The gas of cold spray: one-dimensional flow through a de Laval nozzle and a free jet to the target.

The flow in the nozzle is isentropic, and sonic in the throat. Particles have no effect on it. x: position along the axis, m, 0 in the
throat. docs/theory/gas.md lists the neglected effects and their magnitude.
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
SEPARATES = 0.4  # exit pressure over ambient pressure at which the flow separates: Summerfield, Foster & Swan (1954)


@dataclass(frozen=True)
class Gas:
    """A calorically perfect gas. molar_mass (kg/mol); gamma: ratio of specific heats; Pr: Prandtl number; mu_ref: viscosity (Pa s) at
    T_ref (K), with Sutherland's constant S (K), or proportional to T^n if S is None."""

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
        """Specific gas constant of the gas, J/(kg K)."""
        return R_MOLAR / self.molar_mass

    @property
    def cp(self) -> float:
        """Specific heat of the gas, J/(kg K)."""
        return self.gamma / (self.gamma - 1) * self.R

    def viscosity(self, T: float) -> float:
        """Viscosity of the gas, Pa s, at T (K)."""
        theta = T / self.T_ref
        if self.S is None:
            return self.mu_ref * theta**self.n
        return self.mu_ref * theta**1.5 * (self.T_ref + self.S) / (T + self.S)

    def conductivity(self, T: float) -> float:
        """Thermal conductivity of the gas, W/(m K), at T (K): mu cp / Pr."""
        return self.viscosity(T) * self.cp / self.Pr

    def sound(self, T: float) -> float:
        """Speed of sound, m/s, at T (K)."""
        return math.sqrt(self.gamma * self.R * T)


# White, Viscous Fluid Flow (1991), tables 1-2 and A: viscosity; Pr near 300 K. The power law is more accurate for helium.
GASES = {
    "N2": Gas("N2", 28.0134e-3, 1.4, 0.72, 1.663e-5, 273.0, 107.0),
    "He": Gas("He", 4.0026e-3, 5 / 3, 0.68, 1.865e-5, 273.0, None, 0.666),
    "air": Gas("air", 28.9647e-3, 1.4, 0.71, 1.716e-5, 273.0, 111.0),
}


# ---- relations of one-dimensional gas dynamics (NACA report 1135, 1953) --------------------------------


def temperature_ratio(M: float, gamma: float) -> float:
    """Ratio of total to static temperature at Mach number M."""
    return 1 + (gamma - 1) / 2 * M**2


def pressure_ratio(M: float, gamma: float) -> float:
    """Ratio of total to static pressure at Mach number M."""
    return temperature_ratio(M, gamma) ** (gamma / (gamma - 1))


def area_ratio(M: float, gamma: float) -> float:
    """Ratio of the flow area at Mach number M to the area of the throat."""
    return (2 / (gamma + 1) * temperature_ratio(M, gamma)) ** ((gamma + 1) / (2 * (gamma - 1))) / M


def mach(ratio: float, gamma: float, supersonic: bool) -> float:
    """Mach number at which `area_ratio` is `ratio` (1 or more). supersonic: True for a Mach number above 1, False for one below."""
    from scipy.optimize import brentq

    if ratio < 1 + 1e-15:
        return 1.0
    ends = (1.0, 1000.0) if supersonic else (1e-9, 1.0)
    return float(brentq(lambda M: math.log(area_ratio(M, gamma) / ratio), *ends, xtol=1e-15))


def normal_shock(M: float, gamma: float) -> tuple[float, float]:
    """Mach number behind a normal shock, and the pressure behind it divided by the pressure before it. M: Mach number before the
    shock, at least 1."""
    behind = math.sqrt(temperature_ratio(M, gamma) / (gamma * M**2 - (gamma - 1) / 2))
    return behind, 1 + 2 * gamma / (gamma + 1) * (M**2 - 1)


# ---- the flow ------------------------------------------------------------------------------------------


class State(NamedTuple):
    """The gas at a point: velocity u m/s, temperature T K, density rho kg/m^3."""

    u: float
    T: float
    rho: float


class Piece(NamedTuple):
    """A part of the axis, from start to stop (m), in which the state of the gas is a smooth function of x."""

    start: float
    stop: float
    state: Callable[[float], State]


@dataclass(frozen=True)
class Flow:
    """Flow of a gas of total pressure p0 (Pa) and total temperature T0 (K) through a nozzle and a free jet to the target.

    standoff: from nozzle to target, m. ambient: pressure outside, Pa. bow_shock: whether a normal shock before the target stops the
    jet. Raises ColdsprayError if a shock would be inside the nozzle, or a bow shock within a tenth of the standoff from the exit.
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
            why = f"too low for nozzle {self.nozzle.name}, because a shock would stand in it"
            least = f"give at least {math.ceil(self.least_pressure / 100.0) / 1000.0:g} bar, or a nozzle with a smaller exit"
            raise ColdsprayError(f"pressure = {self.p0 / 1e5:.4g} bar: {why}: {least}")
        if self.layer > 0.9 * self.standoff:
            shock = f"the bow shock, which stands {self.layer * 1e3:.3g} mm before the target"
            raise ColdsprayError(f"standoff = {self.standoff * 1e3:.3g} mm: too short for {shock}: increase standoff")

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
        """The total pressure, Pa, at which a normal shock stands in the exit."""
        g = self.gas.gamma
        return self.ambient * pressure_ratio(self.exit_mach, g) / normal_shock(self.exit_mach, g)[1]

    @cached_property
    def mass_flow(self) -> float:
        """Mass flow through the sonic throat, kg/s."""
        throat = self._expanded(1.0)
        return throat.rho * throat.u * math.pi / 4 * self.nozzle.throat**2

    def inside(self, x: float) -> State:
        """The gas in the nozzle at x (m): isentropic from p0, T0."""
        return self._expanded(mach(self.nozzle.area_ratio(x), self.gas.gamma, x > 0))

    def _expanded(self, M: float) -> State:
        T = self.T0 / temperature_ratio(M, self.gas.gamma)
        p = self.p0 / pressure_ratio(M, self.gas.gamma)
        return State(M * self.gas.sound(T), T, p / (self.gas.R * T))

    @cached_property
    def jet(self) -> State:
        """The jet at ambient pressure. Its flows of mass, momentum (including pressure) and energy are those at the exit.

        Yuceil & Otugen (2002), Phys. Fluids 14, 4206, give this state for under-expanded jets. It is used here also for over-expanded
        jets; with a normal shock in the exit it is the state behind this shock.
        """
        exit_ = self.inside(self.nozzle.end)
        u = exit_.u + (self.exit_pressure - self.ambient) / (exit_.rho * exit_.u)
        T = self.T0 - u**2 / (2 * self.gas.cp)
        return State(u, T, self.ambient / (self.gas.R * T))

    @cached_property
    def jet_diameter(self) -> float:
        """Diameter of the jet in the state `jet`, m."""
        return math.sqrt(4 / math.pi * self.mass_flow / (self.jet.rho * self.jet.u))

    @cached_property
    def core(self) -> float:
        """Length of the potential core, m: Lau, Morris & Fisher (1979), J. Fluid Mech. 93, 1."""
        return self.jet_diameter * (4.2 + 1.1 * (self.jet.u / self.gas.sound(self.jet.T)) ** 2)

    def outside(self, x: float) -> State:
        """The gas on the axis of the free jet at x (m): constant in the core, then the decay of Lau, Morris & Fisher. The total
        temperature depends linearly on the velocity (Crocco-Busemann). The density is that of the pure gas, not of a mixture."""
        s = (x - self.nozzle.end) / self.core
        share = 1 - math.exp(1.35 / (1 - s)) if s > 1 else 1.0
        u = share * self.jet.u
        T = T_AMBIENT + share * (self.T0 - T_AMBIENT) - u**2 / (2 * self.gas.cp)
        return State(u, T, self.ambient / (self.gas.R * T))

    @cached_property
    def layer(self) -> float:
        """Distance of the bow shock from the target, m; 0 without a bow shock.

        An estimate by continuity, as in Moeckel (1949), NACA TN 1921, for a layer of constant thickness: the mass of the jet leaves the
        layer over its rim at the speed of sound.
        """
        before, g = self.outside(self.target), self.gas.gamma
        if not self.bow_shock or before.u <= self.gas.sound(before.T):
            return 0.0
        _, T, rho = self._at_rest
        sonic = rho * (2 / (g + 1)) ** (1 / (g - 1)) * self.gas.sound(2 / (g + 1) * T)
        diameter = math.sqrt(4 / math.pi * self.mass_flow / (before.rho * before.u))
        return diameter / 4 * before.rho * before.u / sonic

    @cached_property
    def _at_rest(self) -> State:
        """Two states in one: u directly behind the bow shock; T and rho of the same gas after it comes to rest (total values)."""
        before, g = self.outside(self.target), self.gas.gamma
        M, p = normal_shock(before.u / self.gas.sound(before.T), g)
        T = before.T + before.u**2 / (2 * self.gas.cp)
        rho = before.rho * before.T * p * pressure_ratio(M, g) / T
        return State(M * self.gas.sound(T / temperature_ratio(M, g)), T, rho)

    def stopped(self, x: float) -> State:
        """The gas at x (m) between bow shock and target. Its velocity decreases linearly to zero, without losses."""
        behind, total, rho = self._at_rest
        u = behind * (self.target - x) / self.layer
        T = total - u**2 / (2 * self.gas.cp)
        return State(u, T, rho * (T / total) ** (1 / (self.gas.gamma - 1)))

    @property
    def target(self) -> float:
        """Position of the target, m from the throat."""
        return self.nozzle.end + self.standoff

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """The parts of the axis from the powder feed to the target."""
        nozzle, shock = self.nozzle, self.target - self.layer
        inside = [x for x in nozzle.corners if x > nozzle.feed]
        sections = [Piece(a, b, self.inside) for a, b in zip([nozzle.feed, *inside], inside, strict=False)]
        sections.append(Piece(nozzle.end, shock, self.outside))
        return (*sections, Piece(shock, self.target, self.stopped)) if self.layer else tuple(sections)

    @property
    def notes(self) -> list[str]:
        """Notes on limits of validity of this flow, and on assumed values of its nozzle."""
        ends = f"{self.exit_pressure / 1e5:.2g} bar at the exit, {self.ambient / 1e5:.3g} outside"
        slow = f"below a ratio of {SEPARATES:g} a real flow separates from the wall in the nozzle, and particles are slower"
        core = f"the target stands beyond the jet's core, {self.core * 1e3:.3g} mm long: the jet is slower there"
        notes = {
            f"over-expanded: {ends}; {slow}": self.exit_pressure < SEPARATES * self.ambient,
            core: self.standoff > self.core,
            f"assumed values of the nozzle: {self.nozzle.assumed}": bool(self.nozzle.assumed),
        }
        return [note for note, applies in notes.items() if applies]
