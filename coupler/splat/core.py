"""The mesh of a body with a core: which of its tetrahedra are the core.

A field that is 1 at the points of the core and 0 at all others is fitted at the centroids of the tetrahedra. The core consists of those
above a level of the field, which is chosen such that the core has the volume of its points. Tetrahedra that touch others of the core
only along an edge are given to the shell, because the surfaces of both bodies must be closed.
"""

from collections.abc import Iterator

import numpy as np

from ..core.arrays import Floats, Ints
from ..geometry.tetrahedra import boundary_faces, volumes
from ..geometry.triangles import compact
from .cloud import MIN_POINTS, Cloud
from .transfer import Fit

LEVELS = 12  # of the bisection: the volume changes by whole tetrahedra


def parts_of(cloud: Cloud, points: Floats, tets: Ints) -> Iterator[tuple[bool, Ints, Floats, Ints]]:
    """Yield shell and core of a mesh: whether the part is the core, its points (p,) of the cloud, nodes (n,3) m, tetrahedra (m,4).

    If shell or core has fewer than MIN_POINTS points, the whole mesh is the larger one; if the core has no tetrahedra, the shell.
    """
    everyone = np.arange(len(cloud.x))
    if cloud.core is None or min(cloud.core.sum(), (~cloud.core).sum()) < MIN_POINTS:
        yield cloud.core is not None and bool(cloud.core.mean() > 0.5), everyone, points, tets
        return
    core = _core_of(cloud, points, tets)
    if not core.any():
        yield False, everyone, points, tets
        return
    for is_core in (False, True):
        yield is_core, np.flatnonzero(cloud.core == is_core), *compact(points, tets[core == is_core])


def _core_of(cloud: Cloud, points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Mask (m,) of the tetrahedra of the core."""
    assert cloud.core is not None
    field = Fit(cloud.x, points[tets].mean(axis=1), cloud.spacing)(cloud.core.astype(float))
    size = volumes(points, tets)
    wanted = float(cloud.current_volume[cloud.core].sum() / cloud.solid_volume * size.sum())
    low, high, best = 0.0, 1.0, np.zeros(len(tets), bool)
    for _ in range(LEVELS):
        level = 0.5 * (low + high)
        core = _closed(tets, field > level)
        if abs(size[core].sum() - wanted) < abs(size[best].sum() - wanted):
            best = core
        low, high = (level, high) if size[core].sum() > wanted else (low, level)
    return best


def _closed(tets: np.ndarray, core: np.ndarray) -> np.ndarray:
    """The core (m,) without the tetrahedra at those edges where the surface of the core or of the shell has more than two triangles."""
    core = core.copy()
    while core.any():
        bad = np.concatenate([_double_edges(tets[part]) for part in (core, ~core)])
        if not len(bad):
            break
        for edge in bad:
            core &= np.isin(tets, edge).sum(axis=1) < 2
    return core


def _double_edges(tets: np.ndarray) -> np.ndarray:
    """The edges (k,2) that belong to more than two triangles of the surface of tetrahedra (m,4)."""
    ends = np.sort(boundary_faces(tets)[0][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(ends, axis=0, return_counts=True)
    return edges[count > 2]
