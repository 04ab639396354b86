"""What a person looks at: a picture of the cut through particle and target, and a table of the summary."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .errors import StoreError
from .result import Fields, Result
from .section import crossing, cut_tets, cut_triangles, section_loops

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.table import Table

MICRO = 1e6

# Field, words beside the colour bar, colours. Light is untouched and dark is hot or strained: both maps read
# without telling red from green, and in grey.
PANELS = (
    ("T", "temperature (K)", "YlOrRd"),
    ("eps_p", "equivalent plastic strain", "YlGnBu"),
)
PIXELS = 500  # along the longer side of the particle
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # of a tetrahedron


# ---- the picture ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Cut:
    """What one picture shows. Lengths in um; window: left, right, bottom, top."""

    particle: Fields
    target: Fields
    plane: float  # m
    level: float  # the undeformed surface
    window: tuple[float, float, float, float]
    loops: list[NDArray]  # outline of the particle
    polygons: NDArray[np.int64]  # target, as from cut_tets
    rim: NDArray  # surface of the target, (q, 2, 2)


def section_picture(result: Result, path: str | Path | None = None, step: int = -1) -> Path:
    """Draw the cut through the middle of particle and target, once by temperature, once by plastic strain.

    path: PNG file, `section.png` in the run's folder unless given. step: stored step, -1 is the last.
    Returns the path. Raises StoreError if something to draw is missing or the picture cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path = Path(path) if path is not None else result.directory / "section.png"
    cut = _cut(result, step)
    left, right, bottom, top = cut.window
    width, bar, margin, gap = 6.4, 1.15, 0.15, 0.12  # inches
    tall = width * (top - bottom) / (right - left)
    size = (width + bar + 2 * margin, 2 * tall + gap + margin + 0.55)
    figure = Figure(figsize=size, dpi=160, facecolor="white")
    FigureCanvasAgg(figure)
    for row, panel in enumerate(PANELS):
        low = margin + (1 - row) * (tall + gap)
        axis = figure.add_axes((margin / size[0], low / size[1], width / size[0], tall / size[1]))
        _panel(axis, cut, *panel)
    _scale_bar(figure.axes[0], cut)
    height = 1 - 0.27 / size[1]
    figure.text(margin / size[0], height, _title(result), fontsize=13, va="center", parse_math=False)
    when = f"t = {cut.particle.time * 1e9:.1f} ns"
    figure.text((margin + width) / size[0], height, when, fontsize=13, va="center", ha="right")
    try:
        figure.savefig(path, format="png")
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error.strerror or error}") from error
    return path


def _cut(result: Result, step: int) -> _Cut:
    steps = min(len(result.times(domain)) for domain in ("particle", "surface", "target"))
    if not -steps <= step < steps:
        raise StoreError(f"{result.directory} holds {steps} steps of particle, surface and target, not step {step}")
    step %= steps
    particle, surface, target = (result.fields(step, domain) for domain in ("particle", "surface", "target"))
    missing = {name for name, *_ in PANELS for fields in (particle, target) if name not in fields.data}
    if missing or target.cells.shape[1:] != (4,) or surface.cells.shape[1:] != (3,):
        raise StoreError(f"{result.directory} lacks what a picture needs: {', '.join(sorted(missing)) or 'cells'}")

    start = result.fields(0, "surface").points
    plane = float(start[:, 1].min() + start[:, 1].max()) / 2
    diameter = float(np.ptp(start[:, 0])) * MICRO
    level = float(result.fields(0, "target").points[:, 2].max()) * MICRO
    now = surface.points * MICRO
    middle = (now[:, 0].min() + now[:, 0].max()) / 2
    top = max(now[:, 2].max(), level) + 0.15 * diameter
    window = (middle - 1.5 * diameter, middle + 1.5 * diameter, level - 0.9 * diameter, top)

    polygons, _ = cut_tets(target.points, target.cells, plane)
    corners = crossing(target.points, polygons, plane)[0] * MICRO
    x, z = corners[..., 0], corners[..., 1]
    seen = (x.max(1) > window[0]) & (x.min(1) < window[1]) & (z.max(1) > window[2]) & (z.min(1) < window[3])
    faces = target.cells[:, FACES].reshape(-1, 3)
    _, where, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    rim = crossing(target.points, cut_triangles(target.points, faces[where[count == 1]], plane), plane)[0]
    loops = [loop * MICRO for loop in section_loops(surface.points, surface.cells, plane)]
    return _Cut(particle, target, plane, level, window, loops, polygons[seen], rim * MICRO)


