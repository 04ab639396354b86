"""Coatings whose deposition stress and flattening others have measured: python workflows/coating_stress.py

Measured values, readings, strength sets and tests are in measurements.toml. Coatings of aluminium ([deposition_stress]) have the scene
coatings_al.toml and rows in docs/tables/coating_al.csv, those of iron, nickel and aluminium on magnesium ([coatings]) in coatings.csv.
Rows in the tables are not computed again; --docs runs nothing and writes figure and tables of the page.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pages import computed, drawing, impact_tables, markdown, options, scene_file, spacing_of, with_error, write_parts
from study_table import Row, column, measurements, number, study

from coupler import Scene
from coupler.geometry.tetrahedra import volumes
from coupler.physics.materials import entry
from coupler.studies import coating
from coupler.studies.splats import Splats

MEASURED = measurements("deposition_stress")
COATED = {name: value for name, value in measurements("coatings").items() if isinstance(value, dict)}
KEY = ("metal", "velocity_m_s", "strength", "seed", "test")


def scene_of(metal: str, velocity: str, strength: str, seed: str, test: str) -> Scene:
    """The scene of a key: coatings_al.toml with its changes."""
    um, gas, kPa, temperature = next(row[:4] for row in MEASURED[metal] if f"{row[4]}" == velocity)
    nozzle, standoff = MEASURED["nozzles"][f"{kPa}"]
    scene = scene_file(
        "coatings_al",
        coating={"material": metal, "radius": f"{1.5 * um} um", "diameter": f"{um} um", "seed": int(seed)},
        gas={
            "kind": gas, "nozzle": nozzle, "pressure": f"{kPa / 100} bar", "temperature": f"{temperature} degC",
            "standoff": f"{standoff} mm",
        },
        substrate={"diameter": f"{9 * um} um", "height": f"{3 * um} um"},
        resolution={"spacing": f"{spacing_of(1000, um):.4g} um"},
        materials={metal: {"strength": strength}},
    )  # fmt: skip
    return scene.with_(**(MEASURED["tests"] | MEASURED["hot"]).get(test, {}))


def keys() -> Iterator[tuple[str, ...]]:
    """The five coatings with two seeds, the other strength sets, the tests on the first coating and at 805 m/s, the other seeds."""
    sets, seeds = MEASURED["strength"], [str(seed) for seed in MEASURED["seeds"]]
    rows = [(metal, f"{row[4]}") for metal in sets for row in MEASURED[metal]]
    yield from ((*row, sets[row[0]][0], seed, "") for seed in seeds[:2] for row in rows)
    yield from ((*row, name, seeds[0], "") for row in reversed(rows) for name in sets[row[0]][1:])
    yield from ((*rows[0], sets[rows[0][0]][0], seeds[0], test) for test in MEASURED["tests"])
    yield from (("Al1100", "805", sets["Al1100"][0], seeds[0], test) for test in MEASURED["hot"])
    yield from ((*row, sets[row[0]][0], seed, "") for seed in seeds[2:] for row in rows)


def row_of(*key: str) -> dict[str, object]:
    """The coating of a key as a row of the table."""
    scene = scene_of(*key)
    particle = scene.particles[0]
    with computed(scene, skip_failed=True) as (result, cpu):
        drift = max(abs(impact["energy_drift"]) for impact in result.summary["impacts"])
        splats = coating.read(result)
        all_ = coating.measure(splats)
    inner = buried(splats)
    # the last layer is left out: no later impact has struck it
    layers = [layer for layer in all_.layers if 0 < layer["layer"] < splats.layers]
    eps_p = np.average([layer["eps_p_mean"] for layer in layers], weights=[layer["volume_m3"] for layer in layers])
    return {
        "impact_m_s": particle.velocity, "impact_K": particle.temperature,
        "stress_MPa": coating.in_plane(inner, all_.disc_radius_m, "stress")[0] * 1e-6,
        "stress_all_MPa": all_.stress_in_plane_Pa * 1e-6, "thermal_all_MPa": all_.thermal_in_plane_Pa * 1e-6,
        "density": 100.0 * (1.0 - all_.porosity_open - all_.porosity_closed), "overlap_share": 100.0 * all_.overlap_share,
        "strain": flattening_strains(inner, all_.disc_radius_m).mean(), "eps_p": float(eps_p),
        "thickness_um": all_.thickness_mean_m * 1e6, "drift": drift, "cpu_s": cpu,
    }  # fmt: skip


def buried(splats: Splats) -> Splats:
    """The coating without the splats of its last layer, which nothing has struck."""
    last = splats.planned - splats.planned // splats.layers
    return replace(splats, body=np.where(splats.impact[splats.body] > last, 0, splats.body))


def flattening_strains(splats: Splats, radius: float) -> NDArray[np.float64]:
    """2/3 ln(width / height) (k,) of the splats whose middle lies within radius (m), as ellipsoids of the same second moments."""
    corners, found = splats.mesh.points[splats.mesh.cells], []
    volume = np.abs(volumes(splats.mesh.points, splats.mesh.cells))[:, None]
    for body in np.unique(splats.body[splats.body > 0]):
        x, v = corners[splats.body == body], volume[splats.body == body]
        middle = (v * x.mean(axis=1)).sum(axis=0) / v.sum()
        away = x - middle
        xx, yy, zz = (v * ((away**2).sum(axis=1) + away.sum(axis=1) ** 2)).sum(axis=0)  # of linear tetrahedra, times 20
        if math.hypot(*middle[:2]) <= radius:
            found.append(math.log(0.5 * (xx + yy) / zz) / 3.0)
    return np.array(found)


class Comparison(NamedTuple):
    """A measured coating, its row of measurements.toml, and its computed rows: with the first strength set, and with others."""

    name: str
    metal: str
    measured: Sequence[Any]
    rows: list[Row]
    others: list[Row]


def comparisons(rows: Sequence[Row]) -> Iterator[Comparison]:
    """One for each measured coating that is computed."""
    for metal, sets in MEASURED["strength"].items():
        for measured in MEASURED[metal]:
            key = metal, f"{measured[4]}", "", ""
            own = [r for r in rows if (r["metal"], r["velocity_m_s"], r["test"], r["failed"]) == key]
            usual, others = ([r for r in own if (r["strength"] == sets[0]) == first] for first in (True, False))
            if usual:
                yield Comparison(f"{metal}, {measured[4]} m/s", metal, measured, usual, others)


def error_of(values: NDArray[np.float64]) -> float:
    """Standard error of the mean over seeds; nan for a single seed."""
    return float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else math.nan


def lines(rows: Sequence[Row]) -> list[str]:
    """The table of the coatings, and the tests."""

    def told(rows: Sequence[Row], name: str, digits: int) -> str:
        values = column(rows, name)
        return with_error(values.mean(), error_of(values), digits)

    table = []
    for c in comparisons(rows):
        density, d_density, strain, d_strain, stress, d_stress = c.measured[5:11]
        table.append([
            c.name, f"{float(c.rows[0]['impact_m_s']):.0f}, {float(c.rows[0]['impact_K']):.0f}",
            f"{stress} ± {d_stress}", told(c.rows, "stress_MPa", 0),
            ", ".join(f"{float(r['stress_MPa']):.0f}" for r in c.others) or "-",
            f"{strain} ± {d_strain}", told(c.rows, "strain", 2),
            f"{density} ± {d_density}", told(c.rows, "density", 1),
        ])  # fmt: skip
    head = "coating | m/s, K | stress (MPa) | computed | other | strain | computed | density (%) | computed"
    tested = ((f"{r['velocity_m_s']} m/s, {r['test']}", r) for r in rows if r["test"] and not r["failed"])
    tests = [f"{test} {float(r['stress_MPa']):.0f} MPa" for test, r in tested]
    return [*markdown(head, table, rows), *(["", f"Tests: {'; '.join(tests)}."] if tests else [])]


def draw(rows: Sequence[Row]) -> None:
    """Draw computed against measured values: stress, with the other strength sets as crosses, and density."""
    places = {"stress_MPa": (0.09, "deposition stress (MPa)", 9), "density": (0.59, "density (%)", 5)}
    with drawing("coating_al", 8.0, 3.8) as figure:
        for key, (left, title, k) in places.items():
            axes = figure.add_axes((left, 0.14, 0.38, 0.77))
            for n, c in enumerate(comparisons(rows)):
                (x, dx), y, other, colour = c.measured[k : k + 2], column(c.rows, key), column(c.others, key), f"C{n}"
                axes.errorbar(x, y.mean(), np.nan_to_num(error_of(y)), dx, "o", capsize=3, color=colour, label=c.name)
                axes.plot(np.full(len(other), x), other, "x", color=colour)
            low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
            axes.plot([low.min(), high.max()], [low.min(), high.max()], "k--", lw=1)
            axes.set(title=title, xlabel="measured", ylabel="computed")
        axes.legend(fontsize=7)


def coating_scene(metal: str, test: str) -> Scene:
    """The scene of a coating of measurements.toml, with the changes of a test."""
    said = {"strength": next(iter(entry(metal).sets))} | COATED[metal]
    D, size = said["diameter_um"], said["scene"]
    tables = impact_tables(metal, D, said["velocity_m_s"], said["base"], (9 * D, size["height"] * D))
    of_coating = {
        "number": size["number"], "layers": size["layers"], "radius": f"{size['patch'] * D:g} um", "positions": "even",
        "temperature": f"{said['temperature_K']} K", "dwell": "1 ms",
    }  # fmt: skip
    scene = {
        "preset": "draft", "end": {"at": "cold"}, "output": {"at": "ends"}, "adhesion": {"kind": "tied", "criterion": "all"},
        "coating": tables.pop("particle") | of_coating, **tables, "materials": {metal: {"strength": said["strength"]}},
        "resolution": {"spacing": f"{spacing_of(1000, D):.4g} um"},
    }  # fmt: skip
    return Scene.from_dict(scene, "coating").with_(**said["tests"].get(test, {}))


def coating_row(metal: str, test: str) -> dict[str, object]:
    """The row of a coating: flattening of its splats, and stress in the substrate at the depths of measurements.toml."""
    with computed(coating_scene(metal, test), skip_failed=True) as (result, cpu):
        splats, drift = coating.read(result), max(abs(i["energy_drift"]) for i in result.summary["impacts"])
        radius = coating.disc_radius(splats)
    strain = flattening_strains(buried(splats), radius)
    row: dict[str, object] = {"splats": len(strain), "drift": drift, "cpu_s": cpu}
    for name, values in {"flattening": 1.0 - np.exp(-strain), "height_over_width": np.exp(-1.5 * strain)}.items():
        row |= {name: values.mean(), f"{name}_error": error_of(values)}
    z = splats.mesh.points[splats.mesh.cells].mean(axis=1)[:, 2] * 1e6
    for name, (top, bottom) in COATED[metal].get("stress_um", {}).items():
        slice_ = replace(splats, body=((splats.body == 0) & (z < -top) & (z >= -bottom)).astype(np.int64))
        mean, error = coating.in_plane(slice_, radius, "stress")
        row |= {f"{name}_MPa": mean * 1e-6, f"{name}_error": math.nan if error is None else error * 1e-6}
    return row


def coating_pairs(row: Row) -> Iterator[tuple[str, str, Sequence[float], Sequence[float], int]]:
    """What is measured of a coating: quantity, case, measured value and error, computed value and error, digits after the point."""
    metal, said = row["metal"], COATED[row["metal"]]
    values = [
        ("flattening", f"{metal} in a coating, (d₀ - h) / d₀", said.get("flattening"), "flattening", 2),
        ("flattening", f"{metal} in a coating, h / w", said.get("flattening"), "height_over_width", 2),
    ]
    for place, measured in said.get("stress_MPa", {}).items():
        what = f"{said['base']} below {metal}, {place.replace('um', 'µm')}"
        values.append(("stress, MPa", what, measured, f"{place}_MPa", 0))
    for quantity, what, measured, key, digits in values:
        if measured:
            error = number(row, f"{key.removesuffix('_MPa')}_error")
            yield quantity, what, measured, (number(row, key), error), digits


def coating_part(rows: Sequence[Row]) -> list[str]:
    """Flattening in coatings, by both readings, and stress below one, measured and computed; what each test gives."""
    lines, tests = [], []
    for row in (row for row in rows if not row["failed"]):
        for quantity, what, measured, ours, digits in coating_pairs(row):
            if row["test"] and not what.endswith("h / w"):
                short = what.replace(" in a coating, (d₀ - h) / d₀", "")
                tests.append(f"{short}, {row['test']} {with_error(*ours, digits)}")
            elif not row["test"]:
                lines.append([quantity, what, with_error(*measured, digits), with_error(*ours, digits)])
    told = f"Tests, (d₀ - h) / d₀ and MPa: {'; '.join(tests)}."
    return [*markdown("quantity | case | measured | computed", lines, rows), "", told]


if __name__ == "__main__":
    docs = options(__doc__, "docs").docs
    tests = [(metal, test) for metal, said in COATED.items() for test in said["tests"]]
    coatings = [*((metal, "") for metal in COATED), *tests]
    table = study("coating_al", KEY, () if docs else keys(), row_of, may_fail=True)
    others = study("coatings", ("metal", "test"), () if docs else coatings, coating_row, may_fail=True)
    draw(table.rows)
    write_parts("coating_stress", {"aluminium": lines(table.rows), "coatings": coating_part(others.rows)})
