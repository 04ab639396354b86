"""Bonds of nodes to triangles: which faces which, damage, cohesive forces (numba). Rows in order: the same sums every time."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from ..compiling import njit
from ..core.arrays import Bools, Floats, Ints
from ..geometry.vector_kernels import add, area_vector, from_foot
from .closest import closest_on_triangle


class Ties(NamedTuple):
    """Bonds between points and points on triangles, one row per bond as in `bond.Bond`. Columns: normal, shear. weakness (n,2): 1 /
    strength, 1/Pa; ease (n,2): 1 / fracture energy, m2/J; alpha: exponent of the power law of mixed modes.

    gap: distance of the point above the triangle, along its normal n, at which the bond has no force. With k the stiffness, Pa/m, and d
    from the bond's point on the triangle to the other point, the potential is

        U = area k / 2 (delta^2 + |s|^2),   delta = d.n - gap,   s = d - (d.n) n

    and the forces are its gradient, including the term of n: this term gives the couple that balances the moment of the forces across
    the gap. Where a bond yields, the permanent part of delta is added to gap, and that part of s moves the point on the triangle:
    unloading is elastic, to a residual opening. opening: elastic, max(delta, 0) n + s.
    """

    nodes: Ints
    triangles: Ints
    weights: Floats
    gap: Floats
    area: Floats
    stiffness: Floats
    weakness: Floats
    ease: Floats
    rewelds: Floats
    loose: Bools
    damage: Floats
    opening: Floats
    traction: Floats
    slid: Floats
    spent: Floats
    alpha: float


@njit(cache=True, nogil=True)
def facing(
    points: Floats, outward: Floats, start: Ints, boxes: Ints, ids: Ints, facets: Ints, x: Floats, face: Ints, weights:
    Floats, gap: Floats,
) -> None:  # fmt: skip
    """The closest triangle that each point looks at, if any: face (n,), weights (n,3), signed gap (n,) m are written.

    outward (n,3): normals of the surface at the points; a triangle is looked at when its normal is against it. start,
    boxes: candidates as `broad.candidates` gives them, indices into ids; facets (k,3), x (N,3). Where an edge or corner is
    closest, the triangle that looks most towards the point says inside or outside.
    """
    for i in range(len(points)):
        p, o = points[i], outward[i]
        best = 1e300
        straight = -1.0
        for r in range(start[i], start[i + 1]):
            t = facets[ids[boxes[r]]]
            A, B, C = x[t[0]], x[t[1]], x[t[2]]
            n0, n1, n2 = area_vector(A, B, C)
            if n0 * o[0] + n1 * o[1] + n2 * o[2] >= 0.0:
                continue
            a, b, c = closest_on_triangle(p, A, B, C)
            d0, d1, d2 = from_foot(p, A, B, C, a, b, c)
            dd = d0 * d0 + d1 * d1 + d2 * d2
            if dd > best * (1.0 + 1e-9):
                continue
            dn = d0 * n0 + d1 * n1 + d2 * n2
            align = abs(dn) / sqrt((n0 * n0 + n1 * n1 + n2 * n2) * dd + 1e-300)
            if dd < best * (1.0 - 1e-9) or align > straight:
                best, straight = dd, align
                face[i] = ids[boxes[r]]
                weights[i, 0], weights[i, 1], weights[i, 2] = a, b, c
                gap[i] = sqrt(dd) if dn >= 0.0 else -sqrt(dd)


@njit(cache=True, nogil=True)
def softening(a: float, b: float, ease_n: float, ease_s: float, alpha: float) -> float:
    """2 (1 - D) dD / dl of `yielding`, m2/J. a, b: tractions over their strengths."""
    e = 0.0
    if a > 0.0:
        e += (a * a * ease_n) ** alpha
    if b > 0.0:
        e += (b * b * ease_s) ** alpha
    return e ** (1.0 / alpha)


@njit(cache=True, nogil=True)
def flow(
    a: float, b: float, soft_n: float, soft_s: float, ease_n: float, ease_s: float, alpha: float, held: float
) -> float:  # fmt: skip
    """The multiplier dl of `yielding` that brings tractions back to the locus; infinite where nothing of the bond is left.

    a, b: trial tractions over their strengths; soft = k / strength^2; held: 1 - D before the step. With m = |(a, b)| of the tractions
    at the end of the step, m + dl softening / 2 m = held: regula falsi (Illinois) in y = c dl / (1 + c dl), which is linear in one
    direction.
    """
    c = 0.0
    la = lb = 0.0  # direction of the tractions as dl grows without bound
    if a > 0.0:
        c, la = soft_n, a / soft_n
    if b > 0.0:
        c, lb = max(c, soft_s), b / soft_s
    low, above = 0.0, sqrt(a * a + b * b) - held
    high, below = 1.0, softening(la, lb, ease_n, ease_s, alpha) / (2.0 * sqrt(la * la + lb * lb)) - held
    if below >= -1e-14 * above:  # what is left is lost in rounding
        return np.inf
    dl, side = 0.0, 0
    for _ in range(100):
        y = (low * below - high * above) / (below - above)
        dl = y / (c * (1.0 - y))
        ta, tb = a / (1.0 + soft_n * dl), b / (1.0 + soft_s * dl)
        m = sqrt(ta * ta + tb * tb)
        h = m + dl * softening(ta, tb, ease_n, ease_s, alpha) / (2.0 * m) - held
        if abs(h) <= 1e-14 * held:
            break
        if h > 0.0:
            low, above = y, h
            below *= 0.5 if side == 1 else 1.0
            side = 1
        else:
            high, below = y, h
            above *= 0.5 if side == -1 else 1.0
            side = -1
    return dl


@njit(cache=True, nogil=True)
def yielding(
    wide: float, slip: float, k: float, weakness_n: float, weakness_s: float, ease_n: float, ease_s: float, alpha: float,
    D: float, most: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Shares of the elastic opening and of the elastic slip that become permanent, and the damage then, of a bond of damage D.

    wide, slip: elastic opening and slip, m; k: stiffness, Pa/m; weakness: 1/strength in tension and shear, 1/Pa; ease: 1/fracture
    energy, m2/J. The tractions t = k delta stay within (t_n/N)^2 + (t_s/S)^2 = (1 - D)^2, the onset of Camanho & Davila (2002),
    NASA/TM-2002-211737. Beyond it the opening flows normal to this locus (Drucker 1951):

        dp_n = dl t_n / N^2,  dp_s = dl t_s / S^2,  dD = ((t_n dp_n / G_I)^alpha + (t_s dp_s / G_II)^alpha)^(1/alpha) / 2 (1 - D)

    Then in one direction the softening is linear, and tractions that keep their ratio end where (G_I/G_Ic)^alpha +
    (G_II/G_IIc)^alpha = 1. t_n, t_s and D are those of the end of the step. From the damage `most` on the bond flows at the strength
    that is left.
    """
    a, b = k * wide * weakness_n, k * slip * weakness_s
    if a * a + b * b <= (1.0 - D) ** 2:
        return 0.0, 0.0, D
    soft_n, soft_s = k * weakness_n**2, k * weakness_s**2
    dl = flow(a, b, soft_n, soft_s, ease_n, ease_s, alpha, 1.0 - D)
    softened = 1.0
    if dl < np.inf:
        ta, tb = a / (1.0 + soft_n * dl), b / (1.0 + soft_s * dl)
        softened = D + dl * softening(ta, tb, ease_n, ease_s, alpha) / (2.0 * sqrt(ta * ta + tb * tb))
    if softened >= most:
        softened = max(D, most)
        dl = flow(a, b, soft_n, soft_s, 0.0, 0.0, 1.0, 1.0 - softened) if softened < 1.0 else np.inf
    if dl == np.inf:
        return 1.0, 1.0, 1.0
    return soft_n * dl / (1.0 + soft_n * dl), soft_s * dl / (1.0 + soft_s * dl), softened


