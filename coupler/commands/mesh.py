"""The command `coldspray mesh`: it converts points, from a run or from a file, to a mesh of tetrahedra in a common file format."""

import argparse
import contextlib
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import SplatError
from ..files.inputs import reading, require_memory
from ..files.outputs import MARK, claim_file, kind_of, replacing
from ..units import UnitError, parse, rounded
from .arguments import Commands, add_command, add_force, path, quantity, working

if TYPE_CHECKING:
    import numpy as np

    from ..splat.cloud import Cloud, Splat

METHODS = ("auto", "carried", "density")
SIZE_OVER_SPACING = 1.7  # as the target's elements
SUFFIXES = (".vtu", ".vtk", ".msh", ".xdmf", ".inp")  # those that meshio writes as one file
_MOST_SPACING = 1e-3  # m: a larger spacing means that the file has another unit
_MEMORY_EACH = 3000.0  # bytes for each point: 2000 measured from 5000 to 40 000 points, at the default size
_SI = {"T": "K", "energy": "J", "volume": "m3"}
_SWAP = [0, 1, 2, 4, 5, 3]  # stress from the order of VTK, xx yy zz xy yz xz, to that of `Cloud`, xx yy zz yz xz xy
_SWAP_BACK = [0, 1, 2, 5, 3, 4]  # the inverse


def add(commands: Commands) -> None:
    option = add_command(commands, "mesh", run, "convert points, from a run or from a file, to a mesh of tetrahedra")
    text = "folder of a run, or a file of points: .csv, .xyz, .npz, or any format of meshio"
    option("cloud", type=path, metavar="CLOUD", help=text)
    option("--out", type=path, metavar="FILE", help=f"{', '.join(SUFFIXES)} (default: beside CLOUD, .vtu)")
    add_force(option)
    option("--method", choices=METHODS, default="auto", help="source of the surface (default: auto)")
    for name, form, text in (
        ("--size", "{}", f'element size, such as "1.2 um" (default: {SIZE_OVER_SPACING} spacings)'),
        ("--spacing", "{}", "spacing of the undeformed points (default: that of the run, or an estimate)"),
        ("--unit", "1 {}", "unit of the coordinates: mm, um, nm, m (default: from the column headings, or m)"),
    ):
        option(name, type=quantity(name, "length", form=form), metavar="L", help=text)
    text = "names of the columns of a text file in their order, such as 'x y z T'; - leaves a column out (default: detected)"
    option("--columns", metavar="NAMES", help=text)
    option("--step", type=int, metavar="N", default=-1, help="stored step of the run (default: the last)")


def run(arguments: argparse.Namespace) -> int:
    from ..splat.convert import convert

    source: Path = arguments.cloud
    out = arguments.out or (source / "splat.vtu" if source.is_dir() else source.with_name(f"{source.stem}_mesh.vtu"))
    in_its_run = arguments.out is None and kind_of(out.parent) == "run"
    claim_file(out, SUFFIXES, [source], arguments.force or in_its_run)
    if source.is_dir():
        with reading(source):
            cloud, notes = of_run(source, arguments.step, arguments.spacing)
    else:
        cloud, notes = of_file(source, arguments.spacing, arguments.unit, arguments.columns)
    size = arguments.size or SIZE_OVER_SPACING * cloud.spacing
    require_memory(_MEMORY_EACH * len(cloud.x), f"to mesh {len(cloud.x)} points")
    with working("meshing the points"):
        splat = convert(cloud, size, arguments.method)
    write(out, splat)
    _show(cloud, splat, notes)
    print(f"mesh in {out}")
    return 0


def of_run(folder: Path, step: int = -1, spacing: float | None = None) -> tuple["Cloud", list[str]]:
    """The particle of a run at a stored step, with its surface, and remarks. spacing, m: by default that of the run. Raises SplatError
    if the run has no such step, StoreError if it cannot be read."""
    import numpy as np

    from ..core.records import rows_of
    from ..files.result import Result, impact_at
    from ..physics.metal import MetalState
    from ..physics.shapes import sphere_volume
    from ..plan.record import read_plan
    from ..splat.cloud import Cloud

    result = Result(folder)
    try:
        fields = result.fields(step)
    except IndexError as problem:
        raise SplatError(f"--step {step}: {problem}") from None
    impact = read_plan(folder).impacts[impact_at(result, fields.time) - 1]
    spacing = spacing or (sphere_volume(impact.diameter) / len(fields.points)) ** (1.0 / 3.0)
    skin = np.flatnonzero(np.isclose(result.times("surface"), fields.time, rtol=0.0, atol=0.25e-15))
    whole = result.fields(int(skin[-1]), "surface") if len(skin) else None
    surface = (whole.points, whole.cells) if whole is not None else None
    notes = [] if surface else ["no surface is stored at this step: the shape follows from the points"]
    data = {name: values.astype(float) for name, values in fields.data.items()}
    cloud = Cloud(
        fields.points, np.full(len(fields.points), spacing**3), spacing, impact.material.rho, velocity=data.get("velocity"),
        stress=data["stress"][:, _SWAP] if "stress" in data else None, surface=surface, wave_speed=impact.wave_speed,
        core=data["core"] > 0.5 if "core" in data else None,
        **{name: data[name] for name in rows_of(MetalState) if name in data},
    )  # fmt: skip
    return cloud, notes


