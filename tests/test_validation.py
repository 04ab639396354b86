"""The comparison with the paper (workflows/validate.py): its arithmetic and its scenes."""

import numpy as np
import pytest
import validate
import validation_figures
import validation_page

from coupler.geometry import mesher
from coupler.geometry.tetrahedra import boundary_faces
from coupler.plan.reading import Scene


def rows(flattening: dict[str, list[float]]) -> list[dict[str, str]]:
    """Rows of the table with nothing but a flattening, the same in all readings."""
    return [
        {"run": letter, "impact": str(k + 1), "failed": "", "diameter_um": "1", "axial_um_end": str(1 - value)}
        | {
            f"{name}_{when}": str(value)
            for name in ("flattening", "flattening_total")
            for when in ("end", "own", "greatest")
        }
        for letter, values in flattening.items()
        for k, value in enumerate(values)
    ]


def test_the_papers_own_errors_come_out() -> None:
    case = validation_page.PAPER["case"]
    as_experiment = rows({letter: entry["flattening"]["experiment"] for letter, entry in case.items()})
    lines = validation_page.errors(as_experiment)
    assert "7 particles" in lines[0]
    assert "| 0.101 |" in lines[2]
    assert "| 0.086 |" in lines[3]
    assert all("0.000" in line for line in lines[4:10])
    as_hybrid = rows({letter: entry["flattening"]["hybrid"] for letter, entry in case.items()})
    assert all("0.101" in line for line in validation_page.errors(as_hybrid)[4:10])


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
    parts = (validate.cases, validate.drafts, validate.spread, validate.trends, validate.shapes)
    wanted = [case for part in parts for case in part()]
    assert len({case.name for case in wanted}) == len(wanted)
    for case in wanted:
        scene = Scene.from_text(case.text, case.name)
        first = scene.particles[0] if hasattr(scene, "particles") else scene.particle
        assert first.temperature == case.start
    with pytest.raises(SystemExit, match="no line colour"):
        validate.scene_of("single_ni", colour="red")
