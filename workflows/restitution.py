"""Rebound over velocity and the critical velocity, for Ni, Ti, Cu and Al on their own kind: python workflows/restitution.py

Particles of 25 um at 300 K, preset draft, without adhesion: 18 runs, each kept as a line of docs/tables/restitution.csv as it ends, and
not run again while it is there (--anew does). Then docs/tables/critical_velocity.csv, docs/evidence/bonding.png and the tables of
docs/evidence/bonding.md. --draw makes only these.
"""

import argparse
import csv
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from coupler import Scene, run
from coupler.contact.hold import REACH
from coupler.geometry.triangles import vertex_areas
from coupler.physics.adhesion import critical_velocity, critical_velocity_linear
from coupler.physics.materials import Material, material
from coupler.progress import Progress

TABLES, PAGE = Path("docs/tables"), Path("docs/evidence/bonding.md")
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
name = "restitution"
preset = "draft"
[particle]
material = "{metal}"
diameter = "25 um"
velocity = "{velocity} m/s"
temperature = "300 K"
[substrate]
material = "{metal}"
diameter = "150 um"
height = "75 um"
[adhesion]
kind = "none"
"""


class Interface:
    """A probe: area, strain and temperature of the contact when the particle's centre turns back."""

    def __init__(self) -> None:
        self.found: tuple[float, float, float] | None = None

    def __call__(self, impact: Any) -> None:
        p, t, s = impact.particle, impact.target, impact.surface
        rows, facets = impact.contact.touching(s.weights.shape[0], REACH * p.spacing)
        if self.found is not None or len(rows) == 0 or p.momentum()[2] < 0.0:
            return
        area = vertex_areas(s.positions(p.x), s.triangles)[rows]
        behind = t.mesh.facet_element[facets]
        strain, T = (np.maximum(s.values(a)[rows], b[behind]) for a, b in ((p.eps_p, t.eps_p), (p.T, t.T)))
        self.found = float(area.sum()), float(np.average(strain, weights=area)), float(np.average(T, weights=area))


