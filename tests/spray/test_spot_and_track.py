"""The spot of the spray, and the growth of the cross-sections of its tracks."""

import math
from pathlib import Path

import numpy as np
import pytest

from coupler.plan.passes import spot_of
from coupler.scene.spray import GunPath
from coupler.spray.spot import Spot
from coupler.spray.track import Gun, measures, waves

SIGMA = 1.5e-3  # m, of a spot of 6 mm
WIDTH = 2.0 * SIGMA * math.sqrt(2.0 * math.log(2.0))  # of a gaussian at half its height
AREA = 30e-3 / 60.0 / (8960.0 * 0.3)  # m2: 30 g/min of copper at 300 mm/s
RIGHT = 0.5 * math.pi
CONSTANT = np.array([0.0, RIGHT]), np.array([0.8, 0.8])
FALLS = np.radians([0, 10, 20, 30, 40, 50, 60, 70, 90]), np.array([0.9, 0.88, 0.8, 0.65, 0.4, 0.2, 0.05, 0, 0])


def spot(distribution: str) -> Spot:
    """A spot of 6 mm, of which a gaussian has four standard deviations."""
    return spot_of(GunPath.model_validate({"spot": "6 mm", "distribution": distribution}), Path())


def gaussian(x: np.ndarray) -> np.ndarray:
    """Density of the normal distribution, 1/m."""
    return np.exp(-0.5 * (x / SIGMA) ** 2) / (SIGMA * math.sqrt(2.0 * math.pi))


def test_spots_have_the_chords_and_the_quantiles_of_their_distributions() -> None:
    """The chord of a disc; the normal distribution, cut at four deviations and made of 400 rings, each an error of 3e-4 of the greatest
    value; a table of two points, a cone."""
    disc, x = spot("uniform"), np.array([0.0, 1e-3, 2.9e-3])
    assert disc.across(x) == pytest.approx(2.0 * np.sqrt(9e-6 - x**2) / (9e-6 * math.pi))
    assert disc.along(1e-3, np.array([0.0, 0.25, 1.0])) == pytest.approx(math.sqrt(8e-6) * np.array([-1.0, -0.5, 1.0]))
    round_one, x = spot("gaussian"), np.linspace(-3e-3, 3e-3, 13)
    assert round_one.across(x) == pytest.approx(gaussian(x), abs=5e-4 * gaussian(np.zeros(1))[0])
    assert round_one.along(1e-3, np.array([0.8413447])) == pytest.approx(SIGMA, rel=2e-3)
    table = Spot.of_points(np.array([0.0, 3e-3]), np.array([1.0, 0.0]))
    s, _, share = table.table
    assert share[[0, len(s) // 2, -1]] == pytest.approx([0.0, 0.5, 1.0], abs=1e-12)
    assert table.across(0.0) == pytest.approx(1.0 / (math.pi * 1e-3), rel=1e-4)  # 2 R / 2 over the volume pi R^2 / 3


def test_a_constant_efficiency_gives_gaussians_and_their_waviness() -> None:
    """A sum of gaussians a step p apart has the mean A / p, and by its first harmonic the waviness 4 exp(-2 (pi sigma / p)^2) of it."""
    gun = Gun(spot("gaussian"), 0.0, AREA, *CONSTANT)
    x, h = gun.spray([0.0])
    one = measures(x, h, AREA)
    assert h == pytest.approx(0.8 * AREA * gaussian(x), abs=1e-3 * one["height_m"])
    assert one["width_m"] == pytest.approx(WIDTH, rel=1e-3)
    rise, run = 0.6 * one["height_m"], SIGMA * (math.sqrt(2.0 * math.log(5.0)) - math.sqrt(2.0 * math.log(1.25)))
    for side in ("left", "right"):
        assert one[f"flank_{side}_rad"] == pytest.approx(math.atan(rise / run), rel=1e-3)
    for step in (2.0 * SIGMA, 2.5 * SIGMA, 3.0 * SIGMA):
        raster = waves(*gun.spray(step * np.arange(-4, 5)), step)
        assert raster["thickness_m"] == pytest.approx(0.8 * AREA / step, rel=1e-3)
        wave = 4.0 * math.exp(-2.0 * (math.pi * SIGMA / step) ** 2)
        assert raster["waviness_m"] / raster["thickness_m"] == pytest.approx(wave, rel=0.02)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 60.0])
