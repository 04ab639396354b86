"""Measures of an impact: shape, strain, temperature, stress, velocity."""

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from ..core.arrays import Floats
from ..fe.explicit import Target
from ..geometry.extent import shape_measures
from ..geometry.raycast import RaySurface
from ..geometry.triangles import enclosed_volume
from ..particle.carried_surface import CarriedSurface
from ..physics.constitutive import von_mises
from .domains import Domains

FAR = 2.0  # spacings: a vertex farther from all points lies in a jet that is not resolved
YIELDED = 0.002  # smallest plastic strain of a yielded element: the offset of the 0.2 % proof stress


def share_inside_itself(surface: CarriedSurface, x: np.ndarray) -> float:
    """Fraction of the points x (n,3) m of a particle that lie inside another part of the same particle. There the winding number of
    the surface, including cavities, is above 1."""
    return float(np.mean(RaySurface(surface.positions(x), surface.triangles).windings(x) > 1))


def tension(stress: np.ndarray) -> np.ndarray:
    """Greatest principal stress (n,) Pa, tension positive, of tensors (n,6) Pa, Voigt xx yy zz yz xz xy."""
    return np.linalg.eigvalsh(stress[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]])[:, -1]


def crater_depth(surface: np.ndarray) -> float:
    """Depth of the crater below z = 0, m. surface (k,3) m: surface nodes of the target. The depth is 0 without nodes, as in the
    sub-domain of an impact on a pile higher than its window.

    A paraboloid is fitted to the 16 nodes nearest to the deepest one, because the depth of a single node depends on the mesh. The
    depth is the lowest value of this paraboloid at a node.
    """
    if len(surface) == 0:
        return 0.0
    deepest = surface[np.argmin(surface[:, 2])]
    distance = np.hypot(surface[:, 0] - deepest[0], surface[:, 1] - deepest[1])
    d = surface[np.argsort(distance, kind="stable")[:16]] - deepest
    size = float(np.abs(d[:, :2]).max()) or 1.0
    x, y = d[:, 0] / size, d[:, 1] / size
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    fit = np.linalg.lstsq(terms, d[:, 2], rcond=None)[0]
    return float(-(deepest[2] + (terms @ fit).min()))


def plastic_zone(target: Target, heights: Callable[[Floats], Floats]) -> tuple[float, float]:
    """Radius and depth (m) of the part of the substrate that has a plastic strain of at least YIELDED; both are 0 if there is none.

    Radius: of the circle with the area of the yielded part of the surface, seen from above; depth: largest depth of a yielded
    element's centroid below the undeformed ground. heights(points (k,2) m): heights (k,) m of this ground.
    """
    mesh, yielded = target.mesh, target.elements.eps_p >= YIELDED
    top = mesh.sets["top"]
    top = top[yielded[mesh.facet_element[top]]]
    corners = target.nodes.x[mesh.facets[top], :2]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum())
    middle = target.nodes.x[mesh.conn[yielded]].mean(axis=1)
    depth = float((heights(middle[:, :2]) - middle[:, 2]).max(initial=0.0))
    return float(np.sqrt(area / np.pi)), depth


def measure(domains: Domains, level: float) -> dict[str, float]:
    """Present measures of an impact in SI units, without the crater. level (m): zero of heights. Means are over mass, percentiles over
    points."""
    particle, target, surface = domains.particle, domains.target, domains.surface
    rho = particle.law["rho"]
    matter = particle.mass * (rho[0] / rho[particle.law_of])  # mass with the density of the first material
    vertices = surface.positions(particle.x)
    skin = vertices - [0.0, 0.0, level]
    m = shape_measures(skin, surface.triangles, domains.own.diameter)
    whole, outer = domains.whole_surface, enclosed_volume(skin, surface.triangles)
    metal = outer if whole is surface else enclosed_volume(whole.positions(particle.x), whole.triangles)
    m["surface_volume_error"] = metal * float(rho[0]) / float(matter @ particle.points.J) - 1.0
    if whole is not surface:
        m["pore_share"] = 1.0 - metal / outer
    m["unresolved_share"] = float(np.mean(cKDTree(particle.x).query(vertices)[0] > FAR * particle.spacing))
    m["eps_p_mean"] = float(np.average(particle.points.eps_p, weights=particle.mass))
    m["eps_p_p99"] = float(np.percentile(particle.points.eps_p, 99))
    m["eps_p_max"] = float(particle.points.eps_p.max())
    m["T_mean_K"] = float(np.average(particle.points.T, weights=particle.mass))
    m["T_p99_K"] = float(np.percentile(particle.points.T, 99))
    m["T_max_K"] = float(particle.points.T.max())
    m["von_mises_max_Pa"] = float(von_mises(particle.stress()).max())
    m["target_eps_p_max"] = float(target.elements.plastic_strain.max())
    m["target_T_max_K"] = float(target.elements.T.max())
    m["target_von_mises_max_Pa"] = float(von_mises(target.stress()).max())
    m["plastic_radius_m"], m["plastic_depth_m"] = plastic_zone(target, domains.plan.target.heights)
    m["velocity_z_m_s"] = float(particle.totals.momentum[2] / particle.mass.sum())
    return m
