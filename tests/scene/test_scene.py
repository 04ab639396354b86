import math
from pathlib import Path

import pytest
from scenes import LEAST, problems_with, scene_with, several

from coupler.errors import SceneError
from coupler.physics.shapes import SHAPES
from coupler.plan import cost as estimates
from coupler.plan.reading import Scene

WORKFLOWS = Path(__file__).parents[2] / "workflows"
CP = [["300 K", "4e2 J/kgK"], ["900 K", "5e2 J/kgK"]]

NI = LEAST["particle"]


def test_the_example_of_nickel():
    scene = Scene.load(WORKFLOWS / "single_ni.toml")
    assert scene.name == "single_ni"
    assert (scene.particle.diameter, scene.particle.velocity) == (25e-6, 500.0)
    assert (scene.substrate.diameter, scene.substrate.height) == (200e-6, 100e-6)
    assert scene.derived.points == 5000
    assert scene.derived.spacing == pytest.approx(1.1784e-6, rel=1e-4)
    assert scene.derived.element_size == pytest.approx(1.7 * scene.derived.spacing)
    assert scene.derived.output_every_of(scene.particle) == pytest.approx(2e-9)
    assert scene.derived.end_time_of(scene.particle) == pytest.approx(
        3 * 25e-6 / 500 + scene.derived.gap_of(scene.particle) / 500
    )
    law = scene.derived.adhesion_law
    assert (law.kind, law.criterion) == ("tied", "velocity")


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
        {"resolution": {"error": True, "growth": 0.3}},
        {"end__at": "greatest", "particle__dwell": "3.7 ms", "splat": {"method": "density", "element_size": "1.7 um"}},
        {"adhesion": {"kind": "cohesive", "strength": "300 MPa", "energy": "20 J/m2", "shear_energy": "31.3 J/m2"}},
        {"adhesion": {"kind": "tied", "criterion": "pressure", "threshold": "1.3 GPa"}},
        {
            "particle": [
                NI,
                NI | {"offset": ["3 um", "0 um"], "dwell": "10 us"},
                NI | {"shape": "flake", "tilt": "9 deg"},
            ]
        },
        {"particle": [NI, NI | {"gap": "1 um"}], "adhesion": {"criterion": "plastic_strain", "threshold": 0.5}},
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
    assert (scene_with().end.at, scene_with().end.time) == (None, None)
    timed = scene_with(end__time="60 ns")
    assert (timed.end.at, timed.derived.end_time_of(timed.particle)) == (None, 60e-9)


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
        ("particle__gap", "-0.1 um", "is outside 0 um to 200 um"),
        ("particle__gap", "30 um", "larger than the diameter"),
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
        ("particle", [], "give a table [particle]"),
        ("particle", [NI] * 501, "has 501 impacts; at most 500"),
        ("particle", 3, "expected a table"),
        ("particle", [NI, 3], "particle[2] = 3: expected a table [[particle]]"),
        ("particle", [NI, NI | {"velocity": "5 um"}], 'particle[2].velocity = "5 um" is a length'),
        ("particle", [NI, NI | {"offset": ["1 um", "2"]}], 'particle[2].offset[2] = "2" has no unit'),
        ("particle", [NI, NI | {"offset": ["90 um", "0 um"]}], "particle[2].offset: at 90 um from the axis"),
        ("particle__dwell", "11 s", "outside 0 s to 10 s"),
        ("particle__dwell", "-1 us", "outside 0 s to 10 s"),
        ("particle__dwell", "1 um", "is a length: needs a time"),
        ("adhesion", 3, "expected a table [adhesion]"),
        ("adhesion__kind", "glued", "expected one of none, tied, cohesive"),
        ("adhesion__strenght", "3 MPa", 'did you mean "strength"'),
        ("adhesion__strength", "300 MPa", 'no effect with kind = "tied"'),
        ("adhesion__energy", "20 J/m2", 'no effect with kind = "tied"'),
        ("adhesion__criterion", "pressure", "adhesion.threshold is missing"),
        ("adhesion", {"kind": "tied", "threshold": 0.5}, 'no effect with criterion = "all"'),
        ("adhesion", {"criterion": "pressure", "threshold": 0.5}, "needs a pressure"),
        ("adhesion", {"criterion": "plastic_strain", "threshold": "1 GPa"}, "needs a number without unit"),
        ("adhesion", {"criterion": "plastic_strain", "threshold": True}, "needs a number without unit"),
        ("adhesion", {"criterion": "presure", "threshold": "1 GPa"}, 'did you mean "pressure"'),
        ("adhesion", {"kind": "cohesive", "strength": "300 MPa"}, "adhesion.energy is missing"),
        ("adhesion", {"kind": "cohesive", "strength": "300 MPa", "energy": "20 MPa"}, "needs a surface energy"),
        ("adhesion", {"kind": "cohesive", "strength": "0 MPa", "energy": "2 J/m2"}, "must be positive"),
        ("splat__method", "densty", 'did you mean "density"'),
        ("splat__element_size", "10 um", "too coarse for the splat"),
        ("materials", 3, "expected tables"),
        ("name", "../elsewhere", "letters"),
        ("particle__material", "Ni\nshell rm", "unknown material"),
    ],
)
def test_one_problem(path, value, says):
    (problem,) = problems_with(**{path: value})
    assert says in problem
    assert problem.startswith(path.split("__")[0])


