"""How the time of an impact grows with the splats before it: python workflows/growth.py [--impacts 10] [--docs]

Nickel particles of 20 um at 550 m/s on steel, coarse (700 points), at places drawn from a seed within 12 um of the axis. One line for
each impact in docs/tables/growth.csv: elements, steps, and wall time (one thread) of the steps and of the work before them (meshing,
joining and equilibrium of the previous splat; building of the model). --docs only draws the figure of the page on speed.
"""

import random

from pages import computed, drawing, impact_tables, options
from study_table import column, table_rows, write_table

from coupler import Result, Scene


def scene(impacts: int, seed: int) -> Scene:
    """Particles at random places within a disc."""
    dice, particles = random.Random(seed), []
    for _ in range(impacts):
        x = y = 12.0
        while x * x + y * y >= 144:
            x, y = dice.uniform(-12, 12), dice.uniform(-12, 12)
        tables = impact_tables("Ni", 20.0, 550.0, spacing=1.8, dwell="0 us", offset=[f"{x:.2f} um", f"{y:.2f} um"])
        particles.append(tables.pop("particle"))
    more = {"adhesion": {"kind": "tied"}, "end": {"at": "rest"}}
    return Scene.from_dict({"particle": particles, **tables, **more}, "growth")


def rows_of(result: Result) -> list[dict[str, object]]:
    """The table's row of each impact."""
    rows = []
    for impact, before in zip(result.impacts, [{}, *result.summary["joins"]], strict=False):
        joining = sum(s for part, s in before.get("seconds", {}).items() if part != "impacts")
        rows.append({
            "impact": len(rows) + 1, "elements": impact["elements"], "steps": impact["steps"],
            "before s": f"{joining + impact['wall_s'] - impact['wall_loop_s']:.1f}", "steps s": f"{impact['wall_loop_s']:.1f}",
            "dt mean ps": f"{impact['dt_mean_s'] * 1e12:.1f}",
        })  # fmt: skip
    return rows


def draw() -> None:
    """Time of each impact, and its number of steps."""
    rows = table_rows("growth")
    number, before, steps = (column(rows, name) for name in ("impact", "before s", "steps s"))
    with drawing("growth", 6.0, 3.2) as figure:
        axes = figure.add_axes((0.11, 0.16, 0.77, 0.81))
        axes.bar(number, before, color="#999999", label="new body, joining, equilibrium")
        axes.bar(number, steps, bottom=before, color="#0072b2", label="steps of the impact")
        axes.set(xlabel="impact", ylabel="time of one core (s)", xticks=number)
        right = axes.twinx()
        right.plot(number, column(rows, "steps"), "ko--", ms=4, label="number of steps (right)")
        right.set_ylim(0, None)
        figure.legend(loc="upper left", bbox_to_anchor=(0.11, 0.97))


if __name__ == "__main__":
    a = options(__doc__, "docs", impacts=10, seed=2)
    if not a.docs:
        with computed(scene(a.impacts, a.seed)) as (result, _):
            write_table("growth", rows_of(result))
    draw()