def _panel(axis: Axes, cut: _Cut, name: str, label: str, colours: str) -> None:
    """Draw the cut coloured by one field, with its colour bar."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.colors import Normalize
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline
    from matplotlib.tri import Triangulation

    left, right, bottom, top = cut.window
    corners, share = crossing(cut.target.points, cut.polygons, cut.plane)
    ends = _at_points(cut.target, name)[cut.polygons]
    values = ends[..., 0] + share * (ends[..., 1] - ends[..., 0])
    image, extent = _particle_image(cut, name) if cut.loops else (np.zeros((0, 0)), None)
    shown = np.concatenate([values.ravel(), image.ravel()])
    shown = shown[np.isfinite(shown)]
    low = 0.0 if name == "eps_p" else float(shown.min())
    # A few points at an edge must not take the whole range of colours, nor one body that of the other.
    tops = [np.percentile(part, 99.5) for part in (values, image) if part.size]
    high = float(max([*tops, low + (0.01 if name == "eps_p" else 1.0)]))
    scale = Normalize(low, high)

    halves = (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(len(corners))[:, None, None]).reshape(-1, 3)
    flat = corners.reshape(-1, 2) * MICRO
    sides = np.roll(flat[halves], -1, axis=1) - flat[halves]
    # Thinner than a pixel or two they show nothing but streaks of colours beyond those of their corners.
    double_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    thick = double_area > (right - left) / 600 * np.hypot(sides[..., 0], sides[..., 1]).max(axis=1)
    grid = Triangulation(flat[:, 0], flat[:, 1], halves[thick])
    below = {
        "array": values.mean(axis=1),
        "cmap": colours,
        "norm": scale,
        "edgecolors": "face",
        "linewidths": 0.5,
    }
    axis.add_collection(PolyCollection(list(corners * MICRO), **below))  # so that no seam shows white
    axis.tripcolor(grid, values.ravel(), cmap=colours, norm=scale, shading="gouraud")
    rim = LineCollection(list(cut.rim), colors="black", linewidths=1.0, capstyle="round", zorder=2)
    axis.add_collection(rim)
    if cut.loops:
        closed = (Outline(np.vstack([loop, loop[:1]]), closed=True) for loop in cut.loops)
        outline = Outline.make_compound_path(*closed)
        picture = axis.imshow(image, extent=extent, origin="lower", cmap=colours, norm=scale, zorder=3)
        picture.set_clip_path(outline, axis.transData)
        axis.add_patch(PathPatch(outline, fill=False, edgecolor="black", linewidth=1.3, zorder=5))
    axis.plot([left, right], [cut.level] * 2, color="0.3", linewidth=0.9, dashes=(6, 4), zorder=6)
    axis.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axis.set_axis_off()
    box = axis.inset_axes((1.02, 0.02, 0.025, 0.96))
    above = "max" if len(shown) and shown.max() > high * 1.02 else "neither"
    bar = axis.figure.colorbar(ScalarMappable(scale, colours), cax=box, extend=above)
    bar.set_label(label, fontsize=11)


def _particle_image(cut: _Cut, name: str) -> tuple[NDArray, tuple[float, float, float, float]]:
    """A particle's field on pixels over its section, averaged from the nearest points; the extent in um."""
    from scipy.spatial import cKDTree

    corners = np.concatenate(cut.loops)
    (left, bottom), (right, top) = corners.min(0), corners.max(0)
    step = max(right - left, top - bottom) / PIXELS
    columns, rows = (max(int(np.ceil(length / step)), 2) for length in (right - left, top - bottom))
    x = left + (np.arange(columns) + 0.5) * (right - left) / columns
    z = bottom + (np.arange(rows) + 0.5) * (top - bottom) / rows
    grid = np.stack(np.broadcast_arrays(x, cut.plane * MICRO, z[:, None]), axis=-1).reshape(-1, 3) / MICRO
    near = min(12, len(cut.particle.points))
    distance, index = cKDTree(cut.particle.points).query(grid, k=near)
    distance, index = distance.reshape(len(grid), near), index.reshape(len(grid), near)
    # Weights fall over the distance of the points from each other, wherever that has been stretched.
    reach = np.maximum(distance[:, min(3, near - 1)], 1e-12)[:, None]
    weight = np.exp(-((distance / reach) ** 2))
    values = (weight * _at_points(cut.particle, name)[index]).sum(1) / weight.sum(1)
    return values.reshape(rows, columns), (left, right, bottom, top)


def _at_points(fields: Fields, name: str) -> NDArray:
    """A field at the points, (n,); values in tetrahedra are averaged with the volumes as weights."""
    values = fields.data[name].astype(float)
    if len(values) == len(fields.points):
        return values
    corners = fields.points[fields.cells]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    where, count = fields.cells.ravel(), len(fields.points)
    weight = np.bincount(where, np.repeat(volume, 4), count)
    return np.bincount(where, np.repeat(volume * values, 4), count) / np.where(weight > 0, weight, 1.0)


def _scale_bar(axis: Axes, cut: _Cut) -> None:
    left, right, bottom, top = cut.window
    wanted = (right - left) / 7
    power = 10.0 ** np.floor(np.log10(wanted))
    length = power * max(step for step in (1, 2, 5) if step * power <= wanted)
    x, z = left + 0.03 * (right - left), bottom + 0.06 * (top - bottom)
    axis.plot([x, x + length], [z, z], color="black", linewidth=3, solid_capstyle="butt", zorder=7)
    axis.text(x + length / 2, z + 0.03 * (top - bottom), f"{length:g} µm", ha="center", fontsize=11, zorder=7)


