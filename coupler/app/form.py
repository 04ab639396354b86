"""A form for the keys of a scene or a job. The fields are made from the JSON schema; the program's own reader checks the values."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from nicegui import ui

from ..files.inputs import parse_toml
from ..physics import materials
from ..scene.toml import changed, texts
from ..spray import nozzles

Entries = Mapping[str, Mapping[str, Any]]
SLIDERS = {  # key -> least, greatest, step, unit
    "gas.pressure": (10, 70, 1, "bar"), "gas.temperature": (20, 1100, 10, "degC"), "gas.standoff": (10, 100, 5, "mm"),
}  # fmt: skip
_KEY = re.compile(r"[A-Za-z_]+(?:\[\d+\])?(?:\.[A-Za-z_]+)*")


def entries_of(schema: Mapping[str, Any]) -> Entries:
    """Return the schema entry of each key, such as "gas.pressure", of a scene or a job. The key `name` and the keys of the user's own
    metals and nozzles are left out."""
    found: dict[str, Mapping[str, Any]] = {}
    for name, entry in schema["properties"].items():
        table = schema["definitions"].get(str(entry.get("$ref", "")).rpartition("/")[2], entry)
        if "properties" in table:
            found |= {f"{name}.{key}": of_key for key, of_key in table["properties"].items()}
        elif name not in ("materials", "nozzles", "name"):
            found[name] = entry
    return found


def numbered(key: str, text: str) -> list[str]:
    """Return the keys of the form for a key of the schema. If the text has tables [[powder]], a key of a powder gives one key for each
    of them, such as "powder[2].material"; any other key is returned unchanged."""
    given = parse_toml(text).get("powder")
    if not (key.startswith("powder.") and isinstance(given, list)):
        return [key]
    return [key.replace("powder", f"powder[{k}]", 1) for k in range(1, len(given) + 1)]


def placed(problems: Iterable[str], keys: Iterable[str]) -> dict[str, str]:
    """Return the problems by key: each is under the key of `keys` with which it begins, or under "". Line breaks separate them."""
    known, found = set(keys), dict[str, str]()
    for problem in problems:
        match = _KEY.match(problem)
        key = match[0] if match and match[0] in known else ""
        found[key] = f"{found[key]}\n{problem}" if key in found else problem
    return found


class Form:
    """Fields for the keys of a TOML text. main: keys whose fields are always visible; the other fields are in a closed group for each
    table. on_change: function that is called after each change."""

    def __init__(self, text: str, entries: Entries, main: Sequence[str], on_change: Callable[[], Any]):
        self.text, self.on_change = text, on_change
        self.entries = entries = {field: entry for key, entry in entries.items() for field in numbered(key, text)}
        main = [field for key in main for field in numbered(key, text)]
        self.first = texts(text, entries)
        self.fields: dict[str, Any] = {}
        self._grid(main)
        rest = [key for key in entries if key not in main]
        for table in dict.fromkeys(key.partition(".")[0] if "." in key else "" for key in rest):
            keys = [key for key in rest if (key.partition(".")[0] if "." in key else "") == table]
            with ui.expansion(table or "general").classes("w-full border-t border-gray-400/40").props("dense"):
                self._grid(keys)

    def toml(self) -> str:
        """Return the text with the values of the fields. An empty field removes its key, and a table without keys is removed. Raises
        ValueError for a key that cannot be set."""
        now = {key: str(field.value or "").strip() for key, field in self.fields.items()}
        settings = [(k, now[k] or None) for k in now if now[k] != self.first.get(k, "")]
        gone = {k.partition(".")[0] for k, value in settings if value is None and "." in k and "[" not in k}
        settings += [(t, None) for t in gone if not any(now[k] for k in now if k.startswith(f"{t}."))]
        return changed(self.text, settings)

    def show(self, problems: Iterable[str]) -> str:
        """Show each problem at its field. Returns the problems that belong to no field."""
        found = placed(problems, self.fields)
        for key, field in self.fields.items():
            field.error = found.get(key)
        return found.get("", "")

    def _grid(self, keys: Sequence[str]) -> None:
        with ui.element("div").classes("grid grid-cols-1 sm:grid-cols-2 gap-x-4 gap-y-1 w-full"):
            for key in keys:
                with ui.element("div"):
                    self.fields[key] = self._field(key)

    def _field(self, key: str) -> Any:
        """Make the field of a key. Its help text is visible while the user edits the field. A key in SLIDERS also gets a slider."""
        entry, value, leaf = self.entries[key], self.first.get(key, ""), key.rpartition(".")[2]
        usual = str(default).lower() if isinstance(default := entry.get("default"), bool) else default
        choices = entry.get("enum") or (["true", "false"] if entry.get("type") == "boolean" else None)
        own = {"material": materials.names, "nozzle": lambda: [*nozzles.library()]}.get(leaf)
        label = f"{key.replace('.', ' ').replace('_', ' ')}"
        if own:
            options = list(dict.fromkeys([*own(), *([value] if value else [])]))
            field: Any = ui.select(
                options, label=label, value=value or None, with_input=True, new_value_mode="add-unique"
            )
        elif choices:
            empty = f"{usual} (default)" if usual is not None else "not set"
            field = ui.select({"": empty, **{item: str(item) for item in choices}}, label=label, value=value)
        else:
            field = ui.input(label, value=value, placeholder=str(usual) if usual is not None else "")
            field.props("debounce=300" + (" stack-label" if usual is not None else ""))
        words = str(entry.get("description", "")).replace("`", "").replace('"', "'")
        field.props(f'dense outlined hide-bottom-space hint="{words}" hide-hint').classes("w-full")
        field.on_value_change(self.on_change)
        if key in SLIDERS:
            least, most, step, unit = SLIDERS[key]
            number = re.match(r"[\d.]+", value)
            slider = ui.slider(min=least, max=most, step=step, value=float(number[0]) if number else least)
            slider.props("dense label").classes("w-full px-2")
            slider.on("update:model-value", lambda event: field.set_value(f"{event.args:g} {unit}"), throttle=0.3)
        return field
