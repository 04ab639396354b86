"""The one time loop of an impact: an SPH particle and an FE target that meet in every step.

LAMMPS owns the loop of single steps and calls `_rendezvous` between its forces and its kick; there the target makes
the same step with the same dt, contact is computed once from the positions of both at n+1, and each domain leaves
with its forces. Every CHUNK steps both agree on dt, pairs that may touch are searched, and the books are kept.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .errors import SolverError

CHUNK = 10  # steps between two agreements on dt; a stale dt at a Courant factor of 0.9 is known to blow up after more


@dataclass
class Ledger:
    """Energies of both domains in J. Their sum is constant; `drift` is its change over the initial kinetic energy.

    internal_particle is the work done against the particle's internal forces; what of it is neither elastic nor
    plastic the SPH scheme itself has eaten (viscosity, hourglass control, kernel error): numerical_particle.
    numerical_target is the work of the bulk viscosity. The target's elastic and plastic energies are functions of
    its state, so that drift measures its stress update and the contact, not just arithmetic.
    """

    kinetic_0: float
    momentum_0: np.ndarray
    rows: dict[str, float] = field(default_factory=dict)

    def close(self, particle: Any, target: Any, contact: Any) -> dict[str, float]:
        """Take stock. Returns the energies (J), drift (of the initial kinetic energy) and momentum_error (of the initial momentum)."""
        r: dict[str, float] = {}
        r["kinetic_particle"], r["kinetic_target"] = particle.kinetic(), target.kinetic()
        r["kinetic"] = r["kinetic_particle"] + r["kinetic_target"]
        r["elastic_particle"], r["elastic_target"] = particle.elastic(), target.elastic()
        r["plastic_particle"], r["plastic_target"] = float(particle.sums[0]), float(target.sums[0])
        r["numerical_particle"] = particle.internal_work - r["elastic_particle"] - r["plastic_particle"]
        r["numerical_target"] = float(target.sums[1])
        r["contact"], r["friction"] = contact.penalty_energy, contact.friction_heat
        r["boundary"] = target.absorbed
        stored = sum(
            r[f"{what}_{where}"] for what in ("elastic", "plastic", "numerical") for where in ("particle", "target")
        )
        total = r["kinetic"] + stored + r["contact"] + r["friction"] + r["boundary"]
        r["drift"] = (total - self.kinetic_0) / self.kinetic_0
        balance = particle.momentum() + target.momentum() - target.external_impulse() - self.momentum_0
        r["momentum_error"] = float(np.linalg.norm(balance) / np.linalg.norm(self.momentum_0))
        self.rows = r
        return r


class Impact:
    """One particle meeting one target. They touch where the particle's carried surface meets the target's facets."""

    def __init__(self, particle: Any, target: Any, surface: Any, contact: Any, threads: int = 1):
        """threads: with 2, the target's next step is computed beside LAMMPS's, on a second core; the numbers are the same."""
        self.particle, self.target, self.surface, self.contact = particle, target, surface, contact
        self._softness = surface.softness(particle.mass)
        self._forces = np.zeros((surface.touching.shape[0], 3))
        self.surface_nodes = np.unique(contact.facets)
        self.ledger = Ledger(particle.kinetic(), particle.momentum() + target.momentum())
        self._pool = ThreadPoolExecutor(1) if threads > 1 else None
        self._ahead: Future[None] | None = None
        self._left = 0  # steps of this chunk still to come
        self.time = 0.0
        self.force = np.zeros(3)  # on the particle, N
        self.deepest = 0.0  # largest penetration so far, m
        self.limits: dict[str, int] = {"particle": 0, "target": 0, "contact": 0}

    def _rendezvous(self) -> None:
        p, t, s, dt = self.particle, self.target, self.surface, self.particle.dt
        if self._ahead is None:
            t.advance(dt)
        else:
            self._ahead.result()
        self._forces[:] = 0.0
        self.contact.forces(dt, s.contacts(p.x), s.contacts(p.v), t.x, t.v, self._forces, t.f_ext)
        p.f_ext += s.spread(self._forces)
        t.finish()
        self._left -= 1
        # until LAMMPS calls again it works in C, without Python's lock: room for the target's next step
        self._ahead = self._pool.submit(t.advance, dt) if self._pool and self._left else None

    def agree_on_dt(self) -> float:
        """The time step (s) both domains and the contact can take, and a note of which asked for it."""
        bounds = {
            "particle": self.particle.stable_dt(),
            "contact": self.contact.stable_dt(self._softness, self.target.mass[self.surface_nodes]),
        }
        bounds["target"] = self.target.stable_dt(min(bounds.values()))[0]
        who = min(bounds, key=lambda name: bounds[name])
        self.limits[who] += CHUNK
        return bounds[who]

    def advance(self, until: float | None = None) -> float:
        """Make a chunk of steps (fewer and smaller where `until`, s, is near). Returns dt, s.

        Raises SolverError where either domain breaks down.
        """
        dt, steps = self.agree_on_dt(), CHUNK
        if until is not None and self.time + steps * dt > until:
            steps = max(1, int(np.ceil((until - self.time) / dt - 1e-9)))
            dt = (until - self.time) / steps
        fastest = float(np.sqrt(np.max(np.einsum("ij,ij->i", self.particle.v, self.particle.v))))
        fastest += float(np.sqrt(np.max(np.einsum("ij,ij->i", (v := self.target.v[self.surface_nodes]), v))))
        self.contact.search(self.surface.contacts(self.particle.x), self.target.x, 1.5 * fastest * steps * dt)
        self._left, self._ahead = steps, None
        self.particle.run(steps, dt, self._rendezvous)
        self.time += steps * dt
        self.force = self._forces.sum(axis=0)
        self.deepest = max(self.deepest, float(self.contact.depth.max()))
        self._share_heat()
        return dt

    def _share_heat(self) -> None:
        """Friction heat becomes temperature: of the points it arose at, and of the elements behind the facets."""
        c, p, t = self.contact, self.particle, self.target
        if c.heat_point.any():
            p.warm(self.surface.spread_heat(c.heat_point))
            c.heat_point[:] = 0.0
        facets = np.flatnonzero(c.heat_facet)
        if len(facets):
            t.warm(t.mesh.facet_element[c.facet_ids[facets]], c.heat_facet[facets])
            c.heat_facet[facets] = 0.0


class Watch:
    """Says when an impact has come to its greatest deformation and when it is over.

    Greatest deformation: the particle's centre of mass stops sinking. Over: it no longer sinks and the contact
    force has stayed below 2 % of its peak for `quiet` seconds (the particle has left, or rests), or time is up.
    """

    def __init__(self, end_time: float, at_rest: bool, quiet: float):
        self.end_time, self.at_rest, self.quiet = end_time, at_rest, quiet
        self.peak = 0.0
        self.turned: float | None = None
        self._loud = 0.0

    def look(self, time: float, sinking: float, force: float) -> bool:
        """sinking: downward speed of the centre of mass (m/s), force: on the particle, upwards (N). Returns True when it is over."""
        self.peak = max(self.peak, force)
        if self.turned is None and self.peak > 0.0 and sinking <= 0.0:
            self.turned = time
        if abs(force) > 0.02 * self.peak:
            self._loud = time
        settled = self.turned is not None and self.peak > 0 and time - self._loud > self.quiet
        return time >= self.end_time * (1 - 1e-12) or (self.at_rest and settled)


def check_books(ledger: Ledger, drift_bound: float, momentum_bound: float) -> None:
    """Raise SolverError when the energy ledger or the momentum balance of a run does not close."""
    drift, error = ledger.rows["drift"], ledger.rows["momentum_error"]
    if not abs(drift) <= drift_bound:
        raise SolverError(
            f"the energy ledger does not close: {drift:+.2%} of the initial kinetic energy, allowed {drift_bound:.2%}. "
            "What was computed is in the folder but is not a result: try a finer preset or a smaller time step"
        )
    if not error <= momentum_bound:
        raise SolverError(
            f"momentum is not conserved: {error:.1e} of the initial momentum, allowed {momentum_bound:.0e}"
        )
