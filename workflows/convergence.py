"""Convergence of one impact in the number of points, and in the parameters of the SPH scheme.

    python workflows/convergence.py [--points 1000 2000 ...] [--parameters] [--velocity 500]   # docs/tables/convergence_ni500.csv
    python workflows/convergence.py --lattice hcp      # another lattice for the points of the ladder
    python workflows/convergence.py --docs     # runs nothing: fits orders to the table and writes them into the page

25 um Ni on SS304. Each row is one run to rest; rows in the table are not computed again, failures are rows too. A run that was
stopped goes on from its last checkpoint in runs/convergence. Elements keep their ratio to the spacing, so that both domains are
refined together.
"""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
from pages import PAGES, markdown, options, single_impact, spacing_of, study_table, versions, write_parts
from scipy.spatial.transform import Rotation

from coupler import Scene, run
from coupler.deposition.run import resume
from coupler.errors import SolverError
from coupler.plan.refinement import line
from coupler.sph import shapes
from coupler.sph.packing import FCC, Lattice
from coupler.studies.order import FEWEST, fit_order
from coupler.studies.table import Row

COLUMNS = (
    "points", "kernel_radius", "Q1", "hourglass", "courant", "contact_stiffness", "lattice", "elements", "steps", "dt_mean_ps",
    "wall_loop_s", "flattening_gd", "flattening_end", "flattening_total_end", "crater_gd_um", "crater_end_um", "diameter_end_um",
    "eps_p_mean", "eps_p_p99", "eps_p_max", "T_mean_K", "T_p99_K", "T_max_K", "rebound_m_s", "plastic_particle",
    "plastic_target", "numerical_particle", "numerical_target", "friction", "drift", "failed",
)  # fmt: skip
BCC = Lattice((1.0, 1.0, 1.0), ((0, 0, 0), (0.5, 0.5, 0.5)), (0.5, 0.5, 0.5), 0.0785433)
HCP = Lattice(
    (1.0, np.sqrt(3.0), np.sqrt(8.0 / 3.0)), ((0, 0, 0), (0.5, 0.5, 0), (0.5, 5 / 6, 0.5), (0, 1 / 3, 0.5)), (0.5, 0.25, 0.5),
    FCC.moment,
)  # fmt: skip
LATTICES = {"fcc": FCC, "hcp": HCP, "bcc": BCC}


def turned_at_random(seed: int, lattice: Lattice = FCC) -> Lattice:
    """A lattice with a random orientation of uniform distribution, the same for the same seed."""
    x, y, z = Rotation.random(rng=np.random.default_rng(seed)).as_rotvec().tolist()
    return replace(lattice, turn=(x, y, z))


LATTICES |= {f"fcc turned {seed}": turned_at_random(seed) for seed in (1, 2, 3)}
DEFAULTS: dict[str, float | str] = {
    "kernel_radius": 0.75, "Q1": 0.06, "hourglass": 1.0, "courant": 0.4, "contact_stiffness": 1.0, "lattice": "fcc",
}  # fmt: skip
CHANGES: list[dict[str, float | str]] = [
    *({"kernel_radius": value} for value in (0.9, 1.1)), *({"Q1": value} for value in (0.0, 0.2)),
    *({"hourglass": value} for value in (0.1, 0.3, 3.0)),
    {"courant": 0.1, "stretch": 0.3}, {"courant": 0.2, "stretch": 0.6}, {"courant": 0.5, "stretch": 1.2},
    {"contact_stiffness": 0.3}, {"contact_stiffness": 3.0}, *({"lattice": name} for name in LATTICES if name != "fcc"),
]  # fmt: skip
# What orders are fitted to: column -> name.
MEASURES = {
    "flattening_gd": "flattening, greatest", "flattening_end": "flattening, end", "crater_gd_um": "crater, greatest, µm",
    "crater_end_um": "crater, end, µm", "diameter_end_um": "diameter, µm", "eps_p_mean": "eps_p mean", "eps_p_p99": "eps_p 99 %",
    "eps_p_max": "eps_p max", "T_mean_K": "T mean, K", "T_p99_K": "T 99 %, K", "T_max_K": "T max, K", "rebound_m_s": "rebound, m/s",
    "numerical_particle": "dissipated by SPH", "numerical_target": "bulk viscosity",
}  # fmt: skip
LIMITS = {"numerical_particle": 0.0, "numerical_target": 0.0}  # where they are known
ORDERS = np.linspace(0.1, 6.0, 296)
KEY = ("points", *DEFAULTS)


def key_of(row: Mapping[str, object]) -> tuple[str, ...]:
    """The key of a run: its points and each parameter, the default where a row does not say."""
    values = {name: row.get(name) if row.get(name) not in (None, "") else usual for name, usual in DEFAULTS.items()}
    return tuple(str(v) if v in LATTICES else f"{float(str(v)):g}" for v in (row["points"], *values.values()))


