"""The file of a job, the sizes it names, and its parts."""

from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import pytest

from coupler.errors import ColdsprayError, SceneError
from coupler.plan.cost import forecast
from coupler.plan.job import Coatings, Job, Search, read, seconds, sets_of
from coupler.plan.planning import plan

TEXT = (files("coupler.commands") / "templates" / "job.toml").read_text(encoding="utf-8")


def job_of(folder: Path, text: str = TEXT) -> Job:
    path = folder / "cu.toml"
    path.write_text(text, encoding="utf-8")
    return read(path)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"15-45 um"', '"45-15 um"', 'powder.sizes = "45-15 um" needs the smaller sieve size first'),
        ('"15-45 um"', '["30 um", "20 um", "40 um"]', "needs D10, D50, D90 in ascending order"),
        ('"15-45 um"', '"coarse"', 'powder.sizes = "coarse" needs "15-45 um" (sieves)'),
        ('"15-45 um"', '"none.csv"', 'powder.sizes = "none.csv": the file is missing'),
        ("sizes =", "size =", 'powder.size: unknown key (did you mean "sizes"?); known: material, sizes'),
        ('material = "Cu"', 'material = "Cuu"', 'powder.material = "Cuu"'),
        ('"50 bar"', '"50 um"', 'gas.pressure = "50 um" is a length'),
        ('"D42PBI"', '"D42"', 'gas.nozzle = "D42"'),
        ('spot = "6 mm"', 'efficiency = 0.5', "spray.efficiency: unknown key"),
        ('spot = "6 mm"', 'angle = "20"', 'spray.angle = "20" has no unit'),
        ('spot = "6 mm"', 'step = "2 mm"', 'spray.step = "2 mm" needs the key passes (number of lines)'),
        ('"30 min"', "30", "within = 30 needs a time with its unit"),
        ("[powder]", "[powder]\nshare = 0.5", "powder needs values of powder.share that add up to 1: these add up to 0.5"),
        ("[powder]", '[powder]\nvelocity = "600 m/s"', "powder.velocity: unknown key; known: material, sizes, shapes"),
        ("[powder]", '[powder]\ncore = { material = "Al2O4", share = 0.5 }', 'powder.core.material = "Al2O4": unknown material'),
        ('[substrate]', '[[substrate.layer]]\nmaterial = "Nix"\nthickness = "9 um"\n[substrate]', 'substrate.layer.material = "Nix"'),
        ("[powder]", "[coating]\nnumber = 9\n[powder]", "coating: unknown key; known: within, powder,"),
        ("[powder]", "[powders]", "powders: unknown key (did you mean \"powder\"?)"),
    ],
)  # fmt: skip
def test_a_fault_names_its_key_and_the_remedy(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in TEXT
    with pytest.raises(SceneError) as error:
        job_of(tmp_path, TEXT.replace(old, new, 1))
    assert any(says in problem for problem in error.value.problems), error.value.problems


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"Cu"', '"Al2O3"', "powder.material: Al2O3 is a ceramic: it makes no metallic bond"),
        ('"Al6061"', '"Al2O3"', "substrate.material: Al2O3 is a ceramic: no metallic bond forms on it"),
        ('"Al6061"', '"PEEK"', "substrate.material: PEEK is a polymer: no metallic bond forms on it"),
        (
            '"20 degC"',
            '"20 degC"\nlayer = [{ material = "SiC", thickness = "9 um" }]',
            r"substrate.layer\[1\].material: SiC is a ceramic",
        ),
    ],
)
def test_a_ceramic_or_a_polymer_has_no_window(tmp_path: Path, old: str, new: str, says: str) -> None:
    """Also not a ceramic with a tensile strength, for which the formula of metals has a number."""
    strong = '[materials.Al2O3]\nbase = "Al2O3"\nsigma_TS = "260 MPa"\n'
    for own in ("", strong):
        with pytest.raises(ColdsprayError, match=says):
            _ = job_of(tmp_path, TEXT.replace(old, new, 1) + own).arrived


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    text = TEXT.replace('"15-45 um"', '"coarse"').replace('"Al6061"', '"Al606"').replace("30 min", "30")
    with pytest.raises(SceneError) as error:
        job_of(tmp_path, text)
    assert len(error.value.problems) == 3


