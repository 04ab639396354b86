"""Output of an impact while it runs: rows of the history, fields in time, and limits of models that it exceeds."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from ..core.records import Shape
from ..core.threads import share
from ..errors import SolverError
from ..files.store import Store
from ..geometry.extent import UP, extent
from ..physics.constitutive import is_metal, von_mises
from ..plan.cost import CHUNK
from ..plan.planning import Plan
from ..progress import Progress
from ..target.bodies import Bodies
from .domains import metals_of
from .exchange import Impact
from .ledger import DRIFT_ALARM
from .measure import crater_depth, measure, tension
from .validity import Extremes

FITTED = 16  # nodes that `crater_depth` fits
ROWS = 50  # rows of the history in a time of D / v, and at least one row per two chunks of steps
LEAST_VERTICES = 500  # in a range of a shared loop
VTK_ORDER = [0, 1, 2, 5, 3, 4]  # order of tensor components in ParaView: xx yy zz xy yz xz


@dataclass
class Recorded:
    """State of a `Recorder`. next_row, next_output (s): times of the next outputs; greatest: measures at the greatest deformation,
    None before it; over_rim: the particle has reached beyond the rim of the substrate and below its surface; at_rim: it has touched
    the rim of the target's window; met (k,) m: heights of the target's surface nodes before the impact; touched_at (m): height of the
    particle's centre at its last contact, or at the start before the first contact. Of ceramics: tension (Pa): greatest
    tensile principal stress of the particle's ceramic; base_tension: that of the target divided by its tensile limit; broken_share:
    greatest share of the ceramic's points above its tensile limit at one time."""

    next_row: float = 0.0
    next_output: float = 0.0
    greatest: dict[str, float] | None = None
    extremes: Extremes = field(default_factory=Extremes)
    over_rim: bool = False
    at_rim: bool = False
    met: Annotated[np.ndarray, Shape(-1)] = field(default_factory=lambda: np.zeros(0))
    touched_at: float = 0.0
    tension: float = 0.0
    base_tension: float = 0.0
    broken_share: float = 0.0


def cell_fields(plan: Plan, bodies: Bodies) -> dict[str, np.ndarray]:
    """Output fields of all tetrahedra. body: 0 for the substrate, then the splats in the order in which they joined; impact: number
    of the impact that made each body, 0 for the substrate; core: 1 in cores of composite particles, if the plan has such."""
    t, stress = bodies.target, bodies.target.stress()
    own = {"stress": stress[:, VTK_ORDER], "von_mises": von_mises(stress), "eps_p": t.elements.plastic_strain}
    if plan.has_cores:
        both = zip(metals_of(plan, bodies), bodies.impact.tolist(), strict=True)
        cores = [float(i > 0 and metal is not plan.impacts[i - 1].material) for metal, i in both]
        own["core"] = np.array(cores)[bodies.body]
    return {**own, "T": t.elements.T, "body": bodies.body, "impact": bodies.impact[bodies.body].astype(np.int32)}


def joint_fields(bodies: Bodies, are_cohesive: bool) -> dict[str, np.ndarray]:
    """Output fields of the joints between bodies at rest. bonded: remaining share of the strength of a node's bond, 0 without a bond;
    touching: 1 if a contact presses the node on another body. are_cohesive: whether bonds can break; the fields then include
    bond_strength (Pa) and bond_energy (J/m2), each in tension and shear, before damage; zero for a tied bond."""
    n = len(bodies.target.nodes.x)
    bonded, touching, strength, energy = np.zeros(n), np.zeros(n), np.zeros((n, 2)), np.zeros((n, 2))
    if (bond := bodies.bond) is not None:
        whole = ~bond.broken
        nodes = bond.nodes[whole]
        bonded[nodes] = 1.0 - bond.damage[whole]
        strength[nodes], energy[nodes] = bond.strength[whole], bond.energy[whole]
    if (contact := bodies.contact) is not None:
        nodes = contact.pairs.points.node
        touching[nodes[contact.pairs.touching(len(nodes))[0]]] = 1.0
    breaks = np.isfinite(strength)  # layers and cores are tied, beside bonds that break
    law = {"bond_strength": np.where(breaks, strength, 0.0), "bond_energy": np.where(breaks, energy, 0.0)}
    return {"bonded": bonded, "touching": touching, **(law if are_cohesive else {})}


