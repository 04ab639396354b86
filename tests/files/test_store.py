"""The files of a run: read back by VTK, and readable whatever happens to the process that writes them."""

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from coupler.errors import StoreError
from coupler.files import vtkhdf
from coupler.files.result import impact_at
from coupler.files.store import Store
from coupler.files.vtkhdf import VtkHdfWriter

TETS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]]) * 1e-6


def read_with_vtk(path: Path) -> list[dict[str, np.ndarray]]:
    """Every step of a file as VTK's own reader sees it."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    steps = []
    for step in range(reader.GetNumberOfSteps()):
        reader.SetStep(step)
        reader.Update()
        grid = reader.GetOutput()
        found = {
            "time": reader.GetTimeValue(),
            "points": vtk_to_numpy(grid.GetPoints().GetData()).copy(),
            "cells": vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(grid.GetNumberOfCells(), -1).copy(),
            "type": grid.GetCellType(0),
        }
        for data in (grid.GetPointData(), grid.GetCellData()):
            for number in range(data.GetNumberOfArrays()):
                array = data.GetArray(number)
                found[array.GetName()] = vtk_to_numpy(array).copy()
        steps.append(found)
    return steps


@pytest.mark.parametrize(
    ("cells", "kind"),
    [(np.arange(5)[:, None], 1), (TETS[:, :3], 5), (TETS, 10)],
    ids=["points", "triangles", "tets"],
)
def test_vtk_reads_every_step_back(tmp_path, cells, kind):
    rng = np.random.default_rng(1)
    written = []
    writer = VtkHdfWriter(tmp_path / "a.vtkhdf")
    for step in range(7):
        points = POINTS + rng.normal(size=POINTS.shape) * 1e-7
        velocity, stress = rng.normal(size=(5, 3)), rng.normal(size=(len(cells), 6)) * 1e8
        writer.write(step * 2e-9, points, cells, {"velocity": velocity}, {"stress": stress})
        written.append((points, velocity, stress))
    writer.close()
    steps = read_with_vtk(tmp_path / "a.vtkhdf")
    assert len(steps) == 7
    for number, (found, (points, velocity, stress)) in enumerate(zip(steps, written, strict=True)):
        assert found["time"] == number * 2e-9
        assert found["type"] == kind
        np.testing.assert_array_equal(found["points"], points)
        np.testing.assert_array_equal(found["cells"], cells)
        np.testing.assert_array_equal(found["velocity"], velocity.astype(np.float32))
        np.testing.assert_array_equal(found["stress"], stress.astype(np.float32))


def test_topology_and_number_of_points_may_change(tmp_path):
    import h5py

    writer = VtkHdfWriter(tmp_path / "a.vtkhdf")
    topologies = [TETS, TETS.copy(), TETS[:1], TETS[:1], TETS[::-1], TETS]
    counts = [5, 5, 5, 4, 5, 5]
    for step, (cells, count) in enumerate(zip(topologies, counts, strict=True)):
        writer.write(
            step,
            POINTS[:count],
            cells,
            {"T": np.full(count, 300.0 + step)},
            {"eps_p": np.full(len(cells), step)},
        )
    writer.close()
    for step, found in enumerate(read_with_vtk(tmp_path / "a.vtkhdf")):
        np.testing.assert_array_equal(found["cells"], topologies[step])
        np.testing.assert_array_equal(found["points"], POINTS[: counts[step]])
        np.testing.assert_array_equal(found["T"], np.full(counts[step], 300.0 + step))
        np.testing.assert_array_equal(found["eps_p"], np.full(len(topologies[step]), step))
    with h5py.File(tmp_path / "a.vtkhdf") as file:
        assert len(file["VTKHDF/NumberOfCells"]) == 5  # the second step had the topology of the first


def test_chunks_that_do_not_change_are_not_compressed_again(tmp_path, monkeypatch):
    monkeypatch.setattr(vtkhdf, "CHUNK", 8)
    packed = []
    deflated = vtkhdf._deflated
    monkeypatch.setattr(vtkhdf, "_deflated", lambda *given: packed.append(given) or deflated(*given))
    writer = VtkHdfWriter(tmp_path / "a.vtkhdf")
    T = np.arange(20.0)
    points, cells = np.ones((20, 3)), np.arange(20)[:, None]
    steps = []
    for changed in (3, 11, 11):
        T[changed] += 1.0  # the caller's own array
        before = len(packed)
        writer.write(len(steps), points, cells, {"T": T})
        steps.append(T.copy())
        assert len(packed) - before == (9 if len(steps) == 1 else 1)
    writer.close()
    for found, expected in zip(read_with_vtk(tmp_path / "a.vtkhdf"), steps, strict=True):
        np.testing.assert_array_equal(found["T"], expected)


def test_bodies_that_grow_fill_chunks_of_their_own(tmp_path, rng, monkeypatch):
    """A step begins with a new chunk, so that none is ever written twice."""
    monkeypatch.setattr(vtkhdf, "CHUNK", 8)
    written = []
    chunk = vtkhdf._deflated
    monkeypatch.setattr(vtkhdf, "_deflated", lambda *given: written.append(chunk(*given)) or written[-1])
    writer = VtkHdfWriter(tmp_path / "a.vtkhdf")
    sizes = [5, 7, 8, 9, 17, 4, 40]
    points = [rng.normal(size=(n, 3)) for n in sizes]
    for step, x in enumerate(points):
        cells = (step + np.arange(4 * (len(x) - 3)).reshape(-1, 4)) % len(x)
        inside = {"eps_p": step + np.arange(len(cells)), "stress": rng.normal(size=(len(cells), 6))}
        writer.write(step, x, cells, {"T": x[:, 0]}, inside)
    writer.close()
    with h5py.File(tmp_path / "a.vtkhdf") as file:
        long = [
            file["VTKHDF"][name]
            for name in ("Points", "Connectivity", "PointData/T", "CellData/eps_p", "CellData/stress")
        ]
        assert sum(data.id.get_num_chunks() for data in long) == len(written)
        assert len(file["VTKHDF/Points"]) > sum(sizes)
    for step, (x, found) in enumerate(zip(points, read_with_vtk(tmp_path / "a.vtkhdf"), strict=True)):
        np.testing.assert_array_equal(found["points"], x)
        np.testing.assert_array_equal(found["T"], x[:, 0].astype(np.float32))
        np.testing.assert_array_equal(found["eps_p"], step + np.arange(len(x) - 3))


@pytest.mark.parametrize("kept", [1, 3, 5])
def test_a_file_is_taken_up_at_an_earlier_step(tmp_path, rng, monkeypatch, kept):
    """The steps that a checkpoint counts are copied; the steps after them are written again."""
    monkeypatch.setattr(vtkhdf, "CHUNK", 8)
    steps = []
    for step, size in enumerate([5, 7, 7, 30, 6]):
        x = rng.normal(size=(size, 3))
        cells = np.arange(4 * (size - 3)).reshape(-1, 4) % size
        steps.append(
            (
                step,
                x,
                cells,
                {"T": x[:, 0]},
                {"body": np.arange(len(cells)), "stress": rng.normal(size=(len(cells), 6))},
            )
        )
    with Store.create(tmp_path, "") as store:
        for step in steps:
            store.write("target", *step)
            if step[0] + 1 == kept:
                state = store.state()
    path = tmp_path / "target.vtkhdf"
    unbroken = read_with_vtk(path)
    with Store.reopen(tmp_path) as store:
        store.go_on(state, pytest.fail)
        assert len(read_with_vtk(path)) == kept
        for step in steps[kept:]:
            store.write("target", *step)
    for a, b in zip(unbroken, read_with_vtk(path), strict=True):
        for name, values in a.items():
            np.testing.assert_array_equal(b[name], values)
    with h5py.File(path) as file:
        assert file["VTKHDF/CellData/stress"].attrs["units"] == b"Pa"
        assert len(file["VTKHDF/NumberOfCells"]) == 4  # steps 1 and 2 have one topology


def test_a_file_without_room_for_its_copy_stays(tmp_path, monkeypatch):
    with Store.create(tmp_path, "") as store:
        store.write("target", 0.0, POINTS, TETS)
        state = store.state()
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=1000))
    with Store.reopen(tmp_path) as store, pytest.raises(StoreError, match=r"target\.vtkhdf: no space left on the disk"):
        store.go_on(state, pytest.fail)
    assert len(read_with_vtk(tmp_path / "target.vtkhdf")) == 1


@pytest.mark.parametrize("is_there", [True, False])
def test_steps_that_a_retry_has_removed_do_not_cost_the_others(tmp_path, is_there):
    """A checkpoint in an impact has three steps; its retry cuts the file to one, and the run is killed before the next checkpoint."""
    told: list[str] = []
    with Store.create(tmp_path, "") as store:
        store.write("target", 0.0, POINTS, TETS)
        before = store.state()
        for time in (1.0, 2.0):
            store.write("target", time, POINTS, TETS)
        later = store.state()
        store.go_on(before, pytest.fail)
    path = tmp_path / "target.vtkhdf"
    if not is_there:
        path.unlink()
    with Store.reopen(tmp_path) as store:
        store.go_on(later, told.append)
        store.write("target", 3.0, POINTS, TETS)
    assert len(read_with_vtk(path)) == 1 + is_there
    assert len(told) == 1
    assert not list(tmp_path.glob("*.damaged*"))


def test_cells_that_change_in_place_are_noticed(tmp_path):
    writer = VtkHdfWriter(tmp_path / "a.vtkhdf")
    cells = TETS.copy()
    writer.write(0.0, POINTS, cells)
    cells[0] = cells[0, ::-1]
    writer.write(1.0, POINTS, cells)
    writer.close()
    first, second = read_with_vtk(tmp_path / "a.vtkhdf")
    np.testing.assert_array_equal(first["cells"], TETS)
    np.testing.assert_array_equal(second["cells"], cells)


def test_an_interrupted_step_leaves_no_trace(tmp_path, monkeypatch):
    writer = VtkHdfWriter(tmp_path / "a.vtkhdf")
    writer.write(0.0, POINTS, TETS, {"T": np.zeros(5)})
    append = VtkHdfWriter._append

    def interrupted(self, state, name, values, *packed):
        if name == "PointData/T":
            raise KeyboardInterrupt
        return append(self, state, name, values, *packed)

    monkeypatch.setattr(VtkHdfWriter, "_append", interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer.write(1.0, POINTS * 2, TETS[:1], {"T": np.ones(5)})
    monkeypatch.undo()
    writer.write(2.0, POINTS * 3, TETS[::-1], {"T": np.full(5, 2.0)})
    writer.close()
    steps = read_with_vtk(tmp_path / "a.vtkhdf")
    assert [found["time"] for found in steps] == [0.0, 2.0]
    np.testing.assert_array_equal(steps[1]["points"], POINTS * 3)
    np.testing.assert_array_equal(steps[1]["cells"], TETS[::-1])
    np.testing.assert_array_equal(steps[1]["T"], np.full(5, 2.0))


@pytest.mark.parametrize(
    ("points", "cells", "data", "message"),
    [
        (POINTS[:, :2], TETS, {}, "points must be"),
        (POINTS, TETS[:, :2], {}, "cells must be"),
        (POINTS[:4], TETS, {}, "outside 0..3"),
        (POINTS, TETS, {"T": np.zeros(4)}, "'T' must be"),
    ],
)
def test_wrong_shapes_are_refused(tmp_path, points, cells, data, message):
    writer = VtkHdfWriter(tmp_path / "a.vtkhdf")
    with pytest.raises(ValueError, match=message):
        writer.write(0.0, points, cells, data)
    writer.close()


WRITING = """
    import sys
    import numpy as np
    from coupler.files.store import Store

    n = 3000
    cells, tets = np.arange(n)[:, None], np.arange(4 * n).reshape(-1, 4) % n
    with Store.create(sys.argv[1], "preset = 'draft'\\n") as store:
        for step in range(100_000):
            points = np.full((n, 3), float(step))
            noise = np.random.default_rng(step).random((n, 6))
            store.write("particle", step, points, cells, {"T": np.full(n, step), "stress": noise})
            store.write("target", step, points, tets, {}, {"eps_p": np.full(n, step)})
            store.record({"time": step, "kinetic": 2.0 * step})
            print(step, flush=True)
