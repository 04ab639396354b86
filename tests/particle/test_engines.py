"""Both engines are one particle: in MACHDYN's form our compiled passes give MACHDYN's numbers to rounding."""

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from lattices import HCP, ball
from numba import njit
from scipy.linalg import polar
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_info, threadpool_limits

import coupler
from coupler import Scene, run
from coupler.core.arrays import Ints
from coupler.core.loops import ranges
from coupler.core.threads import Team, threads_of, together
from coupler.errors import SolverError
from coupler.particle import compiled_kernels, packing, start
from coupler.particle.compiled import CompiledParticle
from coupler.particle.enriched import EnrichedParticle
from coupler.particle.machdyn import MachdynParticle
from coupler.particle.model import Step
from coupler.particle.particle import Numerics, Particle
from coupler.physics import constitutive
from coupler.physics.materials import material

D = 25e-6
DT = 1e-11
TURNED = partial(ball, turn=(0.3, -0.5, 0.8))
Sphere = Callable[[float, int], tuple[np.ndarray, float]]
BOTH = (MachdynParticle, CompiledParticle)
# What of the largest value two engines may differ by: rounding, as some 300 explicit steps let it grow
CLOSE = {"x": 1e-13, "v": 1e-11, "eps_p": 1e-12, "T": 1e-12, "J": 1e-12, "p": 1e-10, "sigma_y": 1e-12, "energy": 1e-10}


@pytest.fixture
def pair() -> Iterator[Callable[..., tuple[Particle, Particle]]]:
    """Builds the same particle with both engines: MACHDYN, compiled."""
    alive: list[Particle] = []

    def build(
        name: str = "Ni", points: int = 500, T: float = 300.0, sphere: Sphere = packing.sphere, **numerics: float
    ):
        cloud, volume = sphere(D, points)
        law = constitutive.law_record(material(name), rate_filter=5e-10)
        made = [cls(cloud, volume, law, (0.0, 0.0, 0.0), T, Numerics(**numerics)) for cls in BOTH]
        alive.extend(made)
        return made[0], made[1]

    yield build
    for particle in alive:
        particle.close()


def both(particles: tuple[Particle, Particle], do: Callable[[Particle], object]) -> None:
    for particle in particles:
        do(particle)


def set_velocity(rates: tuple[float, float, float], noise: float = 20.0) -> Callable[[Particle], None]:
    """Velocities that stretch at these rates (1/s), and some that no linear field has (m/s)."""

    def do(p: Particle) -> None:
        p.points.v[:] = p.X * np.array(rates) + noise * np.random.default_rng(5).normal(size=p.X.shape)
        p.points.vest[:] = p.points.v

    return do


def assert_equal(a: Particle, b: Particle, factor: float = 1.0) -> None:
    for name, share in CLOSE.items():
        expected, got = a.get(name), b.get(name)
        scale = D if name == "x" else np.abs(expected).max()
        assert np.abs(got - expected).max() <= factor * share * scale, name
    assert np.abs(a.stress() - b.stress()).max() <= factor * 1e-10 * np.abs(a.stress()).max()
    assert np.abs(a.points.f - b.points.f).max() <= factor * 1e-10 * np.abs(a.points.f).max()
    assert a._strain() == pytest.approx(b._strain(), abs=factor * 1e-11)
    assert a.stable_dt() == pytest.approx(b.stable_dt(), rel=factor * 1e-11)
    one, other = a.totals(), b.totals()
    assert (one.kinetic, one.elastic) == pytest.approx((other.kinetic, other.elastic), rel=factor * 1e-9)
    assert a.internal_work == pytest.approx(b.internal_work, rel=factor * 1e-9)
    assert a.sums[:2] == pytest.approx(b.sums[:2], rel=factor * 1e-10)


@pytest.mark.parametrize("name", ["Ni", "Ti"])
@pytest.mark.parametrize("sphere", [packing.sphere, TURNED, partial(ball, lattice=HCP)], ids=["fcc", "turned", "hcp"])
def test_300_steps_are_the_same(pair: Callable[..., tuple[Particle, Particle]], name: str, sphere: Sphere) -> None:
    particles = pair(name, sphere=sphere)
    both(particles, set_velocity((4e7, 3e7, -7e7)))
    both(particles, lambda p: p.run(300, DT, lambda: None))
    assert particles[0].points.eps_p.max() > 0.15
    assert_equal(*particles)


