"""Heat conduction in the explicit target: Fourier's law on its tetrahedra, explicit in time.

The target keeps temperatures in elements, where plastic work heats them; conduction needs nodes. Nodes have temperatures
of their own, which conduct like linear tetrahedra with lumped capacities in the current configuration. What heats an
element raises its nodes by the mean, weighted with heat capacities, of the elements around them; what conduction changes
at nodes the elements get back as an *increment*, each the mean of its nodes. So an element keeps what it has where
nothing flows, and heat is conserved to rounding, whatever k(T) and c_p(T) are. What an element lies above the mean of its
nodes, which they cannot see, flows into them at the rate at which an element levels out, k tr(sum b b^T) / (rho c_p).

Faces are adiabatic where no temperature is held.
"""

from dataclasses import dataclass
from math import ceil
from typing import Annotated

import numpy as np
from numba import njit

from ..physics.constitutive import conductivity, heat_capacity, heated, softened
from ..state.arrays import Floats, Ints, Laws
from ..state.records import Shape, assign, check_indices, collect
from .mesh import TetMesh

EVERY = 10  # mechanical steps to one of conduction: about its own stable step in copper, far less in steel
CONDUCTION_SAFETY = 0.9


@dataclass(frozen=True)
class ConductionState:
    """last (m,) K: temperatures of the elements after the last call; capacity (n,) J/K and T (n,) K of the nodes; known (n,): whether a
    node has a temperature; held (h,) nodes kept at held_T (h,) K; elapsed s and steps since the start and the last call."""

    known_elements: int
    elapsed: float
    steps: int
    last: Annotated[np.ndarray, Shape(-1)]
    capacity: Annotated[np.ndarray, Shape(-1)]
    T: Annotated[np.ndarray, Shape(-1)]
    known: Annotated[np.ndarray, Shape(-1, dtype=bool)]
    held: Annotated[np.ndarray, Shape(-1, dtype=np.int64, index_of="nodes")]
    held_T: Annotated[np.ndarray, Shape(-1)]


