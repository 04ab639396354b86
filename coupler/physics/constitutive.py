"""One constitutive law for both domains: strength with plastic heat, Mie-Grueneisen pressure.

The functions treat one material point and are compiled by numba; the SPH particle and the FE target call the same functions. The
yield stress is explicit: a step uses the yield stress sigma_y of the previous step for the radial return. Then `harden` updates plastic
strain, rate and temperature and evaluates the next sigma_y. MACHDYN needs this form, because its stress update uses a given yield
stress. The plastic strain per explicit step is about 1e-4, so that the delay is far below the discretisation error. The strength laws
are in `physics.strength`.

If an effect is off, its number in the law's record is zero. The switch of a strength law that no metal uses is zero, too. In the
records of `specialised` such zeros are integers: from the type the compiler knows that they are zero, and the kernel does not contain
the code under `on`.
"""

from collections.abc import Callable, Mapping
from math import log, sqrt

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from ..compiling import njit
from ..core.arrays import Floats, Ints, Laws
from ..core.threads import share
from . import strength
from .materials import Material
from .strength import Numbers as Law
from .strength import on as on

#: One record per material: the numbers of the law in SI units. `softening`, `expansion` and `dissipation` (numerical dissipation
#: becomes heat) are 1.0 or 0.0.
LAW = np.dtype([(name, np.float64) for name in (
    "rho", "G", "K", "s", "Gamma0", "T_m", "softening", "taylor_quinney", "cp_T0", "cp_T1", "cp_0", "cp_slope", "k_T0", "k_T1", "k_0",
    "k_slope", "rate_filter", "expansion", "dissipation", "forest", "forest_slope", "gradient_length", *strength.FIELDS, *strength.LAWS,
)])  # fmt: skip
#: Numbers that are zero if an effect is off: those of the pressure, and those of plastic flow and its heat.
PRESSURE = ("s", "Gamma0", "expansion")
FLOW = (
    "C", "C_high", *strength.LAWS, "softening", "taylor_quinney", "cp_slope", "expansion", "dissipation", "gradient_length",
)  # fmt: skip

ROOM = 300.0  # K, temperature of the shear modulus in the record
# -(T_m / G) dG/dT: .54 (Cu), .64 (Ni), .50 (Al), Frost & Ashby (1982), Deformation-Mechanism Maps, second-hand
MODULUS_SLOPE = 0.5
FIRST_Y = 0.02  # b sqrt(density) of a metal at some 500 MPa: start value of Newton's method for a given flow stress
NEWTON_STEPS = 3  # error at most 1e-9 of the stress between 50 MPa and 5 GPa

#: Effects that change a LAW record.
SWITCHES = (
    "thermal_softening", "rate_hardening", "mie_gruneisen", "plastic_heating", "temperature_dependent_cp", "temperature_dependent_k",
    "thermal_expansion",
)  # fmt: skip


def law_record(material: Material, on: Mapping[str, bool] | None = None, rate_filter: float = 0.0) -> np.ndarray:
    """The LAW record (1,) of a material: its constants, for the kernels. on: whether an effect is on, by name. Effects that are not
    named are on, except for two.

    rate_filter: time constant of the average of the plastic strain rate for the strength law, s; 0: no average. Without mie_gruneisen
    the Hugoniot has s = 0 and Gamma0 = 0: p = K (1 - J). Without thermal expansion heat is not part of the energy in the equation of
    state; the work of compression is. Two effects are off by default: heat of the numerical dissipation ("dissipation_heat"), which is
    not a property of the metal, and hardening by gradients ("gradient_hardening").
    """
    is_on = dict.fromkeys(SWITCHES, True) | {"dissipation_heat": False, "gradient_hardening": False} | dict(on or {})
    numbers = material.strength.fields(material.T_m, material.rho, is_on["thermal_softening"], is_on["rate_hardening"])
    numbers |= {"rho": material.rho, "G": material.G, "K": material.K, "rate_filter": rate_filter}
    if is_on["mie_gruneisen"]:
        numbers |= {"s": material.s, "Gamma0": material.Gamma0}
    for name, table in (("cp", material.cp), ("k", material.k)):
        (T0, v0), (T1, v1) = table[0], table[-1]
        varies = T1 > T0 and is_on[f"temperature_dependent_{name}"]
        slope = (v1 - v0) / (T1 - T0) if varies else 0.0
        numbers |= {f"{name}_T0": T0, f"{name}_T1": max(T1, T0), f"{name}_0": v0, f"{name}_slope": slope}
    numbers["forest"], numbers["forest_slope"] = material.forest
    numbers["taylor_quinney"] = material.taylor_quinney if is_on["plastic_heating"] else 0.0
    numbers["gradient_length"] = material.gradient_length if is_on["gradient_hardening"] else 0.0
    numbers["expansion"] = 1.0 if is_on["thermal_expansion"] else 0.0
    numbers["dissipation"] = 1.0 if is_on["dissipation_heat"] else 0.0
    law = np.zeros(1, LAW)
    for name, value in numbers.items():
        law[0][name] = value
    return law


