"""The facets that points are closest to: places on triangles, and which of several bodies a point meets (numba)."""

from math import sqrt

import numpy as np
from numba import njit

from ..geometry.vector_kernels import area_vector, from_foot
from ..state.arrays import Bools, Faces, Floats, Ints
from .broad import box_of

ANY = -1  # body
#: A triangle that points may meet: the box around it (m), its nodes and its body, together in one line of the processor's cache.
FACE = np.dtype([("low", "f8", 3), ("high", "f8", 3), ("nodes", "i4", 3), ("body", "i4")])


@njit(cache=True, nogil=True)
def faces_of(facets: Ints, ids: Ints, owner: Ints, faces: Faces) -> None:
    """The triangles `ids` of facets (k,3), each of a body, owner (k,), into faces (len(ids),); their boxes are not written."""
    for r in range(len(ids)):
        for d in range(3):
            faces[r].nodes[d] = facets[ids[r], d]
        faces[r].body = owner[ids[r]]


@njit(cache=True, nogil=True)
def box_faces(x: Floats, faces: Faces) -> None:
    """Bring the boxes around triangles up to their nodes x (N,3), m."""
    for r in range(len(faces)):
        box_of(x, faces[r].nodes, faces[r].low, faces[r].high)


@njit(cache=True, nogil=True, inline="always")
def closest_on_triangle(p: Floats, a: Floats, b: Floats, c: Floats) -> tuple[float, float, float]:
    """Barycentric weights (wa, wb, wc) of the point of triangle abc closest to p. Ericson (2005), section 5.1.5."""
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
    """Square of the distance of p from the box [low, high], m2."""
    u = max(low[0] - p[0], p[0] - high[0], 0.0)
    v = max(low[1] - p[1], p[1] - high[1], 0.0)
    w = max(low[2] - p[2], p[2] - high[2], 0.0)
    return u * u + v * v + w * w


@njit(cache=True, nogil=True)
def _closest_of(
    p: Floats, body: int, but: int, first: int, lo: int, hi: int, reach: float, boxes: Ints, faces: Faces, x: Floats, shift: float,
) -> tuple[int, float, float, float, float, float]:  # fmt: skip
    """The triangle of a body (ANY: of all but one, `but`) among the candidates [lo, hi) that p is closest to: its place in `boxes`, -1
    for none; the square of the distance, m2; which side p is on, negative inside; the weights of the closest point. first: where to
    look first, -1 for nowhere; reach: square of the distance up to which boxes are looked at, m2. Arrays as in `closest_facets`."""
    best = 1e300
    facing = side = -1.0
    face = -1
    wa = wb = wc = 0.0
    for look in range(lo - 1, hi):
        r = look
        if look < lo:
            if first < 0:
                continue
            r = first
        elif look == first:
            continue
        if boxes[r] < 0:
            continue
        candidate = faces[boxes[r]]
        if (body != ANY and candidate.body != body) or (but != ANY and candidate.body == but):
            continue
        # no triangle is closer than the box around it: most are left out so, once one close by is known
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
        # on a shared edge or corner the face that looks most towards the point decides inside or outside
        if dd < best * (1.0 - 1e-9) or align > facing:
            best, facing, side, face = dd, align, dn, r
            reach = min(reach, (sqrt(best) + shift) ** 2 * (1.0 + 4e-9))
            wa, wb, wc = a, b, c
    return face, best, side, wa, wb, wc


@njit(cache=True, nogil=True)
def _next_body(after: int, p: Floats, lo: int, hi: int, reach: float, boxes: Ints, faces: Faces) -> int:
    """The least number above `after` of a body that has one of the candidates [lo, hi) with its box within reach, m2; ANY for none."""
    found = ANY
    for r in range(lo, hi):
        if boxes[r] >= 0:
            candidate = faces[boxes[r]]
            lower = candidate.body > after and (found == ANY or candidate.body < found)
            if lower and _box_distance2(p, candidate.low, candidate.high) <= reach:
                found = candidate.body
    return found


@njit(cache=True, nogil=True)
def several_bodies(rows: Ints, start: Ints, boxes: Ints, faces: Faces) -> Bools:
    """Whether each of the points `rows` has candidates of more than one body. Arguments as in `closest_facets`."""
    several = np.zeros(len(rows), np.bool_)
    for q in range(len(rows)):
        one = ANY
        for r in range(start[rows[q]], start[rows[q] + 1]):
            if boxes[r] >= 0:
                body = faces[boxes[r]].body
                several[q] |= one != ANY and body != one
                one = body
    return several


@njit(cache=True, nogil=True)
def narrow(
    rows: Ints, more: float, xp: Floats, start: Ints, boxes: Ints, faces: Faces, limit: Floats, gap: Floats, nearest: Ints, second:
    Ints, inner: Ints, within: Floats, at: Floats,
) -> None:  # fmt: skip
    """Put those candidates of each of the points `rows` first whose boxes come within a distance of it that is `more` m beyond what it
    meets now: up to place inner (n,), within (n,) m of at (n,3), where it is. nearest and second (n,) move to their new places.

    As long as point and facets have moved by less, nothing else has to be looked at. Arrays as in `closest_facets`.
    """
    for q in range(len(rows)):
        i = rows[q]
        lo, hi = start[i], start[i + 1]
        within[i] = max(abs(gap[i]), limit[q]) + more
        at[i, 0], at[i, 1], at[i, 2] = xp[i, 0], xp[i, 1], xp[i, 2]
        others = np.empty(hi - lo, np.int64)
        count, apart, place, place_2 = lo, 0, -1, -1
        reach = within[i] ** 2 * (1.0 + 4e-9)
        for r in range(lo, hi):
            near = boxes[r] >= 0 and _box_distance2(xp[i], faces[boxes[r]].low, faces[boxes[r]].high) <= reach
            if r == nearest[i] or r == second[i] or near:
                if r == nearest[i]:
                    place = count
                if r == second[i]:
                    place_2 = count
                boxes[count] = boxes[r]
                count += 1
            else:
                others[apart] = boxes[r]
                apart += 1
        boxes[count:hi] = others[:apart]
        inner[i], nearest[i], second[i] = count, place, place_2


