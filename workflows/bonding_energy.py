"""Critical velocities by exposure, over size, temperature, film and strength: python workflows/bonding_energy.py [--docs]

Runs of workflows/critical_ni.toml, critical_cu.toml and critical_ni_rate.toml, kept in runs/bonding_energy (--runs). Each is a row of
docs/tables/bonding_energy.csv that is not computed again. critical_velocity.csv has the brackets of their verdicts, bonding_scatter.csv
the margins of several placements of points and elements, contact_springs.csv the energies of contact springs and rebound against the
stiffness of the springs, without bonds, and bond_profile.csv the strength of bonds against the radius (critical_al.toml). At the end
the script makes the figure and the table of the page on bonding; --docs makes only these.
"""

import itertools
import math
import tomllib
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from pages import computed, drawing, markdown, options, scene_file, write_parts
from study_table import REMAKE, TABLES, Row, column, measurements, number, study

from coupler import Scene
from coupler.files.result import Result
from coupler.impact.exchange import Impact
from coupler.impact.touching import Touching
from coupler.physics.materials import material
from coupler.studies.critical import Bracket, at_velocity, bracket, point_name, rows_at
from coupler.studies.table import write_rows

KEY = ("metal", "diameter_um", "temperature_K", "film", "strength", "taylor_alpha", "preset", "velocity_m_s")
PLACED_KEY = ("metal", "diameter_um", "preset", "velocity_m_s", "placement")
ABOUT = f"""remake: {REMAKE}
film: factor on the strength of the oxide film (docs/theory/bonds.md)
strength: strength set of the metal; taylor_alpha: of its hardening by gradients of plastic strain, 0 for none"""
# the sets whose fitted rates reach those of an impact, and an estimate with a rate (critical_ni_rate.toml)
NI, CU, RATE = "Steinberg_1996", "Preston_2003", "critical_ni_rate"
FILES = {"Ni": "critical_ni", "OFHC_Cu": "critical_cu", "Al1100": "critical_al"}
ALPHA = "0.35"  # Taylor's coefficient of the workflows (docs/theory/material.md)
# first columns of the key -> velocities (m/s). PLACED_CASES: at several placements (`studies.critical.at_velocity`), without gradients
CASES, PLACED_CASES = (
    {tuple(name.split(", ")): velocities for name, velocities in measurements(section, "scenes").items()}
    for section in ("critical", "placements")
)
PLACEMENTS = 3
VELOCITY_NI = 665.0  # m/s, of the springs
SIZE_AL, VELOCITY_AL = 22.0, 1100.0  # um and m/s, of the profile
ZONES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)  # of the particle's radius, at the greatest deformation
MEASURED = measurements("rebound")  # restitution and critical velocity, of particles of `diameter_um` at 300 K


def scene_of(
    metal: str, diameter: str, temperature: str = "300", film: str = "1", strength: str = "", alpha: str = "0",
    preset: str = "draft",
) -> Scene:  # fmt: skip
    """A scene of FILES with these values (`CASES`). The target keeps its ratio to the particle. strength: "" for that of the file."""
    name, D = RATE if strength == RATE else FILES[metal], float(diameter)
    scene = scene_file(name)
    scale = D * 1e-6 / scene.particle.diameter
    size = {key: f"{getattr(scene.substrate, key) * 1e6 * scale:g} um" for key in ("diameter", "height")}
    changes: dict[str, object] = {"taylor_alpha": float(alpha)}
    if strength not in ("", RATE):
        changes["strength"] = strength
    if film != "1":
        changes["oxide_strength"] = f"{float(film) * (material(metal).oxide_strength or 0.0) / 1e9:g} GPa"
    title = "_".join((metal, diameter, temperature, film, strength, alpha, preset))
    return scene.with_(
        name=title.replace(".", "p").replace(" ", "-"), preset=preset,
        particle={"diameter": f"{D:g} um", "temperature": f"{temperature} K"}, substrate=size, materials={metal: changes},
    )  # fmt: skip


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
    """The row of one placement: margin, if there is a verdict, and energy dissipated by bonds, per section of the particle."""
    scene, v, k = scene_of(metal, size, preset=preset), float(velocity), int(placement)
    folder, section = runs / scene.name, 0.25 * math.pi * scene.particle.diameter**2
    row = rows_at(scene, v, folder, PLACEMENTS)[k]
    result = Result(folder / point_name(v, k))
    margin, torn = (None if e is None else e / section for e in (result.values["margin_J"], result.history("bond")[-1]))
    return {
        "verdict": row["verdict_by_bonds"], "restitution": row["restitution"], "margin_J_m2": margin, "torn_J_m2": torn,
    }  # fmt: skip


