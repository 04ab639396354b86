"""Does a splat converge, and its jet: python workflows/jets.py [--docs]

Five fast impacts at the presets. Rows in docs/tables/jets.csv are not computed again. --docs: run nothing, write the table of the page.
"""

import numpy as np
from pages import EVIDENCE, column, computed, fill, markdown, number, options, single_impact, study_table, write_parts

from coupler import Scene
from coupler.impact.exchange import Impact
from coupler.report.picture import blank, save
from coupler.studies.table import Row

CASES = {
    "Ni 25 µm, 1000 m/s, on SS304": ("Ni", 25, 1000, "SS304"),
    "Cu 25 µm, 600 m/s, on Cu": ("Cu", 25, 600, "Cu"),
    "Cu 20 µm, 750 m/s, on 42CrMo4": ("Cu", 20, 750, "42CrMo4"),
    "Al 25 µm, 725 m/s, on SS304": ("Al", 25, 725, "SS304"),
    "Ti64 25 µm, 1000 m/s, on SS304": ("Ti64", 25, 1000, "SS304"),
}
PRESETS = ("draft", "standard", "fine")
THINNED = 0.1  # of its length: a point compressed further
COLUMNS = (
    "case", "preset", "points", "stretch_median", "stretch_99", "thinned", "height", "thickness", "diameter", "top", "span",
    "jet_um", "unresolved", "cpu_s",
)  # fmt: skip


def row(case: str, preset: str) -> dict[str, object]:
    """Run one scene to rest and measure its splat and its jet."""
    last: dict[str, np.ndarray] = {}

    def probe(impact: Impact) -> None:
        p = impact.particle
        last["F"], last["skin"] = p.whole("F").reshape(-1, 3, 3), impact.surface.positions(p.x)

    text = single_impact(*CASES[case], more='[adhesion]\nkind = "none"\n')
    scene = Scene.from_text(f'preset = "{preset}"\n{text}', "jets")
    with computed(scene, probe=probe) as (result, cpu):
        end, diameter = dict(result.end), CASES[case][1] * 1e-6
    stretches = np.linalg.svd(last["F"], compute_uv=False)
    return {
        "case": case, "preset": preset, "points": len(stretches),
        "stretch_median": round(float(np.median(stretches[:, 0])), 2),
        "stretch_99": round(float(np.percentile(stretches[:, 0], 99)), 2),
        "thinned": round(float(np.mean(stretches[:, 2] < THINNED)), 4),
        "height": round(end["height_m"] / diameter, 3), "thickness": round(end["thickness_m"] / diameter, 3),
        "diameter": round(end["splat_diameter_m"] / diameter, 3),
        "top": round(float(last["skin"][:, 2].max()) / diameter, 3), "span": round(float(np.ptp(last["skin"][:, 2])) / diameter, 3),
        "jet_um": round(end["jet_length_m"] * 1e6, 2), "unresolved": round(end["unresolved_share"], 4),
        "cpu_s": round(cpu, 1),
    }  # fmt: skip


def page(rows: list[Row]) -> None:
    """Write the table of the page: of each impact the measures at the presets."""
    lines = []
    for case in CASES:
        own = {r["preset"]: r for r in rows if r["case"] == case}
        measures = (("stretch_median", "{:.2f}"), ("stretch_99", "{:.1f}"), ("height", "{:.2f}"), ("thickness", "{:.2f}"),
                    ("diameter", "{:.2f}"), ("jet_um", "{:.1f}"))  # fmt: skip
        cells = [
            " / ".join(form.format(number(own[preset], name)) for preset in PRESETS if preset in own)
            for name, form in measures
        ]
        lines.append([case, *cells])
    head = "impact | stretch, median | stretch, 99 % | height | thickness | diameter | jet, µm"
    write_parts("jets", {"table": markdown(head, lines, rows)})


def figure(rows: list[Row]) -> None:
    """Draw thickness and stretch over the number of points."""
    drawing = blank(9.6, 3.8, 110, "constrained")
    left, right = drawing.subplots(1, 2)
    for k, case in enumerate(CASES):
        own, color = [r for r in rows if r["case"] == case], f"C{k}"
        points = column(own, "points")
        left.semilogx(points, column(own, "thickness"), "o-", color=color, label=case)
        left.semilogx(points, column(own, "span"), "s:", color=color, mfc="none")
        right.semilogx(points, column(own, "stretch_99"), "o-", color=color)
        right.semilogx(points, column(own, "stretch_median"), "s:", color=color, mfc="none")
    left.set_ylabel("thickness / diameter")
    left.set_title("full: 99 % of the volume; open: outermost vertices", fontsize=9)
    right.set_ylabel("largest principal stretch of the points")
    right.set_title("full: 99th percentile; open: median", fontsize=9)
    for axes in (left, right):
        axes.set_xlabel("points")
        axes.set_ylim(bottom=0.0)
    drawing.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    save(drawing, EVIDENCE / "jets.png")


def main() -> None:
    """Compute the rows that the table lacks, the cheap ones first, and write the page."""
    table = study_table("jets", COLUMNS, ("case", "preset"), "python workflows/jets.py")
    if not options(__doc__, "docs").docs:
        fill(table, ((case, preset) for preset in PRESETS for case in CASES), row)
    page(table.rows)
    figure(table.rows)


if __name__ == "__main__":
    main()