def test_all_powder_hits_and_its_share_stays(degrees: float) -> None:
    """Deposited area x density x speed = feed x efficiency, at any angle of the gun, because a beam ends on a surface. The footprint of
    an inclined gun is 1 / cos(angle) wider."""
    gun = Gun(spot("gaussian"), math.radians(degrees), 40.0 * AREA, *CONSTANT)
    assert measures(*gun.spray([0.0]), gun.area)["efficiency"] == pytest.approx(0.8, rel=1e-3)
    thin = Gun(gun.spot, gun.angle, AREA, *CONSTANT)
    assert measures(*thin.spray([0.0]), AREA)["width_m"] == pytest.approx(WIDTH / math.cos(gun.angle), rel=2e-3)


def test_a_point_in_the_shadow_gets_nothing() -> None:
    """A step down of 0.5 mm, away from a gun at 60 degrees from the normal: its shadow is 0.5 mm x tan(60 deg) long. The powder that
    passes over the step lands beyond the shadow, and none is lost."""
    gun = Gun(spot("uniform"), math.radians(60.0), AREA, *CONSTANT)
    edges = np.linspace(-16e-3, 16e-3, 3201)
    x = 0.5 * (edges[1:] + edges[:-1])
    h = np.where(x < 0.0, 0.5e-3, 0.0)
    before = h.copy()
    part = gun.increment(edges, h, 0.0, 1e-3)
    grown = (h - before) / (part * AREA)
    dark = (x > 2e-5) & (x < 0.5e-3 * math.sqrt(3.0) - 2e-5)
    assert abs(grown[dark]).max() < 1e-12
    assert grown[x > 0.5e-3 * math.sqrt(3.0) + 2e-5][0] == pytest.approx(0.8 * gun.spot.across(0.4e-3) * 0.5, rel=0.05)
    assert grown.sum() * (edges[1] - edges[0]) == pytest.approx(0.8, rel=1e-6)


@pytest.mark.parametrize("degrees", [0.0, 20.0])
def test_a_track_with_an_efficiency_that_falls_with_the_angle_converges(degrees: float) -> None:
    """Twice the cells, half the change: the scheme is of first order. A track of 1.8 mm on 3.2 mm is nearly a triangle, whose tip is
    the least exact: 0.2 % at 200 cells. In the middle of a flat one a vertical gun has the efficiency of the normal."""
    gun = Gun(spot("gaussian"), math.radians(degrees), 40.0 * AREA, *FALLS)
    found = [measures(*gun.spray([0.0], cells), gun.area) for cells in (100, 200, 400)]
    for key in ("height_m", "width_m", "area_m2"):
        coarse, middle, fine = (each[key] for each in found)
        assert abs(fine - middle) < 0.7 * abs(middle - coarse)
        assert fine == pytest.approx(middle, rel=0.003)
    few, many = (gun.spray([0.0], 200, least)[1].max() for least in (20, 80))
    assert few == pytest.approx(many, rel=2e-3)
    flat = Gun(gun.spot, 0.0, 5.0 * AREA, *FALLS).spray([0.0])[1].max()
    assert flat == pytest.approx(0.9 * 5.0 * AREA * gaussian(np.zeros(1))[0], rel=2e-3)


def test_a_flank_away_from_the_gun_stops_at_the_angle_at_which_nothing_sticks() -> None:
    """Nothing sticks from 53 degrees on: behind a gun at 30 degrees no slope exceeds 23 degrees, at any width of the cells. A scheme
    that is not monotone grows columns there."""
    jump = np.radians([0.0, 52.0, 53.0, 90.0]), np.array([1.0, 1.0, 0.0, 0.0])
    gun = Gun(spot("gaussian"), math.radians(30.0), 40.0 * AREA, *jump)
    (x, h), (_, finer) = (gun.spray([0.0, 1.5e-3], cells) for cells in (20, 40))
    assert math.radians(22.0) < math.atan(-np.diff(h).min() / (x[1] - x[0])) < math.radians(23.0)
    assert finer.max() == pytest.approx(h.max(), rel=0.02)
