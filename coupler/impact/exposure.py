"""Clean metal that an impact exposes and presses together, at each vertex of the particle's surface: the film theory of bonding."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.sparse import csr_matrix

from ..contact.hold import CONTACT_RANGE
from ..geometry.triangles import areas, rings, vertex_areas
from ..physics.adhesion import EXTRUSION, sound_fraction
from ..physics.constitutive import yield_stresses
from ..state.records import Shape, assign, collect
from .domains import Domains


@dataclass(frozen=True)
class ExposureState:
    """area_0 (v,), facet_area_0 (f,) m2: of vertices and facets at the start; exposed, sound (v,): see `Exposure`."""

    area_0: Annotated[np.ndarray, Shape(-1)]
    facet_area_0: Annotated[np.ndarray, Shape(-1)]
    exposed: Annotated[np.ndarray, Shape(-1)]
    sound: Annotated[np.ndarray, Shape(-1)]


class Exposure:
    """What the interface has gone through so far, at the v vertices of the particle's surface.

    exposed (v,): share of clean metal, of the two surfaces the smaller, 1 - A_0 / A by the expansion of each; the largest so far.
    sound (v,): share of the area that has bonded, the largest so far (`physics.adhesion.sound_fraction`).
    extruding (v,): whether the pressure of this instant brings metal through the cracks.
    """

    def __init__(self, domains: Domains):
        surface, mesh = domains.surface, domains.target.mesh
        skin = surface.positions(domains.particle.x)
        self.area_0, self.facet_area_0 = vertex_areas(skin, surface.triangles), areas(domains.target.x, mesh.facets)
        self.exposed, self.sound, self.extruding = np.zeros(len(skin)), np.zeros(len(skin)), np.zeros(len(skin), bool)
        start, ring = rings(surface.triangles, np.arange(len(skin)))
        self._ring = csr_matrix((np.ones(len(ring)), ring, start), shape=(len(skin), len(skin)))

    def update(self, domains: Domains, threshold: np.ndarray) -> None:
        """Take note of an instant. threshold (l,): exposure at which the films on each law of the target crack."""
        surface, particle, target, contact = domains.surface, domains.particle, domains.target, domains.contact
        rows, facets = contact.touching(len(self.sound), CONTACT_RANGE * particle.spacing)
        self.extruding[:] = False
        if len(rows) == 0:
            return
        area = vertex_areas(surface.positions(particle.x), surface.triangles)
        own = 1.0 - self.area_0[rows] / area[rows]
        other = 1.0 - self.facet_area_0[facets] / areas(target.x, target.mesh.facets[facets])
        self.exposed[rows] = np.maximum(self.exposed[rows], np.minimum(own, other))
        force = contact.stiffness * surface.at_vertices(contact.depth)
        pressure = ((force + self._ring @ force) / (area + self._ring @ area))[rows]  # of a vertex and its neighbours
        strength = softer_strength(domains, rows, facets)
        self.extruding[rows] = pressure > EXTRUSION * strength
        cracked = threshold[target.law_of[target.mesh.facet_element[facets]]]
        sound = sound_fraction(self.exposed[rows], cracked, pressure, strength)
        self.sound[rows] = np.maximum(self.sound[rows], sound)

    def state(self) -> ExposureState:
        """Everything there is to keep."""
        return collect(ExposureState, self)

    def restore(self, state: ExposureState) -> None:
        """Go on from a `state`. Raises CheckpointError where it does not fit."""
        assign(self, state)


def softer_strength(domains: Domains, rows: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Flow stress (k,) Pa, slow and at its strain and temperature, of the softer of the two metals at vertices `rows` on facets."""
    surface, particle, target = domains.surface, domains.particle, domains.target
    element = target.mesh.facet_element[facets]
    first = np.zeros(len(rows), np.int32)
    own = yield_stresses(particle.law, first, surface.values(particle.eps_p)[rows], surface.values(particle.T)[rows])
    other = yield_stresses(target.laws, target.law_of[element], target.eps_p[element], target.T[element])
    return np.minimum(own, other)
