"""What viscosity and hourglass control take from the motion, measured from their own forces, and the heat that it becomes."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from conftest import elastic

from coupler.deposition.summary import LIMITS, _above
from coupler.errors import SolverError
from coupler.fe import mesh as meshes
from coupler.fe.explicit import Target
from coupler.geometry import mesher
from coupler.impact.ledger import Ledger
from coupler.particle import packing
from coupler.particle.compiled import KERNEL, CompiledParticle
from coupler.particle.machdyn import MachdynParticle
from coupler.particle.particle import Numerics, Particle
from coupler.physics import constitutive as law
from coupler.physics.constitutive import heat_capacities
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.plan.reading import Scene

D = 25e-6
DT = 2e-11
Build = Callable[..., Particle]


@pytest.fixture
def ball() -> Iterator[Build]:
    """Builds a ball of the elastic material, by default with the compiled engine."""
    alive: list[Particle] = []

    def build(cls: type[Particle] = CompiledParticle, heats: bool = False, E: float = 200e9, **numerics: float):
        record = law.law_record(elastic(E=E), {"dissipation_heat": heats})
        alive.append(cls(*packing.sphere(D, 400), record, (0.0, 0.0, 0.0), 300.0, Numerics(**numerics)))
        return alive[-1]

    yield build
    for particle in alive:
        particle.close()


def move(p: Particle, velocity: np.ndarray) -> None:
    p.points.v[:] = velocity
    p.points.vest[:] = velocity


@pytest.mark.parametrize(
    ("numerics", "column"), [({"hourglass": 0.0}, 2), ({"Q1": 0.0}, 3)], ids=["viscosity", "control"]
)
def test_a_line_is_the_kinetic_energy_that_its_forces_take(
    ball: Build, numerics: dict[str, float], column: int
) -> None:
    """Points without stiffness: one of the two forces alone brings them to rest against each other, and its line is the loss."""
    p = ball(E=1.0, **numerics)
    p._sides = p._sides._replace(c=np.full_like(p._sides.c, 5000.0))  # both forces are proportional to it
    move(p, p.X * np.array([4e5, 3e5, -6e5]) + 2.0 * np.random.default_rng(3).normal(size=p.X.shape))
    start = p.totals().kinetic
    for _ in range(20):
        p.run(10, 5 * DT, lambda: None)
    assert start - p.totals().kinetic > 0.1 * start
    assert p.sums[column] == pytest.approx(start - p.totals().kinetic, rel=1e-3)
    assert p.sums[5 - column] == 0.0


def test_uniform_stretching_loses_what_the_pairs_formula_says(ball: Build) -> None:
    """Monaghan's linear viscosity in one step of v = a X: sum of m^2 W' Q1 c h a^2 r^3 / (rho (r + .1 h)^2 (r + .01 h)) dt."""
    p = ball(hourglass=0.0)
    a, dt = 1e3, 1e-15
    move(p, a * p.X)
    p.run(1, dt, lambda: None)
    h = 2.0 * p.numerics.kernel_radius * p.spacing
    r = np.sqrt(((p.X[:, None] - p.X[None]) ** 2).sum(axis=2))[np.triu_indices(p.n, 1)]
    r = r[r < h]
    slope = KERNEL * (h - r) ** 2 / h**6
    m, rho = p.mass[0], p.law["rho"][0]
    force = -(m**2) / rho * slope * p.numerics.Q1 * p.wave_speed * h * a * r**2 / (r + 0.1 * h) ** 2
    # the step and the half step after it, in which its forces still act; before it there were none
    assert p.sums[2] == pytest.approx(float((force * a * r**2 / (r + 0.01 * h)).sum()) * dt, rel=1e-6)


@pytest.mark.parametrize("spin", [0.0, 5e6], ids=["flight", "spin"])
def test_rigid_motion_loses_nothing(ball: Build, spin: float) -> None:
    p = ball()
    move(p, np.array([300.0, 0.0, -400.0]) + np.cross(np.array([0.0, 0.0, spin]), p.X))
    p.run(100, DT, lambda: None)
    assert abs(p.sums[2:]).max() < 1e-3 * (spin * D) ** 2 * p.mass.sum() + 1e-12 * p.totals().kinetic


def test_losses_heat_their_points(ball: Build) -> None:
    """All of both lines is in the temperatures, more of it where points move against each other."""
    p = ball(heats=True)
    upper = p.X[:, 2] > 0.0
    move(p, np.where(upper[:, None], 20.0, 0.1) * np.random.default_rng(3).normal(size=p.X.shape))
    p.run(10, DT, lambda: None)
    heat = float(p.law["rho"][0] * p.volume @ (heat_capacities(p.law[0], p.points.T) * (p.points.T - 300.0)))
    assert heat == pytest.approx(float(p.sums[2:].sum()), rel=1e-6)
    assert p.points.T[upper].mean() - 300.0 > 10.0 * abs(p.points.T[~upper].mean() - 300.0)


def test_machdyn_books_no_parts(ball: Build) -> None:
    """MACHDYN's pair style gives the sum of all forces only: its whole dissipation stays on the unexplained line."""
    p = ball(MachdynParticle, heats=True)
    move(p, p.X * np.array([4e5, 3e5, -6e5]))
    p.run(100, DT, lambda: None)
    assert p.totals().viscosity == p.totals().hourglass == 0.0
    assert p.internal_work > p.totals().elastic + p.sums[0]
    assert np.array_equal(p.points.T, np.full(p.n, 300.0))


