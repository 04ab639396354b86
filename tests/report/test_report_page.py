"""The page about a run: what it says, that it keeps to itself, and that a browser shows it."""

import base64
import html
import json
import re
import shutil
from pathlib import Path

import made_up_run
import numpy as np
import pytest
from browser import CHROMIUM, Browser
from runs import SharedRuns
from scenes import COLD, NI

from coupler.commands import main as cli
from coupler.errors import StoreError
from coupler.files.result import Result
from coupler.files.store import Store
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.record import plan_text
from coupler.report import charts, parts
from coupler.report.page import picks, report, write_report
from coupler.report.picture import Range, stage
from coupler.report.solid import TOP, frames, solid, thinned
from coupler.studies import coating, coating_seeds


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Five steps and a summary, with texts that would be markup if nobody took care."""
    summary = made_up_run.summary(
        run={"warnings": ["strain rates beyond the fit", "<img src=x onerror=alert(1)>"]},
        errors={
            "flattening_ratio": {"half_width": 0.0118},
            "crater_depth_m": {"half_width": 1.3e-7},
        },
    )
    scene = made_up_run.SCENE + '# </script><script>window.broken = 1</script> "quoted"\n'
    folder = tmp_path_factory.mktemp("runs") / "finished"
    return made_up_run.write(folder, steps=5, points=2500, edge=6.0, scene=scene, summary=summary)


@pytest.fixture(scope="module")
def page(finished):
    return report(Result(finished))


@pytest.fixture
def without_pictures(monkeypatch):
    """Pictures of the cut are empty: `page` has them, and a browser opens it."""
    monkeypatch.setattr("coupler.report.page.embedded", lambda figure: "data:,")


def light(finished: Path, folder: Path) -> Path:
    """A copy without fields: its page is made at once."""
    return shutil.copytree(finished, folder, ignore=shutil.ignore_patterns("*.vtkhdf"))


def rows(page: str) -> dict[str, list[str]]:
    """First cell of each row of all tables -> the other cells, as read."""
    found = {}
    for row in re.findall(r"<tr.*?</tr>", page, re.S):
        cells = [html.unescape(re.sub(r"<.*?>", "", cell)) for cell in re.findall(r"<td.*?>(.*?)</td>", row, re.S)]
        if cells:
            found[cells[0]] = cells[1:]
    return found


def test_the_page_says_what_was_computed(page):
    read = rows(page)
    assert read["flattening above the surface"] == ["0.551", "0.556 ± 0.012", ""]
    assert read["crater depth"] == ["5.3", "5.02 ± 0.13", "µm"]
    assert "spacing of the points" in page
    assert read["energy drift"] == ["-0.1", "%"]
    assert read["interface conduction"][0] == "on"
    assert read["thermal softening"][0] == "on"
    assert read["thermal softening"][2] == "more than 0"
    assert read["johnson cook A"][0] == "1.63e+08"
    assert "1 000 steps of 20 ms; 1 ns took 0.5 s. The time step is set by: particle 90%, target 10%." in page
    assert "25 µm Ni on SS304 at 500 m/s" in page
    assert "not finished" not in page
    assert page.count("<b>t = ") == 5  # on the first sheet and at four times
    assert "greatest deformation</figcaption>" in page
    front = page[page.index('<section id="front">') : page.index("</section>")]
    for text in ("0.556 ± 0.012", "25 µm Ni sphere, 500 m/s at 0°", "SS304 cylinder, 200 µm across", "friction 0.5",
                 "tied, criterion velocity", "strain rates beyond the fit", "without "):  # fmt: skip
        assert text in front


def test_the_page_keeps_to_itself_and_takes_text_for_text(page):
    own = re.sub(r"<script>.*?</script>", "", page, flags=re.S)  # plotly's own text names many addresses
    assert not re.findall(r"""(?:src|href|action|url)\s*[=(]\s*["']?\s*(?:https?:)?//""", own)
    assert "default-src 'none'" in own
    assert "<img src=x" not in page
    assert "&lt;img src=x onerror" in page
    assert "</script><script>window" not in page
    assert "&lt;/script&gt;&lt;script&gt;window.broken" in page
    assert len(page) < 12e6


def test_a_run_of_several_impacts(finished, tmp_path):
    copy = light(finished, tmp_path / "run")
    (copy / "summary.json").unlink()
    first, second = {"flattening_ratio": 0.5, "time_s": 1e-9}, {"flattening_ratio": 0.4, "velocity_z_m_s": 3.0}
    Store(copy).finish(made_up_run.summary_of({"end": first}, {"end": second}))
    page = report(Result(copy))
    table = page[page.index('<section id="impacts">') :]
    table = table[: table.index("</section>")]
    assert "impact 1" in table
    assert "impact 2" in table
    assert rows(table)["flattening above the surface"] == ["0.5", "0.4"]
    assert rows(table)["mean velocity upwards, m/s"] == ["", "3"]


def test_an_unfinished_run_says_so(finished, tmp_path, without_pictures):
    copy = shutil.copytree(finished, tmp_path / "run")
    (copy / "summary.json").unlink()
    page = report(Result(copy))
    assert "not finished" in page
    assert "reached 40.0 ns" in page
    assert rows(page)["crater depth"] == ["5", "µm"]
    assert "thermal softening" in rows(page)
    assert "beyond the fitted range: strain rates near v/D" in page  # what `check` warns of
    assert page.count("<b>t = ") == 5
    # the earliest moment: a scene and nothing else
    for path in copy.iterdir():
        if path.name not in ("scene.toml", "plan.json"):
            path.unlink()
    page = report(Result(copy))
    assert "not finished" in page
    assert "No step" in page
    assert "velocity = &quot;500 m/s&quot;" in page


def test_a_run_without_a_readable_plan_has_a_page(finished, tmp_path):
    copy = light(finished, tmp_path / "run")
    (copy / "plan.json").unlink()
    page = report(Result(copy))
    assert "no readable plan.json" in page
    assert "Material data" not in page


def history(**further: float) -> dict[str, np.ndarray]:
    lines = [made_up_run.row(amount, **further) for amount in np.linspace(0, 1, 11)]
    return {name: np.array([line[name] for line in lines]) for name in lines[0]}


def test_the_ledger_is_whole():
    for further in ({}, {"bonds": 1e-6}):
        figure = charts.energy(history(**further))
        stack = np.sum([trace["y"] for trace in figure["traces"]], axis=0)
        np.testing.assert_allclose(stack, 100 * (1 + history()["drift"]), rtol=1e-4)
        named = {trace["name"]: trace["y"] for trace in figure["traces"]}
        assert named["plastic work, target"][-1] == pytest.approx(50)
        assert named["elastic, both"][-1] == pytest.approx(0.5)
        assert ("other" in named) == bool(further)
        if further:  # energy in an entry that is not known here
            assert named["other"][-1] == pytest.approx(10)
    assert charts.energy({}) is None
    assert charts.energy({"time": np.zeros(0)}) is None


def test_each_impact_is_drawn_in_percent_of_its_own_energy():
    """A second impact with a quarter of the first's energy: both stacks are whole, no term is negative, nothing joins them."""
    first, second = history(), history()
    for name in second.keys() & {name for names, _, _ in charts.LEDGER for name in names}:
        second[name] = 0.25 * second[name]
    second["time"] = second["time"] + first["time"][-1] + 1e-9
    both = {name: np.concatenate([first[name], second[name]]) for name in first}
    both["impact"] = np.repeat([1.0, 2.0], len(first["time"]))
    figure = charts.energy(both)
    drawn = np.array([trace["y"] for trace in figure["traces"]])
    between = drawn.sum(axis=0) == 0.0
    assert np.flatnonzero(between).tolist() == [11, 12]
    np.testing.assert_allclose(drawn.sum(axis=0)[~between], 100 * (1 + both["drift"]), rtol=1e-4)
    assert drawn.min() >= 0.0
    alone = np.array([trace["y"] for trace in charts.energy(history())["traces"]])
    np.testing.assert_allclose(drawn[:, :11], alone)
    np.testing.assert_allclose(drawn[:, 13:], alone, rtol=1e-6)
    assert charts.over_time(both, "velocity")["traces"][0]["y"][11:13] == [None, None]


def test_curves_have_gaps_where_there_is_no_number():
    figure = charts.over_time({"time": np.array([0.0, 1e-9]), "velocity_z": np.array([np.nan, -3.0])}, "velocity")
    assert figure["traces"][0]["y"] == [None, -3.0]
    assert charts.over_time({"time": np.zeros(2)}, "velocity") is None


def test_the_3d_view_is_the_run(finished):
    result = Result(finished)
    at = stage(result)
    view = solid(result, [0, 4], {"T": Range(300.0, 500.0), "von_mises": Range(0.0, 900.0)}, at)
    assert view["times"] == [0.0, 40.0]
    frame, surface = view["frames"][1]["particle"], result.fields(-1, "surface")
    low, high = (np.array([side[end] for side in view["box"]]) for end in (0, 1))
    span = high - low
    points = low - span + read(frame["points"]).reshape(-1, 3) / TOP * 3 * span
    assert np.abs(points - surface.points * 1e6).max() < 0.005  # um
    triangles = read(view["triangles"][frame["triangles"]], "<u4").reshape(-1, 3).astype(int)
    np.testing.assert_array_equal(triangles, surface.cells)
    # the undeformed particle and the deformed one have their triangles in common
    assert view["frames"][0]["particle"]["triangles"] == frame["triangles"]

    field = view["fields"][0]
    cut = view["frames"][1]["target section"]
    T = field["least"] + read(cut["values"]["T"]) / TOP * field["span"]
    inside = result.fields(-1, "target").data["T"]
    assert T.max() > 350
    assert inside.min() - 0.1 <= T.min() <= T.max() <= inside.max() + 0.1
    y = low[1] - span[1] + read(cut["points"]).reshape(-1, 3)[:, 1] / TOP * 3 * span[1]
    np.testing.assert_allclose(y, at.plane * 1e6, atol=0.005)
    # the particle's section is filled to its outline
    part = view["frames"][1]["particle section"]
    places = low - span + read(part["points"]).reshape(-1, 3) / TOP * 3 * span
    corners = places[read(view["triangles"][part["triangles"]], "<u4").astype(int).reshape(-1, 3)][..., [0, 2]]
    (a, b), (c, d) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    filled = 0.5 * np.abs(a * d - b * c).sum()
    outline = np.array(max(view["frames"][1]["lines"], key=len)).reshape(-1, 2)
    x, z = outline.T
    assert filled == pytest.approx(abs(0.5 * (x[:-1] * z[1:] - x[1:] * z[:-1]).sum()), rel=1e-3)


def read(text: str, kind: str = "<u2") -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind).astype(float)


