"""Work after an impact: the particle is converted to a splat of finite elements, joins the target, and all bodies come to rest."""

import time as clock
from collections.abc import Sequence

import numpy as np

from ..contact.overlap import overlaps
from ..errors import SolverError, SplatError
from ..files.summary import Values
from ..impact.domains import Domains, metals_of
from ..impact.exchange import Impact
from ..physics.adhesion import Adhesion
from ..physics.constitutive import sound_speed
from ..physics.metal import carried
from ..plan.batches import Batch
from ..plan.planning import Plan
from ..progress import Progress
from ..splat.cloud import Cloud
from ..splat.convert import convert
from ..target.bodies import Bodies
from ..target.domain import BodyState, Point
from ..target.equilibrium import RELAXED, settle
from ..target.positions import displacement_back, means_of, near
from .detaching import all_attached, release_time, without_detached
from .pause import pause

REST = 2.25  # radius about an impact point in which equilibrium is computed, divided by the radius of the sub-domain
SHELLS = 8  # of the numbering within REST: a space-filling curve in each shell makes a step of the elements 25 % faster or more
# greatest kinetic energy that the joining of a splat may release, divided by the kinetic energy of the impact
RELEASED_BOUND = 0.005


def join(impact: Impact, record: Values, progress: Progress, place: Point) -> tuple[Bodies, Values]:
    """The bodies of a sub-domain with the splat of an impact, at rest within the window of the impact; and a report.

    impact, record: finished impact, and its entry in the summary; place: impact point, m, from which nodes and elements are numbered
    outwards. A particle that has rebounded does not join. Splats without bonds are removed later, on the full domain (`rest`). Raises
    SolverError if the particle cannot be meshed, or if joining releases more than RELEASED_BOUND of the impact's kinetic energy.
    """
    started, particle, kinetic_0 = clock.perf_counter(), impact.particle, float(record["kinetic_energy_0_J"])
    i = impact.domains.i
    report: Values = {
        "impact": i + 1, "adhesion": impact.domains.plan.adhesion.kind,
        "velocity_z_m_s": float(particle.totals.momentum[2] / particle.mass.sum()),
        "velocity_ratio": impact.domains.own.velocity_ratio,
        "rebounded": record["rebounded"] is True,
    }  # fmt: skip
    if report["rebounded"]:
        progress.log(f"particle {i + 1} leaves the target: {record['verdict_rests_on']}")
        progress.stage("bringing the target to rest")
        new = impact.bodies.renumbered(place)
        return new, report | {"bodies": 0, "detached": [], **_settled(impact, kinetic_0, new)}
    progress.stage("meshing the splat")
    try:
        new, joined = _with_splat(impact, place)
    except SplatError as problem:
        raise SolverError(
            f"impact {i + 1} is computed, but its splat cannot join the target: {problem} (or change splat.method,"
            " resolution.element_size or resolution.spacing)"
        ) from problem
    meshing = clock.perf_counter() - started
    report |= {**joined, "meshing_s": meshing, "detached": [], "before": means_of(new, new.count - 1)}
    progress.stage("bringing splat and target to rest")
    own = np.flatnonzero(new.impact == i + 1).tolist()
    new.separate(own)
    report |= _settled(impact, kinetic_0, new)
    if report["left_J"] > RELAXED * kinetic_0:
        progress.log(
            f"after impact {i + 1} the bodies are not in equilibrium: they can release up to {report['left_J'] / kinetic_0:.0e} of"
            f" the kinetic energy of the impact; the limit is {RELAXED:.0e}"
        )
    deep = overlaps(new.surfaces, new.target.nodes.x, own)
    report |= {"after": means_of(new, new.count - 1), "overlap_m": float(deep.max())}
    report["joining_s"] = clock.perf_counter() - started
    if report["released"] > RELEASED_BOUND:
        raise SolverError(
            f"splat {i + 1} released {report['released']:.2%} of the kinetic energy when it joined the target,"
            f" but the limit is {RELEASED_BOUND:.1%}: try a finer preset, or another [splat] method"
        )
    return new, report


