"""Influence of the size of the substrate on a coating, for random positions of the particles: python workflows/coating_size.py

workflows/coating_size.toml with other seeds, on its substrate and on one of twice the size. Each coating is a row of
docs/tables/coating_size_seeds.csv that is not computed again; --docs runs nothing and writes the sentence of the page.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from pages import computed, options, scene_file, versions, write_parts
from study_table import Row, column, study

from coupler.studies import coating

SEEDS = range(3, 11)
SIZES = {"110": 60, "220": 120}  # um, diameter and height
RADIUS = 10e-6  # m: of the disc that is measured
MEASURES = {  # column: name and unit of its change
    "thickness_um": ("thickness", "%"), "strain": ("plastic strain", "%"), "von_mises_MPa": ("von Mises stress", "%"),
    "thermal_MPa": ("stress of cooling", "MPa"), "residual_MPa": ("residual stress", "MPa"),
}  # fmt: skip


def row_of(seed: str, diameter: str) -> dict[str, object]:
    """The coating of a seed on a substrate of a diameter, um; stresses are means over the volume of the splats within RADIUS."""
    size = {"diameter": f"{diameter} um", "height": f"{SIZES[diameter]} um"}
    with computed(scene_file("coating_size", coating={"seed": int(seed)}, substrate=size)) as (result, cpu):
        measures = coating.measure(coating.read(result), RADIUS)
    layers = [layer for layer in measures.layers if layer["layer"] > 0]
    volume = [layer["volume_m3"] for layer in layers]
    return {
        "thickness_um": measures.thickness_mean_m * 1e6,
        "strain": np.average([layer["eps_p_mean"] for layer in layers], weights=volume),
        "von_mises_MPa": np.average([layer["von_mises_mean"] for layer in layers], weights=volume) * 1e-6,
        "thermal_MPa": measures.thermal_in_plane_Pa * 1e-6, "residual_MPa": measures.stress_in_plane_Pa * 1e-6,
        "cpu_s": cpu,
    }  # fmt: skip


def lines(rows: Sequence[Row]) -> list[str]:
    """A sentence: the mean changes from the small to the large substrate, with their standard errors."""
    rows_in_order = sorted(rows, key=lambda row: int(row["seed"]))
    small, large = ([row for row in rows_in_order if row["diameter_um"] == d] for d in SIZES)
    pairs = min(len(small), len(large))
    changes = []
    for name, (label, unit) in MEASURES.items():
        a, b = column(small[:pairs], name), column(large[:pairs], name)
        scale = 1.0 if unit == "MPa" else 100.0 / abs(a.mean())
        mean, error = scale * (b - a).mean(), scale * (b - a).std(ddof=1) / np.sqrt(pairs)
        changes.append(f"{label} {mean:+.1f} ± {error:.1f} {unit}")
    words = f"From 110 to 220 µm (mean of {pairs} coatings of three particles and its standard error): {'; '.join(changes)}."
    return [f"- **Size of the substrate.** {words} {versions(rows)}"]


if __name__ == "__main__":
    keys = () if options(__doc__, "docs").docs else itertools.product(map(str, SEEDS), SIZES)
    table = study("coating_size_seeds", ("seed", "diameter_um"), keys, row_of)
    write_parts("coating", {"size": lines(table.rows)})
