"""Clouds of points that must become meshes: real impacts and synthetic hard ones, by each method, in one table.

    python workflows/splat_battery.py [--clouds DIR] [--only PART] [--summary]

Clouds in DIR and rows in the table docs/tables/splats.csv are not computed again: a run that was stopped goes on. Run
it with OMP_NUM_THREADS=1: seconds are those of one core, of the whole conversion, with gmsh's process; kernels are loaded before.
"""

import itertools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import splat_clouds
from pages import markdown, options, study_table, versions

from coupler.errors import ColdsprayError, SplatError
from coupler.sph import packing
from coupler.splat.cloud import Cloud
from coupler.splat.convert import convert
from coupler.studies.ladder_runs import spent
from coupler.studies.table import Row

SIZE_OVER_SPACING = 1.7  # as the target's elements
COLUMNS = [
    "cloud", "kind", "points", "size_over_spacing", "asked", "used", "result", "bodies", "lost_mass", "tets", "volume_before",
    "moved_spacings", "gamma_min", "gamma_mean", "dihedral_deg", "step_over_size", "width", "top_spacings", "outside_half",
    "outside_max", "T_raw", "eps_p_raw", "energy_raw", "momentum", "angular_momentum", "kinetic", "stress_square", "cpu_s",
    "wall_s", "failed_tries",
]  # fmt: skip
KEY = ("cloud", "asked", "size_over_spacing")
CLOUDS = Path(tempfile.gettempdir()) / "splat_battery"
SIZES = {"lens_2000": (1.0, 3.0), "lip_2000": (1.0, 3.0)}  # further element sizes over the spacing, by cloud


def load(path: Path) -> Cloud:
    """A cloud of the battery from its file."""
    with np.load(path, allow_pickle=False) as file:
        arrays: dict[str, Any] = {name: file[name] for name in file.files}
    for name in ("spacing", "rho", "wave_speed"):
        if name in arrays:
            arrays[name] = float(arrays[name])
    if "vertices" in arrays:
        arrays["surface"] = arrays.pop("vertices"), arrays.pop("triangles")
    return Cloud(**arrays)


def cloud_of(name: str, folder: Path, make: Callable[[], dict[str, Any]]) -> Cloud:
    """A cloud from its file in a folder, which is computed where it is missing. Raises ColdsprayError."""
    path = folder / f"{name}.npz"
    if not path.exists():
        print(f"{name}: computing it", flush=True)
        folder.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **make())
    return load(path)


def warm_up() -> None:
    """Load open3d and the kernels, so that the first row has the seconds of its conversion alone."""
    x, volume = packing.sphere(splat_clouds.D, 200)
    spacing = volume ** (1.0 / 3.0)
    convert(Cloud(x, np.full(len(x), volume), spacing, 1.0, J=np.ones(len(x))), SIZE_OVER_SPACING * spacing)


def row_of(name: str, kind: str, cloud: Cloud, ratio: float, method: str) -> dict[str, Any]:
    """Convert one cloud; its line of the table."""
    row: dict[str, Any] = dict(zip(COLUMNS, (name, kind, len(cloud.x), ratio, method), strict=False))
    before = spent()
    try:
        splat = convert(cloud, ratio * cloud.spacing, method, time_limit=180.0)
    except SplatError as problem:
        return row | {"result": f"failed: {problem}"[:400], "cpu_s": spent() - before}
    row["cpu_s"] = spent() - before
    r, t, dx = splat.report, splat.report["transfer"], cloud.spacing
    row |= {
        "used": r["method"], "result": "meshed", "bodies": len(splat.bodies), "tets": r["tets"],
        "lost_mass": splat.lost_mass / cloud.mass.sum(), "volume_before": r["volume_error_before"],
        "moved_spacings": r["moved_m"] / dx, "gamma_min": r["gamma_min"], "gamma_mean": r["gamma_mean"],
        "dihedral_deg": r["dihedral_min_deg"], "step_over_size": r["step_length_min_m"] / r["element_size_m"],
        "width": r["width_m"] / r["source_width_m"] - 1.0, "top_spacings": (r["top_m"] - r["source_top_m"]) / dx,
        "outside_half": r["outside_half"], "outside_max": r["outside_max"], "T_raw": t.get("T_raw"), "eps_p_raw": t.get("eps_p_raw"),
        "energy_raw": t.get("energy_raw"), "momentum": t.get("momentum"), "angular_momentum": t.get("angular_momentum"),
        "kinetic": t.get("kinetic_energy"), "stress_square": t.get("stress_square"), "wall_s": r["wall_s"],
        "failed_tries": " | ".join(r["failed"])[:400],
    }  # fmt: skip
    return row


def main() -> None:
    """Make what is missing of the clouds and of the table."""
    a = options(__doc__, "summary", clouds=CLOUDS, methods=["auto"], only="")
    table = study_table("splats", COLUMNS, KEY, "OMP_NUM_THREADS=1 python workflows/splat_battery.py")
    if a.summary:
        print("\n".join(summary(table.rows)))
        return
    warm_up()
    for name, (kind, make) in splat_clouds.every().items():
        if a.only not in name:
            continue
        try:
            cloud = cloud_of(name, a.clouds, make)
        except ColdsprayError as problem:
            print(f"{name}: no cloud, {problem}", flush=True)
            continue
        for ratio, method in itertools.product((SIZE_OVER_SPACING, *SIZES.get(name, ())), a.methods):
            if (name, method, f"{ratio:g}") not in table:
                new = table.add(row_of(name, kind, cloud, ratio, method))
                shown = ("asked", "used", "result", "bodies", "tets", "gamma_min", "step_over_size", "cpu_s")
                print(f"{name}:", *(new[column][:150] or "-" for column in shown), flush=True)


def summary(rows: list[Row]) -> list[str]:
    """The measures as a table in Markdown: medians over the clouds, with the worst in brackets."""
    measures = {
        "volume error before matching": ("volume_before", 100.0, "{:+.1f} %", max),
        "width against the source": ("width", 100.0, "{:+.1f} %", max),
        "points more than half a spacing outside": ("outside_half", 100.0, "{:.1f} %", max),
        "farthest point outside, spacings": ("outside_max", 1.0, "{:.2f}", max),
        "worst gamma": ("gamma_min", 1.0, "{:.2f}", min),
        "mean gamma": ("gamma_mean", 1.0, "{:.2f}", min),
        "least dihedral angle": ("dihedral_deg", 1.0, "{:.0f} deg", min),
        "worst step length over edge": ("step_over_size", 1.0, "{:.3f}", min),
        "tetrahedra over points": ("tets", 1.0, "{:.1f}", max),
        "seconds of one core": ("cpu_s", 1.0, "{:.1f}", max),
    }
    meshed = [row for row in rows if row["result"] == "meshed"]
    lines = [["all gates passed", f"{len(meshed)} of {len(rows)}"]]
    for label, (name, factor, form, worst) in measures.items():
        values = [factor * float(row[name]) for row in meshed if row.get(name)]
        if name == "tets":
            values = [float(row["tets"]) / float(row["points"]) for row in meshed]
        far = worst(values, key=abs) if worst is max else min(values)
        lines.append([label, f"{form.format(float(np.median(values)))} ({form.format(far)})"])
    return [*markdown("| median (worst)", lines), "", versions(rows)]


if __name__ == "__main__":
    main()
