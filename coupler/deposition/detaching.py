"""Splats that leave the coating because their bonds are broken.

A splat is attached if a path of unbroken bonds leads from it to the substrate (`Bodies.attached`); an embedded ceramic is attached to
what it touches. A splat that is not attached after an impact, at rest or in the closing stage is removed. With adhesion of kind "tied"
only a particle that rebounds without a bond leaves; with "none" all splats stay.
"""

import numpy as np

from ..files.summary import Values
from ..plan.planning import Plan
from ..target.bodies import Bodies
from ..target.equilibrium import RELEASE_TIME, settle
from ..target.placing import NEAR

REASON = "no chain of unbroken bonds connects it to the substrate"


def release_time(plan: Plan) -> float:
    """Time (s) in which the energy released by joining is measured: proportional to the largest diameter, constant above 25 um."""
    return RELEASE_TIME * min(max(impact.diameter for impact in plan.impacts) / 25e-6, 1.0)


def without_detached(plan: Plan, bodies: Bodies, number: int, stage: str) -> tuple[Bodies, list[Values]]:
    """Remove bodies that are not attached. Returns the others, not yet in equilibrium, and a record of each splat with removed bodies.

    number: number of the last impact; stage: in which the bonds broke. Keys of a record: splat and by_impact (numbers of impacts),
    stage, bodies and mass_kg (removed), velocity_z_m_s, reason.
    """
    embedded = [b for b, i in enumerate(bodies.impact) if i > 0 and plan.impacts[i - 1].material.is_ceramic]
    if plan.adhesion.kind == "none" or (attached := bodies.attached(embedded, NEAR * plan.splat_element_size)).all():
        return bodies, []
    t = bodies.target
    mass = t.laws["rho"][t.law_of] * t.mesh.V0
    upwards = t.nodes.v[t.mesh.conn, 2].mean(axis=1)
    records = []
    for splat in np.unique(bodies.impact[~attached]):
        gone = ~attached & (bodies.impact == splat)
        own = gone[bodies.body]
        records.append({
            "splat": int(splat), "by_impact": number, "stage": stage, "bodies": int(gone.sum()), "mass_kg": float(mass[own].sum()),
            "velocity_z_m_s": float(np.average(upwards[own], weights=mass[own])), "reason": REASON,
        })  # fmt: skip
    return bodies.without(~attached, plan.splat_element_size), records


def all_attached(plan: Plan, bodies: Bodies, number: int, stage: str, kinetic_0: float) -> tuple[Bodies, list[Values]]:
    """Remove bodies that are not attached, and bring the others to rest; repeat this until all are attached. Returns these bodies and
    the records of the removals. Arguments as for `without_detached`; kinetic_0: kinetic energy of the impacts before, J."""
    records: list[Values] = []
    while True:
        bodies, detached = without_detached(plan, bodies, number, stage)
        if not detached:
            return bodies, records
        records += detached
        settle(bodies, kinetic_0, release_time(plan))
