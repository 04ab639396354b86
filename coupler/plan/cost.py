"""Estimate of size and cost of a run, before the run: steps, wall time on one core, memory, file sizes. All fitted constants of the
estimate are here."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from ..geometry.tetrahedra import COARSEST, TETS_PER_H3
from ..physics.materials import Material
from ..physics.strength import HARDNESS_OVER_FLOW_STRESS
from .model import ImpactPlan, Plan

# preset -> points of the particle
PRESETS = {"draft": 1000, "standard": 5000, "fine": 16000}
LEAST_POINTS = 200
LEAST_LAYERS = 2.0  # spacings across the thinnest part of a shape
# Steps with one dt and one contact search, without output between them. At a Courant factor of 0.9 more steps with one dt are unstable.
CHUNK = 10

# Elements are larger than the spacing: single points would indent finer facets.
ELEMENT_SIZE_OVER_SPACING = 1.7
REFINED_RADIUS_OVER_DIAMETER = 0.55  # of the part of the target with the smallest elements

WINDOW_OVER_DIAMETER = 1.75  # radius round an impact within which the target is computed, for many impacts
MANY = 10  # least number of particles for this window
# Longest time of an impact: the largest of
CAP = 3.0  # - this number of heights over velocity,
SLIDES = 1.5  # - this number of heights over the velocity towards the target, which is larger beyond 60 degrees,
STOPS = 2.0  # - and this number of stopping times: one until the particle stops, one for the rebound
ON_SPLATS = 4.0  # factor on this time above splats: overhanging splats bend slowly, particles slide down their flanks
GREATEST_OVER_REST = 0.75  # time of the greatest deformation over time of rest
# Fits (workflows/pace.py --fit) with the `loads` w of particle (p) and target (t).
# REST_FIT: (time to rest) v / height = (a w_p^b + a w_t^b) exp(c sin^2 angle), with a, b of each body.
# STEP_FIT: increase of spacing / (wave speed * dt) by deformation: the sum of a w^b of both bodies, in which w has the factor
# cos^2 angle + SHEARED sin angle cos angle. If only one body deforms, it is compressed where it flows along the other, more with finer
# points: the term of the particle has the factor (1 + w_p)^(e alone), the sum has the factor (N / 1000)^(f alone).
# alone = ((w_p - w_t) / (w_p + w_t))^2; N: points of a sphere of the particle's diameter.
REST_FIT = (0.75, 0.316), (0.259, 0.78), 0.953
STEP_FIT = (0.59, 1.127), (0.443, 0.976), (0.541, 0.608)
SHEARED = 2.348
CFL = {"enriched": 0.54, "compiled": 0.41, "machdyn": 0.41}  # wave speed * dt / spacing without deformation, by engine
STEP_ON_SPLAT = 0.69  # dt of an impact on a splat over dt on a substrate: 0.58 to 0.78 in docs/tables/validation.csv
STRAIN_OF_FLOW = 0.3  # strain of the flow stress in a damage number
STRAIN_OF_RIM = 1.5  # of a particle
SPLAT_TETS_PER_H3 = 5.5  # in meshes of splats, which have a large surface: 4.2 to 7 counted
# wall time of one step, one core, by engine
SECONDS_PER_POINT = {"compiled": 0.7e-6, "enriched": 1.0e-6, "machdyn": 2.6e-6}
SECONDS_PER_ELEMENT = 0.12e-6
SECONDS_PER_STEP = 6e-4
SECONDS_PER_RUN = 0.3  # files and pictures, without the start of the program
SECONDS_PER_MESHED_ELEMENT = 1e-4
SECONDS_PER_SPLAT_ELEMENT = 2e-4  # of the conversion of points to elements: 1 s for 5000 ...
SECONDS_PER_CONVERSION = 0.3  # ... and for its process
# Between impacts (`deposition`), means of a coating of 40 particles: steps until the target is at rest after a new splat or a pause,
# and steps of implicit conduction
GRID = 1.6  # cost of a step with the coarse grid over cost without it
JOIN_STEPS = 30 * GRID
PAUSE_STEPS = 190 * GRID  # before and after a pause
HEAT_STEPS = 23
SECONDS_PER_HEAT_ELEMENT = 1.3e-6  # of a step of conduction

BYTES_PER_POINT = 3e4  # maximum during the construction of the carried surface
BYTES_PER_ELEMENT = 6e3
BYTES_AT_LEAST = 4e8  # the program and its libraries
# compressed, per written step: 33 to 37 and 53 to 62 in coatings of 40 and 200 and in a particle of 40,000 points
FILE_BYTES_PER_ELEMENT = 36.0
FILE_BYTES_PER_POINT = 58.0
VERTICES = 6.5  # of a particle's surface over points^(2/3)


def spacing(volume: float, points: float) -> float:
    """Spacing, m, of a number of points in a volume (m^3): each point has the volume spacing^3."""
    return (volume / points) ** (1 / 3)


def elements(
    diameter: float, height: float, element_size: float, refined_radius: float, growth: float, spread: float = 0.0
) -> int:
    """Estimated number of tetrahedra of a graded mesh of a cylinder, lengths in m. The elements have element_size within refined_radius
    of a disc of radius `spread` in the top face, and grow outside.

    It is the integral of TETS_PER_H3 / h(r)^3 over the volume below and beside the disc, up to the volume of the cylinder. r: distance
    from the disc; h(r) = element_size + growth max(0, r - refined_radius), at most COARSEST min(diameter, height).
    """
    cylinder = math.pi / 4 * diameter**2 * height
    r = np.linspace(0.0, (1.5 * cylinder / math.pi) ** (1 / 3), 401)  # at most the radius of a half ball
    volume = np.minimum(math.pi * spread**2 * r + 0.5 * math.pi**2 * spread * r**2 + 2 / 3 * math.pi * r**3, cylinder)
    middle = 0.5 * (r[1:] + r[:-1])
    h = np.minimum(element_size + growth * np.maximum(0.0, middle - refined_radius), COARSEST * min(diameter, height))
    return round(float(np.sum(TETS_PER_H3 * np.diff(volume) / h**3)))


def splat_elements(volume: float, element_size: float) -> int:
    """Estimated number of tetrahedra of a splat of `volume` m^3 with edges of element_size m."""
    return round(SPLAT_TETS_PER_H3 * volume / element_size**3)


def flow_stress(material: Material, T: float, rate: float, strain: float = STRAIN_OF_FLOW) -> float:
    """Flow stress, Pa, at a plastic strain. rate: strain rate, 1/s; T: temperature, K, which is limited to a value below the melting
    point."""
    hottest = material.T_ref + 0.95 * (material.T_m - material.T_ref)
    return material.flow_stress(strain, rate, min(T, hottest))


def loads(
    materials: tuple[Material, Material], temperatures: tuple[float, float], velocity: float, diameter: float
) -> tuple[float, float]:
    """Loads of particle and target in an impact: twice the energy that each absorbs, divided by its flow stress and by the volume of
    the particle.

    The load is Johnson's damage number rho v^2 / Y times the fraction of the energy that the body absorbs. rho: density of the
    particle; Y: flow stress of the body, for the particle that of its rim, which a strain of STRAIN_OF_RIM heats. The fraction is
    proportional to 1 / Y, here without this heating. materials, temperatures (K): of particle and target; velocity m/s, diameter m.
    """
    metal, rate, inertia = materials[0], velocity / diameter, materials[0].rho * velocity**2
    Y, Y_base = (flow_stress(m, T, rate) for m, T in zip(materials, temperatures, strict=True))
    share = Y_base / (Y + Y_base)
    T, part = temperatures[0], STRAIN_OF_RIM / 3
    for strain in (part, 2 * part, 3 * part):
        heat = metal.taylor_quinney * part * flow_stress(metal, T, rate, strain)
        T += heat / (metal.rho * metal.cp_at(min(T, metal.T_m)))
    return share * inertia / flow_stress(metal, T, rate, STRAIN_OF_RIM), (1.0 - share) * inertia / Y_base


def stopping_time(
    materials: tuple[Material, Material], temperatures: tuple[float, float], velocity: float, diameter: float
) -> float:
    """Stopping time, s, of a sphere on a target that resists with the pressure H + rho_t v^2 / 2 (Poncelet 1829). H is the hardness of
    the softer body; the time is (2/3) rho_p D atan(v / sqrt(2 H / rho_t)) / sqrt(H rho_t / 2). materials, temperatures (K): those of
    particle and target; velocity m/s, diameter m."""
    rate, (particle, target) = velocity / diameter, materials
    H = HARDNESS_OVER_FLOW_STRESS * min(flow_stress(m, T, rate) for m, T in zip(materials, temperatures, strict=True))
    slowing = math.atan(velocity * math.sqrt(target.rho / (2.0 * H)))
    return 2.0 / 3.0 * particle.rho * diameter / math.sqrt(0.5 * H * target.rho) * slowing


def expected_time(
    cap: float, height: float, velocity: float, end_at: str, load: tuple[float, float], angle: float
) -> float:
    """Expected simulated time of an impact, s. cap: its longest time, s; height: that of the particle, m; velocity (m/s); end_at:
    "rest", "greatest" (deformation) or "time"; load: from `loads`; angle (rad): of the velocity from the normal."""
    if end_at == "time":
        return cap
    (a, b), (c, d), oblique = REST_FIT
    crossings = (a * load[0] ** b + c * load[1] ** d) * math.exp(oblique * math.sin(angle) ** 2)
    return min(cap, crossings * height / velocity * (GREATEST_OVER_REST if end_at == "greatest" else 1.0))


def time_step(
    spacing: float, wave_speed: float, load: tuple[float, float], points: float, angle: float, engine: str, tall: float
) -> float:
    """Mean time step of an impact until rest, s. Deformation decreases the step. spacing (m); wave_speed (m/s); points: number of
    points of the sphere with the volume of the particle; tall: height of the particle divided by the diameter of this sphere; load,
    angle: as in `expected_time`."""
    (a, b), (c, d), (e, f) = STEP_FIT
    pressed = math.cos(angle) * (math.cos(angle) + SHEARED * math.sin(angle))
    alone = ((load[0] - load[1]) / sum(load)) ** 2
    excess = a * (pressed * load[0]) ** b * (1.0 + load[0]) ** (e * alone) + c * (pressed * load[1]) ** d
    excess *= (points / 1000.0) ** (f * alone)
    return spacing / wave_speed / (1.0 / CFL[engine] + excess * max(tall, 1.0))


def memory(points: float, n_elements: float) -> float:
    """Memory of a run, bytes."""
    return BYTES_AT_LEAST + BYTES_PER_POINT * points + BYTES_PER_ELEMENT * n_elements


def machine_memory() -> float:
    """Memory of this machine, bytes; infinite if the system does not give it."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return math.inf


