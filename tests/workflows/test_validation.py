"""The comparison with the paper (workflows/validate.py): its arithmetic and its scenes."""

import re

import numpy as np
import pytest
import validate
import validation_page
from pages import scene_file

from coupler.errors import SceneError


def splats(method: str) -> list[validation_page.Splat]:
    """The seven particles as if we had computed the paper's numbers, by one of its methods."""
    rows = [
        {
            "run": letter, "impact": str(k + 1), "failed": "", "thickness_um_end": "1",
            "flattening_end": str(case["flattening"][method][k]), "widest_um_end": str(case["diameter_over_thickness"][method][k]),
        }
        for letter, case in validation_page.PAPER["case"].items()
        for k in range(len(case["impacts"]))
    ]  # fmt: skip
    return validation_page.seven(rows)


def test_the_papers_own_errors_come_out() -> None:
    """Its text says 0.10 and 0.09 for flattening; mean |ln(ratio / experiment)| of its hybrid is 0.266, from the ratios of its text."""
    whole, without = validation_page.errors(splats("experiment")).values()
    assert whole == ["0.000/0.00", "0.101/0.27", "0.086/0.24"]
    assert without == ["0.000/0.00", "0.082/0.25", "0.082/0.16"]
    assert next(iter(validation_page.errors(splats("hybrid")).values()))[0] == "0.101/0.27"


def test_the_largest_diameter_is_that_of_the_outline() -> None:
    turned = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0.1, 6.3, 200)]) * [4e-6, 2e-6, 1.0]
    assert validate.widest(turned) == pytest.approx(8e-6, rel=1e-3)
    assert validate.widest(np.vstack([turned, turned * 0.5 + [0, 0, 1e-6]])) == pytest.approx(8e-6, rel=1e-3)


def test_every_run_has_a_name_of_its_own_and_a_scene_that_holds() -> None:
    parts = (validate.cases, validate.pairs, validate.spread, validate.trends, validate.shapes, validate.scatter)
    wanted = [case for part in parts for case in part()]
    assert len({name for name, _ in wanted}) == len(wanted)
    for name, scene in wanted:  # names of trends and pairs tell the temperature of the particles, others are at 300 K
        told = re.search(r"-(\d+)K$", name)
        assert {p.temperature for p in scene.particles} == {float(told[1]) if told else 300.0}
    with pytest.raises(SceneError, match="colour"):
        scene_file("single_ni", particle={"colour": "red"})
