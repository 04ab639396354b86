"""Critical velocities by exposure, over size, temperature, film and strength: python workflows/bonding_energy.py [--docs]

Runs of workflows/critical_ni.toml, critical_cu.toml and critical_ni_rate.toml, kept in runs/bonding_energy (--runs). Each is a row of
docs/tables/bonding_energy.csv that is not computed again; critical_velocity.csv has the brackets of their verdicts, bonding_scatter.csv
the margins of several placements of points and elements. Then the figure and the table of the page on bonding; --docs makes only these.
"""

import math
import tomllib
from collections.abc import Iterator
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np
from pages import EVIDENCE, ROOT, TABLES, fill, markdown, number, options, spacing_of, study_table, write_parts

from coupler import Scene
from coupler.files.result import Result
from coupler.physics.materials import material
from coupler.plan.cost import ELEMENT_SIZE_OVER_SPACING
from coupler.report.picture import blank, save
from coupler.studies.critical import bracket, point_name, rows_at
from coupler.studies.table import Row, write_rows

KEY = ("metal", "diameter_um", "temperature_K", "film", "strength", "taylor_alpha", "preset", "velocity_m_s")
COLUMNS = (*KEY, "verdict", "restitution", "bond_J_m2", "rebound_J_m2")
PLACED_KEY = ("metal", "diameter_um", "preset", "velocity_m_s", "placement")
PLACED = (*PLACED_KEY, "verdict", "restitution", "margin_J_m2", "torn_J_m2")
REMAKE = "python workflows/bonding_energy.py"
ABOUT = f"""remake: {REMAKE}
film: factor on the strength of the oxide film (docs/theory/bonds.md)
strength: strength set of the metal; taylor_alpha: of its hardening by gradients of plastic strain, 0 for none"""
# the sets whose fitted rates reach those of an impact, and an estimate with a rate (critical_ni_rate.toml)
NI, CU, RATE = "Steinberg_1996", "Preston_2003", "critical_ni_rate"
FILES = {"Ni": "critical_ni", "OFHC_Cu": "critical_cu", "Al1100": "critical_al"}
ALPHA = "0.35"  # Taylor's coefficient of the workflows (docs/theory/material.md)
FINER, FINER_POINTS = "half of fine", 128_000  # half the spacing of `fine`
# metal, diameter (um), temperature (K), film, strength set, taylor_alpha, preset: velocities (m/s)
CASES = {
    ("Ni", "10", "300", "1", NI, ALPHA, "fine"): (731, 698, 665, 632, 598, 532),
    ("Ni", "5", "300", "1", NI, ALPHA, "fine"): (698, 665), ("Ni", "40", "300", "1", NI, ALPHA, "fine"): (798,),
    ("OFHC_Cu", "14", "300", "1", CU, ALPHA, "fine"): (610, 580, 549, 488),
    ("OFHC_Cu", "5", "300", "1", CU, ALPHA, "fine"): (640, 610), ("OFHC_Cu", "40", "300", "1", CU, ALPHA, "fine"): (580, 549),
    ("OFHC_Cu", "14", "300", "1", CU, ALPHA, "standard"): (610, 580),
    ("Ni", "10", "300", "1", RATE, ALPHA, "fine"): (764, 731), ("Ni", "5", "300", "1", RATE, ALPHA, "fine"): (798, 764),
    ("Ni", "40", "300", "1", RATE, ALPHA, "fine"): (731, 698),
    ("Ni", "10", "300", "1", NI, "0", "fine"): (598, 565, 532), ("OFHC_Cu", "14", "300", "1", CU, "0", "fine"): (580, 549, 488),
    ("Ni", "10", "300", "1", NI, "0", "standard"): (598, 565), ("OFHC_Cu", "14", "300", "1", CU, "0", "standard"): (610, 580),
    ("Ni", "10", "300", "0.36", NI, "0", "standard"): (665,), ("Ni", "10", "300", "1.94", NI, "0", "standard"): (665,),
    ("OFHC_Cu", "14", "300", "0.4", CU, "0", "standard"): (610,), ("OFHC_Cu", "14", "300", "2", CU, "0", "standard"): (610,),
    ("Ni", "10", "900", "1", NI, "0", "standard"): (532,), ("Ni", "10", "300", "1", "Johnson_1983", "0", "standard"): (532, 480),
    ("OFHC_Cu", "14", "300", "1", "Johnson_1983", "0", "standard"): (488, 400),
    ("OFHC_Cu", "14", "300", "1", "Zerilli_1987", "0", "standard"): (400,),
    ("OFHC_Cu", "14", "300", "1", CU, ALPHA, FINER): (610, 549), ("Ni", "10", "300", "1", NI, ALPHA, FINER): (731, 665),
}  # fmt: skip
# metal, diameter (um), preset: velocities (m/s), without gradients, PLACEMENTS of each (`coupler.studies.critical.at_velocity`)
PLACED_CASES = {
    ("Ni", "10", "standard"): (665, 598, 565, 532), ("OFHC_Cu", "14", "standard"): (610, 580, 549, 488),
    ("Ni", "10", "draft"): (665, 831), ("OFHC_Cu", "14", "draft"): (610, 488),
}  # fmt: skip
PLACEMENTS = 3
# Hassani-Gangaraj, Veysset, Nelson & Schuh, arXiv 1612.08081, fig. 1c, digitised: +-10 m/s, +-0.003
MEASURED = {
    "Ni": ((251, 0.129), (310, 0.101), (415, 0.086), (473, 0.098), (512, 0.076), (563, 0.068), (584, 0.045), (614, 0.021),
           (649, 0.020)),
    "OFHC_Cu": ((129, 0.134), (220, 0.090), (315, 0.112), (385, 0.091), (459, 0.065), (489, 0.052), (530, 0.037)),
}  # fmt: skip
# m/s, of particles of a diameter (um) at 300 K, the same source
MEASURED_CRITICAL = {("Ni", "10"): 660.0, ("OFHC_Cu", "14"): 568.0}


