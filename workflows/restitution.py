"""Rebound over velocity, for Ni, Ti, Cu and Al on their own kind: python workflows/restitution.py

Particles of 25 um at 300 K, preset draft, without adhesion: 19 runs, each a row of docs/tables/restitution.csv that is not computed
again. Then the figure and the table of the page on bonding; --docs makes only these.
"""

import math
import tempfile
from pathlib import Path

import numpy as np
from pages import (
    PAGES,
    column,
    figure_path,
    markdown,
    marked,
    number,
    options,
    single_impact,
    study_table,
    versions,
    write_parts,
)  # fmt: skip

from coupler import Scene, run
from coupler.contact.hold import CONTACT_RANGE
from coupler.geometry.triangles import vertex_areas
from coupler.impact.exchange import Impact
from coupler.physics.materials import Material, material
from coupler.progress import Progress
from coupler.report.picture import blank, save
from coupler.studies.table import Row

METALS = ("Ni", "Ti", "OFHC_Cu", "Al")
VELOCITIES = (200, 400, 600, 850)
DIAMETER, TEMPERATURE = 25e-6, 300.0
BAND = ((0.5, "Ni", 400), (2.0, "Ni", 400), (8.0, "Ni", 400))  # contact stiffness, metal, velocity
FLOW_STRAIN = 0.2  # at which Johnson-Cook gives the flow stress of the theory
COLUMNS = (
    "metal", "velocity_m_s", "contact_stiffness", "restitution", "rebound_m_s", "area_um2", "interface_strain", "interface_T_K",
    "needed_J_m2", "flattening", "energy_drift",
)  # fmt: skip

SCENE = """
preset = "draft"
{impact}diameter = "150 um"
height = "75 um"
[adhesion]
kind = "none"
"""


class Interface:
    """A probe: area, strain and temperature of the contact when the particle's centre turns back."""

    def __init__(self) -> None:
        self.values: tuple[float, float, float] | None = None

    def __call__(self, impact: Impact) -> None:
        p, t, s = impact.particle, impact.target, impact.surface
        rows, facets = impact.contact.touching(s.weights.shape[0], CONTACT_RANGE * p.spacing)
        if self.values is not None or len(rows) == 0 or p.totals.momentum[2] < 0.0:
            return
        area = vertex_areas(s.positions(p.x), s.triangles)[rows]
        behind = t.mesh.facet_element[facets]
        strain, T = (np.maximum(s.values(a)[rows], b[behind]) for a, b in ((p.eps_p, t.eps_p), (p.T, t.T)))
        self.values = float(area.sum()), float(np.average(strain, weights=area)), float(np.average(T, weights=area))


