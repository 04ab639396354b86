"""The explicit target on its own: forms, patches, rotations, waves, energy."""

from itertools import pairwise

import numpy as np
import pytest
from conftest import elastic

from coupler.core import safety
from coupler.errors import SolverError
from coupler.fe import explicit, kernels, mesh
from coupler.fe.explicit import Target
from coupler.fe.model import Elements, Nodes, Viscosity
from coupler.geometry import mesher
from coupler.geometry.triangles import areas_and_normals
from coupler.physics.constitutive import law_record, sound_speed
from coupler.physics.materials import material


@pytest.fixture(scope="module")
def block() -> mesh.TetMesh:
    return mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.2))


def distort(x: np.ndarray, rng: np.random.Generator, size: float) -> np.ndarray:
    return x + size * rng.standard_normal(x.shape)


def element_gradients(x: np.ndarray, m: mesh.TetMesh) -> np.ndarray:
    d = x[m.conn[:, 1:]] - x[m.conn[:, :1]]
    return np.einsum("eai,eaj->eij", d, m.B)


def test_mesh_fills_the_cylinder_and_faces_outwards() -> None:
    m = mesh.prepare(*mesher.cylinder(2.0, 1.0, 0.1, 0.3, 0.5))
    assert m.V0.min() > 0
    assert m.V0.sum() == pytest.approx(np.pi, rel=0.02)
    assert m.node_volume.sum() == pytest.approx(m.V0.sum(), rel=1e-12)
    area, normal = areas_and_normals(m.points, m.facets)
    assert np.abs((area[:, None] * normal).sum(axis=0)).max() < 1e-12  # closed
    assert np.all(normal[m.sets["top"], 2] > 0.999)
    assert np.all(np.diff(m.reach_node) >= 0)
    assert np.all(np.diff(m.reach_element) >= 0)
    assert np.einsum("ij,ij->", m.points[m.facets].mean(axis=1), area[:, None] * normal) / 3 == pytest.approx(
        m.V0.sum()
    )


def test_forces_are_scikit_fems_linear_form_of_the_same_stress(block: mesh.TetMesh, rng: np.random.Generator) -> None:
    from skfem import Basis, ElementTetP1, ElementVector, LinearForm, MeshTet, asm
    from skfem.helpers import ddot, grad

    t = Target(block, law_record(elastic()), 300.0, fixed=(), track_wave=False)
    t.nodes.v[:] = distort(np.zeros_like(t.nodes.x), rng, 300.0)
    t.advance(1e-5)
    t.advance(1e-5)
    F = element_gradients(t.nodes.x, block)
    s = t.stress()
    # the bulk viscosity acts too: rebuild it from the same velocities
    Fm = F - 0.5e-5 * element_gradients(t.nodes.v, block)
    div = np.einsum("eij,eji->e", element_gradients(t.nodes.v, block), np.linalg.inv(Fm))
    law = t.laws[0]
    c = sound_speed(law["rho"], law["K"], law["G"])
    length = np.minimum(t.elements.volume ** (1 / 3), kernels.THIN * c * t.dt_of)
    q = np.where(div < 0, law["rho"] * length * (1.44 * length * div**2 - 0.06 * c * div), 0.0)
    sigma = np.zeros((len(F), 3, 3))
    for n, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]):
        sigma[:, i, j] = sigma[:, j, i] = s[:, n]
    sigma -= q[:, None, None] * np.eye(3)
    P = np.linalg.det(F)[:, None, None] * sigma @ np.linalg.inv(F).transpose(0, 2, 1)
    basis = Basis(
        MeshTet(block.points.T, block.conn.T.astype(np.int64), sort_t=False), ElementVector(ElementTetP1()), intorder=1
    )
    form = LinearForm(lambda v, w: -ddot(w["P"], grad(v)))
    reference = asm(form, basis, P=P.transpose(1, 2, 0)[..., None])
    assert np.abs(t.nodes.f - reference.reshape(-1, 3)).max() < 1e-12 * np.abs(reference).max()


