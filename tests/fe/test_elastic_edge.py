"""The window of a target and its elastic edge."""

from functools import cache

import numpy as np
import pytest
from conftest import elastic

from coupler.core.records import copied
from coupler.fe import mesh
from coupler.fe.explicit import Target
from coupler.geometry import mesher
from coupler.geometry.triangles import vertex_areas
from coupler.physics.constitutive import law_record, sound_speed

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
