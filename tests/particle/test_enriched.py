"""The enriched scheme: closed forms and conservation; what F does not see costs energy, and flows with the rest."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest
from conftest import elastic
from lattices import BCC, HCP, ball

from coupler.particle import packing
from coupler.particle.enriched import EnrichedParticle
from coupler.particle.particle import Numerics
from coupler.physics import constitutive as law
from coupler.physics.materials import material

D = 25e-6
E, NU = 200e9, 0.3
Build = Callable[..., EnrichedParticle]


@pytest.fixture
def made() -> Iterator[Build]:
    """Builds a particle of a cloud (n,3) m and a volume of each point, m3."""
    alive: list[EnrichedParticle] = []

    def build(cloud: np.ndarray, volume: float, metal: object = None, **numerics: float) -> EnrichedParticle:
        record = law.law_record(metal or elastic(E=E, nu=NU), rate_filter=5e-10)  # type: ignore[arg-type]
        alive.append(EnrichedParticle(cloud, volume, record, (0.0, 0.0, 0.0), 300.0, Numerics(**numerics)))
        return alive[-1]

    yield build
    for particle in alive:
        particle.close()


def move(p: EnrichedParticle, velocity: np.ndarray) -> None:
    p.points.v[:] = velocity
    p.points.vest[:] = velocity


def place(p: EnrichedParticle, A: np.ndarray) -> None:
    """Put the points where the gradient A (3,3) takes them, without strain on the way."""
    p.points.x[:] = p.X @ A.T
    p.points.F[:] = A.ravel()


def strip(layers: int, slender: float) -> tuple[np.ndarray, float, np.ndarray]:
    """A face-centred cubic strip of so many layers, `slender` times as long as thick: points, volume of each, and its size (3,) m."""
    half = 0.5 * 4.0 ** (1 / 3) * 1e-6  # edge of half a cell of points 1 um apart
    count = np.array([round(slender * layers), layers, layers])
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), axis=-1).reshape(-1, 3)
    cloud = half * (grid[grid.sum(axis=1) % 2 == 0] + 0.5)
    return cloud, float(np.prod(half * count)) / len(cloud), half * count


def test_a_plate_of_five_layers_vibrates_as_a_beam(made: Build) -> None:
    """First bending mode of a free beam with shear and rotary inertia (ASTM E1876, t/L = 1/20): within 3 %."""
    cloud, volume, (length, width, thick) = strip(5, 20.0)
    p = made(cloud, volume, Q1=0.0)
    k, s, xi = 4.730041, 0.982502, p.X[:, 0] / length
    sag = np.cosh(k * xi) + np.cos(k * xi) - s * (np.sinh(k * xi) + np.sin(k * xi))
    slope = k / length * (np.sinh(k * xi) - np.sin(k * xi) - s * (np.cosh(k * xi) + np.cos(k * xi)))
    mode = np.stack([-(p.X[:, 2] - 0.5 * thick) * slope, 0.0 * xi, sag], axis=1)
    move(p, 1e-3 * mode)
    dt, before, now = 0.35 * p.spacing / p.wave_speed, 1.0, 1.0
    while now > 0.0:  # to the turning point, after a quarter of the period
        p.run(10, dt, lambda: None)
        before, now = now, float(np.sum(mode * p.points.v))
    quarter = p.time - 10 * dt * now / (now - before)
    t = thick / length
    T1 = 1.0 + 6.585 * (1.0 + 0.0752 * NU + 0.8109 * NU**2) * t**2 - 0.868 * t**4
    beam = np.sqrt(E * width / p.mass.sum() * t**3 / 0.9465 / T1)
    assert 0.25 / quarter == pytest.approx(beam, rel=0.03)


@pytest.mark.parametrize("sphere", [
    ball, partial(ball, lattice=HCP), partial(ball, lattice=BCC), partial(ball, turn=(0.3, -0.5, 0.8))
], ids=["fcc", "hcp", "bcc", "turned"])  # fmt: skip
def test_a_linear_field_is_exact(made: Build, sphere: Callable[[float, int], tuple[np.ndarray, float]]) -> None:
    """Patch test: F at every point, at the rim too, no residuals, no force on points inside."""
    p = made(*sphere(D, 500))
    A = np.array([[1.01, 0.004, 0.0], [-0.002, 0.99, 0.003], [0.001, 0.0, 1.002]])
    place(p, A)
    p.run(1, 1e-18, lambda: None)
    assert np.abs(p.points.F.reshape(-1, 3, 3) - A).max() < 1e-10
    assert p.points.unseen.max() < 1e-12 * E
    inside = np.linalg.norm(p.X, axis=1) < 0.5 * D - 3.5 * p.spacing
    assert inside.sum() > 5
    assert np.abs(p.points.f[inside]).max() < 1e-9 * np.abs(p.points.f).max()


def test_viscosity_is_all_that_an_elastic_body_loses(made: Build) -> None:
    """A ball that swings freely, long waves and short: kinetic and elastic energy go into the viscosity's line, to 1e-3 of it."""
    p = made(*packing.sphere(D, 400))
    move(p, p.X * np.array([4e5, 3e5, -6e5]) + 2.0 * np.random.default_rng(3).normal(size=p.X.shape))
    start = p.totals().kinetic + p.totals().elastic
    p.run(1500, 5e-12, lambda: None)
    lost = start - p.totals().kinetic - p.totals().elastic
    assert lost > 0.1 * start
    assert p.sums[2] == pytest.approx(lost, rel=1e-3)
    assert p.sums[3] == 0.0


