"""Runs on several ranks: the same numbers as in one process, and one message when a rank fails."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from coupler import Scene, run
from coupler.errors import PlacementError
from coupler.ranks.ranks import Ranks, arrange

MPIEXEC = Path(sys.executable).parent / "mpiexec"
NI = """
[particle]
material = "Ni"
diameter = "25 um"
velocity = "500 m/s"
[substrate]
material = "SS304"
diameter = "120 um"
height = "60 um"
[resolution]
spacing = "3 um"
element_size = "4.5 um"
"""
MEASURES = ("flattening_ratio", "flattening_ratio_total", "crater_depth_m", "splat_diameter_m")
OF_THE_MACHINE = {"wall_s", "wall_loop_s", "placement", "ranks", "idle_share", "memory_peak_bytes"}


def start(ranks: int, *arguments: str, code: str | None = None) -> subprocess.Popen[str]:
    program = [sys.executable, "-c", code] if code else [sys.executable, "-m", "coupler"]
    return subprocess.Popen(
        [str(MPIEXEC), "-n", str(ranks), *program, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen[str], timeout: float = 240) -> tuple[int, str, str]:
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, out, err


def numbers(summary: dict[str, Any], prefix: str = "") -> dict[str, float]:
    found: dict[str, float] = {}
    for name, value in summary.items():
        if isinstance(value, dict):
            found |= numbers(value, f"{prefix}{name}.")
        elif isinstance(value, (int, float)) and name not in OF_THE_MACHINE:
            found[prefix + name] = float(value)
    return found


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "tiny.toml"
    path.write_text(NI)
    return path


@pytest.fixture(scope="module")
def alone(scene: Path) -> dict[str, Any]:
    return run(Scene.load(scene), scene.parent / "alone").summary


def test_two_ranks_give_the_same_summary(scene: Path, alone: dict[str, Any], tmp_path: Path) -> None:
    code, out, err = finish(start(2, "run", str(scene), "--out", str(tmp_path / "two")))
    assert code == 0, err
    assert out.count("results in") == 1  # one rank speaks
    two = json.loads((tmp_path / "two" / "summary.json").read_text())
    assert (two["ranks"], two["placement"], len(two["idle_share"])) == (2, "split", 2)
    expected, got = numbers(alone), numbers(two)
    assert got.keys() == expected.keys()
    assert {k: v for k, v in got.items() if v != pytest.approx(expected[k], rel=1e-10, abs=1e-25)} == {}
    history = (tmp_path / "two" / "history.csv").read_text().splitlines()
    assert history == (scene.parent / "alone" / "history.csv").read_text().splitlines()


@pytest.mark.parametrize(("ranks", "placement"), [(2, "spread"), (3, "split"), (3, "spread")])
def test_a_particle_on_several_ranks(
    scene: Path, alone: dict[str, Any], tmp_path: Path, ranks: int, placement: str
) -> None:
    code, _, err = finish(start(ranks, "run", str(scene), "--out", str(tmp_path), "--quiet", "--placement", placement))
    assert code == 0, err
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["placement"] == placement
    for name in MEASURES:
        assert summary[name] == pytest.approx(alone[name], rel=1e-6), name
    for name, share in alone["energies"].items():
        # yield at the margin amplifies rounding: the elastic and plastic shares of the target trade 1e-6 of the whole
        assert summary["energies"][name] == pytest.approx(share, abs=3e-6), name


def test_a_script_of_ones_own(tmp_path: Path) -> None:
    program = Path(__file__).parents[1] / "workflows" / "two_ranks.py"
    command = [str(MPIEXEC), "-n", "2", sys.executable, str(program), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    assert "probe:" in done.stdout
    assert done.stdout.count("flattening") == 1


# patch one rank, then run the command line as it is
PATCHED = """
import sys
from mpi4py import MPI
from coupler import cli
from coupler.errors import SolverError
if MPI.COMM_WORLD.rank == {rank}:
    {patch}
sys.exit(cli.main(sys.argv[1:]))
"""
LAW_FAILS = """
    from coupler.sph.machdyn import MachdynParticle as Particle
    good = Particle._update_stress
    def bad(self):
        good(self)
        if self.steps > 40:
            raise {error}
    Particle._update_stress = bad
"""
TARGET_FAILS = """
    from coupler.fe.explicit import Target
    good = Target.advance
    def bad(self, dt):
        good(self, dt)
        if self.time > 8e-9:
            raise {error}
    Target.advance = bad
"""


@pytest.mark.parametrize(
    ("rank", "patch", "error", "code", "message"),
    [
        (0, LAW_FAILS, 'SolverError("point 7 is gone")', 3, "point 7 is gone"),
        (1, TARGET_FAILS, 'SolverError("element 5 inverted")', 3, "element 5 inverted"),
        (0, LAW_FAILS, "ZeroDivisionError('odd')", None, "ZeroDivisionError: odd"),
        (1, TARGET_FAILS, "ZeroDivisionError('odd')", None, "ZeroDivisionError: odd"),
    ],
)
def test_a_rank_that_raises_ends_all(
    scene: Path, tmp_path: Path, rank: int, patch: str, error: str, code: int | None, message: str
) -> None:
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


@pytest.mark.parametrize("victim", [0, 1])
def test_a_rank_that_dies_takes_the_others_along(scene: Path, tmp_path: Path, victim: int) -> None:
    program = PATCHED.format(
        rank=victim, patch=f"import os; open(r'{tmp_path / 'pid'}', 'w').write(str(os.getpid()) + '\\n')"
    )
    started = start(2, "run", str(scene), "--out", str(tmp_path / "out"), code=program)
    history = tmp_path / "out" / "history.csv"
    deadline = time.monotonic() + 120
    while not (history.exists() and history.stat().st_size > 500) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)
    killed = time.monotonic()
    code, out, _ = finish(started, timeout=60)
    assert time.monotonic() - killed < 5.0
    assert code != 0
    assert "Killed (signal 9)" in out  # MPI's own launcher says it


def test_user_errors_are_said_once(tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text(NI.replace('"500 m/s"', '"fast"'))
    code, _, err = finish(start(2, "run", str(bad)))
    assert code == 2
    assert err.count("particle.velocity") == 1
    assert "Traceback" not in err


def test_a_placement_needs_ranks_and_a_name_that_is_known() -> None:
    assert arrange(None, None) == Ranks()
    with pytest.raises(PlacementError, match="mpiexec"):
        arrange(None, "spread")
    with pytest.raises(PlacementError, match="split or spread"):
        arrange(None, "sideways")
