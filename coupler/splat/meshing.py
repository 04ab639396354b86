"""Meshing of the points of one body with tetrahedra. There are several strategies; all meshes must satisfy the same limits."""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from ..errors import SplatError
from ..geometry import mesher
from ..geometry.apart import apart
from ..geometry.remesh import even
from ..geometry.solid import check_solid
from ..geometry.tetrahedra import boundary_faces, volumes
from ..geometry.triangles import Surface, enclosed_volume, open_or_double
from ..geometry.triangles import shells as shells_of
from . import field as fields
from . import quality
from .cloud import Cloud, Report

T = TypeVar("T")
TIME_LIMIT = 120.0  # s, of gmsh in one attempt
MIN_GAMMA = 0.05  # smallest quality of an element (`quality.gamma`)
MIN_STEP_LENGTH = 0.05  # smallest `quality.step_lengths` divided by the element size; regular tetrahedra have about 0.4
MAX_VOLUME_ERROR = 0.01  # relative
SIGMAS = (0.15, 0.2, 0.25, 0.32, 0.4)  # smoothing lengths divided by the element size
# cells of the grid along an edge of an element, and largest number of cells in total: more take time and do not change the result
CELLS, MAX_CELLS = 6, 2e6
POINT_SMOOTHING = 0.6  # smallest smoothing length of a cloud, in spacings: with a smaller one single points are visible
MIN_VOID = 30  # spacing^3: smaller voids and fragments are noise
MAX_OFFSET = 0.25  # of an element size: largest offset of the surface to correct the volume
# Limits of the relative difference between the volumes of carried surface and points: outside them the surface is wrong.
CARRIED_VOLUME_ERROR = (-0.22, 0.06)


@dataclass(frozen=True)
class Strategy:
    """A method to mesh a body. source: origin of the shape, "carried" or "density"; mesher: key in `mesher.ALGORITHMS`; factor: the
    element size is multiplied by it; sigma: smallest smoothing length divided by the element size."""

    source: str
    mesher: str
    factor: float = 1.0
    sigma: float = SIGMAS[0]

    def __str__(self) -> str:
        size = f", size x {self.factor:g}" if self.factor != 1 else ""
        smoothing = f", smoothing {self.sigma:g}" if self.sigma != SIGMAS[0] else ""
        return f"{self.source} + {self.mesher}{size}{smoothing}"


def strategies(method: str, has_surface: bool) -> list[Strategy]:
    """The strategies of a method (`convert.METHODS`), in the order of attempts."""
    sources = [method] if method != "auto" else ["carried", "density"] if has_surface else ["density"]
    settings = ("HXT", 1.0, 0.15), ("HXT", 1.0, 0.25), ("HXT", 0.8, 0.2), ("Delaunay", 1.0, 0.4)
    return [Strategy(source, *setting) for source in sources for setting in settings]


@dataclass(frozen=True)
class Shape:
    """The shape of a body as a level set of a field. volume_error: relative error of the volume before its correction; pieces: cells
    (p,3) of each component, largest first; shells: closed surfaces; handles: number of handles of the surfaces."""

    field: fields.Field
    level: float
    volume_error: float
    pieces: list[np.ndarray]
    shells: list[Surface]
    handles: int


@dataclass
class CloudShape:
    """The points of one body, points of other bodies (k,3) m, and the last result of `find` with its arguments (cache)."""

    cloud: Cloud
    others: np.ndarray
    cache: tuple[tuple[str, float, float], Shape] | None = None

    def find(self, source: str, size: float, least_sigma: float) -> Shape:
        """The shape without handles that has the smallest smoothing length; if all have handles, the shape with the fewest.

        size: size of the elements, m; least_sigma: least smoothing length divided by `size`. Handles are holes in thin lips, too small
        for this mesh. Raises SplatError if surface and points differ in volume, or if nothing remains after the smoothing.
        """
        key = source, size, least_sigma
        if self.cache is None or self.cache[0] != key:
            shapes: list[Shape] = []
            for sigma in (s for s in SIGMAS if s >= least_sigma):
                shapes.append(smoothed_shape(self.cloud, self.others, source, size, sigma))
                if shapes[-1].handles == 0:
                    break
            self.cache = key, min(shapes, key=lambda shape: shape.handles)
        return self.cache[1]


