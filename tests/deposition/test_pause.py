"""The closing stage: free bodies contract by their alpha(T), bonded ones keep a stress, and its parts are told apart."""

import json
import signal
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import scenes
from runs import SharedRuns, assert_same_files
from scenes import COLD

from coupler import Scene
from coupler.commands.main import main
from coupler.deposition import fold, joining, task
from coupler.deposition import pause as closing_stage
from coupler.deposition import run as deposition
from coupler.deposition.pause import AT_AMBIENT, COOLINGS, cool_to_ambient
from coupler.deposition.summary import unsettled
from coupler.errors import SolverError
from coupler.fe import mesh as meshes
from coupler.fe.explicit import Target
from coupler.files.result import Result
from coupler.geometry.mesher import box
from coupler.geometry.tetrahedra import volumes
from coupler.impact.ending import HELD_STILL, EndCriterion
from coupler.physics.adhesion import Adhesion
from coupler.physics.constitutive import law_record
from coupler.physics.materials import Material, material
from coupler.target.bodies import Bodies
from coupler.target.domain import BodyState
from coupler.target.equilibrium import COOLED, settle

NI, STEEL = material("Ni"), material("SS304")
STIFF_BASE = replace(STEEL, G=20 * STEEL.G, c0=np.sqrt(20) * STEEL.c0, rho=STEEL.rho)
ORIGIN = (0.0, 0.0, 0.0)
CAME, WARM, AMBIENT = 600.0, 700.0, 300.0  # K


def coated(metal: Material, base: Material, kind: str, high: float = 0.0) -> Bodies:
    """A plate 30 x 30 x 3 um of a metal at WARM, `high` m above a block of a base at AMBIENT."""
    points, tets = box((60e-6, 60e-6, 40e-6), 6e-6)
    mesh = meshes.prepare(points - np.array([30e-6, 30e-6, 40e-6]), tets)
    target = Target(mesh, law_record(base, rate_filter=1e-9), AMBIENT, track_wave=False)
    bodies = Bodies(target, np.zeros(len(mesh.conn), np.int32), ("bottom",), (), 0.3)
    points, tets = box((30e-6, 30e-6, 3e-6), 3e-6)
    low = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]]) < 0
    tets[low, 2:] = tets[low, 2:][:, ::-1]
    points = points + np.array([-15e-6, -15e-6, high])
    n, m = len(points), len(tets)
    heat = metal.rho * metal.cp_at(0.5 * (CAME + WARM)) * (WARM - CAME)  # J/m3, since it was without stress
    law = law_record(metal, rate_filter=1e-9)
    plate = BodyState(
        points, tets, np.zeros((m, 6)), np.full(m, 1.0 + metal.Gamma0 * heat / metal.K),
        np.zeros((n, 3)), np.full(n, heat), metal.rho * float(volumes(points, tets).sum()), law,
        eps_p=np.zeros(m), T=np.full(m, WARM), eps_gradient=np.zeros((m, 3)),
    )  # fmt: skip
    return bodies.joined([plate], Adhesion(kind=cast(Any, kind)), 3e-6, ORIGIN, None, 1)


def planned(metal: Material, base: Material, recovers: bool = False) -> Any:
    impact = SimpleNamespace(material=metal, materials=(metal,), temperature=CAME, diameter=25e-6)
    target = SimpleNamespace(material=base, materials=(base,), temperature=AMBIENT)
    effects = SimpleNamespace(recovery=recovers)
    known = {
        "target": target,
        "adhesion": Adhesion("none"),
        "effects": effects,
        "cooling_time": 60.0 if recovers else 0.0,
    }
    return SimpleNamespace(ambient=AMBIENT, impacts=[impact], **known)


def stiff(metal: Material, alpha: float) -> Material:
    """A metal that does not yield here."""
    strong = replace(metal.strength, numbers=metal.strength.numbers | {"A": 1e11})
    return replace(metal, thermal_expansion=((300.0, alpha),), strength=strong)


