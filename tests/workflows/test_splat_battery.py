"""The battery of clouds writes what a conversion reports."""

import numpy as np
import splat_battery
from splat_clouds import D
from study_table import table_rows

from coupler.particle import packing
from coupler.splat.cloud import Cloud


def test_a_row_has_the_measures_of_the_conversion() -> None:
    x, volume = packing.sphere(D, 200)
    spacing = volume ** (1.0 / 3.0)
    cloud = Cloud(x, np.full(len(x), volume), spacing, 1.0, J=np.ones(len(x)))
    row = splat_battery.row_of("synthetic", cloud, splat_battery.SIZE_OVER_SPACING)
    assert set(row) <= set(table_rows("splats")[0])
    assert row["result"] == "meshed"
    assert row["bodies"] == 1
    assert row["gamma_min"] > 0.2  # of a ball by HXT; a sliver has 0
    assert abs(row["volume_before"]) < 0.2  # of 200 points: a surface half a spacing off is 25 %