def of_file(
    path: Path, spacing: float | None = None, unit: float | None = None, columns: str | None = None
) -> tuple["Cloud", list[str]]:
    """The points of a file, with the fields that a `Cloud` has, and remarks. spacing: None: from the volumes, or estimated; unit: unit
    of the coordinates, m; columns: names of the columns of a text file. Raises InputError if the file cannot be read, holds a surface
    or has no points, SplatError if the points lie on a surface or form no body."""
    import numpy as np

    from ..core.records import rows_of
    from ..files.clouds import read_points
    from ..geometry.points import cleaned, is_shell
    from ..splat.cloud import Cloud

    names = None if columns is None else columns.replace(",", " ").split()
    shapes = {name: spec.shape[1:] for name, spec in rows_of(Cloud).items() if name != "x"}
    points = read_points(path, tuple(name.lower() for name in shapes), names)
    fields: dict[str, Any] = {}
    notes = [*points.notes]
    x = points.x * _unit(points.units.get("x", ""), unit, notes)
    for name, values in points.fields.items():
        known = next((own for own in shapes if own.lower() == name.lower()), None)
        values = np.asarray(values)
        values = values[:, 0] if values.ndim == 2 and values.shape[1] == 1 else values
        if known is None or values.shape != (len(x), *shapes[known]):
            notes.append(f"field {name!r} is left out: it is not one of {', '.join(shapes)}, or its size is wrong")
        elif (in_si := _in_si(known, values.astype(float), points.units.get(name, ""))) is None:
            notes.append(f"field {name!r} is left out: its unit {points.units[name]!r} is unknown")
        else:
            fields[known] = in_si
    if "stress" in fields:
        fields["stress"] = fields["stress"][:, _SWAP]
    if "core" in fields:
        fields["core"] = fields["core"] > 0.5
    volume = fields.pop("volume", None)
    if spacing is None:
        spacing = estimated_spacing(x) if volume is None else float(np.cbrt(np.median(volume)))
        if volume is None:
            hint = "the volume depends on the spacing: give --spacing if you know it"
            notes.append(f"the spacing is estimated: {rounded(spacing, 'um')} ({hint})")
        if spacing > _MOST_SPACING:
            hint = "give the unit of the file, such as --unit um"
            notes.append(f"the points are {spacing:.3g} m apart, which is too far for a particle: {hint}")
    if volume is None:
        volume = np.full(len(x), spacing**3)
    index, left_out = cleaned(x, spacing)
    cloud = Cloud(x, volume, spacing, 1.0, **fields)
    cloud = cloud.part(index) if left_out else cloud
    cloud.check()
    if is_shell(cloud.x):
        raise SplatError(f"the points of {path} lie on a surface: give points in the whole volume of the body")
    return cloud, [*notes, *left_out]


def _unit(of_file: str, given: float | None, notes: list[str]) -> float:
    """The unit of the coordinates, in m: `given` (--unit), else `of_file` ("" if the file names none), else 1. notes: gets a remark
    about a unit from the file. Raises SplatError if the two differ, or if `of_file` is unknown and `given` is None."""
    if not of_file:
        return given or 1.0
    try:
        named = parse(f"1 {of_file}", "length")
    except UnitError as problem:
        if given is not None:
            return given
        text = f"the unit of x, y and z, {of_file!r:.20}: {problem}. Correct it, or give --unit"
        raise SplatError(text) from None
    if given is None:
        notes.append(f"the unit of the coordinates is {of_file}, from the column headings")
    elif given != named:
        text = f"--unit differs from the unit of x, y and z in the file, {of_file}: leave it out, or correct the file"
        raise SplatError(text)
    return named


def _in_si(field: str, values: "np.ndarray", unit: str) -> "np.ndarray | None":
    """Values of a field in SI units. Accepted units: the SI unit of the field; "", "-" and "1", which stand for it; for T, all
    temperature units. For any other unit: None."""
    if unit in ("", "-", "1", _SI.get(field, "")):
        return values
    try:
        zero, one = (parse(f"{k} {unit}", "temperature") for k in (0, 1))
    except UnitError:
        return None
    return zero + (one - zero) * values if field == "T" else None


