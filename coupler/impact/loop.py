"""The one time loop of an impact: an SPH particle and an FE target that meet in every step.

LAMMPS owns the loop of single steps and calls back between its forces and its kick; there the target has made the same
step with the same dt (`_begin`), contact is computed once from the positions of both at n+1 (`_meet`), and each domain
leaves with its forces. Every CHUNK steps both agree on dt, pairs that may touch are searched, and the books are kept.
The particle is a `team.Team`: whether it lives in this process or on other ranks makes no difference here.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from ..contact.hold import REACH, STIFFNESS, Hold
from ..errors import SolverError
from ..physics.adhesion import Adhesion
from .heat import HeatPaths, vertex_areas

CHUNK = 10  # steps between two agreements on dt; a stale dt at a Courant factor of 0.9 is known to blow up after more


class Ledger:
    """Energies of both domains in J, of one impact: what the target held before it is not counted.

    Their sum is constant; `drift` is its change over the particle's initial kinetic energy. internal_particle is the work
    done against the particle's internal forces; what of it is neither elastic nor plastic the SPH scheme itself has eaten
    (viscosity, hourglass control, kernel error): numerical_particle. numerical_target is the work of the bulk viscosity. The
    target's elastic and plastic energies are functions of its state, so that drift measures its stress update and the
    contact, not just arithmetic.
    """

    def __init__(self, particle: Any, bodies: Any, contact: Any):
        target = bodies.target
        self.kinetic_0 = particle.kinetic()
        self.momentum_0 = particle.momentum() + target.momentum() - target.external_impulse()
        self.scale = float(np.linalg.norm(particle.momentum()))
        self.before: dict[str, float] = {}
        self.rows: dict[str, float] = {}
        self.before = self._take_stock(particle, bodies, contact)

    def _take_stock(self, particle: Any, bodies: Any, contact: Any, hold: Any = None) -> dict[str, float]:
        r: dict[str, float] = {}
        target = bodies.target
        r["kinetic_particle"], r["kinetic_target"] = particle.kinetic(), target.kinetic()
        r["kinetic"] = r["kinetic_particle"] + r["kinetic_target"]
        r["elastic_particle"], r["elastic_target"] = particle.elastic(), target.elastic()
        r["plastic_particle"], r["plastic_target"] = particle.plastic_work, float(target.sums[0])
        r["numerical_particle"] = particle.internal_work - r["elastic_particle"] - r["plastic_particle"]
        r["numerical_target"] = float(target.sums[1])
        r["contact"], r["friction"] = contact.penalty_energy, contact.friction_heat
        r["boundary"], r["bodies"] = target.absorbed, bodies.energy
        r["bond"] = hold.energy if hold is not None else 0.0
        return r

    def close(self, particle: Any, bodies: Any, contact: Any, hold: Any = None) -> dict[str, float]:
        """Take stock. hold: what holds a particle that has bonded (`contact.hold.Hold`).

        Returns the energies (J), drift (of the initial kinetic energy) and momentum_error (of the initial momentum).
        """
        r, target = self._take_stock(particle, bodies, contact, hold), bodies.target
        total = sum(value - self.before[name] for name, value in r.items() if name in _STORED)
        for name in r:
            if "kinetic" not in name:
                r[name] -= self.before[name]
        r["drift"] = total / self.kinetic_0
        balance = particle.momentum() + target.momentum() - target.external_impulse() - self.momentum_0
        r["momentum_error"] = float(np.linalg.norm(balance) / self.scale)
        self.rows = r
        return r

    def state(self) -> dict[str, Any]:
        return {
            "kinetic_0": self.kinetic_0, "momentum_0": self.momentum_0, "scale": self.scale, "before": self.before,
            "rows": self.rows,
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)


_STORED = (
    "kinetic", "elastic_particle", "elastic_target", "plastic_particle", "plastic_target", "numerical_particle",
    "numerical_target", "contact", "friction", "boundary", "bodies", "bond",
)  # fmt: skip


class Impact:
    """One particle meeting one target, of one body or several (`bodies.Bodies`).

    They touch where the particle's carried surface meets the target's facets.
    """

    def __init__(
        self, particle: Any, bodies: Any, surface: Any, contact: Any, threads: int = 1, paths: HeatPaths | None = None
    ):
        """particle: a `team.Team`. threads: with 2, the target's next step is computed beside LAMMPS's, on a second core; the
        numbers are the same. paths: where heat goes between chunks; only that of friction, to what rubbed, by default.
        """
        self.paths = paths or HeatPaths()
        self.particle, self.bodies, self.surface, self.contact = particle, bodies, surface, contact
        self.target = bodies.target
        self._softness = surface.softness(particle.mass)
        # positions, velocities and forces of all that may touch
        self._x, self._v, self._forces = (np.zeros((surface.touching.shape[0], 3)) for _ in range(3))
        self.surface_nodes = np.unique(contact.facets)
        self.ledger = Ledger(particle, bodies, contact)
        self._pool = ThreadPoolExecutor(1) if threads > 1 else None
        self._ahead: Future[None] | None = None
        self._left = 0  # steps of this chunk still to come
        self.time = 0.0
        self.force = np.zeros(3)  # on the particle, N
        self.deepest = 0.0  # largest penetration so far, m
        self.limits: dict[str, int] = {"particle": 0, "target": 0, "contact": 0}
        self.hold: Hold | None = None  # what has bonded of the particle
        self.dt_factor = 1.0  # on the step agreed on: a rescue lowers it

    def close(self) -> None:
        """Wait for what still runs beside and let the second core go."""
        if self._pool is not None:
            self._pool.shutdown(wait=True)

    def _begin(self) -> None:
        """The target's own step, which needs nothing of the particle."""
        if self._ahead is None:
            self._advance_bodies(self.particle.dt)
        else:
            self._ahead.result()

    def _advance_bodies(self, dt: float) -> None:
        self.target.advance(dt)
        self.bodies.forces(dt)

    def _meet(self) -> None:
        """Contact at n+1, once for both, and the forces to each."""
        p, t, s, dt = self.particle, self.target, self.surface, self.particle.dt
        rows = self.contact.rows
        self._forces[rows] = 0.0
        s.contacts(p.x, rows, self._x)
        s.contacts(p.v, rows, self._v)
        self.contact.forces(dt, self._x, self._v, t.x, t.v, self._forces, t.f_ext)
        if self.hold is not None:
            self.hold.forces(self._x, t.x, self._forces, t.f_ext)
        s.spread(self._forces, rows, p.f_ext)
        t.finish()
        self._left -= 1
        # until LAMMPS calls again it works in C, without Python's lock: room for the target's next step
        self._ahead = self._pool.submit(self._advance_bodies, dt) if self._pool and self._left else None

    def agree_on_dt(self) -> float:
        """The time step (s) both domains and the contact can take, and a note of which asked for it."""
        bounds = {
            "particle": self.particle.stable_dt(),
            "contact": self.contact.stable_dt(self._softness, self.target.mass[self.surface_nodes]),
        }
        if self.hold is not None:
            bounds["contact"] = min(bounds["contact"], self.hold.stable_dt(self._softness, self.target.mass))
        least = min(bounds.values())
        bounds["target"] = self.bodies.stable_dt(least, CHUNK * least)
        who = min(bounds, key=lambda name: bounds[name])
        self.limits[who] += CHUNK
        return self.dt_factor * bounds[who]

    def advance(self, until: float | None = None) -> float:
        """Make a chunk of steps (fewer and smaller where `until`, s, is near). Returns dt, s.

        Raises SolverError where either domain breaks down.
        """
        fastest = self.particle.fastest
        fastest += float(np.sqrt(np.max(np.einsum("ij,ij->i", (v := self.target.v[self.surface_nodes]), v))))
        self.bodies.search(3.0 * fastest * CHUNK * self.particle.stable_dt())  # first: its springs have a say in dt
        dt, steps = self.agree_on_dt(), CHUNK
        if until is not None and self.time + steps * dt > until:
            steps = max(1, int(np.ceil((until - self.time) / dt - 1e-9)))
            dt = (until - self.time) / steps
        self.contact.search(self.surface.contacts(self.particle.x), self.target.x, 1.5 * fastest * steps * dt)
        if self.hold is not None:
            self.contact.rows = np.union1d(self.contact.rows, self.hold.rows)
        self._forces[:] = 0.0
        self._left, self._ahead = steps, None
        self.particle.run(steps, dt, self._begin, self._meet, self.surface.support(self.contact.rows))
        self.time += steps * dt
        self.force = self._forces.sum(axis=0)
        self.deepest = max(self.deepest, float(self.contact.depth.max()))
        self._share_heat(steps * dt)
        return dt

    def state(self) -> dict[str, Any]:
        """What goes on in the next chunk as if nothing had happened: numbers and arrays, nested."""
        return {
            "particle": self.particle.state(), "bodies": self.bodies.state(), "contact": self.contact.state(),
            "ledger": self.ledger.state(), "time": self.time, "force": self.force, "deepest": self.deepest,
            "limits": self.limits, "dt_factor": self.dt_factor,
            "hold": self.hold.state() if self.hold is not None else None,
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """Put a `state` into an impact of the same plan that was just built."""
        for name in ("particle", "bodies", "contact", "ledger"):
            getattr(self, name).restore(state[name])
        for name in ("time", "force", "deepest", "limits", "dt_factor"):
            setattr(self, name, state[name])
        self.hold = Hold.from_state(state["hold"]) if state["hold"] is not None else None

    def bond(self, adhesion: Adhesion, velocity_ratio: float) -> None:
        """Hold the particle where its surface touches now and the criterion is met; of both sides the larger strain counts.

        velocity_ratio: of the impact to the critical velocity. Raises SolverError where strength and energy make no bond.
        """
        p, t, s = self.particle, self.target, self.surface
        rows, facets = self.contact.touching(s.weights.shape[0], REACH * p.spacing)
        if len(rows) == 0:
            return
        strain = np.maximum(s.values(p.eps_p)[rows], t.eps_p[t.mesh.facet_element[facets]])
        stiffness = STIFFNESS * min(float(p.law["K"][0]), float(t.laws["K"].min())) / p.spacing
        area = vertex_areas(s.positions(p.x), s.triangles)[rows]
        pressure = self.contact.stiffness * self.contact.depth[rows] / area
        chosen = adhesion.bonded(len(rows), strain, pressure, velocity_ratio) & (area > 0.0)
        if chosen.any():
            rows, corners = rows[chosen], t.mesh.facets[facets[chosen]]
            self.hold = Hold(rows, corners, s.contacts(p.x), t.x, area[chosen], stiffness, **adhesion.law())

    def _share_heat(self, time: float) -> None:
        """Friction heat becomes temperature, of points and of the elements behind facets; heat flows for `time` s."""
        c, p, t = self.contact, self.particle, self.target
        self.paths.share(time, p, t, self.surface, c)
        if not self.paths.friction:
            return
        if c.heat_point.any():
            p.warm(self.surface.spread_heat(c.heat_point))
            c.heat_point[:] = 0.0
        facets = np.flatnonzero(c.heat_facet)
        if len(facets):
            t.warm(t.mesh.facet_element[c.facet_ids[facets]], c.heat_facet[facets])
            c.heat_facet[facets] = 0.0


class Watch:
    """Says when an impact has come to its greatest deformation and when it is over.

    Greatest deformation: the particle's centre of mass stops sinking, or all but stops where it creeps to its place in a heap
    that gives way. Over: it no longer sinks and the contact force has stayed below 2 % of its peak for `quiet` seconds (the
    particle has left, or rests), or time is up.
    """

    def __init__(self, end_time: float, at: str, quiet: float, slow: float = 0.0):
        """at: "rest", "greatest" (deformation) or "time"; end_time (s) is the latest in any case. slow: m/s, what counts as still."""
        self.end_time, self.at, self.quiet, self.slow = end_time, at, quiet, slow
        self.peak = 0.0
        self.turned: float | None = None
        self._loud = 0.0

    def state(self) -> dict[str, Any]:
        return {"peak": self.peak, "turned": self.turned, "_loud": self._loud}

    def restore(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)

    def look(self, time: float, sinking: float, force: float) -> bool:
        """sinking: downward speed of the centre of mass (m/s), force: on the particle, upwards (N). Returns True when it is over."""
        self.peak = max(self.peak, force)
        if self.turned is None and self.peak > 0.0 and sinking <= self.slow:
            self.turned = time
        if abs(force) > 0.02 * self.peak:
            self._loud = time
        settled = self.turned is not None and self.peak > 0 and time - self._loud > self.quiet
        over = {"rest": settled, "greatest": self.turned is not None, "time": False}[self.at]
        return over or time >= self.end_time * (1 - 1e-12)


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
