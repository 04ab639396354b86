"""Coatings of aluminium whose deposition stress others have measured: python workflows/coatings_al.py   # --jobs 2: two at a time

Measured values, readings, strength sets and tests are in measurements.toml, [deposition_stress], the scene is coatings_al.toml. Each
coating is a row of docs/tables/coating_al.csv that is not computed again; --docs runs nothing and writes figure and table of the page.
"""

import math
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pages import EVIDENCE, ROOT, column, computed, failed, markdown, options, spacing_of, study_table, write_parts

from coupler import Scene
from coupler.errors import ColdsprayError
from coupler.geometry.tetrahedra import volumes
from coupler.physics.materials import material
from coupler.report.picture import blank, save
from coupler.studies import coating
from coupler.studies.table import Row

MEASURED = tomllib.loads((Path(__file__).parent / "measurements.toml").read_text())["deposition_stress"]
KEY = ("metal", "velocity_m_s", "strength", "seed", "test")
COLUMNS = (
    *KEY, "impact_m_s", "impact_K", "stress_MPa", "stress_all_MPa", "thermal_all_MPa", "density", "overlap_share", "strain", "eps_p",
    "thickness_um", "drift", "cpu_s", "failed",
)  # fmt: skip


class Case(NamedTuple):
    """One coating: the key of its row, and the measured row that it belongs to."""

    metal: str
    velocity: str  # m/s, of the source
    strength: str
    seed: str
    test: str
    row: Sequence[Any]

    @property
    def settings(self) -> list[tuple[str, str]]:
        """What its scene changes of coatings_al.toml."""
        um, gas, kPa, temperature = self.row[:4]
        nozzle, standoff = MEASURED["nozzles"][f"{kPa}"]
        texts = {"coating.material": self.metal, "gas.kind": gas, "gas.nozzle": nozzle} | {
            "coating.radius": f"{1.5 * um} um", "coating.diameter": f"{um} um", "gas.pressure": f"{kPa / 100} bar",
            "gas.temperature": f"{temperature} degC", "gas.standoff": f"{standoff} mm", "substrate.diameter": f"{9 * um} um",
            "substrate.height": f"{3 * um} um", "resolution.spacing": f"{spacing_of(1000, um):.4g} um",
            f"materials.{self.metal}.strength": self.strength,
        }  # fmt: skip
        return [("coating.seed", self.seed), *((key, f"'{value}'") for key, value in texts.items())]


def cases() -> Iterator[Case]:
    """The five coatings with two seeds, then the other strength sets, the tests on the first coating, and the other seeds."""
    rows = [(metal, row) for metal in MEASURED["strength"] for row in MEASURED[metal]]
    first, second, *seeds = map(str, MEASURED["seeds"])

    def usual(seed: str, test: str = "", count: int = len(rows)) -> Iterator[Case]:
        for metal, row in rows[:count]:
            yield Case(metal, f"{row[4]}", MEASURED["strength"][metal][0], seed, test, row)

    yield from (*usual(first), *usual(second))
    for metal, row in reversed(rows):
        yield from (Case(metal, f"{row[4]}", name, first, "", row) for name in MEASURED["strength"][metal][1:])
    yield from (case for test in MEASURED["tests"] for case in usual(first, test, 1))
    yield from (case for seed in seeds for case in usual(seed))


def row_of(case: Case) -> dict[str, object]:
    """The coating of a case as a row of the table."""
    row: dict[str, object] = dict(zip(KEY, case[:-1], strict=True))
    settings = [*case.settings, *MEASURED["tests"].get(case.test, {}).items()]
    try:
        scene = Scene.load(ROOT / "workflows" / "coatings_al.toml", settings)
        with computed(scene, skip_failed=True) as (result, cpu):
            splats, impacts = coating.read(result), result.summary["impacts"]
            at_once = scene.particles[0]
            return row | values_of(splats) | {
                "impact_m_s": at_once.velocity, "impact_K": at_once.temperature, "cpu_s": cpu, "failed": "",
                "drift": max(abs(impact["energy_drift"]) for impact in impacts),
            }  # fmt: skip
    except ColdsprayError as problem:
        return row | failed(problem)


