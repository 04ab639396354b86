"""The particle with two compiled passes over points (`particle.compiled_kernels`), in the form of MACHDYN.

LAMMPS stores and distributes the points; their motion is integrated here, in all threads. Neighbours are those of the reference
configuration: lists are made once. With several ranks LAMMPS provides positions and velocities of neighbours on other ranks;
between the passes the ranks exchange forces of sides, and deformation gradients for hourglass control, with fixed lists. Each sum
over neighbours has the same order for any division of the points among ranks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Annotated, ClassVar

import numpy as np
from scipy.spatial import cKDTree

from ..core.loops import PARTS
from ..core.records import Rows
from ..core.threads import share, together
from ..errors import SolverError
from ..physics import motion
from ..physics.constitutive import sound_speed
from . import compiled_kernels as k
from .law import LEAST_POINTS
from .model import Control, Deformation, Losses, Motion, Scheme, Sides, Step
from .particle import DISTORTED, UNDEFINED_STRESS, LocalState, Particle, PointState
from .start import H

KERNEL = -14.0323944878  # slope of the kernel in MACHDYN: W' = KERNEL (h - r)^2 / h^6
THIRD = 0.333333333333  # value of the kernel in MACHDYN: W = -THIRD (h - r) W'
RowsOfRanks = list[tuple[int, np.ndarray]]  # pairs of another rank and the rows that it gets or sends


@dataclass(frozen=True)
class CompiledPoints(PointState):
    """Points of a `CompiledParticle`. F, R (n,9): deformation gradient and its rotation, row by row."""

    F: Annotated[np.ndarray, Rows(9)]
    R: Annotated[np.ndarray, Rows(9)]


class CompiledParticle(Particle):
    """Deformation, stress and internal forces by compiled passes within the step of LAMMPS (`pair_style none`)."""

    PAIR = "pair_compiled.lmp"
    POINTS: ClassVar[type[PointState]] = CompiledPoints
    points: CompiledPoints
    _passes: ClassVar[ModuleType] = k
    _kinds: ClassVar[int] = 2  # number of rows in `model.Losses.strength`

    def _start_engine(self) -> None:
        super()._start_engine()
        array = self.lmp.numpy.extract_atom
        everyone = self.n + int(self.lmp.extract_setting("nghost"))
        self._tag = array("id", nelem=everyone)[:everyone].astype(np.int64)
        x, v, v_half = (array(name, nelem=everyone, dim=3) for name in ("x", "vest", "v"))
        self._motion = Motion(x.copy(), x, v, v_half)
        F = np.tile(np.eye(3).ravel(), (everyone, 1))
        self.points = replace(self.points, F=F[: self.n], R=F[: self.n].copy())
        self._deformation = Deformation(F, self.points.R, np.ones(everyone))
        num, h = self.numerics, 2.0 * self.numerics.kernel_radius * self.spacing
        self._warming = self.law["expansion"] * self.law["taylor_quinney"]  # share of plastic work that raises pressure
        self._scheme = Scheme(self.volume_of_point, h, H, num.Q1, num.Q2, num.hourglass)
        self._list_neighbours()
        self._list_exchange()
        count = len(self._sides.neighbour)
        self._side_force = np.zeros((count + len(self._far), 3))
        self._losses = Losses(np.zeros((self._kinds, count)), np.zeros((2, self.n)))
        self._failed, self._plastic = np.full(PARTS, -1), np.zeros(len(self.law))

    def _list_neighbours(self) -> None:
        """List the neighbours of each point, in the order of the points' numbers in the whole particle."""
        n, X, tag, h, V = self.n, self._motion.X, self._tag, self._scheme.h, self.volume_of_point
        pairs = cKDTree(X).query_pairs(1.12 * h, output_type="ndarray") if len(X) else np.empty((0, 2), np.int64)
        pairs = pairs[(pairs < n).any(axis=1)]
        d = X[pairs[:, 1]] - X[pairs[:, 0]]
        r0 = np.sqrt((d * d).sum(axis=1))
        are_neighbours = self._are_neighbours(pairs, r0)
        pairs, r0 = pairs[are_neighbours], r0[are_neighbours]
        slope = KERNEL * np.maximum(h - r0, 0.0) ** 2 / h**6
        W = np.float32(-THIRD * (h - r0) * slope).astype(float)
        w = np.float32(slope).astype(float) / r0  # MACHDYN stores both in single precision
        rho, K, G = (self.law[name] for name in ("rho", "K", "G"))
        c = np.array([sound_speed(*each) for each in zip(rho, K, G, strict=True)])
        law_of = self._whole_law_of[tag[pairs] - 1]
        rho, c, E = (of_law[law_of].mean(axis=1) for of_law in (rho, c, 9 * K * G / (3 * K + G)))
        factor = (rho * V) ** 2 * (1.0 / rho) * w * r0

        # each pair has a side for each of its points on this rank
        point, other = pairs.T.ravel(), pairs[:, ::-1].T.ravel()
        side = np.argsort(point * (self.total + 1) + tag[other])  # one key takes a quarter of the time of lexsort
        side = side[point[side] < n]
        row = np.full(len(point), -1)
        row[side] = np.arange(len(side))
        reverse, pair = row[(side + len(pairs)) % max(len(point), 1)], side % max(len(pairs), 1)
        self._point, other = point[side], other[side]
        first = np.searchsorted(self._point, np.arange(n + 1)).astype(np.uint32)
        gradient = self._gradients(first, X[other] - X[self._point], w[pair])
        # sides of points on other ranks follow the own ones, in the order of their points and neighbours
        self._far = np.flatnonzero(other >= n)
        self._far = self._far[np.lexsort((tag[self._point[self._far]], tag[other[self._far]]))]
        reverse[self._far] = len(side) + np.arange(len(self._far))
        later = first[1:] - np.bincount(self._point, tag[other] > tag[self._point], n).astype(np.uint32)
        of_side = first, later, other.astype(np.uint32), reverse.astype(np.uint32), w[pair]
        self._sides = Sides(*of_side, gradient, factor[pair], c[pair])
        self._control = Control(r0[pair], W[pair], E[pair])

    def _gradients(self, first: np.ndarray, d: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Gradient weights (sides,3) 1/m: grad u = sum of (u_j - u_i) weight. first, w: as in `Sides`; d (sides,3) m: X_j - X_i."""
        K = [np.bincount(self._point, w * d[:, a] * d[:, b], self.n) for a in range(3) for b in range(3)]
        stretch, axes = np.linalg.eigh(np.stack(K, axis=1).reshape(-1, 3, 3))
        is_seen = np.abs(self.volume_of_point * stretch) > 1e-16
        inverse = np.divide(1.0, stretch, out=np.zeros_like(stretch), where=is_seen)
        K_inverse = np.ascontiguousarray(np.einsum("nik,nk,njk->nij", axes, inverse, axes))
        return w[:, None] * np.einsum("kij,kj->ki", K_inverse[self._point], d)

    def _are_neighbours(self, pairs: np.ndarray, r0: np.ndarray) -> np.ndarray:
        """Mask (k,) of the pairs (k,2) of rows that interact, from their distances r0 (k,) m."""
        return r0 < self._scheme.h

    def _list_exchange(self) -> None:
        """List the rows of points and of sides (`Sides`) that this rank exchanges with each other rank between passes 1 and 2."""
        self._sends, self._receives = _by_rank([]), _by_rank([])
        self._side_sends, self._side_receives = _by_rank([]), _by_rank([])
        if self.comm.size == 1:
            return
        tag, point, neighbour = self._tag, self._point, self._sides.neighbour.astype(np.int64)
        needed = np.unique(neighbour[neighbour >= self.n])
        owner = np.empty(self.total, np.int64)
        for rank, ids in enumerate(self.comm.allgather(self.ids)):
            owner[ids] = rank
        owner = owner[tag - 1]
        ranks = range(self.comm.size)
        wanted = [needed[owner[needed] == rank] for rank in ranks]
        asked = self.comm.alltoall([tag[rows] - 1 for rows in wanted])
        row_of = np.empty(self.total, np.int64)
        row_of[self.ids] = np.arange(self.n)
        self._sends, self._receives = _by_rank([row_of[ids] for ids in asked]), _by_rank(wanted)
        here = owner[neighbour[self._far]]
        out = self._far[np.lexsort((tag[neighbour[self._far]], tag[point[self._far]]))]
        there = owner[neighbour[out]]
        self._side_sends = _by_rank([out[there == rank] for rank in ranks])
        self._side_receives = _by_rank([len(neighbour) + np.flatnonzero(here == rank) for rank in ranks])

    def _update_stress(self) -> None:
        failed, step = self._failed, Step(self.dt, self._steps_left == 0)
        try:
            together(self._passes.stress_of_all, self.n, failed, self._of_stress(step))
        finally:
            if self.comm.size > 1:
                self._skip_step()
        if failed.max() >= 0:
            point = int(failed[failed >= 0][0])
            reason = DISTORTED if np.isfinite(self.points.J[point]) else UNDEFINED_STRESS
            raise SolverError(self._failure(reason, point))
        together(self._passes.forces_of_all, self.n, self._of_forces(step))

    def _of_stress(self, step: Step) -> tuple[object, ...]:
        """Arguments of `stress_points` (pass 1) after lo and hi."""
        m, d = self._motion, self._deformation
        return step.dt, self._special, self._scheme, self._sides, m, d, self._state, self._side_force

    def _of_forces(self, step: Step) -> tuple[object, ...]:
        """Arguments of `point_forces` (pass 2) after lo and hi."""
        m, d, control = self._motion, self._deformation, self._control
        return step, self._scheme, self._sides, control, m, d, self._losses, self._side_force, self.points.f

    def run(self, steps: int, dt: float, on_step: Callable[[], None]) -> None:
        """As `Particle.run`. At the end the gradient of the plastic strain of these steps is added to `eps_gradient`, if gradients
        harden the metal."""
        p = self.points
        together(motion.begin_all, dt, self.mass, p.f, p.x, p.v, p.vest)
        if not self.law["gradient_length"].any():
            super().run(steps, dt, on_step)
            return
        before = self.points.eps_p.copy()
        try:
            super().run(steps, dt, on_step)
        finally:  # other ranks wait for this exchange, also after a failure here
            grown = np.zeros(len(self._tag))
            grown[: self.n] = self.points.eps_p - before
            self._swap(self._sends, self._receives, grown[:, None])
            k.grow_gradients(self.n, grown, self._sides, self._deformation, self.points.eps_gradient)

    def _book(self, work: np.ndarray) -> None:
        p, is_last = self.points, self._steps_left == 0
        together(motion.end_all, self.dt, is_last, self.mass, p.f_old, p.f, self.f_ext, p.x, p.v, p.vest, work)

    def _end_chunk(self) -> None:
        """Add plastic work and losses of the chunk of steps to the sums, and heat the points by the losses if the law has
        `dissipation`."""
        for i, warming in enumerate(self._warming):
            plastic = self.volume_of_point * float(self.points.work[self.law_of == i].sum())
            self.sums[1] += warming * (plastic - self._plastic[i])
            self._plastic[i] = plastic
        self.sums[0] = self._plastic.sum()
        work = self._losses.work
        self.sums[2:] += work.sum(axis=1)
        if self.law["dissipation"].any():
            self.warm(work.sum(axis=0))
        work[:] = self._losses.strength[:] = 0.0

    def restore(self, state: LocalState, first: bool = True) -> None:
        super().restore(state, first)
        # the first rank gets the sums of all points, the others zero: the total over all ranks is then right
        work = [state.points.work[self._whole_law_of == i].sum() for i in range(1, len(self.law)) if first]
        self._plastic[1:] = self.volume_of_point * np.array(work or 0.0)
        self._plastic[0] = self.sums[0] - self._plastic[1:].sum()

    def _skip_step(self) -> None:
        """Exchange the data that pass 2 needs. After a failure on this rank the other ranks still need its data in each step."""
        d = self._deformation
        self._swap(self._sends, self._receives, d.F, d.effective[:, None])
        self._swap(self._side_sends, self._side_receives, self._side_force)

    def _swap(self, sends: RowsOfRanks, receives: RowsOfRanks, *arrays: np.ndarray) -> None:
        """Send the rows `sends` of the arrays (k,m) to other ranks, and write the rows that arrive to the rows `receives`."""
        if not (sends or receives):
            return
        widths = np.cumsum([0] + [array.shape[1] for array in arrays])
        inbox = [np.empty((len(rows), widths[-1])) for _, rows in receives]
        requests = [self.comm.Irecv(box, source=rank, tag=8) for box, (rank, _) in zip(inbox, receives, strict=True)]
        outbox = [np.concatenate([array[rows] for array in arrays], axis=1) for _, rows in sends]
        requests += [self.comm.Isend(box, dest=rank, tag=8) for box, (rank, _) in zip(outbox, sends, strict=True)]
        for request in requests:
            request.Wait()
        for box, (_, rows) in zip(inbox, receives, strict=True):
            for i, array in enumerate(arrays):
                array[rows] = box[:, widths[i] : widths[i + 1]]

    def _strain(self) -> np.ndarray:
        strain = np.empty((self.n, 6))
        share(lambda lo, hi: k.green_lagrange(lo, hi, self.points.F, strain), self.n, LEAST_POINTS)
        return strain

    def carried(self) -> dict[str, np.ndarray]:
        turned = np.einsum("nij,nj->ni", self.points.R.reshape(-1, 3, 3), self.points.eps_gradient)
        return super().carried() | {"eps_gradient": turned}

    def stress(self) -> np.ndarray:
        R, turned = self.points.R.reshape(-1, 3, 3), np.empty((self.n, 6))

        def turn(lo: int, hi: int) -> None:
            s = self.points.smd_stress[lo:hi, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
            T = (R[lo:hi] @ s) @ R[lo:hi].transpose(0, 2, 1)
            turned[lo:hi] = T.reshape(-1, 9)[:, [0, 4, 8, 5, 2, 1]]

        share(turn, self.n, LEAST_POINTS)
        return turned


def _by_rank(rows: Sequence[np.ndarray]) -> RowsOfRanks:
    """Pairs of a rank and its rows, only for ranks that have rows. rows: rows of each rank."""
    return [(rank, own) for rank, own in enumerate(rows) if len(own)]
