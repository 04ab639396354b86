"""The energy ledger of an impact, and the checks that it closes."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..contact.particle_bonds import ParticleBonds
from ..core.records import Shape
from ..errors import SolverError
from .domains import Domains

DRIFT_BOUND = 0.01  # of the initial kinetic energy: a run that ends beyond it has failed
DRIFT_ALARM = 4.0 * DRIFT_BOUND  # during the run, where part of the drift may come back
MOMENTUM_BOUND = 1e-6  # of the initial momentum
DISSIPATION_BOUND = -0.01  # numerical dissipation below it: the scheme generates energy and is unstable
FLOWS = 0.01  # of the initial kinetic energy: the least plastic work that a share of it says something about

_STORED = (
    "kinetic", "elastic_particle", "elastic_target", "plastic_particle", "plastic_target", "numerical_particle",
    "numerical_target", "contact", "friction", "boundary", "bodies", "bond",
)  # fmt: skip


@dataclass
class Ledger:
    """Energies of both domains in J, of one impact: the energy of the target before the impact is subtracted.

    The sum of all terms is constant; `drift` is its change over the particle's initial kinetic energy. Of the work done against the
    particle's internal forces, the part that is neither elastic nor plastic is the numerical dissipation of the SPH scheme:
    numerical_particle, the sum of viscosity_particle and hourglass_particle, measured from their own forces, and of
    unexplained_particle, the rest (with an engine that does not measure them: all of it). numerical_target is the work of the bulk
    viscosity, the target's only dissipation, and what the inertia of its scaled elements holds and has taken. The target's elastic and
    plastic energies are functions of its state, so that the drift measures its stress update and the contact as well.

    kinetic_0: initial kinetic energy, J; momentum_0 (3,): initial momentum, N s; scale: its norm for the particle alone; before: the
    terms at the start, J; rows: the terms at the last update.
    """

    kinetic_0: float
    scale: float
    before: dict[str, float]
    rows: dict[str, float]
    momentum_0: Annotated[np.ndarray, Shape(3)]

    @classmethod
    def begin(cls, domains: Domains) -> "Ledger":
        """The ledger of an impact that begins."""
        momentum, target = domains.particle.totals.momentum, domains.target
        whole = momentum + target.momentum() - target.external_impulse()
        scale, before = float(np.linalg.norm(momentum)), _terms(domains, None)
        return cls(domains.particle.totals.kinetic, scale, before, {}, whole)

    def update(self, domains: Domains, bonds: ParticleBonds | None = None) -> dict[str, float]:
        """Energies (J), drift (of the initial kinetic energy) and momentum_error (of the initial momentum) of this instant.

        bonds: the bond of the particle to the target, None without one.
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
    def numerical_dissipation(self) -> float:
        """Share of the initial kinetic energy that the schemes of both domains have dissipated."""
        return (self.rows["numerical_particle"] + self.rows["numerical_target"]) / self.kinetic_0

    @property
    def dissipation_of_plastic(self) -> float | None:
        """Numerical dissipation of the particle over its plastic work; None where it hardly flows, by less than FLOWS."""
        plastic = self.rows["plastic_particle"]
        return self.rows["numerical_particle"] / plastic if plastic > FLOWS * self.kinetic_0 else None

    def check(self, drift_bound: float | None = None) -> None:
        """Raise SolverError when energy or momentum do not balance at the last update. drift_bound: DRIFT_BOUND by default."""
        bound = DRIFT_BOUND if drift_bound is None else drift_bound
        drift, error = self.rows["drift"], self.rows["momentum_error"]
        if not abs(drift) <= bound:
            raise SolverError(
                f"the energy ledger does not close: {drift:+.2%} of the initial kinetic energy, allowed {bound:.2%}. "
                "What was computed is in the folder but is not a result: try a finer preset or a smaller time step"
            )
        if not error <= MOMENTUM_BOUND:
            raise SolverError(
                f"momentum is not conserved: {error:.1e} of the initial momentum, allowed {MOMENTUM_BOUND:.0e}:"
                " try a finer preset or a smaller time step"
            )

    def check_closure(self) -> None:
        """Raise SolverError when the ledger of a finished impact does not close."""
        self.check()
        # what viscosity and hourglass control take must not hide what is generated elsewhere
        dissipated, unexplained = (
            self.rows[f"{name}_particle"] / self.kinetic_0 for name in ("numerical", "unexplained")
        )
        if dissipated < DISSIPATION_BOUND or unexplained < 2.0 * DISSIPATION_BOUND:
            raise SolverError(
                f"the SPH scheme generated {-min(dissipated, unexplained):.2%} of the initial kinetic energy: it is unstable; "
                "try a finer preset"
            )


def _terms(domains: Domains, bonds: ParticleBonds | None) -> dict[str, float]:
    """Present value of each term of the ledger, J."""
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
