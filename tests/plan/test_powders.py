"""Particles that are drawn from a table [coating], of one powder or of a blend."""

import glob
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scenes import problems_with

from coupler import Scene
from coupler.errors import SceneError
from coupler.physics.materials import material, mixed
from coupler.plan.planning import plan
from coupler.plan.powder import sizes_of, table_of
from coupler.plan.solids import with_folders

BLEND = """
preset = "draft"

[coating]
number = 60
layers = 3
radius = "60 um"
seed = 3
velocity = "600 m/s"

[[coating.powder]]
material = "Cu"
share = 0.7
sizes = "15-25 um"

[[coating.powder]]
material = "Al1100"
share = 0.3
diameter = "20 um"
hardness = "60 HV"
velocity = "750 m/s"

[substrate]
material = "Al6061"
diameter = "300 um"
height = "80 um"
"""


def masses(scene: Scene, metal: str) -> np.ndarray:
    """Masses (kg) of the particles of one metal."""
    return np.array([material(metal).rho * p.volume for p in scene.particles if p.material == metal])


def test_a_blend_has_its_shares_of_the_mass_and_each_powder_its_own_keys() -> None:
    """Shares to half a particle, as numbers are whole; what a powder leaves out is from [coating]."""
    scene = Scene.from_text(BLEND)
    copper, aluminium = masses(scene, "Cu"), masses(scene, "Al1100")
    assert len(copper) + len(aluminium) == 60
    whole = copper.sum() + aluminium.sum()
    scatter = copper.std() / math.sqrt(len(copper)) * len(copper) / whole  # of the sizes that are drawn
    assert copper.sum() / whole == pytest.approx(0.7, abs=0.5 * aluminium.max() / whole + 2.0 * scatter)
    for p in scene.particles:
        is_copper = p.material == "Cu"
        assert p.velocity == (600.0 if is_copper else 750.0)
        assert p.hardness is None if is_copper else p.hardness == pytest.approx(60 * 9.80665e6)
        assert 14e-6 < p.diameter < 26e-6
    firsts = [p.material for p in scene.particles[:20]]
    assert {"Cu", "Al1100"} == set(firsts)  # mixed, not one after the other


def test_sizes_by_mass_are_drawn_by_number() -> None:
    """The mass of many particles of a sieved powder has its median at the root of the product of the sieves, as a log-normal one has;
    the 5 % of the mass beyond each sieve are left out. 500 particles: to 5 %."""
    head, tail = BLEND[: BLEND.index("[[coating.powder]]")], BLEND[BLEND.index("[substrate]") :]
    head = head.replace("number = 60", "number = 500").replace("layers = 3", "layers = 1")
    text = f'{head}material = "Cu"\nsizes = "15-45 um"\n\n{tail.replace("80 um", "150 um")}'
    D = np.sort([p.diameter for p in Scene.from_text(text).particles])
    below = np.cumsum(D**3) / np.sum(D**3)
    assert np.interp(0.5, below, D) == pytest.approx(math.sqrt(15e-6 * 45e-6), rel=0.05)
    assert D.min() > 14.9e-6
    assert D.max() < 45.1e-6


def test_the_column_undersize_has_no_sizes(tmp_path: Path) -> None:
    (tmp_path / "sizes.csv").write_text("x [um],undersize [%]\n5,2\n10,10\n20,45\n45,92\n75,100\n")
    found = sizes_of("sizes.csv", tmp_path)
    assert found.diameter(0.45) == pytest.approx(20e-6, rel=0.01)
    assert found.diameter(0.92) == pytest.approx(45e-6, rel=0.01)


