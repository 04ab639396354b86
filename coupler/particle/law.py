"""The constitutive law of `coupler.physics.constitutive` inside MACHDYN. It acts through two numbers of each point: yield stress and
energy.

MACHDYN's own Johnson-Cook law has no thermal softening and averages the strain rate over some 500 ns. Its linear plastic strength
model with zero offset returns the deviator to H eff_plastic_strain: with sigma_y / H in eff_plastic_strain before a step, the yield
stress is sigma_y, and the increase in the step is the increment of plastic strain. Its shock equation of state gives the mean
stress -p_H + rho Gamma e: heat has the wrong sign, and the Hugoniot pressure p_H is too stiff. The energy e in esph is chosen so that
this sum equals -p of `coupler.physics.constitutive`. Yield stress and energy lag by one step.
"""

import numpy as np

from ..compiling import njit
from ..core.arrays import Floats, Ints, Laws
from ..core.loops import ranges
from ..geometry.matrix_kernels import SMALLEST, eigenvalue
from ..physics.constitutive import Law, harden, heated, hugoniot_pressure, mie_gruneisen, on, softened
from .model import State

LEAST_POINTS = 1000  # in a range of a loop that threads share


@njit(cache=True, nogil=True, inline="always")
def _volume_ratio(law: Law, mean: float, J: float, e: float) -> float:
    """The J at which MACHDYN's equation of state with the energy e (J/kg) gives the mean stress (Pa): Newton's method from the last
    J."""
    if not (on(law.s) or on(law.Gamma0)):
        return 1.0 + mean / law.K
    for _ in range(30):
        eta = 1.0 - J
        w = 1.0 - law.s * eta
        residual, slope = -(law.K * eta / (w * w)) - mean, -law.K * (1.0 + law.s * eta) / (w * w * w)
        if on(law.Gamma0):
            residual += law.rho / J * law.Gamma0 * e
            slope += law.rho / (J * J) * law.Gamma0 * e
        step = -residual / slope
        J -= step
        if abs(step) < 1e-13:
            break
    return J


@njit(cache=True, nogil=True, error_model="numpy")
def apply_law(
    laws: Laws, dt: float, H: float, volume: Floats, mass: Floats, eps: Floats, e: Floats, de: Floats, set_e: Floats, a: State,
    sums: Floats,
) -> None:  # fmt: skip
    """Read the result of MACHDYN's step, update the state of every point, and prescribe the next step.

    laws: one LAW record; dt (s); H (Pa); volume (n,) m3. Arrays of MACHDYN (n,): mass (kg); eps, e (J) and de (W): plastic strain,
    energy and its rate, which prescribe the next step; set_e (J/kg): energy prescribed for this step, then for the next; a.stress:
    stress of LAMMPS, only read. sums[:2] (J) grow by the plastic work and by the part of its heat that raises the pressure.
    """
    law = laws[0]
    for i in range(len(volume)):
        mean = (a.stress[i, 0] + a.stress[i, 3] + a.stress[i, 5]) / 3.0
        J, sy = _volume_ratio(law, mean, a.J[i], set_e[i]), a.sigma_y[i]  # values in MACHDYN's step
        deps = max(eps[i] - sy / H, 0.0)
        a.eps_p[i], a.rate[i], a.T[i], a.sigma_y[i], w = harden(law, deps, dt, J, sy, sy, a.eps_p[i], a.rate[i], a.T[i])
        heat = 0.0
        if on(law.taylor_quinney) and on(law.expansion):
            heat = law.expansion * law.taylor_quinney * w
            sums[1] += volume[i] * heat
        a.p[i], a.energy[i] = mie_gruneisen(law, a.J[i], J, a.p[i], a.energy[i], heat)
        a.J[i] = J
        a.work[i] += w
        sums[0] += volume[i] * w
        eps[i] = a.sigma_y[i] / H
        if on(law.Gamma0) and law.Gamma0 > 0.0:
            set_e[i] = (hugoniot_pressure(law, J) - a.p[i]) * J / (law.rho * law.Gamma0)
        e[i] = set_e[i] * mass[i]
        de[i] = 0.0


