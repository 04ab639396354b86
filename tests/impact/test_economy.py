"""What keeps the cost of many impacts down: masses of small elements, and a window round the impact."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scenes
from blocks import pinched
from conftest import elastic
from runs import SharedRuns

from coupler import Scene, run
from coupler.core.records import copied
from coupler.errors import SceneError
from coupler.fe import mesh
from coupler.fe.boundary import nodes_of
from coupler.fe.explicit import Target
from coupler.fe.inertia import step_for
from coupler.geometry import mesher
from coupler.geometry.triangles import vertex_areas
from coupler.physics.constitutive import law_record, sound_speed
from coupler.plan.planning import plan

# ---- masses ------------------------------------------------------------------------------------------------------


def test_the_step_that_a_mass_buys() -> None:
    """Two light elements and a heavy one: T^2 sum m / t^2 - sum m = added, by hand."""
    mass, safe = np.array([3.0, 1.0, 2.0]), np.array([9.0, 1.0, 2.0])
    assert step_for(mass, safe, 3.0, 100.0) == pytest.approx(2.0)  # the first alone: 1 (2^2 - 1)
    assert step_for(mass, safe, 1.25, 100.0) == pytest.approx(1.5)
    assert step_for(mass, safe, 10.5, 100.0) == pytest.approx(3.0)  # 1 (9 - 1) + 2 (9/4 - 1)
    assert step_for(mass, safe, 1e6, 2.5) == 2.5  # no more than is of use
    assert step_for(mass, safe, 0.0, 100.0) == pytest.approx(1.0)


@pytest.fixture
def inviscid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Targets without bulk viscosity."""
    for name in ("LINEAR_VISCOSITY", "QUADRATIC_VISCOSITY"):
        monkeypatch.setattr(f"coupler.fe.explicit.{name}", 0.0)


def flattened() -> Target:
    """A block with an element pressed flat inside."""
    flat = pinched(mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.2)), 0.9)
    t = Target(flat, law_record(elastic()), 300.0, fixed=(), track_wave=False)
    return t


@pytest.mark.usefixtures("inviscid")
def test_scaled_elements_take_a_longer_step_with_the_masses_that_they_have() -> None:
    t = flattened()
    whole, step = t.mass.copy(), t.stable_dt()
    t.inertia.most = 0.01 * whole.sum()
    assert t.stable_dt(0.1 * step) == step  # as long as is sought: none is scaled
    assert len(t.inertia.elements) == 0
    longer = t.stable_dt(10.0 * step)
    assert longer > 3 * step
    assert 0 < len(t.inertia.elements) < 0.1 * len(t.mesh.conn)
    chosen = t.inertia.elements
    added = (t.laws["rho"][t.law_of] * t.mesh.V0)[chosen] @ (t.inertia.factor - 1.0)
    assert added == pytest.approx(t.inertia.most, rel=1e-9)
    assert t.dt_of.min() == pytest.approx(t.dt_of[chosen].min())
    np.testing.assert_array_equal(t.mass, whole)


def test_an_element_alone_bears_the_step_that_it_is_scaled_to() -> None:
    """The highest frequency of a tetrahedron by its eigenvalues: 2 / T where it was 2 / t."""
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.1]])
    t = Target(mesh.prepare(points, np.array([[0, 1, 2, 3]])), law_record(elastic()), 300.0, fixed=(), track_wave=False)
    springs = np.eye(4) - 0.25  # a stiffness of which all motion but a translation is of one frequency
    own = t.stable_dt()
    t.inertia.most = 24.0 * t.mass.sum()
    t.inertia.choose(t, safe := np.array([own]), 100.0 * own)
    assert safe[0] == pytest.approx(5.0 * own)

    def frequency() -> float:
        columns = []
        for i in range(4):
            f = np.repeat(springs[:, i : i + 1], 3, axis=1)
            t.inertia.slow(f)
            columns.append(f[:, 0] / t.mass)
        return float(np.sqrt(np.linalg.eigvals(np.array(columns).T).real.max()))

    slow = frequency()
    t.inertia.most = 0.0
    t.inertia.choose(t, safe, 1.0)
    assert frequency() / slow == pytest.approx(5.0)