def is_metal(laws: np.ndarray, material: Material) -> np.ndarray:
    """Mask (k,) of the LAW records (k,) that belong to a material. Numbers that depend on effects are not compared, nor is the
    density, because that of a body follows from its mass and its mesh."""
    on, off = law_record(material), law_record(material, dict.fromkeys(SWITCHES, False))
    others = "rho", "rate_filter", "dissipation", "gradient_length"
    names = [name for name in LAW.names or () if on[name] == off[name] and name not in others]
    return np.all([laws[name] == on[name] for name in names], axis=0)


def specialised(laws: np.ndarray, numbers: tuple[str, ...] = PRESSURE + FLOW) -> np.ndarray:
    """A view of LAW records (k,). In it, each of the fields `numbers` that is zero in all records has an integer type.

    Kernels omit the effects of integer fields (`on`), which must stay zero. numba compiles the kernels for each combination of
    zeros: name only numbers that the kernel reads.
    """
    bits = np.ascontiguousarray(laws, LAW).view(np.int64).reshape(len(laws), -1)
    off = {name for name, seen in zip(LAW.names or (), bits.T, strict=True) if name in numbers and not seen.any()}
    return laws.view([(name, np.int64 if name in off else np.float64) for name in LAW.names or ()])


@overload(on)
def _on(number: object) -> Callable[[object], bool]:
    holds = not isinstance(number, types.Integer)

    def implementation(number: object) -> bool:
        return holds

    return implementation


@njit(cache=True, nogil=True, inline="always")
def heat_capacity(law: Law, T: float) -> float:
    """c_p(T), J/(kg K): linear between the two points of the material data, constant outside."""
    if not on(law.cp_slope):
        return law.cp_0
    return law.cp_0 + law.cp_slope * (min(max(T, law.cp_T0), law.cp_T1) - law.cp_T0)


@njit(cache=True, nogil=True, inline="always")
def conductivity(law: Law, T: float) -> float:
    """k(T), W/(m K): linear between the two points of the material data, constant outside."""
    return law.k_0 + law.k_slope * (min(max(T, law.k_T0), law.k_T1) - law.k_T0)


def heat_capacities(laws: NDArray | np.void, T: NDArray) -> NDArray[np.float64]:
    """`heat_capacity` (m,) for one LAW record or records laws (m,), at T (m,) K."""
    return laws["cp_0"] + laws["cp_slope"] * (np.clip(T, laws["cp_T0"], laws["cp_T1"]) - laws["cp_T0"])


def conductivities(laws: NDArray | np.void, T: NDArray) -> NDArray[np.float64]:
    """`conductivity` (m,) for one LAW record or records laws (m,), at T (m,) K."""
    return laws["k_0"] + laws["k_slope"] * (np.clip(T, laws["k_T0"], laws["k_T1"]) - laws["k_T0"])


@njit(cache=True, nogil=True, inline="always")
def heated(law: Law, T: float, q: float) -> float:
    """Temperature (K) after heating by q J/kg from T (K): exact for a linear c_p(T)."""
    cp = heat_capacity(law, T)
    slope = law.cp_slope if law.cp_T0 < T < law.cp_T1 else 0.0
    return T + 2.0 * q / (cp + sqrt(max(cp * cp + 2.0 * slope * q, 0.0)))


# without these options, numba compiles a function with the options of its first caller, which may be those of fast arithmetic
_precise = njit(cache=True, nogil=True, fastmath=False, error_model="numpy")
_johnson_cook = _precise(strength.johnson_cook)
_zerilli_armstrong = _precise(strength.zerilli_armstrong)
_steinberg_guinan = _precise(strength.steinberg_guinan)
_preston_tonks_wallace = _precise(strength.preston_tonks_wallace)


