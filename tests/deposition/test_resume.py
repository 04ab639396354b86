"""Nothing is lost: checkpoints, and runs that go on after being stopped or killed."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from runs import SharedRuns, assert_same_files, assert_same_numbers, break_off
from scenes import SHORT, WHOLE

from coupler import Result, Scene, run
from coupler.commands.main import main
from coupler.core.records import Rows, Shape, copied, put
from coupler.deposition.fold import Deposition
from coupler.deposition.run import resume
from coupler.errors import CheckpointError, StoreError
from coupler.files import checkpoint
from coupler.impact.domains import build_target
from coupler.impact.exchange import Impact
from coupler.impact.recorder import Recorder
from coupler.impact.run import RunOptions
from coupler.impact.summary import ImpactRecord
from coupler.plan.record import read_plan
from coupler.progress import Progress


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """The file of a scene."""
    path = tmp_path / "shared.toml"
    path.write_text(SHORT)
    return path


def assert_same(one: Result, other: Result) -> None:
    """Numbers to 1e-9: a shared run is of one process, its sums in the same order; files to the last bit."""
    assert_same_numbers(one.summary, other.summary, rel=1e-9)
    assert_same_files(one, other)


@dataclass(frozen=True)
class Part:
    n: int
    x: Annotated[np.ndarray, Rows(3)]
    T: Annotated[np.ndarray, Rows()]


@dataclass(frozen=True)
class Kept:
    part: Part | None
    parts: list[Part]
    f: float
    none: float | None
    infinite: float
    yes: bool
    said: dict[str, Any]
    numbers: tuple[int, ...]
    ids: Annotated[np.ndarray, Shape(-1, dtype=np.int32)]


def kept(n: int = 3) -> Kept:
    rng = np.random.default_rng(n)
    part = Part(n, rng.standard_normal((5, 3)), rng.standard_normal(5))
    return Kept(
        part, [part, part], 0.1 + 0.2, None, np.inf, True, {"a": [1, {"b": "c"}]}, (1, 2), np.arange(3, dtype=np.int32)
    )


def test_a_state_comes_back_exactly(tmp_path: Path) -> None:
    state = kept()
    back = checkpoint.read(checkpoint.write(tmp_path, state, {"scene": "s"}), Kept, {"scene": "s"})
    assert back.part is not None
    assert state.part is not None
    np.testing.assert_array_equal(back.part.x, state.part.x)
    np.testing.assert_array_equal(back.parts[1].T, state.part.T)
    assert back.ids.dtype == np.int32
    assert replace(back, part=None, parts=[], ids=None) == replace(state, part=None, parts=[], ids=None)
    with pytest.raises(TypeError, match="cannot store"):
        checkpoint.write(tmp_path, replace(state, said={"a": object()}), {})


@dataclass(eq=False)
class Sum:
    work: float = 0.0
    steps: int = 0


@dataclass(eq=False)
class Moving:
    x: Annotated[np.ndarray, Rows(3)]
    total: Sum
    time: float = 0.0


class Mover(Moving):
    """Its attributes are the fields of its record; `mass` is no part of the state."""

    def __init__(self) -> None:
        super().__init__(np.zeros((4, 3)), Sum())
        self.mass = np.ones(4)


def test_what_derives_from_a_record_keeps_its_fields(tmp_path: Path) -> None:
    """A further number is one line in the record. Arrays and parts stay where they are: kernels and others refer to them."""
    one, other = Mover(), Mover()
    one.x[:], one.time, one.total.work, one.total.steps = np.arange(12).reshape(4, 3), 3.0, 0.5, 7
    back = checkpoint.read(checkpoint.write(tmp_path, copied(one), {}), Moving)
    assert type(back) is Moving
    x, total = other.x, other.total
    put(back, other)
    assert other.x is x
    assert other.total is total
    np.testing.assert_array_equal(x, one.x)
    assert (other.time, total.work, total.steps) == (3.0, 0.5, 7)
    with pytest.raises(CheckpointError, match=r"x has the shape \(5, 3\), but \(4, 3\) is needed"):
        put(replace(back, x=np.zeros((5, 3))), other)


WRONG = {
    "a number for an array": {"ids": 3},
    "an array for a number": {"f": np.zeros(3)},
    "a text for a number": {"f": "1.0"},
    "a number for a truth": {"yes": 1},
    "another type of array": {"ids": np.arange(3.0)},
    "another shape": {"ids": np.zeros((3, 1), np.int32)},
    "rows that do not match": {"part": Part(1, np.zeros((5, 3)), np.zeros(4))},
    "rows of another width": {"part": Part(1, np.zeros((5, 2)), np.zeros(5))},
    "a record of another class": {"part": replace(kept(), part=None)},
    "a dict for a record": {"part": {"n": 1}},
    "None for a list": {"parts": None},
    "a list for a dict": {"said": [1]},
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_checkpoint_of_the_wrong_types_is_refused(tmp_path: Path, wrong: str) -> None:
    """Whole by its checksums, but not what the record says: one error, and never a traceback."""
    path = checkpoint.write(tmp_path, replace(kept(), **WRONG[wrong]), {})
    with pytest.raises(CheckpointError):
        checkpoint.read(path, Kept)


def test_a_crafted_header_is_refused(tmp_path: Path) -> None:
    with np.load(checkpoint.write(tmp_path, kept(), {})) as arrays:
        content = dict(arrays)
    header = json.loads(content.pop("header").tobytes())
    state = header["state"]
    crafted: list[Any] = [
        [], 1, None, {}, {**header, "state": None}, {**header, "about": 3}, {**header, "format": "many"},
        {**header, "state": {**state, "more": 1}}, {**header, "state": {"@array": "nowhere"}},
        {**header, "state": {"@record": "nobody"}}, {**header, "state": {**state, "ids": {"@array": ["a"]}}},
    ]  # fmt: skip
    for i, made in enumerate(crafted):
        path = tmp_path / f"checkpoint-{i:06d}.ckpt"
        with path.open("wb") as stream:
            np.savez(stream, header=np.frombuffer(json.dumps(made).encode(), np.uint8), **content)
        with pytest.raises(CheckpointError):
            checkpoint.read(path, Kept)


@pytest.mark.parametrize(
    "damage", [{"steps": "many"}, {"end": []}, {"wall_loop_s": None}, {"refused": 3}, {"undecided": 0.0, "end": {}}]
)
def test_records_that_make_no_summary_are_refused(
    shared_run: SharedRuns, tmp_path: Path, damage: dict[str, Any]
) -> None:
    """A checkpoint is whole by its types, but the tables of its finished impacts are not what an impact leaves."""
    result = shared_run(SHORT)
    deposition = object.__new__(Deposition)
    deposition.plan, deposition.folder = read_plan(result.directory), tmp_path
    deposition.options, deposition.joins = RunOptions(Progress(quiet=True), tmp_path / "log"), []
    deposition._began, deposition.closing = 0.0, None
    bodies = build_target(deposition.plan)
    record = ImpactRecord(result.summary["impacts"][0], [], [], 1.0)
    deposition.records = [record]
    deposition._check_records(bodies)
    deposition.records = [replace(record, values=record.values | damage)]
    with pytest.raises(CheckpointError, match="is damaged"):
        deposition._check_records(bodies)


def test_two_are_kept_and_the_last_whole_one_is_used(tmp_path: Path) -> None:
    about = {"version": "1", "scene": "s"}
    for i in range(4):
        checkpoint.write(tmp_path, kept(i), about)
    assert [number for number, _ in checkpoint.stored(tmp_path)] == [3, 4]
    last = checkpoint.stored(tmp_path)[-1][1]
    content = bytearray(last.read_bytes())
    lines: list[str] = []
    for damage in ("truncated", "number", "header", "empty"):
        bad = bytearray(content)
        if damage == "number":
            bad[content.index(kept(3).ids.tobytes())] ^= 1
        elif damage == "header":
            bad[content.index(b'"format"')] ^= 1
        last.write_bytes({"truncated": content[:-100], "empty": b""}.get(damage, bytes(bad)))
        found = checkpoint.latest(tmp_path, Kept, about, lines.append)
        assert found is not None
        assert found.parts[0].n == 2, damage
    assert len(lines) == 4
    assert all("damaged" in line and "previous checkpoint" in line for line in lines)
    checkpoint.stored(tmp_path)[0][1].write_bytes(b"nonsense")
    with pytest.raises(CheckpointError, match=r"no checkpoint .* can be read"):
        checkpoint.latest(tmp_path, Kept, about, lines.append)


@pytest.mark.parametrize(("key", "what"), [("version", "another version"), ("scene", "another scene")])
def test_what_belongs_elsewhere_is_refused(tmp_path: Path, key: str, what: str) -> None:
    about = {"version": "1", "scene": "s"}
    checkpoint.write(tmp_path, kept(), about)
    with pytest.raises(CheckpointError, match=what):
        checkpoint.latest(tmp_path, Kept, about | {key: "2"})


def test_an_older_format_is_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "FORMAT", 4)
    checkpoint.write(tmp_path, kept(), {"version": "0.1.0"})
    monkeypatch.undo()
    with pytest.raises(
        CheckpointError, match=rf"by coldspray 0\.1\.0 in format 4, but this version reads format {checkpoint.FORMAT}"
    ):
        checkpoint.latest(tmp_path, Kept, {"version": "0.3.0"})


def test_a_checkpoint_that_breaks_off_keeps_what_is_there(tmp_path: Path) -> None:
    """A disk that fills while the arrays are written is not seen before: nothing but the last whole checkpoint is left."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    checkpoint.write(tmp_path, kept(1), {})
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with pytest.raises(StoreError, match="File too large; free some space"):
            checkpoint.write(tmp_path, {"x": np.zeros(100_000)}, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    found = checkpoint.latest(tmp_path, Kept, {})
    assert found is not None
    assert found.parts[0].n == 1
    assert not list(tmp_path.glob("*.part"))


def test_a_full_disk_keeps_what_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint.write(tmp_path, kept(1), {})
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 10, 0))  # type: ignore[attr-defined]
    with pytest.raises(StoreError, match="no space left on the disk; free some space"):
        checkpoint.write(tmp_path, kept(2), {})
    found = checkpoint.latest(tmp_path, Kept, {})
    assert found is not None
    assert found.parts[0].n == 1
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(
    ("text", "at"),
    [(SHORT, 5e-9), pytest.param(WHOLE, 32e-9, marks=pytest.mark.slow)],
    ids=["going down", "rebounding"],
)
def test_a_run_goes_on_to_the_same_end(shared_run: SharedRuns, tmp_path: Path, text: str, at: float) -> None:
    out = tmp_path / "out"
    break_off(Scene.from_text(text, "shared"), out, at)
    assert len(checkpoint.stored(out)) > 0
    result = resume(out)
    assert result.finished
    unbroken = shared_run(text)
    is_kept = [bool(checkpoint.stored(folder)) for folder in (out, unbroken.directory)]
    assert is_kept[0] == is_kept[1]  # they stay where the verdict is undecided
    assert_same(unbroken, result)


