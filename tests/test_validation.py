"""The comparison with the paper (workflows/validate.py): its arithmetic and its scenes."""

import numpy as np
import pytest
import validate
import validation_figures
import validation_page

from coupler.geometry import mesher
from coupler.geometry.tetrahedra import boundary_faces
from coupler.plan.reading import Scene


def rows(method: str) -> list[dict[str, str]]:
    """Rows of the table with the paper's flattening (all readings) and ratio of diameter to thickness, by one of its methods."""
    return [
        {
            "run": letter, "impact": str(k + 1), "failed": "", "version": "0", "material": "Ni", "diameter_um": "1",
            "axial_um_end": str(1 - case["flattening"][method][k]), "thickness_um_end": "1",
            "widest_um_end": str(case["diameter_over_thickness"][method][k]),
        }
        | {f"{name}_{when}": str(case["flattening"][method][k])
           for name in ("flattening", "flattening_total") for when in ("end", "own")}
        for letter, case in validation_page.PAPER["case"].items()
        for k in range(len(case["impacts"]))
    ]  # fmt: skip


def test_the_papers_own_errors_come_out() -> None:
    lines = validation_page.errors(rows("experiment"))
    assert "7 particles" in lines[0]
    assert "| 0.101 |" in lines[2]
    assert "| 0.086 |" in lines[3]
    assert all("0.000" in line for line in lines[4:9])
    assert all("0.101" in line for line in validation_page.errors(rows("hybrid"))[4:9])


def test_the_papers_ratios_are_off_by_a_factor_of_e_to_027() -> None:
    """Mean |ln(ratio / experiment)| of the hybrid, from the ratios of its text: 0.266."""
    lines = validation_page.score(rows("hybrid"))
    assert "| 7 | 0.27 |" in lines[2]
    assert "| 7 | 0.27 |" in lines[4]
    assert "| 7 | 0.00 |" in validation_page.score(rows("experiment"))[4]


def test_the_bound_is_the_flattening_of_a_full_cylinder() -> None:
    """A sphere of 25 um pressed to a full cylinder of any thickness h has the flattening 1 - h / 25 um."""
    h = np.array([4.0, 12.0, 20.0])
    d = np.sqrt(2 / 3 * 25.0**3 / h)
    assert validation_page.bound(d / h) == pytest.approx(1 - h / 25.0)


def test_the_largest_diameter_is_that_of_the_outline() -> None:
    turned = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0.1, 6.3, 200)]) * [4e-6, 2e-6, 1.0]
    assert validate.widest(turned) == pytest.approx(8e-6, rel=1e-3)
    assert validate.widest(np.vstack([turned, turned * 0.5 + [0, 0, 1e-6]])) == pytest.approx(8e-6, rel=1e-3)


def test_ringing_is_heard_with_its_amplitude() -> None:
    time = np.linspace(0.0, 150.0, 400)
    y = 380 - 0.4 * time + 100 * np.sin(2 * np.pi * 0.050 * time)
    frequency, amplitude = validation_figures.ringing(time, y, 60.0, 150.0)
    assert frequency == pytest.approx(50.0, abs=1.0)
    assert amplitude == pytest.approx(100.0, rel=0.1)


def test_thickness_on_the_axis_of_a_block_of_tetrahedra() -> None:
    points, tets = mesher.box((20e-6, 20e-6, 6e-6), 3e-6)
    faces = boundary_faces(tets)[0]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # closed
    assert validate.axial(points, faces) == pytest.approx(6e-6, rel=1e-9)
    hollow = np.concatenate([faces, boundary_faces(tets)[0][:, ::-1] + len(points)])
    inside = points.mean(axis=0) + 0.5 * (points - points.mean(axis=0))
    assert validate.axial(np.concatenate([points, inside]), hollow) == pytest.approx(3e-6, rel=1e-9)


def test_every_run_has_a_name_of_its_own_and_a_scene_that_holds() -> None:
    parts = (validate.cases, validate.drafts, validate.spread, validate.trends, validate.shapes, validate.scatter)
    wanted = [case for part in parts for case in part()]
    assert len({case.name for case in wanted}) == len(wanted)
    for case in wanted:
        scene = Scene.from_text(case.text, case.name)
        first = scene.particles[0] if hasattr(scene, "particles") else scene.particle
        assert first.temperature == case.start
    with pytest.raises(SystemExit, match="no line colour"):
        validate.scene_of("single_ni", colour="red")
