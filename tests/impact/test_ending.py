"""When an impact is over, and what is said of one that is not."""

import contextlib
import io
import re
from pathlib import Path

import numpy as np
import pytest
from scenes import TINY, scene

from coupler import Result, Scene, run
from coupler.commands.main import main
from coupler.core.records import copied, put
from coupler.errors import StoreError
from coupler.impact.ending import EndCriterion
from coupler.studies import coating, runs_table
from coupler.studies import runs as study_runs

LIMITED = scene(("Ni", 25, 500), **TINY, more='[end]\nat = "rest"\ntime = "20 ns"\n')


def observed(ending, *instants):
    """The criterion after instants of (time in ns, sinking in m/s, force in N)."""
    for time, sinking, force in instants:
        ending.observe(time * 1e-9, sinking, force)
    return ending


def test_rest_needs_a_turn_and_a_silent_contact():
    ending = observed(
        EndCriterion(100e-9, "rest", 50e-9, 500.0), (1, 500.0, 0.0), (10, 200.0, 3.0), (30, -5.0, 1.0), (32, -30.0, 0.0)
    )
    assert not ending.reached(32e-9), "silent for 2 ns, 5 are asked"
    observed(ending, (36, -30.0, 0.0))
    assert ending.met(36e-9)
    assert ending.undecided(36e-9, -30.0) is None


def test_a_particle_that_glances_off_a_flank_has_left():
    """It sinks with less than 5 % of its energy, and touches nothing; one that falls faster, or still touches, has not."""
    for sinking, force, met in ((105.0, 0.0, True), (120.0, 0.0, False), (105.0, 1.0, False)):
        ending = observed(EndCriterion(200e-9, "rest", 50e-9, 500.0, 2.5), (10, 300.0, 3.0), (20, sinking, 3.0))
        observed(ending, *((time, sinking, force) for time in range(21, 60)))
        assert ending.met(59e-9) == met


def test_a_bonded_particle_is_at_rest_when_it_swings_little_for_a_period():
    """2 % of 500 m/s for half of D / v = 50 ns; one that is not bonded, or may come off, needs a silent contact."""
    swings = [(30, -20.0, 2.0), (40, 9.0, -1.0), (50, -8.0, 1.0), (56, 7.0, -1.0)]
    for grip in ("free", "failing", "held"):
        ending = EndCriterion(200e-9, "rest", 50e-9, 500.0)
        ending.observe(10e-9, 200.0, 3.0)
        for time, sinking, force in swings:
            ending.observe(time * 1e-9, sinking, force, grip)
        assert ending.met(56e-9) == (grip == "held")


def test_a_bonded_particle_that_rises_is_waited_for_and_one_that_is_stopped_is_not():
    still = [(20, 0.0, 1.0), (30, -9.0, 0.0), (56, -9.0, 0.0)]
    fast = [(20, 0.0, 1.0), (30, -40.0, 1.0), (56, 40.0, 1.0)]
    for swings, grip, met in (
        (still, "failing", False),
        (still, "free", True),
        (still, "held", False),
        (still, "secure", False),  # it still rises
        (fast, "held", True),  # stopped
        (fast, "secure", True),
    ):
        ending = EndCriterion(200e-9, "rest", 50e-9, 500.0)
        ending.observe(10e-9, 200.0, 3.0)
        for time, sinking, force in swings:
            ending.observe(time * 1e-9, sinking, force, grip)
        assert ending.met(56e-9) == met, grip


def test_a_time_limit_is_not_rest():
    ending = observed(EndCriterion(40e-9, "rest", 50e-9, 500.0), (10, 200.0, 3.0), (40, 138.0, 2.0))
    assert ending.reached(40e-9)
    assert not ending.met(40e-9)
    assert ending.undecided(40e-9, 138.0) == "not at rest at its time limit of 40 ns: the particle sinks at 138 m/s"


def test_a_particle_that_slides_over_the_rim_has_left_undecided():
    """Silent for more than a tenth of D / v beyond the rim; silent above the target it may still come down."""
    over, beside = EndCriterion(200e-9, "rest", 50e-9, 500.0), EndCriterion(200e-9, "rest", 50e-9, 500.0)
    for time, force, above in ((10, 3.0, True), (30, 1.0, False), (34, 0.0, False), (36, 0.0, False)):
        for ending, is_above in ((over, True), (beside, above)):
            ending.observe(time * 1e-9, 40.0, force, is_above=is_above)
    assert not over.reached(36e-9)
    assert beside.reached(36e-9)
    assert not beside.met(36e-9)
    assert beside.undecided(36e-9, 40.0) == (
        "not at rest when it slid over the rim of the target: increase substrate.diameter"
    )


