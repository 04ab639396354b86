"""Particles whose shape comes from a file."""

import re
import struct
from collections.abc import Callable, Iterable
from pathlib import Path

import meshio
import numpy as np
import pytest
from scenes import COATING, problems_with, scene_with
from scipy.spatial import ConvexHull

from coupler import Scene, run
from coupler.errors import SceneError, SplatError
from coupler.files.inputs import InputError
from coupler.files.surfaces import read_surface
from coupler.geometry.raycast import RaySurface
from coupler.geometry.solid import MOST_TRIANGLES, solid_of
from coupler.geometry.triangles import areas, enclosed_volume, open_or_double
from coupler.particle import packing, shapes
from coupler.plan.planning import plan
from coupler.plan.record import plan_text, read_plan
from coupler.plan.solids import form_of, load
from coupler.plan.text import describe

D, SPHERE = 25e-6, np.pi / 6.0
Surface = tuple[np.ndarray, np.ndarray]


def lumpy(seed: int, roughness: float = 0.2, edge: float = 0.12, waves: int = 6) -> Surface:
    """A ball whose radius changes with the direction, by a few plane waves."""
    vertices, triangles = packing.surface(2.0, edge)
    rng = np.random.default_rng(seed)
    k, phase = rng.normal(size=(waves, 3)) * 1.5, rng.random(waves) * 2.0 * np.pi
    radius = 1.0 + roughness * np.sin(vertices @ k.T + phase).mean(axis=1) * np.sqrt(waves)
    return vertices * radius[:, None], triangles