class Conduction:
    """Conduction over the elements of one mesh: laws (LAW records), law_of (m,) which of them each element follows.

    T (n,) K: temperatures of the nodes, set from the elements when a node is first active.
    """

    def __init__(self, mesh: TetMesh, laws: np.ndarray, law_of: np.ndarray, start: np.ndarray, table: np.ndarray):
        """start, table: the elements around each node, of `kernels.node_to_element`."""
        n, m = len(mesh.points), len(mesh.conn)
        self.mesh, self.laws, self.law_of, self.start, self.table = mesh, laws, law_of, start, table
        self.share, self.rate, self.flow = np.zeros(m), np.zeros(m), np.zeros((m, 4))
        self.last, self.own, self.gain = np.zeros(m), np.zeros(m), np.zeros(m)
        self.capacity, self.T, self.mean, self.change = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
        self.known, self.known_elements = np.zeros(n, bool), 0
        self.held, self.held_T = np.zeros(0, np.int64), np.zeros(0)
        self.elapsed, self.steps = 0.0, 0

    def state(self) -> ConductionState:
        """The history that later calls need."""
        return collect(ConductionState, self)

    def restore(self, state: ConductionState) -> None:
        """Put a `state` into the conduction of the same mesh."""
        assign(self, state)
        check_indices(state, nodes=len(self.T))

    def hold(self, nodes: np.ndarray, temperature: float | np.ndarray) -> None:
        """Keep nodes at a temperature (K, one or one for each): a bath that gives or takes what heat that needs."""
        self.held = np.asarray(nodes, np.int64)
        self.held_T = np.broadcast_to(np.asarray(temperature, np.float64), self.held.shape).copy()

    def advance(
        self, dt: float, nodes: int, elements: int, x: np.ndarray, volume: np.ndarray, T: np.ndarray, heat: np.ndarray,
        sigma_y: np.ndarray, eps_p: np.ndarray,
    ) -> float:  # fmt: skip
        """Note a mechanical step of dt (s); in every EVERY-th conduct over all the time since the last.

        nodes, elements: how many of them are active; the rest is adiabatic. x (n,3) m and volume (m,) m3 as they are
        now. T (m,) K and sigma_y (m,) Pa move on; heat (m,) J is increased by what each element gains. Returns the heat
        that held nodes have put in, J.
        """
        self.elapsed += dt
        self.steps += 1
        if self.steps % EVERY:
            return 0.0
        supplied = self.conduct(self.elapsed, nodes, elements, x, volume, T, heat, sigma_y, eps_p)
        self.elapsed = 0.0
        return supplied

    def conduct(
        self, time: float, nodes: int, elements: int, x: np.ndarray, volume: np.ndarray, T: np.ndarray, heat: np.ndarray,
        sigma_y: np.ndarray, eps_p: np.ndarray,
    ) -> float:  # fmt: skip
        """Conduct for a time (s) in as many stable steps as it takes; see `advance`."""
        if elements == 0:
            return 0.0
        supplied, left = self._sync_nodes(nodes, elements, T, heat, sigma_y, eps_p), time
        while left > 0.0:
            fastest = self._flows(elements, x, volume)
            dt = left / ceil(left * fastest / (2.0 * CONDUCTION_SAFETY)) if fastest > 0.0 else left
            supplied += self._step(dt, nodes, elements, T, heat, sigma_y, eps_p)
            left = left - dt if left > 1.5 * dt else 0.0
        return supplied

    def _sync_nodes(
        self, nodes: int, elements: int, T: np.ndarray, heat: np.ndarray, sigma_y: np.ndarray, eps_p: np.ndarray
    ) -> float:
        """Add to the nodes the rise of temperature of their elements since the last call, and set held nodes to their temperature.

        Returns the heat that the held nodes supply, J.
        """
        known = self.known_elements
        self.own[:known] = T[:known] - self.last[:known]
        self.own[known:elements] = 0.0
        self._means(nodes, elements, T, self.own)
        self.T[:nodes] += self.mean[:nodes]
        if elements > known:
            self._means(nodes, elements, T, T)
            fresh = (self.capacity > 0.0) & ~self.known
            self.T[fresh] = self.mean[fresh]
            self.known |= fresh
            self.known_elements = elements
        active = self.known[self.held]
        held = self.held[active]
        self.change[:] = 0.0
        self.change[held] = self.held_T[active] - self.T[held]
        self.own[:elements] = 0.0
        supplied = float(self.capacity[held] @ self.change[held])
        self._apply_increment(nodes, elements, T, heat, sigma_y, eps_p)
        return supplied

    def _means(self, nodes: int, elements: int, T: np.ndarray, value: np.ndarray) -> None:
        shares(0, elements, self.mesh.V0, self.laws, self.law_of, T, self.share)
        means(0, nodes, self.start, self.table, self.share, value, self.capacity, self.mean)

    def _flows(self, elements: int, x: np.ndarray, volume: np.ndarray) -> float:
        """What flows between nodes, W; returns a bound on the fastest decay, 1/s."""
        conn = self.mesh.conn
        largest = flows(0, elements, x, conn, volume, self.laws, self.law_of, self.T, self.share, self.rate, self.flow)
        return 4.0 * largest

    def _step(
        self,
        dt: float,
        nodes: int,
        elements: int,
        T: np.ndarray,
        heat: np.ndarray,
        sigma_y: np.ndarray,
        eps_p: np.ndarray,
    ) -> float:
        excesses(0, elements, dt, self.mesh.conn, self.T, T, self.rate, self.own)
        self._means(nodes, elements, T, self.own)
        changes(0, nodes, dt, self.start, self.table, self.flow, self.capacity, self.mean, self.change)
        held = self.held[self.known[self.held]]
        supplied = -float(self.capacity[held] @ self.change[held])
        self.change[held] = 0.0
        self._apply_increment(nodes, elements, T, heat, sigma_y, eps_p)
        return supplied

    def _apply_increment(
        self, nodes: int, elements: int, T: np.ndarray, heat: np.ndarray, sigma_y: np.ndarray, eps_p: np.ndarray
    ) -> None:
        """Add the increment `change` to nodes and elements; elements lose their `own` excess."""
        self.T[:nodes] += self.change[:nodes]
        gains(0, elements, self.mesh.conn, self.share, self.change, self.own, self.gain)
        take_heat(0, elements, self.gain, self.mesh.V0, self.laws, self.law_of, T, heat, sigma_y, eps_p)
        self.last[:elements] = T[:elements]


@njit(cache=True, nogil=True)
def shares(lo: int, hi: int, V0: Floats, laws: Laws, law_of: Ints, T: Floats, share: Floats) -> None:
    """A quarter of each element's heat capacity, J/K, into share (m,): what each of its nodes carries."""
    for e in range(lo, hi):
        law = laws[law_of[e]]
        share[e] = 0.25 * law.rho * V0[e] * heat_capacity(law, T[e])


@njit(cache=True, nogil=True)
def means(
    lo: int, hi: int, start: Ints, table: Ints, share: Floats, value: Floats, capacity: Floats, mean: Floats,
) -> None:  # fmt: skip
    """Mean of an element's value (m,) at nodes, weighted with heat capacities: mean (n,) and capacity (n,) J/K."""
    for a in range(lo, hi):
        total = 0.0
        weighted = 0.0
        for r in range(start[a], start[a + 1]):
            e = table[r] >> 2
            total += share[e]
            weighted += share[e] * value[e]
        capacity[a] = total
        mean[a] = weighted / total if total > 0.0 else 0.0


@njit(cache=True, nogil=True)
def excesses(lo: int, hi: int, dt: float, conn: Ints, nodal: Floats, T: Floats, rate: Floats, own: Floats) -> None:
    """What of its temperature above the mean of its nodes each element loses over dt (s), K, into own (m,)."""
    for e in range(lo, hi):
        mean = 0.25 * (nodal[conn[e, 0]] + nodal[conn[e, 1]] + nodal[conn[e, 2]] + nodal[conn[e, 3]])
        own[e] = dt * rate[e] * (T[e] - mean)


