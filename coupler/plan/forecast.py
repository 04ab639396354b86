"""What each impact of a plan is computed on, and what lies between impacts: for the expected cost."""

import itertools
import math
from collections.abc import Sequence
from typing import Protocol

from . import batches, cost


class Impact(batches.Impact, Protocol):
    """What the forecast depends on. splat_elements: tetrahedra of its splat, 0 where it rebounds; expected, output_every,
    dt_expected: s."""

    @property
    def splat_elements(self) -> int: ...
    @property
    def points(self) -> int: ...
    @property
    def expected(self) -> float: ...
    @property
    def output_every(self) -> float: ...
    @property
    def dt_expected(self) -> float: ...


class Sizes(Protocol):
    """Those of the target, m, as in `planning.TargetPlan`."""

    @property
    def height(self) -> float: ...
    @property
    def element_size(self) -> float: ...
    @property
    def spread(self) -> float: ...
    @property
    def refined_radius(self) -> float: ...
    @property
    def growth(self) -> float: ...
    @property
    def elements_estimate(self) -> int: ...


def elements_met(impacts: Sequence[Impact], target: Sizes) -> list[int]:
    """Elements of all bodies that each impact meets: of the substrate and of the splats before it."""
    return list(itertools.accumulate((i.splat_elements for i in impacts[:-1]), initial=target.elements_estimate))


def elements_computed(impacts: Sequence[Impact], target: Sizes) -> list[int]:
    """Elements that each impact is computed on: with a window those within it, the splats by its share of the area they lie on."""
    numbers = []
    for impact, met in zip(impacts, elements_met(impacts, target), strict=True):
        w = impact.window
        if math.isfinite(w):
            sizes = target.element_size, target.refined_radius, target.growth
            share = min((w / (target.spread + target.refined_radius)) ** 2, 1.0)
            within = cost.elements(2.0 * w, min(w, target.height), *sizes)
            met = min(met, within + round(share * (met - target.elements_estimate)))
        numbers.append(met)
    return numbers


def file_bytes(impacts: Sequence[Impact], target: Sizes) -> float:
    """Bytes of all fields that are written: of each impact a step now and then, at the greatest deformation and at the end, or at the
    end alone."""
    written = 0.0
    for impact, elements in zip(impacts, elements_met(impacts, target), strict=True):
        every = max(impact.output_every, cost.WINDOW * impact.dt_expected)
        steps = impact.expected // every + 3.0 if math.isfinite(every) else 1.0
        vertices = cost.VERTICES * impact.points ** (2.0 / 3.0)
        written += steps * (
            cost.FILE_BYTES_PER_ELEMENT * elements + cost.FILE_BYTES_PER_POINT * (impact.points + vertices)
        )
    return written


def time_between(impacts: Sequence[Impact], target: Sizes, cooled: bool, closed: bool) -> tuple[float, ...]:
    """Time after each impact on one core, s (`cost.between_impacts`): a pause follows the last of each batch."""
    paused = {batch[-1] for batch in batches.batches(impacts)} if cooled else set[int]()
    splats = [i.splat_elements for i in impacts]
    return cost.between_impacts(elements_met(impacts, target), splats, paused, closed)
