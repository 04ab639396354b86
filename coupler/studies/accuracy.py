"""Convergence study of a scene: runs with several numbers of points, and each measure with its error and the wall time of its run."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..deposition.error import errors
from ..errors import SceneError, StoreError
from ..files.summary import Values
from ..measures import CONVERGING, axis_label, measure
from ..plan.cost import LEAST_POINTS
from ..plan.reading import Scene
from ..plan.refinement import at_points
from ..report.figure import blank, label_log, save
from ..report.words import shown
from .runs import Log, results
from .table import in_columns

POINTS = (500, 1000, 2000, 3500, 5000, 16000)
LEVELS = 4  # resolutions from which an error follows: the row itself and the next coarser ones
COLUMNS = (
    "points", "points_used", "elements", "steps", "dt_mean_s", "sim_time_s", "wall_s", *CONVERGING, "eps_p_max", "T_max_K",
    *(f"{key}_error" for key in CONVERGING), "numerical_dissipation", "energy_drift", "failed", "version",
)  # fmt: skip
Row = Mapping[str, Any]  # COLUMNS of a run, SI


def compute(scene: Scene, folder: Path, points: Sequence[int], jobs: int, log: Log) -> list[Row]:
    """Run the scene in folder/runs with each number of points (of its largest particle). Finished runs are not computed again. Returns
    a row for each run, the coarsest first. If a run fails, is undecided or is retried with other numerics, its row has no measures but
    the reason in `failed`. Raises StoreError for fewer than LEAST_POINTS points."""
    if (least := min(points)) < LEAST_POINTS:
        raise StoreError(f"--points {least} is too coarse: give at least {LEAST_POINTS} points")
    scenes, failed = dict[str, str](), dict[str, str]()
    names = {f"{n}_points": n for n in sorted(set(points))}
    for name, n in names.items():
        try:
            scenes[name] = at_points(scene, n, {"output": {"at": "ends"}}).to_toml()
        except SceneError as error:  # such as elements too coarse for the crater
            failed[name] = "; ".join(error.problems)
    found, reasons = results(folder / "runs", scenes, jobs, log)
    failed |= reasons
    failed |= {name: result.undecided for name, result in found.items() if result.undecided is not None}
    failed |= {name: str(found[name].warnings[-1]) for name in found.keys() - failed.keys() if found[name].retries}
    rows, levels = list[Row](), list[Values]()  # levels: of rows with measures, the finest first
    for name, n in names.items():
        if name in failed:
            rows.append({"points": n, "failed": failed[name][:200]})
            continue
        levels.insert(0, found[name].values)
        each = {f"{key}_error": entry["half_width"] for key, entry in errors(levels[:LEVELS]).items()}
        own = {"points": n, "points_used": levels[0]["points"], "failed": ""}
        rows.append({key: levels[0].get(key) for key in COLUMNS} | each | own)
    return rows


def lines(rows: Sequence[Row]) -> list[str]:
    """Text lines: a table of number of points, wall time, and each measure with its error, with a column for each run that has
    measures; then a line for each run without them, with the reason."""
    done = [row for row in rows if not row["failed"]]
    cells = [["points", *(str(row["points"]) for row in done)]]
    cells += [["wall time, s", *(f"{row['wall_s']:.3g}" for row in done)]]
    cells += [[axis_label(key), *(shown(key, row[key], row.get(f"{key}_error")) for row in done)] for key in CONVERGING]
    return [*in_columns(cells), *(f"{row['points']} points: {row['failed']}" for row in rows if row["failed"])]


def draw(rows: Sequence[Row], path: Path, heading: str) -> None:
    """Draw each measure with its error against the wall time of the run, as PNG. Labels in the first panel: numbers of points."""
    figure = blank(12.0, 9.5, dpi=110, layout="constrained")
    for k, (key, panel) in enumerate(zip(CONVERGING, figure.subplots(3, 3).flat, strict=True)):
        factor, known = measure(key).factor, [row for row in rows if row.get(key) is not None]
        seconds, values = [row["wall_s"] for row in known], [factor * row[key] for row in known]
        panel.errorbar(
            seconds, values, [factor * (row.get(f"{key}_error") or 0.0) for row in known], fmt="o-", capsize=3
        )
        panel.set(xscale="log", xlabel="wall time (s)", ylabel=axis_label(key))
        label_log(panel.xaxis)
        for row, place in zip(known, zip(seconds, values, strict=True), strict=True) if k == 0 else ():
            panel.annotate(f"{row['points']} points", place, xytext=(4, 4), textcoords="offset points", fontsize=8)
    figure.suptitle(heading, parse_math=False)
    save(figure, path)
