"""Convergence of a splat and its jet: python workflows/jets.py [--docs]

Five fast impacts at the presets, one also with 64,000 points; then with the particle as elements, until it rests or an element fails.
Rows in docs/tables/jets.csv are not computed again. --docs: run nothing, write the table of the page.
"""

import itertools
import time
from collections.abc import Mapping

import numpy as np
from element_particle import EFFECTS, ElementImpact, strike
from pages import computed, drawing, impact_tables, markdown, options, spacing_of, write_parts
from study_table import Row, column, number, study

from coupler import Scene
from coupler.errors import SolverError
from coupler.impact.exchange import Impact
from coupler.plan.cost import ELEMENT_SIZE_OVER_SPACING
from coupler.plan.planning import plan

CASES = {
    "Ni 25 µm, 1000 m/s, on SS304": ("Ni", 25, 1000, "SS304"),
    "Cu 25 µm, 600 m/s, on Cu": ("Cu", 25, 600, "Cu"),
    "Cu 20 µm, 750 m/s, on 42CrMo4": ("Cu", 20, 750, "42CrMo4"),
    "Al 25 µm, 725 m/s, on SS304": ("Al", 25, 725, "SS304"),
    "Ti64 25 µm, 1000 m/s, on SS304": ("Ti64", 25, 1000, "SS304"),
}
PRESETS = ("draft", "standard", "fine")
FINEST = ("Ti64 25 µm, 1000 m/s, on SS304", "64000 points")  # in the other cases a run takes a day: points thin more
SIZES = (3.4, 2.4, 1.7, 1.2)  # um, edges of the particle's elements and of the target's
THINNED = 0.1  # a point with a smaller least principal stretch counts as thinned
SHAPE = {"height": "height_m", "thickness": "thickness_m", "diameter": "splat_diameter_m"}


def scene(case: str, preset: str, spacing: float = 0.0, **more: object) -> Scene:
    """The scene of a case; spacing: um, that of the preset if 0."""
    metal, diameter, velocity, base = CASES[case]
    tables = impact_tables(metal, diameter, velocity, base, spacing=spacing)
    return Scene.from_dict({"preset": preset, "adhesion": {"kind": "none"}, **tables, **more}, "jets")


def by_elements(case: str, size: float) -> dict[str, object]:
    """Follow the particle as finite elements until it rests or an element fails. size: edges, um."""
    spacing = round(size / ELEMENT_SIZE_OVER_SPACING, 6)
    impact = ElementImpact(plan(scene(case, "fine", spacing, effects=EFFECTS)), size * 1e-6)
    t, tets = impact.target, impact.target.mesh.conn[impact.elements]

    def edges() -> np.ndarray:
        """Edges (m, 3, 3) of the tetrahedra from their first node, m."""
        return t.nodes.x[tets[:, 1:]] - t.nodes.x[tets[:, :1]]

    undeformed = np.linalg.inv(edges())
    started, ended, last = time.process_time(), "at rest", (np.eye(3)[None], impact.measures())

    def probe() -> None:
        nonlocal last
        last = np.swapaxes(undeformed @ edges(), 1, 2), impact.measures()

    try:
        strike(impact, probe)
    except SolverError as problem:
        ended = f"{t.time * 1e9:.0f} ns: {str(problem)[:80]}"
    F, measures = last
    row = _row(case, F, t.nodes.x[impact.nodes], measures)
    return {**row, "cpu_s": round(time.process_time() - started, 1), "ended": ended}


def by_points(case: str, what: str) -> dict[str, object]:
    """Run one scene to rest. what: a preset, or "N points"."""
    preset, spacing = (what, 0.0) if what in PRESETS else ("fine", round(spacing_of(int(what.split()[0])), 6))
    last: dict[str, np.ndarray] = {}

    def probe(impact: Impact) -> None:
        p = impact.particle
        last["F"], last["skin"] = p.whole("F").reshape(-1, 3, 3), impact.surface.positions(p.x)

    with computed(scene(case, preset, spacing), probe=probe) as (result, cpu):
        end = dict(result.end)
    row = _row(case, last["F"], last["skin"], end)
    return {**row, "unresolved": round(end["unresolved_share"], 4), "cpu_s": round(cpu, 1), "ended": "at rest"}


