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
from types import ModuleType
from typing import Annotated, ClassVar

import numpy as np
from scipy.spatial import cKDTree

from ..core import safety
from ..core.records import Rows
from ..core.threads import share, together
from ..errors import SolverError
from . import enriched_kernels
from . import frequency as k
from .blocks import MOST_SIDES
from .compiled import CompiledParticle, CompiledPoints
from .inertia import CellInertia
from .model import Residuals, Step
from .particle import LocalState

SECOND_LAYER = 1.65  # spacings: largest distance of a neighbour of a rim point
FIT_REACH = 1.9  # spacings: distance at which the weight of the quadratic fit is zero
FITTED = 2000  # rim points fitted at a time, which limits the memory of their matrices
RIDGE = 0.05  # ridge parameter of the second derivatives in the fit, for points with few neighbours
SYMMETRIC = 1e-6  # relative third moment of the neighbours: a point with a larger one lies at the rim


@dataclass(frozen=True)
class EnrichedPoints(CompiledPoints):
    """Points of an `EnrichedParticle`. unseen (n,) J/m3: elastic energy of the residuals; bend (n, 3 MOST_SIDES) m: plastic parts of
    the residuals, in the order of the neighbours' numbers, up to date only after `state()`; mode (n,3) s: mode of the highest
    frequency, scaled so that the norm of the whole array is the time step at which this mode becomes unstable."""

    unseen: Annotated[np.ndarray, Rows()]
    bend: Annotated[np.ndarray, Rows(3 * MOST_SIDES)]
    mode: Annotated[np.ndarray, Rows(3)]


