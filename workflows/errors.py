"""What accuracy costs in time, and whether the errors that runs print are true: does `fine` lie within those of the other presets?

    python workflows/errors.py               # docs/tables/errors.csv, figure and numbers of the accuracy page
    python workflows/errors.py --docs        # runs nothing: from the table that exists

The scenes were chosen before the first comparison, and the constants of the rule (`coupler.plan.refinement`) are those of its source.
Rows in the table are not computed again. The fine runs, which come last, take most of the time.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.ticker import NullFormatter
from pages import drawing, impact_tables, markdown, options, spent, versions, write_parts
from study_table import Row, column, measurements, number, reason, study

from coupler import Result, Scene, run
from coupler.deposition.error import Companions
from coupler.deposition.run import _alone
from coupler.errors import ColdsprayError
from coupler.measures import CONVERGING, MEASURES
from coupler.measures import measure as record
from coupler.plan.planning import plan
from coupler.plan.refinement import FORECAST_AT, has_error

SCENES = measurements("accuracy", "scenes")
PRESETS = ("draft", "standard", "fine")


def compute(name: str, preset: str) -> dict[str, object]:
    """The row of a scene at a preset: its measures and errors, and the processor time of the run and of its coarser ones."""
    row = dict[str, object]()
    D = SCENES[name]["diameter"]
    tables = impact_tables(**SCENES[name], size=(8 * D, 4 * D))
    scene = Scene.from_dict({"preset": preset, **tables, "output": {"at": "ends"}}, "errors")
    with tempfile.TemporaryDirectory() as place:
        folder, start = Path(place) / "run", spent()
        try:
            run(scene, folder, threads=1, quiet=True)
            row["cpu_s"] = spent() - start
            if preset != "fine":
                Companions(plan(scene, error=True), folder, {}, _alone).measure(threads=1)
                row["error_cpu_s"] = spent() - start - float(str(row["cpu_s"]))
        except ColdsprayError as error:
            return row | {"failed": reason(error)}
        result = Result(folder)
        row |= {key: result.values[key] for key in ("points", "steps", "verdict", *CONVERGING)}
        row |= {f"{key} error": entry["half_width"] for key, entry in result.errors.items()}
        row["failed"] = (result.undecided or "")[:150]
    return row


def pairs(rows: Sequence[Row], preset: str, key: str) -> list[tuple[float, float]]:
    """For each scene that has a measure at a preset, its error, and the measure at `fine`: error and difference from fine, both over
    the value (temperatures: over the rise from 300 K)."""
    found = []
    fine = {row["scene"]: row for row in rows if row["preset"] == "fine" and not row["failed"]}
    for row in rows:
        if row["preset"] == preset and row["scene"] in fine and has_error(key, number(row, "points")):
            value, best, error = number(row, key), number(fine[row["scene"]], key), number(row, f"{key} error")
            whole = abs(value - record(key).initial(300.0))
            if np.isfinite([value, best, error]).all() and whole > 0.0:
                found.append((error / whole, abs(best - value) / whole))
    return found


def by_scene(rows: Sequence[Row], preset: str) -> dict[str, tuple[float, float, float]]:
    """Scene -> processor time of its run at a preset, s, and the median error and difference from fine of its measures, percent."""
    found = {}
    for row in (row for row in rows if row["preset"] == preset and not row["failed"]):
        own = [row, *(r for r in rows if r["preset"] == "fine" and r["scene"] == row["scene"])]
        pairs_of = [pair for key in CONVERGING for pair in pairs(own, preset, key)]
        error, off = (100.0 * float(np.median([pair[k] for pair in pairs_of])) if pairs_of else np.nan for k in (0, 1))
        found[row["scene"]] = number(row, "cpu_s"), error, off
    return found


def table_part(rows: Sequence[Row]) -> list[str]:
    """Of each measure and of all, at each preset: median error, median difference from fine, in how many scenes fine is within."""
    found = {(key, preset): pairs(rows, preset, key) for key in CONVERGING for preset in PRESETS[:2]}
    found |= {("all", preset): [pair for key in CONVERGING for pair in found[key, preset]] for preset in PRESETS[:2]}
    lines = []
    for key in (*CONVERGING, "all"):
        cells = [MEASURES[key].short if key in MEASURES else key]
        for preset in PRESETS[:2]:
            own = found[key, preset]
            cells += [f"{100.0 * float(np.median([pair[k] for pair in own])):.2g} %" if own else "-" for k in (0, 1)]
            cells.append(f"{sum(off <= error for error, off in own)} of {len(own)}" if own else "-")
        lines.append(cells)
    texts = (f"{preset}: {text}" for preset in PRESETS[:2] for text in ("printed error", "fine off", "fine within"))
    failed = [f"{row['scene']}, {row['preset']}: {row['failed']}" for row in rows if row["failed"]]
    told = [f"Failed: {'; '.join(failed)}.", ""] if failed else []
    return [*markdown(["measure", *texts], lines), "", *told, versions(rows)]


def time_part(rows: Sequence[Row]) -> list[str]:
    """The median time and error of the presets, in sentences."""
    of = {preset: by_scene(rows, preset) for preset in PRESETS}
    common = [scene for scene in of["fine"] if all(scene in of[preset] for preset in PRESETS)]
    texts = []
    for preset in PRESETS:
        seconds, error, off = (np.array([of[preset][scene][k] for scene in common]) for k in range(3))
        texts.append(f"`{preset}` {np.median(seconds):.0f} s")
        if preset != "fine":
            texts[-1] += f", {np.nanmedian(off):.1f} % from `fine` (printed error {np.nanmedian(error):.1f} %)"
    standard = [r for r in rows if r["preset"] == "standard" and r["error_cpu_s"]]
    cost = [number(r, "error_cpu_s") / number(r, "cpu_s") for r in standard]
    return [
        f"Medians of {len(common)} scenes: {'; '.join(texts)}. The coarser runs that measure the error take"
        f" {100 * np.median(cost):.0f} % of the time of a run at `standard`."
    ]


def draw(rows: Sequence[Row]) -> None:
    """Draw the difference from fine against time at the presets, and the printed error against the true difference."""
    coarse, standard = (by_scene(rows, preset) for preset in PRESETS[:2])
    with drawing("errors", 10.0, 4.2, "constrained") as figure:
        left, right = figure.subplots(1, 2)
        for scene in (name for name in coarse if name in standard):
            pair = coarse[scene], standard[scene]
            left.loglog(*([values[k] for values in pair] for k in (0, 2)), "-", color="0.8", lw=0.8)
        for preset, of, colour in zip(PRESETS, (coarse, standard), ("C1", "C2"), strict=False):
            seconds, _, off = np.array(list(of.values())).T
            left.loglog(seconds, off, ".", color=colour, alpha=0.6)
            middle, label = (np.median(seconds), np.nanmedian(off)), f"{preset} (diamond: median)"
            left.loglog(*middle, "D", color=colour, ms=9, mec="k", label=label)
            found = np.array([pair for key in CONVERGING for pair in pairs(rows, preset, key)]).T * 100.0
            right.loglog(found[1], found[0], ".", color=colour, label=preset, alpha=0.7)
        ends = (0.01, 300.0)
        right.loglog(ends, ends, "k-", lw=0.8)
        right.text(20.0, 0.03, "fine outside", fontsize=9)
        right.text(0.015, 100.0, "fine within", fontsize=9)
        right.set(xlabel="difference from fine (%)", ylabel="printed error (%)", xlim=ends, ylim=ends)
        left.set(xlabel="processor time (s)", ylabel="median difference of the measures\nfrom fine (%)")
        left.set_title("a line for each scene", fontsize=10)
        right.set_title("all measures of all scenes", fontsize=10)
        for axes in (left, right):
            axes.legend(fontsize=8)
            for scale in (axes.xaxis, axes.yaxis):
                scale.set_major_formatter("{x:g}")
                scale.set_minor_formatter(NullFormatter())
        left.set_xticks((2, 5, 10, 20, 50, 100))
        left.set_yticks((1, 2, 5, 10, 20))


def forecast(rows: Sequence[Row]) -> dict[str, float]:
    """Median error over the value at `draft`, for `coupler.plan.refinement.FORECAST`."""
    shares = {}
    draft = [row for row in rows if row["preset"] == "draft"]
    for key in (key for key in CONVERGING if has_error(key, FORECAST_AT)):
        error, whole = column(draft, f"{key} error"), np.abs(column(draft, key) - record(key).initial(300.0))
        shares[key] = float(f"{np.nanmedian(error[whole > 0.0] / whole[whole > 0.0]):.2g}")
    return shares


if __name__ == "__main__":
    keys = ((name, preset) for preset in PRESETS for name in SCENES)
    rows = study("errors", ("scene", "preset"), () if options(__doc__, "docs").docs else keys, compute).rows
    print("FORECAST =", forecast(rows))
    draw(rows)
    write_parts("accuracy", {"time": time_part(rows), "errors": table_part(rows)})
