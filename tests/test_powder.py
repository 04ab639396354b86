"""Particles whose shape comes from a file."""

import re
from pathlib import Path

import numpy as np
import powder  # workflows/powder.py
import pytest
from scipy.spatial import ConvexHull
from test_coating import COATING
from test_scene import problems_with, scene_with

from coupler import Scene, run
from coupler.errors import SceneError, SplatError
from coupler.files.inputs import InputError
from coupler.geometry.raycast import RaySurface
from coupler.geometry.solid import MOST_TRIANGLES, solid_of
from coupler.geometry.triangles import enclosed_volume, open_or_double
from coupler.plan.planning import plan
from coupler.plan.record import plan_text, read_plan
from coupler.plan.solids import form_of, load
from coupler.plan.text import describe
from coupler.sph import packing, shapes

D, SPHERE = 25e-6, np.pi / 6.0


def inertia(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Second moments (3,3) of the volume in a closed surface about its centre, over the volume: sums over tetrahedra from the origin
    (Tonon 2004, J. Math. Stat. 1, 8)."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    volume, total = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0, a + b + c
    centre = volume @ total / 4.0 / volume.sum()
    moments = sum(np.einsum("f,fi,fj->ij", volume, q, q) for q in (a, b, c, total)) / 20.0
    return moments / volume.sum() - np.outer(centre, centre)


@pytest.mark.parametrize("name", powder.SHAPES)
def test_an_irregular_shape_is_cleaned_and_packed(name: str, tmp_path: Path) -> None:
    """Mass, centre and inertia of the points, each with its cell of the lattice, are those of the solid. The splinter's tips, thinner
    than a spacing, hold no point."""
    solid = load(powder.write(tmp_path, name, unit=3.7))
    assert enclosed_volume(solid.points, solid.triangles) == pytest.approx(SPHERE)
    assert len(solid.triangles) <= MOST_TRIANGLES
    form = form_of(solid)
    assert form.height() == pytest.approx(np.ptp(solid.points[:, 2]))
    body = shapes.of_surface(solid.points, solid.triangles, D, 800)
    assert len(body.points) == pytest.approx(800, rel=0.1)
    assert len(body.points) * body.volume == pytest.approx(SPHERE * D**3)
    np.testing.assert_allclose(body.points.mean(axis=0), 0.0, atol=1e-6 * D)
    exact = inertia(solid.points * D, solid.triangles)
    moments = np.cov(body.points.T, bias=True) + packing.FCC.cell_moment(body.spacing) * np.eye(3)
    difference = np.abs(moments - exact).max() / np.linalg.eigvalsh(exact).max()
    assert difference < (0.09 if name == "splinter" else 0.025)
    assert RaySurface(body.vertices, body.triangles).distance_outside(body.points).max() < 0.05 * body.spacing
    assert open_or_double(body.triangles) == ""
    assert enclosed_volume(body.vertices, body.triangles) == pytest.approx(SPHERE * D**3, rel=1e-6)
    edges = np.linalg.norm(body.vertices[body.triangles] - body.vertices[np.roll(body.triangles, 1, axis=1)], axis=2)
    assert edges.mean() == pytest.approx(0.8 * body.spacing, rel=0.2)
    apart = RaySurface(solid.points * D, solid.triangles).closest(body.vertices) - body.vertices
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
    cell = packing.FCC.cell_moment(body.spacing)
    np.testing.assert_allclose(body.points.var(axis=0) + cell, D**2 / 20.0, rtol=0.01)


def test_files_of_all_kinds_and_faults_that_can_be_mended() -> None:
    x, t = packing.surface(2.0, 0.3)
    soup = x[t].reshape(-1, 3), np.arange(3 * len(t)).reshape(-1, 3)  # as in STL: no triangle shares its corners
    turned = t.copy()
    turned[::2] = turned[::2, ::-1]
    dust, flakes = packing.surface(0.05, 0.02)
    with_dust = np.concatenate([x, dust + 3.0]), np.concatenate([t, flakes + len(x)])
    for surface in (soup, (x, turned), (x, t[:, ::-1]), with_dust, (x, np.concatenate([t, t[:3]]))):
        solid = solid_of(*surface)
        assert enclosed_volume(solid.points, solid.triangles) == pytest.approx(SPHERE)
        assert len(solid.triangles) == len(t)


def test_what_is_no_solid_is_refused_with_its_reason(tmp_path: Path) -> None:
    x, t = packing.surface(2.0, 0.3)
    for points, triangles, reason in (
        (x, t[1:], "3 edges have one triangle"),
        (np.concatenate([x, x + 3.0]), np.concatenate([t, t + len(x)]), "2 parts"),
        (x * [1.0, 1.0, 0.0], t, "solid|volume|pass through"),
        (np.zeros((3, 3)), np.array([[0, 1, 2]]), "no area"),
    ):
        with pytest.raises(SplatError, match=reason):
            solid_of(points, triangles)
    for text, reason in (("nonsense", "cannot be read"), ("solid a\nendsolid a\n", "cannot be read")):
        (tmp_path / "a.stl").write_text(text)
        with pytest.raises(InputError, match=reason):
            load(tmp_path / "a.stl")
    (tmp_path / "a.txt").write_text("1 2 3")
    with pytest.raises(InputError, match="is no surface"):
        load(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"particle__shape": "file"}, "needs file ="),
        ({"particle__file": "a.stl"}, "only with it"),
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
    path = powder.write(tmp_path, "lumpy_1")
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
        powder.write(tmp_path, name)
    text = COATING.replace("shapes = { sphere = 0.5, oblate = 0.5 }", 'files = "*.stl"')
    (tmp_path / "coating.toml").write_text(text)
    scene = Scene.load(tmp_path / "coating.toml")
    names = [Path(str(particle.file)).stem for particle in scene.particles]
    assert {names.count(name) for name in ("rock_1", "rock_2", "lumpy_1")} <= set(range(5, 25))
    assert len(plan(scene).solids) == 3
    with pytest.raises(SceneError, match="no file in"):
        Scene.from_text(text.replace("*.stl", "*.obj"), str(tmp_path / "coating.toml"))
