"""The command `coldspray mesh`: the points of a run, or of any file, become tetrahedra in a file that others read."""

import argparse
import contextlib
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import SplatError

if TYPE_CHECKING:
    import numpy as np

    from ..splat.cloud import Cloud, Splat

METHODS = ("auto", "carried", "density", "stuffing", "paper")
SIZE_OVER_SPACING = 1.7  # as the target's elements
LARGEST_FILE = 2 * 1024**3  # bytes
_TEXT = (".csv", ".xyz", ".txt", ".dat")
_COLUMNS = {"velocity": 3, "stress": 6, "eps_p": 1, "T": 1, "J": 1, "energy": 1, "volume": 1}
_SWAP = [0, 1, 2, 4, 5, 3]  # stress between ours, xx yy zz yz xz xy, and VTK's order, xx yy zz xy yz xz
_SWAP_BACK = [0, 1, 2, 5, 3, 4]


def add(commands: Any) -> None:
    """Add the command to a parser's subcommands."""
    parser = commands.add_parser("mesh", help="turn points into tetrahedra: of a run, or of any file of points")
    parser.set_defaults(command=run)
    option = parser.add_argument
    option(
        "cloud", type=Path, metavar="CLOUD", help="folder of a run, or a file: .csv, .xyz, .npz, or what meshio reads"
    )
    option(
        "--out",
        type=Path,
        metavar="FILE",
        help="what meshio writes: .vtu, .vtk, .msh ... (default: beside CLOUD, .vtu)",
    )
    option("--method", choices=METHODS, default="auto", help="where the surface comes from (default: auto)")
    option("--size", metavar="L", help=f'element size, such as "1.2 um" (default: {SIZE_OVER_SPACING} spacings)')
    option("--spacing", metavar="L", help="of the points before they were deformed (default: the run's, or estimated)")
    option("--unit", metavar="U", default="m", help="of the coordinates in a file: m (default), mm, um, nm")
    option("--step", type=int, metavar="N", default=-1, help="step of a run (default: the last)")


def run(arguments: argparse.Namespace) -> int:
    """Do what the command line asks for. Returns the exit code. Raises ColdsprayError for what a user can mend."""
    from .. import units
    from ..splat.convert import convert

    def length(name: str, text: str | None) -> float | None:
        if text is None:
            return None
        try:
            value = units.parse(text, "length")
        except units.UnitError as error:
            raise SplatError(f"--{name} {text}: {error}") from None
        if not value > 0.0:
            raise SplatError(f"--{name} {text}: must be more than zero")
        return value

    size, spacing, unit = (length(n, t) for n, t in (
        ("size", arguments.size), ("spacing", arguments.spacing), ("unit", f"1 {arguments.unit}")))  # fmt: skip
    source: Path = arguments.cloud
    out = arguments.out or (source / "splat.vtu" if source.is_dir() else source.with_name(f"{source.stem}_mesh.vtu"))
    if out.resolve() == source.resolve():
        raise SplatError(f"{out} is the file to read: choose another with --out")
    _check_suffix(out)
    if source.is_dir():
        cloud, notes = of_run(source, arguments.step, spacing)
    else:
        cloud, notes = of_file(source, spacing, unit or 1.0)
    splat = convert(cloud, size or SIZE_OVER_SPACING * cloud.spacing, arguments.method)
    write(out, splat)
    _show(cloud, splat, notes)
    print(f"mesh in {out}")
    return 0


def of_run(folder: Path, step: int = -1, spacing: float | None = None) -> tuple["Cloud", list[str]]:
    """The particle of a run's folder at a stored step, with its carried surface; and remarks. Raises StoreError, SceneError."""
    import numpy as np

    from ..files.result import Result
    from ..plan.reading import Scene
    from ..splat.cloud import Cloud

    result = Result(folder)
    try:
        fields = result.fields(step)
    except IndexError as problem:
        raise SplatError(f"--step {step}: {problem}") from None
    scene = Scene.from_text(result.scene_text, str(folder / "scene.toml"))
    metal = scene.derived.material(scene.particle.material)
    spacing = spacing or float(result.summary.get("spacing_m") or scene.derived.spacing)
    times = result.times("surface")
    skin = np.flatnonzero(np.isclose(times, fields.time, rtol=1e-9, atol=0.0))
    surface, notes = None, []
    if len(skin):
        whole = result.fields(int(skin[-1]), "surface")
        surface = whole.points, whole.cells
    else:
        notes.append("no surface was stored at this step: the shape is taken from the points")
    data = {name: values.astype(float) for name, values in fields.data.items()}
    cloud = Cloud(
        fields.points, np.full(len(fields.points), spacing**3), spacing, metal.rho, velocity=data.get("velocity"),
        stress=data["stress"][:, _SWAP] if "stress" in data else None, eps_p=data.get("eps_p"), T=data.get("T"),
        surface=surface, wave_speed=metal.wave_speed,
    )  # fmt: skip
    return cloud, notes


