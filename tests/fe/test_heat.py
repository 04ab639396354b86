"""Conduction and thermal expansion in the target, several bodies in one domain."""

from math import erf, sqrt

import numpy as np
import pytest
from blocks import join
from conftest import elastic

from coupler.core.records import new_rows
from coupler.errors import SolverError
from coupler.fe import kernels, mesh
from coupler.fe.explicit import Target
from coupler.fe.heat import Conduction
from coupler.fe.model import Metals
from coupler.fe.state import ElementState, NodeState
from coupler.geometry import mesher
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material, names

CP, K, RHO = 450.0, 50.0, 7800.0  # of `elastic`
ALPHA = K / (RHO * CP)


class Block:
    """Temperatures of a mesh at rest, and conduction over it."""

    def __init__(self, m: mesh.TetMesh, laws: np.ndarray, T: np.ndarray, law_of: np.ndarray | None = None):
        self.mesh, self.laws, self.nodes = m, laws, new_rows(NodeState, len(m.points), x=m.points)
        known = {"T": T.astype(float), "sigma_y": np.full(len(T), 1e8), "volume": m.V0.copy()}
        self.elements = new_rows(ElementState, len(T), **known)
        self.law_of = np.zeros(len(T), np.int32) if law_of is None else law_of.astype(np.int32)
        self.cells, self.metals = mesh.cells_of(m), Metals(laws, self.law_of, np.zeros(len(m.points), np.int32))
        self.active_nodes, self.active_elements = len(m.points), len(T)
        self.conduction = Conduction(len(m.points), len(T))
        self.z = m.points[m.conn][:, :, 2].mean(axis=1)

    def run(self, time: float) -> None:
        self.conduction.conduct_for(time, self)


def column(size: float, low: float = 0.0) -> mesh.TetMesh:
    """A column four elements wide from z = low to 1 whose elements keep to planes of equal z, all in one order."""
    from skfem import MeshTet

    planes = np.linspace(low, 1.0, round((1.0 - low) / size) + 1)
    width = np.linspace(0.0, 4 * size, 5)
    made = MeshTet.init_tensor(width, width, planes)
    return mesh.prepare(made.p.T.copy(), made.t.T.copy())


def test_operator_is_scikit_fems(rng: np.random.Generator) -> None:
    from skfem import Basis, BilinearForm, ElementTetP1, MeshTet
    from skfem.helpers import dot, grad

    m = mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.3))
    block = Block(m, law_record(elastic()), np.full(len(m.conn), 300.0))
    block.run(1e-9)
    x = m.points + 0.02 * rng.standard_normal(m.points.shape)  # conduction acts in the current configuration
    block.nodes.x[:] = x
    assert kernels.volumes(0, len(m.conn), x, m.conn, block.elements.volume) > 0
    block.conduction.T[:] = T = 300 + 100 * rng.random(len(x))
    block.conduction.flows(block)
    flow = np.zeros(len(x))
    np.add.at(flow, m.conn, block.conduction.arrays.flow)
    basis = Basis(MeshTet(x.T, m.conn.T.astype(np.int64), sort_t=False), ElementTetP1(), intorder=1)
    reference = -K * BilinearForm(lambda u, v, w: dot(grad(u), grad(v))).assemble(basis) @ T
    assert np.abs(flow - reference).max() < 1e-12 * np.abs(reference).max()


def test_a_cosine_decays_as_its_exponential() -> None:
    """300 K + 100 K cos(pi z) between adiabatic faces falls by exp(-pi^2 alpha t) (Carslaw & Jaeger 1959, 3.3): second order in h."""
    errors, sizes, end = [], np.array([0.1, 0.06, 0.036]), 0.5 / (np.pi**2 * ALPHA)
    for size in sizes:
        m = mesh.prepare(*mesher.box((4 * size, 4 * size, 1.0), size))
        z = m.points[m.conn][:, :, 2].mean(axis=1)
        block = Block(m, law_record(elastic()), 300 + 100 * np.cos(np.pi * z))
        block.run(end)
        exact = 300 + 100 * np.exp(-0.5) * np.cos(np.pi * z)
        errors.append(float(np.sqrt(np.average((block.elements.T - exact) ** 2, weights=m.V0))) / 100)
        assert abs(block.elements.heat.sum()) < 1e-12 * np.abs(block.elements.heat).sum()
    assert errors[-1] < 1e-3
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 1.7


