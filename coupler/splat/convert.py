"""Conversion of a cloud of points (a splat) to bodies of tetrahedra with the same state."""

import time as clock

import numpy as np
from scipy.spatial import cKDTree

from ..errors import DependencyError, SplatError
from ..geometry.graph import connected_parts
from ..geometry.tetrahedra import TETS_PER_H3
from .cloud import MIN_POINTS, Body, Cloud, Report, Splat
from .core import parts_of
from .meshing import SIGMAS, CloudShape, build_mesh, strategies
from .quality import fit_of
from .transfer import transfer

METHODS = ("auto", "carried", "density")
MAX_ELEMENTS = 5e6
LINK = 2.5  # spacings: largest distance between neighbours in a stretched body
MIN_TETS = 40  # approximate smallest number of elements of a fragment: its element size is reduced for this


def convert(cloud: Cloud, element_size: float, method: str = "auto") -> Splat:
    """Mesh a cloud with elements of about element_size m and transfer its state.

    method: "carried" uses the carried surface, "density" the density of the points; "auto" tries the carried surface first, if
    there is one, and then the density. Raises SplatError if the cloud cannot be meshed.
    """
    if method not in METHODS:
        raise SplatError(f"unknown method {method!r}: choose one of {', '.join(METHODS)}")
    if method == "carried" and cloud.surface is None:
        raise SplatError(
            "method 'carried' needs the carried surface of the body, but the cloud has none: use method 'density'"
        )
    cloud.check()
    if not (np.isfinite(element_size) and element_size > 0.0):
        raise SplatError(f"element_size must be positive, is {element_size:g}: give a length")
    expected = TETS_PER_H3 * cloud.solid_volume / element_size**3
    if expected > MAX_ELEMENTS:
        remedy = (
            f"give a larger element size, at least {1.005 * element_size * (expected / MAX_ELEMENTS) ** (1 / 3):.3g} m"
        )
        raise SplatError(f"this body would have {expected:.2g} elements of {element_size:.3g} m: {remedy}")
    start = clock.perf_counter()
    try:
        parts = separate_bodies(cloud, element_size, method)
        sorting = clock.perf_counter() - start
        meshed = [mesh_body(shape, index, element_size, method) for index, shape in parts]
    except (ArithmeticError, LookupError, MemoryError, ValueError) as problem:
        remedy = "try another element size, or check the points"
        raise SplatError(f"this cloud cannot be meshed ({type(problem).__name__}: {problem}): {remedy}") from problem
    bodies = [body for own in meshed for body in own]
    report = _total([own[0].report for own in meshed], sorting)
    lost = len(cloud.x) - sum(len(body.cloud_index) for body in bodies)
    return Splat(bodies, report | {"lost_points": lost, "wall_s": clock.perf_counter() - start})


def separate_bodies(cloud: Cloud, element_size: float, method: str) -> list[tuple[np.ndarray, CloudShape]]:
    """The separate bodies of a cloud, largest first: indices of their points, and their shapes. Raises SplatError if there is none."""
    pairs = cKDTree(cloud.x).query_pairs(LINK * cloud.spacing, output_type="ndarray")
    count, part = connected_parts(pairs, len(cloud.x))
    groups = sorted((np.flatnonzero(part == i) for i in range(count)), key=len, reverse=True)
    large = [group for group in groups if len(group) >= MIN_POINTS]
    if not large:
        few = f"fewer than {MIN_POINTS} points of the cloud lie within {LINK} spacings of each other"
        raise SplatError(f"{few}: check the spacing ({cloud.spacing:.3g} m)")
    bodies = [body for group in large for body in _separate(cloud, group, element_size, method)]
    return sorted(bodies, key=lambda body: -len(body[0]))


