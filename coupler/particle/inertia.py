"""Added inertia for the cells that limit the time step: selective mass scaling that changes only one mode of each cell.

The cell of a point is the point with its neighbours. That of a crushed point has the fastest mode of the particle: its volume
oscillates, with a frequency far above those of interest. Such a cell gets an inertia c against the rate of its volume,

    M = m 1 + sum c_i b_i b_i^T,   b_i v = d ln J_i / dt = sum_j (v_j - v_i) . F_i^-T g_ij

so that only changes of this volume are slower. A rigid motion, rotation included, changes no volume: linear and angular momentum
are conserved (Olovsson, Simonsson & Unosson 2005, Int. J. Numer. Meth. Engng 63, 1436, for elements). With the stiffness of the
cell, k = V J (K J + 4 G / 3), the inertia c = STIFFER k (T / 2)^2 - m / b^2 makes it stable with the step T; c is at least 0.
Only the few scaled cells need a linear system: m a = f - B^T (C^-1 + B m^-1 B^T)^-1 B m^-1 f, rows b_i of B, c_i on the diagonal of C.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from ..compiling import njit
from ..core.arrays import Floats, Ints, Laws
from ..core.threads import share
from ..geometry.matrix_kernels import applied, inverse, matrix_of, transposed
from ..physics.constitutive import bulk_stiffness
from .law import LEAST_POINTS
from .model import Sides

ENOUGH = 0.25  # safe step of a cell times wave speed / spacing: cells with a longer step do not limit the particle
STIFFER = 2.0  # factor on the stiffness of a cell: neighbouring cells together have a higher frequency


@njit(cache=True, nogil=True, error_model="numpy")
def inertia_of_cells(
    lo: int, hi: int, laws: Laws, law_of: Ints, scale: float, mass: float, sides: Sides, F: Floats, J: Floats, spatial: Floats,
    inertia: Floats,
) -> None:  # fmt: skip
    """Write F^-T g to spatial (sides,3) 1/m, and the inertia c of each cell to inertia (n,) kg m2. scale (m3 s2): STIFFER V (T / 2)^2
    for the time step T; mass (kg): of the lightest point of the body, used for all points, because a larger mass gives a smaller c."""
    for i in range(lo, hi):
        law = laws[law_of[i]]
        B, _ = inverse(matrix_of(F, i))
        square = s0 = s1 = s2 = 0.0
        for k in range(sides.first[i], sides.first[i + 1]):
            t0, t1, t2 = applied(transposed(B), sides.gradient[k, 0], sides.gradient[k, 1], sides.gradient[k, 2])
            spatial[k, 0], spatial[k, 1], spatial[k, 2] = t0, t1, t2
            square += t0 * t0 + t1 * t1 + t2 * t2
            s0, s1, s2 = s0 + t0, s1 + t1, s2 + t2
        square += s0 * s0 + s1 * s1 + s2 * s2
        stiffness = scale * J[i] * (bulk_stiffness(law, J[i]) * J[i] + 4.0 / 3.0 * law.G)
        inertia[i] = max(stiffness - mass / square, 0.0)


class CellInertia:
    """The cells with an added inertia, of the points of all ranks. `weigh` chooses them for a chunk of steps, `slow` changes the
    forces of each step."""

    def __init__(
        self, laws: tuple[Laws, Ints], volume: float, step: float, sides: Sides, numbers: np.ndarray, gather: Callable[..., list[Any]],
    ):  # fmt: skip
        """laws: LAW records, and index (total,) of the law of each point of the whole particle; volume (m3): volume of each point;
        step (s): the inertia makes each cell stable with this time step; numbers (N,): index in the whole particle of each point of
        this rank, then of each copy of a neighbour; gather(values): list of the values of all ranks."""
        (self._laws, law_of), self._scale = laws, STIFFER * volume * (0.5 * step) ** 2
        mass = volume * self._laws["rho"][law_of]
        self._mass, self._total = float(mass.min()), len(law_of)
        self._lightness = self._mass / mass
        self._sides, self._numbers, self._gather = sides, numbers, gather
        n = len(sides.first) - 1
        self._alone = len(gather(n)) == 1
        self._inertia, self._spatial = np.zeros(n), np.zeros((len(sides.neighbour), 3))
        self._own = numbers[:n]
        self._law_of = law_of[self._own]
        self.cells = 0  # number of scaled cells, on all ranks

    def weigh(self, F: np.ndarray, J: np.ndarray) -> None:
        """Choose the cells and their inertia for deformation gradients F (n,9) and volume ratios J (n,)."""
        n = len(J)
        of_cells = self._laws, self._law_of, self._scale, self._mass, self._sides, F, J, self._spatial, self._inertia
        share(lambda lo, hi: inertia_of_cells(lo, hi, *of_cells), n, LEAST_POINTS)
        chosen = np.flatnonzero(self._inertia)
        first = self._sides.first.astype(np.int64)
        rows = np.repeat(np.arange(len(chosen)), first[chosen + 1] - first[chosen])
        sides = np.concatenate([rows[:0], *(np.arange(first[i], first[i + 1]) for i in chosen)])
        own = np.column_stack([
            self._own[chosen[rows]], self._numbers[self._sides.neighbour[sides]], self._inertia[chosen[rows]], self._spatial[sides],
        ])  # fmt: skip
        table = np.concatenate(self._gather(own))
        table = table[np.lexsort((table[:, 1], table[:, 0]))]
        points, first_of, cell = np.unique(table[:, 0].astype(np.int64), return_index=True, return_inverse=True)
        self.cells = len(points)
        if not self.cells:
            return
        c, t = table[first_of, 2], table[:, 3:]
        ones = np.tile(cell, 2), np.concatenate([table[:, 1], table[:, 0]]).astype(np.int64)
        values = np.concatenate([t, -t])
        shape = self.cells, 3 * self._total
        columns = 3 * ones[1][:, None] + np.arange(3)
        B = csr_array((values.ravel(), (np.repeat(ones[0], 3), columns.ravel())), shape)
        self._B_transposed, self._B = csr_array(B.T), B
        self._B.data *= np.repeat(self._lightness, 3)[B.indices]
        self._solve = np.linalg.inv(np.diag(self._mass / c) + (self._B @ self._B_transposed).toarray())

    def slow(self, f: np.ndarray) -> None:
        """Replace the total forces f (n,3) N on the points by forces that give the accelerations with added inertia. All ranks call
        this together."""
        if not self.cells:
            return
        whole = np.zeros((self._total, 3))
        for ids, forces in [(self._own, f)] if self._alone else self._gather((self._own, f)):
            whole[ids] = forces
        push = self._B_transposed @ (self._solve @ (self._B @ whole.ravel()))
        f -= push.reshape(-1, 3)[self._own]