def of_file(path: Path, spacing: float | None = None, unit: float = 1.0) -> tuple["Cloud", list[str]]:
    """The points of a file in units of `unit` m, with the fields whose names we know; and remarks.

    Raises SplatError if it cannot be read or has no points.
    """
    import numpy as np

    from ..splat.cloud import Cloud

    try:
        if path.stat().st_size > LARGEST_FILE:
            raise SplatError(f"{path} is larger than {LARGEST_FILE // 1024**3} GiB")
        reader = _npz if path.suffix == ".npz" else _table if path.suffix in _TEXT else _meshio
        points, data = reader(path)
    except FileNotFoundError:
        raise SplatError(f"{path} is not there") from None
    except (OSError, ValueError, KeyError, UnicodeDecodeError) as problem:
        raise SplatError(f"cannot read {path}: {problem}") from problem
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise SplatError(f"{path} has no points with x, y and z (found an array of shape {points.shape})")
    x = np.ascontiguousarray(points, float) * unit
    fields, notes = {}, []
    for name, values in data.items():
        known = next((own for own in _COLUMNS if own.lower() == name.lower()), None)
        values = np.asarray(values)
        values = values[:, 0] if values.ndim == 2 and values.shape[1] == 1 else values
        columns = (3, 3) if known is None else (_COLUMNS[known],)
        if known is None or values.shape != ((len(x),) if columns == (1,) else (len(x), *columns)):
            notes.append(f"field {name!r} left out: not one of {', '.join(_COLUMNS)}, or of another shape")
        else:
            fields[known] = values.astype(float)
    if "stress" in fields:
        fields["stress"] = fields["stress"][:, _SWAP]
    volume = fields.pop("volume", None)
    if spacing is None:
        spacing = estimated_spacing(x) if volume is None else float(np.cbrt(np.median(volume)))
        if volume is None:
            notes.append(f"spacing estimated: {spacing:.4g} m (say --spacing if you know it; the volume hangs on it)")
    if volume is None:
        volume = np.full(len(x), spacing**3)
    given: dict[str, Any] = fields
    return Cloud(x, volume, spacing, 1.0, **given), notes


def estimated_spacing(x: "np.ndarray") -> float:
    """Edge of the cube that each of points x (n,3) has to itself, from the distances to neighbours; m.

    Half the points see the ball that the k-th neighbour touches filled with k points and half of it; averaged over k, and
    taken where neighbours are densest, inside the body. Within 3 % for lattices and scattered points. Raises SplatError.
    """
    import numpy as np
    from scipy.spatial import cKDTree

    if not np.isfinite(x).all():
        bad = np.flatnonzero(~np.isfinite(x).all(axis=1))
        raise SplatError(f"x of {len(bad)} points is not a number (first: point {bad[0]}): remove or mend them")
    k = np.arange(8, 25)
    if len(x) <= k[-1]:
        raise SplatError(f"the cloud has {len(x)} points, too few for a body: use a finer resolution")
    distance = cKDTree(x).query(x, k=k[-1] + 1)[0][:, k]
    edge = distance * (4.0 / 3.0 * np.pi / (k + 0.5)) ** (1.0 / 3.0)
    spacing = float(np.percentile(edge.mean(axis=1), 25))
    if not spacing > 0.0:
        raise SplatError("most points of the cloud lie on top of others: remove the doubles")
    return spacing


def _npz(path: Path) -> tuple["np.ndarray", dict[str, Any]]:
    import zipfile

    import numpy as np

    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except zipfile.BadZipFile as problem:
        raise ValueError(str(problem)) from None
    for name in ("points", "x"):
        if name in arrays:
            points = arrays.pop(name)
            return points, {k: v for k, v in arrays.items() if len(np.shape(v)) and len(v) == len(points)}
    raise ValueError("it has no array 'points' or 'x'")


