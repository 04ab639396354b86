"""Sizes of a powder: from quantiles, from sieves, from the classes of a sizer."""

from math import exp, log
from statistics import NormalDist

import numpy as np
import pytest

from coupler.spray.sizes import SIEVED, Sizes

NORMAL = NormalDist()


def test_a_log_normal_powder_comes_back_from_its_three_diameters() -> None:
    """ln D normal about ln 25 um with 0.4: every quantile follows from three of them, beyond these too."""
    known = [25e-6 * exp(0.4 * NORMAL.inv_cdf(u)) for u in (0.1, 0.5, 0.9)]
    powder = Sizes.of_diameters(*known)
    for u in (0.01, 0.25, 0.5, 0.7, 0.99):
        assert powder.diameter(u) == pytest.approx(25e-6 * exp(0.4 * NORMAL.inv_cdf(u)), rel=1e-12)


def test_a_range_of_sieves_has_the_same_share_on_either_side() -> None:
    powder = Sizes.of_diameters(15e-6, 45e-6)
    assert powder.diameter(SIEVED) == pytest.approx(15e-6)
    assert powder.diameter(1.0 - SIEVED) == pytest.approx(45e-6)
    assert powder.diameter(0.5) == pytest.approx((15e-6 * 45e-6) ** 0.5)


def test_classes_give_back_the_distribution_that_they_were_cut_from() -> None:
    """Fifty classes of a log-normal powder: quantiles between the edges within 1e-3, because it is linear between them as drawn."""
    edges = np.geomspace(5e-6, 120e-6, 51)
    below = [NORMAL.cdf((log(D) - log(25e-6)) / 0.4) for D in edges]
    powder = Sizes.of_classes(edges.tolist(), (40.0 * np.diff(below)).tolist())
    for u in (0.1, 0.33, 0.5, 0.9):
        assert powder.diameter(u) == pytest.approx(25e-6 * exp(0.4 * NORMAL.inv_cdf(u)), rel=1e-3)


def test_one_class_is_no_distribution() -> None:
    with pytest.raises(ValueError, match="fewer than three size classes"):
        Sizes.of_classes([10e-6, 20e-6, 30e-6], [0.0, 100.0])
