"""What holds while a target is relaxed: which part of it is active, and that nothing depends on velocities."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from .explicit import Target
from .window import outside


@contextmanager
def active_within(t: Target, radius: float, dt: float) -> Iterator[None]:
    """While this lasts, all is active up to `radius` m from where the numbering begins, and what is beyond keeps still; its pending
    heat becomes pressure there in a step of dt s, at rest."""
    kept = t.horizon, t.fixed, t.inv_mass
    t.activate_all()
    m = int(np.searchsorted(t.mesh.reach_element, radius))
    if t.heat[m:].any():
        own = t.heat[:m].copy()
        t.heat[:m] = 0.0
        t.advance(dt)
        t.heat[:m] = own
    t.horizon, t.active_nodes, t.active_elements = min(radius, t.horizon), 0, 0
    t.activate_all()
    edge = outside(t.mesh, t.active_elements, t.active_nodes)
    t.fixed, t.inv_mass = np.union1d(t.fixed, edge), t.inv_mass.copy()
    t.inv_mass[t.fixed] = 0.0
    try:
        yield
    finally:
        t.horizon, t.fixed, t.inv_mass = kept


@contextmanager
def quasi_static(t: Target) -> Iterator[None]:
    """While this lasts nothing that depends on velocities acts: no bulk viscosity, no absorbing faces."""
    kept = t.dashpot_nodes, t.dashpot
    t.viscous, t.dashpot_nodes, t.dashpot = False, kept[0][:0], kept[1][:0]
    t.drag = np.zeros((0, 3))
    try:
        yield
    finally:
        t.viscous, (t.dashpot_nodes, t.dashpot) = True, kept
        t.drag = np.zeros((len(kept[0]), 3))
