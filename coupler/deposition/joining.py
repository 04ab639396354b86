"""Between two impacts: the finished splat becomes bodies of elements, joins the target, and all comes to rest."""

import math
import time as clock
from collections.abc import Sequence

import numpy as np

from ..contact.overlap import overlaps
from ..errors import SolverError, SplatError
from ..fe.assemble import BodyState, Point
from ..fe.explicit import Target
from ..files.summary import Values
from ..geometry.extent import shape_measures
from ..impact.bodies import Bodies, heights_at
from ..impact.domains import Domains
from ..impact.run import ImpactOutcome
from ..physics.constitutive import sound_speed, von_mises
from ..plan.planning import Plan
from ..progress import Progress
from ..sph.carried_surface import CarriedSurface
from ..splat.cloud import Cloud
from ..splat.convert import convert
from .detaching import held_at_rest, release_time, without_detached
from .equilibrium import RELAXED, settle
from .mass_scaling import prepare
from .pause import pause

_CARRIED = ("stress", "eps_p", "T", "J", "velocity", "energy", "eps_gradient")
REST = 2.25  # windows round an impact in which equilibrium is found after it
SHELLS = (
    8  # of the numbering within REST: following a curve in each makes a step of the elements a quarter faster or more
)
RELEASED_BOUND = 0.005  # of an impact's kinetic energy: released kinetic energy after a splat has joined, at most


def join(
    plan: Plan, i: int, outcome: ImpactOutcome, progress: Progress, place: Point | None = None
) -> tuple[Bodies, Values]:
    """The bodies that impact i + 1 meets, or those after the last impact, and what it took to make them.

    outcome: of impact i; place: of an impact on a cut of the target (m), whose bodies come to rest within the impact's window and are
    not made ready for the next. A particle that has rebounded does not join; splats that are no longer held leave (`detaching`).
    Raises SolverError when it cannot be meshed or does not come to rest.
    """
    try:
        return _joined(plan, i, outcome, progress, place)
    except SplatError as problem:
        raise SolverError(
            f"impact {i + 1} is computed, but its splat cannot join the target: {problem} (in a scene: splat.method,"
            " resolution.element_size, resolution.spacing)"
        ) from problem


def _joined(
    plan: Plan, i: int, outcome: ImpactOutcome, progress: Progress, place: Point | None
) -> tuple[Bodies, Values]:
    started = clock.perf_counter()
    p, following = plan.impacts[i], plan.impacts[min(i + 1, len(plan.impacts) - 1)]
    domains, hold, values = outcome.domains, outcome.hold, outcome.record.values
    particle, bodies = domains.particle, domains.bodies
    kinetic_0 = float(values["kinetic_energy_0_J"])
    upwards = float(particle.totals.momentum[2] / particle.mass.sum())
    report: Values = {"impact": i + 1, "adhesion": plan.adhesion.kind, "velocity_z_m_s": upwards}
    report["velocity_ratio"] = ratio = p.velocity_ratio
    left = values["rebounded"] is True
    origin = place or point_of_impact(bodies, following.offset, None if left else domains)
    radius = math.inf if place is None else p.window
    if left:
        progress.log(f"particle {i + 1} leaves: {values['verdict_rests_on']}")
        progress.stage("bringing the target to rest")
        new, report["detached"] = bodies.renumbered(origin), []
        if place is None:
            new, report["detached"] = without_detached(plan, new, i + 1, "impact")
        new.target.window(radius)
        back = _way_back(bodies.target, new.target)
        report |= {"rebounded": True, "bodies": 0, **settle(new, kinetic_0, release_time(plan), back=back)}
        return (new if place else _ready(plan, i, new, origin, kinetic_0, report)), report
    progress.stage("meshing the splat")
    cloud = cloud_of(domains)
    splat = convert(cloud, plan.splat_element_size, plan.splat_method)
    report |= {
        "rebounded": False,
        "bodies": len(splat.bodies),
        "lost_mass_kg": splat.lost_mass,
        "conversion": splat.report,
    }
    law = particle.law
    states = [
        BodyState(
            points=b.points, tets=b.tets, mass=float(cloud.mass[b.cloud_index].sum()), law=law,
            **{name: np.asarray(getattr(b, name)) for name in _CARRIED},
        )
        for b in splat.bodies
    ]  # fmt: skip
    report["meshing_s"] = clock.perf_counter() - started
    held = hold.places(domains.surface.contacts(particle.x)) if hold is not None else None
    new = bodies.joined(states, plan.adhesion, plan.splat_element_size, origin, ratio, i + 1, held)
    report["detached"] = []
    if place is None:  # on a cut it is not known what is held: see `rest`
        new, report["detached"] = without_detached(plan, new, i + 1, "impact")
    report |= {
        "bonds": len(new.bond) if new.bond is not None else 0,
        "elements": len(new.target.mesh.conn), "before": _held(new),
    }  # fmt: skip
    progress.stage("bringing splat and target to rest")
    new.target.window(radius)
    own = np.flatnonzero(new.impact == i + 1).tolist()
    new.separate(own)
    report |= settle(new, kinetic_0, release_time(plan), back=_way_back(bodies.target, new.target))
    if report["left_J"] > RELAXED * kinetic_0:
        progress.log(
            f"after impact {i + 1} the bodies are not quite in equilibrium: {report['left_J'] / kinetic_0:.0e} of its kinetic energy"
            f" may still be set free, {RELAXED:.0e} is sought"
        )
    report["after"] = _held(new)
    deep = overlaps(new.surfaces, new.target.x, own)
    report["overlap_m"] = float(deep.max())
    report["joining_s"] = clock.perf_counter() - started
    if report["released"] > RELEASED_BOUND:
        raise SolverError(
            f"splat {i + 1} set free {report['released']:.2%} of the kinetic energy as it joined, allowed {RELEASED_BOUND:.1%}:"
            " try a finer preset, or another [splat] method"
        )
    if place is not None:
        return new, report
    progress.stage("cooling, and preparing the next impact")
    return _ready(plan, i, new, origin, kinetic_0, report), report


