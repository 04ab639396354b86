"""The stages of a splat's conversion: field, surface, remesh, quality."""

import numpy as np
import pytest

from coupler.errors import SplatError
from coupler.geometry import remesh
from coupler.geometry.tetrahedra import boundary_faces, volumes
from coupler.geometry.triangles import enclosed_volume, open_or_double
from coupler.particle import packing
from coupler.splat import field as fields
from coupler.splat import quality

R = 1.0
BALL = 4.0 / 3.0 * np.pi * R**3


def sphere(edge: float, radius: float = R) -> tuple[np.ndarray, np.ndarray]:
    return packing.surface(2.0 * radius, edge)


def test_field_of_a_surface_holds_its_volume_and_its_level_set_lies_on_it() -> None:
    ball = sphere(0.1)
    field, inside = fields.of_surface(*ball, 0.08, 0.12)
    assert inside == pytest.approx(enclosed_volume(*ball), rel=2e-3)
    level = fields.level_of(field, enclosed_volume(*ball))
    vertices, triangles = fields.contour(field, level)
    assert open_or_double(triangles) == ""
    assert enclosed_volume(vertices, triangles) == pytest.approx(enclosed_volume(*ball), rel=5e-3)
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(R, abs=0.03)


def test_what_is_inside_counts_once_where_a_surface_overlaps_itself() -> None:
    v, t = sphere(0.1)
    twice = np.concatenate([v, v + np.array([1.0, 0, 0])]), np.concatenate([t, t + len(v)])
    _, inside = fields.of_surface(*twice, 0.06, 0.1)
    common = np.pi / 12.0 * (4 * R + 1.0) * (2 * R - 1.0) ** 2
    assert inside == pytest.approx(2 * BALL - common, rel=0.02)
    _, none = fields.of_surface(v, t[:, ::-1], 0.06, 0.1)
    assert none == 0.0  # inside out is outside


def test_field_of_points_holds_their_volume_without_an_inset() -> None:
    points, each = packing.sphere(2.0 * R, 4000)
    spacing = each ** (1 / 3)
    field = fields.of_points(points, np.full(len(points), each), 0.5 * spacing, 0.6 * spacing)
    assert float(field.values.sum()) * field.h**3 == pytest.approx(BALL, rel=1e-4)
    assert fields.inside(field, fields.steepness(field), 0.5) == pytest.approx(BALL, rel=0.04)


def test_small_voids_are_filled_large_ones_kept_and_crumbs_cleared() -> None:
    values = np.zeros((40, 40, 40), np.float32)
    values[5:30, 5:30, 5:30] = 1.0
    values[8:10, 8:10, 8:10] = 0.0
    values[15:22, 15:22, 15:22] = 0.0
    values[35:37, 35:37, 35:37] = 1.0
    field, pieces = fields.clean(fields.Field(values, np.zeros(3), 1.0), 0.5, 30.0)
    assert len(pieces) == 1
    assert field.values.sum() == 25**3 - 7**3


def test_a_grid_beyond_reason_is_refused() -> None:
    with pytest.raises(SplatError, match=r"cells.*larger element size"):
        fields.of_points(np.array([[0.0, 0, 0], [1, 1, 1]]), np.ones(2), 1e-4, 1e-4)


@pytest.mark.parametrize("size", [0.15, 0.4])
def test_remesh_makes_even_triangles_of_the_same_topology(size: float) -> None:
    vertices, triangles = sphere(0.05)
    on_ball = lambda x: x / np.linalg.norm(x, axis=1)[:, None]  # noqa: E731
    x, t = remesh.even(vertices, triangles, size, on_ball)
    assert open_or_double(t) == ""
    assert len(x) - len(t) // 2 == 2  # still a sphere
    edge = np.linalg.norm(x[t] - x[np.roll(t, 1, axis=1)], axis=2) / size
    assert 0.5 < edge.min()
    assert edge.max() < 1.6
    assert np.mean(edge) == pytest.approx(1.0, abs=0.12)
    assert enclosed_volume(x, t) == pytest.approx(BALL, rel=0.6 * size**2)


