"""Rebound over velocity and the critical velocity, for Ni, Ti, Cu and Al on their own kind: python workflows/restitution.py

Particles of 25 um at 300 K, preset draft, without adhesion: 18 runs, each a row of docs/tables/restitution.csv that is not computed
again. Then docs/tables/critical_velocity.csv, the figure and the tables of the page on bonding; --docs makes only these.
"""

import math
import tempfile
from pathlib import Path

import numpy as np
from pages import (
    PAGES,
    TABLES,
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
    write_table,
)  # fmt: skip

from coupler import Scene, run
from coupler.contact.hold import CONTACT_RANGE
from coupler.geometry.triangles import vertex_areas
from coupler.impact.exchange import Impact
from coupler.physics.adhesion import critical_velocity
from coupler.physics.materials import Material, material
from coupler.progress import Progress
from coupler.report.picture import blank, save
from coupler.studies.table import Row

METALS = ("Ni", "Ti", "OFHC_Cu", "Al")
VELOCITIES = (200, 400, 600, 850)
DIAMETER, TEMPERATURE = 25e-6, 300.0
BAND = ((0.5, "Ni", 400), (2.0, "Ni", 400))  # contact stiffness, metal, velocity
FLOW_STRAIN = 0.2  # at which Johnson-Cook gives the flow stress of the theory
FITTED = "OFHC_Cu"  # whose critical velocity gives the one number that is fitted
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


def critical_velocity_linear(metal: Material, temperature: float) -> float:
    """Critical velocity, m/s, as the linear fit v = 667 - 14 rho + 0.08 T_m + 0.1 sigma_TS - 0.4 T to computed impacts.

    There rho is in g/cm3, temperatures in degC, sigma_TS in MPa: Assadi, Gaertner, Stoltenhoff & Kreye (2003), Acta
    Mater. 51, 4379. It was fitted for copper and for small changes about it: use it for nothing far from copper. nan where the
    metal has no sigma_TS.
    """
    strength = (metal.sigma_TS or math.nan) * 1e-6
    T, T_m = temperature - 273.15, metal.T_m - 273.15
    return 667.0 - 14.0 * metal.rho * 1e-3 + 0.08 * T_m + 0.1 * strength - 0.4 * T


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


def crossing(v: np.ndarray, strain: np.ndarray, threshold: float) -> float:
    """The velocity at which the strain of the interface comes to `threshold`, linear between runs; nan outside of them."""
    return float(np.interp(threshold, strain, v)) if strain[0] <= threshold <= strain[-1] else math.nan


def curve(rows: list[Row], metal: str) -> tuple[np.ndarray, ...]:
    """Velocity, restitution and strain of the interface of a metal's runs with the usual contact, by velocity."""
    own = [row for row in rows if row["metal"] == metal and number(row, "contact_stiffness") == 1.0]
    own.sort(key=lambda row: number(row, "velocity_m_s"))
    return tuple(column(own, name) for name in ("velocity_m_s", "restitution", "interface_strain"))


def criticals(rows: list[Row]) -> list[dict[str, object]]:
    """Critical velocities: of the published formulas, and from one strain of the interface for all, fitted to copper."""
    v, _, strain = curve(rows, FITTED)
    schmidt = {metal: critical_velocity(material(metal), TEMPERATURE) for metal in METALS}
    threshold = float(np.interp(schmidt[FITTED], v, strain))
    critical: list[dict[str, object]] = []
    for metal in METALS:
        v, e, strain = curve(rows, metal)
        at = crossing(v, strain, threshold)
        critical.append({
            "metal": metal, "schmidt_2006_m_s": round(schmidt[metal]),
            "assadi_2003_m_s": round(critical_velocity_linear(material(metal), TEMPERATURE)),
            "strain_threshold": round(threshold, 2), "from_strain_m_s": round(at) if math.isfinite(at) else "none",
            "fitted": "yes" if metal == FITTED else "no",
            "strain_at_schmidt": round(float(np.interp(schmidt[metal], v, strain)), 2),
            "exponent_of_restitution": round(float(np.polyfit(np.log(v), np.log(e), 1)[0]), 2),
        })  # fmt: skip
    return critical


