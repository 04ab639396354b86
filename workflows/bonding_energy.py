"""Verdict, and energy of bonds and of rebound, over velocity, size, temperature and film: python workflows/bonding_energy.py

Runs of workflows/critical_ni.toml and critical_cu.toml, kept in runs/bonding_energy (--runs). Writes docs/tables/bonding_energy.csv,
whose rows are not computed again, critical_velocity.csv from its verdicts, bonding_scatter.csv of several placements of points and
elements, and their parts of the page on bonding; --docs only these.
"""

import math
import tomllib
from itertools import groupby
from pathlib import Path
from statistics import fmean, stdev

import numpy as np
from pages import PAGES, ROOT, TABLES, markdown, number, options, study_table, versions, write_parts, write_table

from coupler import Scene
from coupler.files.result import Result
from coupler.measures import REBOUNDS
from coupler.physics.materials import material
from coupler.studies.critical import bracket, point_name, rows_at, shares_of
from coupler.studies.table import Row

COLUMNS = (
    "metal", "diameter_um", "temperature_K", "film", "preset", "velocity_m_s", "verdict", "restitution", "restitution_measured",
    "bonded_over_section", "bond_J_m2", "torn_J_m2", "rebound_J_m2",
)  # fmt: skip
KEY = COLUMNS[:6]
# metal, diameter in um, temperature in K, factor on the strength of the film (its range: docs/theory/bonds.md), preset, velocity in m/s
CASES = (
    *(("ni", 10.0, 300.0, 1.0, "draft", v) for v in (400, 480, 565, 665, 831, 1039)),
    *(("cu", 14.0, 300.0, 1.0, "draft", v) for v in (400, 610, 762, 952)),
    *(("ni", 10.0, 300.0, film, "draft", 665) for film in (0.36, 1.94)),
    *(("cu", 14.0, 300.0, film, "draft", 610) for film in (0.4, 2.0)),
    ("ni", 5.0, 300.0, 1.0, "draft", 665), ("ni", 40.0, 300.0, 1.0, "draft", 665), ("ni", 10.0, 900.0, 1.0, "draft", 665),
    *(("ni", 10.0, 300.0, 1.0, "standard", v) for v in (665, 565, 480, 400, 831)),
    *(("cu", 14.0, 300.0, 1.0, "standard", v) for v in (610, 500)),
    ("ni", 10.0, 300.0, 1.0, "fine", 665), *(("ni", 10.0, 300.0, 1.94, "standard", v) for v in (400, 665, 530)),
    ("ni", 10.0, 300.0, 0.36, "standard", 665), *(("cu", 14.0, 300.0, film, "standard", 610) for film in (2.0, 0.4)),
    ("ni", 10.0, 300.0, 1.0, "fine", 565), ("cu", 14.0, 300.0, 1.0, "fine", 610), ("ni", 10.0, 300.0, 1.0, "fine", 831),
)  # fmt: skip
# metal, diameter in um, preset, velocity in m/s, placements (`coupler.studies.critical.at_velocity`)
PLACEMENTS = (
    *(("ni", 10.0, "draft", v, 6) for v in (565, 665, 831, 480)), ("cu", 14.0, "draft", 610, 6),
    *(("ni", 10.0, "standard", v, 4) for v in (565, 665, 831)),
)  # fmt: skip
OF_SECTION = ("margin_J_m2", "bond_J_m2", "torn_J_m2", "let_go_J_m2", "torn_before_J_m2", "rebound_J_m2")
PLACED = ("metal", "diameter_um", "preset", "velocity_m_s", "placement", "verdict", "restitution", *OF_SECTION)
# Hassani-Gangaraj, Veysset, Nelson & Schuh, arXiv 1612.08081, fig. 1c, digitised: +-10 m/s, +-0.003
MEASURED = {
    "ni": ((251, 0.129), (310, 0.101), (415, 0.086), (473, 0.098), (512, 0.076), (563, 0.068), (584, 0.045), (614, 0.021),
           (649, 0.020)),
    "cu": ((129, 0.134), (220, 0.090), (315, 0.112), (385, 0.091), (459, 0.065), (489, 0.052), (530, 0.037)),
}  # fmt: skip
# m/s, of particles of a diameter (um) at 300 K, the same source
MEASURED_CRITICAL = {("Ni", 10.0): 660.0, ("OFHC_Cu", 14.0): 568.0}