def test_a_blend_that_is_written_out_is_the_same_scene(tmp_path: Path) -> None:
    scene = Scene.from_text(BLEND, "blend")
    text = scene.to_toml()
    assert Scene.from_text(text, "blend") == scene
    del (raw := tomllib.loads(text))["particle"]
    assert Scene.from_dict(raw, "blend").particles == scene.particles  # drawn again
    assert Scene.from_text(BLEND.replace("seed = 3", "seed = 4")).particles != scene.particles


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("share = 0.3", "share = 0.4", "coating needs values of powder.share that add up to 1: these add up to 1.1"),
        ('"15-25 um"', '"25-15 um"', 'coating.powder[1].sizes = "25-15 um" needs the smaller sieve size first'),
        ('"15-25 um"', '"no.csv"', "coating.powder[1].sizes: the file is missing"),
        ('"Al1100"', '"Unobtainium"', 'coating.powder[2].material = "Unobtainium": unknown material'),
        ('sizes = "15-25 um"', "", "coating.powder[1] needs either diameter"),
        ('sizes = "15-25 um"', 'sizes = "15-25 um"\ncolour = "red"', "coating.powder[1].colour: unknown key"),
        ('velocity = "600 m/s"', "", "coating.powder[1].velocity: missing"),
        ('"15-25 um"', '"15-25 um"\nporosity = 0.1', "coating.powder[1] needs both porosity and pore_diameter"),
        (
            '"15-25 um"',
            '"15-25 um"\nporosity = 0.1\npore_diameter = "6 um"\nfiles = "*.stl"',
            "coating.powder[1] has porosity and files",
        ),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_blend_is_named_by_its_key(before: str, after: str, says: str) -> None:
    text = BLEND.replace(before, after, 1)
    with pytest.raises(SceneError) as error:
        Scene.from_text(text, "blend.toml")
    assert len(error.value.problems) == 1
    assert says in error.value.problems[0]


def test_a_powder_too_rare_for_the_number_of_particles_is_refused() -> None:
    """The number that the message gives is enough, also where a third powder takes the largest remainder."""
    third = '[[coating.powder]]\nmaterial = "Ni"\nshare = 0.2\ndiameter = "20 um"\n\n[substrate]'
    rare = BLEND.replace("share = 0.7", "share = 0.79").replace("share = 0.3", "share = 0.01")
    text = rare.replace("[substrate]", third).replace("layers = 3", "layers = 1").replace("number = 60", "number = 4")
    with pytest.raises(SceneError) as error:
        Scene.from_text(text)
    said = re.search(
        r"number = 4: powder\[2\] has no particle, because its share is small: give (\d+) part", str(error.value)
    )
    assert said is not None
    Scene.from_text(text.replace("number = 4", f"number = {said[1]}"))
    with pytest.raises(
        SceneError, match=r"powder\[2\] has no particle, because its share is small: give a larger share"
    ):
        Scene.from_text(text.replace("share = 0.01", "share = 0.0001").replace("0.79", "0.7999"))


def test_what_follows_from_a_particle_in_place_of_a_faulty_coating_is_not_told() -> None:
    """The target is too low for it, not for the particles of the scene."""
    text = BLEND.replace('velocity = "600 m/s"', "").replace('height = "80 um"', 'height = "45 um"')
    with pytest.raises(SceneError) as error:
        Scene.from_text(text)
    assert len(error.value.problems) == 1


RASTER = """
preset = "draft"

[coating]
material = "Ni"
number = 48
layers = 2
radius = "30 um"
diameter = "20 um"
velocity = "650 m/s"
temperature = "500 K"

[spray]
spot = "6 mm"
distribution = "gaussian"
traverse_speed = "300 mm/s"
passes = 3
step = "1.5 mm"
length = "60 mm"
angle = "20 deg"

[substrate]
material = "SS304"
diameter = "200 um"
height = "70 um"
"""


