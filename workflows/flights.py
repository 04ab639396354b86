"""Velocity, temperature and deposition efficiency of published sprays, by the models of gas and flight: python workflows/flights.py

The published values, the readings and the assumptions about the nozzles are in measurements.toml and laboratory_nozzles.toml. Writes
docs/tables/flights.csv and its part of the page on the gas.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import groupby

from pages import markdown, write_parts
from study_table import measurements, write_table

from coupler import __version__
from coupler.measures import STICKS
from coupler.physics.adhesion import pair_formula
from coupler.physics.materials import material
from coupler.spray.flight import fly_together
from coupler.spray.gas import GASES, Flow
from coupler.spray.nozzles import Nozzle, from_tables
from coupler.spray.sizes import Sizes
from coupler.spray.window import spray

MEASURED = measurements("flights")
BAND = 0.2  # of the critical velocity
ATMOSPHERE, ZERO = 1.01325e5, 273.15


def nozzles() -> dict[str, Nozzle]:
    """The nozzles of the sources."""
    found, problems = from_tables(measurements("nozzles", "laboratory_nozzles"))
    assert not problems
    return found


def critical(name: str, diameter: float, temperature: float) -> float:
    """Critical velocity, m/s, of Schmidt's formula on the same metal. diameter: um; temperature: C."""
    return pair_formula(material(name), None, temperature + ZERO, diameter * 1e-6).critical


def rows() -> list[dict[str, object]]:
    """The rows of the table."""
    found, known = [], nozzles()
    for run in MEASURED["run"]:
        metal, sizes = material(run["metal"]), Sizes.of_diameters(*(size * 1e-6 for size in run["sizes_um"]))
        for gas, bar, T_gas, T_powder, v, scatter, T, stays in run["rows"]:
            nozzle, standoff = known[run["nozzle"]], run["standoff_mm"] * 1e-3
            flow = Flow(GASES[gas], nozzle, bar * 1e5, T_gas + ZERO, standoff, ATMOSPHERE)
            powder = spray(metal, None, sizes, partial(fly_together, flow, metal, T_feed=T_powder + ZERO))
            # that stays, percent, by the formula and over the band of the critical velocity
            share = [f"{100.0 * powder.fates(factor)[STICKS]:.0f}" for factor in (1.0, *powder.extremes(BAND))]
            middle = len(powder.velocity) // 2
            velocity, temperature = powder.velocity[middle], powder.temperature[middle] - ZERO
            over = [u / critical(run["metal"], run["sizes_um"][1], t) for u, t in ((v, T), (velocity, temperature))]
            found.append({
                "source": run["source"], "metal": run["metal"], "median_um": run["sizes_um"][1],
                "gas": f"{gas} {bar / 10:g} MPa {T_gas:g} °C", "powder_C": T_powder, "by": run["by"],
                "published_m_s": v, "published_scatter": scatter or "", "computed_m_s": f"{velocity:.0f}",
                "published_C": "" if math.isnan(T) else T, "computed_C": f"{temperature:.0f}",
                "published_percent": stays, "computed_percent": f"{share[0]} ({share[1]} to {share[2]})",
                "published_over_critical": "" if math.isnan(T) else f"{over[0]:.2f}", "computed_over_critical": f"{over[1]:.2f}",
            })  # fmt: skip
    return found


def span(rows: Sequence[Mapping[str, object]], name: str) -> str:
    """The values of a column, from the least to the greatest; "-" where there is none."""
    values = sorted((str(r[name]) for r in rows if r[name] != ""), key=float)
    return " to ".join(dict.fromkeys((values[0], values[-1]))) if values else "-"


def part(table: Sequence[Mapping[str, object]]) -> list[str]:
    """The table of the page; sprays of one powder whose efficiency is not measured share a line."""
    lines = []
    alike = [(r["source"], r["metal"], r["published_percent"] and r["gas"], r["powder_C"]) for r in table]
    for _, group in groupby(zip(table, alike, strict=True), lambda pair: pair[1]):
        rows = [row for row, _ in group]
        r, temperatures = rows[0], [{"T": row["gas"].split()[-2]} for row in rows]
        lines.append([
            f"{r['metal']} {r['median_um']} µm",
            f"{r['gas'].rsplit(' ', 2)[0]} {span(temperatures, 'T')} °C"
            + (f", powder {r['powder_C']} °C" if r["powder_C"] != 20 else ""),
            span(rows, "published_m_s") + (f" ± {r['published_scatter']}" if r["published_scatter"] else "")
            + (" (laser)" if r["by"] == "laser" else ""),
            *(span(rows, name) for name in ("computed_m_s", "published_C", "computed_C")),
            f"{span(rows, 'published_over_critical')} / {span(rows, 'computed_over_critical')}",
            f"{r['published_percent']} / {r['computed_percent']}" if r["published_percent"] else "-",
        ])  # fmt: skip
    head = "powder | gas | m/s, published | computed | °C, published | computed | over critical | stays %"
    sources = []
    for run in MEASURED["critical"]:
        ours = ", ".join(f"{v} / {critical(run['metal'], run['diameter_um'], T):.0f} at {T} °C" for T, v in run["rows"])
        sources.append(f"- {run['metal']}, {run['diameter_um']} µm, {run['source']}: {ours}.")
    told = ["Critical velocities (m/s), published / by Schmidt's formula:", "", *sources]
    return [*markdown(head, lines), "", f"Computed with version {__version__}.", "", *told]


if __name__ == "__main__":
    table = rows()
    for r in table:
        print(*r.values(), sep=", ")
    write_table("flights", table)
    write_parts("gas", {"flights": part(table)})