def test_what_cools_slowly_recovers_and_is_relieved_and_keeps_its_plastic_strain() -> None:
    """Cold-worked aluminium of a strain of 1 on a stiff base, 60 s from 700 K: it bears what annealed metal bears after the
    strain of the contraction alone; steel does not recover."""
    metal, stress = material("Al1100"), []
    for recovers in (False, True):
        bodies = coated(metal, STIFF_BASE, "tied")
        e = bodies.target.elements
        e.eps_p[:] = 1.0
        e.sigma_y[:] *= 3.0  # about
        bodies, _ = cool_to_ambient(planned(metal, STIFF_BASE, recovers), bodies, 1e-9)
        e, plate = bodies.target.elements, bodies.body == 1
        stress.append(float(np.sqrt(1.5 * np.mean(np.sum(e.s[plate, :3] ** 2, axis=1)))))
        assert (e.eps_recovered[~plate] == 0.0).all()
        assert e.plastic_strain[plate].min() >= 1.0 - 1e-9
        assert (e.eps_recovered[plate] > 0.99).all() if recovers else (e.eps_recovered[plate] == 0.0).all()
        assert (e.eps_p[plate] < 0.1).all() == recovers
        assert stress[-1] == pytest.approx(metal.flow_stress(float(e.eps_p[plate].mean()), 0.0, AMBIENT), rel=0.1)
    assert stress[1] < 0.7 * stress[0]


@pytest.mark.parametrize("alpha", [16e-6, 0.0])
def test_a_free_body_contracts_by_its_alpha_and_is_without_stress(alpha: float) -> None:
    """From the temperature that it came with, whatever heated it since; without alpha by Gamma0 rho c_p / K."""
    metal = stiff(NI, alpha)
    bodies = coated(metal, STEEL, "none", high=8e-6)
    own = np.unique(bodies.target.mesh.conn[bodies.body == 1])
    before = np.ptp(bodies.target.nodes.x[own], axis=0)
    bodies, report = cool_to_ambient(planned(metal, STEEL), bodies, 1e-6)
    t = bodies.target
    np.testing.assert_allclose(t.elements.T, AMBIENT, atol=1e-5)
    # it arrives as long as WARM has made it, so that the length it came with is that less its expansion since
    by_heat = metal.Gamma0 * metal.rho * metal.cp_at(450.0) / (3 * metal.K)
    since = metal.Gamma0 * metal.rho * metal.cp_at(650.0) * (WARM - CAME) / (3 * metal.K)
    strain = np.ptp(t.nodes.x[own], axis=0) / before - 1.0
    assert strain[:2] == pytest.approx((alpha or by_heat) * (AMBIENT - CAME) - since, rel=0.03)
    own = bodies.body == 1
    stress = np.average(t.stress()[own, :2].mean(axis=1), weights=t.elements.volume[own])
    assert abs(stress) < 4e6  # of a pressure of 2.5 GPa that the heat alone would leave
    assert report["T_max_before_K"] == pytest.approx(WARM)


def test_a_preheated_substrate_cools_as_one_and_none_of_it_flows() -> None:
    """Soft at 700 K, it would yield at a tenth of the pressure that its contraction or its heat alone makes."""
    metal = material("Al1100")
    points, tets = box((60e-6, 60e-6, 40e-6), 10e-6)
    mesh = meshes.prepare(points - np.array([30e-6, 30e-6, 40e-6]), tets)
    target = Target(mesh, law_record(metal, rate_filter=1e-9), WARM, track_wave=False)
    bodies, plan = Bodies(target, np.zeros(len(tets), np.int32), ("bottom", "sides"), (), 0.3), planned(metal, metal)
    plan.impacts, plan.target.temperature = [], WARM
    bodies, _ = cool_to_ambient(plan, bodies, 1e-9)
    t = bodies.target
    assert np.ptp(t.nodes.x, axis=0) / np.ptp(mesh.points, axis=0) == pytest.approx(
        1.0 - 23.1e-6 * (WARM - AMBIENT), rel=1e-9
    )
    assert t.elements.eps_p.max() == 0.0
    assert np.abs(t.stress()).max() < 2e6