def draw(rows: list[Row], critical: list[dict[str, object]]) -> None:
    colours = dict(zip(METALS, ("#0072b2", "#d55e00", "#009e73", "#cc79a7"), strict=True))
    figure = blank(11.0, 4.6, 110)
    left, right = figure.add_axes((0.07, 0.13, 0.41, 0.83)), figure.add_axes((0.57, 0.13, 0.41, 0.83))
    for metal, colour in colours.items():
        v, e, strain = curve(rows, metal)
        left.plot(v, e, "o-", color=colour, label=metal, ms=4)
        left.fill_between(v, 0.7 * e, 1.3 * e, color=colour, alpha=0.12, lw=0)
        smooth = np.linspace(v.min(), v.max(), 30)
        left.plot(smooth, [johnson(material(metal), x) for x in smooth], "--", color=colour, lw=1)
        right.plot(v, strain, "o-", color=colour, ms=4)
        row = next(r for r in critical if r["metal"] == metal)
        right.plot(row["schmidt_2006_m_s"], row["strain_at_schmidt"], "*", color=colour, ms=13, mec="black", mew=0.5)
    right.axhline(critical[0]["strain_threshold"], color="0.3", lw=1, ls=":")
    left.plot([], [], "k--", lw=1, label="Johnson (1985), theory")
    left.legend(fontsize=8)
    left.set(xlabel="velocity of impact (m/s)", ylabel="coefficient of restitution", ylim=(0, None))
    right.set(xlabel="velocity of impact (m/s)", ylabel="plastic strain of the interface, mean", ylim=(0, None))
    right.plot([], [], "k*", ms=9, label="critical velocity of Schmidt et al. (2006)")
    right.plot([], [], ":", color="0.3", label="threshold fitted to copper")
    right.legend(fontsize=8)
    save(figure, figure_path("bonding", "bonding.png"))


def rebound_part(rows: list[Row]) -> list[str]:
    """Restitution over velocity, computed and by theory, and the influence of the contact stiffness."""
    lines = []
    for metal in METALS:
        v, e, _ = curve(rows, metal)
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


def critical_part(critical: list[dict[str, object]]) -> list[str]:
    """Critical velocities beside each other; the fitted one is marked."""
    lines = []
    for r in critical:
        ours = f"{r['from_strain_m_s']} m/s" + (" (fitted)" if r["fitted"] == "yes" else "")
        ours = f"none up to {VELOCITIES[-1]} m/s" if r["from_strain_m_s"] == "none" else ours
        lines.append([r["metal"], f"{r['schmidt_2006_m_s']} m/s", f"{r['assadi_2003_m_s']} m/s", ours, r["strain_at_schmidt"],
                      f"v^{r['exponent_of_restitution']}"])  # fmt: skip
    head = (
        "| Schmidt et al. (2006) | Assadi et al. (2003) | from one strain | strain at Schmidt's | restitution goes as"
    )
    return [*markdown(head, lines), "", f"The strain: {critical[0]['strain_threshold']}."]


def main() -> None:
    """Run what is missing, tabulate, draw."""
    a = options(__doc__, "docs")
    table = study_table("restitution", COLUMNS, COLUMNS[:3], "python workflows/restitution.py")
    cases = [(metal, v, 1.0) for v in VELOCITIES for metal in METALS] + [(m, v, factor) for factor, m, v in BAND]
    known = {(r["metal"], number(r, "velocity_m_s"), number(r, "contact_stiffness")) for r in table.rows}
    for case in cases if not a.docs else ():
        if case not in known:
            print(table.add(rebound(*case)), flush=True)
    critical = criticals(table.rows)
    about = "remake: python workflows/restitution.py\n25 um, 300 K; from_strain: one strain of the interface, fitted to OFHC_Cu"
    write_table(TABLES / "critical_velocity.csv", critical, about)
    draw(table.rows, critical)
    write_parts(PAGES["bonding"], {"rebound": rebound_part(table.rows), "critical": critical_part(critical)})


if __name__ == "__main__":
    main()
