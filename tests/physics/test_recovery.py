"""Static recovery: closed forms of both paths of diffusion, the energy that a measurement gives, metals that have none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from coupler.physics.materials import material
from coupler.physics.recovery import GAS_CONSTANT, Recovery, recovered_share, recovery_of

AL = material("Al1100")


def law_of(name: str = "Al1100") -> Recovery:
    law = recovery_of(material(name))
    assert law is not None
    return law


def slope(law: Recovery, rho: float, T: float) -> float:
    """d rho/dt, 1/(m2 s), written out."""
    D_v, D_c = (D * np.exp(-Q / (GAS_CONSTANT * T)) for D, Q in (law.lattice, law.core))
    return float(-law.climb / T * (D_v + rho * D_c) * rho**2)


@pytest.mark.parametrize(("lattice", "power"), [(True, 1), (False, 2)])
def test_along_one_path_alone_the_closed_form_holds(lattice: bool, power: int) -> None:
    """1/rho grows linearly in time by diffusion through the lattice, 1/rho^2 by that along dislocations."""
    both, none, T = law_of(), (1e-300, 0.0), 600.0
    law = replace(both, core=none) if lattice else replace(both, lattice=none)
    eps_p = np.array([0.2, 1.0, 3.0])
    before = law.density(eps_p)
    time = 2.0 / (-power * slope(law, before[1], T) / before[1])
    after = law.density(law.after(eps_p, np.full(3, T), time))
    growth = after**-power - before**-power
    assert growth == pytest.approx(np.full(3, 2.0 * before[1] ** -power), rel=0.02)  # of interpolated strains


def test_both_paths_together_are_those_of_the_differential_equation() -> None:
    law, T = law_of(), 560.0  # each has about a half
    eps_p = np.array([1.0])
    rho = float(law.density(eps_p)[0])
    for time in (0.1, 1.0, 10.0):
        exact = solve_ivp(lambda _, r: [slope(law, r[0], T)], (0.0, time), [rho], rtol=1e-8, method="LSODA").y[0, -1]
        assert law.density(law.after(eps_p, np.array([T]), time))[0] == pytest.approx(exact, rel=0.08)
        halves = eps_p
        for _ in range(64):
            halves = law.after(halves, np.array([T]), time / 64)
        assert law.density(halves)[0] == pytest.approx(exact, rel=0.01)


def test_the_apparent_energy_rises_as_measured_in_cold_rolled_aluminium() -> None:
    """89 kJ/mol at the onset and 125 at the end, at 140 to 220 C after a strain of 2 (Vandermeer & Hansen (2008), Acta Mater. 56, 5719,
    abstract): dislocations carry the diffusion as long as there are many of them."""
    law, T = law_of(), np.array([413.15, 493.15])

    def energy(eps_p: float) -> float:
        rho = float(law.density(np.array([eps_p]))[0])
        rates = [slope(law, rho, each) for each in T]
        return GAS_CONSTANT * float(np.log(rates[1] / rates[0]) / (1.0 / T[0] - 1.0 / T[1])) / 1e3

    annealed = 1e-5  # next to no hardening is left, and the lattice carries most of it
    assert energy(2.0) == pytest.approx(89.0, rel=0.1)
    assert energy(annealed) > energy(0.05) > energy(2.0)
    assert energy(annealed) == pytest.approx(125.0, rel=0.1)
    assert energy(annealed) < 142.0  # of the lattice alone


@pytest.mark.parametrize("name", ["Ni", "OFHC_Cu", "Al1100"])
def test_an_hour_at_room_temperature_takes_next_to_nothing_and_at_two_thirds_of_melting_all(name: str) -> None:
    """Cold-worked metal keeps its strength on the shelf, and annealing at such a temperature softens it."""
    metal = material(name)
    assert recovered_share(metal, 293.0, 3600.0) < 1e-3
    assert recovered_share(metal, 0.67 * metal.T_m, 3600.0) > 0.97


def test_only_metals_whose_diffusion_is_known_recover() -> None:
    assert recovery_of(material("SS304")) is None
    assert recovery_of(material("Al")) is None  # 6061: precipitates hold the dislocations
    assert recovered_share(material("SS304"), 1000.0, 3600.0) == 0.0
    assert recovered_share(AL, 700.0, 0.0) == 0.0


def test_the_strain_never_grows_even_where_the_law_saturates() -> None:
    """Steinberg's set reaches Y_max: its densities end there, and what lies above has the strain at which it begins."""
    law = recovery_of(material("Ni", "Steinberg_1996"))
    assert law is not None
    eps_p = np.array([0.0, 1e-6, 0.1, 1.0, 30.0, 90.0])
    for T in (300.0, 900.0):
        left = law.after(eps_p, np.full(6, T), 1.0)
        assert (left <= eps_p).all()
        assert (np.diff(left) >= 0.0).all()
