"""What is written of a coating: measures, the profile over depth, a picture of the cut, and its splats as meshes."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import meshio
import numpy as np

from ..errors import StoreError
from ..files.outputs import write_text
from ..files.result import Result
from ..geometry.tetrahedra import boundary_faces
from ..geometry.triangles import enclosed_volume
from ..report.picture import Stage, colour_range, cut, panels, read, save
from .coating import CoatingMeasures, Splats
from .table import write_rows

NAMES = ("coating.json", "coating_depth.csv", "section.png", "coating.vtu", "splats/splat_*.stl")
_DRAWN = ("eps_p", "T", "von_mises")
_IN_CELLS = ("eps_p", "T", "von_mises", "stress")
MICRO = 1e6


def write_measures(folder: Path, measures: CoatingMeasures) -> list[Path]:
    """coating.json, all of it, and coating_depth.csv, means over slices of the depth; SI. Raises StoreError."""
    paths = [folder / "coating.json", folder / "coating_depth.csv"]
    write_rows(paths[1], list(measures.depth[0]) if measures.depth else ["z_m"], measures.depth)
    write_text(paths[0], json.dumps(asdict(measures), indent=2) + "\n")
    return paths


def section(result: Result, path: Path, radius: float, heading: str, plane: float = 0.0) -> Path:
    """The cut at y = plane (m) by strain, temperature and stress, as a PNG. radius: of what is shown, m.

    The last particle is drawn where the cut meets it. Raises StoreError where there is nothing to draw.
    """
    read(result, -1, _DRAWN)
    mesh, surface = result.fields(-1, "target"), result.fields(-1, "surface")
    inside = mesh.points[np.hypot(mesh.points[:, 0], mesh.points[:, 1]) < radius]
    top = max(float(inside[:, 2].max()), 0.0) * MICRO
    across = radius * MICRO
    seen = (-across, across, -0.35 * across, top + 0.08 * across)
    points = result.fields(-1, "particle").points
    spacing = float(np.cbrt(abs(enclosed_volume(surface.points, surface.cells)) / max(len(points), 1)))
    section_cut = cut(result, -1, _DRAWN, Stage(plane, 0.0, across, 1.6 * spacing), seen)
    save(panels(section_cut, {name: colour_range([section_cut], name) for name in _DRAWN}, heading), path)
    return path


def write_meshes(splats: Splats, folder: Path) -> list[Path]:
    """The splats for homogenisation: coating.vtu, tetrahedra of all with the body and the impact of each and its fields, and
    splats/splat_NNN.stl, the closed surface of each, numbered by impact. Lengths in m. Raises StoreError.
    """
    inner = folder / "splats"
    own = np.flatnonzero(splats.body > 0)
    cells = splats.mesh.cells[own]
    used, local = np.unique(cells, return_inverse=True)
    data = {name: [splats.mesh.data[name][own]] for name in _IN_CELLS}
    data |= {"body": [splats.body[own].astype(np.int32)], "impact": [splats.impact[splats.body[own]].astype(np.int32)]}
    paths = [folder / "coating.vtu"]
    try:
        inner.mkdir(parents=True, exist_ok=True)
        for old in inner.glob("splat_*.stl"):
            old.unlink()
        meshio.Mesh(splats.mesh.points[used], [("tetra", local.reshape(cells.shape))], cell_data=data).write(paths[0])
        skins = [
            (int(splats.impact[b]), splats.mesh.points, boundary_faces(splats.mesh.cells[splats.body == b])[0])
            for b in range(1, len(splats.impact))
        ]
        if splats.last is not None:
            skins.append((splats.finished, *splats.last))
        several = {number for number, _, _ in skins if sum(other == number for other, _, _ in skins) > 1}
        for k, (number, points, faces) in enumerate(skins):
            part = f"_{k}" if number in several else ""
            path = inner / f"splat_{number:03d}{part}.stl"
            corners, triangles = np.unique(faces, return_inverse=True)
            meshio.Mesh(points[corners], [("triangle", triangles.reshape(faces.shape))]).write(path, binary=True)
            paths.append(path)
    except OSError as error:
        raise StoreError(f"cannot write {error.filename}: {error.strerror}") from error
    return paths
