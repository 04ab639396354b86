"""Compile the kernels of the target, and of contact, bonds and pauses between impacts: python workflows/compile_kernels.py

`make setup` runs it at the same time as a first impact, which compiles the other kernels; numba stores the kernels of both.
"""

from pathlib import Path

import numpy as np

from coupler.deposition.pause import pause
from coupler.geometry import mesher
from coupler.geometry.tetrahedra import oriented
from coupler.impact.domains import build_target
from coupler.physics.adhesion import Adhesion
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.target.domain import BodyState

SCENE = Path(__file__).parent / "single_ni.toml"
EDGE = 10e-6  # m, of the body that lies on the target
STEP, PAUSE = 1e-13, 1e-6  # s
ENERGY = 1.0  # J, kinetic energy of earlier impacts: so large that the pause finds equilibrium at once


if __name__ == "__main__":
    p = plan(Scene.load(SCENE))
    bodies = build_target(p)
    bodies.target.advance(STEP)
    bodies.target.finish()
    bodies.stable_dt(1.0)
    points, tets = mesher.box((EDGE, EDGE, EDGE), 0.5 * EDGE)
    n, m, law = len(points), len(tets), bodies.target.laws
    cube = BodyState(
        points=points, tets=oriented(points, tets), stress=np.zeros((m, 6)), eps_p=np.zeros(m), T=np.full(m, 300.0), J=np.ones(m),
        velocity=np.zeros((n, 3)), energy=np.zeros(n), mass=float(law["rho"][0]) * EDGE**3, law=law, eps_gradient=np.zeros((m, 3)),
    )  # fmt: skip
    lying = bodies.joined([cube], Adhesion("tied"), 0.5 * EDGE, (0.0, 0.0, 0.0), 1.0, 1)
    pause(p, PAUSE, lying, ENERGY)
