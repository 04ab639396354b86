"""Keys of a scene set on the command line: read as in a file, and the file's own comments stay."""

import tomllib
from pathlib import Path

import pytest

from coupler.commands.main import main
from coupler.errors import SceneError
from coupler.plan.reading import Scene

WORKFLOWS = Path(__file__).parents[2] / "workflows"
SCENES = sorted(path for path in WORKFLOWS.glob("*.toml") if path.read_text().startswith("#:schema"))
SINGLE, TRIPLE = (str(WORKFLOWS / f"{name}_ni.toml") for name in ("single", "triple"))


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["check", *arguments]) == 2
    return capsys.readouterr().err


def test_settings_take_the_place_of_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    settings = ["particle[2].velocity=600 m/s", 'particle[3].material="Ti"', "contact.friction=0.25", "adhesion.kind="]
    assert main(["check", TRIPLE, "--preset", "draft", *(f"--set={text}" for text in settings)]) == 0
    text = capsys.readouterr().out
    for words in ("(draft)", "impact 2   Ni sphere 22 um, 600 m/s", "impact 3   Ti", "friction   0.25", "critical one"):
        assert words in text


def test_a_key_set_after_a_table_among_dotted_keys_is_the_scene_s() -> None:
    """It came into the table of the metal, and the scene was refused."""
    text = 'materials.Ni.G = "76 GPa"\n' + Path(SINGLE).read_text().replace('effects = "auto"', "", 1)
    scene = Scene.from_text(text, settings=[("materials.Ti.G", "'31 GPa'"), ("effects", "['auto', '-friction']")])
    assert scene.effects == ["auto", "-friction"]


def test_a_preset_takes_the_place_of_the_scene_s_own_resolution(tmp_path: Path) -> None:
    path = tmp_path / "fine.toml"
    path.write_text(Path(SINGLE).read_text() + '[resolution]\nspacing = "0.5 um"\ngrowth = 0.2\n')
    assert main(["check", str(path), "--preset", "draft"]) == 0
    scene = Scene.load(path, [("preset", "draft"), ("resolution.spacing", None)])
    assert (scene.resolution.spacing, scene.resolution.growth) == (None, 0.2)


def test_all_problems_of_settings_are_those_of_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    text = refused(
        capsys, TRIPLE, "--set", "particle[2].velocity=600", "--set", "contact.friktion=1", "--set", "preset=rough"
    )
    assert "3 problems" in text
    for words in (
        "particle[2].velocity = 600 needs a velocity",
        'did you mean "friction"',
        "one of draft, standard, fine",
    ):
        assert words in text


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("particle.velocity=1 m/s", 'name one of them, such as "particle[1]"'),
        ("particle[4].velocity=1 m/s", 'name one of them, such as "particle[1]"'),
        ("substrate[2].height=1 um", "no table substrate[2]"),
        ("preset.x=1", "preset is no table"),
        ("a..b=1", "not a key of a scene"),
        ("particle[1]=1", "not a key of a scene"),
        ("effects=" + 2000 * "[", "effects = "),
    ],
)
def test_keys_that_cannot_be_set(capsys: pytest.CaptureFixture[str], setting: str, words: str) -> None:
    assert words in refused(capsys, TRIPLE, "--set", setting)


def test_a_setting_needs_a_value(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["check", SINGLE, "--set", "particle.velocity"])
    assert "expected KEY=VALUE" in capsys.readouterr().err


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_the_scene_written_out_is_equal_and_keeps_the_comments(path: Path) -> None:
    scene = Scene.load(path, [("preset", "draft")])
    text = scene.to_toml()
    assert Scene.from_text(text, path.stem) == scene
    comments = [line.partition("#")[2] for line in path.read_text().splitlines() if "#" in line]
    assert comments
    assert all(comment in text for comment in comments)
    assert tomllib.loads(text)["preset"] == "draft"
    assert "# gap = " in text
    assert Scene.from_text(text, path.stem).to_toml().count("# gap = ") == text.count("# gap = ")


def test_tables_in_one_line_and_dotted_keys_are_written_out_too() -> None:
    text = (
        'particle = { material = "Ni", diameter = "25 um", velocity = "500 m/s" }  # short\nsubstrate.material = "Al"\n'
    )
    scene = Scene.from_text(text, "short", [("particle.velocity", "450 m/s"), ("substrate.height", "90 um")])
    assert Scene.from_text(scene.to_toml(), "short") == scene
    assert (scene.particle.velocity, scene.substrate.height) == (450.0, 90e-6)


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_knows_commands_and_files(capsys: pytest.CaptureFixture[str], shell: str) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert "accuracy" in text
    assert "--preset" in text
    if shell == "bash":
        assert "_run_pos_0_COMPGEN=_shtab_compgen_files" in text


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_check_fits_on_one_screen(capsys: pytest.CaptureFixture[str], path: Path) -> None:
    assert main(["check", str(path)]) == 0
    brief = capsys.readouterr().out.splitlines()
    assert len(brief) <= 30
    assert max(map(len, brief)) <= 125
    assert main(["check", str(path), "-v"]) == 0
    assert set(line for line in brief if "effects  " not in line and "..." not in line) <= set(
        capsys.readouterr().out.splitlines()
    )


def test_a_scene_with_changes_is_another_scene() -> None:
    """All else is as in the file; what follows from the changed keys follows anew."""
    scene = Scene.load(SINGLE)
    fast = scene.with_(particle={"velocity": "600 m/s"}, contact={"friction": 0.25})
    assert (scene.particle.velocity, fast.particle.velocity) == (500.0, 600.0)
    assert fast == Scene.load(SINGLE, [("particle.velocity", "600 m/s"), ("contact.friction", "0.25")])
    assert fast.with_(particle={"velocity": "500 m/s"}, contact={"friction": 0.5}) == scene
    assert scene.with_(particle={"temperature": None}).particle.temperature == 300.0
    coating = Scene.load(WORKFLOWS / "coating_ni.toml").with_(coating={"number": 6, "layers": 2})
    assert len(coating.particles) == 6


def test_changes_of_several_particles() -> None:
    scene = Scene.load(TRIPLE)
    first, _, last = scene.particles
    assert {p.velocity for p in scene.with_(particle={"velocity": "600 m/s"}).particles} == {600.0}
    changed = scene.with_(particle=[{}, {"material": "Ti"}, {}]).particles
    assert (changed[0], changed[1].material, changed[2]) == (first, "Ti", last)
    alone = {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"}
    assert len(scene.with_(particle=[alone] * 2).particles) == 2


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"particle": {"velocity": "600"}}, 'particle.velocity = "600" has no unit'),
        ({"particle": {"velocty": "600 m/s"}}, 'particle.velocty: unknown key (did you mean "velocity"?)'),
        ({"partcle": {}}, 'partcle: unknown key (did you mean "particle"?)'),
        ({"particle": 5}, "particle = 5: expected a table [particle]"),
        ({"substrate": None}, "substrate: missing"),
    ],
)
def test_wrong_changes_are_named_as_in_a_file(changes: dict[str, object], says: str) -> None:
    with pytest.raises(SceneError) as caught:
        Scene.load(SINGLE).with_(**changes)
    (problem,) = caught.value.problems
    assert problem.startswith(says)


def test_a_notebook_shows_the_text_of_a_scene() -> None:
    assert "A 25 um nickel particle" in Scene.load(SINGLE)._repr_html_()
    made = Scene.load(SINGLE).with_(name="a-b", particle={"velocity": "600 m/s"})._repr_html_()
    assert "velocity = &quot;600 m/s&quot;" in made
