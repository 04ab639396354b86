"""A coating: particles from a seed, and what is measured of made-up bodies whose thickness, roughness and voids are known."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from runs import SharedRuns
from scenes import COATING, COLD, scene_with

from coupler import Scene, run
from coupler.commands.coating import describe
from coupler.commands.main import main
from coupler.errors import SceneError, StoreError
from coupler.files.fields import Fields
from coupler.geometry import mesher
from coupler.geometry.tetrahedra import volumes
from coupler.report.picture import _best_plane
from coupler.studies import coating, coating_seeds
from coupler.studies.coating import (
    growth,
    in_plane,
    lines,
    materials,
    measure,
    over_depth,
    per_layer,
    phases,
    read,
)
from coupler.studies.coating_files import _seen, micrograph
from coupler.studies.splats import Columns, Splats, roughness


def test_particles_come_from_the_seed_and_keep_to_the_table() -> None:
    scene = Scene.from_text(COATING, "coating")
    again = Scene.from_text(COATING, "coating")
    assert scene.particles == again.particles
    assert scene.particles != Scene.from_text(COATING.replace("seed = 3", "seed = 4"), "coating").particles
    assert len(scene.particles) == 40
    D = np.array([p.diameter for p in scene.particles])
    assert 18e-6 <= D.min() < D.max() <= 27e-6
    assert np.median(D) == pytest.approx(22e-6, rel=0.06)
    for p in scene.particles:
        table = np.interp(p.diameter, [18e-6, 25e-6], [610.0, 500.0])
        assert abs(p.velocity - table) <= 40.1  # cut at two deviations
        assert np.hypot(*p.offset) <= 36.01e-6
        assert p.temperature == 400.0
        assert (p.tilt == 0.0) == (p.shape == "sphere")
    assert 10 <= sum(p.shape == "oblate" for p in scene.particles) <= 30
    first = scene.particles[0]
    # what is written out is the same scene: a run can be resumed from it
    assert Scene.from_text(scene.to_toml(), "coating") == scene
    assert first.diameter == pytest.approx(18.44e-6, rel=0.5)


def test_even_places_keep_apart() -> None:
    def nearest(text: str) -> float:
        sites = np.array([p.offset for p in Scene.from_text(text, "c").particles])[:10]
        apart = np.linalg.norm(sites[:, None] - sites, axis=2) + np.eye(10)
        return float(apart.min())

    even = COATING.replace('diameter = "22 um"', 'diameter = "22 um"\npositions = "even"')
    assert nearest(even) > 2.0 * nearest(COATING)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("layers = 4", "layers = 3", "number = 40 to be a multiple of layers = 3"),
        ('smallest = "18 um"', 'smallest = "24 um"', "smallest <= diameter <= largest"),
        ("number = 40", "number = 0", "coating.number"),
        ("{ sphere = 0.5, oblate = 0.5 }", "{ cube = 1.0 }", "coating.shapes"),
        ('[["18 um", "610 m/s"], ["25 um", "500 m/s"]]', '[["18 um"]]', "pairs of a diameter and a value"),
        ('velocity = [["18 um", "610 m/s"], ["25 um", "500 m/s"]]', "", "coating.velocity: missing"),
        ('radius = "36 um"', 'radius = "300 um"', "offset"),
        (
            "[substrate]",
            '[particle]\nmaterial = "Ni"\ndiameter = "20 um"\nvelocity = "500 m/s"\n[substrate]',
            "the scene has both .coating. and particles",
        ),
    ],
)
def test_what_is_wrong_is_said_by_field(old: str, new: str, says: str) -> None:
    with pytest.raises(SceneError, match=says):
        Scene.from_text(COATING.replace(old, new), "coating")


def test_a_coating_of_one_particle_is_written_out_and_read_again() -> None:
    text = COATING.replace("number = 40", "number = 1").replace("layers = 4", "layers = 1")
    one = Scene.from_text(text, "one")
    assert Scene.from_text(one.to_toml(), "one").particles == one.particles


def test_gas_gives_velocity_and_temperature_by_size() -> None:
    text = COATING.replace('velocity = [["18 um", "610 m/s"], ["25 um", "500 m/s"]]\n', "").replace(
        'temperature = "400 K"\n', ""
    )
    text = (
        text.replace("number = 40", "number = 4")
        + '[gas]\npressure = "23 bar"\ntemperature = "530 degC"\nnozzle = "D42PBI"\n'
    )
    with pytest.raises(SceneError, match=r"coating\.velocity_spread: has no effect on velocities from \[gas\]"):
        Scene.from_text(text, "coating")
    text = text.replace('velocity_spread = "20 m/s"\n', "")
    particles = Scene.from_text(text, "coating").particles
    by_size = sorted(particles, key=lambda p: p.diameter)
    assert by_size[0].velocity > by_size[-1].velocity
    assert all(500.0 < p.temperature < 803.0 for p in particles)


def slab(
    low: tuple[float, float, float], high: tuple[float, float, float], size: float
) -> tuple[np.ndarray, np.ndarray]:
    points, tets = mesher.box(tuple(b - a for a, b in zip(low, high, strict=True)), size)
    edge = points[tets[:, 1:]] - points[tets[:, :1]]
    turned = np.linalg.det(edge) < 0
    tets[turned, 2:] = tets[turned, 2:][:, ::-1]
    return points + np.array(low), tets


@pytest.fixture(scope="module")
def built() -> Splats:
    """A substrate, a splat of 6 um all over it, one of 4 um more on the half x > 0, and a bridge 3 um above the rest of it."""
    u = 1e-6
    parts = [
        slab((-30 * u, -30 * u, -20 * u), (30 * u, 30 * u, 0.0), 6 * u),
        slab((-30 * u, -30 * u, 0.0), (30 * u, 30 * u, 6 * u), 6 * u),
        slab((0.0, -30 * u, 6 * u), (30 * u, 30 * u, 10 * u), 6 * u),
        slab((-30 * u, -30 * u, 9 * u), (0.0, 30 * u, 10 * u), 6 * u),
    ]
    points, cells, body = [], [], []
    for b, (x, t) in enumerate(parts):
        cells.append(t + sum(map(len, points)))
        points.append(x)
        body.append(np.full(len(t), b))
    of = np.concatenate(body)
    m = len(of)
    stress = np.zeros((m, 6))
    stress[:, 0] = np.where(of == 1, -1e8, 2e8)
    data = {"body": of, "eps_p": 0.5 * of, "T": 300.0 + 100.0 * of, "von_mises": 1e8 * of, "stress": stress}
    mesh = Fields(
        0.0, np.concatenate(points), np.concatenate(cells), {k: v.astype(np.float32) for k, v in data.items()}
    )
    return Splats(
        mesh, of, np.array([0, 1, 3, 4]), None, np.array([1.0, 0.0, 1.0, 1.0]), np.array([1.0, 1, 1, 1]),
        ({"Ni": 1.0}, {"Ni": 1.0}, {"Cu": 1.0}, {"Ni": 1.0}), 4, 2, 20e-6, 2e-6,
    )  # fmt: skip


def test_columns_know_thickness_and_voids(built: Splats) -> None:
    c = Columns(built, (0.0, 0.0), 12e-6, 0.5e-6)
    np.testing.assert_allclose(c.highest(c.substrate), 0.0, atol=0.26e-6)
    np.testing.assert_allclose(c.highest(c.matter), 10e-6, atol=0.26e-6)
    opened, closed = c.voids(1e-6)
    # the space under the bridge: half of the window, 3 of 10 um; nothing leads out of it within the window
    assert opened.sum() == 0
    assert closed.sum() / (12 * 2 * len(c.x)) == pytest.approx(0.0, abs=1.0)
    share = closed.sum() * 0.5e-6 / (len(c.x) * 10e-6)
    assert share == pytest.approx(0.15, abs=0.015)
    # voids that are lower than the limit are not told from matter
    assert sum(part.sum() for part in c.voids(3.5e-6)) == 0


def test_a_body_beside_the_window_is_not_in_it(built: Splats) -> None:
    """Between the bridge, which ends at x = 0, and the rim of all others."""
    c = Columns(built, (12e-6, 0.0), 5e-6, 0.5e-6)
    np.testing.assert_allclose(c.highest(c.matter), 10e-6, atol=0.26e-6)
    assert sum(part.sum() for part in c.voids(0.0)) == 0
    at_the_end = Columns(built, (0.0, 0.0), 5e-6, 0.5e-6)
    assert at_the_end.voids(0.0)[1].any(axis=1)[at_the_end.x < 0.0].all()
    assert not at_the_end.voids(0.0)[1][at_the_end.x > 0.0].any()


def test_shares_of_a_blend_add_up(built: Splats) -> None:
    """One particle of copper in four of the same mass, all of which but one of nickel stay: shares of mass and volume."""
    nickel, copper = phases(built, 1.0)
    assert (nickel["metal"], copper["metal"]) == ("Ni", "Cu")
    assert (nickel["fed_share"], copper["fed_share"]) == pytest.approx((0.75, 0.25))
    assert (nickel["deposited_share"], copper["deposited_share"]) == pytest.approx((2 / 3, 1 / 3))
    assert (nickel["efficiency"], copper["efficiency"]) == pytest.approx((2 / 3, 1.0))
    volume = np.abs(volumes(built.mesh.points, built.mesh.cells))
    in_copper = volume[built.body == 2].sum() / volume[built.body > 0].sum()
    assert (nickel["volume_share"], copper["volume_share"]) == pytest.approx((1.0 - in_copper, in_copper))
    assert "efficiency 100.0%" in dict(lines(measure(built)))["metals"]
    assert "metals" not in dict(lines(measure(replace(built, parts=4 * ({"Ni": 1.0},)))))
    assert "materials" not in dict(lines(measure(built)))


def test_shell_and_core_count_as_two_materials(built: Splats) -> None:
    """Three of four particles have stayed, one of them with a core of two fifths of its mass, which is the third splat."""
    coated = replace(
        built, parts=({"Ni": 1.0}, {"Ni": 1.0}, {"Ni": 0.6, "Al2O3": 0.4}, {"Ni": 1.0}), cores={2: "Al2O3"}
    )
    assert [row["metal"] for row in phases(coated, 1.0)] == ["Ni", "Ni on Al2O3"]
    nickel, alumina = materials(coated, 1.0)
    assert (nickel["material"], alumina["material"]) == ("Ni", "Al2O3")
    assert (nickel["deposited_share"], alumina["deposited_share"]) == pytest.approx((2.6 / 3, 0.4 / 3))
    assert alumina["volume_share"] == pytest.approx(phases(coated, 1.0)[1]["volume_share"])
    assert "Al2O3 13" not in dict(lines(measure(coated)))["metals"]
    assert "13.3% of the mass deposited" in dict(lines(measure(coated)))["materials"]


def test_an_opening_makes_voids_open(built: Splats) -> None:
    below = built.mesh.points[built.mesh.cells].mean(axis=1)
    holed = ~((built.body == 3) & (np.hypot(below[:, 0] + 6e-6, below[:, 1]) < 4e-6))
    mesh = Fields(0.0, built.mesh.points, built.mesh.cells[holed], {k: v[holed] for k, v in built.mesh.data.items()})
    one = Splats(mesh, built.body[holed], built.impact, None, built.stayed, built.mass, built.parts, 4, 2, 20e-6, 2e-6)
    opened, closed = Columns(one, (0.0, 0.0), 12e-6, 0.5e-6).voids(1e-6)
    assert closed.sum() == 0
    assert opened.sum() > 0


def test_overlap_says_how_far_porosity_is_off(built: Splats) -> None:
    """The splat on the half x > 0 sunk by 1 um into the one below: a tenth of what both fill there is filled twice."""
    x = built.mesh.points.copy()
    sunk = np.unique(built.mesh.cells[built.body == 2])
    x[sunk, 2] -= 1e-6
    c = Columns(replace(built, mesh=replace(built.mesh, points=x)), (6e-6, 0.0), 5e-6, 0.25e-6)
    assert c.double.sum() * 0.25e-6 / len(c.x) == pytest.approx(1e-6, rel=0.02)
    assert Columns(built, (6e-6, 0.0), 5e-6, 0.25e-6).double.sum() == 0
    body = (built.body == 3).astype(
        np.int64
    )  # the first three are a substrate that lies in itself, as a crater that folds
    alone = replace(built, mesh=replace(built.mesh, points=x), body=body, impact=np.array([0, 4]))
    assert Columns(alone, (6e-6, 0.0), 5e-6, 0.25e-6).double.sum() == 0


def test_roughness_of_a_wave() -> None:
    sa, sq = roughness(3e-6 + 2e-6 * np.sin(2 * np.pi * np.arange(2000) / 200))
    assert sa == pytest.approx(2e-6 * 2 / np.pi, rel=1e-3)  # of a sine: 2 / pi of its height
    assert sq == pytest.approx(2e-6 / np.sqrt(2), rel=1e-3)


def test_layers_depth_and_efficiency(built: Splats) -> None:
    rows = per_layer(built, 2)
    of_one = replace(built, impact=np.array([0, 1, 3, 3]))  # shell and core of one splat
    assert per_layer(of_one, 2)[1]["splats"] == 1
    assert [row["layer"] for row in rows] == [1, 2]
    assert rows[0]["T_mean"] == pytest.approx(400.0)
    assert rows[1]["splats"] == 2
    assert rows[1]["eps_p_max"] == pytest.approx(1.5)
    by_depth = over_depth(built, 12e-6, 2e-6)
    inside = [row for row in by_depth if 1e-6 < row["z_m"] < 5e-6]
    assert inside
    assert all(row["sigma_xx"] == pytest.approx(-1e8) and row["coating"] == 1.0 for row in inside)
    assert by_depth[-1]["sigma_xx"] == pytest.approx(2e8)
    assert all(
        row["sigma_p5"] - 1.0 <= 0.5 * (row["sigma_xx"] + row["sigma_yy"]) <= row["sigma_p95"] + 1.0 for row in by_depth
    )
    assert built.deposition_efficiency == pytest.approx(0.75)


@pytest.mark.parametrize(("finished", "rows"), [(1, 1), (60, 60), (500, 60)])
def test_growth_over_many_impacts_has_sixty_rows(monkeypatch: pytest.MonkeyPatch, finished: int, rows: int) -> None:
    read = lambda _, number=finished + 1: SimpleNamespace(mass=np.zeros(number - 1))  # noqa: E731
    monkeypatch.setattr(coating, "read", read)
    monkeypatch.setattr(coating, "growth_row", lambda built, _: {"impacts": len(built.mass)})
    numbers = [each["impacts"] for each in growth(None, 1.0)]  # type: ignore[arg-type]
    assert len(numbers) == len(set(numbers)) == rows
    assert (numbers[0], numbers[-1]) == (1, finished)


def test_growth_has_a_row_for_each_impact(
    shared_run: SharedRuns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of two impacts one on the other: the second adds thickness, the last row is that of the cold coating; watch shows the first."""
    result = shared_run(COLD)
    one, two = growth(result)
    assert (one["impacts"], one["splats"], two["impacts"], two["splats"]) == (1, 1, 2, 2)
    assert one["thickness_mean_m"] < two["thickness_mean_m"] < 40e-6
    cold = measure(read(result))
    assert two["thickness_mean_m"] == pytest.approx(cold.thickness_mean_m, rel=0.02)
    assert main(["coating", str(result.directory), "--out", str(tmp_path / "out")]) == 0
    rows = (tmp_path / "out" / "coating_growth.csv").read_text().splitlines()
    assert len(rows) == 3
    assert (tmp_path / "out" / "growth.png").stat().st_size > 10_000
    copy = shutil.copytree(result.directory, tmp_path / "run")
    (copy / "summary.json").unlink()
    capsys.readouterr()
    assert main(["watch", str(copy), "--once"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"coating after impact 1: splats 1, thickness {one['thickness_mean_m'] * 1e6:.1f} um" in shown


def test_a_film_of_a_coating_cuts_most_of_its_particles() -> None:
    places = [8.0, -1.0, -12.0, 0.5, 2.0]
    plan = {"impacts": [{"offset": [0.0, y * 1e-6], "diameter": 10e-6} for y in places]}
    assert _best_plane(plan, 8e-6) == -1e-6  # the first of those that cut three
    assert _best_plane({"impacts": plan["impacts"][:1]}, 7e-6) == 7e-6
    assert _best_plane({}, 7e-6) == 7e-6


def test_impacts_without_a_verdict_are_told(built: Splats) -> None:
    """Of four of one mass one has left: three quarters have stayed, at least one quarter where two of them are undecided."""
    doubtful = measure(replace(built, undecided=(0, 3)))
    assert (doubtful.least_efficiency, doubtful.deposition_efficiency) == pytest.approx((0.25, 0.75))
    line = next(text for text in describe(doubtful) if text.startswith("deposition efficiency"))
    assert line.endswith("25.0% to 75.0% of the mass: 3 of 4 particles stay, 2 of these are undecided")
    assert not any("undecided" in text for text in describe(measure(built)))


def test_what_cooling_adds_is_told_of_cold_coatings_alone(built: Splats) -> None:
    for is_cold in (False, True):
        said = "\n".join(describe(measure(replace(built, is_cold=is_cold))))
        assert ("from cooling" in said) == is_cold
        assert ("have not cooled" in said) != is_cold


def test_thickness_counts_from_the_old_surface(built: Splats) -> None:
    """All bodies 4 um deeper, as in a crater: a coating that is 10 um thick rises 6 um above the old surface."""
    deeper = replace(built, mesh=replace(built.mesh, points=built.mesh.points - [0.0, 0.0, 4e-6]))
    assert measure(built).thickness_mean_m == pytest.approx(10e-6, abs=0.26e-6)
    assert measure(deeper).thickness_mean_m == pytest.approx(6e-6, abs=0.26e-6)
    assert measure(deeper).bare_share == 0.0


def test_the_error_of_the_stress_is_that_of_a_mean_over_places(built: Splats) -> None:
    """Of n equal sectors the jackknife is the standard error of their mean, s / sqrt(n) (Efron & Tibshirani 1993, 11.2); stresses that
    differ from layer to layer alone have none."""
    x = built.mesh.points[built.mesh.cells].mean(axis=1)[:, 0]
    for own, error in (
        (np.where(x > 0.0, 40e6, -40e6), 40e6 * np.sqrt(8 / 7) / np.sqrt(8)),
        (np.full(len(x), 10e6), 0.0),
    ):
        stress = np.zeros((len(x), 6))
        stress[:, :2] = own[:, None]
        body = np.minimum(built.body, 1)  # a plate all over the window
        one = replace(built, mesh=replace(built.mesh, data={"stress": stress}), body=body)
        assert in_plane(one, 25e-6, "stress")[1] == pytest.approx(error, rel=0.2, abs=1.0)


def test_the_error_of_a_coating_is_that_of_the_mean_of_its_seeds(built: Splats) -> None:
    """Of 10, 12 and 14 um the mean is 12 um and its standard error 2 um over the root of three."""
    own = measure(built)
    several = [replace(own, thickness_mean_m=h) for h in (10e-6, 12e-6, 14e-6)]
    found = coating_seeds.errors(several)
    thick = found["thickness_mean_m"]
    assert (thick.mean, thick.error, thick.least, thick.greatest) == pytest.approx((12e-6, 2e-6 / 3**0.5, 10e-6, 14e-6))
    assert found["porosity_closed"].error == 0.0
    said = dict(lines(replace(own, seeds=found)))
    assert said["thickness above the original surface"].endswith("; 3 seeds: 12.0 ± 1.2 µm, 10 to 14")
    assert all("3 seeds" in said[label] for label in ("roughness", "porosity", "deposition efficiency"))
    assert "--seeds" in dict(lines(own))["error"]
    whole = replace(found["porosity_closed"], mean=1.0, error=1e-16, least=1.0, greatest=1.0)  # rounding is no error
    assert whole.words(100.0, " %") == "; 3 seeds: 100 %, 100 to 100"
    assert coating_seeds.errors([own]) == {}


def test_other_seeds_draw_other_particles_from_the_same_table() -> None:
    scene = Scene.from_text(COATING, "coating")
    others = coating_seeds.other_seeds(scene, 2)
    assert list(others) == ["seed 4", "seed 5"]
    other = Scene.from_text(others["seed 4"], "coating")
    assert other.particles == Scene.from_text(COATING.replace("seed = 3", "seed = 4"), "coating").particles
    with pytest.raises(StoreError, match="no table \\[coating\\]"):
        coating_seeds.other_seeds(scene_with(), 1)


@pytest.mark.slow
def test_the_command_computes_other_seeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of two particles on a disc of 4 um, until 3 ns after each contact."""
    text = COATING.replace("number = 40\nlayers = 4", "number = 2\nlayers = 1").replace('"36 um"', '"4 um"')
    text += 'diameter = "120 um"\nheight = "50 um"\n[resolution]\nspacing = "2.4 um"\n[end]\ntime = "30 ns"\n'
    run(Scene.from_text(text, "two"), tmp_path / "run", quiet=True, threads=1)
    assert main(["coating", str(tmp_path / "run"), "--seeds", "1"]) == 0
    said = capsys.readouterr().out
    assert "2 seeds: " in said
    kept = json.loads((tmp_path / "run" / "coating" / "coating.json").read_text())["seeds"]["thickness_mean_m"]
    assert kept["least"] < kept["mean"] < kept["greatest"]
    scene = tmp_path / "run" / "seeds" / "seed_4" / "scene.toml"
    scene.write_text(scene.read_text().replace('radius = "4 um"', 'radius = "5 um"'))  # of another coating
    assert main(["coating", str(tmp_path / "run")]) == 0
    assert "seeds: " not in capsys.readouterr().out


@pytest.mark.parametrize(("left", "says"), [(0, "all 4 particles stay"), (1, "3 of 4 particles stay")])
def test_words_count_the_particles_that_stay(built: Splats, left: int, says: str) -> None:
    stayed = np.array([1.0] * (4 - left) + [0.0] * left)
    assert dict(lines(measure(replace(built, stayed=stayed))))["deposition efficiency"].endswith(says)


def test_the_micrograph_shows_the_deepest_splat_and_tells_pores_from_the_outside(built: Splats, tmp_path: Path) -> None:
    """Splats sunk by 30 um, more than a third of what is seen: the picture reaches below them; the pore under the bridge is black."""
    from matplotlib.image import imread

    sunk = replace(built, mesh=replace(built.mesh, points=built.mesh.points - [0.0, 0.0, 30e-6]))
    assert _seen(sunk, 25e-6)[2] < -33.0
    left, right, bottom, top = _seen(built, 25e-6)
    picture = imread(micrograph(built, tmp_path / "m.png", 25e-6))[..., :3]
    rows, columns = picture.shape[:2]
    pore, outside = (
        picture[int((top - z) / (top - bottom) * rows), int((x - left) / (right - left) * columns)]
        for x, z in ((-12.0, 7.5), (12.0, 11.0))
    )
    assert pore.tolist() == [0.0, 0.0, 0.0]
    assert outside[2] > outside[0] + 0.1  # blue
