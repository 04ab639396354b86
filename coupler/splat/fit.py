"""How well a mesh fits the cloud it is made from."""

import numpy as np
from scipy.spatial import ConvexHull

from ..geometry.raycast import RaySurface
from ..geometry.tetrahedra import boundary_faces
from .cloud import Cloud, Report
from .quality import compact


def fit_of(points: np.ndarray, tets: np.ndarray, cloud: Cloud) -> Report:
    """Width and height of a mesh and of the carried surface (else of the points), m, and how far points lie outside, in spacings.

    width: diameter of the circle with the area of the body seen from above; outside_half: share of the points more than
    half a spacing outside; outside_max: the farthest.
    """
    x, triangles = compact(points, boundary_faces(tets)[0])
    source = cloud.x if cloud.surface is None else cloud.surface[0]
    out = RaySurface(x, triangles).distance_outside(cloud.x) / cloud.spacing

    def width(places: np.ndarray) -> float:
        return float(np.sqrt(4.0 / np.pi * ConvexHull(places[:, :2]).volume))

    return {
        "width_m": width(x), "top_m": float(x[:, 2].max()),
        "source_width_m": width(source), "source_top_m": float(source[:, 2].max()),
        "outside_half": float(np.mean(out > 0.5)), "outside_max": float(out.max()),
    }  # fmt: skip