def point_of_impact(bodies: Bodies, offset: tuple[float, float], domains: Domains | None = None) -> Point:
    """Where the axis of a particle at `offset` (m) meets what lies there, (x, y, z) m: from there waves and windows are reckoned.

    domains: of the impact whose particle is about to join, and lies there too.
    """
    return points_of_impact(bodies, [offset], domains)[0]


def points_of_impact(
    bodies: Bodies, offsets: Sequence[tuple[float, float]], domains: Domains | None = None
) -> list[Point]:
    """`point_of_impact` of several particles."""
    axes, t = np.array(offsets), bodies.target
    z = heights_at(axes, t.x, t.mesh.facets[bodies.reachable()])
    if domains is not None:
        surface = domains.surface
        z = np.maximum(z, heights_at(axes, surface.positions(domains.particle.x), surface.triangles))
    return [(*offset, float(h) if np.isfinite(h) else 0.0) for offset, h in zip(offsets, z, strict=True)]


def _way_back(before: Target, now: Target) -> tuple[np.ndarray, np.ndarray] | None:
    """The nodes (k,) of a target that were at the elastic edge of the window before, and the way (k,3) m that leads them back to where
    they were at rest: what lies beyond the edge has not moved."""
    if before.edge is None:
        return None
    number, place = now.node_number, np.full(1 + int(before.node_number.max()), -1)
    known = np.flatnonzero(number >= 0)
    place[number[known]] = known
    nodes = place[before.node_number[before.edge.nodes]]
    return nodes, before.edge.rest - now.x[nodes]


def _ready(plan: Plan, i: int, bodies: Bodies, origin: Point, kinetic_0: float, report: Values) -> Bodies:
    """The bodies as the next impact meets them, after the pause; what was done in the report, as `cooling` and `mass_scaling`."""
    bodies, lost = held_at_rest(plan, bodies, i + 1, "rest", kinetic_0)
    report["detached"] += lost
    if i + 1 == len(plan.impacts):
        return bodies
    if plan.impacts[i].dwell > 0.0 and plan.effects.cooling:
        report["cooling"] = pause(plan, plan.impacts[i].dwell, bodies, kinetic_0)
        bodies, lost = held_at_rest(plan, bodies.renumbered(origin), i + 1, "pause", kinetic_0)
        report["detached"] += lost
    report["mass_scaling"] = prepare(plan, i + 1, bodies)
    return bodies


