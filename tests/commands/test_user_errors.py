"""Mistakes of users that end with one message which names the field or file and the remedy."""

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import scenes
from runs import SharedRuns
from sweeps import points, pretend

from coupler import Scene
from coupler.commands import watch
from coupler.commands.accuracy import chosen
from coupler.commands.main import main
from coupler.deposition.run import resume
from coupler.errors import CheckpointError, SceneError, StoreError, UnreadableError
from coupler.files import checkpoint
from coupler.files.outputs import claim_folder
from coupler.files.result import Result
from coupler.files.store import Store, StoreState
from coupler.measures import STICKS
from coupler.physics.adhesion import PairFormula
from coupler.plan.planning import plan
from coupler.spray.window import Spray
from coupler.studies.runs import of_another_scene, write_scene
from coupler.studies.sweep import Sweep

COATING = """[coating]
material = "Ni"
number = 4
radius = "10 um"
diameter = "22 um"
velocity = "600 m/s"
layers = 1
{more}
[substrate]
material = "SS304"
"""


def problems(text: str) -> list[str]:
    with pytest.raises(SceneError) as refused:
        Scene.from_text(text, "x")
    return refused.value.problems


def test_ambient_stays_below_the_melting_point() -> None:
    text = scenes.scene(("Ni", 25, 500)) + '[end]\nat = "cold"\nambient = "5000 K"\n'
    assert problems(text)[0].startswith('end.ambient = "5000 K": must be below')


def test_a_value_without_quotes_is_told_by_its_line() -> None:
    (problem,) = problems(scenes.NI.replace('"500 m/s"', "500 m/s"))
    assert "velocity = 500 m/s" in problem
    assert 'write a value with its unit in quotes, such as "25 um"' in problem


def test_an_example_has_the_type_of_the_field() -> None:
    (problem,) = problems(COATING.format(more="").replace("number = 4\n", ""))
    assert problem == "coating.number: missing; add for example number = 40"


def test_many_particles_with_one_mistake_are_told_once() -> None:
    text = COATING.format(more="").replace("number = 4", "number = 200").replace('"10 um"', '"2000 um"')
    told = problems(text)
    assert len(told) < 12
    assert told[-1].endswith("more problems of other particles")


def test_hot_particles_are_told_in_one_line() -> None:
    text = COATING.format(more="spread = 1.1").replace("number = 4", "number = 40").replace("600 m/s", "1200 m/s")
    notes = [note for note in plan(Scene.from_text(text, "x")).warnings if "may reach" in note]
    assert len(notes) == 1
    assert "and 37 more may reach" in notes[0]


@pytest.mark.parametrize("pattern", ["{folder}/nothing.stl", "a**b"])
def test_shapes_that_are_not_there(tmp_path: Path, pattern: str) -> None:
    (problem,) = problems(COATING.format(more=f'files = "{pattern.format(folder=tmp_path)}"'))
    assert "no file in" in problem


def test_a_folder_of_another_command_is_not_taken(tmp_path: Path) -> None:
    claim_folder(tmp_path, "run", ["scene.toml"], force=False)
    with pytest.raises(StoreError, match="holds the results of coldspray run"):
        claim_folder(tmp_path, "sweep", ["sweep.csv"], force=None)


def test_a_band_of_efficiency_holds_the_efficiency() -> None:
    """Also where most of it is lost to erosion: then a lower critical velocity deposits less."""
    ones = np.ones(3)
    formula = (PairFormula("Cu", 600.0),) * 3
    spray = Spray(np.array([0.0, 0.5, 1.0]), 25e-6 * ones, 900.0 * ones, 300.0 * ones, 300.0 * ones, formula)
    assert spray.fates()[STICKS] == 1.0
    for within, band in ((0.9, [0.0, 1.0]), (0.1, [1.0, 1.0]), (1.0, [0.0, 1.0])):
        assert [spray.fates(factor)[STICKS] for factor in spray.extremes(within)] == band


def test_more_time_needs_a_finished_run_with_a_checkpoint(shared_run: SharedRuns, tmp_path: Path) -> None:
    copy = shutil.copytree(shared_run(scenes.SHORT).directory, tmp_path / "run")
    checkpoint.clear(copy)
    with pytest.raises(CheckpointError, match="has no checkpoint: compute the scene again"):
        resume(copy, until=20e-9, quiet=True)
    (copy / "summary.json").unlink()
    with pytest.raises(CheckpointError, match="is not finished: first resume it without --until"):
        resume(copy, until=20e-9, quiet=True)


