"""Sweeps and maps: points and their scenes, failed and stopped ones, the interpolation and its errors, pictures."""

import csv
import json
import re
import runpy
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_up_run import summary_of, write

from coupler.commands import main as cli
from coupler.commands.map import _levels
from coupler.errors import InterruptedRunError, SceneError, StoreError
from coupler.physics.adhesion import critical_velocity
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.record import plan_text
from coupler.ranks.executors import WITH_PARENT
from coupler.studies import points as point_runs
from coupler.studies.maps import BAND, interpolate, varying
from coupler.studies.runs_table import AXES, COLUMNS, table, write_table
from coupler.studies.sweep import Sweep

ROOT = Path(__file__).parents[1]
SHARED = {"preset": "draft", "substrate": {"material": "SS304"}}


def points(**changed: Any) -> dict[str, Any]:
    """A sweep of nickel as nested dicts, its points changed."""
    plain = {
        "material": ["Ni"],
        "diameter": ["10 um", "25 um"],
        "velocity": ["400 m/s", "700 m/s"],
        "temperature": ["300 K"],
    }
    return {"name": "few", "points": plain | changed, "scene": SHARED}


def flattening(v: np.ndarray, D: np.ndarray) -> np.ndarray:
    return 0.8 * np.tanh(v / 600.0) + 0.03 * np.log(D / 25e-6)


