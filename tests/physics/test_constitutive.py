"""The law against its formula, its limits and its energy balance."""

import itertools
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

import coupler
from coupler.physics import constitutive as law
from coupler.physics.materials import material


@pytest.mark.parametrize("name", ["Ni", "Ti", "SS304"])
def test_johnson_cook_is_the_published_formula(name: str) -> None:
    m = material(name)
    record = law.law_record(m)[0]
    eps, rate, T = 0.3, 2e6, 700.0
    theta = (T - m.T_ref) / (m.T_m - m.T_ref)
    A, B, n, C, exponent = (m.strength[key] for key in ("A", "B", "n", "C", "m"))
    expected = (A + B * eps**n) * (1 + C * np.log(rate)) * (1 - theta**exponent)
    assert law.yield_stress(record, eps, rate, T) == pytest.approx(expected, rel=1e-14)
    assert law.yield_stress(record, 0.0, 0.0, 200.0) == m.strength["A"]  # no hardening, no rate, no heat
    assert law.yield_stress(record, 1.0, 1e6, m.T_m + 50) == 0.0  # molten


def test_effects_leave_the_law_one_by_one() -> None:
    m = material("Ni")
    state = (0.5, 1e7, 900.0)
    cold = law.yield_stress(law.law_record(m, {"thermal_softening": False})[0], *state)
    slow = law.yield_stress(law.law_record(m, {"rate_hardening": False})[0], *state)
    full = law.yield_stress(law.law_record(m)[0], *state)
    theta = (900.0 - m.T_ref) / (m.T_m - m.T_ref)
    assert full / cold == pytest.approx(1 - theta ** m.strength["m"])
    assert full / slow == pytest.approx(1 + m.strength["C"] * np.log(1e7))
    no_heat = law.law_record(m, {"plastic_heating": False})[0]
    assert law.harden(no_heat, 0.1, 1e-9, 1.0, m.strength["A"], m.strength["A"], 0.0, 0.0, 300.0)[2] == 300.0
    linear = law.law_record(m, {"mie_gruneisen": False})[0]
    assert law.mie_gruneisen(linear, 1.0, 0.9, 0.0, 0.0, 1e9)[0] == pytest.approx(0.1 * m.K)


def test_plastic_work_becomes_heat_by_the_taylor_quinney_share() -> None:
    m = material("SS304")
    record = law.law_record(m, rate_filter=1e-10)[0]
    eps_p, rate, T, sigma_y, total = 0.0, 0.0, 300.0, m.strength["A"], 0.0
    for _ in range(4000):
        eps_p, rate, T, sigma_y, work = law.harden(record, 2.5e-4, 1e-11, 1.0, sigma_y, sigma_y, eps_p, rate, T)
        total += work
    # cp grows linearly up to 1073 K: the heat that warms from 300 K to T is the integral of rho cp
    slope = (m.cp[1][1] - m.cp[0][1]) / (m.cp[1][0] - m.cp[0][0])
    rise = min(T, 1073.0) - 300.0
    stored = m.rho * (m.cp[0][1] * rise + 0.5 * slope * rise**2 + m.cp[1][1] * max(T - 1073.0, 0.0))
    assert eps_p == pytest.approx(1.0)
    assert rate == pytest.approx(2.5e7, rel=1e-12)
    assert stored == pytest.approx(0.9 * total, rel=1e-3)


def test_shock_compression_lies_on_the_hugoniot() -> None:
    """A jump with the Rankine-Hugoniot energy ends at p = rho c0^2 eta / (1 - s eta)^2, whatever Gamma0 is."""
    m = material("Ni")
    record = law.law_record(m)[0]
    J = 0.85
    eta = 1 - J
    hugoniot = m.K * eta / (1 - m.s * eta) ** 2
    energy = 0.5 * hugoniot * eta  # per reference volume
    # one straight (Rayleigh) step from rest is exactly the Rankine-Hugoniot jump
    p, e = law.mie_gruneisen(record, 1.0, J, 0.0, 0.0, 0.0)
    assert p == pytest.approx(hugoniot, rel=1e-12)
    assert e == pytest.approx(energy, rel=1e-12)


def test_adiabatic_compression_returns_the_energy_it_took() -> None:
    record = law.law_record(material("Ni"))[0]
    path = np.concatenate([np.linspace(1, 0.9, 2000), np.linspace(0.9, 1, 2000)[1:]])
    p = e = 0.0
    for J0, J1 in itertools.pairwise(path):
        p, e = law.mie_gruneisen(record, J0, J1, p, e, 0.0)
    assert abs(p) < 1e-9 * record["K"]
    assert abs(e) < 1e-9 * record["K"]


def test_heat_at_constant_volume_pushes() -> None:
    record = law.law_record(material("Ni"))[0]
    p, _ = law.mie_gruneisen(record, 1.0, 1.0, 0.0, 0.0, 1e8)
    assert p == pytest.approx(record["Gamma0"] * 1e8)


def test_arithmetic_of_a_kernel_does_not_depend_on_who_compiles_it_first() -> None:
    """numba compiles a function without `fastmath` as the kernel that calls it first: with two such kernels the order of compilation
    would decide the last digits. So what a kernel with fast arithmetic calls says itself what it wants."""
    root = Path(coupler.__file__).parent
    names = {p.relative_to(root.parent).with_suffix("").parts for p in root.glob("*/*.py") if "njit(" in p.read_text()}
    modules = [import_module(".".join(name)) for name in names]
    kernels = {f for module in modules for f in vars(module).values() if isinstance(f, CPUDispatcher)}

    def called(kernel: CPUDispatcher) -> set[CPUDispatcher]:
        """Functions of numba that a kernel calls, in the place of those that it inlines what they call."""
        seen = {kernel.py_func.__globals__.get(name) for name in kernel.py_func.__code__.co_names} & kernels
        inlined = {f for f in seen if f.targetoptions.get("inline") == "always"}
        return (seen - inlined).union(*map(called, inlined))

    fast = {kernel for kernel in kernels if "fastmath" in kernel.targetoptions}
    assert law.harden in fast
    silent = {
        (f.__name__, kernel.__name__) for kernel in fast for f in called(kernel) if "fastmath" not in f.targetoptions
    }
    assert silent == set()
