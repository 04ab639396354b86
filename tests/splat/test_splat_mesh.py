"""`coldspray mesh`: a run's folder or any file of points in, a file that others read out."""

from pathlib import Path

import meshio
import numpy as np
import pytest
from made_up_run import SCENE

from coupler.commands import mesh as mesh_command
from coupler.commands.main import main
from coupler.errors import StoreError
from coupler.files.store import Store
from coupler.geometry.tetrahedra import volumes
from coupler.particle import packing
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.record import plan_text

D = 25e-6


@pytest.fixture(scope="module")
def ball() -> np.ndarray:
    return packing.sphere(D, 400)[0]


def test_a_run_becomes_a_mesh_with_its_fields(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points, each = packing.sphere(D, 1000)
    vertices, triangles = packing.surface(D, 0.8 * each ** (1 / 3))
    n = len(points)
    stress = np.tile(np.array([1.0, 2, 3, 4, 5, 6]) * 1e8, (n, 1))
    fields = {
        "stress": stress,
        "T": np.full(n, 400.0),
        "eps_p": np.full(n, 0.5),
        "velocity": np.tile([1.0, 2, 3], (n, 1)),
    }
    with Store.create(tmp_path / "run", SCENE, plan_json=plan_text(plan(Scene.from_text(SCENE)))) as store:
        for time in (0.0, 1e-9):
            store.write("particle", time, points, np.arange(n)[:, None], fields)
            store.write("surface", time, vertices, triangles, {})
    assert main(["mesh", str(tmp_path / "run")]) == 0
    said = capsys.readouterr().out
    assert "carried + HXT" in said
    mesh = meshio.read(tmp_path / "run" / "splat.vtu")
    tets = mesh.cells_dict["tetra"]
    assert np.linalg.det(mesh.points[tets[:, 1:]] - mesh.points[tets[:, :1]]).sum() / 6 == pytest.approx(
        np.pi / 6 * D**3, rel=0.01
    )
    assert mesh.cell_data["stress"][0] == pytest.approx(stress[: len(tets)])  # VTK's order in, VTK's order out
    assert mesh.cell_data["T"][0] == pytest.approx(np.full(len(tets), 400.0))
    assert mesh.point_data["velocity"] == pytest.approx(np.tile([1.0, 2, 3], (len(mesh.points), 1)), rel=0.02)
    cloud, notes = mesh_command.of_run(tmp_path / "run")
    assert cloud.stress[0] == pytest.approx([1e8, 2e8, 3e8, 5e8, 6e8, 4e8])  # inside: xx yy zz yz xz xy
    assert notes == []
    assert main(["mesh", str(tmp_path / "run"), "--step", "7"]) == 2
    assert "there is no step 7" in capsys.readouterr().err


def test_a_composite_particle_becomes_bodies_of_shell_and_core(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From a run or a file: the cell field `core` has the volume fraction of its points."""
    points, _ = packing.sphere(D, 1000)
    n, core = len(points), (np.linalg.norm(points, axis=1) < 0.37 * D).astype(float)
    scene = SCENE.replace("velocity", 'core = { material = "Al2O3", share = 0.2 }\nvelocity')
    with Store.create(tmp_path / "run", scene, plan_json=plan_text(plan(Scene.from_text(scene)))) as store:
        store.write("particle", 0.0, points, np.arange(n)[:, None], {"core": core})
    rows = (f"{x},{y},{z},{i}" for (x, y, z), i in zip(points * 1e6, core, strict=True))
    (tmp_path / "points.csv").write_text("\n".join(["x [um],y [um],z [um],core", *rows]) + "\n")
    for source in (tmp_path / "run", tmp_path / "points.csv"):
        assert main(["mesh", str(source), "--out", str(tmp_path / "mesh.vtu"), "--force"]) == 0
        assert "2, 1 of these cores" in " ".join(capsys.readouterr().out.split())
        mesh = meshio.read(tmp_path / "mesh.vtu")
        size = volumes(mesh.points, mesh.cells_dict["tetra"])
        share = size[mesh.cell_data["core"][0] == 1.0].sum() / size.sum()
        assert share == pytest.approx(core.mean(), abs=0.02)
        assert mesh.cell_data["core"][0] == pytest.approx(mesh.cell_data["body"][0])


def test_points_in_micrometres_become_a_gmsh_file(ball, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "points.csv", tmp_path / "mesh.msh"
    rows = ["x,y,z,T,colour", *(f"{x},{y},{z},300,{i}" for i, (x, y, z) in enumerate(ball * 1e6))]
    source.write_text("\n".join(rows) + "\n")
    assert main(["mesh", str(source), "--unit", "um", "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the spacing is estimated" in said
    assert "field 'colour' is left out" in said
    mesh = meshio.read(out)
    assert np.ptp(mesh.points, axis=0) == pytest.approx(np.full(3, D), rel=0.1)
    assert mesh.cell_data["T"][0] == pytest.approx(np.full(len(mesh.cells_dict["tetra"]), 300.0))


def test_stress_is_a_whole_tensor_for_gmsh(tmp_path: Path) -> None:
    from coupler.splat.cloud import Body, Splat

    points, tets = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 1, 2, 3]])
    body = Body(points, tets, np.arange(4), stress=np.array([[1.0, 2, 3, 4, 5, 6]]))
    mesh_command.write(tmp_path / "one.msh", Splat([body], {}))
    whole = meshio.read(tmp_path / "one.msh").cell_data["stress"][0].reshape(3, 3)
    assert whole == pytest.approx(np.array([[1.0, 6, 5], [6, 2, 4], [5, 4, 3]]))


@pytest.mark.parametrize("suffix", [".csv", ".xyz", ".txt", ".npz", ".vtk"])
def test_points_are_read_from_many_files(ball, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"points{suffix}"
    if suffix == ".csv":
        path.write_text("\n".join(",".join(map(repr, map(float, p))) for p in ball))
    elif suffix == ".xyz":
        path.write_text(f"{len(ball)}\n\n" + "\n".join("Ni " + " ".join(map(repr, map(float, p))) for p in ball))
    elif suffix == ".txt":
        path.write_text("# a remark\n" + "\n".join(" ".join(map(repr, map(float, p))) for p in ball))
    elif suffix == ".npz":
        np.savez(path, x=ball, T=np.full(len(ball), 300.0))
    else:
        vertices = [("vertex", np.arange(len(ball))[:, None])]
        meshio.write(path, meshio.Mesh(ball, vertices, {"T": np.full(len(ball), 300.0)}))
    cloud, _ = mesh_command.of_file(path)
    assert cloud.x == pytest.approx(ball)
    assert (cloud.T is not None) == (suffix in (".npz", ".vtk"))


def lattices() -> dict[str, np.ndarray]:
    grid = np.stack(np.meshgrid(*[np.arange(12.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    rng = np.random.default_rng(3)
    return {
        "face-centred": packing.sphere(1.0, 3000)[0] / (np.pi / 6 / len(packing.sphere(1.0, 3000)[0])) ** (1 / 3),
        "cubic": grid,
        "jittered": grid + rng.uniform(-0.25, 0.25, grid.shape),
    }


@pytest.mark.parametrize("kind", ["face-centred", "cubic", "jittered"])
def test_the_spacing_is_estimated_within_five_per_cent(kind: str) -> None:
    assert mesh_command.estimated_spacing(lattices()[kind]) == pytest.approx(1.0, rel=0.05)


def test_what_is_wrong_is_said_in_one_line_with_exit_code_2(
    ball, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = tmp_path / "good.npz"
    np.savez(good, x=ball)
    files = {
        "missing.csv": (None, "is missing"),
        "empty.csv": ("", "it is empty"),
        "words.csv": ("a,b,c\n1,2,3\n", "its columns are a, b, c: name them with --columns"),
        "ragged.csv": ("1,2,3\n1,2\n", "line 1 has 3 columns, line 2 has 2"),
        "text.csv": ("1,2,3\n1,2,three\n", "line 2, column 3: 'three' is not a number"),
        "flat.csv": ("\n".join(f"{i % 10},{i // 10},0" for i in range(100)), "plane"),
        "few.csv": ("\n".join(f"{i % 4},{i // 4 % 4},{i // 16}" for i in range(40)), "50 or more"),
        "far.csv": (
            "\n".join(f"{i % 5},{i // 5 % 5},{i // 25 if i else 1e4}\n{i % 5 + 1e4},{i},{i}" for i in range(125)),
            "far from",
        ),
        "nan.csv": ("\n".join(f"{i % 5},{i // 5 % 5},{i // 25 if i else 'nan'}" for i in range(125)), "not a number"),
        "bytes.npz": ("not an archive", "cannot be read"),
        "what.vtu": ("<html>", "cannot be read"),
        "what.unknown": ("1 2 3", "cannot be read"),
    }
    cases = [([str(tmp_path / name)], told) for name, (_, told) in files.items()]
    for name, (text, _) in files.items():
        if text is not None:
            (tmp_path / name).write_text(text)
    (tmp_path / "folder").mkdir()
    cases += [
        ([str(tmp_path / "folder")], "holds no results"),
        ([str(good), "--out", str(tmp_path / "a.jpg")], "use .vtu or .vtk"),
        ([str(good), "--size", "5"], "has no unit"),
        ([str(good), "--size", "-5 um"], "must be above zero"),
        ([str(good), "--unit", "parsec"], "unknown unit"),
        ([str(good), "--spacing", "1 nm"], "check the spacing"),
        ([str(good), "--size", "1 nm"], "give a larger element size"),
        ([str(good), "--out", str(tmp_path / "not" / "there.vtu")], "cannot write"),
    ]
    for arguments, told in cases:
        assert main(["mesh", *arguments]) == 2, arguments
        message = capsys.readouterr().err
        assert told in message, (arguments, message)
        assert message.count("\n") == 1
        assert message.startswith("coldspray: ")


def test_the_file_to_read_is_never_written(ball, tmp_path: Path) -> None:
    path = tmp_path / "cloud.vtu"
    meshio.write(path, meshio.Mesh(ball, [("vertex", np.arange(len(ball))[:, None])]))
    before = path.read_bytes()
    with pytest.raises(StoreError, match="is the same file as"):
        mesh_command.run(mesh_parser().parse_args(["mesh", str(path), "--out", str(path)]))
    assert path.read_bytes() == before


def mesh_parser():
    from coupler.commands.main import _parser

    return _parser()


def test_doubles_and_lonely_points_of_a_file_are_left_out(tmp_path: Path) -> None:
    x, volume = packing.sphere(20e-6, 600)
    dx = volume ** (1.0 / 3.0)
    far = np.array([[90e-6, 0.0, 0.0], [0.0, -80e-6, 5e-6]])
    np.savez(tmp_path / "cloud.npz", points=np.concatenate([x, x[:7] + 1e-6 * dx, far]), T=np.arange(len(x) + 9.0))
    cloud, notes = mesh_command.of_file(tmp_path / "cloud.npz", dx)
    np.testing.assert_array_equal(cloud.x, x)
    np.testing.assert_array_equal(cloud.T, np.arange(len(x)))
    assert notes[-2:] == ["7 duplicate points left out", "2 points far from all others left out"]
