"""Kernels of the explicit tetrahedral target: kinematics, averaged nodal pressure, stress, forces, time step.

Each kernel works on a range [lo, hi) of elements or nodes and writes only its own rows, so that any split of the
range over threads gives the same numbers to the last bit. The arrays are those of `fe.model`. The averaged
nodal pressure is that of Bonet & Burton (1998): the volume ratio, and with it the pressure, is a nodal quantity; a
tetrahedron takes the mean of its four nodes, which keeps linear tetrahedra from locking in isochoric flow.
"""

from math import log, sqrt

import numpy as np

from ..compiling import njit
from ..core.arrays import Floats, Ints, Vector
from ..core.loops import ranges
from ..geometry.matrix_kernels import LARGEST, eigenvalue
from ..physics import motion
from ..physics.constitutive import bulk_stiffness, harden, heat_capacity, mie_gruneisen, norm, on
from .blocks import BLOCK, ROWS, edge_cofactors, kinematics, nodal_forces, rows_of
from .model import Active, Cells, Elements, Metals, Nodes

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
    lo: int, hi: int, m: int, c: Cells, metals: Metals, nodes: Nodes, volume: Floats, heat: Floats
) -> None:
    """Averaged nodal volume ratio J and the pressure p that goes with it, from the volumes (m,) m3 of the elements at n+1.

    heat (m,) J: what each element was given during the last step counts of the first m, the active ones: that of others waits.
    """
    J, p, energy = nodes.J, nodes.p, nodes.energy
    for a in range(lo, hi):
        law = metals.laws[metals.of_node[a]]
        vol = 0.0
        q = 0.0
        for r in range(c.start[a], c.start[a + 1]):
            e = c.table[r] >> 2
            vol += volume[e]
            if e < m and on(law.expansion):
                q += heat[e]
        J_new = 0.25 * vol / c.V0_node[a]
        p[a], energy[a] = mie_gruneisen(law, J[a], J_new, p[a], energy[a], 0.25 * q / c.V0_node[a])
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
    lo: int, hi: int, dt: float, viscosity: tuple[float, float], c: Cells, metals: Metals, nodes: Nodes, a: Elements
) -> Vector:
    """Stress update and internal nodal forces of each tetrahedron, from n to n+1.

    x at n+1, v at n+1/2. The deviator s is updated by a Jaumann rate with an exact (Cayley) rotation and a radial return to sigma_y.
    fe receives the force each element puts on its nodes, -V0 P B with P = J sigma F^-T; heat that of the step which makes pressure.
    viscosity: coefficients of the linear and the quadratic bulk viscosity. Returns the plastic work, the work of the bulk viscosity
    and that heat, J.

    The laws: as `constitutive.specialised` sees them for FLOW, or plain records. Only what depends on their effects is here:
    the flow of one element after the other. What goes before and after it is done block by block (`fe.blocks`), and only there
    is arithmetic fast: what flows is the same to the last bit whichever effects its kernel leaves out.
    """
    laws, (b1, b2), heat = metals.laws, viscosity, a.heat
    plastic = warmth = viscous = 0.0
    w = np.empty((ROWS, BLOCK))
    b = rows_of(w)
    S, length, div = b.S, b.length, b.div
    two_G = np.empty(len(laws))
    for i in range(len(laws)):
        two_G[i] = 2.0 * laws[i].G
    for first in range(lo, hi, BLOCK):
        kinematics(first, hi, dt, c, nodes, a, two_G, metals.of_element, w)
        for i in range(min(BLOCK, hi - first)):
            e = first + i
            law = laws[metals.of_element[e]]
            # radial return to the yield stress the last step left behind
            sy = a.sigma_y[e]
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
            if deps > 0.0 or a.rate[e] > 0.0:
                eta = norm(a.eps_gradient, e) if on(law.gradient_length) else 0.0
                a.eps_p[e], a.rate[e], a.T[e], sy, work = harden(
                    law, deps, dt, b.J[i], flow, sy, a.eps_p[e], a.rate[e], a.T[e], eta
                )
                a.sigma_y[e] = sy
                plastic += b.V0[i] * work
                if on(law.taylor_quinney) and on(law.expansion):
                    warm = b.V0[i] * law.expansion * law.taylor_quinney * work
                    warmth += warm
            if on(law.expansion):
                heat[e] = warm
            for k in range(6):
                a.s[e, k] = S[k, i]
            # bulk viscosity, linear and quadratic in the rate of compression, over the element's length
            if div[i] < 0.0:
                speed = sqrt((law.K + 4.0 / 3.0 * law.G) / law.rho)
                qv = law.rho * length[i] * (b2 * b2 * length[i] * div[i] * div[i] - b1 * speed * div[i])
                loss = -qv * div[i] * dt * b.volume[i]
                viscous += loss
                b.pressure[i] += qv
                if on(law.dissipation):  # the yield stress follows with the next plastic flow
                    a.T[e] += law.dissipation * loss / (b.V0[i] * law.rho * heat_capacity(law, a.T[e]))
                    if on(law.expansion):
                        warm = law.expansion * law.dissipation * loss
                        heat[e] += warm
                        warmth += warm
            b.pressure[i] -= SHAPE_STIFFNESS * law.K * shape_strain(b.J[i]) / b.J[i]
        nodal_forces(first, hi, c.B, w, a.fe)
    return plastic, viscous, warmth


