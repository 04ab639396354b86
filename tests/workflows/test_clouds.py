"""Files of points as users bring them: the same points from every form, or a refusal that says why."""

import io
import re
from pathlib import Path

import meshio
import numpy as np
import pytest

from coupler.commands.main import main
from coupler.commands.mesh import of_file
from coupler.errors import SplatError
from coupler.files.clouds import read_points
from coupler.files.inputs import InputError
from coupler.particle import packing

BALL = np.round(packing.sphere(12.0, 300)[0], 4)  # um
T = np.arange(len(BALL)) + 300.5


def text(between: str = ",", head: str = "", form: str = "{:.4f}", *, index: bool = False, comma: bool = False) -> str:
    """Rows of x, y, z and T of the ball, under a head."""
    rows = [[form.format(value) for value in row] for row in np.column_stack([BALL, T])]
    rows = [[str(k + 1), *row] for k, row in enumerate(rows)] if index else rows
    lines = "\n".join(between.join(row) for row in rows)
    return f"{head}\n{lines.replace('.', ',') if comma else lines}\n"


FORMS = {
    "plain.csv": text(head="x,y,z,T"),
    "capitals.CSV": text(head="X,Y,Z,T"),
    "quotes.csv": text(head='"x","y","z","T"', form='"{:.4f}"'),
    "quoted_commas.csv": text(form='"{:.4f}"', comma=True),
    "units.csv": text(head="X [um],Y [um],Z [um],T [K]"),
    "celsius.csv": text(head="x (µm),y (µm),z (µm),T (°C)"),
    "semicolons.csv": text(";", "x;y;z;T"),
    "decimal_commas.csv": text(";", "x;y;z;T", comma=True),
    "commas_and_blanks.txt": text("  ", "x y z T", comma=True),
    "comma_blank.txt": text(", ", "x, y, z, T"),
    "tabs.tsv": text("\t", "x\ty\tz\tT"),
    "blanks.dat": text("   ", "x [um]  y [um]  z [um]  T [K]"),
    "savetxt.txt": text(" ", "# made by numpy\n# x y z T"),
    "paraview.csv": text(head='"Points:0","Points:1","Points:2","T"'),
    "paraview_6.csv": text(head='"Points_0","Points_1","Points_2","T"'),
    "words.csv": text(head="element,x,y,z,T")
    .replace("\n", "\nNi,")
    .replace("Ni,element", "element")
    .removesuffix("Ni,"),
    "title.csv": text(head="the ball of yesterday\nx,y,z,T"),
    "numbered.csv": text(head="id,x,y,z,T", index=True),
    "only_numbers.csv": text(),
    "numbered_only.csv": text(index=True),
    "element.xyz": f"{len(BALL)}\na remark\n" + re.sub("^", "Ni ", text(" ").strip(), flags=re.MULTILINE),
}


