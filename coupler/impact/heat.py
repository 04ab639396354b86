"""Heat in an impact: conduction in the particle and across the contact, heat of friction."""

from dataclasses import dataclass

import numpy as np

from ..contact.contact import Contact
from ..contact.particle_bonds import ParticleBonds
from ..fe.explicit import Target
from ..geometry.triangles import areas, vertex_areas
from ..particle.carried_surface import CarriedSurface
from ..particle.heat import PointConduction
from ..physics.constitutive import conductivities, heat_capacities
from ..ranks.distributed import DistributedParticle
from .folding import Folding


@dataclass
class HeatPaths:
    """Heat flows that are active between a particle and a target. friction: heat of friction and of bond fracture raises the
    temperature of both; points: conduction inside the particle, None if it is off; interface: conduction across the contact, without
    contact resistance; folding: self-contact of the particle, None if it is off."""

    particle: DistributedParticle
    target: Target
    surface: CarriedSurface
    contact: Contact
    friction: bool = True
    points: PointConduction | None = None
    interface: bool = False
    folding: Folding | None = None

    def flow(self, time: float) -> None:
        """Conduct heat for `time` s among the points of the particle and across the contact."""
        if self.points is not None:
            self.particle.warm(self.points.share(time, self.particle.x, self.particle.points.T))
        if self.interface:
            rows, elements, heat = self.crossing(time)
            if len(rows):
                self._warm_surface(rows, -heat)
                self.target.warm(elements, heat)

    def release(self, bonds: ParticleBonds | None) -> None:
        """Heat the points of the particle, and the elements behind the facets, by the friction and the fracture of bonds since the
        last call. Of the heat of bonds the particle gets the contact's `share`."""
        if not self.friction:
            return
        target, contact = self.target, self.contact
        if contact.heat_point.any():
            self.particle.warm(self.surface.spread_heat(contact.heat_point))
            contact.heat_point[:] = 0.0
        facets = np.flatnonzero(contact.heat_face)
        if len(facets):
            target.warm(target.mesh.facet_element[facets], contact.heat_face[facets])
            contact.heat_face[facets] = 0.0
        if self.folding is not None and (heat := self.folding.heat()).any():
            self.particle.warm(heat)
        if bonds is not None and (heat := bonds.bond.heat()).any():
            self._warm_surface(bonds.bond.nodes, contact.constants.share * heat)
            target.warm_around(bonds.bond.triangles, np.repeat((1.0 - contact.constants.share) / 3.0 * heat, 3))

    def _warm_surface(self, rows: np.ndarray, heat: np.ndarray) -> None:
        """Add heat (k,) J at rows (k,) of the particle's surface to its points."""
        into = np.zeros(self.surface.touching.shape[0])
        into[rows] = heat
        self.particle.warm(self.surface.spread_heat(into))

    def crossing(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices (k,) of the particle in contact, the element (k,) under each, and the heat (k,) J that this gets in `time` s.

        Each pair is modelled as two lumps, a layer of the particle one spacing thick and the vertex's part of the element. Their
        temperatures approach each other exponentially, which is stable for any time. The thermal resistance is that of the material
        between the contact and the places of the two temperatures.
        """
        particle, target, surface = self.particle, self.target, self.surface
        rows, facets = self.contact.touching(len(surface.weights.indptr) - 1)
        if len(rows) == 0:
            return rows, rows, np.zeros(0)
        elements = target.mesh.facet_element[facets].astype(np.int64)
        touching = np.zeros(len(surface.weights.indptr) - 1, bool)
        touching[rows] = True
        skin, inside = surface.positions(particle.x), surface.values(particle.x)[rows]
        area = vertex_areas(skin, surface.triangles[touching[surface.triangles].any(axis=1)])[rows]
        T_a, T_b = surface.values(particle.points.T)[rows], target.elements.T[elements]
        deep_a = np.linalg.norm(skin[rows] - inside, axis=1)
        area_b = areas(target.nodes.x, target.mesh.facets[facets])
        # distance of the centroid of a tetrahedron from its face
        deep_b = 0.75 * target.elements.volume[elements] / area_b
        a, b = particle.law[0], target.laws[target.law_of[elements]]
        resistance = deep_a / conductivities(a, T_a) + deep_b / conductivities(b, T_b)
        C_a = a["rho"] * heat_capacities(a, T_a) * area * particle.spacing
        sharing = np.bincount(elements, minlength=len(target.elements.T))[elements]
        C_b = b["rho"] * heat_capacities(b, T_b) * target.mesh.V0[elements] / sharing
        together = C_a * C_b / (C_a + C_b)
        return rows, elements, together * (T_a - T_b) * -np.expm1(-area / resistance * time / together)
