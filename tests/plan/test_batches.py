"""Batches of impacts that do not meet."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest
import scenes

from coupler import Scene
from coupler.plan.batches import LARGEST_BATCH, MEET, Landing, batches_of, side_by_side
from coupler.plan.planning import plan


def ranges_of(impacts: Sequence[Landing]) -> list[range]:
    """The numbers of the impacts of each batch."""
    return [range(each.first, each.stop) for each in batches_of(impacts, False)]


@pytest.mark.parametrize(
    ("offsets", "sizes"), [((-42, 42, -36), [2, 1]), ((-42, -36, 42), [1, 2]), ((0, 42, -36), [1, 2])]
)
def test_batches_lie_apart_and_keep_the_order_of_arrival(offsets: tuple[int, ...], sizes: list[int]) -> None:
    """Windows of 32 um and half a diameter between them: 74 um from centre to centre."""
    ranges = ranges_of(plan(Scene.from_text(scenes.three(*offsets), "x")).impacts)
    assert [len(r) for r in ranges] == sizes
    assert [i for r in ranges for i in r] == [0, 1, 2]


def test_impacts_pass_only_those_that_their_splats_do_not_meet() -> None:
    dice = np.random.default_rng(4)
    places = [Landing((x, y), 30e-6, 20e-6) for x, y in dice.uniform(-200e-6, 200e-6, (120, 2))]
    order = side_by_side(places)
    assert sorted(order) == list(range(120))
    rank = np.argsort(order)
    apart = np.array([[math.dist(a.offset, b.offset) for b in places] for a in places])
    meet, joined = apart <= MEET * 20e-6, apart <= 70e-6  # half a diameter between windows
    assert all(rank[i] < rank[k] for k in range(120) for i in range(k) if meet[i][k])
    longest = np.ones(120, int)  # chain of impacts that ends with each, whose windows overlap one after the other
    for k in range(120):
        longest[k] += max((longest[i] for i in range(k) if joined[i][k]), default=0)
    ordered = [places[i] for i in order]
    ranges = ranges_of(ordered)
    # an order that only windows decide has as many batches as the longest chain
    assert len(ranges) < 0.9 * longest.max() < 0.9 * len(ranges_of(places))
    for now, then in itertools.pairwise(ranges):  # none can be put off to the next batch, but where that is full
        assert len(then) == LARGEST_BATCH or all(any(joined[order[i]][order[k]] for k in then) for i in now)
    everywhere = [Landing(p.offset, math.inf, p.diameter) for p in places]
    assert side_by_side(everywhere) == list(range(120))
