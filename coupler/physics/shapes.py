"""The particle shapes of a scene: their dimensions at equal volume, and their orientation.

The dimensions follow from the diameter of the sphere of equal volume and from the aspect ratios of the paper
(doi:10.1016/j.jestch.2023.101579, 8181 um3 each). The paper shows its shapes without definitions; here they are defined as:

- sphere.
- hollow_sphere: a shell whose inner diameter is half the outer one (the paper gives no wall); the volume is that of the metal.
- oblate: a spheroid, ratio of equatorial diameter to thickness 1.67.
- rod: a cylinder with hemispherical ends, ratio of total length to diameter 6.17.
- flake: a flat disc with a sharp rim, ratio of diameter to thickness 2.41.
- angular: a cuboctahedron (8 triangles, 6 parallelograms, sharp edges) stretched by 1.31 along one axis.

At tilt 0 the longest axis is along x in the plane of the target, and the shortest axis is normal to the target. A tilt rotates the
shape about y: at a positive tilt the end at +x, the direction of an oblique impact, moves towards the target. At 90 deg a rod stands on
its end and a flake on its edge. All shapes are symmetric about their centre.

The shape "file" is a closed surface from a file (`coupler.plan.solids`), in the orientation of the file; its centre of volume is the
centre.
"""

import itertools
import math
import random
from dataclasses import dataclass

import numpy as np

from ..core.arrays import Floats

ASPECT = {"sphere": 1.0, "hollow_sphere": 1.0, "oblate": 1.67, "rod": 6.17, "flake": 2.41, "angular": 1.31}
SHAPES = tuple(ASPECT)
HOLLOW_RATIO = 0.5  # inner over outer diameter

# corners of a cuboctahedron, the permutations of (+-1, +-1, 0)
_CORNERS = sorted({p for signs in itertools.product((-1, 1), repeat=2) for p in itertools.permutations((*signs, 0))})
_CUBOCTAHEDRON_VOLUME = 20.0 / 3.0


def sphere_volume(diameter: float) -> float:
    """Volume (m3) of a sphere with a given diameter (m)."""
    return math.pi / 6 * diameter**3


def in_cylinder(radius: float, half_length: float, x: Floats) -> np.ndarray:
    """Mask (k,) of the points x (k,3) m in a cylinder about z around the origin."""
    return (x[:, 0] ** 2 + x[:, 1] ** 2 < radius**2) & (np.abs(x[:, 2]) < half_length)


@dataclass(frozen=True)
class Form:
    """One shape in one size. lengths: extents (m) along x, y, z at tilt 0; thinnest: smallest thickness of the body or its wall, m;
    corners (m): corners of the polyhedron, or of the convex hull of a file's surface; empty for other shapes."""

    name: str
    lengths: tuple[float, float, float]
    thinnest: float
    corners: tuple[tuple[float, float, float], ...] = ()

    def support(self, nx: float, ny: float, nz: float) -> float:
        """Support function, m: largest extent of the shape at tilt 0 from its centre along the unit vector (nx, ny, nz)."""
        a, b, c = (0.5 * length for length in self.lengths)
        if self.corners:
            return max(nx * x + ny * y + nz * z for x, y, z in self.corners)
        if self.name == "rod":
            return (a - c) * abs(nx) + c
        if self.name == "flake":
            return a * math.hypot(nx, ny) + c * abs(nz)
        if a == c:
            return a
        return math.sqrt((a * nx) ** 2 + (b * ny) ** 2 + (c * nz) ** 2)

    def height(self, tilt: float = 0.0) -> float:
        """Extent along z, m, if the shape is rotated about y by a tilt (rad)."""
        return self._extent(-math.sin(tilt), 0.0, math.cos(tilt))

    def width(self, tilt: float = 0.0) -> float:
        """The larger of the extents along x and y, m, if the shape is rotated about y by a tilt (rad)."""
        return max(self._extent(math.cos(tilt), 0.0, math.sin(tilt)), self._extent(0.0, 1.0, 0.0))

    def _extent(self, nx: float, ny: float, nz: float) -> float:
        return self.support(nx, ny, nz) + self.support(-nx, -ny, -nz)

    def contains(self, x: Floats) -> np.ndarray:
        """Mask (k,) of the points x (k,3) m, from the centre, that lie inside the shape at tilt 0. Not for a shape from a file."""
        a, b, c = (0.5 * length for length in self.lengths)
        if self.name == "rod":
            along = np.clip(x[:, 0], c - a, a - c)
            return (x[:, 0] - along) ** 2 + x[:, 1] ** 2 + x[:, 2] ** 2 < c * c
        if self.name == "flake":
            return in_cylinder(a, c, x)
        if self.name == "angular":
            # faces of the cuboctahedron: |x|, |y|, |z| < 1 and |x| + |y| + |z| < 2
            u = np.abs(x / np.array([a, b, c]))
            return (u.max(axis=1) < 1.0) & (u.sum(axis=1) < 2.0)
        radius = np.einsum("ij,ij->i", x / np.array([a, b, c]), x / np.array([a, b, c]))
        hole = HOLLOW_RATIO**2 if self.name == "hollow_sphere" else 0.0
        return (radius < 1.0) & (radius >= hole)

    def scaled(self, factor: float) -> "Form":
        """The shape with all lengths multiplied by a factor."""
        a, b, c = (factor * length for length in self.lengths)
        corners = tuple((factor * x, factor * y, factor * z) for x, y, z in self.corners)
        return Form(self.name, (a, b, c), factor * self.thinnest, corners)


