"""Coatings of aluminium whose deposition stress and density others have measured: python workflows/coatings_al.py

    python workflows/coatings_al.py --docs    # runs nothing: the part of the page from the table

The measurements, readings, ranges and bands are in workflows/measurements.toml. Each coating is a row of docs/tables/coating_al.csv
that is not computed again. Nothing is fitted.
"""

import math
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import process_time

from pages import PAGES, column, markdown, options, study_table, table_rows, versions, write_parts

from coupler import Result, Scene, run
from coupler.errors import ColdsprayError, SolverError
from coupler.progress import Progress
from coupler.studies import coating
from coupler.studies.table import Row

MEASURED = tomllib.loads((Path(__file__).parent / "measurements.toml").read_text())["deposition_stress"]
COLUMNS = (
    "metal", "velocity_m_s", "diameter_um", "temperature_K", "seed", "points", "number", "layers", "disc", "strength", "stress_MPa",
    "thermal_MPa", "density", "open", "closed", "overlap_share", "thickness_um", "eps_p", "impacts", "skipped", "drift", "cpu_s",
    "failed",
)  # fmt: skip
KEY = COLUMNS[:10]
DRAFT, BETWEEN, FINE, FINEST = 213, 500, 1000, 2000  # points of a particle
FINEST_AT = (585, 805)  # m/s: the first of pure aluminium, and the one that is missed most
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
    points: int = DRAFT
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
    """The nominal coatings, the corners and other places of the particles, with two numbers of points, three with others, and what
    tests the reasons for what is missed: another strength, with both, and other patches."""
    rows = [(MEASURED["metals"][name], row[0]) for name in MEASURED["metals"] for row in MEASURED[name]]
    first, *others = MEASURED["seeds"]
    for state, seed in [
        *((s, first) for s in (MEASURED["nominal"], *MEASURED["corners"])),
        *((MEASURED["nominal"], s) for s in others),
    ]:
        for metal, velocity in rows:
            for points in (DRAFT, FINE):
                yield Case(metal, velocity, state["diameter_um"], state["temperature_K"], seed, points)
    nominal = MEASURED["nominal"]
    one = Case(*rows[0], nominal["diameter_um"], nominal["temperature_K"], first)
    yield replace(one, points=BETWEEN)
    for velocity in FINEST_AT:
        yield replace(one, velocity=velocity, points=FINEST)
    for strength, points in product(MEASURED["other_strength"], (DRAFT, FINE)):
        for metal, velocity in rows:
            if metal == one.metal:
                yield replace(one, velocity=velocity, strength=strength, points=points)
    for strength in ("Hassani_2016", ""):
        yield replace(one, number=56, layers=4, disc=1.35, strength=strength)
    yield replace(one, number=236, disc=4.0, strength="Hassani_2016")


def row_of(case: Case) -> dict[str, object]:
    """The coating of a case as a row of the table."""
    row: dict[str, object] = dict(zip(KEY, case.key, strict=True))
    started = process_time()
    try:
        with tempfile.TemporaryDirectory() as place:
            scene = Scene.from_text(case.text, "coating")
            result = run(scene, Path(place) / "run", threads=1, skip_failed=True, progress=Progress(quiet=True))
            if result.undecided is not None:
                raise SolverError(result.undecided)
            return row | values_of(result, case) | {"cpu_s": process_time() - started, "failed": ""}
    except ColdsprayError as problem:
        return row | {"failed": " ".join(str(problem).split())[:200]}


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


def gap(low: float, high: float, value: float, error: float) -> float:
    """Distance between the band [low, high] and value with its error; 0 where they overlap, negative where the band lies below."""
    return max(low - value - error, 0.0) + min(high - value + error, 0.0)


def is_usual(row: Row) -> bool:
    """Whether a row has the patch and the strength of the comparison."""
    return (row["number"], row["strength"]) == (str(NUMBER), MEASURED["strength"][row["metal"]])


def reasons(rows: Sequence[Row]) -> list[str]:
    """What other patches and another strength change, beside the measured values."""
    table, first = [], MEASURED["seeds"][0]
    measured = {f"{velocity:g}": (density, stress) for velocity, density, stress, _ in MEASURED["pure_Al"]}
    for row in rows:
        is_nominal = row["diameter_um"] == f"{MEASURED['nominal']['diameter_um']:g}" and row["seed"] == str(first)
        has_reference = row["metal"] == MEASURED["metals"]["pure_Al"] and row["points"] in (str(DRAFT), str(FINE))
        if row["failed"] or not (is_nominal and has_reference):
            continue
        density, stress = measured[row["velocity_m_s"]]
        table.append([
            row["velocity_m_s"], f"{row['number']} in {row['layers']} layers, {row['disc']} diameters",
            row["strength"].replace("_", " "), row["points"], f"{float(row['stress_MPa']):.0f}", stress,
            f"{float(row['thermal_MPa']):+.0f}", f"{float(row['density']):.1f}", density,
        ])  # fmt: skip
    table.sort(key=lambda line: (int(line[0]), line[2], line[1], int(line[3])))
    head = "m/s | particles, radius of the disc | strength | points | stress (MPa) | measured | of it cooling | density (%) | measured"
    return markdown(head, table)


def lines(rows: Sequence[Row]) -> list[str]:
    """Computed and measured stress and density of each coating, by number of points."""
    table = []
    for points, name in product((DRAFT, FINE), MEASURED["metals"]):
        metal = MEASURED["metals"][name]
        for velocity, density, stress, error in MEASURED[name]:
            chosen = (metal, f"{velocity:g}", str(points))
            own = [row for row in rows if (row["metal"], row["velocity_m_s"], row["points"]) == chosen]
            usual = [row for row in own if is_usual(row) and not row["failed"]]
            if not usual:
                continue
            s, d = column(usual, "stress_MPa"), column(usual, "density")
            nominal = [row for row in usual if row["diameter_um"] == f"{MEASURED['nominal']['diameter_um']:g}"]
            table.append([
                name.replace("_", " "), f"{velocity:g}", points, f"{stress} ± {error}",
                f"{column(nominal or usual, 'stress_MPa').mean():.0f} ({s.min():.0f} to {s.max():.0f})",
                f"{gap(s.min(), s.max(), stress, error):+.0f}", f"{density:.1f}",
                f"{column(nominal or usual, 'density').mean():.1f} ({d.min():.1f} to {d.max():.1f})",
                f"{gap(d.min(), d.max(), density, 0.0):+.1f}", len(usual),
            ])  # fmt: skip
    head = (
        "coating | m/s | points | stress measured (MPa) | computed: nominal (band) | apart | density measured (%)"
        " | computed: nominal (band) | apart | coatings"
    )
    failed = [row for row in rows if row["failed"]]
    note = [f"{len(failed)} of {len(rows)} coatings did not end: {failed[0]['failed']}", ""] if failed else []
    return [*markdown(head, table), "", *note, versions(rows)]


def main() -> None:
    """Run what is missing, write the part of the page."""
    a = options(__doc__, "docs")
    table = study_table("coating_al", COLUMNS, KEY, "python workflows/coatings_al.py")
    for case in () if a.docs else cases():
        if case.key not in table:
            row = table.add(row_of(case))
            print({name: row[name] for name in (*KEY, "stress_MPa", "density", "cpu_s", "failed")}, flush=True)
    rows = table_rows("coating_al")
    write_parts(PAGES["coating"], {"aluminium": lines(rows), "reasons": reasons(rows)})


if __name__ == "__main__":
    main()