"""


@pytest.mark.parametrize("complete", [1, 4, 9])
def test_files_are_readable_after_kill_9(tmp_path, complete):
    """Killed while it writes the step after so many: at any place of it, or later."""
    from coupler.files.result import Result

    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(WRITING), str(tmp_path / "run")], stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    for _ in range(complete):
        assert process.stdout.readline()
    process.kill()
    process.wait()
    process.stdout.close()
    steps = read_with_vtk(tmp_path / "run" / "particle.vtkhdf")
    assert len(steps) >= complete
    for number, found in enumerate(steps):
        assert found["time"] == number
        assert (found["points"] == number).all()
        assert (found["T"] == number).all()
        expected = np.random.default_rng(number).random((3000, 6)).astype(np.float32)
        np.testing.assert_array_equal(found["stress"], expected)
    for found in read_with_vtk(tmp_path / "run" / "target.vtkhdf"):
        assert (found["eps_p"] == found["time"]).all()
    result = Result(tmp_path / "run")
    assert not result.finished
    assert len(result.times("particle")) == len(steps)
    assert result.fields(-1).time == len(steps) - 1
    np.testing.assert_array_equal(result.history("kinetic"), 2 * result.history("time"))
    # The folder of a run that died is free again.
    Store.create(tmp_path / "run", "").close()


def test_full_disk_names_the_file_and_keeps_earlier_steps(tmp_path):
    # A limit on the size of files is the closest to a full disk that any user can make.
    script = """
        import os, resource, sys
        import numpy as np
        from coupler.errors import StoreError
        from coupler.files import vtkhdf
        from coupler.files.store import Store

        vtkhdf._longest_file = lambda: float("inf")  # a full disk shows only when it is full
        memory = os.memfd_create

        def unlimited(name):  # the limit counts for memory as well, which a full disk does not
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            return memory(name)

        os.memfd_create = unlimited
        n = 2000
        for room in sys.argv[2:]:
            with Store.create(f"{sys.argv[1]}/{room}", "") as store:
                resource.setrlimit(resource.RLIMIT_FSIZE, (int(room), resource.RLIM_INFINITY))
                try:
                    for step in range(1000):
                        noise = np.random.default_rng(step).random((n, 3))
                        store.write("particle", step, noise, np.arange(n)[:, None], {"T": noise[:, 0]})
                except StoreError as error:
                    print(step, error)
    """
    rooms = [str(room) for room in range(396_000, 404_000, 2000)]
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), str(tmp_path), *rooms],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    for room, line in zip(rooms, done.stdout.splitlines(), strict=True):
        step, message = line.split(maxsplit=1)
        assert f"cannot write {tmp_path}/{room}/particle.vtkhdf: File too large" in message
        steps = read_with_vtk(tmp_path / room / "particle.vtkhdf")
        assert len(steps) == int(step) >= 3
        for number, found in enumerate(steps):
            np.testing.assert_array_equal(found["points"], np.random.default_rng(number).random((2000, 3)))


def test_no_space_is_noticed_before_the_step(tmp_path, monkeypatch):
    with Store.create(tmp_path, "") as store:
        store.write("target", 0.0, POINTS, TETS)
        monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=1000))
        with pytest.raises(StoreError, match=r"cannot write .*target\.vtkhdf: no space left on the disk"):
            store.write("target", 1.0, POINTS, TETS)
        monkeypatch.undo()
        with pytest.raises(StoreError, match="earlier error"):
            store.write("target", 2.0, POINTS, TETS)
    assert len(read_with_vtk(tmp_path / "target.vtkhdf")) == 1


def test_finished_run_needs_force(tmp_path):
    with Store.create(tmp_path / "a" / "run", "one = 1\n") as store:
        store.record({"time": 0.0})
        store.write("particle", 0.0, POINTS, np.arange(5)[:, None])
        store.finish({"points": 5})
    with pytest.raises(StoreError, match=r"finished run.*--force"):
        Store.create(tmp_path / "a" / "run", "two = 2\n")
    (tmp_path / "a" / "run" / "notes.txt").write_text("mine")
    Store.create(tmp_path / "a" / "run", "two = 2\n", force=True).close()
    left = sorted(path.name for path in (tmp_path / "a" / "run").iterdir())
    assert left == [".coldspray", "notes.txt", "scene.toml"]
    assert (tmp_path / "a" / "run" / "scene.toml").read_text() == "two = 2\n"


def test_two_runs_do_not_share_a_folder(tmp_path):
    with Store.create(tmp_path, ""), pytest.raises(StoreError, match="another run"):
        Store.create(tmp_path, "")
    Store.create(tmp_path, "").close()


def test_unwritable_folders_say_why(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match=r"cannot write to the folder .*file/run: Not a directory"):
        Store.create(tmp_path / "file" / "run", "")
    with pytest.raises(StoreError, match=r"cannot write to .*file: it is not a folder"):
        Store.create(tmp_path / "file", "")
    if os.geteuid() == 0:  # nothing is forbidden to root but the kernel's own files
        forbidden = Path("/proc/run")
    else:
        forbidden = tmp_path / "locked"
        forbidden.mkdir(mode=0o500)
    with pytest.raises(StoreError, match=f"cannot write to the folder {forbidden}: "):
        Store.create(forbidden, "")


def test_summary_is_plain_json(tmp_path):
    with Store.create(tmp_path, "") as store:
        summary = {
            "a": np.float64(1.5),
            "b": np.int32(3),
            "c": float("nan"),
            "d": {"e": np.array([1.0, np.inf])},
            "effects": ("friction",),
            "on": np.bool_(True),
        }
        store.finish(summary)
    text = (tmp_path / "summary.json").read_text()
    assert json.loads(text) == {
        "a": 1.5,
        "b": 3,
        "c": None,
        "d": {"e": [1.0, None]},
        "effects": ["friction"],
        "on": True,
    }
    assert not list(tmp_path.glob(".*.part"))


def test_history_keeps_its_columns(tmp_path):
    with Store.create(tmp_path, "") as store:
        store.record({"time": 0.0, "kinetic": 1 / 3})
        store.record({"kinetic": np.float32(0.25), "time": 1e-9})
        with pytest.raises(ValueError, match="columns"):
            store.record({"time": 0.0})
        # Flushed line by line: nothing waits for the end of the run.
        assert (tmp_path / "history.csv").read_text() == "time,kinetic\n0.0,0.3333333333\n1e-09,0.25\n"


def test_a_stored_step_is_known_by_its_time_in_a_long_coating(tmp_path):
    """After 20 us a step lies 1e-15 s, less than ten digits show, after the end of the impact before."""
    ends = np.cumsum(np.random.default_rng(2).uniform(80e-9, 120e-9, 220))
    with Store.create(tmp_path, "") as store:
        for number, (start, end) in enumerate(zip([0.0, *ends], ends, strict=False), 1):
            for time in (start + 0.5 * (end - start), end):
                store.record({"time": time, "impact": float(number)})
    from coupler.files.result import Result

    result = Result(tmp_path)
    assert [impact_at(result, end) for end in ends] == list(range(1, 221))
    assert [impact_at(result, end + 1e-15) for end in ends[:-1]] == list(range(2, 221))


def test_properties_of_a_coating_go_with_its_results(tmp_path):
    """The report shows those of this run only."""
    for start in (lambda: Store.create(tmp_path, "", force=True), lambda: Store.reopen(tmp_path)):
        (tmp_path / "properties").mkdir(exist_ok=True)
        (tmp_path / "properties" / "properties.json").write_text("{}")
        with start() as store:
            store.go_on(None, print)
        assert not (tmp_path / "properties" / "properties.json").exists()
