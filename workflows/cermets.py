"""What a ceramic in the powder does to a coating, and whether it stays: python workflows/cermets.py

Coatings: the blends of workflows/cermet_cu.toml and cermet_al.toml; each without its ceramic ("metal": the same metal particles at the
same places); and with all of the ceramic after the metal ("after"). Impacts: single particles of Al2O3 that cannot break, without bonds
except in the last two. Each is a row of docs/tables/cermets.csv and ceramic_impacts.csv that is not computed again; --docs runs
nothing and writes the tables of the page.
"""

import math
import tomllib
from collections.abc import Sequence

from pages import EVIDENCE, computed, impact_tables, markdown, options, scene_file, write_parts
from study_table import Row, column, study

from coupler import Scene
from coupler.measures import EMBEDDED, STICKS, UNDECIDED
from coupler.report.picture import stage
from coupler.studies import coating, coating_files

COATINGS = {  # scene, powder: heading
    ("cermet_cu", "metal"): "Cu", ("cermet_cu", "blend"): "Cu + 30 % Al2O3", ("cermet_cu", "after"): "Cu, then Al2O3",
    ("cermet_al", "metal"): "Al", ("cermet_al", "blend"): "Al + 50 % SiC",
}  # fmt: skip
PICTURES = "cermet_cu"  # scene whose coatings the page shows
LINES = {  # column: label, factor, digits
    "ceramics": ("particles of ceramic", 1.0, 0), "ceramics_stay": ("of these stay", 1.0, 0),
    "fed_share": ("ceramic in the mass fed, %", 100.0, 1),
    "thickness_um": ("thickness, µm", 1.0, 1), "Sa_um": ("roughness Sa, µm", 1.0, 1), "porosity": ("porosity, %", 100.0, 1),
    "strain": ("plastic strain, mean", 1.0, 2), "impacts_MPa": ("stress of the impacts, MPa", 1.0, 0),
    "residual_MPa": ("residual stress, MPa", 1.0, 0), "error_MPa": ("its variation over the disc, ± MPa", 1.0, 0),
    "drift": ("energy error of an impact at worst, %", 100.0, 2),
}  # fmt: skip
KEY = ("shape", "base", "velocity", "spacing", "bond")  # of an impact: m/s, um, J/m2
IMPACTS = (
    *(("sphere", "Al1100", velocity, spacing, "0") for velocity in ("500", "800") for spacing in ("2.5", "1.3")),
    ("angular", "Al1100", "600", "2", "0"), ("angular", "Cu", "700", "2", "0"),
    ("sphere", "Cu", "800", "2.5", "0"), ("sphere", "Cu", "800", "1.3", "0"),
    ("sphere", "Al1100", "600", "2.5", "20"), ("sphere", "Al1100", "600", "2.5", "100"),
)  # fmt: skip
WHOLE = {"tensile_limit": "20 GPa"}  # no impact reaches this stress: particles do not break
DIAMETER = 20.0  # um


def scene_of(name: str, powder: str) -> Scene:
    """The blend of a scene; "metal": only the particles of its first powder; "after": these first, then the ceramic ones."""
    scene = scene_file(name)
    if powder == "blend":
        return scene
    tables = tomllib.loads(scene.to_toml())
    metal, particles = tables["coating"].pop("powder")[0]["material"], tables["particle"]
    hard = [particle for particle in particles if particle["material"] != metal]
    tables["particle"] = [particle for particle in particles if particle not in hard] + hard * (powder == "after")
    tables["coating"] |= {"number": len(tables["particle"]), "layers": 1}
    return Scene.from_dict(tables, f"{name}_{powder}")


