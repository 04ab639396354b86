"""Heat conduction in all bodies during a pause, while they are at rest: Fourier's law, implicit in time.

Linear tetrahedra in the current configuration with lumped capacities; links conduct heat between nodes of one body and facets of
another. The time integration is the L-stable diagonally implicit Runge-Kutta scheme of two stages and second order (Alexander 1977,
SIAM J. Numer. Anal. 14, 1006). Steps grow geometrically, as diffusion slows down; k(T) and c_p(T) are values at the beginning of a
step. Elements have their own temperatures, as in `fe.heat`. Heat is conserved to rounding: the residual of the linear solver is
spread over all nodes.
"""

from collections.abc import Callable, Sequence

import numpy as np

from ..core.arrays import Links
from ..core.threads import share
from ..errors import SolverError
from ..geometry.products import solve, times
from .conductances import Conductances, levels
from .explicit import Target
from .heat import LEAST, add_heat, gains, means, shares
from .model import Elements

GAMMA = 1.0 - 0.5**0.5  # of Alexander's scheme
# ratio of steps: 1.5 reduces the error of temperatures after a pause by a fifth, with 1.6 times the steps
STEP_GROWTH = 2.0
FIRST_STEP = 0.1  # first step divided by the shortest time constant of an element
# of the linear solver: an error of a millikelvin after a pause; 1e-4 takes an eighth more iterations
CG_TOLERANCE = 3e-4


def cool(
    target: Target, time: float, fixed: np.ndarray, fixed_T: float, links: Sequence[Links] = (),
    gas: tuple[np.ndarray, float] | None = None, recover: Callable[[float], None] = lambda _: None,
) -> dict[str, float]:  # fmt: skip
    """Conduct heat for `time` s in a target at rest. T, sigma_y and ledger change at once, pressures in the next step of the target.

    fixed: nodes at the constant temperature fixed_T, K; links: thermal contacts; gas: conductance (n,) W/K from a gas to each node,
    and temperature (K) of the gas; all other faces are adiabatic. recover(time): function called before and after each step with
    half of its time, s. Returns the number of steps, the largest and the mean temperature before and after (K), and the heat (J)
    that has left through fixed nodes and the gas. Raises SolverError when the linear solver does not converge.
    """
    t = target
    n, m = len(t.nodes.x), len(t.mesh.conn)
    carried, excess, rate, own, gain, heat, k = np.zeros((7, m))
    capacity, mean, free = np.zeros(n), np.zeros(n), np.ones(n)
    free[fixed] = 0.0
    elements = Elements.of(t.elements)._replace(heat=heat)

    def carry(lo: int, hi: int) -> None:
        shares(lo, hi, t.cells, t.metals, t.elements.T, carried)

    def nodal(values: np.ndarray) -> np.ndarray:
        share(lambda lo, hi: means(lo, hi, t.cells, carried, values, capacity, mean), n, LEAST)
        return mean.copy()

    def level(lo: int, hi: int) -> None:
        levels(lo, hi, matrix.elements, t.metals, T, t.elements.T, carried, k, excess, rate)

    def lose(lo: int, hi: int) -> None:
        own[lo:hi] = excess[lo:hi] * -np.expm1(-dt * rate[lo:hi])

    def absorb(lo: int, hi: int) -> None:
        gains(lo, hi, t.mesh.conn, carried, change, own, gain)
        add_heat(lo, hi, gain, t.cells, t.metals, elements)
        carry(lo, hi)

    before = _extremes(t)
    share(carry, m, LEAST)
    T = nodal(t.elements.T)
    from_gas, T_gas = gas or (np.zeros(n), 0.0)
    matrix = Conductances.of(t.nodes.x, t.cells, Links.joined(links), from_gas)
    dt, left, steps, removed = 0.0, time, 0, 0.0
    known = np.full(n, np.inf)
    while left > 0.0:
        share(level, m, LEAST)
        if np.abs(T - known).max() > 1.0:  # K: below this change the last matrix is accurate enough
            K, known = matrix.explicit(k), T.copy()
        dt = min(left, STEP_GROWTH * dt if steps else FIRST_STEP / float(rate.max()))
        dt = left if left < 1.5 * dt else dt
        share(lose, m, LEAST)
        source = capacity * nodal(own)
        # rows and columns of fixed nodes are removed from the system; their heat flow to other nodes is on the right-hand side
        A = matrix.implicit(K, GAMMA * dt, free, capacity)
        change, stage = np.where(free == 0.0, fixed_T - T, 0.0), np.zeros(n)
        for weight in ((1.0 - GAMMA) / GAMMA, 1.0):
            b = GAMMA * free * (source - dt * (times(K, T + change) - from_gas * T_gas))
            if not solve(A, b, stage, CG_TOLERANCE, most=5000):
                raise SolverError(
                    "the heat conduction in the pause between impacts does not converge: give a shorter dwell, or a finer preset"
                )
            # the residual of the total heat is spread over all nodes
            stage += free * (np.sum(b - times(A, stage)) / (free @ times(A, free)))
            change += weight * stage
        # each element gets the increments of its nodes, and loses its excess over them
        recover(0.5 * dt)
        share(absorb, m, LEAST)
        recover(0.5 * dt)
        removed -= float(gain.sum())
        T += change
        left = left - dt if dt < left else 0.0
        steps += 1
    t.elements.heat[:] += heat
    t.balance.heat += float(heat.sum())
    after = _extremes(t)
    return {
        "time_s": time, "heat_steps": float(steps), "T_max_before_K": before[0], "T_max_after_K": after[0],
        "T_mean_before_K": before[1], "T_mean_after_K": after[1], "taken_away_J": removed,
    }  # fmt: skip


def _extremes(t: Target) -> tuple[float, float]:
    return float(t.elements.T.max()), float(np.average(t.elements.T, weights=t.mesh.V0))