@njit(cache=True, nogil=True)
def flows(
    lo: int, hi: int, x: Floats, conn: Ints, volume: Floats, laws: Laws, law_of: Ints, T: Floats, share: Floats, rate: Floats,
    flow: Floats,
) -> float:  # fmt: skip
    """Heat that each element conducts into its nodes, flow (m,4) W = -k v b_I . grad T, from nodal T (n,).

    k is taken at the mean of the nodes. rate (m,): k v tr(sum b b^T) / capacity, 1/s. Returns the largest rate.
    """
    largest = 0.0
    for e in range(lo, hi):
        n0, n1, n2, n3 = conn[e, 0], conn[e, 1], conn[e, 2], conn[e, 3]
        a0, a1, a2 = x[n1, 0] - x[n0, 0], x[n1, 1] - x[n0, 1], x[n1, 2] - x[n0, 2]
        b0, b1, b2 = x[n2, 0] - x[n0, 0], x[n2, 1] - x[n0, 1], x[n2, 2] - x[n0, 2]
        c0, c1, c2 = x[n3, 0] - x[n0, 0], x[n3, 1] - x[n0, 1], x[n3, 2] - x[n0, 2]
        # gradients of the shape functions of nodes 1 to 3, times six volumes
        p0, p1, p2 = b1 * c2 - b2 * c1, b2 * c0 - b0 * c2, b0 * c1 - b1 * c0
        q0, q1, q2 = c1 * a2 - c2 * a1, c2 * a0 - c0 * a2, c0 * a1 - c1 * a0
        r0, r1, r2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
        s0, s1, s2 = p0 + q0 + r0, p1 + q1 + r1, p2 + q2 + r2
        t1, t2, t3 = T[n1] - T[n0], T[n2] - T[n0], T[n3] - T[n0]
        g0, g1, g2 = t1 * p0 + t2 * q0 + t3 * r0, t1 * p1 + t2 * q1 + t3 * r1, t1 * p2 + t2 * q2 + t3 * r2
        weight = conductivity(laws[law_of[e]], 0.25 * (T[n0] + T[n1] + T[n2] + T[n3])) / (36.0 * volume[e])
        f1, f2, f3 = p0 * g0 + p1 * g1 + p2 * g2, q0 * g0 + q1 * g1 + q2 * g2, r0 * g0 + r1 * g1 + r2 * g2
        flow[e, 1], flow[e, 2], flow[e, 3] = -weight * f1, -weight * f2, -weight * f3
        flow[e, 0] = weight * (f1 + f2 + f3)
        trace = p0 * p0 + p1 * p1 + p2 * p2 + q0 * q0 + q1 * q1 + q2 * q2 + r0 * r0 + r1 * r1 + r2 * r2
        trace += s0 * s0 + s1 * s1 + s2 * s2
        rate[e] = 0.25 * weight * trace / share[e]
        largest = max(largest, rate[e])
    return largest


@njit(cache=True, nogil=True)
def changes(
    lo: int, hi: int, dt: float, start: Ints, table: Ints, flow: Floats, capacity: Floats, mean: Floats, change: Floats,
) -> None:  # fmt: skip
    """Rise of temperature of each node over dt (s), K, into change (n,): mean (n,) K and what flows in."""
    for a in range(lo, hi):
        heat = 0.0
        for r in range(start[a], start[a + 1]):
            heat += flow[table[r] >> 2, table[r] & 3]
        change[a] = mean[a] + dt * heat / capacity[a] if capacity[a] > 0.0 else 0.0


@njit(cache=True, nogil=True)
def gains(lo: int, hi: int, conn: Ints, share: Floats, change: Floats, own: Floats, gain: Floats) -> None:
    """Heat each element gains as its nodes change their temperature and as it loses its own (m,) K to them, J."""
    for e in range(lo, hi):
        rise = change[conn[e, 0]] + change[conn[e, 1]] + change[conn[e, 2]] + change[conn[e, 3]]
        gain[e] = share[e] * (rise - 4.0 * own[e])


@njit(cache=True, nogil=True)
def take_heat(
    lo: int, hi: int, gain: Floats, V0: Floats, laws: Laws, law_of: Ints, T: Floats, heat: Floats, sigma_y: Floats,
    eps_p: Floats,
) -> float:  # fmt: skip
    """Give elements heat, gain (m,) J: T by enthalpy, softening of sigma_y (m,) at the plastic strains eps_p (m,).

    heat (m,) J: what of it makes pressure. Returns that part of all of it, J.
    """
    total = 0.0
    for e in range(lo, hi):
        if gain[e] == 0.0:
            continue
        law = laws[law_of[e]]
        old = T[e]
        T[e] = heated(law, old, gain[e] / (law.rho * V0[e]))
        heat[e] += law.expansion * gain[e]
        total += law.expansion * gain[e]
        sigma_y[e] = softened(law, sigma_y[e], eps_p[e], old, T[e])
    return total
