"""What keeps the cost of an impact from growing much with the number of those before it: selective mass scaling, a window.

A few elements of splats that others have crushed would dictate the time step of all impacts to come: they change their shape against
an added inertia (`fe.inertia`), and the lightest nodes of surfaces are a little heavier, for the springs of contact. And what is far
from the impact is not computed (`Target.set_window`): it is in equilibrium, and answers as an elastic body.
"""

import math

import numpy as np

from ..files.summary import Values
from ..particle.inertia import ENOUGH
from ..plan.planning import Plan
from ..target.bodies import Bodies
from ..target.domain import Point

SPRINGS = 2.5  # steps that are enough for a particle: one so long the springs of contact bear


def prepare(plan: Plan, i: int, bodies: Bodies, place: Point) -> Values:
    """Prepare bodies at rest, numbered outwards from the place (m) of impact i, for this impact. Returns the entries of the report."""
    report: Values = {}
    if i and plan.mass_scaling:
        p = plan.impacts[i]
        most = plan.mass_scaling * p.material.rho * math.pi / 6.0 * p.diameter**3
        bodies.target.inertia.most = most
        if bodies.contact is not None:
            step = SPRINGS * ENOUGH * p.spacing / p.material.wave_speed
            report["added_mass_kg"] = bodies.target.weigh_surface(bodies.contact.pairs.mass_for(step), most)
    within = bodies.target.set_window(plan.impacts[i].window, np.array(place))
    if within < len(bodies.target.mesh.conn):
        report |= {"window_m": plan.impacts[i].window, "elements_in_window": within}
    return report
