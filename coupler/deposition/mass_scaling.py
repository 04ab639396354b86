"""What keeps the cost of an impact from growing much with the number of those before it: heavier small elements, a window.

A few elements of splats that others have crushed would dictate the time step of all impacts to come: they are made heavier, by
a small share of a particle's mass in all and at rest, which changes no energy and no momentum. And what is far from the impact is not
computed (`Target.window`): it is in equilibrium, and answers as an elastic body.
"""

import math

import numpy as np

from ..fe import kernels
from ..fe.assemble import Point
from ..impact.bodies import Bodies
from ..plan.planning import Plan
from ..sph.inertia import ENOUGH


def prepare(plan: Plan, i: int, bodies: Bodies, place: Point | None = None) -> dict[str, float]:
    """Make bodies at rest, numbered outwards from the place (m) where impact i comes, ready for it; what was done, for the report."""
    report = scale_masses(bodies, *_allowed(plan, i)) if i and plan.mass_scaling else {}
    radius = plan.impacts[i].window
    if math.isfinite(radius):
        report |= {"window_m": radius, "elements_in_window": bodies.target.window(radius, place and np.array(place))}
    return report


def _allowed(plan: Plan, i: int) -> tuple[float, float]:
    """Mass (kg) that may be added before impact i, and the safe step (s) that is enough for its particle."""
    p = plan.impacts[i]
    mass = p.material.rho * math.pi / 6.0 * p.diameter**3
    return plan.mass_scaling * mass, ENOUGH * p.spacing / p.material.wave_speed


def scale_masses(bodies: Bodies, most: float, enough: float) -> dict[str, float]:
    """Make the elements with the shortest steps heavier, all of them to the same step, by `most` kg in all or until that step is
    `enough`, s. Returns how many, how much (kg) and the safe step (s) before and after."""
    t = bodies.target
    conn, safe = t.mesh.conn, np.zeros(len(t.mesh.conn))
    kernels.stable_dt(0, len(conn), t.x, conn, t.J, t.laws, t.law_of, safe)
    step = step_for(t.laws["rho"][t.law_of] * t.mesh.V0, safe, most, enough)
    inertia = np.maximum(step / safe, 1.0) ** 2
    before = float(t.mass.sum())
    t.scale_masses(inertia)
    return {
        "heavier_elements": int(np.sum(inertia > 1.0)), "added_mass_kg": float(t.mass.sum()) - before,
        "safe_step_before_s": float(safe.min()), "safe_step_s": max(step, float(safe.min())),
    }  # fmt: skip


def step_for(mass: np.ndarray, safe: np.ndarray, most: float, enough: float) -> float:
    """The step (s) to which elements of mass (m,) kg and own steps safe (m,) s can be brought by adding `most` kg, `enough` at most.

    An element of mass m and step t bears the step T with the mass m (T / t)^2: T^2 sum m / t^2 - sum m = most, over those with t < T.
    """
    order = np.argsort(safe, kind="stable")
    mass, safe = mass[order], safe[order]
    reached = np.sqrt((most + np.cumsum(mass)) / np.cumsum(mass / safe**2))
    fits = np.append(reached[:-1] <= safe[1:], True)  # no further element would have to be made heavier
    return float(min(reached[np.argmax(fits)], enough))
