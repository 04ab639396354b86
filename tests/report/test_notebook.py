"""What a notebook shows of a result: verdict, measures and section, and of a run with less than these what is missing."""

import base64
import json
import re
import shutil
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from made_up_run import summary, write
from PIL import Image

from coupler.files.result import Result


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("runs") / "ni", points=2000, edge=6.0, summary=summary(verdict="sticks"))


def test_a_finished_run_shows_verdict_measures_with_units_and_its_section(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # Jupyter sets it, and a table had escape sequences
    html = Result(folder)._repr_html_()
    for text in (
        "verdict: sticks",
        "25 µm Ni on SS304 at 500 m/s",
        r"flattening.* 0\.551 +0\.5561",
        r"crater depth.* 5\.02 +µm",
    ):
        assert re.search(text, html), text
    assert "\x1b" not in html
    (data,) = re.findall('src="data:image/png;base64,([^"]*)"', html)
    picture = np.asarray(Image.open(BytesIO(base64.b64decode(data))).convert("RGB")).astype(float)
    assert (picture[..., 0] - picture[..., 2] > 60).mean() > 0.02, "the upper half is coloured by temperature"
    assert len(data) < 200_000


def test_an_unfinished_run_says_how_far_it_is(folder: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(folder, tmp_path / "part")
    (copy / "summary.json").unlink()
    html = Result(copy)._repr_html_()
    assert "not finished: 2 steps are stored, until 40.0 ns" in html
    assert "data:image/png" in html


@pytest.mark.parametrize("name", ["summary.json", "plan.json", "particle.vtkhdf", "surface.vtkhdf", "target.vtkhdf"])
@pytest.mark.parametrize("content", [None, b"", b"{}", b"<script>\xff"])
def test_a_broken_run_is_shown_as_far_as_it_can_be_read(
    name: str, content: bytes | None, folder: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(folder, tmp_path / "broken")
    (copy / name).unlink()
    if content is not None:
        (copy / name).write_bytes(content)
    html = Result(copy)._repr_html_()
    assert "<script>" not in html
    assert html.count("data:image/png") == (name in ("summary.json", "plan.json"))
    assert ("verdict: sticks" in html) == (name != "summary.json")


def test_a_summary_whose_values_make_no_sense_is_named(folder: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(folder, tmp_path / "odd")
    text = json.loads((copy / "summary.json").read_text())
    text["impacts"][0]["errors"] = {"flattening_ratio": 3}
    (copy / "summary.json").write_text(json.dumps(text))
    assert "<p>no measures: " in Result(copy)._repr_html_()
