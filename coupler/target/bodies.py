"""The target of a run: substrate and finished splats in one finite-element domain, with contact and bonds between these bodies."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from ..contact import broad
from ..contact.bodies import BodyContact, BodyContactState, ContactPast
from ..contact.bond import Bond, penalty
from ..contact.model import new_history
from ..contact.overlap import lying_inside
from ..contact.surfaces import Interface, Surfaces, earlier_neighbours, interface, neighbours
from ..core.arrays import Links, occurring
from ..core.records import Shape, check_indices, copied, unfit
from ..fe.explicit import Target, TargetState
from ..fe.mesh import TetMesh
from ..geometry.graph import connected_parts
from ..physics.adhesion import Adhesion
from ..physics.constitutive import LAW
from .domain import SPLAT, BodyState, Domain, Point, domain_now, domain_of, merge, new_indices, select
from .placing import NEAR, placed_on

# Spacings. A bonded node deeper than FOLDED in another body is checked. For a node deeper than PRESSED the contact pressure exceeds
# 0.06 K, about the theoretical strength G / 2 pi: no bond beside the node can resist it. A node deeper than DEEPEST has not come
# through a fold: its bonds do not change.
FOLDED, PRESSED, DEEPEST = 0.03, 0.06, 0.5


@dataclass(frozen=True)
class BodiesState:
    """State of substrate and splats with their bonds and contact. placed (n,3) m, body (m,), impact, buried (b,): as in `Bodies`."""

    mesh: TetMesh
    target: TargetState
    contact: BodyContactState | None
    bond: Bond | None
    placed: np.ndarray | None
    laws: Annotated[np.ndarray, Shape(-1, dtype=LAW)]
    body: Annotated[np.ndarray, Shape(-1, dtype=np.int32, index_of="laws")]
    buried: Annotated[np.ndarray, Shape(-1, dtype=np.int64, index_of="facets")]
    impact: Annotated[np.ndarray, Shape(-1, dtype=np.int64)]


@dataclass
class Bodies:
    """Substrate (body 0) and splats. target: their common domain; body (m,): body of each element; fixed, absorbing: names of facet
    sets; bond, contact: between bodies, None while there is only the substrate; buried: covered facets, which no other body can touch;
    placed (n,3) m: positions in which the contact was set up; impact (bodies,): impact that made each body, from 1; 0: substrate."""

    target: Target
    body: np.ndarray
    fixed: tuple[str, ...]
    absorbing: tuple[str, ...]
    friction: float
    bond: Bond | None = None
    buried: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    placed: np.ndarray | None = None
    impact: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int64))
    _contact: BodyContact | None = None
    _past: ContactPast | None = None  # data from which the contact will continue, while `_contact` is None

    @property
    def contact(self) -> BodyContact | None:
        """The contact between the bodies. It is made when it is first needed."""
        if self._contact is None and self._past is not None and self.placed is not None:
            K, ground = self.target.laws["K"].tolist(), int(np.count_nonzero(self.impact == 0))
            self._contact = BodyContact(self.surfaces, self.placed, K, self.friction, ground)
            self._contact.continue_from(self._past)
        return self._contact

    def past(self) -> ContactPast | None:
        """Data from which the contact of another set of bodies continues."""
        return self._past if self._contact is None else self._contact.past()

    @property
    def count(self) -> int:
        """Number of bodies, the substrate included."""
        return len(self.target.laws)

    @property
    def surfaces(self) -> Surfaces:
        mesh = self.target.mesh
        return Surfaces.of(mesh.facets, mesh.facet_element, self.body)

    @property
    def is_flat(self) -> bool:
        """Whether there is only a substrate, which nothing has hit, and its surface is flat."""
        mesh = self.target.mesh
        return self.count == 1 and self.target.time == 0.0 and not np.ptp(mesh.points[mesh.facets[mesh.sets["top"]], 2])

    def reachable(self) -> np.ndarray:
        """Indices of the facets that a particle can hit: top and sides of the substrate and surfaces of splats, without buried facets.

        The sides are included: otherwise a point that slides over the rim would lie behind the top, which would pull it back.
        """
        sets = self.target.mesh.sets
        splats = [sets[name] for name in sorted(sets) if name.startswith(SPLAT)]
        ids = np.concatenate([sets["top"], sets["sides"], *splats])
        return np.setdiff1d(occurring(ids, len(self.target.mesh.facets)), self.buried, assume_unique=True)

    # ---- in the loop ---------------------------------------------------------------------------------------------

    def search(self, travel: float, by_speed: bool = False, time: float = 0.0) -> None:
        """Call `release_heat`. Then find the pairs that can touch before surfaces have moved `travel` m, among nodes that waves reach
        in `time` s. by_speed: reduce `travel` for surfaces that are slower than the fastest node."""
        self.release_heat()
        if self.contact is not None:
            v = self.target.nodes.v if by_speed else None
            self.contact.search(self.target.nodes.x, travel, self.bond, self.target.active_after(time), v)

    def release_heat(self) -> None:
        """Heat the elements by the friction and fracture since the last call."""
        if self.bond is not None:
            heat = 0.5 * self.bond.heat()  # half for each side
            if heat.any():
                self.target.warm_around(self.bond.nodes, heat)
                self.target.warm_around(self.bond.triangles, np.repeat(heat / 3.0, 3))
        if self._contact is not None:
            self.target.warm(*self._contact.heat())

    def forces(self, dt: float) -> None:
        """Add the present forces of bonds and contact between bodies to the external forces of the target."""
        t = self.target
        if self.contact is not None:
            self.contact.forces(dt, t.nodes.x, t.nodes.v, t.f_ext, t.active_nodes)
        if self.bond is not None:
            self.bond.forces(t.nodes.x, t.f_ext, active=t.active_nodes)

    def stable_dt(self, enough: float, ahead: float = 0.0) -> float:
        """Stable time step (s) of the target with the springs between its bodies. enough, ahead: see `Target.stable_dt`."""
        t, springs = self.target, self.bond.springs() if self.bond is not None else None
        if self.contact is None:
            return t.stable_dt(enough, ahead, springs)
        moving = t.active_after(np.inf)
        of_contact = self.contact.stable_dt(t.mass, moving=moving)
        alone = 1.0 / np.sqrt(1.0 / enough**2 - 1.0 / of_contact**2) if 0.0 < enough < of_contact else np.inf
        return self.contact.stable_dt(t.mass, t.stable_dt(enough, ahead, springs, alone), moving)

    def springs(self) -> list[Links]:
        """Tables of the springs of bonds and contact between the bodies. Call `search` first."""
        pairs = self.contact.pairs if self.contact is not None else None
        return [each.springs() for each in (pairs, self.bond) if each is not None]

    @property
    def energy(self) -> float:
        """Sum of stored and dissipated energy of contact and bonds between bodies, J."""
        c, b = self.contact, self.bond
        energy = c.energy + c.pairs.sums.lost if c is not None else 0.0
        return energy + (b.work if b is not None else 0.0)

    def state(self) -> BodiesState:
        """State from which `from_state` makes the same bodies. The mesh is not copied: it never changes."""
        return BodiesState(
            self.target.mesh, copied(self.target), copied(self.contact), copied(self.bond), self.placed, self.target.laws, self.body,
            self.buried, self.impact,
        )  # fmt: skip

    @classmethod
    def from_state(
        cls, state: BodiesState, fixed: tuple[str, ...], absorbing: tuple[str, ...], friction: float, conduction: bool
    ) -> "Bodies":
        """Bodies from a `state`. Raises CheckpointError if its parts do not fit each other."""
        _check(state)
        T = state.target.elements.T
        target = Target(state.mesh, state.laws, T, state.body, fixed, absorbing, conduction=conduction)
        target.restore(state.target)
        bodies = cls(
            target, state.body.copy(), fixed, absorbing, friction, buried=state.buried, placed=state.placed, impact=state.impact
        )  # fmt: skip
        if state.placed is not None and state.contact is not None:
            bodies._past = ContactPast(new_history(len(state.placed)))
            if (contact := bodies.contact) is not None:
                contact.restore(state.contact)
        bodies.bond = copied(state.bond)
        return bodies

    # ---- between impacts -----------------------------------------------------------------------------------------

    def separate(self, which: Iterable[int]) -> None:
        """Prepare overlapping bodies at rest for `reduce_overlap`, which pushes them apart. Only pairs with a body of `which` count.

        A node that lies in another body without contact force gets a contact without force. Three kinds of bonds change:

        - A node lies in the body to which it is bonded, but its bond is compressed by less than half of the node's depth: the surface
          has folded at the bond's triangle. The bond moves to the facet through which the node has entered.
        - A bond joins a body to a triangle, and a corner of the triangle lies deeper than PRESSED spacings in this body. Such bonds can
          hold the corner there with more than the theoretical strength of the metal: they start again without force.
        - A bond has so small an area, as between crushed facets, that it is too soft to keep its node out of the body. Its stiffness is
          increased, at most to the median of all bonds, so that its present force would compress it by FOLDED spacings.
        """
        if self.contact is None:
            return
        surfaces, x, bond = self.surfaces, self.target.nodes.x, self.bond
        depth = np.zeros(len(x))
        if bond is not None:  # bodies on both sides of the bonds, which do not change when bonds move
            node_of, triangle_of = (surfaces.body_of_node[ends] for ends in (bond.nodes, bond.triangles[:, 0]))
        for body, nodes, deep, facets in lying_inside(surfaces, x, which):
            np.maximum.at(depth, nodes, deep)
            if bond is None or len(nodes) == 0:
                continue
            spacing = surfaces.spacing(x, max(body, 1))
            pressed = nodes[(deep > PRESSED * spacing) & (deep < DEEPEST * spacing)]
            pins = np.flatnonzero(node_of == body)
            pins = pins[np.isin(bond.triangles[pins], pressed).any(axis=1)]
            bond.move(x, pins, bond.triangles[pins])
            folded = nodes[(deep > FOLDED * spacing) & (deep < DEEPEST * spacing)]
            # without loose bonds: the contact resists their compression
            rows = np.flatnonzero((triangle_of == body) & ~bond.loose)
            rows = rows[np.isin(bond.nodes[rows], folded)]
            row = np.searchsorted(nodes, bond.nodes[rows])
            squeezed = bond.compression(x, rows)
            outside = squeezed < 0.5 * deep[row]
            bond.move(x, rows[outside], surfaces.facets[facets[row[outside]]])
            soft = ~outside & (deep[row] > PRESSED * spacing) & (bond.damage[rows] == 0.0)
            bond.stiffen(x, rows[soft], squeezed[soft] / (FOLDED * spacing))
        self.contact.ignore_depth(depth)

    def reduce_overlap(self, share: float) -> None:
        """Multiply by `share` the depths that give no contact force, and the negative gaps of bonds that `separate` has moved."""
        for each in (self.contact, self.bond):
            if each is not None:
                each.reduce_overlap(share)

    def joined(
        self, splats: list[BodyState], adhesion: Adhesion, size: float, origin: Point, ratio: float | None, impact: int,
        bonded: tuple[np.ndarray, Bond] | None = None, partners: np.ndarray | None = None,
    ) -> "Bodies":  # fmt: skip
        """These bodies together with the finished splats of an impact, bonded by `adhesion`. Nodes are numbered outwards from origin
        (m). size (m): size of the elements; ratio: impact velocity divided by critical velocity; impact: number of the impact;
        bonded: positions (k,3) m of the points that are bonded at the end of the impact, and their bonds, if bonds act in the impact
        (`Adhesion.in_impact`). partners: mask of all bodies, the new ones included, to which the splats can bond, default all.

        The surfaces of the splats are fitted to those under them, so that contact starts without force. The result is not yet in
        equilibrium (`equilibrium.settle`). Raises SolverError when a splat cannot be fitted.
        """
        self.release_heat()
        fitted = [placed_on(splat, self.target, self.body, size) for splat in splats]
        parts = [domain_now(self.target, self.body)]
        parts += [domain_of(splat, f"{SPLAT}{self.count + i}") for i, splat in enumerate(fitted)]
        domain, rank = merge(parts, origin)
        new = self.remade(domain)
        new.impact = np.append(self.impact, np.full(len(splats), impact))
        bonds = []
        if self.bond is not None:
            self.bond.renumber(rank)
            bonds.append(self.bond)
        surfaces, x, reach = new.surfaces, new.target.nodes.x, NEAR * size
        buried, near = [self.buried], earlier_neighbours(surfaces, x, reach)
        for body in range(self.count, new.count):
            contact_pairs = interface(surfaces, x, body, reach, near[body])
            buried.append(_covered(contact_pairs, surfaces, x, body, near[body], reach))
            stiffness = penalty(float(new.target.laws["K"].min()), surfaces.spacing(x, body))
            if not adhesion.in_impact:
                chosen = contact_pairs.area > 0.0
                if partners is not None:
                    chosen &= partners[surfaces.body[contact_pairs.facet]]
                if chosen.any():
                    chosen &= _bonded(contact_pairs, surfaces, new.target, adhesion, ratio)
                if chosen.any():
                    bonds.append(Bond.between(contact_pairs.only(chosen), surfaces, x, stiffness, **adhesion.law()))
            elif bonded is not None and len(bonded[0]):
                away, row = cKDTree(bonded[0]).query(x[contact_pairs.nodes])
                chosen = (contact_pairs.area > 0.0) & (away <= size)
                if partners is not None:
                    chosen &= partners[surfaces.body[contact_pairs.facet]]
                if chosen.any():
                    bonds.append(_continued(bonded[1], row[chosen], contact_pairs.only(chosen), surfaces, x, stiffness))
        new.bond = Bond.joined(bonds) if bonds else None
        new.buried = np.unique(np.concatenate(buried)).astype(np.int64)
        past = self.past()
        new.touch(past and past.renumbered(rank[: len(self.target.nodes.x)], len(new.target.nodes.x)))
        return new

    def renumbered(self, *origins: Point, shell: float = 0.0) -> "Bodies":
        """The same bodies, numbered outwards from the nearest of the points `origins`, in shells of thickness `shell` (m; see
        `merge`). Only elements near these points are active."""
        self.release_heat()
        domain, rank = merge([domain_now(self.target, self.body)], *origins, shell=shell)
        return self.with_domain(domain, rank, self.buried)

    def with_domain(self, domain: Domain, rank: np.ndarray, buried: np.ndarray) -> "Bodies":
        """The same bodies, with their bonds and contact, on another domain. rank: new index of each node, -1 for a removed node;
        buried: facets of the new domain that nothing can reach. The bonds of these bodies pass to the result, renumbered."""
        new = self.remade(domain)
        if self.bond is not None:
            self.bond.renumber(rank)
        new.bond, new.buried = self.bond, buried
        if (past := self.past()) is not None:
            new.touch(past.renumbered(rank, len(new.target.nodes.x)))
        return new

    def attached(self, embedded: Iterable[int] = (), reach: float = 0.0) -> np.ndarray:
        """Mask (bodies,) of the bodies that are connected to the substrate by unbroken bonds, directly or through other bodies. The
        bodies `embedded` are also connected to what they touch, within `reach` m.

        Mechanical interlocking of other splats is not modelled.
        """
        pairs = np.zeros((2, 0), np.int64)
        if self.bond is not None:
            owner = np.zeros(len(self.target.nodes.x), np.int64)
            owner[self.target.mesh.conn] = self.body[:, None]
            pairs = owner[np.stack([self.bond.nodes, self.bond.triangles[:, 0]])[:, ~self.bond.broken]]
        surfaces, x = self.surfaces, self.target.nodes.x
        for body in embedded:
            near = neighbours(*surfaces.boxes(x), body, reach)
            facet = interface(surfaces, x, body, reach, near).facet if near else np.zeros(0, int)
            under = np.unique(surfaces.body[facet])
            pairs = np.concatenate([pairs, [np.full(len(under), body), under]], axis=1)
        part = connected_parts(pairs.T, self.count)[1]
        return np.asarray(part == part[0])

    def without(self, gone: np.ndarray, size: float) -> "Bodies":
        """These bodies without those of the mask `gone` (bodies,), and without the contact and the bonds of the removed bodies. size
        (m): size of the splats' elements.

        The result is not in equilibrium. Facets that the removed bodies covered become reachable again.
        """
        self.release_heat()
        reach = NEAR * size
        is_near, freed = self._around(np.flatnonzero(gone), reach)
        part, mesh = select(domain_now(self.target, self.body), ~gone[self.body]), self.target.mesh
        node, facet = new_indices(part.nodes, len(mesh.points)), new_indices(part.facets, len(mesh.facets))
        if self.bond is not None:
            self.bond.drop((node[self.bond.nodes] < 0) | (node[self.bond.triangles[:, 0]] < 0))
        buried = facet[self.buried]
        new = self.with_domain(part.domain, node, buried[buried >= 0])
        new.impact = self.impact[~gone]
        surfaces, x = new.surfaces, new.target.nodes.x
        covered = [
            _covered(interface(surfaces, x, body, reach, near), surfaces, x, body, near, reach)
            for body, near in enumerate(earlier_neighbours(surfaces, x, reach, is_near[~gone])) if near
        ]  # fmt: skip
        bare = np.setdiff1d(facet[freed], np.concatenate([freed[:0], *covered]))
        new.buried = np.setdiff1d(new.buried, bare)
        return new

    def _around(self, gone: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Mask (bodies,) of the bodies that can cover a facet within `reach` m of bodies `gone` (g,), and the buried facets there."""
        low, high = self.surfaces.boxes(self.target.nodes.x)
        is_near, facets = np.zeros(self.count, bool), [self.buried[:0]]
        for body in gone:
            is_near[list(neighbours(low, high, body, 2.0 * reach))] = True
            box = low[body] - reach, high[body] + reach
            facets.append(broad.facets_within(self.target.nodes.x, self.surfaces.facets, self.buried, *box))
        return is_near, np.unique(np.concatenate(facets))

    def remade(self, domain: Domain) -> "Bodies":
        """New `Bodies` on a changed domain. Their energy balance continues from that of these bodies."""
        target = Target(
            domain.mesh, domain.laws, domain.elements.T, law_of=domain.body, fixed=self.fixed, absorbing=self.absorbing,
            conduction=self.target.conduction is not None, track_wave=bool(np.isfinite(self.target.reach)),
        )  # fmt: skip
        target.start_from(domain.nodes, domain.elements, self.target)
        return Bodies(target, domain.body, self.fixed, self.absorbing, self.friction, impact=self.impact)

    def touch(self, past: ContactPast | None = None) -> None:
        """Set up the contact between bodies in their present positions. It continues from the `past` of another contact."""
        self.placed = self.target.nodes.x.copy()
        self._contact, self._past = None, past or ContactPast(new_history(len(self.placed)))


