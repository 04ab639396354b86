"""Flight of particles from the powder feed to the target, with drag and heat transfer from the gas of `coupler.spray.gas`.

A particle is a single sphere of uniform temperature on the axis; docs/evidence/gas.md gives the accuracy. All sizes are integrated
together.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import ColdsprayError
from ..physics.materials import Material
from .gas import T_AMBIENT, Flow, State

POINTS = 80  # that are stored in each piece of the axis
NEAR_MELTING = 0.9  # temperature over melting point, K over K
Numbers = float | NDArray[np.float64]
# (Re, M, T_particle / T_gas, gamma) -> coefficient
Drag = Callable[[Numbers, Numbers, Numbers, float], NDArray[np.float64]]


def henderson(Re: Numbers, M: Numbers, theta: Numbers, gamma: float) -> NDArray[np.float64]:
    """Drag coefficient of a sphere, from creeping to free-molecular flow, M < 6: Henderson (1976), AIAA J. 14, 707.

    Re, M: Reynolds and Mach number of the relative motion; theta: temperature of the sphere divided by the temperature of the gas.
    """
    slow, fast = _subsonic(Re, np.minimum(M, 1.0), theta, gamma), _supersonic(Re, np.maximum(M, 1.75), theta, gamma)
    return slow + np.clip(4 / 3 * (M - 1), 0.0, 1.0) * (fast - slow)


def _subsonic(Re: Numbers, M: Numbers, theta: Numbers, gamma: float) -> NDArray[np.float64]:
    S = M * math.sqrt(gamma / 2)
    slip = 4.33 + (3.65 - 1.53 * theta) / (1 + 0.353 * theta) * np.exp(-0.247 * Re / S)
    knee = 0.03 * Re + 0.48 * np.sqrt(Re)
    inertia = (4.5 + 0.38 * knee) / (1 + knee) + 0.1 * M**2 + 0.2 * M**8
    return 24 / (Re + S * slip) + inertia * np.exp(-0.5 * M / np.sqrt(Re)) + (1 - np.exp(-M / Re)) * 0.6 * S


def _supersonic(Re: Numbers, M: Numbers, theta: Numbers, gamma: float) -> NDArray[np.float64]:
    S = M * math.sqrt(gamma / 2)
    rare = 1.86 * np.sqrt(M / Re)
    molecular = 2 + 2 / S**2 + 1.058 / S * np.sqrt(theta) - 1 / S**4
    return (0.9 + 0.34 / M**2 + rare * molecular) / (1 + rare)


def carlson_hoglund(Re: Numbers, M: Numbers, theta: Numbers, gamma: float) -> NDArray[np.float64]:
    """Drag coefficient of a sphere by Carlson & Hoglund (1964), AIAA J. 2, 1980; arguments as in `henderson`."""
    inertia = (1 + 0.15 * Re**0.687) * (1 + np.exp(-0.427 / M**4.63 - 3.0 / Re**0.88))
    return 24 / Re * inertia / (1 + M / Re * (3.82 + 1.28 * np.exp(-1.25 * Re / M)))


DRAG_LAWS: dict[str, Drag] = {"henderson": henderson, "carlson-hoglund": carlson_hoglund}


def nusselt(Re: Numbers, M: Numbers, Pr: float) -> NDArray[np.float64]:
    """Nusselt number of a sphere. It is based on the recovery temperature of the gas, not its static temperature. The law of Ranz &
    Marshall (1952) is reduced at low density and high Mach number as by Kavanau (1955), in the form of Carlson & Hoglund (1964)."""
    continuum = 2 + 0.6 * np.sqrt(Re) * Pr ** (1 / 3)
    return continuum / (1 + 3.42 * M / (Re * Pr) * continuum)


@dataclass(frozen=True)
class Flight:
    """Flight of a particle to the target, arrays (n,): position x (m), velocities u of the gas and v of the particle (m/s), their
    temperatures T_gas and T (K), time t (s) since the feed."""

    x: NDArray[np.float64]
    u: NDArray[np.float64]
    T_gas: NDArray[np.float64]
    v: NDArray[np.float64]
    T: NDArray[np.float64]
    t: NDArray[np.float64]

    @property
    def velocity(self) -> float:
        """Velocity at impact, m/s."""
        return float(self.v[-1])

    @property
    def temperature(self) -> float:
        """Temperature at impact, K."""
        return float(self.T[-1])


def melting(
    material: Material, diameter: Sequence[float], hottest: Sequence[float], impact: Sequence[float]
) -> list[str]:
    """Notes on particles that melt in flight; if there are none, notes on particles that arrive near their melting point. diameter
    (m); hottest, impact: highest temperature in flight and temperature at impact, K."""
    near = NEAR_MELTING * material.T_m
    for temperature, limit, text in (
        (hottest, material.T_m, f"reach the melting point ({material.T_m:.0f} K) in flight: melt is not modelled"),
        (impact, near, f"arrive above {near:.0f} K, {NEAR_MELTING:g} of the melting point: critical velocities"
        f" are measured only at lower temperatures"),
    ):  # fmt: skip
        over = [D for D, T in zip(diameter, temperature, strict=True) if T >= limit]
        if over:
            sizes = " to ".join(dict.fromkeys(f"{D * 1e6:.3g}" for D in (min(over), max(over))))
            return [f"{material.name} particles of {sizes} um {text}"]
    return []


def fly_together(
    flow: Flow, material: Material, diameters: Sequence[float], T_feed: float = T_AMBIENT, drag: Drag = henderson
) -> list[Flight]:
    """Flights of spheres (diameters D, m) of uniform temperature from the feed to the target along the axis.

        m v dv/dx = C_D rho_gas |u - v| (u - v) pi D^2 / 8,    m cp v dT/dx = Nu k pi D (T_r - T)

    T_r = T_gas (1 + sqrt(Pr) (gamma - 1) / 2 M^2): recovery temperature (White, Viscous Fluid Flow, 1991). The spheres start at T_feed
    (K) with the velocity of the gas at the inlet of the nozzle. They have the same steps in x, and each satisfies the tolerance of
    the solver. Raises ColdsprayError if a flight cannot be computed.
    """
    from scipy.integrate import solve_ivp

    D, gas, rho, (given, c_p) = np.asarray(diameters, np.float64), flow.gas, material.rho, np.transpose(material.cp)
    columns = []
    y = np.tile([flow.inside(-flow.nozzle.converging).u, T_feed, 0.0], len(D))  # u, T, t of each sphere
    for start, stop, state in flow.pieces:

        def slope(x: float, y: NDArray[np.float64], state: Callable[[float], State] = state) -> NDArray[np.float64]:
            v, T = np.maximum(y[0::3], 1e-9), y[1::3]
            u, T_gas, rho_gas = state(x)
            w = np.maximum(np.abs(u - v), 1e-9)
            Re, M = rho_gas * w * D / gas.viscosity(T_gas), w / gas.sound(T_gas)
            push = 3 / 4 * drag(Re, M, T / T_gas, gas.gamma) * rho_gas * w * (u - v) / (rho * D)
            T_r = T_gas * (1 + math.sqrt(gas.Pr) * (gas.gamma - 1) / 2 * M**2)
            gain = 6 * nusselt(Re, M, gas.Pr) * gas.conductivity(T_gas) * (T_r - T)
            heat = gain / (rho * np.interp(T, given, c_p) * D**2)
            return np.stack([push / v, heat / v, 1 / v], axis=1).ravel()

        # finer at both ends, where the gas changes fastest: throat and shock
        xs = start + (stop - start) * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, POINTS)))
        xs[0], xs[-1] = start, stop
        atol = np.tile([1e-6, 1e-6, 1e-12], len(D))
        solved = solve_ivp(slope, (start, stop), y, "LSODA", xs, rtol=1e-8, atol=atol, lband=2, uband=2)
        if not solved.success or not np.isfinite(solved.y).all():
            which = " to ".join(f"{size * 1e6:.3g}" for size in sorted({D.min(), D.max()}))
            where = f"of particles of {which} um between x = {start * 1e3:.3g} and {stop * 1e3:.3g} mm"
            raise ColdsprayError(f"cannot integrate the flight {where}: check diameters, metal and gas")
        u, T_gas, _ = np.transpose([state(float(x)) for x in xs])
        columns.append(np.vstack([xs, u, T_gas, solved.y]))
        y = solved.y[:, -1]
    table = np.hstack(columns)
    return [Flight(*table[:3], *table[3 + 3 * i : 6 + 3 * i]) for i in range(len(D))]
