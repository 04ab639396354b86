"""What accuracy costs in time: computes the ladders of the accuracy page and writes all that rests on them.

    python workflows/accuracy.py             # docs/tables/accuracy_*.csv, their figures, the page
    python workflows/accuracy.py --docs      # runs nothing: from the tables that exist

Rows in the tables are not computed again; a stopped ladder goes on where it was.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from pages import PAGES, ROOT, figure_path, markdown, marked, options, table_rows, versions, write_parts

from coupler.measures import CONVERGING, MEASURES
from coupler.plan.reading import Scene
from coupler.plan.refinement import line
from coupler.report.picture import save
from coupler.studies import accuracy_fit as fit
from coupler.studies import ladder, ladder_runs
from coupler.studies.accuracy_figures import diagram, order_of, preset_of
from coupler.studies.accuracy_fit import Row
from coupler.studies.table import StudyTable


@dataclass(frozen=True)
class Study:
    """A case of the page. knobs_at: points at which the other settings are tried, 0 for not at all."""

    heading: str
    scene: str
    points: tuple[int, ...] = (500, 1000, 2000, 5000, 12000)
    reference: int = 24000
    knobs_at: int = 0

    def load(self) -> Scene:
        return Scene.load(ROOT / "workflows" / f"{self.scene}.toml")


STUDIES = {
    "ni500": Study("Ni at 500 m/s", "single_ni", knobs_at=1000),
    "ti500": Study("Ti at 500 m/s", "single_ti", knobs_at=1000),
    "ni1000": Study("Ni at 1000 m/s", "fast_ni", (500, 1000, 2000, 5000), 12000),
    "al725": Study("Al at 725 m/s", "al_on_steel", (500, 1000, 2000), 5000),
    "triple": Study("three Ni, 500 to 610 m/s", "triple_ni", (700, 1000, 2000), 4000),
}


@dataclass(frozen=True)
class StudyCase:
    """A scene of the accuracy study. impacts: of the run; speed m/s and temperature K: of its last particle; rows: of its ladder."""

    name: str
    impacts: int
    speed: float
    temperature: float
    rows: Sequence[Row]


def table_of(name: str) -> StudyTable:
    about = "remake: make accuracy (rows in this table are not computed again)"
    return ladder.ladder_table(ROOT / "docs" / "tables" / f"accuracy_{name}.csv", about)


def case_of(name: str) -> StudyCase:
    particles = STUDIES[name].load().particles
    last = particles[-1]
    return StudyCase(STUDIES[name].heading, len(particles), last.velocity, last.temperature, table_of(name).rows)


def compute(names: Sequence[str]) -> None:
    """Compute the rows that the tables lack."""
    for name in names:
        study = STUDIES[name]
        print(study.heading)
        points = ladder.ladder_points(study.points, study.reference, study.knobs_at or None)
        ladder_runs.compute_missing(study.load(), ROOT / "runs" / "accuracy" / name, points, table_of(name), print)


def cases_part(cases: dict[str, StudyCase]) -> list[str]:
    """A section for each case: figure, reference, differences of each setting in percent, failures."""
    lines: list[str] = []
    for name, case in cases.items():
        best = fit.reference(case.rows)
        assert best is not None
        finest = max(int(r["points_used"]) for r in ladder.finished(case.rows) if r["axis"] == "points")
        last = " in the last of its particles" if case.impacts > 1 else ""
        lines += [
            f"### {case.name}", "", f"![{case.name}](accuracy_{name}.png)", "",
            f"The reference has {int(best['points_used'])} points{last}, {int(best['points_used']) / finest:.1f} times those of"
            f" the finest setting compared with it, and took {float(best['cpu_s']):.0f} s"
            f" ([table](../tables/accuracy_{name}.csv)). {versions(case.rows)}", "",
        ]  # fmt: skip
        by_measure = {m: fit.errors(case.rows, m, case.temperature) for m in CONVERGING}
        errors = {m: {(r["axis"], r["setting"]): e for r, e in pairs} for m, pairs in by_measure.items()}
        shown = []
        for row in ladder.finished(case.rows):
            if row["axis"] != "reference":
                text = row["setting"] + ("" if row["axis"] == "points" else f", {row['points']} points")
                text = marked(text + (f" ({preset_of(row)})" if preset_of(row) else ""), row)
                cells = [f"{errors[m][row['axis'], row['setting']]:+.1f}" for m in CONVERGING]
                shown.append([text, f"{float(row['cpu_s']):.3g}", *cells])
        lines += [*markdown(["setting", "s", *(MEASURES[m].short for m in CONVERGING)], shown), ""]
        failed = [f"{r['setting']} ({r['points']} points): {r['failed']}" for r in case.rows if r["failed"]]
        lines += [f"Failed: {'; '.join(failed)}" if failed else "No setting failed.", ""]
    return lines


def orders_part(cases: Sequence[StudyCase]) -> list[str]:
    """Fitted order of each measure, common to the single impacts, and its limit over the reference in each case."""
    lines = []
    for measure in CONVERGING:
        used, fitted = fit.order([fit.resolutions(c.rows, measure, c.temperature) for c in cases if c.impacts == 1])
        limits = [line(*fit.resolutions(c.rows, measure, c.temperature), used)[0] for c in cases]
        orders = (f"{fitted.order:.2g}", " to ".join(fitted.interval()), f"{used:.2g}")
        lines.append([MEASURES[measure].short, *orders, *(f"{limit:.3f}" for limit in limits)])
    return markdown(
        ["measure", "fitted order", "95 %", "order taken", *(f"limit, {case.name}" for case in cases)], lines
    )


def pace_part() -> list[str]:
    """The estimates of time (workflows/pace.py) against the times taken."""
    rows = table_rows("pace")
    steps = [abs(float(row["steps_said"]) / float(row["steps"]) - 1.0) for row in rows]
    within = [sum(x <= 0.3 for x in off) for off in (steps, [abs(float(row["off_percent"])) / 100.0 for row in rows])]
    line = f"Of {len(rows)} scenes {within[0]} are within 30 % in steps, {within[1]} in time."
    cells = [
        [marked(r["scene"], r), r["steps_said"], r["steps"], r["said_s"], r["took_s"], f"{float(r['off_percent']):+.0f} %"]
        for r in rows
    ]  # fmt: skip
    return [line, "", *markdown(["scene", "steps estimated", "steps", "s estimated", "s", "off"], cells)]


def main() -> None:
    """Compute the ladders and write what rests on them."""
    a = options(__doc__, "docs", only=list(STUDIES))
    if not a.docs:
        compute(a.only)
    cases = {name: case_of(name) for name in STUDIES}
    cases = {name: case for name, case in cases.items() if fit.reference(case.rows) is not None}
    tables = [*cases_part(cases), "## Orders", "", *orders_part(list(cases.values()))]
    for name, case in cases.items():
        save(diagram(case.rows, case.name, case.temperature), figure_path("accuracy", f"accuracy_{name}.png"))
        print(f"{case.name}: flattening, {order_of(case.rows, 'flattening_ratio_total', case.temperature)}")
    write_parts(PAGES["accuracy"], {"tables": tables, "pace": pace_part()})


if __name__ == "__main__":
    main()
