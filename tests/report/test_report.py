"""The picture and the table, from a made-up splat in a made-up crater."""

import dataclasses
import io
import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_up_run import SCENE, ball, block, flattened, summary_of, write
from scenes import several

from coupler.errors import StoreError
from coupler.files.fields import Fields
from coupler.files.result import Result
from coupler.files.store import Store
from coupler.geometry.points import in_tets
from coupler.geometry.sections import crossing, section_loops, section_of_tets
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.record import plan_text
from coupler.report import picture, screen, section_picture
from coupler.report.compare import _change
from coupler.report.fields import FIELDS, from_points
from coupler.report.figure import READABLE, axes_at, blank, label_log
from coupler.report.page import report
from coupler.report.phases import colour_of, phases_of
from coupler.report.picture import cross_section, stage, view
from coupler.report.profiles import on_vertical, profiles
from coupler.report.words import alerts, remarks, span, summary_table, title


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write(tmp_path_factory.mktemp("runs") / "single_ni")


def area(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Of polygons (..., k), by the shoelace rule; positive if they turn from x to z."""
    return 0.5 * (x * np.roll(z, -1, axis=-1) - np.roll(x, -1, axis=-1) * z).sum(-1)


@pytest.mark.parametrize("plane", [0.0, 0.31, -0.7])
def test_cut_of_tetrahedra_is_exact(plane):
    points, tets = block(2.0, 3.0, 0.5)
    edges, owner = section_of_tets(points, tets, plane)
    corners, share = crossing(points, edges, plane)
    assert (share >= 0).all()
    assert (share <= 1).all()
    # Polygons that do not cross themselves and lie side by side fill the cut through the box.
    assert np.abs(area(corners[..., 0], corners[..., 1])).sum() == pytest.approx(4.0 * 3.0, rel=1e-12)
    middle = corners.mean(axis=1)
    inside = points[tets[owner]][..., [0, 2]]
    assert (middle >= inside.min(axis=1)).all()
    assert (middle <= inside.max(axis=1)).all()


@pytest.mark.parametrize("plane", [0.0, 0.5, -0.8])
def test_outline_of_a_hollow_ball(plane):
    outer, triangles = ball(4000)
    points = np.concatenate([outer, 0.9 * outer])
    both = np.concatenate([triangles, triangles[:, ::-1] + len(outer)])
    loops = section_loops(points, both, plane)
    assert len(loops) == 2
    small, large = sorted((area(*loop.T) for loop in loops), key=abs)
    assert large * small < 0  # the hole turns against the outline
    assert abs(large) == pytest.approx(np.pi * (1 - plane**2), rel=0.01)
    assert abs(small) == pytest.approx(np.pi * (0.81 - plane**2), rel=0.02)
    assert section_loops(points, both, 1.5) == []


@pytest.mark.parametrize("length", [0.9, 1.3, 3.0])
def test_the_label_of_a_colour_bar_is_no_longer_than_the_bar(length: float) -> None:
    """A coating is wide and flat: 'equivalent plastic strain' at its full size is longer than the section is high."""
    figure = blank(8.0, 4.0, dpi=100)
    box = axes_at(figure, 6.0, 0.3, 0.1, length)
    picture.colour_bar(box, "eps_p", picture.Range(0.0, 2.0), length)
    label = box.yaxis.label
    assert label.get_text().split() == ["equivalent", "plastic", "strain"]
    assert label.get_window_extent().height <= 100 * length
    assert label.get_fontsize() >= READABLE
    assert ("\n" in label.get_text()) == (length < 2.0)


def test_an_outline_has_all_corners() -> None:
    """Of two squares: the micrograph showed a pore in place of the last corner of each splat."""
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    outline = picture.outline_of([square, square + 2.0])
    inside = 0.9 * (square - 0.5) + 0.5
    assert outline.contains_points(np.concatenate([inside, inside + 2.0])).all()


def test_materials_are_those_of_shell_core_and_layers() -> None:
    """Two particles, one coated, on a layer; of one metal there are no phases."""
    layer = [{"material": "Al", "thickness": "10 um"}]
    core = {"material": "Al2O3", "share": 0.3}
    two = several({"core": core}, {"material": "Cu"}, substrate={"material": "SS304", "layer": layer})
    phases = phases_of(json.loads(plan_text(plan(two)))["plan"])
    assert phases is not None
    assert phases.names == ["Ni", "Al2O3", "OFHC_Cu", "SS304", "Al"]
    assert phases.particles.tolist() == [[0, 1], [2, 2]]
    data = {"body": [0, 1, 2, 3, 4], "impact": [0, 0, 1, 1, 2], "core": [0, 0, 0, 1, 0]}
    bodies = Fields(0.0, np.zeros((4, 3)), np.zeros((5, 4), int), {k: np.array(v, float) for k, v in data.items()})
    assert phases.of(bodies).tolist() == [3, 4, 0, 1, 2]
    assert phases_of(json.loads(plan_text(plan(several({}, {}))))["plan"]) is None
    assert phases_of({}) is None


def test_a_section_of_several_materials_shows_them(folder: Path, tmp_path: Path) -> None:
    """Above temperature and strain: particle and target in the colours of their materials."""
    from matplotlib.image import imread

    scene = SCENE.replace("velocity", 'core = { material = "Al2O3", share = 0.3 }\nvelocity')
    coated = imread(section_picture(Result(write(tmp_path / "run", scene=scene, impact=1.0))))[..., :3]
    plain = imread(section_picture(Result(folder), tmp_path / "plain.png"))
    assert len(coated) > 1.4 * len(plain)
    above = coated[: len(coated) // 3]
    for phase in (0, 2):  # nickel, which has no points of a core here, on steel
        assert np.isclose(above, colour_of(phase), atol=0.01).all(axis=-1).mean() > 0.02
    assert not np.isclose(plain[..., :3], colour_of(2), atol=0.01).all(axis=-1).any()


def test_picture_shows_both_fields(folder, tmp_path):
    from matplotlib.image import imread

    path = section_picture(Result(folder))
    assert path == folder / "section.png"
    picture = imread(path)[..., :3].astype(float)
    rows, columns = picture.shape[:2]
    assert rows > 600
    assert columns > 1000
    panels = picture[:, : int(0.83 * columns)]  # without the colour bars
    upper, lower = panels[: rows // 2], panels[rows // 2 :]
    for half, warm in ((upper, True), (lower, False)):
        red, blue = half[..., 0], half[..., 2]
        strong = (red - blue > 0.3) if warm else (blue - red > 0.3)
        assert strong.mean() > 0.03
        other = (blue - red > 0.3) if warm else (red - blue > 0.3)
        assert other.mean() < 0.001
        assert (half.max(axis=-1) < 0.2).mean() > 0.002  # outlines
        assert (half.min(axis=-1) > 0.99).mean() > 0.1  # nothing above the target
    before = imread(section_picture(Result(folder), tmp_path / "before.png", step=0))
    assert before.shape != picture.shape or (before[..., :3] != picture).any()


def test_title_of_an_oblique_impact_and_of_a_strange_plan(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "oblique")
    text = plan_of((copy / "scene.toml").read_text().replace('"500 m/s"', '"500 m/s"\nangle = "30 deg"'))
    (copy / "plan.json").write_text(text)
    assert title(Result(copy)) == "25 µm Ni on SS304 at 500 m/s and 30°"
    layered = text.replace('"layers": []', '"layers": [[{"name": "Al"}, 6e-6]]')
    (copy / "plan.json").write_text(layered)
    assert title(Result(copy)) == "25 µm Ni on Al / SS304 at 500 m/s and 30°"
    # Text of a stranger's plan is shown as it stands: no formulas, no end of it.
    (copy / "plan.json").write_text(text.replace('"Ni"', f'"$\\\\frac{{{"x" * 100}$"'))
    assert "$\\frac{x" in title(Result(copy))
    assert len(title(Result(copy))) < 120
    section_picture(Result(copy))
    (copy / "plan.json").write_text('{"plan": {"impacts": [3]}}')
    assert title(Result(copy)) == "oblique"


def test_title_of_many_particles():
    assert span([500.0, 500.0]) == "500"
    assert span([0.0, 20.0]) == "0, 20"
    assert span([18.44, 22.0, 25.0, 26.91, 18.44]) == "18.4 to 26.9"
    assert span([1250.0]) == "1250"


def test_the_section_shows_jets_whole(folder):
    """A jet of the target beyond the particle, and a particle deeper than its diameter, are inside the view."""
    result = Result(folder)
    at, fields = stage(result), result.fields
    _, right, bottom, _ = view(result, [-1], at)
    jet = np.array([[right * 1e-6 + 20e-6, at.plane, 30e-6]])

    class WithJet:
        def fields(self, step, domain):
            seen = fields(step, domain)
            points = np.vstack([seen.points, jet]) if domain == "target" else seen.points - [0, 0, 40e-6]
            return dataclasses.replace(seen, points=points)

    wide = view(WithJet(), [-1], at)
    assert wide[1] > right + 20
    assert wide[2] < bottom - 15
    assert wide[3] > 30


@pytest.mark.parametrize("limits", [(550.0, 900.0), (300.0, 1300.0), (5e-6, 60e-6), (0.02, 30.0)])
def test_a_logarithmic_axis_has_labels(limits):
    axes = axes_at(blank(3, 2, 100), 0.5, 0.5, 2, 1)
    axes.set(xscale="log", xlim=limits)
    label_log(axes.xaxis, 1e6 if limits[1] < 1e-3 else 1.0)
    axes.figure.canvas.draw()
    texts = [tick.get_text() for tick in axes.get_xticklabels() if limits[0] <= tick.get_position()[0] <= limits[1]]
    assert 2 <= len([text for text in texts if text]) <= 12


def plan_of(scene: str) -> str:
    return plan_text(plan(Scene.from_text(scene)))


def test_picture_of_an_unfinished_run_says_what_is_missing(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "run")
    (copy / "surface.vtkhdf").unlink()
    with pytest.raises(StoreError, match="no stored step of particle, surface and target"):
        section_picture(Result(copy))
    with pytest.raises(StoreError, match="cannot write"):
        section_picture(Result(folder), tmp_path / "nowhere" / "a.png")


def printed(result: Result) -> list[list[str]]:
    from rich.console import Console

    stream = io.StringIO()
    Console(file=stream, width=120).print(summary_table(result))
    return [[cell.strip() for cell in line.split("│")[1:-1]] for line in stream.getvalue().splitlines()]


def test_summary_table(tmp_path, monkeypatch):
    impact = {
        "energy_drift": 0.0031,
        "rebound_velocity_m_s": None,
        "points": 4012,
        "dt_mean_s": 5.2e-12,
        "unheard_of_K": 1.0,
        "greatest": {"time_s": 41e-9, "crater_depth_m": 5.5e-6},
        "end": {"time_s": 60e-9, "crater_depth_m": 5.02e-6, "flattening_ratio": 0.5561, "von_mises_max_Pa": 778e6},
    }
    whole = {
        "wall_s": 28.4,
        "effects": ["friction", "[bold]mine"],
        "warnings": ["strain rates beyond the fit"],
    }
    with Store.create(tmp_path, "") as store:
        store.finish(summary_of(impact, **whole))
    rows = {row[0]: row[1:] for row in printed(Result(tmp_path)) if len(row) > 1}
    assert rows["crater depth"] == ["5.5", "5.02", "µm"]
    assert rows["time"] == ["41", "60", "ns"]
    assert rows["flattening above the surface"] == ["", "0.5561", ""]
    assert rows["highest von Mises stress"] == ["", "778", "MPa"]
    assert rows["energy drift"] == ["", "0.31", "%"]
    assert rows["rebound velocity"] == ["", "-", "m/s"]
    assert rows["points"] == ["", "4 012", ""]
    assert rows["mean time step"] == ["", "5.2", "ps"]
    assert rows["wall time"] == ["", "28.4", "s"]
    assert rows["unheard of"] == ["", "1", "K"]
    # Text is text, not markup, and in a notebook it is returned as elsewhere, not displayed.
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    text = screen(Result(tmp_path), verbose=True)
    assert text.endswith("\neffects: friction, [bold]mine\nwarning: strain rates beyond the fit")


def test_summary_table_of_several_impacts(tmp_path):
    nickel = {"material": "Ni", "diameter_m": 30e-6, "wall_s": 30.0, "surface_level_m": 0.0}
    titanium = {
        "material": "Ti",
        "diameter_m": 25e-6,
        "wall_s": 20.0,
        "surface_level_m": 9.1e-6,
        "idle_share": [0.25, 0.031],
    }
    impacts = [nickel | {"end": {"flattening_ratio": 0.62}}, titanium | {"end": {"flattening_ratio": 0.31}}]
    scene = "".join(
        f'[[particle]]\nmaterial = "{what}"\ndiameter = "{size} um"\nvelocity = "{speed} m/s"\n'
        for what, size, speed in (("Ni", 30, 500), ("Ti", 25, 450))
    )
    scene += '[substrate]\nmaterial = "SS304"\n'
    with Store.create(tmp_path, scene, plan_json=plan_of(scene)) as store:
        store.finish(summary_of(*impacts, wall_s=55.5, memory_peak_bytes=412_345_678, ranks=2))
    result = Result(tmp_path)
    assert summary_table(result).title.plain == "30 µm Ni, 25 µm Ti on SS304 at 500, 450 m/s"
    heads = [str(column.header) for column in summary_table(result).columns]
    assert heads == ["", "impact\xa01\n30\xa0µm\xa0Ni", "impact\xa02\n25\xa0µm\xa0Ti", ""]
    rows = {row[0]: row[1:] for row in printed(result) if len(row) > 1 and row[0] != "wall time"}
    assert rows["flattening above the surface"] == ["0.62", "0.31", ""]
    assert rows["height of the surface at the first contact"] == ["0", "9.1", "µm"]
    assert rows["waiting time of each process"] == ["", "25, 3.1", "%"]
    assert rows["most memory"] == ["", "412.3", "MB"]
    assert "joins" not in rows
    assert [row[1:] for row in printed(result) if row[:1] == ["wall time"]] == [["30", "20", "s"], ["", "55.5", "s"]]


def test_errors_stand_beside_their_values(tmp_path):
    impact = {
        "end": {"flattening_ratio": 0.55613, "crater_depth_m": 5.02e-6, "T_max_K": 612.3},
        "steps": 10,
        "errors": {
            "flattening_ratio": {"half_width": 0.0118},
            "crater_depth_m": {"half_width": 1.3e-7, "order": 1.0, "coarser": [5.1e-6, 5.2e-6]},
            "T_max_K": {"half_width": 0.0},
        },
    }
    with Store.create(tmp_path, "") as store:
        store.finish(summary_of(impact))
    rows = {row[0]: row[1:] for row in printed(Result(tmp_path)) if len(row) > 1}
    assert rows["flattening above the surface"] == ["0.556 ± 0.012", ""]
    assert rows["crater depth"] == ["5.02 ± 0.13", "µm"]
    assert rows["highest temperature"] == ["612.3", "K"]
    assert not {"errors", "impacts"} & set(rows)


def test_what_has_no_value_has_a_reason_and_the_doubtful_leads(tmp_path):
    """A refused strain, an embedded particle, an undecided second impact, and a dissipation of 31 %."""
    first = {
        "end": {"eps_p_max": None, "flattening_ratio": 1.2, "T_max_K": 900.0},
        "refused": {"end.eps_p_max": "85 is above 20"},
        "numerical_dissipation": 0.31,
    }
    second = {
        "end": {"time_s": 9e-9, "eps_p_max": None, "flattening_ratio": None},
        "refused": dict.fromkeys(["restitution", "end.eps_p_max", "end.flattening_ratio"], "not at rest"),
        "restitution": None,
    }
    doubt = "numerical viscosity and hourglass control took 31%"
    with Store.create(tmp_path, "") as store:
        store.finish(
            summary_of(first, second, undecided="not at rest", warnings=["splat 3 has come off", doubt, "rates"])
        )
    result = Result(tmp_path)
    rows = {row[0]: row[1:] for row in printed(result) if len(row) > 1}
    assert rows["greatest plastic strain"] == ["-", "-", ""]
    assert remarks(result.summary)[:3] == [
        "impact 1: greatest plastic strain at the end is undefined: 85 is above 20",
        "impact 1: at the end, flattening above the surface is 1.2: the top lies below the surface: the particle is embedded",
        "impact 2: all measures at the end, rebound velocity / impact velocity are undefined: not at rest",
    ]
    assert alerts(result.summary) == [doubt]
    page = report(result)
    head = page[page.index('<section id="front">') : page.index("</section>")]
    assert head.index("undecided</b>: not at rest") < head.index(f"doubtful</b>: {doubt}") < head.index("<li>rates")
    assert "85 is above 20" in page


def test_impacts_of_one_remark_share_it(tmp_path) -> None:
    """Impacts 1, 2, 4, 5, 6 of a run that is undecided: their splats do not rest."""
    waits, done = {"end": {}, "refused": {"at_end": "not at rest"}}, {"end": {}, "refused": {}}
    assert remarks(summary_of(waits, waits, done, waits, waits, waits)) == [
        "impacts 1, 2, 4 to 6: all measures at the end of the run are undefined: not at rest"
    ]


# How people without one kind of cone see linear RGB: Machado, Oliveira & Fernandes (2009), severity 1.
SEEN_BY = {
    "all cones": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def lightness_of(name, eyes):
    """CIE lightness of 33 colours of a field, as seen by these eyes."""
    from matplotlib import colormaps

    rgb = colormaps[FIELDS[name].colours](np.linspace(0, 1, 33))[:, :3]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.array(SEEN_BY[eyes]).T, 0, 1)
    luminance = seen @ [0.2126, 0.7152, 0.0722]
    return np.where(luminance > 0.008856, 116 * np.cbrt(luminance) - 16, 903.3 * luminance)


WITH_SIGN = ("in_plane",)


@pytest.mark.parametrize("eyes", SEEN_BY)
@pytest.mark.parametrize("name", [name for name in FIELDS if name not in WITH_SIGN])
def test_everybody_sees_more_as_darker(name, eyes):
    lightness = lightness_of(name, eyes)
    assert lightness[0] - lightness[-1] > 60
    assert (np.diff(lightness) < 0).all()


@pytest.mark.parametrize("eyes", SEEN_BY)
@pytest.mark.parametrize("name", WITH_SIGN)
def test_of_a_stress_with_sign_zero_is_the_lightest(name, eyes):
    lightness = lightness_of(name, eyes)
    middle = len(lightness) // 2
    assert abs(int(np.argmax(lightness)) - middle) <= 1
    assert lightness[middle] - max(lightness[0], lightness[-1]) > 40


def test_values_between_nodes_and_points():
    points, tets = block(2.0, 3.0, 0.5)
    places = np.random.default_rng(1).uniform([-1.9, -1.7, -2.9], [1.9, 1.9, -0.1], (50, 3))
    owner, share = in_tets(points, tets, np.vstack([places, [[9.0, 0.0, 0.0]]]))
    assert owner[-1] == -1
    np.testing.assert_allclose(share.sum(1)[:-1], 1.0)
    np.testing.assert_allclose(np.einsum("kj,kjx->kx", share[:-1], points[tets[owner[:-1]]]), places, atol=1e-12)
    # in a void there is no value
    assert np.isnan(from_points(points, np.array([[0.0, 0.0, 9.0]]), 1.0)[1]).all()
    # of a cloud: a constant stays, and no value leaves the range of the points'
    cloud = np.random.default_rng(2).uniform(-1, 1, (3000, 3))
    index, weight = from_points(cloud, 0.5 * cloud[:40] + 0.01)
    np.testing.assert_allclose(weight.sum(1), 1.0)
    smooth = (weight * cloud[index][..., 0]).sum(1)
    np.testing.assert_allclose(smooth, 0.5 * cloud[:40, 0] + 0.01, atol=0.08)


def test_a_line_through_a_hollow_ball_goes_in_and_out_twice():
    outer, triangles = ball(4000)
    points = np.concatenate([outer, 0.6 * outer])
    both = np.concatenate([triangles, triangles[:, ::-1] + len(outer)])
    heights = on_vertical(points, both, 0.3, 0.2)
    expected = [np.sqrt(r**2 - 0.13) for r in (1.0, 0.6)]
    np.testing.assert_allclose(heights, [-expected[0], -expected[1], expected[1], expected[0]], atol=5e-3)
    assert on_vertical(points, both, 1.2, 0.0) == []
    # the corners of a symmetric surface do not count twice
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = [[a, b, c] for a in (0, 1) for b in (2, 3) for c in (4, 5)]
    np.testing.assert_allclose(on_vertical(corners, np.array(faces), 0.0, 0.0), [-1, 1], atol=1e-5)


def test_profiles_follow_the_axis(folder):
    result = Result(folder)
    upper, lower = profiles(result, -1, ("T", "stress", "nothing"), stage(result), 20e-6)
    assert upper.depth[-1] == pytest.approx(lower.depth[0], abs=0.6e-6)  # they touch
    assert lower.depth[-1] == pytest.approx(20e-6, rel=1e-6)
    assert lower.depth[0] == pytest.approx(5e-6, abs=0.4e-6)  # the crater of the made-up run
    assert "nothing" not in upper.values
    assert upper.values["stress"].shape == (len(upper.depth), 6)
    # its substrate: T = 300 + 91 exp(-(...)^2), known on the axis in the undeformed place
    reference = np.linspace(-20, 0, 2001)
    place = reference - 5 * np.exp(reference / 15)
    known = np.interp(-lower.depth * 1e6, place, 300 + 91 * np.exp(-(((reference + 2) / 9) ** 2)))
    np.testing.assert_allclose(lower.values["T"], known, atol=6)


def test_a_step_that_broke_down_is_named(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "run")
    with h5py.File(copy / "particle.vtkhdf", "a") as file:
        file["VTKHDF/PointData/T"][-1] = np.nan
    with pytest.raises(StoreError, match="step 1 has values that are not finite numbers"):
        section_picture(Result(copy))
    section_picture(Result(copy), tmp_path / "first.png", step=0)


def test_a_hollow_particle_is_not_painted_inside(folder, tmp_path):
    """Its stored surface is the outer one; that it is hollow shows in its points."""
    copy = shutil.copytree(folder, tmp_path / "hollow")
    (copy / "particle.vtkhdf").unlink()
    shell = np.random.default_rng(5).normal(size=(6000, 3))
    shell *= np.random.default_rng(6).uniform(0.6, 0.98, (6000, 1)) / np.linalg.norm(shell, axis=1)[:, None]
    store = Store(copy)
    data = {"T": np.full(6000, 400.0), "eps_p": np.zeros(6000)}
    store.write("particle", 0.0, flattened(shell, 0.0), np.arange(6000)[:, None], data)
    store.close()
    result = Result(copy)
    at = stage(result)
    image = cross_section(result, 0, ("T",), at, view(result, [0], at), 200).images["T"]
    rows, columns = np.indices(image.shape)
    r = np.hypot(rows / image.shape[0] - 0.5, columns / image.shape[1] - 0.5) * 2
    assert np.isnan(image[r < 0.4]).all()
    np.testing.assert_allclose(image[(r > 0.65) & (r < 0.95)], 400)
    section_picture(result, tmp_path / "hollow.png", step=0)
    values = profiles(result, 0, ("T",), at, 20e-6)[0].values["T"]
    assert np.isnan(values).any()
    assert np.isfinite(values[[0, -1]]).all()


def test_the_first_screen_has_verdict_measures_and_each_warning_once(tmp_path):
    warnings = ["numerical viscosity and hourglass control took 31%", *(f"warning {k}" for k in range(3))]
    end = {"flattening_ratio": 0.5, "T_mean_K": 400.0, "von_mises_max_Pa": 1e9}
    record = {"verdict": "sticks", "diameter_m": 25e-6, "material": "Ni", "numerical_dissipation": 0.31, "end": end}
    record |= {"margin_m_s": 12.0}
    for number, head in (
        (1, "verdict: sticks; margin +12 m/s\n"),
        (40, "verdict: of 40 particles 40 stick\n  smallest margin: particle 1 sticks"),
    ):
        with Store.create(tmp_path / str(number), "") as store:
            store.finish(summary_of(*[record] * number, warnings=warnings))
        text = screen(Result(tmp_path / str(number)))
        assert text.startswith(head)
        assert "\ndoubtful: numerical viscosity" in text
        assert text.count("\n") < 29
        assert all(text.count(warning) == 1 for warning in warnings)
        assert "flattening" in text
        assert "von Mises" not in text
        whole = screen(Result(tmp_path / str(number)), verbose=True)
        assert ("highest von Mises stress" if number == 1 else "\n40  25 µm Ni") in whole.replace("\n ", "\n")
    assert "... and 30 more" in text


@pytest.mark.parametrize("count", [1, 2])
def test_a_particle_that_sticks_has_no_rebound_velocity(tmp_path, count):
    """In tables for people; one that rebounds has."""
    record = {"diameter_m": 25e-6, "material": "Ni", "rebound_velocity_m_s": 31.25, "end": {}}
    for verdict, rebounded in (("sticks", False), ("rebounds", True)):
        with Store.create(tmp_path, "", force=True) as store:
            store.finish(summary_of(*[record | {"verdict": verdict, "rebounded": rebounded}] * count))
        assert ("31.25" in screen(Result(tmp_path))) == rebounded


def test_a_long_title_is_not_broken_at_the_width_of_the_table(tmp_path):
    with Store.create(tmp_path, "") as store:
        store.finish(summary_of({"verdict": "sticks", "diameter_m": 25e-6, "material": "N" * 90, "end": {}}))
    result = Result(tmp_path)
    assert title(result) in screen(result).splitlines()


def test_a_change_below_its_digits_has_no_minus():
    assert [_change(1000.0, after) for after in (999.9, 999.0, 1001.0)] == ["+0.0%", "-0.1%", "+0.1%"]
    assert _change(True, 1.0) == _change(0.0, 1.0) == ""


def test_a_change_less_than_both_errors_is_said_to_be_within() -> None:
    """.50 +- .03 and .55 +- .03 overlap, .50 +- .02 and .55 +- .02 do not."""
    assert _change(0.50, 0.55, 0.03, 0.03) == "+10.0%, within the errors"
    assert _change(0.50, 0.55, 0.02, 0.02) == _change(0.50, 0.55, 0.2, None) == "+10.0%"


def test_a_picture_keeps_its_size_while_the_particle_flies_away(folder) -> None:
    """30 and 300 um above the surface, also aside: the same view, in which the crater stays as large."""
    result = Result(folder)
    at, fields = stage(result), result.fields

    def seen_from(height: float, aside: float) -> tuple[float, float, float, float]:
        class Away:
            def fields(self, step, domain):
                seen = fields(step, domain)
                return dataclasses.replace(
                    seen, points=seen.points + np.array([aside, 0, height]) * (domain == "surface")
                )

        return view(Away(), [-1], at)

    near = seen_from(30e-6, 0.0)
    assert near == seen_from(300e-6, 200e-6)
    assert near[3] - near[2] < 3.0 * at.diameter