@pytest.mark.parametrize("numerics", [{"kernel_radius": 0.9}, {"Q1": 0.5, "Q2": 1.0, "hourglass": 10.0}])
def test_other_numbers_of_the_scheme(
    pair: Callable[..., tuple[Particle, Particle]], numerics: dict[str, float]
) -> None:
    particles = pair(**numerics)
    both(particles, set_velocity((4e7, 3e7, -7e7), noise=200.0))
    both(particles, lambda p: p.run(200, DT, lambda: None))
    assert_equal(*particles)


def test_a_stretched_and_rotated_start(pair: Callable[..., tuple[Particle, Particle]]) -> None:
    """2.5 rad about an oblique axis from one step to the next: no rotation of the step before helps to find it."""
    from scipy.spatial.transform import Rotation

    particles = pair()
    turn = Rotation.from_rotvec(2.5 * np.array([1.0, 2.0, -2.0]) / 3.0).as_matrix()
    stretch = np.array([[1.05, 0.02, 0.0], [0.02, 0.97, 0.01], [0.0, 0.01, 0.98]])

    def displace(p: Particle) -> None:
        p.points.x[:] = p.X @ (turn @ stretch).T
        set_velocity((1e7, 0.0, -1e7))(p)

    both(particles, displace)
    both(particles, lambda p: p.run(150, DT, lambda: None))
    assert_equal(*particles)


def test_a_spin_of_many_steps_keeps_the_rotation_exact(pair: Callable[..., tuple[Particle, Particle]]) -> None:
    particles = pair(points=300)

    def spin(p: Particle) -> None:
        p.points.v[:] = np.cross(np.array([0.0, 0.0, 5e6]), p.X)
        p.points.vest[:] = p.points.v

    both(particles, spin)
    both(particles, lambda p: p.run(1000, 2e-11, lambda: None))
    # the hourglass control jumps where its error changes sign, and in a rigid spin that error is rounding
    assert np.abs(particles[0].points.x - particles[1].points.x).max() < 1e-8 * D
    R = particles[1].points.R.reshape(-1, 3, 3)  # type: ignore[attr-defined]
    assert np.abs(np.einsum("nki,nkj->nij", R, R) - np.eye(3)).max() < 1e-12


@pytest.mark.parametrize("engine", [CompiledParticle, EnrichedParticle])
@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.2, 1.0, 3.0])
def test_one_step_finds_the_rotation_of_any_turn(engine: type[CompiledParticle], angle: float) -> None:
    """R of F = R U by scipy's polar decomposition; each point has its own F, the number of points is no multiple of a block."""
    cloud, volume = packing.sphere(20e-6, 300)
    p = engine(cloud[:-3], volume, constitutive.law_record(material("Ni")), (0.0, 0.0, 0.0), 300.0)
    assert p.n % 8 > 0
    stretch = np.array([[1.1, 0.05, 0.0], [0.05, 0.9, 0.02], [0.0, 0.02, 1.0]])
    bent = p.X + 0.02 * p.X**2 / 10e-6
    p.points.x[:] = bent @ stretch @ Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_matrix().T
    together(p._passes.stress_of_all, p.n, p._failed, p._of_stress(Step(p.dt, True)))
    expected = np.array([polar(F)[0].ravel() for F in p.points.F.reshape(-1, 3, 3)])
    assert p.points.R == pytest.approx(expected, abs=1e-13)
    p.close()


def test_heat_between_steps(pair: Callable[..., tuple[Particle, Particle]]) -> None:
    """Heat comes in every ten steps, as from conduction; some points melt, and their hourglass control is the elastic one."""
    particles = pair()
    heat = 2e9 * particles[0].volume_of_point * (particles[0].X[:, 2] > 0.0)
    both(particles, set_velocity((2e7, 2e7, -4e7)))

    def heated(p: Particle) -> None:
        for _ in range(15):
            p.run(10, DT, lambda: None)
            p.warm(heat / 15 * 8)

    both(particles, heated)
    melt = float(particles[0].law["T_m"][0])
    assert particles[0].points.T.max() > melt
    assert (particles[0].points.sigma_y < compiled_kernels.PLASTIC * 1e9).sum() > 20
    assert_equal(*particles, factor=100.0)


