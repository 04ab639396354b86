"""Metals and nozzles of the user's own: from a csv table of others into a library, from the library into scenes."""

import json
from pathlib import Path

import pytest

from coupler import Scene
from coupler.commands import main as cli
from coupler.errors import SceneError
from coupler.physics import materials
from coupler.studies.sweep import Sweep

HEAD = "name,A,B,n,C,m,T_melt,rho,E,nu,source"
ROW = "Al 6061-T6,324,114,0.42,0.002,1.34,855,2703,70,0.33,Lesuer (2001) – Børvik"
SCENE = {
    "particle": {"material": "Al_6061-T6", "diameter": "25 um"},
    "substrate": {"material": "Ni", "diameter": "150 um", "height": "75 um"},
    "gas": {"pressure": "20 bar", "temperature": "300 degC", "nozzle": "Mine"},
}
NOZZLE = '[nozzles.Mine]\ninlet = "8 mm"\nthroat = "2 mm"\nexit = "6 mm"\nconverging = "30 mm"\ndiverging = "100 mm"\n'


def imported(tmp_path: Path, *lines: str) -> int:
    (tmp_path / "table.csv").write_text("\n".join(lines), encoding="utf-8")
    return cli.main(["materials", "--import", str(tmp_path / "table.csv"), "--out", str(tmp_path / "mine.toml")])


def scene_of(tmp_path: Path) -> Path:
    """A scene that names the library, in a folder beside it."""
    (tmp_path / "scenes").mkdir()
    path = tmp_path / "scenes" / "scene.toml"
    lines = [f"{key} = {json.dumps(value)}" for key, value in (("library", "../mine.toml"),)]
    for name, table in SCENE.items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_row_becomes_a_metal_of_scenes(tmp_path, capsys):
    """The numbers of the row in SI, and the flow stress that Johnson & Cook's formula gives for these."""
    assert imported(tmp_path, HEAD, ROW) == 0
    said = capsys.readouterr().out
    (tmp_path / "mine.toml").write_text((tmp_path / "mine.toml").read_text() + NOZZLE)
    scene = Scene.load(scene_of(tmp_path))
    metal = scene.derived.material("Al_6061-T6")
    assert (metal.rho, metal.T_m, metal.E, metal.nu) == pytest.approx((2703.0, 855.0, 70e9, 0.33))
    assert metal.flow_stress(0.2, 1.0, 298.0) == pytest.approx(324e6 + 114e6 * 0.2**0.42)
    assert metal.cp == materials.material("Al").cp
    assert "cp and k from Al, the metal of the library nearest in density" in said
    assert "cp and k from Al" in metal.note
    assert metal.source.startswith("Lesuer (2001)")


def test_heat_data_of_a_metal_come_from_a_metal(tmp_path, capsys):
    """Also if a ceramic (Al2O3, 3900 kg/m3) is nearer in density."""
    assert imported(tmp_path, HEAD, ROW.replace("2703", "3900")) == 0
    assert "cp and k from Ti6Al4V, the metal of the library" in capsys.readouterr().out


def test_units_stand_in_the_head_or_follow_from_the_size(tmp_path):
    """A flow stress of some 1 MPa to 10 GPa is below 1e5 in MPa and above in Pa; a modulus likewise in GPa, MPa and Pa."""
    texts = [row for row in (ROW, ROW.replace("324,114", "3.24e8,1.14e8"), ROW.replace(",70,", ",70e9,"))]
    assert imported(tmp_path, HEAD, *(f"M{i}{text}" for i, text in enumerate(texts))) == 0
    same = materials.from_scene(tables_of(tmp_path))[0]
    assert len({(m.strength["A"], m.strength["B"], round(m.E)) for name, m in same.items() if "6061-T6" in name}) == 1
    head = HEAD.replace("A,B", "A [GPa],B (MPa)").replace(",", ";")
    assert imported(tmp_path, head, ROW.replace("324", "0.324").replace(",", ";").replace(".", ",")) == 0
    assert materials.from_scene(tables_of(tmp_path))[0]["Al_6061-T6"].strength["A"] == pytest.approx(324e6)