def test_a_bonded_plate_keeps_the_stress_of_its_contraction() -> None:
    """In the middle of a thin plate on a stiff base E alpha dT / (1 - nu), less what the base gives way; all of it is thermal."""
    metal, base = stiff(NI, 13e-6), STIFF_BASE
    bodies = coated(metal, base, "tied")
    for _ in range(6):  # what is out of balance before is none of the cooling's
        settle(bodies, 1e-6, 0.0, COOLED)
    started = bodies.target.stress()
    cool_to_ambient(planned(metal, base), bodies, 1e-6)
    t = bodies.target
    x = t.nodes.x[t.mesh.conn].mean(axis=1)
    middle = (bodies.body == 1) & (np.hypot(x[:, 0], x[:, 1]) < 6e-6)
    sigma = float(np.average(t.stress()[middle, :2].mean(axis=1), weights=t.elements.volume[middle]))
    heat = metal.Gamma0 * metal.rho * metal.cp_at(650.0) * (WARM - CAME) / (3 * metal.K)
    full = metal.E / (1 - metal.nu) * (13e-6 * (CAME - AMBIENT) + heat)
    assert 0.75 * full < sigma < 1.02 * full
    np.testing.assert_allclose(t.stress() - t.elements.thermal_stress, started, atol=1e-5 * full)


def test_bodies_yield_as_in_slower_cooling() -> None:
    """A change of temperature that comes too suddenly lets stresses overshoot, and the base yields more."""
    plastic = []
    for ramp in (COOLED.ramp, 10 * COOLED.ramp):
        metal, base = stiff(NI, 13e-6), STIFF_BASE
        bodies = coated(metal, base, "tied")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(closing_stage, "COOLED", COOLED._replace(ramp=ramp))
            cool_to_ambient(planned(metal, base), bodies, 1e-6)
        plastic.append(float(bodies.target.elements.eps_p @ bodies.target.elements.volume))
    assert plastic[0] == pytest.approx(plastic[1], rel=0.15)


def test_what_yields_as_it_cools_ends_at_ambient_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tied plate of nickel shrinks by 1.2 % and its base does not: it yields, and a second cooling takes away the heat of that.

    By 0.9 x 350 MPa x 2.4 % / (4 MJ/m3K), some 2 K; the second time it shrinks by 1e-4 of that strain only.
    """
    metal = replace(NI, thermal_expansion=((300.0, 40e-6),))
    base = replace(STIFF_BASE, strength=stiff(STEEL, 0.0).strength)
    for most, coldest, warmest in ((1, AT_AMBIENT, 5.0), (COOLINGS, 0.0, AT_AMBIENT)):
        monkeypatch.setattr(closing_stage, "COOLINGS", most)
        bodies = coated(metal, base, "tied")
        _, report = cool_to_ambient(planned(metal, base), bodies, 1e-6)
        assert report["off_ambient_K"] == np.abs(bodies.target.elements.T - AMBIENT).max()
        assert coldest < report["off_ambient_K"] < warmest
        assert bool(unsettled(report)) == (most == 1)


COLD_AT_LIMIT = scenes.COLD.replace('at = "cold"', 'time = "6 ns"')


def test_a_sequence_ends_cold_with_all_splats_as_bodies(shared_run: SharedRuns, tmp_path: Path) -> None:
    result: Result = shared_run(COLD)
    (first, last), closing = result.summary["joins"], result.summary["closing"]
    assert first["cooling"]["time_s"] > 1e-3
    assert first["cooling"]["T_max_after_K"] < 305.0
    assert list(first["seconds"]) == ["impacts", "conduction", "equilibria", "bodies"]
    assert min(first["seconds"].values()) > 0.0
    assert last["bodies"] == 1
    assert all(impact["at_end"] is not None for impact in result.impacts)
    cold = result.fields(-1, "cold")
    assert cold.data["body"].max() == 2
    np.testing.assert_allclose(cold.data["T"], 300.0, atol=AT_AMBIENT)  # what flows as it cools warms
    assert closing["ambient_K"] == 300.0
    thermal = np.abs(cold.data["thermal_stress"]).max(axis=1)
    assert thermal[cold.data["body"] > 0].mean() > 5 * thermal[cold.data["body"] == 0].mean()
    assert json.dumps(closing)


def test_a_run_ended_in_its_closing_stage_goes_on_from_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last impact cannot be meshed and is skipped; the run ends as the bodies cool."""

    def join(impact: Any, *more: Any) -> Any:
        if impact.domains.i > 0:
            raise SolverError("the cloud has a hole")
        return true_join(impact, *more)

    def cool(*_: Any) -> Any:
        raise KeyboardInterrupt

    true_join = task.join
    monkeypatch.setattr(task, "join", join)
    true_cool = fold.cool_to_ambient
    monkeypatch.setattr(fold, "cool_to_ambient", cool)
    with pytest.raises(KeyboardInterrupt):
        deposition.run(Scene.from_text(COLD, "cold"), tmp_path, force=True, quiet=True, skip_failed=True)
    monkeypatch.setattr(fold, "cool_to_ambient", true_cool)
    result = deposition.resume(tmp_path, quiet=True, skip_failed=True)
    assert len(result.impacts) == 1
    assert "particle 2 of the scene's sequence was skipped" in result.summary["run"]["warnings"][0]
    assert result.summary["closing"]["ambient_K"] == 300.0


