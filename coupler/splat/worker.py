"""The process that meshes: python -m coupler.splat.worker FOLDER, started by `convert`.

Each attempt is written to attempts.jsonl before it begins, and its failure after it. An attempt without an outcome is one in
which a process died; `convert` closes it and starts another process.
"""

import json
import sys
import time as clock
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..errors import SplatError
from ..geometry.tetrahedra import TETS_PER_H3
from .cloud import MIN_POINTS, Body, Cloud, Report
from .fit import fit_of
from .meshing import SIGMAS, CloudShape, build_mesh, strategies
from .transfer import transfer

LINK = 2.5  # spacings: the largest distance of neighbours in a stretched body
ARRAYS_OF_BODY = ("points", "tets", "cloud_index")
MIN_TETS = 40  # of a fragment: its elements are made small enough for about that number


@dataclass(frozen=True)
class Task:
    """element_size: m. method: one of `convert.METHODS`."""

    element_size: float
    method: str


def write_task(folder: Path, cloud: Cloud, task: Task) -> None:
    """Write a cloud and its task for the worker."""
    arrays = _arrays(cloud, [field.name for field in fields(cloud) if field.name != "surface"])
    if cloud.surface is not None:
        arrays["vertices"], arrays["triangles"] = cloud.surface
    np.savez(folder / "cloud.npz", allow_pickle=False, **arrays)
    (folder / "task.json").write_text(json.dumps(asdict(task)))


def _arrays(record: Cloud | Body, names: Iterable[str]) -> dict[str, NDArray]:
    return {name: np.asarray(getattr(record, name)) for name in names if getattr(record, name) is not None}


def read_task(folder: Path) -> tuple[Cloud, Task]:
    """The cloud and the task that `write_task` wrote."""
    with np.load(folder / "cloud.npz", allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    surface = (arrays.pop("vertices"), arrays.pop("triangles")) if "vertices" in arrays else None
    spacing, rho = float(arrays.pop("spacing")), float(arrays.pop("rho"))
    wave_speed = float(arrays.pop("wave_speed")) if "wave_speed" in arrays else None
    cloud = Cloud(**arrays, spacing=spacing, rho=rho, surface=surface, wave_speed=wave_speed)
    return cloud, Task(**json.loads((folder / "task.json").read_text()))


@dataclass(frozen=True)
class Attempt:
    """A strategy tried for a body. failed: the reason, None while it runs and where it succeeded."""

    body: int
    strategy: str
    failed: str | None


class Attempts:
    """The attempts of all processes, in one file of the folder."""

    def __init__(self, folder: Path):
        self.path = folder / "attempts.jsonl"

    def read(self) -> list[Attempt]:
        """All lines, in order."""
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        return [Attempt(**json.loads(line)) for line in lines]

    def failed(self, body: int) -> list[Attempt]:
        """The failures of a body."""
        return [row for row in self.read() if row.body == body and row.failed is not None]

    def add(self, body: int, strategy: str, failed: str | None = None) -> None:
        """Append a line."""
        with open(self.path, "a") as file:
            file.write(json.dumps(asdict(Attempt(body, strategy, failed))) + "\n")

    def close_last(self, reason: str) -> bool:
        """Mark the last attempt as failed. Returns False where none is open."""
        rows = self.read()
        if not rows or rows[-1].failed is not None:
            return False
        self.add(rows[-1].body, rows[-1].strategy, reason)
        return True


def linked_groups(x: np.ndarray, spacing: float) -> list[np.ndarray]:
    """Indices of the parts of a cloud (n,3) whose points are linked within LINK spacings, largest first."""
    pairs = cKDTree(x).query_pairs(LINK * spacing, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), shape=(len(x), len(x)))
    count, part = connected_components(graph, directed=False)
    return sorted((np.flatnonzero(part == i) for i in range(count)), key=len, reverse=True)


def element_size_of(cloud: Cloud, task: Task) -> float:
    """Element size (m) for a body: the task's, or smaller where that gives fewer than MIN_TETS elements."""
    return min(task.element_size, (TETS_PER_H3 * cloud.solid_volume / MIN_TETS) ** (1.0 / 3.0))


def separate(cloud: Cloud, index: np.ndarray, task: Task) -> list[tuple[np.ndarray, CloudShape]]:
    """The bodies in a linked part of a cloud: several where its shape is in pieces, close to each other but not touching."""

    def shape_of(part: np.ndarray) -> CloudShape:
        return CloudShape(cloud.part(part), np.delete(cloud.x, part, axis=0))

    body = shape_of(index)
    sources = [s.source for s in strategies(task.method, cloud.surface is not None) if s.source != "paper"]
    for source in dict.fromkeys(sources):
        try:
            shape = body.find(source, element_size_of(body.cloud, task), SIGMAS[0])
        except SplatError:
            continue
        if len(shape.pieces) > 1:
            places = [shape.field.origin + cells * shape.field.h for cells in shape.pieces]
            nearest = np.argmin([cKDTree(place).query(body.cloud.x)[0] for place in places], axis=0)
            parts = [index[nearest == i] for i in range(len(places))]
            if large := [part for part in parts if len(part) >= MIN_POINTS]:
                return [(part, shape_of(part)) for part in large]
        break
    return [(index, body)]


