"""The picture and the table, from a made-up splat in a made-up crater."""

import io
import shutil

import numpy as np
import pytest

from coupler.errors import StoreError
from coupler.report import section_picture, summary_table
from coupler.result import Result
from coupler.section import crossing, cut_tets, section_loops
from coupler.store import Store

UM = 1e-6


def block(half: float, depth: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """A box below z = 0 in tetrahedra, six for each cube, finer towards the middle."""
    n, m = round(2 * half / step), round(depth / step)
    side = np.linspace(-1, 1, n + 1)
    side = half * np.sign(side) * np.abs(side) ** 1.4
    down = -depth * np.linspace(0, 1, m + 1) ** 1.4
    points = np.stack(np.meshgrid(side, side + 0.3 * step, down, indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.arange((n + 1) ** 2 * (m + 1)).reshape(n + 1, n + 1, m + 1)
    unit = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T
    cube = np.stack([corner[i : n + i, j : n + j, k : m + k].ravel() for i, j, k in unit], axis=1)
    ways = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
    return points, cube[:, ways].reshape(-1, 4)


def ball(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points on a unit sphere and their triangles, turning outwards."""
    from scipy.spatial import ConvexHull

    number = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * number / count), np.pi * (1 + 5**0.5) * number
    points = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
    triangles = ConvexHull(points).simplices
    a, b, c = (points[triangles[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return points, triangles


def flattened(points: np.ndarray, amount: float) -> np.ndarray:
    """A sphere of 25 um at the surface, pressed into a splat with its lower side in the crater."""
    radius = np.hypot(points[:, 0], points[:, 1])
    spread = 12.5 * (1 + 0.35 * amount * (1 - points[:, 2]) / 2)
    z = 12.8 + 12.5 * points[:, 2]
    height = np.abs(points[:, 2])
    x = np.hypot(points[:, 0] * spread, points[:, 1] * spread)
    lower = pressed(x) * np.clip(height / 0.3, 0, 1) ** 0.5
    splat = np.where(points[:, 2] > 0, 11 * height**0.8 * (1 - 0.1 * radius**2), lower)
    return np.column_stack([points[:, 0] * spread, points[:, 1] * spread, z + amount * (splat - z)]) * UM


def pressed(r: np.ndarray) -> np.ndarray:
    """Depth of the crater and its raised rim, um."""
    return -5 * np.exp(-((r / 14) ** 4)) + 1.2 * np.exp(-(((r - 20) / 3.5) ** 2))


def crater(points: np.ndarray, amount: float) -> np.ndarray:
    moved = points.copy()
    moved[:, 2] += amount * pressed(np.hypot(points[:, 0], points[:, 1])) * np.exp(points[:, 2] / 15)
    return moved * UM


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "single_ni"
    scene = """
        [particle]
        material = "Ni"
        diameter = "25 um"
        velocity = "500 m/s"
        [substrate]
        material = "SS304"
    """
    rng = np.random.default_rng(0)
    inside = rng.uniform(-1, 1, (8000, 3))
    inside = inside[(inside**2).sum(1) < 0.95]
    skin, triangles = ball(1500)
    soil, tets = block(60, 50, 3)
    with Store.create(folder, scene) as store:
        for step, amount in enumerate((0.0, 1.0)):
            heat = amount * np.exp(-(((inside[:, 2] + 0.9) / 0.6) ** 2)) * (0.4 + (inside[:, :2] ** 2).sum(1))
            data = {"T": 300 + 160 * heat, "eps_p": 0.25 * amount + 1.1 * heat}
            store.write("particle", step * 60e-9, flattened(inside, amount), np.arange(len(inside))[:, None], data)
            store.write("surface", step * 60e-9, flattened(skin, amount), triangles)
            middle = soil[tets].mean(1)
            far = np.hypot(np.hypot(middle[:, 0], middle[:, 1]) / 14, (middle[:, 2] + 2) / 9)
            strain = amount * 0.7 * np.exp(-(far**2)) * (1 + 0.1 * rng.normal(size=len(tets)))
            data = {"T": 300 + 130 * strain, "eps_p": strain}
            store.write("target", step * 60e-9, crater(soil, amount), tets, {}, data)
    return folder


def area(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Of polygons (..., k), by the shoelace rule; positive if they turn from x to z."""
    return 0.5 * (x * np.roll(z, -1, axis=-1) - np.roll(x, -1, axis=-1) * z).sum(-1)


@pytest.mark.parametrize("plane", [0.0, 0.31, -0.7])
def test_cut_of_tetrahedra_is_exact(plane):
    points, tets = block(2.0, 3.0, 0.5)
    edges, owner = cut_tets(points, tets, plane)
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


def test_oblique_picture_of_a_named_scene(folder, tmp_path):
    from coupler.report import _title

    copy = shutil.copytree(folder, tmp_path / "oblique")
    text = (copy / "scene.toml").read_text().replace('"500 m/s"', '"500 m/s"\nangle = "30 deg"')
    (copy / "scene.toml").write_text(text)
    assert _title(Result(copy)) == "25 µm Ni on SS304 at 500 m/s and 30°"
    # Text of a stranger's scene is shown as it stands: no formulas, no end of it.
    (copy / "scene.toml").write_text(text.replace('"Ni"', f'"$\\\\frac{{{"x" * 100}$"'))
    assert len(_title(Result(copy))) < 120
    section_picture(Result(copy))
    (copy / "scene.toml").write_text("particle = 3")
    assert _title(Result(copy)) == "oblique"


def test_picture_of_an_unfinished_run_says_what_is_missing(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "run")
    (copy / "surface.vtkhdf").unlink()
    with pytest.raises(StoreError, match="0 steps of particle, surface and target"):
        section_picture(Result(copy))
    with pytest.raises(StoreError, match="cannot write"):
        section_picture(Result(folder), tmp_path / "nowhere" / "a.png")


def printed(result: Result) -> list[list[str]]:
    from rich.console import Console

    stream = io.StringIO()
    Console(file=stream, width=120).print(summary_table(result))
    return [[cell.strip() for cell in line.split("│")[1:-1]] for line in stream.getvalue().splitlines()]


def test_summary_table(tmp_path):
    summary = {
        "flattening_ratio": 0.5561,
        "crater_depth_m": 5.02e-6,
        "energy_drift": 0.0031,
        "von_mises_max_Pa": 778e6,
        "rebound_velocity_m_s": None,
        "points": 4012,
        "dt_mean_s": 5.2e-12,
        "wall_s": 28.4,
        "effects": ["friction", "[bold]mine"],
        "version": "0.1.0",
        "warnings": ["strain rates beyond the fit"],
        "unheard_of_K": 1.0,
        "greatest_deformation": {"time_s": 41e-9, "crater_depth_m": 5.5e-6},
        "end": {"time_s": 60e-9, "crater_depth_m": 5.02e-6},
    }
    with Store.create(tmp_path, "") as store:
        store.finish(summary)
    rows = {row[0]: row[1:] for row in printed(Result(tmp_path)) if len(row) > 1}
    assert rows["crater depth"] == ["5.5", "5.02", "µm"]
    assert rows["time"] == ["41", "60", "ns"]
    assert rows["flattening, above surface"] == ["", "0.5561", ""]
    assert rows["highest von Mises stress"] == ["", "778", "MPa"]
    assert rows["energy drift"] == ["", "0.31", "%"]
    assert rows["rebound velocity"] == ["", "", "m/s"]
    assert rows["points"] == ["", "4 012", ""]
    assert rows["mean time step"] == ["", "5.2", "ps"]
    assert rows["wall time"] == ["", "28.4", "s"]
    assert rows["unheard of"] == ["", "1", "K"]
    # Text is text, not markup.
    caption = summary_table(Result(tmp_path)).caption
    assert str(caption) == "effects: friction, [bold]mine\nwarnings: strain rates beyond the fit"