def test_without_a_checkpoint_it_starts_anew(
    short: Path, shared_run: SharedRuns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    break_off(short, tmp_path / "out", 5e-9, every=1e9)
    result = resume(tmp_path / "out")
    assert "no checkpoint: the run starts from its beginning" in capsys.readouterr().err
    assert_same(shared_run(SHORT), result)


def test_a_damaged_checkpoint_and_a_damaged_file(
    short: Path, shared_run: SharedRuns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    break_off(short, out, 6e-9)
    last = checkpoint.stored(out)[-1][1]
    last.write_bytes(last.read_bytes()[:-1])
    (out / "surface.vtkhdf").write_bytes(b"not HDF5 at all")
    result = resume(out)
    said = capsys.readouterr().err
    assert f"{last} is damaged" in said
    assert "surface.vtkhdf cannot be read" in said
    assert len(result.times("target")) == len(shared_run(SHORT).times("target"))
    assert 0 < len(result.times("surface")) < len(result.times("target"))


def test_an_unfinished_run_is_not_thrown_away(short: Path, tmp_path: Path) -> None:
    break_off(short, tmp_path / "out", 3e-9)
    with pytest.raises(StoreError, match="coldspray resume"):
        run(short, tmp_path / "out")


def test_a_checkpoint_of_another_scene_is_refused(short: Path, tmp_path: Path) -> None:
    """The scene beside a checkpoint was changed: its numbers would be those of neither."""
    break_off(short, tmp_path / "out", 3e-9)
    faster = Scene.from_text(SHORT.replace("500 m/s", "510 m/s"), "shared")
    (tmp_path / "out" / "scene.toml").write_text(faster.to_toml())
    with pytest.raises(CheckpointError, match="another scene"):
        resume(tmp_path / "out")


def test_a_finished_run_is_left_alone(shared_run: SharedRuns, tmp_path: Path) -> None:
    summary = shared_run(SHORT).directory / "summary.json"
    before = summary.stat().st_mtime_ns
    assert resume(summary.parent).finished
    assert summary.stat().st_mtime_ns == before
    with pytest.raises(StoreError):
        resume(tmp_path / "nothing here")


def launch(text: str, folder: Path) -> subprocess.Popen[str]:
    """The command line on a scene, into the folder `out` there."""
    scene = folder / "shared.toml"
    scene.write_text(text)
    arguments = ["run", str(scene), "--out", str(folder / "out"), "--checkpoint", "0.05"]
    command = [sys.executable, "-m", "coupler", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(path: Path, size: int = 1) -> None:
    deadline = time.monotonic() + 120
    while not (path.exists() and path.stat().st_size >= size):
        assert time.monotonic() < deadline, f"{path} did not come"
        time.sleep(0.005)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_signal_writes_a_checkpoint_first(
    short: Path,
    shared_run: SharedRuns,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
    code: int,
) -> None:
    out, true_record, sent = tmp_path / "out", Recorder.record, []

    def record(self: Recorder, impact: Impact, *more: Any, **named: Any) -> None:
        if impact.time > 5e-9 and not sent:
            sent.append(number)
            signal.raise_signal(number)
        true_record(self, impact, *more, **named)

    monkeypatch.setattr(Recorder, "record", record)
    assert main(["run", str(short), "--out", str(out), "--checkpoint", "1e9", "--quiet"]) == code
    assert f"continue with coldspray resume {out}" in capsys.readouterr().err
    assert f"stopped by the signal {number.name}" in (out / "run.log").read_text()
    assert len(checkpoint.stored(out)) == 1
    assert not (out / "summary.json").exists()
    assert_same(shared_run(SHORT), resume(out))


@pytest.mark.parametrize(
    "moment",
    [
        pytest.param(0, marks=pytest.mark.slow),
        800,
        *(pytest.param(size, marks=pytest.mark.slow) for size in (1500, 2700, 3300)),
    ],
)
def test_a_killed_run_goes_on(shared_run: SharedRuns, tmp_path: Path, moment: int) -> None:
    """Killed when the history has so many bytes; 0: as soon as there is a scene."""
    out = tmp_path / "out"
    started = launch(WHOLE, tmp_path)
    wait_for(out / "scene.toml")
    if moment:
        wait_for(out / "history.csv", moment)
    os.kill(started.pid, signal.SIGKILL)
    started.communicate(timeout=60)
    if not (out / "summary.json").exists():
        for domain in ("particle", "target"):
            Result(out).times(domain)  # still readable
    assert_same(shared_run(WHOLE), resume(out))
