"""A particle on its way from the powder feed to the target, dragged and heated by the gas of `coupler.spray.gas`.

It is a sphere of one temperature, alone on the axis; how good that is, is in docs/guide/gas.md.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ..errors import ColdsprayError
from ..physics.materials import Material
from .gas import T_AMBIENT, Flow, Gas, Piece, State

Drag = Callable[[float, float, float, float], float]  # (Re, M, T_particle / T_gas, gamma) -> coefficient


def henderson(Re: float, M: float, theta: float, gamma: float) -> float:
    """Drag coefficient of a sphere, from creeping to free-molecular flow, M < 6.

    Re, M: of the relative motion; theta: temperature of the sphere over that of the gas. Henderson (1976), AIAA J. 14, 707.
    """
    if M <= 1:
        return _subsonic(Re, M, theta, gamma)
    if M >= 1.75:
        return _supersonic(Re, M, theta, gamma)
    slow, fast = _subsonic(Re, 1.0, theta, gamma), _supersonic(Re, 1.75, theta, gamma)
    return slow + 4 / 3 * (M - 1) * (fast - slow)


def _subsonic(Re: float, M: float, theta: float, gamma: float) -> float:
    S = M * math.sqrt(gamma / 2)
    slip = 4.33 + (3.65 - 1.53 * theta) / (1 + 0.353 * theta) * math.exp(-0.247 * Re / S)
    knee = 0.03 * Re + 0.48 * math.sqrt(Re)
    inertia = (4.5 + 0.38 * knee) / (1 + knee) + 0.1 * M**2 + 0.2 * M**8
    return 24 / (Re + S * slip) + inertia * math.exp(-0.5 * M / math.sqrt(Re)) + (1 - math.exp(-M / Re)) * 0.6 * S


def _supersonic(Re: float, M: float, theta: float, gamma: float) -> float:
    S = M * math.sqrt(gamma / 2)
    rare = 1.86 * math.sqrt(M / Re)
    molecular = 2 + 2 / S**2 + 1.058 / S * math.sqrt(theta) - 1 / S**4
    return (0.9 + 0.34 / M**2 + rare * molecular) / (1 + rare)


def carlson_hoglund(Re: float, M: float, theta: float, gamma: float) -> float:
    """Drag coefficient of a sphere by Carlson & Hoglund (1964), AIAA J. 2, 1980; arguments as in `henderson`."""
    inertia = (1 + 0.15 * Re**0.687) * (1 + math.exp(-0.427 / M**4.63 - 3.0 / Re**0.88))
    return 24 / Re * inertia / (1 + M / Re * (3.82 + 1.28 * math.exp(-1.25 * Re / M)))


DRAG_LAWS: dict[str, Drag] = {"henderson": henderson, "carlson-hoglund": carlson_hoglund}


def nusselt(Re: float, M: float, Pr: float) -> float:
    """Nusselt number of a sphere: Ranz & Marshall (1952), lowered for rarefaction and Mach number as by Kavanau (1955) in
    the form of Carlson & Hoglund (1964). The temperature that drives the heat is then the recovery temperature."""
    continuum = 2 + 0.6 * math.sqrt(Re) * Pr ** (1 / 3)
    return continuum / (1 + 3.42 * M / (Re * Pr) * continuum)


@dataclass(frozen=True)
class Flight:
    """A particle's way to the target: at positions x (m), arrays (n,), the velocities of gas and particle u, v (m/s),
    their temperatures T_gas, T (K) and the time t (s) since it was fed."""

    x: NDArray[np.float64]
    u: NDArray[np.float64]
    T_gas: NDArray[np.float64]
    v: NDArray[np.float64]
    T: NDArray[np.float64]
    t: NDArray[np.float64]

    @property
    def velocity(self) -> float:
        """At impact, m/s."""
        return float(self.v[-1])

    @property
    def temperature(self) -> float:
        """At impact, K."""
        return float(self.T[-1])


def fly(flow: Flow, material: Material, diameter: float, T_feed: float = T_AMBIENT, drag: Drag = henderson) -> Flight:
    """Drag and heat a sphere (diameter m) from its feed, where it has T_feed (K) and the velocity of the gas at the
    nozzle's inlet, to the target. Raises ColdsprayError if it never gets there."""
    v_feed = flow.inside(-flow.nozzle.converging).u
    return integrate(flow.pieces, flow.gas, material.rho, material.cp_at, diameter, v_feed, T_feed, drag)


def integrate(
    pieces: tuple[Piece, ...],
    gas: Gas,
    rho: float,
    cp: Callable[[float], float],
    D: float,
    v: float,
    T: float,
    drag: Drag = henderson,
    points: int = 80,
) -> Flight:
    """Integrate a sphere's motion and temperature, uniform in it, along the axis.

        m v dv/dx = C_D rho_gas |u - v| (u - v) pi D^2 / 8,    m cp v dT/dx = Nu k pi D (T_r - T)

    rho kg/m^3, cp(T) J/(kg K), D m: of the sphere; v m/s, T K: at the start; T_r = T_gas (1 + sqrt(Pr) (gamma - 1) / 2 M^2): the
    recovery temperature (White, Viscous Fluid Flow, 1991). points: stored in each piece.
    """
    columns = []
    y = np.array([v, T, 0.0])
    for start, stop, state in pieces:

        def slope(x: float, y: NDArray[np.float64], state: Callable[[float], State] = state) -> list[float]:
            v, T = max(y[0], 1e-9), y[1]
            u, T_gas, rho_gas = state(x)
            w = max(abs(u - v), 1e-9)
            Re, M = rho_gas * w * D / gas.viscosity(T_gas), w / gas.sound(T_gas)
            push = 3 / 4 * drag(Re, M, T / T_gas, gas.gamma) * rho_gas * w * (u - v) / (rho * D)
            T_r = T_gas * (1 + math.sqrt(gas.Pr) * (gas.gamma - 1) / 2 * M**2)
            heat = 6 * nusselt(Re, M, gas.Pr) * gas.conductivity(T_gas) * (T_r - T) / (rho * cp(T) * D**2)
            return [push / v, heat / v, 1 / v]

        # closer together at both ends, where the gas changes fastest: throat and shock
        xs = start + (stop - start) * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, points)))
        xs[0], xs[-1] = start, stop
        solved = solve_ivp(slope, (start, stop), y, "LSODA", xs, rtol=1e-8, atol=[1e-6, 1e-6, 1e-12])
        if not solved.success or not np.isfinite(solved.y).all():
            raise ColdsprayError(f"the particle of {D * 1e6:.3g} um cannot be followed past x = {start * 1e3:.3g} mm")
        gas_there = np.array([state(float(x)) for x in xs])
        columns.append(np.vstack([xs, gas_there[:, 0], gas_there[:, 1], solved.y]))
        y = solved.y[:, -1]
    return Flight(*np.hstack(columns))