def test_large_surfaces_are_thinned():
    points, triangles = made_up_run.ball(6000)
    kept, fewer = thinned(points, triangles, 1000)
    assert 600 < len(kept) <= 1000
    assert fewer.max() < len(kept)
    corners = points[kept][fewer]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert 0.5 * np.linalg.norm(normal, axis=1).sum() == pytest.approx(4 * np.pi, rel=0.02)
    # turned outwards, but for slivers
    assert (normal * corners[:, 0]).sum() / 6 == pytest.approx(4 / 3 * np.pi, rel=0.02)
    same, all_of_it = thinned(points, triangles, 6000)
    assert len(same) == 6000
    assert all_of_it is triangles
    assert frames(100)[0] == 0
    assert frames(100)[-1] == 99
    assert len(frames(100)) == 26
    assert frames(3) == [0, 1, 2]


def test_pictures_are_taken_on_the_way_and_at_the_end(finished):
    assert picks(Result(finished)) == [1, 2, 3, 4]  # at 10, 20, 30 (greatest deformation) and 40 ns


def test_each_of_several_impacts_has_its_picture(finished, tmp_path, without_pictures):
    copy = shutil.copytree(finished, tmp_path / "run")
    (copy / "summary.json").unlink()
    one = {"greatest": {"time_s": 10e-9}, "end": {"time_s": 20e-9}}
    Store(copy).finish(made_up_run.summary_of(one, one))
    assert picks(Result(copy)) == [1, 3, 4]  # at 10, 20 + 10 and 40 ns
    page = report(Result(copy))
    assert "<b>t = 10.0 ns</b>, greatest deformation of impact 1" in page
    assert "<b>t = 30.0 ns</b>, greatest deformation of impact 2" in page