@pytest.mark.usefixtures("inviscid")
def test_a_translation_of_scaled_elements_needs_no_more_force() -> None:
    t = flattened()
    t.inertia.most = 0.01 * t.mass.sum()
    t.stable_dt(1.0)
    along = np.array([1.0, -2.0, 0.5])
    f = t.mass[:, None] * along
    t.inertia.slow(f)
    np.testing.assert_allclose(f / t.mass[:, None], np.tile(along, (len(f), 1)), rtol=1e-9)
    assert t.inertia.twice_kinetic(np.tile(along, (len(f), 1))) == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize("fixed", [(), ("bottom",)])
@pytest.mark.usefixtures("inviscid")
def test_the_longer_step_is_stable_and_the_ledger_closes(fixed: tuple[str, ...]) -> None:
    """Energy and momentum with elements that are chosen anew as they move; what their inertia holds is numerical dissipation."""
    t = flattened()
    t.fixed = nodes_of(t.mesh, fixed)
    t.inv_mass[t.fixed] = 0.0
    t.inertia.most = 0.01 * t.mass.sum()
    rng = np.random.default_rng(2)
    t.nodes.v[:] = 0.01 * rng.standard_normal(t.nodes.v.shape)
    t.nodes.v[:] -= (t.mass @ t.nodes.v) / t.mass.sum()
    t.nodes.v[t.fixed] = 0.0
    start, momentum = t.kinetic(), t.momentum()
    taken = []
    for _ in range(400):
        t.advance(t.stable_dt(1.0))
        t.finish()
        taken.append(t.balance.numerical)
    assert np.abs(taken).max() > 5e-3 * start
    assert t.kinetic() + t.elastic() + t.balance.numerical == pytest.approx(start, rel=3e-3)
    assert np.abs(t.momentum() - t.external_impulse() - momentum).max() < 1e-10 * t.mass.sum() * 0.01


@pytest.mark.usefixtures("inviscid")
def test_scaling_goes_on_from_its_state() -> None:
    """The step after a restart: what the inertia took in the step before enters the ledger of the next."""
    t, again = flattened(), flattened()
    t.inertia.most = 0.01 * t.mass.sum()
    t.nodes.v[:] = 0.01 * np.random.default_rng(2).standard_normal(t.nodes.v.shape)
    for _ in range(3):
        t.advance(t.stable_dt(1.0))
        t.finish()
    again.restore(copied(t))
    for each in (t, again):
        each.advance(each.stable_dt(1.0))
        each.finish()
    np.testing.assert_array_equal(again.nodes.x, t.nodes.x)
    np.testing.assert_equal(vars(again.balance), vars(t.balance))
    assert t.balance.numerical != 0.0


@pytest.mark.usefixtures("inviscid")
def test_the_surface_is_heavier_until_the_bodies_rest_again() -> None:
    t, again = flattened(), flattened()
    true, surface = t.mass.copy(), np.unique(t.mesh.facets)
    least = float(np.median(true[surface]))
    some = t.weigh_surface(np.inf, 1e-3 * true.sum())  # as far as the mass that may be added allows
    assert some == pytest.approx(1e-3 * true.sum())
    assert t.mass[surface].min() == pytest.approx(t.least_mass)
    added = t.weigh_surface(least, np.inf)  # reckoned from the true masses each time
    assert t.mass[surface].min() == least
    np.testing.assert_array_equal(np.delete(t.mass, surface), np.delete(true, surface))
    assert added == pytest.approx(np.maximum(least - true[surface], 0.0).sum())
    again.restore(copied(t))
    np.testing.assert_array_equal(again.mass, t.mass)
    np.testing.assert_array_equal(again.inv_mass, 1.0 / t.mass)
    t.rest()
    np.testing.assert_array_equal(t.mass, true)


# ---- the window --------------------------------------------------------------------------------------------------


MIDDLE = np.zeros(3)  # of the top: from there an elastic edge is reckoned