@contextmanager
def packed_on(lattice: str) -> Iterator[None]:
    """Within this context bodies are packed on one of LATTICES, which a scene cannot choose."""
    with mock.patch.object(shapes, "shape", partial(shapes.shape, lattice=LATTICES[lattice])):
        yield


def case(points: int, velocity: float, change: Mapping[str, float | str]) -> dict[str, object]:
    """One run; a row of the table."""
    row: dict[str, object] = {"points": points, **DEFAULTS, **{k: v for k, v in change.items() if k in DEFAULTS}}
    scene = Scene.from_text(single_impact("Ni", 25.0, velocity, spacing=spacing_of(points)), "convergence")
    numerics = {name: float(value) for name, value in change.items() if name != "lattice"}
    folder = Path("runs/convergence") / "_".join((f"{velocity:g}", *key_of(row))).replace(" ", "-")
    try:
        with packed_on(str(row["lattice"])):
            stopped = (folder / "scene.toml").exists()
            result = resume(folder, numerics=numerics) if stopped else run(scene, folder, numerics=numerics)
    except SolverError as problem:
        shutil.rmtree(folder)
        return {**row, "failed": str(problem)[:160]}
    s, g, e = result.values, result.greatest, result.energies
    shutil.rmtree(folder)
    row |= {
        "elements": s["elements"], "steps": s["steps"], "dt_mean_ps": s["dt_mean_s"] * 1e12, "wall_loop_s": s["wall_loop_s"],
        "flattening_gd": g["flattening_ratio"], "flattening_end": s["flattening_ratio"],
        "flattening_total_end": s["flattening_ratio_total"], "crater_gd_um": g["crater_depth_m"] * 1e6,
        "crater_end_um": s["crater_depth_m"] * 1e6, "diameter_end_um": s["splat_diameter_m"] * 1e6,
        **{k: s[k] for k in ("eps_p_mean", "eps_p_p99", "eps_p_max", "T_mean_K", "T_p99_K", "T_max_K")},
        "rebound_m_s": max(s["velocity_z_m_s"], 0.0),
        **{k: e[k] for k in ("plastic_particle", "plastic_target", "numerical_particle", "numerical_target", "friction")},
        "drift": s["energy_drift"], "failed": "",
    }  # fmt: skip
    return {k: (f"{v:.5g}" if isinstance(v, float) else v) for k, v in row.items()}


def orders(rows: list[Row]) -> list[list[str]]:
    """The rows of the table of fitted orders, from the rows of the ladder (defaults of every parameter); none of too few."""
    plain = [row for row in rows if key_of(row)[1:] == key_of({"points": 0})[1:] and not row["failed"]]
    plain.sort(key=lambda row: int(row["points"]))
    N = np.array([float(row["points"]) for row in plain])
    if len(N) < FEWEST:
        return []
    lines = []
    for column, name in MEASURES.items():
        limit = LIMITS.get(column)
        y, h = np.array([float(row[column]) for row in plain]), (N / N[0]) ** (-1 / 3)
        fit = fit_order([(h, y)], ORDERS, limit)
        bounded = not any(fit.at_bound)
        last = "0 (given)" if limit is not None else f"{line(h, y, fit.order)[0]:.4g}" if bounded else "-"
        first = "-" if limit is not None else f"{line(h, y, 1.0)[0]:.4g}"
        order = f"{fit.order:.2g}" if bounded else "none"
        ends, interval = (f"{y[0]:.4g}", f"{y[-1]:.4g}"), " to ".join(fit.interval())
        lines.append([name, *ends, order, interval, last, first, f"{fit.scatter:.2g}"])
    return lines


def main() -> None:
    """Fill the table."""
    a = options(
        __doc__,
        "parameters",
        "docs",
        points=[1000, 2000, 4000, 8000, 16000, 32000, 64000],
        lattice="fcc",
        velocity=500.0,
    )
    command = f"python workflows/convergence.py --velocity {a.velocity:g} --parameters"
    table = study_table(f"convergence_ni{a.velocity:g}", COLUMNS, KEY, command)
    cases = [(n, {"lattice": a.lattice}) for n in a.points] + [(4000, change) for change in CHANGES if a.parameters]
    for points, change in cases if not a.docs else ():
        if key_of({"points": points, **change}) not in {key_of(row) for row in table.rows}:
            print(table.add(case(points, a.velocity, change)), flush=True)
    lines = [
        *markdown("| coarsest | finest | order p | 95 % | limit | limit if p = 1 | scatter", orders(table.rows)),
        "",
        versions(table.rows),
    ]
    if a.docs:
        write_parts(PAGES["solvers"], {"orders": lines})
    else:
        print("\n".join(lines))


if __name__ == "__main__":
    main()
