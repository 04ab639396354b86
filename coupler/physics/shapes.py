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
from dataclasses import dataclass

ASPECT = {"sphere": 1.0, "hollow_sphere": 1.0, "oblate": 1.67, "rod": 6.17, "flake": 2.41, "angular": 1.31}
SHAPES = tuple(ASPECT)
HOLLOW_RATIO = 0.5  # inner over outer diameter

# corners of a cuboctahedron, the permutations of (+-1, +-1, 0)
_CORNERS = sorted({p for signs in itertools.product((-1, 1), repeat=2) for p in itertools.permutations((*signs, 0))})
_CUBOCTAHEDRON_VOLUME = 20.0 / 3.0


def sphere_volume(diameter: float) -> float:
    """Volume (m3) of a sphere with a given diameter (m)."""
    return math.pi / 6 * diameter**3


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
        """Extent along z, m, if the shape is rotated by a tilt (rad)."""
        return self._extent(-math.sin(tilt), 0.0, math.cos(tilt))

    def width(self, tilt: float = 0.0) -> float:
        """The larger of the extents along x and y, m, if the shape is rotated by a tilt (rad)."""
        return max(self._extent(math.cos(tilt), 0.0, math.sin(tilt)), self._extent(0.0, 1.0, 0.0))

    def _extent(self, nx: float, ny: float, nz: float) -> float:
        return self.support(nx, ny, nz) + self.support(-nx, -ny, -nz)

    def scaled(self, factor: float) -> "Form":
        """The shape with all lengths multiplied by a factor."""
        a, b, c = (factor * length for length in self.lengths)
        corners = tuple((factor * x, factor * y, factor * z) for x, y, z in self.corners)
        return Form(self.name, (a, b, c), factor * self.thinnest, corners)


def form(name: str, diameter: float) -> Form:
    """The dimensions of a shape with the volume of a sphere of `diameter` m."""
    D, ratio = diameter, ASPECT[name]
    if name == "sphere":
        return Form(name, (D, D, D), D)
    if name == "hollow_sphere":
        outer = D / (1.0 - HOLLOW_RATIO**3) ** (1.0 / 3.0)
        return Form(name, (outer, outer, outer), 0.5 * (1.0 - HOLLOW_RATIO) * outer)
    if name == "oblate":  # D^3 = d^2 t
        d = D * ratio ** (1.0 / 3.0)
        return Form(name, (d, d, d / ratio), d / ratio)
    if name == "rod":  # pi/6 D^3 = pi/6 d^3 + pi/4 d^2 (ratio - 1) d
        d = D / (1.5 * ratio - 0.5) ** (1.0 / 3.0)
        return Form(name, (ratio * d, d, d), d)
    if name == "flake":  # pi/6 D^3 = pi/4 d^3 / ratio
        d = D * (ratio / 1.5) ** (1.0 / 3.0)
        return Form(name, (d, d, d / ratio), d / ratio)
    scale = D * (math.pi / 6.0 / (ratio * _CUBOCTAHEDRON_VOLUME)) ** (1.0 / 3.0)
    corners = tuple((ratio * scale * x, scale * y, scale * z) for x, y, z in _CORNERS)
    return Form(name, (2 * ratio * scale, 2 * scale, 2 * scale), 2 * scale, corners)
