"""The 3D view of the report: particle and target, as a whole or cut open, at several times. The data are compact enough for one file.

Numbers are little-endian 16-bit integers in base64: positions relative to the box of the view, values relative to their range.
"""

import base64
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.path import Path as Outline
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from ..files.fields import Fields
from ..files.result import Result
from ..geometry.sections import crossing, section_loops, section_of_tets
from ..geometry.tetrahedra import boundary_faces
from .fields import FIELDS, at_nodes, from_points
from .picture import MICRO, Range, Stage, read, section_of_surfaces, view

FRAMES = 26  # of the time slider, at most
VERTICES = 2500  # of the surface of the particle: more are merged
SECTION_STEPS = 28  # triangles along the longer side of the cross-section of the particle
TOP = 2**16 - 1

# One mesh: points (n, 3) um, triangles (m, 3), name -> values (n,) in the units of FIELDS.
Mesh = tuple[NDArray, NDArray, dict[str, NDArray]]


def frames(count: int) -> list[int]:
    """Indices of the stored steps for the time slider: all, or FRAMES of them, evenly distributed."""
    return sorted({round(step) for step in np.linspace(0, count - 1, min(count, FRAMES))})


def solid(result: Result, steps: Sequence[int], ranges: Mapping[str, Range], at: Stage) -> dict[str, object]:
    """The 3D view as data for JSON. steps: stored steps to show; ranges: colour scale of each field; at: plane of the cross-section.

    `times` (ns); `box`: ends in x, y, z (um); `plane`: y of the cross-section (um); `lowest`: a z below the particle at all times (um);
    `fields`: the fields with colours and ranges; `triangles`: sets of index triplets, which frames share; `frames`: for each time
    `lines` (x and z of the outlines of the cross-section, um) and the meshes "target", "particle", "target section" and "particle
    section", each with the index of its set of triangles, points and values. Points and values are integers 0 to TOP of 2 bytes,
    corners of triangles of 4 bytes, in base64.
    For points, this range spans a box three times as large as `box`, with the same centre; for values, the range of the field.
    """
    seen = view(result, steps, at)
    box = _box([result.fields(step, "surface").points * MICRO for step in steps], seen[3], at)
    cells, kept = np.zeros((0, 3), int), (np.zeros(0, int), np.zeros((0, 3), int))
    times, shown, lines = [], [], []
    for step in steps:
        particle, surface, target = read(result, step, ranges)
        if not np.array_equal(cells, surface.cells):
            cells, kept = surface.cells, thinned(surface.points, surface.cells)
        nodal = {name: at_nodes(target, name) * FIELDS[name].factor for name in ranges}
        cloud = {name: at_nodes(particle, name) * FIELDS[name].factor for name in ranges}
        skin, _ = boundary_faces(target.cells)
        loops = [loop * MICRO for loop in section_loops(surface.points, surface.cells, at.plane)]
        rim, _ = section_of_surfaces(target, at)
        meshes = {"target": _target(target.points * MICRO, skin, nodal, box)}
        meshes["target section"] = _target_section(target, nodal, at, box)
        meshes["particle"] = _particle(particle.points, cloud, surface, kept)
        meshes["particle section"] = _particle_section(particle.points, cloud, loops, at)
        shown.append(meshes)
        lines.append([np.vstack([loop, loop[:1]]) for loop in loops] + list(rim[_reaches_into(rim, box)]))
        times.append(round(particle.time * 1e9, 3))
    every = {name: np.concatenate([mesh[2][name] for meshes in shown for mesh in meshes.values()]) for name in ranges}
    reach = {name: (float(values.min()), float(np.ptp(values)) or 1.0) for name, values in every.items()}
    triangles: dict[str, int] = {}  # packed -> index
    return {
        "times": times,
        "box": box.T.tolist(),
        "plane": at.plane * MICRO,
        "lowest": min(float(mesh[0][:, 2].min()) for mesh in (each["particle"] for each in shown)) - 0.1 * at.diameter,
        "fields": [_colours(name, ranges[name], *reach[name]) for name in ranges],
        "frames": [_frame(*each, box, reach, triangles) for each in zip(shown, lines, strict=True)],
        "triangles": list(triangles),
    }


def thinned(points: NDArray, triangles: NDArray, most: int = VERTICES) -> tuple[NDArray, NDArray]:
    """A coarser surface with at most `most` vertices: indices (k,) of its vertices in points (n, 3), and triangles (j, 3) as
    indices into these k. triangles: (m, 3). Vertices in one cell of a cubic grid are merged into the vertex nearest to their mean.
    A surface with few vertices stays unchanged."""
    if len(points) <= most:
        return np.arange(len(points)), triangles
    size = float(np.ptp(points, axis=0).max())
    places = (points - points.min(0)) / size
    fine, coarse = 1.0, 1e4  # bounds of the number of cells along the longer side
    for _ in range(30):
        middle = np.sqrt(fine * coarse)
        few = len(np.unique(np.floor(places * middle).astype(int), axis=0)) <= most
        fine, coarse = (middle, coarse) if few else (fine, middle)
    group = np.unique(np.floor(places * fine).astype(int), axis=0, return_inverse=True)[1].ravel()
    count = np.bincount(group)
    mean = np.stack([np.bincount(group, column) for column in places.T], axis=1) / count[:, None]
    order = np.lexsort((((places - mean[group]) ** 2).sum(1), group))
    kept = order[np.cumsum(count) - count]
    merged = group[triangles]
    merged = merged[(merged != np.roll(merged, 1, axis=1)).all(1)]
    _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
    return kept, merged[np.sort(first)]


