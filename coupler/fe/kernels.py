"""Kernels of the explicit tetrahedral target: kinematics, averaged nodal pressure, stress, forces, time step.

Each kernel works on a range [lo, hi) of elements or nodes and writes only its own rows, so that any split of the
range over threads gives the same numbers to the last bit. Voigt order everywhere: xx yy zz yz xz xy. The averaged
nodal pressure is that of Bonet & Burton (1998): the volume ratio, and with it the pressure, is a nodal quantity; a
tetrahedron takes the mean of its four nodes, which keeps linear tetrahedra from locking in isochoric flow.
"""

from math import acos, cos, log, sqrt

import numpy as np

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints, Laws, Vector
from ..core.loops import ranges
from ..physics import motion
from ..physics.constitutive import bulk_stiffness, harden, heat_capacity, mie_gruneisen, norm, on
from .blocks import BLOCK, ROWS, edge_cofactors, kinematics, nodal_forces, rows_of

LEAST_ELEMENTS, LEAST_NODES = 250, 400  # in a range of a loop that threads share
SHAPE_LIMIT = 0.5
SHAPE_STIFFNESS = 0.05


@njit(cache=True, nogil=True)
def volumes(lo: int, hi: int, x: Floats, conn: Ints, volume: Floats) -> float:
    """Current volume of each tetrahedron, m3; volume (m,) is written. Returns the smallest."""
    smallest = 1e300
    for e in range(lo, hi):
        volume[e] = edge_cofactors(x[conn[e, 0]], x[conn[e, 1]], x[conn[e, 2]], x[conn[e, 3]])[9] / 6.0
        smallest = min(smallest, volume[e])
    return smallest


@njit(cache=True, nogil=True)
def nodal_pressure(
    lo: int, hi: int, m: int, start: Ints, table: Ints, volume: Floats, heat: Floats, V0_node: Floats, laws: Laws, law_of_node: Ints,
    J: Floats, p: Floats, energy: Floats,
) -> None:  # fmt: skip
    """Averaged nodal volume ratio and the pressure that goes with it.

    start (n+1,), table: rows 4 e + local of the elements around each node. volume m3 now; heat J put into each element during the
    last step, which counts of the first m, the active ones: that of others waits. J, p (Pa), energy (J per reference m3) of shape
    (n,) move on in place.
    """
    for a in range(lo, hi):
        law = laws[law_of_node[a]]
        vol = 0.0
        q = 0.0
        for r in range(start[a], start[a + 1]):
            e = table[r] >> 2
            vol += volume[e]
            if e < m and on(law.expansion):
                q += heat[e]
        J_new = 0.25 * vol / V0_node[a]
        p[a], energy[a] = mie_gruneisen(law, J[a], J_new, p[a], energy[a], 0.25 * q / V0_node[a])
        J[a] = J_new


