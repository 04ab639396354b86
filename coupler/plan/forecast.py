"""Expected cost of a plan: time steps, wall time on one core, memory, file sizes. The constants are in `plan.cost`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from . import cost
from .model import ImpactPlan, Plan


@dataclass(frozen=True)
class Forecast:
    """Expected cost of a plan. steps: number of steps of each impact; shares: for each impact two fractions of the wall time, before
    its steps and of its steps; whole: wall time, s; memory, files: bytes; target_load: cost of target and contact divided by cost of
    the particles."""

    steps: list[int]
    shares: list[tuple[float, float]]
    whole: float
    memory: float
    files: float
    target_load: float


def forecast(plan: Plan) -> Forecast:
    """The expected cost of a plan."""
    impacts, engine = plan.impacts, plan.engine
    # elements of all bodies before each impact, substrate and splats
    met = list(accumulate((i.splat_elements for i in impacts[:-1]), initial=plan.target.elements_estimate))
    steps = [math.ceil(i.expected / i.dt_expected) for i in impacts]
    looped, between, files, load, weight = list[float](), _between(plan, met), 0.0, 0.0, 0.0
    for n, impact, elements in zip(steps, impacts, met, strict=True):
        computed, points = _computed(plan, impact, elements), impact.points
        looped.append(cost.step_time(n, points, computed, engine))
        files += _file_bytes(impact, elements)
        load += n * points * cost.target_load(points, computed, engine)
        weight += n * points  # proportional to the cost of the particle
    ends = list(accumulate(map(sum, zip(looped, between, strict=True)), initial=0.0))
    whole = ends[-1] + cost.SECONDS_PER_RUN
    shares = [(begin / whole, own / whole) for begin, own in zip(ends, looped, strict=False)]
    time = sum(looped) + sum(between) + cost.run_time(plan.target.elements_estimate)
    return Forecast(steps, shares, time, cost.memory(max(i.points for i in impacts), met[-1]), files, load / weight)


def _computed(plan: Plan, impact: ImpactPlan, met: int) -> int:
    """Number of elements that an impact computes: those of the substrate within its window, and those of the splats in proportion to
    the area of the window. met: elements of all bodies."""
    target, w = plan.target, impact.window
    if math.isinf(w):
        return met
    share = min((w / (target.spread + target.refined_radius)) ** 2, 1.0)
    within = cost.elements(2.0 * w, min(w, target.height), target.element_size, target.refined_radius, target.growth)
    return min(met, within + round(share * (met - target.elements_estimate)))


def _between(plan: Plan, met: Sequence[int]) -> list[float]:
    """Computing time after each impact, before the next one, s: conversion of its splat, relaxation to rest and, after the last
    impact of each batch, the pause. After the last impact there is only the closing stage."""
    paused = {batch.stop - 1 for batch in plan.batches if plan.effects.cooling}
    closed, times = plan.ambient is not None, []
    for i, (before, impact) in enumerate(zip(met, plan.impacts, strict=True)):
        last, own = i == len(met) - 1, impact.splat_elements
        step = cost.SECONDS_PER_ELEMENT * (before + own)
        time = cost.JOIN_STEPS * step + (cost.SECONDS_PER_CONVERSION + cost.SECONDS_PER_SPLAT_ELEMENT * own) * (own > 0)
        if closed if last else i in paused:
            heat = 0.0 if last else cost.HEAT_STEPS * cost.SECONDS_PER_HEAT_ELEMENT
            time += cost.PAUSE_STEPS * step + heat * (before + own)
        times.append(time if closed or not last else 0.0)
    return times


def _file_bytes(impact: ImpactPlan, elements: int) -> float:
    """Bytes of the stored fields of an impact: steps at regular times, at the greatest deformation and at the end; or only the
    end."""
    every = max(impact.output_every, cost.CHUNK * impact.dt_expected)
    steps = impact.expected // every + 3.0 if math.isfinite(every) else 1.0
    places = impact.points + cost.VERTICES * impact.points ** (2.0 / 3.0)
    return steps * (cost.FILE_BYTES_PER_ELEMENT * elements + cost.FILE_BYTES_PER_POINT * places)
