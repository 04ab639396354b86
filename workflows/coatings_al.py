"""Coatings of aluminium whose deposition stress and density others have measured: python workflows/coatings_al.py

    python workflows/coatings_al.py --docs    # runs nothing: figure and table of the page

The measurements, readings, ranges and bands are in workflows/measurements.toml. Each coating is a row of docs/tables/coating_al.csv
that is not computed again. Nothing is fitted.
"""

import math
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pages import EVIDENCE, column, computed, failed, markdown, number, options, study_table, write_parts

from coupler import Result, Scene
from coupler.errors import ColdsprayError, SolverError
from coupler.report.picture import blank, save
from coupler.studies import coating
from coupler.studies.table import Row

MEASURED = tomllib.loads((Path(__file__).parent / "measurements.toml").read_text())["deposition_stress"]
COLUMNS = (
    "metal", "velocity_m_s", "diameter_um", "temperature_K", "seed", "points", "number", "layers", "disc", "strength", "stress_MPa",
    "thermal_MPa", "density", "open", "closed", "overlap_share", "thickness_um", "eps_p", "impacts", "skipped", "drift", "cpu_s",
    "failed",
)  # fmt: skip
KEY = COLUMNS[:10]
POINTS, OTHER_POINTS = 1000, (213, 2000)  # of a particle
LADDER_AT = (585, 805)  # m/s
NUMBER, LAYERS = 12, 2
DISC = 0.9  # diameters: radius of the disc that the particles are aimed at
SCENE = """
preset = "draft"
[coating]
material = "{metal}"
number = {number}
layers = {layers}
radius = "{radius:g} um"
positions = "even"
diameter = "{diameter:g} um"
velocity = "{velocity:g} m/s"
temperature = "{temperature:g} K"
seed = {seed}
[substrate]
material = "{metal}"
diameter = "{width:g} um"
height = "{depth:g} um"
[adhesion]
kind = "tied"
criterion = "all"
[resolution]
spacing = "{spacing:.4g} um"
[materials.{metal}]
strength = "{strength}"
"""


@dataclass(frozen=True)
class Case:
    """One coating. velocity m/s, diameter um, temperature K of the particles; points of each; number: of particles, in so many layers
    on a disc of `disc` diameters radius; strength: set of the library, "" for that of the comparison."""

    metal: str
    velocity: float
    diameter: float
    temperature: float
    seed: int
    points: int = POINTS
    number: int = NUMBER
    layers: int = LAYERS
    disc: float = DISC
    strength: str = ""

    @property
    def strength_set(self) -> str:
        """The strength set."""
        return self.strength or MEASURED["strength"][self.metal]

    @property
    def key(self) -> tuple[str, ...]:
        """As in the table."""
        return (
            self.metal, f"{self.velocity:g}", f"{self.diameter:g}", f"{self.temperature:g}", f"{self.seed}", f"{self.points}",
            f"{self.number}", f"{self.layers}", f"{self.disc:g}", self.strength_set,
        )  # fmt: skip

    @property
    def text(self) -> str:
        """The scene: layers on a disc; the substrate is 3.7 diameters wider and 3 high."""
        spacing = self.diameter * (math.pi / 6.0 / self.points) ** (1.0 / 3.0)
        width = (2.0 * self.disc + 3.7) * self.diameter
        size = {"radius": self.disc * self.diameter, "width": width, "depth": 3.0 * self.diameter}
        return SCENE.format(**vars(self) | {"strength": self.strength_set}, **size, spacing=spacing)


def cases() -> Iterator[Case]:
    """The nominal coatings, corners of the ranges, other places of the particles, other strengths of pure aluminium, other numbers of
    points, and one heap as high as wide."""
    rows = [(MEASURED["metals"][name], row[0]) for name in MEASURED["metals"] for row in MEASURED[name]]
    first, *others = MEASURED["seeds"]
    nominal = MEASURED["nominal"]
    states = [(state, first) for state in (nominal, *MEASURED["corners"])] + [(nominal, seed) for seed in others]
    for state, seed in states:
        for metal, velocity in rows:
            yield Case(metal, velocity, state["diameter_um"], state["temperature_K"], seed)
    one = Case(*rows[0], nominal["diameter_um"], nominal["temperature_K"], first)
    for strength in MEASURED["other_strength"]:
        for metal, velocity in rows:
            if metal == one.metal:
                yield replace(one, velocity=velocity, strength=strength)
    for points, velocity in product(OTHER_POINTS, LADDER_AT):
        yield replace(one, points=points, velocity=velocity)
    yield replace(one, points=OTHER_POINTS[0], number=56, layers=4, disc=1.35)


def row_of(case: Case) -> dict[str, object]:
    """The coating of a case as a row of the table."""
    row: dict[str, object] = dict(zip(KEY, case.key, strict=True))
    try:
        with computed(Scene.from_text(case.text, "coating"), skip_failed=True) as (result, cpu):
            if result.undecided is not None:
                raise SolverError(result.undecided)
            return row | values_of(result, case) | {"cpu_s": cpu, "failed": ""}
    except ColdsprayError as problem:
        return row | failed(problem)


