"""Film theory of bonding: at each vertex of the particle, cracks of oxide films expose clean metal, which is pressed together."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..core.arrays import Floats, Ints
from ..core.records import Shape
from ..geometry.triangles import areas, vertex_areas
from ..physics.adhesion import EXTRUSION, clean_share, ligament_bonds, ligament_width, sound_fraction
from .domains import Domains
from .touching import Touching


@dataclass(eq=False)
class Exposure:
    """History of the interface at the v vertices of the particle's surface.

    clean (v,2): clean fraction of the two surfaces, smaller and larger value (`physics.adhesion.clean_share`), at the time when the
    smaller value is largest; sound (v,): largest area fraction at which clean metal has come through the cracks of the films
    (`physics.adhesion.sound_fraction`); extruding (v,): whether the present pressure extrudes metal through the cracks; area_0 (v,),
    facet_area_0 (f,) m2: areas of vertices and facets at the start.
    """

    area_0: Annotated[np.ndarray, Shape(-1)]
    facet_area_0: Annotated[np.ndarray, Shape(-1)]
    clean: Annotated[np.ndarray, Shape(-1, 2)]
    sound: Annotated[np.ndarray, Shape(-1)]
    extruding: Annotated[np.ndarray, Shape(-1, dtype=bool)]

    @classmethod
    def begin(cls, domains: Domains) -> "Exposure":
        """The state at the start of an impact, before any film has cracked."""
        surface, target = domains.surface, domains.target
        area_0 = vertex_areas(surface.positions(domains.particle.x), surface.triangles)
        n, facet_area_0 = len(area_0), areas(target.nodes.x, target.mesh.facets)
        return cls(area_0, facet_area_0, np.zeros((n, 2)), np.zeros(n), np.zeros(n, bool))

    def update(self, domains: Domains, touching: Touching, threshold: np.ndarray) -> None:
        """Update the history at the touching vertices. threshold (l,): exposure at which films crack, for each law of the target."""
        target = domains.target
        rows, facets = touching.rows, touching.facets
        self.extruding[:] = False
        if len(rows) == 0:
            return
        area, force, strength = touching.area, touching.force, touching.strength
        own = 1.0 - self.area_0[rows] / area[rows]
        other = 1.0 - self.facet_area_0[facets] / areas(target.nodes.x, target.mesh.facets[facets])
        cracked = threshold[target.law_of[touching.element]]
        clean = np.sort(np.stack([clean_share(own, cracked), clean_share(other, cracked)], axis=1), axis=1)
        self.clean[rows] = np.where((clean > self.clean[rows])[:, :1], clean, self.clean[rows])
        beside = domains.surface.neighbours
        pressure = ((force + beside @ force) / (area + beside @ area))[rows]  # mean over a vertex and its neighbours
        self.extruding[rows] = pressure > EXTRUSION * strength
        self.sound[rows] = np.maximum(self.sound[rows], sound_fraction(self.clean[rows, 0], pressure, strength))

    def bonds(self, rows: Ints, film_force: Floats, strength: Floats, stiffness: float) -> dict[str, Floats]:
        """Strengths, energies and `rewelds` of bonds at the vertices `rows` (k,): arguments (k,) of `contact.bond.Bond.tie`, by name.
        film_force (k,) N/m: as in `ligament_width`; strength (k,) Pa, stiffness Pa/m: as in `ligament_bonds` (`physics.adhesion`)."""
        smaller, larger = self.clean[rows].T
        width = ligament_width(smaller, film_force, strength)
        return ligament_bonds(self.sound[rows], width, larger, strength, stiffness)