MALVERN = """Probe;Kupfer Größe -45+15
D [4;3] - Volumen (µm);29,6

Size Classes (µm);Volume Density (%)
10,0;0,00
15,0;20,00
20,0;30,00
30,0;40,00
40,0;10,00
50,0;0,00
"""


@pytest.mark.parametrize("coding", ["latin-1", "utf-8-sig", "utf-16"])
def test_the_export_of_a_sizer_is_read_as_it_is(tmp_path: Path, coding: str) -> None:
    """Semicolons, decimal commas, lines above the table; each row names the lower edge of its class: 20 % lie below 20 um."""
    (tmp_path / "sizer.csv").write_bytes(MALVERN.encode(coding))
    sizes = job_of(tmp_path, TEXT.replace('"15-45 um"', '"sizer.csv"')).powders["Cu"].sizes
    assert sizes.share == pytest.approx((0.2, 0.5, 0.9))
    assert sizes.known == pytest.approx((20e-6, 30e-6, 40e-6))


def test_shares_below_each_size_are_told_from_shares_of_classes(tmp_path: Path) -> None:
    (tmp_path / "sizer.csv").write_text("size (mm),passing (%)\n0.015,5\n0.02,20\n0.03,50\n0.04,90\n0.06,100\n")
    sizes = job_of(tmp_path, TEXT.replace('"15-45 um"', '"sizer.csv"')).powders["Cu"].sizes
    assert sizes.share == pytest.approx((0.05, 0.2, 0.5, 0.9))
    assert sizes.known == pytest.approx((15e-6, 20e-6, 30e-6, 40e-6))


def test_numbers_of_particles_are_refused(tmp_path: Path) -> None:
    (tmp_path / "sizer.csv").write_text("size (um),Number (%)\n10,20\n20,50\n30,30\n40,0\n")
    with pytest.raises(SceneError, match="give a file with volume fractions"):
        job_of(tmp_path, TEXT.replace('"15-45 um"', '"sizer.csv"'))


def test_later_parts_of_a_kind_take_longer(tmp_path: Path) -> None:
    """The order of the parts is that of their worth: what is computed first must not use the time of a finer part of its kind."""
    job = job_of(tmp_path)
    times: dict[tuple[str, str], list[float]] = {}
    for part in job.parts:
        kind = (part.base, part.strength) if isinstance(part, Search) else ("", "")
        times.setdefault(kind, []).append(seconds(job, part, lambda scene: forecast(plan(scene)).whole, 2))
    assert {("Cu", ""), ("Al6061", ""), ("", "")} < times.keys()
    for each in times.values():
        assert all(a < b for a, b in pairwise(each))