def test_an_end_by_time_is_met_by_time():
    ending = observed(EndCriterion(40e-9, "time", 50e-9, 500.0), (40, 138.0, 2.0))
    assert ending.met(40e-9)
    assert ending.touched
    assert not ending.settled(40e-9)
    ending.extend(40e-9, None)
    assert ending.reached(40e-9)  # it is over: only a later time lets it go on
    ending.extend(40e-9, 90e-9)
    assert not ending.reached(80e-9)
    assert ending.reached(90e-9)


def test_an_end_that_was_moved_is_kept() -> None:
    """Stopped and gone on from, an impact that was given more time has the same end; another resumption does not move it."""
    ending = observed(EndCriterion(40e-9, "rest", 50e-9, 500.0), (40, 138.0, 2.0))
    ending.extend(40e-9, None)
    assert (ending.at, ending.end_time) == ("rest", pytest.approx(80e-9))
    again = EndCriterion(40e-9, "rest", 50e-9, 500.0)
    put(copied(ending), again)
    again.extend(60e-9, None)
    assert (again.at, again.end_time) == ("rest", pytest.approx(80e-9))
    settled = observed(EndCriterion(200e-9, "rest", 50e-9, 500.0), (10, 200.0, 3.0), (30, -5.0, 1.0), (60, -5.0, 0.0))
    assert settled.met(60e-9)
    settled.extend(60e-9, 90e-9)
    put(copied(settled), again)
    assert (again.at, again.end_time) == ("time", 90e-9)
    assert not again.reached(80e-9)


def test_an_end_at_the_greatest_deformation_writes_it_once_and_has_no_margin(tmp_path: Path) -> None:
    text = scene(("Ni", 25, 500)) + '[end]\nat = "greatest"\n'
    result = run(Scene.from_text(text, "greatest"), tmp_path, force=True, quiet=True)
    assert np.diff(result.times("target")).min() > 0.0
    assert result.impacts[0]["verdict"] == "undecided"
    assert result.impacts[0]["margin_m_s"] is None
    assert result.impacts[0]["margin_J"] is None


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """A run whose time limit comes before its greatest deformation: folder and exit code."""
    folder = tmp_path_factory.mktemp("limited")
    (folder / "limited.toml").write_text('effects = "all"\n' + LIMITED)
    with contextlib.redirect_stderr(io.StringIO()) as said:
        code = main(["run", str(folder / "limited.toml"), "--out", str(folder / "out"), "--quiet", "--threads", "1"])
    assert re.search(
        rf"sinks at \d+ m/s; continue with coldspray resume {re.escape(str(folder / 'out'))}\n$", said.getvalue()
    )
    return folder, code


def test_a_run_that_is_not_at_rest_is_undecided(limited, capsys):
    folder, code = limited
    result = Result(folder / "out")
    assert code == 4
    assert result.undecided.startswith("not at rest at its time limit of 20 ns")
    assert result.at_limit
    assert result.rebounded is None
    assert result.restitution is None
    assert result.deposition_efficiency is None
    assert result.end["flattening_ratio"] is None
    assert result.greatest is None
    assert result.refused["end.flattening_ratio"] == result.refused["rebound_velocity_m_s"] == result.undecided
    assert result.end["time_s"] >= 20e-9
    assert result.errors == {}
    assert main(["resume", str(folder / "out"), "--until", "15 ns"]) == 2
    assert "give a later time with --until" in capsys.readouterr().err
    assert Result(folder / "out").undecided, "a refused resumption changes nothing"


def test_an_undecided_run_goes_on_as_if_it_had_not_stopped(limited, tmp_path):
    """The limit changes neither the step nor the windows of steps, so that every digit is that of a run with a later limit."""
    folder, _ = limited
    later = tmp_path / "later.toml"
    later.write_text('effects = "all"\n' + LIMITED.replace("20 ns", "150 ns"))
    assert main(["run", str(later), "--out", str(tmp_path / "later"), "--quiet", "--threads", "1"]) == 0
    assert main(["resume", str(folder / "out"), "--until", "150 ns", "--quiet", "--threads", "1"]) == 0
    one, other = Result(folder / "out"), Result(tmp_path / "later")
    assert one.undecided is None
    for name in ("flattening_ratio", "crater_depth_m", "restitution", "energy_drift", "steps"):
        assert getattr(one, name) == getattr(other, name)
    np.testing.assert_array_equal(one.history("kinetic"), other.history("kinetic"))


