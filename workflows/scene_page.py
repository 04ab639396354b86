"""Writes docs/guide/scene.md, a scene key by key, from the models that read scenes: python workflows/scene_page.py [FILE]

Types, units, limits and defaults are those of the models; the descriptions are here. `make docs` runs it first.
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
from coupler.physics.strength import LAWS
from coupler.plan import cost as estimates
from coupler.plan.reading import Scene
from coupler.scene.effects import NAMES
from coupler.scene.tables import Quantity, Section
from coupler.spray import nozzles

PAGE = Path(__file__).parents[1] / "docs" / "guide" / "scene.md"
WORDS = {
    "name": "of the run, and of its folder in `runs/`; the file's name by default",
    "preset": "how fine: points of the particle, " + ", ".join(f"{n} for `{p}`" for p, n in estimates.PRESETS.items()),
    "effects": '`"auto"`: those that the scene calls for; or a list of names, `"-name"` leaves one out of those before it'
    " ([effects](../theory/effects.md))",
    "strength": "strength set or law of all metals that name none under `[materials.NAME]`; the first set of each by default"
    " ([materials](materials.md))",
    "particle.material": "a name of the library or of `[materials.NAME]`",
    "particle.shape": "all shapes have the volume of a sphere of `diameter`",
    "particle.file": 'with `shape = "file"`: a closed surface (STL, PLY, OBJ), relative to the scene, scaled to `diameter`',
    "particle.diameter": "of the sphere of equal volume",
    "particle.velocity": "of impact; not needed with `[gas]`",
    "particle.angle": "of flight, from the surface normal, in the plane of x and z",
    "particle.tilt": "of the shape about y",
    "particle.temperature": "at impact, uniform",
    "particle.offset": "of the centre from the axis, x and y, at the start",
    "particle.gap": "of the lowest point above what lies under it at the start; half a spacing by default",
    "particle.dwell": "time until the next impact, in which heat flows; `auto`, as `[spray]` has it, by default",
    "particle.hardness": "of the powder, if it is harder than its metal as the strength set has it ([materials](materials.md))",
    "particle.yield_strength": "of the powder, instead of its hardness",
    "gas.kind": "of gas",
    "gas.pressure": "total, before the nozzle",
    "gas.temperature": "total, before the nozzle",
    "gas.nozzle": "a name of the library (`coldspray gas --list`) or of `[nozzles.NAME]`",
    "gas.standoff": "from the nozzle's exit to the target",
    "gas.ambient": "pressure around the jet",
    "gas.powder_temperature": "of the powder when it is fed",
    "gas.bow_shock": "whether a normal shock stops the jet before the target",
    "gas.drag": "the law of drag",
    "substrate.material": "a name of the library or of `[materials.NAME]`",
    "substrate.diameter": "of the cylinder",
    "substrate.height": "of the cylinder",
    "substrate.temperature": "at the start, uniform",
    "substrate.sides": "`absorbing` lets waves out, `free` and `fixed` send them back, `half_space` lets them out and has the"
    " static stiffness of the rest of a half-space ([target](../theory/target.md)); `half_space` by default with `[coating]`",
    "substrate.bottom": "as `sides`",
    "substrate.window": "radius round each impact within which the target is computed, the rest keeps still"
    f" ([sequences](sequences.md)); {estimates.WINDOW_OVER_DIAMETER:g} diameters from {estimates.MANY} particles on, and"
    " everything with fewer, by default",
    "contact.friction": "Coulomb's coefficient",
    "adhesion.kind": '`"tied"` by `"velocity"` where neither kind nor criterion is given; `"none"` where a metal has no `sigma_TS`',
    "adhesion.criterion": "which of the nodes in contact are bonded",
    "adhesion.threshold": "of plastic strain (a number), pressure (with unit) or velocity over the critical one (default 1)",
    "adhesion.strength": "in tension, of a cohesive bond",
    "adhesion.energy": "of fracture in tension, of a cohesive bond; 0 is brittle",
    "adhesion.shear_strength": "in shear; that in tension by default",
    "adhesion.shear_energy": "in shear; that in tension by default",
    "adhesion.pair": "tables `[[adhesion.pair]]`: `metals`, two names, and the strengths and energies between them where they differ",
    "splat.mass_scaling": "share of the next particle's mass that the elements with the shortest steps may be made heavier by; 0 for"
    " none ([sequences](sequences.md))",
    "splat.method": "where the surface of a finished splat comes from ([splats](../theory/splats.md))",
    "splat.element_size": "edges of a splat's elements; the target's smallest by default",
    "resolution.spacing": "of the particle's points; by the preset by default",
    "resolution.element_size": f"smallest edges of the target's elements; {estimates.ELEMENT_SIZE_OVER_SPACING} spacings by default",
    "resolution.growth": "of the edges, for each unit of distance from the impact",
    "resolution.engine": "of the particle's internal forces: the enriched scheme, or MACHDYN's in compiled passes or by LAMMPS"
    " ([particle](../theory/particle.md))",
    "want.measures": "keys of `summary.json` with a band, and `verdict`; all by default. What none of them needs is left out"
    " ([budget](accuracy.md))",
    "want.accuracy": "share of the value, for discretisation and omitted effects together: 0.05, 0.02 and 0.01 by default, by preset",
    "end.at": '`"rest"` for one particle (unless `[want]` needs no rest) and `"cold"` for several, unless `at` or `time` is there;'
    ' `"greatest"` is the greatest deformation; `"cold"`: at rest, and after the last impact all cools to `ambient`',
    "end.ambient": "temperature of the closing stage",
    "spray.feed_rate": "of powder",
    "spray.spot": "diameter of the circle that the powder falls on, evenly",
    "spray.traverse_speed": "of the gun over the target",
    "spray.efficiency": "share of the powder that the scene's particles stand for",
    "spray.heat_transfer": "of the jet on the surface between impacts; none by default",
    "spray.gas_temperature": "of the jet at the surface; the total temperature of `[gas]` by default",
    "end.time": "after the start of each impact; with `at`, whichever comes first",
    "output.every": "simulated time between two written steps; diameter / velocity / 25 by default",
    "coating.material": "of all particles",
    "coating.number": "of particles in all",
    "coating.layers": "that they come in, with equal numbers",
    "coating.radius": "of the disc about the axis that their centres fall on",
    "coating.positions": "`even`: each as far as may be from those of its layer",
    "coating.diameter": "median of a log-normal distribution, by number",
    "coating.spread": "geometric standard deviation of the diameters; 1 is all equal",
    "coating.smallest": "where the distribution is cut",
    "coating.largest": "where the distribution is cut",
    "coating.velocity": "one value, or pairs of a diameter and a value; from `[gas]` by default",
    "coating.velocity_spread": "standard deviation about the velocity, cut at two",
    "coating.temperature": "one value, or pairs of a diameter and a value",
    "coating.shapes": "shares of each shape, by number",
    "coating.files": 'files with shapes in place of `shapes`, relative to the scene, such as `"powder/*.stl"`',
    "coating.dwell": "time between impacts, in which heat flows; `auto`, as `[spray]` has it, by default",
    "coating.hardness": "as of a particle",
    "coating.yield_strength": "as of a particle",
    "coating.seed": "the same seed gives the same particles",
}
ABOUT = {
    "particle": "One table `[particle]`, or `[[particle]]` several times: impacts one after another ([sequences](sequences.md)).",
    "gas": "Optional: gives the velocity and temperature that the particle leaves out ([gas](gas.md)).",
    "coating": "Optional, in place of `[[particle]]`: many particles drawn from a seed.",
    "spray": "Optional: the stream of powder, which sets the time between impacts ([sequences](sequences.md)).",
    "substrate": "The target, a cylinder whose top is the surface.",
    "contact": "Between particle and target, and between bodies.",
    "adhesion": "What holds splats to what they lie on ([bonds](../theory/bonds.md)).",
    "splat": "How a finished particle becomes finite elements.",
    "resolution": "Overrides of the preset.",
    "end": "When an impact ends.",
    "output": "What is written.",
}
MATERIAL = {
    "rho": "density", "G": "shear modulus", "c0": "Hugoniot U = c0 + s u; bulk modulus rho c0²", "s": "the same",
    "Gamma0": "Grüneisen's parameter", "T_m": "melting point", "taylor_quinney": "share of plastic work that becomes heat",
    "thermal_expansion": "linear; one value, or two pairs [T, value], linear between; 0: not known",
    "sigma_TS": "tensile strength at 293 K, for critical velocities",
    "oxide_thickness": "of the native film", "oxide_strength": "tensile strength of the film",
    "oxide_threshold": "share of clean metal at which the film cracks",
    "cp": "specific heat: one value, or two pairs [T, cp], linear between",
    "k": "conductivity: one value, or two pairs [T, k], linear between",
    "source": "where the numbers come from", "note": "what to know of them",
    "strength": "a strength set of the library, or a law, to start from",
}  # fmt: skip
LAW = {
    "law": f"{', '.join(f'`{name}`' for name in LAWS)}; `johnson_cook` by default",
    "fitted": '`{ rate = ["1e-3 1/s", "1e4 1/s"], temperature = ["77 K", "1000 K"], strain = 0.5 }`: range of the fit',
}
NOZZLE = {
    "inlet": "diameter", "throat": "diameter", "exit": "diameter", "converging": "length of the first cone",
    "diverging": "length of the second cone", "barrel": "length of a straight part behind",
    "chamber": "length of a straight part before",
    "injection": "where the powder is fed, from the throat, upstream negative; at the very start by default",
    "source": "where the numbers come from", "assumed": "what of this is not known",
}  # fmt: skip


def main(path: Path = PAGE) -> None:
    """Write the page."""
    path.write_text(page(), encoding="utf-8")


def page() -> str:
    """The page as Markdown."""
    known = "; ".join(f"{name} `{'` `'.join(known)}`" for name, known in _units())
    lines = [
        f"""# A scene, key by key