def _table(path: Path) -> tuple["np.ndarray", dict[str, Any]]:
    """Columns x, y, z and others by the names in the first line; without names the first three (of .xyz: after the element)."""
    import numpy as np

    lines = [line.replace(",", " ").replace(";", " ").split() for line in path.read_text(encoding="utf-8").splitlines()]
    lines = [line for line in lines if line and not line[0].startswith("#")]
    if path.suffix == ".xyz" and lines and len(lines[0]) == 1 and lines[0][0].isdigit():
        count = int(lines[0][0])
        lines = lines[len(lines) - count :]  # the comment line may be empty and gone
    if not lines:
        raise ValueError("it is empty")
    names: list[str] = []
    if not any(_is_number(word) for word in lines[0]):
        names, lines = [word.strip('"') for word in lines[0]], lines[1:]
    elif lines[0] and not _is_number(lines[0][0]):  # the element's symbol of an .xyz file
        lines = [line[1:] for line in lines]
    widths = {len(line) for line in lines}
    if len(widths) != 1:
        raise ValueError("its lines have different numbers of columns")
    table = np.array([[float(word) for word in line] for line in lines])
    if not names:
        return table[:, :3], {}
    at = {name.lower(): i for i, name in enumerate(names)}
    if not {"x", "y", "z"} <= at.keys():
        raise ValueError(f"its columns are {', '.join(names)}: x, y and z are needed")
    data = {name: table[:, i] for i, name in enumerate(names) if name.lower() not in ("x", "y", "z")}
    return table[:, [at["x"], at["y"], at["z"]]], data


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _meshio(path: Path) -> tuple["np.ndarray", dict[str, Any]]:
    import meshio

    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            mesh = meshio.read(path)
    except (meshio.ReadError, SystemExit) as problem:  # meshio leaves by sys.exit where several readers have failed
        if not path.exists():
            raise FileNotFoundError(path) from None
        raise ValueError(str(problem) if str(problem) not in ("1", "") else "not in a format meshio reads") from None
    except OSError:
        raise
    except Exception as problem:  # its readers raise whatever comes up on a damaged file
        raise ValueError(f"damaged? ({type(problem).__name__}: {problem})") from problem
    return mesh.points, dict(mesh.point_data)


def _check_suffix(path: Path) -> None:
    """Refuse a file meshio cannot write before hours are spent."""
    import meshio

    known = meshio.extension_to_filetypes
    if path.suffix.lower() not in known:
        good = ", ".join(s for s in (".vtu", ".vtk", ".msh", ".xdmf", ".inp") if s in known)
        raise SplatError(f"cannot write {path}: no format has the suffix {path.suffix!r}; use one of {good}")


def write(path: Path, splat: "Splat") -> None:
    """All bodies of a splat with their fields in one file; the cell field `body` numbers them. Raises SplatError."""
    import meshio
    import numpy as np

    offsets = np.cumsum([0, *(len(body.points) for body in splat.bodies)])
    points = np.concatenate([body.points for body in splat.bodies])
    tets = np.concatenate([body.tets + at for body, at in zip(splat.bodies, offsets, strict=False)])
    cells: dict[str, Any] = {"body": np.repeat(np.arange(len(splat.bodies)), [len(b.tets) for b in splat.bodies])}
    nodes: dict[str, Any] = {}
    gmsh = path.suffix.lower() == ".msh"
    for into, names in ((cells, ("stress", "eps_p", "T", "J")), (nodes, ("velocity", "energy"))):
        for name in names:
            if getattr(splat.bodies[0], name) is not None:
                into[name] = np.concatenate([getattr(body, name) for body in splat.bodies])
    if "stress" in cells:  # gmsh knows whole tensors only, row by row
        cells["stress"] = cells["stress"][:, [0, 5, 4, 5, 1, 3, 4, 3, 2] if gmsh else _SWAP_BACK]
    mesh = meshio.Mesh(points, [("tetra", tets)], nodes, {name: [values] for name, values in cells.items()})
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            meshio.write(path, mesh, file_format="gmsh22" if gmsh else None)
    except (meshio.WriteError, OSError, KeyError, ValueError, SystemExit) as problem:
        raise SplatError(f"cannot write {path}: {problem}") from problem


def _show(cloud: "Cloud", splat: "Splat", notes: list[str]) -> None:
    from rich.console import Console
    from rich.table import Table

    r, t = splat.report, splat.report["transfer"]
    table = Table(title="from points to tetrahedra", title_justify="left", show_header=False)
    rows = {
        "points": f"{len(cloud.x)}, {cloud.spacing * 1e6:.3g} um apart",
        "method": r["method"],
        "bodies": f"{len(splat.bodies)}" + (f", and {r['lost_points']} points lost" if r["lost_points"] else ""),
        "tetrahedra": f"{r['tets']}, {r['nodes']} nodes, element size {r['element_size_m'] * 1e6:.3g} um",
        "quality": f"gamma {r['gamma_min']:.2f} least, {r['gamma_mean']:.2f} mean; least dihedral angle"
        f" {r['dihedral_min_deg']:.0f} deg",
        "explicit step": f"{r['step_length_min_m'] * 1e6:.3g} um / wave speed"
        + (f" = {r['dt_s'] * 1e12:.3g} ps" if "dt_s" in r else ""),
        "volume": f"{r['volume_error_before']:+.2%} before it was put right by {r['moved_m'] * 1e6:+.2g} um",
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
    for note in [*(f"not passed: {m}" for m in r["missed"]), *(f"tried before: {f}" for f in r["failed"]), *notes]:
        console.print(note, markup=False, highlight=False)