@cache
def struck(elastic_edge: bool = False) -> tuple[Target, float]:
    """A cylinder struck at the middle of its top, after waves have gone out to the edge of its window and back twice; its energy then.
    It is made once for the tests that look at it."""
    m = mesh.prepare(*mesher.cylinder(12.0, 6.0, 0.25, 2.5, 0.4))
    mat = elastic()
    t = Target(m, law_record(mat), 300.0, fixed=())
    t.set_window(2.5, MIDDLE if elastic_edge else None)
    r = np.linalg.norm(t.nodes.x, axis=1)
    t.nodes.v[:, 2] = blow(r)
    start = t.kinetic()
    end = 8.0 / sound_speed(mat.rho, mat.K, mat.G)
    while t.time < end:
        t.advance(min(t.stable_dt(), end - t.time + 1e-12))
        t.finish()
    return t, start


def blow(r: np.ndarray) -> np.ndarray:
    """Velocities (m/s) down into the target at a distance r from the middle."""
    return -np.where(r < 1.0, np.cos(0.5 * np.pi * r) ** 2, 0.0)


def test_an_elastic_edge_lets_waves_out_and_closes_the_ledger() -> None:
    """In an impact; a fixed edge sends all of them back."""
    (t, start), (fixed, _) = struck(elastic_edge=True), struck()
    assert t.active_elements < 0.7 * len(t.mesh.conn)
    beyond = t.mesh.reach_node > 3.5
    assert not np.abs(t.nodes.x - t.mesh.points)[beyond].any()
    left, kept = ((q.kinetic() + q.elastic()) / start for q in (t, fixed))
    assert left < 0.3 * kept
    assert left + (t.balance.absorbed + t.balance.numerical) / start == pytest.approx(1.0, abs=5e-3)


@pytest.mark.parametrize(
    ("origin", "end", "within"), [(MIDDLE, 28.0, (0.92, 1.04)), (None, 12.0, (0.6, 0.85))], ids=["elastic", "fixed"]
)
def test_a_dead_load_sinks_as_far_as_on_a_half_space(
    origin: np.ndarray | None, end: float, within: tuple[float, float]
) -> None:
    """Pressure p cos^2(pi r / 2) within r = 1: Boussinesq's point loads add up to w = (1 - nu^2) p / E in the middle. A fixed edge at
    r = 2.5 takes a fifth of that away, and has done so at 10 / c; an elastic one creeps to 0.97 of it, 0.956 at 28 / c."""
    m = mesh.prepare(*mesher.cylinder(12.0, 6.0, 0.25, 2.5, 0.4))
    mat, p = elastic(), 1e5
    t = Target(m, law_record(mat), 300.0, fixed=(), track_wave=False)
    t.set_window(2.5, origin)
    top = m.facets[m.sets["top"]]
    r = np.linalg.norm(t.nodes.x[:, :2], axis=1)
    load = np.zeros_like(t.nodes.x)
    load[:, 2] = -p * vertex_areas(t.nodes.x, top) * np.where(r < 1.0, np.cos(0.5 * np.pi * r) ** 2, 0.0)
    c = sound_speed(mat.rho, mat.K, mat.G)
    while t.time < end / c:
        t.nodes.v[:] *= 0.97
        t.advance(t.stable_dt())
        t.f_ext += load
        t.finish()
    E, nu = 9.0 * mat.K * mat.G / (3.0 * mat.K + mat.G), (3.0 * mat.K - 2.0 * mat.G) / (6.0 * mat.K + 2.0 * mat.G)
    middle = (t.nodes.x - m.points)[(r < 0.15) & (m.points[:, 2] > -1e-9), 2].mean()
    assert within[0] < -middle * E / ((1.0 - nu**2) * p) < within[1]


@pytest.mark.parametrize("elastic_edge", [False, True], ids=["fixed", "elastic"])
def test_momentum_is_that_of_the_edge(elastic_edge: bool) -> None:
    t, _ = struck(elastic_edge=elastic_edge)
    fresh = Target(t.mesh, t.laws, 300.0, fixed=())
    r = np.linalg.norm(t.mesh.points, axis=1)
    given = fresh.mass @ np.stack([0 * r, 0 * r, blow(r)], axis=1)
    np.testing.assert_allclose(t.momentum() - t.external_impulse(), given, atol=1e-9 * np.abs(given).max())