@njit(cache=True, nogil=True)
def bond_forces(
    xp: Floats, x: Floats, b: Ties, depth: Floats, active: int, f_point: Floats, f: Floats
) -> tuple[float, float]:  # fmt: skip
    """Forces of cohesive bonds between points xp and triangles of nodes x (N,3) m, equal and opposite in force and moment, added to
    f_point and f (N,3). The bonds move on in place. Returns the energy stored, and that dissipated by this call, J.

    depth (n,) m: penetration of a contact that presses point i; 0 where the contact presses beside it (`in_contact`); negative where it
    is free. In contact the net normal traction is compressive: delta is 0 and the gap follows the surface, so that the bond opens from
    where the contact lets go; slip then takes no more than the share 1 - rewelds of the strength. loose bonds leave compression to a
    contact. active: nodes that move, the first ones; bonds between others stay as they are, and add no forces.
    """
    stored = lost = 0.0
    for i in range(len(b.nodes)):
        t0, t1, t2 = b.triangles[i, 0], b.triangles[i, 1], b.triangles[i, 2]
        k = b.stiffness[i]
        if min(b.nodes[i], t0, t1, t2) >= active:
            stored += 0.5 * b.area[i] * (b.traction[i, 0] ** 2 + b.traction[i, 1] ** 2) / k
            continue
        A, B, C, p = x[t0], x[t1], x[t2], xp[b.nodes[i]]
        wa, wb, wc = b.weights[i, 0], b.weights[i, 1], b.weights[i, 2]
        n0, n1, n2 = area_vector(A, B, C)
        size = sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        n0, n1, n2 = n0 / size, n1 / size, n2 / size
        u0, u1, u2 = B[0] - A[0], B[1] - A[1], B[2] - A[2]
        v0, v1, v2 = C[0] - A[0], C[1] - A[1], C[2] - A[2]
        d0, d1, d2 = from_foot(p, A, B, C, wa, wb, wc)
        h = d0 * n0 + d1 * n1 + d2 * n2
        loss, most = 0.0, 1.0
        if depth[i] > 0.0 or (depth[i] == 0.0 and b.traction[i, 0] <= 0.0):
            b.gap[i] = h + depth[i]
            most -= b.rewelds[i]
            if b.traction[i, 0] > 0.0:  # what the opening still stored when the contact closed
                loss = 0.5 * b.area[i] * b.traction[i, 0] ** 2 / k
                along = b.opening[i, 0] * n0 + b.opening[i, 1] * n1 + b.opening[i, 2] * n2
                b.opening[i, 0] -= along * n0
                b.opening[i, 1] -= along * n1
                b.opening[i, 2] -= along * n2
            delta = 0.0
        else:
            delta = h - b.gap[i]
        s0, s1, s2 = d0 - h * n0, d1 - h * n1, d2 - h * n2
        slip2 = s0 * s0 + s1 * s1 + s2 * s2
        wide = max(delta, 0.0)
        o0, o1, o2 = wide * n0 + s0, wide * n1 + s1, wide * n2 + s2
        slip = sqrt(slip2)
        share, part, D = yielding(
            wide, slip, k, b.weakness[i, 0], b.weakness[i, 1], b.ease[i, 0], b.ease[i, 1], b.alpha, b.damage[i], most
        )
        if share + part > 0.0:
            b.damage[i] = D
            b.gap[i] += share * wide
            b.slid[i] += part * slip
            # the foot follows: dw = grad w . (part s)
            db = part * (n0 * (s1 * v2 - s2 * v1) + n1 * (s2 * v0 - s0 * v2) + n2 * (s0 * v1 - s1 * v0)) / size
            dc = part * (n0 * (u1 * s2 - u2 * s1) + n1 * (u2 * s0 - u0 * s2) + n2 * (u0 * s1 - u1 * s0)) / size
            wa, wb, wc = wa - db - dc, wb + db, wc + dc
            b.weights[i, 0], b.weights[i, 1], b.weights[i, 2] = wa, wb, wc
            p0, p1, p2 = share * wide * n0 + part * s0, share * wide * n1 + part * s1, share * wide * n2 + part * s2
            o0, o1, o2 = o0 - p0, o1 - p1, o2 - p2
            # work of the mean traction of the step
            along = p0 * (b.opening[i, 0] + o0) + p1 * (b.opening[i, 1] + o1) + p2 * (b.opening[i, 2] + o2)
            loss += max(0.5 * k * b.area[i] * along, 0.0)
            delta = min(delta, 0.0) + (1.0 - share) * wide
            rest = 1.0 - part
            s0, s1, s2 = rest * s0, rest * s1, rest * s2
            slip2 *= rest * rest
        b.spent[i] += loss
        lost += loss
        b.opening[i, 0], b.opening[i, 1], b.opening[i, 2] = o0, o1, o2

        tn = 0.0 if b.loose[i] and delta < 0.0 else k * delta
        b.traction[i, 0], b.traction[i, 1] = tn, k * sqrt(slip2)
        stored += 0.5 * b.area[i] * (tn * delta + k * slip2)
        stiff = b.area[i] * k
        tn *= b.area[i]
        f0, f1, f2 = -(tn * n0 + stiff * s0), -(tn * n1 + stiff * s1), -(tn * n2 + stiff * s2)
        # dU/dn = turn d, and d n = (1 - n n) d((B - A) x (C - A)) / size
        turn = (tn - stiff * h) / size
        b0, b1, b2 = -turn * (v1 * s2 - v2 * s1), -turn * (v2 * s0 - v0 * s2), -turn * (v0 * s1 - v1 * s0)
        c0, c1, c2 = -turn * (s1 * u2 - s2 * u1), -turn * (s2 * u0 - s0 * u2), -turn * (s0 * u1 - s1 * u0)
        add(f_point, b.nodes[i], f0, f1, f2)
        add(f, t0, -(wa * f0 + b0 + c0), -(wa * f1 + b1 + c1), -(wa * f2 + b2 + c2))
        add(f, t1, b0 - wb * f0, b1 - wb * f1, b2 - wb * f2)
        add(f, t2, c0 - wc * f0, c1 - wc * f1, c2 - wc * f2)
    return stored, lost