def test_what_cannot_be_read_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fields without the permission to read them stay as they are; a checkpoint is not called damaged."""
    with Store.create(tmp_path / "run", "") as store:
        store.write("particle", 0.0, np.zeros((1, 3)), np.zeros((1, 1), int), {"T": np.zeros(1)})
        state = store.state()
    checkpoint.write(tmp_path, state, {})

    def refused(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = tmp_path / "run" / "particle.vtkhdf"
    kept = path.read_bytes()
    with monkeypatch.context() as without:
        without.setattr("coupler.files.fields.h5py", SimpleNamespace(**vars(h5py) | {"File": refused}))
        with Store.reopen(tmp_path / "run") as store, pytest.raises(UnreadableError, match="cannot be read"):
            store.go_on(state, print)
    assert path.read_bytes() == kept
    monkeypatch.setattr("builtins.open", refused)
    with pytest.raises(UnreadableError, match="cannot be read"):
        checkpoint.latest(tmp_path, StoreState, {})


def test_fields_that_are_damaged_are_kept_beside_the_new_ones(tmp_path: Path) -> None:
    with Store.create(tmp_path, "") as store:
        store.write("particle", 0.0, np.zeros((1, 3)), np.zeros((1, 1), int), {"T": np.zeros(1)})
        state = store.state()
    (tmp_path / "particle.vtkhdf").write_bytes(b"nothing")
    told: list[str] = []
    with Store.reopen(tmp_path) as store:
        store.go_on(state, told.append)
    assert (tmp_path / "particle.vtkhdf.damaged").read_bytes() == b"nothing"
    assert "particle.vtkhdf.damaged" in told[0]


def test_watching_bears_files_that_vanish(shared_run: SharedRuns, tmp_path: Path) -> None:
    result = shared_run(scenes.SHORT)
    for name in ("scene.toml", "history.csv", "run.log", "summary.json"):
        (tmp_path / name).write_bytes((result.directory / name).read_bytes())
    os.symlink("nowhere", tmp_path / "checkpoint-000001.ckpt")
    assert "ns" in watch.state(Result(tmp_path))


def test_a_log_that_cannot_be_written_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "a.toml"
    scene.write_text(scenes.SHORT)
    (tmp_path / "out" / "log.lammps").mkdir(parents=True)
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "-q", "--force"]) == 2
    assert "log.lammps" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("resolution.growth", '"1"', "expected a number without unit or quotes"),
        ("contact.friction", "true", "expected a number without unit, from 0 to 2"),
    ],
)
def test_a_wrong_type_is_told_in_words_of_the_scene(key: str, value: str, words: str) -> None:
    with pytest.raises(SceneError) as refused:
        Scene.from_text(scenes.NI, "x", [(key, value)])
    assert refused.value.problems == [f"{key} = {value}: {words}"]


def test_a_changed_sweep_does_not_replace_what_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Points of the same names, of another substrate."""
    one = Sweep.from_dict(points(diameter=["25 um"]))
    for name in one.points:
        write_scene(tmp_path / "runs", name, one.points[name])
    pretend(tmp_path / "runs", next(iter(one.points)), flattening_ratio=0.5)
    other = points(diameter=["25 um"]) | {"scene": {"preset": "draft", "substrate": {"material": "Al"}}}
    changed = Sweep.from_dict(other)
    assert of_another_scene(tmp_path / "runs", one.points) == []
    assert of_another_scene(tmp_path / "runs", changed.points) == [next(iter(one.points))], "the other has no result"
    (tmp_path / "few.toml").write_text(
        'name = "few"\n[scene]\npreset = "draft"\nsubstrate.material = "Al"\n[points]\nmaterial = ["Ni"]\n'
        'diameter = ["25 um"]\nvelocity = ["400 m/s", "700 m/s"]\ntemperature = ["300 K"]\n'
    )
    assert main(["sweep", str(tmp_path / "few.toml"), "--out", str(tmp_path / "runs")]) == 2
    said = capsys.readouterr().err
    assert "holds results of 1 points" in said
    assert "--force" in said
    assert (tmp_path / "runs" / f"{next(iter(one.points))}.toml").read_text() == next(iter(one.points.values()))
    assert main(["sweep", str(tmp_path / "few.toml"), "--out", str(tmp_path / "new"), "--slurm", "cores=2"]) == 2
    assert "--slurm: the executor is" in capsys.readouterr().err


def test_a_map_of_a_measure_that_no_run_has_is_not_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = Sweep.from_dict(points(diameter=["25 um"]))
    for name in few.points:
        write_scene(tmp_path, name, few.points[name])
        pretend(tmp_path, name, flattening_ratio=0.5)
    assert main(["map", str(tmp_path), "--show", "crater_depth_m"]) == 0
    assert "no map, because no point has this measure" in capsys.readouterr().out
    assert not list(tmp_path.glob("*.png"))


def test_a_resolution_that_is_chosen_says_what_it_takes_the_place_of() -> None:
    free = [("resolution.spacing", None), ("resolution.element_size", None)]
    given = Scene.from_text(scenes.NI, "x", [("resolution.spacing", '"1 um"'), free[1]])
    assert chosen(given, None, "5%")[1].endswith("; this replaces resolution.spacing in the scene")
    assert "in place" not in chosen(Scene.from_text(scenes.NI, "x", free), None, "5%")[1]


def test_too_few_points_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.toml").write_text(scenes.NI)
    assert main(["accuracy", str(tmp_path / "x.toml"), "--out", str(tmp_path / "a"), "--points", "0"]) == 2
    assert "--points 0 is too coarse" in capsys.readouterr().err
