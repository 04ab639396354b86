"""Scenes that several test files run, coarse enough for about a second of processor time each."""

import pytest

from coupler.errors import SceneError
from coupler.plan.reading import Scene

LEAST = {
    "particle": {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"},
    "substrate": {"material": "SS304"},
}


def scene_with(**changes):
    """The least scene with some values changed, as particle__diameter="30 um"."""
    data = {key: dict(table) for key, table in LEAST.items()}
    for path, value in changes.items():
        section, _, field = path.partition("__")
        if field:
            data.setdefault(section, {})[field] = value
        else:
            data[section] = value
    return Scene.from_dict(data)


def several(*particles, **changes):
    """A scene of several impacts, each given by what differs from the particle of the least scene."""
    return scene_with(particle=[LEAST["particle"] | dict(particle) for particle in particles], **changes)


def problems_with(**changes):
    with pytest.raises(SceneError) as caught:
        scene_with(**changes)
    return caught.value.problems


STEEL = """[substrate]
material = "SS304"
diameter = "{diameter} um"
height = "{height} um"
{more}"""


def scene(
    *particles: tuple[str, float, float],
    spacing: float = 3.0,
    element_size: float = 4.5,
    diameter: float = 120,
    height: float = 60,
    end: float | None = None,
    of_particle: str = "",
    of_substrate: str = "",
    more: str = "",
    tied: bool = True,
    every: float = 10,
) -> str:
    """TOML of impacts on SS304, one after another.

    particles: material, diameter in um, velocity in m/s of each. spacing, element_size, diameter, height: um. end: ns.
    of_particle, of_substrate: further lines of these tables. more: further tables. tied: splats of several
    impacts stick wherever they touch, and come one at once after another. every: ns between written steps; to write one costs as
    much as to compute for some ns.
    """
    head = "[particle]" if len(particles) == 1 else '[[particle]]\ndwell = "0 us"'
    lines = [
        f'{head}\nmaterial = "{material}"\ndiameter = "{size} um"\nvelocity = "{velocity} m/s"\n{of_particle}'
        for material, size, velocity in particles
    ]
    lines.append(STEEL.format(diameter=diameter, height=height, more=of_substrate))
    lines.append(f'[resolution]\nspacing = "{spacing} um"\nelement_size = "{element_size} um"\n')
    if end is not None or len(particles) > 1:
        lines.append(f'[end]\ntime = "{end} ns"\n' if end is not None else '[end]\nat = "rest"\n')
    lines.append(f'[output]\nevery = "{every} ns"\n')
    if tied and len(particles) > 1:
        lines.append('[adhesion]\nkind = "tied"\n')
    return "".join(lines) + more


SMALL = """
[particle]
material = "Ni"
diameter = "10 um"
velocity = "500 m/s"
[substrate]
material = "SS304"
diameter = "60 um"
height = "30 um"
[end]
time = "3 ns"
"""
NI = scene(("Ni", 25, 500), every=2)  # 300 points, to its end at about 50 ns
TINY = {"spacing": 3.4, "element_size": 6.0, "diameter": 100, "height": 50}
WHOLE = scene(("Ni", 25, 500), **TINY, every=5)  # 200 points, to its end at about 50 ns
# 200 points; 10 ns: deep in contact, still going down
SHORT = scene(("Ni", 25, 500), **TINY, end=10, every=2)
# the first splat becomes a body, the second particle is in contact with it for its last 10 ns
SHORT_DOUBLE = scene(("Ni", 25, 500), ("Ti", 25, 450), **TINY, end=15, every=2)
# two splats, to ambient
COLD = scene(("Ni", 20, 550), ("Ni", 20, 550), **TINY | {"spacing": 2.7, "element_size": 5.0})
COLD = COLD.replace("[substrate]", '[substrate]\nsides = "half_space"\nbottom = "half_space"')
COLD = COLD.replace('dwell = "0 us"', "").replace('at = "rest"', 'at = "cold"')
COATING = """
preset = "draft"
[coating]
material = "Ni"
number = 40
layers = 4
radius = "36 um"
diameter = "22 um"
spread = 1.16
smallest = "18 um"
largest = "27 um"
velocity = [["18 um", "610 m/s"], ["25 um", "500 m/s"]]
velocity_spread = "20 m/s"
temperature = "400 K"
shapes = { sphere = 0.5, oblate = 0.5 }
seed = 3
[substrate]
material = "SS304"
"""


def three(*offsets: float) -> str:
    """200-point particles for 10 ns, windows of 32 um, at these places (um) along x."""
    head, *particles = scene(
        ("Ni", 20, 550), ("Ni", 20, 550), ("Ti", 20, 500), spacing=2.7, element_size=5.0, diameter=180, height=50, end=10, every=5,
        of_substrate='window = "32 um"\n',
    ).split("[[particle]]\n")  # fmt: skip
    placed = [f'[[particle]]\noffset = ["{x} um", "0 um"]\n{p}' for x, p in zip(offsets, particles, strict=True)]
    return head + "".join(placed)


SIDE = three(-42, 42, -36)  # two side by side, then one on the first splat