def mesh_body(
    shape: CloudShape, index: np.ndarray, number: int, task: Task, folder: Path, attempts: Attempts
) -> Report:
    """Mesh one body, the points `index` of the cloud, and write it to body_`number`.npz.

    Returns its report. Raises SplatError where every strategy fails.
    """
    cloud = shape.cloud
    size = element_size_of(cloud, task)
    seconds: dict[str, float] = {}
    for strategy in strategies(task.method, cloud.surface is not None)[len(attempts.failed(number)) :]:
        attempts.add(number, str(strategy))
        try:
            points, tets, report = build_mesh(strategy, shape, size, seconds)
        except SplatError as problem:
            attempts.add(number, str(strategy), str(problem))
            continue
        except Exception as problem:  # another strategy may still succeed
            attempts.add(number, str(strategy), f"{type(problem).__name__}: {problem}")
            continue
        start = clock.perf_counter()
        state, mass_scale, errors = transfer(cloud, points, tets)
        report |= {"method": str(strategy), "points": len(index), "mass_scale": mass_scale, "transfer": errors}
        report |= fit_of(points, tets, cloud)
        if cloud.wave_speed is not None:
            report["dt_s"] = report["step_length_min_m"] / cloud.wave_speed
        seconds["transfer"] = clock.perf_counter() - start
        report["seconds"] = seconds
        report["failed"] = [f"{row.strategy}: {row.failed}" for row in attempts.failed(number)]
        body = Body(points, tets, mass_scale, index, report=report, **state)
        np.savez(folder / f"body_{number}.npz", allow_pickle=False, **_arrays(body, (*ARRAYS_OF_BODY, *state)))
        (folder / f"body_{number}.json").write_text(json.dumps(report))
        return report
    raise SplatError(
        f"no mesh of body {number} ({len(index)} points) passed: "
        + "; ".join(f"{row.strategy}: {row.failed}" for row in attempts.failed(number))
        + ". Try another element size, or method 'stuffing'"
    )


def main(folder: Path) -> None:
    """Convert the cloud in the folder; writes body_*.npz and summary.json."""
    summary: Mapping[str, object]
    try:
        cloud, task = read_task(folder)
        start = clock.perf_counter()
        large = [group for group in linked_groups(cloud.x, cloud.spacing) if len(group) >= MIN_POINTS]
        if not large:
            raise SplatError(
                f"no {MIN_POINTS} points of the cloud lie within {LINK} spacings of each other: check the spacing "
                f"({cloud.spacing:.3g} m)"
            )
        bodies = [body for group in large for body in separate(cloud, group, task)]
        bodies.sort(key=lambda body: -len(body[0]))
        attempts, sorting = Attempts(folder), clock.perf_counter() - start
        reports: list[Report] = []
        for number, (index, shape) in enumerate(bodies):
            done = folder / f"body_{number}.json"
            reports.append(
                json.loads(done.read_text())
                if done.exists()
                else mesh_body(shape, index, number, task, folder, attempts)
            )
        summary = {"error": None, "bodies": reports, "report": _total(reports, sorting)}
    except SplatError as problem:
        summary = {"error": str(problem)}
    except (ArithmeticError, LookupError, MemoryError, ValueError) as problem:
        summary = {"error": f"no body can be made of this cloud ({type(problem).__name__}: {problem})"}
    (folder / "summary.json").write_text(json.dumps(summary))


def _total(reports: list[Report], sorting: float) -> Report:
    """The report of a splat: sums and worst values over its bodies, and the largest body's own measures."""
    seconds = {"sorting": sorting}
    for report in reports:
        for stage, spent in report["seconds"].items():
            seconds[stage] = seconds.get(stage, 0.0) + spent
    total: Report = {
        **reports[0],
        "bodies": len(reports),
        "tets": sum(report["tets"] for report in reports),
        "nodes": sum(report["nodes"] for report in reports),
        "volume_m3": sum(report["volume_m3"] for report in reports),
        "gamma_min": min(report["gamma_min"] for report in reports),
        "dihedral_min_deg": min(report["dihedral_min_deg"] for report in reports),
        "step_length_min_m": min(report["step_length_min_m"] for report in reports),
        "failed": [reason for report in reports for reason in report["failed"]],
        "seconds": seconds,
        "cpu_s": clock.process_time(),
    }
    if "dt_s" in reports[0]:
        total["dt_s"] = min(report["dt_s"] for report in reports)
    return total


if __name__ == "__main__":
    main(Path(sys.argv[1]))