class Recorder:
    """Writes one impact to the files of its run. before: simulated time (s) of the earlier impacts."""

    def __init__(self, plan: Plan, i: int, store: Store, progress: Progress, before: float):
        self.plan, self.i, self.impact_plan = plan, i, plan.impacts[i]
        self.store, self.progress, self.before = store, progress, before
        self.seen = Recorded()
        self._row_every = self.impact_plan.diameter / float(np.linalg.norm(self.impact_plan.velocity)) / ROWS
        self._written = -1.0  # s: time of the last fields

    def start(self, impact: Impact) -> None:
        """Write the fields at the start of the impact, if restored files do not contain them yet. If only the end of each impact is
        written, only the first impact has fields at its start."""
        if self.seen.next_output == 0.0:
            self.seen.met = impact.target.nodes.x[impact.surface_nodes, 2]
            self.seen.touched_at = float(impact.particle.x[:, 2].mean())
            if self.i == 0 or np.isfinite(self.impact_plan.output_every):
                self.write_fields(impact)
            self.seen.next_output = self.impact_plan.output_every

    def record(self, impact: Impact, dt: float, is_last: bool) -> None:
        """Write the outputs that are due after a chunk of steps of dt s. After the last chunk write all outputs.

        Raises SolverError when the ledger is far from closed, StoreError when a file cannot be written.
        """
        if impact.force.any() or not impact.deepest > 0.0:
            self.seen.touched_at = float(impact.particle.x[:, 2].mean())
        if is_last or impact.time >= self.seen.next_row:
            self.write_row(impact, dt)
        if impact.time > self._written and (is_last or impact.time >= self.seen.next_output):
            self.write_fields(impact)

    def record_greatest(self, impact: Impact) -> None:
        """Store the measures at the greatest deformation. Write also its fields, unless only the end of each impact is written."""
        self.seen.greatest = self.measures(impact)
        if np.isfinite(self.seen.next_output):
            self.write_fields(impact)

    def write_row(self, impact: Impact, dt: float) -> None:
        """Write one row of history.csv, and update the extreme values of the impact."""
        particle = impact.particle
        ledger = impact.ledger.update(impact.domains, impact.bonds)
        skin = impact.surface.positions(particle.x)
        bottom, top = extent(skin, impact.surface.triangles, UP)
        self.store.record({
            "time": self.before + impact.time, "impact": float(self.i + 1), "dt": dt, "step": float(particle.steps), **ledger,
            "height": top - self._flight(impact), "thickness": top - bottom, "crater_depth": self._crater(impact),
            "velocity_z": float(particle.totals.momentum[2] / particle.mass.sum()),
            "contact_force": float(impact.force[2]), "T_max": float(particle.points.T.max()),
            "eps_p_mean": float(particle.points.eps_p.mean()), "stretch_min": particle.totals.stretch_min,
        })  # fmt: skip
        self._notice(impact, skin)
        self.seen.next_row = impact.time + min(self._row_every, 1.5 * CHUNK * dt)
        if not np.isfinite(ledger["drift"]):
            raise SolverError(
                f"the energy is not a finite number at t = {impact.time * 1e9:.3f} ns: try a finer preset"
            )
        impact.ledger.check(DRIFT_ALARM)
        self.progress.update(impact.time, ledger["kinetic"] / impact.ledger.kinetic_0, dt, particle.steps)

    def is_above(self, impact: Impact) -> bool:
        """Whether the centre of the particle is above the top face of the target, not beyond its rim."""
        return bool(np.hypot(*(along.mean() for along in impact.particle.x[:, :2].T)) < 0.5 * self.plan.target.diameter)

    def _notice(self, impact: Impact, skin: np.ndarray) -> None:
        """Record the extreme values that the validity check needs, and whether the particle reaches an edge of the target. skin (k,3)
        m: surface of the particle."""
        target, substrate = impact.target, self.plan.target
        self.seen.extremes.note(impact.particle, target, impact.bodies.impact == 0)
        if (index := self.impact_plan.brittle) is not None:
            limit = self.impact_plan.materials[index].tensile_limit
            at_points = tension(impact.particle.stress()[impact.particle.law_of == index])
            self.seen.tension = max(self.seen.tension, float(at_points.max()))
            self.seen.broken_share = max(self.seen.broken_share, float(np.mean(at_points > limit)))
        for ceramic in substrate.ceramics:
            stress = target.stress()[is_metal(target.laws, ceramic)[target.law_of]]
            ratio = float(tension(stress).max(initial=0.0)) / (ceramic.tensile_limit or np.inf)
            self.seen.base_tension = max(self.seen.base_tension, ratio)
        beside = np.hypot(*skin[:, :2].T) > 0.5 * substrate.diameter
        self.seen.over_rim |= bool(np.any(beside & (skin[:, 2] < 0.0)))
        facets = impact.contact.touching(len(skin))[1]
        self.seen.at_rim |= bool(np.any(target.mesh.reach_node[target.mesh.facets[facets]] > target.undisturbed))

    def write_fields(self, impact: Impact) -> None:
        """Write one time step of particle.vtkhdf, surface.vtkhdf and target.vtkhdf."""
        # slightly later than the last step of the impact before: viewers need different times
        time = self.before + max(impact.time, 1e-15 if self.i else 0.0)
        p, s, t = impact.particle, impact.surface, impact.target
        stress = p.stress()
        fields = {
            "velocity": p.v, "stress": stress[:, VTK_ORDER], "von_mises": von_mises(stress), "eps_p": p.points.eps_p,
            "eps_p_rate": p.points.rate, "T": p.points.T,
        }  # fmt: skip
        if self.plan.has_cores:
            fields["core"] = p.law_of.astype(float)
        self.store.write("particle", time, p.x, np.arange(p.n)[:, None], fields)
        skin = {name: s.values(field) for name, field in fields.items()}
        vertices = s.positions(p.x)
        tree = cKDTree(p.x, balanced_tree=False, compact_nodes=False)  # faster to build
        skin["from_points"] = away = np.empty(len(vertices))

        def measure_distance(lo: int, hi: int) -> None:
            away[lo:hi] = tree.query(vertices[lo:hi])[0]

        share(measure_distance, len(vertices), LEAST_VERTICES)
        self.store.write("surface", time, vertices, s.triangles, skin)
        self.store.write(
            "target", time, t.nodes.x, t.mesh.conn, {"velocity": t.velocity()}, cell_fields(self.plan, impact.bodies)
        )
        self._written, self.seen.next_output = impact.time, impact.time + self.impact_plan.output_every

    def measures(self, impact: Impact) -> dict[str, float]:
        """Present measures of the impact, SI units."""
        level = impact.domains.level + self._flight(impact)
        return {"time_s": impact.time, **measure(impact.domains, level), "crater_depth_m": self._crater(impact)}

    def _flight(self, impact: Impact) -> float:
        """Height (m) by which the particle has risen since its last contact. `measures` adds it to the zero of heights."""
        return max(0.0, float(impact.particle.x[:, 2].mean()) - self.seen.touched_at)

    def _crater(self, impact: Impact) -> float:
        """Depth (m) of the crater of this impact: downward displacement of the target's surface since the impact started.

        `crater_depth` fits the nodes of the substrate. On splats, whose nodes are sparse, it fits the nodes in the lower half of
        the crater; if these are fewer than FITTED, the lowest node counts.
        """
        x = impact.target.nodes.x[impact.surface_nodes]
        lowered = self.seen.met - x[:, 2]
        on_splats = bool(impact.bodies.impact.any())
        inner = lowered > (0.5 * lowered.max(initial=0.0) if on_splats else -np.inf)
        if on_splats and inner.sum() < FITTED:
            return float(lowered.max(initial=0.0))
        return crater_depth(np.column_stack([x[inner, :2], -lowered[inner]]))
