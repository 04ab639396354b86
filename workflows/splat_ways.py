"""Our surface, remesher and volume correction against those of open3d, on the clouds of the battery: docs/tables/splat_ways.csv.

    python workflows/splat_ways.py [--most 6000] [--clouds DIR]

Ways: `ours` (the default: carried surface, else density; level set; remeshed), `density` (the same without the carried surface),
`decimated` (the default's level set, thinned by quadric decimation and smoothed by Taubin's filter in place of our remesher), `poisson`
(Poisson reconstruction of the points at the rim, with normals of the density, remeshed). All go through the same gates at the first
try, at one element size. most: points of the largest cloud. Clouds in DIR and rows in the table are not computed again.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d as o3d
import splat_clouds
from pages import options, study_table
from splat_battery import CLOUDS, SIZE_OVER_SPACING, cloud_of, spent

from coupler.errors import SplatError
from coupler.geometry.remesh import even
from coupler.geometry.triangles import enclosed_volume, surface_area
from coupler.splat import field as fields
from coupler.splat import meshing, surface
from coupler.splat.cloud import Cloud, Report
from coupler.splat.convert import separate_bodies

COLUMNS = ("cloud", "way", "points", "result", "gamma_min", "gamma_mean", "step_over_size", "volume_before", "tets",
           "cpu_s")  # fmt: skip
Surface = tuple[np.ndarray, np.ndarray]


def triangles_of(mesh: o3d.geometry.TriangleMesh) -> Surface:
    return np.asarray(mesh.vertices).copy(), np.asarray(mesh.triangles).astype(np.int64)


def decimated(vertices: np.ndarray, triangles: np.ndarray, size: float, *_: object) -> Surface:
    """A surface with as many triangles as equilateral ones of edge `size` m have room for, smoothed."""
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices / size), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    count = round(surface_area(vertices, triangles) / (np.sqrt(3.0) / 4.0 * size**2))
    x, t = triangles_of(mesh.simplify_quadric_decimation(count).filter_smooth_taubin(5))
    return x * size, t


def poisson(cloud: Cloud, size: float) -> list[Surface]:
    """The surface through the points at the rim of a cloud: where the density falls, with normals against its gradient."""
    dx = cloud.spacing
    density = fields.of_points(cloud.x, cloud.current_volume, 0.5 * dx, 0.8 * dx)
    slope = np.stack(
        [fields.Field(g, density.origin, density.h).at(cloud.x) for g in np.gradient(density.values, density.h)], axis=1
    )
    steep = np.linalg.norm(slope, axis=1)
    rim = steep > 0.3 * np.percentile(steep, 95)
    points = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.x[rim] / dx))
    points.normals = o3d.utility.Vector3dVector(-slope[rim] / steep[rim, None])
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(points, depth=7, n_threads=1)
    x, t = triangles_of(mesh)
    shells = surface.shells((x * dx, t), 0.1 * cloud.solid_volume)
    if not shells:
        raise SplatError("the reconstruction left no surface")
    return [even(*shell, size) for shell in shells]


def mesh(way: str, cloud: Cloud, size: float) -> Report:
    """The worst measures of the bodies of a cloud, by one way, at the first try. Raises SplatError where a gate is not passed."""
    method = "carried" if cloud.surface is not None and way != "density" else "density"
    worst: Report = {}
    for _, shape in separate_bodies(cloud, size, method):
        solid = shape.cloud.solid_volume
        strategy = meshing.Strategy(method, "HXT")
        kept = meshing.even
        try:
            if way == "decimated":
                meshing.even = decimated
            if way == "poisson":
                shells = poisson(shape.cloud, size)
                before = sum(enclosed_volume(*shell) for shell in shells) / solid - 1.0
                shells, _ = surface.correct_volume(shells, solid, shape.cloud.spacing)
                for shell in shells:
                    meshing.check_solid(*shell)
                filled = meshing.apart(
                    meshing.partial(meshing.mesher.fill, shells, size, meshing.mesher.HXT, 0.45), 120.0
                )
                report: Report = {"volume_error_before": before, **meshing.check_mesh(*filled, solid, size)}
            else:
                *filled, report = meshing.build_mesh(strategy, shape, size, {}, 40.0)
        finally:
            meshing.even = kept
        if not worst or report["gamma_min"] < worst["gamma_min"]:
            worst = {**report, "tets": report["tets"]}
    return worst


def main() -> None:
    """Compute the rows that the table lacks."""
    a = options(__doc__, clouds=CLOUDS, most=6000, ways=["ours", "density", "decimated", "poisson"])
    table = study_table("splat_ways", COLUMNS, ("cloud", "way"), "OMP_NUM_THREADS=1 python workflows/splat_ways.py")
    makers: dict[str, Callable[[], dict]] = {**splat_clouds.synthetic(), **splat_clouds.real()}
    for name, make in makers.items():
        if not (Path(a.clouds) / f"{name}.npz").exists() and name in splat_clouds.real():
            continue  # real clouds are computed by workflows/splat_battery.py
        cloud = cloud_of(name, a.clouds, make)
        size = SIZE_OVER_SPACING * cloud.spacing
        for way in a.ways if len(cloud.x) <= a.most else ():
            if (name, way) in table:
                continue
            row: dict[str, object] = {"cloud": name, "way": way, "points": len(cloud.x)}
            before, began = spent(), time.perf_counter()
            try:
                r = mesh(way, cloud, size)
                row |= {"result": "meshed", "gamma_min": r["gamma_min"], "gamma_mean": r["gamma_mean"], "tets": r["tets"],
                        "step_over_size": r["step_length_min_m"] / size, "volume_before": r["volume_error_before"]}  # fmt: skip
            except (SplatError, ValueError, RuntimeError) as problem:
                row["result"] = f"failed: {problem}"[:200]
            new = table.add({**row, "cpu_s": spent() - before})
            print(
                ", ".join(new[c] for c in COLUMNS[:7]),
                f"{new['cpu_s']} s, wall {time.perf_counter() - began:.1f}",
                flush=True,
            )
    for way in a.ways:
        rows = [row for row in table.rows if row["way"] == way]
        passed = [row for row in rows if row["result"] == "meshed"]
        values = {
            c: [float(row[c]) for row in passed if row[c]]
            for c in ("gamma_min", "step_over_size", "volume_before", "cpu_s")
        }
        medians = ", ".join(f"{c} {np.median(v):.3g} (worst {max(v, key=abs) if c in ('volume_before', 'cpu_s') else min(v):.3g})"
                            for c, v in values.items() if v)  # fmt: skip
        print(f"{way}: {len(passed)} of {len(rows)} through all gates; {medians}")


if __name__ == "__main__":
    main()
