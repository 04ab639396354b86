"""A job: efficiency and thickness of made-up sprays, what is computed again, and a whole one through the command line."""

import json
import math
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from coupler.commands.main import main
from coupler.errors import StoreError
from coupler.physics.adhesion import PairFormula
from coupler.plan.job import CHOICES, read
from coupler.spray.window import Spray
from coupler.studies import job_parts
from coupler.studies.critical import Bracket
from coupler.studies.job_numbers import answer, numbers
from coupler.studies.job_parts import Bonds, Coating, efficiency, folder_of, thickness
from coupler.studies.trust import RED

TEXT = (Path(job_parts.__file__).parents[1] / "commands" / "templates" / "job.toml").read_text()


def spray_of(velocity: np.ndarray, critical: float = 400.0) -> Spray:
    share, one = (np.arange(len(velocity)) + 0.5) / len(velocity), np.ones(len(velocity))
    return Spray(share, one, velocity, one, one, (PairFormula("Cu", critical),) * len(velocity))


def on(low: float | None, high: float | None, **more: object) -> Bonds:
    return Bonds("Cu", "bonds/on_Cu/5000", Bracket(low, high), **more)


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
    layer = thickness(job, 0.5, 0.1)
    assert layer * 0.9 * job.metal.rho * 6e-3 * 0.3 == pytest.approx(0.5 * 0.5e-3)


def test_formula_and_bonds_that_disagree_stand_first(job) -> None:
    """Copper flies at 1.6 times its critical velocity by the formula; bonds that tear up to 900 m/s say that nothing stays."""
    found = [replace(on(900.0, None), base="Al6061"), on(400.0, 420.0)]
    lines = numbers(job, found, Coating({}, {}))
    said = answer(job, lines)
    assert said[0].startswith("Formula and computed bonds disagree. Share of the powder that sticks on Al6061: 100%")
    assert said[0].endswith("0% by bonds.")
    assert len([text for text in said if "disagree" in text]) == 1
    assert {line.label: line.computed for line in lines}[
        "Critical velocity on Al6061, the first layer"
    ] == "above 900 m/s"
    assert all(line.why for line in lines)


def test_what_is_not_computed_is_not_trusted(job) -> None:
    lines = numbers(job, [], Coating({}, {}))
    assert {line.colour for line in lines} == {RED}
    assert "not computed by bonds" in answer(job, lines)[0]


def test_a_folder_has_one_job_and_any_time(tmp_path: Path) -> None:
    folder_of(TEXT, tmp_path / "out")
    folder_of(TEXT.replace("30 min", "2 h"), tmp_path / "out")
    with pytest.raises(StoreError, match="holds another job"):
        folder_of(TEXT.replace("500 degC", "600 degC"), tmp_path / "out")


@pytest.mark.slow
def test_a_whole_job_and_only_what_is_missing_of_it(tmp_path: Path, monkeypatch, capsys) -> None:
    """The least choice, of copper on aluminium; then the second seed alone after its folder is lost."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("coupler.commands.accuracy.here", lambda: type("", (), {"factor": 1.0})())
    least = replace(CHOICES[0], disc=0.5, seeds=2)  # of two particles each
    monkeypatch.setattr("coupler.plan.job.CHOICES", (least,))
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
