"""Measures of a coating: thickness, roughness, porosity, and state of each layer, on a grid of upright columns (`Columns`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from .. import units
from ..errors import StoreError
from ..files.fields import Fields
from ..files.inputs import parse_toml
from ..files.result import COLD, Result, first_step
from ..geometry.raycast import RaySurface
from ..geometry.tetrahedra import boundary_faces, volumes
from ..geometry.triangles import area_vectors
from ..measures import UNDECIDED
from ..physics.shapes import sphere_volume
from ..plan.record import read_plan
from ..report.words import with_error

DISC = 0.6  # of the radius on which centres fall: what is measured, away from the rim of the patch
FINEST = 0.25  # splat element sizes: voids thinner than that are not told from the facets that meshes make of a round surface
SECTORS = 8  # of the disc, for the error of a mean
COLUMN = 0.125  # splat element sizes between two columns, and between two heights
NO_SEEDS = "not measured: coldspray coating DIR --seeds 3 computes three other seeds"
NOT_COLD = "the bodies have not cooled: their stresses are not residual stresses"


@dataclass(frozen=True)
class Splats:
    """The coating at the last written step, or cold after the closing stage (is_cold). mesh: substrate and splats;
    body (m,): of each tetrahedron, 0 the substrate; impact (bodies,): from which each came,
    counted from 1, 0 for the substrate. last: surface of the last particle, still made of
    points, (points (k,3) m, triangles), None if it has left; of each finished impact: mass (n,) kg, stayed (n,), the
    share of it that is in the coating, metal (n,): its name; planned: impacts of the run, in so many layers; patch m: radius of the
    disc that particles are aimed at; element_size m: of the splats; undecided: indices of the impacts that are counted as stayed
    without a verdict."""

    mesh: Fields
    body: NDArray[np.int64]
    impact: NDArray[np.int64]
    last: tuple[NDArray, NDArray] | None
    stayed: NDArray
    mass: NDArray
    metal: NDArray
    planned: int
    layers: int
    patch: float
    element_size: float
    is_cold: bool = False
    undecided: tuple[int, ...] = ()

    @property
    def deposition_efficiency(self) -> float:
        """Mass that stayed over the mass of all particles that have hit; undecided particles count as stayed."""
        return float(self.mass @ self.stayed / self.mass.sum())

    @property
    def least_efficiency(self) -> float:
        """Deposition efficiency if all undecided particles count as lost."""
        lost = sum(self.mass[i] * self.stayed[i] for i in self.undecided)
        return self.deposition_efficiency - lost / float(self.mass.sum())


def read(result: Result, before: int | None = None) -> Splats:
    """The coating that a run has built so far, finished or not; before: until the impact of this number begins. Raises StoreError where
    the files do not name the body of each element."""
    plan = read_plan(result.directory)
    numbers = result.history("impact")
    if not len(numbers) or not len(result.times("target")):
        raise StoreError(f"{result.directory} has no impact yet: nothing to measure")
    done = before or int(numbers.max())
    is_cold = before is None and len(result.times(COLD)) > 0
    step = -1 if before is None else first_step(result, before)
    mesh = result.fields(step, COLD if is_cold else "target")
    if "impact" not in mesh.data:
        raise StoreError(
            f"{result.directory} has no field that names the splat of each tetrahedron: run the scene again with this version"
        )
    body, came = mesh.data["body"].astype(np.int64), mesh.data["impact"].astype(np.int64)
    impact = np.zeros(int(body.max()) + 1, np.int64)
    impact[body] = came
    left, last = [number not in impact for number in range(1, done)], None
    if is_cold:
        left.append(done not in impact)
    elif before is None and result.finished and result.undecided is None:
        left.append(bool(result.summary["impacts"][-1]["rebounded"]))
        surface = result.fields(-1, "surface")
        last = None if left[-1] else (surface.points, surface.cells)
    elif not left:
        raise StoreError(f"{result.directory}: no impact is finished yet: nothing to measure")
    impacts = plan.impacts[: len(left)]  # one that is still falling, or undecided, is not counted
    mass = np.array([p.material.rho * sphere_volume(p.diameter) for p in impacts])
    metal = np.array([p.material.name for p in impacts])
    coating = parse_toml(result.scene_text).get("coating")
    stayed = 1.0 - np.array(left)
    if before is None and result.finished:
        detached = np.array([record.get("detached_mass_kg", 0.0) for record in result.summary["impacts"]])
        stayed *= 1.0 - detached[: len(mass)] / mass
    records = result.summary["impacts"][: len(left)] if before is None and result.finished else []
    undecided = tuple(i for i, record in enumerate(records) if record["verdict"] == UNDECIDED and not left[i])
    patch = units.parse(coating["radius"], "length") if coating else max(math.hypot(*p.offset) for p in impacts)
    return Splats(mesh, body, impact, last, stayed, mass, metal, len(plan.impacts), coating["layers"] if coating else 1, patch,
                  plan.splat_element_size, is_cold, undecided)  # fmt: skip


class Columns:
    """Upright columns over a disc of `radius` m about `centre`, `step` m apart, of cells `step` high from z = low on. Where a column
    passes through matter follows from where it crosses the closed surfaces of the bodies.

    matter (k, layers): which cells lie in the substrate or a splat; splat, substrate: in one of these; double: in more than one of all.
    x, y (k,) m. A cell is in a body where its middle is.
    """

    def __init__(self, splats: Splats, centre: tuple[float, float], radius: float, step: float):
        self.step = step
        n = max(int(np.ceil(radius / step)), 4)
        axis = (np.arange(-n, n) + 0.5) * step
        self.inside = np.hypot(*np.meshgrid(axis, axis, indexing="ij")) <= radius
        self._origin, self._side = (centre[0] - n * step, centre[1] - n * step), 2 * n
        faces, behind = boundary_faces(splats.mesh.cells)  # bodies share no nodes
        body = splats.body[behind]
        of_each = np.split(faces[np.argsort(body, kind="stable")], np.cumsum(np.bincount(body))[:-1])
        skins = [(splats.mesh.points, own, b > 0) for b, own in enumerate(of_each)]
        if splats.last is not None:
            skins.append((*splats.last, True))
        points, faces, _ = skins[0]
        corners, upward = points[faces], area_vectors(points, faces)[:, 2] > 0.0
        near = np.hypot(corners[..., 0] - centre[0], corners[..., 1] - centre[1]).min(axis=1) <= radius
        deepest = [float(corners[upward & near, :, 2].min(initial=0.0))]
        deepest += [float(points[faces, 2].min()) for points, faces, splat in skins if splat]
        self.low = min(deepest) - 8.0 * step
        self.layers = int(np.ceil((max(float(x[f, 2].max()) for x, f, _ in skins) - self.low) / step)) + 2
        count = np.zeros((2, self._side, self._side, self.layers + 1), np.int16)
        for points, faces, splat in skins:
            self._cross(points, faces, count[int(splat)])
        layered = np.cumsum(count[..., :-1], axis=-1, dtype=np.int16)
        solid = layered > 0
        self.double = ((layered.sum(axis=0) > 1) & solid[1])[self.inside]  # where a crater folds no splat overlaps
        self.splat = solid[1][self.inside]
        self.substrate = solid[0][self.inside]
        self.matter = self.splat | self.substrate
        grid = np.stack(np.meshgrid(axis + centre[0], axis + centre[1], indexing="ij"), axis=-1)
        self.x, self.y = grid[self.inside].T

    def _cross(self, points: NDArray, faces: NDArray, count: NDArray) -> None:
        """Note where columns enter (+1) and leave (-1) a closed surface of triangles that turn outwards."""
        h, aside = self.step, (0.5011, 0.5007)  # so that no column runs along an edge, which two triangles share
        corners = points[faces][..., :2]
        low, high = (extreme(axis=(0, 1)) for extreme in (corners.min, corners.max))
        # those that may pass through the body, and one more on each side
        first, stop = ((ends - self._origin) / h - aside for ends in (low, high))
        first, stop = (np.clip(ends, 0, self._side).astype(int) for ends in (np.floor(first), np.ceil(stop) + 1))
        if (first >= stop).any():
            return
        i, j = (axis.ravel() for axis in np.mgrid[first[0] : stop[0], first[1] : stop[1]])
        x, y = ((axis + part) * h + start for axis, part, start in zip((i, j), aside, self._origin, strict=True))
        column, z, face = RaySurface(points, faces, closed=False).on_verticals(x, y)
        k = np.ceil((z - self.low) / h - 0.5).astype(int).clip(0, self.layers)
        downward = area_vectors(points, faces)[face, 2] < 0.0  # is entered
        np.add.at(count, (i[column], j[column], k), np.where(downward, 1, -1).astype(np.int16))

    def highest(self, cells: NDArray) -> NDArray:
        """Height (k,) m of the highest of some cells (k, layers) in each column: of matter the top, of the substrate the interface."""
        last = self.layers - np.argmax(cells[:, ::-1], axis=1)
        return np.where(cells.any(axis=1), self.low + last * self.step, self.low)

    def voids(self, thinnest: float) -> tuple[NDArray, NDArray]:
        """Cells (k, layers) without matter below each column's top: (open, closed); closed are those that no way through cells without
        matter joins to the outside. Voids lower than `thinnest` m are taken for matter."""
        span = max(round(thinnest / self.step), 0)
        whole = np.zeros((self._side, self._side, self.layers), bool)
        whole[self.inside] = self.matter
        if span > 0:
            pad = ((0, 0), (0, 0), (span + 1, span + 1))
            closed = ndimage.binary_closing(np.pad(whole, pad, mode="edge"), np.ones((1, 1, span + 1), bool))
            whole |= closed[..., span + 1 : -span - 1]
        below = np.cumsum(whole[..., ::-1], axis=-1)[..., ::-1] > 0
        below &= self.inside[..., None]
        empty = ~whole
        # the outside: above the tops; the disc's rim is no outside, or half of what touches it would count as open
        label, _ = ndimage.label(empty & self.inside[..., None])
        outer = np.unique(label[empty & ~below & self.inside[..., None]])
        outside = np.isin(label, outer[outer > 0])
        void = empty & below
        return (void & outside)[self.inside], (void & ~outside)[self.inside]


def roughness(z: NDArray) -> tuple[float, float]:
    """Sa and Sq, m, of heights z (k,) on an even grid: mean and root mean square of their distance from the mean (ISO 25178-2), which
    is a plane parallel to the substrate: one fitted to a disc of a few splats would take the largest of their steps away."""
    away = z - z.mean()
    return float(np.abs(away).mean()), float(np.sqrt((away**2).mean()))


@dataclass(frozen=True)
class SeedError:
    """A measure over several seeds, SI: mean, standard error of the mean, least and greatest value."""

    seeds: int
    mean: float
    error: float
    least: float
    greatest: float

    def words(self, factor: float, unit: str) -> str:
        """The error in a unit: "; 4 seeds: 40.8 ± 0.6 µm, 39.5 to 42.1"."""
        ends = " to ".join(f"{factor * end:.3g}" for end in (self.least, self.greatest))
        return f"; {self.seeds} seeds: {with_error(factor * self.mean, factor * self.error)}{unit}, {ends}"


@dataclass(frozen=True)
class CoatingMeasures:
    """Measures of a coating, SI; the keys of coating.json. impacts, of: finished and planned; undecided: impacts with that verdict,
    which count as stayed in deposition_efficiency and as lost in least_efficiency; thickness: height of the coating above the old
    surface of the substrate, z = 0, so that metal inside craters does not count, 0 where there is none; height_mean_m: mean height
    of the surface, craters included, as a profilometer steps from the old surface; bare_share: share of the disc
    without coating; overlap_share: of the coating's volume that more than one body fills: the matter there is missing elsewhere, so
    that the porosity is too high by up to that; void_limit_m: height below which a void is not resolved; stress_in_plane_Pa: mean over
    the coating's volume in the disc of (xx + yy) / 2, residual once cold, and its standard error, None of one sector (`in_plane`);
    thermal_in_plane_Pa: the part of it that changes of temperature have made; layers, depth, phases: rows of `per_layer`, `over_depth`,
    `phases`;
    seeds: measure -> its error, where other seeds are computed (`coating_seeds`)."""

    impacts: int
    of: int
    rebounded: int
    undecided: int
    deposition_efficiency: float
    least_efficiency: float
    window_radius_m: float
    column_m: float
    thickness_mean_m: float
    thickness_min_m: float
    thickness_max_m: float
    height_mean_m: float
    bare_share: float
    Sa_m: float
    Sq_m: float
    porosity_open: float
    porosity_closed: float
    overlap_share: float
    void_limit_m: float
    stress_in_plane_Pa: float
    stress_error_Pa: float | None
    thermal_in_plane_Pa: float
    layers: list[dict[str, float]]
    depth: list[dict[str, float]]
    phases: list[dict[str, float | str]]
    warnings: list[str]
    seeds: dict[str, SeedError]


def measure(splats: Splats, radius: float | None = None) -> CoatingMeasures:
    """All measures of a coating. radius: of the disc, m; DISC of the patch's by default. Raises StoreError where there is none."""
    if not splats.stayed.any():
        raise StoreError("no particle has stayed on the target: there is no coating to measure")
    size, planned = splats.element_size, splats.planned
    radius = radius or disc_radius(splats)
    finished = len(splats.mass)
    unfinished = f"the run is not finished: {finished} of {planned} impacts"
    stress, error = in_plane(splats, radius, "stress")
    return CoatingMeasures(
        impacts=finished, of=planned, rebounded=int((splats.stayed <= 0.0).sum()),
        undecided=len(splats.undecided), deposition_efficiency=splats.deposition_efficiency,
        least_efficiency=splats.least_efficiency, window_radius_m=radius, column_m=COLUMN * size,
        **shape(splats, radius, COLUMN * size), void_limit_m=FINEST * size,
        stress_in_plane_Pa=stress, stress_error_Pa=error, thermal_in_plane_Pa=in_plane(splats, radius, "thermal_stress")[0],
        layers=per_layer(splats, -(-planned // splats.layers)), depth=over_depth(splats, radius, 0.5 * size),
        phases=phases(splats, radius),
        warnings=([] if finished == planned else [unfinished]) + ([] if splats.is_cold else [NOT_COLD]), seeds={},
    )  # fmt: skip


def disc_radius(splats: Splats) -> float:
    """Default radius (m) of the measured disc."""
    return max(DISC * splats.patch, 4.0 * splats.element_size)


def shape(splats: Splats, radius: float, step: float) -> dict[str, float]:
    """Thickness, heights, roughness, m, and the shares of voids and overlap in a disc of `radius` m, from columns `step` m apart."""
    columns = Columns(splats, (0.0, 0.0), radius, step)
    top = columns.highest(columns.matter)
    is_bare = columns.highest(columns.substrate) > top - step
    thickness = np.where(is_bare, 0.0, np.maximum(top, 0.0))
    Sa, Sq = roughness(top)
    opened, closed = columns.voids(FINEST * splats.element_size)
    volume = max(float((columns.splat & ~columns.substrate).sum() + opened.sum() + closed.sum()), 1.0)
    return {
        "thickness_mean_m": float(thickness.mean()), "thickness_min_m": float(thickness.min()),
        "thickness_max_m": float(thickness.max()), "height_mean_m": float(top.mean()), "bare_share": float(is_bare.mean()),
        "Sa_m": Sa, "Sq_m": Sq, "porosity_open": float(opened.sum()) / volume, "porosity_closed": float(closed.sum()) / volume,
        "overlap_share": float(columns.double.sum()) / volume,
    }  # fmt: skip


def in_plane(splats: Splats, radius: float, name: str) -> tuple[float, float | None]:
    """Mean over the coating's volume in the disc of (xx + yy) / 2 of a stress, Pa, and its standard error; 0 where the mesh has none.

    radius m. The error is that from place to place: of a mean with the volumes as weights, with each of SECTORS sectors of the disc
    left out in turn (delete-one jackknife of a ratio; Cochran 1977, Sampling techniques, 3rd ed., section 6.17). A sector holds all
    layers, whose stresses differ by more than chance. None where the coating fills fewer than two.
    """
    mesh = splats.mesh
    x, y = mesh.points[mesh.cells].mean(axis=1)[:, :2].T
    own = (np.hypot(x, y) <= radius) & (splats.body > 0)
    if name not in mesh.data or not own.any():
        return 0.0, None
    of_tet = np.abs(volumes(mesh.points, mesh.cells[own]))
    sector = ((np.arctan2(y, x)[own] / (2.0 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    volume = np.bincount(sector, of_tet)
    load = np.bincount(sector, of_tet * 0.5 * mesh.data[name][own, :2].sum(axis=1))
    mean, is_there = float(load.sum() / volume.sum()), volume > 0.0
    n = int(is_there.sum())
    if n < 2:
        return mean, None
    without = ((load.sum() - load) / (volume.sum() - volume))[is_there]
    return mean, float(np.sqrt((n - 1) * without.var()))


def lines(measures: CoatingMeasures) -> list[tuple[str, str]]:
    """The measures of a coating in words: label and value with its unit, for the terminal and the page."""
    um = {name: f"{1e6 * value:.1f} µm" for name, value in vars(measures).items() if name.endswith("_m")}
    count, left = measures.impacts, measures.rebounded
    stay, least = (f"{count - left} of {count}" if left else f"all {count}") + " particles stay", ""
    if measures.undecided:
        stay += f", {measures.undecided} of these are undecided"
        least = f"{measures.least_efficiency:.1%} to "
    is_cold = NOT_COLD not in measures.warnings  # else it is not known what cooling adds
    error = "" if measures.stress_error_Pa is None else f" ± {1e-6 * measures.stress_error_Pa:.0f}"
    stress, thermal = 1e-6 * measures.stress_in_plane_Pa, 1e-6 * measures.thermal_in_plane_Pa

    def seeds(key: str, factor: float, unit: str) -> str:
        return measures.seeds[key].words(factor, unit) if key in measures.seeds else ""

    parts = f" = {stress - thermal:+.0f} MPa of the impacts {thermal:+.0f} MPa of cooling" if is_cold else ""
    texts = {
        "thickness above the old surface": f"{um['thickness_mean_m']} in the mean, {um['thickness_min_m']} to {um['thickness_max_m']};"
        f" {measures.bare_share:.1%} of the surface is bare{seeds('thickness_mean_m', 1e6, ' µm')}",
        "roughness": f"Sa {um['Sa_m']}, Sq {um['Sq_m']}{seeds('Sa_m', 1e6, ' µm')}",
        "porosity": f"{measures.porosity_closed:.2%} closed, {measures.porosity_open:.2%} open; too high by up to"
        f" {measures.overlap_share:.2%}, where bodies overlap; voids lower than {1e6 * measures.void_limit_m:.2f} µm are not resolved"
        + seeds("porosity_closed", 100.0, " %"),
        "deposition efficiency": f"{least}{measures.deposition_efficiency:.1%} of the mass: {stay}"
        + seeds("deposition_efficiency", 100.0, " %"),
        f"{'residual stress' if is_cold else 'stress before cooling'}, in plane": f"{stress:+.0f}{error} MPa{parts};"
        f" mean over the volume of the splats, error from place to place{seeds('stress_in_plane_Pa', 1e-6, ' MPa')}",
        **(
            {
                "metals": "; ".join(
                    f"{row['metal']} {row['volume_share']:.1%} of the volume, {row['fed_share']:.1%} of the mass fed,"
                    f" {row['deposited_share']:.1%} of the mass deposited, efficiency {row['efficiency']:.1%}"
                    for row in measures.phases
                )
            }
            if len(measures.phases) > 1
            else {}
        ),
        "measured": f"within {um['window_radius_m']} of the axis, away from the rim of the patch",
        "error": "standard error of the mean of the seeds, and the range" if measures.seeds else NO_SEEDS,
    }
    return list(texts.items())


def phases(splats: Splats, radius: float) -> list[dict[str, float | str]]:
    """Shares of each metal: of the mass that is fed and that stays, of the volume of the coating in a disc of `radius` m; efficiency:
    the mass of the metal that stays over the mass that is fed. The last particle, still made of points, has no volume here."""
    mesh, stays = splats.mesh, splats.mass * splats.stayed
    x, y = mesh.points[mesh.cells].mean(axis=1)[:, :2].T
    own = (np.hypot(x, y) <= radius) & (splats.body > 0)
    volume = np.bincount(
        splats.impact[splats.body[own]] - 1, np.abs(volumes(mesh.points, mesh.cells[own])), len(splats.mass)
    )
    rows = list[dict[str, float | str]]()
    for name in dict.fromkeys(splats.metal):
        of = splats.metal == name
        fed, left = splats.mass[of].sum(), stays[of].sum()
        shares = {
            "fed_share": fed / splats.mass.sum(), "deposited_share": left / stays.sum(), "efficiency": left / fed,
            "volume_share": volume[of].sum() / max(volume.sum(), 1e-300),
        }  # fmt: skip
        rows.append({"metal": str(name)} | {key: float(share) for key, share in shares.items()})
    return rows


def per_layer(splats: Splats, each: int) -> list[dict[str, float]]:
    """Strain, temperature and stress of the substrate (layer 0: what yielded of it) and of each layer of `each` particles, over volume.
    The last particle, still made of points, is in none of them."""
    volume, data = np.abs(volumes(splats.mesh.points, splats.mesh.cells)), splats.mesh.data
    layer = np.where(splats.impact > 0, (splats.impact - 1) // each + 1, 0)[splats.body]
    rows = []
    for number in range(int(layer.max()) + 1):
        own = (layer == number) & ((number > 0) | (data["eps_p"] > 0.002))
        if not own.any():
            continue
        count = int(np.sum(np.unique(splats.body[own]) > 0))
        row: dict[str, float] = {"layer": number, "splats": count, "volume_m3": float(volume[own].sum())}
        for name in ("eps_p", "T", "von_mises"):
            value = data[name][own].astype(float)
            row[f"{name}_mean"] = float(np.average(value, weights=volume[own]))
            row[f"{name}_p99"] = float(_percentiles(value, volume[own], 0.99))
            row[f"{name}_max"] = float(value.max())
        rows.append(row)
    return rows


def _percentiles(values: NDArray, weights: NDArray, shares: ArrayLike) -> NDArray:
    """The values (k,) below which these shares of their weights (k,) lie."""
    return np.asarray(np.quantile(values, np.asarray(shares, float), weights=weights, method="inverted_cdf"))


def over_depth(splats: Splats, radius: float, step: float) -> list[dict[str, float]]:
    """Means over volume of the stress (Pa) and of strain and temperature in slices `step` m high of the disc, from the top down.

    sigma_xx, sigma_yy lie in the surface, sigma_zz across it; tension is positive. thermal_xx and so on: the part due to
    changes of temperature, for a cold coating; the rest is due to the impacts. sigma_p5, sigma_p95: of (xx + yy) / 2. coating:
    share of splats in the slice's matter.
    """
    middle = splats.mesh.points[splats.mesh.cells].mean(axis=1)
    own = np.hypot(middle[:, 0], middle[:, 1]) <= radius
    z, volume = middle[own, 2], np.abs(volumes(splats.mesh.points, splats.mesh.cells[own]))
    tensors = {"sigma": splats.mesh.data["stress"], "thermal": splats.mesh.data.get("thermal_stress")}
    columns = {
        f"{name}_{axis}": tensor[own, i].astype(float)
        for name, tensor in tensors.items() if tensor is not None
        for i, axis in enumerate(("xx", "yy", "zz"))
    }  # fmt: skip
    columns |= {name: splats.mesh.data[name][own].astype(float) for name in ("von_mises", "eps_p", "T")}
    columns["coating"] = (splats.body[own] > 0).astype(float)
    slot = np.floor(z / step).astype(int)
    rows = []
    for number in np.unique(slot)[::-1]:
        here = slot == number
        if here.sum() >= 4:
            means = {name: float(np.average(value[here], weights=volume[here])) for name, value in columns.items()}
            in_surface = 0.5 * (columns["sigma_xx"] + columns["sigma_yy"])[here]
            low, high = _percentiles(in_surface, volume[here], (0.05, 0.95))
            means |= {"sigma_p5": float(low), "sigma_p95": float(high)}
            rows.append({"z_m": (number + 0.5) * step, "volume_m3": float(volume[here].sum()), **means})
    return rows
