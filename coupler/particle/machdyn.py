"""The particle with MACHDYN's own pair style. The constitutive law acts in it through the yield stress and the energy of each point
(`particle.law`)."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..core.records import Rows
from ..errors import SolverError
from . import law as k
from .particle import UNDEFINED_STRESS, Particle, PointState
from .start import H


@dataclass(frozen=True)
class MachdynPoints(PointState):
    """Points of a `MachdynParticle`. set_e (n,) J/kg: energy prescribed for the next step."""

    set_e: Annotated[np.ndarray, Rows()]


class MachdynParticle(Particle):
    """A particle whose deformation, stress and internal forces are computed by LAMMPS (`pair_style smd/tlsph`); the constitutive law
    prescribes yield stress and energy of the next step."""

    PAIR = "pair_machdyn.lmp"
    POINTS = MachdynPoints
    points: MachdynPoints

    def _update_stress(self) -> None:
        p = self.points
        k.apply_law(
            self._special, self.dt, H, self.volume, self._mass, p.eff_plastic_strain, p.esph, p.desph, p.set_e, self._state, self.sums
        )  # fmt: skip
        if not np.isfinite(self.sums[0]):
            bad = int(np.argmin(np.isfinite(self.points.work)))
            raise SolverError(self._failure(UNDEFINED_STRESS, bad))

    def _strain(self) -> np.ndarray:
        return self.lmp.numpy.extract_compute("strain", 1, 2)[: self.n]

    def stress(self) -> np.ndarray:
        s = self.lmp.numpy.extract_compute("stress", 1, 2)[: self.n, :6]  # xx yy zz xy xz yz
        return s[:, [0, 1, 2, 5, 4, 3]].copy()
