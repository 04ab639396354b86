"""Heat conduction in the explicit target: Fourier's law on its tetrahedra, explicit in time.

The target stores temperatures in elements, where plastic work heats them; conduction needs temperatures at nodes. Nodes conduct as
linear tetrahedra with lumped capacities in the current configuration. A rise of temperature in elements raises each node by the
mean rise of the elements around it, weighted with heat capacities. Conduction returns *increments* to the elements: each gets the mean
increment of its nodes. Therefore an element without heat flow keeps its temperature, and heat is conserved to rounding for any k(T)
and c_p(T). The excess of an element over the mean of its nodes flows into the nodes at the rate k tr(sum b b^T) / (rho c_p).

Faces are adiabatic.
"""

from dataclasses import dataclass
from math import ceil
from typing import Annotated, NamedTuple

import numpy as np

from ..compiling import njit
from ..core import safety
from ..core.arrays import Floats, Ints
from ..core.loops import PARTS, ranges
from ..core.records import Shape
from ..core.threads import together
from ..physics.constitutive import conductivity, heat_capacity, heated, softened
from .blocks import edge_cofactors
from .mesh import FiniteElements
from .model import Cells, Elements, Metals

EVERY = 10  # mechanical steps per step of conduction: about the stable step of conduction in copper, far below that in steel
LEAST = 4000  # elements or nodes in a range of a loop that threads share


@dataclass(eq=False)
class ConductionState:
    """State of the conduction over n nodes and m elements. last (m,) K: temperatures of the elements after the last conduction;
    capacity (n,) J/K, T (n,) K: heat capacity and temperature of the nodes; known (n,): whether a node has a temperature;
    known_elements: number of elements (the first ones) whose nodes have a temperature; elapsed (s): time since the last conduction;
    steps: number since the start."""

    last: Annotated[np.ndarray, Shape(-1)]
    capacity: Annotated[np.ndarray, Shape(-1)]
    T: Annotated[np.ndarray, Shape(-1)]
    known: Annotated[np.ndarray, Shape(-1, dtype=bool)]
    known_elements: int = 0
    elapsed: float = 0.0
    steps: int = 0


class Flow(NamedTuple):
    """Arrays of the kernels. Elements: share (m,) J/K: a quarter of the heat capacity; rate (m,) 1/s: see `_flows`; flow (m,4) W: heat
    flow into the nodes; own (m,) K: decrease of T towards the mean of the nodes; gain (m,) J: heat gained; last (m,) K: see
    `ConductionState`. Nodes: capacity (n,) J/K; T (n,) K; mean (n,) K: see `means`; change (n,) K: rise of T in a step."""

    share: Floats
    rate: Floats
    flow: Floats
    own: Floats
    gain: Floats
    last: Floats
    capacity: Floats
    T: Floats
    mean: Floats
    change: Floats


class Conduction(ConductionState):
    """Conduction in a target of n nodes and m elements. A node gets its first temperature from the elements when it becomes active."""

    def __init__(self, n: int, m: int):
        super().__init__(np.zeros(m), np.zeros(n), np.zeros(n), np.zeros(n, bool))
        share, rate, own, gain, flow = *np.zeros((4, m)), np.zeros((m, 4))
        self.arrays = Flow(share, rate, flow, own, gain, self.last, self.capacity, self.T, np.zeros(n), np.zeros(n))

    def advance(self, dt: float, t: FiniteElements) -> None:
        """Count a mechanical step of dt (s). Every EVERY steps, conduct heat over the time since the last conduction."""
        self.elapsed += dt
        self.steps += 1
        if self.steps % EVERY == 0:
            self.conduct_for(self.elapsed, t)
            self.elapsed = 0.0

    def conduct_for(self, time: float, t: FiniteElements) -> None:
        """Conduct heat among the active elements for `time` s, in stable steps; their boundary is adiabatic.

        Changes T, sigma_y and heat of the elements of t.
        """
        n, m, left = t.active_nodes, t.active_elements, time
        if m == 0:
            return
        self._sync_nodes(t)
        while left > 0.0:
            fastest = 4.0 * self.flows(t)
            dt = left / ceil(left * fastest / (2.0 * safety.CONDUCTION)) if fastest > 0.0 else left
            together(_level, n, m, dt, t.cells, t.metals, Elements.of(t.elements), self.arrays)
            left = left - dt if left > 1.5 * dt else 0.0

    def _sync_nodes(self, t: FiniteElements) -> None:
        """Raise the temperatures of the nodes by the rise of their elements since the last call."""
        n, m, a, known = t.active_nodes, t.active_elements, self.arrays, self.known_elements
        a.own[:known] = t.elements.T[:known] - self.last[:known]
        a.own[known:m] = 0.0
        together(_averages, n, m, t.cells, t.metals, t.elements.T, a.own, a)
        self.T[:n] += a.mean[:n]
        if m > known:
            together(_averages, n, m, t.cells, t.metals, t.elements.T, t.elements.T, a)
            fresh = (self.capacity > 0.0) & ~self.known
            self.T[fresh] = a.mean[fresh]
            self.known |= fresh
            self.known_elements = m

    def flows(self, t: FiniteElements) -> float:
        """Do `_flows` for the active elements: writes arrays.flow, W, and arrays.rate, 1/s. Returns the largest rate, 1/s."""
        fastest = np.zeros(PARTS)
        m, volume = t.active_elements, t.elements.volume
        together(_flows, m, t.nodes.x, volume, t.cells, t.metals, self.arrays, fastest)
        return float(fastest.max())


