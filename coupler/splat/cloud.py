"""Records of a conversion: cloud of points, bodies made of tetrahedra, reports."""

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, TypeAlias

import numpy as np
from scipy.spatial import cKDTree

from ..core.records import Rows, arrays_of, rows_of
from ..errors import SplatError
from ..geometry.triangles import open_or_double
from ..physics.metal import MetalState

MIN_POINTS = 50  # of a body
#: Mesh report of one body, or of a whole splat: sums or worst values over its bodies; all other keys are of its largest body. failed:
#: strategies that failed before, with reasons; surface: number of triangles of each closed surface; volume_error_before: relative error
#: before the surface is moved by moved_m; outside_half, outside_max: see `quality.fit_of`; transfer: see `transfer.transfer`.
Report: TypeAlias = dict[str, Any]

MAX_BOX = 5e7  # largest volume of the box around a cloud, in spacing^3: it limits the grid of the density
LARGEST = 1e30  # of any value, SI: its square is still finite


@dataclass(frozen=True)
class Cloud(MetalState):
    """Points of one splat and their state; unknown fields are None. SI units.

    x (n,3); volume (n,): reference volume of each point; spacing: spacing of the undeformed points, the edge of a cube of this
    volume; rho: reference density; velocity (n,3); stress (n,6): Cauchy, Voigt xx yy zz yz xz xy; J (n,): volume ratio; energy (n,):
    J per reference m3; core (n,): mask of the points of the core; surface: vertices (k,3) and triangles (m,3) of the
    deformed carried surface, including cavities, normals outwards; wave_speed: for the explicit time step in the report.
    """

    x: Annotated[np.ndarray, Rows(3)]
    volume: Annotated[np.ndarray, Rows()]
    spacing: float
    rho: float
    velocity: Annotated[np.ndarray | None, Rows(3)] = None
    stress: Annotated[np.ndarray | None, Rows(6)] = None
    J: Annotated[np.ndarray | None, Rows()] = None
    energy: Annotated[np.ndarray | None, Rows()] = None
    core: Annotated[np.ndarray | None, Rows(dtype=np.bool_)] = None
    surface: tuple[np.ndarray, np.ndarray] | None = None
    wave_speed: float | None = None

    @property
    def mass(self) -> np.ndarray:
        """Mass (n,) kg of each point."""
        return self.rho * self.volume

    @property
    def current_volume(self) -> np.ndarray:
        """Volume (n,) m3 of each point in the deformed state."""
        return self.volume if self.J is None else self.volume * self.J

    @property
    def solid_volume(self) -> float:
        """Sum of the current volumes of all points, m3."""
        return float(self.current_volume.sum())

    def part(self, index: np.ndarray) -> "Cloud":
        """The cloud of only the points `index` (p,), but with the whole surface."""
        kept: dict[str, Any] = {name: array[index] for name, array in self._known().items()}
        return replace(self, **kept)

    def _known(self) -> dict[str, np.ndarray]:
        return {name: array for name, array in arrays_of(self).items() if array is not None}

    def check(self) -> None:
        """Raise SplatError, with a remedy, if the cloud cannot be meshed."""
        x = np.asarray(self.x)
        n = len(x)
        if n < MIN_POINTS:
            remedy = "use a smaller spacing of the points"
            raise SplatError(f"the cloud has {n} points, but {MIN_POINTS} or more are needed: {remedy}")
        for name, values in self._known().items():
            shape, has = (n, *rows_of(self)[name].shape[1:]), np.shape(values)
            if has != shape:
                raise SplatError(f"{name} must have the shape {shape}, but has {has}: give a row for each point")
            bad = np.flatnonzero(~(np.abs(np.asarray(values).reshape(n, -1)) < LARGEST).all(axis=1))
            if len(bad):
                wrong = f"is not a number, or beyond {LARGEST:g} (first: point {bad[0]})"
                raise SplatError(f"{name} of {len(bad)} points {wrong}: remove or correct these points")
        for name, value in {"spacing": self.spacing, "rho": self.rho}.items():
            if not 1.0 / LARGEST < value < LARGEST:
                raise SplatError(f"{name} must be positive and below {LARGEST:g}, not {value:g}: give it in SI units")
        if not np.min(self.volume) > 0.0 or (self.J is not None and not np.min(self.J) > 0.0):
            raise SplatError("volume and J of every point must be positive: correct or remove points with other values")
        self._check_places(x)
        if self.surface is not None:
            vertices, triangles = self.surface
            if not (np.abs(vertices) < LARGEST).all():
                remedy = "correct them, or leave the surface out"
                raise SplatError(f"vertices of the surface are not numbers, or beyond {LARGEST:g}: {remedy}")
            if problem := open_or_double(np.asarray(triangles, np.int64)):
                raise SplatError(f"the surface is not closed ({problem}): correct it, or leave it out")

    def _check_places(self, x: np.ndarray) -> None:
        box = float(np.prod(np.ptp(x, axis=0) / self.spacing + 1.0))
        if box > MAX_BOX:
            remedy = "remove points that lie far from the body, or check the spacing"
            raise SplatError(f"the points are spread over {box:.2g} times the volume of one point: {remedy}")
        extent = np.linalg.svd(x - x.mean(axis=0), compute_uv=False) * np.sqrt(12.0 / len(x))
        if extent[2] < 0.05 * self.spacing:
            shape = "a line" if extent[1] < 0.05 * self.spacing else "a plane"
            remedy = "a body needs points in three dimensions, or a smaller spacing"
            raise SplatError(f"the points lie in {shape}: {remedy}")
        distance, nearest = cKDTree(x).query(x, k=2)
        double = np.flatnonzero(distance[:, 1] < 1e-4 * self.spacing)
        if len(double):
            i = int(double[0])
            other = next(int(k) for k in nearest[i] if k != i)  # of two equal points either may come first
            same = f"points {i} and {other} have the same coordinates"
            raise SplatError(
                f"{len(double)} points have the coordinates of another point ({same}): remove the duplicates"
            )


@dataclass(frozen=True)
class Body(MetalState):
    """One body of tetrahedra of one material with its state; fields that the cloud does not have are None. SI units.

    points (n,3); tets (m,4): positively oriented; cloud_index (k,): points of the cloud in this body; at nodes: velocity (n,3),
    energy (n,) J per reference m3; in elements: stress (m,6): Cauchy, Voigt xx yy zz yz xz xy; J (m,); state of the metal (m,);
    is_core: whether it is the core of a composite particle; report: see `Report`.
    """

    points: np.ndarray
    tets: np.ndarray
    cloud_index: np.ndarray
    velocity: np.ndarray | None = None
    energy: np.ndarray | None = None
    stress: np.ndarray | None = None
    J: np.ndarray | None = None
    is_core: bool = False
    report: Report = field(default_factory=dict)


@dataclass(frozen=True)
class Splat:
    """The bodies of a cloud, largest first, without fragments with fewer than MIN_POINTS points."""

    bodies: list[Body]
    report: Report
