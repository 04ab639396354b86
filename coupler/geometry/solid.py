"""Surfaces that bound a solid: checks before meshing, and cleaning of surfaces from the user's files (open3d)."""

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import SplatError
from .library import open3d
from .raycast import RaySurface
from .triangles import Surface, enclosed_volume, open_or_double, shells, together

if TYPE_CHECKING:
    from open3d.pybind.geometry import TriangleMesh

MOST_TRIANGLES = 4000  # of a cleaned solid; a finer surface is decimated
SAME_PLACE = 1e-6  # of the extent: corners that are closer are merged
FRAGMENT = 0.01  # of the area of the surface: smaller separate parts are removed


@dataclass(frozen=True)
class Solid:
    """A body, given by its closed surface: points (n,3), triangles (m,3) with normals out of the metal. Its centroid is the origin, and
    its volume is that of a sphere of diameter 1."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]


def solid_of(points: NDArray, triangles: NDArray) -> Solid:
    """The solid inside a surface of points (n,3), in any unit, and triangles (m,3).

    Coincident corners are merged; duplicate triangles, triangles without area and fragments (small parts that are no pores) are
    removed; triangles are oriented outwards; a fine surface is decimated to MOST_TRIANGLES. A closed surface inside another is a pore.
    Raises SplatError if the surface bounds no solid, or more than one.
    """
    mesh = _mesh(points, triangles)
    mesh.merge_close_vertices(100.0 * SAME_PLACE)
    mesh.remove_degenerate_triangles()
    corners = np.asarray(mesh.triangles)
    # two triangles with the same corners are duplicates, even with opposite orientations
    _, once = np.unique(np.sort(corners, axis=1), axis=0, return_index=True)
    mesh.remove_triangles_by_index(np.setdiff1d(np.arange(len(corners)), once).tolist())
    label, _, area = (np.asarray(values) for values in mesh.cluster_connected_triangles())
    if not len(area) or not area.sum() > 0.0:
        raise SplatError("the surface has no area: give the triangles of a closed surface")
    largest, small = int(area.argmax()), np.flatnonzero(area <= FRAGMENT * area.sum()).tolist()
    fragments = [k for k in small if not _is_pore(mesh, label, k, largest)]
    mesh.remove_triangles_by_mask(np.isin(label, fragments).tolist())
    mesh.remove_unreferenced_vertices()
    if not mesh.is_edge_manifold():
        raise SplatError("the surface does not enclose a solid: an edge has more than two triangles")
    if not mesh.orient_triangles():
        raise SplatError("the surface does not enclose a solid: its triangles have no consistent orientation")
    if problem := open_or_double(np.asarray(mesh.triangles, np.int64)):
        raise SplatError(f"the surface does not enclose a solid: {problem}")
    many = len(mesh.triangles)
    if many > MOST_TRIANGLES:
        mesh = mesh.simplify_quadric_decimation(MOST_TRIANGLES)
        mesh.remove_degenerate_triangles().remove_unreferenced_vertices()
    x, t = np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int64)
    try:
        check_solid(x, t)
    except SplatError as problem:
        if many <= MOST_TRIANGLES:
            raise
        reduced = f"becomes invalid when it is reduced to {MOST_TRIANGLES} triangles ({problem})"
        raise SplatError(f"the surface has {many} triangles and {reduced}: give fewer triangles") from None
    x, t = _with_pores(x, t)
    volume = enclosed_volume(x, t)
    if volume < 1e-9 * float(np.prod(np.ptp(x, axis=0)) or 1.0):
        raise SplatError("the surface encloses no volume: give the triangles of a closed surface")
    a, b, c = (x[t[:, i]] for i in range(3))
    centre = np.einsum("ij,ij,ik->k", a, np.cross(b, c), a + b + c) / (24.0 * volume)
    return Solid((x - centre) * (np.pi / 6.0 / volume) ** (1.0 / 3.0), t)


def _is_pore(mesh: "TriangleMesh", label: NDArray, part: int, largest: int) -> bool:
    """Whether a part of a mesh is closed and lies inside the largest part. label (m,): part of each triangle."""
    x, t = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    own = t[label == part]
    is_closed = _mesh(x, own).is_edge_manifold(allow_boundary_edges=False)
    return is_closed and bool(RaySurface(x, t[label == largest], closed=False).inside(x[np.unique(own)]).all())


def _with_pores(x: NDArray, t: NDArray) -> Surface:
    """A closed surface whose largest part is oriented outwards, and all others, which must lie inside it, inwards. Raises SplatError
    if one lies outside."""
    parts = [(own, out if enclosed_volume(own, out) > 0.0 else out[:, ::-1]) for own, out in shells((x, t))]
    outer, *inner = sorted(parts, key=lambda part: -enclosed_volume(*part))
    if inner and not RaySurface(*outer).inside(np.concatenate([own for own, _ in inner])).all():
        remedy = "give one body; only its pores may be separate"
        raise SplatError(f"the surface consists of {len(parts)} separate parts: {remedy}")
    return together([outer, *((own, out[:, ::-1]) for own, out in inner)])


def _mesh(points: NDArray, triangles: NDArray) -> "TriangleMesh":
    """A surface as a mesh of open3d, scaled to a size of 100: open3d has absolute tolerances for numbers near one."""
    o3d = open3d()
    unit = float(np.ptp(points, axis=0).max()) / 100.0 or 1.0
    return o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector((points - points[0]) / unit), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )


def check_solid(points: NDArray, triangles: NDArray) -> None:
    """Raise SplatError if points (n,3) and triangles (m,3) do not bound a solid: the surface is open, not manifold, or intersects
    itself.
    """
    problem = open_or_double(np.asarray(triangles, np.int64))
    mesh = _mesh(points, triangles)
    if not problem and not mesh.is_vertex_manifold():
        problem = f"it touches itself at {len(mesh.get_non_manifold_vertices())} corners"
    if not problem and any(
        _intersect(points[triangles[pair]]) for pair in np.asarray(mesh.get_self_intersecting_triangles())
    ):
        problem = "triangles pass through each other"
    if problem:
        raise SplatError(f"the surface does not enclose a solid: {problem}")


def _intersect(pair: NDArray) -> bool:
    """Whether two triangles (2,3,3) have a common point, in exact arithmetic by the separating axis theorem (Gottschalk, Lin & Manocha
    1996, doi:10.1145/237170.237244).

    open3d has a tolerance: it reports also pairs of triangles in one plane that are next to each other.
    """
    a, b = np.vectorize(Fraction, otypes=[object])(pair)
    ea, eb = np.roll(a, -1, axis=0) - a, np.roll(b, -1, axis=0) - b
    na, nb = np.cross(ea[0], ea[1]), np.cross(eb[0], eb[1])
    of_edges = np.cross(ea[:, None], eb[None]).reshape(9, 3)
    directions = np.concatenate([[na, nb], of_edges, np.cross(na, ea), np.cross(nb, eb)])
    p, q = directions @ a.T, directions @ b.T
    return not np.any((p.max(axis=1) < q.min(axis=1)) | (q.max(axis=1) < p.min(axis=1)))