@pytest.mark.parametrize(
    "text", [pytest.param(COLD, marks=pytest.mark.slow), COLD_AT_LIMIT], ids=["at rest", "at a time limit"]
)
def test_a_signal_between_impacts_ends_a_run_that_can_go_on(
    shared_run: SharedRuns,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    text: str,
) -> None:
    """The impact before the signal is over: it does not go on beyond its own end, the time limit included."""
    scene, out, true_pause = tmp_path / "cold.toml", tmp_path / "out", joining.pause
    scene.write_text(text)

    def pause(*_: Any) -> Any:
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(joining, "pause", pause)
    assert main(["run", str(scene), "--out", str(out), "--checkpoint", "0.1", "-q"]) == 143
    assert f"continue with coldspray resume {out}" in capsys.readouterr().err
    monkeypatch.setattr(joining, "pause", true_pause)
    assert main(["resume", str(out), "-q"]) == 0
    assert_same_files(shared_run(text), Result(out))


def test_a_particle_that_slides_off_is_lost_and_the_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second of three has left over the rim: it has rebounded although the scene ties what touches, and nothing is skipped."""
    text = scenes.scene(
        ("Ni", 20, 500), ("Ti", 20, 450), ("Ni", 20, 550), **scenes.TINY | {"spacing": 2.7, "element_size": 5.0}, end=6
    )
    monkeypatch.setattr(EndCriterion, "slid_off", lambda self, _: self.held_slow == HELD_STILL * 450.0)
    result = deposition.run(Scene.from_text(text, "rim"), tmp_path / "out", quiet=True)
    impacts = result.summary["impacts"]
    assert [impact["rebounded"] for impact in impacts] == [None, True, None]  # the others are still in motion at 6 ns
    assert "over the rim" in impacts[1]["verdict_rests_on"]
    assert impacts[1]["undecided"] is None
    assert [join["rebounded"] for join in result.summary["joins"]] == [False, True]


@pytest.mark.parametrize("how", ["fails", "fails, resumed", "undecided"])
def test_an_impact_that_fails_can_be_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    """The second of three cannot be meshed, or has no end: without it the run goes on, at once or resumed, and says so."""
    text = scenes.scene(
        ("Ni", 20, 500), ("Ti", 20, 450), ("Ni", 20, 550), **scenes.TINY | {"spacing": 2.7, "element_size": 5.0}, end=6
    )
    true_join, true_impact = task.join, task.run_impact
    reason = "not at rest at its time limit" if how == "undecided" else "the cloud has a hole"

    def join(impact: Any, *more: Any) -> Any:
        if impact.domains.own.material.name == "Ti":
            raise SolverError(reason)
        return true_join(impact, *more)

    def run_impact(plan: Any, i: int, *more: Any) -> Any:
        impact, record = true_impact(plan, i, *more)
        if plan.impacts[i].material.name == "Ti":
            record.values["undecided"] = reason
        return impact, record

    name, function = ("run_impact", run_impact) if how == "undecided" else ("join", join)
    monkeypatch.setattr(task, name, function)
    scene, out = Scene.from_text(text, "skip"), tmp_path / "out"
    if how.endswith("resumed"):
        with pytest.raises(SolverError):
            deposition.run(scene, out, quiet=True, checkpoint_every=0.0)
        result = deposition.resume(out, quiet=True, skip_failed=True)
    else:
        result = deposition.run(scene, out, quiet=True, skip_failed=True)
    assert [impact["material"] for impact in result.impacts] == ["Ni", "Ni"]
    assert result.summary["run"]["warnings"][0] == f"particle 2 of the scene's sequence was skipped: {reason}"
    assert list(np.unique(result.history("impact"))) == [1.0, 2.0]
    assert len(result.summary["joins"]) == 1