@pytest.mark.parametrize("name", FORMS)
def test_the_same_points_in_every_form(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(FORMS[name], encoding="latin-1" if "µ" in FORMS[name] else "utf-8")
    points = read_points(tmp_path / name, ())
    np.testing.assert_array_equal(points.x, BALL)
    has_names = "only" not in name and "element" not in name and "quoted_commas" not in name
    assert any("are used as x, y, z" in note for note in points.notes) == (not has_names)
    assert any("decimal commas" in note for note in points.notes) == ("commas" in name)
    if has_names:
        np.testing.assert_array_equal(points.fields["T"], T)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("x;y;z\n1,5;2,5;3.5\n", "with a decimal comma and with a decimal point"),
        ("1,5,2,5,3,5\n4,5,5,5,6,5\n", "may separate columns or be decimal commas"),
        ("a,b,c\n1,2,3\n", "its columns are a, b, c: name them with --columns"),
        ("x [um],y [mm],z [um]\n1,2,3\n", "different units: mm, um"),
        ("x,y,z\n1,2,3\n1,2\n", "line 2 has 3 columns, line 3 has 2"),
        ("x,y,z\n1,2,3\n1,two,3\n", "line 3, column 2: 'two' is not a number"),
        ("\n".join(f"{k},0.5,{k}.5" for k in range(20)), "needs three columns"),
        ("x,y\n1,2\n", "none of its lines has three numbers"),
        ("x,y,z,X\n1,2,3,4\n", "two of its columns have the same name"),
    ],
)
def test_what_is_not_sure_is_refused(content: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(InputError, match=re.escape(told)):
        read_points(tmp_path / "a.csv", ())


@pytest.mark.timeout(60)
def test_a_long_line_takes_no_longer_than_its_length(tmp_path: Path) -> None:
    """A pattern that went back over the line for each of its characters took an hour."""
    for line in ("x" * 300_000, "[" * 300_000, "x" + " " * 300_000 + "[um]"):
        (tmp_path / "a.csv").write_text(f"{line}\n{text()}")
        np.testing.assert_array_equal(read_points(tmp_path / "a.csv", ()).x, BALL)


def test_columns_are_named_by_the_user(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text(head="n,a,b,c,d", index=True))
    points = read_points(tmp_path / "a.csv", (), ["-", "z", "x", "y", "T"])
    np.testing.assert_array_equal(points.x, BALL[:, [1, 2, 0]])
    np.testing.assert_array_equal(points.fields["T"], T)
    with pytest.raises(InputError, match="it has 5 columns, but 6 names are given"):
        read_points(tmp_path / "a.csv", (), list("xyzabc"))
    np.savez(tmp_path / "a.npz", points=BALL)
    with pytest.raises(InputError, match="has no columns to name"):
        read_points(tmp_path / "a.npz", (), list("xyz"))


def test_units_of_names_are_taken_and_held_against_the_option(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text(head="X [um],Y [um],Z [um],T [degC]"))
    for unit in (None, 1e-6):
        cloud, notes = of_file(tmp_path / "a.csv", unit=unit)
        np.testing.assert_allclose(cloud.x, BALL * 1e-6, rtol=1e-12)
        np.testing.assert_allclose(cloud.T, T + 273.15)
        assert any("the unit of the coordinates is um" in note for note in notes) == (unit is None)
    with pytest.raises(SplatError, match="--unit differs from the unit of x, y and z in the file, um"):
        of_file(tmp_path / "a.csv", unit=1e-3)
    (tmp_path / "b.csv").write_text(text(head="x,y,z,T [F]"))
    assert "field 'T' is left out: its unit 'F' is unknown" in of_file(tmp_path / "b.csv", unit=1e-6)[1]


@pytest.mark.parametrize("kind", [".stl", ".ply", ".obj", ".vtk", ".vtu"])
def test_the_surface_of_a_body_is_no_cloud(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Taken for points of a volume it would be a shell with a third of it."""
    x, t = packing.surface(2.0, 0.3)
    path = tmp_path / f"a{kind}"
    meshio.Mesh(x, [("triangle", t.astype(np.int32))]).write(path)
    assert main(["mesh", str(path), "--unit", "um"]) == 2
    assert "is a surface, and points in the whole volume are needed" in capsys.readouterr().err


def test_points_of_a_shell_are_refused(tmp_path: Path) -> None:
    x, _ = packing.surface(12.0, 0.8)
    np.savetxt(tmp_path / "a.csv", x, delimiter=",", header="x,y,z", comments="")
    with pytest.raises(SplatError, match="lie on a surface"):
        of_file(tmp_path / "a.csv", unit=1e-6)
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0), np.arange(2.0), indexing="ij"), -1).reshape(-1, 3)
    of = io.BytesIO()
    np.savez(of, points=grid * 1e-6)
    (tmp_path / "two_layers.npz").write_bytes(of.getvalue())
    assert len(of_file(tmp_path / "two_layers.npz")[0].x) == 800


def test_points_of_a_ply_keep_their_fields(tmp_path: Path) -> None:
    rows = "\n".join(f"{a:.4f} {b:.4f} {c:.4f} {d}" for (a, b, c), d in zip(BALL, T, strict=True))
    head = f"ply\nformat ascii 1.0\nelement vertex {len(BALL)}\n" + "".join(f"property float {n}\n" for n in "xyzT")
    (tmp_path / "a.ply").write_text(f"{head}end_header\n{rows}\n")
    points = read_points(tmp_path / "a.ply", ())
    np.testing.assert_allclose(points.x, BALL, atol=1e-5)
    np.testing.assert_allclose(points.fields["T"], T)
