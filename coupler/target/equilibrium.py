"""Equilibrium of the bodies between impacts, by dynamic relaxation with its own masses and damping.

With real masses a few crushed elements would limit the time step. Here each element gets the mass with which its time step equals that
of all others: the number of steps does not depend on element sizes. A coarse grid moves whole regions at once (`fe.coarse`): the
number of steps does not depend on the number of elements across the bodies. The damping is critical for the lowest frequency in
motion, which a Rayleigh quotient of forces and velocities gives in each step (Underwood 1983, in Belytschko & Hughes, Computational
methods for transient analysis, section 5.5). For a higher accuracy (`Aim`) the damping is later limited to the critical one of the
slowest motion, that of thin rims of splats. Stresses, flow, bonds, contact and friction are those of the explicit solver.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..core import safety
from ..core.loops import PARTS
from ..core.threads import share, together
from ..errors import SolverError
from ..fe.coarse import CoarseGrid
from ..fe.relaxed import Relaxation
from ..fe.stability import HighestFrequency
from ..physics import motion
from .bodies import Bodies

RELAX_STEP = 1e-10  # s: about a real step, so that strain rates are about those of the real motion
SEARCH_EVERY = 10  # steps
SLACK = 0.1  # edges of the smallest element: motion of surfaces between two searches in addition to that by their velocities
LEAST_DAMPING, MOST_DAMPING = 0.004, 0.5  # dt times the frequency for which the damping is critical
# About the critical damping of the slowest motion: more damping slows it down, and faster motions decay equally fast with this.
SLOW_DAMPING = 0.06
RELAX_STEPS = 2500  # at most
BACK = 20  # steps in which fixed nodes are moved and overlapping bodies are pushed apart
LOCAL = 0.5  # largest share of the elements in a local equilibrium: a larger part takes about as long as all elements
RELEASE_TIME = 5e-9  # s after joining in which the released kinetic energy is measured, for particles of 25 um


class Aim(NamedTuple):
    """Required accuracy of an equilibrium. left: largest remaining energy divided by the kinetic energy of the impacts before; ramp:
    number of steps over which pending heat (`ElementState.heat`) raises the pressure, as in slow cooling; quick: number of steps after
    which the damping is limited to SLOW_DAMPING."""

    left: float
    ramp: int
    quick: int


RELAXED = 2e-5
JOINED = Aim(RELAXED, 0, RELAX_STEPS)
# Before a pause. Long waves from the rims of sub-domains must not oscillate: they would cause plastic flow.
BALANCED = Aim(4e-6, 0, BACK)
COOLED = Aim(4e-7, 40, 0)  # after a pause: stresses within a few MPa


@dataclass
class Known:
    """Data that one equilibrium passes to the next one of the same bodies. highest: power iteration for the highest frequency of
    the elements; grid: number of active elements, and their coarse grid."""

    highest: HighestFrequency | None = None
    grid: tuple[int, CoarseGrid] | None = None


def settle(
    bodies: Bodies,
    kinetic_0: float,
    release_time: float = RELEASE_TIME,
    aim: Aim = JOINED,
    radius: float = np.inf,
    known: Known | None = None,
    back: tuple[np.ndarray, np.ndarray] | None = None,
) -> dict[str, float]:
    """Bring all bodies to rest in equilibrium. All elements are active during it; those beyond the wave front are inactive after it.

    kinetic_0 (J): kinetic energy of the impacts before, the scale of the remaining energy. release_time (s): duration of the real
    motion after the equilibrium, in which the released energy is measured. radius (m): only nodes whose reach (`TetMesh`) is
    smaller move, but pending heat (`Aim`) raises the pressure of all; if more than LOCAL of the elements lie within it, all move.
    known: results of an earlier equilibrium of these bodies, updated for the next one. back: fixed nodes (k,), and displacements
    (k,3) m by which they are moved. The simulated time does not advance, and no heat is conducted. Returns the number of steps and
    energies. Raises SolverError if a tetrahedron inverts, or if the bodies then have more kinetic energy than the impacts before.
    """
    t = bodies.target
    if np.searchsorted(t.mesh.reach_element, radius) > LOCAL * len(t.mesh.conn):
        radius = np.inf
    reach = t.reach
    energy = _stored(bodies) + t.kinetic()
    t.rest()
    relaxation = Relaxation(t, radius, RELAX_STEP)
    report = _relax(bodies, relaxation, aim._replace(left=aim.left * kinetic_0), known or Known(), back)
    removed = energy - _stored(bodies)
    released = _run_for(bodies, release_time)
    if not released <= kinetic_0:
        raise SolverError(
            f"bodies at rest gained {released:.3g} J, more than the {kinetic_0:.3g} J of the impact: the time step is"
            " not stable; try another [splat] method or a finer preset"
        )
    t.rest()
    t.deactivate_beyond(reach)
    return report | {"taken_J": removed, "released_J": released, "released": released / kinetic_0}


def _stored(bodies: Bodies) -> float:
    """All energy (J) except kinetic energy. The damping dissipates the amount by which it decreases."""
    t = bodies.target
    return t.elastic() + t.balance.plastic + bodies.energy


def _relax(
    bodies: Bodies, relaxation: Relaxation, aim: Aim, known: Known, back: tuple[np.ndarray, np.ndarray] | None
) -> dict[str, float]:
    """Make steps of dynamic relaxation until the remaining energy is at most aim.left, which is in J here, or until RELAX_STEPS steps.
    Returns the number of steps and the remaining energy (J). known, back: see `settle`."""
    t = bodies.target
    m = t.active_elements
    heat = t.elements.heat[:m].copy()
    moved, moving = back if back is not None else (np.zeros(0, np.int64), np.zeros((0, 3)))
    goal, moving_for = t.nodes.x[moved] + moving, BACK if len(moved) else 0
    if aim.ramp:
        t.elements.heat[:m] = 0.0
    _search(bodies, RELAX_STEP)
    known.highest = known.highest or HighestFrequency(len(t.nodes.x), len(t.mesh.conn))
    _weigh(bodies, relaxation, known.highest)
    dt = relaxation.dt
    if known.grid is None or known.grid[0] != m:
        known.grid = m, CoarseGrid(t, relaxation.free, relaxation.mass, dt, bodies.springs())
    grid = known.grid[1]
    steps, left, n = 0, np.inf, t.active_nodes
    along, momentum = np.zeros((2, n, 3))
    before, damping = t.nodes.total[:n].copy(), MOST_DAMPING if aim.quick else SLOW_DAMPING

    def damp(lo: int, hi: int) -> None:
        motion.damp(lo, hi, relaxation.free, dt, damping, t.nodes.total, along, t.nodes.v, momentum)

    while steps < RELAX_STEPS and left > aim.left:
        if steps % SEARCH_EVERY == 0:
            _search(bodies, dt)
        share(damp, n, motion.LEAST)
        if steps < aim.ramp:
            t.elements.heat[:m] += (_ramp((steps + 1) / aim.ramp) - _ramp(steps / aim.ramp)) * heat
        t.nodes.v[moved] = (goal - t.nodes.x[moved]) / ((moving_for - steps) * dt) if steps < moving_for else 0.0
        if steps < BACK:
            bodies.reduce_overlap(1.0 - 1.0 / (BACK - steps))
        relaxation.advance(damping)
        bodies.forces(dt)
        relaxation.finish()
        steps += 1
        along = grid.acceleration(t.nodes.total[:n])
        kinetic, omega2, unbalanced = _moving(relaxation, n, along, momentum, before)
        most = MOST_DAMPING if steps < aim.quick else SLOW_DAMPING
        damping = float(np.clip(dt * np.sqrt(omega2), LEAST_DAMPING, most))
        if steps > max(2 * SEARCH_EVERY, aim.ramp, moving_for):
            left = max(kinetic, unbalanced / max(omega2, (LEAST_DAMPING / dt) ** 2))
    relaxation.rest()
    return {"settle_steps": float(steps), "left_J": float(left)}


def _ramp(passed: float) -> float:
    """Fraction of a temperature change that is applied when the fraction `passed` of the ramp is done. The ramp starts and ends
    smoothly: with little damping a sudden change makes stresses overshoot, and more metal yields."""
    return passed * passed * (3.0 - 2.0 * passed)


def _weigh(bodies: Bodies, relaxation: Relaxation, highest: HighestFrequency) -> None:
    """Give the nodes masses with which elements and all springs between bodies are stable with the same time step.

    First the masses for the elements are set: with them the safe bound of the step is RELAX_STEP. The step itself is the true limit
    of the mesh with these masses, which is longer (`fe.stability`). The masses for the springs are set for this step and added.
    """
    relaxation.weigh(highest, RELAX_STEP)
    n, share_of = len(bodies.target.nodes.x), 0.25 * relaxation.dt * relaxation.dt
    bond, contact = bodies.bond, bodies.contact
    springs = [bond.springs() if bond is not None else None, contact.pairs if contact is not None else None]
    loads = [each.load(n) for each in springs if each is not None]
    for load in (*loads, bodies.target.foundation_load()):
        relaxation.add_mass(share_of * load)


def _moving(
    relaxation: Relaxation, n: int, along: np.ndarray, momentum: np.ndarray, before: np.ndarray
) -> tuple[float, float, float]:
    """Kinetic energy (J) of the first n nodes with the masses of the relaxation, squared frequency (1/s2) of the present motion, and
    f M^-1 f / 2 (N m/s2) of the unbalanced forces f: an energy if divided by the squared frequency. along (n,3) m/s2: part of M^-1 f
    from the coarse grid; momentum (n,3) kg m/s; before (n,3) N: forces one step ago, updated to the present ones."""
    t, sums = relaxation.target, np.zeros((PARTS, 3))
    free, mass = relaxation.free, relaxation.mass[:n]
    together(motion.moving, free[:n], mass, t.nodes.total[:n], along, momentum, t.nodes.v[:n], before, sums)
    twice, power, unbalanced = sums.sum(axis=0)
    return 0.5 * twice, max(power / relaxation.dt / twice, 0.0) if twice > 0.0 else 0.0, 0.5 * unbalanced


def _run_for(bodies: Bodies, time: float) -> float:
    """Continue for `time` s with real masses and without damping. Returns the largest kinetic energy, J."""
    t, largest, left = bodies.target, 0.0, time
    while left > 0.0:
        _search(bodies, SEARCH_EVERY * t.stable_dt())
        dt = min(safety.SETTLED * bodies.stable_dt(1.0), left)
        for _ in range(SEARCH_EVERY):
            t.advance(dt, is_conducting=False)
            bodies.forces(dt)
            t.finish()
            left -= dt
        largest = max(largest, 0.5 * float(t.mass @ np.einsum("ai,ai->a", t.nodes.v, t.nodes.v)))
    return largest


def _search(bodies: Bodies, dt: float) -> None:
    t = bodies.target
    fastest = float(np.sqrt(np.max(np.einsum("ij,ij->i", t.nodes.v, t.nodes.v), initial=0.0)))
    time = SEARCH_EVERY * dt
    bodies.search(3.0 * fastest * time + SLACK * float(np.cbrt(t.mesh.V0.min())), time=time)
