"""Contact between the points of a particle and the facets of the target: search now and then, forces each step."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import DTypeLike

from ..errors import CheckpointError, SolverError
from ..state.arrays import Floats, Ints, SpringTable
from ..state.loops import PARTS
from ..state.records import Shape, assign, collect
from ..state.threads import share, together
from . import broad
from . import kernels as k
from .closest import ANY, FACE, box_faces, faces_of, narrow, reachable, several_bodies

# Of a step: a point bears a spring to a second body too, where its mass is at least 0.78 of that of the lightest node.
WITH_SECOND = 0.8
JUMP = 0.2  # spacings: twice what a particle of a quarter of the speed of sound moves in a step


@dataclass(frozen=True)
class ContactState:
    """spring (n,3) N: of friction, depth (n,) m: penetration that gives force, ignored (n,) m: penetration beside it that gives none
    (`kernels.follow`), second_depth, second_ignored (n,) m: the same in the body in which it lies second deepest, body, second_body
    (n,): which these are (`kernels.end_look`), heat_point (n,) J of
    each point; heat_facet (k,) J; sums (4,): energy of the penalty and friction springs, heat
    of the last step, J, and the number of points that touch; friction_heat: so far, J; dropped: points that have lost their contact
    as too deep so far, dropped_energy: what the springs of these held, and of those whose depth has jumped, J."""

    friction_heat: float
    dropped: int
    dropped_energy: float
    spring: Annotated[np.ndarray, Shape(-1, 3)]
    depth: Annotated[np.ndarray, Shape(-1)]
    ignored: Annotated[np.ndarray, Shape(-1)]
    second_depth: Annotated[np.ndarray, Shape(-1)]
    second_ignored: Annotated[np.ndarray, Shape(-1)]
    body: Annotated[np.ndarray, Shape(-1, dtype=np.int64)]
    second_body: Annotated[np.ndarray, Shape(-1, dtype=np.int64)]
    heat_point: Annotated[np.ndarray, Shape(-1)]
    heat_facet: Annotated[np.ndarray, Shape(-1)]
    sums: Annotated[np.ndarray, Shape(4)]


class PointContact:
    """Points on one surface against the triangles of another, with penalty and Coulomb friction.

    The stiffness rule: a point that stands for an area a of its surface gets k = factor K a / dx (K the softer bulk
    modulus, dx the particle's spacing), so that a pressure p presses the surfaces p dx / (factor K) into each
    other, one twentieth of a spacing at 10 GPa in nickel; the contact is then about as stiff as a layer of the
    material one spacing thick and does not set the time step. Tangential stiffness: half of it.
    """

    def __init__(
        self,
        points: int,
        facets: np.ndarray,
        spacing: float,
        area: float,
        bulk_modulus: float,
        friction: float,
        share: float = 0.5,
        factor: float = 1.0,
        facet_ids: np.ndarray | None = None,
        jump: float = np.inf,
        owner: np.ndarray | None = None,
    ):
        """facets (k,3) node indices, outward; facet_ids (k,): their numbers in the target; owner (k,): the body of each, of which each
        has all of its facets here (default: all are one body's); spacing m of the particle;
        area m2 of a point; bulk_modulus Pa; share: of the friction heat, for the side of the points; factor: of the stiffness;
        jump: spacings that a point may move inwards in one step. A point found deeper did not enter through this surface: it
        has no contact until it is outside again.
        """
        self.facets = np.ascontiguousarray(facets, np.int64)
        self.facet_ids = np.arange(len(facets)) if facet_ids is None else facet_ids
        self.owner = np.zeros(len(facets), np.int64) if owner is None else owner
        #: The body that each point (n,) does not meet, because a bond holds it there; ANY for none.
        self.partner: Ints = np.full(points, ANY)
        self.spacing = spacing
        self.stiffness = factor * bulk_modulus * area / spacing
        self.tangential = 0.5 * self.stiffness
        self.friction, self.share = friction, share
        self.spring, self.depth, self.ignored = np.zeros((points, 3)), np.zeros(points), np.full(points, k.UNKNOWN)
        self.second_depth, self.second_ignored = np.zeros((2, points))
        self.body: Ints = np.full(points, ANY)
        self.second_body: Ints = np.full(points, ANY)
        self.heat_point, self.heat_facet = np.zeros(points), np.zeros(len(facets))
        self.sums = np.zeros(4)
        self.friction_heat = self.dropped_energy = 0.0
        self.dropped = 0
        #: The points that may touch before the next search, ascending: `forces` reads and writes only these. Some may be taken out.
        self.rows = np.zeros(0, np.int64)
        #: The candidates of the last search: their numbers, and they with the boxes around them.
        self._ids, self._faces = np.arange(len(facets)), np.zeros(0, FACE)
        self._start: Ints = np.zeros(points + 1, np.int64)
        self._boxes: Ints = np.zeros(0, np.int64)
        self._low, self._high = np.zeros((len(facets), 3)), np.zeros((len(facets), 3))
        self._nodes, self._way = np.zeros(0, np.int64), np.zeros(1)
        self._places, self._last = np.zeros((2, 0, 3))
        self._seen, self._room = np.zeros((points, 3)), np.zeros(points)
        self._inner: Ints = np.zeros(points, np.int64)
        self._within, self._at = np.zeros(points), np.zeros((points, 3))
        #: Signed distance of the points `rows` from the facets, m.
        self.gap: np.ndarray
        self._nearest, self._foot, self.gap = np.full(points, -1), np.zeros((points, 3)), np.zeros(points)
        self._second, self._second_foot, self._second_gap = np.full(points, -1), np.zeros((points, 3)), np.zeros(points)
        self._capacity = 64 * points
        self._margin, self._jump = np.inf, jump * spacing

    @property
    def penalty_energy(self) -> float:
        """Energy stored in the penalty and friction springs, J."""
        return float(self.sums[0] + self.sums[1])

    def state(self) -> ContactState:
        """The history that later steps need, and the energies."""
        return collect(ContactState, self)

    def restore(self, state: ContactState) -> None:
        """Put a `state` into a contact of the same surfaces. Raises CheckpointError where it does not fit."""
        points = len(self.depth)
        if not len(state.depth) == len(state.spring) == points or len(state.heat_facet) != len(self.facets):
            raise CheckpointError("a state does not fit: the contact has other surfaces")
        assign(self, state)

    def history(self) -> np.ndarray:
        """What each point remembers (n,7): friction spring N, depth and ignored depth m, and those in the second body."""
        return np.column_stack([self.spring, self.depth, self.ignored, self.second_depth, self.second_ignored])

    def remember(self, history: np.ndarray) -> None:
        """Go on from what points have of another contact, see `history`; its energies follow."""
        self.spring[:] = history[:, :3]
        self.depth[:], self.ignored[:], self.second_depth[:], self.second_ignored[:] = history[:, 3:].T
        self.body[:] = self.second_body[:] = ANY  # the bodies had other numbers
        self.sums[0] = 0.5 * self.stiffness * float(self.depth @ self.depth + self.second_depth @ self.second_depth)
        self.sums[1] = 0.5 * float(np.einsum("ij,ij->", self.spring, self.spring)) / self.tangential

    def forget(self, which: np.ndarray) -> None:
        """Let the points of a mask (n,) begin anew: bonds have taken them, or let go of them."""
        self.spring[which], self.depth[which], self.ignored[which] = 0.0, 0.0, k.UNKNOWN
        self.second_depth[which] = self.second_ignored[which] = 0.0
        self.body[which] = self.second_body[which] = ANY

    def stable_dt(self, softness: float, node_mass: np.ndarray) -> float:
        """Stable time step (s) of the penalty springs between points of inverse mass `softness` (1/kg) and nodes (kg)."""
        lightest = float(np.min(node_mass)) if len(node_mass) else np.inf
        return WITH_SECOND * 2.0 / np.sqrt(self.stiffness * (softness + 1.0 / lightest))

    def mass_for(self, step: float) -> float:
        """The mass (kg) of points and nodes with which the springs bear a step (s)."""
        return 2.0 * self.stiffness * (0.5 * step / WITH_SECOND) ** 2

    def search(
        self, xp: np.ndarray, x: np.ndarray, travel: float, among: np.ndarray | None = None, always: np.ndarray | None = None,
        nodes: np.ndarray | None = None, active: int = 0,
    ) -> float:  # fmt: skip
        """Find the pairs that can touch before the surfaces have moved `travel` m against each other.

        xp (n,3) points, x (N,3) nodes. among: places in `facets` of those that come into question (default: all). always: points that
        `rows` has in any case. nodes (n,): that the points are, where only the first `active` ones move: a point keeps its forces and
        is not among `rows` where neither it nor a facet near it moves. Returns the number of active nodes from which on the search no
        longer holds. Raises SolverError when the positions are no longer numbers.
        """
        ids = np.arange(len(self.facets)) if among is None else among
        if not (np.isfinite(xp).all() and np.isfinite(x).all()):
            raise SolverError("positions are no longer numbers: try a smaller time step or more points")
        margin = 0.5 * self.spacing + travel  # half a spacing deep is as deep as a point may be lost
        self._margin = margin
        broad.facet_boxes(x, self.facets, ids, self._low, self._high)
        least, most = broad.bounds(xp, xp)
        near = broad.boxes_within(np.arange(len(ids)), self._low, self._high, least - margin, most + margin)
        self._ids = ids[near]
        low, high = self._low[near] - margin, self._high[near] + margin
        self._start, self._boxes, self._capacity = broad.pairs_within(xp, low, high, self.spacing, self._capacity)
        # points that remember a contact are visited too, so that what they remember is settled
        held = np.einsum("ij,ij->i", self.spring, self.spring) > 0
        if always is not None:
            held[always] = True
        rows = np.flatnonzero((np.diff(self._start) > 0) | held)
        away, holds = np.ones(len(xp), bool), np.inf
        if nodes is not None:  # what faces a point at rest may not be here: the contact of a cut ends at its rim
            still, holds = self._at_rest(rows, nodes, active)
            away[rows[still]] = False
            rows = rows[~still]
        self._nearest[:] = self._second[:] = -1
        self._within[:] = -np.inf  # all candidates are looked at
        # from here on facets move from zero; of points that were not among `rows` it is not known how near they were
        way = np.full(len(xp), np.inf)
        way[self.rows] = self._way[0] + broad.farthest(x, self._nodes, self._last)
        self._room -= way
        self._note_corners(x)
        self._look(xp, x, rows)
        # a tenth of a spacing for what the surfaces gain in speed
        close = (self._nearest[rows] >= 0) & (self.gap[rows] < travel + 0.1 * self.spacing)
        self.rows = rows[close | held[rows]]
        self._keep_reachable(xp, travel)
        away[self.rows] = False
        if nodes is not None:  # of the candidates that are left
            still, others = self._at_rest(self.rows, nodes, active)
            if still.any():
                holds, self.rows = min(holds, others), self.rows[~still]
                self._keep_reachable(xp, travel)
        self._ids = self._ids[broad.candidates_of(self.rows, self._start, self._boxes, len(self._ids))]
        self._note_corners(x)
        limit = k.deepest(self.rows, self._margin, self._jump, self.depth, self.ignored)
        narrow(
            self.rows, self._jump, xp, self._start, self._boxes, self._faces, limit, self.gap, self._nearest, self._second, self._inner,
            self._within, self._at,
        )  # fmt: skip
        self.depth[away] = self.second_depth[away] = 0.0
        away[rows] = False  # what has no candidate is outside
        self.ignored[away] = self.second_ignored[away] = 0.0
        self.body[away] = self.second_body[away] = ANY
        return holds

    def _at_rest(self, rows: np.ndarray, nodes: np.ndarray, active: int) -> tuple[np.ndarray, float]:
        """Which of the points `rows` (n,) bool do not move, and no facet near them, see `search`; the least node of all of these."""
        first = np.minimum(nodes[rows], broad.least_corners(rows, self._start, self._boxes, self._ids, self.facets))
        still = first >= active
        return still, float(first[still].min()) if still.any() else np.inf

    def _keep_reachable(self, xp: np.ndarray, travel: float) -> None:
        """Of the candidates of `rows`, those that they can meet before the surfaces have moved `travel` m against each other."""
        limit = k.deepest(self.rows, self._margin, self._jump, self.depth, self.ignored)
        self._start, self._boxes = reachable(
            self.rows, travel, xp, self._start, self._boxes, self._faces, limit, self.gap, self._nearest, self._second
        )  # fmt: skip

    def _note_corners(self, x: np.ndarray) -> None:
        """Remember where the facets in question are at a search."""
        self._faces = np.empty(len(self._ids), FACE)
        faces_of(self.facets, self._ids, self.owner, self._faces)
        box_faces(x, self._faces)
        self._nodes = broad.corners(self.facets, self._ids, len(x))
        self._places = x[self._nodes]
        self._last, self._way[0] = self._places.copy(), 0.0

    def touching(self, first: int, within: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Which of the first so many points touch in this step (k,), and what the target calls the facet that each is on (k,).

        within: m; points nearer than this count as touching, because a touching point can lose its contact for single steps.
        """
        if within > 0.0:
            rows = self.rows[self.rows < first]
            rows = rows[self.gap[rows] < within]
        else:
            rows = np.flatnonzero(self.depth[:first] > 0.0)
        rows = rows[self._nearest[rows] >= 0]
        return rows, self.facet_ids[self._ids[self._boxes[self._nearest[rows]]]]

    def springs(self, nodes: np.ndarray) -> list[SpringTable]:
        """Those of all points that may touch before the next search, at the places closest to them, and at those in a second body in
        which they lie now. nodes (n,): that the points are."""
        tables = []
        for nearest, foot in ((self._nearest, self._foot), (self._second, self._second_foot)):
            rows = self.rows[nearest[self.rows] >= 0]
            corners = self.facets[self._ids[self._boxes[nearest[rows]]]]
            tables.append(SpringTable.of(nodes[rows], corners, foot[rows], np.full(len(rows), self.stiffness)))
        return tables

    def between_bodies(self) -> np.ndarray:
        """Those of `rows` that may meet two bodies before the next search."""
        return self.rows[several_bodies(self.rows, self._start, self._boxes, self._faces)]

    def _look(self, xp: np.ndarray, x: np.ndarray, rows: np.ndarray) -> None:
        """Find the closest facet of those `rows` that may touch, and take the contact from those that lie too deep."""
        lost = np.zeros((PARTS, 3))
        together(
            k.look, rows,
            (xp, x, self._nodes, self._places, self._last, self._way, self._seen, self._room, self._nearest, len(x)),
            (self._way, self._margin, self._jump, xp, self._faces, self.partner, x, self._start, self._boxes, self._inner, self._within,
             self._at, self._seen, self._room, self._nearest, self._foot, self.gap, self._second, self._second_foot, self._second_gap,
             self.body, self.second_body, self.depth, self.ignored, self.second_depth, self.second_ignored, self.spring),
            np.empty(len(rows) + 1, np.int64), np.empty(1), lost,
        )  # fmt: skip
        self._drop(lost.sum(axis=0))

    def _drop(self, lost: np.ndarray) -> None:
        """Add the contacts that `kernels.end_look` has dropped, and their energy, to the ledger."""
        if lost.any():
            self.dropped += int(lost[0])
            self.dropped_energy += 0.5 * (self.stiffness * float(lost[1]) + float(lost[2]) / self.tangential)

    def forces(self, dt: float, xp: Floats, vp: Floats, x: Floats, v: Floats, f_point: Floats, f_node: Floats) -> None:
        """Add the contact forces of this instant to f_point (n,3) and f_node (N,3), N; friction moves on by dt s.

        Of xp, vp (n,3) only `rows` are read, of f_point only they are written.
        """
        self._look(xp, x, self.rows)
        k.contact_forces(
            dt, 1e-6 * self.spacing, self.stiffness, self.tangential, self.friction, xp, vp, self.rows,
            self._boxes, self._ids, self._faces, self._nearest, self._foot, self.gap, self.ignored, x, v, f_point, f_node,
            _NO_NODES, 0, self.spring, self.heat_point, self.heat_facet, self.share, self.sums, self.depth,
        )  # fmt: skip
        k.second_forces(
            1e-6 * self.spacing, self.stiffness, xp, self.rows, self._boxes, self._faces, self._second, self._second_foot,
            self._second_gap, self.second_ignored, x, f_point, f_node, _NO_NODES, 0, self.sums, self.second_depth,
        )  # fmt: skip
        self.friction_heat += float(self.sums[2])


_NO_NODES = np.zeros(0, np.int64)  # points that are no nodes all move
_OF_POINT = (
    "partner", "body", "second_body", "spring", "depth", "ignored", "second_depth", "second_ignored", "heat_point", "_inner",
    "_within", "_at", "_seen", "_room", "_nearest", "_foot", "gap", "_second", "_second_foot", "_second_gap",
)  # fmt: skip
_OF_FACET = ("heat_facet",)
LEAST_SIDES = 3  # in a range of a shared loop


class SideBySide:
    """Several contacts whose points are nodes of one domain, of N nodes: one compiled pass computes the step of all of them.

    Their arrays with a row for each point or facet lie one after the other in arrays of this; each contact keeps its own part. node_of
    (n,): node of each of their points; bounds (contacts+1,): where those of each contact begin and end.
    """

    def __init__(self, contacts: Sequence[PointContact], nodes: Sequence[np.ndarray]):
        """nodes: of each contact, the nodes (n,) that its points are. All contacts have the same friction and share."""
        self._contacts = list(contacts)
        self.node_of = _joined(nodes, np.int64)
        self.bounds, self._facets = _bounds(nodes), _bounds([c.facets for c in contacts])
        self._whole: dict[str, np.ndarray] = {}
        for names, bounds in ((_OF_POINT, self.bounds), (_OF_FACET, self._facets)):
            for name in names:
                self._whole[name] = _joined([getattr(c, name) for c in contacts])
                for c, lo, hi in zip(contacts, bounds, bounds[1:], strict=False):
                    setattr(c, name, self._whole[name][lo:hi])
        points = np.diff(self.bounds)
        self._stiffness = np.repeat([c.stiffness for c in contacts], points)
        self._tangential = np.repeat([c.tangential for c in contacts], points)
        self._x, self._v, self._f = np.zeros((3, len(self.node_of), 3))
        self.arrange([])

    def arrange(self, active: Sequence[int]) -> None:
        """Note what the last searches of the contacts `active` have found: the others have no part in a step."""
        chosen = [self._contacts[s] for s in active]
        self._active = chosen
        names = ("rows", "_start", "_boxes", "_ids", "_faces", "_nodes", "_places", "_last", "_way")
        searched = {name: [getattr(c, name) for c in chosen] for name in names}
        self._searched = {name: _joined(parts) for name, parts in searched.items()}
        rows, start, boxes, ids, nodes = (
            _bounds(searched[name]) for name in ("rows", "_start", "_boxes", "_ids", "_nodes")
        )
        which = np.asarray(active, np.int64)
        ends = [(b[:-1], b[1:]) for b in (rows, start, boxes, ids, nodes)]
        ends.insert(1, (self.bounds[which], self.bounds[which + 1]))
        ends.append((self._facets[which], self._facets[which + 1]))
        self._spans = np.array(ends, np.int64).reshape(14, -1).T.copy()
        self._numbers = np.array(
            [(c._margin, c._jump, 1e-6 * c.spacing, c.stiffness, c.tangential) for c in chosen]
        ).reshape(-1, 5)
        self._sums, self._lost = np.zeros((len(chosen), 4)), np.zeros((len(chosen), 3))
        self._met, self._meeting = np.zeros(rows[-1], np.int64), np.zeros(len(chosen), np.int64)
        self._is_unsettled = True
        for i, c in enumerate(chosen):  # what a step changes
            c._last, c._way = self._searched["_last"][nodes[i] : nodes[i + 1]], self._searched["_way"][i : i + 1]
            c._boxes = self._searched["_boxes"][boxes[i] : boxes[i + 1]]
            self._sums[i] = c.sums
            c.sums = self._sums[i]

    def refresh(self, x: Floats) -> None:
        """Bring the boxes of the last searches up to x (N,3) m: the less facets have left them, the fewer are looked at."""
        if not self._active:
            return
        w, near = self._whole, self._searched

        def bring_up(lo: int, hi: int) -> None:
            k.refresh_sides(
                lo, hi, self._spans, self._numbers, near["rows"], near["_start"], near["_boxes"], near["_faces"], near["_nodes"],
                near["_places"], self.node_of, x, self._x, w["_inner"], w["_within"], w["_at"], w["_nearest"], w["gap"], w["_second"],
                w["depth"], w["ignored"],
            )  # fmt: skip

        share(bring_up, len(self._active), LEAST_SIDES)

    @property
    def energy(self) -> float:
        """Energy stored in the penalty and friction springs of all contacts, J."""
        w = self._whole
        if not self._contacts:
            return 0.0
        squares = self._stiffness * (w["depth"] ** 2 + w["second_depth"] ** 2)
        squares += np.einsum("ij,ij->i", w["spring"], w["spring"]) / self._tangential
        return 0.5 * float(squares.sum())

    def forces(self, dt: float, x: Floats, v: Floats, f: Floats, active: int) -> None:
        """Add the contact forces of this instant to f (N,3) N; friction moves on by dt s. x m, v m/s (N,3).

        active: nodes that move, the first ones; pairs of others keep what their springs hold."""
        if not self._active:
            return
        w, near, own = self._whole, self._searched, self._active[0]
        rows, boxes, faces = near["rows"], near["_boxes"], near["_faces"]

        def look(lo: int, hi: int) -> None:
            k.look_of_sides(
                lo, hi, self._spans, self._numbers, rows, near["_start"], boxes, faces, near["_nodes"], near["_places"], near["_last"],
                near["_way"], self.node_of, w["partner"], x, self._x, w["_inner"], w["_within"], w["_at"], w["_seen"], w["_room"],
                w["_nearest"], w["_foot"], w["gap"], w["_second"], w["_second_foot"], w["_second_gap"], w["body"], w["second_body"],
                w["depth"], w["ignored"], w["second_depth"], w["second_ignored"], w["spring"], self._lost, active, self._met,
                self._meeting,
            )  # fmt: skip

        self._lost[:] = 0.0
        share(look, len(self._active), LEAST_SIDES)
        for i in np.flatnonzero(self._lost.any(axis=1)):
            self._active[i]._drop(self._lost[i])
        if self._is_unsettled:  # points that remember a contact may lie outside: what they hold is settled
            self._met[:], self._meeting[:] = rows, self._spans[:, 1] - self._spans[:, 0]
            self._is_unsettled = False
        k.forces_of_sides(
            dt, own.friction, own.share, self._spans, self._numbers, self._met, self._meeting, boxes, near["_ids"], faces, self.node_of,
            x, v, f, active, self._x, self._v, self._f, w["_nearest"], w["_foot"], w["gap"], w["_second"], w["_second_foot"],
            w["_second_gap"], w["depth"], w["ignored"], w["second_depth"], w["second_ignored"], w["spring"], w["heat_point"],
            w["heat_facet"], self._sums,
        )  # fmt: skip
        for c, slip in zip(self._active, self._sums[:, 2].tolist(), strict=True):
            c.friction_heat += slip


def _joined(parts: Sequence[np.ndarray], kind: DTypeLike = float) -> np.ndarray:
    return np.concatenate(parts) if len(parts) else np.zeros(0, kind)


def _bounds(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Where each part begins among all of them, and the end."""
    return np.cumsum([0, *map(len, parts)])
