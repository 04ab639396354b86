"""Batches: impacts that are computed side by side, each on its own cut of the target, because their windows lie apart.

They follow from the plan alone, whatever the number of processes: so does the coating.
"""

import math
from collections.abc import Sequence

from .planning import ImpactPlan

LARGEST_BATCH = 8
GAP = 0.5  # diameters between two windows


def batch(impacts: Sequence[ImpactPlan], first: int) -> range:
    """The batch that begins with an impact: those after it in the order of arrival, up to one whose window is not apart."""
    last = first + 1
    while last < len(impacts) and last - first < LARGEST_BATCH and _apart(impacts[first:last], impacts[last]):
        last += 1
    return range(first, last)


def batches(impacts: Sequence[ImpactPlan]) -> list[range]:
    """All batches, in the order of arrival."""
    ranges: list[range] = []
    while not ranges or ranges[-1].stop < len(impacts):
        ranges.append(batch(impacts, ranges[-1].stop if ranges else 0))
    return ranges


def _apart(others: Sequence[ImpactPlan], new: ImpactPlan) -> bool:
    """Whether the window of an impact lies apart from those of others."""
    return math.isfinite(new.window) and all(
        math.dist(a.offset, new.offset) > a.window + new.window + GAP * max(a.diameter, new.diameter) for a in others
    )
