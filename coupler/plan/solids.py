"""Particle shapes from files. Each file is read, cleaned and checked only once."""

import glob
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from ..errors import ColdsprayError
from ..files.inputs import InputError
from ..files.surfaces import read_surface
from ..geometry.solid import Solid, solid_of
from ..geometry.triangles import surface_area
from ..physics.shapes import Form
from ..scene.coating import TABLES
from ..scene.model import SceneData, particle_tables


def load(path: Path) -> Solid:
    """The solid in a file. Raises InputError or SplatError with the reason if the file holds no solid."""
    return _loaded(path, path.stat().st_mtime_ns if path.is_file() else 0)


@cache
def _loaded(path: Path, changed: int) -> Solid:
    points, triangles = read_surface(path)
    if len(triangles) == 0:
        raise InputError(path, "has no triangles: the closed surface of a body is needed")
    return solid_of(points, triangles)


def form_of(solid: Solid) -> Form:
    """Extents, corners and mean thickness 2 V / A of a solid, scaled to the volume of a sphere of diameter 1."""
    x = solid.points
    hull = x[ConvexHull(x).vertices]
    a, b, c = np.ptp(x, axis=0).tolist()
    thickness = np.pi / 3.0 / surface_area(x, solid.triangles)
    return Form("file", (a, b, c), float(thickness), tuple((float(p), float(q), float(r)) for p, q, r in hull))


def read_forms(scene: SceneData) -> Iterator[str]:
    """Read the files of the scene's particles, and set the particles' forms. Yields the problems."""
    for label, particle in zip(scene.labels, scene.particles, strict=True):
        if particle.file is not None:
            try:
                particle._of_file = form_of(load(Path(particle.file)))
            except ColdsprayError as error:
                text = str(error)
                yield f"{label}.file: {text if particle.file in text else f'{particle.file}: {text}'}"


def with_folders(raw: dict[str, object], source: str) -> None:
    """Make names of files and patterns of names absolute; they are relative to the folder of the scene. raw: the scene as nested dicts,
    changed in place."""

    def table_of(value: object) -> dict[str, object]:
        return value if isinstance(value, dict) else {}

    folder, coating, substrate = Path(source).parent, table_of(raw.get("coating")), table_of(raw.get("substrate"))
    powder = coating.get("powder")
    powders = [coating, *map(table_of, powder if isinstance(powder, list) else [powder])]
    each = [(table, "file") for table in (*particle_tables(raw), table_of(substrate.get("height_map")))]
    each += [(table, key) for table in powders for key in ("files", "sizes")]
    each.append((table_of(raw.get("spray")), "distribution"))
    for table, key in each:
        name = table.get(key)
        if not isinstance(name, str) or len(name) >= 4096 or "\0" in name:
            continue
        if key == "files":
            table[key] = str(Path(glob.escape(str(folder.absolute()))) / os.path.expanduser(name))
        elif key == "file" or name.lower().endswith(TABLES):
            table[key] = str((folder / os.path.expanduser(name)).absolute())