def test_patch_of_distorted_elements_has_one_stress_and_no_force_inside(rng: np.random.Generator) -> None:
    points, tets = mesher.box((1.0, 1.0, 1.0), 0.2)
    inside = np.all((points > 1e-6) & (points < 1 - 1e-6), axis=1)
    points[inside] = distort(points[inside], rng, 0.02)
    m = mesh.prepare(points, tets)
    mat = elastic()
    t = Target(m, law_record(mat), 300.0, fixed=(), track_wave=False)
    L = 1e-6 * rng.standard_normal((3, 3))
    t.nodes.v[:] = t.nodes.x @ L.T
    t.inv_mass[:] = 0.0
    t.advance(1.0)
    eps = 0.5 * (L + L.T)
    expected = 2 * mat.G * (eps - np.trace(eps) / 3 * np.eye(3)) + mat.K * np.trace(eps) * np.eye(3)
    voigt = expected[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    assert np.abs(t.stress() - voigt).max() < 1e-5 * np.abs(voigt).max()
    interior = np.setdiff1d(np.arange(len(m.points)), m.facets.ravel())
    assert np.abs(t.nodes.f[interior]).max() < 1e-5 * np.abs(t.nodes.f).max()


def test_rigid_rotation_leaves_no_stress_and_turns_a_stress_that_is_there(block: mesh.TetMesh) -> None:
    mat = elastic()
    t = Target(block, law_record(mat), 300.0, fixed=(), track_wave=False)
    t.inv_mass[:] = 0.0
    t.elements.s[:] = np.array([1e6, -1e6, 0, 0, 0, 0])
    steps = 400
    angle = 0.5 * np.pi / steps
    for i in range(steps):  # chords of a circle: the rotation over a step is exact
        a, b = i * angle, (i + 1) * angle
        Ra, Rb = (np.array([[np.cos(q), -np.sin(q), 0], [np.sin(q), np.cos(q), 0], [0, 0, 1]]) for q in (a, b))
        t.nodes.v[:] = block.points @ (Rb - Ra).T
        t.advance(1.0)
    # a quarter turn swaps the stresses in x and y; the chords stretch by angle^2/8 a step, which a linear material feels
    assert np.abs(t.elements.s[:, 0] + 1e6).max() < 2e-3 * 1e6
    assert np.abs(t.elements.s[:, 1] - 1e6).max() < 2e-3 * 1e6
    assert np.abs(t.nodes.p).max() < 1e-3 * mat.K * angle**2


def test_stable_dt_is_sharp_from_below(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound never exceeds what the exact largest eigenvalue allows, and is not far below it."""
    from scipy.linalg import eigh

    points, tets = mesher.box((1.0, 1.0, 1.0), 0.5)
    m = mesh.prepare(points, tets)
    mat = elastic()
    monkeypatch.setattr(explicit, "LINEAR_VISCOSITY", 0.0)
    monkeypatch.setattr(explicit, "QUADRATIC_VISCOSITY", 0.0)
    t = Target(m, law_record(mat), 300.0, fixed=(), track_wave=False)
    n = 3 * len(m.points)
    K = np.zeros((n, n))
    for col in range(n):  # stiffness by probing: forces are linear in small velocities from rest
        t2 = Target(m, law_record(mat), 300.0, fixed=(), track_wave=False)
        t2.inv_mass[:] = 0.0
        t2.nodes.v.ravel()[col] = -1e-9
        t2.advance(1.0)
        K[:, col] = t2.nodes.f.ravel() / 1e-9
    K = 0.5 * (K + K.T)
    omega2 = eigh(K, np.diag(np.repeat(t.mass, 3)), eigvals_only=True)[-1]
    exact = 2 / np.sqrt(omega2)
    bound = t.stable_dt() / safety.ELEMENTS
    assert bound <= exact * 1.001
    assert bound > 0.3 * exact  # averaged pressure is softer than the element bound knows
    sharp = t.stable_dt(enough=1.0)
    for _ in range(5):  # later calls start from the last vector
        sharp = t.stable_dt(enough=1.0)
    assert 0.75 * exact < sharp < exact


def test_the_step_includes_elements_that_become_active_while_it_is_kept() -> None:
    """A flat inactive element does not limit the step until the front reaches it."""
    m = mesh.prepare(*mesher.box((1.0, 1.0, 12.0), 0.25), origin=(0.5, 0.5, 0.0))
    t = Target(m, law_record(elastic()), 300.0, fixed=())
    last = m.conn[-1]
    t.nodes.x[last[0]] += 0.9 * (t.nodes.x[last[1:]].mean(axis=0) - t.nodes.x[last[0]])
    assert t.active_elements < len(m.conn)
    for enough in (0.0, 1.0):
        now = t.stable_dt(enough)
        assert t.stable_dt(enough, 0.1 * now) == pytest.approx(now, rel=0.1)
        assert t.stable_dt(enough, 20.0 / t.wave_speed) < 0.5 * now


def test_the_sharper_step_is_stable_while_elements_flow(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block that twists itself into plastic flow, stepped at the limit of the whole mesh: as at half the safe bound."""
    m = mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.2))
    ends = []
    for sharp in (True, False):
        t = Target(m, law_record(material("SS304"), rate_filter=1e-6), 300.0, fixed=(), track_wave=False)
        x = m.points - 0.5
        t.nodes.v[:] = 400 * np.stack([-x[:, 1] * x[:, 2], x[:, 0] * x[:, 2], 0 * x[:, 0]], axis=1)
        start, steps, end, dt = t.kinetic(), 0, 4e-4, 0.0
        while t.time < end * (1 - 1e-9):
            if steps % 10 == 0:
                dt = t.stable_dt(enough=1.0) if sharp else 0.5 * t.stable_dt()
            t.advance(min(dt, end - t.time))
            t.finish()
            steps += 1
        ends.append(
            (
                t.nodes.x.copy(),
                (t.kinetic() + t.elastic() + t.balance.plastic + t.balance.numerical) / start,
                t.elements.eps_p.max(),
                steps,
            )
        )
    assert ends[0][3] < 0.4 * ends[1][3]
    assert ends[0][1] == pytest.approx(1.0, abs=5e-3)
    assert ends[0][2] > 0.005
    assert np.abs(ends[0][0] - ends[1][0]).max() < 2e-3


