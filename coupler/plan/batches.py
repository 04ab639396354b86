"""Batches: impacts that are computed side by side, each on its own cut of the target; they follow from the plan alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

LARGEST_BATCH = 12
GAP = 0.5  # diameters between two windows
# mean diameters between the axes of two impacts whose splats may come to lie on each other: none of 195 on a coating is wider than 1.7
MEET = 2.0
AHEAD = 96  # impacts back among which those of a batch are looked for


@dataclass(frozen=True)
class Landing:
    """Data of an impact on which batches depend. offset: of its axis, m; window: radius (m) within which the target is computed;
    diameter: of the particle, m; dwell: time until the next impact, s."""

    offset: tuple[float, float]
    window: float
    diameter: float
    dwell: float = 0.0


@dataclass(frozen=True)
class Batch:
    """Impacts first to stop - 1. cut: radius (m) of the largest of their cuts, inf where it is the whole target; pause: time (s) until
    the next batch in which heat flows, 0 without."""

    first: int
    stop: int
    cut: float
    pause: float

    @property
    def is_whole(self) -> bool:
        """Whether the cut is the whole target."""
        return math.isinf(self.cut)


def batches_of(impacts: Sequence[Landing], is_cooled: bool) -> tuple[Batch, ...]:
    """The batches of a plan, in the order of arrival, each up to an impact whose window is not apart. is_cooled: whether heat flows
    between impacts."""
    found, first = list[Batch](), 0
    while first < len(impacts):
        stop = first + 1
        while stop < len(impacts) and stop - first < LARGEST_BATCH and _apart(impacts[first:stop], impacts[stop]):
            stop += 1
        cut, before_last = max(i.window for i in impacts[first:stop]), impacts[first : min(stop, len(impacts) - 1)]
        found.append(Batch(first, stop, cut, sum((i.dwell for i in before_last), 0.0) if is_cooled else 0.0))
        first = stop
    return tuple(found)


def side_by_side(impacts: Sequence[Landing]) -> list[int]:
    """An order of impacts that makes large batches. An impact moves to a later batch if its window lies apart from the windows of that
    batch and its splat from the splats of all impacts in between: splats that may overlap keep their order. Batches are made from the
    last one back, each as large as can be: the pause after a batch costs the more the higher the coating is."""
    if not all(math.isfinite(impact.window) for impact in impacts):
        return list(range(len(impacts)))
    left, groups = list(range(len(impacts)))[::-1], list[list[int]]()
    while left:
        chosen, passed = left[:1], list[int]()
        for i in left[1:AHEAD]:
            alone = _apart([impacts[k] for k in chosen], impacts[i]) and not any(
                math.dist(impacts[k].offset, impacts[i].offset)
                <= 0.5 * MEET * (impacts[k].diameter + impacts[i].diameter)
                for k in passed
            )
            (chosen if alone and len(chosen) < LARGEST_BATCH else passed).append(i)
        groups.insert(0, sorted(chosen))
        left = passed + left[AHEAD:]
    order: list[int] = []
    for before, group in zip([[], *groups], groups, strict=False):
        # one that meets the group before it comes first: there a batch ends
        meets = [i for i in group if not _apart([impacts[k] for k in before], impacts[i])][:1]
        order += meets + [i for i in group if i not in meets]
    return order


def _apart(others: Sequence[Landing], new: Landing) -> bool:
    """Whether the window of an impact lies apart from the windows of others."""
    return math.isfinite(new.window) and all(
        math.dist(a.offset, new.offset) > a.window + new.window + GAP * max(a.diameter, new.diameter) for a in others
    )
