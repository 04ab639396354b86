"""Contact of points with triangles: projection of the points in each step, and contact forces (numba)."""

from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from ..compiling import njit, uncounted
from ..core.arrays import Bools, Faces, Floats, Histories, History, Ints, Vector
from ..core.loops import ranges
from ..geometry.vector_kernels import add, area_vector, from_foot
from .closest import closest_faces
from .law import TANGENTIAL, friction_force, normal_force, stored
from .model import ALL, ANY, UNKNOWN, Candidates, Constants, Motion, Nodes, Points, Projections, Pushes

LEAST_ROWS = 30  # points in a range of a loop that threads share
LEAST_SEARCHED = 2000  # points in such a range of a search
NEAR, SHEARED = 1, 2  # states of a point in a search, see `begin_search`
KEPT, AWAY, OUTSIDE = 0, 1, 2  # and `end_search`


@njit(cache=True, nogil=True, inline="always")
def _solve3(
    a: float, b: float, c: float, d: float, e: float, f: float, r0: float, r1: float, r2: float,
) -> Vector:  # fmt: skip
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
def add_travel(lo: int, hi: int, m: Motion, x: Floats, active: int) -> None:
    """Increase the travel of the bodies lo to hi - 1 by the largest displacement, since the last call, of a node of their candidate
    faces. Only the first `active` nodes move."""
    for body in range(lo, hi):
        most = 0.0
        for q in range(m.bounds[body], m.bounds[body + 1]):
            a = m.nodes[q]
            if a < active:
                u, v, w = x[a, 0] - m.last[q, 0], x[a, 1] - m.last[q, 1], x[a, 2] - m.last[q, 2]
                most = max(most, u * u + v * v + w * w)
                m.last[q, 0], m.last[q, 1], m.last[q, 2] = x[a, 0], x[a, 1], x[a, 2]
        m.travel[body] += sqrt(most)


@njit(cache=True, nogil=True, inline="always")
def _squared(h: History) -> float:
    """Square of the friction force in a history, N2."""
    return h.spring[0] ** 2 + h.spring[1] ** 2 + h.spring[2] ** 2


@njit(cache=True, nogil=True, inline="always")
def _ignored(h: History) -> float:
    """Penetration without force in the first body of a history, m."""
    return max(h.ignored[0], 0.0) if h.ignored[0] < ALL else 0.0


@njit(cache=True, nogil=True, inline="always")
def _deepest(h: History, margin: float, jump: float) -> float:
    """Largest depth (m) at which a point keeps its contact: its last depth plus `jump` (m), but at most `margin` (m)."""
    return min(margin, h.depth[0] + _ignored(h) + jump)


@njit(cache=True, nogil=True)
def deepest(rows: Ints, history: Histories, points: Points, jump: float) -> Floats:
    """Largest depth (k,) m at which each of the points `rows` keeps its contact (`_deepest`). jump: in spacings."""
    limit = np.empty(len(rows))
    for q in range(len(rows)):
        i = rows[q]
        limit[q] = _deepest(history[i], points.margin[i], jump * points.spacing[i])
    return limit