def _check(state: BodiesState) -> None:
    """Raise CheckpointError if lengths of arrays do not fit the mesh, or indices refer to rows that do not exist."""
    mesh, n, m = state.mesh, len(state.mesh.points), len(state.mesh.conn)
    facets, placed = len(mesh.facets), [] if state.placed is None else [state.placed]
    by_node = (mesh.node_volume, mesh.reach_node, state.target.nodes.x, *placed)
    by_element = (mesh.B, mesh.V0, mesh.reach_element, state.body, state.target.elements.T)
    if len(state.impact) != len(state.laws):
        raise unfit("the number of the impact is missing for some bodies")
    fits = all(len(a) == n for a in by_node) and all(len(a) == m for a in by_element)
    if not fits or len(mesh.facet_element) != facets:
        raise unfit("mesh and fields of the target have different lengths")
    if not {"top", "bottom", "sides"} <= set(mesh.sets):
        raise unfit("the mesh lacks the faces of the substrate")
    for ids in mesh.sets.values():
        if ids.dtype.kind != "i" or ids.ndim != 1 or (ids.size and not 0 <= ids.min() <= ids.max() < facets):
            raise unfit("a face of the body refers to triangles that do not exist")
    for record in (mesh, state, *([] if state.bond is None else [state.bond])):
        check_indices(record, nodes=n, points=n, elements=m, facets=facets, laws=len(state.laws))