def pretend(folder: Path, name: str, **measures: float) -> None:
    """Leave behind what a finished run of a point leaves for a map."""
    scene = Scene.load(folder / f"{name}.toml")
    run = folder / name
    run.mkdir()
    (run / "scene.toml").write_text(scene.to_toml())
    decided = plan(scene)
    (run / "plan.json").write_text(plan_text(decided))
    own = {"velocity_ratio": decided.impact.velocity_ratio, "restitution": 20.0 / scene.particle.velocity}
    (run / "summary.json").write_text(json.dumps(summary_of(own | {"end": measures})))
    (folder / f"{name}.json").write_text(json.dumps({"status": "done", "reason": "", "exit_code": 0}))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep of 24 points of which one failed and one has not begun, with measures that are known."""
    folder = tmp_path_factory.mktemp("sweep")
    whole = Sweep.from_dict(
        points(diameter=[f"{D} um" for D in (5, 12, 28, 60)], velocity=[f"{v} m/s" for v in (125, 250, 400, 600, 900, 1250)])
    )  # fmt: skip
    for number, name in enumerate(whole.points):
        whole.write(folder, name)
        p = Scene.load(folder / f"{name}.toml").particle
        if number == 8:
            (folder / f"{name}.json").write_text(
                '{"status": "failed", "reason": "an inverted element", "exit_code": 3}'
            )
        elif number != 15:
            f = float(flattening(np.array(p.velocity), np.array(p.diameter)))
            pretend(folder, name, flattening_ratio=f, T_p99_K=300.0 + p.velocity**2 / 1200.0, rebound_velocity_m_s=20.0)
    return folder


def test_points_of_a_sweep() -> None:
    few = Sweep.from_dict(points(material=["Ni", "Ti"], temperature=["300 K", "200 degC"]))
    assert len(few.points) == 16
    assert not few.refused
    scene = Scene.from_text(few.points["Ti_25um_700ms_200degC"])
    assert (scene.particle.material, scene.preset) == ("Ti", "draft")
    assert (scene.particle.diameter, scene.particle.velocity, scene.particle.temperature) == (25e-6, 700.0, 473.15)
    assert (scene.substrate.diameter, scene.substrate.height) == (200e-6, 100e-6)
    assert Scene.from_text(few.points["Ni_10um_400ms_300K"]).substrate.diameter == pytest.approx(80e-6, rel=1e-12)
    held = Sweep.from_dict(points() | {"scene": {"substrate": {"material": "Al", "height": "70 um"}}})
    assert Scene.from_text(held.points["Ni_25um_400ms_300K"]).substrate.height == 70e-6


def test_what_is_wrong_with_a_sweep_is_said_at_once() -> None:
    wrong = points(diameter=["10", "25 m/s"], velocity="fast", temperture=["300 K"], contact={"frction": [0.1]})
    with pytest.raises(SceneError) as caught:
        Sweep.from_dict(wrong, "mine.toml")
    text = str(caught.value)
    assert text.startswith("mine.toml: 5 problems")
    for words in (
        'particle.diameter = "10" has no unit', 'particle.diameter = "25 m/s" is a velocity', 'particle.velocity = "fast"',
        "temperture: unknown key", 'contact.frction: unknown key (did you mean "friction"?)',
    ):  # fmt: skip
        assert words in text
    with pytest.raises(SceneError, match=r"preset = .darft..*did you mean .draft."):
        Sweep.from_dict(points() | {"scene": SHARED | {"preset": "darft"}})
    with pytest.raises(SceneError, match=r"absent\.toml"):
        Sweep.load("absent.toml")
    for data, words in (
        ({"scene": SHARED}, "give .points"),
        ({"points": {"velocity": []}, "scene": SHARED}, "points.particle.velocity: expected a list"),
        ({"points": {"velocity": [f"{v} m/s" for v in range(100, 200)], "diameter": [f"{d} um" for d in range(10, 120)]},
          "scene": SHARED}, "at most 10000"),
        ({"points": {"particle[3].velocity": ["500 m/s"]}, "scene": SHARED | {"particle": [{}, {}]}}, "no such table"),
        (points() | {"target": {"width": 3}}, "target.width"),
        (points() | {"ensemble": {"runs": 3}}, "give .points"),
        ({"scene": SHARED, "ensemble": {"runs": 0, "velocity": {"mean": "500 m/s", "deviation": "3 K"}}},
         "whole number from 1 to 10000\n.*one dimension"),
        ({"scene": SHARED, "ensemble": {"runs": 3, "velocity": {"mean": 5}}}, "expected a distribution"),
        (points() | {"scene": "absent.toml"}, "absent.toml"),
    ):  # fmt: skip
        with pytest.raises(SceneError, match=words):
            Sweep.from_dict(data)


def test_a_sweep_marks_what_is_refused_and_keeps_what_is_done_without_a_process(tmp_path, monkeypatch, capsys) -> None:
    """One point finished before, one that the program refuses: hotter than its metal stands."""
    monkeypatch.setattr(point_runs, "compute", lambda scene, status: pytest.fail(f"{scene.name} was run"))
    two = Sweep.from_dict(points(diameter=["25 um"], velocity=["400 m/s"], temperature=["300 K", "1700 K"]))
    good, bad = two.points
    assert list(two.refused) == [bad]
    two.write(tmp_path, good)
    pretend(tmp_path, good, flattening_ratio=0.5)
    assert two.run(tmp_path, jobs=2) == tmp_path
    rows = {row["point"]: row for row in table(tmp_path)}
    assert (rows[good]["status"], rows[good]["flattening_ratio"]) == ("done", 0.5)
    assert rows[bad]["status"] == "failed"
    assert "must stay below 0.95 of the melting point of Ni" in rows[bad]["reason"]
    assert (rows[bad]["velocity_m_s"], rows[bad]["temperature_K"]) == (400.0, 1700.0)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.json")}
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"1/2 {bad}: failed: particle.temperature")
    assert said[1:] == ["1 of 2 points have ended before"]
    two.run(tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.json")} == times


def test_a_point_that_was_refused_before_is_run_when_it_no_longer_is(tmp_path, monkeypatch) -> None:
    def end(scene: Path, status: Path) -> dict[str, object]:
        status.write_text(json.dumps(ended := {"status": "done", "reason": "", "exit_code": 0}))
        return ended

    monkeypatch.setattr(point_runs, "compute", end)
    few = Sweep.from_dict(points(diameter=["25 um"], velocity=["400 m/s"]))
    (name,) = few.points
    scene = few.write(tmp_path, name)
    scene.with_suffix(".json").write_text(json.dumps({"status": "failed", "reason": "", "exit_code": 2}))
    few.run(tmp_path)
    assert json.loads(scene.with_suffix(".json").read_text())["status"] == "done"


def test_time_to_go_of_a_sweep_is_that_of_the_points_that_are_left(tmp_path, monkeypatch) -> None:
    """Three points of 40 s each."""
    done = {"status": "done", "reason": "", "exit_code": 0}
    monkeypatch.setattr(point_runs, "run_point", lambda *_: done)
    monkeypatch.setattr(point_runs, "time", SimpleNamespace(monotonic=iter([0.0, 40.0, 80.0, 120.0]).__next__))
    said: list[str] = []
    point_runs.run_points(tmp_path, dict.fromkeys("abc", ""), ThreadPoolExecutor(1), said.append)
    assert [line.partition("; ")[2] for line in said] == ["about 80 s to go", "about 40 s to go", ""]


@pytest.mark.parametrize(("number", "verdict"), [("TERM", None), ("INT", None), ("KILL", "killed by SIGKILL")])
def test_a_point_that_is_stopped_is_no_failure(tmp_path, monkeypatch, number, verdict) -> None:
    program = tmp_path / "program"
    # a shell would pass on that a signal is ignored, as it is for what runs in the background
    default = "" if number == "KILL" else f"signal.signal(signal.SIG{number}, signal.SIG_DFL); "
    program.write_text(f"#!{sys.executable}\nimport os, signal\n{default}os.kill(os.getpid(), signal.SIG{number})\n")
    program.chmod(0o755)
    monkeypatch.setattr(point_runs.sys, "executable", str(program))
    scene = Sweep.from_dict(points()).write(tmp_path, "Ni_10um_400ms_300K")
    status = scene.with_suffix(".json")
    if verdict is None:
        with pytest.raises(InterruptedRunError):
            point_runs.compute(scene, status)
        assert not status.exists()
    else:
        assert point_runs.compute(scene, status)["reason"] == verdict
        assert json.loads(status.read_text())["status"] == "failed"


def test_a_run_of_another_scene_is_not_gone_on_with(tmp_path) -> None:
    few = Sweep.from_dict(points())
    name = next(iter(few.points))
    scene = few.write(tmp_path, name)
    pretend(tmp_path, name)
    assert point_runs._begun(scene, tmp_path / name)
    scene.write_text(few.points[name].replace("draft", "fine"))
    assert not point_runs._begun(scene, tmp_path / name)


def test_the_table(finished, tmp_path) -> None:
    rows = table(finished)
    assert len(rows) == 24
    status = [row["status"] for row in rows]
    assert (status.count("done"), status.count("failed"), status.count("unfinished")) == (22, 1, 1)
    assert next(row["reason"] for row in rows if row["status"] == "failed") == "an inverted element"
    assert varying(rows) == AXES[:2]
    row = next(row for row in rows if row["point"] == "Ni_28um_900ms_300K")
    assert row["velocity_ratio"] == pytest.approx(900.0 / critical_velocity(material("Ni"), 300.0), rel=1e-12)
    assert row["restitution"] == pytest.approx(20.0 / 900.0, rel=1e-12)
    write_table(rows, tmp_path / "map.csv", "about")
    with (tmp_path / "map.csv").open() as stream:
        assert stream.readline() == "# about\n"
        again = list(csv.DictReader(stream))
    assert tuple(again[0]) == COLUMNS
    assert [float(r["diameter_m"]) for r in again] == pytest.approx([r["diameter_m"] for r in rows], rel=1e-5)
    with pytest.raises(StoreError, match="holds no points"):
        table(tmp_path)


def test_the_interpolation_finds_a_smooth_function(finished) -> None:
    fit = interpolate(table(finished), "flattening_ratio")
    v, D = np.meshgrid([180.0, 320.0, 500.0, 750.0, 1100.0], [8e-6, 18e-6, 40e-6])
    mean, std = fit(v, D)
    assert mean.shape == std.shape == v.shape
    assert np.abs(mean - flattening(v, D)).max() < 0.01
    assert fit.loo_rms < 0.02 < 0.2 < fit.spread
    outside, _ = fit(2500.0, 25e-6), fit(500.0, 25e-6)
    assert outside[1] > 3 * fit(500.0, 25e-6)[1]


def test_leaving_one_out_is_what_it_says(finished) -> None:
    """The closed form against fits that were really made without the point, with the same constants."""
    from sklearn.gaussian_process import GaussianProcessRegressor

    rng = np.random.default_rng(3)
    rows = [dict(row) for row in table(finished) if row["status"] == "done"]
    for row in rows:
        row["flattening_ratio"] += 0.02 * rng.normal()
    fit = interpolate(rows, "flattening_ratio")
    x, y = fit._model.X_train_, fit._model.y_train_
    off, inside = [], []
    for i in range(len(y)):
        others = np.arange(len(y)) != i
        left = GaussianProcessRegressor(fit._model.kernel_, optimizer=None, alpha=fit._model.alpha).fit(
            x[others], y[others]
        )
        mean, std = left.predict(x[i : i + 1], return_std=True)
        off.append(float(y[i] - mean[0]))
        inside.append(abs(off[-1]) <= BAND * float(std[0]))
    same_velocity, left_out = fit._model.X_train_[:, 0], []
    for value in np.unique(same_velocity)[1:-1]:
        others = same_velocity != value
        left = GaussianProcessRegressor(fit._model.kernel_, optimizer=None, alpha=fit._model.alpha).fit(
            x[others], y[others]
        )
        left_out += list(y[~others] - left.predict(x[~others]))
    assert fit.gap_rms["velocity_m_s"] == pytest.approx(fit.spread * np.sqrt(np.mean(np.square(left_out))), rel=1e-4)
    assert fit.loo_rms == pytest.approx(fit.spread * np.sqrt(np.mean(np.square(off))), rel=1e-5)
    assert fit.loo_inside == np.mean(inside)
    assert 0.01 < fit.loo_rms < 0.05
    assert fit.loo_inside > 0.8


def test_too_little_for_a_map(finished) -> None:
    rows = table(finished)
    with pytest.raises(StoreError, match="3 values of velocity; an interpolation needs 4"):
        interpolate(rows[:3], "flattening_ratio")
    with pytest.raises(StoreError, match="2 values of diameter"):
        interpolate([row for row in rows if row["diameter_m"] < 20e-6], "flattening_ratio")
    with pytest.raises(StoreError, match="flatening is no column"):
        interpolate(rows, "flatening")


def made(folder: Path, whole: Sweep) -> Path:
    """A sweep whose points are done, with the flattening that `flattening` says."""
    for name in whole.points:
        whole.write(folder, name)
        p = Scene.load(folder / f"{name}.toml").particle
        pretend(folder, name, flattening_ratio=float(flattening(np.array(p.velocity), np.array(p.diameter))))
    return folder


def drawn(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> str:
    assert cli.main(["map", str(folder), "--show", "flattening_ratio", *more]) == 0
    return capsys.readouterr().out


def test_six_points_are_points_and_lines_and_no_surface(tmp_path, capsys) -> None:
    """Three velocities of two sizes: a surface would say 0.470 +- 0.19 between them where a run gives 0.389."""
    whole = Sweep.from_dict(points(velocity=["300 m/s", "500 m/s", "900 m/s"]))
    said = drawn(made(tmp_path, whole), capsys)
    assert "3 values of velocity and 2 values of diameter; an interpolation needs 4 along each axis" in said
    assert "rms" not in said
    assert "inside" not in said
    assert re.search(r"next point worth a run: velocity 670.8 m/s, diameter (10|25) .m; --refine 1 runs it", said)
    assert (tmp_path / "map_Ni_flattening_ratio.png").stat().st_size > 10_000


def test_one_axis_gives_a_curve_with_its_band(tmp_path, capsys) -> None:
    velocities = [f"{v} m/s" for v in (150, 250, 400, 650, 1100)]
    said = drawn(made(tmp_path, Sweep.from_dict(points(diameter=["25 um"], velocity=velocities))), capsys)
    assert "rms error leaving out one point" in said
    assert re.search(r"next point worth a run: velocity \S+ m/s \(band \+- \S+\)", said)
    fit = interpolate(table(tmp_path), "flattening_ratio")
    assert fit.axes == ("velocity_m_s",)
    mean, std = fit(520.0)
    assert abs(mean - flattening(np.array(520.0), np.array(25e-6))) < min(2.5 * std, 0.03)


def test_a_length_below_the_distance_of_points_is_no_answer(tmp_path) -> None:
    """Values that alternate: the points cannot tell the length, and the remark says it."""
    velocities = [f"{v} m/s" for v in (200, 300, 400, 500, 600, 700)]
    rows = table(made(tmp_path, Sweep.from_dict(points(diameter=["25 um"], velocity=velocities))))
    for number, row in enumerate(rows):
        row["flattening_ratio"] = 0.5 + 0.1 * (-1) ** number
    fit = interpolate(rows, "flattening_ratio")
    assert fit.warnings == (
        "flattening, above surface changes along velocity within the distance of two points: more of them are needed",
    )
    assert fit(250.0)[1] > 0.02


def test_any_key_of_the_scene_is_an_axis(tmp_path, capsys) -> None:
    for number, friction in enumerate((0.0, 0.2, 0.5, 0.8)):
        scene = {"preset": "draft", "contact": {"friction": friction}, "substrate": {"material": "SS304"}}
        whole = Sweep.from_dict(points(diameter=["25 um"], velocity=["500 m/s"]) | {"scene": scene})
        (name,) = whole.points
        path = tmp_path / f"f{number}.toml"
        path.write_text(whole.points[name])
        pretend(tmp_path, path.stem, flattening_ratio=0.5 - 0.1 * friction)
    assert "vary in none of the axes" in drawn(tmp_path, capsys)
    said = drawn(tmp_path, capsys, "--axes", "contact.friction")
    assert "rms error leaving out one point" in said
    assert "next point worth a run: contact.friction 0." in said
    with (tmp_path / "map.csv").open() as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    assert sorted(float(row["contact.friction"]) for row in rows) == [0.0, 0.2, 0.5, 0.8]
    assert cli.main(["map", str(tmp_path), "--axes", "contact.frction"]) == 2
    assert "contact.friction" in capsys.readouterr().err
    assert cli.main(["map", str(tmp_path), "--axes", "contact.friction", "particle.velocity"]) == 2
    assert "--axes particle.velocity: all 4 points have the same value there" in capsys.readouterr().err


def test_levels_of_a_band_are_those_of_its_own_values() -> None:
    """Also of the ratio to the critical velocity, whose map has 1 in the middle."""
    band, mean = np.array([0.0, 0.005]), np.array([0.6, 1.2])
    assert _levels([band], "velocity_ratio", band=True).max() <= 0.01
    levels = _levels([mean], "velocity_ratio", band=False)
    assert levels[0] + levels[-1] == pytest.approx(2.0, abs=0.1)


def test_refine_runs_the_point_that_tells_most(tmp_path, capsys, monkeypatch) -> None:
    made(tmp_path, Sweep.from_dict(points(velocity=["300 m/s", "500 m/s", "900 m/s"])))
    scenes = []

    def run_it(folder: Path, name: str, text: str) -> None:
        (folder / f"{name}.toml").write_text(text)
        scenes.append(Scene.load(folder / f"{name}.toml"))
        pretend(folder, name, flattening_ratio=0.4)

    monkeypatch.setattr("coupler.studies.maps.run_point", run_it)
    said = drawn(tmp_path, capsys, "--refine", "2")
    assert "7 points" not in said.splitlines()[0]
    assert "8 points: 8 done" in said
    assert scenes[0].particle.velocity == pytest.approx(670.8)
    for scene in scenes:
        assert scene.substrate.diameter == pytest.approx(8 * scene.particle.diameter)
        assert scene.substrate.height == pytest.approx(4 * scene.particle.diameter)
    assert cli.main(["map", str(tmp_path), "--refine", "-1"]) == 2


def test_the_command_draws_maps_with_their_points(finished, tmp_path, capsys) -> None:
    from matplotlib.image import imread

    assert cli.main(["map", str(finished), "--out", str(tmp_path), "--show", "flattening_ratio", "velocity_ratio"]) == 0
    said = capsys.readouterr().out
    assert "24 points: 22 done, 0 undecided, 1 failed, 1 unfinished" in said
    assert "failed: an inverted element" in said
    assert "leaving out one point" in said
    assert (tmp_path / "map.csv").is_file()
    picture = imread(tmp_path / "map_Ni_flattening_ratio.png")[..., :3]
    left = picture[:, : picture.shape[1] // 2]
    assert len(np.unique((255 * left).astype(int).reshape(-1, 3), axis=0)) > 50
    orange = np.abs(picture - np.array([0xD5, 0x5E, 0x00]) / 255).max(axis=-1) < 0.02
    assert orange.sum() > 20  # the points that are not done
    assert (tmp_path / "map_Ni_velocity_ratio.png").is_file()
    assert cli.main(["map", str(tmp_path / "absent")]) == 2
    assert "is not a folder" in capsys.readouterr().err


def test_the_example_runs_to_its_end(tmp_path, monkeypatch, capsys) -> None:
    """workflows/map_example.py over runs that were never computed, but for the drawing, which is tested above."""

    def run(self: Sweep) -> Path:
        for name in self.points:
            self.write(tmp_path, name)
            p = Scene.load(tmp_path / f"{name}.toml").particle
            f = float(flattening(np.array(p.velocity), np.array(p.diameter)))
            pretend(tmp_path, name, flattening_ratio=f, T_p99_K=400.0 + p.velocity, rebound_velocity_m_s=20.0)
        looked_at = tmp_path / "Ni_25um_650ms_300K"
        summary = json.loads((looked_at / "summary.json").read_text())
        (looked_at / "summary.json").unlink()
        scene = (looked_at / "scene.toml").read_text()
        (looked_at / "scene.toml").unlink()
        (looked_at / "plan.json").unlink()
        write(looked_at, 1, 200, 20.0, scene, summary)
        return tmp_path

    monkeypatch.setattr(Sweep, "run", run)
    monkeypatch.setattr("coupler.commands.map.draw", lambda rows, folder: [f"{len(rows)} rows drawn"])
    runpy.run_path(str(ROOT / "workflows" / "map_example.py"))
    said = capsys.readouterr().out
    assert said.startswith("16 points, the first: Ni_10um_300ms_300K")
    at = re.search(r"25 um at 550 m/s: ([0-9.]+) \+- ([0-9.]+)", said)
    assert at is not None
    assert float(at[1]) == pytest.approx(float(flattening(np.array(550.0), np.array(25e-6))), abs=0.02)
    assert "25 um at 650 m/s: rebound 20 m/s" in said


def test_snakemake_finds_what_is_left_to_do(finished, tmp_path) -> None:
    """A dry run over a sweep of which all but one are done."""
    pytest.importorskip("snakemake")
    config = tmp_path / "few.toml"
    config.write_text(
        'name = "few"\nscene.preset = "draft"\nscene.substrate.material = "SS304"\n[points]\nmaterial = "Ni"\n'
        'diameter = ["5 um", "12 um", "28 um", "60 um"]\n'
        'velocity = ["125 m/s", "250 m/s", "400 m/s", "600 m/s", "900 m/s", "1250 m/s"]\ntemperature = ["300 K"]\n'
    )
    for path in finished.glob("*.json"):
        path.touch()
    done = subprocess.run(
        [sys.executable, "-m", "snakemake", "-n", "-q", "rules", "-s", ROOT / "workflows" / "Snakefile", "-d", finished,
         "--rerun-triggers", "mtime", "--config", f"map={config}", f"out={finished}"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    counts = dict(line.split() for line in said.splitlines() if len(line.split()) == 2 and line.split()[1].isdigit())
    assert counts == {"point": "1", "draw": "1", "all": "1", "total": "3"}


def test_points_are_a_list_and_settings_reach_any_table(tmp_path) -> None:
    (tmp_path / "base.toml").write_text(
        'preset = "draft"\n[[particle]]\nmaterial = "Ni"\ndiameter = "25 um"\nvelocity = "500 m/s"\n'
        '[[particle]]\nmaterial = "Ni"\ndiameter = "25 um"\nvelocity = "500 m/s"\n'
        '[substrate]\nmaterial = "SS304"\ndiameter = "200 um"\nheight = "100 um"\n'
    )
    listed = {
        "scene": "base.toml",
        "points": [{"contact": {"friction": 0.1}}, {"contact.friction": 0.3, "particle[2].velocity": "600 m/s"}],
    }
    two = Sweep.from_dict(listed, str(tmp_path / "two.toml"))
    assert list(two.points) == ["friction0.1", "friction0.3_velocity600ms"]
    scene = Scene.from_text(two.points["friction0.3_velocity600ms"])
    assert [particle.velocity for particle in scene.particles] == [500.0, 600.0]
    assert scene.contact.friction == 0.3
    assert two.varied == ("contact.friction", "particle[2].velocity")


ENSEMBLE = {
    "name": "scatter",
    "scene": {
        "preset": "draft",
        "particle": {"material": "Ni", "velocity": "500 m/s"},
        "substrate": {"material": "SS304"},
    },
    "ensemble": {
        "runs": 64,
        "seed": 5,
        "velocity": {"mean": "600 m/s", "deviation": "40 m/s"},
        "diameter": {"median": "25 um", "spread": 1.4, "smallest": "15 um", "largest": "40 um"},
        "particle": {
            "offset": [{"from": "-5 um", "to": "5 um"}, {"from": "0 um", "to": "1 um"}],
            "angle": {"values": ["0 deg", "30 deg"]},
        },
    },
}


def test_an_ensemble_has_the_distributions_that_it_names() -> None:
    """Quasi-random: quantiles are right to 1/n, where random draws would be to 1/sqrt(n); Kolmogorov-Smirnov distance below 0.05."""
    from scipy import stats

    drawn = Sweep.from_dict(ENSEMBLE)
    scenes = [Scene.from_text(text) for text in drawn.points.values()]
    v, D = (np.array([getattr(s.particle, key) for s in scenes]) for key in ("velocity", "diameter"))
    assert stats.kstest(v, stats.norm(600.0, 40.0).cdf).statistic < 0.05
    law = stats.lognorm(np.log(1.4), scale=25e-6)
    low, high = law.cdf((15e-6, 40e-6))
    assert D.min() > 15e-6
    assert D.max() < 40e-6
    assert stats.kstest((law.cdf(D) - low) / (high - low), "uniform").statistic < 0.05
    x, y = np.array([s.particle.offset for s in scenes]).T
    assert stats.kstest(x * 1e5 + 0.5, "uniform").statistic < 0.05
    assert stats.kstest(y * 1e6, "uniform").statistic < 0.05
    assert sum(s.particle.angle > 0.0 for s in scenes) == pytest.approx(32, abs=2)
    assert abs(stats.spearmanr(v, D).statistic) < 0.1
    longer = Sweep.from_dict(ENSEMBLE | {"ensemble": ENSEMBLE["ensemble"] | {"runs": 80}})  # type: ignore[operator]
    assert list(longer.points.items())[:64] == list(drawn.points.items())
    assert drawn.varied == ("particle.velocity", "particle.diameter", "particle.offset", "particle.angle")


def test_the_distribution_of_the_measures_is_the_result(tmp_path, capsys) -> None:
    """Flattening is made a straight function of velocity: its quantiles are those of the velocity, its rank correlation is one."""
    few = {**ENSEMBLE, "ensemble": {"runs": 24, "velocity": {"mean": "600 m/s", "deviation": "40 m/s"}}}
    few["scene"]["particle"]["diameter"] = "25 um"  # type: ignore[index]
    file = tmp_path / "scatter.json"
    drawn = Sweep.from_dict(few)
    text = ['name = "scatter"', *(f"scene.{line}" for line in next(iter(drawn.points.values())).splitlines())]
    file = tmp_path / "scatter.toml"
    file.write_text(
        "\n".join([*text, "[ensemble]", "runs = 24", 'velocity = { mean = "600 m/s", deviation = "40 m/s" }\n'])
    )
    drawn = Sweep.load(file)
    v = []
    for name in drawn.points:
        drawn.write(tmp_path / "out", name)
        v.append(Scene.load(tmp_path / "out" / f"{name}.toml").particle.velocity)
        pretend(tmp_path / "out", name, flattening_ratio=v[-1] / 1000.0, T_mean_K=v[-1])
    assert cli.main(["sweep", str(file), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "24 points: 24 done" in said
    assert "mean temperature" in said  # values, where bands are those of its rise
    line = next(line.split() for line in said.splitlines() if line.startswith("flattening"))
    assert line[-1] == "+1.00"
    with (tmp_path / "out" / "distribution.csv").open() as stream:
        rows = {row["measure"]: row for row in csv.DictReader(line for line in stream if not line.startswith("#"))}
    row = rows["flattening_ratio"]
    assert float(row["quantile_0.95"]) == pytest.approx(float(np.quantile(v, 0.95)) / 1000.0, rel=1e-5)
    assert float(row["mean"]) == pytest.approx(float(np.mean(v)) / 1000.0, rel=1e-5)
    assert float(row["rank_correlation particle.velocity"]) == 1.0
    assert (tmp_path / "out" / "distribution.png").stat().st_size > 10_000


def test_a_lost_worker_and_a_stopped_run_leave_points_without_an_end(tmp_path) -> None:
    """Each executor ends so: the exception of a worker's death, or of a run that was stopped; other points go on."""
    from concurrent.futures import Executor, Future

    class Losing(Executor):
        def submit(self, function, folder, point, text):  # type: ignore[no-untyped-def, override]
            future: Future[dict[str, object]] = Future()
            if point == "b":
                future.set_exception(InterruptedRunError("stopped"))
            elif point == "c":
                future.set_exception(RuntimeError("node down"))
            else:
                future.set_result({"status": "done", "reason": ""})
            return future

    said: list[str] = []
    statuses = point_runs.run_points(tmp_path, dict.fromkeys("abc", ""), Losing(), said.append)
    assert statuses == {"a": "done", "b": "stopped", "c": "stopped"}
    assert sum("its worker was lost (node down)" in line for line in said) == 1


def test_the_server_of_the_slurm_jobs_ends_with_the_sweep() -> None:
    """The pipe ends when its last writer has: the child of a killed parent."""
    child = f"{WITH_PARENT}; print('ready', flush=True); signal.pause()"
    start = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]])"
    with subprocess.Popen([sys.executable, "-c", start, child], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "ready\n"
        parent.kill()
        assert parent.stdout.read() == ""


def test_executors(tmp_path, monkeypatch) -> None:
    from coupler.errors import PlacementError
    from coupler.ranks.executors import executor, own_environment

    with executor("processes", 2, tmp_path) as pool:
        assert list(pool.map(abs, [-1, 2])) == [1, 2]
    with pytest.raises(PlacementError, match=r'did you mean "slurm"'):
        executor("slum", 1, tmp_path)
    with pytest.raises(PlacementError, match="two ranks or more"):
        executor("mpi", 1, tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(PlacementError, match="sbatch is not installed"):
        executor("slurm", 1, tmp_path)
    monkeypatch.setenv("PMI_RANK", "3")
    assert "PMI_RANK" not in own_environment()
