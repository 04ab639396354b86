"""Convergence of one impact in the number of points, and in the knobs of the SPH scheme.

    python workflows/convergence.py [--points 1000 2000 ...] [--knobs] [--velocity 500] [--out docs/tables/convergence_ni500.csv]

25 um Ni on SS304. Each line of the table is one run to rest; lines that are there already are not computed again,
failures are listed too. Elements keep their ratio to the spacing, so that both domains are refined together.
"""

import argparse
import csv
import tempfile
from pathlib import Path

from coupler import Scene, run
from coupler.errors import SolverError

COLUMNS = [
    "points", "kernel_radius", "Q1", "hourglass", "courant", "contact_stiffness", "elements", "steps", "dt_mean_ps", "wall_loop_s",
    "flattening_gd", "flattening_end", "flattening_total_end", "crater_gd_um", "crater_end_um", "diameter_end_um",
    "eps_p_mean", "eps_p_p99", "eps_p_max", "T_mean_K", "T_p99_K", "T_max_K", "rebound_m_s", "plastic_particle",
    "plastic_target", "numerical_particle", "numerical_target", "friction", "drift", "failed",
]  # fmt: skip
KNOBS = [
    {"kernel_radius": 0.9},
    {"kernel_radius": 1.1},
    {"Q1": 0.0},
    {"Q1": 0.2},
    {"hourglass": 0.1},
    {"hourglass": 0.3},
    {"hourglass": 3.0},
    {"courant": 0.1, "stretch": 0.3},
    {"courant": 0.2, "stretch": 0.6},
    {"courant": 0.5, "stretch": 1.2},
    {"contact_stiffness": 0.3},
    {"contact_stiffness": 3.0},
]
DEFAULTS = {"kernel_radius": 0.75, "Q1": 0.06, "hourglass": 1.0, "courant": 0.4, "contact_stiffness": 1.0}
SCENE = """
[particle]
material = "Ni"
diameter = "25 um"
velocity = "{velocity:g} m/s"
[substrate]
material = "SS304"
[resolution]
spacing = "{spacing!r} um"
"""


def case(points: int, velocity: float, numerics: dict[str, float]) -> dict[str, object]:
    """One run; a row of the table."""
    spacing = (3.141592653589793 / 6 * 25.0**3 / points) ** (1 / 3)
    row: dict[str, object] = {"points": points, **DEFAULTS, **{k: v for k, v in numerics.items() if k in DEFAULTS}}
    scene = Scene.from_text(SCENE.format(velocity=velocity, spacing=spacing), "convergence")
    try:
        with tempfile.TemporaryDirectory() as folder:
            r = run(scene, Path(folder) / "run", numerics=numerics)
            s = r.summary
    except SolverError as problem:
        return {**row, "failed": str(problem)[:160]}
    g, e = s["greatest_deformation"], s["energies"]
    row |= {
        "elements": s["elements"], "steps": s["steps"], "dt_mean_ps": s["dt_mean_s"] * 1e12, "wall_loop_s": s["wall_loop_s"],
        "flattening_gd": g["flattening_ratio"], "flattening_end": s["flattening_ratio"],
        "flattening_total_end": s["flattening_ratio_total"], "crater_gd_um": g["crater_depth_m"] * 1e6,
        "crater_end_um": s["crater_depth_m"] * 1e6, "diameter_end_um": s["splat_diameter_m"] * 1e6,
        **{k: s[k] for k in ("eps_p_mean", "eps_p_p99", "eps_p_max", "T_mean_K", "T_p99_K", "T_max_K")},
        "rebound_m_s": s["rebound_velocity_m_s"],
        **{k: e[k] for k in ("plastic_particle", "plastic_target", "numerical_particle", "numerical_target", "friction")},
        "drift": s["energy_drift"], "failed": "",
    }  # fmt: skip
    return {k: (f"{v:.5g}" if isinstance(v, float) else v) for k, v in row.items()}


def main() -> None:
    """Fill the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="*", default=[1000, 2000, 4000, 8000, 16000, 32000, 64000])
    parser.add_argument("--knobs", action="store_true", help="vary the knobs too, at 4000 points")
    parser.add_argument("--velocity", type=float, default=500.0)
    parser.add_argument("--out", type=Path, default=None)
    a = parser.parse_args()
    out = a.out or Path(f"docs/tables/convergence_ni{a.velocity:g}.csv")
    done: list[dict[str, str]] = []
    if out.exists():
        with out.open() as file:
            done = list(csv.DictReader(line for line in file if not line.startswith("#")))
    keys = ("points", *DEFAULTS)
    have = {tuple(float(row.get(k) or DEFAULTS[k]) for k in keys) for row in done}
    wanted = [(n, {}) for n in a.points] + [(4000, knob) for knob in KNOBS if a.knobs]
    for points, numerics in wanted:
        now = {"points": points, **DEFAULTS, **{k: v for k, v in numerics.items() if k in DEFAULTS}}
        if tuple(float(now[k]) for k in keys) in have:
            continue
        row = case(points, a.velocity, numerics)
        print(
            {
                k: row.get(k)
                for k in (*keys, "flattening_end", "crater_end_um", "diameter_end_um", "wall_loop_s", "failed")
            }
        )
        done.append({k: str(row.get(k, "")) for k in COLUMNS})
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("w", newline="") as file:
            file.write(
                f"# remake: python workflows/convergence.py --velocity {a.velocity:g} --knobs (rows that are here are kept)\n"
            )
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(done)


if __name__ == "__main__":
    main()
