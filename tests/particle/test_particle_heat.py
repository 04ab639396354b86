"""Heat in the particle: conduction among its points, heat put in from outside, and across the contact."""

from math import erf, pi, sqrt

import numpy as np
import pytest
from conftest import elastic

from coupler.particle import shapes
from coupler.particle.engine import ENGINES
from coupler.particle.heat import PointConduction
from coupler.particle.packing import sphere
from coupler.physics.constitutive import law_record

CP, K, RHO = 450.0, 50.0, 7800.0  # of `elastic`
ALPHA = K / (RHO * CP)


def bar(points: int) -> tuple[np.ndarray, float]:
    """Points of a bar 1 m across and 2 m long along z, and the volume of each."""
    body = shapes.cylinder(1.0, 2.0, points)
    return body.points - np.array([0, 0, body.points[:, 2].mean()]), body.volume


STRETCHES = {
    "undeformed": np.eye(3),
    "flattened": np.diag([1.5, 1.5, 0.4]),
    "flattened and turned": np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]]) @ np.diag([1.5, 1.5, 0.4]),
}


@pytest.mark.parametrize("name", STRETCHES)
def test_a_wave_of_temperature_decays_at_its_rate_in_any_shape(name: str) -> None:
    """cos(pi z / l) along a bar decays like exp(-J alpha (pi / l)^2 t): l its length now, J the volume its density goes with."""
    F = STRETCHES[name]
    errors = []
    for points in (500, 4000):
        X, volume = bar(points)
        conduction = PointConduction(X, volume ** (1 / 3), np.full(len(X), volume), law_record(elastic()))
        x = X @ F.T
        length = 2.0 * float(np.linalg.norm(F[:, 2]))
        wave = np.cos(pi * (X[:, 2] / 2.0 + 0.5))
        time = 0.5 * length**2 / (pi**2 * ALPHA * np.linalg.det(F))
        gained = conduction.share(time, x, 300.0 + 100.0 * wave)
        assert abs(gained.sum()) < 1e-12 * np.abs(gained).sum()
        left = wave + gained / (RHO * CP * volume * 100.0)
        errors.append(abs(float(wave @ left) / float(wave @ wave) / np.exp(-0.5) - 1.0))
    assert errors[1] < 0.002
    assert errors[1] < 0.4 * errors[0]


def test_gradients_are_exact_for_linear_fields_and_a_lone_hot_point_levels_out() -> None:
    X, volume = sphere(25e-6, 1000)
    conduction = PointConduction(X, volume ** (1 / 3), np.full(len(X), volume), law_record(elastic()))
    T = 300.0 + 1e6 * (X @ np.array([1.0, -2.0, 3.0]))
    start, columns, weights = conduction.operators
    excess = np.add.reduceat(weights * T[columns, None], start[:-1])
    np.testing.assert_allclose(excess[:, :3], [[1e6, -2e6, 3e6]] * len(X), rtol=1e-6)
    assert np.abs(excess[:, 3]).max() < 1e-9 * T.max()
    hot = np.full(len(X), 300.0)
    inside = int(np.argmin(np.linalg.norm(X, axis=1)))
    hot[inside] = 900.0
    T, total, peaks = hot.copy(), hot.sum(), []
    for _ in range(20):
        T += conduction.share(0.1 * volume ** (2 / 3) / ALPHA, X, T) / (RHO * CP * volume)
        peaks.append(T.max())
    assert T.sum() == pytest.approx(total, rel=1e-13)
    assert np.all(np.diff(peaks) < 0)
    assert peaks[-1] < 330.0
    assert T.min() > 290.0


