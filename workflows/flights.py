"""Velocity, temperature and deposition efficiency of published sprays by our gas and flight: python workflows/flights.py (seconds)

The published values, the readings and what is assumed of the nozzles are in measurements.toml and laboratory_nozzles.toml. Writes
docs/tables/flights.csv and its part of the page on the gas.
"""

import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pages import TABLES, markdown, measurements, write_parts, write_table

from coupler import __version__
from coupler.measures import STICKS
from coupler.physics.adhesion import pair_formula
from coupler.physics.materials import material
from coupler.spray.flight import fly_together
from coupler.spray.gas import GASES, Flow
from coupler.spray.nozzles import Nozzle, from_tables
from coupler.spray.sizes import Sizes
from coupler.spray.window import Spray, spray

HERE = Path(__file__).parent
MEASURED = measurements("flights")
BAND = 0.2  # of the critical velocity
ATMOSPHERE, ZERO = 1.01325e5, 273.15


def nozzles() -> dict[str, Nozzle]:
    """The nozzles of the sources."""
    found, problems = from_tables(tomllib.loads((HERE / "laboratory_nozzles.toml").read_text())["nozzles"])
    assert not problems
    return found


def arrived(run: Mapping[str, Any], row: Sequence[Any], nozzle: Nozzle) -> Spray:
    """The powder of a row at the target."""
    gas, bar, T_gas, T_powder = row[:4]
    flow = Flow(GASES[gas], nozzle, bar * 1e5, T_gas + ZERO, run["standoff_mm"] * 1e-3, ATMOSPHERE)
    metal = material(run["metal"])
    sizes = Sizes.of_quantiles(*(size * 1e-6 for size in run["sizes_um"]))
    return spray(metal, None, sizes, lambda D: fly_together(flow, metal, D, T_powder + ZERO))


def efficiency(powder: Spray) -> str:
    """Share of the mass that stays, percent, with its range over the band of the critical velocity."""
    share = [100.0 * powder.fates(factor)[STICKS] for factor in (1.0, *powder.extremes(BAND))]
    return f"{share[0]:.0f} ({share[1]:.0f} to {share[2]:.0f})"


def rows() -> list[dict[str, object]]:
    """The rows of the table."""
    found, known = [], nozzles()
    for run in MEASURED["run"]:
        for row in run["rows"]:
            gas, bar, T_gas, T_powder, v, scatter, T, stays = row
            powder = arrived(run, row, known[run["nozzle"]])
            middle = len(powder.velocity) // 2
            velocity, temperature = powder.velocity[middle], powder.temperature[middle] - ZERO
            found.append({
                "source": run["source"], "metal": run["metal"], "median_um": run["sizes_um"][1],
                "gas": f"{gas} {bar / 10:g} MPa {T_gas:g} °C", "powder_C": T_powder, "by": run["by"],
                "published_m_s": v, "published_scatter": scatter or "", "computed_m_s": f"{velocity:.0f}",
                "published_C": "" if math.isnan(T) else T, "computed_C": f"{temperature:.0f}",
                "published_percent": stays, "computed_percent": efficiency(powder),
            })  # fmt: skip
    return found


def part(table: Sequence[Mapping[str, object]]) -> list[str]:
    """The table of the page."""
    lines = [
        [
            f"{r['metal']} {r['median_um']} µm", r["gas"] + (f", powder {r['powder_C']} °C" if r["powder_C"] != 20 else ""),
            f"{r['published_m_s']}" + (f" ± {r['published_scatter']}" if r["published_scatter"] else "") + f" ({r['by']})",
            r["computed_m_s"], r["published_C"] or "-", r["computed_C"], r["published_percent"] or "-", r["computed_percent"],
        ]
        for r in table
    ]  # fmt: skip
    head = "powder | gas | m/s, published | computed | °C, published | computed | stays %, measured | computed"
    critical = []
    for run in MEASURED["critical"]:
        metal = material(run["metal"])
        ours = ", ".join(
            f"{v} / {pair_formula(metal, None, T + ZERO, run['diameter_um'] * 1e-6).critical:.0f} m/s at {T} °C"
            for T, v in run["rows"]
        )
        critical.append(f"- {run['metal']}, {run['diameter_um']} µm, {run['source']}: {ours}.")
    told = ["Critical velocities, published / by Schmidt's formula:", "", *critical]
    return [*markdown(head, lines), "", f"Computed with version {__version__}.", "", *told]


def main() -> None:
    """Compute, print, write."""
    table = rows()
    for r in table:
        print(*r.values(), sep=", ")
    write_table(TABLES / "flights.csv", table, "remake: python workflows/flights.py")
    write_parts("gas", {"flights": part(table)})


if __name__ == "__main__":
    main()
