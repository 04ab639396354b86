"""The process that meshes: python -m coupler.splat.worker FOLDER, started by `convert`, which says what is in the folder.

Each try is announced in tries.jsonl before it begins and its failure noted after; a process that finds a try without an
outcome has been started in place of one that died in it, and takes it for failed.
"""

import json
import sys
import time as clock
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..errors import SplatError
from . import volume
from .convert import FEWEST, TETS_PER_SIZE3, Cloud, load
from .fit import fit_of
from .transfer import transfer

LINK = 2.5  # spacings: points of a stretched body are that far apart
FEWEST_TETS = 40  # elements of a fragment are made small enough for about so many


class Tries:
    """What has been tried for which body, across processes."""

    def __init__(self, folder: Path):
        self.path = folder / "tries.jsonl"
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        self.rows: list[dict[str, Any]] = [row for row in map(json.loads, lines) if row["failed"] is not None]

    def failed(self, body: int) -> list[dict[str, Any]]:
        return [row for row in self.rows if row["body"] == body]

    def note(self, body: int, way: str, failed: str | None) -> None:
        row = {"body": body, "way": way, "failed": failed}
        if failed is not None:
            self.rows.append(row)
        with open(self.path, "a") as file:
            file.write(json.dumps(row) + "\n")


def groups(x: np.ndarray, spacing: float) -> list[np.ndarray]:
    """Indices of the parts of a cloud (n,3) whose points are linked within LINK spacings, largest first."""
    pairs = cKDTree(x).query_pairs(LINK * spacing, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), np.int8), pairs.T), shape=(len(x), len(x)))
    count, part = connected_components(graph, directed=False)
    found = [np.flatnonzero(part == i) for i in range(count)]
    return sorted(found, key=len, reverse=True)


def size_of(cloud: Cloud, task: dict[str, Any]) -> float:
    """Element size (m) for a body: the one asked for, or smaller where that would leave a handful of elements."""
    return min(task["element_size"], (TETS_PER_SIZE3 * cloud.solid_volume / FEWEST_TETS) ** (1.0 / 3.0))


def separate(cloud: Cloud, index: np.ndarray, task: dict[str, Any]) -> list[tuple[np.ndarray, volume.Body]]:
    """The bodies in a linked part of a cloud: more than one where its shape is in pieces, close to each other but not touching."""
    body = volume.Body(cloud.part(index), np.delete(cloud.x, index, axis=0))
    ways = volume.ladder(task["method"], cloud.surface is not None)
    for source in dict.fromkeys(way.source for way in ways if way.source != "paper"):
        try:
            form = body.shape(source, size_of(body.cloud, task), volume.SIGMAS[0])
        except SplatError:
            continue
        if len(form.pieces) == 1:
            break
        where = [form.field.origin + cells * form.field.h for cells in form.pieces]
        nearest = np.argmin([cKDTree(place).query(body.cloud.x)[0] for place in where], axis=0)
        pieces = [index[nearest == i] for i in range(len(where))]
        large = [piece for piece in pieces if len(piece) >= FEWEST]
        if large:
            return [(p, volume.Body(cloud.part(p), np.delete(cloud.x, p, axis=0))) for p in large]
        break
    return [(index, body)]


def mesh(
    body: volume.Body, index: np.ndarray, number: int, task: dict[str, Any], folder: Path, tries: Tries
) -> dict[str, Any]:
    """Mesh one body, the points `index` of the cloud, and write it; its report. Raises SplatError at the ladder's end."""
    part = body.cloud
    size = size_of(part, task)
    seconds: dict[str, float] = {}
    ways = volume.ladder(task["method"], part.surface is not None)
    for way in ways[len(tries.failed(number)) :]:
        tries.note(number, str(way), None)
        try:
            points, tets, report = volume.attempt(way, body, size, seconds)
        except SplatError as problem:
            tries.note(number, str(way), str(problem))
            continue
        except Exception as problem:  # whatever one way has come to grief on, another may not
            tries.note(number, str(way), f"{type(problem).__name__}: {problem}")
            continue
        start = clock.perf_counter()
        fields, moved = transfer(part, points, tets)
        report |= {"method": str(way), "points": len(index), "mass_scale": moved.pop("mass_scale"), "transfer": moved}
        report |= fit_of(points, tets, part)
        if part.wave_speed is not None:
            report["dt_s"] = report["step_length_min_m"] / part.wave_speed
        seconds["transfer"] = clock.perf_counter() - start
        report["seconds"] = seconds
        report["failed"] = [f"{row['way']}: {row['failed']}" for row in tries.failed(number)]
        arrays: dict[str, Any] = {name: values for name, values in fields.items() if values is not None}
        np.savez(folder / f"body_{number}.npz", points=points, tets=tets, cloud_index=index, **arrays)
        (folder / f"body_{number}.json").write_text(json.dumps(report))
        return report
    raise SplatError(
        f"no mesh of body {number} ({len(index)} points) passed: "
        + "; ".join(f"{row['way']}: {row['failed']}" for row in tries.failed(number))
        + ". Try another element size, or method 'stuffing'"
    )


def main(folder: Path) -> None:
    """Convert what is in the folder; writes body_*.npz and summary.json."""
    summary: dict[str, Any] = {"error": None, "bodies": [], "report": {}}
    try:
        cloud, task = load(folder)
        start = clock.perf_counter()
        linked = groups(cloud.x, cloud.spacing)
        large = [part for part in linked if len(part) >= FEWEST]
        if not large:
            raise SplatError(
                f"no {FEWEST} points of the cloud lie within {LINK} spacings of each other: check the spacing "
                f"({cloud.spacing:.3g} m)"
            )
        bodies = [found for part in large for found in separate(cloud, part, task)]
        bodies.sort(key=lambda found: -len(found[0]))
        tries = Tries(folder)
        sorting = clock.perf_counter() - start
        for number, (index, one) in enumerate(bodies):
            done = folder / f"body_{number}.json"
            if done.exists():
                summary["bodies"].append(json.loads(done.read_text()))
            else:
                summary["bodies"].append(mesh(one, index, number, task, folder, tries))
        summary["report"] = _together(summary["bodies"], sorting) | {"cpu_s": clock.process_time()}
    except SplatError as problem:
        summary["error"] = str(problem)
    (folder / "summary.json").write_text(json.dumps(summary))


def _together(bodies: list[dict[str, Any]], sorting: float) -> dict[str, Any]:
    """The report of a splat from those of its bodies: sums, worst values, and the largest body's own measures."""
    first = bodies[0]
    seconds = {"sorting": sorting}
    for about in bodies:
        for stage, spent in about["seconds"].items():
            seconds[stage] = seconds.get(stage, 0.0) + spent
    return {
        **first,
        "bodies": len(bodies),
        "tets": sum(about["tets"] for about in bodies),
        "nodes": sum(about["nodes"] for about in bodies),
        "volume_m3": sum(about["volume_m3"] for about in bodies),
        **{name: min(about[name] for about in bodies)
           for name in ("gamma_min", "dihedral_min_deg", "step_length_min_m", "dt_s") if name in first},
        "failed": [reason for about in bodies for reason in about["failed"]],
        "seconds": seconds,
    }  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]))
