"""Measures of a coating: thickness, roughness and porosity from vertical columns on a grid (`Columns`); state of each layer;
stress."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import StoreError
from ..files.inputs import parse_toml
from ..files.result import COLD, Result, first_step, impact_at
from ..geometry.tetrahedra import volumes
from ..measures import BROKEN, EMBEDDED, REBOUNDS, UNDECIDED
from ..physics.shapes import sphere_volume
from ..plan.model import ImpactPlan
from ..plan.record import read_plan
from ..report.words import with_error
from .splats import Columns, Splats, roughness

DISC = 0.6  # radius of the measured disc over the radius of the patch on which centres of particles fall
# splat element sizes: thinner voids cannot be distinguished from the gap between facets and a round surface
FINEST = 0.25
SECTORS = 8  # of the disc, for the standard error of a mean
COARSE = 2.0  # distance of the columns for a row of the growth table, over their distance for the final measures
MOST = 60  # rows of the growth table
COLUMN = 0.125  # splat element sizes between two columns, and between two heights
FATES = {EMBEDDED: "embedded", REBOUNDS: "bounced", BROKEN: "broken"}  # verdicts on ceramic particles, and words
NO_SEEDS = "not measured: compute three other seeds with coldspray coating DIR --seeds 3"
Growth = dict[str, float]  # see `growth_row`
NOT_COLD = "the bodies have not cooled: their stresses are not residual stresses"


def read(result: Result, before: int | None = None) -> Splats:
    """The coating of a run so far, finished or not; with `before`, the coating at the start of the impact of this number. Raises
    StoreError if no impact is finished, or the elements have no field "impact"."""
    plan = read_plan(result.directory)
    numbers = result.history("impact")
    if not len(numbers) or not len(result.times("target")):
        raise StoreError(f"{result.directory} has no impact yet: try again later")
    done = before or int(numbers.max())
    is_cold = before is None and len(result.times(COLD)) > 0
    mesh = result.fields(-1 if before is None else first_step(result, before), COLD if is_cold else "target")
    if not is_cold:  # with fields of ends only, the impact that is computed has none yet
        done = min(done, impact_at(result, mesh.time))
    if "impact" not in mesh.data:
        raise StoreError(
            f"{result.directory} has no field 'impact' for its elements: run the scene again with this version"
        )
    body, came = mesh.data["body"].astype(np.int64), mesh.data["impact"].astype(np.int64)
    impact = np.zeros(int(body.max()) + 1, np.int64)
    impact[body] = came
    inner = np.unique(body[mesh.data["core"] > 0.5]).tolist() if "core" in mesh.data else []
    cores = {b: plan.impacts[impact[b] - 1].materials[-1].name for b in inner}
    left, last = [number not in impact for number in range(1, done)], None
    if is_cold:
        left.append(done not in impact)
    elif before is None and result.finished and result.undecided is None:
        left.append(bool(result.summary["impacts"][-1]["rebounded"]))
        surface = result.fields(-1, "surface")
        last = None if left[-1] else (surface.points, surface.cells)
    elif not left:
        raise StoreError(f"{result.directory}: no impact is finished yet: try again later")
    impacts = plan.impacts[: len(left)]  # without a last one that is unfinished or undecided
    mass = np.array([p.rho * sphere_volume(p.diameter) for p in impacts])
    coating = parse_toml(result.scene_text).get("coating")
    stayed = 1.0 - np.array(left)
    if before is None and result.finished:
        detached = np.array([record.get("detached_mass_kg", 0.0) for record in result.summary["impacts"]])
        stayed *= 1.0 - detached[: len(mass)] / mass
    records = result.summary["impacts"][: len(left)] if before is None and result.finished else []
    undecided = tuple(i for i, record in enumerate(records) if record["verdict"] == UNDECIDED and not left[i])
    patch = units.parse(coating["radius"], "length") if coating else max(math.hypot(*p.offset) for p in impacts)
    verdicts, layers = tuple(str(record["verdict"]) for record in records), coating["layers"] if coating else 1
    return Splats(mesh, body, impact, last, stayed, mass, tuple(map(_parts, impacts)), len(plan.impacts), layers, patch,
                  plan.splat_element_size, is_cold, undecided, verdicts, cores, plan.target.heights)  # fmt: skip


def _parts(particle: ImpactPlan) -> dict[str, float]:
    """Mass fraction of each material of a particle, that of the shell first."""
    shell, core = particle.material, particle.core
    if core is None or core.material.name == shell.name:
        return {shell.name: 1.0}
    share = core.share * core.material.rho / particle.rho
    return {shell.name: 1.0 - share, core.material.name: share}


@dataclass(frozen=True)
class SeedError:
    """A measure in coatings of several seeds, SI. error: standard error of the mean; least, greatest: smallest and largest value."""

    seeds: int
    mean: float
    error: float
    least: float
    greatest: float

    def words(self, factor: float, unit: str) -> str:
        """Text such as "; 4 seeds: 40.8 ± 0.6 µm, 39.5 to 42.1". factor: factor from SI to the unit."""
        ends = " to ".join(f"{factor * end:.3g}" for end in (self.least, self.greatest))
        return f"; {self.seeds} seeds: {with_error(factor * self.mean, factor * self.error)}{unit}, {ends}"


@dataclass(frozen=True)
class CoatingMeasures:
    """Measures of a coating in SI units. The names are the keys of coating.json.

    impacts, of: numbers of finished and of planned impacts. undecided: number of undecided particles, which count as stayed in
    deposition_efficiency and as lost in least_efficiency. thickness: vertical height of the coating above the original surface of the
    substrate; metal in craters below does not count; 0 without coating. height_mean_m: mean height of the surface, craters included,
    above the original surface, as a profilometer measures it. bare_share: share of the disc without coating. overlap_share: share of
    the volume of the coating that lies in more than one body; the porosity is too high by up to this share, because this metal is
    missing elsewhere.
    void_limit_m: voids of a lower height are not resolved. stress_in_plane_Pa: mean of (xx + yy) / 2 over the volume of the coating in
    the disc, with its standard error (`in_plane`); in a cold coating it is the residual stress. thermal_in_plane_Pa: the part of this
    stress that changes of temperature cause. layers, depth, phases, materials: rows of the functions of these names (`per_layer`,
    `over_depth`). seeds: measure -> its error, if other seeds are computed (`coating_seeds`).
    """

    impacts: int
    of: int
    rebounded: int
    undecided: int
    deposition_efficiency: float
    least_efficiency: float
    disc_radius_m: float
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
    materials: list[dict[str, float | str]]
    warnings: list[str]
    seeds: dict[str, SeedError]


def measure(splats: Splats, radius: float | None = None) -> CoatingMeasures:
    """All measures of a coating. radius (m): radius of the measured disc; default: `disc_radius`. Raises StoreError if there is no
    coating."""
    if not splats.stayed.any():
        raise StoreError("no particle has stayed on the target, so there is no coating: give a run with splats")
    size, planned = splats.element_size, splats.planned
    radius = radius or disc_radius(splats)
    finished = len(splats.mass)
    unfinished = f"the run is not finished: {finished} of {planned} impacts"
    stress, error = in_plane(splats, radius, "stress")
    return CoatingMeasures(
        impacts=finished, of=planned, rebounded=int((splats.stayed <= 0.0).sum()),
        undecided=len(splats.undecided), deposition_efficiency=splats.deposition_efficiency,
        least_efficiency=splats.least_efficiency, disc_radius_m=radius, column_m=COLUMN * size,
        **shape(splats, radius, COLUMN * size), void_limit_m=FINEST * size,
        stress_in_plane_Pa=stress, stress_error_Pa=error, thermal_in_plane_Pa=in_plane(splats, radius, "thermal_stress")[0],
        layers=per_layer(splats, -(-planned // splats.layers)), depth=over_depth(splats, radius, 0.5 * size),
        phases=phases(splats, radius), materials=materials(splats, radius),
        warnings=([] if finished == planned else [unfinished]) + ([] if splats.is_cold else [NOT_COLD]), seeds={},
    )  # fmt: skip


def disc_radius(splats: Splats) -> float:
    """Default radius (m) of the measured disc: DISC times `Splats.patch`, but at least four element sizes of the splats."""
    return max(DISC * splats.patch, 4.0 * splats.element_size)


def shape(splats: Splats, radius: float, step: float) -> dict[str, float]:
    """Thickness, heights and roughness (m), and volume fractions of voids and overlap, in a disc of `radius` m. They follow from
    vertical columns `step` m apart."""
    columns = Columns(splats, (0.0, 0.0), radius, step)
    top = columns.highest(columns.matter)
    at = np.column_stack([columns.x, columns.y])
    ground = splats.ground(at)
    is_bare = columns.highest(columns.substrate) > top - step
    thickness = np.where(is_bare, 0.0, np.maximum(top - ground, 0.0))
    plane = np.column_stack([np.ones(len(at)), at])
    Sa, Sq = roughness(top - plane @ np.linalg.lstsq(plane, ground, rcond=None)[0])
    opened, closed = columns.voids(FINEST * splats.element_size)
    volume = max(float((columns.splat & ~columns.substrate).sum() + opened.sum() + closed.sum()), 1.0)
    return {
        "thickness_mean_m": float(thickness.mean()), "thickness_min_m": float(thickness.min()),
        "thickness_max_m": float(thickness.max()), "height_mean_m": float((top - ground).mean()), "bare_share": float(is_bare.mean()),
        "Sa_m": Sa, "Sq_m": Sq, "porosity_open": float(opened.sum()) / volume, "porosity_closed": float(closed.sum()) / volume,
        "overlap_share": float(columns.double.sum()) / volume,
    }  # fmt: skip


def in_plane(splats: Splats, radius: float, name: str) -> tuple[float, float | None]:
    """Mean of (xx + yy) / 2 of a stress field over the volume of the coating inside a disc, Pa, and its standard error.

    radius: radius of the disc, m; name: name of the field; the mean is 0 without this field. The error describes the variation over
    the disc: each of SECTORS sectors is left out in turn (delete-one jackknife of a ratio; Cochran 1977, Sampling techniques, 3rd
    ed., section 6.17). A sector contains all layers, because their stresses differ systematically. None if fewer than two sectors
    contain coating.
    """
    mesh = splats.mesh
    x, y = mesh.points[mesh.cells].mean(axis=1)[:, :2].T
    own = (np.hypot(x, y) <= radius) & (splats.impact[splats.body] > 0)
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
    """The measures of a coating as (label, text with units), for terminal and page."""
    um = {name: f"{1e6 * value:.1f} µm" for name, value in vars(measures).items() if name.endswith("_m")}
    count, left = measures.impacts, measures.rebounded
    stay, least = (f"{count - left} of {count}" if left else f"all {count}") + " particles stay", ""
    if measures.undecided:
        stay += f", {measures.undecided} of these are undecided"
        least = f"{measures.least_efficiency:.1%} to "
    is_cold = NOT_COLD not in measures.warnings  # else the stress from cooling is unknown
    error = "" if measures.stress_error_Pa is None else f" ± {1e-6 * measures.stress_error_Pa:.0f}"
    stress, thermal = 1e-6 * measures.stress_in_plane_Pa, 1e-6 * measures.thermal_in_plane_Pa

    def seeds(key: str, factor: float, unit: str) -> str:
        return measures.seeds[key].words(factor, unit) if key in measures.seeds else ""

    parts = f" = {stress - thermal:+.0f} MPa from the impacts {thermal:+.0f} MPa from cooling" if is_cold else ""
    texts = {
        "thickness above the original surface": f"{um['thickness_mean_m']} on average, {um['thickness_min_m']}"
        f" to {um['thickness_max_m']};"
        f" {measures.bare_share:.1%} of the surface is bare{seeds('thickness_mean_m', 1e6, ' µm')}",
        "roughness": f"Sa {um['Sa_m']}, Sq {um['Sq_m']}{seeds('Sa_m', 1e6, ' µm')}",
        "porosity": f"{measures.porosity_closed:.2%} closed, {measures.porosity_open:.2%} open; these are too high by up to"
        f" {measures.overlap_share:.2%}, where bodies overlap; voids lower than {1e6 * measures.void_limit_m:.2f} µm are not resolved"
        + seeds("porosity_closed", 100.0, " %"),
        "deposition efficiency": f"{least}{measures.deposition_efficiency:.1%} of the mass: {stay}"
        + seeds("deposition_efficiency", 100.0, " %"),
        f"{'residual stress' if is_cold else 'stress before cooling'}, in plane": f"{stress:+.0f}{error} MPa{parts};"
        f" mean over the volume of the splats, the error is the variation over the disc{seeds('stress_in_plane_Pa', 1e-6, ' MPa')}",
        "metals": "; ".join(
            f"{row['metal']} {row['volume_share']:.1%} of the volume, {row['fed_share']:.1%} of the mass fed,"
            f" {row['deposited_share']:.1%} of the mass deposited, efficiency {row['efficiency']:.1%}"
            + "".join(f", {row[fate]} {word}" for fate, word in FATES.items() if fate in row)
            for row in measures.phases
        ),
        "materials": "; ".join(
            f"{row['material']} {row['volume_share']:.1%} of the volume, {row['deposited_share']:.1%} of the mass deposited"
            for row in measures.materials
        ),
        "measured": f"within {um['disc_radius_m']} of the axis, away from the rim of the coated area",
        "error": "standard error of the mean of the seeds, and the range" if measures.seeds else NO_SEEDS,
    }
    one_each = {row["metal"] for row in measures.phases} == {row["material"] for row in measures.materials}
    shown = {"metals": len(measures.phases) > 1, "materials": not one_each}
    return [(label, text) for label, text in texts.items() if shown.get(label, True)]


def phases(splats: Splats, radius: float) -> list[dict[str, float | str]]:
    """Fractions of each powder: of the fed mass, of the mass in the coating, and of the volume of the coating in a disc of `radius` m.
    efficiency: mass of the powder in the coating divided by its fed mass. If particles are embedded or broken (ceramic), the row has
    the number of particles with each verdict of FATES. The last particle, which consists of points, is not part of the volume."""
    stays, of_body = splats.mass * splats.stayed, _volumes(splats, radius)
    volume = np.bincount(splats.impact, of_body, len(splats.mass) + 1)[1:]
    rows = list[dict[str, float | str]]()
    for name in dict.fromkeys(splats.metal):
        of = splats.metal == name
        fed, left = splats.mass[of].sum(), stays[of].sum()
        shares = {
            "fed_share": fed / splats.mass.sum(), "deposited_share": left / stays.sum(), "efficiency": left / fed,
            "volume_share": volume[of].sum() / max(volume.sum(), 1e-300),
        }  # fmt: skip
        verdicts = [verdict for verdict, own in zip(splats.verdicts, of, strict=False) if own]
        fates = {fate: verdicts.count(fate) for fate in FATES} if {EMBEDDED, BROKEN} & set(verdicts) else {}
        rows.append({"metal": str(name)} | {key: float(share) for key, share in shares.items()} | fates)
    return rows


def materials(splats: Splats, radius: float) -> list[dict[str, float | str]]:
    """Fractions of each material: of the mass in the coating, and of the volume of the coating in a disc of `radius` m. The materials
    of shell and core of composite particles count separately."""
    stays, volume = splats.mass * splats.stayed, _volumes(splats, radius)
    of_body = np.array([splats.material(b, i) if i else "" for b, i in enumerate(splats.impact.tolist())])
    return [
        {
            "material": name,
            "deposited_share": float(stays @ [part.get(name, 0.0) for part in splats.parts] / stays.sum()),
            "volume_share": float(volume[of_body == name].sum() / max(volume.sum(), 1e-300)),
        }
        for name in splats.materials
    ]


def _volumes(splats: Splats, radius: float) -> NDArray:
    """Volume (m3) of each body of the coating within `radius` m of the axis; 0 for the substrate."""
    mesh = splats.mesh
    x, y = mesh.points[mesh.cells].mean(axis=1)[:, :2].T
    own = (np.hypot(x, y) <= radius) & (splats.impact[splats.body] > 0)
    return np.bincount(splats.body[own], np.abs(volumes(mesh.points, mesh.cells[own])), len(splats.impact))


def per_layer(splats: Splats, each: int) -> list[dict[str, float]]:
    """Volume-weighted mean, 99th percentile and maximum of strain, temperature and stress in each layer of `each` particles. Layer 0 is
    the yielded part of the substrate. The last particle, which consists of points, is left out."""
    volume, data = np.abs(volumes(splats.mesh.points, splats.mesh.cells)), splats.mesh.data
    layer = np.where(splats.impact > 0, (splats.impact - 1) // each + 1, 0)[splats.body]
    rows = []
    for index in range(int(layer.max()) + 1):
        own = (layer == index) & ((index > 0) | (data["eps_p"] > 0.002))
        if not own.any():
            continue
        impacts = splats.impact[np.unique(splats.body[own])]
        count = len(np.unique(impacts[impacts > 0]))  # a splat may have several bodies
        row: dict[str, float] = {"layer": index, "splats": count, "volume_m3": float(volume[own].sum())}
        for name in ("eps_p", "T", "von_mises"):
            value = data[name][own].astype(float)
            row[f"{name}_mean"] = float(np.average(value, weights=volume[own]))
            row[f"{name}_p99"] = float(_percentiles(value, volume[own], 0.99))
            row[f"{name}_max"] = float(value.max())
        rows.append(row)
    return rows


def _percentiles(values: NDArray, weights: NDArray, shares: ArrayLike) -> NDArray:
    """Weighted quantiles of `values` (n,) with `weights` (n,) at `shares` (k,)."""
    return np.asarray(np.quantile(values, np.asarray(shares, float), weights=weights, method="inverted_cdf"))


def over_depth(splats: Splats, radius: float, step: float) -> list[dict[str, float]]:
    """Volume means of stress (Pa), strain and temperature in slices of the disc, `step` m high and parallel to the original surface,
    from the top down.

    sigma_xx, sigma_yy are in the plane of a flat surface, sigma_zz is normal to it; tension is positive. thermal_xx etc., for a cold
    coating: the part that changes of temperature cause; the impacts cause the rest. sigma_p5, sigma_p95: quantiles of (xx + yy) / 2.
    coating: volume share of splats in the slice.
    """
    middle = splats.mesh.points[splats.mesh.cells].mean(axis=1)
    own = np.hypot(middle[:, 0], middle[:, 1]) <= radius
    z = middle[own, 2] - splats.ground(middle[own, :2])
    volume = np.abs(volumes(splats.mesh.points, splats.mesh.cells[own]))
    tensors = {"sigma": splats.mesh.data["stress"], "thermal": splats.mesh.data.get("thermal_stress")}
    columns = {
        f"{name}_{axis}": tensor[own, i].astype(float)
        for name, tensor in tensors.items() if tensor is not None
        for i, axis in enumerate(("xx", "yy", "zz"))
    }  # fmt: skip
    columns |= {name: splats.mesh.data[name][own].astype(float) for name in ("von_mises", "eps_p", "T")}
    columns["coating"] = (splats.impact[splats.body[own]] > 0).astype(float)
    slot = np.floor(z / step).astype(int)
    rows = []
    for index in np.unique(slot)[::-1]:
        here = slot == index
        if here.sum() >= 4:
            means = {name: float(np.average(value[here], weights=volume[here])) for name, value in columns.items()}
            in_surface = 0.5 * (columns["sigma_xx"] + columns["sigma_yy"])[here]
            low, high = _percentiles(in_surface, volume[here], (0.05, 0.95))
            means |= {"sigma_p5": float(low), "sigma_p95": float(high)}
            rows.append({"z_m": (index + 0.5) * step, "volume_m3": float(volume[here].sum()), **means})
    return rows


def growth(result: Result, radius: float | None = None) -> list[Growth]:
    """Rows (see `growth_row`): one after each finished impact or, for more than MOST impacts, MOST evenly spread ones. radius (m):
    radius of the measured disc; default: the disc of the coating."""
    built = read(result)
    radius = radius or disc_radius(built)
    finished = len(built.mass)
    numbers = np.unique(np.linspace(2, finished, min(MOST, finished) - 1).round().astype(int))
    rows = [growth_row(read(result, number), radius) for number in numbers.tolist()]
    return [*rows, growth_row(built, radius)]


def latest(result: Result) -> Growth:
    """The row of the growth table at the start of the latest impact. Raises StoreError if no impact is finished before it."""
    built = read(result, int(result.history("impact").max(initial=0.0)))
    return growth_row(built, disc_radius(built))


def growth_row(built: Splats, radius: float) -> Growth:
    """A row of the growth table. impacts: number of finished impacts; splats: number of splats in the coating; deposition_efficiency;
    measures of `coating.shape`."""
    counts = {"impacts": len(built.mass), "splats": float(np.count_nonzero(built.stayed))}
    measures = shape(built, radius, COARSE * COLUMN * built.element_size)
    return {**counts, "deposition_efficiency": built.deposition_efficiency, **measures}


def growth_line(now: Growth) -> str:
    """A row of the growth table as a text line."""
    return (
        f"after impact {now['impacts']:.0f}: splats {now['splats']:.0f}, thickness {now['thickness_mean_m'] * 1e6:.1f} um"
        f" (bare {now['bare_share']:.0%}), Sa {now['Sa_m'] * 1e6:.1f} um, porosity {now['porosity_closed']:.1%} closed,"
        f" {now['porosity_open']:.1%} open, deposition efficiency {now['deposition_efficiency']:.0%}"
    )
