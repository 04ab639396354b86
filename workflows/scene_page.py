"""Writes docs/guide/scene.md, a scene key by key, from the models that read scenes: python workflows/scene_page.py [FILE]

Types, units, limits and defaults are those of the models; the descriptions are in coupler/scene/words.toml. `make docs` runs it first.
"""

import dataclasses
import sys
import types
import typing
from pathlib import Path
from typing import Any

from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from coupler import units
from coupler.physics import materials
from coupler.physics.strength import LAWS, Parameter
from coupler.plan import cost as estimates
from coupler.plan.reading import Scene
from coupler.scene.json_schema import words
from coupler.scene.tables import Quantity, Section
from coupler.spray import nozzles

PAGE = Path(__file__).parents[1] / "docs" / "guide" / "scene.md"
DEFAULTS = {  # numbers of the plan, in words
    "preset": ": points of the particle, " + ", ".join(f"{n} for `{p}`" for p, n in estimates.PRESETS.items()),
    "substrate.window": f"; {estimates.WINDOW_OVER_DIAMETER:g} diameters from {estimates.MANY} particles on, else the whole target",
    "resolution.element_size": f"; {estimates.ELEMENT_SIZE_OVER_SPACING} spacings by default",
}
EXAMPLE = """```toml
[particle]
material = "MyAlloy"
diameter = "25 um"
velocity = "600 m/s"

[materials.MyAlloy]
rho = "8190 kg/m3"
G = "77 GPa"
c0 = "4500 m/s"
s = 1.5                            # a number without a unit stands without quotes
Gamma0 = 1.8
T_m = "1600 K"
T_ref = "293 K"                    # at which the yield stress is A
cp = "435 J/(kg K)"                # constant; or [["300 K", "435 J/(kg K)"], ["1073 K", "580 J/(kg K)"]]
k = "11 W/(m K)"
A = "980 MPa"                      # Johnson-Cook
B = "1370 MPa"
n = 0.16
C = 0.02
m = 1.03
eps_dot_0 = "1 1/s"
source = "an example, not a measurement"
```"""


def main(path: Path = PAGE) -> None:
    """Write the page."""
    path.write_text(page(), encoding="utf-8")


def page() -> str:
    """The page as Markdown."""
    known = "; ".join(f"{name} `{'` `'.join(known)}`" for name, known in _units())
    lines = [
        f"""# A scene, key by key

<!-- written by workflows/scene_page.py from coupler/scene/tables.py and words.toml: change those -->

A scene is a TOML file. Values with a unit are texts, `"25 um"`, in any unit of the same dimension. The `scene.toml` of a run
holds every default written out.

Units: {known}.
"""
    ]
    top, tables = [], []
    for name, info in Scene.model_fields.items():
        key, model = info.alias or name, _section(info.annotation)
        if model is not None:
            tables.append((key, model))
        elif name not in ("materials", "nozzles"):
            top.append((key, info))
    lines += ["## Before the first table", "", *_table("", top)]
    for key, model in tables:
        lines += [f"## `[{key}]`", "", words(f"{key}.about"), ""]
        lines += _table(f"{key}.", [(info.alias or name, info) for name, info in model.model_fields.items()])
    own = f"A material of your own, or numbers changed of one of the library ({', '.join(materials.names())})."
    lines += ["## `[materials.NAME]`", "", own, "", *EXAMPLE.splitlines(), "",
              *_plain(materials.Material, materials.DEFAULTS, lambda k: materials.UNITS.get(k, "")), *_laws()]  # fmt: skip
    own = f"A nozzle of your own; the library has {', '.join(nozzles.library())} ([gas](gas.md))."
    lines += ["## `[nozzles.NAME]`", "", own, "",
              *_plain(nozzles.Nozzle, nozzles._DEFAULTS, lambda name: "mm" if name in nozzles._LIMITS else "")]  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"


def missing_words() -> list[str]:
    """Keys of a scene that have no words."""
    keys = []
    for name, info in Scene.model_fields.items():
        model = _section(info.annotation)
        above = info.alias or name
        keys += [f"{above}.{key}" for key in model.model_fields] if model else [above]
    keys = [key for key in keys if not words(key) and key not in ("materials", "nozzles")]
    for kind in (materials.Material, nozzles.Nozzle):
        own = (f"{kind.__name__.lower()}.{field.name}" for field in dataclasses.fields(kind) if field.name != "name")
        keys += [key for key in own if not words(key)]
    return keys


def _table(above: str, fields: list[tuple[str, FieldInfo]]) -> list[str]:
    lines = ["| key | values | default | |", "|---|---|---|---|"]
    for key, info in fields:
        default = "" if key == "name" else _default(info)
        lines.append(f"| `{key}` | {_takes(info)} | {default} | {words(above + key)}{DEFAULTS.get(above + key, '')} |")
    return [*lines, ""]


