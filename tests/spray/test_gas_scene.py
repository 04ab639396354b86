"""Nozzles, scenes that give a gas in place of a velocity, and the command `coldspray gas`."""

import dataclasses
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from coupler.commands import main as cli
from coupler.errors import SceneError
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.text import describe
from coupler.scene.spray import GasConditions
from coupler.spray import nozzles
from coupler.spray.flight import DRAG_LAWS, fly_together
from coupler.spray.gas import GASES, Flow

D42 = nozzles.library()["D42PBI"]
SPRAY = {"pressure": "40 bar", "temperature": "800 degC", "nozzle": "D42PBI"}


def flow(**changes):
    return Flow(**({"gas": GASES["N2"], "nozzle": D42, "p0": 40e5, "T0": 1073.15, "standoff": 30e-3} | changes))


# ---- nozzles ---------------------------------------------------------------------------------------------


def test_every_nozzle_says_where_it_is_from_and_what_is_assumed():
    for nozzle in nozzles.library().values():
        assert nozzle.source
        assert nozzle.assumed
        assert nozzle.area_ratio(-nozzle.converging) == pytest.approx((nozzle.inlet / nozzle.throat) ** 2)
        assert nozzle.area_ratio(nozzle.end) == pytest.approx((nozzle.exit / nozzle.throat) ** 2)


def test_a_chamber_heats_and_a_barrel_lengthens():
    long = dataclasses.replace(D42, chamber=0.1, barrel=0.05)
    plain, changed = (fly_together(flow(nozzle=n), material("Ni"), [25e-6])[0] for n in (D42, long))
    assert changed.temperature > plain.temperature
    assert changed.velocity > plain.velocity
    assert changed.x[0] == pytest.approx(-0.15)
    assert np.all(np.diff(changed.x) >= 0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"throat": "2.7"}, "throat has no unit"),
        ({"exit": "2 mm"}, "exit = 2 mm: must be wider than the throat"),
        ({"exti": "2 mm"}, 'unknown key (did you mean "exit"?)'),
        ({"inlet": None}, "missing: inlet"),
        ({"injection": "1 m"}, "injection = 1000 mm: lies outside the nozzle"),
        ({"source": "a\x1b[2J"}, "source must be a text"),
    ],
)
def test_a_nozzle_of_ones_own(change, says):
    """Powder may be fed at the very inlet, although 5 mm and 9 mm add up to less than 14 mm in binary numbers."""
    at_inlet = {"converging": "5 mm", "chamber": "9 mm", "injection": "-14 mm", "inlet": "8 mm", "throat": "2.5 mm"}
    assert nozzles.from_table("Mine", at_inlet | {"exit": "6 mm", "diverging": "100 mm"}).injection == -14e-3
    lengths = {"inlet": "8 mm", "throat": "2.5 mm", "exit": "6 mm", "converging": "30 mm", "diverging": "100 mm"}
    assert nozzles.from_table("Mine", lengths).exit == 6e-3
    with pytest.raises(SceneError) as caught:
        nozzles.from_table("Mine", {key: text for key, text in (lengths | change).items() if text is not None})
    (problem,) = caught.value.problems
    assert says in problem


# ---- scenes ----------------------------------------------------------------------------------------------


def scene(particle=(), gas_=(), **more):
    data = {"particle": {"material": "Ni", "diameter": "25 um"} | dict(particle), "gas": SPRAY | dict(gas_)}
    return Scene.from_dict(data | {"substrate": {"material": "SS304"}} | more)


def problems(*arguments, **more):
    with pytest.raises(SceneError) as caught:
        scene(*arguments, **more)
    return caught.value.problems


def test_gas_gives_a_scene_velocity_and_temperature():
    flown = fly_together(flow(), material("Ni"), [25e-6], 293.15)[0]
    found = scene()
    assert found.particle.velocity == pytest.approx(flown.velocity, rel=1e-3)
    assert found.particle.temperature == pytest.approx(flown.temperature, rel=1e-3)
    text = found.to_toml()
    assert f'velocity = "{found.particle.velocity:.4g} m/s"' in text
    assert Scene.from_text(text, "elsewhere.toml") == found
    said = describe(plan(found))
    assert f"gives {found.particle.velocity:.4g} m/s" in said
    assert "used here" in said
    assert "assumed values of the nozzle" in said