@njit(cache=True, nogil=True)
def _averages(team: Ints, n: int, m: int, c: Cells, metals: Metals, T: Floats, value: Floats, a: Flow) -> None:
    """Do `means` for values (m,) of the elements at temperatures T (m,) K, in all threads."""
    for lo, hi, _ in ranges(team, 0, m, LEAST):
        shares(lo, hi, c, metals, T, a.share)
    for lo, hi, _ in ranges(team, 1, n, LEAST):
        means(lo, hi, c, a.share, value, a.capacity, a.mean)


@njit(cache=True, nogil=True)
def _level(team: Ints, n: int, m: int, dt: float, c: Cells, metals: Metals, elements: Elements, a: Flow) -> None:
    """Do one step of conduction over dt (s), after `_flows`, for the first n nodes and m elements, in all threads."""
    for lo, hi, _ in ranges(team, 0, m, LEAST):
        for e in range(lo, hi):  # decrease of the excess over the mean of the nodes
            n0, n1, n2, n3 = c.conn[e, 0], c.conn[e, 1], c.conn[e, 2], c.conn[e, 3]
            a.own[e] = dt * a.rate[e] * (elements.T[e] - 0.25 * (a.T[n0] + a.T[n1] + a.T[n2] + a.T[n3]))
        shares(lo, hi, c, metals, elements.T, a.share)
    for lo, hi, _ in ranges(team, 1, n, LEAST):
        means(lo, hi, c, a.share, a.own, a.capacity, a.mean)
        for i in range(lo, hi):  # rise of each node, by its elements and by the heat flow
            heat = 0.0
            for r in range(c.start[i], c.start[i + 1]):
                heat += a.flow[c.table[r] >> 2, c.table[r] & 3]
            a.change[i] = a.mean[i] + dt * heat / a.capacity[i] if a.capacity[i] > 0.0 else 0.0
            a.T[i] += a.change[i]
    for lo, hi, _ in ranges(team, 2, m, LEAST):
        gains(lo, hi, c.conn, a.share, a.change, a.own, a.gain)
        add_heat(lo, hi, a.gain, c, metals, elements)
        a.last[lo:hi] = elements.T[lo:hi]


@njit(cache=True, nogil=True)
def shares(lo: int, hi: int, c: Cells, metals: Metals, T: Floats, share: Floats) -> None:
    """Write a quarter of each element's heat capacity, the share of each of its nodes, to share (m,) J/K."""
    for e in range(lo, hi):
        law = metals.laws[metals.of_element[e]]
        share[e] = 0.25 * law.rho * c.V0[e] * heat_capacity(law, T[e])


