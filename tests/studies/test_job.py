"""A job: efficiency and thickness of made-up sprays, what is computed again, and a whole one through the command line."""

import json
import math
import os
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from coupler.commands.main import main
from coupler.errors import SceneError, StoreError
from coupler.files.outputs import keep_toml
from coupler.physics.adhesion import PairFormula
from coupler.plan.job import Coatings, Job, Search, read
from coupler.spray.window import Spray
from coupler.studies import critical, job_parts
from coupler.studies import job as study
from coupler.studies.critical import Bracket
from coupler.studies.job_numbers import answer, numbers
from coupler.studies.job_parts import Bonds, Coating, efficiency, thickness
from coupler.studies.pace import Pace
from coupler.studies.trust import RED

TEXT = (Path(job_parts.__file__).parents[1] / "commands" / "templates" / "job.toml").read_text()


def spray_of(velocity: np.ndarray, critical: float = 400.0) -> Spray:
    share, one = (np.arange(len(velocity)) + 0.5) / len(velocity), np.ones(len(velocity))
    return Spray(share, one, velocity, one, one, (PairFormula("Cu", critical),) * len(velocity))


def on(low: float | None, high: float | None, **more: object) -> Bonds:
    return Bonds("Cu", "Cu", "bonds/Cu_on_Cu/5000", Bracket(low, high), **more)


def test_efficiency_is_the_share_of_the_mass_above_the_computed_critical_velocity() -> None:
    """Velocities even from 700 down to 500 m/s over the mass: half of it flies faster than 600, a quarter more in the bracket."""
    spray = spray_of(np.linspace(700.0, 500.0, 25))
    value, least, greatest = efficiency(spray, on(550.0, 650.0))
    assert value == pytest.approx(0.5, abs=0.03)
    assert least == pytest.approx(0.25, abs=0.03)
    assert greatest == pytest.approx(0.75, abs=0.03)


@pytest.mark.parametrize(("low", "high", "share"), [(800.0, None, 0.0), (None, 450.0, 1.0), (None, None, 1.0)])
def test_efficiency_of_a_search_without_a_bracket(low: float | None, high: float | None, share: float) -> None:
    """It rebounds at all velocities, sticks at all, or has no verdict: then nothing to all of it may stick."""
    value, least, greatest = efficiency(spray_of(np.full(25, 600.0)), on(low, high))
    assert (low is None and high is None) or value == share
    assert (least, greatest) == ((0.0, 1.0) if low is high else (share, share))


def test_the_error_of_a_critical_velocity_holds_those_of_resolution_and_strength() -> None:
    wide = on(590.0, 610.0, error=40.0, sets={"Johnson_1983": Bracket(440.0, 480.0)})
    assert wide.band == (440.0, 640.0)
    assert on(590.0, None).band == (590.0, math.inf)


@pytest.fixture
def job(tmp_path: Path):
    path = tmp_path / "cu.toml"
    path.write_text(TEXT)
    return read(path)


def test_the_thickness_of_a_pass_keeps_the_mass(job) -> None:
    """30 g/min at 300 mm/s on a track of 6 mm: half of it, with a tenth of pores, per area of the track."""
    layer = thickness(job, {"Cu": (0.5, 0.4, 0.6)}, 0.1)
    rho = job.powders["Cu"].metal.rho
    assert [each * 0.9 * rho * 6e-3 * 0.3 for each in layer] == pytest.approx([0.25e-3, 0.2e-3, 0.3e-3])


def test_formula_and_bonds_that_disagree_stand_first(job) -> None:
    """Copper flies at 1.6 times its critical velocity by the formula; bonds that tear up to 900 m/s say that nothing stays."""
    found = {("Cu", "Al6061"): replace(on(900.0, None), base="Al6061"), ("Cu", "Cu"): on(400.0, 420.0)}
    lines = numbers(job, found, Coating({}, {}))
    said = answer(lines)
    assert said[0].startswith("Formula and computed bonds disagree. Share of the powder that sticks on Al6061: 100%")
    assert "0% by bonds. By bonds no size sticks. A first layer then needs" in said[0]
    assert len([text for text in said if "disagree" in text]) == 1
    assert {line.label: line.computed for line in lines}[
        "Critical velocity on Al6061, the first layer"
    ] == "above 900 m/s"
    assert all(line.why for line in lines)


def test_what_is_not_computed_is_not_trusted(job) -> None:
    lines = numbers(job, {}, Coating({}, {}))
    assert {line.colour for line in lines} == {RED}
    assert "not computed by bonds" in answer(lines)[0]