def bar_error(size: float) -> float:
    """Relative error of the arrival speed of a longitudinal pulse in a confined bar of elements of this size."""
    m = mesh.prepare(*mesher.box((0.2, 0.2, 2.0), size))
    mat = elastic()
    t = Target(m, law_record(mat), 300.0, fixed=(), track_wave=False)
    t.inv_mass[:] = 1 / t.mass
    width, z0 = 0.25, 1.0
    t.nodes.v[:, 2] = np.exp(-(((t.nodes.x[:, 2] - z0) / width) ** 2))
    c = sound_speed(mat.rho, mat.K, mat.G)
    end = 0.4 / c
    while t.time < end:
        dt = min(t.stable_dt(), end - t.time)
        t.advance(dt)
        t.nodes.total[:] = t.nodes.f
        t.nodes.total[:, :2] = 0.0  # uniaxial strain
        t.nodes.v[:, :2] = 0.0
    v = t.velocity()[:, 2]
    z = t.mesh.points[:, 2]
    exact = 0.5 * sum(np.exp(-(((z - z0 + d) / width) ** 2)) for d in (-c * t.time, c * t.time))
    return float(np.sqrt(np.average((v - exact) ** 2, weights=t.mass) / np.average(exact**2, weights=t.mass)))


def test_wave_converges_with_second_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explicit, "LINEAR_VISCOSITY", 0.0)
    monkeypatch.setattr(explicit, "QUADRATIC_VISCOSITY", 0.0)
    sizes = np.array([0.1, 0.07, 0.05])
    errors = np.array([bar_error(h) for h in sizes])
    order = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert order > 1.5
    assert errors[-1] < 0.04


def test_elastic_run_keeps_its_energy(block: mesh.TetMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explicit, "LINEAR_VISCOSITY", 0.0)
    monkeypatch.setattr(explicit, "QUADRATIC_VISCOSITY", 0.0)
    t = Target(block, law_record(elastic()), 300.0, fixed=(), track_wave=False)
    t.nodes.v[:, 2] = 0.1 * np.sin(np.pi * t.nodes.x[:, 2])
    start = t.kinetic()
    dt = t.stable_dt()
    worst = 0.0
    for _ in range(600):
        t.advance(dt)
        t.finish()
        worst = max(worst, abs(t.kinetic() + t.elastic() - start) / start)
    assert worst < 1e-4
    assert np.abs(t.momentum() - t.mass @ np.outer(np.sin(np.pi * block.points[:, 2]), [0, 0, 0.1])).max() < 1e-10


