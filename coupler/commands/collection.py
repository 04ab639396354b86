"""Import of metals from a CSV table into a library for scenes: `coldspray materials --import`."""

import csv
import io
import json
import re
import unicodedata
from collections.abc import Mapping
from pathlib import Path

from ..errors import SceneError
from ..files.inputs import read_text
from ..files.outputs import MARK, claim_file, write_text

COLUMNS = ("name", "A", "B", "n", "C", "m", "T_melt", "rho", "E", "nu", "source")  # required
_OTHER_NAMES = {"T_melt": "T_m", "eps0_dot": "eps_dot_0"}  # column -> name of the parameter
_TEXTS = ("name", "source", "note")
_USUAL = {"law": "johnson_cook", "eps_dot_0": "1 1/s", "T_ref": "298 K", "s": 0.0, "Gamma0": 0.0}  # defaults
_HEAD = re.compile(r"([^\s(\[]+)\s*(?:[(\[]([^])]*)[])])?")
_UNSAFE = re.compile(r"[^A-Za-z0-9_.,:;/()=&+ -]+")


def write_library(table: Path, out: Path, force: bool) -> list[str]:
    """Write the metals of a CSV table into a TOML file. Returns text lines about the metals. Raises SceneError with all problems, by
    row and column."""
    claim_file(out, (".toml",), [table], force)
    try:
        tables, lines = _read(read_text(table), str(table))
    except csv.Error as error:
        raise SceneError([f"the file is not a CSV table: {error}"], str(table)) from None
    key = f"library = {json.dumps(out.name)}"
    text = f"# {MARK} materials --import {table.name}\n# to use this library, write before the first table of a scene: {key}\n"
    for name, values in tables.items():
        text += f"\n[materials.{json.dumps(name)}]\n"
        text += "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items())
    write_text(out, text)
    return [*lines, f"written to {out}; to use this library, write before the first table of a scene: {key}"]


def _read(text: str, file: str) -> tuple[dict[str, Mapping[str, object]], list[str]]:
    """Convert a CSV text to tables of a library (name -> values), and text lines about them."""
    from ..physics.materials import UNITS, from_scene

    separator = max(",;\t", key=text.partition("\n")[0].count)
    reader = csv.DictReader(io.StringIO(text), delimiter=separator)
    columns = {title: match.groups() for title in reader.fieldnames or () if (match := _HEAD.match(title.strip()))}
    if lacks := [name for name in COLUMNS if name not in {name for name, _ in columns.values()}]:
        raise SceneError([f"row 1: the columns {', '.join(lacks)} are missing; needed: {', '.join(COLUMNS)}"], file)
    known = {title: head for title, head in columns.items() if _OTHER_NAMES.get(head[0], head[0]) in {*UNITS, *_TEXTS}}
    lines = [f"column left out: {title}" for title in columns if title not in known]
    tables: dict[str, Mapping[str, object]] = {}
    problems: list[str] = []
    for row in reader:
        cells = {name: (cell, unit) for title, (name, unit) in known.items() if (cell := (row[title] or "").strip())}
        if not cells:
            continue
        found = [f"{name} is empty: give a value" for name in COLUMNS if name not in cells]
        if None in row:
            found = [f"{COLUMNS[-1]} is followed by more cells: with decimal commas, separate the cells by semicolons"]
        values = {_OTHER_NAMES.get(name, name): _value(name, *cell, separator == ";") for name, cell in cells.items()}
        name = str(values.pop("name", "")).replace(" ", "_")
        if name in tables:
            found.append("name is already used in another row: give each metal its own name")
        if not found:
            values, remark = _with_heat(name, _USUAL | values)
            catalogue, texts = from_scene({name: values})
            found = [text.partition(": ")[2] for text in texts]
            # problems of the given columns come first: others may only follow from them
            found = [text for text in found if text.split()[0] in values] or found
            if not found:
                metal, law = catalogue[name], catalogue[name].strength
                stress = f"flow stress {metal.flow_stress(0.2, 1e3, 300.0) / 1e6:.0f} MPa at strain 0.2, 1e3 1/s, 300 K"
                elastic = f"E {metal.E / 1e9:.4g} GPa, melting {metal.T_m:g} K"
                constants = f"A {law['A'] / 1e6:g} MPa, B {law['B'] / 1e6:g} MPa, {elastic}, {stress}"
                lines.append(f"{metal.name}: {constants}" + (f"; {remark}" if remark else ""))
        tables[name] = values
        for key, _, problem in (text.partition(" ") for text in found):
            column = next((title for title, other in _OTHER_NAMES.items() if other == key), key)
            problems.append(f"row {reader.line_num} ({name[:40]}), column {column}: {problem}")
    if problems or not tables:
        raise SceneError(problems or ["the table has no rows: give a row for each metal"], file)
    return tables, lines


def _value(name: str, cell: str, unit: str | None, comma: bool) -> object:
    """Convert a cell of column `name` to a value of a scene. unit: unit in the column heading; None: the usual unit, where the
    magnitude of a stress or modulus decides between Pa, MPa and GPa. comma: whether the number has a decimal comma."""
    from ..physics.materials import UNITS

    if name in _TEXTS:
        plain = unicodedata.normalize("NFKD", cell).encode("ascii", "ignore").decode()
        return _UNSAFE.sub(" ", plain)[:600]
    text = cell.replace(",", ".") if comma else cell
    try:
        number = float(text)
    except ValueError:
        return cell
    usual = UNITS[_OTHER_NAMES.get(name, name)]
    if usual == "MPa":
        usual = "MPa" if number < 1e5 else "Pa"
    elif usual == "GPa":
        usual = "GPa" if number < 1e3 else "MPa" if number < 1e6 else "Pa"
    return f"{text} {unit or usual}" if unit or usual else number


def _with_heat(name: str, values: dict[str, object]) -> tuple[dict[str, object], str]:
    """The table of a metal, completed with heat capacity and conductivity, and a remark. Missing values come from the metal of
    the library with the nearest density."""
    from ..physics import materials

    usual: dict[str, object] = {"cp": "500 J/(kg K)", "k": "50 W/(m K)"}
    lacks = {key: text for key, text in usual.items() if key not in values}
    catalogue, problems = materials.from_scene({name: lacks | values})
    if not lacks or problems:
        return lacks | values, ""
    rho = catalogue[name].rho
    library = (materials.material(other) for other in materials.names())
    near = min((m for m in library if not (m.is_ceramic or m.is_polymer)), key=lambda metal: abs(metal.rho - rho))
    numbers = {"cp": f"{near.cp_at(300.0):g} J/(kg K)", "k": f"{near.k_at(300.0):g} W/(m K)"}
    remark = f"{' and '.join(lacks)} from {near.name}, the metal of the library nearest in density"
    note = "; ".join(str(text) for text in (values.get("note"), remark) if text)
    return {**values, **{key: numbers[key] for key in lacks}, "note": note}, remark
