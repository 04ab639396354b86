"""Which block of a run is taken, what the command prints and writes, and what it refuses."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import scenes
from conftest import SharedRuns

from coupler.commands.main import main
from coupler.errors import StoreError
from coupler.files.result import Result
from coupler.properties.measure import cold_coating, extract_sample

BLOCK = ["--side", "28 um", "--heights", "1 um", "12 um"]  # two splats fill so much, though they do not fill it


@pytest.fixture(scope="module")
def cold(shared_run: SharedRuns) -> Result:
    """Two splats, one on the other, tied wherever they touch."""
    return shared_run(scenes.COLD)


def test_a_cold_run_says_which_nodes_are_bonded(cold: Result) -> None:
    """Only nodes of a splat can be, as splats are tied to what lies below; none of the first to the second."""
    at_nodes, in_cells = cold.fields(-1, "cold").split()
    bonded = at_nodes["bonded"] > 0.0
    body = in_cells["body"]
    of_substrate = cold.fields(-1, "cold").cells[body == 0]
    assert bonded.any()
    assert not bonded[of_substrate].any()
    assert set(at_nodes["touching"]) <= {0.0, 1.0}


def test_the_command_prints_and_writes_the_properties(
    cold: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small block of a splat: stiffness and conductivities lie between nothing and the bulk; of two runs it gives the mean."""
    monkeypatch.setenv("COLUMNS", "160")
    folder, other = tmp_path / "of", tmp_path / "other"
    shutil.copytree(cold.directory, other)
    assert main(["properties", str(cold.directory), str(other), "--out", str(folder), *BLOCK]) == 0
    said = capsys.readouterr().out
    assert "Young's modulus, in plane" in said
    assert "give runs with other seeds" in said
    written = json.loads((folder / "properties.json").read_text())
    of_run = written["runs"][str(cold.directory)]
    assert written["seeds"]["E_across"]["error"] == 0.0
    assert written["seeds"]["E_across"]["mean"] == of_run["values"]["E_across"]["mixed"]
    assert 0.0 < of_run["values"]["E_in_plane"]["mixed"] <= of_run["values"]["E_in_plane"]["kinematic"] * (1 + 1e-6)
    assert of_run["values"]["k_across"]["kinematic"] <= of_run["values"]["k_across"]["bulk"]
    with (folder / "properties.csv").open() as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    assert {row["property"] for row in rows} == set(of_run["values"])


@pytest.mark.slow
def test_the_command_pulls_and_bends(
    cold: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tied splats never part: they bear less than the flow stress of nickel with its strain. The strip bends away from pressure."""
    monkeypatch.setattr("coupler.properties.pull.MOST", 0.004)
    asked = ["--pull", "--strip", "1 mm", "--sprayed-at", "500 K"]
    assert main(["properties", str(cold.directory), "--out", str(tmp_path), *BLOCK, *asked]) == 0
    said = capsys.readouterr().out
    assert "bonds of this run never break" in said
    written = json.loads((tmp_path / "properties.json").read_text())
    by_direction = {pull["direction"]: pull for pull in written["pull"]}
    assert set(by_direction) == {"across", "in_plane", "adhesion"}
    assert all(0.0 < pull["strength_Pa"] < 2e9 for pull in by_direction.values())
    assert all(pull["energy_error"] < 0.02 for pull in by_direction.values())
    strip = written["strip"]
    assert (strip["deposited_1_m"] > 0.0) == (strip["arriving_Pa"] < 0.0)
    assert strip["misfit_1_m"] != 0.0  # nickel and steel expand by unequal amounts
    for name in ("pull.csv", "pull.png", "pull_adhesion.vtu", "strip.csv", "strip.inp"):
        assert (tmp_path / name).stat().st_size > 0


def test_what_has_no_cold_coating_or_no_room_is_refused(
    cold: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(StoreError, match=r"contains .* splats, but 2 are needed: choose a larger"):
        cold.properties(side=4e-6, heights=(3e-6, 6e-6))
    _, splats, metals = cold_coating(cold)
    joint = extract_sample(
        splats, metals, np.full(3, -6e-6), np.full(3, 6e-6), first=0
    )  # to the substrate: one splat is enough
    assert joint.splats < 2.0
    assert {0, 1} <= set(joint.block.body)
    for heights in ((-30e-6, 6e-6), (300e-6, 400e-6)):
        with pytest.raises(StoreError, match="the lower must be above the substrate"):
            cold.properties(heights=heights)
    with pytest.raises(StoreError, match="smaller than an element of the coating"):
        cold.properties(side=1e-12)
    hot = tmp_path / "hot"
    shutil.copytree(cold.directory, hot)
    (hot / "cold.vtkhdf").unlink()
    assert main(["properties", str(hot)]) == 2
    assert "has no cold coating" in capsys.readouterr().err
