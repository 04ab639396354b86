"""Rough ground: mean, Sa and correlation of the heights, and the mesh below."""

import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from coupler import Scene, run
from coupler.errors import SceneError
from coupler.fe.mesh import prepare
from coupler.files.height_maps import read_heights
from coupler.files.inputs import InputError
from coupler.geometry.mesher import cylinder
from coupler.geometry.rough import Ground, heights, normal_under
from coupler.plan.planning import plan

D, SA, LENGTH = 400e-6, 3e-6, 20e-6


def disc(step: float = 2e-6) -> np.ndarray:
    """Places (k,2) m on an even grid of the disc."""
    axis = np.arange(-0.5 * D + step / 2, 0.5 * D, step)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return grid[np.hypot(*grid.T) <= 0.5 * D]


def test_heights_have_the_mean_and_the_sa_that_are_asked_for() -> None:
    """Set on a grid three times as coarse: to 2 %."""
    h = heights(disc(), D, SA, LENGTH, seed=4)
    assert abs(h.mean()) < 0.02 * SA
    assert np.abs(h).mean() == pytest.approx(SA, rel=0.02)


def test_the_correlation_falls_to_1_over_e_in_the_length() -> None:
    """exp(-(d / length)^2), over eight surfaces of some 300 correlated areas each: to 0.05 of 1."""
    places = disc(8e-6)
    here = [heights(places, D, SA, LENGTH, seed) for seed in range(8)]
    for over in (0.5, 1.0, 1.5):
        beside = places + np.array([over * LENGTH, 0.0])
        found = [np.mean(h * heights(beside, D, SA, LENGTH, seed)) / np.mean(h * h) for seed, h in enumerate(here)]
        assert np.mean(found) == pytest.approx(np.exp(-(over**2)), abs=0.05)


