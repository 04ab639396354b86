"""Heat in an impact: conduction among the particle's points and across the contact, heat of friction."""

from typing import Protocol

import numpy as np

from ..contact.hold import Hold
from ..contact.penalty import PointContact
from ..fe.explicit import Target
from ..geometry.triangles import areas, vertex_areas
from ..physics.constitutive import conductivities, heat_capacities
from ..sph.carried_surface import CarriedSurface
from ..sph.heat import PointConduction


class Particle(Protocol):
    """The particle as heat sees it. x (n,3) m; T (n,) K; law: LAW record (1,); spacing m."""

    x: np.ndarray
    law: np.ndarray
    spacing: float

    @property
    def T(self) -> np.ndarray: ...

    def warm(self, heat: np.ndarray) -> None:
        """Put heat (n,) J into the points."""


class HeatPaths:
    """The heat paths that are open. friction: its heat, and that of fracture, warms what has rubbed or torn; points: conduction in the
    particle, or None; interface: heat crosses the contact, which is perfect."""

    def __init__(self, friction: bool = True, points: PointConduction | None = None, interface: bool = False):
        self.friction, self.points, self.interface = friction, points, interface

    def flow(
        self, time: float, particle: Particle, target: Target, surface: CarriedSurface, contact: PointContact
    ) -> None:
        """Let heat flow for `time` s among the points of the particle and across the contact."""
        if self.points is not None:
            particle.warm(self.points.share(time, particle.x, particle.T))
        if self.interface:
            rows, elements, heat = self.crossing(time, particle, target, surface, contact)
            if len(rows):
                into = np.zeros(surface.touching.shape[0])
                into[rows] = -heat
                particle.warm(surface.spread_heat(into))
                target.warm(elements, heat)

    def release_friction(
        self, particle: Particle, target: Target, surface: CarriedSurface, contact: PointContact
    ) -> None:
        """Turn the heat of friction since the last call into temperature, of points and of the elements behind facets."""
        if not self.friction:
            return
        if contact.heat_point.any():
            particle.warm(surface.spread_heat(contact.heat_point))
            contact.heat_point[:] = 0.0
        facets = np.flatnonzero(contact.heat_facet)
        if len(facets):
            target.warm(target.mesh.facet_element[contact.facet_ids[facets]], contact.heat_facet[facets])
            contact.heat_facet[facets] = 0.0

    def release_fracture(
        self, particle: Particle, target: Target, surface: CarriedSurface, share: float, hold: Hold
    ) -> None:
        """Turn the heat of torn bonds since the last call into temperature, `share` of it on the particle's side."""
        if not self.friction:
            return
        rows, nodes, heat = hold.heat()
        if not heat.any():
            return
        into = np.zeros(surface.touching.shape[0])
        into[rows] = share * heat
        particle.warm(surface.spread_heat(into))
        target.warm_around(nodes, np.repeat((1.0 - share) / 3.0 * heat, 3))

    def crossing(
        self, time: float, particle: Particle, target: Target, surface: CarriedSurface, contact: PointContact
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices of the particle's surface (k,) that touch, the element under each (k,), and the heat (k,) J it gets in `time` s.

        Two lumps in contact, a layer one spacing thick and the element's part: they level out exponentially, so that no
        time is too long. The resistance is that of what lies between the contact and where temperatures are known.
        """
        rows, facets = contact.touching(len(surface.weights.indptr) - 1)
        if len(rows) == 0:
            return rows, rows, np.zeros(0)
        elements = target.mesh.facet_element[facets].astype(np.int64)
        skin, inside = surface.positions(particle.x), surface.values(particle.x)[rows]
        area = vertex_areas(skin, surface.triangles)[rows]
        T_a, T_b = surface.values(particle.T)[rows], target.T[elements]
        deep_a = np.linalg.norm(skin[rows] - inside, axis=1)
        deep_b = (
            0.75 * target.volume[elements] / areas(target.x, target.mesh.facets[facets])
        )  # of a tetrahedron's centre
        a, b = particle.law[0], target.laws[target.law_of[elements]]
        resistance = deep_a / conductivities(a, T_a) + deep_b / conductivities(b, T_b)
        C_a = a["rho"] * heat_capacities(a, T_a) * area * particle.spacing
        sharing = np.bincount(elements, minlength=len(target.T))[elements]
        C_b = b["rho"] * heat_capacities(b, T_b) * target.mesh.V0[elements] / sharing
        together = C_a * C_b / (C_a + C_b)
        return rows, elements, together * (T_a - T_b) * -np.expm1(-area / resistance * time / together)
