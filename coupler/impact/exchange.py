"""One particle and one target in contact: time step, contact search, forces of each step, bonding.

LAMMPS runs the loop over time steps. In each step it calls this module after its internal forces and before its last update of the
velocities. In this callback, the target first makes a step with the same dt (`advance_target`). Then the contact forces are computed
from the positions of both domains at n+1 (`exchange_forces`).
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np
from scipy.sparse import csr_matrix, hstack

from ..contact.bond import Bond
from ..contact.contact import ContactState
from ..contact.model import Nodes
from ..contact.particle_bonds import SECURE, ParticleBonds
from ..core.records import Shape, check_indices, copied, put, unfit
from ..errors import SolverError
from ..fe.gradients import growing
from ..geometry.points import depths
from ..physics.adhesion import PARTICLE_BOND_STIFFNESS, oxide_film
from ..physics.materials import Material
from ..plan.cost import CHUNK
from ..ranks.distributed import ParticleState
from ..target.bodies import BodiesState
from .domains import Domains, metals_of
from .ending import Grip
from .exposure import Exposure
from .ledger import Ledger
from .touching import Touching

# spacings: largest motion of a point in a chunk of steps, in which the stable step is not computed again
APPROACH = 0.5
LOST = 0.01  # largest share of the points that can lie deeper than a spacing in the target at the end


@dataclass(eq=False)
class Course:
    """Data collected during an impact. time (s): since its start; force (3,) N: present contact force on the particle; deepest (m):
    largest penetration so far; limits: numbers of steps whose length is limited by particle, target and contact."""

    time: float = 0.0
    deepest: float = 0.0
    limits: dict[str, int] = field(default_factory=lambda: {"particle": 0, "target": 0, "contact": 0})
    force: Annotated[np.ndarray, Shape(3)] = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class ImpactState:
    """State of an `Impact`, for a checkpoint."""

    bodies: BodiesState
    particle: ParticleState
    contact: ContactState
    folding: ContactState | None
    ledger: Ledger
    bonds: Bond | None
    exposure: Exposure | None
    course: Course


class Impact(Course):
    """The impact of one particle on one target of one or several bodies.

    The carried surface of the particle is in contact with the facets of the target. bonds: bonds of the particle, or None; dt_factor:
    factor of the stable time step, below 1 after a retry.
    """

    def __init__(self, domains: Domains):
        super().__init__()
        self.domains = domains
        self.particle, self.bodies, self.target = domains.particle, domains.bodies, domains.target
        self.surface, self.contact, self.folding = domains.surface, domains.contact, domains.folding
        self._softness = self.surface.softness(self.particle.mass)
        self.surface_nodes = np.unique(self.target.mesh.facets[self.contact.facing[0]])
        self.ledger = Ledger.begin(domains)
        self.bonds: ParticleBonds | None = None
        self.exposure: Exposure | None = None
        self.dt_factor = 1.0

    @cached_property
    def _beside(self) -> csr_matrix:
        """Matrix with a row for each vertex of the particle's surface and a column for each contact node, first vertices, then points.
        Entries are nonzero for adjacent vertices and for points under the vertex."""
        return hstack([self.surface.neighbours, self.surface.under], format="csr")

    @cached_property
    def _metals(self) -> list[Material]:
        """The metal of each law of the target."""
        return metals_of(self.domains.plan, self.bodies)

    @cached_property
    def _films(self) -> np.ndarray:
        """`oxide_film` (laws, 2) of the particle and each law of the target: exposure at cracking, strength times thickness (N/m)."""
        return np.array([oxide_film(self.domains.own.material, metal) for metal in self._metals])

    @property
    def sinking(self) -> float:
        """Speed (m/s) of the particle's centre of mass along the normal of the ground, positive towards the ground."""
        return -float(self.particle.totals.momentum @ self.domains.own.normal / self.particle.mass.sum())

    @property
    def grip(self) -> Grip:
        """State of the particle's bonds, as in `EndCriterion.observe`. It follows from the energy that the bonds can absorb, divided
        by the energy that can break them. The latter is the kinetic energy of the centre of mass normal to the surface plus the
        energy stored in the bonds."""
        if self.bonds is None or self.bonds.bond.broken.all():
            return "free"
        if self.sinking < 0.0 and self.bonds.may_break(self.normal_energy):
            return "free"
        ratio = self.bonds.resistance / max(self.normal_energy + self.bonds.bond.stored, 1e-300)
        return "failing" if ratio <= 1.0 else "held" if ratio < SECURE else "secure"

    @property
    def normal_energy(self) -> float:
        """Kinetic energy (J) of the particle's centre of mass normal to the surface."""
        return 0.5 * float(self.particle.mass.sum()) * self.sinking**2

    @property
    def dissipated(self) -> float:
        """Plastic work and heat of friction, J, including those of the target before the impact."""
        rubbed = 0.0 if self.folding is None else self.folding.contact.sums.friction_heat
        return self.particle.totals.plastic + self.target.balance.plastic + self.contact.sums.friction_heat + rubbed

    def _fastest(self) -> float:
        """Bound on the speed of approach of two surfaces, m/s: largest speed of a point plus that of a surface node."""
        v = self.target.nodes.v[self.surface_nodes]
        return self.particle.totals.fastest + float(np.sqrt(np.max(np.einsum("ij,ij->i", v, v))))

    def stable_time_step(self) -> float:
        """Stable time step (s) of the particle, the target and the contact. It also counts in `limits` which of these limits the
        step."""
        nearer = APPROACH * self.particle.spacing / (CHUNK * max(self.particle.totals.fastest, 1e-9))
        bounds = {
            "particle": min(self.particle.totals.dt, nearer),
            "contact": self.contact.stable_dt(self._softness, float(self.target.mass[self.surface_nodes].min())),
        }
        if self.folding is not None:
            bounds["contact"] = min(bounds["contact"], self.folding.stable_dt(self.particle.mass))
        if self.bonds is not None:
            bounds["contact"] = min(bounds["contact"], self.bonds.stable_dt(self._softness, self.target.mass))
        least = min(bounds.values())
        bounds["target"] = self.bodies.stable_dt(least, CHUNK * least)
        who = min(bounds, key=lambda name: bounds[name])
        self.limits[who] += CHUNK
        return self.dt_factor * bounds[who]

    def search_bodies(self) -> None:
        """Find the pairs of bodies of the target that can touch in this chunk of steps: their springs limit the time step."""
        time = CHUNK * self.particle.totals.dt  # the longest time of the chunk
        fastest = float(np.sqrt(np.max(np.einsum("ij,ij->i", self.target.nodes.v, self.target.nodes.v))))
        # the particle does not accelerate two surfaces beyond its own speed in a chunk; the factor 1.5 allows for acceleration
        travel = 1.5 * min(max(2.0 * fastest, self.particle.totals.fastest), self._fastest()) * time
        self.bodies.search(travel, by_speed=True, time=time)

    def search_contacts(self, time: float) -> None:
        """Find the pairs of particle and target that can touch within `time` s."""
        travel = 1.5 * self._fastest() * time
        bonded = self.bonds.bond.nodes if self.bonds is not None else ()
        self.contact.search(self.surface.contacts(self.particle.x), self.target.nodes.x, travel, always=bonded)
        self.contact.points.f[:] = 0.0
        if self.folding is not None:
            self.folding.search(self.particle, time)

    def advance(self, steps: int, dt: float) -> None:
        """Make `steps` steps of dt s. Raises SolverError if a domain fails."""
        needed = None  # all points
        if self.particle.ranks.size > 1:
            needed = self.surface.support(self.contact.rows)
            if self.folding is not None:
                needed = np.union1d(needed, self.folding.needed)
        with growing(self.target):
            self.particle.run(steps, dt, self.advance_target, self.exchange_forces, needed)
        self.time += steps * dt
        self.force = self.contact.points.f[self.contact.rows].sum(axis=0)
        self.deepest = max(self.deepest, float(self.contact.depth[self.contact.rows].max(initial=0.0)))

    def advance_target(self) -> None:
        """Advance the target by one step, which needs no data of the particle."""
        self.target.advance(self.particle.dt)
        self.bodies.forces(self.particle.dt)

    def exchange_forces(self) -> None:
        """Compute contact and bonds at n+1, and add their forces to both domains."""
        p, t, s, dt = self.particle, self.target, self.surface, self.particle.dt
        rows, points = self.contact.rows, self.contact.points
        s.moving_contacts(p.x, p.v, rows, points.x, points.v, points.f)
        self.contact.forces(dt, Nodes(t.nodes.x, t.nodes.v, t.f_ext, len(t.nodes.x)))
        if self.bonds is not None:
            self.bonds.forces(points.x, t.nodes.x, points.f, t.f_ext, self.contact)
        s.spread(points.f, rows, p.f_ext)
        if self.folding is not None:
            self.folding.forces(p)
        t.finish()

    def expose(self, touching: Touching) -> None:
        """Update the area of clean metal at the touching vertices after a chunk of steps."""
        if self.exposure is None:
            self.exposure = Exposure.begin(self.domains)
        self.exposure.update(self.domains, touching, self._films[:, 0])

    def bond(self, touching: Touching) -> None:
        """Bond the touching vertices that are under pressure and meet the adhesion criterion. A vertex bonds only once.

        With the criterion "exposure" a vertex bonds when its pressure has fallen below the extrusion pressure: above this pressure
        fresh metal still slides while it welds. If the pressure rises above it again, the bond is removed, and the vertex can bond
        again. Raises SolverError if strength and energy give no admissible bond.
        """
        if self.bonds is not None and self.exposure is not None:
            again = self.exposure.extruding[self.bonds.bond.nodes]
            if again.any():
                self.bonds.bond.drop(again)
                self.bonds = ParticleBonds(self.bonds.bond, self._beside)
        chosen, adhesion = touching.pressed, self.domains.plan.adhesion
        if self.bonds is not None:
            chosen &= ~np.isin(touching.rows, self.bonds.bond.nodes)
        if chosen.any():
            joins = np.array([adhesion.joins(self.domains.own.material, metal) for metal in self._metals])
            chosen &= joins[self.target.law_of[touching.element]]
        if chosen.any():
            chosen &= self._meets_criterion(touching)
        if not chosen.any():
            return
        p, t, s = self.particle, self.target, self.surface
        rows, facets, law_of = touching.rows[chosen], touching.facets[chosen], t.law_of[touching.element[chosen]]
        stiffness = PARTICLE_BOND_STIFFNESS * min(float(p.law["K"][0]), float(t.laws["K"].min())) / p.spacing
        if self.exposure is not None:
            law = self.exposure.bonds(rows, self._films[law_of, 1], touching.strength[chosen], stiffness)
        else:
            law = adhesion.law_on(self.domains.own.material.name, [self._metals[i].name for i in law_of])
        later = Bond.tie(rows, t.mesh.facets[facets], s.contacts(p.x), t.nodes.x, touching.area[rows], stiffness, **law)
        self.bonds = ParticleBonds(later if self.bonds is None else Bond.joined([self.bonds.bond, later]), self._beside)

    def _meets_criterion(self, touching: Touching) -> np.ndarray:
        """Mask (k,) of the touching vertices that meet the adhesion criterion. Of the strains of both sides, the larger counts."""
        rows, area = touching.rows, touching.area[touching.rows]
        if self.exposure is not None:
            sound = (self.exposure.sound[rows] > 0.0) & (area > 0.0) & ~self.exposure.extruding[rows]
            return sound & (touching.strength > 0.0)  # molten metal bonds after it has solidified
        own = self.surface.values(self.particle.points.eps_p)[rows]
        strain = np.maximum(own, self.target.elements.eps_p[touching.element])
        pressure = touching.force[rows] / area
        adhesion, ratio = self.domains.plan.adhesion, self.domains.own.velocity_ratio
        return adhesion.bonded(len(rows), strain, pressure, ratio) & (area > 0.0)

    def check_contact(self) -> None:
        """Raise SolverError if the share of points that lie deeper than one spacing in the target exceeds LOST: the contact no longer
        finds these points."""
        p, t = self.particle, self.target
        depth = depths(p.x, t.nodes.x, t.mesh.conn, least=p.spacing)
        lost = np.count_nonzero(depth)
        if lost > LOST * p.n:
            raise SolverError(
                f"{lost} of {p.n} points of the particle have passed through the target's surface: they lie up to"
                f" {depth.max() / p.spacing:.1f} spacings inside it. Try a finer preset"
            )

    def state(self) -> ImpactState:
        """State of the impact, from which it continues with identical results."""
        return ImpactState(
            self.bodies.state(), self.particle.state(), copied(self.contact),
            copied(self.folding.contact) if self.folding is not None else None, self.ledger,
            copied(self.bonds.bond) if self.bonds is not None else None, self.exposure, copied(self),
        )  # fmt: skip

    def restore(self, state: ImpactState) -> None:
        """Restore a `state` in a new impact of the same plan and bodies. Raises CheckpointError if the state does not fit."""
        self.particle.restore(state.particle)
        self.contact.restore(state.contact)
        if self.folding is not None and state.folding is not None:
            self.folding.contact.restore(state.folding)
        put(state.course, self)
        self.ledger, self.exposure, self.bonds = state.ledger, state.exposure, None
        if self.exposure is not None and len(self.exposure.clean) != self.surface.weights.shape[0]:
            raise unfit("the surface of the particle has another number of vertices")
        if state.bonds is not None:
            check_indices(state.bonds, nodes=len(self.target.nodes.x), points=self.surface.weights.shape[0])
            self.bonds = ParticleBonds(state.bonds, self._beside)