@pytest.mark.parametrize("origin", [None, MIDDLE], ids=["fixed", "elastic"])
def test_a_window_goes_on_from_its_state(origin: np.ndarray | None) -> None:
    m = mesh.prepare(*mesher.cylinder(12.0, 6.0, 0.3, 0.3, 0.3))
    make = lambda: Target(m, law_record(elastic()), 300.0, fixed=())  # noqa: E731
    one = make()
    one.inertia.most = 1e-5 * one.mass.sum()
    one.set_window(2.0, origin)
    one.nodes.v[np.linalg.norm(one.nodes.x, axis=1) < 0.5, 2] = -1.0
    for k in range(40):
        if k == 20:
            state = copied(one)
        one.advance(one.stable_dt(1.0))
        one.finish()
    other = make()
    other.restore(state)
    other.restore(state)  # a resumed run does so: the edge must not be there twice
    for _ in range(20):
        other.advance(other.stable_dt(1.0))
        other.finish()
    for first, second in ((one.nodes, other.nodes), (one.elements, other.elements)):
        for name, values in vars(first).items():
            np.testing.assert_array_equal(vars(second)[name], values, err_msg=name)
    np.testing.assert_equal(vars(one.balance), vars(other.balance))
    assert len(one.inertia.elements) > 0
    assert one.elastic() == other.elastic()


# ---- in a scene --------------------------------------------------------------------------------------------------

PARTICLE = '[[particle]]\nmaterial = "Ni"\ndiameter = "20 um"\nvelocity = "500 m/s"\n'
TARGET = '[substrate]\nmaterial = "SS304"\ndiameter = "160 um"\nheight = "80 um"\n'


def scene(particles: int, more: str = "", name: str = "windows") -> Scene:
    return Scene.from_text('preset = "draft"\n' + particles * PARTICLE + TARGET + more, name)


def test_many_particles_have_a_window_and_few_have_none() -> None:
    assert np.isinf(plan(scene(9)).impact.window)
    assert plan(scene(10)).impact.window == pytest.approx(1.75 * 20e-6)
    assert plan(scene(1, 'window = "33 um"\n')).impact.window == pytest.approx(33e-6)
    assert "window" in scene(10).to_toml()


def assert_same_impact(whole: dict[str, Any], part: dict[str, Any]) -> None:
    for name, most in (
        ("flattening_ratio", 0.01),
        ("splat_diameter_m", 0.01),
        ("crater_depth_m", 0.02),
        ("T_mean_K", 0.01),
    ):
        assert part[name] == pytest.approx(whole[name], rel=most), name
    assert part["momentum_error"] < 1e-10
    assert abs(part["energy_drift"]) < 5e-3


def test_a_window_changes_little_of_an_impact(shared_run: SharedRuns) -> None:
    """The window is 1.75 diameters wide, as `plan` chooses: what it leaves out is elastic, and less than 2 % of a measure."""
    size = {"spacing": 2.7, "element_size": 4.0, "diameter": 160, "height": 80}
    whole, part = (
        shared_run(scenes.scene(("Ni", 20, 500), **size, of_substrate=window)).values
        for window in ("", 'window = "35 um"\n')
    )
    assert part["energies"] != whole["energies"]
    assert_same_impact(whole, part)


@pytest.mark.slow
def test_a_window_changes_little_of_a_finer_impact(tmp_path: Path) -> None:
    whole = run(scene(1), tmp_path / "whole").values
    assert_same_impact(whole, run(scene(1, 'window = "35 um"\n'), tmp_path / "part").values)


def test_a_window_that_does_not_hold_the_splat_is_refused() -> None:
    with pytest.raises(
        SceneError, match=r"substrate.window = .*5 um.*: smaller than the area .* at least 12 um is needed"
    ):
        scene(1, 'window = "5 um"\n')


def test_a_particle_that_reaches_the_edge_is_told_of(tmp_path: Path) -> None:
    particle = scenes.scene(("Ni", 20, 500), spacing=2.7, element_size=5, end=25, of_substrate='window = "14 um"\n')
    narrow = run(Scene.from_text(particle, "narrow"), tmp_path / "narrow").values
    assert any("increase substrate.window" in warning for warning in narrow["warnings"])
