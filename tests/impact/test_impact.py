"""One impact, whole: from a scene to files, coarse enough to run in seconds."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from runs import SharedRuns
from scenes import NI, SHORT

from coupler import Result, Scene, run
from coupler.commands.main import main
from coupler.errors import SolverError, StoreError
from coupler.geometry.points import depths
from coupler.geometry.rough import heights
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.plan.planning import plan
from coupler.report.picture import section_picture
from coupler.target.positions import heights_at


@pytest.fixture(scope="module")
def result(shared_run: SharedRuns) -> Result:
    return shared_run(NI)


def test_ledger_closes(result: Result) -> None:
    s = result.values
    assert abs(s["energy_drift"]) < 5e-3
    assert s["momentum_error"] < 1e-10
    e = s["energies"]
    assert e["friction"] > 0
    assert e["plastic_particle"] > 0.2
    assert e["plastic_target"] > 0.2
    assert 0 < s["numerical_dissipation"] < 0.2
    parts = [e[f"{name}_particle"] for name in ("viscosity", "hourglass", "unexplained")]
    assert sum(parts) == pytest.approx(e["numerical_particle"], abs=1e-12)
    assert parts[0] > 0.01
    assert parts[1] == 0.0  # the default scheme has no hourglass control
    assert abs(parts[2]) < 0.003
    assert s["dissipation_of_plastic"] == pytest.approx(e["numerical_particle"] / e["plastic_particle"])
    assert any("of the plastic work, more than 5%" in text for text in s["warnings"])
    whole = sum(
        e[k] for k in ("kinetic", "elastic_particle", "elastic_target", "plastic_particle", "plastic_target", "numerical_particle",
                       "numerical_target", "contact", "friction", "boundary")
    )  # fmt: skip
    assert whole == pytest.approx(1 + s["energy_drift"], abs=1e-9)


def test_the_summary_says_what_was_measured(result: Result) -> None:
    named = """
        flattening_ratio flattening_ratio_total crater_depth_m splat_diameter_m eps_p_mean eps_p_p99 eps_p_max T_mean_K T_p99_K T_max_K
        von_mises_max_Pa rebound_velocity_m_s energy_drift momentum_error numerical_dissipation points elements steps dt_mean_s
        sim_time_s wall_s effects version
    """.split()  # noqa: SIM905
    assert not set(named) - set(result.values)
    (only,) = result.impacts
    assert not only.keys() & only["end"].keys(), "each number stands once"
    assert only["refused"] == {}
    g, e = result.greatest, result.end
    assert 20e-9 < g["time_s"] < e["time_s"] == result.sim_time_s
    assert g["flattening_ratio"] == pytest.approx(1 - g["height_m"] / 25e-6)
    # coarse as it is, the splat is a splat: bounds far wider than the band of the resolution, far narrower than nonsense
    assert 0.45 < result.flattening_ratio < 0.65
    assert 3.5e-6 < result.crater_depth_m < 7.5e-6
    assert 29e-6 < result.splat_diameter_m < 38e-6
    assert 300 < result.T_mean_K < result.T_p99_K <= result.T_max_K < 1726
    # adiabatic: mean heating is that of plastic work and of the scheme's losses over the heat capacity, friction's added
    e = result.energies
    losses = e["viscosity_particle"] + e["hourglass_particle"]
    heat = (0.9 * e["plastic_particle"] + losses) * result.kinetic_energy_0_J
    mass = 8906 * np.pi / 6 * 25e-6**3
    assert 300 + heat / (mass * 470) == pytest.approx(result.T_mean_K, rel=0.02)


def test_history_and_fields_are_there(result: Result) -> None:
    kinetic = result.history("kinetic")
    assert kinetic[0] > 0.95 * result.kinetic_energy_0_J
    assert kinetic[-1] < 0.05 * result.kinetic_energy_0_J
    assert np.all(np.diff(result.history("time")) > 0)
    plastic = result.history("plastic_particle")
    assert np.all(np.diff(plastic) >= 0)
    f = result.fields(-1)
    assert f.points.shape == (result.points, 3)
    assert f.data["T"].max() == pytest.approx(result.T_max_K, rel=1e-6)
    t = result.fields(-1, "target")
    assert t.data["stress"].shape == (result.elements, 6)
    assert len(result.times("target")) > 10
    # the impact is straight: no preferred side
    middle = np.average(f.points, axis=0)
    assert np.abs(middle[:2]).max() < 0.02 * 25e-6


def test_section_picture_is_made(result: Result, tmp_path: Path) -> None:
    assert section_picture(result, tmp_path / "section.png").stat().st_size > 20_000


def test_a_finished_run_is_not_overwritten(result: Result) -> None:
    with pytest.raises(StoreError, match="--force"):
        run(Scene.from_text(NI, "coarse"), result.directory)


def test_oblique_impact_pushes_sideways_and_closes(tmp_path: Path) -> None:
    text = NI.replace('velocity = "500 m/s"', 'velocity = "400 m/s"\nangle = "45 deg"') + '[end]\ntime = "25 ns"\n'
    s = run(Scene.from_text(text, "oblique"), tmp_path / "o")
    assert s.sim_time_s == pytest.approx(25e-9, rel=1e-9)
    assert abs(s.energy_drift) < 5e-3
    assert s.momentum_error < 1e-10
    v = np.average(s.fields(-1).data["velocity"], axis=0)
    assert v[0] > 50  # still going sideways
    assert v[0] < 400 * np.sin(np.pi / 4) * 0.98  # and slowed by friction


def test_a_slow_hard_particle_rebounds(tmp_path: Path) -> None:
    text = NI.replace('"Ni"', '"Ti"').replace("500 m/s", "100 m/s")
    s = run(Scene.from_text(text, "ti"), tmp_path / "ti")
    assert 5 < s.rebound_velocity_m_s < 60
    assert s.history("contact_force")[-1] == 0.0
    later = run(Scene.from_text(f'{text}[end]\ntime = "{2e9 * s.sim_time_s} ns"\n', "later"), tmp_path / "later")
    # its shape is that with which it left, but for the elastic vibration: in the same time it rises by a tenth of its diameter
    assert later.flattening_ratio == pytest.approx(s.flattening_ratio, abs=0.01)


def test_effects_that_are_off_are_off(tmp_path: Path) -> None:
    text = 'effects = ["auto", "-friction", "-plastic_heating", "-dissipation_heat"]\n' + NI + '[end]\ntime = "8 ns"\n'
    s = run(Scene.from_text(text, "few"), tmp_path / "few")
    assert s.energies["friction"] == 0.0
    assert s.T_max_K == pytest.approx(300.0)
    assert "friction" not in s.effects


def test_a_ledger_that_does_not_close_is_not_a_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from coupler.impact import ledger

    monkeypatch.setattr(ledger, "DRIFT_BOUND", 1e-9)
    with pytest.raises(SolverError, match="energy is not conserved"):
        run(Scene.from_text(SHORT.replace('"10 ns"', '"5 ns"'), "open"), tmp_path / "open")
    assert not (tmp_path / "open" / "summary.json").exists()
    assert len(Result(tmp_path / "open").times("target")) > 1  # what was computed stays readable


def test_points_that_the_contact_has_lost_are_no_result(tmp_path: Path) -> None:
    """Three per cent of the points far inside the target end a run; half a per cent does not."""

    def lose(share: float) -> None:
        def probe(impact: Impact) -> None:
            impact.check_contact()
            x = impact.particle.x
            x[: round(share * len(x))] = impact.target.nodes.x.mean(axis=0)
            impact.check_contact()
            raise KeyboardInterrupt

        run(Scene.from_text(SHORT, "lost"), tmp_path / "out", probe=probe, force=True)

    with pytest.raises(KeyboardInterrupt):
        lose(0.005)
    with pytest.raises(SolverError, match=r"\d+ of \d+ points of the particle have passed"):
        lose(0.03)


def test_depths_in_a_cube() -> None:
    """Of a place in a cube of 6 x 6 x 6 cells: the distance from its faces; outside it is 0."""
    axis = np.arange(7.0)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    cell = np.array([0, 1, 7, 8, 49, 50, 56, 57])
    tets = cell[np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])]
    corners = [49 * i + 7 * j + k for i in range(6) for j in range(6) for k in range(6)]
    mesh = np.concatenate([tets + c for c in corners])
    x = np.array([[3.0, 3.3, 2.0], [3.3, 3.3, 5.5], [3.0, 3.0, -0.5], [9.0, 0.0, 0.0]])
    assert depths(x, points, mesh) == pytest.approx([2.0, 0.5, 0.0, 0.0], abs=1e-5)  # single precision of the size
    assert depths(x, points, mesh, least=1.0) == pytest.approx([2.0, 0.0, 0.0, 0.0], abs=1e-5)


def test_depth_below_a_stretched_facet_is_that_below_its_plane() -> None:
    """A point just under the middle of a facet of edge 10 lies 0.1 deep, however far the nodes of the facet are."""
    corners = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [5.0, 8.66, 0.0], [5.0, 2.887, -8.0]])
    below = np.array([[5.0, 2.887, -0.1]])
    assert depths(below, corners, np.array([[0, 2, 1, 3]])) == pytest.approx([0.1], abs=1e-5)


def test_whole_run_through_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "tiny.toml"
    scene.write_text(SHORT)
    command = [sys.executable, "-m", "coupler", "run", str(scene), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "flattening" in done.stdout
    assert (tmp_path / "out" / "section.png").stat().st_size > 20_000
    assert "ns" in done.stderr  # plain progress lines where there is no terminal
    log = (tmp_path / "out" / "run.log").read_text()
    for words in (
        "python -m coupler run",
        "thermal_softening",
        "meshing the target",
        "remaining kinetic energy",
        "highest temperature",
    ):
        assert words in log
    assert ">>====" not in done.stdout  # LAMMPS's own chatter
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["run"]["steps"] > 20
    rows = list(csv.DictReader((tmp_path / "out" / "history.csv").open()))
    assert float(rows[-1]["time"]) == pytest.approx(10e-9)
    assert main(command[3:]) == 2
    assert "--force" in capsys.readouterr().err


def test_a_particle_starts_its_gap_above_rough_ground() -> None:
    """Measured vertically, whatever peak or slope lies below; the surface is the plan's own."""
    data = {
        "particle": {"material": "Ni", "diameter": "20 um", "velocity": "500 m/s", "offset": ["7 um", "-4 um"], "gap": "1.5 um"},
        "substrate": {"material": "SS304", "height": "80 um", "roughness": "3 um", "roughness_length": "20 um"},
        "resolution": {"spacing": "2.5 um"},
    }  # fmt: skip
    made = plan(Scene.from_dict(data))
    domains = build_domains(made)
    vertices, mesh = domains.surface.positions(domains.particle.x), domains.target.mesh
    below = heights_at(vertices[:, :2], domains.target.nodes.x, mesh.facets[mesh.sets["top"]])
    assert float((vertices[:, 2] - below).min()) == pytest.approx(1.5e-6, abs=1e-9)
    under = heights(np.array([[7e-6, -4e-6]]), made.target.diameter, 3e-6, 20e-6, 1)[0]
    assert domains.bodies.is_flat is False
    assert abs(domains.level - under) < 6e-6
    domains.particle.close()
