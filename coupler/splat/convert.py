"""A finished splat's cloud of points becomes tetrahedral bodies with its state: the door of this room.

The work is done by `worker` in a process of its own, which may crash or hang: gmsh ends with a segmentation fault on some
bad surfaces. What it was trying is then struck off the ladder and another process goes on with the next.
"""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import tempfile
import time as clock
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..errors import SplatError
from .surface import open_or_double

METHODS = ("auto", "carried", "density", "stuffing", "paper")
WORKER = "coupler.splat.worker"
FEWEST = 50  # points of a body
MOST_ELEMENTS = 5e6
TETS_PER_SIZE3 = 4.2  # in a volume size^3, as gmsh makes them
START = 300.0  # s, before the first try: imports, and the kernels where they must be compiled
_FIELDS = {"velocity": 3, "stress": 6, "eps_p": 0, "T": 0, "J": 0, "energy": 0, "X": 3}  # name -> columns


@dataclass(frozen=True)
class Cloud:
    """Points of one splat and what they carry; fields the cloud does not have are None. SI units.

    x (n,3); volume (n,): reference volume of each; spacing: of the undeformed points, the edge of a cube of that volume;
    rho: reference density, kg/m3. velocity (n,3); stress (n,6): Cauchy, Voigt xx yy zz yz xz xy; eps_p, T (n,); J (n,): volume
    ratio; energy (n,): J per reference m3. surface: vertices (k,3) and outward triangles (m,3) of the body's carried
    surface in its deformed place, cavities too; X (n,3): reference positions. wave_speed: m/s, for the explicit time
    step in the report.
    """

    x: np.ndarray
    volume: np.ndarray
    spacing: float
    rho: float
    velocity: np.ndarray | None = None
    stress: np.ndarray | None = None
    eps_p: np.ndarray | None = None
    T: np.ndarray | None = None
    J: np.ndarray | None = None
    energy: np.ndarray | None = None
    surface: tuple[np.ndarray, np.ndarray] | None = None
    X: np.ndarray | None = None
    wave_speed: float | None = None

    @property
    def mass(self) -> np.ndarray:
        """(n,) kg."""
        return self.rho * self.volume

    @property
    def current_volume(self) -> np.ndarray:
        """(n,) m3, as deformed."""
        return self.volume if self.J is None else self.volume * self.J

    @property
    def solid_volume(self) -> float:
        """Volume of the metal now, m3."""
        return float(self.current_volume.sum())

    def part(self, index: np.ndarray) -> "Cloud":
        """The cloud of some of its points; the surface stays whole."""
        kept = {n: getattr(self, n)[index] for n in ("x", "volume", *_FIELDS) if getattr(self, n) is not None}
        return replace(self, **kept)

    def check(self) -> None:
        """Raise SplatError for what no body can be made of: the message says which and what to do."""
        x = np.asarray(self.x)
        n = len(x)
        if x.ndim != 2 or x.shape[1] != 3:
            raise SplatError(f"points must be (n, 3) coordinates, got {x.shape}: give x, y and z of each point")
        if n < FEWEST:
            raise SplatError(f"the cloud has {n} points, {FEWEST} or more are needed: use a finer resolution")
        for name, columns in {"x": 3, "volume": 0, **_FIELDS}.items():
            values = getattr(self, name)
            if values is None:
                continue
            shape = (n, columns) if columns else (n,)
            if np.shape(values) != shape:
                raise SplatError(f"{name} must have the shape {shape}, has {np.shape(values)}")
            bad = np.flatnonzero(~np.isfinite(np.asarray(values).reshape(n, -1)).all(axis=1))
            if len(bad):
                raise SplatError(
                    f"{name} of {len(bad)} points is not a number (first: point {bad[0]}): remove or mend them"
                )
        for name in ("spacing", "rho"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise SplatError(f"{name} must be positive, is {getattr(self, name):g}")
        if not np.min(self.volume) > 0.0 or (self.J is not None and not np.min(self.J) > 0.0):
            raise SplatError("volume and J of every point must be positive")
        self._check_places(x)
        if self.surface is not None:
            vertices, triangles = self.surface
            if not np.isfinite(vertices).all():
                raise SplatError("the carried surface has vertices that are not numbers: leave it out, or mend it")
            if problem := open_or_double(np.asarray(triangles, np.int64)):
                raise SplatError(f"the carried surface is not closed ({problem}): leave it out, or mend it")

    def _check_places(self, x: np.ndarray) -> None:
        extent = np.linalg.svd(x - x.mean(axis=0), compute_uv=False) * np.sqrt(12.0 / len(x))
        if extent[2] < 0.05 * self.spacing:
            shape = "a line" if extent[1] < 0.05 * self.spacing else "a plane"
            raise SplatError(
                f"the points lie in {shape}: a body needs points in three dimensions, or a smaller spacing"
            )
        pairs = cKDTree(x).query(x, k=2)
        double = np.flatnonzero(pairs[0][:, 1] < 1e-4 * self.spacing)
        if len(double):
            i = int(double[0])
            other = next(int(k) for k in pairs[1][i] if k != i)  # either of the two may be named first
            raise SplatError(
                f"{len(double)} points lie on top of others (points {i} and {other} at one place): remove the doubles"
            )


@dataclass(frozen=True)
class Body:
    """One body of tetrahedra with its state; a field is None where the cloud has none. SI units.

    points (n,3); tets (m,4), positively oriented. In elements: stress (m,6) Cauchy, Voigt xx yy zz yz xz xy, eps_p, T, J
    (m,). At nodes: velocity (n,3), energy (n,) J per reference m3. mass_scale: sum over elements of rho V / J times
    it is the mass of the points of this body. cloud_index (k,): those points. report: measures of this body.
    """

    points: np.ndarray
    tets: np.ndarray
    mass_scale: float
    cloud_index: np.ndarray
    velocity: np.ndarray | None = None
    energy: np.ndarray | None = None
    stress: np.ndarray | None = None
    eps_p: np.ndarray | None = None
    T: np.ndarray | None = None
    J: np.ndarray | None = None
    report: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Splat:
    """What a cloud became. lost_mass: kg, of fragments too small for a body; report: see docs/splats.md."""

    bodies: list[Body]
    lost_mass: float
    report: dict[str, Any]


def convert(cloud: Cloud, element_size: float, method: str = "auto", time_limit: float = 120.0) -> Splat:
    """Mesh a cloud with elements of about element_size m and carry its state over.

    method: "auto" takes the carried surface where there is one, else the density of the points, and isosurface stuffing where
    neither can be filled; the others force one way. time_limit: s, for one try; what exceeds it is given up for the next.
    Raises SplatError for a cloud no body can be made of, or when every way has failed.
    """
    if method not in METHODS:
        raise SplatError(f"unknown method {method!r}: choose one of {', '.join(METHODS)}")
    if method == "carried" and cloud.surface is None:
        raise SplatError(
            "method 'carried' needs the carried surface of the body, and the cloud has none: use 'density'"
        )
    if method == "paper" and importlib.util.find_spec("open3d") is None:
        raise SplatError("method 'paper' needs the package open3d, which is not installed: install it, or use 'auto'")
    cloud.check()
    if not (np.isfinite(element_size) and element_size > 0.0):
        raise SplatError(f"element_size must be positive, is {element_size:g}")
    expected = TETS_PER_SIZE3 * cloud.solid_volume / element_size**3
    if expected > MOST_ELEMENTS:
        raise SplatError(
            f"elements of {element_size:.3g} m would be {expected:.2g} in this body: give a larger size, "
            f"at least {(TETS_PER_SIZE3 * cloud.solid_volume / MOST_ELEMENTS) ** (1 / 3):.3g} m"
        )
    started = clock.perf_counter()
    with tempfile.TemporaryDirectory(prefix="splat-") as name:
        folder = Path(name)
        _write(folder, cloud, {"element_size": element_size, "method": method})
        _work(folder, time_limit)
        splat = _read(folder, cloud)
    splat.report["wall_s"] = clock.perf_counter() - started
    return splat


def _write(folder: Path, cloud: Cloud, task: dict[str, Any]) -> None:
    arrays = {f.name: getattr(cloud, f.name) for f in fields(cloud) if f.name != "surface"}
    arrays = {name: np.asarray(value, float) for name, value in arrays.items() if value is not None}
    if cloud.surface is not None:
        arrays["vertices"], arrays["triangles"] = cloud.surface
    np.savez(folder / "cloud.npz", **arrays)
    (folder / "task.json").write_text(json.dumps(task))


def load(folder: Path) -> tuple[Cloud, dict[str, Any]]:
    """The cloud and the task that `convert` has left in a folder for its worker."""
    with np.load(folder / "cloud.npz", allow_pickle=False) as file:
        arrays: dict[str, Any] = {name: file[name] for name in file.files}
    for name in ("spacing", "rho", "wave_speed"):
        if name in arrays:
            arrays[name] = float(arrays[name])
    if "vertices" in arrays:
        arrays["surface"] = (arrays.pop("vertices"), arrays.pop("triangles"))
    return Cloud(**arrays), json.loads((folder / "task.json").read_text())


def _work(folder: Path, time_limit: float) -> None:
    """Run workers until one ends by itself; each goes on where the one before has died."""
    tries = folder / "tries.jsonl"
    for _ in range(100):
        code, how = _one_worker(folder, tries, time_limit)
        if code == 0:
            return
        if code > 0:
            log = (folder / "log.txt").read_text(errors="replace")
            raise RuntimeError(f"the conversion's own program failed:\n{log}")
        last = json.loads(tries.read_text().splitlines()[-1]) if tries.exists() else {"failed": ""}
        if last["failed"] is not None:  # nothing was being tried: another process would do no better
            raise SplatError(f"{how} before it could try anything: give more time, or a larger element size")
        with open(tries, "a") as file:
            file.write(json.dumps({**last, "failed": how}) + "\n")
    raise SplatError("the mesher was ended a hundred times")


def _one_worker(folder: Path, tries: Path, time_limit: float) -> tuple[int, str]:
    """The exit code of a worker, and how it was ended if not by itself."""
    here = str(Path(__file__).resolve().parents[2])
    paths = os.pathsep.join(p for p in (here, os.environ.get("PYTHONPATH")) if p)
    with open(folder / "log.txt", "wb") as log:
        worker = subprocess.Popen(
            [sys.executable, "-m", WORKER, str(folder)],
            stdin=subprocess.DEVNULL, stdout=log, stderr=log, env={**os.environ, "PYTHONPATH": paths},
        )  # fmt: skip
        before = noted = tries.stat().st_size if tries.exists() else 0
        since = clock.monotonic()
        try:
            while True:
                try:
                    code = worker.wait(0.05)
                    return code, f"the mesher was ended by {signal.Signals(-code).name}" if code < 0 else ""
                except subprocess.TimeoutExpired:
                    size = tries.stat().st_size if tries.exists() else 0
                    if size != noted:
                        noted, since = size, clock.monotonic()
                    limit = time_limit if noted != before else max(time_limit, START)
                    if clock.monotonic() - since > limit:
                        return -1, f"not done after {limit:g} s"
        finally:  # nor may an interrupt here leave it behind
            if worker.poll() is None:
                worker.kill()
                worker.wait()


def _read(folder: Path, cloud: Cloud) -> Splat:
    summary = json.loads((folder / "summary.json").read_text())
    if summary["error"]:
        raise SplatError(summary["error"])
    bodies = []
    for i, about in enumerate(summary["bodies"]):
        with np.load(folder / f"body_{i}.npz", allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        bodies.append(Body(**arrays, mass_scale=about["mass_scale"], report=about))
    lost = np.setdiff1d(np.arange(len(cloud.x)), np.concatenate([body.cloud_index for body in bodies]))
    report = summary["report"]
    report["lost_points"] = len(lost)
    return Splat(bodies, float(cloud.mass[lost].sum()), report)