@njit(cache=True, nogil=True)
def closest_facets(
    xp: Floats, rows: Ints, start: Ints, boxes: Ints, faces: Faces, partner: Ints, x: Floats, shift: float, limit: Floats, inner: Ints,
    within: Floats, at: Floats, nearest: Ints, foot: Floats, gap: Floats, second: Ints, second_foot: Floats, second_gap: Floats,
) -> None:  # fmt: skip
    """Which of its candidate triangles each point of `rows` meets, where, and how far away it is: the closest one; of a point that
    lies in several bodies, or outside one and inside another, the closest ones of the two in which it lies deepest.

    A point in the gap between two bodies that both lie against a third is closest to one of them: the third would not stop it.

    xp, x as in `contact_forces`; start (n+1,), boxes: candidates of each point, places in faces (k,), whose triangles have moved from
    the boxes around them by `shift` m at the most; partner (n,): the body that each point does not meet because a bond holds it there,
    ANY for none. limit (rows,) m: other bodies than that of the closest one are not met deeper than that. inner, within, at: of
    `narrow`. nearest (n,): place in `boxes`, -1 for none; what it holds is where to look first, then it is written. foot (n,3):
    barycentric weights of the closest point; gap (n,): signed distance, negative inside, m. second, second_foot, second_gap: the same
    of the body in which it lies second deepest, -1 and 0 where it lies in one at most.
    """
    for q in range(len(rows)):
        i = rows[q]
        lo, hi = start[i], start[i + 1]
        u, v, w = xp[i, 0] - at[i, 0], xp[i, 1] - at[i, 1], xp[i, 2] - at[i, 2]
        moved = sqrt(u * u + v * v + w * w) + shift
        end = inner[i] if limit[q] + moved <= within[i] else hi
        face, best, side, a, b, c = _closest_of(
            xp[i], ANY, partner[i], nearest[i], lo, end, 1e300, boxes, faces, x, shift
        )
        if end < hi and sqrt(best) + moved > within[i]:
            end = hi
            face, best, side, a, b, c = _closest_of(
                xp[i], ANY, partner[i], face, lo, end, 1e300, boxes, faces, x, shift
            )
        away = -sqrt(best) if face >= 0 and side < 0.0 else sqrt(best)
        face_2, away_2, a_2, b_2, c_2 = -1, 0.0, 0.0, 0.0, 0.0
        if face >= 0 and best <= limit[q] ** 2:
            closest = faces[boxes[face]].body
            reach = (limit[q] + shift) ** 2 * (1.0 + 4e-9)
            body = _next_body(ANY, xp[i], lo, end, reach, boxes, faces)
            while body != ANY:
                if body != closest and body != partner[i]:
                    other, best, side, u, v, w = _closest_of(
                        xp[i], body, ANY, -1, lo, end, reach, boxes, faces, x, shift
                    )
                    if other >= 0 and side < 0.0 and best <= limit[q] ** 2:
                        if -sqrt(best) < away:
                            if away < 0.0:
                                face_2, away_2, a_2, b_2, c_2 = face, away, a, b, c
                            face, away, a, b, c = other, -sqrt(best), u, v, w
                        elif -sqrt(best) < away_2:
                            face_2, away_2, a_2, b_2, c_2 = other, -sqrt(best), u, v, w
                body = _next_body(body, xp[i], lo, end, reach, boxes, faces)
        nearest[i], gap[i] = face, away
        foot[i, 0], foot[i, 1], foot[i, 2] = a, b, c
        second[i], second_gap[i] = face_2, away_2
        second_foot[i, 0], second_foot[i, 1], second_foot[i, 2] = a_2, b_2, c_2


@njit(cache=True, nogil=True)
def reachable(
    rows: Ints, travel: float, xp: Floats, start: Ints, boxes: Ints, faces: Faces, limit: Floats, gap: Floats, nearest: Ints, second:
    Ints,
) -> tuple[Ints, Ints]:  # fmt: skip
    """The candidates (start, boxes) of the points `rows` that they can meet while point and facets come `travel` m closer or farther:
    no more than twice that farther away than the closest now or, where there are several bodies, than `limit` (rows,) m. nearest and
    second (n,) move to their new places.

    A point without a closest facet keeps all of its candidates, others than `rows` keep none. Arrays as in `closest_facets`.
    """
    several = several_bodies(rows, start, boxes, faces)
    first = np.zeros(len(start), np.int64)
    kept = np.empty(len(boxes), np.int64)
    count = 0
    last = 0
    for q in range(len(rows)):
        i = rows[q]
        first[last + 1 : i + 1] = count
        last = i
        place = place_2 = -1
        lo, hi = start[i], start[i + 1]
        far = max(abs(gap[i]), limit[q]) if several[q] else abs(gap[i])
        reach = np.inf if nearest[i] < 0 else (far + 2.0 * travel) ** 2 * (1.0 + 4e-9)
        for r in range(lo, hi):
            if r == nearest[i]:
                place = count
            if r == second[i]:
                place_2 = count
            if r == nearest[i] or _box_distance2(xp[i], faces[boxes[r]].low, faces[boxes[r]].high) <= reach:
                kept[count] = boxes[r]
                count += 1
        nearest[i], second[i] = place, place_2
    first[last + 1 :] = count
    return first, kept[:count]
