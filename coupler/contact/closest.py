"""Projection of points on the closest point of triangles, and the choice of the triangle among several bodies (numba)."""

from math import inf, sqrt

import numpy as np

from ..compiling import njit, uncounted
from ..core.arrays import Bools, Faces, Floats, Ints
from ..geometry.vector_kernels import area_vector, from_foot
from .broad import box_of
from .model import ANY, Candidates, Points, Projections


@njit(cache=True, nogil=True)
def box_faces(x: Floats, faces: Faces) -> None:
    """Update the bounding boxes of triangles to the positions x (N,3) of their nodes, m."""
    for r in range(len(faces)):
        box_of(x, faces[r].nodes, faces[r].low, faces[r].high)


@njit(cache=True, nogil=True, inline="always")
def closest_on_triangle(p: Floats, a: Floats, b: Floats, c: Floats) -> tuple[float, float, float]:
    """Barycentric coordinates (wa, wb, wc) of the point of triangle abc that is closest to p. Ericson (2005), section 5.1.5."""
    ab0, ab1, ab2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    ac0, ac1, ac2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    ap0, ap1, ap2 = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    d1 = ab0 * ap0 + ab1 * ap1 + ab2 * ap2
    d2 = ac0 * ap0 + ac1 * ap1 + ac2 * ap2
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    bp0, bp1, bp2 = p[0] - b[0], p[1] - b[1], p[2] - b[2]
    d3 = ab0 * bp0 + ab1 * bp1 + ab2 * bp2
    d4 = ac0 * bp0 + ac1 * bp1 + ac2 * bp2
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return 1.0 - v, v, 0.0
    cp0, cp1, cp2 = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    d5 = ab0 * cp0 + ab1 * cp1 + ab2 * cp2
    d6 = ac0 * cp0 + ac1 * cp1 + ac2 * cp2
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return 1.0 - w, 0.0, w
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - w, w
    inv = 1.0 / (va + vb + vc)
    return 1.0 - (vb + vc) * inv, vb * inv, vc * inv


@njit(cache=True, nogil=True, inline="always")
def _box_distance2(p: Floats, low: Floats, high: Floats) -> float:
    """Square of the distance between p and the box [low, high], m2."""
    u = max(low[0] - p[0], p[0] - high[0], 0.0)
    v = max(low[1] - p[1], p[1] - high[1], 0.0)
    w = max(low[2] - p[2], p[2] - high[2], 0.0)
    return u * u + v * v + w * w


@uncounted
def _closest_of(
    p: Floats, body: int, but: int, first: int, among: Ints, faces: Faces, x: Floats, reach: float, shift: float
) -> tuple[int, float, float, float, float, float]:  # fmt: skip
    """The triangle that is closest to p, -1 for none; the square of the distance, m2; the side of p, negative inside; the
    barycentric coordinates of the closest point.

    body: body of the triangle, ANY for all bodies except `but`; among: candidates; first: candidate to try first, -1 for none; x
    (N,3) m: nodes; shift: largest displacement of a node since the boxes of the faces were updated, m; reach: square of the
    distance beyond which boxes are skipped, m2.
    """
    best = 1e300
    facing = side = -1.0
    face = -1
    wa = wb = wc = 0.0
    for q in range(-1, len(among)):
        r = first if q < 0 else among[q]
        if r < 0 or (q >= 0 and r == first):
            continue
        candidate = faces[r]
        if (body != ANY and candidate.body != body) or (but != ANY and candidate.body == but):
            continue
        # no triangle is closer than its box: this skips most triangles once a close one is known
        if _box_distance2(p, candidate.low, candidate.high) > reach:
            continue
        t = candidate.nodes
        A, B, C = x[t[0]], x[t[1]], x[t[2]]
        a, b, c = closest_on_triangle(p, A, B, C)
        d0, d1, d2 = from_foot(p, A, B, C, a, b, c)
        dd = d0 * d0 + d1 * d1 + d2 * d2
        if dd > best * (1.0 + 1e-9):
            continue
        n0, n1, n2 = area_vector(A, B, C)
        dn = d0 * n0 + d1 * n1 + d2 * n2
        align = abs(dn) / sqrt((n0 * n0 + n1 * n1 + n2 * n2) * dd + 1e-300)
        # on a shared edge or corner the face whose normal is closest to the direction of p decides between inside and outside
        if dd < best * (1.0 - 1e-9) or align > facing:
            best, facing, side, face = dd, align, dn, r
            reach = min(reach, (sqrt(best) + shift) ** 2 * (1.0 + 4e-9))
            wa, wb, wc = a, b, c
    return face, best, side, wa, wb, wc


