"""The particle on its own, with either engine: driven step by step with our law in it."""

import numpy as np
import pytest

from coupler.errors import SolverError
from coupler.particle import packing
from coupler.particle.engine import ENGINES
from coupler.particle.particle import Numerics, Particle
from coupler.physics import constitutive
from coupler.physics.materials import material

D = 25e-6


def particle(
    engine: str, points: int = 300, velocity=(0.0, 0.0, 0.0), name: str = "Ni", T: float = 300.0, **numerics: float
) -> Particle:
    cloud, volume = packing.sphere(D, points)
    law = constitutive.law_record(material(name), rate_filter=5e-10)
    return ENGINES[engine](cloud, volume, law, velocity, T, numerics=Numerics(**numerics) if numerics else None)


@pytest.fixture(params=ENGINES)
def engine(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_free_flight_is_free(engine: str) -> None:
    p = particle(engine, velocity=(3.0, -2.0, 500.0))
    start, kinetic = p.points.x.copy(), p.totals().kinetic
    p.run(200, 2e-11, lambda: None)
    assert np.abs(p.points.x - start - np.array([3.0, -2.0, 500.0]) * 4e-9).max() < 1e-9 * D
    assert p.totals().kinetic == pytest.approx(kinetic, rel=1e-12)
    assert p.mass.sum() == pytest.approx(8906 * np.pi / 6 * D**3)
    assert p.points.eps_p.max() == 0.0
    p.close()


def test_rotation_keeps_momentum_energy_and_shape(engine: str) -> None:
    p = particle(engine)
    spin = np.array([0.0, 0.0, 2e6])  # 25 m/s at the rim
    p.points.v[:] = np.cross(spin, p.X)
    p.points.vest[:] = p.points.v
    L0 = np.cross(p.points.x, p.mass[:, None] * p.points.v).sum(0)
    e0 = p.totals().kinetic
    steps = 1000
    p.run(steps, 2e-11, lambda: None)
    L1 = np.cross(p.points.x, p.mass[:, None] * p.points.v).sum(0)
    assert np.abs(L1 - L0).max() < 1e-6 * np.abs(L0).max()
    assert p.totals().kinetic + p.totals().elastic == pytest.approx(e0, rel=1e-3)
    r0, r1 = np.linalg.norm(p.X, axis=1), np.linalg.norm(p.points.x - p.points.x.mean(0), axis=1)
    assert np.abs(r1 - r0).max() < 1e-3 * D
    # an interior point has gone round by the angle
    i = np.argmax(r0 * (np.abs(p.X[:, 2]) < 0.1 * D))
    angle = np.arctan2(p.points.x[i, 1], p.points.x[i, 0]) - np.arctan2(p.X[i, 1], p.X[i, 0])
    assert angle % (2 * np.pi) == pytest.approx(2e6 * steps * 2e-11, abs=7e-4)
    p.close()


def test_the_law_in_lammps_is_the_law_of_the_target(engine: str) -> None:
    """Squeeze the whole particle: what each point did is replayed through the functions the FE kernel calls."""
    p = particle(engine, points=300)
    m, law, dt = material("Ni"), p.law[0], 1e-11
    path = []

    def watch() -> None:
        path.append(
            (
                p.points.eps_p[7],
                p.points.rate[7],
                p.points.T[7],
                p.points.sigma_y[7],
                p.points.J[7],
                p.points.p[7],
                p.points.energy[7],
            )
        )

    p.points.v[:] = p.X * np.array([4e7, 4e7, -8e7])  # isochoric to first order, 1e8 1/s
    p.points.vest[:] = p.points.v
    p.run(150, dt, watch)
    eps_p, rate, T, sy, J, pr, e = 0.0, 0.0, 300.0, m.strength["A"], 1.0, 0.0, 0.0
    assert path[-1][0] > 0.05
    for eps_now, *rest in path:
        deps = max(eps_now - eps_p, 0.0)
        eps_p, rate, T, sy, work = constitutive.harden(law, deps, dt, rest[3], sy, sy, eps_p, rate, T)
        pr, e = constitutive.mie_gruneisen(law, J, rest[3], pr, e, law["taylor_quinney"] * work)
        J = rest[3]
        got, want = np.array([eps_now, *rest]), np.array([eps_p, rate, T, sy, J, pr, e])
        assert np.abs(got - want).max() <= 1e-10 * np.abs(want).max()
        assert got == pytest.approx(want, rel=1e-10)
    p.close()


def test_pressure_in_lammps_is_our_mie_gruneisen(engine: str) -> None:
    """MACHDYN's own equation of state lets heat pull; with the energy prescribed its mean stress is minus our pressure."""
    p = particle(engine, points=1000)
    p.points.v[:] = -4e7 * p.X
    p.points.vest[:] = p.points.v
    p.run(150, 1e-11, lambda: None)
    inner = np.linalg.norm(p.X, axis=1) < 0.3 * D
    mean = p.points.smd_stress[:, [0, 3, 5]].mean(axis=1)
    assert p.points.p[inner].min() > 5e9
    assert -mean[inner] == pytest.approx(p.points.p[inner], rel=5e-3)  # it lags by one step
    p.close()


def test_preheating_softens_without_pressing(engine: str) -> None:
    p = particle(engine, T=600.0)
    assert p.points.T == pytest.approx(600.0)
    assert p.points.sigma_y[0] == pytest.approx(constitutive.yield_stress(p.law[0], 0.0, 0.0, 600.0))
    p.run(20, 2e-11, lambda: None)
    assert np.abs(p.stress()).max() < 1e3
    p.close()


def test_what_the_callback_raises_comes_out(engine: str) -> None:
    p = particle(engine)

    def fail() -> None:
        raise SolverError("told so")

    with pytest.raises(SolverError, match="told so"):
        p.run(50, 1e-11, fail)
    assert p.steps == 1
    p.close()


def test_a_step_too_long_is_reported_with_place_and_time(engine: str) -> None:
    p = particle(engine, points=300)
    p.points.v[:] = p.X * np.array([1e8, 1e8, -3e8])
    p.points.vest[:] = p.points.v

    def go() -> None:
        for _ in range(200):
            p.run(10, 2e-9, lambda: None)
            p.stable_dt()

    with pytest.raises(SolverError, match=r"failed at t = .* ns"):
        go()
    p.close()