def test_waves_leave_through_absorbing_sides_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explicit, "LINEAR_VISCOSITY", 0.0)
    monkeypatch.setattr(explicit, "QUADRATIC_VISCOSITY", 0.0)
    left = {}
    for kind in ("free", "absorbing", "fixed"):
        m = mesh.prepare(*mesher.box((1.0, 1.0, 1.0), 0.1), (0.5, 0.5, 0.5))
        names = ("top", "bottom", "sides")
        mat = elastic(nu=0.0)
        t = Target(
            m, law_record(mat), 300.0, fixed=names if kind == "fixed" else (), absorbing=names if kind == "absorbing" else ()
        )  # fmt: skip
        r = t.nodes.x - 0.5
        t.nodes.v[:] = r * np.exp(-np.einsum("ij,ij->i", r, r) / 0.04)[:, None]
        t.nodes.v[t.fixed] = 0.0
        start = t.kinetic()
        end = 2.0 / sound_speed(mat.rho, mat.K, mat.G)
        while t.time < end:
            t.advance(t.stable_dt())
            t.finish()
        left[kind] = (t.kinetic() + t.elastic()) / start
        assert (t.kinetic() + t.elastic() + t.balance.absorbed) / start == pytest.approx(1.0, abs=1e-4)
    assert left["absorbing"] < 0.1 * min(left["free"], left["fixed"])


def test_only_what_a_wave_has_reached_is_computed_and_nothing_changes() -> None:
    m = mesh.prepare(*mesher.cylinder(8.0, 4.0, 0.12, 0.3, 0.3))
    states = []
    for track_wave in (True, False):
        t = Target(m, law_record(elastic()), 300.0, track_wave=track_wave)
        assert (t.active_elements < len(m.conn)) == track_wave
        near = np.linalg.norm(t.nodes.x, axis=1) < 0.2
        t.nodes.v[near, 2] = -1.0
        for _ in range(25):
            t.advance(5e-6)
            t.finish()
        states.append((t.nodes.v.copy(), t.kinetic(), t.elastic()))
        if track_wave:
            assert t.active_elements < len(m.conn)
    assert np.abs(states[0][0] - states[1][0]).max() < 1e-9
    assert states[0][1] == pytest.approx(states[1][1], rel=1e-9)


def test_an_inverted_element_stops_with_place_and_time(block: mesh.TetMesh) -> None:
    t = Target(block, law_record(elastic()), 300.0, fixed=(), track_wave=False)
    t.nodes.v[0] = 1e6
    with pytest.raises(SolverError, match=r"element \d+ of the target inverted at t = .* near \(.*\) um"):
        t.advance(1e-5)


def test_elements_are_computed_alike_wherever_a_range_begins(block: mesh.TetMesh, rng: np.random.Generator) -> None:
    """The whole range, odd pieces, and pieces smaller than a block: every number the same to the last bit."""
    t = Target(block, law_record(material("SS304")), 300.0, fixed=(), track_wave=False)
    t.nodes.v[:] = 30 * rng.standard_normal(block.points.shape)
    for _ in range(5):
        t.advance(1e-6)
        t.finish()
    m, names = len(block.conn), ("s", "sigma_y", "eps_p", "rate", "T", "heat", "fe", "eps_gradient")
    assert m % kernels.BLOCK
    ends, nodes = [], Nodes.of(t.nodes, t.f_ext, t.inv_mass)
    for cuts in ([0, m], [0, 1, 5, 38, 102, m - 1, m], [*range(0, m, 7), m]):
        own = {name: vars(t.elements)[name].copy() for name in names}
        for lo, hi in pairwise(cuts):
            elements = Elements.of(t.elements)._replace(**own)
            kernels.element_forces(lo, hi, 1e-6, Viscosity(0.06, 1.2, t.dt_of), t.cells, t.metals, nodes, elements)
        ends.append(own)
    for own in ends[1:]:
        assert all(np.array_equal(own[name], ends[0][name]) for name in names)
    assert not np.array_equal(ends[0]["s"], t.elements.s)
    assert 0 < np.count_nonzero(t.elements.eps_p) < m