def test_a_raster_sends_its_particles_pass_by_pass_at_the_angle_of_the_gun() -> None:
    """Lines a standard deviation apart: the outer passes bring exp(-cos(20 deg)^2 / 2) of the mass of the middle one. A pass has the
    standard deviation of the spot over the speed, 5 ms; one pass follows another after (60 + 1.5) mm / 300 mm/s. Quantiles of eight
    particles and a spot that is cut at four deviations: to a tenth."""
    scene = Scene.from_text(RASTER)
    decided = plan(scene)
    passes = np.split(np.arange(48), [i + 1 for i, impact in enumerate(decided.impacts) if impact.ends_pass])
    beside = math.exp(-0.5 * math.cos(math.radians(20.0)) ** 2)
    outer = 24 * beside / (1.0 + 2.0 * beside)
    assert [len(each) for each in passes] == [round(outer), 24 - 2 * round(outer), round(outer)] * 2
    times = np.concatenate([[0.0], np.cumsum([impact.dwell for impact in decided.impacts[:-1]])])
    middles = np.array([times[each].mean() for each in passes])
    assert np.diff(middles) == pytest.approx(61.5 / 300.0, rel=1e-9)
    for each in passes:
        assert times[each].std() == pytest.approx(5e-3, rel=0.1)
    for impact in decided.impacts:
        assert impact.velocity == pytest.approx(
            (650.0 * math.sin(math.radians(20.0)), 0.0, -650.0 * math.cos(math.radians(20.0)))
        )
    ends = {batch.stop - 1 for batch in decided.batches}
    assert {int(each[-1]) for each in passes} <= ends  # the pause is between two passes
    assert sum(batch.pause for batch in decided.batches) == pytest.approx(times[-1])
    assert Scene.from_text(scene.to_toml(), "raster") == scene


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('step = "1.5 mm"', 'step = "0 mm"', 'spray.step = "0 mm" is outside 0.001 mm to 100 mm'),
        ("passes = 3", "", 'spray.step = "1.5 mm" needs the key passes (number of lines)'),
        ('step = "1.5 mm"', 'first = "20 mm"', "spray.first: the nearest line is 18.8 mm from the coated area"),
        ('length = "60 mm"', 'length = "20 mm"', "spray.length = 20 mm: the spot does not leave the coated area"),
        ('length = "60 mm"', 'length = "9 m"', "spray.length = 9000 mm: the gun returns after 30"),
        ('"gaussian"', '"round"', 'spray.distribution = "round": the file is missing; give "uniform", "gaussian" or a file'),
        ('"gaussian"', '"none.csv"', 'spray.distribution = "none.csv": the file is missing'),
        ("number = 48", 'number = 48\ndwell = "1 us"', "spray.passes: the path of the gun gives the times between impacts"),
    ],
)  # fmt: skip
def test_a_path_that_cannot_be_is_one_message_with_its_key(old: str, new: str, message: str) -> None:
    with pytest.raises(SceneError) as error:
        Scene.from_text(RASTER.replace(old, new))
    assert len(error.value.problems) == 1
    assert error.value.problems[0].startswith(message)


def test_a_path_needs_a_coating() -> None:
    particle = '[particle]\nmaterial = "Ni"\ndiameter = "20 um"\nvelocity = "650 m/s"\n\n'
    alone = particle + RASTER[RASTER.index("[spray]") :]
    with pytest.raises(SceneError) as error:
        Scene.from_text(alone)
    (problem,) = error.value.problems
    assert problem.startswith("spray.passes and spray.angle are for the particles of a table [coating]")


def test_a_porous_powder_has_pores_of_its_own_in_each_particle() -> None:
    """The draw of all else is that of the dense powder, up to the first particle with pores."""
    text = BLEND.replace("hardness =", 'porosity = 0.1\npore_diameter = "6 um"\nhardness =')
    porous = [p for p in Scene.from_text(text).particles if p.material == "Al1100"]
    assert {p.porosity for p in porous} == {0.1}
    assert len({p.pore_seed for p in porous}) == len(porous)
    for particle in porous[:3]:
        pores = particle.pores()
        assert pores is not None
        assert pores.volume / (pores.volume + particle.volume) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"porosity": 0.1}, "needs both porosity and pore_diameter"),
        ({"porosity": 0.1, "pore_diameter": "1 um"}, "too small for points"),
        ({"porosity": 0.4, "pore_diameter": "9 um"}, "do not fit: give a smaller porosity"),
        ({"porosity": 0.1, "pore_diameter": "9 um", "shape": "hollow_sphere"}, "has porosity and shape"),
    ],
)
def test_pores_that_cannot_be_are_refused(keys: dict[str, object], told: str) -> None:
    (problem,) = problems_with(particle={"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"} | keys)
    assert problem.startswith("particle")
    assert told in problem


def test_a_composite_powder_has_the_density_of_both_materials() -> None:
    """Ni on Al2O3 with 60 % of its mass in the core: 1 / rho = 0.6 / 3.9 + 0.4 / 8.9, and the core is 77 % of the volume."""
    core = 'core = { material = "Al2O3", share = 0.6 }'
    scene = Scene.from_text(BLEND.replace("hardness =", core + "\nhardness ="))
    planned = plan(scene)
    impact = next(each for each in planned.impacts if each.core is not None)
    shell, inner = impact.materials
    rho = 1.0 / (0.6 / inner.rho + 0.4 / shell.rho)
    assert impact.rho == pytest.approx(rho, rel=1e-12)
    assert impact.core.share == pytest.approx(0.6 * rho / inner.rho, rel=1e-12)
    assert mixed(shell, inner, impact.core.share).rho == pytest.approx(rho, rel=1e-12)
    assert any("larger than the shell" in text for text in planned.warnings)  # 1 um of shell in elements of some 3 um


