"""Critical velocities by exposure, over size, temperature, film and strength: python workflows/bonding_energy.py [--docs]

Runs of workflows/critical_ni.toml, critical_cu.toml and critical_ni_rate.toml, kept in runs/bonding_energy (--runs). Each is a row of
docs/tables/bonding_energy.csv that is not computed again; critical_velocity.csv has the brackets of their verdicts, bonding_scatter.csv
the margins of several placements of points and elements. Then the figure and the table of the page on bonding; --docs makes only these.
"""

import math
import tomllib
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from pages import EVIDENCE, ROOT, TABLES, markdown, number, options, study_table, write_parts, write_table

from coupler import Scene
from coupler.files.result import Result
from coupler.physics.materials import material
from coupler.report.picture import blank, save
from coupler.studies.critical import bracket, point_name, rows_at
from coupler.studies.table import Row

COLUMNS = (
    "metal", "diameter_um", "temperature_K", "film", "strength", "taylor_alpha", "preset", "velocity_m_s", "verdict", "restitution",
    "restitution_measured", "bonded_over_section", "bond_J_m2", "torn_J_m2", "rebound_J_m2",
)  # fmt: skip
KEY = COLUMNS[:8]


@dataclass(frozen=True)
class Case:
    """A scene at some velocities (m/s)."""

    name: str
    velocities: tuple[float, ...]
    preset: str = "draft"
    diameter: float = 0.0
    temperature: float = 300.0
    film: float = 1.0
    strength: str = ""
    alpha: float = 0.0

    @property
    def metal(self) -> str:
        """Name in the library."""
        return METALS[self.name][0]

    @property
    def size(self) -> float:
        """Diameter, um."""
        return self.diameter or METALS[self.name][1]

    @property
    def set(self) -> str:
        """Name of the strength set, that of the workflow by default."""
        return self.strength or str(
            data_of(self.name)["materials"][self.metal].get("strength", f"critical_{self.name}")
        )

    def key(self, velocity: float) -> tuple[str, ...]:
        """As in the table."""
        size, temperature, film, alpha = (f"{x:g}" for x in (self.size, self.temperature, self.film, self.alpha))
        return self.metal, size, temperature, film, self.set, alpha, self.preset, f"{velocity:g}"

    @property
    def scene(self) -> Scene:
        """workflows/critical_NAME.toml with these values, its target in the same ratio to the particle."""
        data = data_of(self.name)
        data["preset"] = self.preset
        own = float(data["particle"]["diameter"].split()[0])
        for table, keys in (("particle", ("diameter",)), ("substrate", ("diameter", "height"))):
            for key in keys:
                data[table][key] = f"{float(data[table][key].split()[0]) * self.size / own:g} um"
        data["particle"]["temperature"] = f"{self.temperature:g} K"
        metal = data["particle"]["material"]
        changes = data.setdefault("materials", {}).setdefault(metal, {})
        changes["taylor_alpha"] = self.alpha
        if self.strength:
            changes["strength"] = self.strength
        if self.film != 1.0:
            changes["oxide_strength"] = f"{self.film * (material(metal).oxide_strength or 0.0) / 1e9:g} GPa"
        title = f"{self.name}_{self.size:g}um_{self.temperature:g}K_{self.film:g}_{self.preset}"
        title += (f"_{self.alpha:g}" if self.alpha else "") + (f"_{self.strength}" if self.strength else "")
        return Scene.from_dict(data, title.replace(".", "p"))  # a name ends at its first point


