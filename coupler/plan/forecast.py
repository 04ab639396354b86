"""What a plan is expected to cost: steps, wall time on one core, memory, files; the constants are those of `cost`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from . import cost
from .model import ImpactPlan, Plan


@dataclass(frozen=True)
class Forecast:
    """A number for each impact. steps: of its time loop; met: elements of all bodies before it, substrate and splats; computed: the
    elements among these in its sub-domain; looped, between: wall time of its steps and of the work after it, s.

    whole: wall time, s; memory, files: bytes; target_load: cost of the target and the contact over that of the particles.
    """

    steps: tuple[int, ...]
    met: tuple[int, ...]
    computed: tuple[int, ...]
    looped: tuple[float, ...]
    between: tuple[float, ...]
    whole: float
    memory: float
    files: float
    target_load: float

    @property
    def shares(self) -> list[tuple[float, float]]:
        """Shares of the wall time for each impact: before it, and of its own steps, without the work after it."""
        ends = list(accumulate(map(sum, zip(self.looped, self.between, strict=True))))
        whole = ends[-1] + cost.SECONDS_PER_RUN
        return [(begin / whole, own / whole) for begin, own in zip([0.0, *ends], self.looped, strict=False)]


def forecast(plan: Plan) -> Forecast:
    """The expected cost of a plan."""
    impacts, engine = plan.impacts, plan.engine
    met = list(accumulate((i.splat_elements for i in impacts[:-1]), initial=plan.target.elements_estimate))
    computed = [_computed(plan, impact, elements) for impact, elements in zip(impacts, met, strict=True)]
    steps = [math.ceil(i.expected / i.dt_expected) for i in impacts]
    points = [i.points for i in impacts]
    each = list(zip(steps, points, computed, strict=True))
    looped, between = [cost.step_time(*impact, engine) for impact in each], _between(plan, met)
    weights = [n * p for n, p, _ in each]  # as the particle's cost goes
    loads = [cost.target_load(p, elements, engine) for _, p, elements in each]
    return Forecast(
        steps=tuple(steps),
        met=tuple(met),
        computed=tuple(computed),
        looped=tuple(looped),
        between=tuple(between),
        whole=sum(looped) + sum(between) + cost.run_time(plan.target.elements_estimate),
        memory=cost.memory(max(points), met[-1]),
        files=sum(_file_bytes(impact, elements) for impact, elements in zip(impacts, met, strict=True)),
        target_load=sum(w * load for w, load in zip(weights, loads, strict=True)) / sum(weights),
    )


def _computed(plan: Plan, impact: ImpactPlan, met: int) -> int:
    """Elements that an impact is computed on: within its window, of the splats by its share of the area they lie on."""
    target, w = plan.target, impact.window
    if math.isinf(w):
        return met
    share = min((w / (target.spread + target.refined_radius)) ** 2, 1.0)
    within = cost.elements(2.0 * w, min(w, target.height), target.element_size, target.refined_radius, target.growth)
    return min(met, within + round(share * (met - target.elements_estimate)))


def _between(plan: Plan, met: Sequence[int]) -> list[float]:
    """Time after each impact, s: conversion of its splat and rest; a pause after the last of each batch; after the last impact that of
    the closing stage alone."""
    paused = {batch.stop - 1 for batch in plan.batches if plan.effects.cooling}
    closed, times = plan.ambient is not None, []
    for i, (before, impact) in enumerate(zip(met, plan.impacts, strict=True)):
        last, own = i == len(met) - 1, impact.splat_elements
        step = cost.SECONDS_PER_ELEMENT * (before + own)
        time = cost.JOIN_STEPS * step + (cost.SECONDS_PER_CONVERSION + cost.SECONDS_PER_SPLAT_ELEMENT * own) * (own > 0)
        if closed if last else i in paused:
            time += cost.PAUSE_STEPS * step + cost.HEAT_STEPS * cost.SECONDS_PER_HEAT_ELEMENT * (before + own) * (
                not last
            )
        times.append(time if closed or not last else 0.0)
    return times


def _file_bytes(impact: ImpactPlan, elements: int) -> float:
    """Bytes of the fields of an impact: a step now and then, at the greatest deformation and at the end, or at the end alone."""
    every = max(impact.output_every, cost.CHUNK * impact.dt_expected)
    steps = impact.expected // every + 3.0 if math.isfinite(every) else 1.0
    places = impact.points + cost.VERTICES * impact.points ** (2.0 / 3.0)
    return steps * (cost.FILE_BYTES_PER_ELEMENT * elements + cost.FILE_BYTES_PER_POINT * places)