@pytest.mark.parametrize(
    ("core", "more", "told"),
    [
        ({"material": "Al2O3", "diameter": "25 um"}, {}, "particle.core.diameter: a core of 25 um leaves no shell"),
        ({"material": "Al2O3", "diameter": "24.5 um"}, {}, "do not resolve a shell of 0.25 um: set resolution.spacing"),
        ({"material": "Al2O3", "share": 0.001}, {}, "particle.core.share: points"),
        ({"material": "Alumina2", "diameter": "18 um"}, {}, "particle.core.material = \"Alumina2\": unknown material"),
        ({"material": "Al2O3"}, {}, "needs either diameter, such as"),
        ({"material": "Al2O3", "diameter": "18 um"}, {"resolution__engine": "machdyn"}, "particle.core: engine machdyn"),
        ({"material": "Al2O3", "diameter": "9 um"}, {"particle__shape": "hollow_sphere"}, "particle.core: a particle with shape"),
    ],
)  # fmt: skip
def test_a_core_that_cannot_be_is_refused(core: dict[str, object], more: dict[str, object], told: str) -> None:
    (problem,) = problems_with(particle__core=core, **more)
    assert told in problem


def test_files_of_a_coating_are_found_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The written scene has absolute names: other seeds of it are drawn in another folder."""
    name = "15-45um.csv"  # no range of sieves
    (tmp_path / "lab[1]").mkdir()
    (tmp_path / "lab[1]" / name).write_text("# size (um), volume %\n15, 30\n20, 40\n25, 30\n30, 0\n")
    text = BLEND.replace('sizes = "15-25 um"', f'sizes = "{name}"')
    scene = Scene.from_text(text, str(tmp_path / "lab[1]" / "scene.toml"))
    monkeypatch.chdir(tmp_path / "lab[1]")
    assert "[[coating.powder]]" in scene.to_toml()  # with the user's own form
    elsewhere = Scene.from_text(scene.to_toml(), str(tmp_path / "run" / "scene.toml"))
    assert [p.diameter for p in elsewhere.with_(particle=None).particles] == [p.diameter for p in scene.particles]
    ball = "solid a\nendsolid a\n"
    (tmp_path / "lab[1]" / "a.stl").write_text(ball)
    raw = {"coating": {"files": "*.stl", "powder": [{"files": "*.stl"}]}, "spray": {"distribution": "spot.csv"}}
    with_folders(raw, str(tmp_path / "lab[1]" / "scene.toml"))  # type: ignore[arg-type]
    patterns = raw["coating"]["files"], raw["coating"]["powder"][0]["files"]  # type: ignore[index]
    assert all(glob.glob(pattern) == [str(tmp_path / "lab[1]" / "a.stl")] for pattern in patterns)
    assert raw["spray"]["distribution"] == str(tmp_path / "lab[1]" / "spot.csv")


def test_a_commented_heading_of_a_spot_has_its_units(tmp_path: Path) -> None:
    (tmp_path / "spot.csv").write_text("# radius (cm),flow (g/s)\n0,3\n0.1,2\n0.3,1\n")
    table = table_of("spot.csv", tmp_path)
    assert (table.units, list(table.columns)) == ({"radius": "cm", "flow": "g/s"}, ["radius", "flow"])
    rows = "\n".join(f"{15 + k} {10 + k % 3}" for k in range(12))
    (tmp_path / "classes.csv").write_text(f"# a sieve\n{rows}\n")  # sizes 1 um apart are no line numbers
    assert table_of("classes.csv", tmp_path).columns["x"][0] == 15.0
    (tmp_path / "numbers.csv").write_text("# size (um), number %\n15, 40\n25, 60\n45, 0\n")
    with pytest.raises(ValueError, match="has numbers of particles"):
        sizes_of("numbers.csv", tmp_path)


def test_the_core_of_a_particle_needs_an_oxide_film_too() -> None:
    """The second particle meets the core of the first."""
    core = {"material": "W", "share": 0.6}
    problem = problems_with(adhesion={"kind": "cohesive", "criterion": "exposure"}, particle={"core": core})
    assert any("W has no oxide film" in text for text in problem)
