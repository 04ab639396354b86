"""The command `coldspray track`: its files, and the sources of the deposition efficiency."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from sweeps import pretend

from coupler.commands.main import main
from coupler.studies.runs import write_scene
from coupler.studies.sweep import Sweep


def test_a_track_balances_its_mass_in_files_that_agree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """30 g/min of copper at 100 mm/s and the efficiency of its file: area x density x speed = feed x efficiency. A gun at 30 degrees
    with 0.6 from 20 to 40 degrees has 0.6 everywhere, because the slopes of a thin track are below 10 degrees."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", "track", "cu"]) == 0
    text = (tmp_path / "cu.toml").read_text()
    text = text.replace('# efficiency = "angles.csv" ', 'efficiency = "angles.csv" ').replace('"0 deg"', '"30 deg"')
    (tmp_path / "cu.toml").write_text(text)
    (tmp_path / "angles.csv").write_text("angle [deg];efficiency [%]\n0;90\n20;60\n40;60\n60;10\n")
    assert main(["track", "cu.toml"]) == 0
    assert "deposition efficiency 60.0%" in capsys.readouterr().out
    known = json.loads((tmp_path / "runs/track-cu/track.json").read_text())
    one, raster = known["one pass"], known["raster"]
    assert one["area_m2"] * 8960.0 * 0.1 == pytest.approx(0.6 * 30e-3 / 60.0, rel=1e-3)
    assert raster["area_m2"] == pytest.approx(6.0 * one["area_m2"], rel=1e-6)
    assert known["middle of the raster"][0]["thickness_m"] * 2e-3 == pytest.approx(one["area_m2"], rel=1e-3)
    lines = [
        line.split(",") for line in (tmp_path / "runs/track-cu/track.csv").read_text().splitlines() if line[0] != "#"
    ]
    heights = np.array([float(height) for profile, _, height in lines[1:] if profile == "one pass"])
    assert heights.max() == pytest.approx(one["height_m"], rel=1e-5)
    assert (tmp_path / "runs/track-cu/track.png").stat().st_size > 10_000


def test_runs_at_several_angles_give_the_efficiency_by_their_mass(tmp_path: Path) -> None:
    """Two sizes at 0 and 40 degrees: both stick at 0; of 10 and 20 um only the small one sticks at 40 degrees, 1/9 of the mass. At 90
    degrees nothing does."""
    from coupler.plan.job import from_text
    from coupler.scene.job import TrackData
    from coupler.studies.track import efficiency_of

    particle = {
        "material": ["Ni"],
        "diameter": ["10 um", "20 um"],
        "velocity": ["600 m/s"],
        "particle.angle": ["0 deg", "40 deg"],
    }
    whole = Sweep.from_dict({
        "name": "angles", "points": particle, "scene": {"preset": "draft", "substrate": {"material": "SS304"}}
    })  # fmt: skip
    for name, scene in whole.points.items():
        write_scene(tmp_path, name, scene)
        oblique, large = 'angle = "40 deg"' in scene, 'diameter = "20 um"' in scene
        pretend(tmp_path, name, "rebounds" if oblique and large else "sticks")
    template = Path(__file__).parents[2] / "coupler/commands/templates/track.toml"
    text = template.read_text().replace('# efficiency = "angles.csv"', f'efficiency = "{tmp_path}"')
    job = from_text(text, tmp_path / "track.toml", TrackData)
    angle, share = efficiency_of(job, job.data.spray, tmp_path)  # type: ignore[arg-type]
    assert angle == pytest.approx(np.radians([0.0, 40.0, 90.0]))
    assert share == pytest.approx([1.0, 1.0 / 9.0, 0.0])


def test_by_the_formula_only_the_normal_velocity_counts(tmp_path: Path) -> None:
    """The powder at 60 degrees from the normal has the efficiency that twice the critical velocity leaves."""
    from coupler.measures import STICKS
    from coupler.plan.job import read
    from coupler.scene.job import TrackData
    from coupler.studies.track import efficiency_of

    job = read(Path(__file__).parents[2] / "coupler/commands/templates/track.toml", TrackData)
    found = efficiency_of(job, job.data.spray, tmp_path)  # type: ignore[arg-type]
    for degrees in (0.0, 50.0, 60.0):
        share = job.arrived["Cu"].fates(1.0 / math.cos(math.radians(degrees)))[STICKS]
        assert np.interp(math.radians(degrees), *found) == pytest.approx(share, abs=1e-9)


def test_the_ceramic_of_a_blend_adds_nothing_to_a_track(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the formula. The area of one pass is that of the copper: 0.8 of the feed."""
    monkeypatch.chdir(tmp_path)
    text = (Path(__file__).parents[2] / "coupler/commands/templates/track.toml").read_text()
    ceramic = '[[powder]]\nmaterial = "Al2O3"\nshare = 0.2\nsizes = "15-45 um"\n\n[gas]'
    Path("blend.toml").write_text(text.replace("[powder]", "[[powder]]\nshare = 0.8").replace("[gas]", ceramic))
    assert main(["track", "blend.toml", "-q"]) == 0
    known = json.loads(Path("runs/track-blend/track.json").read_text())
    assert known["one pass"]["area_m2"] * 8960.0 * 0.1 == pytest.approx(0.8 * 30e-3 / 60.0, rel=2e-3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('step = "2 mm"', 'step = "-2 mm"', 'spray.step = "-2 mm" is outside 0.001 mm to 100 mm'),
        ('"gaussian"', '"spot.csv"', 'spray.distribution = "spot.csv": needs ascending radii and mass flows'),
        ('"gaussian"', '"none.csv"', 'spray.distribution = "none.csv": the file is missing'),
        ('# efficiency = "angles.csv"', 'efficiency = "bad.csv"', 'spray.efficiency = "bad.csv": needs ascending angles of 0 to 90'),
        ('# efficiency = "angles.csv"', 'efficiency = "none.csv"', 'spray.efficiency = "none.csv": the file is missing'),
        ('"0 deg"', '"80 deg"', "spray.efficiency: no powder sticks at 80 degrees from the normal"),
    ],
)  # fmt: skip
def test_a_fault_of_a_track_is_one_message_with_its_key(
    old: str,
    new: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "track", "cu"]) == 0
    path = tmp_path / "cu.toml"
    path.write_text(path.read_text().replace(old, new))
    (tmp_path / "spot.csv").write_text("r,flow\n0,1\n1,nan\n2,0\n")
    (tmp_path / "bad.csv").write_text("angle,efficiency\n0,1.2\n40,0.5\n")
    assert main(["track", "cu.toml", "-q"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n  - ") == 1
    assert f"  - {message}" in error