def step_time(steps: float, points: float, n_elements: float, engine: str) -> float:
    """Computing time, s, of a number of time steps on one core."""
    return steps * (SECONDS_PER_STEP + SECONDS_PER_ELEMENT * n_elements + SECONDS_PER_POINT[engine] * points)


@dataclass(frozen=True)
class Forecast:
    """Expected cost of a plan. steps: number of steps of each impact; shares: for each impact the time before its steps and the time of
    its steps, as fractions of the wall time without meshing; whole: wall time, s; memory, files: bytes."""

    steps: list[int]
    shares: list[tuple[float, float]]
    whole: float
    memory: float
    files: float


def forecast(plan: Plan) -> Forecast:
    """The expected cost of a plan."""
    impacts = plan.impacts
    # elements of all bodies before each impact, substrate and splats
    met = list(accumulate((i.splat_elements for i in impacts[:-1]), initial=plan.target.elements_estimate))
    steps = [math.ceil(i.expected / i.dt_expected) for i in impacts]
    looped, between, files = list[float](), _between(plan, met), 0.0
    for n, impact, elements in zip(steps, impacts, met, strict=True):
        points = impact.points
        looped.append(step_time(n, points, _computed(plan, impact, elements), plan.engine))
        # steps at regular times, at the greatest deformation and at the end; or only the end
        every = max(impact.output_every, CHUNK * impact.dt_expected)
        stored = impact.expected // every + 3.0 if math.isfinite(every) else 1.0
        places = points + VERTICES * points ** (2.0 / 3.0)
        files += stored * (FILE_BYTES_PER_ELEMENT * elements + FILE_BYTES_PER_POINT * places)
    ends = list(accumulate(map(sum, zip(looped, between, strict=True)), initial=0.0))
    whole = ends[-1] + SECONDS_PER_RUN
    shares = [(begin / whole, own / whole) for begin, own in zip(ends, looped, strict=False)]
    time = whole + SECONDS_PER_MESHED_ELEMENT * plan.target.elements_estimate
    return Forecast(steps, shares, time, memory(max(i.points for i in impacts), met[-1]), files)