def _box(skins: Sequence[NDArray], top: float, at: Stage) -> NDArray:
    """Lower and upper corner (2, 3) of the view, um: the particle at all times, up to the height `top`, and the target near it."""
    skins = [below for skin in skins if len(below := skin[skin[:, 2] < top])]
    low, high = (np.array([end(skin, axis=0) for skin in skins]) for end in (np.min, np.max))
    plane, D = at.plane * MICRO, at.diameter
    half = max(plane - low[:, 1].min(), high[:, 1].max() - plane) + 0.9 * D
    least = low[:, 0].min() - 0.9 * D, plane - half, at.level - 1.1 * D
    return np.array([least, (high[:, 0].max() + 0.9 * D, plane + half, top)])


def _reaches_into(corners: NDArray, box: NDArray) -> NDArray:
    """Mask (q,) of the polygons (q, k, 2 or 3) that overlap the box (2, 3); two coordinates are x and z."""
    low, high = (box if corners.shape[-1] == 3 else box[:, [0, 2]])[:, None]
    return ((corners.max(1) > low) & (corners.min(1) < high)).all(1)


def _target(points: NDArray, skin: NDArray, nodal: Mapping[str, NDArray], box: NDArray) -> Mesh:
    used, triangles = np.unique(skin[_reaches_into(points[skin], box)], return_inverse=True)
    return points[used], triangles.reshape(-1, 3), {name: values[used] for name, values in nodal.items()}


def _target_section(target: Fields, nodal: Mapping[str, NDArray], at: Stage, box: NDArray) -> Mesh:
    polygons, _ = section_of_tets(target.points, target.cells, at.plane)
    near = _reaches_into(crossing(target.points, polygons, at.plane)[0] * MICRO, box)
    edges, corner = np.unique(np.sort(polygons[near], axis=2).reshape(-1, 2), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 4)
    places, share = crossing(target.points, edges, at.plane)
    values = {name: field[edges[:, 0]] * (1 - share) + field[edges[:, 1]] * share for name, field in nodal.items()}
    triangles = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])
    return _upright(places * MICRO, at), triangles[triangles[:, 1] != triangles[:, 2]], values


def _particle(points: NDArray, cloud: Mapping[str, NDArray], surface: Fields, kept: tuple[NDArray, NDArray]) -> Mesh:
    vertices, triangles = kept
    places, values = surface.points[vertices], {}
    index, weight = from_points(points, places)
    for name, field in cloud.items():
        if name in surface.data and len(surface.data[name]) == len(surface.points):
            values[name] = surface.data[name][vertices].astype(float) * FIELDS[name].factor
        else:
            values[name] = (weight * field[index]).sum(1)
    return places * MICRO, triangles, values


def _particle_section(points: NDArray, cloud: Mapping[str, NDArray], loops: list[NDArray], at: Stage) -> Mesh:
    """The cross-section of the particle as triangles, none in voids. Their corners are the points of its outlines `loops` (um) and of a
    grid inside. points: m; cloud: field -> values at points."""
    if not loops:
        return np.zeros((0, 3)), np.zeros((0, 3), int), {name: np.zeros(0) for name in cloud}

    def inside(places: NDArray) -> NDArray:
        return np.bitwise_xor.reduce([Outline(loop).contains_points(places) for loop in loops])

    outline = np.concatenate(loops)
    low, high = outline.min(0), outline.max(0)
    step = float((high - low).max()) / SECTION_STEPS
    x, z = (np.arange(a, b, step) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(x, z), axis=-1).reshape(-1, 2)
    grid = grid[inside(grid) & (cKDTree(outline).query(grid)[0] > 0.4 * step)]
    places = np.concatenate([outline, grid])
    triangles = Delaunay(places).simplices
    triangles = triangles[inside(places[triangles].mean(1))]
    upright = _upright(places, at)
    index, weight = from_points(points, upright / MICRO, at.void)
    metal = np.isfinite(weight[:, 0])
    triangles, weight = triangles[metal[triangles].all(1)], np.where(metal[:, None], weight, 1 / weight.shape[1])
    return upright, triangles, {name: (weight * field[index]).sum(1) for name, field in cloud.items()}


def _upright(places: NDArray, at: Stage) -> NDArray:
    """Points (n, 3), um, of the plane of the cross-section, from their x and z (n, 2)."""
    return np.stack([places[:, 0], np.full(len(places), at.plane * MICRO), places[:, 1]], axis=1)


def _colours(name: str, ends: Range, least: float, span: float) -> dict[str, object]:
    field = FIELDS[name]
    scale = [[k / 16, to_hex(colormaps[field.colours](k / 16))] for k in range(17)]
    words = {"name": name, "label": field.label, "unit": field.unit, "colours": scale}
    return {**words, "low": ends.low, "high": ends.high, "least": least, "span": span}


def _frame(
    meshes: Mapping[str, Mesh], lines: Sequence[NDArray], box: NDArray, reach: Mapping[str, tuple[float, float]],
    triangles: dict[str, int],
) -> dict[str, object]:  # fmt: skip
    span = box[1] - box[0]
    frame: dict[str, object] = {"lines": [np.round(line, 2).ravel().tolist() for line in lines]}
    for kind, (points, corners, values) in meshes.items():
        of = {name: _packed((field - reach[name][0]) / reach[name][1] * TOP) for name, field in values.items()}
        # in a box three times as large, because triangles that overlap the view extend beyond it
        places = _packed((points - box[0] + span) / (3 * span) * TOP)
        index = triangles.setdefault(_in_base64(corners.astype("<u4")), len(triangles))
        frame[kind] = {"triangles": index, "points": places, "values": of}
    return frame


def _packed(values: NDArray) -> str:
    return _in_base64(np.rint(np.clip(values, 0, TOP)).astype("<u2"))


def _in_base64(integers: NDArray) -> str:
    return base64.b64encode(integers.tobytes()).decode()