@njit(cache=True, nogil=True, inline="always")
def shape_strain(J: float) -> float:
    """ln(J / J_limit) of a tetrahedron outside [SHAPE_LIMIT, 1 / SHAPE_LIMIT], else 0: it must not collapse or blow up while the
    nodes around it keep their volume.

    Averaged nodal pressure leaves single elements free to trade volume: in a fast crater some sink to a twentieth of
    theirs and take the time step with them. psi = SHAPE_STIFFNESS K/2 ln^2(J / J_limit) acts against that, with a small share of
    the element's own bulk stiffness, as in Puso & Solberg (2006), but only where needed.
    """
    return log(J / SHAPE_LIMIT) if J < SHAPE_LIMIT else log(J * SHAPE_LIMIT) if J * SHAPE_LIMIT > 1.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def element_forces(
    lo: int, hi: int, dt: float, b1: float, b2: float, x: Floats, v: Floats, conn: Ints, B: Floats, V0: Floats, volume:
    Floats, p: Floats, J_node: Floats, laws: Laws, law_of: Ints, s: Floats, sigma_y: Floats, eps_p: Floats, rate: Floats, T:
    Floats, heat: Floats, fe: Floats, eps_gradient: Floats,
) -> Vector:  # fmt: skip
    """Stress update and internal nodal forces of each tetrahedron, from n to n+1.

    x (n,3) positions at n+1, v (n,3) velocities at n+1/2; B (m,3,3) reference gradients of nodes 1 to 3; s (m,6)
    Cauchy deviator, updated by a Jaumann rate with an exact (Cayley) rotation and a radial return to sigma_y (m,).
    fe (m,4,3) receives the force each element puts on its nodes, -V0 P B with P = J sigma F^-T. heat (m,) receives
    the heat of the step in J that makes pressure; eps_gradient (m,3) 1/m: `fe.gradients`.
    Returns the plastic work, the work of the bulk viscosity and that heat, J.

    laws: as `constitutive.specialised` sees them for FLOW, or plain records. Only what depends on their effects is here:
    the flow of one element after the other. What goes before and after it is done block by block (`fe.blocks`), and only there
    is arithmetic fast: what flows is the same to the last bit whichever effects its kernel leaves out.
    """
    plastic = warmth = viscous = 0.0
    w = np.empty((ROWS, BLOCK))
    b = rows_of(w)
    S, length, div = b.S, b.length, b.div
    two_G = np.empty(len(laws))
    for i in range(len(laws)):
        two_G[i] = 2.0 * laws[i].G
    for first in range(lo, hi, BLOCK):
        kinematics(first, hi, dt, x, v, conn, B, V0, volume, p, two_G, law_of, s, w)
        for i in range(min(BLOCK, hi - first)):
            e = first + i
            law = laws[law_of[e]]
            # radial return to the yield stress the last step left behind
            sy = sigma_y[e]
            deps = 0.0
            flow = sy
            if b.q_squared[i] > sy * sy:
                q_trial = sqrt(b.q_squared[i])
                deps = (q_trial - sy) / (3.0 * law.G)
                # the step's mean stress along the plastic flow: what makes stored and dissipated energy add up to the work done
                flow = 0.5 * (sy + 1.5 * b.along[i] / q_trial)
                for k in range(6):
                    S[k, i] *= sy / q_trial
            warm = 0.0
            if deps > 0.0 or rate[e] > 0.0:
                eta = norm(eps_gradient, e) if on(law.gradient_length) else 0.0
                eps_p[e], rate[e], T[e], sy, work = harden(
                    law, deps, dt, b.J[i], flow, sy, eps_p[e], rate[e], T[e], eta
                )
                sigma_y[e] = sy
                plastic += b.V0[i] * work
                if on(law.taylor_quinney) and on(law.expansion):
                    warm = b.V0[i] * law.expansion * law.taylor_quinney * work
                    warmth += warm
            if on(law.expansion):
                heat[e] = warm
            for k in range(6):
                s[e, k] = S[k, i]
            # bulk viscosity, linear and quadratic in the rate of compression, over the element's length
            if div[i] < 0.0:
                c = sqrt((law.K + 4.0 / 3.0 * law.G) / law.rho)
                qv = law.rho * length[i] * (b2 * b2 * length[i] * div[i] * div[i] - b1 * c * div[i])
                loss = -qv * div[i] * dt * b.volume[i]
                viscous += loss
                b.pressure[i] += qv
                if on(law.dissipation):  # the yield stress follows with the next plastic flow
                    T[e] += law.dissipation * loss / (b.V0[i] * law.rho * heat_capacity(law, T[e]))
                    if on(law.expansion):
                        warm = law.expansion * law.dissipation * loss
                        heat[e] += warm
                        warmth += warm
            b.pressure[i] -= SHAPE_STIFFNESS * law.K * shape_strain(b.J[i]) / b.J[i]
        nodal_forces(first, hi, B, w, fe)
    return plastic, viscous, warmth


@njit(cache=True, nogil=True)
def gather_forces(lo: int, hi: int, start: Ints, table: Ints, fe: Floats, f: Floats) -> None:
    """Sum the element forces at each node: f (n,3) is overwritten for nodes [lo, hi)."""
    for a in range(lo, hi):
        f0 = f1 = f2 = 0.0
        for r in range(start[a], start[a + 1]):
            e, k = table[r] >> 2, table[r] & 3
            f0 += fe[e, k, 0]
            f1 += fe[e, k, 1]
            f2 += fe[e, k, 2]
        f[a, 0], f[a, 1], f[a, 2] = f0, f1, f2


@njit(cache=True, nogil=True)
def advance(
    team: Ints, kicked: int, n: int, m: int, half_step: float, dt: float, of_motion: Arrays, of_volume: Arrays, of_pressure: Arrays,
    of_forces: Arrays, of_sum: Arrays, smallest: Floats, sums: Floats,
) -> None:  # fmt: skip
    """Move the first nodes and compute the internal forces of the first n nodes and m elements where they are then, in all threads.

    kicked: how many nodes get the forces of n over half_step s; n of them move. of_motion: total N, 1/mass, v, x, and f_ext, which
    is set to zero, (N,...); the other tuples: arguments of the kernels above. smallest (PARTS,) m3: volumes, sums (PARTS,3): those of
    `element_forces`, part by part; both are written.
    """
    total, inv_mass, v, x, f_ext = of_motion
    for lo, hi, _ in ranges(team, 0, len(x), LEAST_NODES):
        motion.kick(lo, min(hi, kicked), half_step, total, inv_mass, v)
        motion.drift(lo, min(hi, n), dt, v, x)
        f_ext[lo:hi] = 0.0
    for lo, hi, part in ranges(team, 1, m, LEAST_ELEMENTS):
        smallest[part] = volumes(lo, hi, *of_volume)
    for lo, hi, _ in ranges(team, 2, n, LEAST_NODES):
        nodal_pressure(lo, hi, m, *of_pressure)
    for lo, hi, part in ranges(team, 3, m, LEAST_ELEMENTS):
        sums[part, 0], sums[part, 1], sums[part, 2] = element_forces(lo, hi, *of_forces)
    for lo, hi, _ in ranges(team, 4, n, LEAST_NODES):
        gather_forces(lo, hi, *of_sum)