<!-- written by workflows/scene_page.py from coupler/scene/tables.py: change those -->

A scene is a TOML file. Values with a unit are texts, `"25 um"`; any unit of the same dimension will do. Whatever is
wrong is reported at once, by key. `coldspray check SCENE` prints what would be computed; the `scene.toml` of a run holds
every default written out.

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
        lines += [f"## `[{key}]`", "", ABOUT.get(key, _first(model)), ""]
        lines += _table(f"{key}.", [(info.alias or name, info) for name, info in model.model_fields.items()])
    own = f"A material of your own, or numbers changed of one of the library ({', '.join(materials.names())})."
    lines += [
        "## `[materials.NAME]`",
        "",
        own,
        "",
        *_plain(materials.Material, materials._DEFAULTS, MATERIAL, _material_unit),
        *_laws(),
    ]
    own = f"A nozzle of your own; the library has {', '.join(nozzles.library())} ([gas](gas.md))."
    lines += ["## `[nozzles.NAME]`", "", own, "",
              *_plain(nozzles.Nozzle, nozzles._DEFAULTS, NOZZLE, lambda name: "mm" if name in nozzles._LIMITS else "")]  # fmt: skip
    lines += ["## Effects", "", f"Names for `effects`: {', '.join(f'`{name}`' for name in NAMES)}."]
    return "\n".join(lines).rstrip() + "\n"