def rock(seed: int, corners: int = 14) -> Surface:
    """The hull of random points: flat faces and sharp edges, few triangles."""
    x = np.random.default_rng(seed).normal(size=(corners, 3))
    hull = ConvexHull(x / np.linalg.norm(x, axis=1)[:, None] * [1.3, 1.0, 0.8])
    t = hull.simplices.copy()
    a, b, c = (hull.points[t[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0.0
    t[inwards] = t[inwards][:, ::-1]
    return hull.points, t


def dumbbell() -> Surface:
    """Two balls with a neck, as satellites on a powder particle: not convex."""
    vertices, triangles = packing.surface(2.0, 0.1)
    waist = 1.0 - 0.45 * np.exp(-((vertices[:, :1] / 0.35) ** 2))
    return vertices * np.concatenate([np.full_like(waist, 1.8), waist, waist], axis=1), triangles


def dented() -> Surface:
    """A ball with a deep dent."""
    vertices, triangles = packing.surface(2.0, 0.08)
    return vertices * (1.0 - 0.55 * np.exp(-((vertices[:, 2:] - 1.0) ** 2 / 0.15))), triangles


SHAPES: dict[str, Callable[[], Surface]] = {
    **{f"lumpy_{seed}": lambda seed=seed: lumpy(seed) for seed in (1, 2, 3)},  # type: ignore[misc]
    "rough": lambda: lumpy(4, 0.12, 0.06, 20),
    **{f"rock_{seed}": lambda seed=seed: rock(seed) for seed in (1, 2)},  # type: ignore[misc]
    "splinter": lambda: (rock(3, 10)[0] * [2.2, 1.0, 0.9], rock(3, 10)[1]),
    "dumbbell": dumbbell,
    "dented": dented,
    "fine": lambda: lumpy(5, 0.15, 0.06),
}


def written(folder: Path, name: str, unit: float = 1.0) -> Path:
    """An STL file of one of SHAPES."""
    points, triangles = SHAPES[name]()
    path = folder / f"{name}.stl"
    meshio.Mesh(points * unit, [("triangle", triangles)]).write(path)
    return path


def inertia(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Second moments (3,3) of the volume in a closed surface about its centre, over the volume: sums over tetrahedra from the origin
    (Tonon 2004, J. Math. Stat. 1, 8)."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    volume, total = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0, a + b + c
    centre = volume @ total / 4.0 / volume.sum()
    moments = sum(np.einsum("f,fi,fj->ij", volume, q, q) for q in (a, b, c, total)) / 20.0
    return moments / volume.sum() - np.outer(centre, centre)


@pytest.mark.parametrize("name", SHAPES)
def test_an_irregular_shape_is_cleaned_and_packed(name: str, tmp_path: Path) -> None:
    """Mass, centre and inertia of the points, each with its cell of the lattice, are those of the solid. The splinter's tips, thinner
    than a spacing, hold no point."""
    solid = load(written(tmp_path, name, unit=3.7))
    assert enclosed_volume(solid.points, solid.triangles) == pytest.approx(SPHERE)
    assert len(solid.triangles) <= MOST_TRIANGLES
    form = form_of(solid)
    assert form.height() == pytest.approx(np.ptp(solid.points[:, 2]))
    body = shapes.of_surface(solid.points, solid.triangles, D, 800)
    assert len(body.points) == pytest.approx(800, rel=0.1)
    assert len(body.points) * body.volume == pytest.approx(SPHERE * D**3)
    np.testing.assert_allclose(body.points.mean(axis=0), 0.0, atol=1e-6 * D)
    exact = inertia(solid.points * D, solid.triangles)
    moments = np.cov(body.points.T, bias=True) + packing.MOMENT * body.spacing**2 * np.eye(3)
    difference = np.abs(moments - exact).max() / np.linalg.eigvalsh(exact).max()
    assert difference < (0.09 if name == "splinter" else 0.025)
    assert RaySurface(body.vertices, body.triangles).distance_outside(body.points).max() < 0.05 * body.spacing
    assert open_or_double(body.triangles) == ""
    assert enclosed_volume(body.vertices, body.triangles) == pytest.approx(SPHERE * D**3, rel=1e-6)
    edges = np.linalg.norm(body.vertices[body.triangles] - body.vertices[np.roll(body.triangles, 1, axis=1)], axis=2)
    assert edges.mean() == pytest.approx(0.8 * body.spacing, rel=0.2)
    apart = RaySurface(solid.points * D, solid.triangles).feet(body.vertices)[0] - body.vertices
    assert np.linalg.norm(apart, axis=1).max() < 0.05 * body.spacing


def test_moments_of_a_box() -> None:
    """Lengths a, b, c off the origin: a^2 / 12, b^2 / 12, c^2 / 12."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 2.0) for z in (0.0, 3.0)]) + 5.0
    hull = ConvexHull(corners)
    sides, away = hull.simplices.copy(), hull.equations[:, :3]
    normals = np.cross(corners[sides[:, 1]] - corners[sides[:, 0]], corners[sides[:, 2]] - corners[sides[:, 0]])
    inwards = np.einsum("ij,ij->i", normals, away) < 0.0
    sides[inwards] = sides[inwards][:, ::-1]
    np.testing.assert_allclose(inertia(corners, sides), np.diag([1.0, 4.0, 9.0]) / 12.0, atol=1e-12)


def test_a_ball_from_a_file_is_the_sphere() -> None:
    """Moments of its points: those of a ball of equal volume, D^2 / 20 along each axis."""
    solid = solid_of(*packing.surface(1.0, 0.05))
    body = shapes.of_surface(solid.points, solid.triangles, D, 2000)
    cell = packing.MOMENT * body.spacing**2
    np.testing.assert_allclose(body.points.var(axis=0) + cell, D**2 / 20.0, rtol=0.01)


def test_a_closed_surface_inside_another_is_a_pore() -> None:
    """Whichever way its triangles turn: a ball of radius 1 with a cavity of 0.5 has 7/8 of its volume, and points in none of it."""
    (x, t), (hole, facing) = packing.surface(2.0, 0.15), packing.surface(1.0, 0.15)
    for turned in (facing, facing[:, ::-1]):
        solid = solid_of(np.concatenate([x, hole + np.array([0.3, 0.0, 0.0])]), np.concatenate([t, turned + len(x)]))
        assert enclosed_volume(solid.points, solid.triangles) == pytest.approx(SPHERE)
    body = shapes.of_surface(solid.points, solid.triangles, D, 1000)
    assert body.inner is not None
    outer, inner = enclosed_volume(body.vertices, body.triangles), enclosed_volume(*body.inner)
    assert outer + inner == pytest.approx(SPHERE * D**3, rel=1e-6)
    assert -inner / outer == pytest.approx(0.125, rel=0.05)  # of coarse surfaces, whose triangles are chords
    middle = body.inner[0].mean(axis=0)
    assert (
        np.linalg.norm(body.points - middle, axis=1).min() > 0.9 * np.linalg.norm(body.inner[0] - middle, axis=1).min()
    )


def test_a_small_pore_is_no_fragment() -> None:
    """A cavity of a tenth of the diameter has 1 % of the area. Open parts, and those outside, are fragments."""
    (x, t), (hole, facing) = packing.surface(2.0, 0.15), packing.surface(0.18, 0.03)
    apart = [np.array([0.3, 0.0, 0.0]), np.array([-0.3, 0.2, 0.0]), np.array([3.0, 0.0, 0.0])]
    bodies = [(x, t), *((hole + at, facing) for at in apart), (hole + np.array([0.0, 0.0, 0.4]), facing[1:])]
    starts = np.cumsum([0, *(len(points) for points, _ in bodies)])
    solid = solid_of(
        np.concatenate([points for points, _ in bodies]),
        np.concatenate([triangles + start for (_, triangles), start in zip(bodies, starts, strict=False)]),
    )
    assert len(solid.triangles) == len(t) + 2 * len(facing)


def test_files_of_all_kinds_and_faults_that_can_be_mended() -> None:
    x, t = packing.surface(2.0, 0.3)
    soup = x[t].reshape(-1, 3), np.arange(3 * len(t)).reshape(-1, 3)  # as in STL: no triangle shares its corners
    turned = t.copy()
    turned[::2] = turned[::2, ::-1]
    dust, flakes = packing.surface(0.05, 0.02)
    with_dust = np.concatenate([x, dust + 3.0]), np.concatenate([t, flakes + len(x)])
    doubles, turned_doubles = (np.concatenate([t, more]) for more in (t[:3], t[3:8, ::-1]))
    for surface in (soup, (x, turned), (x, t[:, ::-1]), with_dust, (x, doubles), (x, turned_doubles)):
        solid = solid_of(*surface)
        assert enclosed_volume(solid.points, solid.triangles) == pytest.approx(SPHERE)
        assert len(solid.triangles) == len(t)


CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])  # of a cube, and its sides, outwards
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
HALVES = [half for a, b, c, d in SIDES for half in ([a, b, c], [a, c, d])]
LIKE_L = [(2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 0)]


def obj(points: Iterable[Iterable[float]], faces: Iterable[Iterable[object]]) -> bytes:
    lines = [*("v {} {} {}".format(*p) for p in points), *("f " + " ".join(map(str, f)) for f in faces)]
    return "\n".join(lines).encode()


def text_stl(keyword: Callable[[str], str] = str) -> bytes:
    facet = "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n"
    corners = ("".join("vertex {} {} {}\n".format(*CORNERS[i]) for i in half) for half in HALVES)
    return keyword(f"solid a\n{''.join(map(facet.format, corners))}endsolid a\n").encode()


def binary_stl(count: int = 12, behind: bytes = b"") -> bytes:
    rows = np.zeros(12, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    rows["corners"] = CORNERS[HALVES]
    return b"solid".ljust(80) + struct.pack("<I", count) + rows.tobytes() + behind


def ply(form: str, faces: list[list[int]], name: str = "vertex_indices", end: str = "\n") -> bytes:
    """With a number at the points and a list at the faces that are no business of a shape."""
    head = [
        "ply", f"format {form} 1.0", "element vertex 8", *(f"property float {axis}" for axis in "xyz"), "property uchar red",
        f"element face {len(faces)}", f"property list uchar int {name}", "property list uchar float texcoord", "end_header", "",
    ]  # fmt: skip
    if form == "ascii":
        rows = [
            *("{} {} {} 7".format(*p) for p in CORNERS),
            *(f"{len(f)} {' '.join(map(str, f))} 2 0.5 0.5" for f in faces),
        ]
        return end.join(head + rows).encode()
    order = ">" if "big" in form else "<"
    points = b"".join(struct.pack(f"{order}3fB", *p, 7) for p in CORNERS)
    return end.join(head).encode() + points + b"".join(
        struct.pack(f"{order}B{len(f)}iB2f", len(f), *f, 2, 0.5, 0.5) for f in faces
    )  # fmt: skip


FROM_ONE = [[i + 1 for i in side] for side in SIDES]
SAME_CUBE = {
    "quads.obj": obj(CORNERS, FROM_ONE),
    "both.obj": obj(CORNERS, [*FROM_ONE[:5], *([i + 1 for i in half] for half in HALVES[10:])]),
    "texture.obj": obj(CORNERS, [[f"{i}/{i + 9}/1" for i in side] for side in FROM_ONE]).replace(b"f", b"vt 0 0\nf", 1),
    "backwards.obj": b"\n".join(obj(CORNERS[side], [[-4, -3, -2, -1]]) for side in SIDES),  # points between the faces
    "capitals.STL": text_stl(str.upper), "text.stl": text_stl(), "binary.stl": binary_stl(), "behind.stl": binary_stl(behind=b"\n"),
    "text.ply": ply("ascii", SIDES, end="\r\n"), "little.ply": ply("binary_little_endian", HALVES),
    "big.ply": ply("binary_big_endian", SIDES, "vertex_index") + b"behind",
}  # fmt: skip


@pytest.mark.parametrize("name", SAME_CUBE)
def test_a_cube_as_other_programs_write_it(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(SAME_CUBE[name])
    points, triangles = read_surface(tmp_path / name)
    assert len(triangles) == 12
    assert enclosed_volume(points, triangles) == pytest.approx(8.0, rel=1e-12)
    assert len(load(tmp_path / name).triangles) == 12


def test_a_concave_side_is_cut_into_triangles_that_lie_in_it(tmp_path: Path) -> None:
    """A prism of height 1 on an L of area 3; a fan from the first corner, at the end of the L, would leave it."""
    points = [(x, y, z) for z in (0, 1) for x, y in LIKE_L]
    walls = [[i + 1, (i + 1) % 6 + 1, (i + 1) % 6 + 7, i + 7] for i in range(6)]
    (tmp_path / "l.obj").write_bytes(obj(points, [[6, 5, 4, 3, 2, 1], [7, 8, 9, 10, 11, 12], *walls]))
    x, t = read_surface(tmp_path / "l.obj")
    assert areas(x, t).sum() == pytest.approx(2 * 3.0 + 8.0)
    assert enclosed_volume(x, t) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("name", "raw", "told"),
    [
        ("more.stl", binary_stl(15), "states 15 triangles, but the size of the file is that of 12"),
        ("less.stl", binary_stl(9), "states 9 triangles, but the size of the file is that of 12"),
        ("cut.stl", text_stl()[:-60], "33 corners for 12 facets; the file is damaged or incomplete"),
        ("cut.ply", ply("binary_little_endian", HALVES)[:-9], "fewer values than its header states"),
        ("zero.obj", obj(CORNERS, SIDES), "or with an index outside its 8"),
        ("beyond.obj", obj(CORNERS, [*FROM_ONE, [1, 2, -9]]), "or with an index outside its 8"),
        ("comma.obj", b"v 0,5 0 0", "line 1, 'v 0,5 0 0': a point needs three numbers"),
        ("none.obj", obj(CORNERS, []), "has no triangles"),
        ("order.ply", ply("ascii", SIDES).replace(b"element vertex 8\n", b""), "fewer values than"),
        ("not.ply", binary_stl(), "its header is missing"),
        ("nan.stl", binary_stl().replace(struct.pack("<f", 1.0), struct.pack("<f", np.nan)), "not numbers"),
    ],
)
def test_a_damaged_surface_is_refused_for_what_it_is(name: str, raw: bytes, told: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(raw)
    with pytest.raises(InputError, match=re.escape(told)):
        load(tmp_path / name)


def test_flat_sides_of_many_triangles_do_not_pass_through_each_other(rng: np.random.Generator) -> None:
    """Turned, and in single precision, as STL files are, their triangles lie in one plane up to rounding."""
    points, triangles = packing.subdivide(CORNERS, np.array(HALVES), 4)
    for _ in range(20):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        assert len(solid_of((points @ turn.T).astype(np.float32), triangles).triangles) == len(triangles)


def test_what_is_no_solid_is_refused_with_its_reason(tmp_path: Path) -> None:
    x, t = packing.surface(2.0, 0.3)
    for points, triangles, reason in (
        (x, t[1:], "3 edges have only one triangle"),
        (np.concatenate([x, x + 3.0]), np.concatenate([t, t + len(x)]), "2 separate parts"),
        (x * [1.0, 1.0, 0.0], t, "solid|volume|pass through"),
        (np.zeros((3, 3)), np.array([[0, 1, 2]]), "no area"),
        (x, np.concatenate([t, [[t[0, 0], t[0, 1], t[40, 0]]]]), "more than two triangles"),
    ):
        with pytest.raises(SplatError, match=reason):
            solid_of(points, triangles)
    for text, reason in (("nonsense", "cannot be read"), ("solid a\nendsolid a\n", "cannot be read")):
        (tmp_path / "a.stl").write_text(text)
        with pytest.raises(InputError, match=reason):
            load(tmp_path / "a.stl")
    (tmp_path / "a.txt").write_text("1 2 3")
    with pytest.raises(InputError, match="is not a surface file"):
        load(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"particle__shape": "file"}, "shape = .file.: give file, such as"),
        ({"particle__file": "a.stl"}, "has a file: set shape"),
        (
            {"particle__shape": "file", "particle__file": "not_there.stl"},
            r"particle\.file: .*not_there\.stl is missing",
        ),
    ],
)
def test_a_scene_without_its_shape_is_refused(changes: dict[str, str], told: str) -> None:
    problems = problems_with(**changes)
    assert any(re.search(told, problem) for problem in problems), problems


def test_a_particle_of_a_file_flies_and_lands(tmp_path: Path) -> None:
    """Rests on the plan alone once it is planned: the file may go."""
    path = written(tmp_path, "lumpy_1")
    scene = scene_with(
        particle__shape="file", particle__file=str(path), particle__tilt="30 deg", end__time="4 ns", output__every="4 ns",
        resolution__spacing="2.6 um", resolution__element_size="4 um",
    )  # fmt: skip
    decided = plan(scene)
    assert "lumpy_1.stl" in describe(decided)
    assert decided.impact.lengths[0] == pytest.approx(np.ptp(load(path).points[:, 0]) * decided.impact.diameter)
    (tmp_path / "plan.json").write_text(plan_text(decided))
    assert read_plan(tmp_path) == decided
    assert type(scene).from_text(scene.to_toml(), "again") == scene
    result = run(scene, tmp_path / "run", threads=1)
    assert abs(result.surface_volume_error) < 0.05
    start = result.fields(0, "surface")
    assert enclosed_volume(start.points, start.cells) == pytest.approx(SPHERE * decided.impact.diameter**3, rel=1e-3)
    assert result.height_m < 2.0 * decided.impact.diameter


def test_a_folder_of_shapes_serves_a_coating(tmp_path: Path) -> None:
    for name in ("rock_1", "rock_2", "lumpy_1"):
        written(tmp_path, name)
    text = COATING.replace("shapes = { sphere = 0.5, oblate = 0.5 }", 'files = "*.stl"')
    (tmp_path / "coating.toml").write_text(text)
    scene = Scene.load(tmp_path / "coating.toml")
    names = [Path(str(particle.file)).stem for particle in scene.particles]
    assert {names.count(name) for name in ("rock_1", "rock_2", "lumpy_1")} <= set(range(5, 25))
    assert len(plan(scene).solids) == 3
    with pytest.raises(SceneError, match="no file in"):
        Scene.from_text(text.replace("*.stl", "*.obj"), str(tmp_path / "coating.toml"))