ALPHA = 0.35  # Taylor's coefficient of the workflows (docs/theory/material.md)
# name of the workflow: metal and diameter, um; the sets of the workflows are those whose fitted rates reach those of an impact, that
# of ni_rate an estimate
METALS = {"ni": ("Ni", 10.0), "cu": ("OFHC_Cu", 14.0), "ni_rate": ("Ni", 10.0)}
CASES = (
    Case("ni", (665, 598, 565, 532, 400, 831), "standard"), Case("cu", (610, 580, 549, 488, 400, 762), "standard"),
    *(Case(name, velocities) for name, velocities in (("ni", (665, 831)), ("cu", (610, 488, 762)))),
    Case("ni", (665, 598, 565, 532, 400, 831), "fine"), Case("cu", (610, 580, 549, 488, 400, 762), "fine"),
    *(Case("ni", (665,), "standard", film=film) for film in (0.36, 1.94)),
    *(Case("cu", (610,), "standard", film=film) for film in (0.4, 2.0)),
    *(Case("cu", (610, 580, 549), "fine", diameter=size) for size in (5.0, 40.0)),
    *(Case("ni", (598, 565, 532), "fine", diameter=size) for size in (5.0, 40.0)),
    Case("ni", (532,), "standard", temperature=900.0),
    Case("ni", (532, 480), "standard", strength="Johnson_1983"), Case("cu", (549, 488, 400), "standard", strength="Johnson_1983"),
    *(Case("cu", (580, 488, 400), "standard", strength=name) for name in ("Konokman_2011", "Zerilli_1987", "Steinberg_1996")),
    Case("ni", (731, 698, 665, 632, 598, 532), "fine", alpha=ALPHA), Case("cu", (610, 580, 549, 488), "fine", alpha=ALPHA),
    Case("cu", (610, 580), "standard", alpha=ALPHA),
    *(Case("cu", velocities, "fine", diameter=size, alpha=ALPHA) for size, velocities in ((5.0, (640, 610)), (40.0, (580, 549)))),
    Case("ni", (731, 698, 665), "fine", diameter=5.0, alpha=ALPHA),
    Case("ni", (798, 764, 731, 698, 665), "fine", diameter=40.0, alpha=ALPHA),
    Case("ni_rate", (764, 731), "fine", alpha=ALPHA), Case("ni_rate", (798, 764), "fine", diameter=5.0, alpha=ALPHA),
    Case("ni_rate", (731, 698), "fine", diameter=40.0, alpha=ALPHA),
)  # fmt: skip
# name of the workflow, preset, velocities in m/s: PLACEMENTS of each (`coupler.studies.critical.at_velocity`)
PLACED_CASES = (
    ("ni", "standard", (665, 598, 565, 532)), ("cu", "standard", (610, 580, 549, 488)), ("ni", "draft", (665, 831)),
    ("cu", "draft", (610, 488)),
)  # fmt: skip
PLACEMENTS = 3
PLACED = (
    "metal", "diameter_um", "preset", "velocity_m_s", "placement", "verdict", "restitution", "margin_J_m2", "torn_J_m2",
)  # fmt: skip
# Hassani-Gangaraj, Veysset, Nelson & Schuh, arXiv 1612.08081, fig. 1c, digitised: +-10 m/s, +-0.003
MEASURED = {
    "ni": ((251, 0.129), (310, 0.101), (415, 0.086), (473, 0.098), (512, 0.076), (563, 0.068), (584, 0.045), (614, 0.021),
           (649, 0.020)),
    "cu": ((129, 0.134), (220, 0.090), (315, 0.112), (385, 0.091), (459, 0.065), (489, 0.052), (530, 0.037)),
}  # fmt: skip
MEASURED["ni_rate"] = MEASURED["ni"]
# m/s, of particles of a diameter (um) at 300 K, the same source
MEASURED_CRITICAL = {("Ni", 10.0): 660.0, ("OFHC_Cu", 14.0): 568.0}


def data_of(name: str) -> dict[str, Any]:
    """workflows/critical_NAME.toml."""
    return tomllib.loads((ROOT / "workflows" / f"critical_{name}.toml").read_text())


