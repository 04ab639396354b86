"""Marks of trust follow from the comparisons of the page "How good is it?"."""

from pathlib import Path

import pytest

from coupler.physics import materials
from coupler.studies.trust import AMBER, GREEN, RED, mark, table

PAGE = Path(__file__).parents[2] / "docs" / "evidence" / "how_good.md"


def test_the_data_are_those_of_the_page() -> None:
    """Quantity, case and difference of each row; the velocities are in the cases and tables that the page names."""
    rows, quantity = [], ""
    for line in PAGE.read_text(encoding="utf-8").split("<!-- end of table -->")[0].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 5 and cells[0] not in ("quantity", "---"):
            quantity = cells[0].partition(":")[0].partition(",")[0] or quantity
            rows.append((quantity, cells[1], cells[4]))
    known = {name: cases for name, cases in table().items() if name != "kinds"}
    assert rows == [(name, case, row.apart) for name, cases in known.items() for case, row in cases.items()]
    assert {row.kind for cases in known.values() for row in cases.values()} <= set(table()["kinds"])


def test_the_kinds_name_metals_of_the_library() -> None:
    assert {metal for metals in table()["kinds"].values() for metal in metals} <= set(materials.names())


@pytest.mark.parametrize(
    ("quantities", "metal", "velocity", "base", "colour"),
    [
        (("critical velocity",), "OFHC_Cu", 600.0, "OFHC_Cu", GREEN),  # met: 564 of 568 m/s
        (("critical velocity",), "OFHC_Cu", 600.0, "Al", AMBER),  # measured on copper alone
        (("critical velocity",), "Ni", 600.0, "", RED),  # apart by 38 m/s
        (("critical velocity",), "Ta", 600.0, "", AMBER),  # one of two of other metals met
        (("stress",), "Al1100", 350.0, "", RED),  # apart at 388 m/s, no other is near
        (("flattening",), "Al1100", 600.0, "", AMBER),  # two of four met
        (("density",), "Al1100", 800.0, "", RED),  # all near it apart
        (("velocity at impact",), "OFHC_Cu", 660.0, "", RED),  # the one of copper is of 375 m/s, none of all is met
        (("critical velocity", "velocity at impact"), "OFHC_Cu", 600.0, "", RED),  # the worst of both
        ((), "Ni", 600.0, "", RED),
    ],
)
def test_the_mark_follows_from_the_table(
    quantities: tuple[str, ...], metal: str, velocity: float, base: str, colour: str
) -> None:
    assert mark(quantities, metal, velocity, base).colour == colour
