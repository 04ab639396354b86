"""The table of all comparisons with laboratories."""

import how_good
import numpy as np
import pytest
from pages import EVIDENCE


@pytest.mark.parametrize(
    ("measured", "error", "computed", "own", "apart"),
    [
        (10.0, 3.0, 14.9, 4.0, 0.0),  # within the root of the sum of squares, 5
        (10.0, 3.0, 15.1, 4.0, 5.1),
        (10.0, np.nan, 13.0, 4.0, 0.0),  # an error that is not known does not count
        (10.0, np.nan, 5.0, 4.0, -5.0),
        (10.0, np.nan, 10.1, np.nan, 0.1),
    ],
)
def test_values_are_apart_beyond_their_known_errors(
    measured: float, error: float, computed: float, own: float, apart: float
) -> None:
    pair = how_good.Pair("stress, MPa", "a", measured, error, computed, own, 1, "")
    assert pair.apart == pytest.approx(apart)


def test_page_is_that_of_the_tables() -> None:
    """The page says what the tables of the studies say: `python workflows/how_good.py` was run after the last of them."""
    page = (EVIDENCE / "how_good.md").read_text(encoding="utf-8")
    assert "\n".join(how_good.table(how_good.pairs())) in page


def test_nozzles_of_the_flights_are_known() -> None:
    import flights

    assert {run["nozzle"] for run in flights.MEASURED["run"]} <= set(flights.nozzles())
