"""Tetrahedral meshes by gmsh, of simple solids and inside closed surfaces. Only this module imports gmsh.

gmsh can hang, or end its process: the program calls these functions in a separate process (`geometry.apart`).
"""

import math
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from types import ModuleType

import numpy as np

from ..errors import SolverError, SplatError
from .tetrahedra import COARSEST, boundary_faces, oriented
from .triangles import compact

ALGORITHMS = {"HXT": 10, "Delaunay": 1}


def load() -> None:
    """Import gmsh before the first call. Where it is not installed, `build` raises the error."""
    with suppress(ImportError, OSError):
        import gmsh  # noqa: F401


def build(model: Callable[[ModuleType], None], algorithm: str = "HXT") -> tuple[np.ndarray, np.ndarray]:
    """Points (n,3) and tetrahedra (m,4) of the solid that model(gmsh) describes, in the unit of the model. algorithm: in ALGORITHMS.

    The model sets the element size; curvature and points do not change it. Raises SolverError if gmsh makes no element, and all errors
    of gmsh.
    """
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)  # the same mesh on every machine
        gmsh.model.add("solid")
        for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
            gmsh.option.setNumber(f"Mesh.{option}", 0)
        gmsh.option.setNumber("Mesh.Algorithm3D", ALGORITHMS[algorithm])
        gmsh.option.setNumber("Mesh.OptimizeNetgen", 1)  # halves the number of slivers, which would limit dt
        model(gmsh)
        gmsh.model.mesh.generate(3)
        tags, coords, _ = gmsh.model.mesh.getNodes()
        _, nodes = gmsh.model.mesh.getElementsByType(4)
    finally:
        gmsh.finalize()
        if threading.current_thread() is threading.main_thread():  # Python allows no other thread to set a handler
            # the default of Python; with the handler that gmsh sets, a broken pipe ends the process
            signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    if len(nodes) == 0:
        raise SolverError("gmsh made no tetrahedra: choose smaller elements or a larger substrate")
    lookup = np.zeros(int(tags.max()) + 1, np.int64)
    lookup[tags.astype(np.int64)] = np.arange(len(tags))
    # without points of the geometry that have no element
    return compact(coords.reshape(-1, 3), lookup[nodes.astype(np.int64)].reshape(-1, 4))


def _equal(gmsh: ModuleType) -> None:
    gmsh.option.setNumber("Mesh.MeshSizeMin", 1.0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0)


def cylinder(
    diameter: float, height: float, size: float, refined_radius: float, growth: float, centre: tuple[float, float] = (0.0, 0.0),
    sizes_to: float | None = None, sector: float = 2.0 * math.pi, spread: float = 0.0,
    top: Callable[[np.ndarray], np.ndarray] | None = None, below: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Points (n,3) and tetrahedra (m,4) of a cylinder whose top face is z = -below, axis z; lengths in m.

    Element edges are `size` within refined_radius of a disc on z = 0, whose radius is `spread` and whose centre is `centre`.
    Outside they grow by `growth` per unit of distance up to sizes_to (default: a sixth of the smaller dimension). sector: angle, rad,
    of the part of the cylinder from the x axis on; pi / 2 is a quarter with the symmetry planes x = 0 and y = 0. top: heights (k,) m of
    the top face at points (k,2) m, for below = 0: the surface of the flat cylinder is displaced along z, the disc is moved to the
    height at its centre, and the inside is meshed again.
    """
    unit = size  # gmsh has absolute tolerances for numbers near one
    most = (sizes_to or COARSEST * min(diameter, height)) / unit

    def sized(gmsh: ModuleType, level: float = 0.0) -> None:
        axis = f"(x-({centre[0] / unit:.12g}))^2+(y-({centre[1] / unit:.12g}))^2"
        if spread > 0.0:
            beyond = f"(Sqrt({axis})-{spread / unit:.12g})"
            axis = f"(0.5*({beyond}+Abs({beyond})))^2"
        depth = f"(z-({level / unit:.12g}))" if level else "z"
        beyond = f"(Sqrt({axis}+{depth}^2)-{refined_radius / unit:.12g})"
        grown = f"1+{growth:.12g}*(0.5*({beyond}+Abs({beyond})))"
        field = gmsh.model.mesh.field.add("MathEval")
        gmsh.model.mesh.field.setString(field, "F", f"0.5*(({grown})+{most:.12g}-Abs(({grown})-{most:.12g}))")
        gmsh.model.mesh.field.setAsBackgroundMesh(field)

    def model(gmsh: ModuleType) -> None:
        gmsh.model.occ.addCylinder(
            0, 0, -(height + below) / unit, 0, 0, height / unit, 0.5 * diameter / unit, angle=sector
        )
        gmsh.model.occ.synchronize()
        sized(gmsh)

    points, tets = build(model)
    if top is None:
        return points * unit, tets
    shell, faces = compact(points * unit, boundary_faces(tets)[0])
    shell[:, 2] += top(shell[:, :2]) * (1.0 + shell[:, 2] / height)
    level = float(top(np.array([centre]))[0])
    return fill([(shell, faces)], size, sizes=lambda gmsh: sized(gmsh, level))


def box(lengths: tuple[float, float, float], size: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra of a box [0, lx] x [0, ly] x [0, lz] with edges of about `size` (m)."""

    def model(gmsh: ModuleType) -> None:
        gmsh.model.occ.addBox(0, 0, 0, *(length / size for length in lengths))
        gmsh.model.occ.synchronize()
        _equal(gmsh)

    points, tets = build(model)
    return points * size, tets


def fill(
    shells: list[tuple[np.ndarray, np.ndarray]], size: float, algorithm: str = "HXT",
    sizes: Callable[[ModuleType], None] = _equal,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Points (n,3) m and tetrahedra (m,4), edges of about `size` m, between closed surfaces, which do not change.

    shells: vertices (k,3) m and outward triangles of the outer surface, then those of cavities; sizes: sets other sizes of edges in
    gmsh, in units of `size`. Raises SplatError if gmsh fails.
    """

    def model(gmsh: ModuleType) -> None:
        nodes = elements = 1
        loops = []
        for vertices, triangles in shells:
            surface = gmsh.model.addDiscreteEntity(2)
            tags = np.arange(nodes, nodes + len(vertices))
            gmsh.model.mesh.addNodes(2, surface, tags, (vertices / size).ravel())
            own = np.arange(elements, elements + len(triangles))
            gmsh.model.mesh.addElementsByType(surface, 2, own, (triangles + nodes).ravel())
            loops.append(gmsh.model.geo.addSurfaceLoop([surface]))
            nodes += len(vertices)
            elements += len(triangles)
        gmsh.model.geo.addVolume(loops)
        gmsh.model.geo.synchronize()
        sizes(gmsh)
        # quality below which elements are optimised; at the default 0.3 the worst one has a time step some 30 % shorter
        gmsh.option.setNumber("Mesh.OptimizeThreshold", 0.45)

    try:
        points, tets = build(model, algorithm)
    except SolverError:
        raise SplatError("gmsh made no tetrahedra inside the surface: try another element size") from None
    except Exception as problem:  # gmsh raises plain Exception
        raise SplatError(f"gmsh: {str(problem).splitlines()[0] if str(problem) else 'failed'}") from problem
    return points * size, oriented(points, tets)