def critical_of(metal: str, diameter: str) -> float | None:
    """The measured critical velocity, m/s, of a metal at room temperature; None if the diameter (um) is not the measured one."""
    own = MEASURED[metal]
    return float(own["critical_velocity_m_s"]) if f"{own['diameter_um']}" == diameter else None


def springs(preset: str, factor: str) -> dict[str, object]:
    """One impact without bonds; energies over the section of the particle. factor: on the stiffness of the contact."""
    scene, energy = scene_of("Ni", "10", preset=preset), list[float]()

    def probe(impact: Impact) -> None:
        if not energy and impact.sinking < 0.0:  # the particle turns back
            energy.append(impact.contact.penalty_energy)

    data = tomllib.loads(at_velocity(scene, VELOCITY_NI)) | {"adhesion": {"kind": "none"}}
    with computed(Scene.from_dict(data), probe=probe, numerics={"contact_stiffness": float(factor)}) as (result, _):
        s = dict(result.values)
    section = 0.25 * np.pi * scene.particle.diameter**2
    rebound = 0.5 * s["particle_mass_kg"] * s["velocity_z_m_s"] ** 2
    return {
        "metal": scene.particle.material, "velocity_m_s": VELOCITY_NI, "springs_J_m2": round(energy[0] / section, 1),
        "rebound_J_m2": round(rebound / section, 1), "restitution": round(s["restitution"], 4), "steps": s["steps"],
    }  # fmt: skip


def profile() -> Iterator[dict[str, object]]:
    """Means over the bonded area of each zone, of the bonds that have formed by the end of the impact."""
    scene, values = scene_of("Al1100", f"{SIZE_AL:g}", preset="standard"), dict[str, np.ndarray]()

    def probe(impact: Impact) -> None:
        bonds, exposure = impact.bonds, impact.exposure
        if impact.sinking <= 0.0 and bonds is not None and exposure is not None:
            nodes, bond = bonds.bond.nodes, bonds.bond
            values["radius"] = np.linalg.norm(impact.surface.positions(impact.particle.x)[nodes, :2], axis=1)
            values["area"], values["strength"], values["energy"] = bond.area, bond.strength[:, 0], bond.energy[:, 0]
            flow = np.full(
                impact.surface.weights.shape[0], np.inf
            )  # of the softer metal; far from the target there is none
            near = Touching(impact.domains, 10.0)
            flow[near.rows] = near.strength
            values["flow"], values["clean"] = flow[nodes], exposure.clean[nodes, 0]

    with computed(Scene.from_text(at_velocity(scene, VELOCITY_AL)), probe=probe):
        pass
    radius, area = values.pop("radius"), values.pop("area")
    for low, high in itertools.pairwise(ZONES):
        zone = (radius >= 0.5e-6 * SIZE_AL * low) & (radius < 0.5e-6 * SIZE_AL * high)
        if area[zone].any():
            mean = {name: float(np.average(field[zone], weights=area[zone])) for name, field in values.items()}
            yield {
                "metal": scene.particle.material, "diameter_um": SIZE_AL, "velocity_m_s": VELOCITY_AL, "preset": "standard",
                "zone_r_over_R": f"{low:g} to {high:g}", "clean_share": round(mean["clean"], 3),
                "strength_MPa": round(mean["strength"] * 1e-6), "over_flow_stress": round(mean["strength"] / mean["flow"], 2),
                "energy_J_m2": round(mean["energy"], 1),
            }  # fmt: skip


def bracket_of(rows: Iterable[Row]) -> Bracket:
    """The critical velocity that the verdicts of some runs show."""
    return bracket({number(row, "velocity_m_s"): row["verdict"] for row in rows})