def rebound(metal: str, velocity: float, stiffness: float) -> dict[str, Any]:
    """One impact, and the energy per area of contact that would have kept the particle."""
    probe = Interface()
    with tempfile.TemporaryDirectory() as place:
        scene = Scene.from_text(SCENE.format(metal=metal, velocity=velocity), "restitution")
        numerics = {} if stiffness == 1.0 else {"contact_stiffness": stiffness}
        s = run(
            scene, Path(place) / "run", threads=1, probe=probe, numerics=numerics, progress=Progress(quiet=True)
        ).summary
    area, strain, T = probe.found or (math.nan, math.nan, math.nan)
    mass = s["particle_mass_kg"]
    up = s["rebound_velocity_m_s"]
    values = (
        metal, velocity, stiffness, round(up / velocity, 5), round(up, 2), round(area * 1e12, 2), round(strain, 3), round(T, 1),
        round(0.5 * mass * up**2 / area, 2), round(s["flattening_ratio"], 4), f"{s['energy_drift']:.1e}",
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def flow_stress(m: Material, velocity: float) -> float:
    """Johnson-Cook at FLOW_STRAIN and the strain rate v / D, without heating, Pa."""
    rate = max(velocity / DIAMETER, 1.0)
    return (m.A + m.B * FLOW_STRAIN**m.n) * (1.0 + m.C * math.log(rate))


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


def read() -> list[dict[str, Any]]:
    path = TABLES / "restitution.csv"
    if not path.exists():
        return []
    with path.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return [{k: v if k == "metal" else float(v) for k, v in row.items()} for row in rows]


def write(path: Path, names: tuple[str, ...], rows: list[dict[str, Any]], note: str) -> None:
    with path.open("w", newline="") as file:
        file.write(f"# remake: python workflows/restitution.py; {note}\n")
        table = csv.DictWriter(file, names)
        table.writeheader()
        table.writerows(rows)


def compute(anew: bool) -> None:
    rows = [] if anew else read()
    have = {(r["metal"], float(r["velocity_m_s"]), float(r["contact_stiffness"])) for r in rows}
    wanted = [(metal, v, 1.0) for v in VELOCITIES for metal in METALS] + [
        (metal, v, factor) for factor, metal, v in BAND
    ]
    for metal, v, factor in wanted:
        if (metal, float(v), factor) not in have:
            rows.append(rebound(metal, v, factor))
            print(rows[-1], flush=True)
            write(TABLES / "restitution.csv", COLUMNS, rows, "25 um, 300 K, on their own kind, draft, no adhesion")


def curve(rows: list[dict[str, Any]], metal: str) -> tuple[np.ndarray, ...]:
    """Velocity, restitution and strain of the interface of a metal's runs with the usual contact, by velocity."""
    own = sorted(
        (r for r in rows if r["metal"] == metal and float(r["contact_stiffness"]) == 1.0),
        key=lambda r: r["velocity_m_s"],
    )
    return tuple(
        np.array([float(r[name]) for r in own]) for name in ("velocity_m_s", "restitution", "interface_strain")
    )


def criticals(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Critical velocities: of the published formulas, and from one strain of the interface for all, fitted to copper."""
    v, _, strain = curve(rows, FITTED)
    schmidt = {metal: critical_velocity(material(metal), TEMPERATURE) for metal in METALS}
    threshold = float(np.interp(schmidt[FITTED], v, strain))
    found = []
    for metal in METALS:
        v, e, strain = curve(rows, metal)
        at = crossing(v, strain, threshold)
        found.append({
            "metal": metal, "schmidt_2006_m_s": round(schmidt[metal]),
            "assadi_2003_m_s": round(critical_velocity_linear(material(metal), TEMPERATURE)),
            "strain_threshold": round(threshold, 2), "from_strain_m_s": round(at) if math.isfinite(at) else "none",
            "fitted": "yes" if metal == FITTED else "no",
            "strain_at_schmidt": round(float(np.interp(schmidt[metal], v, strain)), 2),
            "exponent_of_restitution": round(float(np.polyfit(np.log(v), np.log(e), 1)[0]), 2),
        })  # fmt: skip
    return found


def draw(rows: list[dict[str, Any]], found: list[dict[str, Any]]) -> None:
    from coupler.report.picture import blank, save

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
        row = next(r for r in found if r["metal"] == metal)
        right.plot(row["schmidt_2006_m_s"], row["strain_at_schmidt"], "*", color=colour, ms=13, mec="black", mew=0.5)
    right.axhline(found[0]["strain_threshold"], color="0.3", lw=1, ls=":")
    left.plot([], [], "k--", lw=1, label="Johnson (1985), theory")
    left.legend(fontsize=8)
    left.set(xlabel="velocity of impact (m/s)", ylabel="coefficient of restitution", ylim=(0, None))
    right.set(xlabel="velocity of impact (m/s)", ylabel="plastic strain of the interface, mean", ylim=(0, None))
    right.plot([], [], "k*", ms=9, label="critical velocity of Schmidt et al. (2006)")
    right.plot([], [], ":", color="0.3", label="threshold fitted to copper")
    right.legend(fontsize=8)
    save(figure, Path("docs/evidence/bonding.png"))


def rebound_table(rows: list[dict[str, Any]]) -> str:
    """Restitution over velocity, computed and by theory, and what the stiffness of the contact makes of it."""
    lines = [
        "| restitution (theory) | " + " | ".join(f"{v} m/s" for v in VELOCITIES) + " |",
        "|---|" + "---|" * len(VELOCITIES),
    ]
    for metal in METALS:
        v, e, _ = curve(rows, metal)
        cells = [f"{value:.3f} ({johnson(material(metal), at):.3f})" for at, value in zip(v, e, strict=True)]
        lines.append(f"| {metal} | " + " | ".join(cells) + " |")
    band = sorted(
        (r for r in rows if float(r["contact_stiffness"]) != 1.0), key=lambda r: float(r["contact_stiffness"])
    )
    for r in band:
        _, e, _ = curve([q for q in rows if float(q["velocity_m_s"]) == float(r["velocity_m_s"])], r["metal"])
        lines += [
            "",
            f"{r['metal']} at {float(r['velocity_m_s']):.0f} m/s with {float(r['contact_stiffness']):g} times the stiffness of contact:"
            f" {float(r['restitution']):.3f}, {float(r['restitution']) / e[0] - 1:+.0%}.",
        ]
    return "\n".join(lines)


def critical_table(found: list[dict[str, Any]]) -> str:
    """Critical velocities beside each other; the fitted one is marked."""
    head = "| | Schmidt et al. (2006) | Assadi et al. (2003) | from one strain | strain at Schmidt's | restitution goes as |"
    lines = [head, "|---|---|---|---|---|---|"]
    for r in found:
        mark = " (fitted)" if r["fitted"] == "yes" else ""
        ours = (
            f"{r['from_strain_m_s']} m/s{mark}"
            if r["from_strain_m_s"] != "none"
            else f"none up to {VELOCITIES[-1]} m/s"
        )
        lines.append(
            f"| {r['metal']} | {r['schmidt_2006_m_s']} m/s | {r['assadi_2003_m_s']} m/s | {ours} | {r['strain_at_schmidt']} |"
            f" v^{r['exponent_of_restitution']} |"
        )
    return "\n".join([*lines, "", f"The strain: {found[0]['strain_threshold']}."])


def into_page(path: Path, parts: dict[str, str]) -> None:
    """Put texts between the marks of a page that name them."""
    text = path.read_text()
    for name, part in parts.items():
        start, end = f"<!-- {name}: python workflows/restitution.py -->", f"<!-- end of {name} -->"
        before, rest = text.split(start)
        text = f"{before}{start}\n{part}\n{end}{rest.split(end, 1)[1]}"
    path.write_text(text)


def main() -> None:
    """Run what is missing, tabulate, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--anew", action="store_true", help="run everything again")
    parser.add_argument("--draw", action="store_true", help="only tabulate and draw what is there")
    a = parser.parse_args()
    if not a.draw:
        compute(a.anew)
    rows = read()
    found = criticals(rows)
    write(
        TABLES / "critical_velocity.csv",
        tuple(found[0]),
        found,
        "25 um, 300 K; from_strain rests on one strain of the interface, fitted to OFHC_Cu",
    )
    for row in found:
        print(row)
    draw(rows, found)
    into_page(PAGE, {"rebound": rebound_table(rows), "critical": critical_table(found)})


if __name__ == "__main__":
    main()
