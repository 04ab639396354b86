"""Batches: impacts that are computed side by side, each on its own cut of the target, because their windows lie apart.

They follow from the plan alone, whatever the number of processes: so does the coating. An impact without a window is a batch of one,
whose cut is the whole target.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

LARGEST_BATCH = 12
GAP = 0.5  # diameters between two windows
# mean diameters between the axes of two impacts whose splats may come to lie on each other: none of 195 on a coating is wider than 1.7
MEET = 2.0
AHEAD = 96  # impacts back among which those of a batch are looked for


class Impact(Protocol):
    """What batches depend on. offset: of its axis, m; window: radius (m) within which the target is computed; diameter: m."""

    @property
    def offset(self) -> tuple[float, float]: ...
    @property
    def window(self) -> float: ...
    @property
    def diameter(self) -> float: ...


@dataclass(frozen=True)
class Landing:
    """The least that is an `Impact`."""

    offset: tuple[float, float]
    window: float
    diameter: float


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


class Timed(Impact, Protocol):
    """dwell: time until the next impact, s."""

    @property
    def dwell(self) -> float: ...


def batches_of(impacts: Sequence[Timed], is_cooled: bool) -> tuple[Batch, ...]:
    """The batches of a plan. is_cooled: whether heat flows between impacts."""
    found = []
    for own in batches(impacts):
        dwell = sum((impacts[i].dwell for i in own if i + 1 < len(impacts)), 0.0)
        found.append(Batch(own.start, own.stop, max(impacts[i].window for i in own), dwell if is_cooled else 0.0))
    return tuple(found)


def batch(impacts: Sequence[Impact], first: int) -> range:
    """The batch that begins with an impact: those after it in the order of arrival, up to one whose window is not apart."""
    last = first + 1
    while last < len(impacts) and last - first < LARGEST_BATCH and _apart(impacts[first:last], impacts[last]):
        last += 1
    return range(first, last)


def batches(impacts: Sequence[Impact]) -> list[range]:
    """All batches, in the order of arrival."""
    ranges: list[range] = []
    while not ranges or ranges[-1].stop < len(impacts):
        ranges.append(batch(impacts, ranges[-1].stop if ranges else 0))
    return ranges


def side_by_side(impacts: Sequence[Impact]) -> list[int]:
    """An order of impacts that makes large batches: each is put off where its window lies apart from those that it joins and its splat
    from those of all that it passes, so that splats that may come to lie on each other arrive in the order they had.

    Batches are made from the last one back, each as large as can be: the pause after a batch costs the more the higher the coating is.
    """
    if not all(math.isfinite(impact.window) for impact in impacts):
        return list(range(len(impacts)))
    left, groups = list(range(len(impacts)))[::-1], list[list[int]]()
    while left:
        chosen, passed = left[:1], list[int]()
        for i in left[1:AHEAD]:
            alone = _apart([impacts[k] for k in chosen], impacts[i]) and not _meets(
                [impacts[k] for k in passed], impacts[i]
            )
            (chosen if alone and len(chosen) < LARGEST_BATCH else passed).append(i)
        groups.insert(0, sorted(chosen))
        left = passed + left[AHEAD:]
    order: list[int] = []
    for before, group in zip([[], *groups], groups, strict=False):
        # one that meets the group before it comes first: there `batch` ends
        meets = [i for i in group if not _apart([impacts[k] for k in before], impacts[i])][:1]
        order += meets + [i for i in group if i not in meets]
    return order


def _apart(others: Sequence[Impact], new: Impact) -> bool:
    """Whether the window of an impact lies apart from those of others."""
    return math.isfinite(new.window) and all(
        math.dist(a.offset, new.offset) > a.window + new.window + GAP * max(a.diameter, new.diameter) for a in others
    )


def _meets(others: Sequence[Impact], new: Impact) -> bool:
    """Whether the splat of an impact may come to lie on one of those of others."""
    return any(math.dist(a.offset, new.offset) <= MEET * 0.5 * (a.diameter + new.diameter) for a in others)
