"""A run is followed from its files, and nothing is written into its folder."""

import os
import shutil
from pathlib import Path

import pytest
from runs import SharedRuns
from scenes import SHORT

from coupler.commands.main import main


def test_an_unfinished_run_is_shown_as_far_as_it_is(
    shared_run: SharedRuns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = shared_run(SHORT)
    copy = shutil.copytree(result.directory, tmp_path / "run")
    (copy / "summary.json").unlink()
    before = {path.name: path.stat().st_mtime_ns for path in copy.iterdir()}
    assert main(["watch", str(copy), "--once"]) == 0
    text = capsys.readouterr().out
    assert f"{result.sim_time_s * 1e9:.4g} ns" in text
    for words in ("crater depth", "energy drift", "kinetic", "plastic"):
        assert words in text
    assert {path.name: path.stat().st_mtime_ns for path in copy.iterdir()} == before
    (copy / "history.csv").unlink()
    assert main(["watch", str(copy), "--once"]) == 0
    assert "no time step is written yet" in capsys.readouterr().out
    for path in copy.iterdir():
        os.utime(path, (1e9, 1e9))
    assert main(["watch", str(copy), "--once"]) == 0
    assert "coldspray resume" in capsys.readouterr().out


def test_a_finished_run_ends_with_its_first_screen(shared_run: SharedRuns, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", str(shared_run(SHORT).directory)]) == 0
    assert "flattening above the surface" in capsys.readouterr().out
