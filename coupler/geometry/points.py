"""Points: how deep they lie in a mesh; their order along a curve; cleaning of clouds."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from .raycast import RaySurface
from .tetrahedra import boundary_faces

SAME_PLACE = 1e-4  # spacings: points so close are one
NEAR = 32  # tetrahedra with the nearest centres, in one of which a point inside a mesh lies
AT_ONCE = 4096  # points in a part of `depths`: some 100 MB
LEAST_KEPT = 0.9  # of the points: with fewer of them the cloud is left as it is
BITS = 16  # of each coordinate in the key of `morton`
FLAT = 0.015  # of the variance of neighbours: less of it along their normal is a surface
LONELY = 2.5  # spacings: a point without another one so near is no part of a body


def cleaned(x: NDArray, spacing: float) -> tuple[NDArray[np.int64], list[str]]:
    """Which of points x (n,3) m to keep: each position once, without isolated points; and what is left out, as text."""
    finite = np.isfinite(x).all(axis=1)
    if not finite.all() or np.abs(x).max() > 1e6 * spacing:  # reported by the check of the cloud
        return np.arange(len(x)), []
    pairs = cKDTree(x).query_pairs(SAME_PLACE * spacing, output_type="ndarray")
    first = np.setdiff1d(np.arange(len(x)), pairs.max(axis=1, initial=-1))
    index = first[cKDTree(x[first]).query(x[first], k=2)[0][:, 1] <= LONELY * spacing]
    if len(index) < LEAST_KEPT * len(x):  # another fault, such as a wrong spacing
        return np.arange(len(x)), []
    counts = {"points on top of others": len(x) - len(first), "points far from all others": len(first) - len(index)}
    return index, [f"{count} {kind} left out" for kind, count in counts.items() if count]


def is_shell(x: NDArray) -> bool:
    """Whether points x (n,3) lie on a surface: most have their nearest neighbours in a plane.

    The least variance of ten neighbours over the sum of all three is .15 to .27 in bodies, .17 in two layers, below .014 on spheres of
    160 points and more.
    """
    some = x[:: max(1, len(x) // 1000)]
    near = x[cKDTree(x).query(some, k=11)[1]]
    near = near - near.mean(axis=1, keepdims=True)
    spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near))
    return bool(np.median(spread[:, 0] / np.maximum(spread.sum(axis=1), 1e-300)) < FLAT)


def depths(x: NDArray, points: NDArray, tets: NDArray, least: float = 0.0) -> NDArray[np.float64]:
    """Distance (k,) m of points x (k,3) inside the tetrahedra (m,4) of points (n,3) from their boundary, where it is larger than
    `least` m; else 0, as outside.

    Only the NEAR tetrahedra with the nearest centres are tried.
    """
    centres, inside = cKDTree(points[tets].mean(axis=1)), np.zeros(len(x), bool)
    for rows in np.array_split(np.arange(len(x)), len(x) // AT_ONCE + 1):
        candidates = centres.query(x[rows], np.arange(1, min(NEAR, len(tets)) + 1))[1]
        corner = points[tets[candidates]]
        edges = np.moveaxis(corner[:, :, 1:] - corner[:, :, :1], -1, -2)
        weights = np.linalg.solve(edges, (x[rows, None] - corner[:, :, 0])[..., None])[..., 0]
        inside[rows] = np.any((weights.min(axis=2) > -1e-9) & (weights.sum(axis=2) < 1.0 + 1e-9), axis=1)
    depth, facets = np.zeros(len(x)), boundary_faces(tets)[0]
    # the boundary is no farther than the nearest of its nodes: mostly no point is left, and open3d is not loaded
    inside[inside] = cKDTree(points[np.unique(facets)]).query(x[inside])[0] > least
    if inside.any():
        feet = RaySurface(points, facets, closed=False).feet(x[inside])[0]
        depth[inside] = np.linalg.norm(x[inside] - feet, axis=1)
    return np.where(depth > least, depth, 0.0)


def morton(x: NDArray) -> NDArray[np.uint64]:
    """Key (n,) of points x (n,3) along the curve of Morton (1966), which interleaves the bits of their coordinates: points that are
    near along it are near in space."""
    low = x.min(axis=0)
    extent = float((x.max(axis=0) - low).max()) or 1.0
    cells = ((x - low) * ((2**BITS - 1) / extent)).astype(np.uint64)
    key = np.zeros(len(x), np.uint64)
    for bit in range(BITS):
        for d in range(3):
            key |= ((cells[:, d] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + d)
    return key


def points_near(tree: cKDTree, places: np.ndarray, reach: float, least: int, instead: int) -> csr_array:
    """Matrix (k,n) with a 1 for each point of a tree that lies within reach (m) of each of places (k,3) m, columns ascending; where
    there are fewer than `least`, for the `instead` nearest ones."""
    found = cKDTree(places).sparse_distance_matrix(tree, reach, output_type="coo_matrix")
    few = np.bincount(found.row, minlength=len(places)) < least
    instead = min(instead, tree.n)
    nearest = tree.query(places[few], k=instead)[1]
    rows = np.concatenate([found.row[~few[found.row]], np.repeat(np.flatnonzero(few), instead)])
    columns = np.concatenate([found.col[~few[found.row]], nearest.ravel()])
    matrix = csr_array((np.ones(len(rows)), (rows, columns)), (len(places), tree.n))
    matrix.sort_indices()
    return matrix
