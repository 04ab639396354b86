"""Sections of tetrahedra and triangles with a plane of constant y. Lengths are in the unit of the points."""

import numpy as np
from numpy.typing import NDArray


def section_of_tets(points: NDArray, tets: NDArray, y: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Section of tetrahedra with a plane of constant y: polygons (q,4,2) and their tetrahedra (q,).

    points (n,3), tets (m,4). A corner of a polygon lies on an edge of a tetrahedron, and is given by the two points of this edge.
    Corners are in order round the polygon; a triangle has its last corner twice.
    """
    side = points[tets, 1] >= y
    above = side.sum(axis=1)
    # with the points above the plane first, the edges depend only on the number of these points
    order = np.take_along_axis(tets, np.argsort(~side, axis=1, kind="stable"), axis=1)
    recipes = {
        1: [(0, 1), (0, 2), (0, 3), (0, 3)],
        2: [(0, 2), (0, 3), (1, 3), (1, 2)],
        3: [(3, 0), (3, 1), (3, 2), (3, 2)],
    }
    owners = {count: np.flatnonzero(above == count) for count in recipes}
    edges = [order[owners[count]][:, np.array(recipe)] for count, recipe in recipes.items()]
    return np.concatenate(edges), np.concatenate(list(owners.values()))


def section_of_triangles(points: NDArray, triangles: NDArray, y: float) -> NDArray[np.int64]:
    """Section of triangles with a plane of constant y: segments (q,2,2), from start to end.

    points (n,3), triangles (m,3). An end of a segment is on an edge, given by its two points, the smaller index first. Triangles of one
    orientation give segments of one orientation.
    """
    side = points[triangles, 1] >= y
    above = side.sum(axis=1)
    crossed = (above == 1) | (above == 2)
    triangles, side, above = triangles[crossed], side[crossed], above[crossed]
    # the corner that is alone on its side of the plane comes first
    alone = np.argmax(side == (above == 1)[:, None], axis=1)
    turned = np.take_along_axis(triangles, (alone[:, None] + np.arange(3)) % 3, axis=1)
    segments = np.stack([turned[:, [0, 1]], turned[:, [0, 2]]], axis=1)
    segments[above == 2] = segments[above == 2][:, ::-1]
    return np.sort(segments, axis=2)


def section_loops(points: NDArray, triangles: NDArray, y: float) -> list[NDArray]:
    """Closed lines of the section of a closed surface with a plane of constant y: x and z (k,2) of each.

    points (n,3), triangles (m,3), all of one orientation: a hole has the orientation opposite to its outline.
    """
    segments = section_of_triangles(points, triangles, y).tolist()
    end_of = {tuple(start): tuple(end) for start, end in segments}
    loops = []
    while end_of:
        start, corner = end_of.popitem()
        chain = [start]
        while corner in end_of:
            chain.append(corner)
            corner = end_of.pop(corner)
        if len(chain) > 2:
            loops.append(crossing(points, np.array(chain), y)[0])
    return loops


def crossing(points: NDArray, edges: NDArray, y: float) -> tuple[NDArray, NDArray]:
    """Intersections of edges (...,2) with a plane of constant y: x and z (...,2), and position along the edge, 0 to 1, (...).

    The two points of each edge lie on different sides of the plane.
    """
    a, b = points[edges[..., 0]], points[edges[..., 1]]
    share = (y - a[..., 1]) / (b[..., 1] - a[..., 1])
    return (a + share[..., None] * (b - a))[..., [0, 2]], share
