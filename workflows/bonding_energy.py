"""Energy of bonds and of rebound over velocity, size, temperature and oxide film: python workflows/bonding_energy.py

Runs of workflows/critical_ni.toml and critical_cu.toml, kept in runs/bonding_energy (--runs). Writes docs/tables/bonding_energy.csv,
whose rows are not computed again, and its part of the page on bonding; --docs only the page.
"""

import math
import tomllib
from pathlib import Path

import numpy as np
from pages import PAGES, ROOT, markdown, number, options, study_table, versions, write_parts

from coupler import Scene
from coupler.files.result import Result
from coupler.physics.materials import material
from coupler.studies.critical import run_at
from coupler.studies.table import Row

COLUMNS = (
    "metal", "diameter_um", "temperature_K", "film", "velocity_m_s", "verdict", "restitution", "restitution_measured",
    "bonded_over_section", "bond_J_m2", "torn_J_m2", "rebound_J_m2",
)  # fmt: skip
# metal, diameter in um, temperature in K, factor on the strength of the film (its range: docs/theory/bonds.md), velocity in m/s
CASES = (
    *(("ni", None, 300.0, 1.0, v) for v in (400, 665, 1039)), *(("cu", None, 300.0, 1.0, v) for v in (400, 610, 952)),
    ("ni", None, 300.0, 1.94, 665), ("ni", None, 300.0, 1.94, 831), ("cu", None, 300.0, 2.0, 610),
    ("ni", 5.0, 300.0, 1.0, 665), ("ni", 40.0, 300.0, 1.0, 665), ("ni", None, 900.0, 1.0, 665),
)  # fmt: skip
# Hassani-Gangaraj, Veysset, Nelson & Schuh, arXiv 1612.08081, fig. 1c, digitised: +-10 m/s, +-0.003
MEASURED = {
    "ni": ((251, 0.129), (310, 0.101), (415, 0.086), (473, 0.098), (512, 0.076), (563, 0.068), (584, 0.045), (614, 0.021),
           (649, 0.020)),
    "cu": ((129, 0.134), (220, 0.090), (315, 0.112), (385, 0.091), (459, 0.065), (489, 0.052), (530, 0.037)),
}  # fmt: skip


def scene_of(name: str, diameter: float | None = None, temperature: float = 300.0, film: float = 1.0) -> Scene:
    """workflows/critical_NAME.toml with another diameter (um), its target in the same ratio, temperature (K) of the particle, and
    strength of the oxide film (factor)."""
    data = tomllib.loads((ROOT / "workflows" / f"critical_{name}.toml").read_text())
    own = float(data["particle"]["diameter"].split()[0])
    size = own if diameter is None else diameter
    for table, keys in (("particle", ("diameter",)), ("substrate", ("diameter", "height"))):
        for key in keys:
            data[table][key] = f"{float(data[table][key].split()[0]) * size / own:g} um"
    data["particle"]["temperature"] = f"{temperature:g} K"
    metal = data["particle"]["material"]
    strength = film * (material(metal).oxide_strength or 0.0)
    data["materials"] = {metal: {"oxide_strength": f"{strength / 1e9:g} GPa"}} if film != 1.0 else {}
    return Scene.from_dict(data, f"{name}_{size:g}um_{temperature:g}K_{film:g}")


def row_of(name: str, scene: Scene, film: float, velocity: float, runs: Path) -> dict[str, object]:
    """One run: energies over all the area that bonded."""
    folder = runs / scene.name
    run_at(scene, velocity, folder)
    s = Result(folder / f"{velocity:.6g}ms").values
    area, section = s["bonded_area_m2"], 0.25 * math.pi * scene.particle.diameter**2
    torn = s["energies"]["bond"] * s["kinetic_energy_0_J"]
    rebound = 0.5 * s["particle_mass_kg"] * max(s["velocity_z_m_s"], 0.0) ** 2
    v, e = np.array(MEASURED[name]).T
    is_measured = scene.particle.diameter == scene_of(name).particle.diameter and v.min() <= velocity <= v.max()
    values = (
        scene.particle.material, scene.particle.diameter * 1e6, scene.particle.temperature, film, velocity, s["verdict"],
        "" if s["restitution"] is None else round(s["restitution"], 4),
        round(float(np.interp(velocity, v, e)), 3) if is_measured else "", round(area / section, 3),
        *(round(energy / area, 1) if area else "" for energy in (s["bond_energy_J"], torn, rebound)),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def page(rows: list[Row]) -> list[str]:
    """The rows as a table."""
    lines = [
        [f"{row['metal']} {number(row, 'diameter_um'):g} um, {row['temperature_K']} K", row["film"], f"{row['velocity_m_s']} m/s",
         row["verdict"], row["restitution"] or "-", row["restitution_measured"] or "-", row["bonded_over_section"],
         *(f"{row[key]} J/m2" for key in ("bond_J_m2", "torn_J_m2", "rebound_J_m2"))] for row in rows
    ]  # fmt: skip
    head = "particle | film | velocity | verdict | restitution | measured | bonded / cross section | to tear it | torn | rebound"
    return [*markdown(head, lines), "", versions(rows)]


def main() -> None:
    """Run what is missing and tabulate."""
    a = options(__doc__ or "", "docs", runs="runs/bonding_energy")
    table = study_table("bonding_energy", COLUMNS, COLUMNS[:5], "python workflows/bonding_energy.py")
    known = {
        (row["metal"], *(number(row, key) for key in ("diameter_um", "temperature_K", "film", "velocity_m_s")))
        for row in table.rows
    }
    for name, D, T, film, v in CASES if not a.docs else ():
        scene = scene_of(name, D, T, film)
        p = scene.particle
        if (p.material, round(p.diameter * 1e6, 6), p.temperature, film, float(v)) not in known:
            print(table.add(row_of(name, scene, film, float(v), Path(a.runs))), flush=True)
    write_parts(PAGES["bonding"], {"energy": page(table.rows)})


if __name__ == "__main__":
    main()
