"""What touches at one instant of an impact: computed once, for exposure and for bonds."""

from functools import cached_property

import numpy as np

from ..contact.particle_bonds import CONTACT_RANGE
from ..geometry.triangles import vertex_areas
from ..physics.constitutive import yield_stresses
from .domains import Domains


class Touching:
    """rows (k,): vertices of the particle's surface within CONTACT_RANGE spacings of the target; facets (k,): facets under them."""

    def __init__(self, domains: Domains):
        self._domains = domains
        vertices = domains.surface.weights.shape[0]
        self.rows, self.facets = domains.contact.touching(vertices, CONTACT_RANGE * domains.particle.spacing)

    @cached_property
    def area(self) -> np.ndarray:
        """Area (v,) m2 of all vertices of the surface."""
        surface = self._domains.surface
        return vertex_areas(surface.positions(self._domains.particle.x), surface.triangles)

    @cached_property
    def force(self) -> np.ndarray:
        """Force (v,) N that presses on all vertices, with their shares of that on the points under them."""
        return self._domains.surface.at_vertices(self._domains.contact.normal_force)

    @cached_property
    def element(self) -> np.ndarray:
        """Elements (k,) of the target behind the facets."""
        return self._domains.target.mesh.facet_element[self.facets]

    @cached_property
    def strength(self) -> np.ndarray:
        """Flow stress (k,) Pa, see `softer_strength`."""
        return softer_strength(self._domains, self.rows, self.facets)

    @property
    def pressed(self) -> np.ndarray:
        """Mask (k,) of `rows`: vertices that press on the target, directly or by the points under them, or have such a neighbour."""
        pressing, triangles = self.force > 0.0, self._domains.surface.triangles
        beside = np.zeros(len(pressing), bool)
        beside[triangles[pressing[triangles].any(axis=1)]] = True
        return beside[self.rows] | pressing[self.rows]


def softer_strength(domains: Domains, rows: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Flow stress (k,) Pa, slow and at its strain and temperature, of the softer of the two metals at vertices `rows` on facets."""
    surface, particle, target = domains.surface, domains.particle, domains.target
    element = target.mesh.facet_element[facets]
    first = np.zeros(len(rows), np.int32)
    eps_p, T, gradient = (
        surface.values(values)[rows]
        for values in (particle.points.eps_p, particle.points.T, particle.points.eps_gradient)
    )
    own = yield_stresses(particle.law, first, eps_p, T, gradient)
    other = yield_stresses(
        target.laws,
        target.law_of[element],
        target.elements.eps_p[element],
        target.elements.T[element],
        target.elements.eps_gradient[element],
    )
    return np.minimum(own, other)
