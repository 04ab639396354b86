"""A square sheet of points bonded to two facets: what the tests of bonds in an impact and of verdicts share."""

import numpy as np
from scipy.sparse import csr_matrix

from coupler.contact.bond import Bond
from coupler.contact.contact import Contact
from coupler.contact.law import stiffness
from coupler.contact.model import Nodes
from coupler.contact.particle_bonds import ParticleBonds
from coupler.geometry.triangles import edges

STRENGTH, ENERGY, SHEAR = 4e8, 50.0, 20.0  # Pa, J/m2, J/m2 in shear
STIFFNESS, SIDE = 1e17, 4e-6
SQUARE = np.array([[0.0, 0, 0], [SIDE, 0, 0], [SIDE, SIDE, 0], [0, SIDE, 0]])
FACETS = np.array([[0, 1, 2], [0, 2, 3]])


class Sheet:
    """A square sheet of n x n points bonded to two facets, with the contact between them."""

    def __init__(self, n: int, friction: float = 0.0, **law: float):
        a = (np.arange(n) + 0.5) * SIDE / n
        self.xp = np.stack([*np.meshgrid(a, a, indexing="ij"), np.zeros((n, n))], axis=-1).reshape(-1, 3)
        area = np.full(n * n, (SIDE / n) ** 2)
        below = np.where(self.xp[:, 0] > self.xp[:, 1], 0, 1)
        law = law or {"strength": STRENGTH, "energy": ENERGY, "shear_energy": SHEAR}
        corner = np.arange(n * n).reshape(n, n)
        lower = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:]], axis=-1).reshape(-1, 3)
        upper = np.stack([corner[:-1, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1).reshape(-1, 3)
        bond = Bond.tie(np.arange(n * n), FACETS[below], self.xp, SQUARE, area, STIFFNESS, **law)
        one_way = edges(np.concatenate([lower, upper]))
        ends = np.concatenate([one_way, one_way[:, ::-1]]).T
        self.bonds = ParticleBonds(bond, csr_matrix((np.ones(ends.shape[1]), ends), shape=(n * n, n * n)))
        k = stiffness(STIFFNESS * SIDE / n, float(area[0]), SIDE / n)
        self.contact = Contact(np.zeros(n * n, int), FACETS, np.ones(2, int), [k], [SIDE / n], friction, jump=np.inf)
        self.work, self._last, self._force = 0.0, self.xp.copy(), np.zeros_like(self.xp)

    def move(self, to: np.ndarray) -> np.ndarray:
        """Lead the points to `to` (n,3): their force in the plane and off it (3,), N. The work of the way is added up."""
        g, f = np.zeros_like(SQUARE), self.contact.points.f
        self.contact.search(to, SQUARE, 1e-7, always=np.arange(len(to)))
        f[:] = 0.0
        self.contact.forces(1e-12, Nodes(SQUARE, np.zeros_like(SQUARE), g, 4))
        self.bonds.forces(to, SQUARE, f, g, self.contact)
        np.testing.assert_allclose(f.sum(axis=0) + g.sum(axis=0), 0.0, atol=1e-12 * (1e-30 + np.abs(f).max()))
        self.work -= 0.5 * float(np.sum((f + self._force) * (to - self._last)))
        self._last, self._force = to, f.copy()
        return f.sum(axis=0)
