"""Undeformed particles: points of uniform spacing and a closed surface, for each shape of a scene."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull

from ..geometry.raycast import RaySurface
from ..geometry.remesh import even
from ..geometry.triangles import correct_volume, enclosed_volume, shells, surface_area, together
from ..physics import shapes as morphology
from . import packing

EDGE = 0.8  # edge of the surface's triangles divided by the spacing of the points
_FLAT = {"flake": (2,), "angular": (0, 1, 2)}  # axes along which a shape ends in flat faces
_GOLDEN = 0.618034  # its multiples, without their whole parts, are evenly distributed
_RING = 0.87  # distance between rings of vertices divided by the edges along them, for nearly equilateral triangles


@dataclass(frozen=True)
class Body:
    """A solid of uniform points around the origin. SI units.

    points (n,3); volume: volume of each point, which is the volume of the body divided by n; vertices (k,3), triangles (m,3): closed
    outer surface, normals outwards; area: area of this surface; half_height: depth of the lowest vertex below the centre; inner:
    vertices and triangles of the surfaces of cavities, normals into the cavities, or None.
    """

    points: np.ndarray
    volume: float
    vertices: np.ndarray
    triangles: np.ndarray
    area: float
    half_height: float
    inner: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def spacing(self) -> float:
        """Edge of a cube with the volume of one point, m."""
        return float(self.volume ** (1.0 / 3.0))


def shape(name: str, diameter: float, points: int, tilt: float = 0.0, pores: morphology.Pores | None = None) -> Body:
    """A body of a shape in `physics.shapes.SHAPES`, with the volume of a sphere of `diameter` m and about `points` points.

    tilt: rotation about y, rad, see `coupler.physics.shapes`; pores: cavities, which enlarge the shape: the volume is that of the
    metal.
    """
    form = morphology.form(name, diameter)
    volume = np.pi / 6.0 * diameter**3
    inner = None
    if pores is not None:
        body = _porous(form.scaled((1.0 + pores.volume / volume) ** (1.0 / 3.0)), pores, volume, points)
    elif name == "sphere":
        cloud, each = packing.sphere(diameter, points)
        skin = packing.surface(diameter, EDGE * each ** (1.0 / 3.0))
        body = Body(cloud, each, *skin, np.pi * diameter**2, 0.5 * diameter)
    else:
        half = (0.5 * form.lengths[0], 0.5 * form.lengths[1], 0.5 * form.lengths[2])
        flat = _FLAT.get(name, ())
        cloud, each = packing.fill(form.contains, half, volume, points, flat)
        vertices, triangles = _surface(form, EDGE * each ** (1.0 / 3.0))
        if name == "hollow_sphere":
            hole, facing_out = packing.surface(morphology.HOLLOW_RATIO * form.lengths[0], EDGE * each ** (1.0 / 3.0))
            inner = hole, facing_out[:, ::-1]
        body = Body(
            cloud, each, vertices, triangles, surface_area(vertices, triangles), -float(vertices[:, 2].min()), inner
        )
    return _tilted(body, tilt) if tilt else body


def _porous(form: morphology.Form, pores: morphology.Pores, volume: float, points: int) -> Body:
    """A body with pores, centre of mass at the origin. form: its outer shape; volume (m3): of the metal; points: as in `shape`."""
    centres, radius = np.array(pores.centres), 0.5 * pores.diameter
    middle = -pores.volume / volume * centres.mean(axis=0)

    def inside(x: np.ndarray) -> np.ndarray:
        metal = form.contains(x + middle)
        for centre in centres:
            metal &= np.linalg.norm(x + middle - centre, axis=1) > radius
        return metal

    a, b, c = (0.5 * length + abs(float(off)) for length, off in zip(form.lengths, middle, strict=True))
    cloud, each = packing.fill(inside, (a, b, c), volume, points)
    spacing = each ** (1.0 / 3.0)
    vertices, triangles = _surface(form, EDGE * spacing)
    hole, facing_out = packing.surface(pores.diameter, EDGE * spacing)
    # a sphere of flat triangles has less volume than the sphere: scale it
    hole *= (pores.volume / len(centres) / enclosed_volume(hole, facing_out)) ** (1.0 / 3.0)
    holes = (centres[:, None] + hole - middle).reshape(-1, 3)
    facing = (facing_out[:, ::-1] + len(hole) * np.arange(len(centres))[:, None, None]).reshape(-1, 3)
    area, half = surface_area(vertices, triangles), float(middle[2] - vertices[:, 2].min())
    return Body(cloud, each, vertices - middle, triangles, area, half, (holes, facing))


def of_surface(points: np.ndarray, triangles: np.ndarray, diameter: float, count: int, tilt: float = 0.0) -> Body:
    """A body inside a closed surface of points and triangles (`geometry.solid.Solid`), scaled to the volume of a sphere of
    `diameter` m. count: approximate number of points; tilt: as in `shape`.

    The surface is meshed again with even edges, and moved along its normals to the exact volume. Closed surfaces inside it are pores.
    """
    volume, x = np.pi / 6.0 * diameter**3, points * diameter
    source = RaySurface(x, triangles)
    a, b, c = np.abs(x).max(axis=0).tolist()
    cloud, each = packing.fill(source.inside, (a, b, c), volume, count)
    vertices, corners = even(x, triangles, EDGE * each ** (1.0 / 3.0), lambda at: source.feet(at)[0])
    vertices, _ = correct_volume(vertices, corners, volume, 0.5 * each ** (1.0 / 3.0))
    (vertices, corners), *holes = shells((vertices, corners))
    area, half = surface_area(vertices, corners), -float(vertices[:, 2].min())
    body = Body(cloud, each, vertices, corners, area, half, together(holes) if holes else None)
    return _tilted(body, tilt) if tilt else body


def core_of(body: Body, share: float) -> np.ndarray:
    """Index (n,) of the material of each point of a body: 1 in the core, 0 in the shell. The core consists of the points farthest
    below the outer surface, with an even selection of those at its least depth. share: volume fraction of the core, in whole points."""
    feet = RaySurface(body.vertices, body.triangles).feet(body.points)[0]
    depth = np.round(np.linalg.norm(body.points - feet, axis=1) / body.spacing, 1)
    all_round = _GOLDEN * np.arange(len(depth)) % 1.0
    number = np.zeros(len(depth), np.int32)
    number[np.lexsort((all_round, -depth))[: round(share * len(depth))]] = 1
    return number


def cylinder(diameter: float, length: float, points: int) -> Body:
    """A cylinder of `diameter` and `length` m along z, with about `points` points."""
    volume = np.pi / 4.0 * diameter**2 * length
    half = (0.5 * diameter, 0.5 * diameter, 0.5 * length)
    cloud, each = packing.fill(lambda x: morphology.in_cylinder(half[0], half[2], x), half, volume, points, (2,))
    skin = revolved(_cylinder_profile(half[0], half[2]), EDGE * each ** (1.0 / 3.0))
    return Body(cloud, each, *skin, surface_area(*skin), half[2])


def _tilted(body: Body, tilt: float) -> Body:
    """The body rotated about y by `tilt` rad: +x turns towards -z."""
    c, s = np.cos(tilt), np.sin(tilt)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    inner = None if body.inner is None else (body.inner[0] @ turn.T, body.inner[1])
    vertices = body.vertices @ turn.T
    points, half = np.ascontiguousarray(body.points @ turn.T), -float(vertices[:, 2].min())
    return replace(body, points=points, vertices=vertices, half_height=half, inner=inner)


def _surface(form: morphology.Form, edge: float) -> tuple[np.ndarray, np.ndarray]:
    a, _, c = (0.5 * length for length in form.lengths)
    if form.name in ("sphere", "hollow_sphere"):
        return packing.surface(2.0 * a, edge)
    if form.name == "angular":
        return _polyhedron(np.array(form.corners), edge)
    angle = np.linspace(0.0, np.pi, 2001)
    if form.name == "oblate":
        return revolved([np.stack([a * np.sin(angle), c * np.cos(angle)], axis=1)], edge)
    if form.name == "rod":
        quarter = 0.5 * angle
        top = np.stack([c * np.sin(quarter), a - c + c * np.cos(quarter)], axis=1)
        bottom = top[::-1] * [1.0, -1.0]
        vertices, triangles = revolved([top, np.array([top[-1], bottom[0]]), bottom], edge)
        return vertices[:, [2, 0, 1]], triangles  # from z to x
    return revolved(_cylinder_profile(a, c), edge)


def _cylinder_profile(radius: float, half: float) -> list[np.ndarray]:
    corners = np.array([[0.0, half], [radius, half], [radius, -half], [0.0, -half]])
    return [corners[i : i + 2] for i in range(3)]


def revolved(profile: list[np.ndarray], edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Closed surface of revolution about the z axis, with edges of about `edge` m: vertices (n,3), triangles (m,3), normals outwards.

    profile: pieces (k,2) of radius and z, finely sampled, from the upper to the lower pole. A ring of vertices lies at each end of
    a piece, so that sharp rims stay sharp.
    """
    stations = [profile[0][:1]]
    for piece in profile:
        run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(piece, axis=0), axis=1))])
        at = np.linspace(0.0, run[-1], max(1, round(run[-1] / (_RING * edge))) + 1)[1:]
        stations.append(np.stack([np.interp(at, run, piece[:, i]) for i in range(2)], axis=1))
    rings, vertices, angles = [], [], []
    n = 0
    for i, (r, z) in enumerate(np.concatenate(stations)):
        count = 1 if r < 1e-6 * edge else max(6, round(2.0 * np.pi * r / edge))
        phi = 2.0 * np.pi * (np.arange(count) + 0.5 * (i % 2)) / count
        vertices.append(np.stack([r * np.cos(phi), r * np.sin(phi), np.full(count, z)], axis=1))
        rings.append(np.arange(n, n + count))
        angles.append(phi)
        n += count
    triangles = [_stitch(rings[i], angles[i], rings[i + 1], angles[i + 1]) for i in range(len(rings) - 1)]
    return np.concatenate(vertices), np.concatenate(triangles)


