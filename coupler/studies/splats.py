"""The bodies of a coating, and vertical columns through them, which give heights, roughness and voids."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..files.fields import Fields
from ..geometry.raycast import RaySurface
from ..geometry.tetrahedra import boundary_faces
from ..geometry.triangles import area_vectors


def flat(at: NDArray) -> NDArray:
    """Heights (k,) m of a flat surface at points (k,2) m."""
    return np.zeros(len(at))


@dataclass(frozen=True)
class Splats:
    """A coating at a stored step, or cold after the closing stage (is_cold).

    mesh: tetrahedra of substrate and splats; body (m,): body of each tetrahedron, 0 for the substrate; impact (bodies,): number of the
    impact of each body, 0 for the substrate; last: surface of the last particle as (points (k,3) m, triangles), if it stays and
    consists of points, else None; stayed (n,): share of the mass of each finished impact that is in the coating; mass (n,) kg: mass of
    each particle; parts (n): materials of each particle, that of the shell first, with their mass fractions; planned: number of impacts
    of the run, in `layers` layers; patch: radius of the disc on which centres of particles fall, m; element_size (m): element size of
    the splats; undecided: indices of the undecided impacts that count as stayed; verdicts: verdicts of the finished impacts, empty
    while the run continues; cores: index of each body that is the core of a particle -> name of its material.
    ground: heights (k,) m of the bare surface at points (k,2) m.
    """

    mesh: Fields
    body: NDArray[np.int64]
    impact: NDArray[np.int64]
    last: tuple[NDArray, NDArray] | None
    stayed: NDArray
    mass: NDArray
    parts: tuple[dict[str, float], ...]
    planned: int
    layers: int
    patch: float
    element_size: float
    is_cold: bool = False
    undecided: tuple[int, ...] = ()
    verdicts: tuple[str, ...] = ()
    cores: dict[int, str] = field(default_factory=dict)
    ground: Callable[[NDArray], NDArray] = flat

    @property
    def metal(self) -> NDArray[np.str_]:
        """Name (n,) of the powder of each particle: its metal, or such as "Ni on Al2O3"."""
        return np.array([" on ".join(part) for part in self.parts])

    @property
    def materials(self) -> list[str]:
        """Name of each material of the particles, once, in the order of the first impacts."""
        return list(dict.fromkeys(name for part in self.parts for name in part))

    def material(self, body: int, impact: int) -> str:
        """Name of the material of a body of a splat, or of the last particle. impact: number of its impact."""
        return self.cores.get(body) or next(iter(self.parts[impact - 1]))

    @property
    def deposition_efficiency(self) -> float:
        """Mass in the coating divided by the mass of all particles of finished impacts. Undecided particles count as stayed."""
        return float(self.mass @ self.stayed / self.mass.sum())

    @property
    def least_efficiency(self) -> float:
        """Deposition efficiency if all undecided particles count as lost."""
        lost = sum(self.mass[i] * self.stayed[i] for i in self.undecided)
        return self.deposition_efficiency - lost / float(self.mass.sum())


class Columns:
    """Vertical columns of cells over a disc: radius m, `step` m apart; cells are `step` m high and begin at z = low.

    A cell is inside a body if its middle is; this follows from the points at which the column crosses the closed surfaces of the
    bodies. Masks (k, layers) of k columns of `layers` cells, the lowest first: splat, substrate: cells inside a splat or the substrate;
    matter: inside one of them; double: inside a splat and another body. x, y (k,): positions of the columns, m.
    """

    def __init__(self, splats: Splats, centre: tuple[float, float], radius: float, step: float):
        self.step = step
        n = max(int(np.ceil(radius / step)), 4)
        axis = (np.arange(-n, n) + 0.5) * step
        self.inside = np.hypot(*np.meshgrid(axis, axis, indexing="ij")) <= radius
        self._origin, self._side = (centre[0] - n * step, centre[1] - n * step), 2 * n
        faces, behind = boundary_faces(splats.mesh.cells)  # bodies share no nodes
        body = splats.body[behind]
        of_each = np.split(faces[np.argsort(body, kind="stable")], np.cumsum(np.bincount(body))[:-1])
        skins = [(splats.mesh.points, own, came > 0) for came, own in zip(splats.impact.tolist(), of_each, strict=True)]
        if splats.last is not None:
            skins.append((*splats.last, True))
        points, faces, _ = skins[int(np.count_nonzero(splats.impact == 0)) - 1]  # uppermost body of the substrate
        corners, upward = points[faces], area_vectors(points, faces)[:, 2] > 0.0
        near = np.hypot(corners[..., 0] - centre[0], corners[..., 1] - centre[1]).min(axis=1) <= radius
        deepest = [float(corners[upward & near, :, 2].min(initial=0.0))]
        deepest += [float(points[faces, 2].min()) for points, faces, splat in skins if splat]
        self.low = min(deepest) - 8.0 * step
        self.layers = int(np.ceil((max(float(x[f, 2].max()) for x, f, _ in skins) - self.low) / step)) + 2
        count = np.zeros((2, self._side, self._side, self.layers + 1), np.int16)
        for points, faces, splat in skins:
            self._cross(points, faces, count[int(splat)])
        layered = np.cumsum(count[..., :-1], axis=-1, dtype=np.int16)
        solid = layered > 0
        self.double = ((layered.sum(axis=0) > 1) & solid[1])[self.inside]  # in a fold of a crater no splat overlaps
        self.splat = solid[1][self.inside]
        self.substrate = solid[0][self.inside]
        self.matter = self.splat | self.substrate
        grid = np.stack(np.meshgrid(axis + centre[0], axis + centre[1], indexing="ij"), axis=-1)
        self.x, self.y = grid[self.inside].T

    def _cross(self, points: NDArray, faces: NDArray, count: NDArray) -> None:
        """Add to `count` +1 at each point where a column enters a closed surface with outward triangles, and -1 where it leaves
        it."""
        h, aside = self.step, (0.5011, 0.5007)  # so that no column meets an edge, which two triangles share
        corners = points[faces][..., :2]
        low, high = (extreme(axis=(0, 1)) for extreme in (corners.min, corners.max))
        # columns that may pass through the body, and one more on each side
        first, stop = ((ends - self._origin) / h - aside for ends in (low, high))
        first, stop = (np.clip(ends, 0, self._side).astype(int) for ends in (np.floor(first), np.ceil(stop) + 1))
        if (first >= stop).any():
            return
        i, j = (axis.ravel() for axis in np.mgrid[first[0] : stop[0], first[1] : stop[1]])
        x, y = ((axis + part) * h + start for axis, part, start in zip((i, j), aside, self._origin, strict=True))
        column, z, face = RaySurface(points, faces, closed=False).on_verticals(x, y)
        k = np.ceil((z - self.low) / h - 0.5).astype(int).clip(0, self.layers)
        downward = area_vectors(points, faces)[face, 2] < 0.0  # the column enters here
        np.add.at(count, (i[column], j[column], k), np.where(downward, 1, -1).astype(np.int16))

    def highest(self, cells: NDArray) -> NDArray:
        """Height (k,) m of the top of the highest marked cell in each column; `low` if no cell is marked. cells (k, layers): mask.
        For the mask `matter` this is the surface of the coating, for `substrate` the interface."""
        last = self.layers - np.argmax(cells[:, ::-1], axis=1)
        return np.where(cells.any(axis=1), self.low + last * self.step, self.low)

    def voids(self, thinnest: float) -> tuple[NDArray, NDArray]:
        """Masks (k, layers) of empty cells below the highest cell of matter in their column: (open, closed). Closed: no path of empty
        cells leads to the space above the highest matter of a column. Voids with a height below `thinnest` m count as matter."""
        span = max(round(thinnest / self.step), 0)
        whole = np.zeros((self._side, self._side, self.layers), bool)
        whole[self.inside] = self.matter
        if span > 0:
            pad = ((0, 0), (0, 0), (span + 1, span + 1))
            closed = ndimage.binary_closing(np.pad(whole, pad, mode="edge"), np.ones((1, 1, span + 1), bool))
            whole |= closed[..., span + 1 : -span - 1]
        below = np.cumsum(whole[..., ::-1], axis=-1)[..., ::-1] > 0
        below &= self.inside[..., None]
        empty = ~whole
        # outside: above the tops. The rim of the disc does not count, or half of the voids at the rim would be open.
        label, _ = ndimage.label(empty & self.inside[..., None])
        outer = np.unique(label[empty & ~below & self.inside[..., None]])
        outside = np.isin(label, outer[outer > 0])
        void = empty & below
        return (void & outside)[self.inside], (void & ~outside)[self.inside]


def roughness(z: NDArray) -> tuple[float, float]:
    """Sa and Sq (ISO 25178-2), m, of heights z (k,) on an even grid: mean and root mean square of the distance from the mean height. No
    plane is fitted and subtracted: in a disc with few splats this would remove their largest steps."""
    away = z - z.mean()
    return float(np.abs(away).mean()), float(np.sqrt((away**2).mean()))
