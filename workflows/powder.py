"""Ten irregular particles from files, run to rest: docs/tables/powder.csv.

    python workflows/powder.py

The surfaces are made here; rows in the table are not computed again.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
from pages import options, single_impact, spacing_of, study_table
from scipy.spatial import ConvexHull

from coupler import Scene, run
from coupler.sph import packing
from coupler.studies.ladder_runs import spent

Surface = tuple[np.ndarray, np.ndarray]


def lumpy(seed: int, roughness: float = 0.2, edge: float = 0.12, waves: int = 6) -> Surface:
    """A ball whose radius changes with the direction, by a few plane waves."""
    vertices, triangles = packing.surface(2.0, edge)
    rng = np.random.default_rng(seed)
    k, phase = rng.normal(size=(waves, 3)) * 1.5, rng.random(waves) * 2.0 * np.pi
    radius = 1.0 + roughness * np.sin(vertices @ k.T + phase).mean(axis=1) * np.sqrt(waves)
    return vertices * radius[:, None], triangles


def rock(seed: int, corners: int = 14) -> Surface:
    """The hull of random points: flat faces and sharp edges, few triangles."""
    x = np.random.default_rng(seed).normal(size=(corners, 3))
    hull = ConvexHull(x / np.linalg.norm(x, axis=1)[:, None] * [1.3, 1.0, 0.8])
    t = hull.simplices.copy()
    a, b, c = (hull.points[t[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0.0
    t[inwards] = t[inwards][:, ::-1]
    return hull.points, t


def dumbbell() -> Surface:
    """Two balls with a neck, as satellites on a powder particle: not convex."""
    vertices, triangles = packing.surface(2.0, 0.1)
    waist = 1.0 - 0.45 * np.exp(-((vertices[:, :1] / 0.35) ** 2))
    return vertices * np.concatenate([np.full_like(waist, 1.8), waist, waist], axis=1), triangles


def dented() -> Surface:
    """A ball with a deep dent."""
    vertices, triangles = packing.surface(2.0, 0.08)
    return vertices * (1.0 - 0.55 * np.exp(-((vertices[:, 2:] - 1.0) ** 2 / 0.15))), triangles


SHAPES: dict[str, Callable[[], Surface]] = {
    **{f"lumpy_{seed}": lambda seed=seed: lumpy(seed) for seed in (1, 2, 3)},  # type: ignore[misc]
    "rough": lambda: lumpy(4, 0.12, 0.06, 20),
    **{f"rock_{seed}": lambda seed=seed: rock(seed) for seed in (1, 2)},  # type: ignore[misc]
    "splinter": lambda: (rock(3, 10)[0] * [2.2, 1.0, 0.9], rock(3, 10)[1]),
    "dumbbell": dumbbell,
    "dented": dented,
    "fine": lambda: lumpy(5, 0.15, 0.025),
}


def write(folder: Path, name: str, suffix: str = ".stl", unit: float = 1.0) -> Path:
    """A file of one of SHAPES."""
    points, triangles = SHAPES[name]()
    path = folder / f"{name}{suffix}"
    meshio.Mesh(points * unit, [("triangle", triangles)]).write(path)
    return path


COLUMNS = (
    "shape", "points", "flattening_ratio", "flattening_ratio_total", "crater_depth_m", "splat_diameter_m", "eps_p_p99", "T_p99_K",
    "surface_volume_error", "energy_drift", "undecided", "sim_time_s", "cpu_s",
)  # fmt: skip
POINTS, DIAMETER, VELOCITY = 1000, 25.0, 500.0  # um, m/s


def main() -> None:
    """Compute the rows that the table lacks."""
    options(__doc__)
    table = study_table("powder", COLUMNS, ("shape",), "python workflows/powder.py")
    with tempfile.TemporaryDirectory() as place:
        for name in SHAPES:
            if (name,) in table:
                continue
            file, before = write(Path(place), name), spent()
            text = single_impact("Ni", DIAMETER, VELOCITY).replace(
                "diameter", f'shape = "file"\nfile = "{file}"\ndiameter', 1
            )
            text += f'[resolution]\nspacing = "{spacing_of(POINTS, DIAMETER)!r} um"\n'
            result = run(Scene.from_text(text, name), Path(place) / name, threads=1)
            row = table.add({**result.values, "shape": name, "cpu_s": spent() - before})
            print(", ".join(f"{key} {row[key]}" for key in COLUMNS), flush=True)


if __name__ == "__main__":
    main()
