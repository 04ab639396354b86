"""Positions and shapes of the bodies of a target: under a particle, near a point, after all impacts."""

from collections.abc import Sequence

import numpy as np

from ..fe.explicit import Target
from ..geometry.extent import shape_measures
from ..geometry.raycast import RaySurface
from ..physics.constitutive import von_mises
from .bodies import Bodies
from .domain import Point


def level_under(vertices: np.ndarray, x: np.ndarray, facets: np.ndarray) -> float:
    """Upward displacement (m) after which the surface of a body just touches the facets below; -inf if there are no facets below.

    vertices (k,3) m: vertices of the body's surface; x (n,3) m, facets (f,3): nodes and facets of the surfaces below.
    """
    return float(np.max(heights_at(vertices[:, :2], x, facets) - vertices[:, 2], initial=-np.inf))


def heights_at(axes: np.ndarray, x: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Largest height (k,) m at which vertical lines through axes (k,2) m cross facets (f,3) of x (n,3) m; -inf for no crossing."""
    line, z, _ = RaySurface(x, facets, closed=False).on_verticals(axes[:, 0], axes[:, 1])
    height = np.full(len(axes), -np.inf)
    np.maximum.at(height, line, z)
    return height


def points_of_impact(bodies: Bodies, offsets: Sequence[tuple[float, float]]) -> list[Point]:
    """Points of impact (x, y, z) m, where the vertical axis of each particle at an offset (m) crosses the surface."""
    t = bodies.target
    if bodies.is_flat:  # no ray casting, whose library takes time to load
        return [(*offset, 0.0) for offset in offsets]
    z = heights_at(np.array(offsets), t.nodes.x, t.mesh.facets[bodies.reachable()])
    return [(*offset, float(h) if np.isfinite(h) else 0.0) for offset, h in zip(offsets, z, strict=True)]


def near(bodies: Bodies, points: Sequence[Point], radius: float) -> list[int]:
    """Bodies whose bounding boxes lie within `radius` m of one of the points."""
    low, high = bodies.surfaces.boxes(bodies.target.nodes.x)
    at = np.array(points)[:, None]
    away = np.maximum(np.maximum(low - at, at - high), 0.0)
    return np.flatnonzero((np.linalg.norm(away, axis=2) < radius).any(axis=0)).tolist()


def displacement_back(before: Target, now: Target) -> tuple[np.ndarray, np.ndarray] | None:
    """Nodes (k,) of a target that were at the elastic edge of the window, and the displacements (k,3) m that move them back to their
    rest positions, because elements beyond the edge have not moved. None if there is no such edge."""
    if before.edge is None:
        return None
    index, row = now.nodes.node_number, np.full(1 + int(before.nodes.node_number.max()), -1)
    known = np.flatnonzero(index >= 0)
    row[index[known]] = known
    nodes = row[before.nodes.node_number[before.edge.nodes]]
    return nodes, before.edge.rest - now.nodes.x[nodes]


def means_of(bodies: Bodies, body: int) -> dict[str, float]:
    """Volume averages of von Mises stress (Pa), pressure (Pa), plastic strain and temperature (K) over the elements of a body."""
    t = bodies.target
    own = bodies.body == body
    weight = t.elements.volume[own]
    values = {
        "von_mises_Pa": von_mises(t.elements.s[own]), "pressure_Pa": t.nodes.p[t.mesh.conn[own]].mean(axis=1),
        "eps_p": t.elements.plastic_strain[own], "T_K": t.elements.T[own],
    }  # fmt: skip
    return {name: float(np.average(value, weights=weight)) for name, value in values.items()}


def splats_at_end(bodies: Bodies, diameters: Sequence[float], levels: Sequence[float]) -> list[dict[str, float] | None]:
    """Shape measures of the splats of the first impacts, SI; None for a splat that has left.

    diameters (k,) m: diameters of their particles; levels (k,) m: height of the surface under each particle before its impact.
    """
    mesh, standing = bodies.target.mesh, []
    impact_of_facet = bodies.impact[bodies.body[mesh.facet_element]]
    for number, (diameter, level) in enumerate(zip(diameters, levels, strict=True), 1):
        facets = mesh.facets[impact_of_facet == number]
        away = bodies.target.nodes.x - np.array([0.0, 0.0, level])
        standing.append(shape_measures(away, facets, diameter) if len(facets) else None)
    return standing
