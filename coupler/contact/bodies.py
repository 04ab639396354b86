"""Contact between the bodies of one finite-element domain: unilateral, with friction, in addition to the bonds between them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from ..core.arrays import Histories
from ..core.records import Shape, copied, put
from . import broad
from . import kernels as k
from .bond import Bond
from .contact import Contact, ContactState, ContactSums
from .law import stiffness
from .model import ALL, ANY, Nodes, new_history
from .surfaces import Surfaces, neighbours

SKIN = 0.15  # spacings added to the search distance
JUMP = 0.1  # spacings in one step: bodies move by far less against each other


class ContactPast(NamedTuple):
    """Data of the contact between the previous bodies, from which the contact between the new bodies continues.

    nodes (N,): contact history of each node; sums: energies of the contact over all steps so far.
    """

    nodes: Histories
    sums: ContactSums = ContactSums()

    def renumbered(self, node: np.ndarray, count: int) -> "ContactPast":
        """The same data for a new numbering of `count` nodes. node (N,): new index of each node, -1 for a removed node."""
        nodes, kept = new_history(count), node >= 0
        nodes[node[kept]] = self.nodes[kept]
        return self._replace(nodes=nodes)


@dataclass(eq=False)
class BodyContactState:
    """State of a `BodyContact`. pairs: contact of nodes with facets; bonded (N,): mask of the nodes at which a bond, not the
    contact, resists compression."""

    pairs: ContactState
    bonded: Annotated[np.ndarray, Shape(-1, dtype=bool)]


class BodyContact(BodyContactState):
    """Contact of the surface nodes of each body with the facets of all other bodies, in both directions for each pair of bodies.

    The contact stiffness of a node follows from the mean area per node of its body's surface. Nodes of the substrate, whose mesh
    becomes coarser outwards, have the stiffness of the first splat's nodes. Friction: as in `Contact`. A node has no contact with the
    body to which it is bonded, unless the bond is loose. Bodies with fitted interfaces (`Interface.fitted`) start with almost no force.
    """

    pairs: Contact

    def __init__(
        self, surfaces: Surfaces, x: np.ndarray, bulk_modulus: Sequence[float], friction: float, ground: int = 1
    ):
        """x (N,3) m: positions; bulk_modulus (bodies,) Pa; friction: Coulomb's coefficient; ground: the first `ground` bodies are the
        substrate and its layers."""
        self.surfaces = surfaces
        self._is_new = True  # bonds before the first search are not new: no history is cleared
        bodies = range(surfaces.bodies if surfaces.bodies > 1 else 0)
        alike = [max(body, 1) for body in bodies]  # the stiffness does not change when later bodies join
        spacing = [surfaces.spacing(x, b) for b in alike]
        k_of = [  # a node has the area of two equilateral triangles
            stiffness(min(bulk_modulus[: b + 1]), 0.5 * np.sqrt(3.0) * h**2, h)
            for b, h in zip(alike, spacing, strict=True)
        ]
        nodes = [surfaces.nodes_of(body) for body in bodies]
        node = np.concatenate([np.zeros(0, np.int64), *nodes])
        self._facing = self._facets_around(x, bodies, ground)
        pairs = Contact(
            surfaces.body_of_node[node], surfaces.facets, surfaces.body, k_of, spacing, friction, jump=JUMP, node=node,
            facing=self._facing, skin=SKIN,
        )  # fmt: skip
        super().__init__(pairs, np.zeros(len(x), bool))
        #: Stable time step (s) of the penalty springs, and the masses and the number of moving nodes for which it was computed.
        self._stable_dt, self._weighed, self._moving = np.inf, np.zeros(0), 0
        elements = int(surfaces.element.max(initial=0)) + 1
        behind = np.sort(surfaces.facets.ravel() * elements + np.repeat(surfaces.element, 3))
        self._behind = np.divmod(behind[np.diff(behind, prepend=-1) > 0], elements)  # pairs of surface node and element
        self._share_of_node = 1.0 / np.maximum(np.bincount(self._behind[0], minlength=len(x)), 1)

    def _facets_around(self, x: np.ndarray, bodies: Sequence[int], ground: int) -> list[np.ndarray]:
        """For each body: indices of the facets of other bodies that it can touch during an impact. The bounding box of such a facet is
        closer to the body's bounding box than half the longest edge of all splats' boxes."""
        s = self.surfaces
        low, high = s.boxes(x)
        boxes, reach = broad.boxes_of(x, s.facets), 0.5 * float((high - low)[ground:].max(initial=0.0))
        return [
            broad.boxes_within(*boxes, s.facets_of(*neighbours(low, high, b, reach)), low[b] - reach, high[b] + reach)
            for b in bodies
        ]

    @property
    def energy(self) -> float:
        """Sum of the stored energy, the heat of friction and the energy of dropped contacts, J."""
        c = self.pairs
        return c.penalty_energy + c.sums.friction_heat + c.sums.dropped_energy

    def stable_dt(self, mass: np.ndarray, alone: float = np.inf, moving: int | None = None) -> float:
        """Stable time step (s) of bodies with penalty springs. mass (N,) kg: mass of the nodes, of which only the first `moving` can
        move (default: all); alone: stable step (s) of the bodies without the springs.

        The squared frequency of the sum of two stiffnesses is at most the sum of their squared frequencies.
        """
        moving = len(mass) if moving is None else moving
        if mass is not self._weighed or moving != self._moving:
            # includes all facets that a node can ever touch, because a resumed run searches at other times
            self._weighed, self._moving, self._stable_dt = mass, moving, np.inf
            for body, facing in enumerate(self._facing):
                own, others = self.surfaces.nodes_of(body), self.surfaces.corners_of(facing)
                light = [float(mass[nodes[nodes < moving]].min(initial=np.inf)) for nodes in (own, others)]
                if len(facing) and min(light) < np.inf:
                    self._stable_dt = min(self._stable_dt, self.pairs.stable_dt(1.0 / light[0], light[1], body))
        return alone if self._stable_dt == np.inf else float(1.0 / np.sqrt(1.0 / self._stable_dt**2 + 1.0 / alone**2))

    def search(
        self, x: np.ndarray, travel: float, bond: Bond | None = None, active: int | None = None, v: np.ndarray | None = None
    ) -> None:  # fmt: skip
        """Find the pairs that can touch before surfaces have moved `travel` m relative to each other. active, v: see `Contact.search`.

        x (N,3) m. Afterwards the contact resists compression at bonds that are broken or have a large slip (`Bond.release`); the
        lost spring energy is added to `sums.lost`, J. Raises SolverError when the positions are not finite numbers.
        """
        given_up = bond.release() if bond is not None else 0.0
        bonded, partner = np.zeros(len(x), bool), np.full(len(x), ANY)
        if bond is not None:
            tight = ~bond.loose
            bonded[bond.nodes[tight]] = True
            partner[bond.nodes[tight]] = self.surfaces.body_of_node[bond.triangles[tight, 0]]
        handed_over = (bonded != self.bonded) & (not self._is_new)
        changed = bool(handed_over.any()) or given_up > 0.0
        before, self.bonded, self._is_new = self.energy if changed else 0.0, bonded, False
        c, node = self.pairs, self.pairs.points.node
        c.points.partner[:] = partner[node]
        c.history[handed_over[node]] = new_history(1)  # a bond has started or ceased to resist their compression
        c.expire(handed_over[node])
        c.search(x[node], x, travel, active=active, v=v)
        if changed:  # a step of zero length gives the energy that the contact stores with its new nodes
            rest = np.zeros_like(x)
            self.forces(0.0, x, rest, rest.copy(), active)
            c.sums.lost += given_up + before - self.energy

    def ignore_depth(self, depth: np.ndarray) -> None:
        """Start the contact of nodes that lie in another body and have no contact force yet. Their present depth gives no force.
        depth (N,) m: depth of each node in the other body."""
        c, own = self.pairs, depth[self.pairs.points.node]
        new = (own > 0.0) & (c.depth == 0.0)
        c.history["ignored"][new, 0] = own[new]
        c.expire(new)

    def reduce_overlap(self, share: float) -> None:
        """Multiply by `share` the depth without force (`ignore_depth`) of the points `pairs.rows`: these then push the bodies apart."""
        ignored, rows = self.pairs.history["ignored"], self.pairs.rows
        ignored[rows] = np.where((ignored[rows] > 0.0) & (ignored[rows] < ALL), share * ignored[rows], ignored[rows])

    def forces(self, dt: float, x: np.ndarray, v: np.ndarray, f: np.ndarray, active: int | None = None) -> None:
        """Add the contact forces at x m and v m/s (N,3) to f (N,3) N, and update friction for a step of dt s. active: as in
        `search`."""
        c, nodes = self.pairs, Nodes(x, v, f, len(x) if active is None else active)
        k.gather(c.rows, c.points, nodes)
        c.forces(dt, nodes)
        k.scatter(c.rows, c.points, nodes)

    def heat(self) -> tuple[np.ndarray, np.ndarray]:
        """Elements behind the nodes and facets that slid since the last call, and the heat of friction (J) of each: arguments of
        `Target.warm`."""
        c, of_node = self.pairs, np.zeros(len(self.bonded))
        of_node[c.points.node] = c.heat_point
        of_pair = (of_node * self._share_of_node)[self._behind[0]]
        pairs, facets = np.flatnonzero(of_pair), np.flatnonzero(c.heat_face)
        elements = np.concatenate([self._behind[1][pairs], self.surfaces.element[facets]])
        heat = np.concatenate([of_pair[pairs], c.heat_face[facets]])
        c.heat_point[:], c.heat_face[:] = 0.0, 0.0
        return elements, heat

    def restore(self, state: BodyContactState) -> None:
        """Restore the state of a contact of the same surfaces. Call `search` next. Raises CheckpointError if the state does not
        belong to these surfaces."""
        put(state, self)
        self.pairs.expire()
        self._is_new = not self.bonded.any()  # of a cut: its contact has not searched yet

    def past(self) -> ContactPast:
        """Data for the contact of another set of bodies, which continues from this contact. Call `heat` first."""
        c, nodes = self.pairs, new_history(len(self.bonded))
        nodes[c.points.node] = c.history
        return ContactPast(nodes, copied(c.sums))

    def continue_from(self, past: ContactPast) -> None:
        """Continue from the contact `past` of the previous set of bodies: keep its friction springs and its energy sums."""
        c = self.pairs
        c.history[:] = past.nodes[c.points.node]
        c.history["body"] = ANY  # the bodies had other indices
        c.sums = copied(past.sums)
        c.expire()
