"""Bonds of nodes to triangles: damage and cohesive forces (numba). Sums run in the order of the rows, so that they are reproducible."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from ..compiling import njit, uncounted
from ..core.arrays import Bools, Floats, Ints, Vector
from ..geometry.vector_kernels import add, area_vector, cross, from_foot


class Ties(NamedTuple):
    """Bonds between points and points on triangles, one row per bond, as in `bond.Bond`. inv_strength (n,2) 1/Pa, inv_energy (n,2)
    m2/J: 1 / strength and 1 / fracture energy, normal and shear.

    gap: height of the point above the triangle, along its normal n, at which the bond has no normal force. With the stiffness k,
    Pa/m, and the vector d from the bond's point on the triangle to the other point, the potential is

        U = area k / 2 (delta^2 + |s|^2),   delta = d.n - gap,   s = d - (d.n) n

    The forces are minus its gradient, with the derivative of n: this term gives the couple that balances the moment of the forces
    across the gap. When a bond yields, the permanent part of delta is added to gap, and the permanent part of s moves the point on
    the triangle. Unloading is elastic, to a residual opening. opening: elastic part, max(delta, 0) n + s.
    """

    nodes: Ints
    triangles: Ints
    weights: Floats
    gap: Floats
    area: Floats
    stiffness: Floats
    inv_strength: Floats
    inv_energy: Floats
    rewelds: Floats
    loose: Bools
    damage: Floats
    opening: Floats
    traction: Floats
    slid: Floats
    spent: Floats


@njit(cache=True, nogil=True)
def softening(a: float, b: float, inv_G_n: float, inv_G_s: float) -> float:
    """The term 2 (1 - D) dD / dl of `yielding`, m2/J. a, b: normal and shear traction, each divided by its strength."""
    e = a * a * inv_G_n if a > 0.0 else 0.0
    return e + b * b * inv_G_s if b > 0.0 else e


@njit(cache=True, nogil=True)
def flow(
    a: float, b: float, soft_n: float, soft_s: float, inv_G_n: float, inv_G_s: float, intact: float
) -> float:  # fmt: skip
    """The multiplier dl of `yielding` that returns the tractions to the yield locus; infinite if the bond breaks completely.

    a, b: trial tractions divided by strengths; soft = k / strength^2; intact: 1 - D before the step. With m = |(a, b)| at the end of
    the step, m + dl softening / (2 m) = intact. The solver is regula falsi (Illinois) in y = c dl / (1 + c dl), where c is the larger
    `soft` of the loaded directions: the equation is linear in y for tension or shear alone.
    """
    c = 0.0
    la = lb = 0.0  # direction of the tractions as dl grows without bound
    if a > 0.0:
        c, la = soft_n, a / soft_n
    if b > 0.0:
        c, lb = max(c, soft_s), b / soft_s
    low, above = 0.0, sqrt(a * a + b * b) - intact
    high, below = 1.0, softening(la, lb, inv_G_n, inv_G_s) / (2.0 * sqrt(la * la + lb * lb)) - intact
    if below >= -1e-14 * above:  # the remaining strength is within rounding of zero
        return np.inf
    dl, side = 0.0, 0
    for _ in range(100):
        y = (low * below - high * above) / (below - above)
        dl = y / (c * (1.0 - y))
        ta, tb = a / (1.0 + soft_n * dl), b / (1.0 + soft_s * dl)
        m = sqrt(ta * ta + tb * tb)
        h = m + dl * softening(ta, tb, inv_G_n, inv_G_s) / (2.0 * m) - intact
        if abs(h) <= 1e-14 * intact:
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
    wide: float, slip: float, k: float, inv_strength: Floats, inv_G: Floats, D: float, most: float
) -> tuple[float, float, float]:  # fmt: skip
    """Fractions of the elastic opening and slip that become permanent in this step, and the new damage. D: damage before the step.

    wide, slip: elastic opening and slip, m; k: stiffness, Pa/m; inv_strength (2,) 1/Pa: 1 / N in tension, 1 / S in shear; inv_G
    (2,) m2/J: 1 / fracture energy. The tractions t = k delta stay within (t_n/N)^2 + (t_s/S)^2 = (1 - D)^2, the onset criterion of
    Camanho & Davila (2002), NASA/TM-2002-211737. At this locus the opening flows normal to it (Drucker 1951):

        dp_n = dl t_n / N^2,  dp_s = dl t_s / S^2,  dD = (t_n dp_n / G_Ic + t_s dp_s / G_IIc) / (2 (1 - D))

    Then the softening is linear for tension or shear alone, and tractions of constant ratio end at G_I/G_Ic + G_II/G_IIc = 1.
    In these equations t_n, t_s and D are values at the end of the step, and dl is the multiplier of `flow`. A bond that has reached
    the damage `most` flows at its remaining strength.
    """
    a, b = k * wide * inv_strength[0], k * slip * inv_strength[1]
    if a * a + b * b <= (1.0 - D) ** 2:
        return 0.0, 0.0, D
    soft_n, soft_s = k * inv_strength[0] ** 2, k * inv_strength[1] ** 2
    dl = flow(a, b, soft_n, soft_s, inv_G[0], inv_G[1], 1.0 - D)
    softened = 1.0
    if dl < np.inf:
        ta, tb = a / (1.0 + soft_n * dl), b / (1.0 + soft_s * dl)
        softened = D + dl * softening(ta, tb, inv_G[0], inv_G[1]) / (2.0 * sqrt(ta * ta + tb * tb))
    if softened >= most:
        softened = max(D, most)
        dl = flow(a, b, soft_n, soft_s, 0.0, 0.0, 1.0 - softened) if softened < 1.0 else np.inf
    if dl == np.inf:
        return 1.0, 1.0, 1.0
    return soft_n * dl / (1.0 + soft_n * dl), soft_s * dl / (1.0 + soft_s * dl), softened


@uncounted
def bond_forces(
    xp: Floats, x: Floats, b: Ties, depth: Floats, active: int, f_point: Floats, f: Floats
) -> tuple[float, float]:  # fmt: skip
    """Add the forces of cohesive bonds between points xp and triangles of nodes x (N,3) m to f_point and f (N,3), and update the
    bonds. Returns the stored energy and the energy dissipated by this call, J. Forces and moments of each bond are in balance.

    depth (n,) m: positive: penetration of point i in its contact; 0: only a neighbour of the point is in contact (`in_contact`),
    counted as contact unless the bond is in tension; negative: no contact. In contact the bond has no normal traction, and gap moves
    with the surface: the opening starts where the contact ends. Slip in contact leaves at least the share rewelds of the strength.
    `loose` bonds resist no compression. active: number of nodes that move, the first ones; other bonds do not change and add no forces.
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
            if b.traction[i, 0] > 0.0:  # the contact closes: the energy of the opening is lost
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
        share, part, D = yielding(wide, slip, k, b.inv_strength[i], b.inv_energy[i], b.damage[i], most)
        if share + part > 0.0:
            b.gap[i] += share * wide if b.damage[i] < 1.0 else 0.0  # surfaces that are apart leave nothing between them
            b.damage[i] = D
            b.slid[i] += part * slip
            # the bond's point moves on the triangle: dw = grad w . (part s)
            db = part * (n0 * (s1 * v2 - s2 * v1) + n1 * (s2 * v0 - s0 * v2) + n2 * (s0 * v1 - s1 * v0)) / size
            dc = part * (n0 * (u1 * s2 - u2 * s1) + n1 * (u2 * s0 - u0 * s2) + n2 * (u0 * s1 - u1 * s0)) / size
            wa, wb, wc = wa - db - dc, wb + db, wc + dc
            b.weights[i, 0], b.weights[i, 1], b.weights[i, 2] = wa, wb, wc
            p0, p1, p2 = share * wide * n0 + part * s0, share * wide * n1 + part * s1, share * wide * n2 + part * s2
            o0, o1, o2 = o0 - p0, o1 - p1, o2 - p2
            # work of the mean traction in the step
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
        add(f_point, b.nodes[i], -(tn * n0 + stiff * s0), -(tn * n1 + stiff * s1), -(tn * n2 + stiff * s2))
        turn = (tn - stiff * h) / size
        n, s, u, v = (n0, n1, n2), (s0, s1, s2), (u0, u1, u2), (v0, v1, v2)
        _add_reaction(f, b.triangles[i], b.weights[i], tn, stiff, turn, n, s, u, v)
    return stored, lost


