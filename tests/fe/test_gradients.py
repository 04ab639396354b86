"""Hardening by gradients of plastic strain: the flow stress, the gradient in both domains, whole impacts with it."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from runs import assert_same_files, assert_same_numbers, break_off
from scenes import TINY, WHOLE, scene

from coupler import Result, Scene, run
from coupler.deposition.joining import cloud_of
from coupler.deposition.run import resume
from coupler.errors import SceneError
from coupler.fe import mesh
from coupler.fe.explicit import Target
from coupler.fe.gradients import growing
from coupler.geometry import mesher
from coupler.impact.exchange import Impact
from coupler.particle import packing
from coupler.particle.compiled_kernels import grow_gradients
from coupler.particle.engine import ENGINES
from coupler.particle.model import Deformation
from coupler.physics import constitutive
from coupler.physics.dislocations import NYE_FACTOR
from coupler.physics.materials import Material, from_table, material
from coupler.plan.cost import STRAIN_OF_FLOW
from coupler.plan.model import Decision
from coupler.plan.planning import plan
from coupler.progress import Progress

D = 25e-6
SLOPE = np.array([3e4, -2e4, 5e4])  # 1/m
QUIET = Progress(quiet=True)
HARDENED = 'effects = ["auto", "+gradient_hardening"]\n'
ON = {"gradient_hardening": True}
EXPOSED = '[adhesion]\nkind = "cohesive"\ncriterion = "exposure"\n'


def nickel(alpha: float = 0.35) -> Material:
    return from_table("Ni", {"taylor_alpha": alpha}, material("Ni"))


def taylor(density: float) -> float:
    """Flow stress of nickel, Pa, with so many dislocations per m2; their coefficient is .35 at 1e12 and falls by the line tension."""
    y = 0.2492e-9 * np.sqrt(density)
    share = np.log(0.35 * y) / np.log(0.35 * 0.2492e-9 * 1e6)
    return float(3.06 * 76e9 * y * 0.35 * (0.2 + 0.8 * share))


def test_dislocations_of_gradients_add_to_the_others() -> None:
    """r eta / b of them per area."""
    metal, eta = nickel(), 4e5
    law = constitutive.law_record(metal, ON)[0]
    of_gradient = 1.9 * eta / 0.2492e-9
    assert taylor(1e12) == pytest.approx(3.06 * 0.35 * 76e9 * 0.2492e-9 * 1e6)
    assert 0.58 < taylor(1e16) / (1e2 * taylor(1e12)) < 0.62
    for random in (1e13, 1e15, 2e16):
        both = taylor(random + of_gradient)
        assert constitutive.with_gradient(law, taylor(random), eta, 300.0) == pytest.approx(both, rel=1e-9)
        hot = constitutive.with_gradient(law, 0.75 * taylor(random), eta, 300.0 + 0.5 * metal.T_m)
        assert hot == pytest.approx(0.75 * both, rel=1e-9)  # G falls by a quarter
    for sigma in (1e3, 50e6, 5e9):
        assert constitutive.with_gradient(law, sigma, 0.0, 300.0) == sigma
        assert sigma < constitutive.with_gradient(law, sigma, eta, 300.0) < sigma + taylor(of_gradient)
    assert constitutive.with_gradient(law, 0.0, eta, 2000.0) == 0.0  # a liquid
    assert constitutive.with_gradient(law, 1e6, eta, 300.0 + 3.0 * metal.T_m) == 1e6  # no modulus is left


@pytest.mark.parametrize(
    ("case", "error"), [("single crystal (111), annealed", 0.06), ("polycrystal, cold worked", 0.13)]
)
def test_indents_are_as_hard_as_measured(case: str, error: float) -> None:
    """The law where it is measured, far from impacts: H = 3 sigma, with 3/2 tan^2 / (b h) dislocations per area under the indenter.

    Each loop counts once (Nix & Gao): r = 1 in place of that of polycrystals in impacts.
    """
    measured = tomllib.loads((Path(__file__).parents[1] / "data/references.toml").read_text())["indents_copper"]
    values, metal = measured["results"][case], from_table("Cu", {"taylor_alpha": 0.35}, material("OFHC_Cu"))
    law = constitutive.law_record(metal, ON)[0]
    for h in measured["depths"]:
        eta = 1.5 * measured["tangent"] ** 2 / h / NYE_FACTOR
        computed = 3.0 * constitutive.with_gradient(law, values["H0"] / 3.0, eta, 293.0)
        assert computed == pytest.approx(values["H0"] * np.sqrt(1.0 + values["depth"] / h), rel=error)


def test_without_thermal_softening_the_modulus_stays() -> None:
    law = constitutive.law_record(nickel(), ON | {"thermal_softening": False})[0]
    assert constitutive.with_gradient(law, 1e8, 4e5, 1200.0) == constitutive.with_gradient(law, 1e8, 4e5, 300.0)


def test_a_plastic_step_takes_it() -> None:
    deps, dt = 1e-3, 1e-11
    law, plain = constitutive.law_record(nickel(), ON)[0], constitutive.law_record(material("Ni"))[0]
    state = (1.0, 2e8, 2e8, 0.3, 1e7, 400.0)
    eps_p, rate, T, sigma_y, _ = constitutive.harden(law, deps, dt, *state, 3e5)
    assert sigma_y == constitutive.with_gradient(law, constitutive.yield_stress(law, eps_p, rate, T), 3e5, T)
    assert constitutive.harden(law, deps, dt, *state, 0.0) == constitutive.harden(plain, deps, dt, *state, 3e5)


@pytest.fixture(scope="module")
def target() -> Target:
    points, tets = mesher.box((8e-6, 8e-6, 8e-6), 1e-6)
    return Target(mesh.prepare(points, tets), constitutive.law_record(nickel(), ON), 300.0, fixed=(), track_wave=False)


def turned(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])


def grown(t: Target, F: np.ndarray) -> np.ndarray:
    """Gradient (m,3) of a strain that grows linearly over the reference, in a target that is deformed by F."""
    X = t.mesh.points
    t.nodes.x[:], t.elements.eps_gradient[:], t.elements.eps_p[:] = X @ F.T, 0.0, 0.2
    with growing(t):
        t.elements.eps_p[:] += 1.0 + X[t.mesh.conn].mean(axis=1) @ SLOPE
    return t.elements.eps_gradient.copy()


def test_elements_see_a_linear_strain(target: Target) -> None:
    """Within the block; at its faces the averages of one side are those of a place inside."""
    centre = target.mesh.points[target.mesh.conn].mean(axis=1)
    inner = (np.abs(centre - centre.mean(axis=0)) < 2.2e-6).all(axis=1)
    got = grown(target, np.eye(3))[inner]
    assert np.count_nonzero(inner) > 50
    assert got.mean(axis=0) == pytest.approx(SLOPE, rel=0.05)
    with growing(target):
        target.elements.eps_p[:] += 0.3  # alike everywhere
    assert target.elements.eps_gradient[inner] == pytest.approx(got, abs=1e-3)


def test_elements_take_the_gradient_where_they_are(target: Target) -> None:
    """Turned it is the same, to rounding; in a body that is stretched by two a half."""
    plain, R = grown(target, np.eye(3)), turned(0.7)
    assert grown(target, R) == pytest.approx(plain, rel=1e-9, abs=1e-6)
    stretched = np.diag([2.0, 0.5, 1.0])
    assert grown(target, R @ stretched) == pytest.approx(plain / np.diag(stretched), rel=1e-9, abs=1e-6)


def test_a_metal_without_it_keeps_none() -> None:
    points, tets = mesher.box((4e-6, 4e-6, 4e-6), 1e-6)
    t = Target(mesh.prepare(points, tets), constitutive.law_record(material("Ni")), 300.0, fixed=(), track_wave=False)
    assert not grown(t, np.eye(3)).any()


@pytest.mark.parametrize("engine", ["compiled", "enriched"])
def test_points_see_a_linear_strain(engine: str) -> None:
    """Exactly, at the rim too; turned and stretched as elements do."""
    cloud, volume = packing.sphere(D, 300)
    p = ENGINES[engine](cloud, volume, constitutive.law_record(nickel(), ON), (0.0, 0.0, 0.0), 300.0)
    R, stretched = turned(0.7), np.diag([2.0, 0.5, 1.0])
    for rotation, F in ((np.eye(3), np.eye(3)), (R, R), (R, R @ stretched)):
        out = np.zeros((p.n, 3))
        rows = [np.tile(A.ravel(), (p.n, 1)) for A in (F, rotation)]
        grow_gradients(p.n, 1.0 + p.X @ SLOPE, p._sides, Deformation(*rows, np.empty(0)), out)
        U = rotation.T @ F
        assert out == pytest.approx(np.tile(np.linalg.solve(U, SLOPE), (p.n, 1)), rel=1e-6)
    p.points.eps_gradient[:] = SLOPE
    p.points.R[:] = R.ravel()
    assert p.carried()["eps_gradient"] == pytest.approx(np.tile(R @ SLOPE, (p.n, 1)))
    p.close()


@pytest.fixture(scope="module")
def hardened(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return run(Scene.from_text(HARDENED + WHOLE, "shared"), tmp_path_factory.mktemp("whole") / "out", progress=QUIET)


def test_gradients_harden_an_impact(hardened: Result, tmp_path: Path) -> None:
    """The particle flattens less and rebounds faster; the ledger closes."""
    plain = run(Scene.from_text(WHOLE, "shared"), tmp_path / "plain", progress=QUIET)
    (soft,), (hard,) = plain.impacts, hardened.impacts
    assert hard["end"]["flattening_ratio"] < 0.985 * soft["end"]["flattening_ratio"]
    assert hard["end"]["eps_p_mean"] < 0.97 * soft["end"]["eps_p_mean"]
    assert hard["restitution"] > 1.03 * soft["restitution"]
    assert abs(hard["energy_drift"]) < 5e-3


@pytest.mark.slow
def test_it_goes_on_as_if_nothing_had_happened(hardened: Result, tmp_path: Path) -> None:
    text = HARDENED + WHOLE
    break_off(Scene.from_text(text, "shared"), tmp_path / "out", at=15e-9)
    other = resume(tmp_path / "out", progress=QUIET)
    assert_same_numbers(hardened.summary, other.summary, rel=1e-9)
    assert_same_files(hardened, other)


def test_a_splat_keeps_its_gradients(tmp_path: Path) -> None:
    """As a body it has those that its points had, in the mean, and none where the metal has none."""
    text = HARDENED + scene(("Ni", 25, 500), ("Ni", 25, 450), **TINY, end=15, every=20)
    seen: list[tuple[np.ndarray, np.ndarray]] = []

    def probe(impact: Impact) -> None:
        if impact.bodies.count == 1:
            seen[:] = [(cloud_of(impact.domains).eps_gradient, impact.particle.mass)]
        elif len(seen) == 1:
            own = impact.bodies.body == 1
            seen.append((impact.target.elements.eps_gradient[own], impact.target.mesh.V0[own]))
            assert not impact.target.elements.eps_gradient[~own].any()  # steel, as the library has it

    run(Scene.from_text(text, "double"), tmp_path / "out", progress=QUIET, probe=probe)
    (points, mass), (elements, volume) = seen
    before, after = np.average(points, axis=0, weights=mass), np.average(elements, axis=0, weights=volume)
    assert np.linalg.norm(after - before) < 0.15 * np.linalg.norm(before)


def test_it_is_on_where_bonds_form_by_exposure_or_the_scene_says_so() -> None:
    def row(text: str) -> Decision:
        rows = plan(Scene.from_text(text)).decisions
        return next(row for row in rows if row.name == "gradient_hardening")

    exposed = WHOLE.replace("SS304", "Ni") + EXPOSED
    assert row(exposed).on
    # of a plastic strain that changes by 1 over a tenth of the diameter
    of_gradient = taylor(1.9 * (10.0 / D) / 0.2492e-9)
    flow_stress = material("Ni").flow_stress(STRAIN_OF_FLOW, 500.0 / D, 300.0)
    assert row(exposed).value == pytest.approx(np.hypot(1.0, of_gradient / flow_stress) - 1.0)
    without = WHOLE.replace("SS304", "Ni")
    assert not row(without).on
    assert row(without).value == row(exposed).value
    assert row(without).why == "by default only with bonds by exposure"
    assert row(HARDENED + WHOLE).on
    for off in ('effects = ["auto", "-gradient_hardening"]\n', 'effects = "none"\n'):
        assert not row(off + exposed).on
    assert not row(exposed + "[materials.Ni]\ntaylor_alpha = 0.0\n").on
    machdyn = exposed.replace("[resolution]\n", '[resolution]\nengine = "machdyn"\n')
    assert not row(machdyn).on
    assert not row('effects = "all"\n' + machdyn).on
    assert any("the effect gradient_hardening is off" in text for text in plan(Scene.from_text(machdyn)).warnings)


def test_what_it_needs_is_said() -> None:
    def problems(text: str) -> str:
        with pytest.raises(SceneError) as caught:
            plan(Scene.from_text(text))
        return str(caught.value)

    assert "burgers" in problems(WHOLE + "[materials.SS304]\ntaylor_alpha = 0.35\n")
    titanium = HARDENED + WHOLE.replace('"Ni"', '"Ti"')
    assert "gradient_hardening needs taylor_alpha and burgers of SS304 or Ti" in problems(titanium)
    machdyn = HARDENED + WHOLE.replace("[resolution]\n", '[resolution]\nengine = "machdyn"\n')
    assert "use enriched or compiled" in problems(machdyn)
