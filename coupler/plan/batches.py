"""Batches of impacts that are computed in parallel, each impact on its own sub-domain of the target. The batches follow only from the
plan."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

LARGEST_BATCH = 12
GAP = 0.5  # least distance between two windows, in diameters
# Distance of the axes of two impacts, in mean diameters, up to which their splats may overlap. The widest of 195 splats on a coating
# has 1.7 diameters.
MEET = 2.0
AHEAD = 96  # number of impacts that the search for a batch considers


@dataclass(frozen=True)
class Landing:
    """Data of an impact for the choice of batches. offset: position (x, y) of its axis, m; window: radius (m) within which the target
    is computed, inf for the whole target; diameter: diameter of the particle, m; dwell: time until the next impact, s; ends_pass:
    whether it is the last impact of a pass of the gun."""

    offset: tuple[float, float]
    window: float
    diameter: float
    dwell: float = 0.0
    ends_pass: bool = False


@dataclass(frozen=True)
class Batch:
    """The impacts with the indices first to stop - 1. cut: radius (m) of the largest of their sub-domains, inf for the full target;
    pause: time (s) of heat conduction until the next batch, 0 for none."""

    first: int
    stop: int
    cut: float
    pause: float

    @property
    def is_whole(self) -> bool:
        """Whether the impact of this batch is computed on the full target, not on a sub-domain."""
        return math.isinf(self.cut)


def batches_of(impacts: Sequence[Landing], is_cooled: bool) -> tuple[Batch, ...]:
    """The batches of a plan, in the order of the impacts. A batch ends with a pass of the gun, after LARGEST_BATCH impacts, and before
    an impact whose window is too close to another window of the batch. is_cooled: False makes all pauses 0."""
    found, first = list[Batch](), 0
    while first < len(impacts):
        stop = first + 1
        while stop < min(len(impacts), first + LARGEST_BATCH) and not impacts[stop - 1].ends_pass:
            if not _apart(impacts[first:stop], impacts[stop]):
                break
            stop += 1
        cut = max(i.window for i in impacts[first:stop])
        found.append(Batch(first, stop, cut, pause_of(impacts, first, stop) if is_cooled else 0.0))
        first = stop
    return tuple(found)


def pause_of(impacts: Sequence[Landing], first: int, stop: int) -> float:
    """Sum (s) of the pauses after the impacts first to stop - 1, without one after the last of all."""
    return sum((i.dwell for i in impacts[first : min(stop, len(impacts) - 1)]), 0.0)


def side_by_side(impacts: Sequence[Landing]) -> list[int]:
    """An order of the impacts that allows large batches, as indices of the impacts. The last batch is filled first: small
    batches are then early in the run, when a pause takes less computing time. An impact moves to a later batch if its window is far
    enough from the windows of this batch, and its splat cannot overlap the splats of the impacts that then come before it. Thus splats
    that may overlap keep their order. If a window is infinite, the order does not change."""
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
        # an impact too close to the group before comes first, so that a batch ends there
        meets = [i for i in group if not _apart([impacts[k] for k in before], impacts[i])][:1]
        order += meets + [i for i in group if i not in meets]
    return order


def _apart(others: Sequence[Landing], new: Landing) -> bool:
    """Whether the window of the impact `new` is far enough from the windows of other impacts."""
    return math.isfinite(new.window) and all(
        math.dist(a.offset, new.offset) > a.window + new.window + GAP * max(a.diameter, new.diameter) for a in others
    )