def test_a_run_whose_verdict_is_undecided_at_its_end_goes_on_until_it_is_decided(tmp_path, capsys):
    """`end.time` alone is the end criterion: it is met in full contact."""
    file, out = tmp_path / "short.toml", str(tmp_path / "out")
    file.write_text(scene(("Ni", 25, 500), **TINY, end=10))
    assert main(["run", str(file), "--out", out, "--threads", "1"]) == 0
    hint = "".join(capsys.readouterr().out.split())
    assert "undecided" in hint
    assert f"coldsprayresume{''.join(out.split())}--untilTIME" in hint
    for quiet in ([], ["--quiet"]):
        assert main(["resume", out, *quiet]) == 0
        said = capsys.readouterr()
        (line,) = (said.err if quiet else said.out).splitlines()
        assert re.match(r"the run has met its end criterion \(10.* ns\), and its verdict is undecided; ", line)
        assert line.endswith(f"coldspray resume {out} --until TIME")
    assert Result(out).verdict == "undecided", "without a time it stays as it is"
    assert list((tmp_path / "out").glob("checkpoint-*")), "nothing is lost"
    with pytest.raises(SystemExit):
        main(["resume", "--help"])
    assert "required if it met its end criterion without a verdict" in " ".join(capsys.readouterr().out.split())
    assert main(["resume", out, "--quiet", "--threads", "1", "--until", "100 ns"]) == 0
    assert Result(out).verdict == "rebounds"
    assert Result(out).end["time_s"] == pytest.approx(100e-9)
    assert not list((tmp_path / "out").glob("checkpoint-*"))


def test_an_undecided_point_of_a_sweep_says_why_and_an_undecided_particle_has_not_stayed(tmp_path):
    folder = tmp_path
    (folder / "limited.toml").write_text(LIMITED.replace("20 ns", "5 ns"))
    ended = study_runs.compute(folder / "limited.toml")
    assert (ended["status"], ended["exit_code"]) == ("undecided", 4)
    assert str(ended["reason"]).startswith("undecided: not at rest at its time limit of 5 ns")
    (row,) = (row for row in runs_table.table(folder) if row["point"] == "limited")
    assert row["status"] == "undecided"
    with pytest.raises(StoreError, match="no impact is finished yet"):
        coating.read(Result(folder / "limited"))


@pytest.mark.slow
def test_a_particle_that_never_touches_is_an_error(tmp_path, capsys):
    """At 80 degrees the second particle starts above the first splat and leaves it sideways: the substrate is 115 ns away."""
    text = scene(("Ni", 25, 500), ("Ni", 25, 500), **TINY | {"diameter": 160}, end=12)
    text = text.replace('velocity = "500 m/s"\n', 'velocity = "500 m/s"\noffset = ["-10 um", "0 um"]\n', 1)
    head, tail = text.rsplit("[[particle]]", 1)
    tail = tail.replace(
        'velocity = "500 m/s"\n',
        'velocity = "500 m/s"\nangle = "80 deg"\ngap = "0.5 um"\noffset = ["8 um", "0 um"]\n',
        1,
    )
    (tmp_path / "past.toml").write_text(f"{head}[[particle]]{tail}")
    assert main(["run", str(tmp_path / "past.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 3
    assert "particle 2 has not touched the target" in capsys.readouterr().err
    assert not (tmp_path / "out" / "summary.json").exists()
    assert len(Result(tmp_path / "out").times()), "what was computed stays readable"


@pytest.mark.parametrize(("energy", "ends"), [(1.0, True), (0.0, False)])
def test_a_tied_particle_is_not_waited_for_once_it_hardly_deforms(energy: float, ends: bool) -> None:
    """The power of the deformation falls as exp(-t / 10 ns) and is 0.01 E v / D at 10 ln(500) = 62 ns; D / v = 50 ns, E = 1 J. The
    contact is never silent."""
    ending, over = EndCriterion(200e-9, "rest", 50e-9, 500.0, 2.5, energy), None
    for time in range(1, 80):
        work = 7.0 + 1.0 - np.exp(-time / 10.0)  # of earlier impacts too
        ending.observe(time * 1e-9, 300.0 - 10.0 * time, 1.0, work=work)
        if over is None and ending.met(time * 1e-9):
            over = time
    assert ending.turned == pytest.approx(30e-9)
    assert (over is not None) == ends
    assert over is None or 62 <= over <= 62 + 2 * 5  # the mean reaches back about 5 ns