def coating_row(name: str, powder: str) -> dict[str, object]:
    """Compute a coating and return its row. Draws the pictures of the page, which look like etched sections."""
    with computed(scene_of(name, powder)) as (result, _):
        impacts, splats = result.summary["impacts"], coating.read(result)
        if name == PICTURES:
            picture = EVIDENCE / f"{PICTURES}_{powder}.png"
            coating_files.micrograph(splats, picture, 1.3 * splats.patch, stage(result).plane)
    measures = coating.measure(splats)
    hard = [impact for impact in impacts if "tension_max_Pa" in impact]
    shares = measures.phases[-1] if hard else {"fed_share": 0.0, "deposited_share": 0.0}
    layers = [layer for layer in measures.layers if layer["layer"] > 0]
    volume = sum(layer["volume_m3"] for layer in layers)
    return {
        "ceramics": len(hard), "ceramics_stay": sum(impact["verdict"] in (STICKS, EMBEDDED) for impact in hard),
        "undecided": sum(impact["verdict"] == UNDECIDED for impact in hard),
        **{name: shares[name] for name in ("fed_share", "deposited_share")},
        "thickness_um": measures.thickness_mean_m * 1e6, "Sa_um": measures.Sa_m * 1e6,
        "porosity": measures.porosity_open + measures.porosity_closed,
        "strain": sum(layer["eps_p_mean"] * layer["volume_m3"] for layer in layers) / volume,
        "impacts_MPa": (measures.stress_in_plane_Pa - measures.thermal_in_plane_Pa) * 1e-6,
        "residual_MPa": measures.stress_in_plane_Pa * 1e-6, "error_MPa": (measures.stress_error_Pa or math.nan) * 1e-6,
        "drift": max(abs(impact["energy_drift"]) for impact in impacts),
    }  # fmt: skip


def impact_row(shape: str, base: str, velocity: str, spacing: str, bond: str) -> dict[str, object]:
    """Compute an impact and return its row."""
    tables = impact_tables("Al2O3", DIAMETER, float(velocity), base, (140.0, 80.0), float(spacing), shape=shape)
    law = {"kind": "cohesive", "criterion": "all", "strength": "200 MPa", "energy": f"{bond} J/m2"}
    pair = {"metals": ["Al2O3", base], "energy": f"{bond} J/m2"}
    tables |= {"preset": "draft", "materials": {"Al2O3": WHOLE}, "output": {"at": "ends"}}
    tables["adhesion"] = {"kind": "tied"} if bond == "0" else law | {"pair": [pair]}
    with computed(Scene.from_dict(tables, "ceramic")) as (result, _):
        (impact,) = result.summary["impacts"]
    return {
        "points": impact["points"], "verdict": impact["verdict"], "restitution": impact["restitution"],
        "crater_um": impact["greatest"]["crater_depth_m"] * 1e6, "tension_GPa": impact["tension_max_Pa"] * 1e-9,
    }  # fmt: skip


def coating_lines(rows: Sequence[Row]) -> list[str]:
    """A table with a column for each coating."""
    heads = [COATINGS[row["scene"], row["powder"]] for row in rows]
    lines = [
        [label, *(f"{scale * value:.{digits}f}" for value in column(rows, name))]
        for name, (label, scale, digits) in LINES.items()
    ]
    return markdown(["", *heads], lines, rows)


def impact_lines(rows: Sequence[Row]) -> list[str]:
    """A table with a row for each impact."""
    lines = [
        [
            f"{row['shape']} on {row['base']}", row["velocity"], row["points"], row["bond"], row["verdict"],
            f"{float(row['restitution']):.2f}", f"{float(row['crater_um']):.1f}", f"{float(row['tension_GPa']):.1f}",
        ]
        for row in rows
    ]  # fmt: skip
    head = "Al2O3 of 20 µm | m/s | points | bond, J/m2 | verdict | rebound over impact velocity | crater, µm | tension up to, GPa"
    return markdown(head, lines, rows)


if __name__ == "__main__":
    a = options(__doc__, "docs")
    impacts = study("ceramic_impacts", KEY, () if a.docs else IMPACTS, impact_row)
    coatings = study("cermets", ("scene", "powder"), () if a.docs else COATINGS, coating_row)
    write_parts("cermets", {"impacts": impact_lines(impacts.rows), "cermets": coating_lines(coatings.rows)})