def row_of(case: Case, velocity: float, runs: Path) -> dict[str, object]:
    """One run: energies over all the area that bonded."""
    scene = case.scene
    folder = runs / scene.name
    rows_at(scene, velocity, folder)
    s = Result(folder / f"{velocity:.6g}ms").values
    area, section = s["bonded_area_m2"], 0.25 * math.pi * scene.particle.diameter**2
    torn = s["energies"]["bond"] * s["kinetic_energy_0_J"]
    upwards = s["velocity_z_m_s"]
    rebound = None if upwards is None else 0.5 * s["particle_mass_kg"] * max(upwards, 0.0) ** 2
    v, e = np.array(MEASURED[case.name]).T
    is_measured = case.size == METALS[case.name][1] and case.temperature == 300.0 and v.min() <= velocity <= v.max()
    values = (
        *case.key(velocity), s["verdict_by_bonds"], "" if s["restitution"] is None else round(s["restitution"], 4),
        round(float(np.interp(velocity, v, e)), 3) if is_measured else "", round(area / section, 3),
        *(round(energy / area, 1) if area and energy is not None else "" for energy in (s["bond_energy_J"], torn, rebound)),
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def placed_rows(name: str, preset: str, velocity: float, runs: Path) -> list[dict[str, object]]:
    """Runs of several placements: margin and energy that bonds have dissipated, over the section of the particle; no margin of a run
    without a verdict."""
    metal, size = METALS[name]
    scene = Case(name, (), preset).scene
    folder, section = runs / scene.name, 0.25 * math.pi * scene.particle.diameter**2
    rows = []
    for k, row in enumerate(rows_at(scene, velocity, folder, PLACEMENTS)):
        result = Result(folder / point_name(velocity, k))
        energies = (None if e is None else e / section for e in (result.values["margin_J"], result.history("bond")[-1]))
        values = metal, size, preset, velocity, k, row["verdict_by_bonds"], row["restitution"], *energies
        rows.append(dict(zip(PLACED, values, strict=True)))
    return rows


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


def critical_part(lines: list[dict[str, object]], rows: list[Row]) -> list[str]:
    """Critical velocities at `fine` by size: without and with gradients of plastic strain, and with a rate."""

    def words(r: dict[str, object]) -> str:
        low, high = r["rebounds_to_m_s"], r["sticks_from_m_s"]
        if low and high:
            middle, half = (low + high) / 2, (high - low) / 2  # type: ignore[operator]
            return f"{int(middle + 0.5)} ± {int(half + 0.5)}"
        return f"above {low:g}" if low else f"below {high:g}"

    fine = [r for r in lines if r["preset"] == "fine"]
    usual = {metal: data_of(name)["materials"][metal]["strength"] for name, metal in (("ni", "Ni"), ("cu", "OFHC_Cu"))}
    with_, words_of = f"{ALPHA:g}", ("without gradients", "with gradients", "with gradients and a rate")
    columns = dict(zip(words_of, (("0", True), (with_, True), (with_, False)), strict=True))
    table = []
    for metal, size in sorted({(str(r["metal"]), float(str(r["diameter_um"]))) for r in fine}):
        own = [r for r in fine if (r["metal"], float(str(r["diameter_um"]))) == (metal, size)]
        found = {(r["taylor_alpha"], r["strength"] == usual[metal]): words(r) for r in own}
        measured = f"{MEASURED_CRITICAL[metal, size]:g}" if (metal, size) in MEASURED_CRITICAL else "-"
        table.append([f"{metal} {size:g} µm", *(found.get(key, "-") for key in columns.values()), measured])
    return markdown(["critical velocity, m/s", *columns, "measured"], table, rows)


def draw(rows: list[Row]) -> None:
    """Restitution over velocity beside the measured one, a panel for each metal; verdicts of the workflow's own scene."""
    figure = blank(9.6, 4.0, 110)
    for left, (name, title) in zip((0.07, 0.57), (("ni", "nickel, 10 µm"), ("cu", "copper, 14 µm")), strict=True):
        axes = figure.add_axes((left, 0.13, 0.42, 0.78))
        v, e = np.array(MEASURED[name]).T
        axes.plot(v, e, "o", mfc="none", color="k", ms=5, label="measured")
        critical = MEASURED_CRITICAL[METALS[name]]
        axes.axvline(critical, color="k", ls="--", lw=1, label="measured critical velocity")
        for alpha, colour, mark in ((ALPHA, "#0072b2", "s-"), (0.0, "#d55e00", "^:")):
            case, words = Case(name, (), "fine", alpha=alpha), "gradients harden" if alpha else "no gradients"
            own = [row for row in rows if tuple(row[k] for k in KEY[:-1]) == case.key(0.0)[:-1]]
            points = sorted((number(r, "velocity_m_s"), float(r["restitution"])) for r in own if r["restitution"])
            axes.plot(*np.array(points).T, mark, color=colour, ms=5, lw=1, label=f"computed, {words}")
            found = bracket({number(row, "velocity_m_s"): row["verdict"] for row in own})
            if found.low is not None and found.high is not None:
                label = f"computed critical velocity, {words}"
                axes.axvspan(found.low, found.high, color=colour, alpha=0.2, lw=0, label=label)
        axes.set(title=title, xlabel="velocity of impact (m/s)", ylim=(-0.003, None))
        axes.set_ylabel("coefficient of restitution" if name == "ni" else "")
        if name == "cu":
            axes.legend(fontsize=7, loc="upper right")
    save(figure, EVIDENCE / "critical.png")


def main() -> None:
    """Run what is missing and tabulate."""
    a = options(__doc__ or "", "docs", runs="runs/bonding_energy")
    table = study_table("bonding_energy", COLUMNS, KEY, "python workflows/bonding_energy.py")
    for case in CASES if not a.docs else ():
        for velocity in case.velocities:
            if case.key(velocity) not in table:
                print(table.add(row_of(case, velocity, Path(a.runs))), flush=True)
    scatter = study_table("bonding_scatter", PLACED, PLACED[:5], "python workflows/bonding_energy.py")
    placed = [(name, preset, v) for name, preset, velocities in PLACED_CASES for v in velocities if not a.docs]
    for name, preset, velocity in placed:
        first = METALS[name][0], f"{METALS[name][1]:.6g}", preset, str(velocity)
        if not all((*first, str(k)) in scatter for k in range(PLACEMENTS)):
            for row in placed_rows(name, preset, velocity, Path(a.runs)):
                scatter.add(row)
    lines = criticals(table.rows)
    draw(table.rows)
    about = (
        "remake: python workflows/bonding_energy.py\nfilm: factor on the strength of the oxide film (docs/theory/bonds.md)\n"
        "strength: strength set of the metal; taylor_alpha: of its hardening by gradients of plastic strain, 0 for none"
    )
    write_table(TABLES / "critical_velocity.csv", lines, about)
    write_parts("bonding", {"critical": critical_part(lines, table.rows)})


if __name__ == "__main__":
    main()