def estimated_spacing(x: "np.ndarray") -> float:
    """Estimate of the spacing (m) of points x (n, 3). For each point, the mean edge of its cube follows from the distances to its 8th
    to 24th neighbours. The result is the lower quartile of these edges, because they are smallest inside the body. Error: at most 3 %
    for lattices and scattered points. Raises SplatError for values that are not finite, fewer than 25 points, or many duplicates."""
    import numpy as np
    from scipy.spatial import cKDTree

    if not np.isfinite(x).all():
        bad = np.flatnonzero(~np.isfinite(x).all(axis=1))
        text = f"x of {len(bad)} points is not a number (first: point {bad[0]}): remove or correct these points"
        raise SplatError(text)
    k = np.arange(8, 25)
    if len(x) <= k[-1]:
        raise SplatError(f"the cloud has {len(x)} points, which is too few for a body: give more points")
    distance = cKDTree(x).query(x, k=k[-1] + 1)[0][:, k]
    edge = distance * (4.0 / 3.0 * np.pi / (k + 0.5)) ** (1.0 / 3.0)
    spacing = float(np.percentile(edge.mean(axis=1), 25))
    if not spacing > 0.0:
        raise SplatError("most points of the cloud have the same coordinates as others: remove the duplicates")
    return spacing


def write(path: Path, splat: "Splat") -> None:
    """Write all bodies of a splat with their fields to one file. Cell fields: `body` is the index of the body; `core` is 1 in the core
    of a composite particle, as in target.vtkhdf. Raises SplatError if the file cannot be written."""
    import meshio
    import numpy as np

    from ..core.records import rows_of
    from ..geometry.triangles import together
    from ..physics.metal import MetalState

    points, tets = together([(body.points, body.tets) for body in splat.bodies])
    each, is_core = [len(body.tets) for body in splat.bodies], [body.is_core for body in splat.bodies]
    cells: dict[str, np.ndarray] = {"body": np.repeat(np.arange(len(each)), each)}
    if any(is_core):
        cells["core"] = np.repeat(np.array(is_core, float), each)
    nodes: dict[str, np.ndarray] = {}
    gmsh = path.suffix.lower() == ".msh"
    for into, names in ((cells, ("stress", *rows_of(MetalState), "J")), (nodes, ("velocity", "energy"))):
        for name in names:
            if vars(splat.bodies[0])[name] is not None:
                into[name] = np.concatenate([vars(body)[name] for body in splat.bodies])
    if "stress" in cells:  # gmsh knows whole tensors only, row by row
        cells["stress"] = cells["stress"][:, [0, 5, 4, 5, 1, 3, 4, 3, 2] if gmsh else _SWAP_BACK]
    mesh = meshio.Mesh(points, [("tetra", tets)], nodes, {name: [values] for name, values in cells.items()})
    kind = {"file_format": "gmsh22"} if gmsh else {"data_format": "XML"} if path.suffix.lower() == ".xdmf" else {}
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output), replacing(path) as part:
            meshio.write(part, mesh, **kind)
            if path.suffix.lower() == ".vtu":
                with part.open("a", encoding="utf-8") as file:
                    file.write(f"<!-- {MARK} -->\n")
    except (meshio.WriteError, KeyError, ValueError, SystemExit) as problem:
        raise SplatError(f"cannot write {path}: {problem}") from problem


def _show(cloud: "Cloud", splat: "Splat", notes: list[str]) -> None:
    from rich.console import Console
    from rich.table import Table

    r, t = splat.report, splat.report["transfer"]
    cores = sum(body.is_core for body in splat.bodies)
    table = Table(title="from points to tetrahedra", title_justify="left", show_header=False)
    rows = {
        "points": f"{len(cloud.x)}, {cloud.spacing * 1e6:.3g} um apart",
        "method": r["method"],
        "bodies": f"{len(splat.bodies)}"
        + (f", {cores} of these cores" if cores else "")
        + (f", and {r['lost_points']} points lost" if r["lost_points"] else ""),
        "tetrahedra": f"{r['tets']}, {r['nodes']} nodes, element size {r['element_size_m'] * 1e6:.3g} um",
        "quality": f"gamma {r['gamma_min']:.2f} least, {r['gamma_mean']:.2f} mean; least dihedral angle"
        f" {r['dihedral_min_deg']:.0f} deg",
        "explicit step": f"{r['step_length_min_m'] * 1e6:.3g} um / wave speed"
        + (f" = {r['dt_s'] * 1e12:.3g} ps" if "dt_s" in r else ""),
        "volume": f"{r['volume_error_before']:+.2%} before the correction by {r['moved_m'] * 1e6:+.2g} um",
        "width": f"{r['width_m'] * 1e6:.4g} um (source {r['source_width_m'] * 1e6:.4g} um)",
        "points outside": f"{r['outside_half']:.2%} by more than half a spacing, at most {r['outside_max']:.2g} spacings",
        "momentum": f"{t['momentum']:.0e} linear, {t['angular_momentum']:.0e} angular" if "momentum" in t else "",
        "time": f"{r['wall_s']:.1f} s",
    }  # fmt: skip
    for name, text in rows.items():
        if text:
            table.add_row(name, text)
    console = Console()
    console.print(table)
    for note in [*(f"this method failed: {f}" for f in r["failed"]), *notes]:
        console.print(note, markup=False, highlight=False)