def _stitch(upper: np.ndarray, phi_u: np.ndarray, lower: np.ndarray, phi_l: np.ndarray) -> np.ndarray:
    """Triangles (k,3) between two rings of vertices at the angles phi_u and phi_l, in the order of the angle. A ring may be a pole."""
    nu, nl = len(upper), len(lower)
    # each edge of a ring is a side of one triangle; the triangles are in the order of the ends of these edges
    order = np.argsort(
        np.concatenate([np.append(phi[1:], phi[0] + 2.0 * np.pi) for phi in (phi_u, phi_l)]), kind="stable"
    )
    on_upper = order < nu
    i: np.ndarray = np.cumsum(on_upper) - on_upper
    j = np.arange(nu + nl) - i
    third = np.where(on_upper, upper[(i + 1) % nu], lower[(j + 1) % nl])
    triangles = np.stack([upper[i % nu], lower[j % nl], third], axis=1)
    return triangles[np.where(on_upper, nu > 1, nl > 1)]  # a pole has no edge


def _polyhedron(corners: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Surface of the convex hull of corners (c,3) m; its flat faces are divided into triangles with edges of about `edge` m."""
    size = float(np.abs(corners).max())
    hull = ConvexHull(corners / size)
    faces = hull.simplices.copy()
    a, b, c = (hull.points[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    lengths = np.linalg.norm(hull.points[faces] - hull.points[np.roll(faces, 1, axis=1)], axis=2)
    vertices, triangles = packing.subdivide(hull.points, faces, max(2, round(size * float(np.median(lengths)) / edge)))
    return vertices * size, triangles