@njit(cache=True, nogil=True)
def begin_search(
    team: Ints, due: Bools, travel: Floats, least: Floats, most: Floats, known: Bools, points: Points, proj: Projections, history:
    Histories, state: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Prepare a search of the points of the bodies in the mask due (bodies,), in all threads: set their margins and delete their
    projections. Points outside the mask known (n,) get the clearance -inf.

    travel (bodies,) m: relative displacement of points and faces up to which the search is valid; least, most (3,) m: bounding box of
    the faces. Writes state (n,): NEAR for points within their margin of this box, plus SHEARED for points with a friction spring.
    """
    for lo, hi, _ in ranges(team, 0, len(points.owner), LEAST_SEARCHED):
        for i in range(lo, hi):
            state[i] = 0
            body = points.owner[i]
            if not due[body]:
                continue
            far = 0.5 * points.spacing[i] + travel[body]  # a point keeps its contact down to a depth of half a spacing
            points.margin[i] = far
            proj.face[i, 0] = proj.face[i, 1] = -1
            if not known[i]:
                proj.clearance[i] = -inf
            x, is_near = points.x[i], True
            for d in range(3):
                is_near = is_near and least[d] - far <= x[d] <= most[d] + far
            if is_near:
                state[i] = NEAR
            if _squared(history[i]) > 0.0:
                state[i] += SHEARED


@njit(cache=True, nogil=True)
def end_search(team: Ints, state: NDArray[np.uint8], history: Histories) -> None:
    """Set the depths of points with the state AWAY or OUTSIDE (n,) to zero. For points OUTSIDE, delete also the rest of the history
    except the friction spring. In all threads."""
    for lo, hi, _ in ranges(team, 0, len(state), LEAST_SEARCHED):
        for i in range(lo, hi):
            h = history[i]
            if state[i] >= AWAY:
                h.depth[0] = h.depth[1] = 0.0
            if state[i] == OUTSIDE:
                h.ignored[0] = h.ignored[1] = 0.0
                h.body[0] = h.body[1] = ANY


@njit(cache=True, nogil=True, inline="always")
def ignored_depth(deep: float, before: float, moved: float, ignored: float) -> float:
    """The part of a point's penetration depth that gives no contact force, m.

    At the rim of a surface the closest face can change to one on the other side of the body, and the depth of the point jumps. A
    spring with this depth would create energy. Therefore the part of the depth that the motion does not explain is ignored until the
    point has moved out again. deep, before: depth now and at the last projection, negative outside; moved: relative displacement of
    point and faces since then; ignored: value of the last projection, ALL if the point had lost its contact. All in m.
    """
    ignored = max(min(ignored, deep), 0.0)
    return max(ignored, deep - max(before - ignored + moved, 0.0))


@uncounted
def _update_history(
    i: int, k: float, limit: float, moved: float, before: float, proj: Projections, faces: Faces, h: History, lost: Floats
) -> None:  # fmt: skip
    """Update the contact history h of point i to its new projection. k (N/m): stiffness; before: gap at the last projection, m;
    moved: see `ignored_depth`.

    A point deeper than limit (m) loses its contact: it counts as outside, because beyond the margin of the search nearer faces can
    be missing. lost grows by [number of such points with a contact, energy (J) of their springs]. If the second body becomes the
    first one, its history moves to the first column.
    """
    if proj.face[i, 0] < 0 or proj.gap[i, 0] < -limit:
        proj.face[i, 0] = proj.face[i, 1] = ANY
        energy = stored(k, h.depth[0], _squared(h))
        if energy > 0.0:
            lost[0] += 1.0
            lost[1] += energy + stored(k, h.depth[1], 0.0)
        h.spring[0] = h.spring[1] = h.spring[2] = h.depth[0] = h.depth[1] = 0.0
        h.ignored[0], h.ignored[1] = ALL, 0.0
        h.body[0] = h.body[1] = ANY
        return
    first, other = faces[proj.face[i, 0]].body, ANY
    if proj.face[i, 1] >= 0:
        other = faces[proj.face[i, 1]].body
    # the two bodies change their order: without this exchange the ignored depth would belong to the other body, and the force would
    # jump
    if h.body[0] != ANY and first == h.body[1]:
        before, was = -h.depth[1] - h.ignored[1], max(-before, 0.0)
        h.ignored[0], h.ignored[1] = h.ignored[1], _ignored(h)
        h.depth[0], h.depth[1] = h.depth[1], h.depth[0]
    else:
        was = h.depth[1] + h.ignored[1]
    h.body[0], h.body[1] = first, other
    if h.ignored[0] == UNKNOWN:
        h.ignored[0] = 0.0
    else:
        h.ignored[0] = ignored_depth(-proj.gap[i, 0], -before, moved, h.ignored[0])
        if proj.gap[i, 0] > before + moved:  # a jump out of contact: the energy of the spring is lost
            left = stored(k, max(-proj.gap[i, 0] - h.ignored[0], 0.0), 0.0)
            lost[1] += max(stored(k, h.depth[0], 0.0) - left, 0.0)
    deep = -proj.gap[i, 1]
    if deep > 0.0 or was > 0.0:
        h.ignored[1] = ignored_depth(deep, was, moved, h.ignored[1])
        if deep < was - moved:
            left = stored(k, max(deep - h.ignored[1], 0.0), 0.0)
            lost[1] += max(stored(k, h.depth[1], 0.0) - left, 0.0)


@uncounted
def project(
    team: Ints, rows: Ints, jump: float, points: Points, nodes: Nodes, c: Candidates, faces: Faces, motion: Motion, proj: Projections,
    history: Histories, due: Bools, lost: Floats,
) -> None:  # fmt: skip
    """Project each of the points `rows`. A point keeps its projection while its displacement plus the travel of its faces is too
    small for a contact.

    jump: largest inward motion of a point in one step, in spacings; due (k,): set to True for projected points; lost (PARTS,2): see
    `_update_history`.
    """
    for lo, hi, _ in ranges(team, 0, len(motion.travel), 4):
        add_travel(lo, hi, motion, nodes.x, nodes.active)
    for lo, hi, part in ranges(team, 1, len(rows), LEAST_ROWS):
        for q in range(lo, hi):
            i = rows[q]
            travel, margin, more = motion.travel[points.owner[i]], points.margin[i], jump * points.spacing[i]
            u, v, w = points.x[i, 0] - proj.at[i, 0], points.x[i, 1] - proj.at[i, 1], points.x[i, 2] - proj.at[i, 2]
            own, left = sqrt(u * u + v * v + w * w), proj.clearance[i] - travel
            if proj.face[i, 0] >= 0 and own <= left:
                continue
            due[q] = True
            h, before, moved = history[i], proj.gap[i, 0], 1e-9 * margin
            if proj.clearance[i] == -inf:  # at a search, for a point that was not in `rows`: nothing has moved since
                before = -h.depth[0] - _ignored(h)
            else:
                moved += own + travel - (proj.clearance[i] - before)
            limit = _deepest(h, margin, more)
            closest_faces(i, points, c, faces, nodes.x, travel, limit, proj)
            _update_history(i, points.stiffness[i], limit, moved, before, proj, faces, h, lost[part])
            proj.at[i, 0], proj.at[i, 1], proj.at[i, 2] = points.x[i, 0], points.x[i, 1], points.x[i, 2]
            proj.clearance[i] = proj.gap[i, 0] + travel


@njit(cache=True, nogil=True, inline="always")
def _normal(p: Floats, A: Floats, B: Floats, C: Floats, foot: Floats, gap: float, tiny: float) -> Vector:
    """Unit vector along the line between p and its closest point on the triangle, out of the triangle's body; the normal of the
    triangle if the distance is at most `tiny` m."""
    if abs(gap) > tiny:
        d0, d1, d2 = from_foot(p, A, B, C, foot[0], foot[1], foot[2])
        return d0 / gap, d1 / gap, d2 / gap
    n0, n1, n2 = area_vector(A, B, C)
    scale = 1.0 / sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    return n0 * scale, n1 * scale, n2 * scale


@uncounted
def _friction(
    i: int, dt: float, mu: float, pen: float, normal: Vector, points: Points, nodes: Nodes, t: Ints, proj: Projections, h: History,
    couple: Floats,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Friction force (3,) N on point i with the penetration pen (m), and heat (J) of its slip in a step of dt (s). Updates the spring.

    The pair of friction forces acts across the gap between the two surfaces. A couple (3,3) N on the triangle's nodes t balances its
    moment. The slip does not include the rotation of the triangle.
    """
    n0, n1, n2 = normal
    A, B, C = nodes.x[t[0]], nodes.x[t[1]], nodes.x[t[2]]
    va, vb, vc = nodes.v[t[0]], nodes.v[t[1]], nodes.v[t[2]]
    k, w, s, v = points.stiffness[i], proj.foot[i, 0], h.spring, points.v[i]
    ra0, ra1, ra2 = (2 * A[0] - B[0] - C[0]) / 3, (2 * A[1] - B[1] - C[1]) / 3, (2 * A[2] - B[2] - C[2]) / 3
    rb0, rb1, rb2 = (2 * B[0] - A[0] - C[0]) / 3, (2 * B[1] - A[1] - C[1]) / 3, (2 * B[2] - A[2] - C[2]) / 3
    rc0, rc1, rc2 = -ra0 - rb0, -ra1 - rb1, -ra2 - rb2
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
    gap = proj.gap[i, 0]
    l0, l1, l2 = gap * n0, gap * n1, gap * n2
    u0 = v[0] - (w[0] * va[0] + w[1] * vb[0] + w[2] * vc[0]) - (o1 * l2 - o2 * l1)
    u1 = v[1] - (w[0] * va[1] + w[1] * vb[1] + w[2] * vc[1]) - (o2 * l0 - o0 * l2)
    u2 = v[2] - (w[0] * va[2] + w[1] * vb[2] + w[2] * vc[2]) - (o0 * l1 - o1 * l0)
    un = u0 * n0 + u1 * n1 + u2 * n2
    sn = s[0] * n0 + s[1] * n1 + s[2] * n2
    g0 = s[0] - sn * n0 - TANGENTIAL * k * dt * (u0 - un * n0)
    g1 = s[1] - sn * n1 - TANGENTIAL * k * dt * (u1 - un * n1)
    g2 = s[2] - sn * n2 - TANGENTIAL * k * dt * (u2 - un * n2)
    size = sqrt(g0 * g0 + g1 * g1 + g2 * g2)
    friction, heat = friction_force(k, mu, pen, size)
    if friction < size:
        scale = friction / size
        g0, g1, g2 = g0 * scale, g1 * scale, g2 * scale
    s[0], s[1], s[2] = g0, g1, g2
    # the couple -(l x g) balances the moment of the pair about the closest point
    m0, m1, m2 = _solve3(
        yy + zz, xx + zz, xx + yy, -yz, -xz, -xy, -(l1 * g2 - l2 * g1), -(l2 * g0 - l0 * g2), -(l0 * g1 - l1 * g0)
    )  # fmt: skip
    couple[0, 0], couple[0, 1], couple[0, 2] = m1 * ra2 - m2 * ra1, m2 * ra0 - m0 * ra2, m0 * ra1 - m1 * ra0
    couple[1, 0], couple[1, 1], couple[1, 2] = m1 * rb2 - m2 * rb1, m2 * rb0 - m0 * rb2, m0 * rb1 - m1 * rb0
    couple[2, 0], couple[2, 1], couple[2, 2] = m1 * rc2 - m2 * rc1, m2 * rc0 - m0 * rc2, m0 * rc1 - m1 * rc0
    return g0, g1, g2, heat


@uncounted
def _push(
    q: int,
    dt: float,
    c: Constants,
    points: Points,
    nodes: Nodes,
    faces: Faces,
    proj: Projections,
    h: History,
    p: Pushes,
) -> None:
    """Write the force, the couple and the heat of row q to p. h: history of the point of this row."""
    i, mu, share = p.rows[q], c.friction, c.share
    force, couple, heat, heat_point = p.force[q], p.couple[q], p.heat[q], p.heat_point
    force[:], couple[:], heat[:] = 0.0, 0.0, 0.0
    k = points.stiffness[i]
    for body in range(2):
        g2 = _squared(h) if body == 0 else 0.0
        pen = 0.0 if proj.face[i, body] < 0 else max(-proj.gap[i, body] - h.ignored[body], 0.0)
        if pen == 0.0 and h.depth[body] == 0.0 and g2 == 0.0:
            continue  # outside before and now
        face = proj.face[i, body]
        t = faces[face].nodes
        if face >= 0 and min(points.node[i], t[0], t[1], t[2]) >= nodes.active:
            continue
        h.depth[body] = pen
        if pen == 0.0:  # the contact opens: the energy of the friction spring becomes heat
            if body == 0:
                h.spring[0] = h.spring[1] = h.spring[2] = 0.0
                if face >= 0:
                    heat_point[i] += stored(k, 0.0, share * g2)
                    heat[0], heat[1] = stored(k, 0.0, g2), stored(k, 0.0, (1.0 - share) * g2)
            continue
        A, B, C, tiny = nodes.x[t[0]], nodes.x[t[1]], nodes.x[t[2]], 1e-6 * points.spacing[i]
        n = _normal(points.x[i], A, B, C, proj.foot[i, body], proj.gap[i, body], tiny)
        normal = normal_force(k, pen)
        f0, f1, f2 = normal * n[0], normal * n[1], normal * n[2]
        if mu > 0.0 and body == 0:
            t0, t1, t2, worn = _friction(i, dt, mu, pen, n, points, nodes, t, proj, h, couple)
            f0, f1, f2 = f0 + t0, f1 + t1, f2 + t2
            heat_point[i] += share * worn
            heat[0], heat[1] = worn, (1.0 - share) * worn
        force[body, 0], force[body, 1], force[body, 2] = f0, f1, f2


@uncounted
def contact_forces(
    team: Ints, dt: float, constants: Constants, points: Points, nodes: Nodes, c: Candidates, faces: Faces, motion: Motion,
    proj: Projections, history: Histories, pushes: Pushes, sums: Floats,
) -> None:  # fmt: skip
    """`project` the points pushes.rows, compute the forces between them and their closest faces, and add them to points.f and nodes.f,
    in all threads. sums (PARTS,3): `lost` of `project` is added to the first two columns, the heat of friction, J, to sums[0, 2].

    Forces are opposite and equal, and their moments cancel. The penetration is minus the signed gap, less the ignored depth. The
    normal force acts along the line to the closest point (`_normal`). Friction acts only with the body in which the point lies
    deepest. pushes.heat_point and pushes.heat_face grow by the heat of friction. Springs between nodes that do not move do not
    change.
    """
    rows = pushes.rows
    project(team, rows, constants.jump, points, nodes, c, faces, motion, proj, history, pushes.due, sums)
    for lo, hi, _ in ranges(team, 2, len(rows), LEAST_ROWS):
        for q in range(lo, hi):
            if pushes.due[q]:
                _push(q, dt, constants, points, nodes, faces, proj, history[rows[q]], pushes)
    for _ in ranges(team, 3, 1, 1):  # one thread: several points act on a node
        for q in range(len(rows)):
            if not pushes.due[q]:
                continue
            i, f, m, h = rows[q], pushes.force[q], pushes.couple[q], history[rows[q]]
            # a point without springs gets no force until its next projection
            pushes.due[q] = h.depth[0] != 0.0 or h.depth[1] != 0.0 or _squared(h) > 0.0
            sums[0, 2] += pushes.heat[q, 0]
            if pushes.heat[q, 1] != 0.0:
                pushes.heat_face[proj.face[i, 0]] += pushes.heat[q, 1]
            for body in range(2):
                if f[body, 0] == 0.0 and f[body, 1] == 0.0 and f[body, 2] == 0.0:
                    continue
                t = faces[proj.face[i, body]].nodes
                if body == 0:
                    for corner in range(3):
                        add(nodes.f, t[corner], m[corner, 0], m[corner, 1], m[corner, 2])
                add(points.f, i, f[body, 0], f[body, 1], f[body, 2])
                for corner in range(3):
                    w = -proj.foot[i, body, corner]
                    add(nodes.f, t[corner], w * f[body, 0], w * f[body, 1], w * f[body, 2])


@njit(cache=True, nogil=True)
def energy(team: Ints, points: Points, history: Histories, sums: Floats) -> None:
    """Write the energy of the normal and friction springs in each part of the points to sums (PARTS,) J, in all threads."""
    for lo, hi, part in ranges(team, 0, len(history), LEAST_SEARCHED):
        for i in range(lo, hi):
            h, k = history[i], points.stiffness[i]
            sums[part] += stored(k, h.depth[0], _squared(h)) + stored(k, h.depth[1], 0.0)


@njit(cache=True, nogil=True)
def gather(rows: Ints, points: Points, nodes: Nodes) -> None:
    """Copy positions and velocities of the nodes to the points `rows`, and set the forces on these points to zero."""
    for i in rows:
        for d in range(3):
            points.x[i, d], points.v[i, d], points.f[i, d] = nodes.x[points.node[i], d], nodes.v[points.node[i], d], 0.0


@njit(cache=True, nogil=True)
def scatter(rows: Ints, points: Points, nodes: Nodes) -> None:
    """Add the forces on the points `rows` to the forces on their nodes."""
    for i in rows:
        add(nodes.f, points.node[i], points.f[i, 0], points.f[i, 1], points.f[i, 2])
