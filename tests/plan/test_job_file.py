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
        ('spot = "6 mm"', 'spot = "6 mm"\nangle = "20 deg"', "spray.angle: the particles of a job fall normal to the surface"),
        ('"30 min"', "30", "within = 30 needs a time with its unit"),
        ("[powder]", "[[powder]]", "a job has one powder: write a blend as a scene with [[coating.powder]]"),
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
    sizes = job_of(tmp_path, TEXT.replace('"15-45 um"', '"sizer.csv"')).sizes
    assert sizes.share == pytest.approx((0.2, 0.5, 0.9))
    assert sizes.known == pytest.approx((20e-6, 30e-6, 40e-6))


def test_shares_below_each_size_are_told_from_shares_of_classes(tmp_path: Path) -> None:
    (tmp_path / "sizer.csv").write_text("size (mm),passing (%)\n0.015,5\n0.02,20\n0.03,50\n0.04,90\n0.06,100\n")
    sizes = job_of(tmp_path, TEXT.replace('"15-45 um"', '"sizer.csv"')).sizes
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
    slowest, fastest = job.reach
    median = job.arrived.critical[len(job.arrived.critical) // 2]
    assert slowest < fastest
    assert job.arrived.fates(fastest / median)["sticks"] == 0.0
    assert job.arrived.fates(slowest / median)["sticks"] == 1.0


def test_the_scenes_of_a_job_have_a_plan(tmp_path: Path) -> None:
    """The smallest particle of each coating has points enough, its velocity is that of the gas."""
    job = job_of(tmp_path)
    for part in job.parts:
        if isinstance(part, Coatings):
            planned = plan(job.coating(part, 1))
            assert len(planned.impacts) == part.number
            assert max(impact.points for impact in planned.impacts) <= 1.1 * part.points
    scene = job.on("Al6061", 5000)
    assert plan(scene).impact.points == pytest.approx(5000, rel=0.02)
    assert scene.derived.material("Cu").strength.set == "Preston_2003"


def test_the_strength_set_is_that_of_the_highest_rates() -> None:
    """Those that docs/evidence/bonding.md compares with measured critical velocities, by the ranges that their sources state."""
    firsts = [sets_of({}, name)[0] for name in ("Cu", "Ni", "Al")]
    assert firsts == ["Preston_2003", "Steinberg_1996", "Steinberg_1996"]
    assert sets_of({}, "no metal") == sets_of({"strength": "Johnson_1983"}, "Cu") == []
