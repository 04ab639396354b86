"""Splats of copper that are pulled off their ground, over velocity: python workflows/pull_cu.py

The scene is pull_cu.toml. Each velocity is a row of docs/tables/pull_cu.csv that is not computed again; --docs runs nothing and writes
figure and table of the page.
"""

from collections.abc import Sequence

import numpy as np
from pages import EVIDENCE, ROOT, column, computed, markdown, options, study, write_parts

from coupler import Scene
from coupler.properties.pull import FILM, strengths
from coupler.report.picture import blank, save
from coupler.studies.table import Row

VELOCITIES = ("600", "650", "700", "800")  # m/s
SIDE = 13e-6  # m: of the block, within each splat
ENDS = ("strength_MPa", "thin_MPa", "thick_MPa")  # of the films FILM


def row_of(velocity: str) -> dict[str, object]:
    """The splat of a velocity (m/s) as a row of the table; without a splat the strength is zero."""
    scene = Scene.load(ROOT / "workflows" / "pull_cu.toml").with_(particle={"velocity": f"{velocity} m/s"})
    with computed(scene, error=False) as (result, cpu):
        impact = result.summary["impacts"][0]
        row: dict[str, object] = {"verdict": impact["verdict"], "cpu_s": round(cpu)}
        if impact["rebounded"] is not False:
            return row | dict.fromkeys(ENDS, 0.0)
        pulls = strengths(result, SIDE, directions=["adhesion"])
    row |= {end: 1e-6 * p.strength_Pa for end, p in zip(ENDS, pulls, strict=True)}
    central = pulls[0]
    bond = {"brittle": central.brittle, "strain": central.strain, "energy_error": central.energy_error}
    return row | bond | {"parted": all(p.has_parted for p in pulls)}


def lines(rows: Sequence[Row]) -> list[str]:
    """The table of the page."""
    table = [
        [r["velocity_m_s"], f"{float(r['strength_MPa']):.0f}", f"{float(r['thin_MPa']):.0f}, {float(r['thick_MPa']):.0f}",
         f"{float(r['brittle']):.0%}" if r["brittle"] else "-"]
        for r in rows
    ]  # fmt: skip
    return markdown(f"m/s | MPa | {FILM[1]:g}, {FILM[2]:g} of the film | work in bonds", table, rows)


def draw(rows: Sequence[Row]) -> None:
    """Strength over velocity, with the range of the film."""
    v, (central, thin, thick) = column(rows, "velocity_m_s"), (column(rows, end) for end in ENDS)
    figure = blank(4.5, 3.2, 140, "constrained")
    axes = figure.subplots()
    axes.errorbar(v, central, np.maximum([central - thin, thick - central], 0.0), fmt="o-", capsize=3)
    axes.set(xlabel="velocity (m/s)", ylabel="adhesion (MPa)", ylim=(0.0, None))
    save(figure, EVIDENCE / "pull_cu.png")


def main() -> None:
    """Run what is missing, draw, write the table of the page."""
    a = options(__doc__, "docs")
    keys = () if a.docs else ((v,) for v in VELOCITIES)
    rows = sorted(study("pull_cu", ("velocity_m_s",), "python workflows/pull_cu.py", keys, row_of).rows,
                  key=lambda r: float(r["velocity_m_s"]))  # fmt: skip
    draw(rows)
    write_parts("properties", {"copper": lines(rows)})


if __name__ == "__main__":
    main()
