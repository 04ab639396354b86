"""Bonds of a particle during its impact: while it rebounds, vertices of its surface are bonded to the facets under them."""

import numpy as np
from scipy.sparse import csr_matrix

from ..core import safety
from ..core.arrays import Floats
from ..core.records import take
from .bond import Bond
from .bond_kernels import in_contact
from .contact import Contact

CONTACT_RANGE = 0.1  # spacings: a point closer to the surface than this, with a neighbour in contact, is in contact
FEWEST = 3  # bonds: with fewer the particle can turn about a point or a line
# if the energy that bonds can absorb is this multiple of the energy left to break them, or the reverse, the outcome is decided
SECURE = 4.0


class ParticleBonds:
    """Cohesive springs (`contact.bond`) between points of a particle's surface and points on facets of the target.

    The contact carries the pressure between them: all springs are loose (`Bond.loose`). A spring carries shear, and tension after the
    contact has opened: the opening stays zero while the point is in contact, or is close to the target and has a neighbour in contact
    (`bond_kernels.in_contact`). Springs fail as bonds between bodies do.
    """

    def __init__(self, bond: Bond, beside: csr_matrix):
        """beside (v,k): row i is nonzero at those of the k contact nodes that are neighbours of vertex i of the surface."""
        self.bond, near = bond, beside[bond.nodes]
        bond.loose[:] = True
        self._ring = near.indptr.astype(np.int64), near.indices.astype(np.int64)

    def forces(self, xp: Floats, x: Floats, f_point: Floats, f_node: Floats, contact: Contact | None = None) -> None:
        """Add the forces at positions xp and x to f_point (like xp) and f_node (like x), N, and update the damage. contact: between
        points and target, at the same positions (default: none)."""
        depth = np.full(len(self.bond), -1.0)
        if contact is not None:
            reach = CONTACT_RANGE * float(contact.spacing[0])
            in_contact(self.bond.nodes, *self._ring, contact.depth, contact.gap, reach, depth)
        self.bond.forces_on(xp, f_point, x, f_node, depth, len(x))

    def stable_dt(self, softness: float, mass: Floats) -> float:
        """Stable time step (s) of the springs between points and nodes. softness: inverse mass of a point, 1/kg; mass (N,) kg: mass
        of the nodes."""
        sums = self.bond.springs().row_sums()
        point = float(np.bincount(self.bond.nodes, sums[:, 0]).max(initial=0.0))
        node = np.bincount(self.bond.triangles.ravel(), sums[:, 1:].ravel(), len(mass)) / mass
        omega2 = max(point * softness, float(node.max()))
        return safety.BONDS * 2.0 / np.sqrt(omega2) if omega2 > 0.0 else np.inf

    def unbroken(self, xp: np.ndarray) -> tuple[np.ndarray, Bond]:
        """Positions (k,3) m of the points with unbroken springs, and the bonds of these springs. xp: as in `forces`."""
        whole = take(self.bond, ~self.bond.broken)
        return xp[whole.nodes], whole

    @property
    def resistance(self) -> float:
        """Energy (J) that all springs together can still absorb; 0 if fewer than FEWEST springs are unbroken."""
        whole = np.count_nonzero(~self.bond.broken)
        return float(self.bond.resistance.sum()) if whole >= FEWEST else 0.0

    def may_break(self, energy: float) -> bool:
        """Whether the bonds may break: `energy` (J) is at least SECURE times the energy that all springs can absorb."""
        return SECURE * float(self.bond.resistance.sum()) <= energy
