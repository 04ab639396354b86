"""Lattices beside the face-centred cubic one of the program, for tests."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from coupler.particle.packing import FCC, Lattice

BCC = Lattice((1.0, 1.0, 1.0), ((0, 0, 0), (0.5, 0.5, 0.5)), (0.5, 0.5, 0.5), 0.0785433)
HCP = Lattice(
    (1.0, np.sqrt(3.0), np.sqrt(8.0 / 3.0)), ((0, 0, 0), (0.5, 0.5, 0), (0.5, 5 / 6, 0.5), (0, 1 / 3, 0.5)), (0.5, 0.25, 0.5),
    FCC.moment,
)  # fmt: skip


def turned_at_random(seed: int, lattice: Lattice = FCC) -> Lattice:
    """A lattice with a random orientation of uniform distribution, the same for the same seed."""
    x, y, z = Rotation.random(rng=np.random.default_rng(seed)).as_rotvec().tolist()
    return replace(lattice, turn=(x, y, z))
