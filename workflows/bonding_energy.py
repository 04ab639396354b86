"""Energy that would hold a particle, over velocity, size and temperature: python workflows/bonding_energy.py

Runs of workflows/critical_ni.toml and critical_cu.toml, whose bonds have the energy of clean metal, kept in runs/bonding_energy
(--runs). Where all bonds are torn, their energy and that of the rebound over the sound area is what G would have had to be. Writes
docs/tables/bonding_energy.csv, whose rows are not computed again, and its part of the page on bonding; --docs only the page.
"""

import math
import tomllib
from pathlib import Path

import numpy as np
from pages import PAGES, ROOT, markdown, number, options, study_table, versions, write_parts

from coupler import Scene
from coupler.files.result import Result
from coupler.studies.critical import run_at
from coupler.studies.table import Row

COLUMNS = (
    "metal", "diameter_um", "temperature_K", "velocity_m_s", "verdict", "restitution", "restitution_measured", "bonded_over_section",
    "sound_share", "needed_J_m2", "needed_over_given",
)  # fmt: skip
VELOCITIES = {"ni": (250, 400, 530, 665, 831, 1000), "cu": (250, 400, 488, 610, 762, 952)}
TRENDS = (("ni", 5.0, 300.0, 665), ("ni", 40.0, 300.0, 665), ("ni", 10.0, 600.0, 665), ("ni", 10.0, 900.0, 665))
# Hassani-Gangaraj, Veysset, Nelson & Schuh, arXiv 1612.08081, fig. 1c, digitised: +-10 m/s, +-0.003
MEASURED = {
    "ni": ((251, 0.129), (310, 0.101), (415, 0.086), (473, 0.098), (512, 0.076), (563, 0.068), (584, 0.045), (614, 0.021),
           (649, 0.020)),
    "cu": ((129, 0.134), (220, 0.090), (315, 0.112), (385, 0.091), (459, 0.065), (489, 0.052), (530, 0.037)),
}  # fmt: skip


def scene_of(name: str, diameter: float | None = None, temperature: float = 300.0) -> Scene:
    """workflows/critical_NAME.toml with another diameter (um), its target in the same ratio, and temperature (K) of the particle."""
    data = tomllib.loads((ROOT / "workflows" / f"critical_{name}.toml").read_text())
    own = float(data["particle"]["diameter"].split()[0])
    size = own if diameter is None else diameter
    for table, keys in (("particle", ("diameter",)), ("substrate", ("diameter", "height"))):
        for key in keys:
            data[table][key] = f"{float(data[table][key].split()[0]) * size / own:g} um"
    data["particle"]["temperature"] = f"{temperature:g} K"
    return Scene.from_dict(data, f"{name}_{size:g}um_{temperature:g}K")


def row_of(name: str, scene: Scene, velocity: float, runs: Path) -> dict[str, object]:
    """One run, and the energy per sound area that would have kept the particle."""
    folder = runs / scene.name
    run_at(scene, velocity, folder)
    s = Result(folder / f"{velocity:.6g}ms").values
    given, section = scene.derived.adhesion_law.energy or math.nan, 0.25 * math.pi * scene.particle.diameter**2
    torn = s["energies"]["bond"] * s["kinetic_energy_0_J"]
    rebound = 0.5 * s["particle_mass_kg"] * s["velocity_z_m_s"] ** 2
    needed = given * (1.0 + rebound / torn)
    v, e = np.array(MEASURED[name]).T
    is_measured = scene.particle.diameter == scene_of(name).particle.diameter and v.min() <= velocity <= v.max()
    values = (
        scene.particle.material, scene.particle.diameter * 1e6, scene.particle.temperature, velocity, s["verdict"],
        round(s["restitution"], 4), round(float(np.interp(velocity, v, e)), 3) if is_measured else "",
        round(s["bonded_area_m2"] / section, 3), round(torn / given / s["bonded_area_m2"], 3),
        round(needed, 1), round(needed / given, 1),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def page(rows: list[Row]) -> list[str]:
    """The rows as a table."""
    lines = [
        [f"{row['metal']} {number(row, 'diameter_um'):g} um, {row['temperature_K']} K", f"{row['velocity_m_s']} m/s", row["verdict"],
         row["restitution"], row["restitution_measured"] or "-", row["bonded_over_section"], row["sound_share"],
         f"{row['needed_J_m2']} J/m2"] for row in rows
    ]  # fmt: skip
    head = "particle | velocity | verdict | restitution | measured | bonded / cross section | sound share | energy that would hold it"
    return [*markdown(head, lines), "", versions(rows)]


def main() -> None:
    """Run what is missing and tabulate."""
    a = options(__doc__ or "", "docs", runs="runs/bonding_energy")
    table = study_table("bonding_energy", COLUMNS, COLUMNS[:4], "python workflows/bonding_energy.py")
    cases = [(name, scene_of(name), v) for name, all_v in VELOCITIES.items() for v in all_v]
    cases += [(name, scene_of(name, D, T), v) for name, D, T, v in TRENDS]
    known = {(*(number(row, key) for key in COLUMNS[1:4]), row["metal"]) for row in table.rows}
    for name, scene, v in cases if not a.docs else ():
        p = scene.particle
        if (round(p.diameter * 1e6, 6), p.temperature, float(v), p.material) not in known:
            print(table.add(row_of(name, scene, float(v), Path(a.runs))), flush=True)
    write_parts(PAGES["bonding"], {"energy": page(table.rows)})


if __name__ == "__main__":
    main()
