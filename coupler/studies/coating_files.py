"""Output files of a coating: measures, profile along the depth, pictures of a cross-section, and the splats as meshes."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import meshio
import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import PathPatch
from numpy.typing import NDArray
from scipy import ndimage

from ..errors import StoreError
from ..files.outputs import write_text
from ..files.result import COLD, Result
from ..geometry.sections import section_loops
from ..geometry.tetrahedra import boundary_faces
from ..geometry.triangles import enclosed_volume
from ..report import picture
from ..report.figure import blank, save
from ..report.phases import colour_of, name_phases, phases_of
from ..report.picture import MICRO, Stage, cold_section, colour_range, cross_section, panels, read, scale_bar
from .coating import CoatingMeasures, Growth
from .splats import Splats
from .table import write_rows

NAMES = (
    "coating.json", "coating_depth.csv", "coating_growth.csv", "growth.png", "section.png", "micrograph.png", "stress.png",
    "coating.vtu", "splats/splat_*.stl",
)  # fmt: skip
_DRAWN = ("eps_p", "T", "von_mises")
_IN_CELLS = ("eps_p", "T", "von_mises", "stress", "thermal_stress")


def write_measures(folder: Path, measures: CoatingMeasures) -> None:
    """Write coating.json with all measures, and coating_depth.csv with mean values in horizontal slices; SI units. Raises
    StoreError."""
    write_rows(folder / "coating_depth.csv", list(measures.depth[0]) if measures.depth else ["z_m"], measures.depth)
    write_text(folder / "coating.json", json.dumps(asdict(measures), indent=2) + "\n")


def write_growth(folder: Path, rows: list[Growth]) -> None:
    """Write coating_growth.csv and growth.png: the measures of the coating after each impact. Raises StoreError."""
    write_rows(folder / "coating_growth.csv", list(rows[0]), rows)
    draw_growth(rows, folder / "growth.png")


def section(result: Result, splats: Splats, path: Path, radius: float, heading: str, plane: float = 0.0) -> None:
    """Draw the cross-section at y = plane (m) up to `radius` m from the axis, as PNG. Colours of a cold coating:
    strain, von Mises stress and in-plane stress. Of other coatings: strain, temperature and stress, with the last particle. A coating
    of several materials has a panel of the materials, too. Raises StoreError if no step is stored."""
    x = np.linspace(-radius, radius, 400)
    places = np.column_stack([x, np.full(len(x), plane)])
    ground = (np.column_stack([x, splats.ground(places)]) * MICRO,)
    at = Stage(plane, 0.0, radius * MICRO, 0.0, ground=ground, phases=phases_of(result.plan))
    if len(result.times(COLD)):
        save(panels(*cold_section(result, at, _seen(splats, radius)), heading), path)
        return
    read(result, -1, _DRAWN)
    surface, points = result.fields(-1, "surface"), result.fields(-1, "particle").points
    spacing = float(np.cbrt(abs(enclosed_volume(surface.points, surface.cells)) / max(len(points), 1)))
    at_end = cross_section(result, -1, _DRAWN, replace(at, void=1.6 * spacing), _seen(splats, radius))
    ranges = picture.with_phases(at_end, {name: colour_range([at_end], name) for name in _DRAWN})
    save(panels(at_end, ranges, heading), path)


def _seen(splats: Splats, radius: float) -> tuple[float, float, float, float]:
    """Extent of the picture, um: left, right, bottom, top. It shows `radius` m about the axis, down to below the deepest splat."""
    mesh, across = splats.mesh, radius * MICRO
    is_near = np.hypot(*mesh.points[:, :2].T) < radius
    of_splat = np.isin(np.arange(len(mesh.points)), mesh.cells[splats.impact[splats.body] > 0])
    deepest = float(mesh.points[is_near & of_splat, 2].min(initial=0.0)) * MICRO
    top = float(mesh.points[is_near, 2].max(initial=0.0)) * MICRO
    return -across, across, min(-0.35 * across, deepest - 0.15 * across), top + 0.08 * across


def _skins(splats: Splats) -> list[tuple[int, NDArray, NDArray]]:
    """(impact, points, triangles) of each surface: substrate and layers (impact 0), splats, last particle if it consists of points."""
    cells = [splats.mesh.cells[splats.body == b] for b in range(len(splats.impact))]
    skins = [(int(n), splats.mesh.points, boundary_faces(own)[0]) for n, own in zip(splats.impact, cells, strict=True)]
    return [*skins, *([(len(splats.mass), *splats.last)] if splats.last is not None else [])]


def micrograph(splats: Splats, path: Path, radius: float, plane: float = 0.0) -> Path:
    """Draw the cross-section at y = plane (m) like an etched section under a microscope, as PNG. Returns the path. Boundaries of
    splats are dark, the boundary of the substrate is thick, closed pores are black. Blue areas are open to the outside in this plane.
    Different materials have different colours. radius: distance from the axis up to which the picture reaches, m."""
    seen = _seen(splats, radius)
    left, right, bottom, top = seen
    figure = blank(7.0, 7.0 * (top - bottom) / (right - left), 200)
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0), facecolor="black")
    x, z = (np.linspace(*ends, pixels) for ends, pixels in (((left, right), 1400), ((bottom, top), 600)))
    places = np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)
    metal = np.zeros(len(places), bool)
    names = splats.materials
    for number, (came, points, faces) in enumerate(_skins(splats)):
        tone = 0.45 + 0.08 * (number % 2) if came == 0 else 0.72 + 0.2 * (0.618034 * number % 1.0)  # neighbours differ
        style = {"edgecolor": "0.1", "linewidth": 0.8 if came else 2.0, "facecolor": (tone, tone, tone)}
        if came:
            style["facecolor"] = colour_of(names.index(splats.material(number, came)), tone)
        loops = [loop * MICRO for loop in section_loops(points, faces, plane)]
        if loops:
            outline = picture.outline_of(loops)
            axis.add_patch(PathPatch(outline, **style))
            metal |= outline.contains_points(places)
    empty, _ = ndimage.label(~metal.reshape(len(z), len(x)))
    sky = (empty > 0) & np.isin(empty, empty[-1])
    axis.imshow(np.where(sky, 1.0, np.nan), extent=seen, origin="lower", cmap=ListedColormap(["#b9cfe4"]), zorder=0)
    axis.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xticks=[], yticks=[])
    scale_bar(axis, seen)
    if len(names) > 1:
        name_phases(axis, names, loc="upper right")
    save(figure, path)
    return path


def stress_profile(measures: CoatingMeasures, path: Path) -> None:
    """Draw the in-plane stress against height as PNG: mean, range from the 5 % to the 95 % quantile by volume, and for a cold coating
    the parts that cooling and impacts cause."""
    rows = measures.depth
    z, mean, low, high = (np.array(column) for column in zip(*(
        (row["z_m"] * MICRO, 0.5e-6 * (row["sigma_xx"] + row["sigma_yy"]), 1e-6 * row["sigma_p5"], 1e-6 * row["sigma_p95"])
        for row in rows
    ), strict=True))  # fmt: skip
    figure = blank(5.0, 5.0, 160, "constrained")
    axis = figure.add_subplot()
    axis.fill_betweenx(z, low, high, color="0.85", label="5 to 95 % of the volume")
    is_cold = "thermal_xx" in rows[0]
    axis.plot(mean, z, color="black", label="residual stress" if is_cold else "stress before cooling")
    if is_cold:
        thermal = np.array([0.5e-6 * (row["thermal_xx"] + row["thermal_yy"]) for row in rows])
        axis.plot(thermal, z, color="#d55e00", label="from cooling (quench)")
        axis.plot(mean - thermal, z, color="#0072b2", label="from impacts (deposition)")
    axis.axhline(0.0, color="0.4", linewidth=0.8, dashes=(6, 4))
    axis.axvline(0.0, color="0.4", linewidth=0.8)
    axis.set(xlabel="in-plane stress (xx + yy) / 2 (MPa)", ylabel="height above the substrate's surface (µm)")
    axis.legend(fontsize=8)
    save(figure, path)


def write_meshes(splats: Splats, folder: Path) -> list[Path]:
    """Write the coating as meshes for homogenisation. Returns the paths. coating.vtu: mesh of substrate and splats with body, impact,
    metal (0: substrate; then materials in the order of their first impacts) and fields of each tetrahedron; splats/splat_NNN.stl:
    closed surface of the splat of impact NNN. Lengths in m. Raises StoreError."""
    inner = folder / "splats"
    cells = splats.mesh.cells
    data = {name: [splats.mesh.data[name]] for name in _IN_CELLS if name in splats.mesh.data}
    data |= {"body": [splats.body.astype(np.int32)], "impact": [splats.impact[splats.body].astype(np.int32)]}
    made = enumerate(splats.impact.tolist())
    metal = np.array([splats.materials.index(splats.material(b, i)) + 1 if i else 0 for b, i in made])
    data["metal"] = [metal[splats.body].astype(np.int32)]
    paths = [folder / "coating.vtu"]
    try:
        inner.mkdir(parents=True, exist_ok=True)
        for old in inner.glob("splat_*.stl"):
            old.unlink()
        meshio.Mesh(splats.mesh.points, [("tetra", cells)], cell_data=data).write(paths[0])
        skins = [skin for skin in _skins(splats) if skin[0] > 0]
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


def draw_growth(rows: list[Growth], path: Path) -> None:
    """Draw thickness (mean, smallest, largest), roughness Sa and porosity (open, closed) against the number of impacts, as PNG."""
    impacts = [each["impacts"] for each in rows]
    um = {key: np.array([each[key] for each in rows]) * MICRO for key in rows[0] if key.endswith("_m")}
    share = {key: 100.0 * np.array([each[key] for each in rows]) for key in ("porosity_open", "porosity_closed")}
    figure = blank(5.0, 5.5, 160, "constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.fill_between(impacts, um["thickness_min_m"], um["thickness_max_m"], color="0.88", label="smallest to largest")
    above.plot(impacts, um["thickness_mean_m"], "o-", color="black", markersize=3, label="mean thickness")
    above.plot(impacts, um["Sa_m"], color="#0072b2", label="roughness Sa")
    above.set(ylabel="µm", ylim=(0.0, None))
    below.plot(impacts, share["porosity_closed"], "o-", color="#d55e00", markersize=3, label="closed")
    below.plot(impacts, share["porosity_open"], color="#0072b2", label="open")
    below.set(xlabel="impacts", ylabel="porosity (%)", ylim=(0.0, None))
    for axis in (above, below):
        axis.legend(fontsize=8)
    save(figure, path)
