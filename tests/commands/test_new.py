"""From nothing: scenes written by the program run, and editors can check them."""

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from coupler.commands import new
from coupler.commands.main import main
from coupler.physics.shapes import SHAPES
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.spray.nozzles import library
from coupler.studies.maps import FEWEST_VALUES
from coupler.studies.sweep import Sweep

WORKFLOWS = Path(__file__).parents[2] / "workflows"
CHECKER = jsonschema.Draft4Validator


@pytest.mark.parametrize("kind", ["single", "pair", "coating"])
def test_a_new_scene_has_a_plan_and_fits_the_schema(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", kind, f"my_{kind}"]) == 0
    text = Path(f"my_{kind}.toml").read_text()
    assert f"coldspray run my_{kind}.toml" in text
    assert plan(Scene.load(f"my_{kind}.toml")).preset == "draft"
    assert text.splitlines()[0] == "#:schema scene.schema.json"
    CHECKER(json.loads(Path("scene.schema.json").read_text())).validate(tomllib.loads(text))
    assert main(["new", kind, f"my_{kind}.toml"]) == 2
    assert "add --force" in capsys.readouterr().err
    assert main(["new", kind, f"my_{kind}.toml", "--force"]) == 0


def test_a_new_scene_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "single", "first"]) == 0
    assert "materials.first" not in Path("first.toml").read_text()  # what is replaced is the name of the file alone
    assert (
        main(
            [
                "run",
                "first.toml",
                "-q",
                "--threads=1",
                "--set=resolution.spacing=3.3 um",
                "--set=end.at=",
                "--set=end.time=5 ns",
            ]
        )
        == 0
    )
    assert (tmp_path / "runs" / "first" / "summary.json").is_file()


def test_a_new_map_is_a_sweep_with_values_enough_for_a_surface(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "map", "few"]) == 0
    sweep = Sweep.load("few.toml")
    scenes = [Scene.from_text(text, name).particle for name, text in sweep.points.items()]
    for values in ({p.velocity for p in scenes}, {p.temperature for p in scenes}):
        assert len(values) >= FEWEST_VALUES
    assert not sweep.refused


def test_the_list_has_a_line_for_each_kind_and_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [*new.KINDS, *new.EXAMPLES]
    assert main(["new", "single"]) == main(["new"]) == 2
    assert "coldspray new --list" in capsys.readouterr().err


@pytest.mark.parametrize("name", new.EXAMPLES)
def test_an_example_is_written_under_a_name(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", name, "mine"]) == 0
    assert "workflows/" not in Path("mine.toml").read_text()
    reader = Sweep if name == "map_ni" else Scene
    assert reader.load("mine.toml")
    assert Path("scene.schema.json").is_file() == (reader is Scene)


def test_a_wheel_has_the_examples() -> None:
    pyproject = tomllib.loads((WORKFLOWS.parent / "pyproject.toml").read_text())
    included = pyproject["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    scenes = {f"workflows/{name}.toml": f"coupler/workflows/{name}.toml" for name in new.EXAMPLES}
    assert included == {"lammps_inputs": "coupler/lammps_inputs"} | scenes


def test_new_points_become_a_mesh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mesh", "lens"]) == 0
    command = Path("lens.csv").read_text().splitlines()[0].removeprefix("# coldspray ").split()
    assert main([*command, "--size", "4um"]) == 0
    assert Path("lens_mesh.vtu").is_file()


def test_names_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "single", str(tmp_path / "ä b")]) == 2
    assert "use letters, digits" in capsys.readouterr().err


def test_a_schema_of_others_is_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / new.SCHEMA
    path.write_text("{}")
    assert main(["schema", "--out", str(path)]) == 2
    assert path.read_text() == "{}"
    assert "was not written by coldspray" in capsys.readouterr().err


@pytest.mark.parametrize("path", sorted(WORKFLOWS.glob("*.toml")), ids=lambda path: path.stem)
def test_scenes_name_the_schema_and_fit_it(path: Path) -> None:
    text = path.read_text()
    if "\n[substrate]" not in text:
        return  # a table of numbers, or a sweep
    assert text.splitlines()[0] == f"#:schema {new.SCHEMA}"
    schema = json.loads((WORKFLOWS / new.SCHEMA).read_text())
    CHECKER.check_schema(schema)
    CHECKER(schema).validate(tomllib.loads(text))
    CHECKER(schema).validate(tomllib.loads(Scene.load(path).to_toml()))


@pytest.mark.parametrize(
    "wrong",
    [
        {"particle": {"material": "Ni", "diameter": 25.0, "velocity": "500 m/s"}},
        {"particle": {"material": "Ni", "diameter": "25 m/s", "velocity": "500 m/s"}},
        {"particle": {"material": "Ni", "velocity": "500 m/s"}},
        {"contact": {"friktion": 0.3}},
        {"contact": {"friction": 3.0}},
        {"preset": "rough"},
        {"effects": ["auto", "-frictoin"]},
        {
            "coating": {
                "material": "Ni",
                "number": 4,
                "radius": "9 um",
                "diameter": "9 um",
                "velocity": [["9 um", "9 um"]],
            }
        },
    ],
)
def test_the_schema_finds_mistakes(wrong: dict[str, object]) -> None:
    right = {
        "particle": {"material": "Ni", "diameter": "25 µm", "velocity": "500 m/s"},
        "substrate": {"material": "Al"},
    }
    schema = json.loads(new._schema())
    assert CHECKER(schema).is_valid(right)
    assert not CHECKER(schema).is_valid({**right, **wrong})


def test_the_schema_marks_the_wrong_key_alone() -> None:
    """Not its table, as an editor would with `anyOf` over one particle and several."""
    wrong = {"material": "Ni", "diameter": "25 m/s"}
    for particle, path in ((wrong, ["particle", "diameter"]), ([wrong], ["particle", 0, "diameter"])):
        scene = {"particle": particle, "substrate": {"material": "Al"}}
        assert [list(error.path) for error in CHECKER(json.loads(new._schema())).iter_errors(scene)] == [path]


def test_the_stored_schema_is_that_of_the_models() -> None:
    assert (WORKFLOWS / new.SCHEMA).read_text() == new._schema(), "coldspray schema --out workflows/scene.schema.json"


def test_shapes_and_nozzles_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["shapes"]) == main(["nozzles"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in (*SHAPES, *library()))


def test_a_new_ensemble_is_a_sweep_over_distributions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "ensemble", "scatter"]) == 0
    sweep = Sweep.load("scatter.toml")
    assert sweep.is_ensemble
    assert len(sweep.points) == 32
    assert not sweep.refused


def test_the_schema_of_jobs_knows_a_new_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "--of", "job"]) == 0
    checker = CHECKER(json.loads(capsys.readouterr().out))
    assert main(["new", "job", str(tmp_path / "cu")]) == 0
    job = tomllib.loads((tmp_path / "cu.toml").read_text())
    assert checker.is_valid(job)
    job["powder"]["sizes"] = ["18 um", "26 um", "38 um"]
    assert checker.is_valid(job)
    assert not checker.is_valid(job | {"within": "30 um"})
    assert not checker.is_valid(job | {"powder": {"material": "Cu"}})