def _computed(plan: Plan, impact: ImpactPlan, met: int) -> int:
    """Number of elements that an impact computes: those of the substrate within its window, and a share of those of the splats.
    The share is the area of the window divided by the refined area, at most 1. met: elements of substrate and earlier splats."""
    target, w = plan.target, impact.window
    if math.isinf(w):
        return met
    share = min((w / (target.spread + target.refined_radius)) ** 2, 1.0)
    within = elements(2.0 * w, min(w, target.height), target.element_size, target.refined_radius, target.growth)
    return min(met, within + round(share * (met - target.elements_estimate)))


def _between(plan: Plan, met: Sequence[int]) -> list[float]:
    """Computing time (s) from each impact to the next: conversion of its splat, relaxation to rest and, after a batch, the pause. The
    last impact has the closing stage instead of a pause; without a closing stage its time is 0. met: elements before each impact."""
    paused = {batch.stop - 1 for batch in plan.batches if plan.effects.cooling}
    closed, times = plan.ambient is not None, []
    for i, (before, impact) in enumerate(zip(met, plan.impacts, strict=True)):
        last, own = i == len(met) - 1, impact.splat_elements
        step = SECONDS_PER_ELEMENT * (before + own)
        time = JOIN_STEPS * step + (SECONDS_PER_CONVERSION + SECONDS_PER_SPLAT_ELEMENT * own) * (own > 0)
        if closed if last else i in paused:
            heat = 0.0 if last else HEAT_STEPS * SECONDS_PER_HEAT_ELEMENT
            time += PAUSE_STEPS * step + heat * (before + own)
        times.append(time if closed or not last else 0.0)
    return times