def test_preheated_without_effects(pair: Callable[..., tuple[Particle, Particle]]) -> None:
    cloud, volume = packing.sphere(D, 300)
    off = dict.fromkeys(("thermal_expansion", "mie_gruneisen", "rate_hardening", "thermal_softening"), False)
    law = constitutive.law_record(material("OFHC_Cu"), off, rate_filter=5e-10)
    particles = (
        MachdynParticle(cloud, volume, law, (0.0, 0.0, 0.0), 600.0),
        CompiledParticle(cloud, volume, law, (0.0, 0.0, 0.0), 600.0),
    )
    both(particles, set_velocity((4e7, 3e7, -7e7)))
    both(particles, lambda p: p.run(200, DT, lambda: None))
    assert_equal(*particles)
    both(particles, lambda p: p.close())


@pytest.mark.parametrize("rate", [-3e8, 3e8], ids=["crushed", "torn"])
def test_the_same_point_fails_in_the_same_step(pair: Callable[..., tuple[Particle, Particle]], rate: float) -> None:
    """det F beyond 0.2 or 2, one step at a time. MACHDYN then zeroes the stress: without a volume for it our law may speak first."""
    particles = pair(points=300)
    both(particles, set_velocity((rate, rate, rate), noise=0.0))
    said: list[str] = []

    def go(p: Particle) -> None:
        for _ in range(1000):
            p.run(1, DT, lambda: None)

    for p in particles:
        with pytest.raises(SolverError, match=r"volume ratio|not a finite number") as error:
            go(p)
        said.append(str(error.value))
    assert "volume ratio" in said[1]
    assert particles[0].steps == particles[1].steps
    assert rate < 0.0 or said[0] == said[1]


def test_a_restored_particle_goes_on_to_the_last_bit(pair: Callable[..., tuple[Particle, Particle]]) -> None:
    _, first = pair()
    set_velocity((4e7, 3e7, -7e7))(first)
    first.run(100, DT, lambda: None)
    state = first.state()
    first.run(100, DT, lambda: None)
    _, second = pair()
    second.restore(state)
    second.run(100, DT, lambda: None)
    for name in ("x", "v", "eps_p", "T", "p", "f"):
        assert np.array_equal(first.get(name), second.get(name)), name
    assert first.internal_work == second.internal_work