def _row(case: str, F: np.ndarray, skin: np.ndarray, measures: Mapping[str, float]) -> dict[str, object]:
    """The columns of a splat and its jet. F (n,3,3): deformation gradients; skin (v,3) m: vertices; measures: as `Result.end`."""
    diameter, stretches = CASES[case][1] * 1e-6, np.linalg.svd(F, compute_uv=False)  # the largest first
    return {
        "points": len(stretches), "stretch_median": round(float(np.median(stretches[:, 0])), 2),
        "stretch_99": round(float(np.percentile(stretches[:, 0], 99)), 2),
        "thinned": round(float(np.mean(stretches[:, 2] < THINNED)), 4),
        **{name: round(measures[key] / diameter, 3) for name, key in SHAPE.items()},
        "top": round(float(skin[:, 2].max()) / diameter, 3), "span": round(float(np.ptp(skin[:, 2])) / diameter, 3),
        "jet_um": round(measures["jet_length_m"] * 1e6, 2),
    }  # fmt: skip


def row_of(case: str, what: str) -> dict[str, object]:
    """Measure the splat and its jet of an impact. what: a preset, "N points", or "elements S um"."""
    return by_elements(case, float(what.split()[1])) if what.startswith("elements") else by_points(case, what)


def at_rest(rows: list[Row], case: str, body: str) -> list[Row]:
    """The rows of a case that came to rest, with the particle as "points" or as "elements"."""
    own = [row for row in rows if row["case"] == case and row["ended"] == "at rest"]
    return [row for row in own if ("elements" in row["preset"]) == (body == "elements")]


def page(rows: list[Row]) -> None:
    """Write the table of the page: the measures of each impact at all presets and sizes."""
    measures = {"stretch_median": 2, "stretch_99": 1, "height": 2, "thickness": 2, "diameter": 2, "jet_um": 1}
    lines = []
    for case, body in itertools.product(CASES, ("points", "elements")):
        own = at_rest(rows, case, body)
        cells = ["/".join(f"{number(row, name):.{digits}f}" for row in own) for name, digits in measures.items()]
        lines.append([case if body == "points" else "", body, *cells])
    head = "impact | particle of | stretch, median | stretch, 99 % | height | thickness | diameter | jet, µm"
    write_parts("jets", {"table": markdown(head, lines, rows)})


def draw(rows: list[Row]) -> None:
    """Draw thickness and stretch against the number of points, and of elements."""
    with drawing("jets", 9.6, 3.8, "constrained") as figure:
        left, right = figure.subplots(1, 2)
        for (k, case), body in itertools.product(enumerate(CASES), ("points", "elements")):
            own, full = at_rest(rows, case, body), body == "points"
            style = {"color": f"C{k}", "ls": "-" if full else "--", "mfc": None if full else "none"}
            size = column(own, "points")
            left.semilogx(size, column(own, "thickness"), "o", label=case if full else None, **style)
            right.semilogx(size, column(own, "stretch_99"), "o", **style)
            right.semilogx(size, column(own, "stretch_median"), "s", ms=4, alpha=0.5, **style)
        left.set(ylabel="thickness / diameter", title="99 % of the volume")
        right.set(ylabel="largest principal stretch", title="circles: 99th percentile; squares: median")
        for axes in (left, right):
            axes.set_xlabel("points (full lines), elements (dashed)")
            axes.set_ylim(bottom=0.0)
        figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)


if __name__ == "__main__":
    whats = (*PRESETS, *(f"elements {size:g} um" for size in SIZES))
    keys = [*((case, what) for what in whats for case in CASES), FINEST]
    table = study("jets", ("case", "preset"), () if options(__doc__, "docs").docs else keys, row_of)
    page(table.rows)
    draw(table.rows)