def test_what_a_scene_says_of_its_particle_goes_before_the_gas():
    found = scene({"velocity": "500 m/s"})
    assert found.particle.velocity == 500.0
    assert found.particle.temperature == scene().particle.temperature
    assert "replaced by 500 m/s of the scene" in describe(plan(found))


def test_check_says_that_a_flake_is_not_a_sphere():
    assert "not of the shape flake" in describe(plan(scene({"shape": "flake"})))
    assert "equal volume, not" not in describe(plan(scene()))


def test_gas_gives_each_of_several_particles_its_own():
    sizes = [{"material": "Ni", "diameter": f"{d} um"} for d in (25, 18)]
    data = {"gas": SPRAY, "substrate": {"material": "SS304"}}
    found = Scene.from_dict(data | {"particle": [*sizes, sizes[0] | {"velocity": "500 m/s"}]})
    large, small, own = found.particles
    assert small.velocity > large.velocity == scene().particle.velocity
    assert (own.velocity, own.temperature) == (500.0, large.temperature)
    assert Scene.from_text(found.to_toml(), "elsewhere.toml") == found
    said = describe(plan(found))
    assert f"Ni 18 um: gives {small.velocity:.4g} m/s" in said
    assert said.count("Ni 25 um: gives") == 2
    with pytest.raises(SceneError, match=r"particle\[2\]\.diameter: missing"):
        Scene.from_dict(data | {"particle": [sizes[0], {"material": "Ni"}]})


def test_a_nozzle_in_a_scene():
    table = {"inlet": "8 mm", "throat": "2.5 mm", "exit": "6 mm", "converging": "30 mm", "diverging": "100 mm"}
    found = scene(gas_={"nozzle": "Mine", "standoff": "20 mm", "bow_shock": True}, nozzles={"Mine": table})
    assert found.particle.velocity != scene().particle.velocity
    assert Scene.from_text(found.to_toml(), "elsewhere.toml") == found


def test_a_scene_without_gas_stays_as_it_was():
    text = scene({"velocity": "500 m/s"}).to_toml()
    without = {"particle": {"material": "Ni", "diameter": "25 um"}, "substrate": {"material": "SS304"}}
    assert "[gas]" in text
    with pytest.raises(SceneError, match=r"particle\.velocity: missing"):
        Scene.from_dict(without)


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("pressure", "40", "gas.pressure = \"40\" has no unit"),
        ("pressure", "4 bar", "gas.pressure = 4 bar: too low for nozzle D42PBI"),
        ("pressure", None, 'gas.pressure: missing; add for example pressure = "40 bar"'),
        ("temperature", "800 bar", "gas.temperature = \"800 bar\" is a pressure: needs a temperature"),
        ("nozzle", "D24PBI", 'gas.nozzle = "D24PBI": unknown nozzle (did you mean "D42PBI"?)'),
        ("kind", "Ne", 'gas.kind = "Ne": expected one of N2, He, air'),
        ("drag", "henders", 'gas.drag = "henders": expected one of henderson, carlson-hoglund'),
        ("presure", "3 bar", 'gas.presure: unknown key (did you mean "pressure"?)'),
        ("standoff", "1 mm", "gas.standoff = 1 mm: too short for the bow shock"),
    ],
)  # fmt: skip
def test_one_problem_of_the_gas(field, value, says):
    table = {key: text for key, text in (SPRAY | {"bow_shock": True, field: value}).items() if text is not None}
    data = {"particle": {"material": "Ni", "diameter": "25 um"}, "gas": table, "substrate": {"material": "SS304"}}
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(data)
    (problem,) = caught.value.problems
    assert problem.startswith(says)


def test_problems_of_the_gas_stand_among_the_others():
    found = problems({"diameter": 25, "material": "Nj"}, {"temperature": "20"}, nozzles={"Mine": {"throat": 3}})
    text = "\n".join(found)
    assert len(found) == 5
    for part in (
        "particle.diameter",
        "particle.material",
        "gas.temperature",
        "nozzles.Mine: throat",
        "nozzles.Mine: missing",
    ):
        assert part in text
    assert "expected a table" in problems(gas=3)[0]
    assert "nozzles: expected tables, such as [nozzles.Mine]" in problems(nozzles={"Mine": 3})[0]


