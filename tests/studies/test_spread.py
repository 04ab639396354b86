"""What the other strength sets of the metals and other coefficients of friction change: `run --spread`."""

import json
import tomllib
from pathlib import Path

import pytest
from made_up_run import summary_of
from scenes import scene_with

from coupler import Result, Scene
from coupler.commands import main as cli
from coupler.studies import spread

AL = """
[particle]
material = "Al7075"
diameter = "10 um"
velocity = "500 m/s"
[substrate]
material = "Al7075"
diameter = "60 um"
height = "30 um"
[resolution]
spacing = "1.2 um"
[end]
time = "2 ns"
"""


def test_each_scene_has_one_other_set_of_one_metal() -> None:
    scenes = spread.other_sets(scene_with(materials={"SS304": {"strength": "Lee_2006"}}))
    assert set(scenes) == {
        "Ni Steinberg_1996", "SS304 paper_2023", "SS304 Konokman_2011", "SS304 Preston_2003", "SS304 Steinberg_1996",
    }  # fmt: skip
    changed = Scene.from_text(scenes["Ni Steinberg_1996"])
    assert changed.derived.material("Ni").strength.set == "Steinberg_1996"
    assert changed.derived.material("SS304").strength.set == "Lee_2006"
    own = {"Ni": tomllib.loads('law = "johnson_cook"\nA = "1 MPa"\nB = "1 MPa"\nn = 1.0\nC = 0.0\nm = 1.0')}
    assert not [name for name in spread.other_sets(scene_with(materials=own)) if name.startswith("Ni")]


def test_friction_goes_from_none_to_sticking() -> None:
    """von Mises: the shear stress that metal bears is its flow stress over the root of three."""
    scenes = spread.other_frictions(scene_with(contact={"friction": 0.3}))
    assert [Scene.from_text(text).contact.friction for text in scenes.values()] == [0.0, 0.577]
    assert list(spread.other_frictions(scene_with(contact={"friction": 0.577}))) == ["friction 0"]
    assert spread.other_frictions(scene_with(effects="none")) == {}


def test_the_range_names_the_sets_at_its_ends(tmp_path: Path) -> None:
    def result(name: str, crater: float, verdict: str) -> Result:
        folder = tmp_path / name
        folder.mkdir()
        impact = {
            "verdict": verdict,
            "end": {"crater_depth_m": crater},
            "errors": {"crater_depth_m": {"half_width": 1e-7}},
        }
        (folder / "summary.json").write_text(json.dumps(summary_of(impact)))
        return Result(folder)

    others = {name: result(name, crater, word) for name, crater, word in
              (("a", 4e-6, "rebounds"), ("b", 6e-6, "sticks"), ("c", 5e-6, "rebounds"))}  # fmt: skip
    text = "\n".join(spread.lines(result("own", 5.02e-6, "sticks"), others))
    assert "5.02 ± 0.10" in text
    assert "4 (a)" in text
    assert "6 (b)" in text
    assert "2 rebounds, 1 sticks" in text


@pytest.mark.slow
def test_the_command_prints_the_range(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "al.toml").write_text(AL)
    how = ["run", str(tmp_path / "al.toml"), "--out", str(tmp_path / "run"), "--no-error", "--spread", "strength"]
    assert cli.main(how) == 0
    text = capsys.readouterr().out
    assert "with Al7075 Steinberg_1996:" in text
    own, other = Result(tmp_path / "run"), Result(tmp_path / "run" / "strength" / "Al7075_Steinberg_1996")
    assert own.eps_p_mean != other.eps_p_mean
    assert "error" not in other.summary["run"]