def scene_of(
    metal: str, diameter: str, temperature: str = "300", film: str = "1", strength: str = "", alpha: str = "0",
    preset: str = "draft",
) -> Scene:  # fmt: skip
    """A scene of FILES with these values (`CASES`), its target in the same ratio to the particle. strength: "" for that of the file."""
    name = RATE if strength == RATE else FILES[metal]
    data = tomllib.loads((ROOT / "workflows" / f"{name}.toml").read_text())
    data["preset"] = "fine" if preset == FINER else preset
    if preset == FINER:
        spacing = spacing_of(FINER_POINTS, float(diameter))
        lengths = {"spacing": spacing, "element_size": ELEMENT_SIZE_OVER_SPACING * spacing}
        data["resolution"] = {key: f"{length:.4g} um" for key, length in lengths.items()}
    own = float(data["particle"]["diameter"].split()[0])
    for table, keys in (("particle", ("diameter",)), ("substrate", ("diameter", "height"))):
        for key in keys:
            data[table][key] = f"{float(data[table][key].split()[0]) * float(diameter) / own:g} um"
    data["particle"]["temperature"] = f"{temperature} K"
    changes = data.setdefault("materials", {}).setdefault(metal, {})
    changes["taylor_alpha"] = float(alpha)
    if strength not in ("", RATE):
        changes["strength"] = strength
    if film != "1":
        changes["oxide_strength"] = f"{float(film) * (material(metal).oxide_strength or 0.0) / 1e9:g} GPa"
    title = "_".join((metal, diameter, temperature, film, strength, alpha, preset))
    return Scene.from_dict(data, title.replace(".", "p").replace(" ", "-"))  # a name ends at its first point


def row_of(*key: str, runs: Path) -> dict[str, object]:
    """One run: energies over all the area that bonded."""
    scene, velocity = scene_of(*key[:-1]), float(key[-1])
    rows_at(scene, velocity, runs / scene.name)
    s = Result(runs / scene.name / point_name(velocity, 0)).values
    area, upwards = s["bonded_area_m2"], s["velocity_z_m_s"]
    rebound = None if upwards is None else 0.5 * s["particle_mass_kg"] * max(upwards, 0.0) ** 2
    energies = {"bond_J_m2": s["bond_energy_J"], "rebound_J_m2": rebound}
    return {
        "verdict": s["verdict_by_bonds"], "restitution": None if s["restitution"] is None else round(s["restitution"], 4),
        **{name: round(energy / area, 1) if area and energy is not None else "" for name, energy in energies.items()},
    }  # fmt: skip


def placed_row(metal: str, size: str, preset: str, velocity: str, placement: str, runs: Path) -> dict[str, object]:
    """A run of several placements: margin and energy that bonds have dissipated, over the section of the particle; no margin of a run
    without a verdict."""
    scene, v, k = scene_of(metal, size, preset=preset), float(velocity), int(placement)
    folder, section = runs / scene.name, 0.25 * math.pi * scene.particle.diameter**2
    row = rows_at(scene, v, folder, PLACEMENTS)[k]
    result = Result(folder / point_name(v, k))
    margin, torn = (None if e is None else e / section for e in (result.values["margin_J"], result.history("bond")[-1]))
    return {
        "verdict": row["verdict_by_bonds"], "restitution": row["restitution"], "margin_J_m2": margin, "torn_J_m2": torn,
    }  # fmt: skip