def _separate(cloud: Cloud, index: np.ndarray, element_size: float, method: str) -> list[tuple[np.ndarray, CloudShape]]:
    """The bodies in a connected part of a cloud. There are several if its shape consists of separate pieces close to each other."""

    def shape_of(part: np.ndarray) -> CloudShape:
        return CloudShape(cloud.part(part), np.delete(cloud.x, part, axis=0))

    body = shape_of(index)
    sources = [s.source for s in strategies(method, cloud.surface is not None)]
    for source in dict.fromkeys(sources):
        try:
            shape = body.find(source, _size_of(body.cloud, element_size), SIGMAS[0])
        except SplatError:
            continue
        if len(shape.pieces) > 1:
            cells_x = [shape.field.origin + cells * shape.field.h for cells in shape.pieces]
            nearest = np.argmin([cKDTree(x).query(body.cloud.x)[0] for x in cells_x], axis=0)
            parts = [index[nearest == i] for i in range(len(cells_x))]
            if large := [part for part in parts if len(part) >= MIN_POINTS]:
                return [(part, shape_of(part)) for part in large]
        break
    return [(index, body)]


def _size_of(cloud: Cloud, element_size: float) -> float:
    """Element size (m) for a body: the given size, or a smaller one so that the body has at least about MIN_TETS elements."""
    return min(element_size, (TETS_PER_H3 * cloud.solid_volume / MIN_TETS) ** (1.0 / 3.0))


def mesh_body(shape: CloudShape, index: np.ndarray, element_size: float, method: str) -> list[Body]:
    """Mesh one body of a cloud and transfer its state; a body with a core becomes shell and core. index: its points in the
    cloud. Raises SplatError if every strategy fails."""
    cloud, failed = shape.cloud, []
    seconds: dict[str, float] = {}
    for strategy in strategies(method, cloud.surface is not None):
        try:
            points, tets, report = build_mesh(strategy, shape, _size_of(cloud, element_size), seconds)
        except SplatError as problem:
            failed.append(f"{strategy}: {problem}")
            continue
        except DependencyError:
            raise
        except Exception as problem:  # another strategy can still succeed
            failed.append(f"{strategy}: {type(problem).__name__}: {problem}")
            continue
        start = clock.perf_counter()
        states, errors = [], dict[str, float]()
        for is_core, own, nodes, corners in parts_of(cloud, points, tets):
            state, own_errors = transfer(cloud.part(own), nodes, corners)
            states.append(state | {"points": nodes, "tets": corners, "cloud_index": index[own], "is_core": is_core})
            errors = {key: max(errors.get(key, 0.0), error, key=abs) for key, error in own_errors.items()}
        report |= {"method": str(strategy), "points": len(index), "transfer": errors}
        report |= fit_of(points, tets, cloud)
        if cloud.wave_speed is not None:
            report["dt_s"] = report["step_length_min_m"] / cloud.wave_speed
        seconds["transfer"] = clock.perf_counter() - start
        report |= {"seconds": seconds, "failed": failed}
        return [Body(**state, report=report) for state in states]
    reasons = "; ".join(dict.fromkeys(reason.split(": ", 1)[1] for reason in failed))
    none = f"no mesh of the body of {len(index)} points has a sufficient quality"
    raise SplatError(f"{none}: {reasons}. Try another element size, or check the spacing")


def _total(reports: list[Report], sorting: float) -> Report:
    """The report of a splat (`Report`) from the reports of its bodies. sorting: wall time of `separate_bodies`, s."""
    seconds = {"sorting": sorting}
    for report in reports:
        for stage, spent in report["seconds"].items():
            seconds[stage] = seconds.get(stage, 0.0) + spent
    failed = [reason for report in reports for reason in report["failed"]]
    sums = {key: sum(report[key] for report in reports) for key in ("tets", "nodes", "volume_m3")}
    least = "gamma_min", "dihedral_min_deg", "step_length_min_m", "dt_s"
    worst = {key: min(report[key] for report in reports) for key in least if key in reports[0]}
    return {**reports[0], "bodies": len(reports), "failed": failed, "seconds": seconds, **sums, **worst}