def smoothed_shape(cloud: Cloud, others: np.ndarray, source: str, size: float, sigma: float) -> Shape:
    """The shape of a cloud for one smoothing length. others (k,3) m: points of other bodies; size (m): size of the elements; sigma:
    smoothing length divided by the element size."""
    solid, min_void = cloud.solid_volume, MIN_VOID * cloud.spacing**3
    if source == "carried":
        assert cloud.surface is not None
        h = _cell_size(cloud.surface[0], size / CELLS)
        metal, inside = fields.of_surface(*cloud.surface, h, max(sigma * size, h))
        if len(others):
            metal = fields.only(metal, cloud.x, others)
            inside = float(metal.values.sum(dtype=float)) * metal.h**3
    else:
        smooth = POINT_SMOOTHING * cloud.spacing * (sigma / SIGMAS[0]) ** 0.35
        h = _cell_size(cloud.x, min(size / CELLS, 0.5 * cloud.spacing))
        metal = fields.of_points(cloud.x, cloud.current_volume, h, max(smooth, sigma * size, h))
        inside = fields.inside(metal, fields.steepness(metal), 0.5)
    error = inside / solid - 1.0
    if source == "carried" and not CARRIED_VOLUME_ERROR[0] < error < CARRIED_VOLUME_ERROR[1]:
        raise SplatError(
            f"the volume in the carried surface differs by {error:+.1%} from the points' volume: use method 'density'"
        )
    # noise is removed first, because its volume would change the level
    metal, _ = fields.clean(metal, 0.5, min_void)
    level = fields.level_of(metal, solid)
    metal, pieces = fields.clean(metal, level, min_void)
    if not pieces:
        raise SplatError("the body is so thin or small that the smoothing removes it")
    shells = shells_of(fields.contour(metal, level), 0.2 * min_void)
    return Shape(metal, level, error, pieces, shells, sum(map(fields.handles, shells)))


def _cell_size(x: np.ndarray, h: float) -> float:
    """The smallest cell size (m), not below h, with which a grid around x (n,3) m has at most MAX_CELLS cells."""
    return max(h, float(np.prod(np.ptp(x, axis=0) + 12.0 * h) / MAX_CELLS) ** (1.0 / 3.0))


def build_mesh(
    strategy: Strategy, body: CloudShape, size: float, seconds: dict[str, float]
) -> tuple[np.ndarray, np.ndarray, Report]:
    """Mesh a body with one strategy: points (n,3) m, tetrahedra (m,4) and report. size (m): size of the elements.

    Adds the wall time of each stage to `seconds`. Raises SplatError if a stage fails or the mesh is outside a limit.
    """
    size, solid = strategy.factor * size, body.cloud.solid_volume
    report: Report = {"element_size_m": size}

    def timed(stage: str, work: Callable[[], T]) -> T:
        start = clock.perf_counter()
        result = work()
        seconds[stage] = seconds.get(stage, 0.0) + clock.perf_counter() - start
        return result

    shape = timed("field", lambda: body.find(strategy.source, size, strategy.sigma))
    report["volume_error_before"] = shape.volume_error
    if (outer := sum(enclosed_volume(*shell) > 0.0 for shell in shape.shells)) != 1:
        raise SplatError(f"the surface consists of {outer} separate pieces")
    project = fields.projection(shape.field, shape.level, size)
    shells = timed("surface", lambda: [even(*shell, size, project) for shell in shape.shells])
    shells, moved = fields.correct_volume(shells, solid, MAX_OFFSET * size)
    report |= {"moved_m": moved, "surface": [len(shell[1]) for shell in shells]}
    for shell in shells:
        check_solid(*shell)
    points, tets = timed("volume", lambda: apart(partial(mesher.fill, shells, size, strategy.mesher), TIME_LIMIT))
    report |= check_mesh(points, tets, solid, size)
    return points, tets, report


def check_mesh(points: np.ndarray, tets: np.ndarray, solid: float, size: float) -> Report:
    """Quality measures of a mesh with points (n,3) m and tets (m,4). solid: exact volume of the body, m3; size: element size, m.
    Raises SplatError with all limits that the mesh exceeds."""
    volume = volumes(points, tets)
    gamma, steps = quality.gamma(points, tets), quality.step_lengths(points, tets)
    report: Report = {
        "tets": len(tets), "nodes": len(points), "volume_m3": float(volume.sum()), "gamma_min": float(gamma.min()),
        "gamma_mean": float(gamma.mean()), "dihedral_min_deg": float(np.degrees(quality.dihedral_angles(points, tets).min())),
        "step_length_min_m": float(steps.min()),
    }  # fmt: skip
    wrong = []
    if inverted := int(np.sum(~(volume > 0.0))):
        wrong.append(f"{inverted} tetrahedra are inverted")
    if unclosed := open_or_double(boundary_faces(tets)[0]):
        wrong.append(unclosed)
    if (pieces := quality.pieces(points, tets)) != 1:
        wrong.append(f"the mesh consists of {pieces} separate pieces")
    if gamma.min() < MIN_GAMMA:
        wrong.append(f"worst element quality gamma {gamma.min():.3f}, required at least {MIN_GAMMA}")
    if steps.min() < MIN_STEP_LENGTH * size:
        wrong.append(
            f"smallest step length {steps.min() / size:.3f} of the element size, required at least {MIN_STEP_LENGTH}"
        )
    if abs(error := report["volume_m3"] / solid - 1.0) > MAX_VOLUME_ERROR:
        wrong.append(f"volume differs from that of the body by {error:+.1%}")
    if wrong:
        raise SplatError("; ".join(wrong))
    return report
