"""Selective mass scaling of the target: elements with the shortest time steps get an added inertia against changes of their shape.

The nodal masses m do not change. The element e adds to the mass matrix

    M = m 1 + sum_e mu_e (1 - 1 1^T / 4),   mu_e = (m_e / 4) ((T / t_e)^2 - 1)

over its four nodes (Olovsson, Simonsson & Unosson 2005, Int. J. Numer. Meth. Engng 63, 1436). Translations are not affected, so
that linear momentum is conserved; relative motions of the nodes of one element, its rotation included, are slower. An element with
its own step t_e is stable with the step T. Only the nodes of the few scaled elements need a linear system for their accelerations.
The work that the added inertia subtracts from that of the forces is numerical dissipation in the ledger.
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ..core.records import Shape
from .mesh import FiniteElements

MOST = 150  # elements: the matrix of their nodes is inverted in each chunk of steps


@dataclass(eq=False)
class InertiaState:
    """State of an `ElementInertia`. last (k,): nodes of the scaled elements in the last step; taken (k,3) N: reduction of the forces on
    these nodes in the last step; most (kg): limit of the sum of (factor - 1) m_e, the added mass, over the scaled elements of mass m_e;
    0 means no scaling."""

    most: float = 0.0
    last: Annotated[np.ndarray, Shape(-1, dtype=np.int64, index_of="nodes")] = field(
        default_factory=lambda: np.zeros(0, np.int64)
    )
    taken: Annotated[np.ndarray, Shape(-1, 3)] = field(default_factory=lambda: np.zeros((0, 3)))


class ElementInertia(InertiaState):
    """The elements of one target that have an added inertia (scaled elements). They are chosen before each chunk of steps.

    elements (s,): indices; factor (s,): (time step with added inertia / own time step)^2; nodes (k,): their nodes that are not fixed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.elements: np.ndarray = np.zeros(0, np.int64)
        self.factor = np.ones(0)
        self.nodes: np.ndarray = np.zeros(0, np.int64)
        self._corners: np.ndarray = np.zeros((0, 4), np.int64)
        self._mu, self._share = np.zeros(0), np.zeros((0, 0))  # kg; m M^-1 of the nodes that are free

    def choose(self, t: FiniteElements, safe: np.ndarray, step: float) -> None:
        """Choose elements so that all elements are stable with `step` s, as far as the limit `most` allows. safe (e,) s: stable steps
        of the first e elements; the steps of chosen elements are increased."""
        self.elements = self.elements[:0]
        if self.most > 0.0:
            short = np.flatnonzero(safe < step)
            short = short[np.argsort(safe[short], kind="stable")]
            if len(short) > MOST:
                short, step = short[:MOST], float(safe[short[MOST]])
            mass = t.laws["rho"][t.law_of[short]] * t.mesh.V0[short]
            reached = step_for(mass, safe[short], self.most, step)
            self.elements = np.sort(short[safe[short] < reached])
        if len(self.elements) == 0:
            self.nodes = self.nodes[:0]
            return
        chosen = self.elements
        self.factor = (reached / safe[chosen]) ** 2
        safe[chosen] = reached
        mass = t.laws["rho"][t.law_of[chosen]] * t.mesh.V0[chosen]
        self._mu = 0.25 * mass * (self.factor - 1.0)
        self._corners = t.mesh.conn[chosen]
        nodes, row = np.unique(self._corners.astype(np.int64), return_inverse=True)
        row = row.reshape(-1, 4)
        free = t.inv_mass[nodes] > 0.0
        M = np.zeros((len(nodes), len(nodes)))
        for i in range(4):
            for j in range(4):
                np.add.at(M, (row[:, i], row[:, j]), self._mu * ((i == j) - 0.25))
        M[np.diag_indices_from(M)] += t.mass[nodes]
        self.nodes = nodes[free]
        self._share = t.mass[self.nodes][:, None] * np.linalg.inv(M[np.ix_(free, free)])

    def slow(self, f: np.ndarray) -> None:
        """Replace the forces f (n,3) N by forces that give the nodal masses the accelerations with added inertia."""
        if len(self.nodes):
            f[self.nodes] = self._share @ f[self.nodes]

    def advance(self, t: FiniteElements, total: np.ndarray, n: int, dt: float) -> tuple[float, np.ndarray]:
        """Apply `slow` to the total forces (N,3) N on the first n nodes, the active ones, at the end of a step of dt s. Returns the
        work (J) in the step of the forces that this takes away, and the sum (3,) N of these forces: it acts on the supports instead."""
        work = float(np.einsum("ij,ij->", self.taken, t.nodes.v[self.last]))
        before = total[self.nodes]
        moving = self.nodes < n
        before[~moving] = 0.0
        after = np.where(moving[:, None], self._share @ before, 0.0) if len(before) else before
        total[self.nodes[moving]] = after[moving]
        self.taken, self.last = before - after, self.nodes
        work += float(np.einsum("ij,ij->", self.taken, t.nodes.v[self.last]))
        return 0.5 * dt * work, self.taken.sum(axis=0)

    def twice_kinetic(self, v: np.ndarray) -> float:
        """Twice the kinetic energy of the added inertia, v^T (M - m) v, J. v (n,3) m/s."""
        if len(self.elements) == 0:
            return 0.0
        own = v[self._corners]
        own -= own.mean(axis=1, keepdims=True)
        return float(self._mu @ np.einsum("eai,eai->e", own, own))


def step_for(mass: np.ndarray, safe: np.ndarray, most: float, enough: float) -> float:
    """The largest stable step (s), at most `enough`, of elements that get `most` kg of added mass in total. mass (m,) kg,
    safe (m,) s: masses and own steps of the elements.

    An element of mass m and step t is stable with the step T if its mass is m (T / t)^2. T follows from T^2 sum m / t^2 - sum m =
    most, summed over elements with t < T.
    """
    if len(mass) == 0:
        return enough
    order = np.argsort(safe, kind="stable")
    mass, safe = mass[order], safe[order]
    reached = np.sqrt((most + np.cumsum(mass)) / np.cumsum(mass / safe**2))
    fits = np.append(reached[:-1] <= safe[1:], True)  # no other element needs more mass
    return float(min(reached[np.argmax(fits)], enough))
