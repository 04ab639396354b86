"""Splats of copper that are pulled off the substrate, by velocity and temperature: python workflows/pull_cu.py

The scene is pull_cu.toml. Each impact is a row of docs/tables/pull_cu.csv that is not computed again; --docs only writes the page.
"""

from collections.abc import Sequence

import numpy as np
from pages import computed, drawing, markdown, options, scene_file, write_parts
from study_table import Row, column, study

from coupler.properties.pull import FILM, strengths

IMPACTS = (("600", "300"), ("650", "300"), ("650", "450"), ("650", "600"), ("700", "300"), ("800", "300"))  # m/s, K
KEY = ("velocity_m_s", "particle_K")
SIDE = 13e-6  # m: of the block, within each splat
ENDS = ("strength_MPa", "thin_MPa", "thick_MPa")  # of the films FILM


def row_of(velocity: str, temperature: str) -> dict[str, object]:
    """The splat of a particle (m/s, K) as a row of the table; without a splat the strength is zero."""
    particle = {"velocity": f"{velocity} m/s", "temperature": f"{temperature} K"}
    with computed(scene_file("pull_cu", particle=particle), error=False) as (result, cpu):
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
    table = []
    for r in rows:
        central, thin, thick = (f"{float(r[end]):.0f}" for end in ENDS)
        share = f"{float(r['brittle']):.0%}" if r["brittle"] else "-"
        table.append([r["velocity_m_s"], r["particle_K"], central, f"{thin}, {thick}", share])
    return markdown(f"m/s | K | MPa | {FILM[1]:g}, {FILM[2]:g} of the film | work in bonds", table, rows)


def draw(rows: Sequence[Row]) -> None:
    """Draw the strength of splats of cold particles against velocity, with the range due to the film."""
    rows = [row for row in rows if float(row["particle_K"]) == 300.0]
    v, (central, thin, thick) = column(rows, "velocity_m_s"), (column(rows, end) for end in ENDS)
    with drawing("pull_cu", 4.5, 3.2, "constrained", 140) as figure:
        axes = figure.subplots()
        axes.errorbar(v, central, np.maximum([central - thin, thick - central], 0.0), fmt="o-", capsize=3)
        axes.set(xlabel="velocity (m/s)", ylabel="adhesion (MPa)", ylim=(0.0, None))


if __name__ == "__main__":
    table = study("pull_cu", KEY, () if options(__doc__, "docs").docs else IMPACTS, row_of)
    rows = sorted(table.rows, key=lambda r: [float(r[name]) for name in KEY])
    draw(rows)
    write_parts("properties", {"copper": lines(rows)})