@njit(cache=True, nogil=True)
def means(lo: int, hi: int, c: Cells, share: Floats, value: Floats, capacity: Floats, mean: Floats) -> None:
    """Write the means of element values (m,) at the nodes, weighted with heat capacities, to mean (n,), and the sums of the
    capacities to capacity (n,) J/K."""
    for a in range(lo, hi):
        total = 0.0
        weighted = 0.0
        for r in range(c.start[a], c.start[a + 1]):
            e = c.table[r] >> 2
            total += share[e]
            weighted += share[e] * value[e]
        capacity[a] = total
        mean[a] = weighted / total if total > 0.0 else 0.0


@njit(cache=True, nogil=True)
def _flows(team: Ints, m: int, x: Floats, volume: Floats, c: Cells, metals: Metals, a: Flow, fastest: Floats) -> None:
    """Write the heat flow of the first m elements into each node I, -k v b_I . grad T, to a.flow (m,4) W, in all threads.

    k: conductivity at the mean temperature of the nodes; v: current volume; b_I: gradient of the shape function. Also writes a.rate
    (m,) 1/s: k v sum |b_I|^2 / capacity; fastest (PARTS,) 1/s: the largest rate in each part of the loop.
    """
    T, flow, rate = a.T, a.flow, a.rate
    for lo, hi, part in ranges(team, 0, m, LEAST):
        largest = 0.0
        for e in range(lo, hi):
            n0, n1, n2, n3 = c.conn[e, 0], c.conn[e, 1], c.conn[e, 2], c.conn[e, 3]
            # gradients of the shape functions of nodes 1 to 3, times six volumes
            p0, p1, p2, q0, q1, q2, r0, r1, r2, _ = edge_cofactors(x[n0], x[n1], x[n2], x[n3])
            s0, s1, s2 = p0 + q0 + r0, p1 + q1 + r1, p2 + q2 + r2
            t1, t2, t3 = T[n1] - T[n0], T[n2] - T[n0], T[n3] - T[n0]
            g0, g1, g2 = t1 * p0 + t2 * q0 + t3 * r0, t1 * p1 + t2 * q1 + t3 * r1, t1 * p2 + t2 * q2 + t3 * r2
            law = metals.laws[metals.of_element[e]]
            weight = conductivity(law, 0.25 * (T[n0] + T[n1] + T[n2] + T[n3])) / (36.0 * volume[e])
            f1, f2, f3 = p0 * g0 + p1 * g1 + p2 * g2, q0 * g0 + q1 * g1 + q2 * g2, r0 * g0 + r1 * g1 + r2 * g2
            flow[e, 1], flow[e, 2], flow[e, 3] = -weight * f1, -weight * f2, -weight * f3
            flow[e, 0] = weight * (f1 + f2 + f3)
            trace = p0 * p0 + p1 * p1 + p2 * p2 + q0 * q0 + q1 * q1 + q2 * q2 + r0 * r0 + r1 * r1 + r2 * r2
            trace += s0 * s0 + s1 * s1 + s2 * s2
            rate[e] = 0.25 * weight * trace / a.share[e]
            largest = max(largest, rate[e])
        fastest[part] = largest


@njit(cache=True, nogil=True)
def gains(lo: int, hi: int, conn: Ints, share: Floats, change: Floats, own: Floats, gain: Floats) -> None:
    """Write the heat that each element gains, from change (n,) K of its nodes less the decrease own (m,) K, to gain (m,) J."""
    for e in range(lo, hi):
        rise = change[conn[e, 0]] + change[conn[e, 1]] + change[conn[e, 2]] + change[conn[e, 3]]
        gain[e] = share[e] * (rise - 4.0 * own[e])


@njit(cache=True, nogil=True)
def add_heat(lo: int, hi: int, gain: Floats, c: Cells, metals: Metals, a: Elements) -> float:
    """Add the heat gain (m,) J to elements: T rises with the enthalpy, sigma_y decreases by softening, and `heat` increases by the part
    that raises pressure. Returns the sum of this part, J."""
    total = 0.0
    for e in range(lo, hi):
        if gain[e] == 0.0:
            continue
        law = metals.laws[metals.of_element[e]]
        old = a.T[e]
        a.T[e] = heated(law, old, gain[e] / (law.rho * c.V0[e]))
        a.heat[e] += law.expansion * gain[e]
        total += law.expansion * gain[e]
        a.sigma_y[e] = softened(law, a.sigma_y[e], a.eps_p[e], old, a.T[e])
    return total
