"""What accuracy costs in time, for the cases of docs/accuracy.md: computes their ladders and writes all that rests on them.

    python workflows/accuracy.py             # docs/tables/accuracy_*.csv, their figures, coupler/plan/bands.csv, docs/accuracy.md
    python workflows/accuracy.py --docs      # runs nothing: from the tables that are there

Rows that are there are kept; a stopped ladder goes on where it was.
"""

import argparse
import csv
from pathlib import Path
from typing import Any

from coupler.measures import BANDED, MEASURES
from coupler.plan import bands
from coupler.plan import cost as estimates
from coupler.progress import Progress
from coupler.report.picture import save
from coupler.scene.model import Scene
from coupler.studies import accuracy_fit as fit
from coupler.studies import ladder
from coupler.studies.accuracy_figures import diagram, order_of, preset_of

# name -> heading, scene, points, reference, points of the other settings (0: not tried)
CASES: dict[str, tuple[str, str, tuple[int, ...], int, int]] = {
    "ni500": ("Ni at 500 m/s", "single_ni", ladder.POINTS, 16000, 1000),
    "ti500": ("Ti at 500 m/s", "single_ti", ladder.POINTS, 16000, 1000),
    "ni1000": ("Ni at 1000 m/s", "fast_ni", ladder.POINTS, 16000, 0),
    "triple": ("three Ni, 500 to 610 m/s", "triple_ni", (600, 1000, 2000, 3500), 8000, 0),
}  # fmt: skip
TABLES, DOCS, PACKAGED = Path("docs/tables"), Path("docs/accuracy.md"), Path("coupler/plan/bands.csv")
REMAKE = "remake: make accuracy (rows that are here are kept)"
BEGIN, END = "<!-- tables: written by workflows/accuracy.py -->", "<!-- end of tables -->"
PACE, PACE_MARKS = TABLES / "pace.csv", ("<!-- pace: written by workflows/accuracy.py -->", "<!-- end of pace -->")


def table_of(name: str) -> ladder.Table:
    return ladder.Table(TABLES / f"accuracy_{name}.csv", REMAKE)


def scene_of(name: str) -> Scene:
    return Scene.load(f"workflows/{CASES[name][1]}.toml")


def climb(names: list[str]) -> None:
    """Compute what the tables lack."""
    for name in names:
        _, _, points, reference, knobs_at = CASES[name]
        rungs = ladder.settings(points, reference, knobs_at or None)
        say = ladder.announce(quiet=False)
        say(CASES[name][0])
        ladder.climb(
            scene_of(name), Path("runs/accuracy") / name, rungs, table_of(name), lambda: Progress(quiet=True), say
        )


def about(name: str) -> dict[str, Any]:
    """What is said of a case in the packaged table: its last impact."""
    made = scene_of(name)
    last = made.particles[-1]
    return {"impacts": len(made.particles), "speed": last.velocity, "temperature": last.temperature}


def package() -> list[dict[str, Any]]:
    """Write coupler/plan/bands.csv; its rows."""
    whole = {n: table_of(n).rows for n in CASES if fit.reference(table_of(n).rows) is not None}
    rows = fit.packaged({CASES[name][0]: (about(name), found) for name, found in whole.items()})
    with PACKAGED.open("w", newline="", encoding="utf-8") as file:
        file.write("# remake: python workflows/accuracy.py --docs; shares of the reference, h = N^(-1/3)\n")
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    bands._rows.cache_clear()
    return rows


def percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def written(packaged: list[dict[str, Any]]) -> list[str]:
    """The part of the document that the tables make."""
    lines: list[str] = []
    for name, (heading, _, _, _, _) in CASES.items():
        rows, T_0 = table_of(name).rows, about(name)["temperature"]
        best = fit.reference(rows)
        if best is None:
            continue
        finest = max(int(r["points_used"]) for r in ladder.finished(rows) if r["axis"] == "points")
        lines += [f"### {heading}", "", f"![{heading}](accuracy_{name}.png)", ""]
        where = " in the last of its particles" if about(name)["impacts"] > 1 else ""
        lines.append(
            f"The reference has {int(best['points_used'])} points{where}, {int(best['points_used']) / finest:.1f} times those of"
            f" the finest setting it judges, and took {float(best['cpu_s']):.0f} s ([table](tables/accuracy_{name}.csv))."
        )
        lines += ["", *_differences(rows, T_0), ""]
        failed = [f"{r['setting']} ({r['points']} points): {r['failed']}" for r in rows if r["failed"]]
        lines += [f"Failed: {'; '.join(failed)}" if failed else "No setting failed.", ""]
    lines += ["## Orders and bands", "", *_orders(packaged), ""]
    lines += ["## The presets", "", *_presets(), ""]
    return lines


