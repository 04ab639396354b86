"""The cross-section of a track: its growth pass by pass, with the deposition efficiency at the local angle of impact.

The beam is parallel and inclined by the angle a of the gun from the z axis, towards +x; each line of the gun runs along y. With
s = x cos a + z sin a, the position across the beam, a pass brings the mass g(s) ds (`Spot.table`). On a surface of slope tan b the
angle of impact is |b - a|, and the height h(x) grows by

    dh = dA g(s) (cos a + h' sin a) E(|b - a|),   tan b = h',

dA: cross-section of the powder at the density of the metal. A point is in the shade, and gets nothing, if a
point on the side of the gun has the same or a larger s. The scheme is that of Lax and Friedrichs with local speeds, monotone and of
first order in the width of a cell: Osher & Shu (1991), SIAM J. Numer. Anal. 28, 907. With a constant E it conserves the mass.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .spot import Spot

CELLS = 200  # of the radius of the spot
LEAST = 20  # increments of a pass
_COURANT = 0.5
_LOW, _HIGH = 0.2, 0.8  # shares of the height between which a flank is measured
_STEEPEST = math.radians(89.9)  # slope of a surface in the table of speeds

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gun:
    """A gun with its powder. angle: angle of the beam to the z axis, rad; area: cross-section (m2) of all powder of one pass, without
    pores: the feed rate divided by the density of the metal and the speed of the gun. efficiency (n,): deposition efficiency, 0 to 1,
    at the ascending angles of impact `angles` (n,) rad from the surface normal."""

    spot: Spot
    angle: float
    area: float
    angles: Array
    efficiency: Array

    def efficiency_at(self, slope: Array) -> Array:
        """Deposition efficiency on a surface whose slope has these angles (rad)."""
        return np.asarray(np.interp(np.abs(slope - self.angle), self.angles, self.efficiency), np.float64)

    @cached_property
    def _speed(self) -> tuple[Array, Array]:
        """Slope angles b (rad) of a surface, and the derivative |dr/dh'| of the growth rate r = (cos a + h' sin a) E at each angle. a:
        angle of the gun; h' = tan b; E: deposition efficiency."""
        b = np.linspace(-_STEEPEST, _STEEPEST, 1799)
        rate = np.maximum(np.cos(b - self.angle), 0.0) / np.cos(b) * self.efficiency_at(b)
        return 0.5 * (b[1:] + b[:-1]), np.abs(np.diff(rate) / np.diff(np.tan(b)))

    def spray(self, lines: Sequence[float] | Array, cells: int = CELLS, least: int = LEAST) -> tuple[Array, Array]:
        """Positions x (n,) m of cells, and heights (n,) m there after passes over a flat surface z = 0. lines: x (m) of the passes, in
        their order. cells: number of cells over the radius of the spot; least: least number of increments of a pass."""
        high = len(lines) * self.area * float(self.spot.across(0.0))
        room = 1.05 * self.spot.reach / math.cos(self.angle) + high * math.tan(self.angle)
        low, top = min(lines) - room, max(lines) + room
        count = math.ceil((top - low) / self.spot.reach * cells)
        edges = np.linspace(low, top, count + 1)
        h = np.zeros(count)
        for line in lines:
            left = 1.0
            while left > 0.0:
                left -= self.increment(edges, h, line, min(left, 1.0 / least))
        return 0.5 * (edges[1:] + edges[:-1]), h

    def increment(self, edges: Array, h: Array, line: float, most: float) -> float:
        """Add a share of a pass, at most `most`, to the heights h (n,) m of cells of equal width. Returns the share. edges (n + 1,):
        limits of the cells in x, m; line: x of the pass, m."""
        s, density, below = self.spot.table
        dx, cos, sin = edges[1] - edges[0], math.cos(self.angle), math.sin(self.angle)
        padded = np.concatenate([h[:1], h, h[-1:]])
        at = 0.5 * (padded[1:] + padded[:-1])
        across = (edges - line) * cos + at * sin
        share = np.diff(np.interp(np.maximum.accumulate(across), s, below))
        gain = share / dx * self.efficiency_at(np.arctan(np.diff(at) / dx))
        lit = np.interp(0.5 * (across[1:] + across[:-1]), s, density, 0.0, 0.0) * (share > 0.0)
        # equal for all points, because s depends on h; its term conserves the mass
        drift = sin * float(self.efficiency.max())
        sides = np.interp(np.arctan(np.diff(padded) / dx), *self._speed)
        speed = np.maximum(np.maximum(sides[1:], sides[:-1]), drift)
        fastest = float((lit * speed).max())
        part = min(most, _COURANT * dx / (self.area * fastest)) if fastest > 0.0 else most
        faces = 0.5 * drift * (lit[1:] + lit[:-1]) * np.diff(h)
        gain += 0.5 / dx * (lit * (speed - drift) * np.diff(padded, 2) + np.diff(faces, prepend=0.0, append=0.0))
        h += part * self.area * gain
        return part


def measures(x: Array, h: Array, fed: float) -> dict[str, float]:
    """Measures of a cross-section, SI: height; width at half of the height; mean angles of the flanks between _LOW and _HIGH of the
    height; area; efficiency. x, h (n,) m: positions and heights of cells of equal width; fed: area of all powder, m2."""
    top, height, area = int(h.argmax()), float(h.max()), float(h.sum() * (x[1] - x[0]))
    left, right = slice(top + 1), slice(None, top - 1 if top else None, -1)
    sides = [np.interp(np.array([_LOW, 0.5, _HIGH]) * height, np.maximum.accumulate(h[k]), x[k]) for k in (left, right)]
    flanks = [math.atan2((_HIGH - _LOW) * height, abs(float(side[2] - side[0]))) for side in sides]
    return {
        "height_m": height, "width_m": float(sides[1][1] - sides[0][1]), "flank_left_rad": flanks[0],
        "flank_right_rad": flanks[1], "area_m2": area, "efficiency": area / fed,
    }  # fmt: skip


def waves(x: Array, h: Array, step: float, middle: float = 0.0) -> dict[str, float]:
    """Mean height and waviness (largest minus smallest height) over a step of a raster about `middle`. All lengths in m."""
    low, high, dx = middle - 0.5 * step, middle + 0.5 * step, x[1] - x[0]
    below = np.interp([low, high], x + 0.5 * dx, np.cumsum(h) * dx)
    wave = float(np.ptp(h[(x >= low) & (x <= high)]))
    return {"step_m": step, "thickness_m": float(below[1] - below[0]) / step, "waviness_m": wave}
