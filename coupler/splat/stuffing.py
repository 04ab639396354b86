"""Isosurface stuffing: tetrahedra of a body-centred cubic lattice, warped and cut at a level set.

It works for any shape, needs no surface and no other program; features that the lattice does not resolve are left out.
Labelle & Shewchuk (2007), with quadrilaterals cut by vertex number instead of by parity, so their bound on the dihedral
angles (11 deg) is not guaranteed.
"""

import numpy as np

from ..geometry.tetrahedra import oriented
from .field import Field
from .quality import compact

WARP_LONG, WARP_SHORT = 0.24999, 0.41189  # of an edge: a vertex closer to a cut is moved onto the cut
EDGE = 1.25  # lattice constant over the element size: tetrahedra have about the volume of those of gmsh


def stuff(field: Field, level: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n,3) m and tetrahedra (m,4) of the region where a field exceeds a level, elements of about `size` m."""
    a = EDGE * size
    x, tets, edges, long = _lattice(field, a)
    value = field.at(x) - level
    inside = value > 0.0
    crossed = inside[edges[:, 0]] != inside[edges[:, 1]]
    edges, long = edges[crossed], long[crossed]
    cut = _cuts(field, level, x, edges, inside)
    sign = np.where(inside, 1, -1)

    # vertices that are too close to a cut move to their nearest cut
    limit = np.where(long, WARP_LONG * a, WARP_SHORT * 0.5 * np.sqrt(3.0) * a)
    ends = np.concatenate([edges[:, 0], edges[:, 1]])
    gap = np.concatenate([np.linalg.norm(cut - x[edges[:, i]], axis=1) for i in range(2)])
    order = np.lexsort((gap, ends))
    first = order[np.concatenate([[True], np.diff(ends[order]) > 0])] if len(order) else order
    close = np.zeros(len(x), bool)
    close[ends[gap < np.concatenate([limit, limit])]] = True
    move = first[close[ends[first]]]
    x[ends[move]] = cut[move % max(len(cut), 1)]
    sign[ends[move]] = 0

    kept = (sign[edges[:, 0]] * sign[edges[:, 1]]) < 0
    return _clip(x, tets, sign, edges[kept], cut[kept])


def _lattice(field: Field, a: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, tetrahedra, edges of a body-centred cubic lattice over a field, and which edges are long ones."""
    counts = np.ceil((np.array(field.values.shape) - 1) * field.h / a).astype(int) + 2
    n = counts + 1
    corner = np.arange(np.prod(n)).reshape(n)
    centre = corner.size + np.arange(np.prod(counts)).reshape(counts)
    grid = np.stack(np.meshgrid(*(np.arange(k) for k in n), indexing="ij"), axis=-1).reshape(-1, 3)
    middle = np.stack(np.meshgrid(*(np.arange(k) for k in counts), indexing="ij"), axis=-1).reshape(-1, 3) + 0.5
    x = field.origin - 0.5 * a + a * np.concatenate([grid, middle])
    tets = []
    for axis in range(3):
        # each edge between neighbouring centres, with the four edges of the face between them
        centres = np.moveaxis(centre, axis, 0)
        square = np.moveaxis(corner, axis, 0)[1:-1]
        c0, c1 = centres[:-1].ravel(), centres[1:].ravel()
        ring = [square[:, :-1, :-1], square[:, 1:, :-1], square[:, 1:, 1:], square[:, :-1, 1:]]
        for k in range(4):
            tets.append(np.stack([c0, c1, ring[k].ravel(), ring[(k + 1) % 4].ravel()], axis=1))
    all_tets = np.concatenate(tets)
    metal = field.at(x) > 1e-3
    all_tets = oriented(x, all_tets[metal[all_tets].any(axis=1)])
    pairs = np.concatenate([all_tets[:, [i, j]] for i, j in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))])
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    long = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) > 0.95 * a
    return x, all_tets, edges, long


def _cuts(field: Field, level: float, x: np.ndarray, edges: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Where edges (e,2) meet the level set, (e,3) m: by bisection, because the field is not linear along a long edge."""
    first = inside[edges[:, 0]]
    p = np.where(first[:, None], x[edges[:, 0]], x[edges[:, 1]])
    q = np.where(first[:, None], x[edges[:, 1]], x[edges[:, 0]])
    for _ in range(16):
        middle = 0.5 * (p + q)
        metal = (field.at(middle) > level)[:, None]
        p, q = np.where(metal, middle, p), np.where(metal, q, middle)
    return 0.5 * (p + q)


def _clip(
    x: np.ndarray, tets: np.ndarray, sign: np.ndarray, edges: np.ndarray, cut: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The part of tetrahedra where sign > 0, bounded by vertices of sign 0 and by the cuts (e,3) of edges (e,2)."""
    s = sign[tets]
    whole = tets[(s >= 0).all(axis=1) & (s > 0).any(axis=1)]
    mixed = (s > 0).any(axis=1) & (s < 0).any(axis=1)
    # vertices in metal first, then on the surface, then outside; equal signs by number, so that neighbours cut a face alike
    order = np.lexsort((tets[mixed], -s[mixed]), axis=1)
    v = np.take_along_axis(tets[mixed], order, axis=1)
    s = np.take_along_axis(s[mixed], order, axis=1)
    key = np.sort(edges, axis=1) @ np.array([len(x), 1])
    by_key = np.argsort(key)

    def cuts(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        wanted = np.minimum(p, q) * len(x) + np.maximum(p, q)
        return len(x) + by_key[np.searchsorted(key, wanted, sorter=by_key)]

    kept = [whole]
    plus, minus = (s > 0).sum(axis=1), (s < 0).sum(axis=1)

    def case(a: int, b: int) -> tuple[np.ndarray, ...]:
        rows = v[(plus == a) & (minus == b)]
        return tuple(rows[:, i] for i in range(4))

    p, n, m, o = case(1, 3)
    kept.append(np.stack([p, cuts(p, n), cuts(p, m), cuts(p, o)], axis=1))
    p, z, n, m = case(1, 2)
    kept.append(np.stack([p, z, cuts(p, n), cuts(p, m)], axis=1))
    p, z, y, n = case(1, 1)
    kept.append(np.stack([p, z, y, cuts(p, n)], axis=1))
    p, q, z, n = case(2, 1)
    pn, qn = cuts(p, n), cuts(q, n)
    kept += [np.stack([p, q, qn, z], axis=1), np.stack([p, qn, pn, z], axis=1)]
    p, q, n, m = case(2, 2)
    pn, pm, qn, qm = cuts(p, n), cuts(p, m), cuts(q, n), cuts(q, m)
    kept += [np.stack(c, axis=1) for c in ((p, q, qn, qm), (p, pn, pm, qm), (p, pn, qm, qn))]
    p, q, r, n = case(3, 1)
    pn, qn, rn = cuts(p, n), cuts(q, n), cuts(r, n)
    kept += [np.stack(c, axis=1) for c in ((p, q, r, rn), (p, q, qn, rn), (p, pn, qn, rn))]

    points = np.concatenate([x, cut])
    return compact(points, oriented(points, np.concatenate(kept)))