def values_of(splats: coating.Splats) -> dict[str, float]:
    """The measures of a cold coating; its last layer is that of the last impacts."""
    buried = splats.planned - splats.planned // splats.layers
    inner = replace(splats, body=np.where(splats.impact[splats.body] > buried, 0, splats.body))
    all_ = coating.measure(splats)
    stress, _ = coating.in_plane(inner, all_.window_radius_m, "stress")
    strain = flattening_strain(inner, all_.window_radius_m)
    strained = [layer for layer in all_.layers if 0 < layer["layer"] < splats.layers]
    return {
        "stress_MPa": stress * 1e-6, "stress_all_MPa": all_.stress_in_plane_Pa * 1e-6,
        "thermal_all_MPa": all_.thermal_in_plane_Pa * 1e-6,
        "density": 100.0 * (1.0 - all_.porosity_open - all_.porosity_closed), "overlap_share": 100.0 * all_.overlap_share,
        "strain": strain, "thickness_um": all_.thickness_mean_m * 1e6,
        "eps_p": float(np.average([layer["eps_p_mean"] for layer in strained], weights=[layer["volume_m3"] for layer in strained])),
    }  # fmt: skip


def flattening_strain(splats: coating.Splats, radius: float) -> float:
    """Mean of 2/3 ln(width / height) of the splats whose middle lies within radius (m), as ellipsoids of the same second moments."""
    x, volume = splats.mesh.points[splats.mesh.cells], np.abs(volumes(splats.mesh.points, splats.mesh.cells))
    found = []
    for body in np.unique(splats.body[splats.body > 0]):
        own, v = x[splats.body == body], volume[splats.body == body, None]
        middle = (v * own.mean(axis=1)).sum(axis=0) / v.sum()
        away = own - middle
        xx, yy, zz = (v * ((away**2).sum(axis=1) + away.sum(axis=1) ** 2)).sum(axis=0)  # of linear tetrahedra, times 20
        if math.hypot(*middle[:2]) <= radius:
            found.append(math.log(0.5 * (xx + yy) / zz) / 3.0)
    return float(np.mean(found))


class Comparison(NamedTuple):
    """A measured coating beside the computed ones. measured: its row of measurements.toml; stress MPa, density %, strain, eps_p: values
    (seeds,) with the first strength set; sets: stress with the others, by name; impact: velocity m/s and temperature K."""

    name: str
    measured: Sequence[Any]
    stress: NDArray[np.float64]
    density: NDArray[np.float64]
    strain: NDArray[np.float64]
    eps_p: NDArray[np.float64]
    sets: dict[str, float]
    impact: tuple[float, float]


def error_of(values: NDArray[np.float64]) -> float:
    """Standard error of the mean of seeds; nan of one."""
    return float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else math.nan


def comparisons(rows: Sequence[Row]) -> Iterator[Comparison]:
    """One for each measured coating that is computed."""
    for metal, sets in MEASURED["strength"].items():
        for row in MEASURED[metal]:
            own = [
                r
                for r in rows
                if (r["metal"], r["velocity_m_s"], r["test"], r["failed"]) == (metal, f"{row[4]}", "", "")
            ]
            usual = [r for r in own if r["strength"] == sets[0]]
            if usual:
                values = (column(usual, key) for key in ("stress_MPa", "density", "strain", "eps_p"))
                others = {r["strength"]: float(r["stress_MPa"]) for r in own if r not in usual}
                impact = float(usual[0]["impact_m_s"]), float(usual[0]["impact_K"])
                yield Comparison(
                    f"{'pure Al' if metal == 'Al1100' else metal}, {row[4]} m/s", row, *values, others, impact
                )