@njit(cache=True, nogil=True)
def closest(points: Floats, c: Candidates, faces: Faces, x: Floats, face: Ints, weights: Floats, gap: Floats) -> None:
    """Write the closest candidate of each of points (n,3): face (n,), barycentric coordinates weights (n,3), signed gap (n,) m."""
    for i in range(len(points)):
        among = c.face[c.start[i] : c.start[i + 1]]
        face[i], best, side, wa, wb, wc = _closest_of(points[i], ANY, ANY, -1, among, faces, x, inf, 0.0)
        weights[i, 0], weights[i, 1], weights[i, 2] = wa, wb, wc
        gap[i] = -sqrt(best) if side < 0.0 else sqrt(best)


@uncounted
def _next_body(after: int, p: Floats, among: Ints, faces: Faces, reach: float) -> int:
    """The body with the smallest index above `after` that has a face in `among` near p; ANY if there is none. reach: square of the
    largest distance between p and the box of the face, m2."""
    found = ANY
    for r in among:
        candidate = faces[r]
        lower = candidate.body > after and (found == ANY or candidate.body < found)
        if lower and _box_distance2(p, candidate.low, candidate.high) <= reach:
            found = candidate.body
    return found


@uncounted
def several_bodies(i: int, c: Candidates, faces: Faces) -> bool:
    """Whether the candidates of point i belong to more than one body."""
    among, several = c.face[c.start[i] : c.start[i + 1]], False
    for r in among:
        several = several or faces[r].body != faces[among[0]].body
    return several


@njit(cache=True, nogil=True)
def between_bodies(rows: Ints, c: Candidates, faces: Faces) -> Bools:
    """Mask of those points in `rows` whose candidates belong to more than one body."""
    several = np.zeros(len(rows), np.bool_)
    for q in range(len(rows)):
        several[q] = several_bodies(rows[q], c, faces)
    return several


@uncounted
def closest_faces(
    i: int, points: Points, c: Candidates, faces: Faces, x: Floats, shift: float, limit: float, proj: Projections
) -> None:
    """Project point i on the closest of its candidates. If the point lies inside a body that is not the closest one, or inside
    several bodies, project it on the closest faces of the two bodies in which it lies deepest.

    Otherwise a point in a gap between two bodies, with a third body at the bottom of the gap, could enter the third body.

    x (N,3) m: nodes; shift: largest displacement of a node since the boxes of the faces were updated, m; limit: largest penetration
    that counts in a body that is not the closest one, m.
    """
    p, partner, among = points.x[i], points.partner[i], c.face[c.start[i] : c.start[i + 1]]
    face, best, side, wa, wb, wc = _closest_of(p, ANY, partner, proj.face[i, 0], among, faces, x, inf, shift)
    gap = -sqrt(best) if face >= 0 and side < 0.0 else sqrt(best)
    proj.face[i, 1], proj.gap[i, 1] = -1, 0.0
    proj.foot[i, 1, :] = 0.0
    if face >= 0 and best <= limit * limit:
        closest = faces[face].body
        reach = (limit + shift) ** 2 * (1.0 + 4e-9)
        body = _next_body(ANY, p, among, faces, reach)
        while body != ANY:
            if body != closest and body != partner:
                other, best, side, u, v, w = _closest_of(p, body, ANY, -1, among, faces, x, reach, shift)
                deeper = other >= 0 and side < 0.0 and best <= limit * limit
                if deeper and -sqrt(best) < gap:
                    if gap < 0.0:
                        proj.face[i, 1], proj.gap[i, 1] = face, gap
                        proj.foot[i, 1, 0], proj.foot[i, 1, 1], proj.foot[i, 1, 2] = wa, wb, wc
                    face, gap, wa, wb, wc = other, -sqrt(best), u, v, w
                elif deeper and -sqrt(best) < proj.gap[i, 1]:
                    proj.face[i, 1], proj.gap[i, 1] = other, -sqrt(best)
                    proj.foot[i, 1, 0], proj.foot[i, 1, 1], proj.foot[i, 1, 2] = u, v, w
            body = _next_body(body, p, among, faces, reach)
    proj.face[i, 0], proj.gap[i, 0] = face, gap
    proj.foot[i, 0, 0], proj.foot[i, 0, 1], proj.foot[i, 0, 2] = wa, wb, wc