@dataclass(frozen=True)
class Pores:
    """Closed spherical pores of one particle. diameter m; centres m: at tilt 0, from the centre of the shape."""

    diameter: float
    centres: tuple[tuple[float, float, float], ...]

    @property
    def volume(self) -> float:
        """Volume of all pores, m3."""
        return len(self.centres) * sphere_volume(self.diameter)


WALL = 0.1  # pore diameters: least metal between a pore and the surface, or another pore
_AROUND = 100  # points on a sphere around a pore, which must lie inside the shape
_STARTS, _TRIES = 30, 100  # number of arrangements that are tried, and of random places per pore in each of them


def pores(outer: Form, metal: float, share: float, diameter: float, seed: int) -> Pores:
    """Pores at random places within a shape, wholly inside and apart from each other, the same on all machines.

    outer: the shape with its pores; metal m3: its volume without them; share: volume of the pores over that of the shape; diameter m:
    wanted diameter of a pore; it is changed so that a whole number of pores has this share. Raises ValueError if they do not fit.
    """
    volume = metal * share / (1.0 - share)
    count = max(1, round(volume / sphere_volume(diameter)))
    d = diameter * (volume / count / sphere_volume(diameter)) ** (1.0 / 3.0)
    turn = np.pi * (3.0 - math.sqrt(5.0)) * np.arange(_AROUND)  # Fibonacci's lattice on the sphere
    height = 1.0 - (2.0 * np.arange(_AROUND) + 1.0) / _AROUND
    level = np.sqrt(1.0 - height**2)
    ball = (0.5 + WALL) * d * np.stack([level * np.cos(turn), level * np.sin(turn), height], axis=1)
    dice = random.Random(seed)
    for _ in range(_STARTS):
        centres = list[tuple[float, float, float]]()
        for _ in range(_TRIES * count):
            x, y, z = ((dice.random() - 0.5) * length for length in outer.lengths)
            apart = all(math.dist(other, (x, y, z)) > (1.0 + WALL) * d for other in centres)
            if apart and outer.contains(ball + np.array([x, y, z])).all():
                centres.append((x, y, z))
            if len(centres) == count:
                return Pores(d, tuple(centres))
    raise ValueError(f"{count} pores of {d * 1e6:.3g} um do not fit: give a smaller porosity or pore_diameter")


def form(name: str, diameter: float) -> Form:
    """The dimensions of a shape with the volume of a sphere of `diameter` m."""
    D, ratio = diameter, ASPECT[name]
    if name == "sphere":
        return Form(name, (D, D, D), D)
    if name == "hollow_sphere":
        outer = D / (1.0 - HOLLOW_RATIO**3) ** (1.0 / 3.0)
        return Form(name, (outer, outer, outer), 0.5 * (1.0 - HOLLOW_RATIO) * outer)
    if name in ("oblate", "flake"):  # oblate: D^3 = d^2 t; flake: pi/6 D^3 = pi/4 d^3 / ratio
        d = D * (ratio / (1.0 if name == "oblate" else 1.5)) ** (1.0 / 3.0)
        return Form(name, (d, d, d / ratio), d / ratio)
    if name == "rod":  # pi/6 D^3 = pi/6 d^3 + pi/4 d^2 (ratio - 1) d
        d = D / (1.5 * ratio - 0.5) ** (1.0 / 3.0)
        return Form(name, (ratio * d, d, d), d)
    scale = D * (math.pi / 6.0 / (ratio * _CUBOCTAHEDRON_VOLUME)) ** (1.0 / 3.0)
    corners = tuple((ratio * scale * x, scale * y, scale * z) for x, y, z in _CORNERS)
    return Form(name, (2 * ratio * scale, 2 * scale, 2 * scale), 2 * scale, corners)