@njit(cache=True, nogil=True)
def warm_points(
    team: Ints, laws: Laws, H: float, volume: Floats, heat: Floats, machdyn_eps: Floats, a: State, pressing: Floats
) -> None:
    """Add heat (n,) J to points: T by enthalpy, sigma_y by softening, energy by the part that raises the pressure in the next step.

    Writes machdyn_eps (n,), which prescribes sigma_y for the next step; adds the part that raises the pressure to pressing (PARTS,) J.
    """
    for lo, hi, part in ranges(team, 0, len(heat), LEAST_POINTS):
        for i in range(lo, hi):
            if heat[i] == 0.0:
                continue
            law, old = laws[a.law_of[i]], a.T[i]
            a.T[i] = heated(law, old, heat[i] / (law.rho * volume[i]))
            a.sigma_y[i] = softened(law, a.sigma_y[i], a.eps_p[i], old, a.T[i])
            machdyn_eps[i] = a.sigma_y[i] / H
            a.energy[i] += law.expansion * heat[i] / volume[i]
            pressing[part] += law.expansion * heat[i]


@njit(cache=True, nogil=True)
def add_up(
    team: Ints, laws: Laws, dt: float, volume: Floats, mass: Floats, v: Floats, f: Floats, a: State, sums: Floats
) -> None:
    """Write sums over points, part by part, to sums (PARTS,6): kinetic energy and stored energy, J; momentum, kg m/s; square of the
    largest speed, m2/s2.

    Stored energy: of deviators, J V s:s / 4G, and of volume changes, with the part due to heat. Kinetic energy: the sum of
    m v(n-1/2) . v(n+1/2) / 2; its change in the integrator is the work of the forces. v (n,3) m/s and f (n,3) N: both at n.
    """
    for lo, hi, part in ranges(team, 0, len(volume), LEAST_POINTS):
        kinetic = stored = x = y = z = fastest = 0.0
        for i in range(lo, hi):
            s = a.stress[i]
            mean = (s[0] + s[3] + s[5]) / 3.0
            xx, yy, zz = s[0] - mean, s[3] - mean, s[5] - mean
            ss = xx * xx + yy * yy + zz * zz + 2.0 * (s[1] ** 2 + s[2] ** 2 + s[4] ** 2)
            stored += volume[i] * (a.J[i] * ss / (4.0 * laws[a.law_of[i]].G) + a.energy[i])
            m, half = mass[i], 0.5 * dt / mass[i]
            v0, v1, v2 = v[i, 0], v[i, 1], v[i, 2]
            f0, f1, f2 = half * f[i, 0], half * f[i, 1], half * f[i, 2]
            square = v0 * v0 + v1 * v1 + v2 * v2
            kinetic += m * (square - (f0 * f0 + f1 * f1 + f2 * f2))
            x, y, z, fastest = x + m * v0, y + m * v1, z + m * v2, max(fastest, square)
        sums[part, 0], sums[part, 1] = 0.5 * kinetic, stored
        sums[part, 2], sums[part, 3], sums[part, 4], sums[part, 5] = x, y, z, fastest


@njit(cache=True, nogil=True)
def smallest_stretch(lo: int, hi: int, strain: Floats) -> tuple[float, int]:
    """Smallest principal stretch of the points lo to hi - 1, and the index of this point. strain (n,6): Green-Lagrange, xx yy zz xy
    xz yz."""
    smallest = 1e300
    where = -1
    for i in range(lo, hi):
        xx, yy, zz = 1.0 + 2.0 * strain[i, 0], 1.0 + 2.0 * strain[i, 1], 1.0 + 2.0 * strain[i, 2]
        low = eigenvalue(xx, yy, zz, 2.0 * strain[i, 5], 2.0 * strain[i, 4], 2.0 * strain[i, 3], SMALLEST)
        if low < smallest:
            smallest, where = low, i
    return np.sqrt(max(smallest, 0.0)), where