def _plain(kind: Any, defaults: dict[str, Any], unit_of: Any) -> list[str]:
    lines = ["| key | unit | default | |", "|---|---|---|---|"]
    for field in dataclasses.fields(kind):
        if field.name != "name":
            default = defaults.get(field.name, "needed")
            default = default[0][1] if isinstance(default, tuple) else default
            shown = "" if default in (None, "") else f"{default:g}" if isinstance(default, float) else default
            lines.append(
                f"| `{field.name}` | {unit_of(field.name)} | {shown} | {words(f'{kind.__name__.lower()}.{field.name}')} |"
            )
    return [*lines, ""]


def _laws() -> list[str]:
    """The keys of a strength law, in the table of its material: key, unit and default in brackets, meaning."""
    texts = {name: [_parameter(key, p) for key, p in law.parameters.items()] for name, law in LAWS.items()}
    *_, last = texts.values()
    shared = [text for text in last if all(text in own for name, own in texts.items() if name != "johnson_cook")]
    lines = ["Keys of its strength law, in the same table (needed unless a default is given):", ""]
    names = ", ".join(f"`{name}`" for name in LAWS)
    lines += [f"- `law`: {names}; {words('law.law')}", f"- `fitted`: {words('law.fitted')}"]
    lines += [f"- `{name}`: {'; '.join(text for text in own if text not in shared)}." for name, own in texts.items()]
    lines.append(f"- all but `johnson_cook`: {'; '.join(shared)}.")
    return [*lines, ""]


def _parameter(key: str, parameter: Parameter) -> str:
    default = "" if parameter.default is None else f"default {parameter.default:g}"
    about = ", ".join(text for text in (parameter.unit, default) if text)
    return f"`{key}`{f' ({about})' if about else ''} {parameter.about}"


def _units() -> list[tuple[str, list[str]]]:
    used = {units.dimension_of(q.unit) for q in _quantities(Scene)}
    return [(name, list(known)) for name, (_, known) in units._DIMENSIONS.items() if name in used]


def _quantities(model: type) -> list[Quantity]:
    quantities: list[Quantity] = []
    for info in model.model_fields.values():  # type: ignore[attr-defined]
        inner, own = _section(info.annotation), _quantity(info)
        quantities += _quantities(inner) if inner else [own] if own else []
    return quantities


def _section(annotation: Any) -> type[Section] | None:
    """The model of a table, also of a list of tables or an optional one."""
    for kind in (annotation, *typing.get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, Section):
            return kind
    return None


def _quantity(info: FieldInfo) -> Quantity | None:
    """The unit and limits of a field, of each item of a tuple too, and of one that hangs on the size."""
    inner = [item for arg in typing.get_args(info.annotation) for item in getattr(arg, "__metadata__", ())]
    for item in (*info.metadata, *inner):
        quantity = getattr(item, "of", item)
        if isinstance(quantity, Quantity):
            return quantity
    return None


def _takes(info: FieldInfo) -> str:
    quantity = _quantity(info)
    if quantity is not None:
        text = f"{quantity.low} to {quantity.high}"
        several = "or pairs" if any(hasattr(item, "of") for item in info.metadata) else ""
        two = "two of " if typing.get_origin(info.annotation) is tuple and not several else ""
        return f"{two}{text}{', ' + several if several else ''}"
    words = _kinds(info.annotation)
    limits = [
        f"{sign} {_written(getattr(item, name), None)}"
        for item in info.metadata
        for kind, name, sign in ((Ge, "ge", "from"), (Gt, "gt", "above"), (Le, "le", "to"), (Lt, "lt", "below"))
        if isinstance(item, kind)
    ]
    return " ".join([words, *limits])


def _kinds(annotation: Any) -> str:
    origin = typing.get_origin(annotation)
    if origin is typing.Literal:
        return " ".join(f"`{value}`" for value in typing.get_args(annotation))
    if origin in (typing.Union, types.UnionType):
        kinds = [_kinds(kind) for kind in typing.get_args(annotation) if kind is not type(None)]
        return " or ".join(dict.fromkeys(kinds))
    if origin is typing.Annotated:
        return _kinds(typing.get_args(annotation)[0])
    if origin is list:
        return "a list of texts"
    if origin is tuple:
        return "tables" if _section(annotation) else "a list of texts"
    if origin is dict:
        return "a table"
    return {str: "a text", float: "a number", int: "a whole number", bool: "`true` `false`"}[annotation]


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "needed"
    value = info.get_default(call_default_factory=True)
    quantity = _quantity(info)
    if value is None or value is PydanticUndefined:
        return ""
    if isinstance(value, tuple):
        return ", ".join(f"`{_written(item, quantity)}`" for item in value)
    if isinstance(value, dict):
        return "`{ " + ", ".join(f"{name} = {item:g}" for name, item in value.items()) + " }`"
    return f"`{_written(value, quantity)}`"


def _written(value: Any, quantity: Quantity | None) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if quantity is not None:
        return units.rounded(value, quantity.unit, 8)
    return f"{value:g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
