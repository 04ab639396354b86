"""The enriched particle scheme. It gives an elastic and plastic response to the part of the neighbours' motion that F does not
describe (sub-cell deformation).

Two changes to the scheme of `particle.compiled` replace its hourglass control:

- *Residuals*. e_ij = R_i^T (x_j - x_i - F_i (X_j - X_i)) is zero for a linear field. Its elastic part e has the energy
  V G ACROSS / 2 sum_j omega_ij e^2 / r_ij^2, omega_ij = w_ij r_ij^2 / sum_j w_ij r_ij^2: the energy of the deviatoric strain within the
  cell of a point. Deviator and residuals form one yield condition and return to it by one factor; their dissipation is plastic work of
  the point. There are no zero-energy modes, a linear field is not resisted, and angular momentum is conserved to rounding.
- *Gradients at the rim*. If all neighbours lie on one side, a linear fit gives the gradient inside the body, not at the point, and a
  plate is too soft in bending. There the gradient comes from a quadratic fit that includes the second layer of neighbours. It is exact
  for linear fields, and nearly exact for quadratic ones.

The strain increment follows from the stretch U at n and n+1: a rotation causes no strain, and central differences conserve the
energy of elastic waves.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from ..core import safety
from ..core.arrays import Arrays
from ..core.records import Rows
from ..core.threads import together
from ..errors import SolverError
from . import enriched_kernels as k
from .compiled import CompiledParticle, CompiledPoints
from .frequency import PointFrequency
from .inertia import CellInertia
from .model import Residuals
from .particle import LocalState

MOST_SIDES = 18  # largest number of neighbours: the two nearest layers of a face-centred cubic lattice
SECOND_LAYER = 1.65  # spacings: largest distance of a neighbour of a rim point
FIT_REACH = 1.9  # spacings: distance at which the weight of the quadratic fit is zero
FITTED = 2000  # rim points fitted at a time, which limits the memory of their matrices
RIDGE = 0.05  # ridge parameter of the second derivatives in the fit, for points with few neighbours
SYMMETRIC = 1e-6  # relative third moment of the neighbours: a point with a larger one lies at the rim


@dataclass(frozen=True)
class EnrichedPoints(CompiledPoints):
    """Points of an `EnrichedParticle`. unseen (n,) J/m3: elastic energy of the residuals; bend (n, 3 MOST_SIDES) m: plastic parts of
    the residuals, in the order of the neighbours' numbers, written by `state`; mode (n,3) s: mode of the highest frequency; its norm
    is the time step at which this mode becomes unstable."""

    unseen: Annotated[np.ndarray, Rows()]
    bend: Annotated[np.ndarray, Rows(3 * MOST_SIDES)]
    mode: Annotated[np.ndarray, Rows(3)]


class EnrichedParticle(CompiledParticle):
    """A particle whose scheme has residuals in place of hourglass control, and quadratic fits of gradients at the rim (see the
    module)."""

    POINTS = EnrichedPoints
    points: EnrichedPoints

    def _start_engine(self) -> None:
        super()._start_engine()
        sides = self._sides
        counts = np.diff(sides.first.astype(np.int64))
        if counts.max(initial=0) > MOST_SIDES:
            raise SolverError(
                f"a point has {counts.max()} neighbours, more than {MOST_SIDES}: use a smaller kernel_radius"
            )
        count = len(sides.neighbour)
        foreign = sum(len(rows) for _, rows in self._side_receives)
        self._slot = 3 * (np.arange(count) - sides.first[self._point].astype(np.int64))[:, None] + np.arange(3)
        self._residuals = Residuals(np.zeros((count, 3)), np.zeros((count + foreign, 3)), self.points.unseen)
        random = np.random.default_rng(1).standard_normal((self.total, 3))[self.ids]
        step = self.numerics.inertia * self.spacing / self.wave_speed / self.numerics.frequency
        laws = self.law, self._whole_law_of
        self._inertia = CellInertia(laws, self.volume_of_point, step, sides, self._tag - 1, self.comm.allgather)
        self._frequency = PointFrequency(
            (self.law, self.law_of), self.volume_of_point, sides, self._pairs, self._motion.X, count + foreign, random,
            self.comm.allgather, self._fetch, self._inertia.slow,
        )  # fmt: skip

    def _stress(self, failed: np.ndarray, of_points: Arrays) -> None:
        together(k.stress_of_all, self.n, failed, (*of_points, self._residuals))

    def _forces(self, of_pairs: Arrays, of_sum: Arrays) -> None:
        together(k.forces_of_all, self.n, (*of_pairs, self._residuals.force, self._force), of_sum)

    def _are_neighbours(self, pairs: np.ndarray, r0: np.ndarray) -> np.ndarray:
        self._rim = _one_sided(self._whole, self._scheme.h)[self._tag - 1]
        return (r0 < self._scheme.h) | ((r0 < SECOND_LAYER * self.spacing) & self._rim[pairs].any(axis=1))

    def _gradients(self, first: np.ndarray, d: np.ndarray, w: np.ndarray) -> np.ndarray:
        gradient = super()._gradients(first, d, w)
        D = d / self.spacing
        weight = np.maximum(FIT_REACH - np.sqrt((D * D).sum(axis=1)), 0.0) ** 2
        x, y, z = D.T
        basis = np.stack([x, y, z, x * x, y * y, z * z, y * z, x * z, x * y], axis=1)
        ridge = np.diag([0.0] * 3 + [RIDGE] * 6)
        rim, first = np.flatnonzero(self._rim[: self.n]), first.astype(np.int64)
        for points in np.array_split(rim, len(rim) // FITTED + 1):
            if not len(points):
                continue
            counts = first[points + 1] - first[points]
            start = np.cumsum(counts) - counts
            of = np.repeat(np.arange(len(points)), counts)
            side = np.arange(counts.sum()) + np.repeat(first[points] - start, counts)
            weighted = basis[side] * weight[side, None]
            A = np.add.reduceat(weighted[:, :, None] * basis[side, None, :], start) + ridge
            fit = np.einsum("sij,sj->si", np.linalg.pinv(A)[of, :3], weighted)
            exact = np.linalg.pinv(np.add.reduceat(fit[:, :, None] * D[side, None, :], start))  # for linear fields
            gradient[side] = np.einsum("sij,sj->si", exact[of], fit) / self.spacing
        return gradient

    def _skip_step(self) -> None:
        super()._skip_step()
        self._swap(self._side_sends, self._side_receives, self._residuals.force)

    def _fetch(self, points: np.ndarray, sides: np.ndarray | None = None) -> None:
        self._swap(self._sends, self._receives, points)
        if sides is not None:
            self._swap(self._side_sends, self._side_receives, sides)

    def _add_inertia(self) -> None:
        if self._inertia.cells:
            total = self.points.f + self.f_ext
            self._inertia.slow(total)
            self.points.f[:] = total - self.f_ext

    def stable_dt(self) -> float:
        """Largest stable time step in s, from the highest frequency of the points (`particle.frequency`).

        Raises SolverError under the conditions of `Particle.stable_dt`.
        """
        # all ranks take part in the iteration, before one of them can raise
        if self.numerics.inertia > 0.0:
            self._inertia.weigh(self.points.F, self.points.J)
        longest = self._frequency.longest_step(self._deformation.F, self.points.J, self.points.mode)
        bound = super().stable_dt()
        return min(safety.LONGEST * bound, self.numerics.frequency * longest) if longest > 0.0 else bound

    def _recoverable(self, stored: float) -> float:
        return super()._recoverable(stored) + self.volume_of_point * float(self.points.unseen.sum())

    def state(self) -> LocalState:
        self.points.bend[self._point[:, None], self._slot] = self._residuals.plastic
        return super().state()

    def restore(self, state: LocalState, first: bool = True) -> None:
        super().restore(state, first)
        self._residuals.plastic[:] = self.points.bend[self._point[:, None], self._slot]
        if self.numerics.inertia > 0.0:
            self._inertia.weigh(self.points.F, self.points.J)


def _one_sided(X: np.ndarray, h: float) -> np.ndarray:
    """Mask (n,) of the points X (n,3) m at the rim of the body, where the third moment of the neighbours within h m does not
    vanish."""
    pairs = cKDTree(X).query_pairs(h, output_type="ndarray")
    d = (X[pairs[:, 1]] - X[pairs[:, 0]]) / h
    weight = (1.0 - np.sqrt((d * d).sum(axis=1))) ** 2
    largest = np.zeros(len(X))
    for axes in combinations_with_replacement(range(3), 3):
        third = weight * d[:, axes].prod(axis=1)
        moment = np.bincount(pairs[:, 0], third, len(X)) - np.bincount(pairs[:, 1], third, len(X))
        largest = np.maximum(largest, np.abs(moment))
    return largest > SYMMETRIC * float(weight.max(initial=0.0))
