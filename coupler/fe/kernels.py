"""Kernels of the explicit tetrahedral target: kinematics, averaged nodal pressure, stress, forces, time step.

Each kernel works on a range [lo, hi) of elements or nodes and writes only its own rows: any division among threads gives the same
numbers to the last bit. `fe.model` describes the arrays. Averaged nodal pressure (Bonet & Burton 1998): volume ratio and pressure
are nodal quantities, and a tetrahedron uses the mean of its four nodes. This avoids locking of linear tetrahedra in isochoric flow.
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
from .model import Active, Cells, Elements, Metals, Nodes, Viscosity

LEAST_ELEMENTS, LEAST_NODES = 250, 400  # in a range of a loop that threads share
SHAPE_LIMIT = 0.5
THIN = 2.0  # largest length in the bulk viscosity, divided by the path of a wave in the stable step of the element
SHAPE_STIFFNESS = 0.05


@njit(cache=True, nogil=True)
def volumes(lo: int, hi: int, x: Floats, conn: Ints, volume: Floats) -> float:
    """Write the current volume of each tetrahedron to volume (m,) m3. Returns the smallest."""
    smallest = 1e300
    for e in range(lo, hi):
        volume[e] = edge_cofactors(x[conn[e, 0]], x[conn[e, 1]], x[conn[e, 2]], x[conn[e, 3]])[9] / 6.0
        smallest = min(smallest, volume[e])
    return smallest


@njit(cache=True, nogil=True)
def nodal_pressure(
    lo: int, hi: int, m: int, c: Cells, metals: Metals, nodes: Nodes, volume: Floats, heat: Floats
) -> None:
    """Update the averaged nodal volume ratio J and the pressure p, from the volumes (m,) m3 of the elements at n+1.

    heat (m,) J: heat of each element in the last step. Only heat of the first m elements, the active ones, raises the pressure.
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
    """0 for a tetrahedron with volume ratio J in [SHAPE_LIMIT, 1 / SHAPE_LIMIT], else ln(J / J_limit). J_limit: the nearer limit.

    With averaged nodal pressure neighbouring elements can exchange volume: in a fast crater some shrink to a twentieth of their
    volume and reduce the time step. The energy psi = SHAPE_STIFFNESS K/2 ln^2(J / J_limit) resists this with a small share of the
    element's own bulk stiffness, as in Puso & Solberg (2006), but only outside the limits.
    """
    return log(J / SHAPE_LIMIT) if J < SHAPE_LIMIT else log(J * SHAPE_LIMIT) if J * SHAPE_LIMIT > 1.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def element_forces(
    lo: int, hi: int, dt: float, viscosity: Viscosity, c: Cells, metals: Metals, nodes: Nodes, a: Elements
) -> Vector:
    """Stress update and internal nodal forces of each tetrahedron, from n to n+1.

    x at n+1, v at n+1/2. The deviator s is updated by a Jaumann rate with an exact (Cayley) rotation and a radial return to
    sigma_y. fe receives the forces on the nodes, -V0 P B with P = J sigma F^-T; `heat` receives that part of the step's heat which
    raises the pressure. Returns the plastic work, the work of the bulk viscosity and this heat, J.

    The laws are records specialised for FLOW (`constitutive.specialised`), or plain records. Only the plastic flow depends on the
    effects of the law: this function computes it element by element, without fast arithmetic, so that its numbers are the same to
    the last bit whichever effects the kernel omits. `fe.blocks` computes the rest block by block.
    """
    laws, (b1, b2, dt_of), heat = metals.laws, viscosity, a.heat
    plastic = warmth = viscous = 0.0
    w = np.empty((ROWS, BLOCK))
    b = rows_of(w)
    S, div = b.S, b.div
    two_G = np.empty(len(laws))
    for i in range(len(laws)):
        two_G[i] = 2.0 * laws[i].G
    for first in range(lo, hi, BLOCK):
        kinematics(first, hi, dt, c, nodes, a, two_G, metals.of_element, w)
        for i in range(min(BLOCK, hi - first)):
            e = first + i
            law = laws[metals.of_element[e]]
            # radial return to the yield stress of the last step
            sy = a.sigma_y[e]
            deps = 0.0
            flow = sy
            if b.q_squared[i] > sy * sy:
                q_trial = sqrt(b.q_squared[i])
                deps = (q_trial - sy) / (3.0 * law.G)
                # with the mean stress of the step along the plastic flow, stored and dissipated energy add up to the work
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
            # bulk viscosity, with a linear and a quadratic term in rate of compression times length of the element
            if div[i] < 0.0:
                speed = sqrt((law.K + 4.0 / 3.0 * law.G) / law.rho)
                length = min(b.length[i], THIN * speed * dt_of[e])
                qv = law.rho * length * (b2 * b2 * length * div[i] * div[i] - b1 * speed * div[i])
                loss = -qv * div[i] * dt * b.volume[i]
                viscous += loss
                b.pressure[i] += qv
                if on(law.dissipation):  # the next plastic flow updates the yield stress
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
    """Write the sums of the element forces fe (m,4,3) at the nodes [lo, hi) to f (n,3)."""
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
    team: Ints, active: Active, half_step: float, dt: float, viscosity: Viscosity, c: Cells, of_pressure: Metals, of_flow: Metals,
    nodes: Nodes, elements: Elements, sums: Floats,
) -> None:  # fmt: skip
    """Accelerate nodes by their total forces over half_step s, move them for dt s, and compute the internal forces in the new
    positions, in all threads. The previous internal forces are copied to f_old; f_ext is set to zero.

    of_pressure, of_flow: metals with laws specialised for `nodal_pressure` and `element_forces`. Writes to sums (PARTS,4), for each
    part: 1 if an element is inverted, else 0; and the results of `element_forces`.
    """
    n, m = active.nodes, active.elements
    for lo, hi, _ in ranges(team, 0, len(nodes.x), LEAST_NODES):
        motion.kick(lo, min(hi, active.kicked), half_step, nodes.total, nodes.inv_mass, nodes.v)
        motion.drift(lo, min(hi, n), dt, nodes.v, nodes.x)
        nodes.f_old[lo : min(hi, n)] = nodes.f[lo : min(hi, n)]
        nodes.f_ext[lo:hi] = 0.0
    for lo, hi, part in ranges(team, 1, m, LEAST_ELEMENTS):
        sums[part, 0] = 1.0 if volumes(lo, hi, nodes.x, c.conn, elements.volume) <= 0.0 else 0.0
    for lo, hi, _ in ranges(team, 2, n, LEAST_NODES):
        nodal_pressure(lo, hi, m, c, of_pressure, nodes, elements.volume, elements.heat)
    for lo, hi, part in ranges(team, 3, m, LEAST_ELEMENTS):
        sums[part, 1], sums[part, 2], sums[part, 3] = element_forces(lo, hi, dt, viscosity, c, of_flow, nodes, elements)
    for lo, hi, _ in ranges(team, 4, n, LEAST_NODES):
        gather_forces(lo, hi, c, elements.fe, nodes.f)


@njit(cache=True, nogil=True)
def stable_dt(lo: int, hi: int, x: Floats, J_node: Floats, c: Cells, metals: Metals, dt_of: Floats) -> None:
    """Write a lower bound on the stable time step of each element to dt_of (m,) s; 0 if its volume or omega^2 is not above zero.

    omega^2 <= (4 / rho) (lambda tr M + 2 G lambda_max(M)), M = sum_I b_I (x) b_I with current gradients b. The largest eigenvalue
    of an element is a bound for the mesh. K increases with compression.
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
    """Elastic energy of the elements, J: sum of v s:s / 4G over the current volumes, and energy of `shape_strain`."""
    total = 0.0
    for e in range(lo, hi):
        law = metals.laws[metals.of_element[e]]
        ss = s[e, 0] ** 2 + s[e, 1] ** 2 + s[e, 2] ** 2 + 2.0 * (s[e, 3] ** 2 + s[e, 4] ** 2 + s[e, 5] ** 2)
        total += volume[e] * ss / (4.0 * law.G)
        total += V0[e] * 0.5 * SHAPE_STIFFNESS * law.K * shape_strain(volume[e] / V0[e]) ** 2
    return total