def values_of(result: Result, case: Case) -> dict[str, object]:
    """What a finished coating gives to its row."""
    measures = coating.measure(coating.read(result), MEASURED["window"] * case.disc * case.diameter * 1e-6)
    summary = result.summary
    skipped = [text for text in summary["run"]["warnings"] if "was skipped" in text]
    print(*skipped, sep="\n", end="\n" if skipped else "", flush=True)
    strain = [layer for layer in measures.layers if layer["layer"] > 0]
    volume = sum(layer["volume_m3"] for layer in strain)
    return {
        "stress_MPa": measures.stress_in_plane_Pa * 1e-6, "thermal_MPa": measures.thermal_in_plane_Pa * 1e-6,
        "density": 100.0 * (1.0 - measures.porosity_open - measures.porosity_closed),
        "open": 100.0 * measures.porosity_open, "closed": 100.0 * measures.porosity_closed,
        "overlap_share": 100.0 * measures.overlap_share, "thickness_um": measures.thickness_mean_m * 1e6,
        "eps_p": sum(layer["eps_p_mean"] * layer["volume_m3"] for layer in strain) / volume,
        "impacts": len(summary["impacts"]), "skipped": len(skipped),
        "drift": max(impact["energy_drift"] for impact in summary["impacts"]),
    }  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """A measured coating beside the computed ones: stress MPa, density %; stress, density: mean of the nominal coatings, and all.

    others: stress of seed 1 with the other strength sets, by set.
    """

    name: str
    velocity: float
    measured: tuple[float, float, float]  # stress, its error, density
    stress: tuple[float, NDArray[np.float64]]
    density: tuple[float, NDArray[np.float64]]
    others: dict[str, float]


def comparisons(rows: Sequence[Row]) -> Iterator[Comparison]:
    """One for each measured coating, from the rows with POINTS points."""
    size = f"{MEASURED['nominal']['diameter_um']:g}"
    for name, metal in MEASURED["metals"].items():
        for velocity, density, stress, error in MEASURED[name]:
            chosen = metal, f"{velocity:g}", str(POINTS), str(NUMBER)
            done = [r for r in rows if not r["failed"]]
            own = [r for r in done if (r["metal"], r["velocity_m_s"], r["points"], r["number"]) == chosen]
            usual = [r for r in own if r["strength"] == MEASURED["strength"][metal]]
            nominal = [r for r in usual if r["diameter_um"] == size]
            values = ((float(column(nominal, key).mean()), column(usual, key)) for key in ("stress_MPa", "density"))
            others = {r["strength"]: number(r, "stress_MPa") for r in own if r not in usual}
            yield Comparison(name.replace("_", " "), velocity, (stress, error, density), *values, others)


def lines(rows: Sequence[Row]) -> list[str]:
    """Computed and measured stress and density of each coating."""
    table = []
    for c in comparisons(rows):
        stress, error, density = c.measured
        both = enumerate((c.stress, c.density))
        of_stress, of_density = (f"{mean:.{n}f} ({all_.min():.{n}f} to {all_.max():.{n}f})" for n, (mean, all_) in both)
        others = (f"{c.others[name]:.0f}" if name in c.others else "-" for name in MEASURED["other_strength"])
        table.append([c.name, f"{c.velocity:g}", f"{stress} ± {error}", of_stress, *others, density, of_density])
    sets = (name.replace("_", " ") for name in MEASURED["other_strength"])
    head = ["coating", "m/s", "stress measured (MPa)", "computed", *sets, "density measured (%)", "computed"]
    return markdown(head, table, rows)


def draw(rows: Sequence[Row]) -> None:
    """Computed over measured: stress and density."""
    figure = blank(8.0, 3.8, 110)
    for left, title, of in ((0.09, "residual stress (MPa)", "stress"), (0.59, "density (%)", "density")):
        axes = figure.add_axes((left, 0.14, 0.38, 0.77))
        ends = []
        for c in comparisons(rows):
            stress, error, density = c.measured
            x, dx = (stress, error) if of == "stress" else (density, 0.0)
            mean, band = getattr(c, of)
            label = f"{c.name}, {c.velocity:g} m/s"
            axes.errorbar(x, mean, [[mean - band.min()], [band.max() - mean]], dx, "o", capsize=3, label=label)
            ends += [x - dx, x + dx, band.min(), band.max()]
        axes.plot([min(ends), max(ends)], [min(ends), max(ends)], "k--", lw=1)
        axes.set(title=title, xlabel="measured", ylabel="computed" if of == "stress" else "")
        if of == "stress":
            axes.legend(fontsize=7, loc="upper left")
    save(figure, EVIDENCE / "coating_al.png")


def main() -> None:
    """Run what is missing, draw, write the table of the page."""
    a = options(__doc__, "docs")
    table = study_table("coating_al", COLUMNS, KEY, "python workflows/coatings_al.py")
    for case in () if a.docs else cases():
        if case.key not in table:
            row = table.add(row_of(case))
            print({name: row[name] for name in (*KEY, "stress_MPa", "density", "cpu_s", "failed")}, flush=True)
    draw(table.rows)
    write_parts("coating_stress", {"aluminium": lines(table.rows)})


if __name__ == "__main__":
    main()
