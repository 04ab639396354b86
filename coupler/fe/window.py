"""A window on the target: what lies beyond a radius round the impact is at rest, and a layer before it damps waves.

Nodes on the window's edge are held, so that what is outside neither moves nor strains, and only has to be added up once: the forces
of its resting elements are in equilibrium. Before the edge a layer takes velocity away, with a rate that grows with the square of the
depth into it (Israeli & Orszag 1981, J. Comput. Phys. 41, 115).
"""

import numpy as np

from .mesh import TetMesh

LAYER = 0.2  # of the radius
ABSORBED = 3.0  # wave speeds over the layer's thickness, the rate at its end: a dashpot of rho c to long waves


def outside(mesh: TetMesh, elements: int, nodes: int) -> np.ndarray:
    """Ids (k,) of the first `nodes` nodes, the active ones, that also belong to elements other than the first `elements`, the active
    ones: the edge of the window."""
    others = np.unique(mesh.conn[elements:])
    return others[others < nodes]


def layer(mesh: TetMesh, radius: float, nodes: int, wave_speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Which of the first `nodes` nodes lie in the layer before the radius (m), and the rate (1/s) at which each loses its velocity."""
    thickness = LAYER * radius
    depth = (mesh.reach_node[:nodes] - (radius - thickness)) / thickness
    inside = np.flatnonzero(depth > 0.0)
    return inside, ABSORBED * wave_speed / thickness * np.minimum(depth[inside], 1.0) ** 2
