"""The explicit finite-element target: central differences on tetrahedra with averaged nodal pressure.

The step is that of LAMMPS (half of the velocity update, positions, forces, other half), divided at n+1 for the contact of both domains:

    target.advance(dt)          v at n+1/2, x at n+1, stress and internal forces at n+1
    target.f_ext[...] += ...    contact forces at n+1
    target.finish()             boundary forces, work of all forces over the step
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ..core import safety
from ..core.arrays import Links, occurring
from ..core.loops import PARTS
from ..core.records import Shape, check_indices, copied, new_rows, put, unfit
from ..core.threads import share, together
from ..errors import SolverError
from ..physics import motion
from ..physics.constitutive import FLOW, LAW, PRESSURE, sound_speed, specialised, yield_stresses
from . import kernels as k
from .boundary import HALF_SPACE, dashpots, foundation, nodes_of
from .heat import Conduction, ConductionState, add_heat
from .inertia import ElementInertia, InertiaState, step_for
from .mesh import TetMesh, cells_of
from .model import Active, Elements, Metals, Nodes, Viscosity
from .stability import FrequencyState, HighestFrequency
from .state import Balance, EdgeState, ElementState, NodeState
from .window import UNDISTURBED, Edge, outside

LINEAR_VISCOSITY = 0.06
QUADRATIC_VISCOSITY = 1.2
AHEAD = 1.5  # speed of the front of active elements divided by the speed of sound
LEAST_ELEMENTS = 1000  # in a range of a shared loop


@dataclass(eq=False)
class TargetState:
    """State from which a target continues with unchanged results. The mesh is not part of the state.

    force_suffix_sum (n+1,3) N: row i is the sum of the internal forces of all nodes from i on, at the last `deactivate_beyond`; drag
    (d,3) N: forces of the dashpots; support (3,) N: force of supports and absorbing sides; dt_last (s); reach (m): distance of the
    front of active elements; horizon (m): radius of the window; least_mass (kg): see `weigh_surface`; active_nodes, active_elements:
    numbers of computed nodes and elements; edge: elastic edge of the window; rest_scale: present / initial size of the half-space.
    """

    nodes: NodeState
    elements: ElementState
    force_suffix_sum: Annotated[np.ndarray, Shape(-1, 3)]
    drag: Annotated[np.ndarray, Shape(-1, 3)]
    inertia: InertiaState
    conduction: ConductionState | None = None
    highest: FrequencyState | None = None
    edge: EdgeState | None = None
    support: Annotated[np.ndarray, Shape(3)] = field(default_factory=lambda: np.zeros(3))
    balance: Balance = field(default_factory=Balance)
    dt_last: float = 0.0
    reach: float = np.inf
    horizon: float = np.inf
    least_mass: float = 0.0
    rest_scale: float = 1.0
    active_nodes: int = 0
    active_elements: int = 0


class Target(TargetState):
    """State and motion of one finite-element domain. SI units.

    nodes, elements: state (`fe.state`); kernels change its arrays in place. f_ext (n,3) N: external forces. Nodes and elements are
    numbered outwards from the nearest point of impact. Only the first `active_nodes` and `active_elements`, those that a wave can
    have reached, are computed, and none beyond the `horizon` (m, see `set_window`) or the `limit` (m, see `activate_all`). inertia:
    inertia of scaled elements (`fe.inertia`). balance: sums of energies.

    Heat from plastic work, `warm` or conduction adds to the energy of the nodes and so, by Gamma0, to their pressure: with
    Mie-Grueneisen a free body expands in volume by beta dT, beta = Gamma0 rho cp / K. There is no expansion with a linear equation
    of state (Gamma0 = 0) or with laws without `expansion`. Bodies of different materials share no nodes: a nodal pressure belongs
    to one material.
    """

    conduction: Conduction | None
    highest: HighestFrequency | None
    edge: Edge | None
    inertia: ElementInertia

    def __init__(
        self, mesh: TetMesh, laws: np.ndarray, temperature: float | np.ndarray, law_of: np.ndarray | None = None,
        fixed: tuple[str, ...] = ("bottom",), absorbing: tuple[str, ...] = (), track_wave: bool = True, conduction: bool = False,
    ):  # fmt: skip
        """laws: LAW records, one per material; law_of (m,): law of each element (default: the first); temperature: K, one value or
        (m,); fixed, absorbing: names of facet sets (top, bottom, sides); track_wave: compute only elements that a wave can have
        reached; conduction: heat flows between elements (`fe.heat`). Raises SolverError if elements of different laws share a
        node."""
        n, m = len(mesh.points), len(mesh.conn)
        self.mesh, self.laws = mesh, np.ascontiguousarray(laws, LAW)
        self.law_of = np.zeros(m, np.int32) if law_of is None else np.ascontiguousarray(law_of, np.int32)
        of_node = np.zeros(n, np.int32)
        of_node[mesh.conn.ravel()] = np.repeat(self.law_of, 4)
        if np.any(of_node[mesh.conn] != self.law_of[:, None]):
            raise SolverError("elements of different materials share nodes of the target: join meshes of one body each")
        self.cells, self.metals = cells_of(mesh), Metals(self.laws, self.law_of, of_node)
        self._of_pressure = self.metals._replace(laws=specialised(self.laws, PRESSURE))
        self._of_flow = self.metals._replace(laws=specialised(self.laws, FLOW))
        T = np.broadcast_to(np.asarray(temperature, np.float64), (m,)).copy()
        sigma_y = yield_stresses(self.laws, self.law_of, np.zeros(m), T, np.zeros((m, 3)))
        self.fixed = nodes_of(mesh, fixed)
        self.dashpot_nodes, self.dashpot = dashpots(
            mesh, self.laws, self.law_of, (*absorbing, *({HALF_SPACE} & mesh.sets.keys())), self.fixed
        )
        self.spring_nodes, self.springs = foundation(mesh, self.laws["G"][self.law_of])
        super().__init__(
            new_rows(NodeState, n, x=mesh.points.copy()),
            new_rows(ElementState, m, volume=mesh.V0.copy(), T=T, sigma_y=sigma_y),
            np.zeros((n + 1, 3)), np.zeros((len(self.dashpot_nodes), 3)), ElementInertia(), Conduction(n, m) if conduction else None,
        )  # fmt: skip
        self.f_ext, self.dt_of, self.limit = np.zeros((n, 3)), np.zeros(m), np.inf
        self._bound(m)
        self._weigh()
        speeds = [sound_speed(float(law["rho"]), float(law["K"]), float(law["G"])) for law in self.laws]
        self.wave_speed = AHEAD * max(speeds)  # shocks run ahead of sound
        edge = 2.0 * float(np.max(mesh.V0[: max(1, m // 20)])) ** (1.0 / 3.0)
        if track_wave:
            self.reach = 16.0 * edge  # numerical waves run a little ahead of physical ones
        #: (m+1,): entry i is the number of nodes up to the last node of the first i elements
        self._nodes_of = np.append(0, np.maximum.accumulate(mesh.conn.max(axis=1) + 1))
        self._activate(0.0)

    @property
    def time(self) -> float:
        """Time since the start of the target, s."""
        return self.balance.time

    @property
    def spring_rest(self) -> np.ndarray:
        """Positions (k,3) m of the nodes `spring_nodes` at which the springs of the half-space have no force."""
        return self.rest_scale * self.mesh.points[self.spring_nodes]

    def foundation_load(self) -> np.ndarray:
        """Largest sum of absolute values in a row of each node's half-space stiffness, (n,) N/m, for the bound on omega^2."""
        load = np.zeros(len(self.nodes.x))
        load[self.spring_nodes] = np.abs(self.springs).sum(axis=2).max(axis=1, initial=0.0)
        return load

    def _weigh(self) -> None:
        """Set the masses (n,) kg of the nodes and their inverses, which are 0 for fixed nodes."""
        self.mass = self.mesh.node_volume * self.laws["rho"][self.metals.of_node]
        if self.least_mass > 0.0:
            surface = occurring(self.mesh.facets, len(self.mass))
            self.mass[surface] = np.maximum(self.mass[surface], self.least_mass)
        self.inv_mass = 1.0 / self.mass
        self.inv_mass[self.fixed] = 0.0

    def weigh_surface(self, least: float, most: float) -> float:
        """Increase the masses of surface nodes to at least `least` kg until the next `rest`, by at most `most` kg in total, the
        lightest nodes first. The target must be at rest: energy and momentum do not change. Returns the added mass, kg."""
        self.least_mass = 0.0
        self._weigh()
        surface, before = self.mass[occurring(self.mesh.facets, len(self.mass))], float(self.mass.sum())
        # with steps equal to the roots of the masses, `step_for` returns the root of the least mass that `most` allows
        self.least_mass = min(least, step_for(surface, np.sqrt(surface), most, np.inf) ** 2)
        self._weigh()
        return float(self.mass.sum()) - before

    def set_window(self, radius: float, origin: np.ndarray | None = None, rest: np.ndarray | None = None) -> int:
        """Exclude all elements farther than `radius` m from the point of impact (`fe.window`). The excluded elements must be at rest
        and in equilibrium. The window cannot be removed. Returns the number of elements inside.

        origin (3,) m: point of impact, for an elastic edge; None: the edge is fixed. rest (k,3) m: rest positions of the elastic
        edge, by default the present ones.
        """
        self.horizon = radius
        n, m = self._active_counts(np.inf)
        if m == len(self.mesh.conn):
            return m
        beyond = outside(self.mesh, m, n)
        if origin is not None:
            among = np.setdiff1d(beyond, np.union1d(self.fixed, self.spring_nodes))
            self.edge = Edge(self, m, among, origin, rest)
            beyond, matrix = np.setdiff1d(beyond, self.edge.nodes), np.zeros((len(self.mass), 3, 3))
            matrix[self.dashpot_nodes] = self.dashpot
            matrix[self.edge.nodes] += self.edge.damping
            self.dashpot_nodes = np.union1d(self.dashpot_nodes, self.edge.nodes)
            self.dashpot, self.drag = matrix[self.dashpot_nodes], np.zeros((len(self.dashpot_nodes), 3))
        self.fixed = np.union1d(self.fixed, beyond)
        self.inv_mass[self.fixed] = 0.0
        self.deactivate_beyond(self.reach)
        return m

    @property
    def undisturbed(self) -> float:
        """Distance from the point of impact, m, up to which the window does not affect the target."""
        return UNDISTURBED * self.horizon

    def _active_counts(self, reach: float) -> tuple[int, int]:
        """Numbers of active nodes and elements with the front at `reach` m from the point of impact."""
        elements = int(self.mesh.reach_element.searchsorted(min(reach, self.horizon, self.limit)))
        return max(self.active_nodes, int(self._nodes_of[elements])), elements

    def active_after(self, time: float) -> int:
        """Number of active nodes after another `time` s: those that the wave front has reached. time = np.inf: all in the window."""
        return self._active_counts(self.reach + self.wave_speed * time)[0]

    def _activate(self, dt: float) -> None:
        """Advance the front, which runs ahead of the waves, for dt s, and activate the elements that it reaches."""
        self.reach += self.wave_speed * dt
        m, distance = self.active_elements, self.mesh.reach_element
        if m < len(distance) and distance[m] < min(self.reach, self.horizon, self.limit):
            self.active_nodes, self.active_elements = self._active_counts(self.reach)

    def _bound(self, m: int) -> None:
        """Write the safe bound of the stable step of each of the first m elements to `dt_of` (m,) s."""
        x, J = self.nodes.x, self.nodes.J
        share(lambda lo, hi: k.stable_dt(lo, hi, x, J, self.cells, self.metals, self.dt_of), m, LEAST_ELEMENTS)

    def stable_dt(
        self, enough: float = 0.0, ahead: float = 0.0, springs: Links | None = None, alone: float | None = None
    ) -> float:  # fmt: skip
        """Largest stable time step, s, with safety factors and damping.

        enough (s): if the safe bound of the elements is shorter than this, the sharper limit of the whole mesh is computed
        (`fe.stability`); ahead (s): time for which the step is kept: elements that become active in this time count too; springs:
        between nodes; alone (s): step of the bodies that is enough together with other springs, default `enough`.
        """
        n, e = self._active_counts(self.reach + self.wave_speed * ahead)
        e = max(e, 1)
        self._bound(e)
        if self.inertia.most > 0.0:
            self.inertia.choose(self, self.dt_of[:e], enough)
        bound = float(self.dt_of[:e].min())
        if springs is not None:
            load = springs.load(len(self.nodes.x))[:n]
            bound = 1.0 / np.sqrt(1.0 / bound**2 + 0.25 * float(np.max(load / self.mass[:n])))
        dt, needed = safety.ELEMENTS * bound, (enough if alone is None else alone) * (1.0 + LINEAR_VISCOSITY)
        if dt < enough * (1.0 + LINEAR_VISCOSITY):
            if self.highest is None:
                self.highest = HighestFrequency(len(self.nodes.x), len(self.mesh.conn))
            dt = max(dt, self.highest.longest_step(self, bound, n, e, springs, self.inertia, enough=needed))
        return dt / (1.0 + LINEAR_VISCOSITY)

    def advance(self, dt: float, is_conducting: bool = True) -> None:
        """Move to n+1 and compute stress and internal forces there; velocities are at n+1/2. dt (s); is_conducting: heat flows
        between elements. Raises SolverError when a tetrahedron inverts."""
        half_step, kicked = 0.5 * (self.dt_last + dt), self.active_nodes
        self.balance.impulse += half_step * self.support
        self._activate(dt)
        self.move(kicked, half_step, dt, self.inv_mass, (LINEAR_VISCOSITY, QUADRATIC_VISCOSITY))
        if is_conducting and self.conduction is not None:
            self.conduction.advance(dt, self)
        self.dt_last = dt
        self.balance.time += dt

    def move(
        self, kicked: int, kick: float, dt: float, inv_mass: np.ndarray, viscosity: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Accelerate the first `kicked` nodes for `kick` s by all forces on them, move the active nodes for dt s, and compute
        stress and internal forces there. inv_mass (n,) 1/kg; viscosity: coefficients of the linear and the quadratic bulk
        viscosity.

        Raises SolverError when a tetrahedron inverts.
        """
        sums, active = np.zeros((PARTS, 4)), Active(kicked, self.active_nodes, self.active_elements)
        together(
            k.advance, active, kick, dt, Viscosity(*viscosity, self.dt_of), self.cells, self._of_pressure, self._of_flow,
            Nodes.of(self.nodes, self.f_ext, inv_mass), Elements.of(self.elements), sums,
        )  # fmt: skip
        flipped, plastic, viscous, heat = sums.sum(axis=0).tolist()
        if flipped:
            raise SolverError(_inverted(self))
        self.balance.plastic += plastic
        self.balance.numerical += viscous
        self.balance.heat += heat

    def finish(self) -> None:
        """Complete the step after the contact forces have been added to `f_ext`: add boundary forces, and update work and
        impulses."""
        self.add_up(self.dt_last)
        if len(self.dashpot_nodes):
            power = motion.add_drag(self.dashpot_nodes, self.dashpot, self.nodes.v, self.drag, self.nodes.total)
            self.balance.absorbed -= 0.5 * self.dt_last * power
            self.support += motion.sum_over(0, len(self.drag), self.drag)
        self.pull()
        if len(self.fixed):
            self.support -= motion.sum_at(self.fixed, self.nodes.total)
        if self.inertia.most > 0.0:
            lost, reduction = self.inertia.advance(self, self.nodes.total, self.active_nodes, self.dt_last)
            self.balance.numerical += lost
            self.support -= reduction

    def add_up(self, dt: float) -> None:
        """Write the sums of internal and external forces of the active nodes to `nodes.total`, subtract the work of the internal forces
        in a step of dt s from `balance.internal_work`, and set `support` to the force of the inactive part."""
        n = self.active_nodes
        work, nodes = np.zeros(PARTS), self.nodes
        together(motion.add_up, n, dt, nodes.f_old, nodes.f, nodes.v, self.f_ext, nodes.total, work)
        self.balance.internal_work -= float(work.sum())
        # the inactive part supports the active part: forces of its elements on shared nodes, external forces on its own nodes
        self.support = -self.force_suffix_sum[n] - motion.sum_over(n, len(self.nodes.x), self.f_ext)

    def pull(self) -> None:
        """Add the forces of the springs at the window's edge and of the half-space to the total forces and to `support`."""
        if self.edge is not None:
            pull = self.edge.pull(self.nodes.x)
            self.nodes.total[self.edge.nodes] += pull
            self.support += pull.sum(axis=0)
        if len(self.spring_nodes):
            active = self.spring_nodes < self.active_nodes  # inactive nodes are in balance with their springs
            nodes = self.spring_nodes[active]
            pull = -np.einsum("aij,aj->ai", self.springs[active], self.nodes.x[nodes] - self.spring_rest[active])
            self.nodes.total[nodes] += pull
            self.support += pull.sum(axis=0)

    def external_impulse(self) -> np.ndarray:
        """Impulse (3,) N s of supports and absorbing sides on the target since its start."""
        return self.balance.impulse + 0.5 * self.dt_last * self.support

    def restore(self, state: TargetState) -> None:
        """Restore a state that `core.records.copied` has made of a target with the same mesh. Raises CheckpointError if the state does
        not fit this target."""
        n, m = len(self.nodes.x), len(self.mesh.conn)
        if not (0 <= state.active_nodes <= n and 0 <= state.active_elements <= m):
            raise unfit("the target has another number of nodes or elements")
        self.least_mass = state.least_mass
        self._weigh()
        if state.horizon != self.horizon:
            self.set_window(state.horizon, *((state.edge.origin, state.edge.rest) if state.edge is not None else ()))
        if len(state.drag) != len(self.drag):
            raise unfit("the target has another number of absorbing nodes")
        check_indices(state.inertia, nodes=n)
        if len(state.inertia.taken) != len(state.inertia.last):
            raise unfit("the forces of the scaled elements do not fit their nodes")
        if (self.conduction is None) != (state.conduction is None):
            raise unfit("only one of the target and the checkpoint conducts heat")
        if state.highest is not None:
            self.highest = HighestFrequency(n, m)
        put(state, self)
        if self.edge is not None:
            self.edge.load(self, self._active_counts(np.inf)[1])

    def start_from(self, nodes: NodeState, elements: ElementState, before: "Target") -> None:
        """Start from a state of nodes and elements (`target.domain`). The energy balance continues from that of `before`."""
        self.nodes, self.elements = nodes, elements
        self.balance, self.rest_scale = copied(before.balance), before.rest_scale
        self._store_inactive_forces()

    def rest(self) -> None:
        """Set all velocities to zero, by an external impulse. Removes the added masses of `weigh_surface` and `inertia`."""
        # an external impulse stops the target
        self.balance.impulse = self.external_impulse() - self.mass @ self.nodes.v
        self.nodes.v[:], self.nodes.total[:], self.support, self.drag[:] = 0.0, 0.0, np.zeros(3), 0.0
        self.inertia = ElementInertia()
        if self.least_mass > 0.0:
            self.least_mass = 0.0
            self._weigh()

    def activate_all(self, limit: float = np.inf) -> None:
        """Activate all nodes and elements within `limit` m of the point of impact. The others stay inactive until
        `deactivate_beyond`."""
        self.reach, self.limit, self.active_nodes, self.active_elements = np.inf, limit, 0, 0
        self._activate(0.0)

    def deactivate_beyond(self, reach: float) -> None:
        """Deactivate all nodes and elements farther than `reach` m from the point of impact; they must be in equilibrium, at rest."""
        self._store_inactive_forces()
        self.reach, self.limit, self.active_nodes, self.active_elements = reach, np.inf, 0, 0
        self._activate(0.0)

    def _store_inactive_forces(self) -> None:
        forces = np.zeros_like(self.force_suffix_sum)
        k.gather_forces(0, len(self.nodes.x), self.cells, self.elements.fe, forces)
        self.force_suffix_sum = np.cumsum(forces[::-1], axis=0)[::-1]

    def velocity(self) -> np.ndarray:
        """Velocities (n,3) m/s at the time of the positions."""
        n, v = self.nodes, np.empty_like(self.nodes.v)

        def fill(lo: int, hi: int) -> None:
            v[lo:hi] = n.v[lo:hi] + (0.5 * self.dt_last) * n.total[lo:hi] * self.inv_mass[lo:hi, None]

        share(fill, len(v), LEAST_ELEMENTS)
        return v

    def kinetic(self) -> float:
        """Kinetic energy in J: sum of m v(n-1/2).v(n+1/2) / 2, whose change in central differences is the work of the forces."""
        next_v = self.nodes.v + self.dt_last * self.nodes.total * self.inv_mass[:, None]
        return 0.5 * float(self.mass @ np.einsum("ai,ai->a", self.nodes.v, next_v))

    def momentum(self) -> np.ndarray:
        """Linear momentum (3,) in kg m/s."""
        return self.mass @ self.velocity()

    def elastic(self) -> float:
        """Recoverable energy in J: of the stress deviators, of the volume change without the part due to heat, and of the springs
        of the half-space and of the window's edge."""
        m, e = len(self.mesh.conn), self.elements  # inactive elements may be under stress
        shear = k.elastic_shear_energy(0, m, self.mesh.V0, self.metals, e.volume, e.s)
        u = self.nodes.x[self.spring_nodes] - self.spring_rest
        shear += 0.5 * float(np.einsum("ai,aij,aj->", u, self.springs, u))
        if self.edge is not None:
            shear += self.edge.energy(self.nodes.x)
        pending = float(np.sum(self.elements.heat))  # the nodes receive it in the next step
        return shear + float(self.mesh.node_volume @ self.nodes.energy) - (float(self.balance.heat) - pending)

    def warm(self, elements: np.ndarray, heat: np.ndarray) -> None:
        """Add heat (k,) J to elements (k,), repeats allowed. The elements become active.

        Their temperature rises at once, the pressure of their nodes in the next step.
        """
        if len(elements) == 0:
            return
        reached = float(self.mesh.reach_element[np.max(elements)])
        if reached >= self.reach:
            self.reach = float(np.nextafter(reached, np.inf))
            self._activate(0.0)
        gain = np.asarray(np.bincount(elements, heat, len(self.elements.T)), float)
        self.balance.heat += add_heat(
            0, self.active_elements, gain, self.cells, self.metals, Elements.of(self.elements)
        )

    def warm_around(self, nodes: np.ndarray, heat: np.ndarray) -> None:
        """Add heat (J, of the shape of `nodes`) to the elements around each node, in equal parts."""
        conn = self.mesh.conn
        around = np.bincount(conn.ravel(), minlength=len(self.nodes.x))
        of_node = np.bincount(nodes.ravel(), heat.ravel(), len(self.nodes.x)) / np.maximum(around, 1)
        of_element = of_node[conn].sum(axis=1)
        elements = np.flatnonzero(of_element)
        self.warm(elements, of_element[elements])

    def stress(self) -> np.ndarray:
        """Cauchy stress (m,6) Pa, Voigt xx yy zz yz xz xy: deviator less mean nodal pressure."""
        sigma = np.empty_like(self.elements.s)

        def fill(lo: int, hi: int) -> None:
            sigma[lo:hi] = self.elements.s[lo:hi]
            sigma[lo:hi, :3] -= self.nodes.p[self.mesh.conn[lo:hi]].mean(axis=1)[:, None]

        share(fill, len(sigma), LEAST_ELEMENTS)
        return sigma


def _inverted(t: Target) -> str:
    """Error message about the element of a target with the most negative volume."""
    e = int(np.argmin(t.elements.volume[: t.active_elements]))
    x, y, z = t.nodes.x[t.mesh.conn[e]].mean(axis=0) * 1e6
    remedy = "a finer preset, or a larger resolution.element_size"
    at = f"t = {t.balance.time * 1e9:.3f} ns near ({x:.2f}, {y:.2f}, {z:.2f}) um"
    return f"element {e} of the target inverted at {at}: try {remedy}"
