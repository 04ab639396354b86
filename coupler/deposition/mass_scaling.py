"""Two measures against the growth of the cost with the number of impacts: selective mass scaling, and a window around each impact.

A few strongly deformed elements of splats would determine the time step of all later impacts. Inertia is added to their deformation
(`fe.inertia`), and mass to the lightest nodes of surfaces, for the springs of contact. The domain far from the impact is not
computed: it is in equilibrium and acts as an elastic body (`Target.set_window`).
"""

import math

import numpy as np

from ..files.summary import Values
from ..particle.inertia import ENOUGH
from ..plan.planning import Plan
from ..target.bodies import Bodies
from ..target.domain import Point

SPRINGS = 2.5  # time step that the springs of contact must allow, over the sufficient step of a particle (ENOUGH)


def prepare(plan: Plan, i: int, bodies: Bodies, place: Point) -> Values:
    """Prepare bodies at rest for impact i: mass scaling and window. place: impact point, m, from which the bodies are numbered
    outwards. Returns entries of the report."""
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
