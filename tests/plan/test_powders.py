"""Particles that are drawn from a table [coating], of one powder or of a blend."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from coupler import Scene
from coupler.errors import SceneError
from coupler.physics.materials import material

BLEND = """
preset = "draft"

[coating]
number = 60
layers = 3
radius = "60 um"
seed = 3
velocity = "600 m/s"

[[coating.powder]]
material = "Cu"
share = 0.7
sizes = "15-25 um"

[[coating.powder]]
material = "Al1100"
share = 0.3
diameter = "20 um"
hardness = "60 HV"
velocity = "750 m/s"

[substrate]
material = "Al6061"
diameter = "300 um"
height = "80 um"
"""


def masses(scene: Scene, metal: str) -> np.ndarray:
    """Masses (kg) of the particles of one metal."""
    return np.array([material(metal).rho * p.volume for p in scene.particles if p.material == metal])


def test_a_blend_has_its_shares_of_the_mass_and_each_powder_its_own_keys() -> None:
    """Shares to half a particle, as numbers are whole; what a powder leaves out is from [coating]."""
    scene = Scene.from_text(BLEND)
    copper, aluminium = masses(scene, "Cu"), masses(scene, "Al1100")
    assert len(copper) + len(aluminium) == 60
    whole = copper.sum() + aluminium.sum()
    scatter = copper.std() / math.sqrt(len(copper)) * len(copper) / whole  # of the sizes that are drawn
    assert copper.sum() / whole == pytest.approx(0.7, abs=0.5 * aluminium.max() / whole + 2.0 * scatter)
    for p in scene.particles:
        is_copper = p.material == "Cu"
        assert p.velocity == (600.0 if is_copper else 750.0)
        assert p.hardness is None if is_copper else p.hardness == pytest.approx(60 * 9.80665e6)
        assert 14e-6 < p.diameter < 26e-6
    firsts = [p.material for p in scene.particles[:20]]
    assert {"Cu", "Al1100"} == set(firsts)  # mixed, not one after the other


def test_sizes_by_mass_are_drawn_by_number() -> None:
    """The mass of many particles of a sieved powder has its median at the root of the product of the sieves, as a log-normal one has;
    the 5 % of the mass beyond each sieve are left out. 500 particles: to 5 %."""
    head, tail = BLEND[: BLEND.index("[[coating.powder]]")], BLEND[BLEND.index("[substrate]") :]
    head = head.replace("number = 60", "number = 500").replace("layers = 3", "layers = 1")
    text = f'{head}material = "Cu"\nsizes = "15-45 um"\n\n{tail.replace("80 um", "150 um")}'
    D = np.sort([p.diameter for p in Scene.from_text(text).particles])
    below = np.cumsum(D**3) / np.sum(D**3)
    assert np.interp(0.5, below, D) == pytest.approx(math.sqrt(15e-6 * 45e-6), rel=0.05)
    assert D.min() > 14.9e-6
    assert D.max() < 45.1e-6


def test_a_blend_that_is_written_out_is_the_same_scene(tmp_path: Path) -> None:
    scene = Scene.from_text(BLEND, "blend")
    text = scene.to_toml()
    assert Scene.from_text(text, "blend") == scene
    del (raw := tomllib.loads(text))["particle"]
    assert Scene.from_dict(raw, "blend").particles == scene.particles  # drawn again
    assert Scene.from_text(BLEND.replace("seed = 3", "seed = 4")).particles != scene.particles


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("share = 0.3", "share = 0.4", "coating needs shares of its powders that add up to 1: these add up to 1.1"),
        ('"15-25 um"', '"25-15 um"', 'coating.powder[1].sizes = "25-15 um" needs the smaller sieve size first'),
        ('"15-25 um"', '"no.csv"', "coating.powder[1].sizes: the file is missing"),
        ('"Al1100"', '"Unobtainium"', 'coating.powder[2].material = "Unobtainium": unknown material'),
        ('sizes = "15-25 um"', "", "coating.powder[1] needs either diameter"),
        ('sizes = "15-25 um"', 'sizes = "15-25 um"\ncolour = "red"', "coating.powder[1].colour: unknown key"),
        ('velocity = "600 m/s"', "", "coating.powder[1].velocity: missing"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_blend_is_named_by_its_key(before: str, after: str, says: str) -> None:
    text = BLEND.replace(before, after, 1)
    with pytest.raises(SceneError) as error:
        Scene.from_text(text, "blend.toml")
    assert len(error.value.problems) == 1
    assert says in error.value.problems[0]


def test_a_powder_too_rare_for_the_number_of_particles_is_refused() -> None:
    text = BLEND.replace("share = 0.7", "share = 0.999").replace("share = 0.3", "share = 0.001")
    with pytest.raises(
        SceneError,
        match=r"coating.number = 60: powder\[2\] has no particle, because its share is small: give at least \d+ particles",
    ):
        Scene.from_text(text)
