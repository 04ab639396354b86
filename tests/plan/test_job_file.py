"""The file of a job, the sizes it names, and how much is computed in a time."""

from dataclasses import replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import pytest

from coupler.errors import SceneError
from coupler.plan.job import CHOICES, Job, choose, processor_time, read, seconds, sets_of
from coupler.plan.planning import plan

TEXT = (files("coupler.commands") / "templates" / "job.toml").read_text(encoding="utf-8")
CORES, FACTOR = 2, 1.0


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
        ('"30 min"', "30", "within = 30 needs a time with its unit"),
        ("[powder]", "[powders]", "powders: unknown key (did you mean \"powder\"?)"),
    ],
)  # fmt: skip
def test_a_fault_names_its_key_and_the_remedy(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in TEXT
    with pytest.raises(SceneError) as error:
        job_of(tmp_path, TEXT.replace(old, new, 1))
    assert any(says in problem for problem in error.value.problems), error.value.problems


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


def within(job: Job, time: float) -> Job:
    return replace(job, data=job.data.model_copy(update={"within": time}))


def test_each_choice_takes_longer_and_more_time_buys_more(tmp_path: Path) -> None:
    job, takes = job_of(tmp_path), processor_time(FACTOR)
    times = [seconds(job, choice, takes, CORES) for choice in CHOICES]
    assert all(a < b for a, b in pairwise(times))
    places = []
    for most in (times[0], 60.0, 600.0, 1800.0, 7200.0, 1e6):
        choice, time, then = choose(within(job, most), takes, CORES)
        assert time <= most
        assert then is None or then[1] > most
        places.append(CHOICES.index(choice))
    assert places == sorted(places)
    assert places[-1] == len(CHOICES) - 1
    with pytest.raises(SceneError, match="too short, the smallest choice takes"):
        choose(within(job, 0.9 * times[0]), takes, CORES)


def test_the_scenes_of_a_choice_have_a_plan(tmp_path: Path) -> None:
    """The smallest particle of a coating has points enough at each choice, its velocity is that of the gas."""
    job = job_of(tmp_path)
    for choice in CHOICES:
        planned = plan(job.coating(choice, 1))
        assert len(planned.impacts) == choice.number
        assert max(impact.points for impact in planned.impacts) <= 1.1 * choice.points
    scene = job.on("Al6061", 5000)
    assert plan(scene).impact.points == pytest.approx(5000, rel=0.02)
    assert scene.derived.material("Cu").strength.set == "Preston_2003"


def test_the_strength_set_is_that_of_the_highest_rates() -> None:
    """Those that docs/evidence/bonding.md compares with measured critical velocities, by the ranges that their sources state."""
    firsts = [sets_of({}, name)[0] for name in ("Cu", "Ni", "Al")]
    assert firsts == ["Preston_2003", "Steinberg_1996", "Steinberg_1996"]
    assert sets_of({}, "no metal") == sets_of({"strength": "Johnson_1983"}, "Cu") == []
