"""Volume fraction of metal on a grid, from the carried surface or the points of a body, and the level that encloses its volume.

Both sources give a smooth field that is 1 in the metal and 0 outside. Its level set is a closed surface without self-intersections.
Features that the smoothing does not resolve are lost: lips thinner than about 1.3 sigma, folds, overlaps.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..errors import SplatError
from .kernels import winding

MAX_CELLS = 24_000_000  # of a grid: 100 MB for each array


@dataclass(frozen=True)
class Field:
    """A field on a grid of cells. values (nx,ny,nz): values at the centres origin + (i, j, k) h; origin (3,) m, h (m)."""

    values: np.ndarray
    origin: np.ndarray
    h: float

    def at(self, x: np.ndarray) -> np.ndarray:
        """Values (m,) at points x (m,3) m, linear between the centres, 0 outside the grid."""
        from scipy.ndimage import map_coordinates

        return map_coordinates(self.values, self.index(x), order=1, mode="constant", cval=0.0, prefilter=False)

    def index(self, x: np.ndarray) -> np.ndarray:
        """Grid coordinates (3,m) of points x (m,3) m, in cells, 0 at the first centre."""
        return ((x - self.origin) / self.h).T


def _grid(low: np.ndarray, high: np.ndarray, h: float, margin: float) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Centre of the first cell (3,) m, and numbers of cells, of a grid over the box from low to high (3,) m with a margin (m)."""
    # these fractions keep planes and axes of symmetric bodies away from the cell centres
    first = low - margin - np.array([0.377, 0.219, 0.441]) * h
    counts = np.ceil((high + margin - first) / h).astype(int) + 1
    if np.prod(counts.astype(float)) > MAX_CELLS:
        raise SplatError(
            f"a grid of {h:.3g} m over the body needs {np.prod(counts.astype(float)):.2g} cells: "
            "give a larger element size, or check the spacing"
        )
    return first, (int(counts[0]), int(counts[1]), int(counts[2]))


def of_surface(vertices: np.ndarray, triangles: np.ndarray, h: float, sigma: float) -> tuple[Field, float]:
    """Volume fraction of the solid in cells of h m, smoothed by a Gaussian of standard deviation sigma m. The surface is closed:
    vertices (k,3) m, triangles (m,3) with outward normals.

    Also returns the volume (m3) inside the surface before smoothing; overlaps of the surface with itself count once.
    """
    first, counts = _grid(vertices.min(axis=0), vertices.max(axis=0), h, 3.0 * sigma)
    fine = np.zeros(tuple(2 * n for n in counts), np.int8)
    winding(vertices, triangles.astype(np.int64), first - 0.5 * h, 0.5 * h, fine)
    count = np.zeros(counts, np.int8)
    for i, j, k in np.ndindex(2, 2, 2):
        count += fine[i::2, j::2, k::2] > 0
    share = count.astype(np.float32) / 8.0
    return Field(_smooth(share, sigma / h), first, h), float(share.sum(dtype=float)) * h**3


def of_points(x: np.ndarray, volume: np.ndarray, h: float, sigma: float) -> Field:
    """Volume fraction of points x (n,3) m: the volume (n,) m3 of each point is divided among the eight cells around it, then
    smoothed. h, sigma: as in `of_surface`."""
    first, counts = _grid(x.min(axis=0), x.max(axis=0), h, 4.0 * sigma)
    at = (x - first) / h
    low = np.floor(at).astype(int)
    part = at - low
    share = np.zeros(counts)
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(np.array(corner, bool), part, 1.0 - part), axis=1)
        np.add.at(share, tuple((low + np.array(corner)).T), weight * volume / h**3)
    return Field(_smooth(share.astype(np.float32), sigma / h), first, h)


def _smooth(values: np.ndarray, sigma: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(values, sigma, mode="constant", truncate=3.5)


def steepness(field: Field) -> np.ndarray:
    """Magnitude (nx,ny,nz) of the gradient of a field, per cell."""
    square = np.zeros_like(field.values)
    for axis in range(3):
        square += np.gradient(field.values, axis=axis) ** 2
    return np.sqrt(square)


def inside(field: Field, slope: np.ndarray, level: float) -> float:
    """Volume (m3) in which the field exceeds the level. Cells at the level set count in part. slope: `steepness` of the field."""
    return float(_share(field.values, slope, level).sum(dtype=float)) * field.h**3


def _share(values: np.ndarray, slope: np.ndarray, level: float) -> np.ndarray:
    """Fraction of each cell in which the field exceeds the level, from the value and the slope at its centre."""
    return np.clip(0.5 + (values - level) / np.maximum(slope, 1e-6), 0.0, 1.0)


def level_of(field: Field, volume: float) -> float:
    """The level whose surface encloses a volume (m3), limited to 0.15 to 0.85: beyond, it depends on the tails of the smoothing."""
    near = (field.values > 0.01) & (field.values < 0.99)
    values, slope = field.values[near], steepness(field)[near]
    target = volume / field.h**3 - int(np.sum(field.values >= 0.99))
    low, high = 0.15, 0.85
    for _ in range(20):
        middle = 0.5 * (low + high)
        more = float(_share(values, slope, middle).sum(dtype=float)) > target
        low, high = (middle, high) if more else (low, middle)
    return 0.5 * (low + high)


def only(field: Field, keep: np.ndarray, others: np.ndarray) -> Field:
    """The field in cells that are closer to a point of `keep` (n,3) m than to any point of `others` (k,3) m; 0 in other cells."""
    near = np.argwhere(field.values > 0.01)
    at = field.origin + near * field.h
    own = cKDTree(keep).query(at)[0] <= cKDTree(others).query(at)[0]
    values = np.zeros_like(field.values)
    values[tuple(near[own].T)] = field.values[tuple(near[own].T)]
    return Field(_smooth(values, 0.7), field.origin, field.h)  # smooths the step between the bodies


def clean(field: Field, level: float, smallest: float) -> tuple[Field, list[np.ndarray]]:
    """Fill voids, and remove separate fragments that are smaller than `smallest` m3.

    Returns the field, and the cells (p,3) of each remaining component above the level, largest first.
    """
    from scipy.ndimage import label

    values = field.values.copy()
    gaps, _ = label(values <= level)
    sizes = np.bincount(gaps.ravel()) * field.h**3
    small = np.flatnonzero(sizes < smallest)
    small = small[small != 0]
    if len(small):
        values[np.isin(gaps, small)] = 1.0
    parts, _ = label(values > level)
    sizes = np.bincount(parts.ravel()) * field.h**3
    order = [int(i) for i in np.argsort(-sizes, kind="stable") if i != 0]
    fragments = [i for i in order if sizes[i] < smallest]
    if fragments:
        values[np.isin(parts, fragments)] = 0.0
    kept = [np.argwhere(parts == i) for i in order if i not in fragments]
    return Field(values, field.origin, field.h), kept
