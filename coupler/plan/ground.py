"""The shape of the surface of a substrate, from its groove, step, slope and map of heights."""

import math
from functools import cache
from pathlib import Path

import numpy as np

from ..files.height_maps import IMAGES, read_heights
from ..files.inputs import InputError
from ..geometry.raycast import RaySurface
from ..geometry.rough import Ground
from ..scene.ground import HeightMap, Substrate

_MOST_SAMPLES = 400  # across the substrate
_DECIMALS = 10  # of a height in m


def ground_of(body: Substrate, element_size: float) -> Ground | None:
    """The shape of the surface without its roughness; None: flat. element_size m: length over which maps are averaged. Raises
    InputError, SplatError and StoreError for a map that cannot be used."""
    profiles: list[tuple[float, tuple[tuple[float, float], ...]]] = []
    if (g := body.groove) is not None:
        half, flank = 0.5 * g.width, g.depth / math.tan(g.angle)
        inner = max(half - flank, 0.0)
        profiles.append((g.direction, ((-half, 0.0), (-inner, -g.depth), (inner, -g.depth), (half, 0.0))))
    if (s := body.step) is not None:
        half = 0.5 * s.height / math.tan(s.angle)
        profiles.append((s.direction, ((-half, 0.0), (half, s.height))))
    if (tilt := body.slope) is not None:
        far = body.diameter
        profiles.append((tilt.direction, ((-far, -far * math.tan(tilt.angle)), (far, far * math.tan(tilt.angle)))))
    if body.height_map is None:
        return Ground(tuple(profiles)) if profiles else None
    pitch = max(0.5 * element_size, body.diameter / _MOST_SAMPLES)
    path = Path(body.height_map.file)
    changed = path.stat().st_mtime_ns if path.is_file() else 0
    return Ground(tuple(profiles), _grid(body.height_map, changed, body.diameter, pitch), pitch)


@cache
def _grid(table: HeightMap, changed: int, diameter: float, pitch: float) -> tuple[tuple[float, ...], ...]:
    """Heights (m) of a map on a grid of this pitch (m), as `Ground.grid`, minus their mean over the substrate. A Gaussian filter with
    a standard deviation of one pitch then smooths them. changed: time stamp of the file, for the cache."""
    half = math.ceil(0.5 * diameter / pitch)
    axis = pitch * np.arange(-half, half + 1)
    places = np.stack(np.meshgrid(axis, axis), axis=-1)
    inside = np.hypot(places[..., 0], places[..., 1]) <= 0.5 * diameter
    path = Path(table.file)
    if path.suffix.lower() in IMAGES and table.height is None:
        raise InputError(path, 'is an image: give height = "10 um", the height of white over black')
    x, triangles = read_heights(path)
    x = (x - 0.5 * (x.min(axis=0) + x.max(axis=0))) * [table.unit, table.unit, table.height or table.unit]
    line, height, _ = RaySurface(x, triangles, closed=False).on_verticals(*places[inside].T)
    top = np.full(inside.sum(), -np.inf)
    np.maximum.at(top, line, height)  # seen from above
    z = np.zeros(inside.shape)
    z[inside] = top
    if np.isinf(top).any():
        at = float(np.hypot(*places[np.isinf(z)].T).min())
        lacks = f"has no height at {at * 1e6:.3g} um from its middle, but the substrate has a radius of {diameter * 5e5:.3g} um"
        give = "give a larger unit, a larger map without holes, or a smaller substrate.diameter"
        raise InputError(table.file, f"{lacks}: {give}")
    from scipy.ndimage import gaussian_filter  # its import takes longer than all others of a plan

    shares = gaussian_filter(inside.astype(float), 1.0)  # weight of the disc in each average
    z = gaussian_filter(np.where(inside, z - z[inside].mean(), 0.0), 1.0) / np.maximum(shares, 1e-3)
    return tuple(tuple(row) for row in np.round(z, _DECIMALS).tolist())
