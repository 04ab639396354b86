"""Conversion of many clouds of points to meshes: clouds of real impacts, hard synthetic clouds, and splats of runs.

    python workflows/splat_battery.py [--only PART]    # docs/tables/splats.csv, the figure and the page
    python workflows/splat_battery.py --docs           # converts only the clouds of the figure

Rows in the table are not computed again. Seconds are those of one core (OMP_NUM_THREADS=1) for the whole conversion, with gmsh.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import splat_clouds
from matplotlib.collections import PolyCollection
from pages import drawing, markdown, options, spent, write_parts
from study_table import REMAKE, Row, study

from coupler.errors import SplatError
from coupler.geometry.sections import crossing, section_of_tets
from coupler.particle import packing
from coupler.splat.cloud import Cloud
from coupler.splat.convert import convert

SIZE_OVER_SPACING = 1.7  # as the target's elements
KINDS = {"impact": "impacts", "synthetic": "synthetic", "splat": "splats of runs"}
DRAWN = {"Ni1000": "Ni, 1000 m/s", "Ni500_angular": "Ni, angular, 500 m/s", "long_lip_5000": "long lip, synthetic"}
SHOWN = {  # label -> column, factor, form, the worst of all
    "volume error before the correction": ("volume_before", 100.0, "{:+.1f} %", max),
    "width against the points": ("width", 100.0, "{:+.1f} %", max),
    "points more than half a spacing outside": ("outside_half", 100.0, "{:.1f} %", max),
    "worst gamma": ("gamma_min", 1.0, "{:.2f}", min),
    "worst step length over edge": ("step_over_size", 1.0, "{:.2f}", min),
    "volume integral of σ:σ": ("stress_square", 100.0, "{:+.0f} %", max),
    "seconds of one core": ("cpu_s", 1.0, "{:.1f}", max),
}
SIZES = {"lens_2000": (1.0, 3.0), "lip_2000": (1.0, 3.0)}  # further element sizes over the spacing, by cloud


def row_of(kind: str, cloud: Cloud, ratio: float) -> dict[str, Any]:
    """Convert one cloud and return its row of the table."""
    row: dict[str, Any] = {"kind": kind, "points": len(cloud.x)}
    before = spent()
    try:
        splat = convert(cloud, ratio * cloud.spacing)
    except SplatError as problem:
        return row | {"result": f"failed: {problem}"[:400], "cpu_s": spent() - before}
    row["cpu_s"] = spent() - before
    r, t, dx = splat.report, splat.report["transfer"], cloud.spacing
    return row | {
        "used": r["method"], "result": "meshed", "bodies": len(splat.bodies), "tets": r["tets"],
        "lost_mass": r["lost_points"] / len(cloud.x), "volume_before": r["volume_error_before"],
        "moved_spacings": r["moved_m"] / dx, "gamma_min": r["gamma_min"], "gamma_mean": r["gamma_mean"],
        "dihedral_deg": r["dihedral_min_deg"], "step_over_size": r["step_length_min_m"] / r["element_size_m"],
        "width": r["width_m"] / r["source_width_m"] - 1.0, "top_spacings": (r["top_m"] - r["source_top_m"]) / dx,
        "outside_half": r["outside_half"], "outside_max": r["outside_max"], "T_raw": t.get("T_raw"), "eps_p_raw": t.get("eps_p_raw"),
        "energy_raw": t.get("energy_raw"), "momentum": t.get("momentum"), "angular_momentum": t.get("angular_momentum"),
        "kinetic": t.get("kinetic_energy"), "stress_square": t.get("stress_square"), "wall_s": r["wall_s"],
        "failed_tries": " | ".join(r["failed"])[:400],
    }  # fmt: skip


def compute(only: str, docs: bool) -> list[Row]:
    """The rows of the table. Missing rows of clouds with `only` in their names are computed first. docs: convert no cloud."""
    clouds = {name: each for name, each in splat_clouds.every().items() if only in name}

    def convert_one(name: str, ratio: str) -> dict[str, Any]:
        kind, make = clouds[name]
        return row_of(kind, make(), float(ratio))

    keys = ((name, f"{ratio:g}") for name in clouds for ratio in (SIZE_OVER_SPACING, *SIZES.get(name, ())))
    if not docs:  # load open3d and the kernels, so that the first row has the seconds of its conversion alone
        x, volume = packing.sphere(splat_clouds.D, 200)
        spacing = volume ** (1.0 / 3.0)
        convert(Cloud(x, np.full(len(x), volume), spacing, 1.0, J=np.ones(len(x))), SIZE_OVER_SPACING * spacing)
    remake = f"OMP_NUM_THREADS=1 {REMAKE}"
    return study("splats", ("cloud", "size_over_spacing"), () if docs else keys, convert_one, remake=remake).rows


def part(rows: Sequence[Row]) -> list[str]:
    """The table of the page: medians over each kind of clouds, with the worst in brackets."""
    groups = {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS}
    passed = {kind: [row for row in own if row["result"] == "meshed"] for kind, own in groups.items()}
    first = {kind: sum(not row["failed_tries"] for row in own) for kind, own in groups.items()}
    counts = [f"{len(own)}, {len(passed[kind])}, {first[kind]}" for kind, own in groups.items()]
    lines = [["conversions, all gates passed, at the first try", *counts]]
    for label, (name, factor, form, worst) in SHOWN.items():
        cells = []
        for own in groups.values():
            values = [factor * float(row[name]) for row in own if row[name]]
            cells.append(f"{form.format(float(np.median(values)))} ({form.format(worst(values, key=abs))})")
        lines.append([label, *cells])
    return markdown(["", *KINDS.values()], lines, rows)


def draw() -> None:
    """Points and mesh of three clouds, in cross-section at y = 0, coloured by plastic strain."""
    makers = splat_clouds.every()
    clouds = {label: makers[name][1]() for name, label in DRAWN.items()}
    most = max(float(np.percentile(cloud.eps_p, 99)) for cloud in clouds.values() if cloud.eps_p is not None)
    colours: dict[str, Any] = {"cmap": "viridis", "clim": (0.0, most)}
    with drawing("splats", 12.0, 4.4, "constrained", 100) as figure:
        axes = figure.subplots(2, len(clouds))
        for (above, below), (label, cloud) in zip(axes.T, clouds.items(), strict=True):
            assert cloud.eps_p is not None
            near = np.abs(cloud.x[:, 1]) < 0.8 * cloud.spacing
            x, z = cloud.x[near][:, [0, 2]].T * 1e6
            above.scatter(x, z, s=9, c=cloud.eps_p[near], vmin=0.0, vmax=most, cmap="viridis")
            above.set_title(f"{label}: {len(cloud.x)} points", fontsize=9)
            splat = convert(cloud, SIZE_OVER_SPACING * cloud.spacing)
            for body in splat.bodies:
                assert body.eps_p is not None
                edges, owner = section_of_tets(body.points, body.tets, 0.0)
                corners = list(crossing(body.points, edges, 0.0)[0] * 1e6)
                cells = PolyCollection(corners, array=body.eps_p[owner], edgecolors="k", linewidths=0.3, **colours)
                drawn = below.add_collection(cells)
            r = splat.report
            below.set_title(f"{r['tets']} tetrahedra, worst gamma {r['gamma_min']:.2f}", fontsize=9)
            low, high = cloud.x.min(axis=0) * 1e6 - 2.0, cloud.x.max(axis=0) * 1e6 + 2.0
            for panel in (above, below):
                panel.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[2], high[2]))
            below.set_xlabel("x (µm)")
        for panel, words in zip(axes[:, 0], ("points at y = 0", "elements"), strict=True):
            panel.set_ylabel(f"{words}\nz (µm)")
        figure.colorbar(drawn, ax=axes[:, -1], label="plastic strain", shrink=0.8)


if __name__ == "__main__":
    a = options(__doc__, "docs", only="")
    rows = compute(a.only, a.docs)
    draw()
    write_parts("splats", {"battery": part(rows)})