def tables_of(tmp_path: Path) -> dict[str, dict[str, object]]:
    import tomllib

    return tomllib.loads((tmp_path / "mine.toml").read_text())["materials"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("0.002", "-0.002", "row 3 (X), column C: is outside 0 to 1"),
        ("855", "100", "row 3 (X), column T_melt: is outside 200 K to 5000 K"),
        ("114", "", "row 3 (X), column B: is empty"),
        (",me", ",", "row 3 (X), column source: is empty"),
        ("0.33", "soft", "row 3 (X), column nu: must be a plain number"),
        ("X", "Al 6061-T6", "row 3 (Al_6061-T6), column name: is already used in another row"),
        ("0.42", "0,42", "row 3 (X), column source: is followed by more cells: with decimal commas, separate"),
    ],
)
def test_a_fault_names_its_row_and_column(tmp_path, capsys, old, new, says):
    row = "X,324,114,0.42,0.002,1.34,855,2703,70,0.33,me"
    assert imported(tmp_path, HEAD, ROW, row.replace(old, new)) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "mine.toml").exists()


def test_a_table_without_its_columns_is_refused(tmp_path, capsys):
    assert imported(tmp_path, HEAD.replace(",nu", ""), ROW) == 2
    assert "row 1: the columns nu are missing; needed: name, A, B" in capsys.readouterr().err
    assert imported(tmp_path, HEAD) == 2
    assert "has no rows" in capsys.readouterr().err
    assert imported(tmp_path, HEAD, ROW.replace("Lesuer", "L" * 200_000)) == 2
    assert "the file is not a CSV table: field larger than field limit" in capsys.readouterr().err


def test_a_run_holds_what_it_uses_of_the_library(tmp_path):
    """Its scene.toml names no library, has the metal and the nozzle that are used, no others, and reads the same anywhere."""
    assert imported(tmp_path, HEAD, ROW, ROW.replace("Al 6061", "Other")) == 0
    (tmp_path / "mine.toml").write_text((tmp_path / "mine.toml").read_text() + NOZZLE)
    scene = Scene.load(scene_of(tmp_path))
    text = scene.to_toml()
    assert Scene.from_text(text, "elsewhere/scene") == scene
    assert (list(scene.materials), list(scene.nozzles)) == (["Al_6061-T6"], ["Mine"])
    assert "library =" not in text
    assert "Other" not in text


def test_the_scene_has_precedence_over_its_library(tmp_path):
    assert imported(tmp_path, HEAD, ROW) == 0
    own = {"base": "Al", "A": "100 MPa"}
    data = {
        **SCENE,
        "library": "mine.toml",
        "materials": {"Al_6061-T6": own},
        "particle": SCENE["particle"] | {"velocity": "500 m/s"},
    }
    del data["gas"]
    assert Scene.from_dict(data, str(tmp_path / "scene")).derived.material("Al_6061-T6").strength["A"] == 100e6


def test_points_of_a_sweep_name_metals_of_the_library(tmp_path):
    assert imported(tmp_path, HEAD, ROW, ROW.replace("Al 6061", "Other")) == 0
    (tmp_path / "mine.toml").write_text((tmp_path / "mine.toml").read_text() + NOZZLE)
    data = {"scene": {"library": "mine.toml", **SCENE}, "points": {"material": ["Al_6061-T6", "Other-T6", "Ni"]}}
    sweep = Sweep.from_dict(data, str(tmp_path / "sweep.toml"))
    assert (len(sweep.points), sweep.refused) == (3, {})


@pytest.mark.parametrize(
    ("library", "says"),
    [("mime.toml", "library = 'mime.toml': the file is missing (did you mean \"mine.toml\"?)"), (3, "library: expected the name")],
)  # fmt: skip
def test_a_library_that_is_not_there(tmp_path, library, says):
    assert imported(tmp_path, HEAD, ROW) == 0
    with pytest.raises(SceneError) as caught:
        Scene.from_dict({"library": library, **SCENE}, str(tmp_path / "scene"))
    assert any(says in problem for problem in caught.value.problems)


def test_a_scene_without_a_text_keeps_its_strength():
    """A scene made of nested dicts has no text of its own: what is written for its run must read as an equal scene."""
    data = {
        **SCENE,
        "strength": "steinberg_guinan",
        "particle": {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"},
    }
    del data["gas"]
    scene = Scene.from_dict(data)
    assert Scene.from_text(scene.to_toml()) == scene