@njit(cache=True, nogil=True)
def reachable(
    rows: Ints, travel: Floats, limit: Floats, points: Points, c: Candidates, faces: Faces, proj: Projections
) -> tuple[Ints, Ints]:  # fmt: skip
    """Candidates (start, face) that the points `rows` can touch before a point of the body b and a face have moved by travel[b] m
    relative to each other.

    The boxes of these faces are at most d + 2 travel[b] away from the point. d is the distance of the closest face; if the point has
    candidates of several bodies, d is at least the limit (k,) m of this point. A point without a closest face keeps all its candidates.
    Points that are not in `rows` keep none.
    """
    first, kept = np.zeros(len(c.start), np.int64), np.empty(len(c.face), np.int64)
    count = last = 0
    for q in range(len(rows)):
        i = rows[q]
        first[last + 1 : i + 1] = count
        last = i
        far = max(abs(proj.gap[i, 0]), limit[q]) if several_bodies(i, c, faces) else abs(proj.gap[i, 0])
        reach = inf if proj.face[i, 0] < 0 else (far + 2.0 * travel[points.owner[i]]) ** 2 * (1.0 + 4e-9)
        for r in c.face[c.start[i] : c.start[i + 1]]:
            if r == proj.face[i, 0] or _box_distance2(points.x[i], faces[r].low, faces[r].high) <= reach:
                kept[count] = r
                count += 1
    first[last + 1 :] = count
    return first, kept[:count]


@njit(cache=True, nogil=True)
def merged(
    fresh: Bools, start: Ints, face: Ints, new_start: Ints, new_face: Ints
) -> tuple[Ints, Ints]:  # fmt: skip
    """Candidates (start, face) of all n points: the new ones for points of the mask `fresh`, the old ones for all others."""
    first = np.zeros(len(start), np.int64)
    for i in range(len(fresh)):
        n = new_start[i + 1] - new_start[i] if fresh[i] else start[i + 1] - start[i]
        first[i + 1] = first[i] + n
    both = np.empty(first[-1], np.int64)
    for i in range(len(fresh)):
        if fresh[i]:
            both[first[i] : first[i + 1]] = new_face[new_start[i] : new_start[i + 1]]
        else:
            both[first[i] : first[i + 1]] = face[start[i] : start[i + 1]]
    return first, both


@njit(cache=True, nogil=True)
def candidate_nodes(c: Candidates, owner: Ints, bodies: int, faces: Faces, n: int) -> tuple[Ints, Ints]:
    """Returns nodes and bounds: nodes[bounds[b]:bounds[b + 1]] are those of the candidates of body b's points. n: number of nodes."""
    last, bounds = np.full(n, ANY), np.zeros(bodies + 1, np.int64)
    nodes, count = np.empty(3 * len(c.face), np.int64), 0
    for i in range(len(owner)):
        for r in c.face[c.start[i] : c.start[i + 1]]:
            for d in range(3):
                a = faces[r].nodes[d]
                if last[a] != owner[i]:
                    last[a] = owner[i]
                    nodes[count] = a
                    count += 1
        bounds[owner[i] + 1] = count
    return nodes[:count], bounds


@njit(cache=True, nogil=True)
def least_node(rows: Ints, node: Ints, c: Candidates, faces: Faces) -> Ints:
    """For each point of `rows`, the smallest index among its own node and its candidates' nodes. node (n,): own nodes, -1 for none."""
    least = np.empty(len(rows), np.int64)
    for q in range(len(rows)):
        i = rows[q]
        least[q] = node[i]
        for r in c.face[c.start[i] : c.start[i + 1]]:
            for d in range(3):
                least[q] = min(least[q], faces[r].nodes[d])
    return least