def test_bulk_viscosity_heats_its_elements() -> None:
    """A block that is compressed fast: heat of the elements is the work of the viscosity, and makes pressure like any other."""
    metal = material("Ni")
    m = meshes.prepare(*mesher.box((1.0, 1.0, 1.0), 0.5))
    temperatures = []
    for heats in (True, False):
        record = law.law_record(metal, {"dissipation_heat": heats, "plastic_heating": False})
        t = Target(m, record, 300.0, fixed=(), track_wave=False)
        t.nodes.v[:] = -200.0 * (m.points - 0.5)
        for _ in range(20):
            t.advance(2e-6)
            t.finish()
        assert t.balance.numerical > 0.0
        heat = float((record["rho"] * m.V0) @ (heat_capacities(record[0], t.elements.T) * (t.elements.T - 300.0)))
        assert heat == pytest.approx(t.balance.numerical if heats else 0.0, rel=1e-3)
        assert t.balance.heat == pytest.approx(t.balance.numerical if heats else 0.0, rel=1e-12)
        temperatures.append(t.elements.T.mean())
    assert temperatures[0] > temperatures[1] == 300.0


def test_energy_that_the_scheme_generates_does_not_hide_behind_what_viscosity_takes() -> None:
    """Al at 1250 m/s on Cu, heated by its dissipation beyond melting: 20 % generated, 20 % taken, a sum of 0.2 %."""
    ledger = Ledger.__new__(Ledger)
    ledger.kinetic_0 = 1.0
    ledger.rows = {"drift": 0.003, "momentum_error": 0.0, "numerical_particle": 0.0018, "unexplained_particle": -0.001}
    ledger.check_closure()
    ledger.rows["unexplained_particle"] = -0.198
    with pytest.raises(SolverError, match=r"generated 19\.80% of the initial kinetic energy"):
        ledger.check_closure()


@pytest.mark.parametrize(("velocity", "on"), [(1000, True), (1250, False)])
def test_metal_that_could_melt_is_not_heated_by_dissipation(velocity: float, on: bool) -> None:
    """A particle of Al at 1250 m/s can reach 1080 K; it melts at 855 K. Ni stays far below its melting point."""
    metal = "Ni" if on else "Al"
    scene = f"""
        [particle]
        material = "{metal}"
        diameter = "25 um"
        velocity = "{velocity} m/s"
        [substrate]
        material = "42CrMo4"
        diameter = "100 um"
        height = "60 um"
    """
    assert plan(Scene.from_text(scene, "hot")).effects.dissipation_heat is on


@pytest.mark.parametrize(("plastic", "expected"), [(0.2, 0.25), (0.009, None), (0.0, None)])
def test_a_particle_that_hardly_flows_has_no_share_of_its_plastic_work(plastic: float, expected: float | None) -> None:
    """A share of a plastic work of rounding size is a number without meaning (149295024 %), and no warning comes of it."""
    ledger = Ledger.__new__(Ledger)
    ledger.kinetic_0, ledger.rows = 1.0, {"numerical_particle": 0.05, "plastic_particle": plastic}
    assert ledger.dissipation_of_plastic == expected
    impact = {"numerical_dissipation": 0.05, "dissipation_of_plastic": ledger.dissipation_of_plastic}
    warnings = [text for limit in LIMITS for text in _above([impact], *limit)]
    assert len(warnings) == (expected is not None)