def test_memory_is_compared_with_the_machine(monkeypatch):
    one = scene_with()
    needed = estimates.memory(one.derived.points, one.derived.elements)
    monkeypatch.setattr(estimates, "machine_memory", lambda: 1.01 * needed)
    assert scene_with() == one
    (problem,) = problems_with(particle=[NI] * 20)
    assert "in 19 splats, need about" in problem
    monkeypatch.setattr(estimates, "machine_memory", lambda: 1e8)
    assert "0.1 GB" in problems_with()[0]


# ---- several impacts -------------------------------------------------------------------------------------


def test_the_examples_of_several_impacts():
    double, triple = (Scene.load(WORKFLOWS / f"{name}.toml") for name in ("double_ni_ti", "triple_ni"))
    assert [(p.material, p.diameter, p.velocity) for p in double.particles] == [("Ni", 30e-6, 500), ("Ti", 25e-6, 500)]
    assert [(p.diameter, p.velocity) for p in triple.particles] == [(25e-6, 500), (22e-6, 546), (18e-6, 610)]
    assert triple.particle == triple.particles[0]
    assert triple.derived.adhesion_law.kind == "tied"


@pytest.mark.parametrize("shape", SHAPES)
def test_the_six_shapes_have_equal_volume(shape):
    text = (WORKFLOWS / "morphology.toml").read_text()
    scene = Scene.from_text(text.replace('"rod"', f'"{shape}"'))
    assert [p.shape for p in scene.particles] == [shape] * 3
    assert all(p.volume == pytest.approx(8.181e-15, rel=1e-4) for p in scene.particles)


def test_one_spacing_for_all_that_of_the_largest():
    scene = several({"diameter": "18 um"}, {"diameter": "25 um"})
    assert scene.derived.spacing == scene_with().derived.spacing
    assert [scene.derived.points_of(p) for p in scene.particles] == [round(5000 * 0.72**3), 5000]
    assert (scene.derived.points, scene.derived.element_size) == (5000, scene_with().derived.element_size)
    assert scene.derived.splat_element_size == scene.derived.element_size


def test_the_fine_part_of_the_target_holds_all_offsets():
    scene = several({"offset": ["10 um", "0 um"]}, {"offset": ["-20 um", "8 um"]}, {"diameter": "18 um"})
    assert scene.derived.centre == pytest.approx((-5e-6, 4e-6))
    assert scene.derived.spread == pytest.approx(math.hypot(15e-6, 4e-6))
    assert scene.derived.refined_radius == scene_with().derived.refined_radius
    one = scene_with(particle__offset=["7 um", "0 um"])
    assert one.derived.centre == (7e-6, 0.0)
    assert (one.derived.spread, one.derived.refined_radius) == (0.0, scene_with().derived.refined_radius)


