"""Contact of points against triangles: penalty forces, Coulomb friction with history (numba)."""

from math import inf, sqrt

import numpy as np
from numba import njit

from ..geometry.vector_kernels import add, area_vector, from_foot
from ..state.arrays import Arrays, Faces, Floats, Ints
from ..state.loops import ranges
from .broad import farthest
from .closest import ANY, box_faces, closest_facets, narrow

FRESH = 0.3  # of what facets and points may move before all candidates are looked at: up to it boxes stay as they are
LEAST_ROWS = 30  # points in a range of a loop that threads share
# m, depths that are ignored: of a point that has no contact, and of one that has not been looked at
ALL, UNKNOWN = 1e300, -1.0


@njit(cache=True, nogil=True, inline="always")
def _solve3(
    a: float, b: float, c: float, d: float, e: float, f: float, r0: float, r1: float, r2: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Solve the symmetric system [[a, f, e], [f, b, d], [e, d, c]] g = r."""
    m00, m01, m02 = b * c - d * d, d * e - f * c, f * d - b * e
    det = a * m00 + f * m01 + e * m02
    m11, m12, m22 = a * c - e * e, e * f - a * d, a * b - f * f
    inv = 1.0 / det
    return (
        (m00 * r0 + m01 * r1 + m02 * r2) * inv,
        (m01 * r0 + m11 * r1 + m12 * r2) * inv,
        (m02 * r0 + m12 * r1 + m22 * r2) * inv,
    )


@njit(cache=True, nogil=True)
def due(rows: Ints, xp: Floats, seen: Floats, room: Floats, nearest: Ints, way: float) -> Ints:
    """Those of `rows` without a closest triangle, and that may have come within reach of the triangles since they were looked at.

    seen (n,3): where each point was then; room (n,): its gap, m, and the way that the triangles had gone till then; way: till now.
    Point and triangles come closer by no more than both move.
    """
    due_rows = np.empty(len(rows), np.int64)
    count = 0
    for q in range(len(rows)):
        i = rows[q]
        u, v, w = xp[i, 0] - seen[i, 0], xp[i, 1] - seen[i, 1], xp[i, 2] - seen[i, 2]
        left = room[i] - way
        if nearest[i] < 0 or left < 0.0 or u * u + v * v + w * w > left * left:
            due_rows[count] = i
            count += 1
    return due_rows[:count]


@njit(cache=True, nogil=True)
def note(rows: Ints, xp: Floats, gap: Floats, way: float, seen: Floats, room: Floats) -> None:
    """Store for `due` where the points of `rows` are, and their gaps and the way of the triangles, m."""
    for q in range(len(rows)):
        i = rows[q]
        seen[i, 0], seen[i, 1], seen[i, 2] = xp[i, 0], xp[i, 1], xp[i, 2]
        room[i] = gap[i] + way


@njit(cache=True, nogil=True, inline="always")
def follow(deep: float, before: float, moved: float, ignored: float) -> float:
    """The part of a point's penetration depth that gives no contact force, m.

    Where surfaces end on one another the closest facet can be one of which the point lies on the other side: its depth jumps. A spring
    that had that depth at once would give energy that nobody has put in: what motion does not account for is ignored until the point
    has moved out again. deep, before: depth now and when it was looked at last (negative outside); moved: how far point and facets
    have moved since. ignored: before, ALL where the point had lost its contact.
    """
    ignored = max(min(ignored, deep), 0.0)
    return max(ignored, deep - max(before - ignored + moved, 0.0))


@njit(cache=True, nogil=True)
def begin_look(
    rows: Ints, xp: Floats, x: Floats, nodes: Ints, places: Floats, last: Floats, way: Floats, seen: Floats, room: Floats, nearest:
    Ints, active: int,
) -> tuple[Ints, float]:  # fmt: skip
    """Those of the points `rows` that may touch, and how far the facets have gone since the last search, m.

    nodes (k,): those of the facets, ascending, of which only those below `active` move; places, last (k,3): where they were at the
    last search and at the last look; way (1,) m: how far they have gone since the search, step by step. The rest as in `due`.
    """
    shift2 = step2 = 0.0
    for q in range(len(nodes)):
        a = nodes[q]
        if a >= active:
            break
        u, v, w = x[a, 0] - places[q, 0], x[a, 1] - places[q, 1], x[a, 2] - places[q, 2]
        shift2 = max(shift2, u * u + v * v + w * w)
        u, v, w = x[a, 0] - last[q, 0], x[a, 1] - last[q, 1], x[a, 2] - last[q, 2]
        step2 = max(step2, u * u + v * v + w * w)
        last[q, 0], last[q, 1], last[q, 2] = x[a, 0], x[a, 1], x[a, 2]
    way[0] += sqrt(step2)
    return due(rows, xp, seen, room, nearest, way[0]), sqrt(shift2)


@njit(cache=True, nogil=True)
def deepest(rows: Ints, margin: float, jump: float, depth: Floats, ignored: Floats) -> Floats:
    """How deep each of the points `rows` may lie and keep its contact, m; see `end_look`."""
    limit = np.empty(len(rows))
    for q in range(len(rows)):
        i = rows[q]
        kept = max(ignored[i], 0.0) if ignored[i] < ALL else 0.0
        limit[q] = min(margin, depth[i] + kept + jump)
    return limit


@njit(cache=True, nogil=True)
def end_look(
    rows: Ints, shift: float, lost: Floats, way: Floats, margin: float, jump: float, xp: Floats, faces: Faces, partner: Ints, x: Floats,
    start: Ints, boxes: Ints, inner: Ints, within: Floats, at: Floats, seen: Floats, room: Floats, nearest: Ints, foot: Floats, gap:
    Floats, second: Ints, second_foot: Floats, second_gap: Floats, body: Ints, second_body: Ints, depth: Floats, ignored: Floats,
    second_depth: Floats, second_ignored: Floats, spring: Floats,
) -> None:  # fmt: skip
    """Find the facets that each of those points `rows` of `begin_look` meets; the others keep theirs, which they cannot touch.

    A point that lies deeper than margin, or by more than jump deeper than before, lies outside: nearer facets are only known to be
    among the candidates within the margin. It loses its contact: lost, [points that had one, squares of their depths (m2) and of
    their springs (N2)], is added to. body, second_body (n,): whose facets those are, ANY where there is none or it is not known: what a
    point remembers of the second body goes with it when it becomes the first. For ignored see `follow`, for the rest
    `closest_facets`, `due` and `note`.
    """
    before = gap[rows]
    limit = deepest(rows, margin, jump, depth, ignored)
    closest_facets(
        xp, rows, start, boxes, faces, partner, x, shift, limit, inner, within, at, nearest, foot, gap, second, second_foot, second_gap,
    )  # fmt: skip
    for q in range(len(rows)):
        i = rows[q]
        kept = max(ignored[i], 0.0) if ignored[i] < ALL else 0.0
        moved = 1e-9 * margin
        if room[i] == -inf:  # at a search, of a point that was not in question; nothing has moved in it
            before[q] = -depth[i] - kept
        else:
            u, v, w = xp[i, 0] - seen[i, 0], xp[i, 1] - seen[i, 1], xp[i, 2] - seen[i, 2]
            moved += sqrt(u * u + v * v + w * w) + way[0] - (room[i] - before[q])
        if nearest[i] < 0 or gap[i] < -limit[q]:
            nearest[i] = second[i] = -1
            body[i] = second_body[i] = ANY
            ignored[i] = ALL
            stretch = spring[i, 0] ** 2 + spring[i, 1] ** 2 + spring[i, 2] ** 2
            if depth[i] > 0.0 or stretch > 0.0:
                lost[0] += 1.0
                lost[1] += depth[i] * depth[i] + second_depth[i] * second_depth[i]
                lost[2] += stretch
            depth[i] = spring[i, 0] = spring[i, 1] = spring[i, 2] = second_depth[i] = second_ignored[i] = 0.0
            continue
        first, other = faces[boxes[nearest[i]]].body, ANY
        if second[i] >= 0:
            other = faces[boxes[second[i]]].body
        # the two bodies change their order: else what is ignored changes its body, and the force jumps from step to step
        if body[i] != ANY and first == second_body[i]:
            before[q], was = -second_depth[i] - second_ignored[i], max(-before[q], 0.0)
            ignored[i], second_ignored[i] = second_ignored[i], kept
            depth[i], second_depth[i] = second_depth[i], depth[i]
        else:
            was = second_depth[i] + second_ignored[i]
        body[i], second_body[i] = first, other
        if ignored[i] == UNKNOWN:
            ignored[i] = 0.0
        else:
            ignored[i] = follow(-gap[i], -before[q], moved, ignored[i])
            if gap[i] > before[q] + moved:  # out of contact by a jump: what its spring held is lost
                lost[1] += max(depth[i] ** 2 - max(-gap[i] - ignored[i], 0.0) ** 2, 0.0)
        deep = -second_gap[i]
        if deep > 0.0 or was > 0.0:
            second_ignored[i] = follow(deep, was, moved, second_ignored[i])
            if deep < was - moved:
                lost[1] += max(second_depth[i] ** 2 - max(deep - second_ignored[i], 0.0) ** 2, 0.0)
    note(rows, xp, gap, way[0], seen, room)


@njit(cache=True, nogil=True)
def look(team: Ints, rows: Ints, begin: Arrays, end: Arrays, near_rows: Ints, shift: Floats, lost: Floats) -> None:
    """`begin_look` of the points `rows` in one thread, with the arguments `begin`, and `end_look` in all, with `end`. lost (PARTS,3).

    near_rows (n+1,) and shift (1,) pass from one to the other: how many points may touch, and which.
    """
    for _, _, _ in ranges(team, 0, 1, 1):
        near, shift[0] = begin_look(rows, *begin)
        near_rows[0] = len(near)
        near_rows[1 : len(near) + 1] = near
    for lo, hi, part in ranges(team, 1, near_rows[0], LEAST_ROWS):
        end_look(near_rows[lo + 1 : hi + 1], shift[0], lost[part], *end)


@njit(cache=True, nogil=True, inline="always")
def _normal(
    p: Floats, A: Floats, B: Floats, C: Floats, w0: float, w1: float, w2: float, gap: float, tiny: float
) -> tuple[float, float, float]:
    """Unit vector out of the triangle's body along the line that joins p and its closest point; below the distance `tiny` (m), and
    on the surface, the normal."""
    if abs(gap) > tiny:
        d0, d1, d2 = from_foot(p, A, B, C, w0, w1, w2)
        return d0 / gap, d1 / gap, d2 / gap
    n0, n1, n2 = area_vector(A, B, C)
    scale = 1.0 / sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    return n0 * scale, n1 * scale, n2 * scale


@njit(cache=True, nogil=True, inline="always")
def _add_pair(
    f_point: Floats, f_node: Floats, i: int, t: Ints, w0: float, w1: float, w2: float, f0: float, f1: float, f2: float
) -> None:
    """A force on point i, and the opposite one on the place with the weights w on the triangle of nodes t, N."""
    add(f_point, i, f0, f1, f2)
    add(f_node, t[0], -w0 * f0, -w0 * f1, -w0 * f2)
    add(f_node, t[1], -w1 * f0, -w1 * f1, -w1 * f2)
    add(f_node, t[2], -w2 * f0, -w2 * f1, -w2 * f2)


@njit(cache=True, nogil=True)
def second_forces(
    tiny: float, stiffness: float, xp: Floats, rows: Ints, boxes: Ints, faces: Faces, second: Ints, second_foot: Floats, second_gap:
    Floats, second_ignored: Floats, x: Floats, f_point: Floats, f_node: Floats, node: Ints, active: int, sums: Floats, second_depth:
    Floats,
) -> None:  # fmt: skip
    """Penalty forces, without friction, between points and the bodies in which they lie second deepest; added to f_point, f_node and
    to sums[0]. Arguments as in `contact_forces` and `closest_facets`."""
    for q in range(len(rows)):
        i = rows[q]
        if second[i] < 0:
            second_depth[i] = 0.0
            continue
        pen = max(-second_gap[i] - second_ignored[i], 0.0)
        if pen == second_depth[i] == 0.0:
            continue
        t = faces[boxes[second[i]]].nodes
        if len(node) and min(node[i], t[0], t[1], t[2]) >= active:
            continue
        second_depth[i] = pen
        if pen == 0.0:
            continue
        w0, w1, w2 = second_foot[i, 0], second_foot[i, 1], second_foot[i, 2]
        n0, n1, n2 = _normal(xp[i], x[t[0]], x[t[1]], x[t[2]], w0, w1, w2, second_gap[i], tiny)
        sums[0] += 0.5 * stiffness * pen * pen
        f0, f1, f2 = stiffness * pen * n0, stiffness * pen * n1, stiffness * pen * n2
        _add_pair(f_point, f_node, i, t, w0, w1, w2, f0, f1, f2)


@njit(cache=True, nogil=True)
def contact_forces(
    dt: float, tiny: float, stiffness: float, tangential: float, mu: float, xp: Floats, vp: Floats, rows: Ints, boxes: Ints,
    facet_ids: Ints, faces: Faces, nearest: Ints, foot: Floats, gaps: Floats, ignored: Floats, x: Floats, v: Floats, f_point: Floats,
    f_node: Floats, node: Ints, active: int, spring: Floats, heat_point: Floats, heat_facet: Floats, share: float, sums: Floats,
    depth: Floats,
) -> None:  # fmt: skip
    """Penalty and friction forces between points and triangles, equal and opposite in force and in moment.

    xp, vp (n,3) points; rows: the points that may touch; boxes: candidate triangles (places in facet_ids, their numbers, and in faces)
    with nearest (n,) the place in it of the closest one, foot (n,3) and gaps (n,) from `closest_facets`; the nodes of faces have
    outward normals; x, v (N,3) nodes. penetration = minus the signed distance to the closest point of the surface, less what
    of it is ignored (n,) m, force stiffness x penetration along the line that joins them (below the distance `tiny`: the normal).
    spring (n,3): friction force of each point, updated. f_point (n,3), f_node (N,3) are added to. heat_point (n,), heat_facet (k,) J
    receive friction heat, `share` of it the point. sums: [penalty energy, spring energy, friction heat of the step, touching points].
    depth (n,): penetration in m, 0 where there is none. The friction pair acts across the gap between the two surfaces; its moment is
    balanced by a couple on the triangle's nodes, and the slip it works on excludes the triangle's own rotation.
    node (n,): of each point, where points are nodes, of which the first `active` move: springs between others stay as they are.
    """
    sums[0] = sums[1] = sums[2] = sums[3] = 0.0
    for q in range(len(rows)):
        i = rows[q]
        if nearest[i] < 0:
            depth[i] = 0.0
            spring[i, 0] = spring[i, 1] = spring[i, 2] = 0.0
            continue
        pen = -gaps[i] - ignored[i]
        if pen <= 0.0 and depth[i] == 0.0 and spring[i, 0] == 0.0 and spring[i, 1] == 0.0 and spring[i, 2] == 0.0:
            continue  # outside, as before
        fid, t = facet_ids[boxes[nearest[i]]], faces[boxes[nearest[i]]].nodes
        if len(node) and min(node[i], t[0], t[1], t[2]) >= active:
            continue
        gap = gaps[i]
        if pen <= 0.0:
            depth[i] = 0.0
            lost = spring[i, 0] ** 2 + spring[i, 1] ** 2 + spring[i, 2] ** 2
            if lost > 0.0:  # what the spring still held is heat when the contact opens
                sums[2] += 0.5 * lost / tangential
                heat_point[i] += share * 0.5 * lost / tangential
                heat_facet[fid] += (1.0 - share) * 0.5 * lost / tangential
                spring[i, 0] = spring[i, 1] = spring[i, 2] = 0.0
            continue
        A, B, C = x[t[0]], x[t[1]], x[t[2]]
        w0, w1, w2 = foot[i, 0], foot[i, 1], foot[i, 2]
        n0, n1, n2 = _normal(xp[i], A, B, C, w0, w1, w2, gap, tiny)
        depth[i] = pen
        fn = stiffness * pen
        sums[0] += 0.5 * stiffness * pen * pen
        sums[3] += 1.0
        f0, f1, f2 = fn * n0, fn * n1, fn * n2
        g0 = g1 = g2 = 0.0
        m0 = m1 = m2 = 0.0
        if mu > 0.0:
            ra0, ra1, ra2 = (2 * A[0] - B[0] - C[0]) / 3, (2 * A[1] - B[1] - C[1]) / 3, (2 * A[2] - B[2] - C[2]) / 3
            rb0, rb1, rb2 = (2 * B[0] - A[0] - C[0]) / 3, (2 * B[1] - A[1] - C[1]) / 3, (2 * B[2] - A[2] - C[2]) / 3
            rc0, rc1, rc2 = -ra0 - rb0, -ra1 - rb1, -ra2 - rb2
            va, vb, vc = v[t[0]], v[t[1]], v[t[2]]
            xx = ra0 * ra0 + rb0 * rb0 + rc0 * rc0
            yy = ra1 * ra1 + rb1 * rb1 + rc1 * rc1
            zz = ra2 * ra2 + rb2 * rb2 + rc2 * rc2
            xy = ra0 * ra1 + rb0 * rb1 + rc0 * rc1
            xz = ra0 * ra2 + rb0 * rb2 + rc0 * rc2
            yz = ra1 * ra2 + rb1 * rb2 + rc1 * rc2
            h0 = ra1 * va[2] - ra2 * va[1] + rb1 * vb[2] - rb2 * vb[1] + rc1 * vc[2] - rc2 * vc[1]
            h1 = ra2 * va[0] - ra0 * va[2] + rb2 * vb[0] - rb0 * vb[2] + rc2 * vc[0] - rc0 * vc[2]
            h2 = ra0 * va[1] - ra1 * va[0] + rb0 * vb[1] - rb1 * vb[0] + rc0 * vc[1] - rc1 * vc[0]
            # best-fit rotation of the triangle
            o0, o1, o2 = _solve3(yy + zz, xx + zz, xx + yy, -yz, -xz, -xy, h0, h1, h2)
            l0, l1, l2 = gap * n0, gap * n1, gap * n2
            u0 = vp[i, 0] - (w0 * va[0] + w1 * vb[0] + w2 * vc[0]) - (o1 * l2 - o2 * l1)
            u1 = vp[i, 1] - (w0 * va[1] + w1 * vb[1] + w2 * vc[1]) - (o2 * l0 - o0 * l2)
            u2 = vp[i, 2] - (w0 * va[2] + w1 * vb[2] + w2 * vc[2]) - (o0 * l1 - o1 * l0)
            un = u0 * n0 + u1 * n1 + u2 * n2
            sn = spring[i, 0] * n0 + spring[i, 1] * n1 + spring[i, 2] * n2
            g0 = spring[i, 0] - sn * n0 - tangential * dt * (u0 - un * n0)
            g1 = spring[i, 1] - sn * n1 - tangential * dt * (u1 - un * n1)
            g2 = spring[i, 2] - sn * n2 - tangential * dt * (u2 - un * n2)
            size = sqrt(g0 * g0 + g1 * g1 + g2 * g2)
            limit = mu * fn
            if size > limit:
                cut = limit / size
                g0, g1, g2 = g0 * cut, g1 * cut, g2 * cut
                slip = limit * (size - limit) / tangential
                sums[2] += slip
                heat_point[i] += share * slip
                heat_facet[fid] += (1.0 - share) * slip
                size = limit
            spring[i, 0], spring[i, 1], spring[i, 2] = g0, g1, g2
            sums[1] += 0.5 * size * size / tangential
            # couple that balances the moment of the friction pair about the foot point: -(l x g)
            m0, m1, m2 = _solve3(
                yy + zz, xx + zz, xx + yy, -yz, -xz, -xy,
                -(l1 * g2 - l2 * g1), -(l2 * g0 - l0 * g2), -(l0 * g1 - l1 * g0),
            )  # fmt: skip
            add(f_node, t[0], m1 * ra2 - m2 * ra1, m2 * ra0 - m0 * ra2, m0 * ra1 - m1 * ra0)
            add(f_node, t[1], m1 * rb2 - m2 * rb1, m2 * rb0 - m0 * rb2, m0 * rb1 - m1 * rb0)
            add(f_node, t[2], m1 * rc2 - m2 * rc1, m2 * rc0 - m0 * rc2, m0 * rc1 - m1 * rc0)
        f0, f1, f2 = f0 + g0, f1 + g1, f2 + g2
        _add_pair(f_point, f_node, i, t, w0, w1, w2, f0, f1, f2)


@njit(cache=True, nogil=True)
def refresh_sides(
    lo: int, hi: int, spans: Ints, numbers: Floats, rows: Ints, start: Ints, boxes: Ints, faces: Faces, nodes: Ints, places: Floats,
    node_of: Ints, x: Floats, xp: Floats, inner: Ints, within: Floats, at: Floats, nearest: Ints, gap: Floats, second: Ints, depth:
    Floats, ignored: Floats,
) -> None:  # fmt: skip
    """The boxes around the faces of the sides [lo, hi) and the places (m) of their nodes, brought up to now, and `narrow` by
    them; of a side that has hardly moved they stay."""
    for s in range(lo, hi):
        r, r1, p, p1, q, q1, b, b1, i, i1, n, n1, _, _ = spans[s]
        most = 0.0
        for row in rows[r:r1]:
            way2 = 0.0
            for d in range(3):
                xp[p + row, d] = x[node_of[p + row], d]
                way2 += (xp[p + row, d] - at[p + row, d]) ** 2
            most = max(most, way2)
        if farthest(x, nodes[n:n1], places[n:n1]) + sqrt(most) < FRESH * numbers[s, 1]:
            continue
        box_faces(x, faces[i:i1])
        for k in range(n, n1):
            for d in range(3):
                places[k, d] = x[nodes[k], d]
        limit = deepest(rows[r:r1], numbers[s, 0], numbers[s, 1], depth[p:p1], ignored[p:p1])
        narrow(
            rows[r:r1], numbers[s, 1], xp[p:p1], start[q:q1], boxes[b:b1], faces[i:i1], limit, gap[p:p1], nearest[p:p1],
            second[p:p1], inner[p:p1], within[p:p1], at[p:p1],
        )  # fmt: skip


@njit(cache=True, nogil=True)
def look_of_sides(
    lo: int, hi: int, spans: Ints, numbers: Floats, rows: Ints, start: Ints, boxes: Ints, faces: Faces, nodes: Ints, places: Floats,
    last: Floats, way: Floats, node_of: Ints, partner: Ints, x: Floats, xp: Floats, inner: Ints, within: Floats, at: Floats, seen:
    Floats, room: Floats, nearest: Ints, foot: Floats, gap: Floats, second: Ints, second_foot: Floats, second_gap: Floats, body: Ints,
    second_body: Ints, depth: Floats, ignored: Floats, second_depth: Floats, second_ignored: Floats, spring: Floats, lost: Floats,
    active: int, met: Ints, meeting: Ints,
) -> None:  # fmt: skip
    """`begin_look` and `end_look` for the sides [lo, hi), each on its part of the arrays (`penalty.SideBySide`); xp (n,3) is written
    for their rows. met: those of the rows of each side that may touch, in its part, meeting (sides,): how many they are."""
    for s in range(lo, hi):
        r, r1, p, p1, q, q1, b, b1, i, i1, n, n1, _, _ = spans[s]
        for row in rows[r:r1]:
            for d in range(3):
                xp[p + row, d] = x[node_of[p + row], d]
        own = way[s : s + 1]
        near, shift = begin_look(
            rows[r:r1],
            xp[p:p1],
            x,
            nodes[n:n1],
            places[n:n1],
            last[n:n1],
            own,
            seen[p:p1],
            room[p:p1],
            nearest[p:p1],
            active,
        )
        meeting[s] = len(near)
        met[r : r + len(near)] = near
        end_look(
            near, shift, lost[s], own, numbers[s, 0], numbers[s, 1], xp[p:p1], faces[i:i1], partner[p:p1], x, start[q:q1], boxes[b:b1],
            inner[p:p1], within[p:p1], at[p:p1], seen[p:p1], room[p:p1],
            nearest[p:p1], foot[p:p1], gap[p:p1], second[p:p1], second_foot[p:p1], second_gap[p:p1], body[p:p1], second_body[p:p1],
            depth[p:p1], ignored[p:p1], second_depth[p:p1], second_ignored[p:p1], spring[p:p1],
        )  # fmt: skip


@njit(cache=True, nogil=True)
def forces_of_sides(
    dt: float, mu: float, share: float, spans: Ints, numbers: Floats, met: Ints, meeting: Ints, boxes: Ints, ids: Ints, faces: Faces,
    node_of: Ints, x: Floats, v: Floats, f: Floats, active: int, xp: Floats, vp: Floats, fp: Floats, nearest: Ints, foot: Floats, gap:
    Floats, second: Ints, second_foot: Floats, second_gap: Floats, depth: Floats, ignored: Floats, second_depth: Floats,
    second_ignored: Floats, spring: Floats, heat_point: Floats, heat_facet: Floats, sums: Floats,
) -> None:  # fmt: skip
    """`contact_forces` and `second_forces` of all sides, one after the other, added to f (N,3); sums (sides,4). Only the points that
    `look_of_sides` has `met` matter: all others lie outside, and hold nothing after the first step."""
    for s in range(len(spans)):
        r, _, p, p1, _, _, b, b1, i, i1, _, _, t, t1 = spans[s]
        rows = met[r : r + meeting[s]]
        for row in rows:
            for d in range(3):
                vp[p + row, d] = v[node_of[p + row], d]
                fp[p + row, d] = 0.0
        contact_forces(
            dt, numbers[s, 2], numbers[s, 3], numbers[s, 4], mu, xp[p:p1], vp[p:p1], rows, boxes[b:b1], ids[i:i1],
            faces[i:i1], nearest[p:p1], foot[p:p1], gap[p:p1], ignored[p:p1], x, v, fp[p:p1], f, node_of[p:p1], active, spring[p:p1],
            heat_point[p:p1], heat_facet[t:t1], share, sums[s], depth[p:p1],
        )  # fmt: skip
        second_forces(
            numbers[s, 2], numbers[s, 3], xp[p:p1], rows, boxes[b:b1], faces[i:i1], second[p:p1], second_foot[p:p1],
            second_gap[p:p1], second_ignored[p:p1], x, fp[p:p1], f, node_of[p:p1], active, sums[s], second_depth[p:p1],
        )  # fmt: skip
        for row in rows:
            add(f, node_of[p + row], fp[p + row, 0], fp[p + row, 1], fp[p + row, 2])
