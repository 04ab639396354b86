"""The commands `coldspray new`, `shapes`, `nozzles` and `schema`, which help to write a scene."""

import argparse
import json
import re
from importlib.resources import files
from itertools import product
from pathlib import Path

from ..errors import ColdsprayError
from ..files.inputs import SCENE_LIMIT, read_text
from ..files.outputs import MARK, claim_file, write_text
from .arguments import Commands, add_command, add_force, path
from .gas import add_library, known, shown

SCHEMA = "scene.schema.json"
KINDS = {
    "single": "one particle on a flat target",
    "pair": "two particles, the second on the first",
    "coating": "a coating of random particles, with gas and nozzle",
    "job": "a job: one page says whether a powder sticks, how much of it, and what coating it makes",
    "track": "cross-sections of one pass of the gun and of a raster",
    "map": "a sweep over velocity and temperature",
    "ensemble": "a sweep over distributions of velocity, size, angle, place and hardness",
    "mesh": "a file of points that `coldspray mesh` turns into tetrahedra",
}
EXAMPLES = {  # of workflows/; a wheel has them inside the package (pyproject.toml)
    "single_ni": "a 25 um nickel particle on stainless steel at 500 m/s",
    "double_ni_ti": "a titanium particle on the splat of a nickel particle",
    "triple_ni": "three nickel particles of different sizes, one after another on the same place",
    "morphology": "three nickel particles that are not spheres, one after another on the same place",
    "coating_ni": "a coating of 40 nickel particles on steel, with a gas and a nozzle",
    "raster_ni": "a coating of 24 nickel particles from a gun that moves, two passes at an angle",
    "critical_al": "critical velocity of 22 um aluminium on aluminium, by computed bonds",
    "critical_cu": "critical velocity of 14 um copper on copper, by computed bonds",
    "critical_ni": "critical velocity of 10 um nickel on nickel, by computed bonds",
    "map_ni": "a sweep of nickel on steel over size and velocity",
}


def add(commands: Commands) -> None:
    option = add_command(commands, "new", new, "write an example scene with comments")
    option(
        "kind", nargs="?", choices=(*KINDS, *EXAMPLES), metavar="KIND", help=f"{', '.join(KINDS)}, or an example name"
    )
    option("name", nargs="?", type=path, metavar="NAME", help="name of the file, with or without its ending")
    option("--list", action="store_true", help="list the kinds and the examples")
    option("--force", action="store_true", help="replace a file of this name")
    add_command(commands, "shapes", shapes, "list the particle shapes with their dimensions")
    option = add_command(commands, "nozzles", nozzles, "list the nozzles of the library with their sources")
    add_library(option)
    option = add_command(commands, "schema", schema, "print the JSON schema of scenes (Draft 4), for editors")
    option("--of", choices=("scene", "job"), default="scene", help="which schema: scenes (default) or jobs")
    option("--out", type=path, metavar="FILE", help="write the schema to this .json file")
    add_force(option)


def new(arguments: argparse.Namespace) -> int:
    """Write an example file and, for a scene, also the JSON schema. Returns the exit code."""
    kind, name = arguments.kind, arguments.name
    if arguments.list:
        print("\n".join(f"{each:14} {text}" for each, text in (KINDS | EXAMPLES).items()))
        return 0
    if name is None:
        raise ColdsprayError("new: give a kind or an example, and a file name; coldspray new --list shows all kinds")
    if not name.name:
        raise ColdsprayError(f"new: {name} is a folder: give a file name")
    suffix = ".csv" if kind == "mesh" else ".toml"
    out: Path = name if name.suffix == suffix else name.with_name(f"{name.name}{suffix}")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", out.stem):
        raise ColdsprayError(f"{out.stem}: use letters, digits, '_', '.', '-' (at most 64, a letter or digit first)")
    if out.exists() and not arguments.force:
        raise ColdsprayError(f"{out} exists: add --force to replace it, or choose another name")
    out.parent.mkdir(parents=True, exist_ok=True)
    if kind == "mesh":
        text = _points(out.stem)
    elif kind in EXAMPLES:
        # in the package of an installed wheel, or in the folder beside the package of a source tree
        places = [folder / "workflows" / f"{kind}.toml" for folder in Path(__file__).parents[1:3]]
        text = read_text(next((place for place in places if place.is_file()), places[1]), SCENE_LIMIT)
        text = text.replace(f"workflows/{kind}.toml", str(out))
    else:
        text = (files(__package__) / "templates" / f"{kind}.toml").read_text(encoding="utf-8").replace("NAME", out.stem)
    write_text(out, text)
    print(f"{out}: {(KINDS | EXAMPLES)[kind]}{'; its first lines give the next command' if kind in KINDS else ''}")
    if text.startswith("#:schema"):
        write_text(claim_file(out.parent / SCHEMA, (".json",), force=arguments.force), _schema())
        print(f"{SCHEMA} is in the same folder, for editors that check TOML")
    return 0


def shapes(arguments: argparse.Namespace) -> int:
    """Print the particle shapes. Returns the exit code."""
    from ..physics.shapes import SHAPES, form

    print("lengths along x, y, z at tilt 0 / diameter of the sphere of equal volume; tilt: rotation about y\n")
    for name in SHAPES:
        shape = form(name, 1.0)
        thin = f", wall {shape.thinnest:.3f}" if name == "hollow_sphere" else ""
        print(f"{name:14} {' x '.join(f'{length:.3f}' for length in shape.lengths)}{thin}")
    return 0


def nozzles(arguments: argparse.Namespace) -> int:
    """Print the nozzles of the library. Returns the exit code."""
    print("\n\n".join(shown(nozzle) for nozzle in known(arguments)[1].values()))
    return 0


def schema(arguments: argparse.Namespace) -> int:
    """Print the JSON schema of a scene, or write it to a file. Returns the exit code."""
    text = _schema(arguments.of)
    if arguments.out is None:
        print(text, end="")
    else:
        write_text(claim_file(arguments.out, (".json",), force=arguments.force), text)
        hint = f"an editor uses it if the first line of a scene is: #:schema {arguments.out}"
        print(f"schema written to {arguments.out}; {hint}")
    return 0


def _schema(of: str = "scene") -> str:
    from ..scene import json_schema

    schema = json_schema.job_schema() if of == "job" else json_schema.scene_schema()
    return json.dumps(schema | {"description": MARK}, indent=1, ensure_ascii=False) + "\n"


def _points(name: str) -> str:
    """A CSV text (columns x, y, z in um): cubic lattice in an ellipsoid of 34 x 34 x 12 um. name: file stem, for its first line."""
    step, (a, c) = 1.5, (17.0, 6.0)
    reach = [[step * (k + 0.5) for k in range(-n, n)] for n in (12, 12, 4)]
    points = [(x, y, z) for x, y, z in product(*reach) if (x / a) ** 2 + (y / a) ** 2 + (z / c) ** 2 < 1.0]
    head = f"# coldspray mesh {name}.csv --unit um --spacing {step}um\nx,y,z\n"
    return head + "".join(f"{x:.3f},{y:.3f},{z:.3f}\n" for x, y, z in points)
