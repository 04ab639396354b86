"""Films of a run, and runs side by side."""

import io
import json
import shutil

import made_up_run
import numpy as np
import pytest
from browser import CHROMIUM, Browser

from coupler.commands import main as cli
from coupler.errors import StoreError
from coupler.files.result import Result
from coupler.report.animation import animate, frames
from coupler.report.compare import compare, comparison_table, differences, names_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "nickel"
    return made_up_run.write(folder, steps=4, points=2000, edge=7.5, summary=made_up_run.summary())


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """Another run, larger and faster, of three steps."""
    scene = made_up_run.SCENE.replace('"500 m/s"', '"600 m/s"\nangle = "30 deg"').replace('"25 um"', '"30 um"')
    summary = made_up_run.summary(end={"flattening_ratio": 0.6117, "T_max_K": None})
    folder = tmp_path_factory.mktemp("more") / "nickel"
    return made_up_run.write(folder, steps=3, points=2000, edge=7.5, scene=scene, summary=summary)


def test_one_frame_and_one_range_of_colours_through_time(folder):
    pictures = list(frames(Result(folder), "T"))
    assert len(pictures) == 4
    assert len({picture.shape for picture in pictures}) == 1
    rows, columns, _ = pictures[0].shape
    assert rows % 2 == columns % 2 == 0
    assert rows > 400
    bars = [picture[rows // 8 :, int(0.84 * columns) :] for picture in pictures]  # without the time, in the heading
    for bar in bars[1:]:
        np.testing.assert_array_equal(bar, bars[0])
    assert (bars[0] < 128).any(axis=2).mean() > 0.02  # numbers and colours are there
    corner = [picture[int(0.75 * rows) :, : columns // 5] for picture in pictures]
    assert all((part.max(axis=2) < 60).sum() > 100 for part in corner)  # the scale bar
    hot = [(picture[:, : int(0.8 * columns), 2] < 90).mean() for picture in pictures]  # no blue: hot
    assert hot[0] < hot[1] < hot[3]


@pytest.mark.slow
def test_mp4(folder, tmp_path):
    import imageio_ffmpeg

    path = animate(Result(folder), tmp_path / "film.mp4", "eps_p", fps=5)
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    assert about["codec"] == "h264"
    assert about["fps"] == pytest.approx(5)
    width, height = about["size"]
    read = [np.frombuffer(picture, np.uint8).reshape(height, width, 3).astype(int) for picture in reader]
    drawn = [picture.astype(int) for picture in frames(Result(folder), "eps_p")]
    assert len(read) == 4 + 8  # the last one stays for a while
    assert drawn[0].shape == (height, width, 3)
    for k, picture in enumerate(read):
        assert np.abs(picture - drawn[min(k, 3)]).mean() < 3
    assert np.abs(drawn[0] - drawn[3]).mean() > 3


def test_gif(folder, tmp_path):
    from PIL import Image

    path = animate(Result(folder), tmp_path / "film.GIF", "von_mises", fps=10)
    with Image.open(path) as film:
        assert (film.format, film.n_frames, film.info["loop"]) == ("GIF", 4, 0)
        pauses, pictures = [], []
        for number in range(film.n_frames):
            film.seek(number)
            pauses.append(film.info["duration"])
            pictures.append(np.asarray(film.convert("RGB")).astype(int))
    assert pauses == [100, 100, 100, 1600]
    assert np.abs(pictures[0] - pictures[3]).mean() > 3
    bar = [picture[len(picture) // 8 :, int(0.84 * picture.shape[1]) :] for picture in pictures]
    np.testing.assert_array_equal(bar[0], bar[3])


def test_without_ffmpeg_a_film_is_a_gif(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("coupler.report.animation.ffmpeg", lambda: None)
    with pytest.raises(StoreError, match=r"ffmpeg is missing: .*write a \.gif"):
        animate(Result(folder), tmp_path / "film.mp4")
    assert not list(tmp_path.iterdir())
    run = shutil.copytree(folder, tmp_path / "run")
    assert animate(Result(run)).name == "T.gif"


def test_the_message_of_ffmpeg_is_passed_on(folder, tmp_path, monkeypatch):
    program = tmp_path / "ffmpeg"
    program.write_text("#!/bin/sh\nexec 0<&-\necho 'Unknown encoder libx264' >&2\nexit 8\n")
    program.chmod(0o755)
    monkeypatch.setattr("coupler.report.animation.ffmpeg", lambda: str(program))
    with pytest.raises(StoreError, match="Unknown encoder libx264"):
        animate(Result(folder), tmp_path / "film.mp4")
    assert not (tmp_path / "film.mp4").exists()


def test_films_that_cannot_be_made(folder, tmp_path, capsys):
    empty = tmp_path / "empty"
    empty.mkdir()
    shutil.copy(folder / "scene.toml", empty)
    for arguments, says in (
        ([str(folder), "--out", str(tmp_path / "film.avi")], "use .mp4 or .gif"),
        ([str(folder), "--out", str(tmp_path / "no" / "film.mp4")], "there is no folder"),
        ([str(folder), "--out", str(tmp_path / "film.gif"), "--field", "stress"], "has the fields T, eps_p, von_mises"),
        ([str(folder), "--out", str(tmp_path / "film.gif"), "--fps", "0"], "give 0.1 to 100"),
        ([str(empty)], "try again later"),
    ):
        assert cli.main(["animate", *arguments]) == 2
        error = capsys.readouterr().err
        assert says in error
        assert error.count("\n") == 1
    assert not list(tmp_path.glob("film*"))


def printed(results) -> dict[str, list[str]]:
    from rich.console import Console

    stream = io.StringIO()
    Console(file=stream, width=160).print(comparison_table(results))
    lines = [[cell.strip() for cell in line.split("│")[1:-1]] for line in stream.getvalue().splitlines()]
    return {line[0]: line[1:] for line in lines if line}


def test_two_runs_in_a_table(folder, other):
    rows = printed([Result(folder), Result(other)])
    assert rows["flattening above the surface"] == ["0.5561", "0.6117", "+10.0%", ""]
    assert rows["crater depth"] == ["5.02", "5.02", "+0.0%", "µm"]
    assert rows["highest temperature"] == ["612", "-", "", "K"]
    assert rows["energy drift"] == ["-0.1", "-0.1", "", "%"]
    assert rows["particle.velocity"] == ["500 m/s", "600 m/s", "", ""]
    assert rows["particle.angle"] == ["", "30 deg", "", ""]
    assert "substrate.material" not in rows
    three = printed([Result(folder), Result(other), Result(folder)])
    assert three["flattening above the surface"] == ["0.5561", "0.6117", "0.5561", ""]


def test_two_runs_with_errors_in_a_table(folder, other, tmp_path):
    """0.5561 and 0.6117 with errors of .03 overlap; the crater has an error in one run alone."""
    results = []
    for source, errors in ((folder, ("flattening_ratio", "crater_depth_m")), (other, ("flattening_ratio",))):
        copy = shutil.copytree(source, tmp_path / source.parent.name / source.name)
        summary = json.loads((copy / "summary.json").read_text())
        widths = {"flattening_ratio": 0.03, "crater_depth_m": 1e-7}
        summary["impacts"][-1]["errors"] = {key: {"half_width": widths[key]} for key in errors}
        (copy / "summary.json").write_text(json.dumps(summary))
        results.append(Result(copy))
    rows = printed(results)
    assert rows["flattening above the surface"] == ["0.556 ± 0.030", "0.612 ± 0.030", "+10.0%, within the errors", ""]
    assert rows["crater depth"] == ["5.02 ± 0.10", "5.02", "+0.0%", "µm"]


def test_runs_are_told_apart_by_name_and_scene(folder, other, tmp_path):
    results = [Result(folder), Result(other)]
    names = names_of(results)
    assert names[0].endswith("/nickel")
    assert names[1].endswith("/nickel")
    assert len(set(names)) == 2
    assert differences([results[0], results[0]]) == []
    copy = shutil.copytree(folder, tmp_path / "several")
    text = made_up_run.SCENE.replace("[particle]", "[[particle]]")
    (copy / "scene.toml").write_text(text)
    assert differences([results[0], Result(copy)]) == []
    assert names_of([results[0], Result(copy)]) == ["nickel", "several"]


def test_figure_of_two_runs(folder, other, tmp_path):
    from matplotlib.image import imread

    picture = imread(compare([Result(folder), Result(other)], tmp_path / "both.png"))[..., :3]
    rows, columns = picture.shape[:2]
    assert columns > 1000
    upper, lower = picture[int(0.2 * rows) : rows // 2], picture[rows // 2 :]
    for part in np.array_split(upper[:, : int(0.85 * columns)], 2, axis=1):
        assert (part[..., 0] - part[..., 2] > 0.3).mean() > 0.02  # warm
    for part in np.array_split(lower[:, : int(0.85 * columns)], 2, axis=1):
        assert (part[..., 2] - part[..., 0] > 0.2).mean() > 0.02  # blue
    # the same run twice gives the same picture twice
    picture = imread(compare([Result(folder), Result(folder)], tmp_path / "same.png"))[..., :3]
    below = picture[int(0.2 * picture.shape[0]) :]
    step = round((3.6 + 0.12) * 150)
    np.testing.assert_allclose(below[:, 18:540], below[:, 18 + step : 540 + step], atol=0.01)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
def test_page_of_two_runs(folder, other, tmp_path):
    page = compare([Result(folder), Result(other)], tmp_path / "both.html")
    with Browser(tmp_path / "profile") as browser:
        browser.open(page)
        browser.until("document.body.dataset.ready === 'yes'")
        assert (browser.requests, browser.complaints) == ([page.as_uri()], [])
        assert browser.ask("document.querySelectorAll('.chart .main-svg').length") >= 6
        assert browser.ask("document.getElementById('height').data.length") == 2
        assert "600 m/s" in browser.ask("document.getElementById('scenes').textContent")
        assert "0.6117" in browser.ask("document.getElementById('measures').textContent")


def test_comparing_on_the_command_line(folder, other, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["compare", str(folder), str(other)]) == 0
    assert "comparison written to comparison.png" in capsys.readouterr().out
    assert (tmp_path / "comparison.png").is_file()
    empty = tmp_path / "empty"
    empty.mkdir()
    shutil.copy(folder / "scene.toml", empty)
    for arguments, says in (
        ([str(folder)], "give 2 to 12 folders"),
        ([str(folder)] * 13, "give 2 to 12 folders"),
        ([str(folder), "absent"], "absent is not a results folder"),
        ([str(folder), str(other), "--out", "x.pdf"], "use .png or .html"),
        ([str(folder), str(other), "--out", "no/x.png"], "cannot write no/x.png"),
        ([str(folder), str(empty)], f"{empty}: no stored step"),
    ):
        assert cli.main(["compare", *arguments]) == 2
        error = capsys.readouterr().err
        assert says in error
        assert error.count("\n") == 1


def test_an_unfinished_run_is_named_in_a_comparison(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "stopped")
    (copy / "summary.json").unlink()
    results = [Result(folder), Result(copy)]
    assert printed(results)["flattening above the surface"] == ["0.5561", "", "", ""]
    assert "Not finished: stopped" in compare(results, tmp_path / "x.html").read_text(encoding="utf-8")


def test_a_run_without_a_field_cannot_be_animated_by_it(folder, tmp_path):
    with pytest.raises(StoreError, match="no field 'J' to draw"):
        animate(Result(folder), tmp_path / "x.mp4", "J")
