"""Rough ground: mean, Sa and correlation of the heights, and the mesh below."""

import numpy as np
import pytest

from coupler import Scene
from coupler.errors import SceneError
from coupler.fe.mesh import prepare
from coupler.geometry.mesher import cylinder
from coupler.geometry.rough import heights, roughened
from coupler.geometry.tetrahedra import volumes

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
    for over in (0.5, 1.0, 1.5):
        found = []
        for seed in range(8):
            h, beside = (heights(at, D, SA, LENGTH, seed) for at in (places, places + np.array([over * LENGTH, 0.0])))
            found.append(np.mean(h * beside) / np.mean(h * h))
        assert np.mean(found) == pytest.approx(np.exp(-(over**2)), abs=0.05)


def test_a_seed_is_one_surface_and_another_seed_another() -> None:
    places = disc(20e-6)
    once, again, other = (heights(places, D, SA, LENGTH, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(once, again)
    assert abs(np.corrcoef(once, other)[0, 1]) < 0.3


def test_the_mesh_follows_the_surface_and_keeps_its_bottom_and_its_sides() -> None:
    """Every element keeps a positive volume; facets are told by where they look, as those of a rough top lie at many heights."""
    points, tets = cylinder(100e-6, 60e-6, 4e-6, 20e-6, 0.35)
    moved = roughened(points, 60e-6, 100e-6, 2e-6, 16e-6, 1)
    flat, rough = prepare(points, tets), prepare(moved, tets)
    assert (volumes(rough.points, rough.conn) > 0.0).all()
    assert {name: len(ids) for name, ids in rough.sets.items()} == {name: len(ids) for name, ids in flat.sets.items()}
    top = np.unique(rough.facets[rough.sets["top"]])
    at = rough.points[top]
    np.testing.assert_allclose(at[:, 2], heights(at[:, :2], 100e-6, 2e-6, 16e-6, 1), atol=1e-12)
    np.testing.assert_allclose(rough.points[np.unique(rough.facets[rough.sets["bottom"]]), 2], -60e-6, atol=1e-12)


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