@njit(cache=True, nogil=True)
def gather_forces(lo: int, hi: int, c: Cells, fe: Floats, f: Floats) -> None:
    """Sum the element forces fe (m,4,3) at each node: f (n,3) is overwritten for nodes [lo, hi)."""
    for a in range(lo, hi):
        f0 = f1 = f2 = 0.0
        for r in range(c.start[a], c.start[a + 1]):
            e, k = c.table[r] >> 2, c.table[r] & 3
            f0 += fe[e, k, 0]
            f1 += fe[e, k, 1]
            f2 += fe[e, k, 2]
        f[a, 0], f[a, 1], f[a, 2] = f0, f1, f2


@njit(cache=True, nogil=True)
def advance(
    team: Ints, active: Active, half_step: float, dt: float, viscosity: tuple[float, float], c: Cells, of_pressure: Metals, of_flow:
    Metals, nodes: Nodes, elements: Elements, smallest: Floats, sums: Floats,
) -> None:  # fmt: skip
    """Accelerate nodes by their total forces over half_step s, move them for dt s, and compute the internal forces where they are then,
    in all threads. f_ext is set to zero.

    The metals: with laws as the kernels of pressure and of flow take them. smallest (PARTS,) m3: volumes, sums (PARTS,3): those of
    `element_forces`, part by part; both are written.
    """
    n, m = active.nodes, active.elements
    for lo, hi, _ in ranges(team, 0, len(nodes.x), LEAST_NODES):
        motion.kick(lo, min(hi, active.kicked), half_step, nodes.total, nodes.inv_mass, nodes.v)
        motion.drift(lo, min(hi, n), dt, nodes.v, nodes.x)
        nodes.f_ext[lo:hi] = 0.0
    for lo, hi, part in ranges(team, 1, m, LEAST_ELEMENTS):
        smallest[part] = volumes(lo, hi, nodes.x, c.conn, elements.volume)
    for lo, hi, _ in ranges(team, 2, n, LEAST_NODES):
        nodal_pressure(lo, hi, m, c, of_pressure, nodes, elements.volume, elements.heat)
    for lo, hi, part in ranges(team, 3, m, LEAST_ELEMENTS):
        sums[part, 0], sums[part, 1], sums[part, 2] = element_forces(lo, hi, dt, viscosity, c, of_flow, nodes, elements)
    for lo, hi, _ in ranges(team, 4, n, LEAST_NODES):
        gather_forces(lo, hi, c, elements.fe, nodes.f)


@njit(cache=True, nogil=True)
def stable_dt(lo: int, hi: int, x: Floats, J_node: Floats, c: Cells, metals: Metals, dt_of: Floats) -> None:
    """Bound on the stable time step of each element, s, into dt_of (m,): 0 where it is inverted or no number.

    omega^2 <= (4 / rho) (lambda tr M + 2 G lambda_max(M)), M = sum_I b_I (x) b_I with current gradients b: the
    element's largest eigenvalue bounds the mesh's. K stiffens with compression.
    """
    for e in range(lo, hi):
        n0, n1, n2, n3 = c.conn[e, 0], c.conn[e, 1], c.conn[e, 2], c.conn[e, 3]
        law = metals.laws[metals.of_element[e]]
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
        stiffness = lame * (xx + yy + zz) + 2.0 * law.G * eigenvalue(xx, yy, zz, yz, xz, xy, LARGEST)
        omega2 = 4.0 * J / law.rho * stiffness  # density now is rho0 / J
        dt_of[e] = 2.0 / sqrt(omega2) if det > 0.0 and omega2 > 0.0 else 0.0


@njit(cache=True, nogil=True)
def elastic_shear_energy(lo: int, hi: int, V0: Floats, metals: Metals, volume: Floats, s: Floats) -> float:
    """Recoverable energy of the elements, sum of v s:s / 4G over the volumes now, and of `shape_strain`, in J."""
    total = 0.0
    for e in range(lo, hi):
        law = metals.laws[metals.of_element[e]]
        ss = s[e, 0] ** 2 + s[e, 1] ** 2 + s[e, 2] ** 2 + 2.0 * (s[e, 3] ** 2 + s[e, 4] ** 2 + s[e, 5] ** 2)
        total += volume[e] * ss / (4.0 * law.G)
        total += V0[e] * 0.5 * SHAPE_STIFFNESS * law.K * shape_strain(volume[e] / V0[e]) ** 2
    return total
