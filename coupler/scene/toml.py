"""A scene as TOML text: with its default values, with the comments of its file, with keys that are set on the command line."""

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.container import Container
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Array, Comment, InlineTable, Table, Whitespace

from .. import units
from .model import SceneData
from .values import BySize, Quantity, Section

# (key such as "particle[2].velocity", its value as text; None removes the key)
Settings = Sequence[tuple[str, str | None]]

_STEP = re.compile(r'("[^"]+"|[A-Za-z0-9_-]+)(?:\[(\d+)\])?(?:\.|$)')
_NAMES_OF_FILES = ("file", "files", "sizes", "distribution")
_DERIVED = re.compile(r"^# \w+ = .*\(from: .*\)\n", re.MULTILINE)  # written by `to_toml` below


def to_toml(scene: SceneData, derived: Callable[[str, Section], Mapping[str, str]]) -> str:
    """The scene as TOML with its default values. derived(heading, table): values of fields that the table does not have, by name; the
    text has them as comments."""
    lines = [f'name = "{scene.name}"', f'preset = "{scene.preset}"', f"effects = {_text_of(scene.effects)}"]
    lines += [f'strength = "{scene.strength}"'] if scene.strength else []
    head = "[particle]" if len(scene.particles) == 1 else "[[particle]]"
    tables: list[tuple[str, Section]] = [(head, particle) for particle in scene.particles]
    tables += [(f"[{name}]", table) for name, table in scene if isinstance(table, Section)]
    for head, table in tables:
        lines += ["", head]
        if head == "[gas]":
            lines.append("# has no effect while the particle has velocity and temperature: delete these to use [gas]")
        if head == "[coating]":
            lines.append(
                "# has no effect while there are tables [[particle]], made from it: delete these to use [coating]"
            )
        defaults = derived(head, table)
        for field, value in table:
            if value is not None:
                lines.append(f"{field} = {_written(table, field, value)}")
            elif field in defaults:
                lines.append(f"# {field} = {defaults[field]}")
    for kind in ("materials", "nozzles"):
        for name, fields in dict(scene)[kind].items():
            lines += ["", f"[{kind}.{_text_of(name)}]"]
            lines += [f"{_text_of(field)} = {_text_of(value)}" for field, value in fields.items()]
    return "\n".join(lines) + "\n"


def completed(text: str, full: str) -> str:
    """The text of a scene, in its order and with its comments, together with all keys and comments of `full` that it lacks. The key
    `library` is left out, and names of files are those of `full`, which are absolute."""
    document = tomlkit.parse(_DERIVED.sub("", text))
    document.pop("library", None)
    _fill(document, tomlkit.parse(full))
    return re.sub(r"\n{3,}", "\n\n", document.as_string())


def _fill(own: Container, full: Container) -> None:
    """Add missing keys and comments to a table, before the empty lines at its end."""
    spaces = []
    while own.body and isinstance(own.body[-1][1], Whitespace):
        spaces.append(own.body.pop())
    said = {item.as_string().strip() for _, item in own.body if isinstance(item, Comment)}
    for key, item in full.body:
        if key is None:
            if isinstance(item, Comment) and item.as_string().strip() not in said:
                own.add(tomlkit.comment(item.as_string().strip().removeprefix("# ")))
        elif key.key not in own:
            if isinstance(item, Table | AoT):
                own.add(tomlkit.nl())
            own.append(key.key, item)
        elif _is_file(key.key, item):
            own[key.key] = item
        elif isinstance(item, Table) and isinstance(own[key.key], Table):
            _fill(own[key.key].value, item.value)
        elif isinstance(item, Table | InlineTable) and isinstance(mine := own[key.key], Table | InlineTable):
            mine.update({name: value for name, value in item.items() if _is_file(name, value)})
        elif isinstance(item, AoT) and isinstance(own[key.key], AoT):
            for each, whole in zip(own[key.key].body, item.body, strict=True):
                _fill(each.value, whole.value)
        elif isinstance(item, Array) and isinstance(own[key.key], AoT):
            for each, whole in zip(own[key.key].body, item, strict=True):
                each.update({name: value for name, value in whole.items() if _is_file(name, value)})
    own.body.extend(reversed(spaces))


def _is_file(key: str, value: object) -> bool:
    return key in _NAMES_OF_FILES and isinstance(value, str) and Path(value).is_absolute()


