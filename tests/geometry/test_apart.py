"""Calls in a process of their own: results and messages come back, and a process that hangs is killed."""

import signal
import subprocess
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mesher_that_fails import hangs

from coupler.errors import SplatError
from coupler.geometry import mesher
from coupler.geometry.apart import apart


def test_a_process_that_hangs_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    class Recorded(subprocess.Popen):
        def __init__(self, *arguments: object, **named: object) -> None:
            super().__init__(*arguments, **named)  # type: ignore[call-overload]
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Recorded)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    with pytest.raises(SplatError, match=r"did not finish within 0\.2 s: try another element size"):
        apart(partial(hangs), 0.2)
    assert [process.returncode for process in started] == [-signal.SIGKILL]


def test_files_of_the_working_folder_are_no_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "random.py").write_text("raise RuntimeError('imported')")
    monkeypatch.chdir(tmp_path)
    assert len(apart(partial(mesher.cylinder, 4.0, 2.0, 1.0, 1.0, 1.5), 60.0)[0]) > 10


def test_the_message_of_gmsh_is_passed_on() -> None:
    with pytest.raises(SplatError, match=r"the mesher failed: Exception: .*size"):
        apart(partial(mesher.cylinder, 0.0, 1.0, 0.1, 0.3, 0.5), 60.0)
    x, t = np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3]])
    with pytest.raises(SplatError, match=r"^gmsh"):
        apart(partial(mesher.fill, [(x, t)], 0.5), 60.0)


def test_a_mesh_is_the_same_as_in_this_process() -> None:
    sizes = 2.0, 1.0, 0.3, 0.3, 0.5
    for here, there in zip(mesher.cylinder(*sizes), apart(partial(mesher.cylinder, *sizes), 60.0), strict=True):
        assert (here == there).all()


def test_gmsh_leaves_broken_pipes_to_python() -> None:
    """gmsh sets SIGPIPE back to its default, which ends a process whose reader has gone, as ffmpeg may."""
    mesher.build(lambda gmsh: gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1) and gmsh.model.occ.synchronize())
    assert signal.getsignal(signal.SIGPIPE) is signal.SIG_IGN
    ignored = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("SigIgn"))
    assert int(ignored.split()[1], 16) & 1 << (signal.SIGPIPE - 1)
