"""How well a mesh fits the cloud it is made from."""

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from ..geometry.tetrahedra import boundary_faces, volumes
from .cloud import Cloud, Report
from .kernels import winding
from .quality import compact

_SAMPLES = 6  # along the edge of a facet, to measure distances from


def distance_outside(vertices: np.ndarray, triangles: np.ndarray, x: np.ndarray, h: float) -> np.ndarray:
    """Distance of places x (k,3) m from a closed surface where they lie outside it, else 0, (k,) m; exact to about h m."""
    low = vertices.min(axis=0) - 0.419 * h
    counts = np.ceil((vertices.max(axis=0) - low) / h).astype(int) + 1
    w = np.zeros(counts, np.int8)
    winding(vertices, np.ascontiguousarray(triangles, np.int64), low, h, w)
    cell = np.floor((x - low) / h).astype(int)
    inside = ((cell >= 0) & (cell < counts)).all(axis=1)
    inside[inside] = w[tuple(cell[inside].T)] > 0
    distance = np.zeros(len(x))
    if not inside.all():
        i, j = np.array([(i, j) for i in range(_SAMPLES + 1) for j in range(_SAMPLES + 1 - i)]).T / _SAMPLES
        sample = np.einsum("kc,fcd->fkd", np.stack([1.0 - i - j, i, j], axis=1), vertices[triangles])
        distance[~inside] = cKDTree(sample.reshape(-1, 3)).query(x[~inside])[0]
    return distance


def fit_of(points: np.ndarray, tets: np.ndarray, cloud: Cloud) -> Report:
    """Extents of a mesh and of the carried surface (else of the points), m, and how far points lie outside, in spacings.

    width: diameter of the circle with the area of the body seen from above; outside_half: share of the points more than
    half a spacing outside; outside_max: the farthest; centroid_off: of the centre of mass.
    """
    x, triangles = compact(points, boundary_faces(tets)[0])
    source = cloud.x if cloud.surface is None else cloud.surface[0]
    share = volumes(points, tets)
    centroid = share @ points[tets].mean(axis=1) / share.sum()
    h = max(cloud.spacing / 6.0, float(np.prod(np.ptp(x, axis=0)) / 8e6) ** (1.0 / 3.0))
    out = distance_outside(x, triangles, cloud.x, h) / cloud.spacing

    def width(places: np.ndarray) -> float:
        return float(np.sqrt(4.0 / np.pi * ConvexHull(places[:, :2]).volume))

    return {
        "extent_m": np.ptp(x, axis=0).tolist(), "width_m": width(x), "top_m": float(x[:, 2].max()),
        "source_extent_m": np.ptp(source, axis=0).tolist(), "source_width_m": width(source),
        "source_top_m": float(source[:, 2].max()),
        "centroid_off": float(np.linalg.norm(centroid - np.average(cloud.x, axis=0, weights=cloud.mass)) / cloud.spacing),
        "outside_half": float(np.mean(out > 0.5)), "outside_max": float(out.max()),
    }  # fmt: skip