def test_remesh_splits_a_coarse_surface_and_keeps_a_hole() -> None:
    n, m = 24, 12
    u, w = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    x = np.stack([(1 + 0.4 * np.cos(w)) * np.cos(u), (1 + 0.4 * np.cos(w)) * np.sin(u), 0.4 * np.sin(w)], -1).reshape(
        -1, 3
    )
    number = np.arange(n * m).reshape(n, m)
    a, b = number, np.roll(number, -1, 0)
    c, d = np.roll(b, -1, 1), np.roll(number, -1, 1)
    t = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    for size in (0.08, 0.3):
        y, s = remesh.even(x, t, size)
        assert open_or_double(s) == ""
        assert fields.handles((y, s)) == 1
        edge = np.linalg.norm(y[s] - y[np.roll(s, 1, axis=1)], axis=2)
        assert np.mean(edge) == pytest.approx(size, rel=0.15)


def test_open_and_double_surfaces_are_told() -> None:
    _, t = sphere(0.5)
    assert open_or_double(t) == ""
    assert "3 edges have only one triangle" in open_or_double(t[1:])
    assert "more than two" in open_or_double(np.concatenate([t, t[:1]]))


def test_swelling_puts_the_volume_right_and_stops_at_its_limit() -> None:
    ball, cavity = sphere(0.2), sphere(0.1, 0.4)
    hollow = [ball, (cavity[0], cavity[1][:, ::-1])]
    parts, moved = fields.correct_volume(hollow, 1.05 * BALL, 0.2)
    assert sum(enclosed_volume(*part) for part in parts) == pytest.approx(1.05 * BALL, rel=1e-6)
    assert np.linalg.norm(parts[1][0], axis=1).max() == pytest.approx(
        0.4 - moved, abs=0.01
    )  # metal grows into the cavity
    _, moved = fields.correct_volume(hollow, 3.0 * BALL, 0.1)
    assert moved == pytest.approx(0.1)


def test_quality_of_known_tetrahedra() -> None:
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    tet = np.array([[0, 1, 2, 3]])
    if volumes(regular, tet)[0] < 0:
        tet = tet[:, [0, 1, 3, 2]]
    assert volumes(regular, tet)[0] == pytest.approx(8.0 / 3.0)
    assert quality.gamma(regular, tet)[0] == pytest.approx(1.0)
    assert np.degrees(quality.dihedral_angles(regular, tet)) == pytest.approx(
        np.full((1, 6), np.degrees(np.arccos(1 / 3)))
    )
    flat = regular * [1.0, 1.0, 1e-3]
    assert quality.gamma(flat, tet)[0] < 0.01
    assert quality.gamma(regular, tet[:, [0, 1, 3, 2]])[0] < 0.0
    assert len(boundary_faces(tet)[0]) == 4
    assert enclosed_volume(regular, boundary_faces(tet)[0]) == pytest.approx(8.0 / 3.0)  # outwards


def test_step_length_is_the_solvers_bound() -> None:
    from types import SimpleNamespace

    from coupler.fe import kernels, mesh
    from coupler.fe.model import Metals
    from coupler.geometry import mesher
    from coupler.physics.constitutive import law_record, sound_speed
    from coupler.physics.strength import Strength

    nu, E, rho = 0.3, 200e9, 7800.0
    steel = SimpleNamespace(
        rho=rho, G=E / (2 * (1 + nu)), K=E / (3 * (1 - 2 * nu)), s=0.0, Gamma0=0.0, T_m=2000.0,
        strength=Strength("johnson_cook", dict(A=1e20, B=0.0, n=1.0, C=0.0, m=1.0, eps_dot_0=1.0, T_ref=300.0)),
        taylor_quinney=0.0, forest=(0.0, 0.0), gradient_length=0.0, cp=((300.0, 450.0),), k=((300.0, 50.0),),
    )  # fmt: skip
    points, tets = mesher.box((1.0, 1.0, 1.0), 0.4)
    block = mesh.prepare(points, tets)
    dt, ones = np.zeros(len(tets)), np.ones(len(points))
    metals = Metals(law_record(steel), np.zeros(len(tets), np.int32), np.zeros(len(points), np.int32))
    kernels.stable_dt(0, len(tets), block.points, ones, mesh.cells_of(block), metals, dt)
    assert quality.step_lengths(block.points, block.conn) / sound_speed(rho, steel.K, steel.G) == pytest.approx(
        dt, rel=1e-6
    )