def changed(text: str, settings: Settings) -> str:
    """The TOML text of a scene with keys changed as by `--set`. The rest of the text, with its comments, does not change.

    Raises ValueError with the reason for a key that cannot be set.
    """
    document = tomlkit.parse(text)
    for key, value in settings:
        try:
            set_key(document, key, None if value is None else _value(value))
        except ValueError as error:
            raise ValueError(f"--set {error}") from None
    written, meant = document.as_string(), document.unwrap()
    # in a file with dotted keys tomlkit can write a plain key into the wrong table
    return written if tomllib.loads(written) == meant else tomlkit.dumps(meant)


def texts(text: str, keys: Iterable[str]) -> dict[str, str]:
    """The values of keys such as "particle.velocity" in a TOML text, in the form that `changed` accepts. Keys that are not in the
    text are left out."""
    document, found = tomlkit.parse(text), {}
    for key in keys:
        item: Any = document
        for name, number in _STEP.findall(key):
            item = item.get(name) if isinstance(item, Mapping) else None
            item = item[int(number) - 1] if number and isinstance(item, list) else item
        if item is not None:
            found[key] = str(item) if isinstance(item, str) else tomlkit.item(item).as_string().strip()
    return found


def toml_text(tables: Mapping[str, object]) -> str:
    """Nested dicts as TOML."""
    return tomlkit.dumps(tables)


def set_key(table: Any, key: str, value: object) -> None:
    """Set a key such as "particle[2].velocity" of a scene, which is nested dicts or a document of tomlkit. value: None removes the key.

    Raises ValueError with the reason for a key that cannot be set.
    """
    steps = _STEP.findall(key)
    if not steps or "".join(m[0] for m in _STEP.finditer(key)) != key or key.endswith("."):
        raise ValueError(
            f'{key}: not a key of a scene; a key is for example particle.velocity or "particle[2].velocity"'
        )
    for name, number in steps[:-1]:
        name = name.strip('"')
        if name not in table:
            if value is None:
                return
            table[name] = {}
        table, at = table[name], int(number or 1)
        if isinstance(table, list):
            if not ((number or len(table) == 1) and 1 <= at <= len(table)):
                raise ValueError(
                    f'{key}: the scene has {len(table)} tables [[{name}]]: name one of them, such as "{name}[1]"'
                )
            table, at = table[at - 1], 1
        if at != 1 or not isinstance(table, dict):
            raise ValueError(f"{key}: the scene has no table {name}[{at}]" if at != 1 else f"{key}: {name} is no table")
    name, number = steps[-1][0].strip('"'), int(steps[-1][1] or 0)
    if number:  # an entry of a list, such as particle.offset[1]
        entries = table.get(name)
        if (
            value is None
            or not isinstance(entries, list)
            or number > len(entries)
            or isinstance(entries[number - 1], dict)
        ):
            raise ValueError(
                f"{key}: not a key of a scene; a key is for example particle.velocity or particle.offset[1]"
            )
        table[name] = [*entries[: number - 1], value, *entries[number:]]
    elif value is None:
        table.pop(name, None)
    else:
        table[name] = value


def _value(text: str) -> Any:
    """A TOML value from text; any other text is a string, because shells remove quotation marks."""
    try:
        return tomlkit.value(text.strip())
    except (TOMLKitError, ValueError, RecursionError):
        return tomlkit.string(text)


def _text_of(value: Any) -> str:
    """A text, number, list or dict as a TOML value."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_text_of(name)} = {_text_of(item)}" for name, item in value.items()) + " }"
    return json.dumps(value, ensure_ascii=False)


def _inline(table: Section) -> str:
    said = [f"{field} = {_written(table, field, value)}" for field, value in table if value is not None]
    return f"{{ {', '.join(said)} }}"


def _written(table: Section, field: str, value: Any) -> str:
    kind = next((m for m in type(table).model_fields[field].metadata if isinstance(m, BySize | Quantity)), None)
    if isinstance(kind, BySize):
        pairs = [[units.show(size, "um"), units.show(number, kind.of.unit)] for size, number in value]
        return _text_of(pairs[0][1] if len(value) == 1 and value[0][0] == 0.0 else pairs)
    if isinstance(value, Section):
        return _inline(value)
    if isinstance(value, dict):
        return _text_of(value)
    if field in ("pair", "powder", "layer"):
        return f"[{', '.join(_inline(row) for row in value)}]"
    if field in ("offset", "sizes") and isinstance(value, tuple):
        return _text_of([units.show(x, "um") for x in value])
    if field == "threshold" and dict(table).get("criterion") == "pressure":
        return _text_of(units.show(value, "MPa"))
    return _text_of(units.show(value, kind.unit) if kind else value)