def test_between_the_ends_of_its_reach_none_and_all_of_a_powder_sticks(tmp_path: Path) -> None:
    """Critical velocities of all sizes in the ratio of the formula: what the search leaves out cannot change the efficiency."""
    job = job_of(tmp_path)
    (slowest, fastest), arrived = job.reach("Cu"), job.arrived["Cu"]
    median = arrived.critical[len(arrived.critical) // 2]
    assert slowest < fastest
    assert arrived.fates(fastest / median)["sticks"] == 0.0
    assert arrived.fates(slowest / median)["sticks"] == 1.0


def test_the_scenes_of_a_job_have_a_plan(tmp_path: Path) -> None:
    """The smallest particle of each coating has points enough, its velocity is that of the gas."""
    job = job_of(tmp_path)
    for part in job.parts:
        if isinstance(part, Coatings):
            planned = plan(job.coating(part, 1))
            assert len(planned.impacts) == part.number
            assert max(impact.points for impact in planned.impacts) <= 1.1 * part.points
    scene = job.scene_on("Cu", "Al6061", 5000)
    assert plan(scene).impact.points == pytest.approx(5000, rel=0.02)
    assert scene.derived.material("Cu").strength.set == "Preston_2003"


def test_the_strength_set_is_that_of_the_highest_rates() -> None:
    """Those that docs/evidence/bonding.md compares with measured critical velocities, by the ranges that their sources state."""
    firsts = [sets_of({}, name)[0] for name in ("Cu", "Ni", "Al")]
    assert firsts == ["Preston_2003", "Steinberg_1996", "Steinberg_1996"]
    assert sets_of({}, "no metal") == sets_of({"strength": "Johnson_1983"}, "Cu") == []


OF_CERAMIC = """
[[powder]]
material = "Al2O3"
share = 0.2
sizes = "15-45 um"
shapes = { angular = 1.0 }
"""
BLEND = TEXT.replace("[powder]", "[[powder]]\nshare = 0.8").replace("[gas]", f"{OF_CERAMIC}\n[gas]")


def test_one_table_of_a_list_is_the_job_of_one_powder(tmp_path: Path) -> None:
    one, listed = (job_of(tmp_path, text) for text in (TEXT, TEXT.replace("[powder]", "[[powder]]")))
    assert one.parts == listed.parts
    part = next(part for part in one.parts if isinstance(part, Coatings))
    assert one.coating(part, 3) == listed.coating(part, 3)


def test_a_blend_is_drawn_by_its_shares_of_the_mass(tmp_path: Path) -> None:
    """Only copper has a critical velocity. All of it sticks by the formula, so that a coating has the shares of the feed; numbers of
    particles are whole."""
    job = job_of(tmp_path, BLEND)
    assert job.hits == (("Cu", "Al6061"), ("Cu", "Cu"))
    assert job.efficiency("Cu") == 1.0
    assert job.efficiency("Al2O3") == 0.0
    scene = job.coating([part for part in job.parts if isinstance(part, Coatings)][-1], 1)
    mass = {p: 0.0 for p in ("Cu", "Al2O3")}
    for p in scene.particles:
        mass[p.material] += scene.derived.material(p.material).rho * p.volume
    assert mass["Al2O3"] / sum(mass.values()) == pytest.approx(0.2, abs=0.03)
    assert {p.shape for p in scene.particles if p.material == "Al2O3"} == {"angular"}
    assert plan(scene).target.diameter > 0.0


def test_fine_ceramics_leave_two_particles_of_the_metal(tmp_path: Path) -> None:
    """Sizes more than a factor apart than a coating resolves: each powder has one size, and the smallest enough points."""
    job = job_of(tmp_path, BLEND.replace('sizes = "15-45 um"\nshapes', 'sizes = "5-20 um"\nshapes'))
    scene = job.coating(next(part for part in job.parts if isinstance(part, Coatings)), 1)
    metals = [p.material for p in scene.particles]
    assert metals.count("Cu") >= 2
    assert metals.count("Al2O3") > 10
    assert min(map(scene.derived.points_of, scene.particles)) >= 200


def test_powders_of_one_metal_are_numbered(tmp_path: Path) -> None:
    job = job_of(tmp_path, BLEND.replace('"Al2O3"', '"Cu"'))
    assert list(job.powders) == ["Cu 1", "Cu 2"]
    assert len({part.folder for part in job.parts if isinstance(part, Search)}) > 4


def test_a_composite_powder_flies_with_its_mean_density_and_its_shell_is_resolved(tmp_path: Path) -> None:
    """1 / rho = 0.6 / rho(Al2O3) + 0.4 / rho(Ni); it is lighter, so that it flies faster; bonds are those of nickel."""
    text = TEXT.replace('material = "Cu"', 'material = "Ni"')
    dense = job_of(tmp_path, text)
    job = job_of(tmp_path, text.replace("sizes =", 'core = { material = "Al2O3", share = 0.6 }\nsizes ='))
    powder = job.powders["Ni on Al2O3"]
    rho = {name: job.metals[name].rho for name in ("Ni", "Al2O3")}
    assert powder.flying.rho == pytest.approx(1.0 / (0.6 / rho["Al2O3"] + 0.4 / rho["Ni"]))
    assert (job.arrived["Ni on Al2O3"].velocity > dense.arrived["Ni"].velocity).all()
    assert job.hits == (("Ni on Al2O3", "Al6061"), ("Ni on Al2O3", "Ni"))
    for part in (job.parts[0], next(part for part in job.parts if isinstance(part, Coatings))):
        assert seconds(job, part, lambda scene: forecast(plan(scene)).whole, 2) > 0.0


def test_the_gun_at_an_angle_and_the_ground_are_those_of_the_scenes(tmp_path: Path) -> None:
    """At 60 degrees the formula needs twice the velocity. The heights of the ground are in the coating, and a search is on a flat base
    of the uppermost layer."""
    path = 'passes = 3\nstep = "1 mm"\nangle = "60 deg"\nspot = "6 mm"'
    layer = '[[substrate.layer]]\nmaterial = "Ni"\nthickness = "20 um"\n'
    job = job_of(tmp_path, TEXT.replace('spot = "6 mm"', path, 1) + layer)
    assert job.slant == pytest.approx(2.0)
    assert job.efficiency("Cu") == job.arrived["Cu"].fates(job.slant)["sticks"] < 1.0
    assert job.scene_on("Cu", "Ni", 5000).particle.angle == pytest.approx(1.0471975)
    assert job.hits == (("Cu", "Ni"), ("Cu", "Cu"))
    scene = job.coating(next(part for part in job.parts if isinstance(part, Coatings)), 1)
    assert {round(p.angle, 6) for p in scene.particles} == {1.047198}
    assert scene.substrate.layer[0].thickness == pytest.approx(20e-6)
    assert scene.substrate.height == pytest.approx(20e-6 + 3.0 * max(job.medians.values()), rel=1e-3)
    (tmp_path / "map.csv").write_text("\n".join(["0,0,0,0", "0,2,2,0", "0,1,2,0", "0,0,0,0"]))
    rough = job_of(tmp_path, TEXT + 'height_map = { file = "map.csv", unit = "500 um", height = "1 um" }\n')
    rough.check()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("share = 0.2", "share = 0.3", "powder needs values of powder.share that add up to 1: these add up to 1.1"),
        ("share = 0.2\n", "", "powder needs values of powder.share that add up to 1: these add up to 1.8"),
        ('"Al2O3"', '"Al2O4"', 'powder[2].material = "Al2O4": unknown material (did you mean "Al2O3"?)'),
        ('"Cu"', '"SiC"', "powder[1].material: SiC is a ceramic: it makes no metallic bond"),
        ("shapes", "shape", 'powder[2].shape: unknown key (did you mean "shapes"?)'),
        ("shapes = { angular", "shapes = { angled", "powder[2].shapes"),
        ("shapes = { angular = 1.0 }", 'files = "*.stl"', 'powder[2].files = "*.stl": no file in'),
        ("shapes = { angular = 1.0 }", 'core = { material = "Ni", diameter = "9 um" }', "powder[2] needs the share of its core"),
        ("shapes = { angular = 1.0 }", 'porosity = 0.1\npore_diameter = "4 um"', "powder.pore_diameter"),
        ("shapes = { angular = 1.0 }", 'hardness = "9 HV"', "powder.hardness"),
        ('spot = "6 mm"', 'passes = 2\nfirst = "30 mm"', "spray.first: the nearest line is 30 mm from the coated area"),
        ('spot = "6 mm"', 'passes = 2\ndistribution = "no.csv"', 'spray.distribution = "no.csv": the file is missing'),
        ('"20 degC"', '"20 degC"\ngroove = { width = "40 um", depth = "9 um", angle = "80 deg" }', "substrate.groove.angle"),
    ],
)  # fmt: skip
def test_a_fault_of_a_blend_is_one_message_with_its_key(tmp_path: Path, old: str, new: str, says: str) -> None:
    """Before anything is computed."""
    assert old in BLEND
    with pytest.raises(ColdsprayError) as error:
        job_of(tmp_path, BLEND.replace(old, new, 1)).check()
    (problem,) = error.value.problems if isinstance(error.value, SceneError) else (str(error.value),)
    assert problem.startswith(says)


def test_a_powder_too_rare_for_a_coating_is_told_with_its_number(tmp_path: Path) -> None:
    text = BLEND.replace("share = 0.8", "share = 0.9999").replace("share = 0.2", "share = 0.0001")
    with pytest.raises(
        SceneError, match=r"powder\[2\] has no particle, because its share is small: give a larger share"
    ):
        job_of(tmp_path, text).check()


def test_rods_have_room_on_the_substrate_of_a_coating(tmp_path: Path) -> None:
    """A rod is three diameters long; the job itself has no key for the width of its coatings."""
    job_of(
        tmp_path, TEXT.replace('sizes = "15-45 um"', 'sizes = "15-45 um"\nshapes = { sphere = 0.7, rod = 0.3 }')
    ).check()