@njit(cache=True, nogil=True, inline="always")
def _add_reaction(
    f: Floats, t: Ints, w: Floats, tn: float, stiff: float, turn: float, n: Vector, s: Vector, u: Vector, v: Vector
) -> None:  # fmt: skip
    """Add the reaction to the force -(tn n + stiff s), N, on a bonded point to the corners t of the triangle. n: normal; s: slip, m; u,
    v: edges, m; w: barycentric coordinates; turn (N/m): factor of the couple, from dU/dn with dn = (1 - n n) d(u x v) / |u x v|."""
    b, c = cross(v, s), cross(s, u)
    for d in range(3):
        force, couple_b, couple_c = -(tn * n[d] + stiff * s[d]), -turn * b[d], -turn * c[d]
        f[t[0], d] -= w[0] * force + couple_b + couple_c
        f[t[1], d] += couple_b - w[1] * force
        f[t[2], d] += couple_c - w[2] * force


@njit(cache=True, nogil=True)
def in_contact(
    rows: Ints, start: Ints, ring: Ints, penetration: Floats, gaps: Floats, reach: float, depth: Floats
) -> None:  # fmt: skip
    """Write the argument `depth` (n,) m of `bond_forces`, for the points `rows` (n,).

    penetration, gaps (k,) m: `Contact.depth` and `Contact.gap` of all points; ring[start[i]:start[i + 1]]: neighbours of the point
    rows[i]. Two different triangulations touch only at some of their points. Therefore a point that is closer than `reach` (m) to the
    other surface and has a neighbour in contact counts as in contact, too.
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
