"""A substrate that splats cover gets coarser elements: its fine ones are there for craters.

Its surface stays as it is, with contact and bonds; inside, elements grow from REFINED of the depth on to which they were fine. State
is carried over by `fe.remeshed`; what that changes is in the report, and equilibrium is found anew in the pause that follows.
Splats are not coarsened: nine tenths of their nodes lie on their surfaces.
"""

import time as clock
from functools import partial

import numpy as np

from ..errors import SplatError
from ..fe.assemble import domain_now, merge
from ..fe.explicit import Target
from ..fe.remeshed import base_surface, with_base
from ..files.summary import Values
from ..geometry import mesher
from ..geometry.apart import apart
from ..impact.bodies import Bodies
from ..impact.domains import MESHING_LIMIT
from ..plan.batches import covering
from ..plan.planning import Plan

REFINED = 0.25  # of the depth to which elements are as fine as at the surface


def is_due(plan: Plan, impacts: range) -> bool:
    """Whether splats cover the substrate (`plan.batches.covering`) after these impacts, and did not before."""
    after = covering(plan.impacts)
    return after is not None and impacts.start < after <= impacts.stop


def coarsened(plan: Plan, bodies: Bodies) -> tuple[Bodies, Values]:
    """The bodies at rest with coarser elements in the substrate, not in equilibrium, and a report: the substrate's number of elements,
    mean temperature (K) and in-plane stress (Pa) before and after, energy (J) that the change of the mesh gives to the bodies; or the
    bodies as they are, and why gmsh fails."""
    started, target, t = clock.perf_counter(), plan.target, bodies.target
    bodies.release_heat()
    domain = domain_now(t, bodies.body)
    nodes, triangles = base_surface(domain)
    grown = mesher.Grading(
        REFINED * target.refined_radius, target.growth, target.centre, target.largest_element, target.spread
    )
    before = _measures(bodies)
    held, warmth = t.elastic(), float(t.mesh.node_volume @ t.energy)
    try:
        points, tets = apart(
            partial(mesher.fill, [(t.x[nodes], triangles)], target.element_size, grown=grown), MESHING_LIMIT
        )
        part, number = with_base(domain, points, tets)
    except SplatError as problem:
        return bodies, {"failed": str(problem)}
    numbered, rank = merge([part], (0.0, 0.0, 0.0))
    new = bodies.on(numbered, np.where(number >= 0, rank[number], -1), bodies.buried)
    # the heat that the nodes hold is theirs; what the mesh changes is of elastic energy
    new.target.sums[2] += float(new.target.mesh.node_volume @ new.target.energy) - warmth
    report: Values = {f"{name}_before": value for name, value in before.items()}
    report |= {f"{name}_after": value for name, value in _measures(new).items()}
    return new, report | {"given_J": new.target.elastic() - held, "wall_s": clock.perf_counter() - started}


def words(report: Values) -> str:
    """What was done, for the run's log."""
    if "failed" in report:
        return f"the substrate keeps its fine elements, because it could not be meshed anew: {report['failed']}"
    before, after = (round(report[f"elements_{when}"]) for when in ("before", "after"))
    return f"splats cover the substrate: it has {after} elements from here on, {before} before"


def _measures(bodies: Bodies) -> dict[str, float]:
    """Of the substrate: number of elements, mean temperature (K) and mean in-plane stress (Pa)."""
    t, own = bodies.target, bodies.body == 0
    mean = float(np.average(t.T[own], weights=t.mesh.V0[own]))
    return {"elements": float(own.sum()), "T_mean_K": mean, "stress_Pa": _in_plane(t, own)}


def _in_plane(t: Target, which: np.ndarray) -> float:
    """Mean over volume of the in-plane stress (xx + yy) / 2, Pa; 0 without elements."""
    stress = t.stress()[which]
    return float(np.average(0.5 * (stress[:, 0] + stress[:, 1]), weights=t.volume[which])) if which.any() else 0.0
