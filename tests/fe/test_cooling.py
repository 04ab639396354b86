"""The implicit heat solve of a pause: closed forms, heat conserved, bodies in contact."""

from math import erf, pi, sqrt

import numpy as np
import pytest
from blocks import join
from conftest import elastic

from coupler.core.arrays import Links
from coupler.core.threads import threads_of
from coupler.fe import mesh as meshes
from coupler.fe.conductances import LINK_RESISTANCE
from coupler.fe.cooling import cool
from coupler.fe.explicit import Target
from coupler.fe.heat import LEAST
from coupler.geometry import mesher
from coupler.physics.constitutive import law_record

CP, K, RHO = 450.0, 50.0, 7800.0  # of `elastic`
ALPHA = K / (RHO * CP)
NONE = np.zeros(0, np.int64)


def block(size: float, lengths: tuple[float, float, float] = (1.0, 1.0, 1.0), low: float = 0.0) -> meshes.TetMesh:
    points, tets = mesher.box(lengths, size)
    return meshes.prepare(points + np.array([0.0, 0.0, low]), tets)


def heights(t: Target) -> np.ndarray:
    return t.nodes.x[t.mesh.conn][:, :, 2].mean(axis=1)


def test_half_space_with_a_cold_face_follows_the_error_function() -> None:
    errors = []
    for size in (0.1, 0.05):
        m = block(size, (4 * size, 4 * size, 1.0))
        t = Target(m, law_record(elastic()), 400.0, fixed=())
        bottom = np.unique(m.facets[m.sets["bottom"]])
        end = 0.2**2 / ALPHA
        report = cool(t, end, bottom, 300.0)
        exact = 300.0 + 100.0 * np.vectorize(erf)(heights(t) / (2 * sqrt(ALPHA * end)))
        errors.append(float(np.sqrt(np.average((t.elements.T - exact) ** 2, weights=m.V0))) / 100.0)
        through = 2 * K * 100.0 * sqrt(end / (pi * ALPHA)) * (4 * size) ** 2
        assert report["taken_away_J"] == pytest.approx(through, rel=0.02)
        assert report["taken_away_J"] == pytest.approx(RHO * CP * float(m.V0 @ (400.0 - t.elements.T)), rel=1e-9)
        assert t.balance.heat == pytest.approx(-report["taken_away_J"], rel=1e-9)
        assert t.elements.heat.sum() == pytest.approx(t.balance.heat, rel=1e-9)
    assert errors[1] < 0.006
    assert errors[1] < 0.8 * errors[0]


def test_recovery_is_called_for_all_of_the_time() -> None:
    t, times = Target(block(0.5), law_record(elastic()), 400.0, fixed=()), list[float]()
    cool(t, 3.0, NONE, 300.0, recover=times.append)
    assert sum(times) == pytest.approx(3.0, rel=1e-12)


def test_insulated_heat_levels_out_and_none_is_lost_with_cp_and_k_of_temperature() -> None:
    law = law_record(elastic())
    law["cp_T0"], law["cp_T1"], law["cp_slope"] = 300.0, 1300.0, 0.3  # 450 to 750 J/kgK
    law["k_T0"], law["k_T1"], law["k_slope"] = 300.0, 1300.0, 0.1
    m = block(0.25)
    t = Target(m, law, np.where(m.points[m.conn][:, :, 2].mean(axis=1) > 0.5, 1000.0, 400.0), fixed=())

    def enthalpy(T: np.ndarray) -> np.ndarray:
        return 450.0 * (T - 300.0) + 0.15 * (T - 300.0) ** 2

    before = float(m.V0 @ enthalpy(t.elements.T))
    report = cool(t, 30.0 / ALPHA, NONE, 300.0)
    assert float(m.V0 @ enthalpy(t.elements.T)) == pytest.approx(before, rel=1e-8)
    level = 300.0 + (sqrt(450.0**2 + 0.6 * before / m.V0.sum()) - 450.0) / 0.3
    assert t.elements.T == pytest.approx(level, abs=1e-2)
    assert report["T_max_before_K"] == 1000.0
    assert abs(report["taken_away_J"]) < 1e-8 * RHO * before


