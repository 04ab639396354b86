"""Elements with added inertia: a longer step, with masses, momentum and ledger kept."""

import numpy as np
import pytest
from blocks import pinched
from conftest import elastic

from coupler.core import safety
from coupler.core.records import copied
from coupler.fe import mesh
from coupler.fe.boundary import nodes_of
from coupler.fe.explicit import Target
from coupler.fe.inertia import step_for
from coupler.geometry import mesher
from coupler.physics.constitutive import law_record


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


def test_viscosity_of_thin_elements_is_stable_at_the_step_of_the_mesh() -> None:
    """Elements a hundred times as wide as high, at three times their bound: viscosity over the cube root of their volume makes 30 %
    more energy. Here it takes some, in compression only; velocities half a step late leave an error of 4 %."""
    points, tets = mesher.box((1.0, 1.0, 1.0), 0.2)
    t = Target(mesh.prepare(points * [1.0, 1.0, 0.01], tets), law_record(elastic()), 300.0, fixed=(), track_wave=False)
    t.nodes.v[:] = 0.01 * np.random.default_rng(2).standard_normal(t.nodes.v.shape)
    start, own = t.kinetic(), t.stable_dt()
    for _ in range(15):
        dt = safety.SETTLED * t.stable_dt(1.0)
        for _ in range(10):
            t.advance(dt, is_conducting=False)
            t.finish()
    assert dt > 2.5 * own
    assert 0.1 * start < t.balance.numerical < start
    assert t.kinetic() + t.elastic() + t.balance.numerical == pytest.approx(start, rel=0.06)
