"""The cheapest settings for an accuracy: a grid of points, elements and contact stiffness over the cases of the accuracy page.

    python workflows/presets.py             # docs/tables/presets.csv, its figure and its part of the accuracy page
    python workflows/presets.py --docs      # runs nothing: from the table that exists

The limits are those of the ladders (`workflows/accuracy.py`). Rows in the table are not computed again.
"""

from accuracy import STUDIES
from pages import ROOT, options, study_table

from coupler.studies import ladder, ladder_runs

POINTS = (300, 500, 700, 1000, 1400, 2000, 3500, 5000)
ELEMENTS = (1.2, 1.45, 1.7, 2.1)  # smallest edge of the target's elements over the spacing
STIFFNESS = (1.0, 3.0)
MOST = {"ni500": 5000, "ti500": 5000, "ni1000": 2000, "al725": 1400, "triple": 2000}  # points


def settings(case: str) -> list[ladder.LadderPoint]:
    """The grid of one case, the cheap settings first."""
    return [
        ladder.LadderPoint(case, f"e{element:g} k{k:g}", n, element, None, {"contact_stiffness": k})
        for n in POINTS
        for element in ELEMENTS
        for k in STIFFNESS
        if n <= MOST[case]
    ]


def compute(only: list[str]) -> None:
    """Compute the settings that the table lacks."""
    table = study_table("presets", ladder.COLUMNS, ladder.KEY, "python workflows/presets.py")
    for case in only:
        ladder_runs.compute_missing(STUDIES[case].load(), ROOT / "runs" / "presets", settings(case), table, print)


if __name__ == "__main__":
    a = options(__doc__, "docs", only=list(STUDIES))
    if not a.docs:
        compute(a.only)
