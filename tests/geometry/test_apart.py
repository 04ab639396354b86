"""Calls in a process of their own: results and messages come back, and a call that hangs is killed."""

import math
import os
import signal
import time
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from coupler.errors import SplatError
from coupler.geometry import mesher
from coupler.geometry.apart import apart, begin, end


def test_a_call_that_hangs_is_killed_and_the_next_one_succeeds() -> None:
    with pytest.raises(SplatError, match=r"did not finish within 0\.2 s: try another element size"):
        apart(partial(time.sleep, 600.0), 0.2)
    waiting = begin().pid
    assert not Path(f"/proc/{waiting}/task/{waiting}/children").read_text()
    assert apart(partial(math.hypot, 3.0, 4.0), 60.0) == 5.0
    assert begin().pid == waiting


def test_a_waiting_process_that_dies_is_replaced() -> None:
    waiting = begin()
    waiting.kill()
    waiting.wait()
    assert apart(partial(math.hypot, 3.0, 4.0), 60.0) == 5.0
    with pytest.raises(SplatError, match="the mesher was ended by the signal SIGKILL: try a larger element size"):
        apart(partial(os.killpg, begin().pid, signal.SIGKILL), 60.0)


def test_an_interrupt_ends_the_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise its answer would be that of the next call."""
    waiting = begin()
    answer = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr(waiting, "stdout", Mock(readline=answer, close=waiting.stdout.close))  # type: ignore[union-attr]
    with pytest.raises(KeyboardInterrupt):
        apart(partial(time.sleep, 600.0), 600.0)
    assert waiting.poll() == -signal.SIGKILL
    assert apart(partial(math.hypot, 3.0, 4.0), 60.0) == 5.0


def test_files_of_the_working_folder_are_no_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "random.py").write_text("raise RuntimeError('imported')")
    monkeypatch.chdir(tmp_path)
    end()
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
