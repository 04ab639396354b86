"""Accuracy against time: the ladder, what is fitted to it, choices, the pace of a machine, the command."""

import argparse
import json
import re
from pathlib import Path

import errors as battery  # workflows/errors.py
import numpy as np
import pytest
from matplotlib.figure import Figure
from pages import table_rows
from scenes import scene_with, several

from coupler import __version__
from coupler.commands import accuracy as command
from coupler.commands import main as cli
from coupler.commands.arguments import study_folder
from coupler.errors import SolverError, StoreError
from coupler.measures import CONVERGING
from coupler.plan import cost as estimates
from coupler.plan import refinement
from coupler.plan.forecast import forecast
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.progress import Progress
from coupler.studies import accuracy_figures as draw
from coupler.studies import accuracy_fit as fit
from coupler.studies import ladder, pace, timing
from coupler.studies.table import StudyTable, read_rows

MEASURED = {
    "flattening_ratio": (0.57, -0.2), "flattening_ratio_total": (0.38, -0.4), "crater_depth_m": (5e-6, 0.6),
    "splat_diameter_m": (35e-6, -0.5), "eps_p_mean": (0.7, -1.2), "eps_p_p99": (2.8, -3.0), "eps_p_max": (4.5, -5.0),
    "T_mean_K": (107.0, -0.5), "T_p99_K": (330.0, -2.0), "T_max_K": (360.0, -3.0), "rebound_velocity_m_s": (27.0, 4.0),
}  # fmt: skip
ORDER = 1.25


def row(setting: ladder.LadderPoint, failed: str = "", off: float = 0.0) -> dict[str, str]:
    """A rung whose measures go with h^ORDER; off: a share by which its setting moves all of them."""
    h = setting.points ** (-1 / 3)
    found = {name: limit * (1.0 + slope * h**ORDER + off) + (300.0 if name.startswith("T_") else 0.0)
             for name, (limit, slope) in MEASURED.items()}  # fmt: skip
    told = {"axis": setting.axis, "setting": setting.name, "points": setting.points, "points_used": setting.points}
    told |= {"elements": 5000, "steps": 500, "dt_mean_s": 1e-10, "sim_time_s": 5e-8, "cpu_s": 0.005 * setting.points}
    told |= {"cpu_loop_s": 1.0, "wall_s": 2.0, "numerical_dissipation": 0.05, "energy_drift": 0.001, "failed": failed}
    measures = dict.fromkeys(found, "") if failed else found
    return {name: str((told | measures)[name]) for name in ladder.COLUMNS} | {"version": __version__}


@pytest.fixture(scope="module")
def rows() -> list[dict[str, str]]:
    rungs = ladder.ladder_points()
    off = {"viscosity": 0.02, "contact stiffness": -0.01}
    return [row(r, "crushed flat" if r.name == "2 dt" else "", off.get(r.axis, 0.0)) for r in rungs]


def test_the_rungs_vary_one_thing_at_a_time():
    rungs = ladder.ladder_points()
    assert {r.axis for r in rungs} == {"points", "reference", "effects", *ladder.KNOBS}
    assert len({r.key for r in rungs}) == len(rungs)
    assert rungs[-1].axis == "reference"
    assert all(r.points < rungs[-1].points for r in rungs[:-1])
    scene = scene_with(preset="draft", resolution__spacing="2 um")
    changes = {r.name: {} if r.effects is None else {"effects": r.effects} for r in rungs}
    by_name = {r.name: refinement.at_points(scene, r.points, changes[r.name], r.element) for r in rungs}
    assert by_name["3500 points"].derived.points == 3500
    assert by_name["3500 points"].derived.element_size == pytest.approx(1.7 * by_name["3500 points"].derived.spacing)
    assert by_name["2.5 spacings"].derived.element_size == pytest.approx(2.5 * by_name["2.5 spacings"].derived.spacing)
    assert by_name["effects none"].effects == "none"
    assert by_name["3500 points"].particles == scene.particles
    assert {r.axis for r in ladder.ladder_points(knobs_at=None)} == {"points", "reference"}