def criticals(rows: list[Row]) -> Iterator[Row]:
    """The bracket that the verdicts of each particle, film and preset show."""

    def case(row: Row) -> tuple[str, ...]:
        return tuple(row[key] for key in KEY[:-1])

    for key, group in groupby(sorted(rows, key=case), key=case):
        own = list(group)
        found = bracket({number(row, "velocity_m_s"): row["verdict"] for row in own})
        measured = MEASURED_CRITICAL.get(key[:2]) if key[2] == "300" else None
        values = [f"{value:g}" if value else "" for value in (found.low, found.high, found.velocity, measured)]
        names = "rebounds_to_m_s", "sticks_from_m_s", "critical_m_s", "measured_m_s"
        version = {"version": min(row["version"] for row in own)}
        yield dict(zip((*KEY[:-1], *names), (*key, *values), strict=True)) | version


def critical_part(lines: list[Row], rows: list[Row]) -> list[str]:
    """Critical velocities at `fine` by size: without and with gradients of plastic strain, and with a rate."""

    def words(r: Row) -> str:
        low, high = number(r, "rebounds_to_m_s"), number(r, "sticks_from_m_s")
        if math.isfinite(low + high):
            return f"{int((low + high) / 2 + 0.5)} ± {int((high - low) / 2 + 0.5)}"
        return f"above {low:g}" if math.isfinite(low) else f"below {high:g}"

    fine = [r for r in lines if r["preset"] == "fine"]
    columns = {
        "without gradients": ("0", True),
        "with gradients": (ALPHA, True),
        "with gradients and a rate": (ALPHA, False),
    }
    table = []
    for metal, size in sorted({(r["metal"], r["diameter_um"]) for r in fine}, key=lambda key: (key[0], float(key[1]))):
        own = [r for r in fine if (r["metal"], r["diameter_um"]) == (metal, size)]
        found = {(r["taylor_alpha"], r["strength"] in (NI, CU)): words(r) for r in own}
        measured = f"{MEASURED_CRITICAL[metal, size]:g}" if (metal, size) in MEASURED_CRITICAL else "-"
        table.append([f"{metal} {size} µm", *(found.get(key, "-") for key in columns.values()), measured])
    return markdown(["critical velocity, m/s", *columns, "measured"], table, rows)


def draw(rows: list[Row]) -> None:
    """Restitution over velocity beside the measured one, a panel for each metal; verdicts of the workflow's own scene."""
    figure = blank(9.6, 4.0, 110)
    for left, (metal, size, strength) in zip((0.07, 0.57), (("Ni", "10", NI), ("OFHC_Cu", "14", CU)), strict=True):
        axes = figure.add_axes((left, 0.13, 0.42, 0.78))
        axes.plot(*np.array(MEASURED[metal]).T, "o", mfc="none", color="k", ms=5, label="measured")
        axes.axvline(MEASURED_CRITICAL[metal, size], color="k", ls="--", lw=1, label="measured critical velocity")
        for alpha, colour, mark in ((ALPHA, "#0072b2", "s-"), ("0", "#d55e00", "^:")):
            words = "gradients harden" if alpha == ALPHA else "no gradients"
            key = metal, size, "300", "1", strength, alpha, "fine"
            own = [row for row in rows if tuple(row[k] for k in KEY[:-1]) == key]
            points = sorted((number(r, "velocity_m_s"), float(r["restitution"])) for r in own if r["restitution"])
            axes.plot(*np.array(points).T, mark, color=colour, ms=5, lw=1, label=f"computed, {words}")
            found = bracket({number(row, "velocity_m_s"): row["verdict"] for row in own})
            if found.low is not None and found.high is not None:
                label = f"computed critical velocity, {words}"
                axes.axvspan(found.low, found.high, color=colour, alpha=0.2, lw=0, label=label)
        axes.set(title=f"{metal}, {size} µm", xlabel="velocity of impact (m/s)", ylim=(-0.003, None))
    axes.legend(fontsize=7, loc="upper right")
    figure.axes[0].set_ylabel("coefficient of restitution")
    save(figure, EVIDENCE / "critical.png")


def main() -> None:
    """Run what is missing and tabulate."""
    a = options(__doc__, "docs", runs="runs/bonding_energy")
    table = study_table("bonding_energy", COLUMNS, KEY, REMAKE)
    keys = ((*case, f"{v}") for case, velocities in CASES.items() for v in velocities)
    fill(table, () if a.docs else keys, partial(row_of, runs=Path(a.runs)))
    placed = (
        (*case, f"{v}", f"{k}") for case, speeds in PLACED_CASES.items() for v in speeds for k in range(PLACEMENTS)
    )
    scatter = study_table("bonding_scatter", PLACED, PLACED_KEY, REMAKE)
    fill(scatter, () if a.docs else placed, partial(placed_row, runs=Path(a.runs)))
    lines = list(criticals(table.rows))
    draw(table.rows)
    write_rows(TABLES / "critical_velocity.csv", list(lines[0]), lines, ABOUT)
    write_parts("bonding", {"critical": critical_part(lines, table.rows)})


if __name__ == "__main__":
    main()