def criticals(rows: list[Row]) -> Iterator[Row]:
    """The bracket that the verdicts of each particle, film and preset show."""
    for key in sorted({tuple(row[name] for name in KEY[:-1]) for row in rows}):
        own = [row for row in rows if tuple(row[name] for name in KEY[:-1]) == key]
        found = bracket_of(own)
        measured = critical_of(*key[:2]) if key[2] == "300" else None
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
    heads = "without gradients", "with gradients", "with gradients and a rate"
    table = []
    for metal, size in sorted({(r["metal"], r["diameter_um"]) for r in fine}, key=lambda key: (key[0], float(key[1]))):
        own = [r for r in fine if (r["metal"], r["diameter_um"]) == (metal, size)]
        found = {(r["taylor_alpha"], r["strength"] in (NI, CU)): words(r) for r in own}
        measured = critical_of(metal, size)
        cells = (found.get(key, "-") for key in (("0", True), (ALPHA, True), (ALPHA, False)))
        table.append([f"{metal} {size} µm", *cells, f"{measured:g}" if measured else "-"])
    return markdown(["critical velocity, m/s", *heads, "measured"], table, rows)


def draw(rows: list[Row]) -> None:
    """Computed and measured restitution against velocity, and the brackets of the critical velocity; a panel for each metal."""
    with drawing("critical", 9.6, 4.0) as figure:
        for left, (metal, size, strength) in zip((0.07, 0.57), (("Ni", "10", NI), ("OFHC_Cu", "14", CU)), strict=True):
            axes, measured = figure.add_axes((left, 0.13, 0.42, 0.78)), MEASURED[metal]
            axes.plot(*np.array(measured["e"]).T, "o", mfc="none", color="k", ms=5, label="measured")
            critical = measured["critical_velocity_m_s"]
            axes.axvline(critical, color="k", ls="--", lw=1, label="measured critical velocity")
            for alpha, colour, mark in ((ALPHA, "#0072b2", "s-"), ("0", "#d55e00", "^:")):
                words = "gradients harden" if alpha == ALPHA else "no gradients"
                key = metal, size, "300", "1", strength, alpha, "fine"
                own = [row for row in rows if tuple(row[k] for k in KEY[:-1]) == key]
                points = sorted((number(r, "velocity_m_s"), float(r["restitution"])) for r in own if r["restitution"])
                axes.plot(*np.array(points).T, mark, color=colour, ms=5, lw=1, label=f"computed, {words}")
                found = bracket_of(own)
                if found.low is not None and found.high is not None:
                    label = f"computed critical velocity, {words}"
                    axes.axvspan(found.low, found.high, color=colour, alpha=0.2, lw=0, label=label)
            axes.set(title=f"{metal}, {size} µm", xlabel="velocity of impact (m/s)", ylim=(-0.003, None))
        axes.legend(fontsize=7, loc="upper right")
        figure.axes[0].set_ylabel("coefficient of restitution")


def draw_springs(rows: list[Row]) -> None:
    """Energy of the contact springs at the greatest deformation, and of the rebound, against their stiffness."""
    with drawing("contact", 5.4, 3.4, "constrained") as figure:
        axis = figure.add_subplot()
        for key, words, style in (("rebound_J_m2", "rebound", "-"), ("springs_J_m2", "contact springs", ":")):
            for preset, colour in (("draft", "#d55e00"), ("standard", "#0072b2")):
                own = [row for row in rows if row["preset"] == preset]
                x, y = column(own, "contact_stiffness"), column(own, key)
                axis.plot(x, y, f"o{style}", color=colour, ms=4, label=f"{words}, {preset}")
        axis.set(
            xlabel="stiffness of the contact over the default", ylabel="energy over contact area (J/m²)", ylim=(0, None)
        )
        axis.legend(fontsize=8)


if __name__ == "__main__":
    a = options(__doc__, "docs", runs="runs/bonding_energy")
    runs = Path(a.runs)
    keys = ((*case, f"{v}") for case, speeds in CASES.items() for v in speeds)
    table = study("bonding_energy", KEY, () if a.docs else keys, partial(row_of, runs=runs))
    if not a.docs:
        placed = ((*case, f"{v}") for case, speeds in PLACED_CASES.items() for v in speeds)
        placements = ((*key, f"{k}") for key in placed for k in range(PLACEMENTS))
        study("bonding_scatter", PLACED_KEY, placements, partial(placed_row, runs=runs))
        profiles = study("bond_profile", ("zone_r_over_R",))
        for row in () if profiles.rows else profile():
            print(profiles.add(row), flush=True)
    stiffness = () if a.docs else itertools.product(("draft", "standard"), ("1", "8", "16"))
    draw_springs(study("contact_springs", ("preset", "contact_stiffness"), stiffness, springs).rows)
    lines = list(criticals(table.rows))
    draw(table.rows)
    write_rows(TABLES / "critical_velocity.csv", list(lines[0]), lines, ABOUT)
    write_parts("bonding", {"critical": critical_part(lines, table.rows)})
