"""The source paper's own resolution beside `standard`: python workflows/paper_resolution.py   # docs/tables/paper_resolution.csv

Runs workflows/paper_resolution.toml (89,324 points, 189,228 elements) and single_ni.toml in one process with two threads, and writes
what both gave and what they cost. Finished runs that lie in runs/ are taken as they are; the finer one takes 8 minutes of two cores.
"""

import subprocess
import sys

from pages import ROOT, TABLES, options, write_table

from coupler import Result

RUNS = {
    "standard": ("single_ni", "single_ni_two_threads"),
    "paper's resolution": ("paper_resolution", "paper_resolution"),
}
WHOLE = {
    "points": 1.0, "elements": 1.0, "steps": 1.0, "dt_mean_s": 1e12, "wall_s": 1.0, "memory_peak_bytes": 1e-9,
    "flattening_ratio": 1.0, "flattening_ratio_total": 1.0, "crater_depth_m": 1e6, "splat_diameter_m": 1e6, "eps_p_mean": 1.0,
    "eps_p_p99": 1.0, "eps_p_max": 1.0, "T_mean_K": 1.0, "T_p99_K": 1.0, "T_max_K": 1.0, "target_T_max_K": 1.0,
    "rebound_velocity_m_s": 1.0, "numerical_dissipation": 100.0, "energy_drift": 100.0, "momentum_error": 1.0,
}  # fmt: skip
UNITS = {"dt_mean_s": "ps", "wall_s": "s", "memory_peak_bytes": "GB", "crater_depth_m": "um", "splat_diameter_m": "um"}


def result_of(scene: str, folder: str) -> Result:
    """The result of a run, which is computed first where it does not exist."""
    out = ROOT / "runs" / folder
    if not (out / "summary.json").exists():
        path = ROOT / "workflows" / f"{scene}.toml"
        command = [sys.executable, "-m", "coupler", "run", str(path), "--out", str(out), "--force", "--threads", "2"]
        subprocess.run(command, check=True)
    return Result(out)


def main() -> None:
    """Run what is missing; write the table."""
    options(__doc__)
    results = {name: result_of(*where) for name, where in RUNS.items()}
    rows = []
    for name, factor in WHOLE.items():
        unit = "%" if factor == 100.0 else "m/s" if name.endswith("m_s") else "K" if name.endswith("_K") else ""
        numbers = {which: getattr(result, name) for which, result in results.items()}
        values = {which: "" if n is None else f"{factor * n:.5g}" for which, n in numbers.items()}
        rows.append({"measure": name, "unit": UNITS.get(name, unit), **values})
    about = "remake: python workflows/paper_resolution.py; 25 um Ni on SS304 at 500 m/s, two threads"
    write_table(TABLES / "paper_resolution.csv", rows, about)


if __name__ == "__main__":
    main()