def test_where_the_page_goes(finished, tmp_path, capsys):
    copy = light(finished, tmp_path / "run")
    assert cli.main(["report", str(copy)]) == 0
    assert (copy / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert str(copy / "report.html") in capsys.readouterr().out
    for arguments, says in (
        ([str(tmp_path / "absent")], "is not a results folder"),
        ([str(tmp_path)], "holds no results"),
        ([str(copy), "--out", str(tmp_path / "no" / "x.html")], "cannot write"),
        ([str(copy), "--out", str(tmp_path)], "cannot write"),
    ):
        assert cli.main(["report", *arguments]) == 2
        error = capsys.readouterr().err
        assert says in error
        assert error.count("\n") == 1
    assert not list(tmp_path.glob("**/.*.part"))
    (copy / "target.vtkhdf").write_text("not HDF5")
    with pytest.raises(StoreError, match=r"target\.vtkhdf is damaged"):
        write_report(Result(copy))


OFFSET = 'offset = ["3 um", "-4 um"]\n'
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


def shown(page: Path, profile: Path) -> Browser:
    browser = Browser(profile)
    browser.open(page)
    browser.until("document.body.dataset.ready === 'yes'")
    return browser


@needs_chromium
def test_a_browser_shows_the_page(finished, page, tmp_path):
    path = tmp_path / "page.html"
    path.write_text(page, encoding="utf-8")
    with shown(path, tmp_path / "profile") as browser:
        assert browser.requests == [path.as_uri()]
        assert browser.complaints == []
        assert browser.ask("window.broken") is None
        assert browser.ask("document.querySelectorAll('#measures td').length") > 30
        assert browser.ask("document.querySelectorAll('.chart .main-svg').length") >= 9
        assert (
            browser.ask("[...document.querySelectorAll('#sections img')].map((image) => image.naturalWidth > 500)")
            == [True] * 12  # three fields at four times
        )
        # 3D: WebGL has a canvas, and is given another instant when asked; that it draws it takes seconds to see (the slow test below)
        assert browser.ask("document.querySelector('#solid canvas').width") > 300
        assert browser.ask("document.getElementById('now').textContent") == "40.0 ns"
        places = "document.getElementById('solid').data.map((trace) => [...trace.z].reduce((a, b) => a + b, 0)).join()"
        last = browser.ask(places)
        show_second_instant(browser)
        assert browser.ask("document.getElementById('now').textContent") == "10.0 ns"
        assert "," in last
        assert browser.ask(places) != last
        assert browser.requests == [path.as_uri()]
        assert browser.complaints == []
        fits(browser, tmp_path)


def fits(browser: Browser, folder: Path) -> None:
    """On a telephone nothing is wider than the screen; the first sheet of paper holds all of the front; dark is dark."""
    browser.screen(420, dark=True)
    browser.until("document.documentElement.scrollWidth === 420")  # curves follow the width after a moment
    wider = "[...document.querySelectorAll('.wide, pre')].filter((box) => box.scrollWidth > box.clientWidth).length"
    assert browser.ask(wider) == 0
    assert browser.ask("getComputedStyle(document.body).backgroundColor") == "rgb(22, 25, 29)"
    browser.screen(1280)
    assert browser.ask("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    browser.ask("document.querySelectorAll('section:not(#front), footer').forEach((part) => part.remove())")
    browser.ask(
        "document.getElementById('front').style.breakAfter = 'auto'"
    )  # else a sheet for what is left of the page
    # a curve that is drawn anew after the change of width may add an empty sheet for a moment
    papers = (browser.pdf(folder / "front.pdf").read_bytes() for _ in range(20))
    assert any(len(re.findall(rb"/Type\s*/Page\b", paper)) == 1 for paper in papers)


@needs_chromium
@pytest.mark.slow
@pytest.mark.parametrize("count", [6, 8])
def test_many_impacts_fit(finished, tmp_path, count):
    """Six stand side by side with all measures, eight below each other."""
    copy = shutil.copytree(finished, tmp_path / "run")
    (copy / "summary.json").unlink()
    scene = made_up_run.SCENE.replace("[particle]", "[[particle]]")
    head, particle = scene[: scene.index("[[")], scene[scene.index("[[") : scene.index("[substrate]")]
    several = f"{head}{count * (particle + OFFSET)}{scene[scene.index('[substrate]') :]}"
    (copy / "plan.json").write_text(plan_text(plan(Scene.from_text(several))))
    error = {"half_width": 0.0118}
    end = {"time_s": 1e-9, "flattening_ratio": 0.5512, "crater_depth_m": 5.3e-6, "eps_p_mean": 0.7, "T_mean_K": 423.1}
    impact = {
        "verdict": "rebounds",
        "material": "Ni",
        "diameter_m": 25e-6,
        "end": end,
        "errors": dict.fromkeys(end, error),
    }
    record = {
        "date": "2026-01-01",
        "host": "h" * 30,
        "versions": {f"package{k}": "1.2.3" for k in range(9)},
        "command": "x " * 99,
    }
    summary = made_up_run.summary_of(
        *[impact] * count, warnings=[f"{k} is beyond the fitted range " * 5 for k in range(8)]
    )
    Store(copy).finish(summary | {"provenance": record})
    path = write_report(Result(copy))
    front = path.read_text(encoding="utf-8")
    assert f"{count} Ni of 25 µm on SS304 at 500 m/s" in front
    assert "offset (3, -4) µm" in front
    assert "0.551 ± 0.012" in front
    assert ('<tr class="off"><td>Particle</td>' in front) == (
        count == 6
    )  # measures of particle and target have the same names
    with shown(path, tmp_path / "profile") as browser:
        fits(browser, tmp_path)


def show_second_instant(browser: Browser) -> None:
    browser.ask("{const s = document.getElementById('time'); s.value = 1; s.dispatchEvent(new Event('input'))}")
    browser.until("!window.solid.busy")


@needs_chromium
@pytest.mark.slow
def test_controls_of_the_page(finished, page, tmp_path):
    """Each control changes the picture; play reaches the end; the scene is copied; the page prints on some sheets."""
    path = tmp_path / "page.html"
    path.write_text(page, encoding="utf-8")
    with shown(path, tmp_path / "profile") as browser:
        pictures = [drawn(browser)]
        show_second_instant(browser)
        pictures.append(drawn(browser))
        browser.ask(
            "{const f = document.getElementById('field'); f.value = 'eps_p'; f.dispatchEvent(new Event('change'))}"
        )
        browser.until("!window.solid.busy")
        pictures.append(drawn(browser))
        browser.ask("document.getElementById('whole').click()")
        browser.until("document.getElementById('solid').data[2].visible === false")
        pictures.append(drawn(browser))
        assert len(set(pictures)) == 4
        browser.ask("document.getElementById('play').click()")
        browser.until("document.getElementById('now').textContent === '40.0 ns' && !window.solid.timer")
        browser.ask("navigator.clipboard.writeText = async (text) => { window.copied = text; }; 0")
        browser.ask("document.querySelector('.copy').click()")
        browser.until("document.querySelector('.copy').textContent === 'Copied'")
        assert browser.ask("window.copied") == Result(finished).scene_text
        browser.until("document.getElementById('solid-picture').naturalWidth > 300")  # what stands for WebGL on paper
        paper = browser.pdf(tmp_path / "page.pdf").read_bytes()
        assert paper.startswith(b"%PDF")
        assert 3 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 11
        assert browser.requests == [path.as_uri()]
        assert browser.complaints == []


def drawn(browser: Browser) -> str:
    return browser.ask("Plotly.toImage('solid', {format: 'png', width: 400, height: 300})")


@needs_chromium
@pytest.mark.slow
def test_a_browser_shows_a_real_run(tmp_path, shared_run):
    result = Result(shutil.copytree(shared_run(NI).directory, tmp_path / "run"))
    page = write_report(result)
    read_ = rows(page.read_text(encoding="utf-8"))
    assert float(read_["flattening above the surface"][-2]) == pytest.approx(result.flattening_ratio, abs=5e-4)
    with shown(page, tmp_path / "profile") as browser:
        assert (browser.requests, browser.complaints) == ([page.as_uri()], [])
        assert browser.ask("document.querySelectorAll('.chart .main-svg').length") >= 10
        assert browser.ask("window.solid.solid.fields.map((field) => field.name)") == ["T", "eps_p", "von_mises"]
        # the stack of energies reaches 100 % less the drift at every time
        stack = browser.ask("document.getElementById('ledger').data.map((trace) => trace.y)")
        np.testing.assert_allclose(np.sum(stack, axis=0), 100 * (1 + result.history("drift")), atol=0.02)


def test_a_cold_run_shows_its_residual_stress(shared_run: SharedRuns) -> None:
    """The cut through all bodies after the closing stage, by in-plane stress too, and the one number that the coating has."""
    result = shared_run(COLD)
    page = report(result, coating=coating_seeds.lines_of(result))
    section = page[page.index('<section id="cold">') :].split("</section>")[0]
    assert section.count("<img") == 3
    assert "in-plane stress" in section
    assert f"{coating.measure(coating.read(result)).stress_in_plane_Pa * 1e-6:+.0f}" in section
    assert "away from the rim" in section


def test_the_page_has_what_the_coating_is_worth(tmp_path: Path) -> None:
    """From the file of `coldspray properties` in the run; with one film, the central one; a damaged file is named."""
    (tmp_path / "scene.toml").write_text("")
    assert parts.properties(Result(tmp_path)) == ""
    path = tmp_path / "properties" / "properties.json"
    path.parent.mkdir()
    pulls = [{"direction": "in_plane", "film": film, "strength_Pa": film * 123e6} for film in (1.0, 2.0)]
    of_run = {"values": {"E_across": {"mixed": 150e9, "bulk": 200e9}}}
    path.write_text(json.dumps({"runs": {"here": of_run}, "pull": pulls}))
    text = parts.properties(Result(tmp_path))
    assert "<dt>Young&#x27;s modulus, across</dt><dd>75% of the bulk</dd>" in text
    assert "<dt>strength, in plane</dt><dd>123 MPa</dd>" in text
    assert "246" not in text
    path.write_text("{}")
    with pytest.raises(StoreError, match="damaged: compute the properties again"):
        parts.properties(Result(tmp_path))
