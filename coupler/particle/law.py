"""Our constitutive law inside MACHDYN, through the two per-point numbers it lets one set: yield stress and energy.

MACHDYN's own Johnson-Cook has no thermal softening and averages the strain rate over some 500 ns. Its linear
plastic strength model with a zero offset returns the deviator to H x eff_plastic_strain, so writing sigma_y/H into
eff_plastic_strain each step prescribes the yield stress, and what MACHDYN then adds to it is the plastic strain of
the step. Its shock equation of state gives the mean stress -p_H + rho Gamma e, in which heat pulls where it should
push and the Hugoniot term is too stiff; writing into esph the e that makes that sum equal -p of
`coupler.physics.constitutive` mends both. Both lag by one step.
"""

import numpy as np

from ..compiling import njit
from ..core.arrays import Floats, Ints, Laws
from ..core.loops import ranges
from ..physics.constitutive import Law, harden, heated, hugoniot_pressure, mie_gruneisen, on, softened

LEAST_POINTS = 1000  # in a range of a loop that threads share


@njit(cache=True, nogil=True, inline="always")
def _machdyn_hugoniot(law: Law, J: float) -> tuple[float, float]:
    """Pressure of MACHDYN's shock equation of state without energy, and its slope in J: the Hugoniot as it stands."""
    eta = 1.0 - J
    w = 1.0 - law.s * eta
    return law.K * eta / (w * w), -law.K * (1.0 + law.s * eta) / (w * w * w)


@njit(cache=True, nogil=True, inline="always")
def _volume_ratio(law: Law, mean: float, J: float, e: float) -> float:
    """The J at which MACHDYN's equation of state with the energy e (J/kg) gives this mean stress (Pa): Newton from the last J."""
    if not (on(law.s) or on(law.Gamma0)):
        return 1.0 + mean / law.K
    for _ in range(30):
        pH, slope = _machdyn_hugoniot(law, J)
        residual = -pH - mean
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
    laws: Laws, dt: float, H: float, volume: Floats, mass: Floats, stress: Floats, machdyn_eps: Floats, machdyn_e: Floats,
    machdyn_de: Floats, sigma_y: Floats, eps_p: Floats, rate: Floats, T: Floats, J: Floats, p: Floats, energy: Floats, set_e:
    Floats, work: Floats, sums: Floats,
) -> None:  # fmt: skip
    """Read what MACHDYN did in this step, move the state of every point on, and prescribe the next step.

    laws: one LAW record, dt s, H Pa. Per point (n,): volume m3 and mass kg; machdyn_eps, machdyn_e (J), machdyn_de
    (W) of LAMMPS, written; stress (n,6) of LAMMPS, xx xy xz yy yz zz, read; sigma_y Pa, eps_p, rate 1/s, T K, J, p
    Pa, energy J per reference m3, work (plastic work per reference m3); set_e: the e (J/kg) prescribed for this
    step. sums (2,) grows by plastic work and by what of its heat makes pressure, J.
    """
    law = laws[0]
    for i in range(len(eps_p)):
        mean = (stress[i, 0] + stress[i, 3] + stress[i, 5]) / 3.0
        Ji = _volume_ratio(law, mean, J[i], set_e[i])  # what MACHDYN saw
        deps = max(machdyn_eps[i] - sigma_y[i] / H, 0.0)
        eps_p[i], rate[i], T[i], sigma_y[i], w = harden(
            law, deps, dt, Ji, sigma_y[i], sigma_y[i], eps_p[i], rate[i], T[i]
        )
        heat = 0.0
        if on(law.taylor_quinney) and on(law.expansion):
            heat = law.expansion * law.taylor_quinney * w
            sums[1] += volume[i] * heat
        p[i], energy[i] = mie_gruneisen(law, J[i], Ji, p[i], energy[i], heat)
        J[i] = Ji
        work[i] += w
        sums[0] += volume[i] * w
        machdyn_eps[i] = sigma_y[i] / H
        if on(law.Gamma0) and law.Gamma0 > 0.0:
            set_e[i] = (hugoniot_pressure(law, Ji) - p[i]) * Ji / (law.rho * law.Gamma0)
        machdyn_e[i] = set_e[i] * mass[i]
        machdyn_de[i] = 0.0


@njit(cache=True, nogil=True)
def warm_points(
    team: Ints, laws: Laws, H: float, volume: Floats, heat: Floats, machdyn_eps: Floats, sigma_y: Floats, eps_p: Floats, T: Floats,
    energy: Floats, pressing: Floats,
) -> None:  # fmt: skip
    """Give points heat (n,) J: T by enthalpy, sigma_y by softening, and the energy that makes pressure in the next step.

    machdyn_eps (n,), written, prescribes sigma_y for the next step; pressing (PARTS,): what went into the energy, J, part by part.
    """
    law = laws[0]
    for lo, hi, part in ranges(team, 0, len(heat), LEAST_POINTS):
        for i in range(lo, hi):
            if heat[i] == 0.0:
                continue
            old = T[i]
            T[i] = heated(law, old, heat[i] / (law.rho * volume[i]))
            sigma_y[i] = softened(law, sigma_y[i], eps_p[i], old, T[i])
            machdyn_eps[i] = sigma_y[i] / H
            energy[i] += law.expansion * heat[i] / volume[i]
            pressing[part] += law.expansion * heat[i]


@njit(cache=True, nogil=True)
def stored_energy(laws: Laws, volume: Floats, stress: Floats, J: Floats, energy: Floats) -> float:
    """Energy in J that stresses hold: deviators (J V s:s / 4G) and that of the volume, the heat in it included."""
    law = laws[0]
    total = 0.0
    for i in range(len(J)):
        mean = (stress[i, 0] + stress[i, 3] + stress[i, 5]) / 3.0
        xx, yy, zz = stress[i, 0] - mean, stress[i, 3] - mean, stress[i, 5] - mean
        ss = xx * xx + yy * yy + zz * zz + 2.0 * (stress[i, 1] ** 2 + stress[i, 2] ** 2 + stress[i, 4] ** 2)
        total += volume[i] * (J[i] * ss / (4.0 * law.G) + energy[i])
    return total


@njit(cache=True, nogil=True)
def smallest_stretch(lo: int, hi: int, strain: Floats) -> tuple[float, int]:
    """Smallest principal stretch over points from Green-Lagrange strains (n,6), xx yy zz xy xz yz; and its point."""
    smallest = 1e300
    where = -1
    for i in range(lo, hi):
        xx, yy, zz = 1.0 + 2.0 * strain[i, 0], 1.0 + 2.0 * strain[i, 1], 1.0 + 2.0 * strain[i, 2]
        xy, xz, yz = 2.0 * strain[i, 3], 2.0 * strain[i, 4], 2.0 * strain[i, 5]
        mean = (xx + yy + zz) / 3.0
        xx, yy, zz = xx - mean, yy - mean, zz - mean
        spread = np.sqrt((xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
        low = mean
        if spread > 1e-14 and not mean - 2.0 * spread > smallest:
            xx, yy, zz, xy, xz, yz = xx / spread, yy / spread, zz / spread, xy / spread, xz / spread, yz / spread
            det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
            angle = np.arccos(min(max(0.5 * det, -1.0), 1.0)) / 3.0
            low = mean + 2.0 * spread * np.cos(angle + 2.0 * np.pi / 3.0)
        if low < smallest:
            smallest, where = low, i
    return np.sqrt(max(smallest, 0.0)), where
