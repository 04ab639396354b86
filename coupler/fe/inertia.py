"""Selective mass scaling of the target: elements with the shortest steps resist changes of their shape with an added inertia.

It leaves the masses of the nodes alone. The element e adds to the mass matrix

    M = m 1 + sum_e mu_e (1 - 1 1^T / 4),   mu_e = (m_e / 4) ((T / t_e)^2 - 1)

over its four nodes (Olovsson, Simonsson & Unosson 2005, Int. J. Numer. Meth. Engng 63, 1436): a translation has no part in it, so that
linear momentum is that of the true masses; only what moves the nodes of one element against each other, its rotation
included, is slower. An element with a step of its own t_e bears the step T with it. Accelerations follow from the nodes of the few
scaled elements alone. What the added inertia takes from the forces' work is numerical dissipation in the ledger.
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ..core.records import Shape
from .mesh import FiniteElements

MOST = 150  # elements: the matrix of their nodes is inverted in each window


@dataclass(eq=False)
class InertiaState:
    """most kg: mass that may be added; last (k,): nodes of the last step; taken (k,3) N: reduction of their forces in it."""

    most: float = 0.0
    last: Annotated[np.ndarray, Shape(-1, dtype=np.int64, index_of="nodes")] = field(
        default_factory=lambda: np.zeros(0, np.int64)
    )
    taken: Annotated[np.ndarray, Shape(-1, 3)] = field(default_factory=lambda: np.zeros((0, 3)))


class ElementInertia(InertiaState):
    """The scaled elements of one target in one window of steps; they are chosen before its first step.

    most kg: mass that may be added to elements, sum of (T / t_e)^2 - 1 times m_e; 0 for none. factor (s,): (T / t_e)^2 of each of the
    `elements` (s,), nodes (k,): theirs.
    """

    def __init__(self) -> None:
        super().__init__()
        self.elements: np.ndarray = np.zeros(0, np.int64)
        self.factor = np.ones(0)
        self.nodes: np.ndarray = np.zeros(0, np.int64)
        self._corners: np.ndarray = np.zeros((0, 4), np.int64)
        self._mu, self._share = np.zeros(0), np.zeros((0, 0))  # kg; m M^-1 of the nodes that are free

    def choose(self, t: FiniteElements, safe: np.ndarray, step: float) -> None:
        """Choose elements so that each bears `step` s, as far as `most` allows. safe (e,): own steps s of the first e elements, which
        become those that they bear."""
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
        """Change the forces f (n,3) N into those that give the true masses the accelerations they have with the added inertia."""
        if len(self.nodes):
            f[self.nodes] = self._share @ f[self.nodes]

    def advance(self, t: FiniteElements, total: np.ndarray, n: int, dt: float) -> tuple[float, np.ndarray]:
        """`slow` the forces total (n,3) N of all that acts on the first n nodes, which move, at the end of a step of dt s. Returns what
        it took from their work in the step, J, and from their sum, (3,) N: fixed nodes have it."""
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
        """v^T (M - m) v of velocities v (n,3) m/s, J."""
        if len(self.elements) == 0:
            return 0.0
        own = v[self._corners]
        own -= own.mean(axis=1, keepdims=True)
        return float(self._mu @ np.einsum("eai,eai->e", own, own))


def step_for(mass: np.ndarray, safe: np.ndarray, most: float, enough: float) -> float:
    """The step (s) to which elements of mass (m,) kg and own steps safe (m,) s can be brought by adding `most` kg, `enough` at most.

    An element of mass m and step t bears the step T with the mass m (T / t)^2: T^2 sum m / t^2 - sum m = most, over those with t < T.
    """
    if len(mass) == 0:
        return enough
    order = np.argsort(safe, kind="stable")
    mass, safe = mass[order], safe[order]
    reached = np.sqrt((most + np.cumsum(mass)) / np.cumsum(mass / safe**2))
    fits = np.append(reached[:-1] <= safe[1:], True)  # no further element would have to be made heavier
    return float(min(reached[np.argmax(fits)], enough))
