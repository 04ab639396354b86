"""Maps: the table of a sweep, the interpolation and its errors, pictures."""

import csv
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from made_up_run import write
from sweeps import flattening, made, points, pretend

from coupler.commands import main as cli
from coupler.commands.map import _levels
from coupler.errors import StoreError
from coupler.physics.adhesion import critical_velocity
from coupler.physics.materials import material
from coupler.plan.reading import Scene
from coupler.studies.maps import BAND, interpolate, varying
from coupler.studies.runs_table import AXES, COLUMNS, table, write_table
from coupler.studies.sweep import Sweep

ROOT = Path(__file__).parents[1]


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