def test_a_coating_has_the_stiffness_of_its_seeds_where_its_block_is_large_enough(job) -> None:
    """100 and 104 GPa: the mean with the standard error of two; without a block there is no line."""
    values = {
        "porosity_open": 0.01,
        "porosity_closed": 0.0,
        "Sa_m": 1e-6,
        "stress_in_plane_Pa": -5e7,
        "void_limit_m": 1e-6,
    }
    measures = {f"coatings/{seed}": SimpleNamespace(**values) for seed in (1, 2)}
    blocks = {
        seed: SimpleNamespace(values={"E_in_plane": SimpleNamespace(mixed=E), "k_across": SimpleNamespace(mixed=350.0)})
        for seed, E in ((1, 100e9), (2, 104e9))
    }
    lines = {line.label: line for line in numbers(job, {}, Coating(measures, {}, blocks))}
    assert lines["Young's modulus in the plane"].computed == "102.0 ± 2.0 GPa"
    assert lines["Heat conductivity across"].values["computed"] == (350.0, 350.0, 350.0)
    assert lines.keys() - {line.label for line in numbers(job, {}, Coating(measures, {}))} == {
        "Young's modulus in the plane", "Heat conductivity across",
    }  # fmt: skip


@pytest.fixture
def blend(tmp_path: Path):
    path = tmp_path / "blend.toml"
    ceramic = '[[powder]]\nmaterial = "Al2O3"\nshare = 0.2\nsizes = "15-45 um"\n\n[gas]'
    path.write_text(TEXT.replace("[powder]", "[[powder]]\nshare = 0.8").replace("[gas]", ceramic))
    return read(path)


def coated(*shares: float) -> Coating:
    """Coatings in which these shares of the ceramic stay."""
    values = dict.fromkeys(("porosity_open", "porosity_closed", "Sa_m", "stress_in_plane_Pa", "void_limit_m"), 0.0)
    each = [
        SimpleNamespace(**values, phases=[{"metal": "Al2O3", "efficiency": share, "broken": 2}]) for share in shares
    ]
    return Coating({f"coatings/{k}": measures for k, measures in enumerate(each)}, {})


def test_a_blend_has_the_fed_and_the_deposited_share_of_each_powder(blend) -> None:
    """By bonds all copper stays, of the alumina 5 to 15 % embeds: 0.2 x 0.1 of 0.82. By the formula nothing of the alumina stays."""
    found = {("Cu", "Cu"): on(None, 500.0)}
    lines = {line.label: line for line in numbers(blend, found, coated(0.05, 0.15))}
    assert lines["Al2O3: Share of the powder that embeds"].values["formula"] == (0.0, 0.0, 0.0)
    assert lines["Al2O3: Share of the powder that embeds"].values["computed"] == pytest.approx((0.1, 0.05, 0.15))
    assert "Critical" not in " ".join(label for label in lines if label.startswith("Al2O3"))
    assert lines["Al2O3: Share of the powder that embeds"].how.endswith("(4 broken)")
    share = lines["Al2O3: Share of the mass of the coating"]
    assert share.values["computed"] == pytest.approx((0.02 / 0.82, 0.01 / 0.81, 0.03 / 0.83))
    assert share.values["formula"] == (0.0, 0.0, 0.0)
    assert share.how == "20% of the mass that is fed"
    assert lines["Cu: Share of the mass of the coating"].values["computed"][0] == pytest.approx(0.8 / 0.82)
    said = answer(list(lines.values()))
    assert (
        "Al2O3: Share of the mass of the coating: 0% by the formula, 2% (1% to 4%) computed; 20% of the mass that is fed."
        in said
    )
    layer, rho = lines["Thickness of one pass"].values, {n: blend.powders[n].metal.rho for n in blend.powders}
    assert layer["formula"][0] * 6e-3 * 0.3 == pytest.approx(0.8 * 0.5e-3 / rho["Cu"])
    assert layer["computed"][0] * 6e-3 * 0.3 == pytest.approx(0.8 * 0.5e-3 / rho["Cu"] + 0.02 * 0.5e-3 / rho["Al2O3"])


def test_without_a_coating_the_share_of_a_ceramic_is_not_computed(blend) -> None:
    lines = {line.label: line for line in numbers(blend, {("Cu", "Cu"): on(None, 500.0)}, Coating({}, {}))}
    assert lines["Al2O3: Share of the powder that embeds"].values["computed"] is None
    assert lines["Cu: Share of the mass of the coating"].values == {"formula": (1.0, 1.0, 1.0), "computed": None}


