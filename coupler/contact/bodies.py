"""Contact between the bodies of one finite-element domain: unilateral, with friction, by the kernels of `PointContact`."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from ..errors import CheckpointError, SolverError
from ..state.arrays import SpringTable
from ..state.records import Shape
from . import broad
from .bond import Bond
from .closest import ANY
from .kernels import ALL, UNKNOWN
from .penalty import ContactState, PointContact, SideBySide
from .surfaces import Surfaces, neighbours

SKIN = 0.15  # spacings that a search looks farther than it must, so that it holds while surfaces move by that
JUMP = 0.1  # spacings in one step: bodies move by far less against each other


def new_history(nodes: int) -> np.ndarray:
    """What `BodyContact.history` has for nodes that have never touched."""
    history = np.zeros((nodes, 7))
    history[:, 4] = UNKNOWN
    return history


class ContactPast(NamedTuple):
    """What a contact between bodies leaves to that between others. nodes (N,7): what each node remembers, see `PointContact.history`;
    lost, friction_heat, dropped_energy (J), dropped: see `BodyContact`."""

    nodes: np.ndarray
    lost: float = 0.0
    friction_heat: float = 0.0
    dropped_energy: float = 0.0
    dropped: int = 0

    def on(self, node: np.ndarray, count: int) -> "ContactPast":
        """The same for `count` other nodes, of which node (N,) is each of these, -1 of one that is not there."""
        nodes, kept = new_history(count), node >= 0
        nodes[node[kept]] = self.nodes[kept]
        return self._replace(nodes=nodes)


@dataclass
class _Side:
    """The surface nodes of one body against facets of others.

    facets: ids in `Surfaces`; near: those of them around the nodes at the last search, known: which these are; idle: none touches.
    What was found then holds while both surfaces move against each other by `reach` m, and up to `resting` active nodes; corners: nodes
    of those facets, places: where the own nodes and these were. partners: bodies that the facets belong to; partner_nodes: nodes of all
    facets; clear: m that others than the known ones were away when the bodies had gone as far as `since` (bodies,) m.
    """

    nodes: np.ndarray
    facets: np.ndarray
    contact: PointContact
    near: np.ndarray
    known: np.ndarray
    body: int
    partners: np.ndarray
    partner_nodes: np.ndarray
    since: np.ndarray
    clear: float = -np.inf
    idle: bool = True
    reach: float = -np.inf
    resting: float = np.inf
    corners: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    places: tuple[np.ndarray, np.ndarray] = (np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(frozen=True)
class BodyContactState:
    """lost: energy (J) that the handing over of nodes by bonds has lost; sides: contact of each body;
    held (N,): nodes whose compression a bond resists."""

    lost: float
    sides: list[ContactState]
    held: Annotated[np.ndarray, Shape(-1, dtype=bool)]


class BodyContact:
    """Surface nodes of each body against the facets of all others, so that neither side of a pair lies in the other.

    The same sums as between particle and target: penalty k = factor K a / h for each node of both sides (K the softer bulk
    modulus, a the mean area of a node, h the spacing of its body's surface, for the substrate, whose own grows outwards, of the first
    splat's); Coulomb friction with history, forces equal and opposite in force and moment. Nodes
    that a bond holds to a body meet the others; those of the other side between them meet both. Bodies fitted together
    (`Interface.fitted`) begin all but without a force.
    """

    def __init__(
        self,
        surfaces: Surfaces,
        x: np.ndarray,
        bulk_modulus: Sequence[float],
        friction: float,
        factor: float = 1.0,
    ):
        """x (N,3) m positions; bulk_modulus (bodies,) Pa; friction: Coulomb's coefficient; factor: of the stiffness. Raises
        SolverError where the number of bulk moduli is not that of the bodies."""
        self.surfaces, self.friction, self.bulk_modulus = surfaces, friction, list(bulk_modulus)
        if len(self.bulk_modulus) != surfaces.bodies:
            raise SolverError(f"contact of {surfaces.bodies} bodies needs as many bulk moduli")
        self.lost = 0.0  # what the handing over of nodes by bonds has lost (gained: negative), J
        self._body_of = np.full(len(x), ANY)
        self._held, self._is_new = np.zeros(len(x), bool), True  # the first search takes over what bonds hold
        self._body_of[surfaces.facets] = surfaces.body[:, None]
        count = len(surfaces.facets)
        self._all = np.arange(count)
        self._low, self._high = np.zeros((count, 3)), np.zeros((count, 3))
        broad.facet_boxes(x, surfaces.facets, self._all, self._low, self._high)
        low, high = surfaces.boxes(x)
        # surfaces farther apart than half the size of the largest splat do not come together while they are here
        reach = 0.5 * float((high[1:] - low[1:]).max(initial=0.0))
        bodies = range(surfaces.bodies) if surfaces.bodies > 1 else ()
        self._sides = []
        for body in bodies:
            partners = neighbours(low, high, body, reach)
            least, most = low[body] - reach, high[body] + reach
            near = [broad.boxes_within(surfaces.facets_of(b), self._low, self._high, least, most) for b in partners]
            self._sides.append(self._side(body, x, factor, partners, np.sort(np.concatenate(near or [self._all[:0]]))))
        self._step = SideBySide([side.contact for side in self._sides], [side.nodes for side in self._sides])
        self._way, self._before = np.zeros(len(self._sides)), x[self._step.node_of]
        #: Step (s) of the penalty springs, and the masses and the number of moving nodes that it is of.
        self._stable_dt, self._weighed, self._moving = np.inf, np.zeros(0), 0
        elements = int(surfaces.element.max(initial=0)) + 1
        pairs = np.sort(surfaces.facets.ravel() * elements + np.repeat(surfaces.element, 3))
        self._behind = np.divmod(pairs[np.diff(pairs, prepend=-1) > 0], elements)  # pairs of surface node and element
        self._share_of_node = 1.0 / np.maximum(np.bincount(self._behind[0], minlength=len(x)), 1)

    def _side(self, body: int, x: np.ndarray, factor: float, partners: Sequence[int], ids: np.ndarray) -> _Side:
        s, alike = self.surfaces, max(body, 1)  # the stiffness does not change when later bodies join
        nodes, spacing = s.nodes_of(body), s.spacing(x, alike)
        area = 0.5 * np.sqrt(3.0) * spacing**2  # two equilateral triangles for each node
        softer = min(self.bulk_modulus[: alike + 1])
        contact = PointContact(
            len(nodes), s.facets[ids], spacing, area, softer, self.friction, factor=factor, facet_ids=ids, jump=JUMP,
            owner=s.body[ids],
        )  # fmt: skip
        return _Side(
            nodes,
            ids,
            contact,
            ids[:0],
            np.zeros(len(ids), bool),
            body,
            np.array(partners, np.int64),
            s.corners_of(ids),
            np.zeros(s.bodies),
        )

    @property
    def penalty_energy(self) -> float:
        """Energy stored in the penalty and friction springs, J."""
        return self._step.energy

    @property
    def _energy(self) -> float:
        """What it stores, has turned into heat and has dropped, J."""
        return self.penalty_energy + self.friction_heat + self.dropped_energy

    @property
    def friction_heat(self) -> float:
        """Heat of friction so far, J."""
        return sum(side.contact.friction_heat for side in self._sides)

    @property
    def dropped(self) -> int:
        """How many nodes have lost their contact as too deep so far."""
        return sum(side.contact.dropped for side in self._sides)

    @property
    def dropped_energy(self) -> float:
        """Energy (J) that the springs of these held."""
        return sum(side.contact.dropped_energy for side in self._sides)

    def mass_for(self, step: float) -> float:
        """The mass (kg) that nodes need so that the penalty springs bear a step (s), see `stable_dt`."""
        return max((side.contact.mass_for(step) for side in self._sides), default=0.0)

    def stable_dt(self, mass: np.ndarray, alone: float = np.inf, moving: int | None = None) -> float:
        """Stable time step (s) of the penalty springs between nodes of mass (N,) kg, of which only the first `moving` ever move
        (default: all).

        alone: the step (s) the bodies can take without them; frequencies of systems that act in parallel add up in squares at most, so
        that the step of both together is the shorter.
        """
        moving = len(mass) if moving is None else moving
        if mass is not self._weighed or moving != self._moving:
            # not only what the last search has seen: a resumed run searches at other times
            self._weighed, self._moving, self._stable_dt = mass, moving, np.inf
            for side in self._sides:
                own, others = (nodes[nodes < moving] for nodes in (side.nodes, side.partner_nodes))
                if len(side.facets) and len(own) + len(others) > 0:
                    softness = 1.0 / float(mass[own].min(initial=np.inf))
                    self._stable_dt = min(self._stable_dt, side.contact.stable_dt(softness, mass[others]))
        return alone if self._stable_dt == np.inf else float(1.0 / np.sqrt(1.0 / self._stable_dt**2 + 1.0 / alone**2))

    def load(self, size: int) -> np.ndarray:
        """What the springs of all that may touch can add to each of `size` nodes in the bound on omega^2, N/m; see `Bond.load`."""
        load = np.zeros(size)
        for side in self._sides:
            if not side.idle:
                load[side.nodes] += 2.0 * side.contact.stiffness
                load[side.nodes[side.contact.between_bodies()]] += 2.0 * side.contact.stiffness
                load[side.corners] += 4.0 * side.contact.stiffness
        return load

    def springs(self) -> list[SpringTable]:
        """Of all that may touch before the next search."""
        return [table for side in self._sides if not side.idle for table in side.contact.springs(side.nodes)]

    def search(
        self, x: np.ndarray, travel: float, bond: Bond | None = None, active: int | None = None, v: np.ndarray | None = None
    ) -> None:  # fmt: skip
        """Find the pairs that can touch before surfaces have moved `travel` m against each other. x (N,3) m.

        v (N,3) m/s: then slow surfaces move by their share of `travel` only. active: number of active nodes (default: all); what
        does not move keeps its forces.
        Nodes whose bond has broken or slid far come over from it (`Bond.release`); what its compression held and the contact
        does not goes to `lost`. Raises SolverError when the positions are no longer numbers.
        """
        if not np.isfinite(x).all():
            raise SolverError("positions are no longer numbers: try a smaller time step or smaller elements")
        given_up = bond.release() if bond is not None else 0.0
        held, partner = np.zeros(len(x), bool), np.full(len(x), ANY)
        if bond is not None:
            held[bond.held] = True
            partner[bond.held] = self._body_of[bond.triangles[~bond.loose, 0]]
        handed_over = (held != self._held) & (not self._is_new)
        changed = bool(handed_over.any()) or given_up > 0.0
        before, self._held, self._is_new = self._energy, held, False
        broad.facet_boxes(x, self.surfaces.facets, self._all, self._low, self._high)
        speed = np.sqrt(np.einsum("ij,ij->i", v, v)) if v is not None else np.zeros(0)
        fastest, searched = float(speed.max(initial=0.0)), False
        surface, bounds = self._step.node_of, self._step.bounds
        broad.ways(x, surface, bounds, self._before, self._way)
        for side in self._sides:
            new = handed_over[side.nodes]
            side.contact.partner[:] = partner[side.nodes]
            if new.any() or self._inactive(side, active) or not self._holds(side, x, travel, speed, fastest, active):
                side.contact.forget(new)
                self._search_side(side, x, travel, speed, fastest, active)
                searched = True
        if searched:
            self._step.arrange([i for i, side in enumerate(self._sides) if not side.idle])
        self._step.refresh(x)
        if changed:  # a step of no time tells what the contact holds with its new nodes
            rest = np.zeros_like(x)
            self.forces(0.0, x, rest, rest.copy(), active)
            self.lost += given_up + before - self._energy

    @staticmethod
    def _own_travel(side: _Side, travel: float, speed: np.ndarray, fastest: float) -> float:
        """How far a side and the facets near it move against each other, where the fastest node moves by half of `travel` m."""
        if fastest == 0.0:
            return travel
        together = broad.largest(speed, side.nodes) + broad.largest(speed, side.corners)
        return travel * min(1.0, together / fastest)

    def _holds(
        self, side: _Side, x: np.ndarray, travel: float, speed: np.ndarray, fastest: float, active: int | None
    ) -> bool:
        """Whether the last search of a side still holds, and no other facet can come near while all move by `travel` m."""
        own = self._own_travel(side, travel, speed, fastest)
        if (np.inf if active is None else active) > side.resting:
            return False
        if side.reach <= own or len(side.places[0]) == 0:
            return False
        moved = broad.farthest(x, side.nodes, side.places[0]) + broad.farthest(x, side.corners, side.places[1])
        if moved + own > side.reach:
            return False
        needed = 0.5 * side.contact.spacing + travel
        if side.clear - self._approach(side) <= needed:
            side.clear = broad.nearest_box(x, side.nodes, side.facets, side.known, self._low, self._high)
            side.since = self._way.copy()
        return bool(side.clear - self._approach(side) > needed)

    def _approach(self, side: _Side) -> float:
        """How much closer a side and all that it may ever touch can have come since `side.clear` was measured, m."""
        way = self._way - side.since
        return float(way[side.body] + way[side.partners].max(initial=0.0))

    def _search_side(
        self, side: _Side, x: np.ndarray, travel: float, speed: np.ndarray, fastest: float, active: int | None
    ) -> None:
        """Find what one side can touch. speed, fastest: m/s; the rest as in `search`."""
        c = side.contact
        side.clear, side.since = c.spacing + 2.0 * travel, self._way.copy()
        side.near, side.reach = self._around(side, x, side.clear), -np.inf
        side.known[:] = False
        side.known[np.searchsorted(side.facets, side.near)] = True
        side.corners, side.places = broad.corners(self.surfaces.facets, side.near, len(x)), (x[:0], x[:0])
        reach = self._own_travel(side, travel, speed, fastest) + SKIN * c.spacing
        if self._inactive(side, active):
            side.idle = True
            return
        side.idle = len(side.near) == 0 and not c.spring.any()
        side.resting = np.inf
        if side.idle:
            c.depth[:] = c.second_depth[:] = 0.0
        else:
            moving = (None, 0) if active is None else (side.nodes, active)
            side.resting = c.search(x[side.nodes], x, reach, np.flatnonzero(side.known), None, *moving)
            side.idle = len(c.rows) == 0
        side.reach, side.places = reach, (x[side.nodes], x[side.corners])
        if side.idle:
            c.sums[:] = 0.0

    def _inactive(self, side: _Side, active: int | None) -> bool:
        """Whether neither a side's nodes nor those of the facets near them are among the first `active` ones, where not all are."""
        if active is None:
            return False
        return bool(side.nodes[0] >= active) and (len(side.corners) == 0 or bool(side.corners[0] >= active))

    def _around(self, side: _Side, x: np.ndarray, margin: float) -> np.ndarray:
        """Those of a side's facets whose boxes come within a margin (m) of the box around its nodes."""
        own = x[side.nodes]
        least, most = broad.bounds(own, own)
        return broad.boxes_within(side.facets, self._low, self._high, least - margin, most + margin)

    def meet(self, depth: np.ndarray) -> None:
        """Let nodes without a contact force, depth (N,) m deep in another body, begin one that ignores all of this depth."""
        for side in self._sides:
            own, c = depth[side.nodes], side.contact
            new = (own > 0.0) & (c.depth == 0.0)
            if new.any():
                c.ignored[new], side.reach = own[new], -np.inf

    def ease(self, share: float) -> None:
        """Ignore only this share of the depths that the contacts of active nodes ignore: the bodies are pushed apart."""
        for side in self._sides:
            rows = side.contact.rows
            if not side.idle:
                ignored = side.contact.ignored[rows]
                side.contact.ignored[rows] = np.where((ignored > 0.0) & (ignored < ALL), share * ignored, ignored)
                side.contact.second_ignored[rows] *= share

    def forces(self, dt: float, x: np.ndarray, v: np.ndarray, f: np.ndarray, active: int | None = None) -> None:
        """Add the contact forces of this instant to f (N,3) N; friction moves on by dt s. x m, v m/s (N,3). active: as in `search`."""
        self._step.forces(dt, x, v, f, len(x) if active is None else active)

    def heat(self) -> tuple[np.ndarray, np.ndarray]:
        """Heat of friction since the last call, for `Target.warm`: (elements, J), those behind nodes and facets that rubbed."""
        of_node, of_facet = np.zeros(len(self._held)), np.zeros(len(self.surfaces.facets))
        for side in self._sides:
            if side.contact.heat_point.any():  # one of its points and one of its facets
                of_node[side.nodes] += side.contact.heat_point
                of_facet[side.facets] += side.contact.heat_facet
                side.contact.heat_point[:], side.contact.heat_facet[:] = 0.0, 0.0
        of_pair = (of_node * self._share_of_node)[self._behind[0]]
        pairs, facets = np.flatnonzero(of_pair), np.flatnonzero(of_facet)
        elements = np.concatenate([self._behind[1][pairs], self.surfaces.element[facets]])
        return elements, np.concatenate([of_pair[pairs], of_facet[facets]])

    def state(self) -> BodyContactState:
        """Everything there is to keep."""
        return BodyContactState(self.lost, [side.contact.state() for side in self._sides], self._held.copy())

    def restore(self, state: BodyContactState) -> None:
        """Go back to a `state` of a contact of the same surfaces; a search comes next. Raises CheckpointError where it does not fit."""
        if len(state.sides) != len(self._sides) or len(state.held) != len(self._held):
            raise CheckpointError("a state does not fit: the contact has other bodies")
        self._held, self._is_new, self.lost = state.held.copy(), False, state.lost
        for side, kept in zip(self._sides, state.sides, strict=True):
            side.contact.restore(kept)
            side.reach = -np.inf

    def past(self) -> ContactPast:
        """What the contact of other bodies goes on from. Heat must have been fetched before."""
        nodes = new_history(len(self._held))
        for side in self._sides:
            nodes[side.nodes] = side.contact.history()
        return ContactPast(nodes, self.lost, self.friction_heat, self.dropped_energy, self.dropped)

    def go_on(self, past: ContactPast) -> None:
        """Take over what the contact of other bodies has left, for the nodes of these: friction springs and ledger continue."""
        for side in self._sides:
            side.contact.remember(past.nodes[side.nodes])
            side.contact.friction_heat = side.contact.dropped_energy = 0.0
            side.contact.dropped, side.reach = 0, -np.inf
        self.lost = past.lost
        if self._sides:
            first = self._sides[0].contact
            first.friction_heat, first.dropped_energy, first.dropped = past[2:]
