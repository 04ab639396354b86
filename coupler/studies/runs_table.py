"""The runs of a folder as a table: material, axes, status and measures of each run, read from its files."""

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import units
from ..errors import StoreError
from ..files.inputs import leaves, read_toml, reading
from ..files.result import Result
from ..measures import CONVERGING
from ..plan.record import read_plan
from .runs import how_ended
from .table import write_rows

AXES = ("velocity_m_s", "diameter_m", "temperature_K")  # the first two that vary become x and y of a map
# key of a scene -> axis
KEYS = dict(zip(("particle.velocity", "particle.diameter", "particle.temperature"), AXES, strict=True))
MEASURES = ("flattening_ratio", "T_mean_K", "T_p99_K", "eps_p_mean", "crater_depth_m", "splat_diameter_m",
            "rebound_velocity_m_s", "bonded_area_end_m2", "numerical_dissipation", "energy_drift", "wall_s", "restitution",
            "velocity_ratio")  # fmt: skip
ERRORS = tuple(f"{key}_error" for key in MEASURES if key in CONVERGING)
COLUMNS = ("point", "material", "substrate", *AXES, "status", "reason", *MEASURES, "verdict", "version")
STATUSES = ("done", "undecided", "failed", "unfinished")
LARGEST = 1e30  # a measure with a larger magnitude counts as damaged
Row = dict[str, Any]