@pytest.mark.parametrize("engine", ENGINES)
def test_heat_put_into_points_raises_temperature_pressure_and_softens_and_the_ledger_closes(engine: str) -> None:
    from coupler.physics.materials import material

    metal, heat = material("Ni"), 3e8
    X, volume = sphere(25e-6, 200)
    law = law_record(metal)
    p = ENGINES[engine](X, volume, law, (0.0, 0.0, 0.0), 400.0)
    try:
        sigma = p.points.sigma_y.copy()
        p.warm(np.full(p.n, heat * volume))
        slope = (metal.cp[1][1] - metal.cp[0][1]) / (metal.cp[1][0] - metal.cp[0][0])
        rise = float(p.points.T[0]) - 400.0
        assert metal.rho * (metal.cp_at(400.0) * rise + 0.5 * slope * rise**2) == pytest.approx(heat, rel=1e-12)
        theta = (np.array([400.0, 400.0 + rise]) - metal.T_ref) / (metal.T_m - metal.T_ref)
        assert p.points.sigma_y / sigma == pytest.approx(
            np.divide(*(1 - theta ** metal.strength["m"])[::-1]), rel=1e-12
        )
        assert p.totals().elastic == pytest.approx(0.0, abs=1e-9 * heat * volume * p.n)
        p.run(1, 1e-14, lambda: None)
        assert p.points.p == pytest.approx(metal.Gamma0 * heat, rel=1e-6)
        assert p.points.eps_p.max() == 0.0
        swings, total = [], []
        for _ in range(40):
            p.run(10, 0.5 * p.stable_dt(), lambda: None)
            swings.append(float(np.mean(p.points.J)) - 1.0)
            numerical = p.internal_work - p.totals().elastic - p.sums[0]
            total.append(p.totals().kinetic + p.totals().elastic + p.sums[0] + numerical)
        assert np.abs(total).max() < 1e-3 * p.sums[1]
        # it swings about the volume that its heat asks for, beta dT = Gamma0 heat / K
        assert np.mean(swings) == pytest.approx(metal.Gamma0 * heat / metal.K, rel=0.2)
        assert max(swings) > 1.3 * metal.Gamma0 * heat / metal.K
    finally:
        p.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_without_expansion_heat_makes_no_pressure(engine: str) -> None:
    from coupler.physics.materials import material

    X, volume = sphere(25e-6, 200)
    p = ENGINES[engine](X, volume, law_record(material("Ni"), {"thermal_expansion": False}), (0.0, 0.0, 0.0), 400.0)
    try:
        p.warm(np.full(p.n, 3e8 * volume))
        p.run(20, 0.5 * p.stable_dt(), lambda: None)
        assert p.points.T.min() > 450.0
        assert np.abs(p.points.p).max() < 1e-6 * 3e8
        assert p.sums[1] == 0.0
    finally:
        p.close()


def test_two_half_spaces_in_perfect_contact_meet_at_the_temperature_of_their_effusivities() -> None:
    """A bar of points on a block of elements, as in an impact but at rest: erf on both sides, heat conserved."""
    from types import SimpleNamespace

    from coupler.fe import mesh as meshes
    from coupler.fe.explicit import Target
    from coupler.geometry import mesher
    from coupler.impact.heat import flow
    from coupler.particle.carried_surface import CarriedSurface

    body = shapes.cylinder(1.0, 2.0, 4000)
    lift = np.array([0.0, 0.0, -body.vertices[:, 2].min()])
    X, vertices = body.points + lift, body.vertices + lift
    upper, lower = law_record(elastic()), law_record(elastic())
    lower["rho"] = 15600.0  # diffuses less far: what spreads sideways under the bar stays little
    points, tets = mesher.box((1.4, 1.4, 2.0), 0.09)
    m = meshes.prepare(points - np.array([0.7, 0.7, 2.0]), tets)
    t = Target(m, lower, 300.0, fixed=(), track_wave=False, conduction=True)
    surface = CarriedSurface(X, vertices, body.triangles, body.spacing)
    foot = np.flatnonzero(vertices[:, 2] < 1e-9)
    top = m.sets["top"]
    middle = m.points[m.facets[top]].mean(axis=1)
    under = top[np.argmin(np.linalg.norm(vertices[foot, None, :2] - middle[None, :, :2], axis=2), axis=1)]
    T = np.full(len(X), 600.0)
    p = SimpleNamespace(x=X, points=SimpleNamespace(T=T), law=upper, spacing=body.spacing)
    p.warm = lambda heat: T.__iadd__(heat / (RHO * CP * body.volume))
    contact = SimpleNamespace(touching=lambda first: (foot, under))
    inside = PointConduction(X, body.spacing, np.full(len(X), body.volume), upper)
    plan = SimpleNamespace(effects=SimpleNamespace(interface_conduction=True))
    domains = SimpleNamespace(plan=plan, particle=p, target=t, surface=surface, contact=contact, conduction=inside)
    time, steps = 0.3**2 / ALPHA, 60
    for _ in range(steps):
        flow(domains, time / steps)
        t.conduction.conduct_for(time / steps, t)
    gained = 15600.0 * CP * float(m.V0 @ (t.elements.T - 300.0))
    lost = RHO * CP * body.volume * float(np.sum(600.0 - T))
    assert gained == pytest.approx(lost, rel=1e-9)
    e_a, e_b = sqrt(K * RHO * CP), sqrt(K * 15600.0 * CP)
    between = (600.0 * e_a + 300.0 * e_b) / (e_a + e_b)
    exact = between + (600.0 - between) * np.vectorize(erf)(X[:, 2] / (2 * sqrt(ALPHA * time)))
    inner = np.linalg.norm(X[:, :2], axis=1) < 0.3
    assert np.sqrt(np.mean((T - exact)[inner] ** 2)) < 0.02 * 300.0
    # what has crossed, of one dimension; the wider block takes a little more at the rim
    through = (600.0 - between) * 2 * K * sqrt(time / (pi * ALPHA)) * pi / 4
    assert lost == pytest.approx(through, rel=0.1)