class EnrichedParticle(CompiledParticle):
    """A particle whose scheme has residuals in place of hourglass control, and quadratic fits of gradients at the rim (see the
    module)."""

    POINTS = EnrichedPoints
    points: EnrichedPoints
    _passes: ClassVar[ModuleType] = enriched_kernels
    _kinds: ClassVar[int] = 1

    def _start_engine(self) -> None:
        super()._start_engine()
        sides = self._sides
        counts = np.diff(sides.first.astype(np.int64))
        if counts.max(initial=0) > MOST_SIDES:
            raise SolverError(
                f"a point has {counts.max()} neighbours, more than {MOST_SIDES}: use a smaller kernel_radius"
            )
        count, everyone = len(sides.neighbour), len(self._tag)
        self._side_force = np.zeros((len(self._side_force), 4))
        self._slot = 3 * (np.arange(count) - sides.first[self._point].astype(np.int64))[:, None] + np.arange(3)
        self._residuals = Residuals(np.zeros((count, 3)), self.points.unseen)
        step = self.numerics.inertia * self.spacing / self.wave_speed / self.numerics.frequency
        laws = self.law, self._whole_law_of
        self._inertia = CellInertia(laws, self.volume_of_point, step, sides, self._tag - 1, self.comm.allgather)
        self._random = np.random.default_rng(1).standard_normal((self.total, 3))[self.ids]
        self._small = k.Small(np.zeros((everyone, 3)), np.zeros_like(self._side_force))

    def _are_neighbours(self, pairs: np.ndarray, r0: np.ndarray) -> np.ndarray:
        self._rim = _one_sided(self._whole, self._scheme.h)[self._tag - 1]
        return (r0 < self._scheme.h) | ((r0 < SECOND_LAYER * self.spacing) & self._rim[pairs].any(axis=1))

    def _gradients(self, first: np.ndarray, d: np.ndarray, w: np.ndarray) -> np.ndarray:
        gradient = super()._gradients(first, d, w)
        ridge = np.diag([0.0] * 3 + [RIDGE] * 6)
        rim, first = np.flatnonzero(self._rim[: self.n]), first.astype(np.int64)
        for points in np.array_split(rim, len(rim) // FITTED + 1):
            if not len(points):
                continue
            counts = first[points + 1] - first[points]
            start = np.cumsum(counts) - counts
            of = np.repeat(np.arange(len(points)), counts)
            side = np.arange(counts.sum()) + np.repeat(first[points] - start, counts)
            D = d[side] / self.spacing
            x, y, z = D.T
            basis = np.stack([x, y, z, x * x, y * y, z * z, y * z, x * z, x * y], axis=1)
            weighted = basis * np.maximum(FIT_REACH - np.sqrt((D * D).sum(axis=1)), 0.0)[:, None] ** 2
            A = np.add.reduceat(weighted[:, :, None] * basis[:, None, :], start) + ridge
            fit = np.einsum("sij,sj->si", np.linalg.pinv(A)[of, :3], weighted)
            exact = np.linalg.pinv(np.add.reduceat(fit[:, :, None] * D[:, None, :], start))  # for linear fields
            gradient[side] = np.einsum("sij,sj->si", exact[of], fit) / self.spacing
        return gradient

    def _of_stress(self, step: Step) -> tuple[object, ...]:
        _, *others, force = super()._of_stress(step)
        return step, *others, self._losses, self._residuals, force

    def _of_forces(self, step: Step) -> tuple[object, ...]:
        return self._sides, self._side_force, self.points.f, self._losses.work[0]

    def _skip_step(self) -> None:
        self._swap(self._side_sends, self._side_receives, self._side_force)

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
        longest = self._longest_step()
        bound = super().stable_dt()
        return min(safety.LONGEST * bound, self.numerics.frequency * longest) if longest > 0.0 else bound

    def _longest_step(self) -> float:
        """The time step (s) at which the points of all ranks become unstable; NaN if the frequency is not finite.

        Updates `points.mode`. If the step has decreased since the last call, it is multiplied once more by the same ratio, as an
        estimate for the end of the next chunk.
        """
        n, sides, F, J, mode = self.n, self._sides, self._deformation.F, self.points.J, self.points.mode
        stiffness, f, small = np.empty(n), np.empty((n, 3)), self._small
        unused = np.zeros(n)  # the linear operator has no losses
        share(lambda lo, hi: k.stiffness_points(lo, hi, sides, F, stiffness), n, k.LEAST_POINTS)
        largest = max(self.comm.allgather(float(stiffness.max(initial=0.0))))
        u, before = small.u[:n], self._size(mode)
        if before > 0.0:
            weight = (stiffness / largest) ** 2
            share(lambda lo, hi: np.multiply(self._random[lo:hi], weight[lo:hi, None], out=u[lo:hi]), n, k.LEAST_POINTS)
            part = k.STIRRED / self._size(u)
            share(lambda lo, hi: np.add(mode[lo:hi] / before, part * u[lo:hi], out=u[lo:hi]), n, k.LEAST_POINTS)
        else:
            u[:] = self._random
        omega2 = self._size(u)

        def respond(lo: int, hi: int) -> None:
            """Replace u by -a / |u| in rows lo to hi - 1; a: accelerations that u causes."""
            u[lo:hi] = scale[lo:hi, None] * f[lo:hi]

        for _ in range(k.NEXT if before > 0.0 else k.FIRST):
            self._swap(self._sends, self._receives, small.u)
            together(k.linear_stress, n, self.law, self.law_of, self._scheme.V, sides, self._motion.X, F, J, small)
            self._swap(self._side_sends, self._side_receives, small.side_force)
            together(enriched_kernels.forces_of_all, n, (sides, small.side_force, f, unused))
            self._inertia.slow(f)
            scale = -1.0 / (self.mass * omega2)
            share(respond, n, k.LEAST_POINTS)
            omega2 = self._size(u)
        limit = 2.0 / np.sqrt(omega2)
        if not limit > 0.0:
            return np.nan
        mode[:] = limit / omega2 * u
        ahead = limit * min(1.0, limit / before) if before > 0.0 else limit
        return float(2.0 ** (np.floor(k.GRID * np.log2(ahead)) / k.GRID))

    def _size(self, u: np.ndarray) -> float:
        """Norm of u (n,3) over the points of all ranks: root of the sum of squares."""
        return float(np.sqrt(sum(self.comm.allgather(float(np.vdot(u, u))))))

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
