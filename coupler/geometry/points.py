"""Cleaning of clouds of points (open3d)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

SAME_PLACE = 1e-4  # spacings: points so close are one
LEAST_KEPT = 0.9  # of the points: with fewer of them the cloud is left as it is
LONELY = 2.5  # spacings: a point without another one so near is no part of a body


def cleaned(x: NDArray, spacing: float) -> tuple[NDArray[np.int64], list[str]]:
    """Which of points x (n,3) m to keep: each place once, without lonely points; and what was left out, in words."""
    import open3d as o3d

    finite = np.isfinite(x).all(axis=1)
    if not finite.all() or np.abs(x).max() > 1e6 * spacing:  # reported by the check of the cloud
        return np.arange(len(x)), []
    pairs = cKDTree(x).query_pairs(SAME_PLACE * spacing, output_type="ndarray")
    first = np.setdiff1d(np.arange(len(x)), pairs.max(axis=1, initial=-1))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector((x[first] - x[first[0]]) / spacing))
    _, kept = cloud.remove_radius_outlier(2, LONELY)  # the point itself counts
    index = first[np.asarray(kept, np.int64)]
    if len(index) < LEAST_KEPT * len(x):  # another fault, such as a wrong spacing
        return np.arange(len(x)), []
    counts = {"points on top of others": len(x) - len(first), "points far from all others": len(first) - len(index)}
    return index, [f"{count} {kind} left out" for kind, count in counts.items() if count]
