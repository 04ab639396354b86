"""Operations on points: their positions and depths in a mesh, their order along a space-filling curve, removal of faulty points."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from .raycast import RaySurface
from .tetrahedra import boundary_faces, volumes

SAME_PLACE = 1e-4  # spacings: points that are closer are one point
NEAR = 32  # tetrahedra with the nearest centres; a point inside a mesh is in one of them
AT_ONCE = 4096  # points in a block of `in_tets`: some 100 MB
ROUNDING = 1e-9  # of a barycentric coordinate
LEAST_KEPT = 0.9  # fraction of the points; if fewer would remain, the cloud is not cleaned
BITS = 16  # number of bits of each coordinate in the key of `morton`
# variance of the neighbours along their normal over the sum of variances: if it is lower, the points are a surface
FLAT = 0.015
LONELY = 2.5  # spacings: a point whose nearest neighbour is farther away is not part of a body


def cleaned(x: NDArray, spacing: float) -> tuple[NDArray[np.int64], list[str]]:
    """Indices of the points x (n,3) m to keep. Each position is kept once, and isolated points are left out. Returns also texts about
    the omitted points."""
    if not np.isfinite(x).all() or np.abs(x).max() > 1e6 * spacing:  # the check of the cloud reports it
        return np.arange(len(x)), []
    pairs = cKDTree(x).query_pairs(SAME_PLACE * spacing, output_type="ndarray")
    first = np.setdiff1d(np.arange(len(x)), pairs.max(axis=1, initial=-1))
    index = first[cKDTree(x[first]).query(x[first], k=2)[0][:, 1] <= LONELY * spacing]
    if len(index) < LEAST_KEPT * len(x):  # another fault, such as a wrong spacing
        return np.arange(len(x)), []
    counts = {"duplicate points": len(x) - len(first), "points far from all others": len(first) - len(index)}
    return index, [f"{count} {kind} left out" for kind, count in counts.items() if count]


def is_shell(x: NDArray) -> bool:
    """Whether points x (n,3) are on a surface: the nearest neighbours of most points are in a plane.

    The smallest principal variance of ten neighbours over the sum of all three is 0.15 to 0.27 in bodies, 0.17 in two layers, and below
    0.014 on spheres of 160 points and more.
    """
    some = x[:: max(1, len(x) // 1000)]
    near = x[cKDTree(x).query(some, k=11)[1]]
    near = near - near.mean(axis=1, keepdims=True)
    spread = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", near, near))
    return bool(np.median(spread[:, 0] / np.maximum(spread.sum(axis=1), 1e-300)) < FLAT)


def in_tets(points: NDArray, tets: NDArray, x: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The tetrahedron (k,) of tets (m,4) on points (n,3) that contains each of x (k,3), -1 outside, and the barycentric coordinates
    (k,4) of x in it, 0 outside. Tetrahedra without volume contain no point."""
    solid, owner, share = np.flatnonzero(volumes(points, tets)), np.full(len(x), -1), np.zeros((len(x), 4))
    centres = cKDTree(points[tets[solid]].mean(axis=1))
    for rows in np.array_split(np.arange(len(x)), len(x) // AT_ONCE + 1):
        candidates = solid[centres.query(x[rows], np.arange(1, min(NEAR, len(solid)) + 1))[1]]
        corner = points[tets[candidates]]
        edges = np.moveaxis(corner[:, :, 1:] - corner[:, :, :1], -1, -2)
        three = np.linalg.solve(edges, (x[rows, None] - corner[:, :, 0])[..., None])[..., 0]
        four = np.concatenate([1.0 - three.sum(axis=2, keepdims=True), three], axis=2)
        best = four.min(axis=2).argmax(axis=1)[:, None]
        weights = np.take_along_axis(four, best[:, :, None], axis=1)[:, 0]
        inside = weights.min(axis=1) > -ROUNDING
        owner[rows[inside]] = np.take_along_axis(candidates, best, axis=1)[inside, 0]
        share[rows[inside]] = weights[inside]
    return owner, share


def depths(x: NDArray, points: NDArray, tets: NDArray, least: float = 0.0) -> NDArray[np.float64]:
    """Distance (k,) m of points x (k,3) m inside a mesh from its boundary. The mesh has tetrahedra (m,4) of points (n,3). The
    distance is 0 for points outside, and for distances up to `least` m."""
    inside = in_tets(points, tets, x)[0] >= 0
    depth, facets = np.zeros(len(x)), boundary_faces(tets)[0]
    # the distance to a node is an upper bound: usually no point is left, and open3d is not loaded
    inside[inside] = cKDTree(points[np.unique(facets)]).query(x[inside])[0] > least
    if inside.any():
        feet = RaySurface(points, facets, closed=False).feet(x[inside])[0]
        depth[inside] = np.linalg.norm(x[inside] - feet, axis=1)
    return np.where(depth > least, depth, 0.0)


def morton(x: NDArray) -> NDArray[np.uint64]:
    """Key (n,) of points x (n,3) along the curve of Morton (1966), which interleaves the bits of the coordinates: points with
    neighbouring keys are near each other in space."""
    low = x.min(axis=0)
    extent = float((x.max(axis=0) - low).max()) or 1.0
    cells = ((x - low) * ((2**BITS - 1) / extent)).astype(np.uint64)
    key = np.zeros(len(x), np.uint64)
    for bit in range(BITS):
        for d in range(3):
            key |= ((cells[:, d] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + d)
    return key


def points_near(tree: cKDTree, places: np.ndarray, reach: float, least: int, instead: int) -> csr_array:
    """Matrix (k,n) with the value 1 for each point of `tree` that lies within `reach` (m) of each of the places (k,3) m; columns are
    ascending. If fewer than `least` points lie within reach of a place, the `instead` points nearest to it have the value 1."""
    found = cKDTree(places).sparse_distance_matrix(tree, reach, output_type="coo_matrix")
    few = np.bincount(found.row, minlength=len(places)) < least
    instead = min(instead, tree.n)
    nearest = tree.query(places[few], k=instead)[1]
    rows = np.concatenate([found.row[~few[found.row]], np.repeat(np.flatnonzero(few), instead)])
    columns = np.concatenate([found.col[~few[found.row]], nearest.ravel()])
    matrix = csr_array((np.ones(len(rows)), (rows, columns)), (len(places), tree.n))
    matrix.sort_indices()
    return matrix