def _bonded(pairs: Interface, surfaces: Surfaces, target: Target, law: Adhesion, ratio: float | None) -> np.ndarray:
    """Mask (n,) of the nodes that meet the criterion of bonding of `law`. Strain and pressure: the larger value of the two sides."""
    strain = np.maximum(*pairs.behind(surfaces, target.elements.eps_p))
    pressure = np.maximum(*pairs.behind(surfaces, target.nodes.p[target.mesh.conn].mean(axis=1)))
    return law.bonded(len(pairs.nodes), strain, pressure, ratio)


def _continued(
    bonded: Bond, row: np.ndarray, where: Interface, surfaces: Surfaces, x: np.ndarray, stiffness: float
) -> Bond:
    """New bonds at an interface of n nodes. Bond i gets strength, energy and damage of the bond row[i] (n,) of `bonded`."""
    (strength, shear_strength), (energy, shear_energy) = bonded.strength[row].T, bonded.energy[row].T
    law = {"strength": strength, "energy": energy, "shear_strength": shear_strength, "shear_energy": shear_energy}
    bond = Bond.between(where, surfaces, x, stiffness, **law)
    bond.damage[:] = bonded.damage[row]
    return bond


def _covered(
    contact_pairs: Interface, surfaces: Surfaces, x: np.ndarray, body: int, near: tuple[int, ...], tolerance: float
) -> np.ndarray:
    """Facets in full contact, of a body and of the earlier bodies `near` it (`earlier_neighbours`): all their nodes, and all nodes of
    facets that share a node with them, lie within `tolerance` m of the other body.

    Facets at the rim of the contact stay in the contact search: without them a point could get a wrong facet and a false depth there.
    """
    covered = []
    for side, others in ((body, None), *((b, (body,)) for b in near)):
        nodes = contact_pairs.nodes if others is None else interface(surfaces, x, side, tolerance, others).nodes
        own = surfaces.facets_of(side)
        corners = surfaces.facets[own]
        rim = np.unique(corners[~np.isin(corners, nodes).all(axis=1)])
        covered.append(own[~np.isin(corners, rim).any(axis=1)])
    return np.concatenate(covered)
