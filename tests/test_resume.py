"""Nothing is lost: checkpoints, and runs that go on after being stopped or killed."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coupler import Result, Scene, run
from coupler.deposition.run import resume
from coupler.errors import StoreError
from coupler.files import checkpoint
from coupler.files.checkpoint import CheckpointError
from tests.test_parallel import MPIEXEC, NI, numbers

SHORT = NI + '[end]\ntime = "36 ns"\n[output]\nevery = "5 ns"\n'


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nobody disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "short.toml").write_text(SHORT)
    run(folder / "short.toml", folder / "out")
    return folder


class Enough(Exception):
    """Raised by a probe to break a run off."""


def break_off(scene: Path, out: Path, at: float, every: float = 0.0) -> None:
    def probe(impact: Any) -> None:
        if impact.time > at:
            raise Enough

    with pytest.raises(Enough):
        run(scene, out, probe=probe, checkpoint_every=every)


def same(a: Path, b: Path) -> None:
    expected, got = (
        numbers(json.loads((a / "summary.json").read_text())),
        numbers(json.loads((b / "summary.json").read_text())),
    )
    assert {k: (v, expected[k]) for k, v in got.items() if v != pytest.approx(expected[k], rel=1e-9, abs=1e-25)} == {}
    assert (a / "history.csv").read_text() == (b / "history.csv").read_text()
    one, other = Result(a), Result(b)
    for domain in ("particle", "surface", "target"):
        np.testing.assert_array_equal(one.times(domain), other.times(domain))
        for step in range(len(one.times(domain))):
            left, right = one.fields(step, domain), other.fields(step, domain)
            np.testing.assert_array_equal(left.points, right.points)
            np.testing.assert_array_equal(left.cells, right.cells)
            assert left.data.keys() == right.data.keys()
            for name in left.data:
                np.testing.assert_array_equal(left.data[name], right.data[name])


def test_a_state_comes_back_exactly(tmp_path: Path, rng: np.random.Generator) -> None:
    state = {
        "a": {"x": rng.standard_normal((5, 3)), "n": 3, "f": 0.1 + 0.2, "none": None, "inf": np.inf, "yes": True},
        "list": [1, {"deep": np.arange(3, dtype=np.int32)}],
        "random": rng.bit_generator.state,
    }
    path = checkpoint.write(tmp_path, state, {"scene": "s"})
    back, about = checkpoint.read(path)
    np.testing.assert_array_equal(back["a"]["x"], state["a"]["x"])
    assert back["list"][1]["deep"].dtype == np.int32
    assert (back["a"]["f"], back["a"]["n"], back["a"]["none"], back["a"]["inf"]) == (0.1 + 0.2, 3, None, np.inf)
    assert back["random"] == state["random"]
    assert about == {"scene": "s"}
    with pytest.raises(TypeError, match="cannot hold"):
        checkpoint.write(tmp_path, {"a": object()}, {})


def test_two_are_kept_and_the_last_whole_one_is_used(tmp_path: Path) -> None:
    about = {"version": "1", "scene": "s"}
    for i in range(4):
        checkpoint.write(tmp_path, {"i": i, "x": np.full(1000, float(i))}, about)
    assert [number for number, _ in checkpoint.found(tmp_path)] == [3, 4]
    last = checkpoint.found(tmp_path)[-1][1]
    content = bytearray(last.read_bytes())
    lines: list[str] = []
    for damage in ("truncated", "flipped", "header", "empty"):
        bad = bytearray(content)
        if damage == "flipped":
            bad[-500] ^= 1
        elif damage == "header":
            bad[100] ^= 1
        last.write_bytes({"truncated": content[:-100], "empty": b""}.get(damage, bytes(bad)))
        found = checkpoint.latest(tmp_path, about, lines.append)
        assert found is not None
        assert found[0]["i"] == 2, damage
    assert len(lines) == 4
    assert all("damaged" in line and "one before" in line for line in lines)
    checkpoint.found(tmp_path)[0][1].write_bytes(b"nonsense")
    with pytest.raises(CheckpointError, match=r"no checkpoint .* is whole"):
        checkpoint.latest(tmp_path, about, lines.append)


@pytest.mark.parametrize(("key", "what"), [("version", "another version"), ("scene", "another scene")])
def test_what_belongs_elsewhere_is_refused(tmp_path: Path, key: str, what: str) -> None:
    about = {"version": "1", "scene": "s"}
    checkpoint.write(tmp_path, {"i": 1}, about)
    with pytest.raises(CheckpointError, match=what):
        checkpoint.latest(tmp_path, about | {key: "2"})


def test_a_full_disk_keeps_what_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint.write(tmp_path, {"i": 1}, {})
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 10, 0))  # type: ignore[attr-defined]
    with pytest.raises(StoreError, match="no space left on the disk; make room"):
        checkpoint.write(tmp_path, {"i": 2}, {})
    found = checkpoint.latest(tmp_path, {})
    assert found is not None
    assert found[0]["i"] == 1
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("at", [5e-9, 32e-9])
def test_a_run_goes_on_to_the_same_end(whole: Path, tmp_path: Path, at: float) -> None:
    break_off(whole / "short.toml", tmp_path / "out", at)
    assert len(checkpoint.found(tmp_path / "out")) > 0
    result = resume(tmp_path / "out")
    assert result.finished
    assert checkpoint.found(tmp_path / "out") == []
    same(whole / "out", tmp_path / "out")


def test_it_goes_on_on_other_ranks(whole: Path, tmp_path: Path) -> None:
    break_off(whole / "short.toml", tmp_path / "out", 12e-9)
    command = [str(MPIEXEC), "-n", "2", sys.executable, "-m", "coupler", "resume", str(tmp_path / "out"), "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["ranks"] == 2
    same(whole / "out", tmp_path / "out")


def test_without_a_checkpoint_it_starts_anew(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    break_off(whole / "short.toml", tmp_path / "out", 5e-9, every=1e9)
    resume(tmp_path / "out")
    assert "no checkpoint: the run starts from its beginning" in capsys.readouterr().err
    same(whole / "out", tmp_path / "out")


def test_a_damaged_checkpoint_and_a_damaged_file(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    break_off(whole / "short.toml", out, 20e-9)
    last = checkpoint.found(out)[-1][1]
    last.write_bytes(last.read_bytes()[:-1])
    (out / "surface.vtkhdf").write_bytes(b"not HDF5 at all")
    result = resume(out)
    said = capsys.readouterr().err
    assert f"{last} is damaged" in said
    assert "surface.vtkhdf cannot be read" in said
    assert len(result.times("target")) == len(Result(whole / "out").times("target"))
    assert 0 < len(result.times("surface")) < len(result.times("target"))


def test_an_unfinished_run_is_not_thrown_away(whole: Path, tmp_path: Path) -> None:
    break_off(whole / "short.toml", tmp_path / "out", 5e-9)
    with pytest.raises(StoreError, match="coldspray resume"):
        run(whole / "short.toml", tmp_path / "out")
    other = tmp_path / "out" / "scene.toml"
    other.write_text(other.read_text().replace("5.0 ns", "6.0 ns").replace('"30.0 ns"', '"31.0 ns"'))
    other.write_text(other.read_text() + "\n")
    text = Scene.load(other).to_toml()
    if text != Scene.from_text(SHORT, "short").to_toml():
        with pytest.raises(CheckpointError, match="another scene"):
            resume(tmp_path / "out")


def test_a_finished_run_is_left_alone(whole: Path) -> None:
    before = (whole / "out" / "summary.json").stat().st_mtime_ns
    assert resume(whole / "out").finished
    assert (whole / "out" / "summary.json").stat().st_mtime_ns == before
    with pytest.raises(StoreError):
        resume(whole / "nothing here")


def launch(whole: Path, out: Path, every: float = 0.05) -> subprocess.Popen[str]:
    command = [
        sys.executable,
        "-m",
        "coupler",
        "run",
        str(whole / "short.toml"),
        "--out",
        str(out),
        "--checkpoint",
        str(every),
    ]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(path: Path, size: int = 1) -> None:
    deadline = time.monotonic() + 120
    while not (path.exists() and path.stat().st_size >= size):
        assert time.monotonic() < deadline, f"{path} did not come"
        time.sleep(0.005)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_writes_a_checkpoint_first(whole: Path, tmp_path: Path, number: signal.Signals, code: int) -> None:
    started = launch(whole, tmp_path / "out", every=1e9)
    wait_for(tmp_path / "out" / "history.csv", 600)
    started.send_signal(number)
    _, err = started.communicate(timeout=60)
    assert started.returncode == code
    assert "go on with coldspray resume" in err
    assert len(checkpoint.found(tmp_path / "out")) == 1
    resume(tmp_path / "out")
    same(whole / "out", tmp_path / "out")


@pytest.mark.parametrize("seed", range(4))
def test_a_killed_run_goes_on(whole: Path, tmp_path: Path, seed: int) -> None:
    out, moment = tmp_path / "out", random.Random(seed).random()
    started = launch(whole, out)
    wait_for(out / "scene.toml")
    if seed:  # 0: at the very start
        wait_for(out / "history.csv", int(400 + 3000 * moment))
    os.kill(started.pid, signal.SIGKILL)
    started.communicate(timeout=60)
    if not (out / "summary.json").exists():
        for domain in ("particle", "target"):
            Result(out).times(domain)  # still readable
    resume(out)
    same(whole / "out", out)
