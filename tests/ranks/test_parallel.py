"""Runs on several ranks: the same numbers as in one process, and one message when a rank fails."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from runs import MPIEXEC, SharedRuns, assert_same_files, assert_same_numbers, break_off, finish, start, summary_of
from scenes import NI, SHORT, SHORT_DOUBLE

from coupler import Result, Scene
from coupler.impact.retry import REMEDIES

MEASURES = ("flattening_ratio", "flattening_ratio_total", "crater_depth_m", "splat_diameter_m")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "tiny.toml"
    path.write_text(SHORT)
    return path


def assert_same_impact(alone: dict[str, Any], summary: dict[str, Any]) -> None:
    """Yield at the margin amplifies rounding: the elastic and plastic shares of the target trade 1e-6 of the whole."""
    for name in MEASURES:
        assert summary[name] == pytest.approx(alone[name], rel=1e-6), name
    for name, share in alone["energies"].items():
        assert summary["energies"][name] == pytest.approx(share, abs=3e-6), name


# On all ranks, one run after another: starting two processes costs more than these runs.
PROGRAM = """
import sys
from pathlib import Path
sys.path.append({tests!r})
from mpi4py import MPI
from coupler import Scene, report, run
from coupler.commands.main import main
from coupler.deposition.run import resume
from coupler.errors import SolverError
from coupler.impact import domains
from coupler.progress import Progress
from runs import SharedMeshes

report.section_picture = lambda result, file=None: None  # it costs as much as the run
domains.apart = SharedMeshes(Path({meshes!r}))  # so does gmsh
out, options = {out!r}, dict(progress=Progress(quiet=True))
short = Scene.from_text({short!r}, "shared")
"""
USUAL = """
assert main(["run", out + "/bad.toml"]) == 2
assert main(["run", out + "/short.toml", "--out", out + "/whole"]) == 0
resume(out + "/resumed", **options)
run(Scene.from_text({double!r}, "shared"), out + "/double", **options)
if MPI.COMM_WORLD.rank == 0:
    {fails}
assert main(["run", out + "/short.toml", "--out", out + "/failed", "--quiet"]) == 3
Path(out, "said all").touch()
if MPI.COMM_WORLD.rank == 1:
    {dies}
main(["run", out + "/short.toml", "--out", out + "/dead", "--quiet"])
"""
RARE = """
broken = []

def break_once(impact):
    if impact.time > 6e-9 and not broken:
        broken.append(impact.time)
        raise SolverError("made to fail")

run(short, out + "/retried", probe=break_once, **options)
run(Scene.from_text({enriched!r}, "shared"), out + "/enriched", numerics={inertia!r}, **options)
"""
INERTIA = {"inertia": 0.8}  # of all cells: see `particle.inertia`
ENRICHED = 'effects = ["auto", "+gradient_hardening"]\n' + SHORT.replace(
    "[resolution]", '[resolution]\nengine = "enriched"'
)


def run_on(ranks: int, runs: str, out: Path, of_all_workers: Path) -> tuple[int, str, str]:
    """These runs on ranks, in a folder: exit code, stdout and stderr."""
    program = (PROGRAM + runs).format(
        out=str(out), short=SHORT, double=SHORT_DOUBLE, enriched=ENRICHED, inertia=INERTIA,
        tests=str(Path(__file__).parents[1]), meshes=str(of_all_workers / "shared_meshes"),
        fails=LAW_FAILS.format(error='SolverError("point 7 is gone")').strip(), dies=RANK_DIES.strip(),
    )  # fmt: skip
    return finish(start(ranks, code=program))


@pytest.fixture(scope="module")
def on_two(of_all_workers: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene that is refused, three runs on two ranks: whole (by the command), resumed, double; one, failed, in which a rank
    raises an error of ours; and one, dead, in which a rank is killed. What they say is in `said`, what MPI says in `end`."""
    out = tmp_path_factory.mktemp("two")
    break_off(Scene.from_text(SHORT, "shared"), out / "resumed", 5e-9)
    (out / "short.toml").write_text(SHORT)
    (out / "bad.toml").write_text(SHORT.replace('"500 m/s"', '"fast"'))
    code, text, err = run_on(2, USUAL, out, of_all_workers)
    assert (out / "said all").exists(), err
    assert code != 0
    (out / "said").write_text(err)
    (out / "end").write_text(text)
    assert text.count("results in") == 1  # only the first rank writes to the terminal
    return out


