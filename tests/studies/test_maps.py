"""Maps: the table of a sweep, the interpolation and its errors, pictures."""

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats.qmc import Halton
from sweeps import flattening, made, points, pretend, scattered

from coupler.commands import main as cli
from coupler.errors import StoreError
from coupler.physics.adhesion import critical_velocity
from coupler.physics.materials import material
from coupler.plan.reading import Scene
from coupler.scene.toml import set_key
from coupler.studies import map_figures
from coupler.studies.map_figures import NO_VALUE, _fields, _levels
from coupler.studies.maps import BAND, best_point, brackets, interpolate, run_next, sparse, varying
from coupler.studies.runs import write_scene
from coupler.studies.runs_table import AXES, COLUMNS, scene_numbers, table, write_table
from coupler.studies.sweep import Sweep


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep of 24 points of which one failed and one has not begun, with measures that are known."""
    folder = tmp_path_factory.mktemp("sweep")
    whole = Sweep.from_dict(
        points(diameter=[f"{D} um" for D in (5, 12, 28, 60)], velocity=[f"{v} m/s" for v in (125, 250, 400, 600, 900, 1250)])
    )  # fmt: skip
    for number, name in enumerate(whole.points):
        write_scene(folder, name, whole.points[name])
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
    assert row["velocity_ratio"] == pytest.approx(900.0 / critical_velocity(material("Ni"), 300.0, 28e-6), rel=1e-12)
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
    with pytest.raises(StoreError, match="flatening is not a column"):
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
    assert re.search(r"best next point: velocity 670.8 m/s, diameter (10|25) .m; compute it with --refine 1", said)
    assert (tmp_path / "map_Ni_flattening_ratio.png").stat().st_size > 10_000


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    """The pictures that a test draws, by their names."""
    kept: dict[str, Figure] = {}
    save = map_figures.save

    def keep(figure: Figure, path: Path) -> None:
        kept[path.stem] = figure
        save(figure, path)

    monkeypatch.setattr(map_figures, "save", keep)
    return kept


def labels(figure: Figure) -> set[str]:
    """Texts of all legends of a picture."""
    legends = [*figure.legends, *(at.get_legend() for at in figure.axes if at.get_legend())]
    return {text.get_text() for legend in legends for text in legend.get_texts()}


def spread_over(n: int) -> list[tuple[float, float]]:
    """n places (diameter in um, velocity in m/s) of a Halton sequence."""
    unit = Halton(2, seed=1).random(n)
    return [(float(8 * 5**a), float(300 * 3**b)) for a, b in unit]


def test_four_points_on_a_diagonal_give_no_surface(tmp_path, capsys, figures) -> None:
    """Four values of each axis, but no point of (10 um, 900 m/s), where a surface was off by three times its band."""
    made(tmp_path, scattered([(10, 300), (14, 450), (18, 650), (25, 900)]))
    said = drawn(tmp_path, capsys)
    assert "4 different points, but an interpolation over 2 axes needs 12" in said
    assert "rms" not in said
    assert "best next point: velocity " in said
    assert labels(figures["map_Ni_flattening_ratio"]) == {"no verdict"}
    with pytest.raises(StoreError, match="needs 12 points"):
        interpolate(table(tmp_path), "flattening_ratio")


def test_many_points_near_one_line_give_no_surface(tmp_path, capsys, figures) -> None:
    share = np.linspace(0.0, 1.0, 20)
    noise = 1.0 + 0.03 * np.random.default_rng(1).normal(size=20)
    made(tmp_path, scattered(list(zip(10 * 3**share, 300 * 3**share * noise, strict=True))))
    assert "the points lie near one line of velocity and diameter" in drawn(tmp_path, capsys)
    (picture,) = figures.values()
    assert labels(picture) == {"no verdict"}  # points in a plane: no legend of twenty lines


def test_scattered_points_give_a_surface_inside_their_hull(tmp_path, capsys) -> None:
    made(tmp_path, scattered(spread_over(20)))
    assert "rms error leaving out one point" in drawn(tmp_path, capsys)
    rows = table(tmp_path)
    fit = interpolate(rows, "flattening_ratio")
    assert not fit.inside(310.0, 39e-6)
    assert fit.inside([row["velocity_m_s"] for row in rows], [row["diameter_m"] for row in rows]).all()
    v, D, mean, band = _fields(rows, fit.axes, None, fit)
    outside = ~fit.inside(v, D)
    assert 0.05 < outside.mean() < 0.6
    assert (np.isnan(mean) == outside).all()
    assert (np.isnan(band) == outside).all()
    assert np.nanmax(np.abs(mean - flattening(v, D)) - band) < 0.01


def test_lengths_are_no_shorter_than_the_distance_of_points(tmp_path) -> None:
    """Noise on 30 scattered points: neighbouring values of one axis lie much nearer than the points themselves."""
    rows = table(made(tmp_path, scattered(spread_over(30))))
    for row, value in zip(rows, np.random.default_rng(0).normal(size=30), strict=True):
        row["flattening_ratio"] = 0.5 + 0.1 * value
    fit = interpolate(rows, "flattening_ratio")
    x = fit._model.X_train_
    apart = np.linalg.norm(x[:, None] - x[None], axis=2) + 9.0 * np.eye(30)
    lower = np.exp(fit._model.kernel_.bounds)[1:3, 0]
    assert lower == pytest.approx(np.quantile(apart.min(axis=1), 0.25), rel=1e-6)
    assert np.diff(np.unique(x[:, 0])).min() < 0.3 * lower[0]


def test_a_grid_with_a_hole_and_a_point_between_keeps_its_surface(tmp_path) -> None:
    D, v = (10, 15, 22, 33), (300, 430, 620, 900)
    places = [(a, b) for a in D for b in v][1:]
    rows = table(made(tmp_path, scattered([*places, (12, 520)])))
    assert sparse(rows, AXES[:2]) == ""
    assert "needs 12 points" in sparse(rows[:11], AXES[:2])


def test_a_jump_at_the_critical_velocity_is_no_noise(tmp_path, capsys, figures) -> None:
    """One axis, restitution that falls to zero between 560 and 640 m/s: both sides through their points, a marker for each verdict,
    and the next point in the bracket."""
    velocities = (300, 360, 430, 500, 560, 640, 700, 780)
    whole = Sweep.from_dict(points(diameter=["25 um"], velocity=[f"{v} m/s" for v in velocities]))
    made(tmp_path, whole, critical=600.0)
    quantities = ["restitution", "velocity_ratio", "flattening_ratio"]
    assert cli.main(["map", str(tmp_path), "--show", *quantities]) == 0
    said = capsys.readouterr().out
    assert "verdicts: sticks 3, rebounds 5" in said
    assert "the verdict changes between 560 m/s and 640 m/s, and a measure can jump there" in said
    bracket = r"best next point: velocity 598\.7 m/s \(rebounds at velocity 560 m/s, sticks at velocity 640 m/s\)"
    assert len(re.findall(bracket, said)) == 2
    at = figures["map_Ni_restitution"].axes[0]
    assert {"sticks", "rebounds"} < labels(figures["map_Ni_restitution"])
    below, above = (line.get_xydata() for line in at.get_lines())
    assert below[:, 0].max() == pytest.approx(560.0)
    assert above[:, 0].min() == pytest.approx(640.0)
    assert np.abs(above[:, 1]).max() < 1e-9
    assert np.interp(velocities[:5], *below.T) == pytest.approx(20.0 / np.array(velocities[:5]), rel=0.02)
    ratio = figures["map_Ni_velocity_ratio"].axes[0]
    assert any(set(line.get_ydata()) == {1.0} for line in ratio.get_lines())
    assert "rms error" in next(line for line in said.splitlines() if "of the particle's metal: " in line)


def test_few_points_have_the_markers_of_their_verdicts(tmp_path, capsys, figures) -> None:
    whole = Sweep.from_dict(points(velocity=["300 m/s", "500 m/s", "900 m/s"]))
    for name in whole.points:
        write_scene(tmp_path, name, whole.points[name])
        v = Scene.load(tmp_path / f"{name}.toml").particle.velocity
        verdict = {300.0: "rebounds", 500.0: "undecided", 900.0: "sticks"}[v]
        pretend(tmp_path, name, verdict, flattening_ratio=v / 1000.0)
    said = drawn(tmp_path, capsys)
    assert "verdicts: sticks 2, rebounds 2, undecided 2" in said
    assert {"sticks", "rebounds", "undecided"} < labels(figures["map_Ni_flattening_ratio"])
    assert "(undecided at velocity 500 m/s, sticks at velocity 900 m/s)" in said


def test_points_without_a_value_stand_on_the_lower_edge(tmp_path, capsys, figures) -> None:
    """Of five velocities one fails and one is undecided, so that it has no restitution."""
    velocities = (300, 400, 500, 600, 700)
    whole = Sweep.from_dict(points(diameter=["25 um"], velocity=[f"{v} m/s" for v in velocities]))
    for v, name in zip(velocities, whole.points, strict=True):
        write_scene(tmp_path, name, whole.points[name])
        if v == 300:
            (tmp_path / f"{name}.json").write_text('{"status": "failed", "reason": "an element", "exit_code": 3}')
        else:
            pretend(tmp_path, name, {600: "undecided", 700: "sticks"}.get(v, "rebounds"), flattening_ratio=0.5)
    assert cli.main(["map", str(tmp_path), "--show", "restitution"]) == 0
    assert "verdicts: sticks 1, rebounds 2, undecided 1" in capsys.readouterr().out
    at = figures["map_Ni_restitution"].axes[0]
    (crosses,) = (drawn for drawn in at.collections if drawn.get_label() == NO_VALUE)
    assert np.asarray(crosses.get_offsets()) == pytest.approx(np.array([[v, at.get_ylim()[0]] for v in (300, 600)]))


def test_a_new_point_is_named_by_all_digits_of_its_place(tmp_path, monkeypatch) -> None:
    rows = table(made(tmp_path, Sweep.from_dict(points())))
    kept = []
    monkeypatch.setattr("coupler.studies.maps.run_point", lambda folder, name, text: kept.append(name))
    run_next(tmp_path, rows, {"velocity_m_s": 529.2, "diameter_m": 1.581e-5})
    assert kept == ["Ni_15.81um_529.2ms"]


def test_a_formula_needs_no_run(tmp_path, capsys, monkeypatch) -> None:
    made(tmp_path, Sweep.from_dict(points()), critical=500.0)
    monkeypatch.setattr("coupler.studies.maps.run_point", lambda *_: pytest.fail("it runs a formula"))
    assert cli.main(["map", str(tmp_path), "--show", "velocity_ratio", "--refine", "1"]) == 0
    said = capsys.readouterr().out
    assert (
        "there is no new point to compute: normal velocity / critical velocity of the particle's metal is a formula"
        in said
    )
    assert "best next point" not in said


def test_a_bracket_is_halved_until_it_is_narrow(tmp_path) -> None:
    """On a grid, neighbours along the axes only; a bracket of 5 % is the end, and the widest band is next."""
    grid = points(diameter=["10 um", "25 um"], velocity=["400 m/s", "590 m/s", "610 m/s", "700 m/s"])
    rows = table(made(tmp_path, Sweep.from_dict(grid), critical=600.0))
    assert brackets(rows, AXES[:2]) == []
    grid["points"]["velocity"] = ["400 m/s", "550 m/s", "610 m/s", "700 m/s"]
    rows = table(made(tmp_path / "wide", Sweep.from_dict(grid), critical=600.0))
    assert {(a, b) for a, b, *_ in brackets(rows, AXES[:2])} == {((550.0, D), (610.0, D)) for D in (1e-5, 2.5e-5)}
    assert best_point(rows, "flattening_ratio", ())[0].at["velocity_m_s"] == pytest.approx(579.2)


def test_the_runs_of_a_study_are_in_a_folder_of_their_own(tmp_path, capsys) -> None:
    made(tmp_path / "runs", Sweep.from_dict(points()))
    (tmp_path / "scene.toml").write_text(next((tmp_path / "runs").glob("*.toml")).read_text())
    assert cli.main(["map", str(tmp_path)]) == 2
    assert f"but {tmp_path / 'runs'} has: give that folder" in capsys.readouterr().err


def test_an_axis_is_named_once(tmp_path, capsys) -> None:
    made(tmp_path, Sweep.from_dict(points()))
    assert cli.main(["map", str(tmp_path), "--axes", "particle.velocity", "particle.velocity"]) == 2
    said = capsys.readouterr().err
    assert "--axes particle.velocity: this key is given twice" in said
    assert said.count("\n") == 1


def test_one_axis_gives_a_curve_with_its_band(tmp_path, capsys) -> None:
    velocities = [f"{v} m/s" for v in (150, 250, 400, 650, 1100)]
    said = drawn(made(tmp_path, Sweep.from_dict(points(diameter=["25 um"], velocity=velocities))), capsys)
    assert "rms error leaving out one point" in said
    assert re.search(r"best next point: velocity \S+ m/s \(band \+- \S+\)", said)
    fit = interpolate(table(tmp_path), "flattening_ratio")
    assert fit.axes == ("velocity_m_s",)
    mean, std = fit(520.0)
    assert abs(mean - flattening(np.array(520.0), np.array(25e-6))) < min(2.5 * std, 0.03)


def test_errors_that_runs_have_measured_are_bars_and_a_remark(tmp_path, capsys, figures) -> None:
    velocities = [f"{v} m/s" for v in (150, 250, 400, 650, 1100)]
    folder = made(tmp_path, Sweep.from_dict(points(diameter=["25 um"], velocity=velocities)))
    for path in folder.glob("*/summary.json"):
        summary = json.loads(path.read_text())
        summary["impacts"][-1]["errors"] = {"flattening_ratio": {"half_width": 0.02}}
        path.write_text(json.dumps(summary))
    assert "error of the resolution: 0.02 median, 0.02 largest" in drawn(folder, capsys)
    (bars,) = figures["map_Ni_flattening_ratio"].axes[0].containers
    (segments,) = (lines.get_segments() for lines in bars[2])
    assert np.ptp(segments, axis=1)[:, 1] == pytest.approx(0.04)


def test_a_length_below_the_distance_of_points_is_no_answer(tmp_path) -> None:
    """Values that alternate: the points cannot tell the length, and the remark says it."""
    velocities = [f"{v} m/s" for v in (200, 300, 400, 500, 600, 700)]
    rows = table(made(tmp_path, Sweep.from_dict(points(diameter=["25 um"], velocity=velocities))))
    for number, row in enumerate(rows):
        row["flattening_ratio"] = 0.5 + 0.1 * (-1) ** number
    fit = interpolate(rows, "flattening_ratio")
    assert fit.warnings == (
        "flattening above the surface changes along velocity between neighbouring points: compute more points",
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
    assert "none of the axes varies" in drawn(tmp_path, capsys)
    said = drawn(tmp_path, capsys, "--axes", "contact.friction")
    assert "rms error leaving out one point" in said
    assert "best next point: contact.friction 0." in said
    with (tmp_path / "map.csv").open() as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    assert sorted(float(row["contact.friction"]) for row in rows) == [0.0, 0.2, 0.5, 0.8]
    assert cli.main(["map", str(tmp_path), "--axes", "contact.frction"]) == 2
    assert "contact.friction" in capsys.readouterr().err
    assert cli.main(["map", str(tmp_path), "--axes", "contact.friction", "particle.velocity"]) == 2
    assert "--axes particle.velocity: all 4 points have the same value of this key" in capsys.readouterr().err


def test_levels_of_a_band_are_those_of_its_own_values() -> None:
    """Also of the ratio to the critical velocity, whose map has 1 in the middle."""
    band, mean = np.array([0.0, 0.005]), np.array([0.6, 1.2])
    assert _levels([band], "velocity_ratio", band=True).max() <= 0.01
    levels = _levels([mean], "velocity_ratio", band=False)
    assert levels[0] + levels[-1] == pytest.approx(2.0, abs=0.1)


def test_refine_keeps_materials_apart_and_counts_finished_points(tmp_path, capsys, monkeypatch) -> None:
    """Each metal gets a point between its own two velocities. A point that has failed has no metal."""
    for metal, velocities in (("Ni", (300, 500)), ("Ti", (700, 900))):
        made(tmp_path, Sweep.from_dict(points(material=[metal], velocity=[f"{v} m/s" for v in velocities])))
    (tmp_path / "failed.toml").write_text("preset = 3")  # of no metal that can be read
    (tmp_path / "failed.json").write_text('{"status": "failed", "reason": "no reason", "exit_code": 2}')
    found = []

    def run_it(folder: Path, name: str, text: str) -> None:
        (folder / f"{name}.toml").write_text(text)
        found.append(Scene.load(folder / f"{name}.toml").particle)
        pretend(folder, name, flattening_ratio=0.4)

    monkeypatch.setattr("coupler.studies.maps.run_point", run_it)
    drawn(tmp_path, capsys, "--refine", "2")
    assert [particle.material for particle in found] == ["Ni", "Ti"]
    assert 300.0 < found[0].velocity < 500.0
    assert 700.0 < found[1].velocity < 900.0


def test_numbers_whose_unit_has_a_blank_are_axes() -> None:
    scene: dict[str, Any] = {
        "materials": {"Ni": {"cp": "456 J/(kg K)"}}, "particle": {"offset": ["2 um", "0 um"]},
    }  # fmt: skip
    assert ("materials.Ni.cp", 456.0, "J/(kg K)") in list(scene_numbers(scene))
    set_key(scene, "particle.offset[2]", "3 um")
    assert scene["particle"]["offset"] == ["2 um", "3 um"]
    with pytest.raises(ValueError, match="not a key of a scene"):
        set_key(scene, "particle.offset[3]", "3 um")


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
    assert (tmp_path / "Ni_25um_670.8ms.toml").is_file()
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
