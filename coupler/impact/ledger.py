"""The energy ledger of an impact: a balance of all energies, and checks that the total stays constant."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..contact.particle_bonds import ParticleBonds
from ..core.records import Shape
from ..errors import SolverError
from .domains import Domains

DRIFT_BOUND = 0.01  # of the initial kinetic energy: largest drift at the end of a run
DRIFT_ALARM = 4.0 * DRIFT_BOUND  # largest drift during the run: part of it can be reversible
MOMENTUM_BOUND = 1e-6  # of the initial momentum
DISSIPATION_BOUND = -0.01  # of the initial kinetic energy: with a lower numerical dissipation the scheme is unstable
FLOWS = 0.01  # of the initial kinetic energy: plastic work below which ratios to it are not reported

_STORED = (
    "kinetic", "elastic_particle", "elastic_target", "plastic_particle", "plastic_target", "numerical_particle",
    "numerical_target", "contact", "friction", "boundary", "bodies", "bond",
)  # fmt: skip


@dataclass
class Ledger:
    """Energies of both domains in one impact, J, less their values before the impact (except kinetic energies).

    The sum of all terms should be constant; `drift` is its change divided by the initial kinetic energy of the particle.
    numerical_particle: numerical dissipation of the SPH scheme, the work against internal forces less elastic and plastic energy. Its
    parts viscosity_particle and hourglass_particle are measured from their own forces; unexplained_particle is the rest (all of it
    with an engine that does not measure them). numerical_target: work of the bulk viscosity and of the inertia of scaled elements.
    Elastic and plastic energy of the target are functions of its state: the drift includes errors of stress update and contact.

    kinetic_0 (J): initial kinetic energy; momentum_0 (3,) N s: initial momentum; scale: norm of the initial momentum of the
    particle alone; before: terms at the start, J; rows: terms at the last update.
    """

    kinetic_0: float
    scale: float
    before: dict[str, float]
    rows: dict[str, float]
    momentum_0: Annotated[np.ndarray, Shape(3)]

    @classmethod
    def begin(cls, domains: Domains) -> "Ledger":
        """The ledger at the start of an impact."""
        momentum, target = domains.particle.totals.momentum, domains.target
        whole = momentum + target.momentum() - target.external_impulse()
        scale, before = float(np.linalg.norm(momentum)), _terms(domains, None)
        return cls(domains.particle.totals.kinetic, scale, before, {}, whole)

    def update(self, domains: Domains, bonds: ParticleBonds | None = None) -> dict[str, float]:
        """Compute present energies (J), `drift` (divided by initial kinetic energy) and `momentum_error` (by initial momentum).

        bonds: bonds between particle and target, None if there are none.
        """
        r, target = _terms(domains, bonds), domains.target
        total = sum(value - self.before[name] for name, value in r.items() if name in _STORED)
        for name in r:
            if "kinetic" not in name:
                r[name] -= self.before[name]
        r["drift"] = total / self.kinetic_0
        balance = domains.particle.totals.momentum + target.momentum() - target.external_impulse() - self.momentum_0
        r["momentum_error"] = float(np.linalg.norm(balance) / self.scale)
        self.rows = r
        return r

    @property
    def dissipation_of_plastic(self) -> float | None:
        """Numerical dissipation of the particle divided by its plastic work; None if this work is below FLOWS * kinetic_0."""
        plastic = self.rows["plastic_particle"]
        return self.rows["numerical_particle"] / plastic if plastic > FLOWS * self.kinetic_0 else None

    def check(self, drift_bound: float | None = None) -> None:
        """Raise SolverError if energy or momentum was not in balance at the last update. drift_bound: default DRIFT_BOUND."""
        bound = DRIFT_BOUND if drift_bound is None else drift_bound
        drift, error = self.rows["drift"], self.rows["momentum_error"]
        if not abs(drift) <= bound:
            raise SolverError(
                f"energy is not conserved: the sum of all energies has changed by {drift:+.2%} of the initial kinetic energy, but "
                f"the limit is {bound:.2%}. The files in the output folder are not a valid result: try a finer preset"
            )
        if not error <= MOMENTUM_BOUND:
            raise SolverError(
                f"momentum is not conserved: it has changed by {error:.1e} of the initial momentum, limit"
                f" {MOMENTUM_BOUND:.0e}: try a finer preset"
            )

    def check_closure(self) -> None:
        """Raise SolverError if a finished impact fails `check`, or if its SPH scheme has generated energy."""
        self.check()
        # losses by viscosity and hourglass control must not hide energy that is generated elsewhere
        numerical, unexplained = (self.rows[f"{k}_particle"] / self.kinetic_0 for k in ("numerical", "unexplained"))
        if numerical < DISSIPATION_BOUND or unexplained < 2.0 * DISSIPATION_BOUND:
            raise SolverError(
                f"the SPH scheme generated {-min(numerical, unexplained):.2%} of the initial kinetic energy, because it is unstable: "
                "try a finer preset"
            )


def _terms(domains: Domains, bonds: ParticleBonds | None) -> dict[str, float]:
    """Present values of all terms of the ledger, J."""
    particle, target, contact = domains.particle.totals, domains.target, domains.contact
    r = {"kinetic_particle": particle.kinetic, "kinetic_target": target.kinetic()}
    r["kinetic"] = r["kinetic_particle"] + r["kinetic_target"]
    r["elastic_particle"], r["elastic_target"] = particle.elastic, target.elastic()
    r["plastic_particle"], r["plastic_target"] = particle.plastic, target.balance.plastic
    r["numerical_particle"] = particle.internal_work - r["elastic_particle"] - r["plastic_particle"]
    r["viscosity_particle"], r["hourglass_particle"] = particle.viscosity, particle.hourglass
    r["unexplained_particle"] = r["numerical_particle"] - r["viscosity_particle"] - r["hourglass_particle"]
    r["numerical_target"] = target.balance.numerical
    contacts = [contact] if domains.folding is None else [contact, domains.folding.contact]
    r["contact"] = sum(c.penalty_energy + c.sums.dropped_energy for c in contacts)
    r["friction"] = sum(c.sums.friction_heat for c in contacts)
    r["boundary"], r["bodies"] = target.balance.absorbed, domains.bodies.energy
    r["bond"] = bonds.bond.work if bonds is not None else 0.0
    return r