def test_two_half_spaces_meet_at_the_temperature_of_their_effusivities() -> None:
    copper, steel = material("OFHC_Cu"), material("SS304")
    on = {"temperature_dependent_cp": False}
    laws = np.concatenate([law_record(copper, on), law_record(steel, on)])
    laws["k_slope"] = 0.0
    m = column(0.025, low=-1.0)
    law_of = (m.points[m.conn][:, :, 2].mean(axis=1) > 0).astype(np.int32)
    block = Block(m, laws, np.where(law_of == 0, 600.0, 300.0), law_of)
    alpha = laws["k_0"] / (laws["rho"] * laws["cp_0"])
    effusivity = laws["k_0"] / np.sqrt(alpha)
    end = 0.25**2 / alpha[0]
    block.run(end)
    between = (effusivity[0] * 600 + effusivity[1] * 300) / effusivity.sum()
    met = block.conduction.T[np.abs(m.points[:, 2]) < 1e-9]
    assert met == pytest.approx(between, abs=1.5)
    far = np.where(law_of == 0, 600.0, 300.0)
    exact = between + (far - between) * np.vectorize(erf)(np.abs(block.z) / (2 * np.sqrt(alpha[law_of] * end)))
    assert np.abs(block.elements.T - exact).max() < 5.0  # of 300 K


def test_conductivity_that_changes_with_temperature() -> None:
    """Steady flow through a slab: the integral of k(T) dT is linear across it (Kirchhoff), and is what flows through a unit length."""
    law = law_record(elastic())
    law["k_T0"], law["k_T1"], law["k_slope"] = 300.0, 900.0, 0.25  # 50 to 200 W/mK
    m = column(0.1)
    block = Block(m, law, np.full(len(m.conn), 500.0))
    block.run(1e-9)
    whole = 50 * 600 + 0.125 * 600**2
    block.conduction.T[:] = 300 + (np.sqrt(50**2 + 0.5 * m.points[:, 2] * whole) - 50) / 0.25
    block.conduction.flows(block)
    flow = np.zeros(len(m.points))
    np.add.at(flow, m.conn, block.conduction.arrays.flow)
    face = np.isclose(m.points[:, 2], 1.0)
    through = whole * 0.4**2
    assert -flow[face].sum() == pytest.approx(through, rel=2e-3)
    inner = ~face & (m.points[:, 2] > 1e-9)
    assert np.abs(np.bincount(np.round(10 * m.points[inner, 2]).astype(int), flow[inner])).max() < 2e-3 * through


def test_heat_capacity_that_changes_with_temperature_and_what_is_conserved() -> None:
    """A hot and a cold half level out at the temperature of equal enthalpy, and single elements level with them."""
    law = law_record(elastic())
    law["cp_T0"], law["cp_T1"], law["cp_slope"] = 300.0, 1300.0, 0.3  # 450 to 750 J/kgK
    m = mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.25))
    block = Block(m, law, np.where(m.points[m.conn][:, :, 2].mean(axis=1) > 0.5, 1000.0, 400.0))

    def enthalpy(T: np.ndarray) -> np.ndarray:
        return 450 * (T - 300) + 0.15 * (T - 300) ** 2

    before = float(m.V0 @ enthalpy(block.elements.T))
    block.run(0.1 / ALPHA)
    assert np.ptp(block.elements.T) > 10.0  # on the way
    block.run(8.0 / ALPHA)
    assert float(m.V0 @ enthalpy(block.elements.T)) == pytest.approx(before, rel=1e-9)
    assert abs(block.elements.heat.sum()) < 1e-12 * np.abs(block.elements.heat).sum()
    level = 300 + (sqrt(450**2 + 0.6 * before / m.V0.sum()) - 450) / 0.3
    assert block.elements.T == pytest.approx(level, abs=1e-3)


def test_heat_of_one_element_spreads_and_none_is_lost() -> None:
    m = mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.2))
    block = Block(m, law_record(elastic()), np.full(len(m.conn), 300.0))
    block.elements.T[100] = 900.0
    total = float(m.V0 @ block.elements.T)
    peaks = []
    for _ in range(40):
        block.run(2e-4 / ALPHA)
        peaks.append(block.elements.T.max())
        assert block.elements.T.min() > 300.0 - 1.0
    assert np.all(np.diff(peaks) < 0)
    assert float(m.V0 @ block.elements.T) == pytest.approx(total, rel=1e-13)