def test_two_bodies_level_out_through_their_contact() -> None:
    """A hot cube on a cold one of another mesh, in perfect contact: as one column (Carslaw & Jaeger 1959, 2.14)."""
    below, above = block(0.11, low=-1.0), block(0.09)
    m, body = join({"a": below, "b": above})
    laws = np.concatenate([law_record(elastic())] * 2)
    t = Target(m, laws, np.where(body == 1, 600.0, 300.0), law_of=body, fixed=())
    foot = np.unique(m.facets[m.sets["b.bottom"]])
    links = _links(m, foot, m.facets[m.sets["a.top"]].astype(np.int64))
    assert (LINK_RESISTANCE**2 * links.strength**2).sum() == pytest.approx(1.0)  # the area
    tau = 0.05 / ALPHA
    # a node without area, such as one whose facets have no height: it carries nothing
    top = m.facets[m.sets["b.top"]][:1, :1].astype(np.int64)
    empty = Links(np.concatenate([top, links.ends[:1, 1:]], axis=1), links.weights[:1], np.zeros(1))
    cool(t, tau, NONE, 0.0, [links, empty])
    means = [float(np.average(t.elements.T[body == i], weights=m.V0[body == i])) for i in (0, 1)]
    assert sum(means) == pytest.approx(900.0, rel=1e-9)
    crossed = 150.0 * 2 * K * sqrt(tau / (pi * ALPHA))
    assert RHO * CP * (600.0 - means[1]) == pytest.approx(crossed, rel=0.03)
    assert t.elements.T[body == 1].min() == pytest.approx(450.0, abs=25.0)


def test_a_jet_heats_a_small_body_as_one_lump() -> None:
    """Biot number 0.02: T_gas - T falls as exp(-h A t / (rho c_p V))."""
    m = block(0.25)
    t = Target(m, law_record(elastic()), 300.0, fixed=())
    top = m.facets[m.sets["top"]]
    size = 0.5 * np.linalg.norm(np.cross(*(m.points[top[:, i]] - m.points[top[:, 0]] for i in (1, 2))), axis=1)
    h = 0.02 * K
    time = 0.7 * RHO * CP / h  # volume over area is 1 m
    report = cool(t, time, NONE, 0.0, gas=(h * np.bincount(top.ravel(), np.repeat(size / 3, 3), len(m.points)), 500.0))
    assert float(np.average(t.elements.T, weights=m.V0)) == pytest.approx(500.0 - 200.0 * np.exp(-0.7), abs=2.0)
    assert -report["taken_away_J"] == pytest.approx(RHO * CP * float(m.V0 @ (t.elements.T - 300.0)), rel=1e-8)


@pytest.mark.usefixtures("eight_cores")
def test_threads_cool_as_one_does_to_the_last_bit() -> None:
    m = block(0.045)
    assert len(m.points) > 2 * LEAST
    after = []
    for threads in (1, 2, 4):
        t = Target(m, law_record(elastic()), np.where(m.points[m.conn][:, 0, 0] > 0.5, 900.0, 300.0), fixed=())
        with threads_of(threads):
            cool(t, 0.1 / ALPHA, np.unique(m.facets[m.sets["bottom"]]), 300.0)
        after.append(t.elements.T)
    assert np.ptp(after[0]) > 10.0
    assert all(np.array_equal(T, after[0]) for T in after)


def _links(m: meshes.TetMesh, nodes: np.ndarray, triangles: np.ndarray) -> Links:
    """Each node on the triangle of a plane face that it lies in."""
    found, weights = [], []
    for x in m.points[nodes]:
        a, b, c = (m.points[triangles[:, i], :2] for i in range(3))
        det = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        d = x[:2] - a
        wb = (d[:, 0] * (c - a)[:, 1] - d[:, 1] * (c - a)[:, 0]) / det
        wc = ((b - a)[:, 0] * d[:, 1] - (b - a)[:, 1] * d[:, 0]) / det
        w = np.stack([1 - wb - wc, wb, wc], axis=1)
        best = int(np.argmax(w.min(axis=1)))
        found.append(triangles[best])
        weights.append(w[best])
    own = m.facets[m.sets["b.bottom"]]
    size = 0.5 * np.linalg.norm(np.cross(*(m.points[own[:, i]] - m.points[own[:, 0]] for i in (1, 2))), axis=1)
    area = np.bincount(own.ravel(), np.repeat(size / 3, 3), len(m.points))[nodes]
    return Links.of(nodes.astype(np.int64), np.array(found), np.array(weights), np.sqrt(area) / LINK_RESISTANCE)
