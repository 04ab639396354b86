"""Heat in an impact: conduction in the particle and across the contact, heat of friction."""

import numpy as np

from ..contact.particle_bonds import ParticleBonds
from ..geometry.triangles import areas, vertex_areas
from ..physics.constitutive import conductivities, heat_capacities
from .domains import Domains


def flow(domains: Domains, time: float) -> None:
    """Conduct heat for `time` s among the points of the particle and across the contact (`crossing`), each if the effect is on."""
    particle = domains.particle
    if domains.conduction is not None:
        particle.warm(domains.conduction.share(time, particle.x, particle.points.T))
    if domains.plan.effects.interface_conduction:
        rows, elements, heat = crossing(domains, time)
        if len(rows):
            _warm_surface(domains, rows, -heat)
            domains.target.warm(elements, heat)


def release(domains: Domains, bonds: ParticleBonds | None) -> None:
    """Heat the points of the particle, and the elements behind the facets, by the friction and the fracture of bonds since the last
    call. Of the heat of bonds the particle gets the contact's `share`."""
    if not domains.plan.effects.friction_heat:
        return
    particle, target, contact = domains.particle, domains.target, domains.contact
    if contact.heat_point.any():
        particle.warm(domains.surface.spread_heat(contact.heat_point))
        contact.heat_point[:] = 0.0
    facets = np.flatnonzero(contact.heat_face)
    if len(facets):
        target.warm(target.mesh.facet_element[facets], contact.heat_face[facets])
        contact.heat_face[facets] = 0.0
    if domains.folding is not None and (heat := domains.folding.heat()).any():
        particle.warm(heat)
    if bonds is not None and (heat := bonds.bond.heat()).any():
        _warm_surface(domains, bonds.bond.nodes, contact.constants.share * heat)
        target.warm_around(bonds.bond.triangles, np.repeat((1.0 - contact.constants.share) / 3.0 * heat, 3))


def _warm_surface(domains: Domains, rows: np.ndarray, heat: np.ndarray) -> None:
    """Add heat (k,) J at rows (k,) of the particle's surface to its points."""
    into = np.zeros(domains.surface.touching.shape[0])
    into[rows] = heat
    domains.particle.warm(domains.surface.spread_heat(into))


def crossing(domains: Domains, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (k,) of the particle in contact, the element (k,) under each, and the heat (k,) J that the element gets in `time` s.

    Each pair is modelled as two heat capacities, those of a layer of the particle one spacing thick and of the vertex's part of the
    element. Their temperatures approach each other exponentially, which is stable for any time. The thermal resistance is that of the
    material between the contact and the places of the two temperatures.
    """
    particle, target, surface = domains.particle, domains.target, domains.surface
    rows, facets = domains.contact.touching(len(surface.weights.indptr) - 1)
    if len(rows) == 0:
        return rows, rows, np.zeros(0)
    elements = target.mesh.facet_element[facets].astype(np.int64)
    touching = np.zeros(len(surface.weights.indptr) - 1, bool)
    touching[rows] = True
    skin, inside = surface.positions(particle.x), surface.values(particle.x)[rows]
    area = vertex_areas(skin, surface.triangles[touching[surface.triangles].any(axis=1)])[rows]
    T_a, T_b = surface.values(particle.points.T)[rows], target.elements.T[elements]
    deep_a = np.linalg.norm(skin[rows] - inside, axis=1)
    # distance of the centroid of a tetrahedron from its face
    deep_b = 0.75 * target.elements.volume[elements] / areas(target.nodes.x, target.mesh.facets[facets])
    a, b = particle.law[0], target.laws[target.law_of[elements]]
    resistance = deep_a / conductivities(a, T_a) + deep_b / conductivities(b, T_b)
    C_a = a["rho"] * heat_capacities(a, T_a) * area * particle.spacing
    sharing = np.bincount(elements, minlength=len(target.elements.T))[elements]
    C_b = b["rho"] * heat_capacities(b, T_b) * target.mesh.V0[elements] / sharing
    together = C_a * C_b / (C_a + C_b)
    return rows, elements, together * (T_a - T_b) * -np.expm1(-area / resistance * time / together)
