"""The arrays of a contact, as its kernels take them: points of surfaces against triangles of others."""

from typing import NamedTuple

import numpy as np

from ..core.arrays import Faces, Floats, Histories, Ints

ANY = -1  # body
# m, depths that are ignored: of a point that has no contact, and of one that no search has found near a face
ALL, UNKNOWN = 1e300, -1.0
#: A triangle that points may touch: the box around it (m), its nodes and its body, together in one line of the processor's cache.
FACE = np.dtype([("low", "f8", 3), ("high", "f8", 3), ("nodes", "i4", 3), ("body", "i4")])
#: History of a point: spring N of friction; of the body in which it lies deepest, and of the second one: depth m of penetration that
#: gives force, ignored m: more of it, without force (`kernels.ignored_depth`), and the number of the body.
HISTORY = np.dtype([("spring", "f8", 3), ("depth", "f8", 2), ("ignored", "f8", 2), ("body", "i8", 2)])


def new_history(points: int) -> Histories:
    """The history of points that have never touched."""
    history = np.zeros(points, HISTORY)
    history["ignored"][:, 0], history["body"] = UNKNOWN, ANY
    return history


def faces_of(facets: Ints, body: Ints) -> Faces:
    """Faces of the triangles facets (k,3) of bodies (k,), their boxes to be found (`closest.box_faces`)."""
    faces = np.zeros(len(facets), FACE)
    faces["nodes"], faces["body"] = facets, body
    return faces


class Points(NamedTuple):
    """Positions x m, velocities v m/s, forces f N (n,3); owner (n,): the body of each; node (n,): the node of the domain that each is,
    -1 of others; partner (n,): the body that it is bonded to and has no contact with, ANY for none; stiffness (n,) N/m; spacing (n,) m
    of its surface; margin (n,) m: depth beyond which the last search knows no face."""

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
    """Arrays of the faces' nodes: positions x m, velocities v m/s, forces f N (N,3). Only the first `active` nodes move."""

    x: Floats
    v: Floats
    f: Floats
    active: int


class Candidates(NamedTuple):
    """Faces that each point can touch before the next search: face[start[i]:start[i + 1]]."""

    start: Ints
    face: Ints


class Projections(NamedTuple):
    """Closest-point projection of each point on the body that it is nearest to, and on a second one in which it lies: face (n,2), -1
    for none; foot (n,2,3): barycentric weights; gap (n,2) m: signed distance, negative inside. at (n,3) m: where the point was then;
    clearance (n,) m: its gap then plus the travel of the faces until then."""

    face: Ints
    foot: Floats
    gap: Floats
    at: Floats
    clearance: Floats


class Motion(NamedTuple):
    """Motion of the candidate faces of each body's points: nodes[bounds[b]:bounds[b + 1]] of the faces, last (k,3) m: positions of the
    nodes at the last projection, travel (bodies,) m: bound on how far one of them has moved since the search."""

    nodes: Ints
    bounds: Ints
    last: Floats
    travel: Floats


def motion(nodes: Ints, bounds: Ints, x: Floats) -> Motion:
    """`Motion` that starts at the present positions x (N,3) m, with zero travel."""
    return Motion(nodes, bounds, x[nodes], np.zeros(len(bounds) - 1))
