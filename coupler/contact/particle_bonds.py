"""A particle that bonds in its impact: vertices of its surface bonded to the facets they lie on while it rebounds."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..core import safety
from ..core.arrays import Floats, Ints
from .bond import Bond
from .bond_kernels import in_contact
from .contact import Contact

CONTACT_RANGE = 0.1  # spacings: a point nearer to the surface, beside one that presses, is in contact
FEWEST = 3  # bonds: fewer fix a point or a line, about which a particle turns
# ratio of what bonds can take up to the energy that parts them, or the inverse, at which the end is decided
SECURE = 4.0


@dataclass(frozen=True)
class BondedPoints:
    """Points (k,3) m that are bonded: strength (k,2) Pa and energy (k,2) J/m2, normal and shear; damage (k,)."""

    points: np.ndarray
    strength: np.ndarray
    energy: np.ndarray
    damage: np.ndarray

    def near(self, points: np.ndarray, distance: float) -> tuple[np.ndarray, np.ndarray]:
        """The nearest bonded point to each of points (n,3) m: its index (n,), and whether it lies within `distance` m (n,)."""
        if len(self.points) == 0:
            return np.zeros(len(points), np.int64), np.zeros(len(points), bool)
        away, index = cKDTree(self.points).query(points)
        return index, away <= distance


class ParticleBonds:
    """Cohesive springs (`contact.bond`) between points of a particle's surface and points on facets of the target.

    The contact carries the pressure between them. A spring carries shear, and
    tension from the moment at which the contact lets go: the opening is zero while the net normal traction of the point and
    its neighbours is compressive. Springs fail by strength and fracture energy as bonds between bodies do.
    """

    def __init__(self, bond: Bond, start: Ints, ring: Ints):
        """start (v+1,), ring: neighbours of all v points of the surface."""
        self.bond, rows = bond, bond.nodes
        count = start[rows + 1] - start[rows]
        first = np.concatenate([[0], np.cumsum(count)])
        self._ring = first, ring[np.arange(first[-1]) + np.repeat(start[rows] - first[:-1], count)]

    def forces(self, xp: Floats, x: Floats, f_point: Floats, f_node: Floats, contact: Contact | None = None) -> None:
        """Add the forces of this instant to f_point (like xp) and f_node (like x), N; update the damage. contact: between points and
        target, of this instant (default: none)."""
        depth = np.full(len(self.bond), -1.0)
        if contact is not None:
            reach = CONTACT_RANGE * float(contact.spacing[0])
            in_contact(self.bond.nodes, *self._ring, contact.depth, contact.gap, reach, depth)
        self.bond.forces_on(xp, f_point, x, f_node, depth, len(x))

    def stable_dt(self, softness: float, mass: Floats) -> float:
        """Stable time step (s) of the springs between points of inverse mass `softness` (1/kg) and nodes of mass (N,) kg."""
        sums = self.bond.row_sums()
        point = float(np.bincount(self.bond.nodes, sums[:, 0]).max(initial=0.0))
        node = np.bincount(self.bond.triangles.ravel(), sums[:, 1:].ravel(), len(mass)) / mass
        omega2 = max(point * softness, float(node.max()))
        return safety.BONDS * 2.0 / np.sqrt(omega2) if omega2 > 0.0 else np.inf

    def bonded_points(self, xp: np.ndarray) -> BondedPoints:
        """Points at which unbroken springs act, and their laws. xp as for `forces`."""
        b, whole = self.bond, ~self.bond.broken
        return BondedPoints(xp[b.nodes[whole]], b.strength[whole], b.energy[whole], b.damage[whole])

    @property
    def resistance(self) -> float:
        """Energy (J) that the springs together can still absorb before they break; 0 if fewer than FEWEST are unbroken."""
        whole = np.count_nonzero(~self.bond.broken)
        return float(self.bond.resistance.sum()) if whole >= FEWEST else 0.0

    def gives_way(self, energy: float) -> bool:
        """Whether an energy (J) that pulls on the springs is far more than all of them can absorb."""
        return SECURE * float(self.bond.resistance.sum()) <= energy

    def state(self) -> Bond:
        """State of the springs, for a checkpoint."""
        return self.bond.state()