def missing_words() -> list[str]:
    """Keys of a scene that this file has no words for."""
    keys = []
    for name, info in Scene.model_fields.items():
        model = _section(info.annotation)
        above = info.alias or name
        keys += [f"{above}.{key}" for key in model.model_fields] if model else [above]
    keys = [key for key in keys if key not in WORDS and key not in ("materials", "nozzles")]
    for kind, words in ((materials.Material, MATERIAL), (nozzles.Nozzle, NOZZLE)):
        keys += [f"{kind.__name__}.{f.name}" for f in dataclasses.fields(kind) if f.name not in (*words, "name")]
    return keys


def _table(above: str, fields: list[tuple[str, FieldInfo]]) -> list[str]:
    lines = ["| key | takes | default | |", "|---|---|---|---|"]
    for key, info in fields:
        default = "" if key == "name" else _default(info)
        lines.append(f"| `{key}` | {_takes(info)} | {default} | {WORDS.get(above + key, '')} |")
    return [*lines, ""]


def _plain(kind: Any, defaults: dict[str, Any], words: dict[str, str], unit_of: Any) -> list[str]:
    lines = ["| key | unit | default | |", "|---|---|---|---|"]
    for field in dataclasses.fields(kind):
        if field.name != "name":
            default = defaults.get(field.name, "needed")
            default = default[0][1] if isinstance(default, tuple) else default
            shown = "" if default in (None, "") else f"{default:g}" if isinstance(default, float) else default
            lines.append(f"| `{field.name}` | {unit_of(field.name)} | {shown} | {words.get(field.name, '')} |")
    return [*lines, ""]


def _laws() -> list[str]:
    """The keys of a strength law, in the table of its material."""
    lines = ["Keys of its strength law, in the same table:", "", "| key | unit | default | |", "|---|---|---|---|"]
    lines += [f"| `{key}` | | | {words} |" for key, words in LAW.items()]
    for name, law in LAWS.items():
        for key, p in law.parameters.items():
            default = "needed" if p.default is None else f"{p.default:g}"
            lines.append(f"| `{key}` | {p.unit} | {default} | {name}: {p.about} |")
    return [*lines, ""]


def _material_unit(name: str) -> str:
    limits = materials._LIMITS | materials._PAIR_LIMITS
    return limits[name][0] if name in limits else ""


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
        return "tables"
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


def _first(model: type) -> str:
    return (model.__doc__ or "").split("\n\n")[0].replace("\n", " ").strip()


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