@njit(cache=True, nogil=True)
def in_contact(
    rows: Ints, start: Ints, ring: Ints, penetration: Floats, gaps: Floats, reach: float, depth: Floats
) -> None:  # fmt: skip
    """Which points of a surface are pressed against another: depth (n,) m of the points `rows` for `bond_forces` is written.

    penetration, gaps (k,) m of all points; ring: the neighbours of row i are ring[start[i]:start[i + 1]]. Two unlike
    triangulations touch at some of their points only: one nearer than `reach` (m) whose neighbour presses is in contact too.
    """
    for i in range(len(rows)):
        depth[i] = penetration[rows[i]]
        if depth[i] <= 0.0:
            depth[i] = -1.0
            if gaps[rows[i]] < reach:
                for j in range(start[i], start[i + 1]):
                    if penetration[ring[j]] > 0.0:
                        depth[i] = 0.0
                        break


@njit(cache=True, nogil=True)
def spring_load(
    nodes: Ints, triangles: Ints, weights: Floats, strength: Floats, load_point: Floats, load: Floats
) -> None:  # fmt: skip
    """Row sums of the springs' stiffness, N/m, added to load_point and load (N,): the largest load / mass bounds omega^2 (Gershgorin).

    strength (n,) N/m: of the spring between each point and its foot, in any direction.
    """
    for i in range(len(nodes)):
        reach = abs(weights[i, 0]) + abs(weights[i, 1]) + abs(weights[i, 2])
        load_point[nodes[i]] += strength[i] * (1.0 + reach)
        for j in range(3):
            load[triangles[i, j]] += strength[i] * abs(weights[i, j]) * (1.0 + reach)


@njit(cache=True, nogil=True)
def spring_forces(
    nodes: Ints, triangles: Ints, weights: Floats, strength: Floats, w: Floats, active: int, f: Floats
) -> None:
    """The product of the springs' stiffness with w (N,3) m, which is zero from node `active` on, added to f (N,3) N; the rest as in
    `spring_load`."""
    for i in range(len(nodes)):
        if min(nodes[i], triangles[i, 0], triangles[i, 1], triangles[i, 2]) >= active:
            continue
        for d in range(3):
            pull = w[nodes[i], d]
            for j in range(3):
                pull -= weights[i, j] * w[triangles[i, j], d]
            pull *= strength[i]
            f[nodes[i], d] += pull
            for j in range(3):
                f[triangles[i, j], d] -= weights[i, j] * pull