def test_a_reference_that_is_no_finer_is_refused():
    with pytest.raises(StoreError, match="--reference 5000 must be finer"):
        ladder.ladder_points(reference=5000)
    with pytest.raises(StoreError, match="more than 700"):
        ladder.ladder_points((300,), 600, 700)


def test_a_ladder_goes_on_where_it_was_and_hides_no_failure(tmp_path, monkeypatch):
    rungs, computed = ladder.ladder_points((1000, 1200), 2000, 1000), []

    def compute(scene, rung, folder, progress):
        computed.append(rung.key)
        if rung.key == ("viscosity", "Q1 0", "1000") and computed.count(rung.key) == 1:
            raise KeyboardInterrupt
        return row(rung, "crushed flat" if rung.name == "2 dt" else "") | {"cpu_s": 1.0}

    monkeypatch.setattr(ladder, "compute", compute)
    monkeypatch.setattr(ladder, "_warm_up", lambda out, say: None)
    path, said = tmp_path / "accuracy.csv", []
    for expected in (KeyboardInterrupt, None):
        table = StudyTable(path, ladder.COLUMNS, ladder.KEY, "made by a test")
        if expected:
            with pytest.raises(expected):
                ladder.compute_missing(scene_with(), tmp_path, rungs, table, said.append)
        else:
            ladder.compute_missing(scene_with(), tmp_path, rungs, table, said.append)
    assert computed == [r.key for r in rungs[: computed.index(rungs[7].key)]] + [
        r.key for r in rungs[computed.index(rungs[7].key) :] for _ in range(1 + (r.name == "Q1 0"))
    ]
    found = read_rows(path)
    assert [(r["axis"], r["setting"], r["points"]) for r in found] == [r.key for r in rungs]
    assert [r["failed"] for r in found if r["setting"] == "2 dt"] == ["crushed flat"]
    assert any("crushed flat" in text for text in said)
    coarse = ladder.ladder_points((300,), 600, 300)
    ladder.compute_missing(
        scene_with(), tmp_path, coarse, StudyTable(path, ladder.COLUMNS, ladder.KEY, ""), said.append
    )
    (refused,) = (r for r in read_rows(path) if (r["setting"], r["points"]) == ("2.5 spacings", "300"))
    assert "too coarse for the crater" in refused["failed"]  # not a scene, and a row all the same
    path.write_text("points,flattening\n1,2\n")
    with pytest.raises(StoreError, match="has other columns"):
        StudyTable(path, ladder.COLUMNS, ladder.KEY, "")


def test_a_folder_keeps_to_its_scene(tmp_path):
    asked = argparse.Namespace(out=tmp_path / "a", scene=tmp_path / "scene.toml", force=False)
    for _ in range(2):
        assert study_folder(asked, scene_with(), "accuracy", ("scene.toml",)) == tmp_path / "a"
    with pytest.raises(StoreError, match="the study of another scene"):
        study_folder(asked, scene_with(particle__velocity="501 m/s"), "accuracy", ("scene.toml",))


def test_orders_and_limits_that_are_there_are_found(rows):
    found = [fit.fit_order(*fit.resolutions(rows, m, 300.0)) for m in MEASURED]
    assert all(order == pytest.approx(ORDER, abs=0.03) for order, _, _ in found)
    best = fit.reference(rows)
    assert best is not None
    off = dict(zip((r["setting"] for r, _ in fit.errors(rows, "crater_depth_m", 300.0)),
                   (e for _, e in fit.errors(rows, "crater_depth_m", 300.0)), strict=True))  # fmt: skip
    coarse, fine = (n ** (-ORDER / 3) for n in (1000, ladder.REFERENCE))
    exact = 100 * 0.6 * (coarse - fine) / (1 + 0.6 * fine)
    assert off["1000 points"] == pytest.approx(exact)
    assert "2 dt" not in off
    with pytest.raises(ValueError, match="4 resolutions"):
        fit.fit_order(*fit.resolutions(rows[:2], "crater_depth_m", 300.0))
    h = np.array([500.0, 1000, 2000, 4000, 8000]) ** (-1 / 3)
    assert fit.fit_order(h, -np.log(h))[0] == fit.ORDERS[0]
    assert fit.fit_order(h, np.array([1.0, 1.02, 0.99, 1.01, 1.0]))[1:] == (fit.ORDERS[0], fit.ORDERS[-1])