def test_the_pages_say_each_powder_by_name(blend, tmp_path: Path) -> None:
    found = {("Cu", "Cu"): on(500.0, 520.0)}
    known = study.record(blend, {"computed_s": {}, "left_out_s": {}, "failed": {}}, found, Coating({}, {}))
    assert known["powders"] == {"Cu": 0.8, "Al2O3": 0.2}
    text = study.page(blend, TEXT, tmp_path, known, found, Coating({}, {}))
    for said in ("Cu + Al2O3 on Al6061", "Cu 80% of the mass", "Al2O3 20% of the mass", "a ceramic makes no bond"):
        assert said in text
    labels = [line.get_label() for line in study.deposition_window(blend, found).axes[0].get_lines()]
    assert {"Cu at impact (25 classes of equal mass)", "critical, bonds on Cu"} <= set(labels)
    assert "Al2O3 at impact (25 classes of equal mass)" in labels


def test_at_an_angle_the_formula_takes_the_normal_velocity(tmp_path: Path) -> None:
    """At 60 degrees the critical velocities double, and the spot is twice as wide."""
    path = tmp_path / "cu.toml"
    path.write_text(TEXT.replace('spot = "6 mm"', 'spot = "6 mm"\nangle = "60 deg"'))
    oblique = read(path)
    path.write_text(TEXT)
    normal = read(path)
    label = "Critical velocity on Cu, after the first layer"
    two, one = ({line.label: line for line in numbers(job, {}, Coating({}, {}))}[label] for job in (oblique, normal))
    assert two.values["formula"] == pytest.approx([2.0 * v for v in one.values["formula"]])
    all_stays = {"Cu": (1.0, 1.0, 1.0)}
    assert thickness(oblique, all_stays, 0.0)[0] == pytest.approx(0.5 * thickness(normal, all_stays, 0.0)[0])
    assert any("gun at 60 degrees" in text for text in study._assumed(oblique))


def test_a_part_whose_points_do_not_resolve_a_powder_is_told_and_left_out(job, tmp_path, monkeypatch) -> None:
    def seconds(job, part, *_) -> float:
        raise SceneError(["particle.pore_diameter: not resolved"], "cu_on_Cu")

    monkeypatch.setattr(study, "seconds", seconds)
    monkeypatch.setattr(study, "page", lambda *_: "")
    known = study.compute(job, TEXT, tmp_path / "out", lambda _: 1.0, 1, lambda _: None)
    assert known["failed"].keys() == {part.words for part in job.parts}
    assert known["computed_s"] == known["left_out_s"] == {}


def test_a_folder_has_one_job_and_any_time(tmp_path: Path) -> None:
    kept = tmp_path / "job.toml"
    keep_toml(kept, TEXT, "job", ["within"])
    keep_toml(kept, TEXT.replace("30 min", "2 h"), "job", ["within"])
    with pytest.raises(StoreError, match="holds another job"):
        keep_toml(kept, TEXT.replace("500 degC", "600 degC"), "job", ["within"])