def test_a_preset_fits_itself_to_the_smallest() -> None:
    """15 to 45 um of a powder at `draft`: the preset alone would give the smallest 37 points, and 200 are needed."""
    powder = several({"diameter": "15 um"}, {"diameter": "45 um", "velocity": "400 m/s"}, preset="draft").derived
    assert [powder.points_of(p) for p in powder.scene.particles] == [200, 5400]
    assert scene_with(preset="draft").derived.points == 1000


def test_the_smallest_and_the_largest_are_looked_at():
    small = [NI | {"diameter": "8 um"}, NI]
    (problem,) = problems_with(particle=small, resolution__spacing="1.18 um")
    assert problem.startswith("resolution.spacing")
    assert "a particle of 8 um 163 points; at least 200 are needed: set resolution.spacing to at most 1.1 um" in problem
    (problem,) = problems_with(particle=[NI | {"diameter": "4 um"}, NI])
    assert problem.startswith('preset = "standard": with a particle of 25 um its finest spacing')
    (problem,) = problems_with(particle=[NI, NI | {"diameter": "60 um", "velocity": "300 m/s"}])
    assert "substrate.height" in problem
    assert "a particle of 60 um" in problem
    (problem,) = problems_with(particle=[NI, NI | {"shape": "hollow_sphere"}], resolution__spacing="3.4 um")
    assert "too coarse for 6.53 um, the thinnest part of this hollow_sphere" in problem
    (problem,) = problems_with(particle=[NI, NI | {"diameter": "18 um"}], resolution__element_size="5 um")
    assert "a particle of 18 um; give at most 4.5 um" in problem


def test_a_list_of_one_is_one():
    assert several({}) == scene_with()
    assert "[[particle]]" not in several({}).to_toml()


def test_all_problems_of_all_particles_at_once():
    problems = problems_with(
        particle=[
            NI | {"velocity": 500},
            {"material": "Nj", "diameter": "25 um"},
            NI | {"velocty": "3 m/s", "gap": "30 um"},
        ],
        adhesion={"kind": "cohesive"},
        end={"at": "noon"},
    )
    starts = (
        "particle[1].velocity = 500 needs a velocity",
        "particle[2].velocity: missing",
        "particle[3].velocty: unknown key",
        'end.at = "noon": expected one of rest, greatest',
        'particle[2].material = "Nj": unknown material',
        "particle[3].gap: larger than the diameter",
        "adhesion.strength is missing",
        "adhesion.energy is missing",
    )
    assert len(problems) == len(starts)
    assert all(problem.startswith(start) for problem, start in zip(problems, starts, strict=True))


def test_adhesion_is_read_in_si_units():
    table = {
        "kind": "cohesive",
        "strength": "300 MPa",
        "energy": "20 J/m^2",
        "criterion": "pressure",
        "threshold": "1 GPa",
    }
    law = scene_with(adhesion=table).derived.adhesion_law
    assert (law.strength, law.energy, law.threshold, law.shear_strength) == (300e6, 20.0, 1e9, None)
    assert several({}, {}).derived.adhesion_law == scene_with().derived.adhesion_law
    assert several({}, {}, adhesion__kind="none").derived.adhesion_law.kind == "none"


def test_a_critical_velocity_needs_a_tensile_strength():
    adhesion = {"kind": "tied", "criterion": "velocity"}
    assert scene_with(adhesion=adhesion).derived.adhesion_law.criterion == "velocity"
    (problem,) = problems_with(particle=[NI, NI | {"material": "42CrMo4"}], adhesion=adhesion)
    assert problem.startswith('adhesion.criterion = "velocity": 42CrMo4 has no sigma_TS')
    assert scene_with(particle__material="42CrMo4").derived.adhesion_law.kind == "none"
    (problem,) = problems_with(particle=[NI, NI | {"material": "42CrMo4"}])
    assert problem.startswith("adhesion: several particles need a law of adhesion")