def scene_of(name: str, size: float, temperature: float = 300.0, film: float = 1.0, preset: str = "draft") -> Scene:
    """workflows/critical_NAME.toml with another diameter (um), its target in the same ratio, temperature (K) of the particle, strength
    of the oxide film (factor) and preset."""
    data = tomllib.loads((ROOT / "workflows" / f"critical_{name}.toml").read_text())
    data["preset"] = preset
    own = float(data["particle"]["diameter"].split()[0])
    for table, keys in (("particle", ("diameter",)), ("substrate", ("diameter", "height"))):
        for key in keys:
            data[table][key] = f"{float(data[table][key].split()[0]) * size / own:g} um"
    data["particle"]["temperature"] = f"{temperature:g} K"
    metal = data["particle"]["material"]
    strength = film * (material(metal).oxide_strength or 0.0)
    data["materials"] = {metal: {"oxide_strength": f"{strength / 1e9:g} GPa"}} if film != 1.0 else {}
    return Scene.from_dict(data, f"{name}_{size:g}um_{temperature:g}K_{film:g}_{preset}")


def row_of(
    name: str, size: float, temperature: float, film: float, preset: str, velocity: float, runs: Path
) -> dict[str, object]:
    """One run: energies over all the area that bonded."""
    scene = scene_of(name, size, temperature, film, preset)
    folder = runs / scene.name
    rows_at(scene, velocity, folder)
    s = Result(folder / f"{velocity:.6g}ms").values
    area, section = s["bonded_area_m2"], 0.25 * math.pi * scene.particle.diameter**2
    torn = s["energies"]["bond"] * s["kinetic_energy_0_J"]
    upwards = s["velocity_z_m_s"]
    rebound = None if upwards is None else 0.5 * s["particle_mass_kg"] * max(upwards, 0.0) ** 2
    v, e = np.array(MEASURED[name]).T
    metal = scene.particle.material
    is_measured = (metal, size) in MEASURED_CRITICAL and temperature == 300.0 and v.min() <= velocity <= v.max()
    values = (
        metal, size, temperature, film, preset, velocity, s["verdict"],
        "" if s["restitution"] is None else round(s["restitution"], 4),
        round(float(np.interp(velocity, v, e)), 3) if is_measured else "", round(area / section, 3),
        *(round(energy / area, 1) if area and energy is not None else "" for energy in (s["bond_energy_J"], torn, rebound)),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def placed_rows(
    name: str, size: float, preset: str, velocity: float, repeat: int, runs: Path
) -> list[dict[str, object]]:
    """Runs of several placements: energies over the section of the particle; of a run without a verdict no margin or rebound.

    let_go: of the centre of mass when it moves off fastest; torn_before: dissipated by bonds until then.
    """
    scene = scene_of(name, size, preset=preset)
    folder, section = runs / scene.name, 0.25 * math.pi * scene.particle.diameter**2
    rows = []
    for k, row in enumerate(rows_at(scene, velocity, folder, repeat)):
        s = Result(folder / point_name(velocity, k)).values
        speed = row["rebound_velocity_m_s"] if row["verdict"] == REBOUNDS else None
        history, mass = Result(folder / point_name(velocity, k)).history(), s["particle_mass_kg"]
        fastest = int(np.argmax(history["velocity_z"]))  # the net force turns: the contact lets go
        energies = (
            s["margin_J"], s["bond_energy_J"], history["bond"][-1], 0.5 * mass * history["velocity_z"][fastest] ** 2,
            history["bond"][fastest], None if speed is None else 0.5 * mass * float(str(speed)) ** 2,
        )  # fmt: skip
        first = scene.particle.material, size, preset, velocity, k, row["verdict"], row["restitution"]
        rows.append(dict(zip(PLACED, (*first, *(None if e is None else e / section for e in energies)), strict=True)))
    return rows


def scatter_page(rows: list[Row]) -> list[str]:
    """Mean and standard deviation over the placements; a margin without a verdict counts as 0."""
    lines = []
    for key, each in groupby(rows, key=lambda row: tuple(row[k] for k in PLACED[:4])):
        own, (metal, size, preset, velocity) = list(each), key
        share = shares_of(own, len(own))[float(velocity)]
        values = [[float(row[k] or 0.0) for row in own if k == "margin_J_m2" or row[k]] for k in PLACED[6:]]
        words = [f"{fmean(v):.3g} ± {stdev(v):.2g}" if len(v) > 1 else "-" for v in values]
        torn = fmean(values[3])
        ratio = f"{stdev(values[1]) / torn:.2f}"
        lines.append([f"{metal} {size} um", preset, f"{velocity} m/s", f"{share:.0%} of {len(own)}", *words, ratio])
    head = (
        "particle | preset | velocity | stick | restitution | margin | to tear the bonds | torn | moves off with | torn before"
        " | rebound | scatter / torn"
    )
    return [*markdown(head, lines), "", versions(rows)]


def name_of(row: Row) -> str:
    """The particle of a row."""
    return f"{row['metal']} {number(row, 'diameter_um'):g} um, {number(row, 'temperature_K'):g} K"


def criticals(rows: list[Row]) -> list[dict[str, object]]:
    """The bracket that the verdicts of each particle, film and preset show, and its error where the velocity is measured."""

    def case(row: Row) -> tuple[str, ...]:
        return tuple(row[key] for key in KEY[:-1])

    lines = []
    for key, group in groupby(sorted(rows, key=case), key=case):
        first, *others = group
        found = bracket({number(row, "velocity_m_s"): row["verdict"] for row in (first, *others)})
        at_300 = number(first, "temperature_K") == 300.0
        measured = MEASURED_CRITICAL.get((first["metal"], number(first, "diameter_um"))) if at_300 else None
        error = "" if measured is None or found.velocity is None else f"{found.velocity / measured - 1.0:+.3f}"
        values = found.low or "", found.high or "", found.velocity or "", measured or "", error
        names = "rebounds_to_m_s", "sticks_from_m_s", "critical_m_s", "measured_m_s", "relative_error"
        lines.append(dict(zip((*KEY[:-1], *names), (*key, *values), strict=True)))
    return lines


def critical_page(lines: list[dict[str, object]]) -> list[str]:
    """Critical velocities as a table."""

    def words(r: dict[str, object]) -> object:
        if r["rebounds_to_m_s"]:
            return r["critical_m_s"] or f"none up to {r['rebounds_to_m_s']:g}"
        return f"at most {r['sticks_from_m_s']:g}" if r["sticks_from_m_s"] else "undecided"

    rows = [
        [f"{r['metal']} {r['diameter_um']} um, {r['temperature_K']} K", r["film"], r["preset"], words(r), r["measured_m_s"] or "-",
         r["relative_error"] or "-"] for r in lines
    ]  # fmt: skip
    return markdown("particle | film | preset | computed, m/s | measured, m/s | error", rows)


def page(rows: list[Row]) -> list[str]:
    """The rows as a table."""
    lines = [
        [name_of(row), row["film"], row["preset"], f"{row['velocity_m_s']} m/s",
         row["verdict"], row["restitution"] or "-", row["restitution_measured"] or "-", row["bonded_over_section"],
         *(f"{row[key]} J/m2" if row[key] else "-" for key in ("bond_J_m2", "torn_J_m2", "rebound_J_m2"))] for row in rows
    ]  # fmt: skip
    head = "particle | film | preset | velocity | verdict | restitution | measured | bonded / section | to tear it | torn | rebound"
    return [*markdown(head, lines), "", versions(rows)]


def main() -> None:
    """Run what is missing and tabulate."""
    a = options(__doc__ or "", "docs", runs="runs/bonding_energy")
    table = study_table("bonding_energy", COLUMNS, KEY, "python workflows/bonding_energy.py")
    metals = {"ni": "Ni", "cu": "OFHC_Cu"}
    known = {
        (row["metal"], *(number(row, k) for k in KEY[1:4]), row["preset"], number(row, "velocity_m_s"))
        for row in table.rows
    }
    for name, *case in CASES if not a.docs else ():
        if (metals[name], *case) not in known:
            print(table.add(row_of(name, *case, Path(a.runs))), flush=True)
    scatter = study_table("bonding_scatter", PLACED, PLACED[:5], "python workflows/bonding_energy.py")
    for name, size, preset, velocity, repeat in PLACEMENTS if not a.docs else ():
        first = metals[name], f"{size:.6g}", preset, str(velocity)
        if not all((*first, str(k)) in scatter for k in range(repeat)):
            for row in placed_rows(name, size, preset, velocity, repeat, Path(a.runs)):
                scatter.add(row)
    lines = criticals(table.rows)
    about = "remake: python workflows/bonding_energy.py\nfilm: factor on the strength of the oxide film (docs/theory/bonds.md)"
    write_table(TABLES / "critical_velocity.csv", lines, about)
    write_parts(
        PAGES["bonding"],
        {"energy": page(table.rows), "critical": critical_page(lines), "scatter": scatter_page(scatter.rows)},
    )


if __name__ == "__main__":
    main()
