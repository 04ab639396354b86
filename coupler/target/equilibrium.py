"""Coming to rest between impacts: dynamic relaxation, with masses and damping made for it and for nothing else.

Real masses would make a handful of crushed elements dictate the step, and hundreds of them the way to equilibrium. Here every
element is given the mass with which it just bears the same step, so that the number of steps does not follow from their sizes, and
a coarse grid moves whole regions at once (`fe.coarse`), so that it does not follow from how many elements there are across the
bodies. Damping is that of the lowest frequency now in motion, which a Rayleigh quotient of forces and velocities says in each step
(Underwood 1983, in Belytschko & Hughes, Computational methods for transient analysis, section 5.5). Where more accuracy is asked for
(`Aim`) it ends as that of the slowest motion: thin rims of splats are slower than all that the grid can have. Positions, stresses,
plastic flow, bonds, contact and friction go their way as in the explicit solver.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from ..core import safety
from ..core.loops import PARTS
from ..core.threads import share, together
from ..fe.coarse import CoarseGrid
from ..fe.explicit import Target
from ..fe.relaxed import Relaxation
from ..fe.stability import HighestFrequency
from ..physics import motion
from .bodies import Bodies

RELAX_STEP = 1e-10  # s: about a real one, so that strain rates are about those of the real motion
SEARCH_EVERY = 10
WAY = 0.1  # edges of the smallest element that surfaces may move between two searches beside what their velocities say
LEAST_DAMPING, MOST_DAMPING = 0.004, 0.5  # of the critical one of the step itself
# About the critical one of the slowest motion. More slows that one down; all faster ones decay as fast with this.
SLOW_DAMPING = 0.06
RELAX_STEPS = 2500  # at most
BACK = 20  # steps in which fixed nodes are moved, and bodies that lie in each other are pushed apart
LOCAL = 0.5  # share of the elements up to which equilibrium is found in a part of the bodies: more of them cost hardly less than all
RELEASE_TIME = 5e-9  # s after joining in which the kinetic energy set free is measured, of particles of 25 um


class Aim(NamedTuple):
    """What an equilibrium is for. left: of the kinetic energy of the impacts before, what may be left to be set free; ramp: steps in
    which pending heat becomes pressure, as in slow cooling; quick: steps before the damping is SLOW_DAMPING at most."""

    left: float
    ramp: int
    quick: int


RELAXED = 2e-5
JOINED = Aim(RELAXED, 0, RELAX_STEPS)
# Before a pause. Long waves that set out from the rims of cuts must not swing: they would make metal flow.
BALANCED = Aim(4e-6, 0, BACK)
COOLED = Aim(4e-7, 40, 0)  # after a pause: stresses within a few MPa


class Known:
    """Data that one equilibrium passes to the next of the same bodies: the coarse grid and the fastest motion of the elements."""

    def __init__(self) -> None:
        self._highest: HighestFrequency | None = None
        self._grid: tuple[int, CoarseGrid] | None = None

    def highest(self, t: Target) -> HighestFrequency:
        """Highest squared frequency of the elements; the iteration starts from the motion found before."""
        if self._highest is None:
            self._highest = HighestFrequency(len(t.nodes.x), len(t.mesh.conn))
        return self._highest

    def grid(self, bodies: Bodies, relaxation: Relaxation) -> CoarseGrid:
        """Coarse grid of the active elements and of the springs between them; the previous grid if the elements are the same."""
        t = bodies.target
        if self._grid is None or self._grid[0] != t.active_elements:
            grid = CoarseGrid(t, relaxation.free, relaxation.mass, relaxation.dt, bodies.springs())
            self._grid = t.active_elements, grid
        return self._grid[1]


def settle(
    bodies: Bodies,
    kinetic_0: float,
    release_time: float = RELEASE_TIME,
    aim: Aim = JOINED,
    radius: float = np.inf,
    known: Known | None = None,
    back: tuple[np.ndarray, np.ndarray] | None = None,
) -> dict[str, float]:
    """Bring all bodies to rest in equilibrium; all elements are active meanwhile, and those out of reach are inactive after it.

    kinetic_0: J of the impacts before, the scale of the remaining energy; release_time: s of real motion, in which the energy released
    afterwards is measured. radius: m from the start of the numbering, beyond which no node moves, unless this holds more than LOCAL of
    the elements; pending heat becomes pressure there too. known: of an equilibrium of these bodies before, and for the next. back:
    fixed nodes (k,), and by how much (k,3) m they are moved in this time. This time is not part of the simulated time: no heat is
    conducted during it. Returns what it took and what was left. Raises SolverError when a tetrahedron inverts.
    """
    t = bodies.target
    if np.searchsorted(t.mesh.reach_element, radius) > LOCAL * len(t.mesh.conn):
        radius = np.inf
    reach = t.reach
    energy = _stored(bodies) + t.kinetic()
    t.rest()
    relaxation = Relaxation(t, radius, RELAX_STEP)
    report = _relax(bodies, relaxation, aim._replace(left=aim.left * kinetic_0), known or Known(), back)
    taken = energy - _stored(bodies)
    released = _run_for(bodies, release_time)
    t.rest()
    t.deactivate_beyond(reach)
    return report | {"taken_J": taken, "released_J": released, "released": released / kinetic_0}


def _stored(bodies: Bodies) -> float:
    """Energy (J) without the kinetic energy: its loss is the energy that damping has taken."""
    t = bodies.target
    return t.elastic() + t.balance.plastic + bodies.energy


def _relax(
    bodies: Bodies,
    relaxation: Relaxation,
    aim: Aim,
    known: Known,
    back: tuple[np.ndarray, np.ndarray] | None,
) -> dict[str, float]:
    """Steps of dynamic relaxation until what may still be set free is below aim.left, in J here; known, back: see `settle`."""
    t = bodies.target
    m = t.active_elements
    heat = t.elements.heat[:m].copy()
    moved, moving = back if back is not None else (np.zeros(0, np.int64), np.zeros((0, 3)))
    goal, moving_for = t.nodes.x[moved] + moving, BACK if len(moved) else 0
    if aim.ramp:
        t.elements.heat[:m] = 0.0
    _search(bodies, RELAX_STEP)
    _weigh(bodies, relaxation, known.highest(t))
    dt = relaxation.dt
    steps, left, n = 0, np.inf, t.active_nodes
    grid, along, momentum = known.grid(bodies, relaxation), np.zeros((n, 3)), np.zeros((n, 3))
    before, damping = t.nodes.total[:n].copy(), MOST_DAMPING if aim.quick else SLOW_DAMPING
    while steps < RELAX_STEPS and left > aim.left:
        if steps % SEARCH_EVERY == 0:
            _search(bodies, dt)
        share(partial(_damp, t, relaxation.free, dt, damping, along, momentum), n, motion.LEAST)
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
    """Share of a change of temperature that has come when a share `passed` of the ramp has. It begins and ends gently: where it
    does so suddenly, so little damping lets stresses overshoot, and more metal yields."""
    return passed * passed * (3.0 - 2.0 * passed)


def _weigh(bodies: Bodies, relaxation: Relaxation, highest: HighestFrequency) -> None:
    """Give the nodes the masses with which elements and all springs between bodies bear one step.

    The elements' bound is safe but short (`fe.stability`): the step is the one that the elements really bear with the masses for
    RELAX_STEP, and the springs, whose bound is sharp, get theirs for that.
    """
    relaxation.weigh(highest, RELAX_STEP)
    n, share_of = len(bodies.target.nodes.x), 0.25 * relaxation.dt * relaxation.dt
    pairs = bodies.contact.pairs if bodies.contact is not None else None
    loads = [springs.load(n) for springs in (bodies.bond, pairs) if springs is not None]
    for load in (*loads, bodies.target.foundation_load()):
        relaxation.add_mass(share_of * load)


def _damp(
    t: Target, free: np.ndarray, dt: float, damping: float, along: np.ndarray, momentum: np.ndarray, lo: int, hi: int
) -> None:
    motion.damp(lo, hi, free, dt, damping, t.nodes.total, along, t.nodes.v, momentum)


def _moving(
    relaxation: Relaxation, n: int, along: np.ndarray, momentum: np.ndarray, before: np.ndarray
) -> tuple[float, float, float]:
    """Kinetic energy (J) of the first n nodes in the masses of the relaxation, the squared frequency (1/s2) of what moves now, and
    f M^-1 f / 2 (N m/s2) of the forces f that nothing balances: over omega^2 an energy. along (n,3) m/s2: the grid's part of M^-1 f;
    before (n,3) N: the forces a step ago, and then those of now."""
    t, sums = relaxation.target, np.zeros((PARTS, 3))
    free, mass = relaxation.free, relaxation.mass[:n]
    together(motion.moving, free[:n], mass, t.nodes.total[:n], along, momentum, t.nodes.v[:n], before, sums)
    twice, power, unbalanced = sums.sum(axis=0)
    return 0.5 * twice, max(power / relaxation.dt / twice, 0.0) if twice > 0.0 else 0.0, 0.5 * unbalanced


def _run_for(bodies: Bodies, time: float) -> float:
    """Run `time` s with real masses and no damping; returns the largest kinetic energy, J."""
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
    bodies.search(3.0 * fastest * time + WAY * float(np.cbrt(t.mesh.V0.min())), time=time)