def _differences(rows: list[dict[str, str]], T_0: float) -> list[str]:
    """Difference of each setting from the reference, in percent."""
    names = BANDED
    found = {m: {(r["axis"], r["setting"]): e for r, e in fit.errors(rows, m, T_0)} for m in names}
    head = "| setting | s | " + " | ".join(MEASURES[m].short for m in names) + " |"
    lines = [head, "|---" * (len(names) + 2) + "|"]
    for row in ladder.finished(rows):
        if row["axis"] == "reference":
            continue
        mark = f" ({preset_of(row)})" if preset_of(row) else ""
        at = "" if row["axis"] == "points" else f", {row['points']} points"
        cells = [f"{found[m][row['axis'], row['setting']]:+.1f}" for m in names]
        lines.append(f"| {row['setting']}{at}{mark} | {float(row['cpu_s']):.3g} | {' | '.join(cells)} |")
    return lines


def _orders(packaged: list[dict[str, Any]]) -> list[str]:
    cases = [CASES[name][0] for name in CASES if any(row["case"] == CASES[name][0] for row in packaged)]
    head = f"| measure | fitted order | 95 % | order taken | {' | '.join(f'limit, {case}' for case in cases)} |"
    lines = [head, "|---" * (4 + len(cases)) + "|"]
    for measure in dict.fromkeys(row["measure"] for row in packaged):
        mine = [row for row in packaged if row["measure"] == measure]
        low, high = f"{mine[0]['low']:.2g}", f"{mine[0]['high']:.2g}"
        low = f"below {low}" if mine[0]["low"] <= fit.ORDERS[0] else low
        high = f"above {high}" if mine[0]["high"] >= fit.ORDERS[-1] else high
        limits = " | ".join(f"{row['limit']:.3f}" for row in mine)
        orders = f"{mine[0]['fitted']:.2g} | {low} to {high} | {mine[0]['order']:.2g}"
        lines.append(f"| {MEASURES[measure].short} | {orders} | {limits} |")
    return lines


def _presets() -> list[str]:
    """Band and time of each preset, per measure."""
    names = BANDED
    head = "| preset, speed | s | " + " | ".join(MEASURES[m].short for m in names) + " |"
    lines = [head, "|---" * (len(names) + 2) + "|"]
    for preset, points in estimates.PRESETS.items():
        for speed, case in ((500.0, "ni500"), (1000.0, "ni1000")):
            took = next((r["cpu_s"] for r in table_of(case).rows if r["points"] == str(points) and preset_of(r)), "")
            got = [bands.band(m, bands.Kind(points, speed)) for m in names]
            cells = [percent(b.share) if b else "-" for b in got]
            lines.append(
                f"| {preset}, {speed:g} m/s | {float(took):.3g} | " if took else f"| {preset}, {speed:g} m/s | - | "
            )
            lines[-1] += " | ".join(cells) + " |"
    return lines


def write_docs(packaged: list[dict[str, Any]]) -> None:
    """Put the tables between their two marks in the document, and draw."""
    for name, (heading, *_) in CASES.items():
        rows = table_of(name).rows
        if fit.reference(rows) is not None:
            save(diagram(rows, heading, about(name)["temperature"]), Path(f"docs/accuracy_{name}.png"))
    text = DOCS.read_text(encoding="utf-8")
    for (begin, end), lines in {(BEGIN, END): written(packaged), PACE_MARKS: foretold()}.items():
        before, _, rest = text.partition(begin)
        _, found, after = rest.partition(end)
        if not found:
            raise SystemExit(f"{DOCS} has no place for the tables: it needs the lines {begin!r} and {end!r}")
        text = "\n".join([before + begin, "", *lines, end]) + after
    DOCS.write_text(text, encoding="utf-8")


def foretold() -> list[str]:
    """The scenes of workflows/pace.py, if they are there."""
    if not PACE.exists():
        return []
    rows, lines = ladder.rows_of(PACE), []
    for number in dict.fromkeys(row["round"] for row in rows):
        mine = [row for row in rows if row["round"] == number]
        good = sum(abs(float(row["off_percent"])) <= 30 for row in mine)
        lines.append(f"- Round {number}: {good} of {len(mine)} scenes within 30 %.")
    lines += ["", "| round, scene | steps said | steps | s said | s taken | off |", "|---|---|---|---|---|---|"]
    for row in rows:
        cells = [
            f"{row['round']}, {row['scene']}",
            *(row[name] for name in ("steps_said", "steps", "said_s", "took_s")),
        ]
        lines.append(f"| {' | '.join(cells)} | {float(row['off_percent']):+.0f} % |")
    return [*lines, ""]


def main() -> None:
    """Climb the ladders and write what rests on them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--docs", action="store_true", help="run nothing")
    parser.add_argument("--only", nargs="*", choices=CASES, default=list(CASES), help="cases to compute")
    a = parser.parse_args()
    if not a.docs:
        climb(a.only)
    write_docs(package())
    print(
        "\n".join(
            f"{CASES[n][0]}: flattening, {order_of(table_of(n).rows, 'flattening_ratio_total', 300.0)}" for n in CASES
        )
    )


if __name__ == "__main__":
    main()
