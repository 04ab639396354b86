"""Quasi-static steps of a target towards equilibrium, with their own masses and fixed nodes."""

import numpy as np

from ..physics import motion
from .explicit import Target
from .stability import HighestFrequency, masses_for
from .window import outside


class Relaxation:
    """Quasi-static steps of a target at rest, or of a part of it, without bulk viscosity, absorbing faces and conduction. Masses,
    fixed nodes and time steps of the target itself do not change.

    fixed (k,): fixed nodes of the target and nodes at the edge of the part; free (n,) bool: all others; mass (n,) kg, inv_mass (n,)
    1/kg: masses of the nodes and their inverses, where inv_mass is 0 for fixed nodes; dt (s): time step, see `weigh`.
    """

    def __init__(self, target: Target, radius: float, dt: float):
        """radius (m): only nodes and elements whose reach (`TetMesh`) is smaller can move. If other elements have pending heat
        (`ElementState.heat`), the target first makes one step of dt s, in which this heat raises the pressure."""
        t = self.target = target
        t.activate_all()
        m = int(np.searchsorted(t.mesh.reach_element, radius))
        if t.elements.heat[m:].any():
            own = t.elements.heat[:m].copy()
            t.elements.heat[:m] = 0.0
            t.advance(dt, is_conducting=False)
            t.elements.heat[:m] += own  # beside the heat of plastic work in this step
        t.activate_all(radius)
        self.fixed = np.union1d(t.fixed, outside(t.mesh, t.active_elements, t.active_nodes))
        self.free = t.inv_mass > 0.0
        self.free[self.fixed] = False
        self.mass, self.dt = t.mass, 0.0
        self._invert()

    def weigh(self, highest: HighestFrequency, dt: float) -> None:
        """Set the masses with which the safe bound of the time step is dt s for every element. The time step of the relaxation becomes
        the stability limit of the whole mesh with these masses, which is longer (`fe.stability`)."""
        self.mass = masses_for(self.target, dt)
        self._invert()
        t = self.target
        masses = self.mass, self.inv_mass
        self.dt = highest.longest_step(t, dt, t.active_nodes, t.active_elements, masses=masses)

    def add_mass(self, mass: np.ndarray) -> None:
        """Make the nodes heavier by mass (n,), kg."""
        self.mass = self.mass + mass
        self._invert()

    def _invert(self) -> None:
        self.inv_mass = np.where(self.free, 1.0 / self.mass, 0.0)
        self._damped = self.inv_mass.copy()

    def advance(self, damping: float) -> None:
        """Make one step like `Target.advance`, with forces divided by 1 + damping; `motion.damp` damps the velocities. damping: dt
        times the angular frequency (1/s) that is critically damped."""
        t, n = self.target, self.target.active_nodes
        t.balance.impulse += self.dt * t.support
        np.divide(self.inv_mass[:n], 1.0 + damping, out=self._damped[:n])
        t.move(n, self.dt, self.dt, self._damped)

    def finish(self) -> None:
        """Complete the step like `Target.finish`."""
        t = self.target
        t.add_up(self.dt)
        t.pull()
        if len(self.fixed):
            t.support -= motion.sum_at(self.fixed, t.nodes.total)

    def rest(self) -> None:
        """Set all velocities to zero."""
        t = self.target
        stopped = self.mass @ t.nodes.v  # momentum that an external impulse takes
        t.balance.impulse = t.balance.impulse + 0.5 * self.dt * t.support - stopped
        t.nodes.v[:], t.support = 0.0, np.zeros(3)
        t.rest()