def rest(
    plan: Plan, impacts: range, bodies: Bodies, places: Sequence[Point], kinetic_0: float, report: Values
) -> Bodies:
    """The bodies after a batch of impacts and all the time until the next: heat has flowed, all is in equilibrium, and splats that are
    not held have left. places: of the impacts, m; kinetic_0: J, of all; report: of the last one's joining, to which this is added.

    Where that is less than all, equilibrium is found round the places up to REST windows from them, and after a pause as far as
    temperatures have changed. What little remains is relaxed after later impacts, or in the closing stage.
    """
    radius = REST * max(plan.impacts[i].window for i in impacts)
    shell = radius / SHELLS
    bodies, report["detached"] = without_detached(plan, bodies.renumbered(*places, shell=shell), impacts.stop, "impact")
    bodies.separate(_near(bodies, places, radius))
    time = sum(plan.impacts[i].dwell for i in impacts if i + 1 < len(plan.impacts))
    if time > 0.0 and plan.effects.cooling:
        report["cooling"] = pause(plan, time, bodies, kinetic_0, radius)
    else:
        settled = settle(bodies, kinetic_0, 0.0, radius=radius)
        report |= {f"whole_{name}": settled[name] for name in ("settle_steps", "left_J", "taken_J")}
    bodies, lost = held_at_rest(plan, bodies, impacts.stop, "pause" if time > 0.0 else "rest", kinetic_0)
    report["detached"] += lost
    return bodies


def _near(bodies: Bodies, places: Sequence[Point], radius: float) -> list[int]:
    """Bodies whose boxes come within a radius of one of the places, m."""
    low, high = bodies.surfaces.boxes(bodies.target.x)
    at = np.array(places)[:, None]
    away = np.maximum(np.maximum(low - at, at - high), 0.0)
    return np.flatnonzero((np.linalg.norm(away, axis=2) < radius).any(axis=0)).tolist()


def cloud_of(domains: Domains) -> Cloud:
    """The points of an impact with all they carry and their surface, that of a cavity included (`splat.cloud.Cloud`)."""
    particle, body = domains.particle, domains.body
    law, vertices, triangles = particle.law[0], domains.surface.positions(particle.x), domains.surface.triangles
    if body.inner is not None:
        cavity = CarriedSurface(body.points, *body.inner, body.spacing)
        triangles = np.concatenate([triangles, cavity.triangles + len(vertices)])
        vertices = np.concatenate([vertices, cavity.positions(particle.x)])
    return Cloud(
        x=np.array(particle.x), volume=particle.whole("volume"), spacing=particle.spacing, rho=float(law["rho"]),
        velocity=np.array(particle.v),
        stress=particle.stress(), eps_p=np.array(particle.eps_p), T=np.array(particle.T), J=np.array(particle.J),
        energy=np.array(particle.energy), eps_gradient=particle.spatial_gradient(),
        surface=(vertices, triangles),
        wave_speed=sound_speed(float(law["rho"]), float(law["K"]), float(law["G"])),
    )  # fmt: skip


def _held(bodies: Bodies) -> dict[str, float]:
    """What the last body holds: means over its elements of von Mises stress, pressure, plastic strain and temperature."""
    t = bodies.target
    own = bodies.body == bodies.count - 1
    weight = t.volume[own]
    pressure = t.p[t.mesh.conn[own]].mean(axis=1)
    values = {"von_mises_Pa": von_mises(t.s[own]), "pressure_Pa": pressure, "eps_p": t.eps_p[own], "T_K": t.T[own]}
    return {name: float(np.average(value, weights=weight)) for name, value in values.items()}


def splats_at_end(plan: Plan, levels: Sequence[float], joined: int, bodies: Bodies) -> list[dict[str, float] | None]:
    """How the splats of the first `joined` impacts stand in the target: measures of shape, SI; None for one that has left.

    levels: height (m) of the surface that each particle met.
    """
    mesh, standing = bodies.target.mesh, []
    impact_of_facet = bodies.impact[bodies.body[mesh.facet_element]]
    for number, (impact, level) in enumerate(zip(plan.impacts[:joined], levels, strict=False), 1):
        facets = mesh.facets[impact_of_facet == number]
        away = bodies.target.x - np.array([0.0, 0.0, level])
        standing.append(shape_measures(away, facets, impact.diameter) if len(facets) else None)
    return standing