def test_a_seed_is_one_surface_and_another_seed_another() -> None:
    places = disc(20e-6)
    once, again, other = (heights(places, D, SA, LENGTH, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(once, again)
    assert abs(np.corrcoef(once, other)[0, 1]) < 0.3


def field(at: np.ndarray) -> np.ndarray:
    return heights(at, 100e-6, 2e-6, 12e-6, 3)


#: a groove, a step and a slope in one, of 60 degrees where it is steepest
SHAPED = Ground((
    (0.3, ((-14e-6, 0.0), (-7.07e-6, -12e-6), (7.07e-6, -12e-6), (14e-6, 0.0))),
    (2.0, ((-6e-6, 0.0), (6e-6, 6e-6))), (-1.0, ((-1e-4, -1e-5), (1e-4, 1e-5))),
)).heights  # fmt: skip


@pytest.mark.parametrize("top", [field, SHAPED], ids=["rough", "shaped"])
def test_the_mesh_follows_the_surface_and_keeps_its_bottom_and_its_sides(
    top: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Facets are told by where they look, as those of a shaped top lie at many heights. Elements are as thick as in a flat target: a
    displaced flat mesh has inverted ones below corners of the surface."""
    points, tets = cylinder(100e-6, 60e-6, 3e-6, 15e-6, 0.35)
    flat, shaped = prepare(points, tets), prepare(*cylinder(100e-6, 60e-6, 3e-6, 15e-6, 0.35, top=top))
    assert shaped.V0.min() ** (1 / 3) > 0.5 * flat.V0.min() ** (1 / 3)
    assert {name: len(ids) for name, ids in shaped.sets.items()} == {name: len(ids) for name, ids in flat.sets.items()}
    at = shaped.points[np.unique(shaped.facets[shaped.sets["top"]])]
    np.testing.assert_allclose(at[:, 2], top(at[:, :2]), atol=1e-12)
    np.testing.assert_allclose(shaped.points[np.unique(shaped.facets[shaped.sets["bottom"]]), 2], -60e-6, atol=1e-12)


GROUND = """
[particle]
material = "Ni"
diameter = "20 um"
velocity = "500 m/s"

[substrate]
material = "SS304"
height = "80 um"
roughness = "3 um"
roughness_length = "20 um"

[resolution]
spacing = "2 um"
"""


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ('"3 um"\nroughness_length = "20 um"', '"4 um"\nroughness_length = "15 um"', "steeper than a mesh can represent"),
        ('"2 um"', '"5 um"', "not resolved by elements of"),
        ('"3 um"', '"4.5 um"', 'substrate.roughness = "4.5 um": too rough for a target of 80 um'),
    ],
)  # fmt: skip
def test_ground_that_meshes_do_not_bear_is_refused_by_its_key(before: str, after: str, says: str) -> None:
    assert Scene.from_text(GROUND).substrate.roughness == pytest.approx(3e-6)
    with pytest.raises(SceneError) as error:
        Scene.from_text(GROUND.replace(before, after))
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("shape", "says"),
    [
        ('groove = { width = "30 um", depth = "10 um", angle = "70 deg" }', 'groove.angle = "70 deg": steeper than a mesh can'),
        ('groove = { width = "30 um", depth = "20 um" }', 'groove.width = "30 um": its flanks of 45 degrees need 40 um'),
        ('groove = { width = "10 um", depth = "2 um" }', 'groove.width = "10 um": not resolved by elements of 3.4 um'),
        ('groove = { width = "100 um", depth = "40 um" }', "at most 0.4 of substrate.height"),
        ('groove = { width = "100 um" }', "substrate.groove.depth: missing"),
        ('groove = "deep"', "expected a table [substrate.groove]"),
        ('layer = "Al"', 'substrate.layer = "Al": expected tables [[substrate.layer]]'),
        ('step = { height = "10 um", angle = "65 deg" }\nslope = { angle = "15 deg" }', "substrate.step with substrate.slope"),
        ('slope = { angle = "30 deg" }', "substrate.slope: the surface reaches from"),
        ('height_map = { file = "none.csv" }', "none.csv is missing"),
        ('height_map = { file = "words.csv" }', "values that are not numbers"),
        ('height_map = { file = "small.csv", unit = "0.5 um" }', "the substrate has a radius of 100 um"),
        ('height_map = { file = "grey.png", unit = "3 um" }', 'give height = "10 um", the height of white over black'),
        ('height_map = { file = "grey.png", unit = "3 um", height = "500 um" }', "substrate.height_map: the surface reaches from"),
    ],
)  # fmt: skip
def test_a_shape_that_meshes_do_not_bear_is_refused_by_its_key(shape: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "words.csv").write_text("one,two,three\nfour,five,six\n")
    grid = np.stack(np.meshgrid(np.arange(-60.0, 61.0, 5.0), np.arange(-60.0, 61.0, 5.0)), axis=-1).reshape(-1, 2)
    np.savetxt(tmp_path / "small.csv", np.column_stack([grid, 0.0 * grid[:, 0]]), delimiter=",")
    Image.fromarray(np.tile(np.arange(80, dtype=np.uint8), (80, 1))).save(tmp_path / "grey.png")
    text = GROUND.replace('roughness = "3 um"\nroughness_length = "20 um"', shape)
    with pytest.raises(SceneError) as error:
        Scene.from_text(text, str(tmp_path / "scene.toml"))
    assert says in str(error.value)


def test_a_map_is_the_same_surface_from_every_kind_of_file(tmp_path: Path) -> None:
    """A matrix, columns x, y, z, grey images of 8, 16 and 32 bits, an open patch: each has the waves that were written, with the y axis
    upwards, to the resolution of 8 bits and the average over an element (0.1 um of 3)."""
    n, pitch = 115, 2.0
    axis = pitch * (np.arange(n) - (n - 1) / 2)
    x, y = np.meshgrid(axis, axis)
    z = 2.0 * np.sin(x / 20.0) + np.sin(y / 25.0)
    flat, low, high = np.column_stack([x.ravel(), y.ravel(), z.ravel()]), z.min(), z.max()
    np.savetxt(tmp_path / "xyz.csv", flat, delimiter=",", header="x [um],y [um],z [um]", comments="")
    (tmp_path / "matrix.csv").write_text(
        "\n".join(";".join(f"{v:.5f}" for v in row) for row in z[::-1]).replace(".", ",")
    )
    grey = (z[::-1] - low) / (high - low)
    Image.fromarray((255 * grey).astype(np.uint8)).save(tmp_path / "8.png")
    Image.fromarray((65535 * grey).astype(np.uint16)).save(tmp_path / "16.png")
    Image.fromarray(z[::-1].astype(np.float32)).save(tmp_path / "32.tif")
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    with open(tmp_path / "patch.stl", "wb") as stl:
        stl.write(bytes(80) + struct.pack("<I", len(triangles)))
        stl.write(b"".join(struct.pack("<12fH", 0, 0, 0, *flat[each].ravel(), 0) for each in triangles))
    depth = f"{high - low:.6g} um"
    numbers, grey_values = ', unit = "2 um", height = "1 um"', f', unit = "2 um", height = "{depth}"'
    files = {"xyz.csv": "", "patch.stl": ""} | dict.fromkeys(("matrix.csv", "32.tif"), numbers)
    files |= dict.fromkeys(("8.png", "16.png"), grey_values)
    places = np.array([[30e-6, 40e-6], [-31e-6, 5e-6], [3e-6, -44e-6]])
    written = 2.0 * np.sin(places[:, 0] / 20e-6) + np.sin(places[:, 1] / 25e-6)
    for name, more in files.items():
        text = GROUND.replace(
            'roughness = "3 um"\nroughness_length = "20 um"', f'height_map = {{ file = "{name}"{more} }}'
        )
        scene = Scene.from_text(text, str(tmp_path / "scene.toml"))
        ground = plan(scene).target.ground
        assert ground is not None
        assert np.abs(ground.heights(places) * 1e6 - written).max() < 0.1, name
        assert Scene.from_text(scene.to_toml(), str(tmp_path / "elsewhere" / "scene.toml")) == scene


def test_the_normal_is_that_of_the_place_which_a_sphere_touches() -> None:
    """On a plane its angle; in a V of 90 degrees that of the flank towards which the sphere flies; a sphere wider than a groove touches
    its edges, where the slope is the mean of both sides."""
    tilt, v = math.tan(0.35), (0.0, 0.0, -500.0)
    plane = Ground(((0.0, ((-1e-4, -1e-4 * tilt), (1e-4, 1e-4 * tilt))),)).heights
    n = normal_under(plane, (3e-6, -8e-6), 10e-6, v, 1e-6)
    np.testing.assert_allclose(n, (-math.sin(0.35), 0.0, math.cos(0.35)), atol=1e-12)
    vee = Ground(((0.0, ((-20e-6, 0.0), (0.0, -20e-6), (20e-6, 0.0))),)).heights
    for side in (-1.0, 1.0):
        n = normal_under(vee, (0.0, 0.0), 5e-6, (side * 100.0, 0.0, -500.0), 1e-6)
        np.testing.assert_allclose(n, (-side * math.sqrt(0.5), 0.0, math.sqrt(0.5)), atol=1e-12)
    narrow = Ground(((0.0, ((-3e-6, 0.0), (0.0, -3e-6), (3e-6, 0.0))),)).heights
    n = normal_under(narrow, (0.0, 0.0), 15e-6, v, 1e-6)
    assert abs(n[0]) == pytest.approx(math.sin(math.atan(0.5)), abs=0.05)


def test_velocities_are_normal_to_a_slope() -> None:
    """A vertical impact on a slope of 30 degrees has cos 30 of its velocity along the normal, and a gun at 30 degrees from the
    vertical, which faces the slope, all of it."""
    text = GROUND.replace(
        'roughness = "3 um"\nroughness_length = "20 um"', 'diameter = "80 um"\nslope = { angle = "30 deg" }'
    )
    vertical = plan(Scene.from_text(text)).impact
    assert vertical.towards == pytest.approx(500.0 * math.cos(math.radians(30.0)), rel=1e-9)
    assert math.degrees(vertical.angle) == pytest.approx(30.0)
    facing = plan(Scene.from_text(text).with_(particle={"angle": "30 deg"})).impact
    assert facing.towards == pytest.approx(500.0, rel=1e-9)


@pytest.mark.slow
def test_a_particle_that_leaves_a_steep_slope_has_a_verdict(tmp_path: Path) -> None:
    """It leaves along the normal while its centre still sinks."""
    text = GROUND.replace(
        'roughness = "3 um"\nroughness_length = "20 um"', 'diameter = "60 um"\nslope = { angle = "45 deg" }'
    )
    scene = Scene.from_text(text.replace('"20 um"', '"15 um"')).with_(adhesion={"kind": "none"})
    result = run(scene, tmp_path / "run", quiet=True, error=False)
    assert result.verdict == "rebounds"
    assert result.velocity_z_m_s < 0.0 < result.rebound_velocity_m_s


def test_a_map_too_narrow_for_means_of_its_length_is_refused(tmp_path: Path) -> None:
    """The strip of a profilometer: 4 lines of 4001 heights become means of 5 x 5."""
    np.savetxt(tmp_path / "strip.csv", np.zeros((4, 4001)), delimiter=",")
    with pytest.raises(InputError, match="too narrow: 4 rows and 4001 columns become means of 5 x 5"):
        read_heights(tmp_path / "strip.csv")