@pytest.fixture
def known_pace(monkeypatch):
    monkeypatch.setattr(command, "here", lambda recalibrate=False: pace.Pace(1.0, "as the constants are"))


@pytest.mark.usefixtures("known_pace")
def test_within_takes_the_finest_there_is_time_for():
    scene = scene_with()
    made, said = command.chosen(scene, "60s", None)
    assert 50.0 < forecast(plan(made)).whole <= 60.0
    assert f"{made.derived.points} points" in said
    assert made.derived.element_size == pytest.approx(estimates.ELEMENT_SIZE_OVER_SPACING * made.derived.spacing)
    assert command.chosen(scene, "5 min", None)[0].derived.points > made.derived.points
    with pytest.raises(refinement.AccuracyError, match=r"--within 0\.5s is too short: at 300 points"):
        command.chosen(scene, "0.5s", None)


@pytest.mark.usefixtures("known_pace")
def test_accuracy_chooses_the_coarsest_that_will_do():
    asked = 100 * max(refinement.forecast(3000)[key] for key in refinement.SHAPE)
    made, said = command.chosen(scene_with(), None, f"{asked:.6f}%")
    assert made.derived.points == pytest.approx(3000, rel=0.05)
    assert "shape within" in said
    with pytest.raises(refinement.AccuracyError, match="more than --within 3s"):
        command.chosen(scene_with(), "3s", f"{asked:.6f}%")
    unlike, _ = command.chosen(several({}, {"diameter": "15 um"}), None, "90%")
    assert unlike.derived.points_of(unlike.particles[-1]) >= estimates.LEAST_POINTS
    pile, _ = command.chosen(several({}, {"diameter": "20 um"}), None, f"{asked:.6f}%")
    assert pile.derived.points_of(pile.particles[-1]) >= 0.95 * refinement.points_for(asked / 100)
    with pytest.raises(
        refinement.AccuracyError, match=r"--accuracy 0\.01% cannot be reached: the error of the shape at 64000 points"
    ):
        command.chosen(scene_with(), None, "0.01%")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--within", "soon"], "--within soon: "),
        (["--within", "0s"], "must be more than zero"),
        (["--accuracy", "2"], "--accuracy '2' is not an uncertainty"),
        (["--accuracy", "0%"], "is not an uncertainty"),
        (["--accuracy", "0.001%"], "cannot be reached"),
    ],
)
def test_what_cannot_be_chosen_is_one_clear_message(options, complaint, tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text(scene_with().to_toml())
    assert cli.main(["run", str(path), "--out", str(tmp_path / "run"), *options]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_the_pace_is_timed_once_and_remembered(tmp_path, monkeypatch):
    monkeypatch.setenv("COLDSPRAY_CACHE", str(tmp_path))
    times = iter([2.0, 3.0])
    first, second = (pace.of_this_machine(lambda: next(times)) for _ in range(2))
    assert first.factor == second.factor == 2.0
    assert pace.of_this_machine(lambda: next(times), anew=True).factor == 3.0
    path = tmp_path / "pace.json"
    assert list(json.loads(path.read_text())) == [pace.machine()]

    def fails():
        raise SolverError("it broke")

    assert pace.of_this_machine(fails).factor == 3.0
    path.write_text('{"x": ')
    broken = pace.of_this_machine(fails)
    assert broken.factor == 1.0
    assert "timing this one failed (it broke)" in broken.source


def test_the_factor_carries_the_constants_to_another_machine(monkeypatch):
    disturbed = iter([3.0, 2.0])  # the faster of two counts
    monkeypatch.setattr(timing, "_timed", lambda: next(disturbed))
    factor = timing.measure()
    assert factor == 2.0
    what = plan(scene_with())
    assert pace.Pace(factor, "").seconds(what) == 2.0 * forecast(what).whole


@pytest.mark.usefixtures("known_pace")
def test_check_foretells_time_and_accuracy(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text(scene_with().to_toml())
    assert cli.main(["check", str(path), "-v"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"wall time  about \d+ s on one core here", text)
    assert re.search(r"error      a forecast: \+- .*flattening [\d.]+ %", text)
    first = text.splitlines().index(next(line for line in text.splitlines() if "wall time" in line))
    assert max(map(len, text.splitlines()[first : first + 5])) <= 120


def test_the_ladder_is_told_with_the_error_of_each_rung(rows):
    """Of exact values it is the distance to the limit, times the safety factor (Eca & Hoekstra 2014); the coarsest has none."""
    found = fit.errors_of_ladder(rows, "crater_depth_m")
    assert found[0][1] is None
    row, error = found[-1]
    assert row["axis"] == "reference"
    assert error == pytest.approx(1.25 * 5e-6 * 0.6 * ladder.REFERENCE ** (-ORDER / 3), rel=0.05)
    head, times, *measures = draw.lines(rows)
    assert head.split()[-1] == str(ladder.REFERENCE)
    assert times.startswith("processor time")
    assert len(measures) == len(CONVERGING)
    assert sum("±" in text for text in measures) == len(CONVERGING)


def test_the_forecast_is_the_median_of_the_battery():
    """What `check` says is what docs/tables/errors.csv holds, to two digits (workflows/errors.py prints it)."""
    found = battery.forecast(table_rows("errors"))
    assert found == pytest.approx(refinement.FORECAST)


def test_rows_of_another_version_are_named(rows, tmp_path):
    older = [row | {"version": "0.0.9"} if row["setting"] == "2000 points" else row for row in rows]
    page = draw.html(older, "a case", 300.0, Figure())
    assert page.count("(version 0.0.9)") == 1


def test_diagram_and_page_hide_nothing(rows, tmp_path):
    picture, page = draw.write(rows, tmp_path, "a <case>", 300.0)
    assert picture.read_bytes().startswith(b"\x89PNG")
    text = page.read_text()
    assert "a &lt;case&gt;" in text
    for said in (
        "crushed flat",
        "2 dt",
        "1000 points (draft)",
        "5000 points (standard)",
        "16000 points (fine)",
        "local maxima",
    ):
        assert said in text
    assert "<script src" not in text
    assert '<link rel="stylesheet' not in text
    figure = draw.diagram(rows, "a case", 300.0)
    assert len(figure.axes) == len(CONVERGING)
    assert all(panel.get_xscale() == panel.get_yscale() == "log" for panel in figure.axes)
    assert any("draft" in text.get_text() for text in figure.axes[0].texts)
    assert draw.order_of(rows, "crater_depth_m", 300.0).startswith("order 1.2")


SMALL = """
[particle]
material = "Ni"
diameter = "10 um"
velocity = "500 m/s"
[substrate]
material = "SS304"
diameter = "60 um"
height = "30 um"
[end]
time = "3 ns"
"""


@pytest.fixture(scope="module")
def climbed(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("ladder")
    (folder / "small.toml").write_text(SMALL)
    how = ["--points", "200", "300", "--reference", "400", "--knobs-at", "0", "--quiet"]
    assert cli.main(["accuracy", str(folder / "small.toml"), "--out", str(folder / "out"), *how]) == 0
    return folder / "out"


def test_the_command_computes_a_ladder(climbed):
    found = read_rows(climbed / "accuracy.csv")
    assert [r["points"] for r in found] == ["200", "300", "400"]
    assert not any(r["failed"] for r in found)
    assert all(0.0 < float(r["cpu_loop_s"]) < float(r["cpu_s"]) for r in found)
    assert all(float(r["flattening_ratio_total"]) > 0.0 for r in found)
    assert (climbed / "accuracy.png").is_file()
    assert (climbed / "accuracy.html").is_file()
    assert not list((climbed / "runs").glob("*points*"))


def test_a_setting_that_fails_is_a_row(tmp_path, monkeypatch):
    def breaks(*_, **__):
        raise SolverError("it broke\nin two lines")

    monkeypatch.setattr(ladder, "run", breaks)
    scene = Scene.from_text(SMALL, "small")
    found = ladder.compute(scene, ladder.LadderPoint("dt", "2 dt", 300), tmp_path / "run", Progress(quiet=True))
    assert found["failed"] == "it broke in two lines"
    assert "flattening_ratio" not in found
