"""The particle with MACHDYN's own pair style, into which our law is put through yield stress and energy (`particle.law`)."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..core.records import Rows
from ..errors import SolverError
from . import law as k
from .particle import Particle, PointState
from .start import H


@dataclass(frozen=True)
class MachdynPoints(PointState):
    """set_e (n,) J/kg: the energy prescribed for the next step."""

    set_e: Annotated[np.ndarray, Rows()]


class MachdynParticle(Particle):
    """LAMMPS computes deformation, stress and internal forces (`pair_style smd/tlsph`); our law prescribes the next step."""

    PAIR = "pair_machdyn.lmp"
    POINTS = MachdynPoints
    points: MachdynPoints

    def _update_stress(self) -> None:
        p = self.points
        k.apply_law(
            self._special, self.dt, H, self.volume, self._mass, p.smd_stress, p.eff_plastic_strain, p.esph, p.desph, p.sigma_y, p.eps_p,
            p.rate, p.T, p.J, p.p, p.energy, p.set_e, p.work, self.sums,
        )  # fmt: skip
        if not np.isfinite(self.sums[0]):
            bad = int(np.argmin(np.isfinite(self.points.work)))
            raise SolverError(self._failure(f"the stress at point {self.ids[bad]} is no longer a number", bad))

    def _strain(self) -> np.ndarray:
        return self.lmp.numpy.extract_compute("strain", 1, 2)[: self.n]

    def stress(self) -> np.ndarray:
        s = self.lmp.numpy.extract_compute("stress", 1, 2)[: self.n, :6]  # xx yy zz xy xz yz
        return s[:, [0, 1, 2, 5, 4, 3]].copy()
