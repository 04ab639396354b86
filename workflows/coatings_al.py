"""Coatings of aluminium whose deposition stress and density others have measured: python workflows/coatings_al.py

    python workflows/coatings_al.py --docs    # runs nothing: the part of the page from the table

The measurements, readings, ranges and bands are in workflows/measurements.toml. Each coating is a row of docs/tables/coating_al.csv
that is not computed again. Nothing is fitted.
"""

import math
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

from pages import PAGES, column, markdown, options, study_table, table_rows, versions, write_parts

from coupler import Scene, run
from coupler.errors import ColdsprayError, SolverError
from coupler.progress import Progress
from coupler.studies import coating
from coupler.studies.table import Row

MEASURED = tomllib.loads((Path(__file__).parent / "measurements.toml").read_text())["deposition_stress"]
COLUMNS = (
    "metal", "velocity_m_s", "diameter_um", "temperature_K", "seed", "points", "stress_MPa", "thermal_MPa", "density", "open", "closed",
    "overlap_share", "thickness_um", "eps_p", "impacts", "skipped", "drift", "cpu_s", "failed",
)  # fmt: skip
KEY = COLUMNS[:6]
POINTS, FINE = 213, 500  # of a particle
DISC = 0.9  # diameters: radius of the disc that the particles are aimed at
SCENE = """
preset = "draft"
[coating]
material = "{metal}"
number = 12
layers = 2
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
"""


@dataclass(frozen=True)
class Case:
    """One coating. velocity m/s, diameter um, temperature K of the particles; points of each."""

    metal: str
    velocity: float
    diameter: float
    temperature: float
    seed: int
    points: int = POINTS

    @property
    def key(self) -> tuple[str, ...]:
        """As in the table."""
        return (
            self.metal, f"{self.velocity:g}", f"{self.diameter:g}", f"{self.temperature:g}", f"{self.seed}", f"{self.points}",
        )  # fmt: skip

    @property
    def text(self) -> str:
        """The scene: two layers on a disc of DISC diameters radius; the substrate is 5.5 diameters wide and 3 high."""
        spacing = self.diameter * (math.pi / 6.0 / self.points) ** (1.0 / 3.0)
        size = {"radius": DISC * self.diameter, "width": 5.5 * self.diameter, "depth": 3.0 * self.diameter}
        return SCENE.format(**vars(self), **size, spacing=spacing)


def cases() -> Iterator[Case]:
    """The nominal coatings, the corners, other places of the particles, and one with more points."""
    rows = [(MEASURED["metals"][name], row[0]) for name in MEASURED["metals"] for row in MEASURED[name]]
    first, *others = MEASURED["seeds"]
    for state, seed in [
        *((s, first) for s in (MEASURED["nominal"], *MEASURED["corners"])),
        *((MEASURED["nominal"], s) for s in others),
    ]:
        for metal, velocity in rows:
            yield Case(metal, velocity, state["diameter_um"], state["temperature_K"], seed)
    nominal = MEASURED["nominal"]
    yield Case(*rows[0], nominal["diameter_um"], nominal["temperature_K"], first, FINE)


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
            measures = coating.measure(coating.read(result), MEASURED["window"] * DISC * case.diameter * 1e-6)
            summary = result.summary
            skipped = [text for text in summary["run"]["warnings"] if "was skipped" in text]
            print(*skipped, sep="\n", end="\n" if skipped else "", flush=True)
    except ColdsprayError as problem:
        return row | {"failed": " ".join(str(problem).split())[:200]}
    strain = [layer for layer in measures.layers if layer["layer"] > 0]
    volume = sum(layer["volume_m3"] for layer in strain)
    return row | {
        "stress_MPa": measures.stress_in_plane_Pa * 1e-6, "thermal_MPa": measures.thermal_in_plane_Pa * 1e-6,
        "density": 100.0 * (1.0 - measures.porosity_open - measures.porosity_closed),
        "open": 100.0 * measures.porosity_open, "closed": 100.0 * measures.porosity_closed,
        "overlap_share": 100.0 * measures.overlap_share, "thickness_um": measures.thickness_mean_m * 1e6,
        "eps_p": sum(layer["eps_p_mean"] * layer["volume_m3"] for layer in strain) / volume,
        "impacts": len(summary["impacts"]), "skipped": len(skipped),
        "drift": max(impact["energy_drift"] for impact in summary["impacts"]), "cpu_s": process_time() - started, "failed": "",
    }  # fmt: skip


def gap(low: float, high: float, value: float, error: float) -> float:
    """Distance between the band [low, high] and value with its error; 0 where they overlap, negative where the band lies below."""
    return max(low - value - error, 0.0) + min(high - value + error, 0.0)


def lines(rows: Sequence[Row]) -> list[str]:
    """Computed and measured stress and density of each coating."""
    table = []
    for name, metal in MEASURED["metals"].items():
        for velocity, density, stress, error in MEASURED[name]:
            own = [
                row
                for row in rows
                if (row["metal"], row["velocity_m_s"]) == (metal, f"{velocity:g}") and not row["failed"]
            ]
            usual = [row for row in own if row["points"] == str(POINTS)]
            if not usual:
                continue
            s, d = column(usual, "stress_MPa"), column(usual, "density")
            nominal = [row for row in usual if row["diameter_um"] == f"{MEASURED['nominal']['diameter_um']:g}"]
            table.append([
                name.replace("_", " "), f"{velocity:g}", f"{stress} ± {error}",
                f"{column(nominal or usual, 'stress_MPa').mean():.0f} ({s.min():.0f} to {s.max():.0f})",
                f"{gap(s.min(), s.max(), stress, error):+.0f}", f"{density:.1f}",
                f"{column(nominal or usual, 'density').mean():.1f} ({d.min():.1f} to {d.max():.1f})",
                f"{gap(d.min(), d.max(), density, 0.0):+.1f}", len(usual),
            ])  # fmt: skip
    head = (
        "coating | m/s | stress measured (MPa) | computed: nominal (band) | apart | density measured (%) | computed: nominal (band)"
        " | apart | coatings"
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
    write_parts(PAGES["coating"], {"aluminium": lines(table_rows("coating_al"))})


if __name__ == "__main__":
    main()
