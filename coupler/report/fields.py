"""Fields for pictures: labels and colours, and interpolation of their values in particle and target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..files.fields import Fields
from ..geometry.tetrahedra import volumes

NEAR = 12  # points over which a value inside the particle is averaged


@dataclass(frozen=True)
class Field:
    """A field in pictures. label, unit: as displayed; factor: from SI to this unit; colours: colour map of matplotlib; floor: least
    possible value, None if there is none; least_range: least range of the colour scale, in this unit, so that it shows no noise."""

    label: str
    unit: str
    factor: float
    colours: str
    floor: float | None = None
    least_range: float = 1.0

    @property
    def words(self) -> str:
        return f"{self.label} ({self.unit})" if self.unit else self.label


# The lightness of each sequential map falls monotonically, also for colour-blind readers and in grey: dark is hot, strained or
# stressed.
FIELDS = {
    "T": Field("temperature", "K", 1.0, "YlOrRd"),
    "eps_p": Field("equivalent plastic strain", "", 1.0, "YlGnBu", 0.0, 0.01),
    "in_plane": Field("in-plane stress (xx + yy) / 2", "MPa", 1e-6, "PuOr_r"),
    "von_mises": Field("von Mises stress", "MPa", 1e-6, "BuPu", 0.0),
}


def from_points(points: NDArray, places: NDArray, void: float = np.inf) -> tuple[NDArray[np.int64], NDArray]:
    """Interpolation from points (n, 3) m to places (k, 3) m. Returns indices of points and weights, (k, j) each. The weights of a
    place sum to one. void (m): if a place is farther than this from all points it is outside the metal, and its weights are NaN."""
    near = min(NEAR, len(points))
    tree, inside = cKDTree(points), np.arange(len(places))
    distance, index = np.full((len(places), near), np.inf), np.zeros((len(places), near), np.int64)
    if np.isfinite(void):  # most places of a picture are outside the metal
        inside = np.flatnonzero(np.isfinite(tree.query(places, distance_upper_bound=void)[0]))
    distance[inside], index[inside] = (of.reshape(-1, near) for of in tree.query(places[inside], k=near))
    # The length over which weights fall is the local distance between points, which deformation changes
    reach = np.maximum(distance[:, min(3, near - 1)], 1e-12)[:, None]
    weight = np.full_like(distance, np.nan)
    weight[inside] = np.exp(-((distance[inside] / reach[inside]) ** 2))
    return index, weight / weight.sum(1, keepdims=True)


def at_nodes(fields: Fields, name: str) -> NDArray:
    """The values (n, ...) of a field at the points. For a field in tetrahedra: the mean over those at a point, weighted by volume."""
    values = fields.data[name].astype(float)
    if len(values) == len(fields.points):
        return values
    volume = np.abs(volumes(fields.points, fields.cells))
    where, count = fields.cells.ravel(), len(fields.points)
    weight = np.bincount(where, np.repeat(volume, 4), count)
    columns = values.reshape(len(values), -1).T
    sums = np.stack([np.bincount(where, np.repeat(volume * column, 4), count) for column in columns], axis=1)
    return (sums / np.where(weight > 0, weight, 1.0)[:, None]).reshape(count, *values.shape[1:])
