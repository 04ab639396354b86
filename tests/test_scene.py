import math
from pathlib import Path

import pytest

from coupler import estimates
from coupler.errors import SceneError
from coupler.scene import Scene

WORKFLOWS = Path(__file__).parents[1] / "workflows"
CP = [["300 K", "4e2 J/kgK"], ["900 K", "5e2 J/kgK"]]
LEAST = {
    "particle": {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"},
    "substrate": {"material": "SS304"},
}


def scene_with(**changes):
    """The least scene with some values changed, as particle__diameter="30 um"."""
    data = {key: dict(table) for key, table in LEAST.items()}
    for path, value in changes.items():
        section, _, field = path.partition("__")
        if field:
            data.setdefault(section, {})[field] = value
        else:
            data[section] = value
    return Scene.from_dict(data)


def problems_with(**changes):
    with pytest.raises(SceneError) as caught:
        scene_with(**changes)
    return caught.value.problems


def test_the_example_of_nickel():
    scene = Scene.load(WORKFLOWS / "single_ni.toml")
    assert scene.name == "single_ni"
    assert (scene.particle.diameter, scene.particle.velocity) == (25e-6, 500.0)
    assert (scene.substrate.diameter, scene.substrate.height) == (200e-6, 100e-6)
    assert scene.points == 5000
    assert scene.spacing == pytest.approx(1.1784e-6, rel=1e-4)
    assert scene.element_size == pytest.approx(1.7 * scene.spacing)
    assert scene.output_every == pytest.approx(2e-9)
    assert scene.end_time == pytest.approx(3 * 25e-6 / 500 + scene.gap / 500)


def test_the_example_of_titanium():
    scene = Scene.load(WORKFLOWS / "single_ti.toml")
    assert (scene.particle.material, scene.particle.diameter) == ("Ti", 30e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"particle__angle": "33 deg", "particle__gap": "0.2 um", "particle__temperature": "200 degC"},
        {"particle__offset": ["1 um", "-2.3 um"], "effects": ["auto", "-friction"], "name": "x y"},
        {"resolution__spacing": "1.3 um", "end__time": "60 ns", "output__every": "1 ns"},
        {"contact__friction": 0},
        {"end__time": "60 ns", "end__at": "rest", "preset": "draft"},
        {"materials": {"My.Ni": {"base": "Ni", "A": "180 MPa", "cp": CP}}, "particle__material": "My.Ni"},
    ],
)
def test_written_out_and_read_again_it_is_equal(changes):
    scene = scene_with(**changes)
    text = scene.to_toml()
    assert Scene.from_text(text, "elsewhere.toml") == scene
    assert 'temperature = "' in text
    assert "friction = 0" in text


def test_end():
    assert scene_with().end.at == "rest"
    timed = scene_with(end__time="60 ns")
    assert (timed.end.at, timed.end_time) == (None, 60e-9)


def test_all_problems_at_once():
    problems = problems_with(
        preset="coarse",
        nmae="x",
        effects=["auto", "-fricton"],
        particle__velocty="500 m/s",
        particle__diameter=25,
        particle__velocity="500 mm",
        particle__shape="cube",
        particle__offset=["1 um"],
        substrate__material="SS305",
        contact__friction="0.5",
        materials={"X": {"A": 3}},
    )
    text = "\n".join(problems)
    for part in (
        'preset = "coarse": expected one of draft, standard, fine',
        "nmae: unknown key",
        'did you mean "friction"',
        'particle.velocty: unknown key (did you mean "velocity"?)',
        "particle.diameter = 25 needs a length",
        'particle.velocity = "500 mm" is a length: needs a velocity',
        'particle.shape = "cube"',
        "particle.offset: expected two lengths",
        'substrate.material = "SS305": unknown material (did you mean "SS304"?)',
        "contact.friction",
        "materials.X: A needs a pressure",
    ):
        assert part in text


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("particle__diameter", "-25 um", "outside 1 um to 200 um"),
        ("particle__diameter", "25 m", "outside"),
        ("particle__velocity", "20 km/s", "outside"),
        ("particle__angle", "85 deg", "outside 0 deg to 80 deg"),
        ("particle__temperature", "1700 K", "melting"),
        ("substrate__temperature", "1750 K", "melting"),
        ("particle__temperature", "20 K", "outside"),
        ("particle__gap", "-0.1 um", "inside the target"),
        ("particle__gap", "30 um", "more than the diameter"),
        ("particle__offset", ["90 um", "0 um"], "edge"),
        ("substrate__diameter", "70 um", "at least 75 um"),
        ("substrate__height", "40 um", "at least 50 um"),
        ("substrate__sides", "fre", 'did you mean "free"'),
        ("resolution__spacing", "4 um", "at least 200"),
        ("resolution__spacing", "0.01 um", "memory"),
        ("resolution__element_size", "10 um", "too coarse"),
        ("output__every", "0.001 ns", "at most 5000"),
        ("contact__friction", math.nan, "from 0 to 2"),
        ("contact__friction", 3, "from 0 to 2"),
        ("end__at", "noon", "rest"),
        ("effects", "some", "auto, all, none"),
        ("effects", ["friction", "friction"], "twice"),
        ("effects", [1], "auto, all, none"),
        ("particle", [{}, {}], "not yet supported"),
        ("particle", 3, "expected a table"),
        ("materials", 3, "expected tables"),
        ("name", "../elsewhere", "letters"),
        ("particle__material", "Ni\nshell rm", "unknown material"),
    ],
)
def test_one_problem(path, value, says):
    (problem,) = problems_with(**{path: value})
    assert says in problem
    assert problem.startswith(path.replace("__", ".").split(".")[0])


def test_memory_is_compared_with_the_machine(monkeypatch):
    monkeypatch.setattr(estimates, "machine_memory", lambda: 1e8)
    assert "0.1 GB" in problems_with()[0]


def test_missing_tables():
    with pytest.raises(SceneError, match="particle: missing") as caught:
        Scene.from_text("")
    assert len(caught.value.problems) == 2


@pytest.mark.parametrize(
    "text", ["x", "a=" + "[" * 5000, "a=" + "1" * 5000, '"\x1b[2J"=1', "[particle]\ndiameter=0x" + "f" * 9999]
)
def test_hostile_text_is_a_scene_error(text):
    with pytest.raises(SceneError) as caught:
        Scene.from_text(text)
    assert "\x1b" not in str(caught.value)


def test_unreadable_files(tmp_path):
    for name, content in (("binary.toml", b"\xff\xfe"), ("large.toml", b"#" * 1_000_001)):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(SceneError, match="not a scene"):
            Scene.load(tmp_path / name)
    with pytest.raises(SceneError, match="cannot be read"):
        Scene.load(tmp_path / "absent.toml")


def test_the_name_is_safe_whatever_the_file_is_called(tmp_path):
    path = tmp_path / ".. $(x).toml"
    path.write_text(Scene.from_dict(LEAST).to_toml().replace('name = "scene"\n', ""))
    assert Scene.load(path).name == "__x_"[2:]