def _with_splat(impact: Impact, place: Point) -> tuple[Bodies, Values]:
    """The bodies with the splat of an impact, before equilibrium, and a report."""
    domains, bonds, particle = impact.domains, impact.bonds, impact.particle
    plan, number, ratio, own = domains.plan, domains.i + 1, domains.own.velocity_ratio, domains.own.material
    splat = convert(cloud_of(domains), plan.splat_element_size, plan.splat_method)
    states = [
        BodyState(
            points=b.points, tets=b.tets, mass=float(particle.mass[b.cloud_index].sum()), law=particle.law[[int(b.is_core)]],
            stress=np.asarray(b.stress), J=np.asarray(b.J), velocity=np.asarray(b.velocity), energy=np.asarray(b.energy), **carried(b),
        )
        for b in splat.bodies
    ]  # fmt: skip
    bonded = bonds.unbroken(domains.surface.contacts(particle.x)) if bonds is not None else None
    kept = np.concatenate([body.cloud_index for body in splat.bodies])
    shells, cores = ([s for s, b in zip(states, splat.bodies, strict=True) if b.is_core == k] for k in (False, True))
    materials = [*metals_of(plan, domains.bodies), *[own] * len(shells)]
    partners = np.array([plan.adhesion.joins(own, each) for each in materials])
    size = plan.splat_element_size
    new = domains.bodies.joined(shells, plan.adhesion, size, place, ratio, number, bonded, partners)
    if cores:
        of_shell = np.append(new.impact == number, np.ones(len(cores), bool))
        new = new.joined(cores, Adhesion(kind="tied"), size, place, None, number, partners=of_shell)
    return new, {
        "bodies": len(splat.bodies), "lost_mass_kg": float(np.delete(particle.mass, kept).sum()), "conversion": splat.report,
        "bonds": len(new.bond) if new.bond is not None else 0, "elements": len(new.target.mesh.conn),
    }  # fmt: skip


def _settled(impact: Impact, kinetic_0: float, new: Bodies) -> Values:
    """Bring the bodies `new` to rest within the window of the impact. Returns the result of `settle`. kinetic_0: as there."""
    new.target.set_window(impact.domains.own.window)
    return settle(new, kinetic_0, release_time(impact.domains.plan), back=displacement_back(impact.target, new.target))


def rest(plan: Plan, batch: Batch, bodies: Bodies, places: Sequence[Point], kinetic_0: float, report: Values) -> Bodies:
    """The bodies after a batch of impacts and the pause until the next: heat has flowed, bodies are in equilibrium, and splats that
    are not attached are removed. places: impact points, m; kinetic_0: kinetic energy of all impacts of the batch, J; report: report
    of the last joining, to which entries are added.

    Equilibrium is computed up to the distance REST from the impact points, and after a pause also wherever temperatures have changed.
    The small imbalance farther away is relaxed after later impacts or in the closing stage.
    """
    radius = min(REST * batch.cut, float(np.linalg.norm(np.ptp(bodies.target.nodes.x, axis=0))))
    numbered = bodies.renumbered(*places, shell=radius / SHELLS)
    bodies, report["detached"] = without_detached(plan, numbered, batch.stop, "impact")
    bodies.separate(near(bodies, places, radius))
    if batch.pause > 0.0:
        report["cooling"] = pause(plan, batch.pause, bodies, kinetic_0, radius)
    else:
        settled = settle(bodies, kinetic_0, 0.0, radius=radius)
        report |= {f"whole_{name}": settled[name] for name in ("settle_steps", "left_J", "taken_J")}
    bodies, lost = all_attached(plan, bodies, batch.stop, "pause" if batch.pause > 0.0 else "rest", kinetic_0)
    report["detached"] += lost
    return bodies


def cloud_of(domains: Domains) -> Cloud:
    """The points of a particle at the end of an impact with their state, and its surface with its cavities (`splat.cloud.Cloud`)."""
    particle, surface, law = domains.particle, domains.whole_surface, domains.particle.law[0]
    return Cloud(
        x=np.array(particle.x), volume=particle.whole("volume"), spacing=particle.spacing, rho=float(law["rho"]),
        velocity=np.array(particle.v), core=particle.law_of == 1 if len(particle.law) > 1 else None,
        stress=particle.stress(), J=np.array(particle.points.J), energy=np.array(particle.points.energy), **particle.carried(),
        surface=(surface.positions(particle.x), surface.triangles),
        wave_speed=max(sound_speed(float(r["rho"]), float(r["K"]), float(r["G"])) for r in particle.law),
    )  # fmt: skip
