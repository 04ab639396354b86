"""A particle that has bonded in its impact: vertices of its surface held to the facets they lie on while it rebounds."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..state.records import Shape, check_indices
from .bond import Bond, BondState
from .surfaces import Interface, Surfaces

CONTACT_RANGE = 0.1  # spacings: points that lie closer to the surface count as touching (contact chatters)
HOLD_SAFETY = 0.9  # of the step that the bound on the frequency allows


@dataclass(frozen=True)
class HoldState:
    """bond: the springs, between rows (n,) of the particle's surface and nodes (k,) of the target."""

    bond: BondState
    rows: Annotated[np.ndarray, Shape(-1, dtype=np.int64, index_of="surface")]
    nodes: Annotated[np.ndarray, Shape(-1, dtype=np.int64, index_of="nodes")]


class Hold:
    """Cohesive springs (`contact.bond`) between points of a particle's surface and places on facets of the target.

    rows (n,): the points, ascending; nodes (k,): of the facets. The springs are at rest where they are made, under the
    pressure of the contact there, which they leave alone: they carry the tension from then on, and give way by strength
    and fracture energy as bonds between bodies do.
    """

    def __init__(
        self, rows: np.ndarray, facets: np.ndarray, xp: np.ndarray, x: np.ndarray, area: np.ndarray, stiffness: float,
        **law: float,
    ):  # fmt: skip
        """rows (n,) into xp (.,3) m; facets (n,3) nodes into x (.,3) m; area (n,) m2 of each point; stiffness Pa/m; law: strengths
        (Pa) and energies (J/m2) as `Bond` takes them, none to hold for ever. Raises SolverError as `Bond` does."""
        self.rows, self.nodes = np.asarray(rows, np.int64), np.unique(facets).astype(np.int64)
        n = len(self.rows)
        local = n + np.searchsorted(self.nodes, facets)
        every = np.arange(n)
        surfaces = Surfaces(np.ascontiguousarray(local, np.int64), np.zeros(n, np.int64), every)
        where = Interface(every, every, np.full((n, 3), 1.0 / 3.0), np.zeros(n), area, np.zeros((0, 2), np.int64))
        self.bond = Bond(where, surfaces, self._gather(xp, x), stiffness, **law)

    def _gather(self, xp: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.concatenate([xp[self.rows], x[self.nodes]])

    def forces(self, xp: np.ndarray, x: np.ndarray, f_point: np.ndarray, f_node: np.ndarray) -> None:
        """Add the forces of this instant to f_point (like xp) and f_node (like x), N; damage moves on."""
        n = len(self.rows)
        f = np.zeros((n + len(self.nodes), 3))
        self.bond.forces(self._gather(xp, x), f)
        f_point[self.rows] += f[:n]
        f_node[self.nodes] += f[n:]

    def stable_dt(self, softness: float, mass: np.ndarray) -> float:
        """Stable time step (s) of the springs between points of inverse mass `softness` (1/kg) and nodes of mass (N,) kg."""
        n = len(self.rows)
        load = self.bond.load(n + len(self.nodes))
        omega2 = max(float(load[:n].max()) * softness, float((load[n:] / mass[self.nodes]).max()))
        return HOLD_SAFETY * 2.0 / np.sqrt(omega2)

    @property
    def whole(self) -> np.ndarray:
        """Mask (n,) of the springs that still hold."""
        return ~self.bond.broken

    @property
    def area(self) -> tuple[float, float]:
        """Area (m2) that was bonded, and that still is."""
        return float(self.bond.area.sum()), float(self.bond.area[self.whole].sum())

    @property
    def energy(self) -> float:
        """What the springs hold and have dissipated, J."""
        return self.bond.stored + self.bond.dissipated

    def state(self) -> HoldState:
        """Everything there is to keep."""
        return HoldState(self.bond.state(), self.rows.copy(), self.nodes.copy())

    @classmethod
    def from_state(cls, state: HoldState) -> "Hold":
        """A hold as a `state` has it. Raises CheckpointError where its parts do not fit."""
        check_indices(state.bond.rows, nodes=len(state.rows) + len(state.nodes))
        hold = cls.__new__(cls)
        hold.rows, hold.nodes = state.rows.copy(), state.nodes.copy()
        hold.bond = Bond.from_state(state.bond)
        return hold