@pytest.fixture(scope="module")
def on_three(of_all_workers: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs on three ranks, of which two share the particle: retried and enriched."""
    out = tmp_path_factory.mktemp("rare")
    code, _, err = run_on(3, RARE, out, of_all_workers)
    assert code == 0, err
    return out


def test_two_ranks_give_the_same_summary(on_two: Path, shared_run: SharedRuns) -> None:
    """One rank has the particle: sums are those of one process in the same order, equal to the last bit."""
    alone, two = shared_run(SHORT), Result(on_two / "whole")
    assert (two.ranks, len(two.idle_share)) == (2, 2)
    assert_same_numbers(alone.summary, two.summary, rel=0.0)
    assert_same_files(alone, two)


@pytest.mark.slow
def test_residuals_of_points_on_three_ranks(on_three: Path, shared_run: SharedRuns) -> None:
    """The enriched scheme: forces of residuals and gradients at the rim come from the rank of the point, inertia of cells from all,
    plastic strain, whose gradients harden the metal, from the ranks of the neighbours."""
    assert_same_impact(shared_run(ENRICHED, numerics=INERTIA).values, Result(on_three / "enriched").values)


def test_a_run_of_one_process_goes_on_on_two_ranks(on_two: Path, shared_run: SharedRuns) -> None:
    alone, resumed = shared_run(SHORT), Result(on_two / "resumed")
    assert resumed.ranks == 2
    assert_same_numbers(alone.summary, resumed.summary, rel=1e-9)
    assert_same_files(alone, resumed)


@pytest.mark.slow
def test_ranks_go_back_together(on_three: Path, shared_run: SharedRuns) -> None:
    """Against the scheme of the retry: half the step changes the splat by the error of time integration, far below 1 %."""
    summary, alone = Result(on_three / "retried").values, shared_run(SHORT, numerics=REMEDIES[0].numerics).values
    (retry,) = summary["retries"]
    assert retry["time_s"] > 6e-9
    assert summary["ranks"] == 3
    assert summary["steps"] > alone["steps"]
    assert summary["flattening_ratio"] == pytest.approx(alone["flattening_ratio"], rel=0.01)


def test_a_sequence_on_two_ranks(on_two: Path, shared_run: SharedRuns) -> None:
    assert_same_numbers(shared_run(SHORT_DOUBLE).summary, summary_of(on_two / "double"), rel=1e-9)


def test_errors_on_two_ranks_are_said_once(on_two: Path) -> None:
    """What the user did wrong, and a domain that fails on one rank."""
    said = (on_two / "said").read_text()
    assert said.count("particle.velocity") == 1
    assert said.count("point 7 is gone") == 1
    assert "Traceback" not in said
    assert not (on_two / "failed" / "summary.json").exists()


@pytest.mark.slow
def test_a_whole_impact_on_three_ranks(shared_run: SharedRuns, tmp_path: Path) -> None:
    (tmp_path / "ni.toml").write_text(NI)
    arguments = ["run", str(tmp_path / "ni.toml"), "--out", str(tmp_path / "out"), "--quiet"]
    code, _, err = finish(start(3, *arguments))
    assert code == 0, err
    assert_same_impact(shared_run(NI).values, Result(tmp_path / "out").values)


PROBED = """
import sys
from coupler import Scene, run
from coupler.errors import is_first_rank
lowest = []
def probe(impact):
    lowest.append(impact.surface.positions(impact.particle.x)[:, 2].min())
result = run(Scene.from_text({scene!r}, "probed"), {out!r}, probe=probe, quiet=True)
if lowest:
    print("probe", min(lowest) < 0.0)
if is_first_rank():
    print("crater", result.crater_depth_m > 0.0)
"""


@pytest.mark.slow
def test_a_script_with_a_probe(tmp_path: Path) -> None:
    """One rank calls the probe (docs/guide/scripting.md), one prints."""
    program = PROBED.format(scene=SHORT, out=str(tmp_path / "run"))
    command = [str(MPIEXEC), "-n", "2", sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    assert sorted(done.stdout.splitlines()) == ["crater True", "probe True"]


# patch one rank, then run the command line as it is
PATCHED = """
import sys
from mpi4py import MPI
from coupler.commands import main as cli
from coupler.errors import SolverError
if MPI.COMM_WORLD.rank == {rank}:
    {patch}
sys.exit(cli.main(sys.argv[1:]))
"""
LAW_FAILS = """
    from coupler.particle.compiled import CompiledParticle as Particle
    good = Particle._update_stress
    def bad(self):
        good(self)
        if self.steps > 20:
            raise {error}
    Particle._update_stress = bad
"""
TARGET_FAILS = """
    from coupler.fe.explicit import Target
    good = Target.advance
    def bad(self, dt):
        good(self, dt)
        if self.time > 4e-9:
            raise {error}
    Target.advance = bad
"""


RANK_DIES = """
    import os, signal
    from coupler.fe.explicit import Target
    good = Target.advance
    def bad(self, dt):
        good(self, dt)
        if self.time > 1e-9:
            os.kill(os.getpid(), signal.SIGKILL)
    Target.advance = bad
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rank", "patch", "error", "code", "message"),
    [
        (1, TARGET_FAILS, 'SolverError("element 5 inverted")', 3, "element 5 inverted"),
        (0, LAW_FAILS, "ZeroDivisionError('odd')", None, "ZeroDivisionError: odd"),
        (1, TARGET_FAILS, "ZeroDivisionError('odd')", None, "ZeroDivisionError: odd"),
    ],
)
def test_a_rank_that_raises_ends_all(
    scene: Path, tmp_path: Path, rank: int, patch: str, error: str, code: int | None, message: str
) -> None:
    """An error of ours is one message and its exit code; an unforeseen one ends all ranks with its traceback."""
    program = PATCHED.format(rank=rank, patch=patch.format(error=error).strip())
    started = start(2, "run", str(scene), "--out", str(tmp_path / "out"), "--quiet", code=program)
    got, _, err = finish(started, timeout=120)
    assert got != 0
    if code is not None:
        assert got == code
        assert err.count(message) == 1
        assert "Traceback" not in err
    assert message in err
    assert not (tmp_path / "out" / "summary.json").exists()


