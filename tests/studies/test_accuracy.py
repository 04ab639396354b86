"""Accuracy against time: a scene at several numbers of points, choices of the resolution, the pace of a machine."""

import argparse
import re
from pathlib import Path
from types import SimpleNamespace

import errors as battery  # workflows/errors.py
import pytest
from runs import in_this_process
from scenes import SMALL, scene_with, several
from study_table import read_rows, table_rows

from coupler.commands import accuracy as command
from coupler.commands import main as cli
from coupler.commands.arguments import study_folder
from coupler.errors import ColdsprayError, SceneError, SolverError, StoreError
from coupler.measures import CONVERGING
from coupler.plan import cost as estimates
from coupler.plan import refinement
from coupler.plan.cost import forecast
from coupler.plan.planning import plan
from coupler.studies import accuracy, pace
from coupler.studies import runs as study_runs


def test_a_folder_keeps_to_its_scene(tmp_path):
    asked = argparse.Namespace(out=tmp_path / "a", scene=tmp_path / "scene.toml", force=False)
    for _ in range(2):
        assert study_folder(asked, scene_with(), "accuracy", ("scene.toml",)) == tmp_path / "a"
    with pytest.raises(StoreError, match="holds another study"):
        study_folder(asked, scene_with(particle__velocity="501 m/s"), "accuracy", ("scene.toml",))


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
    with pytest.raises(ColdsprayError, match=r"--within 0\.5s is too short: with 300 points"):
        command.chosen(scene, "0.5s", None)


@pytest.mark.usefixtures("known_pace")
def test_accuracy_chooses_the_coarsest_that_will_do():
    asked = 100 * max(refinement.forecast(3000)[key] for key in refinement.SHAPE)
    made, said = command.chosen(scene_with(), None, f"{asked:.6f}%")
    assert made.derived.points == pytest.approx(3000, rel=0.05)
    assert "shape within" in said
    with pytest.raises(ColdsprayError, match="which exceeds --within 3s"):
        command.chosen(scene_with(), "3s", f"{asked:.6f}%")
    unlike, _ = command.chosen(several({}, {"diameter": "15 um"}), None, "90%")
    assert unlike.derived.points_of(unlike.particles[-1]) >= estimates.LEAST_POINTS
    pile, _ = command.chosen(several({}, {"diameter": "20 um"}), None, f"{asked:.6f}%")
    assert pile.derived.points_of(pile.particles[-1]) >= 0.95 * refinement.points_for(asked / 100)
    with pytest.raises(
        ColdsprayError,
        match=r"--accuracy 0\.01% cannot be reached: with 64000 points",
    ):
        command.chosen(scene_with(), None, "0.01%")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--within", "soon"], "--within soon: "),
        (["--within", "0s"], "must be above zero"),
        (["--accuracy", "2"], "--accuracy '2' is not valid: give a percentage"),
        (["--accuracy", "0%"], "is not valid: give a percentage"),
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

    def fails():
        raise SolverError("it broke")

    assert pace.of_this_machine(fails).factor == 3.0
    pace.kept().write_text("3.0")
    broken = pace.of_this_machine(fails)
    assert broken.factor == 1.0
    assert "on this one failed (it broke)" in broken.source


def test_the_factor_carries_the_constants_to_another_machine():
    what = plan(scene_with())
    assert pace.Pace(2.0, "").seconds(what) == 2.0 * forecast(what).whole


@pytest.mark.usefixtures("known_pace")
def test_check_foretells_time_and_accuracy(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text(scene_with().to_toml())
    assert cli.main(["check", str(path), "-v"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"wall time  about \d+ s on one core here", text)
    assert re.search(r"error      expected: \+- .*flattening [\d.]+ %", text)
    first = text.splitlines().index(next(line for line in text.splitlines() if "wall time" in line))
    assert max(map(len, text.splitlines()[first : first + 5])) <= 120


def test_the_forecast_is_the_median_of_the_battery():
    """What `check` says is what docs/tables/errors.csv holds, to two digits (workflows/errors.py prints it)."""
    found = battery.forecast(table_rows("errors"))
    assert found == pytest.approx(refinement.FORECAST)


ORDER, SLOPE = 1.25, 0.6


def test_each_row_has_its_error_and_no_failure_is_hidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of exact values the error is the distance to the limit, times the safety factor (Eca & Hoekstra 2014); the coarsest row has none.
    One run fails, one has needed other numerics."""

    def results(folder: Path, scenes: dict[str, str], jobs: int, log: object) -> tuple[dict, dict[str, str]]:
        found = {}
        for name in scenes:
            n = int(name.partition("_")[0])
            values = {key: 1.0 for key in accuracy.COLUMNS if "_error" not in key} | {"points": n, "wall_s": n / 100.0}
            values |= dict.fromkeys(CONVERGING, 5e-6 * (1.0 + SLOPE * n ** (-ORDER / 3.0)))
            found[name] = SimpleNamespace(
                values=values, undecided=None, retries=[1] * (n == 2000), warnings=["retried"]
            )
        del found["3500_points"]
        return found, {"3500_points": "crushed flat"}

    monkeypatch.setattr(accuracy, "results", results)
    rows = accuracy.compute(scene_with(), tmp_path, accuracy.POINTS, 1, print)
    assert [row["points"] for row in rows] == list(accuracy.POINTS)
    assert {row["points"]: row["failed"] for row in rows if row["failed"]} == {2000: "retried", 3500: "crushed flat"}
    assert rows[0].get("crater_depth_m_error") is None
    error = 1.25 * 5e-6 * SLOPE * accuracy.POINTS[-1] ** (-ORDER / 3.0)
    assert rows[-1]["crater_depth_m_error"] == pytest.approx(error, rel=0.1)
    text = accuracy.lines(rows)
    assert text[0].split() == ["points", "500", "1000", "5000", "16000"]
    assert "3500 points: crushed flat" in text
    accuracy.draw(rows, tmp_path / "accuracy.png", "a <case> of $5")
    assert (tmp_path / "accuracy.png").read_bytes().startswith(b"\x89PNG")


def test_points_that_are_too_few_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="--points 20 is too coarse"):
        accuracy.compute(scene_with(), tmp_path, (20, 1000), 1, print)


def test_the_command_computes_a_scene_at_several_numbers_of_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study_runs, "compute", in_this_process)
    (tmp_path / "small.toml").write_text(SMALL)
    command = ["accuracy", str(tmp_path / "small.toml"), "--out", str(tmp_path / "out"), "--points", "200", "300"]
    for _ in range(2):  # then from the finished runs
        assert cli.main([*command, "--quiet"]) == 0
    found = read_rows(tmp_path / "out" / "accuracy.csv")
    assert [r["points"] for r in found] == ["200", "300"]
    assert all(float(r["flattening_ratio_total"]) > 0.0 and not r["failed"] for r in found)
    assert (tmp_path / "out" / "accuracy.png").is_file()


@pytest.mark.usefixtures("known_pace")
def test_numbers_of_points_that_a_scene_refuses_are_not_chosen():
    """Small pores need a fine spacing."""
    porous = scene_with(particle__porosity=0.03, particle__pore_diameter="4 um")
    with pytest.raises(SceneError):
        refinement.at_points(porous, 300)
    made, _ = command.chosen(porous, None, "60%")
    assert made.derived.points > 300


def test_ranks_of_one_run_do_not_choose_its_resolution_each_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their machines can differ in speed, and the plans of one run must not."""
    monkeypatch.setenv("PMI_SIZE", "2")
    with pytest.raises(ColdsprayError, match="--within is for one process"):
        command.chosen(scene_with(), "60s", None)