@pytest.mark.parametrize("step", [1e-5, 1e-4, 5e-4])
def test_elements_beside_those_that_a_contact_warms_stay_as_warm_as_they_were(step: float) -> None:
    """Ten elements at a face get 20 K again and again. Nodes take the mean of the elements around them, so that a cold element beside
    a hot one may lose heat it never had: at most 1.5 % of the highest rise, which the independent check of runs allows too."""
    m = mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.2))
    block = Block(m, law_record(elastic()), np.full(len(m.conn), 300.0))
    hot = np.flatnonzero(m.points[m.conn][:, :, 2].max(axis=1) > 1.0 - 1e-9)[:10]
    block.run(1e-9)
    for _ in range(30):
        block.elements.T[hot] += 20.0
        block.run(step / ALPHA)
        T = block.elements.T
        assert T.min() > 300.0 - 0.015 * (T.max() - 300.0)


@pytest.mark.parametrize("length", [1e-6, 1.0])
def test_conduction_in_a_moving_target(length: float) -> None:
    """The ledger closes as well with conduction; it matters in a body of a micrometre and not in one of a metre."""
    made, ledger = [], []
    for conducts in (False, True):
        points, tets = mesher.box((1.0, 1.0, 1.0), 0.2)
        m = mesh.prepare(points * length, tets)
        t = Target(m, law_record(material("OFHC_Cu")), 300.0, fixed=(), track_wave=False, conduction=conducts)
        hot = np.flatnonzero(m.points[m.conn][:, :, 2].mean(axis=1) < 0.3 * length)
        t.warm(hot, 3e8 * m.V0[hot])
        t.nodes.v[:, 2] = np.where(m.points[:, 2] < 0.5 * length, 60.0, -60.0)
        start = t.kinetic() + t.elastic()
        for step in range(300):
            if step % 10 == 0:
                dt = t.stable_dt()
            t.advance(dt)
            t.finish()
        ledger.append((t.kinetic() + t.elastic() + t.balance.plastic + t.balance.numerical) / start)
        assert 8960 * 383 * (m.V0 @ (t.elements.T - 300)) == pytest.approx(t.balance.heat, rel=1e-9)
        made.append(t)
    assert ledger[0] == pytest.approx(1.0, rel=5e-3)  # five elements across, struck hard
    assert ledger[1] == pytest.approx(ledger[0], rel=1e-4)
    still, moved = made
    difference = np.abs(still.elements.T - moved.elements.T).max()
    assert difference > 5.0 if length < 1e-3 else difference < 0.1


def test_conduction_needs_only_the_active_part() -> None:
    points, tets = mesher.cylinder(8e-6, 4e-6, 0.12e-6, 0.3e-6, 0.3)
    m = mesh.prepare(points, tets)
    made, dt = [], 0.0
    for track_wave in (True, False):
        t = Target(m, law_record(material("OFHC_Cu")), 300.0, track_wave=track_wave, conduction=True)
        near = np.flatnonzero(m.reach_element < 0.3e-6)
        t.warm(near, 1e9 * m.V0[near])
        dt = dt or 0.5 * t.stable_dt()
        for _ in range(60):
            t.advance(dt)
            t.finish()
        assert (t.active_elements < len(m.conn)) == track_wave
        made.append(t)
    assert np.abs(made[0].elements.T - made[1].elements.T).max() < 1e-9
    assert np.abs(made[0].nodes.v - made[1].nodes.v).max() < 1e-8 * np.abs(made[0].nodes.v).max()
    assert 310.0 < made[0].elements.T.max() < 300.0 + 1e9 / (8960 * 383) - 1.0


def test_a_heated_body_expands_by_its_grueneisen_number_and_a_linear_one_does_not() -> None:
    m = mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.34))
    for on in (True, False):
        metal = material("Ni")
        t = Target(m, law_record(metal, {"mie_gruneisen": on}), 300.0, fixed=(), track_wave=False)
        t.warm(np.arange(len(m.conn)), metal.rho * metal.cp_at(300.0) * m.V0)
        assert t.elements.T == pytest.approx(301.0, rel=1e-6)
        dt = t.stable_dt()
        for _ in range(600):
            t.advance(dt)
            t.finish()
            t.nodes.v[:] *= 0.9  # to rest
        beta = metal.Gamma0 * metal.rho * metal.cp_at(300.0) / metal.K
        grown = t.elements.volume.sum() / m.V0.sum() - 1.0
        assert grown == pytest.approx(beta if on else 0.0, rel=1e-3, abs=1e-12)
        assert np.abs(t.nodes.p).max() < 1e-3 * beta * metal.K


