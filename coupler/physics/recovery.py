"""Static recovery: a metal loses strain hardening with time at high temperature, because dislocations climb and annihilate in pairs.

d rho/dt = -2 tau_L M rho^2: tau_L = G b^2 / 2 is the line tension, M = D b / (k_B T) the mobility of climb (Lagneborg (1972), Int.
Metall. Rev. 17, 130; Sandstrom (2012), Acta Mater. 60, 314; second-hand), D = D_v + rho a_c D_c the diffusion coefficient through the
lattice and along dislocations (Frost & Ashby (1982), Deformation-Mechanism Maps, eq. 2.20, second-hand). Taylor's relation gives the
dislocation density rho from the hardening of the strength law. No parameter is fitted to measured recovery.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from .materials import Material

BOLTZMANN, GAS_CONSTANT = 1.380649e-23, 8.314462618  # J/K, J/(mol K)
_STRAINS = np.geomspace(1e-5, 100.0, 140)
_Y = np.geomspace(1e-7, 0.3, 300)  # b sqrt(rho)


@dataclass(frozen=True, eq=False)
class Recovery:
    """Static recovery of one metal. densities (k,) 1/m2 at plastic strains (k,), both ascending. lattice: factor (m2/s) and activation
    energy (J/mol) of self-diffusion; core: the same for diffusion along dislocations (D_c, m4/s, and Q_c of `Material`).
    climb: 2 tau_L b / k_B, m2 K, with the line tension tau_L of a dislocation and its Burgers vector b."""

    strains: np.ndarray
    densities: np.ndarray
    lattice: tuple[float, float]
    core: tuple[float, float]
    climb: float

    def density(self, eps_p: np.ndarray) -> np.ndarray:
        """Dislocation density (m,) 1/m2 at plastic strains (m,)."""
        logs = np.log(np.maximum(eps_p, _STRAINS[0]))
        return np.exp(np.interp(logs, np.log(self.strains), np.log(self.densities)))

    def after(self, eps_p: np.ndarray, T: np.ndarray, time: float) -> np.ndarray:
        """Plastic strain (m,) that hardens after `time` s at T (m,) K; at most eps_p (m,).

        Strang splitting of the two diffusion paths, each with its exact solution: stable and positive for any time.
        """
        D_v, D_c = (D * np.exp(-Q / (GAS_CONSTANT * T)) for D, Q in (self.lattice, self.core))
        half, rate = 0.5 * time * self.climb * D_v / T, 2.0 * time * self.climb * D_c / T
        rho = self.density(eps_p)
        rho = rho / (1.0 + half * rho)
        rho = rho / np.sqrt(1.0 + rate * rho * rho)
        rho = rho / (1.0 + half * rho)
        left = np.exp(np.interp(np.log(rho), np.log(self.densities), np.log(self.strains)))
        return np.minimum(eps_p, np.where(rho < self.densities[0], 0.0, left))


@cache
def recovery_of(metal: Material) -> Recovery | None:
    """The static recovery of a metal; None if it lacks D_v, Q_v, D_c or Q_c, or the data of Taylor's relation."""
    known = metal.D_v, metal.Q_v, metal.D_c, metal.Q_c
    if None in known or not metal.taylor_alpha or metal.burgers is None:
        return None
    D_v, Q_v, D_c, Q_c = (float(number) for number in known if number is not None)
    (A, B), b = metal.forest, metal.burgers
    annealed = metal.flow_stress(0.0, 0.0, metal.T_ref)
    hardening = np.array([metal.flow_stress(float(eps_p), 0.0, metal.T_ref) - annealed for eps_p in _STRAINS])
    rho = np.interp(hardening, _Y * (A + B * np.log(_Y)), (_Y / b) ** 2)
    rises = np.diff(rho, prepend=0.0) > 0.0  # the hardening of a law may saturate
    return Recovery(_STRAINS[rises], rho[rises], (D_v, Q_v), (D_c, Q_c), metal.G * b**3 / BOLTZMANN)


def recovered_share(metal: Material, T: float, time: float) -> float:
    """Fraction of the dislocations of a plastic strain of 1 that recover in `time` s at T (K); 0 if the recovery is not known."""
    law = recovery_of(metal)
    if law is None or time <= 0.0:
        return 0.0
    before = np.ones(1)
    after = law.density(law.after(before, np.array([T]), time))
    return 1.0 - float(after[0] / law.density(before)[0])
