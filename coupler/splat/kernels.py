"""Kernels of the conversion: winding numbers on a grid, and moving least squares (numba)."""

import numpy as np
from numpy.typing import NDArray

from ..compiling import njit
from ..core.arrays import Floats, Ints


@njit(cache=True, nogil=True)
def winding(vertices: Floats, triangles: Ints, corner: Floats, h: float, count: NDArray[np.int8]) -> None:
    """Write the winding number of a closed surface at the centres of cubic cells to count (nx,ny,nz), which is zero before.

    vertices (k,3) m; triangles (m,3): normals outwards; corner (3,) m: corner of the first cell; h m: edge of the cells. Along the
    line of cells through each (x, y) a downward facing triangle is an entry, an upward facing one an exit. If the line meets an edge,
    only one of the edge's two triangles counts: both compute from the same vertex, that of smaller index, where the line lies.
    """
    nx, ny, nz = count.shape
    w = np.empty(3)
    for f in range(len(triangles)):
        a, b, c = vertices[triangles[f, 0]], vertices[triangles[f, 1]], vertices[triangles[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        up = 1.0 if area > 0.0 else -1.0
        i0 = max(int(np.ceil((min(a[0], b[0], c[0]) - corner[0]) / h - 0.5)), 0)
        i1 = min(int(np.floor((max(a[0], b[0], c[0]) - corner[0]) / h - 0.5)), nx - 1)
        j0 = max(int(np.ceil((min(a[1], b[1], c[1]) - corner[1]) / h - 0.5)), 0)
        j1 = min(int(np.floor((max(a[1], b[1], c[1]) - corner[1]) / h - 0.5)), ny - 1)
        for i in range(i0, i1 + 1):
            x = corner[0] + (i + 0.5) * h
            for j in range(j0, j1 + 1):
                y = corner[1] + (j + 0.5) * h
                inside = True
                for k in range(3):
                    m, n = triangles[f, (k + 1) % 3], triangles[f, (k + 2) % 3]
                    sign = up
                    if m > n:
                        m, n, sign = n, m, -sign
                    u, v = vertices[m], vertices[n]
                    side = (v[0] - u[0]) * (y - u[1]) - (v[1] - u[1]) * (x - u[0])
                    if side == 0.0:  # decide as for a slightly shifted line
                        side = u[1] - v[1] if u[1] != v[1] else v[0] - u[0]
                    if side * sign < 0.0:
                        inside = False
                        break
                    w[k] = abs(side)
                if inside:
                    z = (w[0] * a[2] + w[1] * b[2] + w[2] * c[2]) / (w[0] + w[1] + w[2])
                    first = max(int(np.ceil((z - corner[2]) / h - 0.5)), 0)
                    if first < nz:
                        count[i, j, first] -= np.int8(up)
    for i in range(nx):
        for j in range(ny):
            for k in range(1, nz):
                count[i, j, k] += count[i, j, k - 1]


@njit(cache=True, nogil=True)
def least_squares_weights(y: Floats, x: Floats, near: Ints, ridge: float, phi: Floats) -> None:
    """Write the weights of the points near (m,k) of x (n,3) in a linear moving least-squares fit at points y (m,3) to phi (m,k).

    Each point has the weight (1 - r^2 / R^2)^2, with R slightly larger than the distance of the farthest point. The fit is centred
    on the weighted mean: if the points have no spread in one direction, the ridge parameter (m2) leaves the mean as result.
    """
    m, k = near.shape
    w, d = np.empty(k), np.empty((k, 3))
    M, offset = np.empty((3, 3)), np.empty(3)
    for a in range(m):
        farthest = 0.0
        for j in range(k):
            for i in range(3):
                d[j, i] = x[near[a, j], i] - y[a, i]
            farthest = max(farthest, d[j, 0] ** 2 + d[j, 1] ** 2 + d[j, 2] ** 2)
        total = 0.0
        offset[:] = 0.0
        for j in range(k):
            w[j] = (1.0 - (d[j, 0] ** 2 + d[j, 1] ** 2 + d[j, 2] ** 2) / (1.1 * farthest)) ** 2
            total += w[j]
            for i in range(3):
                offset[i] += w[j] * d[j, i]
        offset /= total
        w /= total
        M[:] = 0.0
        for j in range(k):
            for p in range(3):
                d[j, p] -= offset[p]
            for p in range(3):
                for q in range(3):
                    M[p, q] += w[j] * d[j, p] * d[j, q]
        for p in range(3):
            M[p, p] += ridge
        slope = np.linalg.solve(M, -offset)
        for j in range(k):
            phi[a, j] = w[j] * (1.0 + slope[0] * d[j, 0] + slope[1] * d[j, 1] + slope[2] * d[j, 2])
