"""The fit of the order of convergence, and the tables that studies are kept in."""

from pathlib import Path

import numpy as np
import pytest

from coupler import __version__
from coupler.errors import StoreError
from coupler.studies.accuracy_fit import ORDERS, fit_order
from coupler.studies.table import StudyTable, other_version, read_rows

N = np.array([1000.0, 2000, 4000, 8000, 16000, 32000])
H = (N / N[0]) ** (-1 / 3)


@pytest.mark.parametrize("order", [0.75, 1.0, 1.5])
def test_an_exact_order_is_recovered(order: float) -> None:
    exact = 5.0 - 0.7 * H**order
    assert fit_order(H, exact)[0] == pytest.approx(order, abs=0.02)
    _, low, high = fit_order(H, exact + 2e-3 * np.array([1, -1, 0.5, -0.5, 1, -1]))
    assert low < order < high


def test_scatter_and_unbounded_growth_have_no_order() -> None:
    _, low, high = fit_order(H, 5.0 + 0.01 * np.array([1, -1, 1, -1, -1, 1]))
    assert (low, high) == (ORDERS[0], ORDERS[-1])
    assert fit_order(H, np.log(N))[1] == ORDERS[0]
    with pytest.raises(ValueError, match="at least 4 resolutions, not 3"):
        fit_order(H[:3], N[:3])


def test_a_study_keeps_its_rows_with_their_versions(tmp_path: Path) -> None:
    path = tmp_path / "docs" / "study.csv"
    table = StudyTable(path, ("case", "points", "value"), ("case", "points"), "remake: this test\ntwo lines")
    table.add({"case": "A", "points": 500, "value": 0.123456789})
    table.add({"case": "B", "points": 500, "value": None})
    assert path.read_text().startswith("# remake: this test\n# two lines\ncase,points,value,version\n")
    path.write_text(path.read_text().replace(f"0.123457,{__version__}", "0.123457,0.0.9"))
    table = StudyTable(path, ("case", "points", "value"), ("case", "points"), "remake: this test")
    assert ("A", "500") in table
    assert ("A", "1000") not in table
    assert [other_version(row) for row in table.rows] == ["0.0.9", ""]
    table.add({"case": "A", "points": 500, "value": 0.2})  # takes the place of the old one
    assert [(r["case"], r["value"], r["version"]) for r in read_rows(path)] == [
        ("A", "0.2", __version__),
        ("B", "", __version__),
    ]
    with pytest.raises(StoreError, match="has other columns"):
        StudyTable(path, ("case", "points"), ("case",), "")


@pytest.mark.parametrize(
    "path", sorted((Path(__file__).parents[2] / "docs" / "tables").glob("*.csv")), ids=lambda p: p.stem
)
def test_every_row_of_the_documents_names_its_version(path: Path) -> None:
    rows = read_rows(path)
    assert rows
    assert all(row["version"] for row in rows)
