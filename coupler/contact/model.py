"""Arrays of a contact between points of surfaces and triangles of other surfaces, as arguments of its kernels."""

from typing import NamedTuple

import numpy as np

from ..core.arrays import Bools, Faces, Floats, Histories, Ints

ANY = -1  # index of a body that is not specified
# Values of `ignored`, m: ALL for a point that has lost its contact, UNKNOWN for a point that no search has found near a face.
ALL, UNKNOWN = 1e300, -1.0
#: A triangle that points may touch: its bounding box (m), its nodes and its body. One record fills one line of the processor's cache.
FACE = np.dtype([("low", "f8", 3), ("high", "f8", 3), ("nodes", "i4", 3), ("body", "i4")])
#: History of a point. spring: friction force, N. The other fields have two columns: the body in which the point lies deepest, and a
#: second body. depth: penetration that gives force, m; ignored: penetration without force, m (`kernels.ignored_depth`); body: index.
HISTORY = np.dtype([("spring", "f8", 3), ("depth", "f8", 2), ("ignored", "f8", 2), ("body", "i8", 2)])


def new_history(points: int) -> Histories:
    """History of points that have never been in contact."""
    history = np.zeros(points, HISTORY)
    history["ignored"][:, 0], history["body"] = UNKNOWN, ANY
    return history


def faces_of(facets: Ints, body: Ints) -> Faces:
    """Records of the triangles facets (k,3) of bodies (k,). `closest.box_faces` fills in their boxes."""
    faces = np.zeros(len(facets), FACE)
    faces["nodes"], faces["body"] = facets, body
    return faces


class Points(NamedTuple):
    """Arrays of n points. x (m), v (m/s), f (N), each (n,3): positions, velocities, forces; owner (n,): body of each point; node
    (n,): its node in the domain, -1 if it is not a node; partner (n,): body to which the point is bonded and with which it has no
    contact, ANY if there is none; stiffness (n,) N/m; spacing (n,) m: spacing of its surface; margin (n,) m: distance up to which the
    last search has listed all faces."""

    x: Floats
    v: Floats
    f: Floats
    owner: Ints
    node: Ints
    partner: Ints
    stiffness: Floats
    spacing: Floats
    margin: Floats


class Nodes(NamedTuple):
    """Arrays of the N nodes of the faces. x (m), v (m/s), f (N), each (N,3): positions, velocities, forces. Only the first `active`
    nodes move."""

    x: Floats
    v: Floats
    f: Floats
    active: int


class Candidates(NamedTuple):
    """Faces that each point can touch before the next search: face[start[i]:start[i + 1]] for point i."""

    start: Ints
    face: Ints


class Projections(NamedTuple):
    """Closest-point projections of n points. Columns: the nearest body; a second body in which the point lies.

    face (n,2): -1 for none; foot (n,2,3): barycentric coordinates; gap (n,2) m: signed distance, negative inside. Values at the last
    projection: at (n,3) m: position of the point; clearance (n,) m: gap plus travel of the faces."""

    face: Ints
    foot: Floats
    gap: Floats
    at: Floats
    clearance: Floats


class Constants(NamedTuple):
    """Constants of a contact. friction: coefficient of friction; share: share of the heat of friction that goes to the points; jump:
    largest inward motion of a point in one step, in spacings."""

    friction: float
    share: float
    jump: float


class Pushes(NamedTuple):
    """Forces of the points `rows` (k,) in a step, before they are added up. due (k,): mask of the points in contact or projected in the
    step; the others have no force, and their values below are old. force (k,2,3) N: on the point, from each of its two bodies; couple
    (k,3,3) N: forces on the nodes of the first body's face that balance the moment of friction; heat (k,2) J: heat of friction of a
    point, and the part of it that goes to the face. heat_point (n,), heat_face (f,) J: see `contact.ContactState`."""

    rows: Ints
    due: Bools
    force: Floats
    couple: Floats
    heat: Floats
    heat_point: Floats
    heat_face: Floats


class Motion(NamedTuple):
    """Motion of the candidate faces. nodes[bounds[b]:bounds[b + 1]]: nodes of the candidates of the points of body b; last (k,3) m:
    their positions at the last projection; travel (bodies,) m: upper bound on their displacements since the last search."""

    nodes: Ints
    bounds: Ints
    last: Floats
    travel: Floats


def motion(nodes: Ints, bounds: Ints, x: Floats) -> Motion:
    """`Motion` that starts at the present positions x (N,3) m, with zero travel."""
    return Motion(nodes, bounds, x[nodes], np.zeros(len(bounds) - 1))