def test_grueneisen_expansion_is_that_of_the_handbook() -> None:
    for name in names():
        metal = material(name)
        alpha = metal.thermal_expansion_at(300.0)
        if metal.Gamma0 > 0 and alpha > 0:
            beta = metal.Gamma0 * metal.rho * metal.cp_at(300.0) / metal.K
            assert beta == pytest.approx(3 * alpha, rel=0.25), name


def test_bodies_of_different_materials_in_one_domain_are_as_alone(rng: np.random.Generator) -> None:
    metals = [material("OFHC_Cu"), material("SS304")]
    laws = np.concatenate([law_record(metal) for metal in metals])
    places, warmth = (0.0, 1.5), (300.0, 500.0)
    parts = []
    for at, size in zip(places, (0.3, 0.25), strict=True):
        points, tets = mesher.box((1.0, 1.0, 1.0), size)
        parts.append(mesh.prepare(points + np.array([at, 0.0, 0.0]), tets))
    both, body = join({"copper": parts[0], "steel": parts[1]})
    assert np.all(np.diff(both.reach_node) >= 0)
    assert np.all(np.diff(both.reach_element) >= 0)

    def run(
        m: mesh.TetMesh, T: float | np.ndarray, law: np.ndarray, law_of: np.ndarray | None, v: np.ndarray
    ) -> Target:
        sides = ("bottom",) if law_of is None else ("copper.bottom", "steel.bottom")
        tops = ("top",) if law_of is None else ("copper.top", "steel.top")
        t = Target(m, law, T, law_of=law_of, fixed=sides, absorbing=tops, track_wave=False, conduction=True)
        t.nodes.v[:] = v
        t.nodes.v[t.fixed] = 0.0
        t.warm(np.arange(20), np.zeros(20))
        for _ in range(60):
            t.advance(2e-6)
            t.finish()
        return t

    def speed(x: np.ndarray) -> np.ndarray:
        return 100.0 * np.stack([np.sin(3 * x[:, 2]), x[:, 0] - 1.0, -x[:, 2]], axis=1)

    joined = run(both, np.take(warmth, body), laws, body, speed(both.points))
    alone = [
        run(m, T, laws[i : i + 1], None, speed(m.points)) for i, (m, T) in enumerate(zip(parts, warmth, strict=True))
    ]
    for i, t in enumerate(alone):
        elements = np.flatnonzero(body == i)
        nodes = np.flatnonzero(joined.metals.of_node == i)
        for of_kind, own, whole, fields in (
            (elements, t.elements, joined.elements, ("s", "T", "eps_p", "sigma_y", "heat", "volume")),
            (nodes, t.nodes, joined.nodes, ("x", "v", "f", "p", "energy", "J")),
        ):
            for name in fields:
                expected = vars(own)[name]
                least = 1e-12 * abs(expected).max()  # kernels are compiled for the laws of a domain: another rounding
                assert vars(whole)[name][of_kind] == pytest.approx(expected, rel=1e-12, abs=least), name
    assert all(t.elements.eps_p.max() > 0.01 for t in alone)
    for what in ("kinetic", "elastic"):
        assert getattr(joined, what)() == pytest.approx(sum(getattr(t, what)() for t in alone), rel=1e-11)
    for what in ("plastic", "numerical", "heat", "absorbed"):
        assert vars(joined.balance)[what] == pytest.approx(sum(vars(t.balance)[what] for t in alone), rel=1e-11)
    assert joined.external_impulse() == pytest.approx(sum(t.external_impulse() for t in alone), rel=1e-9)


def test_materials_do_not_share_nodes() -> None:
    m = mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.5))
    law_of = np.arange(len(m.conn)) % 2
    with pytest.raises(SolverError, match="share nodes"):
        Target(m, np.concatenate([law_record(elastic())] * 2), 300.0, law_of=law_of)