def test_lammps_searches_in_few_enough_bins(
    pair: Callable[..., tuple[Particle, Particle]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The box is twenty diameters wide: fine particles would need more bins than LAMMPS takes. Wider ones find the same neighbours."""
    narrow = pair()[0]
    bins = narrow.spacing * narrow.numerics.kernel_radius  # about the width that LAMMPS chooses
    assert 20.0 * D / bins > 100.0
    monkeypatch.setattr(start, "MOST_BINS", 100)
    wide = pair()[0]
    for p in (narrow, wide):
        set_velocity((4e7, 3e7, -7e7))(p)
        p.run(50, DT, lambda: None)
    for name, part in CLOSE.items():
        one, other = narrow.get(name), wide.get(name)
        order = np.argsort(narrow.ids), np.argsort(wide.ids)
        np.testing.assert_allclose(one[order[0]], other[order[1]], rtol=0, atol=part * np.abs(one).max(), err_msg=name)


@pytest.mark.parametrize("engine", BOTH)
def test_only_machdyn_needs_lammps_to_list_neighbours(engine: type[Particle], tmp_path: Path) -> None:
    """The box has millions of bins for the neighbours of a few thousand points: time and memory that the other engines save."""
    cloud, volume = packing.sphere(D, 100)
    law, log = constitutive.law_record(material("Ni")), tmp_path / "log.lammps"
    engine(cloud, volume, law, (0.0, 0.0, 0.0), 300.0, Numerics(), log=log).close()
    assert ("Neighbor list info" in log.read_text()) == (engine is MachdynParticle)


def test_what_lammps_refuses_is_an_error_of_the_solver(
    pair: Callable[..., tuple[Particle, Particle]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(start, "_deck", lambda name: "no_such_command 1")
    with pytest.raises(SolverError, match=r"cannot create this particle .*no_such_command.* fewer points"):
        pair()


@pytest.mark.usefixtures("eight_cores")
@pytest.mark.parametrize("threads", [2, 3, 8])  # also more than there are cores
def test_threads_give_the_same_bits(pair: Callable[..., tuple[Particle, Particle]], threads: int) -> None:
    """Any split of points and pairs over threads gives the same forces, whoever computes which part."""
    (_, alone), (_, shared) = pair(), pair()
    for p, count in ((alone, 1), (shared, threads)):
        set_velocity((4e7, 3e7, -7e7))(p)
        with threads_of(count):
            p.run(100, DT, lambda: None)
    for name in ("x", "v", "eps_p", "T", "p", "f", "sums"):
        assert np.array_equal(alone.get(name), shared.get(name)), name


def test_blas_has_one_thread_in_a_run() -> None:
    """Long products would be added up in another order, and wait for the cores of other threads."""

    def counts() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    with threadpool_limits(2, "blas"):
        before = counts()
        with threads_of(1):
            assert set(counts()) == {1}
        assert counts() == before


def test_shared_work_is_done_once_and_its_error_comes_out() -> None:
    team = Team(3)
    blocked = Event()
    done: list[int] = []
    team.join(lambda counters: blocked.wait(10))[0] = 1
    team.share(done.append, 5)  # the other threads are busy: this one does all parts
    assert done == [0, 1, 2, 3, 4]
    blocked.set()
    team.share(done.append, 5)
    assert sorted(done[5:]) == [0, 1, 2, 3, 4]

    def fail(part: int) -> None:
        if part == 3:
            raise SolverError("part 3")

    with pytest.raises(SolverError, match="part 3"):
        team.share(fail, 5)
    team.close()


@njit(cache=True, nogil=True)
def _count(team: Ints, fails_at: int, seen: Ints) -> None:
    """Two loops over the elements of seen; fails at this one in the second."""
    for lo, hi, _ in ranges(team, 0, len(seen), 1):
        seen[lo:hi] += 1
    for lo, hi, _ in ranges(team, 1, len(seen), 1):
        for i in range(lo, hi):
            if i == fails_at:
                raise ValueError("no second time")
            seen[i] *= 10


def test_functions_of_all_threads_release_the_lock_of_python() -> None:
    """One that keeps it while it waits for another thread waits for ever where that fails: the other needs it to say so."""
    heads = []
    for path in sorted(Path(coupler.__file__).parent.rglob("*.py")):
        heads += re.findall(r"@njit(.*)\ndef \w+\(\s*team: Ints", path.read_text())
    assert len(heads) >= 12
    assert all("nogil=True" in head for head in heads)


@pytest.mark.usefixtures("eight_cores")
@pytest.mark.parametrize("threads", [1, 2, 8])
def test_compiled_loops_are_gone_through_once_and_end_with_an_error(threads: int) -> None:
    """The second loop begins when the first is done; where one thread fails the others do not wait for it."""
    with threads_of(threads):
        for _ in range(100):
            seen = np.zeros(37, np.int64)
            together(_count, -1, seen)
            assert (seen == 10).all()
            with pytest.raises(ValueError, match="second time"):
                together(_count, 20, seen)


@pytest.mark.parametrize("metal", ["Ni", pytest.param("Ti", marks=pytest.mark.slow)])
def test_a_whole_impact_has_the_same_summary(tmp_path: Path, metal: str) -> None:
    """To what rounding becomes in it, past the greatest deformation: a velocity larger by 2e-13 moves MACHDYN's own flattening of Ti
    by 5e-6."""
    scene = f"""
        effects = ["auto", "-dissipation_heat"]
        [particle]
        material = "{metal}"
        diameter = "25 um"
        velocity = "500 m/s"
        [substrate]
        material = "SS304"
        diameter = "120 um"
        height = "60 um"
        [resolution]
        spacing = "3 um"
        element_size = "4.5 um"
        engine = "%s"
        [end]
        time = "30 ns"
        [output]
        every = "10 ns"
    """
    a, b = (run(Scene.from_text(scene % engine, "one"), tmp_path / engine).values for engine in ("machdyn", "compiled"))
    assert (a["engine"], b["engine"]) == ("machdyn", "compiled")
    assert a["steps"] == b["steps"]
    for name in (
        "flattening_ratio",
        "flattening_ratio_total",
        "crater_depth_m",
        "splat_diameter_m",
        "eps_p_mean",
        "T_mean_K",
    ):
        assert b[name] == pytest.approx(a[name], rel=2e-5), name
    parts = {f"{name}_particle" for name in ("viscosity", "hourglass", "unexplained")}
    for name, share in a["energies"].items():
        if name in parts:  # MACHDYN does not tell them apart
            continue
        assert b["energies"][name] == pytest.approx(share, abs=3e-6), name