def _title(result: Result) -> str:
    """Material, size and speed in the scene's own words; what the scene does not say is left out."""
    try:
        scene = tomllib.loads(result.scene_text)
        particle, substrate = scene["particle"], scene["substrate"]
        particle = particle[0] if isinstance(particle, list) else particle
        words = [particle["diameter"], particle["material"], "on", substrate["material"]]
        words += ["at", particle["velocity"]]
        angle = str(particle.get("angle", "0 deg"))
        if float(angle.split()[0]) != 0.0:
            words += ["and", angle.replace(" deg", "°")]
    except (StoreError, tomllib.TOMLDecodeError, LookupError, TypeError, ValueError, AttributeError):
        return result.directory.name
    return " ".join(str(word)[:40] for word in words).replace(" um ", " µm ")


# ---- the table -----------------------------------------------------------------------------------------

# Ending of a key -> factor and unit in which people read it; the longest ending that fits counts.
UNITS = {
    "_m_s": (1.0, "m/s"),
    "_m": (1e6, "µm"),
    "_Pa": (1e-6, "MPa"),
    "_K": (1.0, "K"),
    "_kg": (1e12, "ng"),
    "_J": (1e9, "nJ"),
    "_s": (1e9, "ns"),
}
SPECIAL = {
    "dt_mean_s": (1e12, "ps"),
    "wall_s": (1.0, "s"),
    "wall_loop_s": (1.0, "s"),
    "energy_drift": (100.0, "%"),
    "momentum_error": (1.0, ""),
    "numerical_dissipation": (100.0, "%"),
}
LABELS = {
    "time_s": "time",
    "flattening_ratio": "flattening, above surface",
    "flattening_ratio_total": "flattening, whole",
    "eps_p_mean": "mean plastic strain",
    "eps_p_p99": "plastic strain, 99 %",
    "eps_p_max": "greatest plastic strain",
    "T_mean_K": "mean temperature",
    "T_p99_K": "temperature, 99 %",
    "T_max_K": "highest temperature",
    "von_mises_max_Pa": "highest von Mises stress",
    "target_eps_p_max": "greatest plastic strain",
    "target_T_max_K": "highest temperature",
    "target_von_mises_max_Pa": "highest von Mises stress",
    "penetration_max_m": "greatest penetration",
    "kinetic_energy_0_J": "kinetic energy at the start",
    "sim_time_s": "simulated time",
    "wall_s": "wall time",
    "wall_loop_s": "wall time of the steps",
    "dt_mean_s": "mean time step",
    "version": "coldspray",
}
NOTES = ("effects", "warnings")  # lists of words, below the table
GROUPS = {
    "shape": (
        "time",
        "flattening",
        "height",
        "thickness",
        "splat",
        "crater",
        "velocity",
        "rebound",
        "penetration",
    ),
    "particle": ("eps_p", "T_", "von_mises"),
    "balance, of the initial energy": ("energy", "momentum", "numerical"),
    "target": ("target",),
    "run": ("",),  # whatever is left
}


def summary_table(result: Result) -> Table:
    """The summary for a terminal, in units that people use, as a rich table.

    What the blocks "greatest_deformation" and "end" hold stands side by side, all else in the last column.
    """
    from rich.table import Table
    from rich.text import Text

    summary = result.summary
    peak, end = (summary.get(name) for name in ("greatest_deformation", "end"))
    peak, end = (block if isinstance(block, Mapping) else {} for block in (peak, end))
    single = {key: value for key, value in summary.items() if not isinstance(value, Mapping)}
    last = {**single, **end}

    table = Table(title=Text(_title(result)), title_justify="left", title_style="bold")
    table.add_column("")
    if peak:
        table.add_column("greatest\ndeformation", justify="right")
    table.add_column("end" if peak else "", justify="right")
    table.add_column("")
    left = [key for key in dict.fromkeys([*peak, *end, *single]) if key not in NOTES]
    for group, starts in GROUPS.items():
        keys = [key for key in left if key.startswith(starts)]
        left = [key for key in left if key not in keys]
        if not keys:
            continue
        table.add_section()
        table.add_row(Text(group, style="bold"))
        for key in keys:
            label, unit = _words(key)
            cells = [_value(key, block.get(key)) for block in ([peak] if peak else []) + [last]]
            table.add_row(Text("  " + label), *(Text(cell) for cell in cells), Text(unit))
    notes = [f"{name}: {_value(name, single[name])}" for name in NOTES if single.get(name)]
    table.caption = Text("\n".join(notes), justify="left")
    return table


def _scale(key: str) -> tuple[str, float, str]:
    """Key without its unit, factor and unit to show it in."""
    if key in SPECIAL:
        return key, *SPECIAL[key]
    for ending, (factor, unit) in UNITS.items():
        if key.endswith(ending):
            return key.removesuffix(ending), factor, unit
    return key, 1.0, ""


def _words(key: str) -> tuple[str, str]:
    name, _, unit = _scale(key)
    return LABELS.get(key, name.replace("_", " ")), unit


def _value(key: str, value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", " ")
    if isinstance(value, float):
        return f"{value * _scale(key)[1]:.4g}"
    if isinstance(value, list):
        return ", ".join(str(item) for item in value)
    return str(value)