def deposited_at(misfit: float, metal: str) -> float:
    """Temperature (K) from which coating and magnesium cool to 300 K by a misfit strain."""
    T = np.arange(300.0, 900.0)
    rates = [material("AZ31B").thermal_expansion_at(t) - material(metal).thermal_expansion_at(t) for t in T]
    return float(np.interp(-misfit, np.cumsum(rates), T))


def told(values: NDArray[np.float64], digits: int) -> str:
    """Mean and standard error."""
    error = error_of(values)
    return f"{values.mean():.{digits}f}" + ("" if math.isnan(error) else f" ± {error:.{digits}f}")


def lines(rows: Sequence[Row]) -> list[str]:
    """The table of the coatings, and the tests."""
    table, metals = [], {row[4]: metal for metal in MEASURED["strength"] for row in MEASURED[metal]}
    for c in comparisons(rows):
        _, gas, _, degC, v, density, d_density, strain, d_strain, stress, d_stress, misfit, d_misfit = c.measured
        sets = ", ".join(f"{value:.0f}" for value in c.sets.values()) or "-"
        table.append([
            c.name, f"{gas} {degC} °C: {c.impact[0]:.0f} m/s, {c.impact[1]:.0f} K", f"{stress} ± {d_stress}", told(c.stress, 0), sets,
            f"{strain} ± {d_strain}", f"{told(c.strain, 2)} ({c.eps_p.mean():.1f})", f"{density} ± {d_density}", told(c.density, 1),
            f"{misfit} ± {d_misfit}: {deposited_at(misfit * 1e-6, metals[v]):.0f} K",
        ])  # fmt: skip
    head = "coating | at impact | stress (MPa) | computed | other sets | strain | computed (plastic) | density (%) | computed | misfit"
    tests = [f"{r['test']} {float(r['stress_MPa']):.0f} MPa" for r in rows if r["test"] and not r["failed"]]
    found = ["", f"Tests, with the first coating and seed: {', '.join(tests)}."] if tests else []
    return [*markdown(head, table, rows), *found]


def draw(rows: Sequence[Row]) -> None:
    """Computed over measured: stress, with the other strength sets as crosses, and density."""
    figure, found = blank(8.0, 3.8, 110), list(comparisons(rows))
    for left, title, k in ((0.09, "deposition stress (MPa)", 9), (0.59, "density (%)", 5)):
        axes = figure.add_axes((left, 0.14, 0.38, 0.77))
        ends: list[float] = []
        for n, c in enumerate(found):
            values = c.stress if k == 9 else c.density
            x, dx, y, dy = *c.measured[k : k + 2], values.mean(), np.nan_to_num(error_of(values))
            axes.errorbar(x, y, dy, dx, "o", capsize=3, color=f"C{n}", label=c.name)
            others = list(c.sets.values()) if k == 9 else []
            axes.plot([x] * len(others), others, "x", color=f"C{n}")
            ends += [x - dx, x + dx, y - dy, y + dy, *others]
        axes.plot([min(ends), max(ends)], [min(ends), max(ends)], "k--", lw=1)
        axes.set(title=title, xlabel="measured", ylabel="computed" if k == 9 else "")
        if k == 9:
            axes.legend(fontsize=7, loc="upper left")
    save(figure, EVIDENCE / "coating_al.png")


def main() -> None:
    """Run what is missing, draw, write the table of the page."""
    a = options(__doc__, "docs", jobs=1)
    table = study_table("coating_al", COLUMNS, KEY, "python workflows/coatings_al.py")
    missing = [] if a.docs else [case for case in cases() if case[:-1] not in table]
    with ProcessPoolExecutor(a.jobs) as pool:
        for done in as_completed([pool.submit(row_of, case) for case in missing]):
            print(table.add(done.result()), flush=True)
    draw(table.rows)
    write_parts("coating_stress", {"aluminium": lines(table.rows)})


if __name__ == "__main__":
    main()
