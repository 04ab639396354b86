"""From the points of one body to its tetrahedra: a ladder of ways, each of which has to pass the gates."""

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import SplatError
from ..geometry import tetrahedra
from ..sph.carried_surface import volume
from . import field as fields
from . import quality, stuffing, surface

if TYPE_CHECKING:
    from .convert import Cloud

LEAST_GAMMA = 0.05
LEAST_STEP = 0.05  # of an element size: step length of the worst element; even tetrahedra have some 0.4
VOLUME_BOUND = 0.01
SIGMAS = (0.15, 0.2, 0.25, 0.32, 0.4)  # smoothing over element size
CELLS = 6  # of the grid along an edge of an element, unless that makes more than
MOST_CELLS = 2e6  # ... in all: more cost time on fine clouds and change nothing
POINT_SMOOTHING = 0.6  # least smoothing of a cloud, in spacings: below, single points show
VOID = 30  # spacing^3: smaller voids and crumbs are noise
MOST_SWELL = 0.25  # of an element size, to put the volume right
CREDIBLE = (
    -0.22,
    0.06,
)  # volume inside the carried surface over the points' less 1; beyond, the surface is not the body's


@dataclass(frozen=True)
class Way:
    """One rung of the ladder: where the shape comes from, what fills it, element size over the one asked for, least smoothing."""

    source: str
    filler: str
    factor: float = 1.0
    sigma: float = SIGMAS[0]

    def __str__(self) -> str:
        how = f"{self.source} + {self.filler}"
        return how + (f", size x {self.factor:g}" if self.factor != 1 else "") + (
            f", smoothing {self.sigma:g}" if self.sigma != SIGMAS[0] else "")  # fmt: skip


def ladder(method: str, has_surface: bool) -> list[Way]:
    """The ways a method tries, in order."""
    filled = ((1.0, 0.15, "HXT"), (1.0, 0.25, "HXT"), (0.8, 0.2, "HXT"), (1.0, 0.4, "Delaunay"))
    ways = {
        source: [Way(source, filler, factor, sigma) for factor, sigma, filler in filled]
        for source in ("carried", "density", "paper")
    }
    first = "carried" if has_surface else "density"
    stuffed = [Way(first, "stuffing", factor, sigma) for factor, sigma in ((1.0, 0.25), (0.7, 0.15), (1.0, 0.4))]
    stuffed += [Way("density", "stuffing", factor, sigma) for factor, sigma in ((1.0, 0.25), (0.7, 0.15), (0.5, 0.15))]
    if method == "auto":
        return (ways["carried"] if has_surface else []) + ways["density"] + stuffed
    if method == "stuffing":
        return stuffed
    if method == "paper":
        return [Way("paper", "HXT"), Way("paper", "Delaunay")]
    return ways[method]


@dataclass(frozen=True)
class Shape:
    """The body as a level set. before: volume error (share) of the source as it came; pieces: cells (p,3) of each
    component, largest first; sigma: smoothing over element size; holes: handles of its surface."""

    field: fields.Field
    level: float
    before: float
    pieces: list[np.ndarray]
    shells: list[surface.Surface]
    sigma: float
    holes: int


@dataclass
class Body:
    """The points of one body, those of the others (k,3) m, and the last shape found for it, which the next try may want again."""

    cloud: "Cloud"
    others: np.ndarray
    known: tuple[Any, Shape] | None = None

    def shape(self, source: str, size: float, least: float) -> Shape:
        """See `shape`."""
        if self.known is None or self.known[0] != (source, size, least):
            self.known = (source, size, least), shape(self.cloud, self.others, source, size, least)
        return self.known[1]


def shape(cloud: "Cloud", others: np.ndarray, source: str, size: float, least: float) -> Shape:
    """The least smoothed shape of a cloud whose surface has no handles, or the fewest; others (k,3): points of other bodies.

    Perforated lips are noise that no mesh of this size can follow, hence the search. Raises SplatError where the
    carried surface cannot be that of the points.
    """
    best: Shape | None = None
    for sigma in (s for s in SIGMAS if s >= least):
        made = _shape(cloud, others, source, size, sigma)
        if best is None or made.holes < best.holes:
            best = made
        if made.holes == 0:
            break
    assert best is not None
    return best


def _shape(cloud: "Cloud", others: np.ndarray, source: str, size: float, sigma: float) -> Shape:
    solid = cloud.solid_volume
    small = VOID * cloud.spacing**3
    if source == "carried":
        assert cloud.surface is not None
        h = _cell(cloud.surface[0], size / CELLS)
        metal, inside = fields.of_surface(*cloud.surface, h, max(sigma * size, h))
        if len(others):
            metal = fields.only(metal, cloud.x, others)
            inside = float(metal.values.sum(dtype=float)) * metal.h**3
    else:
        smooth = POINT_SMOOTHING * cloud.spacing * (sigma / SIGMAS[0]) ** 0.35
        h = _cell(cloud.x, min(size / CELLS, 0.5 * cloud.spacing))
        metal = fields.of_points(cloud.x, cloud.current_volume, h, max(smooth, sigma * size, h))
        inside = fields.inside(metal, fields.steepness(metal), 0.5)
    before = inside / solid - 1.0
    if source == "carried" and not CREDIBLE[0] < before < CREDIBLE[1]:
        raise SplatError(f"the carried surface holds {before:+.1%} of the points' volume")
    # noise goes first, for it counts when the level that holds the volume is sought
    metal, _ = fields.clean(metal, 0.5, small)
    level = fields.level_of(metal, solid)
    metal, pieces = fields.clean(metal, level, small)
    if not pieces:
        raise SplatError("nothing is left of the body at this smoothing")
    parts = surface.shells(surface.contour(metal, level), 0.2 * small)
    return Shape(metal, level, before, pieces, parts, sigma, sum(surface.handles(part) for part in parts))


