"""Fields that are drawn: their words and colours, and their values anywhere in particle and target."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..files.fields import Fields
from ..geometry.tetrahedra import volumes

NEAR = 12  # points whose average is the value at a place inside the particle


@dataclass(frozen=True)
class Field:
    """label, unit and factor from SI, for people; colours: a map of matplotlib; floor: its least value, if it has one."""

    label: str
    unit: str
    factor: float
    colours: str
    floor: float | None = None
    least_range: float = 1.0  # in the shown unit: below it colours would only magnify noise

    @property
    def words(self) -> str:
        return f"{self.label} ({self.unit})" if self.unit else self.label


# Light is untouched and dark is hot, strained or stressed. The lightness of each map falls all the way, also in the
# eyes of those who do not tell red from green, and in grey.
FIELDS = {
    "T": Field("temperature", "K", 1.0, "YlOrRd"),
    "eps_p": Field("equivalent plastic strain", "", 1.0, "YlGnBu", 0.0, 0.01),
    "in_plane": Field("in-plane stress (xx + yy) / 2", "MPa", 1e-6, "PuOr_r"),
    "von_mises": Field("von Mises stress", "MPa", 1e-6, "BuPu", 0.0),
}


def from_points(points: NDArray, places: NDArray, void: float = np.inf) -> tuple[NDArray[np.int64], NDArray]:
    """Points and weights that interpolate a value at each place inside a cloud. points: (n, 3) m. places: (k, 3) m. void: m, a place
    without a point so near lies in none of the metal. Returns indices and weights, (k, j) each; weights of a place sum to one, and are
    not numbers in a void."""
    near = min(NEAR, len(points))
    tree, inside = cKDTree(points), np.arange(len(places))
    distance, index = np.full((len(places), near), np.inf), np.zeros((len(places), near), np.int64)
    if np.isfinite(void):  # most places of a picture lie in none of the metal
        inside = np.flatnonzero(np.isfinite(tree.query(places, distance_upper_bound=void)[0]))
    distance[inside], index[inside] = (of.reshape(-1, near) for of in tree.query(places[inside], k=near))
    # Weights fall over the distance of the points from each other, wherever that has been stretched.
    reach = np.maximum(distance[:, min(3, near - 1)], 1e-12)[:, None]
    weight = np.full_like(distance, np.nan)
    weight[inside] = np.exp(-((distance[inside] / reach[inside]) ** 2))
    return index, weight / weight.sum(1, keepdims=True)


def at_nodes(fields: Fields, name: str) -> NDArray:
    """A field at the points, (n, ...); values in tetrahedra are averaged with the volumes as weights."""
    values = fields.data[name].astype(float)
    if len(values) == len(fields.points):
        return values
    volume = np.abs(volumes(fields.points, fields.cells))
    where, count = fields.cells.ravel(), len(fields.points)
    weight = np.bincount(where, np.repeat(volume, 4), count)
    columns = values.reshape(len(values), -1).T
    sums = np.stack([np.bincount(where, np.repeat(volume * column, 4), count) for column in columns], axis=1)
    return (sums / np.where(weight > 0, weight, 1.0)[:, None]).reshape(count, *values.shape[1:])
