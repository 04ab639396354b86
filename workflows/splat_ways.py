"""Our surface, remesher and volume correction against those of open3d, on the clouds of the battery: docs/tables/splat_ways.csv.

    python workflows/splat_ways.py [--most 6000] [--only PART] [--clouds DIR] [--summary]

Ways: `ours` (the default: carried surface, else density; level set; remeshed), `density` (the same without the carried surface),
`decimated` (the default's level set, thinned by quadric decimation and smoothed by Taubin's filter in place of our remesher), `poisson`
(Poisson reconstruction of the points at the rim, with normals of the density, remeshed). All go through the same gates at the first
try, at one element size, with kernels and open3d loaded. most: points of
the largest cloud. Clouds in DIR and rows in the table are not computed again.
"""

import itertools
from functools import partial

import numpy as np
import open3d as o3d
import splat_clouds
from pages import markdown, options, study_table
from splat_battery import CLOUDS, SIZE_OVER_SPACING, cloud_of, spent, warm_up

from coupler.errors import SplatError
from coupler.geometry import mesher
from coupler.geometry.apart import apart
from coupler.geometry.remesh import even
from coupler.geometry.solid import check_solid
from coupler.geometry.tetrahedra import boundary_faces
from coupler.geometry.triangles import enclosed_volume, surface_area
from coupler.splat import field as fields
from coupler.splat import meshing, surface
from coupler.splat.cloud import Cloud, Report
from coupler.splat.convert import separate_bodies
from coupler.studies.table import Row

COLUMNS = ("cloud", "kind", "way", "points", "result", "gamma_min", "gamma_mean", "step_over_size", "volume_before", "area", "tets",
           "cpu_s")  # fmt: skip
WAYS = ["ours", "density", "decimated", "poisson"]
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


def mesh(way: str, cloud: Cloud, size: float) -> dict[str, object]:
    """The bodies of a cloud by one way at the first try, as a row: worst measures, volume of the largest body before it is corrected,
    area over that of the carried surface less 1, elements. Raises SplatError where a gate is not passed."""
    method = "carried" if cloud.surface is not None and way != "density" else "density"
    reports, area = [], 0.0
    for _, shape in separate_bodies(cloud, size, method):
        points, tets, report = (
            poisson_mesh(shape.cloud, size) if way == "poisson" else strategy_mesh(way, method, shape, size)
        )
        reports.append(report)
        area += surface_area(points, boundary_faces(tets)[0])
    kept = "" if cloud.surface is None else area / surface_area(*cloud.surface) - 1.0
    return {
        "result": "meshed", "gamma_min": min(r["gamma_min"] for r in reports), "gamma_mean": reports[0]["gamma_mean"],
        "step_over_size": min(r["step_length_min_m"] / size for r in reports), "volume_before": reports[0]["volume_error_before"],
        "area": kept, "tets": sum(r["tets"] for r in reports),
    }  # fmt: skip


def strategy_mesh(
    way: str, method: str, shape: meshing.CloudShape, size: float
) -> tuple[np.ndarray, np.ndarray, Report]:
    """Points, tetrahedra and report of the first strategy, with open3d's decimation in place of our remesher for "decimated"."""
    ours = meshing.even
    try:
        if way == "decimated":
            meshing.even = decimated
        return meshing.build_mesh(meshing.Strategy(method, "HXT"), shape, size, {}, 40.0)
    finally:
        meshing.even = ours


def poisson_mesh(cloud: Cloud, size: float) -> tuple[np.ndarray, np.ndarray, Report]:
    """Points, tetrahedra and report by the reconstruction, with our volume correction, checks and gates."""
    shells, solid = poisson(cloud, size), cloud.solid_volume
    before = sum(enclosed_volume(*shell) for shell in shells) / solid - 1.0
    shells, _ = surface.correct_volume(shells, solid, cloud.spacing)
    for shell in shells:
        check_solid(*shell)
    points, tets = apart(partial(mesher.fill, shells, size, mesher.HXT, 0.45), 120.0)
    report: Report = {"volume_error_before": before, **meshing.check_mesh(points, tets, solid, size)}
    return points, tets, report


def main() -> None:
    """Compute the rows that the table lacks."""
    a = options(__doc__, "summary", clouds=CLOUDS, most=6000, only="", ways=WAYS)
    table = study_table("splat_ways", COLUMNS, ("cloud", "way"), "OMP_NUM_THREADS=1 python workflows/splat_ways.py")
    if not a.summary:
        warm_up()
    for name, (kind, make) in splat_clouds.every().items():
        if a.summary or a.only not in name or all((name, way) in table for way in a.ways):
            continue
        cloud = cloud_of(name, a.clouds, make)
        for way in a.ways if len(cloud.x) <= a.most else ():
            if (name, way) in table:
                continue
            row: dict[str, object] = {"cloud": name, "kind": kind, "way": way, "points": len(cloud.x)}
            before = spent()
            try:
                row |= mesh(way, cloud, SIZE_OVER_SPACING * cloud.spacing)
            except (SplatError, ValueError, RuntimeError) as problem:
                row["result"] = f"failed: {problem}"[:200]
            new = table.add({**row, "cpu_s": spent() - before})
            print(*(new[c] or "-" for c in COLUMNS), flush=True)
    print("\n".join(summary(table.rows)))


def summary(rows: list[Row]) -> list[str]:
    """The ways side by side, as a table in Markdown: medians, in brackets the worst."""
    lines = []
    for kind, way in itertools.product(("impact", "synthetic", "splat"), WAYS):
        own = [row for row in rows if row["way"] == way and row["kind"] == kind]
        passed = [row for row in own if row["result"] == "meshed"]
        cells = [f"{len(passed)} of {len(own)}"]
        for name, factor, form, worst in (
            ("gamma_min", 1.0, "{:.2f}", min), ("step_over_size", 1.0, "{:.3f}", min), ("volume_before", 100.0, "{:+.1f} %", max),
            ("area", 100.0, "{:+.1f} %", max), ("cpu_s", 1.0, "{:.1f}", max),
        ):  # fmt: skip
            values = [factor * float(row[name]) for row in passed if row[name]]
            extreme = worst(values, key=abs, default=float("nan"))
            cells.append(f"{form.format(float(np.median(values)))} ({form.format(extreme)})" if values else "-")
        lines.append([f"{kind}, {way}", *cells])
    return markdown(
        "| clouds, way | all gates passed | worst gamma | worst step length over edge | volume before | area | seconds",
        lines,
    )


if __name__ == "__main__":
    main()