def _cell(x: np.ndarray, h: float) -> float:
    """A cell size h (m) that keeps a grid over x (n,3) within MOST_CELLS."""
    return max(h, float(np.prod(np.ptp(x, axis=0) + 12.0 * h) / MOST_CELLS) ** (1.0 / 3.0))


def attempt(
    way: Way, body: Body, size: float, seconds: dict[str, float]
) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Points (n,3) m, tetrahedra (m,4) and a report of one way. Raises SplatError where it fails or a gate stops it.

    seconds: wall time of each stage, added to.
    """
    size = way.factor * size
    cloud = body.cloud
    solid = cloud.solid_volume
    report: dict[str, Any] = {"element_size_m": size}

    def timed(stage: str, work: Callable[[], Any]) -> Any:
        start = clock.perf_counter()
        made = work()
        seconds[stage] = seconds.get(stage, 0.0) + clock.perf_counter() - start
        return made

    if way.source == "paper":
        from .paper import paper_surface

        skin = timed("surface", lambda: paper_surface(cloud.x, cloud.spacing))
        report["volume_error_before"] = volume(*skin) / solid - 1.0
        parts, most = [skin], cloud.spacing
    else:
        most = MOST_SWELL * size
        form = timed("field", lambda: body.shape(way.source, size, way.sigma))
        report |= {"volume_error_before": form.before, "smoothing": form.sigma, "handles": form.holes}
        if way.filler == "stuffing":
            points, tets = timed("volume", lambda: stuffing.stuff(form.field, form.level, size))
            points, tets = quality.largest(points, tets)
            points, moved = stuffing.swell(points, tets, solid, most)
            report |= {"moved_m": moved} | gates(points, tets, solid, size)
            return points, tets, report
        level_set = surface.LevelSet(form.field, form.level, size)
        parts = timed("surface", lambda: [surface.even(part, size, level_set) for part in _whole(form)])
    parts, moved = surface.swell(parts, solid, most)
    report |= {"moved_m": moved, "surface": [len(part[1]) for part in parts]}
    algorithm = tetrahedra.DELAUNAY if way.filler == "Delaunay" else tetrahedra.HXT
    improve = 0.3 if way.source == "paper" else 0.45
    points, tets = timed("volume", lambda: tetrahedra.fill(parts, size, algorithm, improve))
    report |= gates(points, tets, solid, size, strict=way.source != "paper")
    return points, tets, report


def _whole(form: Shape) -> list[surface.Surface]:
    """The outer surface of the one piece of a shape, and its cavities. Raises SplatError if it is in pieces."""
    outer = [part for part in form.shells if volume(*part) > 0.0]
    if len(outer) != 1:
        raise SplatError(f"the surface falls into {len(outer)} pieces")
    return form.shells


def gates(points: np.ndarray, tets: np.ndarray, solid: float, size: float, strict: bool = True) -> dict[str, Any]:
    """Measures of a mesh of a body of `solid` m3. Raises SplatError with every gate it does not pass.

    Not strict: quality, step length and volume are noted under "missed" only; a mesh that is inverted, open or in pieces
    is refused all the same.
    """
    if len(tets) == 0:
        raise SplatError("no tetrahedra")
    volumes = quality.volumes(points, tets)
    gamma, steps = quality.gamma(points, tets), quality.step_lengths(points, tets)
    found = {
        "tets": len(tets), "nodes": len(points), "volume_m3": float(volumes.sum()), "gamma_min": float(gamma.min()),
        "gamma_mean": float(gamma.mean()), "dihedral_min_deg": float(np.degrees(quality.dihedral_angles(points, tets).min())),
        "step_length_min_m": float(steps.min()),
    }  # fmt: skip
    wrong, poor = [], []
    if inverted := int(np.sum(~(volumes > 0.0))):
        wrong.append(f"{inverted} tetrahedra are inverted")
    if unclosed := surface.open_or_double(quality.boundary(tets)):
        wrong.append(unclosed)
    if (pieces := quality.pieces(points, tets)) != 1:
        wrong.append(f"{pieces} pieces")
    if gamma.min() < LEAST_GAMMA:
        poor.append(f"worst quality {gamma.min():.3f}, allowed {LEAST_GAMMA}")
    if steps.min() < LEAST_STEP * size:
        poor.append(f"smallest step length {steps.min() / size:.3f} of the element size, allowed {LEAST_STEP}")
    if abs(error := found["volume_m3"] / solid - 1.0) > VOLUME_BOUND:
        poor.append(f"volume off by {error:+.1%}")
    if wrong or (strict and poor):
        raise SplatError("; ".join(wrong + poor))
    return found | {"missed": poor}
