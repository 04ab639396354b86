"""Fields where people work: units in the files, meshes of pyvista, tables of pandas, .pvd collections."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pandas
import pytest
import pyvista
from runs import SharedRuns
from scenes import COLD, SHORT

from coupler.commands.main import main
from coupler.errors import StoreError
from coupler.files.result import Result


@pytest.fixture
def short(shared_run: SharedRuns) -> Result:
    return shared_run(SHORT)


def test_files_name_units_and_components(short: Result) -> None:
    with h5py.File(short.directory / "target.vtkhdf") as file:
        stress, body = file["VTKHDF/CellData/stress"], file["VTKHDF/CellData/body"]
        assert stress.attrs["units"] == b"Pa"
        assert list(stress.attrs["components"]) == [b"xx", b"yy", b"zz", b"xy", b"yz", b"xz"]
        assert file["VTKHDF/Steps/Values"].attrs["units"] == b"s"
        assert list(file["VTKHDF/Points"].attrs["components"]) == [b"x", b"y", b"z"]
        assert body.dtype == np.int32


@pytest.mark.parametrize(("domain", "cells"), [("particle", "VERTEX"), ("surface", "TRIANGLE"), ("target", "TETRA")])
def test_a_mesh_of_pyvista_holds_the_fields(short: Result, domain: str, cells: str) -> None:
    fields, grid = short.fields(2, domain), short.mesh(2, domain)
    assert set(grid.celltypes) == {pyvista.CellType[cells]}
    np.testing.assert_array_equal(grid.points, fields.points)
    assert grid.field_data["time"][0] == fields.time
    for name, values in fields.data.items():
        np.testing.assert_array_equal(grid[name], values)
    if domain == "target":
        # of a cylinder of 100 um and 50 um, hardly deformed
        assert grid.compute_cell_sizes()["Volume"].sum() == pytest.approx(np.pi / 4 * 100e-6**2 * 50e-6, rel=0.05)


def test_the_history_is_a_table_of_pandas(short: Result) -> None:
    frame = short.history_frame()
    assert isinstance(frame, pandas.DataFrame)
    np.testing.assert_array_equal(frame["kinetic"], short.history("kinetic"))


def test_a_missing_package_is_named(short: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(StoreError, match="pip install pyvista"):
        short.mesh()


def test_a_collection_has_all_steps_with_their_times(
    short: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "fields"
    assert main(["export", str(short.directory), "--out", str(out)]) == 0
    for domain in ("particle", "surface", "target"):
        reader = pyvista.PVDReader(out / f"{domain}.pvd")
        np.testing.assert_allclose(reader.time_values, short.times(domain), rtol=1e-8)
        reader.set_active_time_point(len(reader.time_values) - 1)
        (grid,), fields = reader.read(), short.fields(-1, domain)
        np.testing.assert_array_equal(grid.points, fields.points)
        np.testing.assert_array_equal(grid["von_mises"], fields.data["von_mises"])
    (out / "target.pvd").write_text("mine")
    assert main(["export", str(short.directory), "--out", str(out)]) == 0  # a folder of ours
    assert main(["export", str(tmp_path), "--out", str(out)]) == 2
    assert "no results of a run" in capsys.readouterr().err


def test_the_closing_stage_is_exported_too(shared_run: SharedRuns, tmp_path: Path) -> None:
    result = shared_run(COLD)
    assert main(["export", str(result.directory), "--out", str(tmp_path / "pvd")]) == 0
    grid = pyvista.read(tmp_path / "pvd" / "cold_0000.vtu")
    np.testing.assert_allclose(grid["thermal_stress"], result.fields(-1, "cold").data["thermal_stress"])
