"""Contact of points on surfaces with faces of other surfaces. Pairs are searched before a chunk of steps; forces are computed in each
step."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ..core import safety
from ..core.arrays import Floats, Ints, Links, occurring
from ..core.loops import PARTS
from ..core.records import Shape, Sums, put
from ..core.threads import share, together
from ..errors import SolverError
from . import broad, closest
from . import kernels as k
from .model import (
    ANY,
    HISTORY,
    Candidates,
    Constants,
    Nodes,
    Points,
    Projections,
    Pushes,
    faces_of,
    motion,
    new_history,
)
from .searches import Searches, own_travel, valid_searches

LEAST_POINTS = 4000  # in a range of a shared loop
JUMP = 0.2  # spacings: twice the motion in one step of a particle with a quarter of the speed of sound


@dataclass
class ContactSums(Sums):
    """Sums of contact energies over all steps. dropped: number of points that have lost their contact because they lay too deep.
    Energies, J: friction_heat; dropped_energy: energy of the springs of these points, and of points whose depth has jumped; lost:
    energy lost where compression passes from bonds to the contact, negative if energy is gained."""

    friction_heat: float = 0.0
    dropped_energy: float = 0.0
    lost: float = 0.0
    dropped: int = 0


@dataclass(eq=False)
class ContactState:
    """State of a contact. history (n,): contact history of each point; heat_point (n,), heat_face (k,) J: heat of friction that the
    bodies have not yet received."""

    history: Annotated[np.ndarray, Shape(-1, dtype=HISTORY)]
    heat_point: Annotated[np.ndarray, Shape(-1)]
    heat_face: Annotated[np.ndarray, Shape(-1)]
    sums: ContactSums = field(default_factory=ContactSums)


class Contact(ContactState):
    """Contact of the points of one or several bodies with the faces of other bodies: penalty and Coulomb friction (`law`)."""

    def __init__(
        self, owner: Ints, facets: Ints, body: Ints, stiffness: Sequence[float], spacing: Sequence[float], friction: float,
        share: float = 0.5, jump: float = JUMP, node: Ints | None = None, facing: Sequence[Ints] | None = None, skin: float = 0.0,
    ):  # fmt: skip
        """owner (n,): body of each point, ascending from 0; facets (k,3): nodes, normal outwards; body (k,): body of each facet;
        stiffness (N/m), spacing (m) of the points of each body; share: share of the friction heat that goes to the points;
        jump: largest inward motion of a point in one step, in spacings: a point that moves farther did not enter through this
        surface, and has no contact until it is outside again; node (n,): node of each point in the domain (default: points are not
        nodes); facing: for each body, the facets that its points can ever touch (default: all); skin: a search covers this many
        spacings more than `travel`, so that it stays valid for later calls; 0: each call of `search` searches again."""
        n, bodies = len(owner), len(spacing)
        self.constants, self._skin = Constants(friction, share, jump), skin
        self.stiffness, self.spacing = np.array(stiffness, float), np.array(spacing, float)
        self.faces = faces_of(facets, body)
        node = np.full(n, -1) if node is None else node
        x, v, f = np.zeros((3, n, 3))
        k_of, h_of, far = self.stiffness[owner], self.spacing[owner], np.full(n, np.inf)
        self.points = Points(x, v, f, owner, node, np.full(n, ANY), k_of, h_of, far)
        self.bounds = np.searchsorted(owner, np.arange(bodies + 1))
        self.facing = [np.arange(len(facets))] * bodies if facing is None else facing
        super().__init__(new_history(n), np.zeros(n), np.zeros(len(facets)))
        #: Points that can touch before the next search, ascending: only these are projected and get forces.
        self.rows: Ints = np.zeros(0, np.int64)
        self._list_pushes()
        self._candidates = Candidates(np.zeros(n + 1, np.int64), np.zeros(0, np.int64))
        self._projections = Projections(
            np.full((n, 2), -1), np.zeros((n, 2, 3)), np.zeros((n, 2)), np.zeros((n, 3)), np.full(n, -np.inf)
        )
        self._motion = motion(np.zeros(0, np.int64), np.zeros(bodies + 1, np.int64), np.zeros((0, 3)))
        self._searches = Searches.none_yet(self.bounds, self.facing)

    @property
    def depth(self) -> Floats:
        """Penetration (n,) m of each point, without the part that gives no force."""
        return self.history["depth"][:, 0]

    @property
    def gap(self) -> Floats:
        """Signed distance (n,) m of each point from its face, negative inside. Valid only for the points `rows`."""
        return self._projections.gap[:, 0]

    @property
    def penalty_energy(self) -> float:
        """Energy of the penalty and friction springs, J."""
        sums = np.zeros(PARTS)
        together(k.energy, self.points, self.history, sums)
        return float(sums.sum())

    @property
    def normal_force(self) -> Floats:
        """Normal contact force (n,) N on each point."""
        return self.points.stiffness * self.depth  # `law.normal_force`

    def restore(self, state: ContactState) -> None:
        """Restore the state of a contact of the same surfaces. Call `search` next. Raises CheckpointError if the state does not
        belong to these surfaces."""
        put(state, self)
        self.expire()

    def expire(self, which: np.ndarray | slice = slice(None)) -> None:
        """Make the next `search` list new candidates for all bodies that own points of a mask (n,); default: all bodies."""
        self._searches.reach[self.points.owner[which]] = -np.inf

    def stable_dt(self, softness: float, lightest: float, body: int = 0) -> float:
        """Stable time step (s) of the springs between points of a body and nodes. softness: inverse mass of a point, 1/kg;
        lightest: mass of the lightest node, kg."""
        return float(safety.CONTACT * 2.0 / np.sqrt(self.stiffness[body] * (softness + 1.0 / lightest)))

    def mass_for(self, step: float) -> float:
        """Mass (kg) of points and nodes for which `step` (s) is the stable time step of the springs."""
        return 2.0 * float(self.stiffness.max(initial=0.0)) * (0.5 * step / safety.CONTACT) ** 2

    # ---- search --------------------------------------------------------------------------------------------------

    def search(
        self, xp: Floats, x: Floats, travel: float, always: Sequence[int] | Ints = (), active: int | None = None,
        v: Floats | None = None,
    ) -> bool:  # fmt: skip
        """Find the pairs that can touch before surfaces have moved `travel` m relative to each other.

        xp (n,3), x (N,3) m: points and nodes; always: points that are always in `rows`; active: number of nodes that move, the first
        ones (default: all): a point at rest whose near faces are at rest keeps its forces and is not in `rows`; v (N,3) m/s:
        velocities, if the points are nodes: the searches of slow bodies then cover a smaller distance. Returns whether any body has new
        candidates: old ones are kept until surfaces have moved too far. Raises SolverError when the positions are not finite numbers.
        """
        self.points.x[:], active = xp, len(x) if active is None else active
        if not (np.isfinite(xp).all() and np.isfinite(x).all()):
            raise SolverError("positions of points or nodes are not finite numbers: try a finer preset")
        closest.box_faces(x, self.faces)
        k.add_travel(0, len(self.spacing), self._motion, x, len(x))
        # the travel of the faces restarts from zero
        self._projections.clearance[self.rows] -= self._motion.travel[self.points.owner[self.rows]]
        self._motion.travel[:] = 0.0
        part = np.ones(len(x))
        if v is not None and (fastest := float((speed := np.sqrt(np.einsum("ij,ij->i", v, v))).max(initial=0.0))) > 0.0:
            part = speed / fastest
        valid = np.zeros(len(self.spacing), bool)
        together(
            valid_searches, travel, part, active, self.spacing, self._skin, x, self.points, self.faces, self._searches, valid,
        )  # fmt: skip
        due: Ints = np.flatnonzero(~valid)
        if len(due):
            self._find(due, self._start(due, x, travel, part), always, active, x)
            owner, bodies = self.points.owner, len(self.spacing)
            nodes = closest.candidate_nodes(self._candidates, owner, bodies, self.faces, len(x))
            self._motion = motion(*nodes, x)
        return len(due) > 0

    def _around(self, body: int, margin: float) -> Ints:
        """The faces of `facing` whose boxes lie within `margin` m of the bounding box of a body's points."""
        own, found = self.points.x[self.bounds[body] : self.bounds[body + 1]], list[tuple[Floats, Floats]]()
        share(lambda lo, hi: found.append(broad.bounds(own[lo:hi], own[lo:hi])), len(own), LEAST_POINTS)
        least, most = np.min([low for low, _ in found], axis=0), np.max([high for _, high in found], axis=0)
        low, high = self.faces["low"], self.faces["high"]
        return broad.boxes_within(low, high, self.facing[body], least - margin, most + margin)

    def _start(self, due: Ints, x: Floats, travel: float, part: Floats) -> Floats:
        """Start the searches of the bodies `due`. Returns far (bodies,) m: the search of body b is valid until its points and the faces
        have moved by far[b] relative to each other; 0 for other bodies. part: see `searches.own_travel`."""
        far = np.zeros(len(self.spacing))
        near = {body: self._around(body, self.spacing[body] + 2.0 * travel) for body in due}
        s = self._searches = self._searches.begun(near, self.faces, self.points.x, x)
        for body in due:
            far[body] = own_travel(body, travel, part, self.points, s) + self._skin * self.spacing[body]
            if self._skin > 0.0:
                s.reach[body] = far[body]
        return far

    def _find(self, bodies: Ints, travel: Floats, always: Sequence[int] | Ints, active: int, x: Floats) -> None:
        """Find the candidate faces of all points of `bodies`, and update `rows`. Both stay valid until the points of body b have moved
        travel[b] m relative to the faces. always, active, x: see `search`."""
        p, proj, history, faces = self.points, self._projections, self.history, self.faces
        chosen = np.zeros(len(self.spacing), bool)
        chosen[bodies] = True
        ids = occurring(np.concatenate([self._searches.faces_near(body) for body in bodies]), len(faces))
        low, high = faces["low"][ids], faces["high"][ids]
        state, known = np.zeros(len(p.owner), np.uint8), np.zeros(len(p.owner), bool)
        known[self.rows] = True  # the gaps of the other points are not known
        together(k.begin_search, chosen, travel, *broad.bounds(low, high), known, p, proj, history, state)
        near, due = np.flatnonzero(state & k.NEAR), chosen[p.owner]
        start, face = self._pairs(near, ids, low, high)
        # points with a friction spring are projected too, so that its energy is accounted for
        sheared = state >= k.SHEARED
        sheared[np.asarray(always, np.int64)] = True
        rows: Ints = np.flatnonzero(due & ((np.diff(start) > 0) | sheared))
        self._set_candidates(due, start, face)
        # points at rest are left out, because some of their faces can lie outside a sub-domain
        rows, still = self._moving(rows, active)
        lost = np.zeros((PARTS, 2))
        together(
            k.project, rows, self.constants.jump, p, Nodes(x, x, x, active), self._candidates, faces, self._motion, proj, history,
            np.zeros(len(rows), bool), lost,
        )  # fmt: skip
        self._lose(lost)
        # the tenth of a spacing allows for surfaces that accelerate
        close = (proj.face[rows, 0] >= 0) & (proj.gap[rows, 0] < travel[p.owner[rows]] + 0.1 * p.spacing[rows])
        kept = rows[close | sheared[rows]]
        state[:] = np.where(due, k.OUTSIDE, k.KEPT)  # a point without candidates is outside
        state[rows] = k.AWAY
        state[still] = state[kept] = k.KEPT
        for _ in range(2):  # with fewer candidates more points are at rest
            limit = k.deepest(kept, history, p, self.constants.jump)
            self._set_candidates(due, *closest.reachable(kept, travel, limit, p, self._candidates, faces, proj))
            kept, still = self._moving(kept, active)
            if len(still) == 0:
                break
        together(k.end_search, state, history)
        self.rows = np.union1d(self.rows[~due[self.rows]], kept)
        self._list_pushes()

    def _list_pushes(self) -> None:
        """Allocate the arrays for the forces on the points `rows`."""
        force, couple, heat = (np.zeros((len(self.rows), *shape)) for shape in ((2, 3), (3, 3), (2,)))
        due = np.ones(len(self.rows), bool)
        self._pushes = Pushes(self.rows, due, force, couple, heat, self.heat_point, self.heat_face)

    def _pairs(self, near: Ints, ids: Ints, low: Floats, high: Floats) -> tuple[Ints, Ints]:
        """Candidates (start, face) of all points: for the points `near`, the faces ids (k,) of other bodies whose boxes low, high
        (k,3) m lie within their margins; none for the others."""
        p, counts = self.points, np.zeros(len(self.points.owner) + 1, np.int64)
        if len(near) == 0:
            return counts, near
        own, cell = p.owner[near], float(p.spacing[near].min())
        few, boxes = broad.pairs_within(p.x[near], p.margin[near], own, low, high, self.faces["body"][ids], cell)
        counts[1 + near] = np.diff(few)
        return np.cumsum(counts), ids[boxes]

    def _set_candidates(self, fresh: np.ndarray, start: Ints, face: Ints) -> None:
        """Replace the candidates (start, face) of the points of a mask (n,)."""
        if not fresh.all():
            start, face = closest.merged(fresh, *self._candidates, start, face)
        self._candidates = Candidates(start, face)

    def _moving(self, rows: Ints, active: int) -> tuple[Ints, Ints]:
        """Divide the points `rows` into those with an active node and the others. The nodes of a point are its own node (-1, none,
        counts as active) and the nodes of its candidate faces; the first `active` nodes of the domain are active. The search of the
        others stays valid until one of their nodes becomes active."""
        least = closest.least_node(rows, self.points.node, self._candidates, self.faces)
        still = least >= active
        np.minimum.at(self._searches.active, self.points.owner[rows[still]], least[still])
        return rows[~still], rows[still]

    # ---- forces --------------------------------------------------------------------------------------------------

    def forces(self, dt: float, nodes: Nodes) -> None:
        """Add the contact forces at the positions and velocities of `points` and `nodes` to points.f and nodes.f, N, and update
        friction for a step of dt s. Of the points, only `rows` are read and written."""
        sums = np.zeros((PARTS, 3))
        together(
            k.contact_forces, dt, self.constants, self.points, nodes, self._candidates, self.faces, self._motion,
            self._projections, self.history, self._pushes, sums,
        )  # fmt: skip
        self._lose(sums)
        self.sums.friction_heat += float(sums[0, 2])

    def _lose(self, lost: Floats) -> None:
        """Add the number of points that have lost their contact, and the energy of their springs, to `sums` (`kernels.project`)."""
        if lost[:, 1].any():
            self.sums.dropped += int(lost[:, 0].sum())
            self.sums.dropped_energy += float(lost[:, 1].sum())

    def touching(self, first: int, within: float = 0.0) -> tuple[Ints, Ints]:
        """Points (k,) among the first `first` ones that touch in this step, and the facet (k,) under each.

        within (m): points closer than this also count, because a touching point can lose its contact for single steps.
        """
        rows = self.rows[self.rows < first]
        rows = rows[self.gap[rows] < within] if within > 0.0 else rows[self.depth[rows] > 0.0]
        rows = rows[self._projections.face[rows, 0] >= 0]
        return rows, self._projections.face[rows, 0]

    def springs(self) -> Links:
        """Table of the contact springs that can act before the next search: each joins a point's node to the nodes of the closest
        face, and, where the point lies in a second body, to the nodes of the closest face of that body."""
        p, proj = self.points, self._projections
        body, found = np.nonzero(proj.face[self.rows].T >= 0)
        rows = self.rows[found]
        corners = self.faces["nodes"][proj.face[rows, body]]
        return Links.of(p.node[rows], corners, proj.foot[rows, body], p.stiffness[rows])

    def load(self, size: int) -> Floats:
        """Row sums (size,) N/m of the stiffness matrix of all springs that can act before the next search, see `Links.load`."""
        load, rows, k_2 = np.zeros(size), self.rows, 2.0 * self.points.stiffness
        for body in np.unique(self.points.owner[rows]):
            own = slice(self.bounds[body], self.bounds[body + 1])
            load[self.points.node[own]] += k_2[own]
            load[self._searches.nodes_near(body)] += 4.0 * self.stiffness[body]
        twice = rows[closest.between_bodies(rows, self._candidates, self.faces)]
        load[self.points.node[twice]] += k_2[twice]
        return load
