"""A particle that bonds in its impact: vertices of its surface held to the facets they lie on while it rebounds."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from ..state.records import Shape, check_indices
from .bond import Bond, BondState
from .bond_kernels import in_contact
from .contact import Contact
from .surfaces import Interface, Surfaces

CONTACT_RANGE = 0.1  # spacings: a point nearer to the surface, beside one that presses, is in contact
HOLD_SAFETY = 0.9  # of the step that the bound on the frequency allows
FEWEST = 3  # bonds: fewer hold a point or a line, about which a particle turns
# ratio of what bonds can take up to the energy that parts them, or the inverse, at which the end is decided
SECURE = 4.0


@dataclass(frozen=True)
class HoldState:
    """bond: the springs, between rows (n,) of the particle's surface and nodes (k,) of the target."""

    bond: BondState
    rows: Annotated[np.ndarray, Shape(-1, dtype=np.int64, index_of="surface")]
    nodes: Annotated[np.ndarray, Shape(-1, dtype=np.int64, index_of="nodes")]


@dataclass(frozen=True)
class HeldPlaces:
    """Places (k,3) m that are bonded: strength (k,2) Pa and energy (k,2) J/m2, normal and shear; damage (k,)."""

    points: np.ndarray
    strength: np.ndarray
    energy: np.ndarray
    damage: np.ndarray

    def near(self, points: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """The nearest place to each of the points (n,3): its index (n,), and whether it is no farther than `distance` m (n,)."""
        if len(self.points) == 0:
            return np.zeros(len(points), np.int64), np.zeros(len(points), bool)
        away, index = cKDTree(self.points).query(points)
        return index, away <= distance


class Hold:
    """Cohesive springs (`contact.bond`) between points of a particle's surface and places on facets of the target.

    rows (n,): the points; nodes (k,): of the facets. The contact carries the pressure between them. A spring carries shear, and
    tension from the moment at which the contact lets go: the opening is zero while the net normal traction of the point and
    its neighbours is compressive. Springs give way by strength and fracture energy as bonds between bodies do.
    """

    def __init__(
        self, rows: np.ndarray, facets: np.ndarray, xp: np.ndarray, x: np.ndarray, area: np.ndarray, stiffness: float,
        strength: float | np.ndarray = np.inf, energy: float | np.ndarray = np.inf,
        shear_strength: float | np.ndarray | None = None, shear_energy: float | np.ndarray | None = None,
        rewelds: float | np.ndarray = 0.0,
    ):  # fmt: skip
        """rows (n,) into xp (.,3) m; facets (n,3) nodes into x (.,3) m; area (n,) m2 of each point; stiffness Pa/m; the others
        as for `Bond`. Raises SolverError as it does."""
        self.rows, self.nodes = np.asarray(rows, np.int64), np.unique(facets).astype(np.int64)
        n = len(self.rows)
        local = n + np.searchsorted(self.nodes, facets)
        every = np.arange(n)
        surfaces = Surfaces(np.ascontiguousarray(local, np.int64), np.zeros(n, np.int64), every)
        where = Interface(every, every, np.full((n, 3), 1.0 / 3.0), np.zeros(n), area, np.zeros((0, 2), np.int64))
        law = strength, energy, shear_strength, shear_energy
        self.bond = Bond(where, surfaces, self._gather(xp, x), stiffness, *law, rewelds=rewelds)
        self.bond.loose[:] = True
        self._ring = np.zeros(n + 1, np.int64), np.zeros(0, np.int64)

    def _gather(self, xp: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.concatenate([xp[self.rows], x[self.nodes]])

    def joined(self, later: "Hold") -> "Hold":
        """This hold and the springs of a later one, between other points and the same target."""
        both = Hold.__new__(Hold)
        both.rows, both.nodes = np.concatenate([self.rows, later.rows]), np.union1d(self.nodes, later.nodes)
        first = 0
        for hold in (self, later):
            own, place = np.arange(len(hold.rows)) + first, np.searchsorted(both.nodes, hold.nodes)
            hold.bond.renumber(np.concatenate([own, len(both.rows) + place]))
            first += len(hold.rows)
        both.bond = Bond.joined([self.bond, later.bond])
        return both

    def without(self, gone: np.ndarray) -> "Hold":
        """This hold less the springs of a mask (n,); what they have dissipated stays in its ledger."""
        self.bond.drop(gone)
        left = np.count_nonzero(~gone)
        self.bond.renumber(np.concatenate([np.cumsum(~gone) - 1, left + np.arange(len(self.nodes))]))
        self.rows = self.rows[~gone]
        return self

    def on(self, start: np.ndarray, ring: np.ndarray) -> "Hold":
        """The hold itself, its points' neighbours taken from those of all v points (`rings`): start (v+1,), ring."""
        count = start[self.rows + 1] - start[self.rows]
        first = np.concatenate([[0], np.cumsum(count)])
        self._ring = first, ring[np.arange(first[-1]) + np.repeat(start[self.rows] - first[:-1], count)]
        return self

    def forces(
        self,
        xp: np.ndarray,
        x: np.ndarray,
        f_point: np.ndarray,
        f_node: np.ndarray,
        contact: Contact | None = None,
    ) -> None:
        """Add the forces of this instant to f_point (like xp) and f_node (like x), N; damage moves on. contact: between the points
        and the target, of this instant (default: there is none)."""
        n, depth = len(self.rows), None
        if contact is not None:
            depth = np.zeros(n)
            in_contact(
                self.rows, *self._ring, contact.depth, contact.gap, CONTACT_RANGE * float(contact.spacing[0]), depth
            )
        f = np.zeros((n + len(self.nodes), 3))
        self.bond.forces(self._gather(xp, x), f, depth)
        f_point[self.rows] += f[:n]
        f_node[self.nodes] += f[n:]

    def stable_dt(self, softness: float, mass: np.ndarray) -> float:
        """Stable time step (s) of the springs between points of inverse mass `softness` (1/kg) and nodes of mass (N,) kg."""
        n = len(self.rows)
        load = self.bond.load(n + len(self.nodes))
        omega2 = max(float(load[:n].max(initial=0.0)) * softness, float((load[n:] / mass[self.nodes]).max(initial=0.0)))
        return HOLD_SAFETY * 2.0 / np.sqrt(omega2) if omega2 > 0.0 else np.inf

    @property
    def whole(self) -> np.ndarray:
        """Mask (n,) of the springs that still hold."""
        return ~self.bond.broken

    @property
    def area(self) -> tuple[float, float]:
        """Area (m2) that was bonded, and that still is: of a damaged spring by the share of its fracture energy that is left."""
        return float(self.bond.area.sum()), float(self.bond.area @ self.bond.soundness)

    def places(self, xp: np.ndarray) -> "HeldPlaces":
        """Where the springs hold, and their laws. xp as for `forces`."""
        b, whole = self.bond, self.whole
        return HeldPlaces(xp[self.rows[whole]], b.strength[whole], b.energy[whole], b.damage[whole])

    @property
    def energy(self) -> float:
        """What the springs hold and have dissipated, J."""
        return self.bond.stored + self.bond.dissipated

    @property
    def resistance(self) -> float:
        """Energy (J) that the springs together can still take up before they part; 0 where fewer than FEWEST hold."""
        return float(self.bond.resistance.sum()) if np.count_nonzero(self.whole) >= FEWEST else 0.0

    def gives_way(self, energy: float) -> bool:
        """Whether an energy (J) that parts the springs is far more than all of them can take up."""
        return SECURE * float(self.bond.resistance.sum()) <= energy

    def heat(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Heat of fracture since the last call: (rows (n,) of the surface, nodes (n,3) of the target, J (n,))."""
        n = len(self.rows)
        return self.rows, self.nodes[self.bond.triangles - n], self.bond.heat()

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
        hold._ring = np.zeros(len(hold.rows) + 1, np.int64), np.zeros(0, np.int64)
        return hold