def test_momentum_and_energy_of_a_violent_spin(made: Build) -> None:
    """Angular momentum to rounding while plastic strain grows to 0.4; energy to 0.2 %."""
    p = made(*packing.sphere(D, 400), material("Ni"), Q1=0.0)
    noise = 20.0 * np.random.default_rng(3).normal(size=p.X.shape)
    move(p, p.X * np.array([4e7, 3e7, -6e7]) + np.cross([0.0, 0.0, 1e7], p.X) + noise)

    def spin() -> np.ndarray:
        return np.cross(p.points.x, p.mass[:, None] * p.points.v).sum(axis=0)

    L, linear, start = spin(), p.totals().momentum, p.totals().kinetic
    p.run(400, 2e-11, lambda: None)
    assert p.points.eps_p.mean() > 0.3
    assert np.abs(spin() - L).max() < 1e-12 * np.abs(L).max()
    assert np.abs(p.totals().momentum - linear).max() < 1e-12 * p.mass.sum() * 100.0
    assert p.totals().kinetic + p.totals().elastic + p.sums[0] == pytest.approx(start, rel=2e-3)


def test_a_free_spin_goes_on_as_it_is(made: Build) -> None:
    """2e7 1/s for 3 us, 250 m/s at the equator: no growth, no energy from nowhere.

    It first swings by 2 % across its axis, until viscosity has damped that. An error of (omega dt)^2 / 2 in the plane of spin, of
    the strain of a step, adds 10 % to the axis. Tolerance: what is left of the swing.
    """
    p = made(*packing.sphere(D, 60))
    move(p, np.cross([0.0, 0.0, 2e7], p.X))
    start, sizes, dt = p.totals().kinetic, [], 0.3 * p.spacing / p.wave_speed
    for time in (0.5e-6, 3e-6):
        p.run(round((time - p.time) / dt), dt, lambda: None)
        arm = p.points.x - p.points.x.mean(axis=0)
        sizes.append((np.ptp(arm[:, 2]), np.hypot(*arm[:, :2].T).max()))
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-3)
    stored = p.totals().kinetic + p.totals().elastic
    assert stored + p.sums[2] == pytest.approx(start, rel=1e-4)
    assert p.internal_work - p.totals().elastic == pytest.approx(p.sums[2], abs=1e-4 * start)


def stiffness(p: EnrichedParticle) -> np.ndarray:
    """Stiffness (3n,3n) N/m of a particle as it is, from the forces of each unit velocity in one step."""
    here, dt = p.state(), 1e-14
    rows = []
    for k in range(3 * p.n):
        p.restore(here)
        velocity = np.zeros(3 * p.n)
        velocity[k] = 10.0
        move(p, velocity.reshape(-1, 3))
        p.run(1, dt, lambda: None)
        rows.append(p.points.f.ravel() / (10.0 * dt))
    p.restore(here)
    K = -np.array(rows)
    assert np.abs(K - K.T).max() < 1e-4 * np.abs(K).max()
    return 0.5 * (K + K.T)


def test_only_rigid_motions_cost_nothing(made: Build) -> None:
    """Six zero frequencies, and none near."""
    lowest = np.linalg.eigvalsh(stiffness(made(*packing.sphere(D, 60), Q1=0.0)))
    assert np.abs(lowest[:6]).max() < 1e-5 * lowest[-1]
    assert lowest[6] > 0.01 * lowest[-1]


def test_the_step_follows_from_the_highest_frequency(made: Build) -> None:
    """Power iteration against the eigenvalues of the forces: as it is built, and flattened to half its height at equal volume."""
    p = made(*packing.sphere(D, 60), Q1=0.0)
    flat = np.diag([2.0**0.5, 2.0**0.5, 0.5])
    for A, near in ((np.eye(3), 0.01), (flat, 0.02), (flat[:, [2, 0, 1]], 0.02)):
        place(p, A)
        move(p, np.zeros_like(p.points.x))
        p.run(1, 1e-18, lambda: None)
        exact = 2.0 / np.sqrt(np.linalg.eigvalsh(stiffness(p))[-1] / p.mass[0])
        for _ in range(10):  # later calls start from the last vector
            limit = p.stable_dt() / p.numerics.frequency
        assert limit == pytest.approx(exact, rel=near)