@_precise
def yield_stress(law: Law, eps_p: float, rate: float, T: float) -> float:
    """Flow stress, Pa, by the strength law of the record. rate: plastic strain rate, 1/s; T: K."""
    if on(law.preston_tonks_wallace) and law.preston_tonks_wallace > 0.0:
        return _preston_tonks_wallace(law, eps_p, rate, T)
    if on(law.zerilli_armstrong) and law.zerilli_armstrong > 0.0:
        return _zerilli_armstrong(law, eps_p, rate, T)
    if on(law.steinberg_guinan) and law.steinberg_guinan > 0.0:
        return _steinberg_guinan(law, eps_p, rate, T)
    return _johnson_cook(law, eps_p, rate, T)


@njit(cache=True, nogil=True, inline="always")
def norm(gradient: Floats, i: int) -> float:
    """Length of the vector in row i of gradient (n,3)."""
    return sqrt(gradient[i, 0] ** 2 + gradient[i, 1] ** 2 + gradient[i, 2] ** 2)


@_precise
def with_gradient(law: Law, sigma: float, eta: float, T: float) -> float:
    """Flow stress, Pa, with the gradient eta (1/m) of plastic strain. sigma: flow stress of the strength law, Pa.

    Dislocations due to the gradient (Ashby 1970, Phil. Mag. 21, 399) are added to statistically stored dislocations. Taylor's relation
    (`materials.Material.forest`) gives the flow stress of the sum: Nix & Gao (1998), J. Mech. Phys. Solids 46, 411; Huang et al.
    (2004), Int. J. Plasticity 20, 753. In the code y = b sqrt(density), b: Burgers vector. T (K) softens the shear modulus.
    """
    modulus = 1.0 - law.softening * MODULUS_SLOPE * (T - ROOM) / law.T_m
    if not law.gradient_length > 0.0 or not sigma > 0.0 or not eta > 0.0 or not modulus > 0.0:
        return sigma
    A, B = modulus * law.forest, modulus * law.forest_slope
    y = sigma / (A + B * log(FIRST_Y))
    for _ in range(NEWTON_STEPS):  # y (A + B ln y) = sigma: statistically stored dislocations
        y = (sigma + B * y) / (A + B + B * log(y))
    both = sqrt(y * y + law.gradient_length * eta)
    return both * (A + B * log(both))


@njit(cache=True, nogil=True)
def softened(law: Law, sigma_y: float, eps_p: float, old: float, T: float) -> float:
    """Yield stress (Pa) after a change of temperature from `old` to T (K) without plastic flow.

    sigma_y times the ratio of the softening factors: 1 - theta^m for Johnson-Cook, otherwise the flow stress at eps_p and rate 0.
    """
    if law.softening == 0.0:
        return sigma_y
    if law.johnson_cook > 0.0:
        if max(old, T) <= law.T_ref:
            return sigma_y
        span = law.T_m - law.T_ref
        before = max(1.0 - (max(old - law.T_ref, 0.0) / span) ** law.m, 0.0)
        after = max(1.0 - (max(T - law.T_ref, 0.0) / span) ** law.m, 0.0)
    else:
        before, after = yield_stress(law, eps_p, 0.0, old), yield_stress(law, eps_p, 0.0, T)
    return sigma_y * after / before if before > 0.0 else sigma_y


@_precise
def harden(
    law: Law, deps: float, dt: float, J: float, flow: float, sigma_y: float, eps_p: float, rate: float, T: float,
    eta: float = 0.0,
) -> tuple[float, float, float, float, float]:  # fmt: skip
    """Plastic state after a step with the plastic strain increment `deps` at the mean flow stress `flow` (Pa) of the step.

    Returns (eps_p, rate, T, sigma_y, work): the new state, the yield stress of the next step, and the plastic work of this step per
    reference volume, J/m3. J: volume ratio; dt: s; eta: as in `with_gradient`. Adiabatic: the Taylor-Quinney fraction of the work
    becomes heat. Without plastic flow sigma_y changes only while the averaged rate (`law_record`) exceeds eps_dot_0.
    """
    tau = law.rate_filter
    weight = dt / (tau + dt)
    rate += weight * (deps / dt - rate)
    work = 0.0
    if deps > 0.0:
        work = J * flow * deps
        eps_p += deps
        if on(law.taylor_quinney):
            T += law.taylor_quinney * work / (law.rho * heat_capacity(law, T))
    if deps > 0.0 or rate > law.eps_dot_0:
        sigma_y = yield_stress(law, eps_p, rate, T)
        if on(law.gradient_length):
            sigma_y = with_gradient(law, sigma_y, eta, T)
    else:
        rate = 0.0
    return eps_p, rate, T, sigma_y, work