def test_a_long_sequence_writes_no_more_than_a_scene_may():
    scene = several(*[{"diameter": "10 um"}] * 500, preset="draft", splat__element_size="2.5 um")
    assert sum(scene.derived.end_time_of(p) / scene.derived.output_every_of(p) for p in scene.particles) < 5000
    assert scene.derived.output_every_of(scene.particle) > 5 * scene_with().derived.output_every_of(scene.particle)
    assert "(from: diameter / velocity / 2.5, of the first impact)" in scene.to_toml()


def test_a_range_of_tests_is_written_out_and_read_again():
    own = {"base": "Ni", "fitted": {"rate": ["1e-3 1/s", "1e4 1/s"], "strain": 0.5}}
    scene = scene_with(particle__material="Mine", materials={"Mine": own})
    assert Scene.from_text(scene.to_toml(), scene.name) == scene


def test_a_jet_needs_a_temperature():
    (problem,) = problems_with(spray={"heat_transfer": "1e4 W/(m2 K)"})
    assert problem == "spray.heat_transfer: needs spray.gas_temperature, or a table [gas]"


def test_each_impact_has_its_own_times():
    slow, fast = (scene := several({"velocity": "250 m/s"}, {})).particles
    assert scene.derived.output_every_of(slow) == pytest.approx(2 * scene.derived.output_every_of(fast))
    assert scene.derived.end_time_of(slow) == pytest.approx(2 * scene.derived.end_time_of(fast))


def test_a_flight_past_the_edge_is_refused():
    """25 um at 80 degrees drift 25 tan(80) = 142 um; the target of 200 um has room for 75."""
    (problem,) = problems_with(particle=NI | {"angle": "80 deg", "gap": "25 um"})
    assert "moves 142 um" in problem
    assert "at most 75 um" in problem
    assert scene_with(particle=NI | {"angle": "70 deg", "gap": "25 um"}).particle.gap == 25e-6


def test_an_end_before_the_flight_is_over_is_refused():
    """10 um at 500 m/s take 20 ns."""
    (problem,) = problems_with(particle=NI | {"gap": "10 um"}, end__time="19 ns")
    assert "takes 20 ns" in problem
    assert scene_with(particle=NI | {"gap": "10 um"}, end__time="21 ns").end.time == 21e-9


@pytest.mark.parametrize("direction", ["", "shear_"])
def test_a_bond_of_less_energy_than_its_springs_hold_is_refused(direction):
    """sigma^2 / 2k with k = K / spacing: what the solver would refuse at the greatest deformation."""
    law = {"kind": "cohesive", "strength": "800 MPa", "energy": "1000 J/m2"}
    scene = scene_with(adhesion=law)
    K = min(scene.derived.material(name).K for name in ("Ni", "SS304"))
    least = 8e8**2 * scene.derived.spacing / (2.0 * K)
    (problem,) = problems_with(adhesion=law | {f"{direction}energy": f"{0.99 * least:.6g} J/m2"})
    assert problem.startswith(f"adhesion.{direction}energy")
    scene_with(adhesion=law | {f"{direction}energy": f"{1.01 * least:.6g} J/m2"})
    scene_with(adhesion=law | {f"{direction}energy": "0 J/m2"})


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
        with pytest.raises(SceneError, match=r"give a(nother| smaller) file"):
            Scene.load(tmp_path / name)
    with pytest.raises(SceneError, match="is missing"):
        Scene.load(tmp_path / "absent.toml")


def test_the_name_is_safe_whatever_the_file_is_called(tmp_path):
    path = tmp_path / ".. $(x).toml"
    path.write_text(Scene.from_dict(LEAST).to_toml().replace('name = "scene"\n', ""))
    assert Scene.load(path).name == "__x_"[2:]
