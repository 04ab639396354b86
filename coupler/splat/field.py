"""Volume fraction of metal on a grid, from the carried surface or the points of a body, and the surface that encloses its volume.

Both sources give a smooth field that is 1 in the metal and 0 outside. Its level set is a closed surface without self-intersections.
Features that the smoothing does not resolve are lost: lips thinner than about 1.3 sigma, folds, overlaps.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from ..errors import SplatError
from ..geometry import triangles as triangulated
from ..geometry.triangles import Surface
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

        index = ((x - self.origin) / self.h).T
        return map_coordinates(self.values, index, order=1, mode="constant", cval=0.0, prefilter=False)


def _grid(low: np.ndarray, high: np.ndarray, h: float, margin: float) -> tuple[np.ndarray, tuple[int, ...]]:
    """Centre of the first cell (3,) m, and numbers of cells, of a grid over the box from low to high (3,) m with a margin (m)."""
    # these fractions keep planes and axes of symmetric bodies away from the cell centres
    first = low - margin - np.array([0.377, 0.219, 0.441]) * h
    counts = np.ceil((high + margin - first) / h).astype(int) + 1
    if (cells := np.prod(counts.astype(float))) > MAX_CELLS:
        remedy = "give a larger element size, or check the spacing"
        raise SplatError(f"a grid of {h:.3g} m over the body needs {cells:.2g} cells: {remedy}")
    return first, tuple(counts.tolist())


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
    """Magnitude (nx,ny,nz) of the gradient of a field, with the edge of a cell as unit of length."""
    return np.sqrt(sum(slope**2 for slope in np.gradient(field.values)))


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
    """Fill voids that are smaller than `smallest` m3, and remove separate fragments that are smaller than this volume.

    Returns the field, and the cells (p,3) of each remaining component above the level, largest first.
    """
    from scipy.ndimage import label

    values = field.values.copy()
    gaps, _ = label(values <= level)
    is_small = np.bincount(gaps.ravel()) * field.h**3 < smallest
    values[(gaps > 0) & is_small[gaps]] = 1.0
    parts, _ = label(values > level)
    sizes = np.bincount(parts.ravel()) * field.h**3
    values[(parts > 0) & (sizes < smallest)[parts]] = 0.0
    kept = [i for i in np.argsort(-sizes, kind="stable") if i > 0 and sizes[i] >= smallest]
    return Field(values, field.origin, field.h), [np.argwhere(parts == i) for i in kept]


def contour(field: Field, level: float) -> Surface:
    """Vertices (k,3) m and triangles (m,3), normals outwards, of a level set (marching cubes, Lewiner 2003)."""
    vertices, triangles, _, _ = marching_cubes(field.values, level, gradient_direction="ascent")
    return field.origin + vertices.astype(float) * field.h, triangles.astype(np.int64)


def handles(surface: Surface) -> int:
    """Number of handles (genus) of one closed surface."""
    return 1 - (len(surface[0]) - len(surface[1]) // 2) // 2


def projection(field: Field, level: float, size: float) -> Callable[[np.ndarray], np.ndarray]:
    """A function that moves vertices (k,3) m to the surface on which a field has the value `level`, by two Newton steps of at most
    0.15 size. size (m): size of the elements."""
    gradient = [Field(g, field.origin, field.h) for g in np.gradient(field.values, field.h)]

    def project(x: np.ndarray) -> np.ndarray:
        for _ in range(2):
            slope = np.stack([g.at(x) for g in gradient], axis=1)
            square = np.einsum("ij,ij->i", slope, slope)
            # lower bound on the slope: where the field is flat the distance is unknown
            pull = (level - field.at(x))[:, None] * slope / np.maximum(square, (0.05 / size) ** 2)[:, None]
            length = np.linalg.norm(pull, axis=1)
            x = x + pull * np.minimum(1.0, 0.15 * size / np.maximum(length, 1e-9 * size))[:, None]
        return x

    return project


def correct_volume(parts: list[Surface], target: float, max_offset: float) -> tuple[list[Surface], float]:
    """Closed surfaces, moved along normals so that they enclose `target` m3; and this displacement, m, at most `max_offset`."""
    x, moved = triangulated.correct_volume(*triangulated.together(parts), target, max_offset)
    ends = np.cumsum([len(vertices) for vertices, _ in parts])
    return [(own, triangles) for own, (_, triangles) in zip(np.split(x, ends), parts, strict=False)], moved
