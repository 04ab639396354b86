"""Self-contact of a particle: walls of a hollow sphere, ends of a rod, lobes of a powder."""

import numpy as np

from ..contact.contact import Contact
from ..contact.model import Nodes
from ..core.arrays import Floats, Ints
from ..particle.carried_surface import CarriedSurface
from ..particle.shapes import Body
from ..ranks.distributed import DistributedParticle

SHAPES = ("hollow_sphere", "rod", "flake", "file")  # shapes with possible self-contact; the others are convex
APART = 2.5  # spacings in the undeformed body: a vertex has no contact with faces that were closer
SKIN = 1.0  # spacings added to the search distance


class _OwnContact(Contact):
    """Contact of the vertices of a surface with its own faces, except faces that are near a vertex in the undeformed body."""

    def __init__(self, vertices: Floats, triangles: Ints, stiffness: float, spacing: float, friction: float):
        body, faces = np.zeros(len(vertices), np.int64), np.ones(len(triangles), np.int64)
        super().__init__(body, triangles, faces, [stiffness], [spacing], friction, skin=SKIN)
        self._undeformed, self._centres = vertices, vertices[triangles].mean(axis=1)

    def _pairs(self, near: Ints, ids: Ints, low: Floats, high: Floats) -> tuple[Ints, Ints]:
        start, face = super()._pairs(near, ids, low, high)
        point = np.repeat(np.arange(len(start) - 1), np.diff(start))
        away = self._undeformed[point] - self._centres[face]
        kept = np.einsum("ij,ij->i", away, away) > (APART * self.spacing[0]) ** 2
        return np.concatenate([[0], np.cumsum(kept)])[start], face[kept]


def whole_surface(body: Body, outer: CarriedSurface, place: Floats) -> CarriedSurface:
    """The surface of a particle with its cavities. body: undeformed, around its centre; place (3,) m: centre; outer: outer surface."""
    if body.inner is None:
        return outer
    hole, facing = body.inner
    triangles = np.concatenate([body.triangles, facing + len(body.vertices)])
    return CarriedSurface(body.points + place, np.concatenate([body.vertices, hole]) + place, triangles, body.spacing)


class Folding:
    """Contact of all surfaces of a particle, including cavities, with each other and with themselves.

    A vertex that comes near a face from behind, through a wall, has no contact with this face (`contact.kernels.project`).
    """

    def __init__(self, body: Body, surface: CarriedSurface, place: Floats, stiffness: float, friction: float):
        """body: undeformed, around its centre; surface: outer surface; place (3,) m: centre; stiffness (N/m): of a vertex."""
        self.surface = whole_surface(body, surface, place)
        vertices = body.vertices if body.inner is None else np.concatenate([body.vertices, body.inner[0]])
        self.contact = _OwnContact(vertices, self.surface.triangles, stiffness, body.spacing, friction)
        self._support = self.surface.support(np.arange(len(vertices)))
        # of the frame of the last search
        self._origin = np.zeros(3)  # position, m
        self._drift = np.zeros(3)  # velocity, m/s

    def search(self, particle: DistributedParticle, time: float) -> None:
        """Find the parts of the surface that can touch each other within `time` s."""
        weights, mass = self.surface.weights, particle.mass / particle.mass.sum()
        # in a frame that moves with the centre of mass: a motion of the whole particle does not change distances
        self._origin, self._drift = mass @ particle.x, mass @ particle.v
        x, v = weights @ (particle.x - self._origin), weights @ (particle.v - self._drift)
        fastest = float(np.sqrt(np.einsum("ij,ij->i", v, v).max()))
        self.contact.search(x, x, 1.5 * 2.0 * fastest * time)

    @property
    def needed(self) -> Ints:
        """Points of the particle whose positions determine the contact forces, or on which these forces act."""
        return self._support if len(self.contact.rows) else self._support[:0]

    def stable_dt(self, mass: Floats) -> float:
        """Stable time step (s) of the springs. mass (n,) kg: mass of the points."""
        softness = self.surface.softness(mass)
        return self.contact.stable_dt(softness, 1.0 / softness) if len(self.contact.rows) else np.inf

    def forces(self, particle: DistributedParticle) -> None:
        """Add the contact forces to the external forces on the points of the particle."""
        if len(self.contact.rows) == 0:
            return
        weights, points = self.surface.weights, self.contact.points
        self._origin = self._origin + particle.dt * self._drift  # the same frame as in the search
        points.x[:], points.v[:], points.f[:] = weights @ (particle.x - self._origin), weights @ particle.v, 0.0
        f = np.zeros_like(points.f)
        self.contact.forces(particle.dt, Nodes(points.x, points.v, f, len(f)))
        particle.f_ext += weights.T @ (points.f + f)

    def heat(self) -> Floats:
        """Heat of friction (n,) J since the last call, for each point of the particle."""
        c, into = self.contact, np.zeros(self.surface.touching.shape[0])
        into[: len(c.heat_point)] = c.heat_point
        np.add.at(into, c.faces["nodes"], c.heat_face[:, None] / 3.0)
        c.heat_point[:], c.heat_face[:] = 0.0, 0.0
        return self.surface.spread_heat(into)
