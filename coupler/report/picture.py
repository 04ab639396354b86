"""Pictures of the cross-section through particle and target."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.transforms import Bbox
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from ..errors import StoreError
from ..files.fields import Fields
from ..files.result import COLD, DOMAINS, Result, impact_at
from ..files.summary import Values
from ..geometry.sections import crossing, section_loops, section_of_tets, section_of_triangles
from ..geometry.tetrahedra import boundary_faces
from ..geometry.triangles import enclosed_volume
from .fields import FIELDS, at_nodes, from_points
from .figure import axes_at, blank, fitted, save
from .phases import PHASE, Phases, colour_of, name_phases, phases_of
from .words import title

MICRO = 1e6
VOID = 1.6  # spacings: a place in the particle farther than this from all points is a void
RAISED = 0.03  # diameters above the surface: higher parts of the target belong to a rim, a jet or a splat
FAR = 1.3  # diameters above the target: a higher particle is outside the picture
PIXELS = 320  # along the longer side of the particle
COLD_FIELDS = ("eps_p", "von_mises", "in_plane")

View = tuple[float, float, float, float]  # left, right, bottom, top, um


class Range(NamedTuple):
    """Limits of the colour scale of a field, in the units of `FIELDS`. exceeded: whether some values are clearly above `high`."""

    low: float
    high: float
    exceeded: bool = False


@dataclass(frozen=True)
class Stage:
    """The plane and the reference values of all cross-sections of a run, from its first step. plane: y (m); level: height of the
    undeformed surface below the particle, um; diameter: diameter of the particle, um; void: if a place in the particle is farther
    than this from all points, it counts as hollow, m; top: greatest height of the undeformed target, um; ground: outlines of the
    undeformed target in the plane, (k, 2) um each; phases: materials, None if all particles are of one material."""

    plane: float
    level: float
    diameter: float
    void: float
    top: float = 0.0
    ground: tuple[NDArray, ...] = ()
    phases: Phases | None = None


@dataclass(frozen=True)
class CrossSection:
    """The cross-section at one time. Lengths in um, points as (x, z), values in the units of `FIELDS`.

    time: s; level, ground: as in `Stage`; view: extent of the picture; loops: outlines of the particle, (k, 2) each; corners
    (q, 4, 2): polygons of the target; rim (r, 2, 2): lines of the surfaces of substrate and splats; is_substrate (r,): lines of the
    substrate, all False without splats; values: field -> values at the corners, (q, 4); images: field -> pixels of the
    particle; extent: of the images; phases: names of the materials by the values of PHASE; empty if all particles are of one material.
    """

    time: float
    level: float
    ground: tuple[NDArray, ...]
    view: View
    loops: list[NDArray]
    corners: NDArray
    rim: NDArray
    is_substrate: NDArray[np.bool_]
    extent: View
    values: dict[str, NDArray]
    images: dict[str, NDArray]
    phases: Sequence[str] = ()


def stored_steps(result: Result) -> int:
    """Number of steps for which particle, surface and target are stored."""
    return min(len(result.times(domain)) for domain in DOMAINS)


def drawable(result: Result) -> list[str]:
    """Keys of FIELDS that particle and target both have; empty if no step is stored."""
    if not stored_steps(result):
        return []
    first = [result.fields(0, domain).data for domain in ("particle", "target")]
    return [name for name in FIELDS if all(name in data for data in first)]


def stage(result: Result) -> Stage:
    """The `Stage` of a run. The plane goes through the middle of the particle at the start. For several particles it goes through the
    centre of one of them and crosses as many particles as possible. Raises StoreError if no step is stored."""
    if not stored_steps(result):
        raise StoreError(f"{result.directory} has no stored step of particle, surface and target: try again later")
    particle, surface, target = (result.fields(0, domain) for domain in DOMAINS)
    start, volume = surface.points, abs(enclosed_volume(surface.points, surface.cells))
    plane = _best_plane(result.plan, float(start[:, 1].min() + start[:, 1].max()) / 2)
    void = VOID * (volume / max(len(particle.points), 1)) ** (1 / 3)
    top, low, high = float(target.points[:, 2].max()) * MICRO, start[:, 0].min() * MICRO, start[:, 0].max() * MICRO
    loops = section_loops(target.points, boundary_faces(target.cells)[0], plane)
    ground = tuple(np.vstack([loop, loop[:1]]) * MICRO for loop in loops)
    under = [line[(line[:, 0] >= low) & (line[:, 0] <= high), 1].max(initial=-np.inf) for line in ground]
    level = float(max(under, default=-np.inf))
    level = level if np.isfinite(level) else top
    return Stage(plane, level, float(high - low), void, top, ground, phases_of(result.plan))


def _best_plane(plan: Values, first: float) -> float:
    """The plane y (m) through the centre of a particle that crosses the largest number of particles of a plan. first: y (m) of the
    first particle, which is the result if the plan cannot be read."""
    try:
        impacts = [(float(each["offset"][1]), float(each["diameter"])) for each in plan["impacts"]]
    except (KeyError, TypeError, IndexError, ValueError):  # no readable plan
        return first
    crossed = [sum(abs(y - plane) < 0.4 * diameter for y, diameter in impacts) for plane, _ in impacts]
    return impacts[best][0] if (best := int(np.argmax([*crossed, 0]))) else first


def view(result: Result, steps: Iterable[int], at: Stage) -> View:
    """Left, right, bottom and top of a picture, um. The picture includes particle, splats and jets at all given steps, with a margin. A
    particle that flies away enlarges the picture at most up to FAR diameters above the highest part of the target."""
    ends, D = [], at.diameter
    for step in steps:
        skin, target = result.fields(step, "surface").points * MICRO, result.fields(step, "target")
        points = target.points * MICRO
        raised = points[points[:, 2] > at.top + RAISED * D]
        limit = float(max(raised[:, 2].max(initial=at.level), at.level) + FAR * D)
        is_away, skin = skin[:, 2].min() > limit - FAR * D, skin[skin[:, 2] < limit]
        splats = points[target.cells[_of_splats(target)].ravel()]
        places = np.concatenate([skin, raised, splats, points[:1]])  # the first node is near the impact
        deepest = min(skin[:, 2].min(initial=at.level), splats[:, 2].min(initial=at.level))
        highest = [*places[:, :2].max(0), limit if is_away else places[:, 2].max()]
        ends.append((places.min(0), highest, deepest))
    low, high = np.min([least for least, _, _ in ends], axis=0), np.max([most for _, most, _ in ends], axis=0)
    middle, half = (low[0] + high[0]) / 2, max(1.5 * D, (high[0] - low[0]) / 2 + 0.4 * D)
    bottom = min(at.level - 0.9 * D, min(deepest for _, _, deepest in ends) - 0.3 * D)
    return float(middle - half), float(middle + half), float(bottom), float(max(high[2], at.level) + 0.15 * D)


def cross_section(
    result: Result, step: int, names: Sequence[str], at: Stage, seen: View, pixels: int = PIXELS
) -> CrossSection:
    """The cross-section of particle and target at a stored step. names: keys of `FIELDS`; at: its plane; seen: extent of the picture;
    pixels: along the longer side of the particle. Raises StoreError if data are missing."""
    particle, surface, target = read(result, step, names)
    loops = [loop * MICRO for loop in section_loops(surface.points, surface.cells, at.plane)]
    images, extent = _images(particle, names, loops, at, pixels)
    if at.phases is not None:
        shell, core = at.phases.particles[impact_at(result, particle.time) - 1]
        image = images[names[0]]
        images[PHASE] = np.where(np.isnan(image), np.nan, np.where(images.get("core", 0.0 * image) > 0.5, core, shell))
    return replace(section_of_bodies(target, names, at, seen), loops=loops, images=images, extent=extent)


def section_of_bodies(target: Fields, names: Sequence[str], at: Stage, seen: View) -> CrossSection:
    """The cross-section of tetrahedra without a particle; arguments as in `cross_section`."""
    polygons, owner = section_of_tets(target.points, target.cells, at.plane)
    corners, share = crossing(target.points, polygons, at.plane)
    corners *= MICRO
    x, z = corners[..., 0], corners[..., 1]
    inside = (x.max(1) > seen[0]) & (x.min(1) < seen[1]) & (z.max(1) > seen[2]) & (z.min(1) < seen[3])
    polygons, corners, share = polygons[inside], corners[inside], share[inside]
    values = {}
    for name in names:
        ends = at_nodes(target, name)[polygons] * FIELDS[name].factor
        values[name] = ends[..., 0] + share * (ends[..., 1] - ends[..., 0])
    rim, is_substrate = section_of_surfaces(target, at)
    phases: Sequence[str] = ()
    if at.phases is not None:
        phases = at.phases.names
        values[PHASE] = np.repeat(at.phases.of(target)[owner[inside], None], 4, axis=1)
    nothing = {name: np.zeros((0, 0)) for name in values}
    extent = (0.0, 1.0, 0.0, 1.0)
    return CrossSection(
        target.time, at.level, at.ground, seen, [], corners, rim, is_substrate, extent, values, nothing, phases
    )


def section_of_surfaces(target: Fields, at: Stage) -> tuple[NDArray, NDArray[np.bool_]]:
    """Lines (r, 2, 2), um, where the plane crosses the surfaces of substrate and splats. Returns also the mask (r,) of the lines of
    the substrate, which is all False if there are no splats."""
    skin, owner = boundary_faces(target.cells)
    splat = _of_splats(target)[owner]
    lines = (section_of_triangles(target.points, skin[which], at.plane) for which in (~splat, splat))
    parts = [crossing(target.points, line, at.plane)[0] * MICRO for line in lines]
    is_substrate = np.repeat([len(parts[1]) > 0, False], [len(part) for part in parts])
    return np.concatenate(parts), is_substrate


def _of_splats(target: Fields) -> NDArray[np.bool_]:
    return np.asarray(target.data["impact"] > 0) if "impact" in target.data else np.zeros(len(target.cells), bool)


def cold_section(result: Result, at: Stage, seen: View) -> tuple[CrossSection, dict[str, Range]]:
    """The cross-section after the closing stage, and the colour scales of COLD_FIELDS and, for several materials, PHASE. The scale of
    the in-plane stress is symmetric about 0. Raises StoreError if the run has no closing stage."""
    bodies = result.fields(-1, COLD)
    bodies.data["in_plane"] = bodies.data["stress"][:, :2].mean(axis=1)
    section = section_of_bodies(bodies, COLD_FIELDS, at, seen)
    ranges = {name: colour_range([section], name) for name in COLD_FIELDS}
    most = max(float(np.percentile(np.abs(section.values["in_plane"]), 98)), FIELDS["in_plane"].least_range)
    return section, with_phases(section, {**ranges, "in_plane": Range(-most, most, exceeded=True)})


def read(result: Result, step: int, names: Collection[str]) -> tuple[Fields, Fields, Fields]:
    """Particle, surface and target at a stored step, checked for a picture. Raises StoreError if there is no such step, a field of
    `names` is missing, or values are not finite."""
    steps = stored_steps(result)
    if not -steps <= step < steps:
        have = f"{steps} steps of particle, surface and target"
        raise StoreError(f"{result.directory} has {have}; step {step} does not exist")
    particle, surface, target = (result.fields(step % steps, domain) for domain in DOMAINS)
    missing = {name for name in names for fields in (particle, target) if name not in fields.data}
    if missing or target.cells.shape[1:] != (4,) or surface.cells.shape[1:] != (3,):
        lacking = ", ".join(sorted(missing)) or "cells"
        raise StoreError(f"{result.directory} lacks fields that a picture needs: {lacking}")
    arrays: list[NDArray] = [fields.points for fields in (particle, surface, target)]
    arrays += [fields.data[name] for name in names for fields in (particle, target)]
    if not all(np.isfinite(part).all() for part in arrays):
        why = "has values that are not finite numbers, because the run became unstable"
        remedy = "choose an earlier step, or compute the scene with a finer preset"
        raise StoreError(f"{result.directory}: step {step % steps} {why}: {remedy}")
    return particle, surface, target


def _images(
    particle: Fields, names: Sequence[str], loops: list[NDArray], at: Stage, pixels: int
) -> tuple[dict[str, NDArray], View]:
    """Pixels (rows from the bottom, columns) over the cross-section of the particle: name -> values, also "core" if it is stored. They
    are averaged over the nearest points, NaN in voids. Returns also the extent of the pixels, um."""
    if not loops:
        return {name: np.zeros((0, 0)) for name in names}, (0.0, 1.0, 0.0, 1.0)
    corners = np.concatenate(loops)
    (left, bottom), (right, top) = corners.min(0), corners.max(0)
    step = max(right - left, top - bottom) / pixels
    columns, rows = (max(int(np.ceil(length / step)), 2) for length in (right - left, top - bottom))
    x = left + (np.arange(columns) + 0.5) * (right - left) / columns
    z = bottom + (np.arange(rows) + 0.5) * (top - bottom) / rows
    grid = np.stack(np.broadcast_arrays(x, at.plane * MICRO, z[:, None]), axis=-1).reshape(-1, 3) / MICRO
    index, weight = from_points(particle.points, grid, at.void)
    images = {}
    for name in [*names, *({"core"} & particle.data.keys())]:
        factor = FIELDS[name].factor if name in FIELDS else 1.0
        values = (weight * at_nodes(particle, name)[index]).sum(1) * factor
        images[name] = values.reshape(rows, columns)
    return images, (float(left), float(right), float(bottom), float(top))


def colour_range(sections: Sequence[CrossSection], name: str) -> Range:
    """The limits of the colour scale of a field for all cross-sections together."""
    field = FIELDS[name]
    each = (part for section in sections for part in (section.values[name], section.images[name]))
    parts = [metal for part in each if (metal := part[np.isfinite(part)]).size]  # without voids
    low = field.floor if field.floor is not None else min((float(part.min()) for part in parts), default=0.0)
    # The percentile of each body limits the influence of a few points at an edge, and of one body on the other
    high = max([*(float(np.percentile(part, 99.5)) for part in parts), low + field.least_range])
    return Range(low, high, any(part.max() > 1.02 * high for part in parts))


def with_phases(section: CrossSection, ranges: Mapping[str, Range]) -> dict[str, Range]:
    """Colour scales of pictures of a cross-section: that of PHASE, if its particles are of several materials, and the given ones."""
    return {**({PHASE: Range(-0.5, len(section.phases) - 0.5)} if section.phases else {}), **ranges}


def outline_of(loops: Sequence[NDArray]) -> Outline:
    """The path along closed lines (k, 2). Each gets its first corner again at the end, because matplotlib ignores the last corner."""
    return Outline.make_compound_path(*(Outline(np.vstack([loop, loop[:1]]), closed=True) for loop in loops))


def draw(axis: Axes, section: CrossSection, name: str, ends: Range) -> None:
    """Draw a cross-section coloured by one field. name: key in FIELDS, or PHASE; ends: limits of its colour scale, in the displayed
    unit."""
    left, right, bottom, top = section.view
    scale, phases = Normalize(ends.low, ends.high), [colour_of(k) for k in range(len(section.phases))]
    colours: str | Colormap = ListedColormap(phases) if name == PHASE else FIELDS[name].colours
    corners, values = section.corners, section.values[name]
    halves = (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(len(corners))[:, None, None]).reshape(-1, 3)
    flat = corners.reshape(-1, 2)
    sides = np.roll(flat[halves], -1, axis=1) - flat[halves]
    # Gouraud shading of triangles thinner than about a pixel makes streaks of wrong colours
    double_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    thick = double_area > (right - left) / 600 * np.hypot(sides[..., 0], sides[..., 1]).max(axis=1)
    style = {"array": values.mean(axis=1), "cmap": colours, "norm": scale, "edgecolors": "face", "linewidths": 0.5}
    axis.add_collection(PolyCollection(list(corners), **style))  # below the shading, against white seams
    if thick.any():
        grid = Triangulation(flat[:, 0], flat[:, 1], halves[thick])
        axis.tripcolor(grid, values.ravel(), cmap=colours, norm=scale, shading="gouraud")
    widths = np.where(section.is_substrate, 2.2, 1.0)
    axis.add_collection(
        LineCollection(list(section.rim), colors="black", linewidths=widths, capstyle="round", zorder=2)
    )
    if section.loops:
        outline = outline_of(section.loops)
        image, extent = section.images[name], section.extent
        style = {"cmap": colours, "norm": scale, "interpolation": "nearest" if name == PHASE else None}
        inside: list[Artist] = [axis.imshow(image, extent=extent, origin="lower", zorder=3, **style)]
        if (hollow := np.isnan(image)).any():
            inside.append(axis.contour(hollow, [0.5], extent=extent, colors="black", linewidths=1.0, zorder=4))
        if "core" in section.images and (core := section.images["core"]).max(where=~hollow, initial=0.0) > 0.5:
            inside.append(axis.contour(core, [0.5], extent=extent, colors="black", linewidths=1.0, zorder=4))
        for artist in inside:
            artist.set_clip_path(outline, axis.transData)
        axis.add_patch(PathPatch(outline, fill=False, edgecolor="black", linewidth=1.3, zorder=5))
        if (lowest := min(float(loop[:, 1].min()) for loop in section.loops)) > top:
            words = f"particle {lowest - section.level:.0f} µm above the surface"
            axis.text(0.5 * (left + right), top, words, ha="center", va="top", fontsize=10)
    beside = 0.02 * (right - left)  # the ends of the polygons are just outside of the picture
    box = Bbox([[left - beside, bottom - beside], [right + beside, top + beside]])
    for line in section.ground:
        within = Outline(line, closed=True).clip_to_bbox(box)
        axis.add_patch(PathPatch(within, fill=False, edgecolor="0.3", linewidth=0.9, linestyle=(0, (6, 4)), zorder=6))
    axis.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axis.set_axis_off()


def colour_bar(box: Axes, name: str, ends: Range, length: float, across: bool = False) -> None:
    """Draw the colour bar of a field. length: length of the bar, inches; across: horizontal."""
    field = FIELDS[name]
    bar = box.figure.colorbar(
        ScalarMappable(Normalize(ends.low, ends.high), field.colours), cax=box,
        extend="max" if ends.exceeded else "neither", orientation="horizontal" if across else "vertical",
    )  # fmt: skip
    label, size = fitted(field.words, length)
    bar.set_label(label, fontsize=size)


def scale_bar(axis: Axes, seen: View, fontsize: float = 11) -> None:
    """Draw a scale bar of 1, 2 or 5 times a power of ten, um. seen: extent of the picture, um."""
    left, right, bottom, top = seen
    wanted = (right - left) / 7
    power = 10.0 ** np.floor(np.log10(wanted))
    length = power * max(step for step in (1, 2, 5) if step * power <= wanted)
    x, z = left + 0.03 * (right - left), bottom + 0.06 * (top - bottom)
    axis.plot([x, x + length], [z, z], color="black", linewidth=3, solid_capstyle="butt", zorder=7)
    style: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "fontsize": fontsize, "zorder": 7}
    axis.annotate(f"{length:g} µm", (x + length / 2, z), (0.0, 4.0), **style)


LONGEST_HEADING = 56  # characters beside the time at the full size of the font


def panels(section: CrossSection, ranges: Mapping[str, Range], heading: str) -> Figure:
    """A figure of one cross-section, with a panel and a colour bar for each field of `ranges`. The panels are one below the other."""
    left, right, bottom, top = section.view
    width, bar, margin, gap = 6.4, 1.15, 0.15, 0.12  # inches
    tall, count = width * (top - bottom) / (right - left), len(ranges)
    size = (width + bar + 2 * margin, count * tall + (count - 1) * gap + margin + 0.55)
    figure = blank(*size, dpi=160)
    for row, (name, ends) in enumerate(ranges.items()):
        axis = axes_at(figure, margin, margin + (count - 1 - row) * (tall + gap), width, tall)
        draw(axis, section, name, ends)
        if name == PHASE:
            name_phases(axis, section.phases, loc="upper right")
        else:
            colour_bar(axis.inset_axes((1.02, 0.02, 0.025, 0.96)), name, ends, 0.96 * tall)
    scale_bar(figure.axes[0], section.view)
    height = 1 - 0.27 / size[1]
    font = 13 * min(1.0, LONGEST_HEADING / max(len(heading), 1))
    figure.text(margin / size[0], height, heading, fontsize=font, va="center", parse_math=False)
    when = f"t = {section.time * 1e9:.1f} ns"
    figure.text(1 - margin / size[0], height, when, fontsize=13, va="center", ha="right")
    return figure


def section_picture(result: Result, path: str | Path | None = None, step: int = -1) -> Path:
    """Draw the cross-section of particle and target, coloured by temperature and by plastic strain, and by material if the particles
    are of several. path: PNG file, default `section.png` in the folder of the run. step: stored step, -1 is the last. Returns
    the path. Raises StoreError if data are missing or the picture cannot be written."""
    path = Path(path) if path is not None else result.directory / "section.png"
    save(section_figure(result, step), path)
    return path


def section_figure(result: Result, step: int = -1) -> Figure:
    """The figure of `section_picture`. Raises StoreError if something to draw is missing."""
    at, names = stage(result), ("T", "eps_p")
    section = cross_section(result, step, names, at, view(result, [step], at))
    return panels(section, with_phases(section, {name: colour_range([section], name) for name in names}), title(result))