@njit(cache=True, nogil=True, inline="always")
def hugoniot_pressure(law: Law, J: float) -> float:
    """Pressure on the Hugoniot, p_H = K eta / (1 - s eta)^2 with eta = 1 - J and K = rho c0^2 (Pa)."""
    eta = 1.0 - J
    if on(law.s):
        return law.K * eta / (1.0 - law.s * eta) ** 2
    return law.K * eta


@njit(cache=True, nogil=True, inline="always")
def pressure(law: Law, J: float, energy: float) -> float:
    """Mie-Grueneisen pressure in Pa: p_H (1 - Gamma0 eta / 2) + Gamma0 E with Gamma rho = Gamma0 rho0.

    eta = 1 - J; energy E in J per reference m3.
    """
    return hugoniot_pressure(law, J) * (1.0 - 0.5 * law.Gamma0 * (1.0 - J)) + law.Gamma0 * energy


@_precise
def mie_gruneisen(law: Law, J_old: float, J: float, p_old: float, energy: float, heat: float) -> tuple[float, float]:
    """Pressure (Pa) and energy (J per reference m3) after a change of the volume ratio from J_old to J and the supply of heat (J/m3).

    Solution of `pressure` and the energy equation dE = -p dJ + dq (trapezoidal rule, linear in p).
    """
    dJ = J - J_old
    energy += heat - 0.5 * p_old * dJ
    p = pressure(law, J, energy) / (1.0 + 0.5 * law.Gamma0 * dJ) if on(law.Gamma0) else hugoniot_pressure(law, J)
    return p, energy - 0.5 * p * dJ


@njit(cache=True, nogil=True, inline="always")
def bulk_stiffness(law: Law, J: float) -> float:
    """-dp/dJ on the Hugoniot, Pa: stiffness of the compressed material, for the stable time step."""
    eta = max(1.0 - J, 0.0)
    return law.K * (1.0 + law.s * eta) / (1.0 - law.s * eta) ** 3


@njit(cache=True)
def pressures(laws: Laws, J: Floats, energy: Floats) -> Floats:
    """`pressure` (n,) Pa: LAW record laws (1,), J (n,), energy (n,) J per reference m3."""
    law, p = laws[0], np.empty(len(J))
    for i in range(len(J)):
        p[i] = pressure(law, J[i], energy[i])
    return p


@njit(cache=True)
def yield_stresses(laws: Laws, law_of: Ints, eps_p: Floats, T: Floats, gradient: Floats) -> Floats:
    """Yield stress (m,) Pa at rate 0. law_of (m,): index in LAW records laws; eps_p (m,), T (m,) K; gradient (m,3) of eps_p, 1/m."""
    sigma = np.empty(len(T))
    for e in range(len(T)):
        law = laws[law_of[e]]
        sigma[e] = with_gradient(law, yield_stress(law, eps_p[e], 0.0, T[e]), norm(gradient, e), T[e])
    return sigma


@njit(cache=True, nogil=True, inline="always")
def von_mises_squared(sxx: float, syy: float, szz: float, syz: float, sxz: float, sxy: float) -> float:
    """Square of the equivalent stress of a deviator, 3/2 s:s."""
    return 1.5 * (sxx * sxx + syy * syy + szz * szz + 2.0 * (syz * syz + sxz * sxz + sxy * sxy))


LEAST = 4000  # least number of tensors in a range of a shared loop


def von_mises(stress: NDArray) -> NDArray[np.float64]:
    """Equivalent stress (n,) of tensors (n,6), Voigt xx yy zz yz xz xy, in the unit of the tensors."""
    found = np.empty(len(stress))
    share(lambda lo, hi: _equivalent(lo, hi, stress, found), len(stress), LEAST)
    return found


@njit(cache=True, nogil=True)
def _equivalent(lo: int, hi: int, stress: NDArray, found: Floats) -> None:
    """Write the equivalent stresses of the tensors lo to hi - 1 of stress (n,6) to found (n,)."""
    for i in range(lo, hi):
        s = stress[i]
        mean = (s[0] + s[1] + s[2]) / 3.0
        found[i] = sqrt(von_mises_squared(s[0] - mean, s[1] - mean, s[2] - mean, s[3], s[4], s[5]))


def sound_speed(rho: float, K: float, G: float) -> float:
    """Speed of longitudinal elastic waves, m/s. rho: density, kg/m3; K, G: bulk and shear modulus, Pa."""
    return float(np.sqrt((K + 4.0 * G / 3.0) / rho))
