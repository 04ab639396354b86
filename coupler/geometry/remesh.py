"""Isotropic remeshing of a closed surface: edges are collapsed, split and flipped, vertices relaxed (Botsch & Kobbelt 2004).

No operation opens the surface or changes its topology: an edge is collapsed only if its ends have exactly two common neighbours (Dey et
al. 1999), and flipped only if the new edge does not exist. The operations of one pass have no common triangle; the tables of neighbours
are computed after each pass.
"""

from collections.abc import Callable

import numpy as np

from ..compiling import njit
from ..core.arrays import Floats, Ints
from .graph import around
from .triangles import compact, vertex_normals
from .triangles import edges as directed_edges

SHORT, LONG = 0.75, 1.35  # over the size: edges between these lengths do not change
MIN_COSINE = 0.3  # between a triangle's normals before and after a collapse
ROUNDS = 5
TIE = 1e-6


def even(
    vertices: np.ndarray, triangles: np.ndarray, size: float, project: Callable[[np.ndarray], np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """A closed surface with the same topology and with edges of about `size` m. The given surface and the result have vertices (k,3)
    m and triangles (m,3).

    project(vertices) -> vertices: moves the vertices to the exact surface after each round; None: they are only relaxed along the
    surface.
    """
    x, t = np.array(vertices, float), np.array(triangles, np.int64)
    edge = float(np.median(np.linalg.norm(x[t] - x[np.roll(t, 1, axis=1)], axis=2)))
    while edge < 0.5 * SHORT * size:  # a fine surface is coarsened in steps, the shortest edges first
        edge *= 1.6
        x, t = _collapse_all(x, t, min(edge, SHORT * size), LONG * size)
        x, t = _flip_all(x, t)
        x = relaxed(x, t)
    for _ in range(ROUNDS):
        x, t = _split_all(x, t, LONG * size)
        x, t = _collapse_all(x, t, SHORT * size, LONG * size)
        x, t = _flip_all(x, t)
        x = relaxed(relaxed(x, t), t)
        if project is not None:
            x = project(x)
    return x, t


def relaxed(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Vertices (k,3) after smoothing: each is moved along the surface by half the distance to the mean of its neighbours."""
    total, count = np.zeros_like(x), np.bincount(t.ravel(), minlength=len(x))
    for a, b in ((0, 1), (1, 2), (2, 0)):  # each edge of a closed surface occurs once in each direction
        for i in range(3):
            total[:, i] += np.bincount(t[:, a], x[t[:, b], i], len(x))
    step = total / count[:, None] - x
    normal = vertex_normals(x, t)
    return x + 0.5 * (step - np.einsum("ij,ij->i", step, normal)[:, None] * normal)


def _edges(x: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each edge (e,2) of a closed surface once, and its length (e,) m."""
    both = directed_edges(t)
    once = both[both[:, 0] < both[:, 1]]
    return once, np.linalg.norm(x[once[:, 0]] - x[once[:, 1]], axis=1)


def _around(t: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles around each of n vertices, table[start[i]:start[i + 1]] for vertex i: start (n+1,) and table (3m,)."""
    start, places = around(t, n)
    return start, places // 3


def _shortest_first(length: np.ndarray, size: float) -> np.ndarray:
    """Order of edges (e,) by length, m. Lengths that differ by less than TIE of `size` count as equal, and equal edges keep their
    order.

    Halves of an edge, and edges of a symmetric splat, differ by rounding only. Without this tolerance, or with numpy's default sort,
    whose order of equal values depends on the processor, the mesh would depend on rounding and processor.
    """
    return np.argsort(np.round(length / (TIE * size)), kind="stable")


def _collapse_all(x: np.ndarray, t: np.ndarray, short: float, longest: float) -> tuple[np.ndarray, np.ndarray]:
    for _ in range(60):
        edges, length = _edges(x, t)
        pick = np.flatnonzero(length < short)
        pick = pick[_shortest_first(length[pick], short)]
        if _collapse(x, t, *_around(t, len(x)), edges[pick], longest) == 0:
            break
        x, t = compact(x, t[t[:, 0] >= 0])
    return x, t


@njit(cache=True, nogil=True)
def _turned(x: Floats, t: Ints, f: int, old: int, p: Floats) -> bool:
    """Whether triangle f rotates too much, or loses its area, if its corner `old` moves to p."""
    c, d = np.empty((3, 3)), np.empty((3, 3))
    for k in range(3):
        c[k] = x[t[f, k]]
        d[k] = p if t[f, k] == old else x[t[f, k]]
    n = np.cross(c[1] - c[0], c[2] - c[0])
    m = np.cross(d[1] - d[0], d[2] - d[0])
    nn, mm = np.dot(n, n), np.dot(m, m)
    longest = max(np.dot(d[1] - d[0], d[1] - d[0]), np.dot(d[2] - d[1], d[2] - d[1]), np.dot(d[0] - d[2], d[0] - d[2]))
    if mm < 0.01 * longest * longest:
        return mm < nn  # no new sliver, but an existing one may improve
    return np.dot(n, m) < MIN_COSINE * np.sqrt(nn * mm)


@njit(cache=True, nogil=True)
def _collapse(x: Floats, t: Ints, start: Ints, table: Ints, edges: Ints, longest: float) -> int:
    """Collapse edges to their midpoints, in their order. longest: limit of the edges after a collapse. x and t change in place; removed
    triangles are -1. Returns the number of collapses."""
    n = len(x)
    locked = np.zeros(n, np.bool_)
    mark = np.full(n, -1)
    done = 0
    for e in range(len(edges)):
        u, v = edges[e, 0], edges[e, 1]
        if locked[u] or locked[v]:
            continue
        for r in range(start[u], start[u + 1]):
            for k in range(3):
                mark[t[table[r], k]] = 2 * e
        shared = 0
        mark[u] = mark[v] = -1
        low = 1 << 30
        for r in range(start[v], start[v + 1]):
            for k in range(3):
                w = t[table[r], k]
                if mark[w] == 2 * e:
                    mark[w] = 2 * e + 1
                    shared += 1
                    low = min(low, start[w + 1] - start[w])
        if shared != 2 or low < 4:
            continue
        p = 0.5 * (x[u] + x[v])
        good = True
        for old, other in ((u, v), (v, u)):
            for r in range(start[old], start[old + 1]):
                f = table[r]
                if t[f, 0] == other or t[f, 1] == other or t[f, 2] == other:
                    continue
                for k in range(3):
                    w = t[f, k]
                    if w != old:
                        d = x[w] - p
                        good = good and np.dot(d, d) < longest * longest
                good = good and not _turned(x, t, f, old, p)
            if not good:
                break
        if not good:
            continue
        for old in (u, v):
            for r in range(start[old], start[old + 1]):
                for k in range(3):
                    locked[t[table[r], k]] = True
        x[u] = p
        for r in range(start[v], start[v + 1]):
            f = table[r]
            if t[f, 0] == u or t[f, 1] == u or t[f, 2] == u:
                t[f, :] = -1
            else:
                for k in range(3):
                    if t[f, k] == v:
                        t[f, k] = u
        done += 1
    return done


def _split_all(x: np.ndarray, t: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    for _ in range(20):
        edges, length = _edges(x, t)
        pick = np.flatnonzero(length > longest)
        if len(pick) == 0:
            break
        x, t = _split(x, t, *_around(t, len(x)), edges[pick[_shortest_first(-length[pick], longest)]])
    return x, t


@njit(cache=True, nogil=True)
def _split(x: Floats, t: Ints, start: Ints, table: Ints, edges: Ints) -> tuple[Floats, Ints]:
    """Split edges at their midpoints, in their order, except those at a triangle that is already split. Returns the new x and t."""
    touched = np.zeros(len(t), np.bool_)
    points = np.empty((len(edges), 3))
    faces = np.empty((2 * len(edges), 3), np.int64)
    done = 0
    for e in range(len(edges)):
        u, v = edges[e, 0], edges[e, 1]
        f, g = -1, -1
        for r in range(start[u], start[u + 1]):
            s = table[r]
            if not touched[s] and (t[s, 0] == v or t[s, 1] == v or t[s, 2] == v):
                f, g = s, f
        if g < 0:
            continue
        w = len(x) + done
        points[done] = 0.5 * (x[u] + x[v])
        for q in range(2):
            s = f if q == 0 else g
            touched[s] = True
            for k in range(3):
                faces[2 * done + q, k] = w if t[s, k] == u else t[s, k]
                if t[s, k] == v:
                    t[s, k] = w
        done += 1
    return np.concatenate((x, points[:done])), np.concatenate((t, faces[: 2 * done]))


def _flip_all(x: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    for _ in range(8):
        if _flip(x, t, *_around(t, len(x)), _edges(x, t)[0]) == 0:
            break
    return x, t


@njit(cache=True, nogil=True)
def _flip(x: Floats, t: Ints, start: Ints, table: Ints, edges: Ints) -> int:
    """Flip edges if the numbers of neighbours of the four vertices are then closer to six. t changes in place. Returns the number of
    flips."""
    touched = np.zeros(len(t), np.bool_)
    valence = start[1:] - start[:-1]
    done = 0
    for e in range(len(edges)):
        u, v = edges[e, 0], edges[e, 1]
        f, g, a, b = -1, -1, -1, -1
        for r in range(start[u], start[u + 1]):
            s = table[r]
            for k in range(3):
                if t[s, k] == u and t[s, (k + 1) % 3] == v:
                    f, a = s, t[s, (k + 2) % 3]
                if t[s, k] == v and t[s, (k + 1) % 3] == u:
                    g, b = s, t[s, (k + 2) % 3]
        if f < 0 or g < 0 or touched[f] or touched[g] or valence[u] < 4 or valence[v] < 4:
            continue
        now = abs(valence[u] - 6) + abs(valence[v] - 6) + abs(valence[a] - 6) + abs(valence[b] - 6)
        then = abs(valence[u] - 7) + abs(valence[v] - 7) + abs(valence[a] - 5) + abs(valence[b] - 5)
        if then >= now:
            continue
        known = False
        for r in range(start[a], start[a + 1]):
            s = table[r]
            known = known or t[s, 0] == b or t[s, 1] == b or t[s, 2] == b or touched[s]
        if known:
            continue
        n = np.cross(x[v] - x[u], x[a] - x[u]) + np.cross(x[u] - x[v], x[b] - x[v])
        n1 = np.cross(x[b] - x[u], x[a] - x[u])  # u b a
        n2 = np.cross(x[a] - x[v], x[b] - x[v])  # v a b
        nn = np.dot(n, n)
        if min(np.dot(n, n1), np.dot(n, n2)) < 0.15 * nn:
            continue
        t[f, 0], t[f, 1], t[f, 2] = u, b, a
        t[g, 0], t[g, 1], t[g, 2] = v, a, b
        touched[f] = touched[g] = True
        for less, more in ((u, a), (v, b)):
            valence[less] -= 1
            valence[more] += 1
        done += 1
    return done