@njit(cache=True, nogil=True, inline="always")
def _largest_eigenvalue(a: float, b: float, c: float, d: float, e: float, f: float) -> float:
    """Largest eigenvalue of the symmetric matrix [[a, f, e], [f, b, d], [e, d, c]] (closed form)."""
    mean = (a + b + c) / 3.0
    off = f * f + e * e + d * d
    spread = sqrt(((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2 + 2.0 * off) / 6.0)
    if spread <= 1e-14 * abs(mean):
        return mean
    a, b, c, d, e, f = (a - mean) / spread, (b - mean) / spread, (c - mean) / spread, d / spread, e / spread, f / spread
    half_det = 0.5 * (a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e))
    return mean + 2.0 * spread * cos(acos(min(max(half_det, -1.0), 1.0)) / 3.0)


@njit(cache=True, nogil=True)
def stable_dt(
    lo: int, hi: int, x: Floats, conn: Ints, J_node: Floats, laws: Laws, law_of: Ints, dt_of: Floats,
) -> tuple[float, int]:  # fmt: skip
    """Bound on the stable time step of each element, s, into dt_of (m,); returns (smallest, its element).

    omega^2 <= (4 / rho) (lambda tr M + 2 G lambda_max(M)), M = sum_I b_I (x) b_I with current gradients b: the
    element's largest eigenvalue bounds the mesh's. K stiffens with compression.
    """
    smallest = 1e300
    where = -1
    for e in range(lo, hi):
        n0, n1, n2, n3 = conn[e, 0], conn[e, 1], conn[e, 2], conn[e, 3]
        law = laws[law_of[e]]
        c00, c01, c02, c10, c11, c12, c20, c21, c22, det = edge_cofactors(x[n0], x[n1], x[n2], x[n3])
        i2 = 1.0 / (det * det)
        s0, s1, s2 = c00 + c10 + c20, c01 + c11 + c21, c02 + c12 + c22
        xx = (c00 * c00 + c10 * c10 + c20 * c20 + s0 * s0) * i2
        yy = (c01 * c01 + c11 * c11 + c21 * c21 + s1 * s1) * i2
        zz = (c02 * c02 + c12 * c12 + c22 * c22 + s2 * s2) * i2
        yz = (c01 * c02 + c11 * c12 + c21 * c22 + s1 * s2) * i2
        xz = (c00 * c02 + c10 * c12 + c20 * c22 + s0 * s2) * i2
        xy = (c00 * c01 + c10 * c11 + c20 * c21 + s0 * s1) * i2
        J = 0.25 * (J_node[n0] + J_node[n1] + J_node[n2] + J_node[n3])
        lame = bulk_stiffness(law, J) / J - 2.0 / 3.0 * law.G
        stiffness = lame * (xx + yy + zz) + 2.0 * law.G * _largest_eigenvalue(xx, yy, zz, yz, xz, xy)
        omega2 = 4.0 * J / law.rho * stiffness  # density now is rho0 / J
        dt = 2.0 / sqrt(omega2) if det > 0.0 else 0.0
        dt_of[e] = dt
        if dt < smallest:
            smallest, where = dt, e
    return smallest, where


@njit(cache=True, nogil=True)
def elastic_shear_energy(lo: int, hi: int, volume: Floats, V0: Floats, laws: Laws, law_of: Ints, s: Floats) -> float:
    """Recoverable energy of the elements, sum of v s:s / 4G over the volumes now, and of `shape_strain`, in J."""
    total = 0.0
    for e in range(lo, hi):
        law = laws[law_of[e]]
        ss = s[e, 0] ** 2 + s[e, 1] ** 2 + s[e, 2] ** 2 + 2.0 * (s[e, 3] ** 2 + s[e, 4] ** 2 + s[e, 5] ** 2)
        total += volume[e] * ss / (4.0 * law.G)
        total += V0[e] * 0.5 * SHAPE_STIFFNESS * law.K * shape_strain(volume[e] / V0[e]) ** 2
    return total


def node_to_element(conn: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows 4 e + local around each node: (start (nodes+1,), table (4 m,)), in element order, so that sums have one order."""
    flat = np.asarray(conn).ravel()
    table = np.argsort(flat, kind="stable").astype(np.int32)
    start = np.zeros(nodes + 1, np.int64)
    np.cumsum(np.bincount(flat, minlength=nodes), out=start[1:])
    return start, table