def rebound(metal: str, velocity: float, stiffness: float) -> dict[str, object]:
    """One impact, and the energy per area of contact that would have kept the particle."""
    probe = Interface()
    with tempfile.TemporaryDirectory() as place:
        scene = Scene.from_text(SCENE.format(impact=single_impact(metal, 25.0, velocity, metal)), "restitution")
        numerics = {} if stiffness == 1.0 else {"contact_stiffness": stiffness}
        s = run(scene, Path(place) / "run", threads=1, probe=probe, numerics=numerics, progress=Progress(quiet=True))
        mass, up = s.particle_mass_kg, s.rebound_velocity_m_s
    area, strain, T = probe.values or (math.nan, math.nan, math.nan)
    values = (
        metal, velocity, stiffness, round(up / velocity, 5), round(up, 2), round(area * 1e12, 2), round(strain, 3), round(T, 1),
        round(0.5 * mass * up**2 / area, 2), round(s.flattening_ratio, 4), f"{s.energy_drift:.1e}",
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def flow_stress(m: Material, velocity: float) -> float:
    """At FLOW_STRAIN and the strain rate v / D, without heating, Pa."""
    return m.flow_stress(FLOW_STRAIN, velocity / DIAMETER, m.T_ref)


def johnson(m: Material, velocity: float) -> float:
    """Coefficient of restitution e = 3.8 (Y/E*)^(1/2) (m v^2 / (2 Y R^3))^(-1/8): Johnson (1985), Contact Mechanics, eq. 11.47."""
    nu = (3 * m.K - 2 * m.G) / (2 * (3 * m.K + m.G))
    stiff = 2 * m.G * (1 + nu) / (1 - nu**2) / 2  # both bodies of the same metal
    Y, R = flow_stress(m, velocity), DIAMETER / 2
    mass = m.rho * math.pi / 6 * DIAMETER**3
    return 3.8 * math.sqrt(Y / stiff) * (0.5 * mass * velocity**2 / (Y * R**3)) ** (-1 / 8)


def curve(rows: list[Row], metal: str) -> tuple[np.ndarray, ...]:
    """Velocity and restitution of a metal's runs with the usual contact, by velocity."""
    own = [row for row in rows if row["metal"] == metal and number(row, "contact_stiffness") == 1.0]
    own.sort(key=lambda row: number(row, "velocity_m_s"))
    return tuple(column(own, name) for name in ("velocity_m_s", "restitution"))


def draw(rows: list[Row]) -> None:
    colours = dict(zip(METALS, ("#0072b2", "#d55e00", "#009e73", "#cc79a7"), strict=True))
    figure = blank(6.0, 4.6, 110)
    axes = figure.add_axes((0.12, 0.13, 0.85, 0.83))
    for metal, colour in colours.items():
        v, e = curve(rows, metal)
        axes.plot(v, e, "o-", color=colour, label=metal, ms=4)
        axes.fill_between(v, 0.7 * e, 1.3 * e, color=colour, alpha=0.12, lw=0)
        smooth = np.linspace(v.min(), v.max(), 30)
        axes.plot(smooth, [johnson(material(metal), x) for x in smooth], "--", color=colour, lw=1)
    axes.plot([], [], "k--", lw=1, label="Johnson (1985), theory")
    axes.legend(fontsize=8)
    axes.set(xlabel="velocity of impact (m/s)", ylabel="coefficient of restitution", ylim=(0, None))
    save(figure, figure_path("bonding", "bonding.png"))


def rebound_part(rows: list[Row]) -> list[str]:
    """Restitution over velocity, computed and by theory, and the influence of the contact stiffness."""
    lines = []
    for metal in METALS:
        v, e = curve(rows, metal)
        cells = [f"{value:.3f} ({johnson(material(metal), at):.3f})" for at, value in zip(v, e, strict=True)]
        lines.append([metal, *cells])
    texts = []
    stiffness = {number(row, "contact_stiffness"): row for row in rows if number(row, "contact_stiffness") != 1.0}
    for factor, row in sorted(stiffness.items()):
        v, e = number(row, "velocity_m_s"), number(row, "restitution")
        usual = float(curve([r for r in rows if number(r, "velocity_m_s") == v], row["metal"])[1][0])
        text = marked(f"{row['metal']} at {v:.0f} m/s with {factor:g} times the contact stiffness", row)
        texts += ["", f"{text}: {e:.3f}, {e / usual - 1:+.0%}."]
    return [
        *markdown(["restitution (theory)", *(f"{v} m/s" for v in VELOCITIES)], lines),
        *texts,
        "",
        versions(rows),
    ]


def main() -> None:
    """Run what is missing, tabulate, draw."""
    a = options(__doc__, "docs")
    table = study_table("restitution", COLUMNS, COLUMNS[:3], "python workflows/restitution.py")
    cases = [(metal, v, 1.0) for v in VELOCITIES for metal in METALS] + [(m, v, factor) for factor, m, v in BAND]
    known = {(r["metal"], number(r, "velocity_m_s"), number(r, "contact_stiffness")) for r in table.rows}
    for case in cases if not a.docs else ():
        if case not in known:
            print(table.add(rebound(*case)), flush=True)
    draw(table.rows)
    write_parts(PAGES["bonding"], {"rebound": rebound_part(table.rows)})


if __name__ == "__main__":
    main()
