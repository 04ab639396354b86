"""The tables of studies."""

from pathlib import Path

import pytest
from study_table import StudyTable, read_rows

from coupler import __version__
from coupler.errors import StoreError


def test_a_study_keeps_its_rows_with_their_versions(tmp_path: Path) -> None:
    path = tmp_path / "docs" / "study.csv"
    table = StudyTable(path, ("case", "points"), "remake: this test\ntwo lines")
    table.add({"case": "A", "points": 500, "value": 0.123456789})
    table.add({"case": "B", "points": 500, "value": None})
    assert path.read_text().startswith("# remake: this test\n# two lines\ncase,points,value,version\n")
    path.write_text(path.read_text().replace(f"0.123457,{__version__}", "0.123457,0.0.9"))
    table = StudyTable(path, ("case", "points"), "remake: this test")
    assert ("A", "500") in table
    assert ("A", "1000") not in table
    assert [row["version"] for row in table.rows] == ["0.0.9", __version__]
    table.add({"case": "A", "points": 500, "value": 0.2})  # takes the place of the old one
    assert [(r["case"], r["value"], r["version"]) for r in read_rows(path)] == [
        ("A", "0.2", __version__),
        ("B", "", __version__),
    ]
    table.add({"case": "C", "points": 500, "failed": "a new column"})
    assert [row["failed"] for row in read_rows(path)] == ["", "", "a new column"]
    with pytest.raises(StoreError, match="has other columns"):
        StudyTable(path, ("metal",), "")


@pytest.mark.parametrize(
    "path", sorted((Path(__file__).parents[2] / "docs" / "tables").glob("*.csv")), ids=lambda p: p.stem
)
def test_every_row_of_the_documents_names_its_version(path: Path) -> None:
    rows = read_rows(path)
    assert rows
    assert all(row["version"] for row in rows)