class Time:
    """A clock that shows what a test sets."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch) -> Time:
    shown = Time()
    for module in (critical, study):
        monkeypatch.setattr(module, "time", shown)
    return shown


def searched(
    job, tmp_path: Path, monkeypatch, clock: Time, sticks_from: float, within: float
) -> tuple[object, list[float]]:
    """The search of a particle that sticks from a velocity on, each velocity in 10 s; and the velocities."""
    rows: list[dict[str, object]] = []

    def rows_at(scene, velocity, *_) -> list[dict[str, object]]:
        clock.now += 10.0
        verdict = "sticks" if velocity >= sticks_from else "rebounds"
        rows.append({"velocity_m_s": velocity, "placement": 0, "verdict_by_bonds": verdict})
        return rows[-1:]

    monkeypatch.setattr(critical, "rows_at", rows_at)
    monkeypatch.setattr(critical, "rows_of", lambda _: list(rows))
    part = Search("Cu", "Al6061", 1000)
    found = job_parts.search(job, part, tmp_path, 1, lambda _: None, lambda _: clock.now + 10.0 <= within)
    return found, [row["velocity_m_s"] for row in rows]


def test_no_velocity_is_computed_that_the_powder_does_not_reach(job, tmp_path, monkeypatch, clock) -> None:
    """It rebounds at all: the fastest and the slowest size decide, and the efficiency is zero."""
    found, velocities = searched(job, tmp_path, monkeypatch, clock, 900.0, 1e6)
    assert velocities == [*reversed(job.reach("Cu"))]
    assert efficiency(job.arrived["Cu"], Bonds("Cu", "Al6061", "", found)) == (0.0, 0.0, 0.0)


def test_a_powder_that_sticks_is_searched_down_to_erosion(job, tmp_path, monkeypatch, clock) -> None:
    found, velocities = searched(job, tmp_path, monkeypatch, clock, 480.0, 1e6)
    assert velocities[:2] == [*reversed(job.reach("Cu"))]
    assert found.low < 480.0 <= found.high
    assert found.high - found.low <= 0.1 * found.velocity


@pytest.mark.parametrize(("within", "answers"), [(15.0, False), (25.0, True)])
def test_a_search_ends_with_its_time(job, tmp_path, monkeypatch, clock, within: float, answers: bool) -> None:
    """After one velocity that sticks nothing is known of slower sizes; after the slowest all of them stick."""
    found, velocities = searched(job, tmp_path, monkeypatch, clock, 300.0, within)
    assert clock.now <= within
    assert len(velocities) == (2 if answers else 1)
    assert (found is not None) == answers


def test_a_job_keeps_its_time_where_impacts_take_three_times_the_forecast(job, tmp_path, monkeypatch, clock) -> None:
    """The first parts tell the pace of the others; what does not fit is said with its time."""
    takes = {1000: 3.0, 2000: 6.0, 5000: 15.0, 16000: 70.0, 40000: 250.0}

    def seconds(job, part: Search | Coatings, *_) -> float:
        return takes[part.points] if isinstance(part, Search) else 10.0 * part.seeds

    def search(job, part: Search, out, jobs, log, more) -> Bracket:
        for _ in range(2):
            clock.now += 3.0 * takes[part.points]
            more(3.0 * takes[part.points])
        return Bracket(900.0, None)

    monkeypatch.setattr(study, "seconds", seconds)
    monkeypatch.setattr(study, "search", search)
    monkeypatch.setattr(study, "coatings", lambda *_: Coating({}, {}))
    monkeypatch.setattr(study, "page", lambda *_: "")
    known = study.compute(job, TEXT, tmp_path / "out", lambda _: 1.0, 1, lambda _: None)
    assert clock.now <= job.data.within
    assert known["computed_s"]["bonds of Cu on Al6061 with 16000 points"] == pytest.approx(420.0)
    assert known["left_out_s"]["bonds of Cu on Cu with 40000 points, 3 impacts at each velocity"] == pytest.approx(
        1500.0
    )
    assert known["more_time"].startswith("more time would add: bonds of Cu on Cu with 5000 points, ")
    assert known["more_time"].endswith("; 2 further parts")


@pytest.mark.slow
def test_a_whole_job_and_only_what_is_missing_of_it(tmp_path: Path, monkeypatch, capsys) -> None:
    """A coating alone, of copper on aluminium; then its second seed after its folder is lost."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("coupler.commands.accuracy.here", lambda: Pace(1.0, ""))
    monkeypatch.setattr(Job, "parts", (Coatings(400, 0.5, 1, 2),))  # of two particles each
    assert main(["new", "job", "cu"]) == 0
    assert main(["job", "cu.toml", "--jobs", "1"]) == 0
    out = Path("runs/job-cu")
    assert "100% (20% to 100%) by the formula" in capsys.readouterr().out
    known = json.loads((out / "job.json").read_text())
    porosity = next(line for line in known["numbers"] if line["label"] == "Porosity")
    assert 0.0 < porosity["values"]["computed"][0] < 0.5
    assert "±" in porosity["computed"]
    page = (out / "job.html").read_text()
    assert all(
        text in page
        for text in ("Cu on Al6061", "by the formula", "5 % of the powder", 'class="mark red"', porosity["computed"])
    )
    seeds = sorted((out / "coatings").glob("*/summary.json"))
    before = [os.stat(path).st_mtime_ns for path in seeds]
    shutil.rmtree(seeds[1].parent)
    seeds[1].parent.with_suffix(".json").unlink()
    assert main(["job", "cu.toml", "-q", "--jobs", "1"]) == 0
    after = [os.stat(path).st_mtime_ns for path in seeds]
    assert after[0] == before[0]
    assert after[1] > before[1]
    again = json.loads((out / "job.json").read_text())
    assert again["numbers"] == known["numbers"]  # the same seed gives the same coating