def test_a_scene_offers_what_the_program_has():
    choices = {name: get_args(GasConditions.model_fields[name].annotation) for name in ("kind", "drag")}
    assert choices == {"kind": tuple(GASES), "drag": tuple(DRAG_LAWS)}


# ---- the command -----------------------------------------------------------------------------------------

COMMAND = ["gas", "--pressure", "8 bar", "--temperature", "354 degC", "--nozzle", "D42PBI"]


def test_the_command_prints_writes_and_draws(capsys, tmp_path):
    table, picture = tmp_path / "a.csv", tmp_path / "a.png"
    more = ["--diameter", "25 um", "18 um", "--csv", str(table), "--png", str(picture), "--bow-shock"]
    assert cli.main(COMMAND + more) == 0
    said = capsys.readouterr().out
    flown = fly_together(flow(p0=8e5, T0=627.15, bow_shock=True), material("Ni"), [25e-6])[0]
    for part in ("25 um", f"{flown.velocity:.0f} m/s", "over-expanded", "assumed values of the nozzle"):
        assert part in said
    head, columns, first, second = table.read_text().splitlines()
    assert head.startswith("# written by coldspray gas; remake: coldspray gas")
    assert columns.split(",")[2] == "velocity_m_s"
    assert float(first.split(",")[2]) == pytest.approx(flown.velocity, rel=1e-5)
    assert second.startswith("18,")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_command_lists_nozzles_with_their_sources(capsys, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(Path(nozzles.__file__).with_name("nozzles.toml").read_text().replace("[D42PBI]", "[nozzles.Mine]"))
    assert cli.main(["nozzles", "--library", str(path)]) == 0
    said = capsys.readouterr().out
    assert "Mine: inlet 14 mm, throat 2.7 mm" in said
    assert said.count("source:") == 4


def test_commands_know_metals_and_nozzles_of_a_scene(capsys, tmp_path):
    """The scene's other tables may be anything. Twice the density: slower."""
    path = tmp_path / "scene.toml"
    table = Path(nozzles.__file__).with_name("nozzles.toml").read_text().split("\n\n")
    (own,) = (part for part in table if part.startswith("[D42PBI]"))
    path.write_text(
        own.replace("[D42PBI]", "[nozzles.Mine]") + '\n[materials.Heavy]\nbase = "Ni"\ndensity = "17800 kg/m^3"\n'
    )
    of_scene = ["--library", str(path), "--nozzle", "Mine", "--material", "Heavy"]
    assert cli.main([*COMMAND, "--diameter", "25 um"]) == 0
    light = capsys.readouterr().out
    assert cli.main([*COMMAND[:-2], *of_scene, "--diameter", "25 um"]) == 0
    heavy = capsys.readouterr().out
    slow, fast = (float(said.split("um")[1].split()[2]) for said in (heavy, light))
    assert 0.6 * fast < slow < 0.9 * fast
    path.write_text("materials = 3\n")
    assert cli.main(COMMAND + of_scene) == 2
    assert "materials: expected tables, such as [materials.Mine]" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--pressure", "8"], '--pressure "8" has no unit'),
        (["--nozzle", "D43PBI"], 'did you mean "D42PBI"'),
        (["--diameter", "0.1 um"], '--diameter "0.1 um" is outside 1 um to 200 um'),
        (["--gas", "Ne"], '--gas "Ne": expected one of N2, He, air'),
        (["--material", "Nj"], '--material "Nj": unknown material'),
        (["--pressure", "3 bar"], "at least 4.604 bar"),
        (["--library", "absent.toml"], "absent.toml is missing"),
        (["--csv", "absent/a.csv"], "absent/a.csv: there is no folder"),
    ],
)
def test_the_command_says_what_is_wrong(more, says, capsys):
    assert cli.main(COMMAND + more) == 2
    assert says in capsys.readouterr().err