def table(folder: str | Path) -> list[Row]:
    """One row for each point of a sweep, or each run, in a folder: COLUMNS, SI units, sorted by material and axes.

    status: one of STATUSES; `reason` explains "failed" and "undecided". Measures are those of the last impact in the summary; runs
    that are not finished have none. keys: every number of the scene by its key, SI units; units: the units in which the scene gives
    the numbers. verdict: verdict of the run; version: version of the program that computed it. Raises StoreError if the folder does
    not exist or has no point.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise StoreError(f"{folder} is not a folder of runs")
    names = {path.name for path in folder.iterdir() if path.is_dir() and (path / "scene.toml").is_file()}
    names |= {path.stem for path in folder.glob("*.toml") if "particle" in _scene_of(path)}
    if names <= {"scene"} and any((inner := folder / "runs").glob("*/scene.toml")):  # the folder of a study
        raise StoreError(f"{folder} has no runs, but {inner} has: give that folder")
    rows = [_row(folder, name) for name in names]
    if not rows:
        raise StoreError(
            f"{folder} holds no points of a sweep and no runs: give the folder that holds the folders of runs"
        )
    return sorted(rows, key=lambda row: (row["material"], *(row[axis] or 0.0 for axis in AXES[::-1]), row["point"]))


def _row(folder: Path, name: str) -> Row:
    """The row of a point. If its files cannot be read, the point counts as failed."""
    row = dict.fromkeys(COLUMNS) | {"point": name, "material": "", "substrate": "", "keys": {}, "units": {}}
    try:
        with reading(folder / name):
            return row | {"status": "unfinished", "reason": ""} | _found(folder, name)
    except StoreError as error:
        return row | {"status": "failed", "reason": str(error)}


def _found(folder: Path, name: str) -> Row:
    """The values of a point, from its status, plan and summary."""
    run = folder / name
    row = _as_written(scene_file(folder, name))
    ended = how_ended(folder / f"{name}.json") or {}
    if ended.get("status") == "failed":
        return row | {"status": "failed", "reason": str(ended.get("reason") or "unknown")}
    result = Result(run) if (run / "scene.toml").is_file() else None
    if result is None or not result.finished:
        return row
    numbers = list(scene_numbers(read_toml(run / "scene.toml")))
    row |= {"keys": {key: value for key, value, _ in numbers}, "units": {key: unit for key, _, unit in numbers}}
    values, plan = result.values, read_plan(run)
    impact, verdict = plan.impacts[-1], str(values.get("verdict") or "")
    status = "done" if result.undecided is None else "undecided"
    row |= {"status": status, "version": str(values["version"]), "reason": result.undecided or "", "verdict": verdict}
    row |= {"material": impact.material.name, "substrate": plan.target.material.name}
    row |= dict(
        zip(AXES, (float(f"{np.linalg.norm(impact.velocity):.12g}"), impact.diameter, impact.temperature), strict=True)
    )
    row |= {key: _number(values.get(key)) for key in MEASURES}
    return row | {f"{key}_error": _number(entry["half_width"]) for key, entry in (values.get("errors") or {}).items()}


def scene_file(folder: Path, name: str) -> Path:
    """The path of the scene of a point: beside the folder of its run or, if it is not there, in that folder."""
    beside = folder / f"{name}.toml"
    return beside if beside.is_file() else folder / name / "scene.toml"


def scene_numbers(scene: Mapping[str, object]) -> Iterator[tuple[str, float, str]]:
    """The numbers of a scene as (key, value in SI, unit). Keys: "contact.friction", "particle[2].velocity", "particle.offset[1]"."""
    for key, leaf in leaves(scene):
        several = isinstance(leaf, list)
        for number, value in enumerate(leaf if isinstance(leaf, list) else [leaf], 1):
            name = f"{key}[{number}]" if several else key
            if isinstance(value, int | float) and not isinstance(value, bool):
                yield name, float(value), ""
            elif isinstance(value, str) and (match := re.fullmatch(r"[-+.\deE]+ (\S.*)", value)):
                with contextlib.suppress(ValueError, LookupError):
                    yield name, units.parse(value, units.dimension_of(match[1])), match[1]


def add_axes(rows: Sequence[Row], keys: Sequence[str]) -> tuple[str, ...]:
    """Add keys of the scene as axes to the rows. Returns the names of these axes in the rows. Raises StoreError for a key that has no
    number in any scene, that is given twice, or that has the same value in all points."""
    names = []
    for key in keys:
        name = KEYS.get(key, key)
        known = sorted({key for row in rows for key in row.get("keys", {})})
        if name not in AXES:
            if key not in known:
                raise StoreError(f"--axes {key}: no scene has a number for this key{units.nearest(key, known)}")
            for row in rows:
                row[name] = row["keys"].get(key)
        if len(rows) > 1 and len({row[name] for row in rows}) == 1:
            raise StoreError(f"--axes {key}: all {len(rows)} points have the same value of this key; leave it out")
        if name in names:
            raise StoreError(f"--axes {key}: this key is given twice; give each axis once")
        names.append(name)
    return tuple(names)


def others_that_vary(rows: Sequence[Row], axes: Sequence[str]) -> list[str]:
    """Keys of the scene, other than the axes, that differ between points with the same values of the axes."""
    seen: dict[tuple[float, ...], dict[str, float]] = {}
    different: dict[str, None] = {}
    for row in rows:
        first = seen.setdefault(tuple(row[axis] for axis in axes), row["keys"])
        different |= {key: None for key in first.keys() | row["keys"].keys() if first.get(key) != row["keys"].get(key)}
    return sorted(different)


def counts(rows: Sequence[Row]) -> dict[str, int]:
    """Number of rows for each of STATUSES."""
    return {status: sum(row["status"] == status for row in rows) for status in STATUSES}


def _number(value: object) -> float | None:
    """The value of a measure in a summary; None if it is not a number, or larger than LARGEST."""
    return value if isinstance(value, int | float) and abs(value) < LARGEST else None


def _scene_of(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; empty if it cannot be read."""
    with contextlib.suppress(StoreError):
        return read_toml(path)
    return {}


def _as_written(path: Path) -> Row:
    """Material and axis values of one point of the study, read from its scene file. Values that cannot be read are left out."""
    row, data = dict[str, Any](material="", substrate=""), _scene_of(path)
    with contextlib.suppress(ValueError, LookupError, TypeError):
        row["material"], row["substrate"] = str(data["particle"]["material"]), str(data["substrate"]["material"])
        for axis, dimension in zip(AXES, ("velocity", "length", "temperature"), strict=True):
            row[axis] = units.parse(data["particle"][axis.split("_")[0]], dimension)
    return row


def write_table(rows: Iterable[Row], path: Path, about: str = "", axes: Sequence[str] = ()) -> None:
    """Write the rows as a CSV file. about: text of the first line, after "# "; axes: additional columns. Columns of ERRORS are
    written only if a run has such errors. Raises StoreError."""
    rows = list(rows)
    measured = (name for name in ERRORS if any(row.get(name) is not None for row in rows))
    write_rows(path, (*COLUMNS, *(axis for axis in axes if axis not in COLUMNS), *measured), rows, about)


def errors_of(rows: Iterable[Row], name: str) -> list[float]:
    """The errors of a measure, SI, from the rows with status "done" that have one."""
    return [row[f"{name}_error"] for row in rows if row["status"] == "done" and row.get(f"{name}_error") is not None]