@pytest.mark.slow
def test_a_point_that_fails_on_one_rank_leaves_no_other_waiting(tmp_path: Path) -> None:
    """Ranks that share the particle exchange between the passes of each step: the one that fails goes on with that."""
    patch = """
    from coupler.particle import compiled_kernels, enriched_kernels  # that of the retry, and that of the first attempt
    def failing(good, calls):
        def bad(team, n, failed, of_points):
            calls.append(good(team, n, failed, of_points))
            if len(calls) > 20:
                failed[0] = 3
        return bad
    for k in (compiled_kernels, enriched_kernels):
        k.stress_of_all = failing(k.stress_of_all, [])
"""
    scene = tmp_path / "short.toml"
    scene.write_text(SHORT)
    arguments = ("run", str(scene), "--out", str(tmp_path / "out"), "--quiet")
    code, _, err = finish(start(3, *arguments, code=PATCHED.format(rank=1, patch=patch.strip())), timeout=120)
    assert code == 3
    assert "its volume ratio is outside the range 0.2 to 2" in err


def test_a_rank_that_dies_takes_the_others_along(on_two: Path) -> None:
    """A rank that waits for the dead one would wait for ever."""
    assert "Killed (signal 9)" in (on_two / "end").read_text()  # MPI's own launcher says it
    assert (on_two / "dead" / "scene.toml").exists()
    assert not (on_two / "dead" / "summary.json").exists()


@pytest.mark.slow
def test_a_rank_that_dies_from_outside_takes_the_others_along(tmp_path: Path) -> None:
    """The rank without the target, in a whole run."""
    scene = tmp_path / "ni.toml"
    scene.write_text(NI)
    program = PATCHED.format(
        rank=0, patch=f"import os; open(r'{tmp_path / 'pid'}', 'w').write(str(os.getpid()) + '\\n')"
    )
    started = start(2, "run", str(scene), "--out", str(tmp_path / "out"), code=program)
    history = tmp_path / "out" / "history.csv"
    deadline = time.monotonic() + 120
    while not (history.exists() and history.stat().st_size > 500):
        assert time.monotonic() < deadline, "the run did not begin"
        time.sleep(0.02)
    os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)
    code, out, _ = finish(started, timeout=60)
    assert code != 0
    assert "Killed (signal 9)" in out
    assert not (tmp_path / "out" / "summary.json").exists()
