"""The user's own metals and nozzles: tables of a scene, and tables of the file that the key `library` names."""

from collections.abc import Mapping
from pathlib import Path

from ..files.inputs import InputError, read_toml, similar

KINDS = ("materials", "nozzles")


def with_library(raw: dict[str, object], source: str) -> list[str]:
    """Replace the key `library` of a scene by the tables [materials.NAME] and [nozzles.NAME] of the file that the key
    names. If the scene has a table of the same name, the table of the scene remains. raw: the scene as nested dicts, changed in place;
    source: file of the scene, whose folder is the base of relative names. Returns the problems."""
    name, problems = raw.pop("library", None), []
    given: list[Mapping[str, object]] = [raw]
    if isinstance(name, str) and "\0" not in name:
        path = Path(source).parent / Path(name).expanduser()
        try:
            given = [read_toml(path), raw]
        except InputError as error:
            problems.append(f"library = {name[:80]!r}: the file {error.reason}{similar(path)}")
    elif name is not None:
        problems.append('library: expected the name of a TOML file, such as "my_metals.toml"')
    for kind in KINDS:
        merged: dict[str, object] = {}
        for tables in (each.get(kind, {}) for each in given):
            if isinstance(tables, dict) and all(isinstance(table, Mapping) for table in tables.values()):
                merged |= tables
            else:
                problems.append(f"{kind}: expected tables, such as [{kind}.Mine]")
        raw[kind] = merged
    return problems
