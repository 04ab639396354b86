"""The vertices of the particle in contact at one time of an impact, computed once for exposure and bonds."""

from functools import cached_property

import numpy as np

from ..contact.particle_bonds import CONTACT_RANGE
from ..geometry.triangles import vertex_areas
from ..physics.constitutive import yield_stresses
from .domains import Domains


class Touching:
    """Vertices in contact. rows (k,): vertices within `reach` spacings of the target; facets (k,): facet under each."""

    def __init__(self, domains: Domains, reach: float = CONTACT_RANGE):
        self._domains = domains
        vertices = domains.surface.weights.shape[0]
        self.rows, self.facets = domains.contact.touching(vertices, reach * domains.particle.spacing)

    @cached_property
    def area(self) -> np.ndarray:
        """Area (v,) m2 of each vertex of the particle's surface."""
        surface = self._domains.surface
        return vertex_areas(surface.positions(self._domains.particle.x), surface.triangles)

    @cached_property
    def force(self) -> np.ndarray:
        """Normal force (v,) N on all vertices, including their shares of the force on points under them."""
        return self._domains.surface.at_vertices(self._domains.contact.normal_force)

    @cached_property
    def element(self) -> np.ndarray:
        """Elements (k,) of the target behind the facets."""
        return self._domains.target.mesh.facet_element[self.facets]

    @cached_property
    def strength(self) -> np.ndarray:
        """Flow stress (k,) Pa of the softer metal at each vertex in contact, at slow rate, present strain and temperature."""
        surface, particle, target = self._domains.surface, self._domains.particle, self._domains.target
        at, p, e = self.element, particle.points, target.elements
        eps_p, T, gradient = (surface.values(values)[self.rows] for values in (p.eps_p, p.T, p.eps_gradient))
        own = yield_stresses(particle.law, np.zeros(len(at), np.int32), eps_p, T, gradient)
        other = yield_stresses(target.laws, target.law_of[at], e.eps_p[at], e.T[at], e.eps_gradient[at])
        return np.minimum(own, other)

    @property
    def pressed(self) -> np.ndarray:
        """Mask (k,) of `rows`: vertices with a normal force, or with a neighbour that has one."""
        pressing, triangles = self.force > 0.0, self._domains.surface.triangles
        beside = np.zeros(len(pressing), bool)
        beside[triangles[pressing[triangles].any(axis=1)]] = True
        return beside[self.rows] | pressing[self.rows]