def test_a_body_steps_at_its_limit_and_not_beyond(made: Build) -> None:
    """Free vibration: bounded just below the limit, growing without bound just above it."""
    for share, steps, bounded in ((0.99, 100, True), (1.1, 15, False)):
        p = made(*packing.sphere(D, 60), Q1=0.0)
        move(p, 1e-3 * np.random.default_rng(3).normal(size=p.X.shape))
        start, dt = np.abs(p.points.v).max(), share * p.stable_dt() / p.numerics.frequency
        p.run(steps, dt, lambda: None)
        assert (np.abs(p.points.v).max() < 3.0 * start) == bounded


def crushed(made: Build, inertia: float) -> EnrichedParticle:
    """A small sphere, pressed to 0.16 of its height at equal volume; inertia: as in `Numerics`."""
    p = made(*packing.sphere(D, 60), Q1=0.0, inertia=inertia)
    place(p, np.diag([2.5, 2.5, 0.16]))
    move(p, np.zeros_like(p.points.x))
    p.run(1, 1e-18, lambda: None)
    return p


def test_crushed_cells_with_inertia_bear_a_longer_step(made: Build) -> None:
    """Free vibration: bounded just below the limit, growing without bound just above it, as without inertia."""
    for _ in range(10):
        bare = crushed(made, 0.0).stable_dt()
    for share, steps, bounded in ((0.99, 100, True), (1.1, 15, False)):
        p = crushed(made, 0.25)
        move(p, p.points.v + 1e-3 * np.random.default_rng(3).normal(size=p.X.shape))
        for _ in range(10):
            dt = p.stable_dt()
        assert dt > 1.4 * bare
        start = np.abs(p.points.v).max()
        p.run(steps, share * dt / p.numerics.frequency, lambda: None)
        assert (np.abs(p.points.v).max() < 3.0 * start) == bounded


def test_added_inertia_is_none_of_rigid_motions(made: Build) -> None:
    """Forces that accelerate and spin the body as a whole stay as they are; others keep their sum and their moment."""
    p = crushed(made, 0.25)
    p.stable_dt()
    arm = p.points.x - p.points.x.mean(axis=0)
    rigid = p.mass[:, None] * (np.array([3.0, -1.0, 2.0]) + np.cross([2.0, 1.0, -3.0], arm) / D)
    f = rigid.copy()
    p._inertia.slow(f)
    assert f == pytest.approx(rigid, abs=1e-9 * np.abs(rigid).max())
    pushed = np.random.default_rng(2).normal(size=f.shape)
    f = pushed.copy()
    p._inertia.slow(f)
    assert np.abs(f - pushed).max() > 0.1
    assert f.sum(axis=0) == pytest.approx(pushed.sum(axis=0), abs=1e-9)
    assert np.cross(arm, f).sum(axis=0) == pytest.approx(np.cross(arm, pushed).sum(axis=0), abs=1e-9 * D)


def test_added_inertia_slows_the_rate_of_volume_alone(made: Build) -> None:
    """(m + sum c b b^T) a = f, by a dense solver."""
    p = crushed(made, 0.25)
    p.stable_dt()
    B = p._inertia._B.toarray()
    c = p._inertia._inertia[p._inertia._inertia > 0.0]
    order = np.argsort(p.ids[p._inertia._inertia > 0.0])
    M = p.mass[0] * np.eye(3 * p.n) + B.T @ (c[order, None] * B)
    f = np.random.default_rng(4).normal(size=(p.n, 3))
    whole = np.zeros_like(f)
    whole[p.ids] = f
    exact = (p.mass[0] * np.linalg.solve(M, whole.ravel())).reshape(-1, 3)[p.ids]
    p._inertia.slow(f)
    assert f == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("inertia", [0.0, 0.8])
def test_a_restored_particle_goes_on_to_the_last_bit(made: Build, inertia: float) -> None:
    first, second = (made(*packing.sphere(D, 300), material("Ni"), inertia=inertia) for _ in range(2))
    move(first, first.X * np.array([4e7, 3e7, -7e7]) + 20.0 * np.random.default_rng(5).normal(size=first.X.shape))
    first.run(50, 1e-11, lambda: None)
    first.stable_dt()
    assert (first._inertia.cells > 0) == (inertia > 0.0)
    state, elastic_energy = first.state(), first.totals().elastic
    first.run(50, 1e-11, lambda: None)
    second.restore(state)
    assert second.totals().elastic == elastic_energy
    second.run(50, 1e-11, lambda: None)
    for name in ("x", "v", "eps_p", "T", "p", "f", "unseen"):
        assert np.array_equal(first.get(name), second.get(name)), name
