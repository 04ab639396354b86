"""Taylor bars of the explicit target alone, over a ladder of element sizes: the convergence table docs/tables/taylor_bar.csv.

    python workflows/taylor_bar.py                      # every case, the default ladder
    python workflows/taylor_bar.py 42CrMo4 0.9 0.65     # one case, these element sizes (mm); prints, and writes nothing

A bar of copper or of 42CrMo4 steel strikes a rigid frictionless wall; a quarter of it is computed, between two planes of
symmetry. The numbers of others, with their sources, are in tests/data/references.toml. Elements have edges of the given
size within five radii of the struck face and grow by a tenth per unit of distance behind.
"""

import sys
import time
import tomllib
from types import SimpleNamespace
from typing import Any

import numpy as np
from pages import ROOT, TABLES, write_table

from coupler.fe.explicit import Target
from coupler.fe.mesh import cylinder, prepare
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.planning import RATE_FILTER_OVER_CROSSING

LADDER = {"42CrMo4": (0.8, 0.57, 0.4, 0.28), "copper": (0.8, 0.57, 0.4)}  # mm; a quarter of an hour on one core
CASES = tuple(LADDER)
COARSEST = 1.0  # mm
GROWTH = 0.1
HEAD = """\
remake: python workflows/taylor_bar.py
size: edge of the elements near the struck face, mm (a quarter of the bar is computed); length, diameter: mm, T: degrees Celsius
T_max, eps_p_max: largest mean over the elements around a node; _element: largest of a single element
viscous_share: work of the bulk viscosity, energy_drift: error of the sum of energies, both of the initial kinetic energy
"""
MEASURES = ("length", "diameter", "T_max", "eps_p_max")


def reference(case: str) -> dict[str, Any]:
    """The case as tests/data/references.toml has it; `results`: by author, lengths in mm, T_max in degrees Celsius."""
    with (ROOT / "tests" / "data" / "references.toml").open("rb") as file:
        return tomllib.load(file)[f"taylor_{case}"]


def bar(case: str, size: float) -> dict[str, float]:
    """Compute one bar with elements of `size` (mm) and measure its shape."""
    said = reference(case)
    radius, length, speed = said["radius"] * 1e-3, said["length"] * 1e-3, said["velocity"]
    h, largest = size * 1e-3, max(COARSEST, size) * 1e-3
    points, tets = cylinder(2 * radius, length, h, 5 * radius, GROWTH, sizes_to=largest, sector=0.5 * np.pi)
    points[:, 2] *= -1.0  # struck face at z = 0, bar above it
    mesh = prepare(points, tets)
    law = _linear_hardening(said["law"]) if "law" in said else material(said["material"])
    record = law_record(law, rate_filter=RATE_FILTER_OVER_CROSSING * 2 * radius / speed)
    t = Target(mesh, record, said["temperature"], fixed=(), track_wave=False)
    face = np.unique(mesh.facets[mesh.sets["bottom"]])
    planes = [np.flatnonzero(np.abs(mesh.points[:, i]) < 1e-6 * radius) for i in (0, 1)]
    t.v[:, 2] = -speed
    t.v[face, 2] = 0.0
    start, steps, dt, clock = t.kinetic(), 0, 0.0, time.perf_counter()
    while t.time < said["time"]:
        if steps % 10 == 0:
            dt = t.stable_dt()[0]
        t.advance(min(dt, said["time"] - t.time))
        t.finish()
        t.total[face, 2] = 0.0  # the wall
        for axis, nodes in enumerate(planes):
            t.total[nodes, axis] = 0.0
        steps += 1
    energy = t.kinetic() + t.elastic() + float(t.sums[0] + t.sums[1])
    return {
        "size": size,
        "elements": len(mesh.conn),
        "nodes": len(mesh.points),
        "steps": steps,
        "length": float(np.ptp(t.x[:, 2])) * 1e3,
        "diameter": 2e3 * float(np.hypot(t.x[face, 0], t.x[face, 1]).max()),
        "T_max": float(_at_nodes(t, t.T).max()) - 273.15,
        "eps_p_max": float(_at_nodes(t, t.eps_p).max()),
        "T_max_element": float(t.T.max()) - 273.15,
        "eps_p_max_element": float(t.eps_p.max()),
        "viscous_share": float(t.sums[1]) / start,
        "energy_drift": energy / start - 1.0,
        "wall_s": time.perf_counter() - clock,
    }


def _at_nodes(t: Target, values: np.ndarray) -> np.ndarray:
    """Means over the elements around each node, weighted with their volumes."""
    conn, V0 = t.mesh.conn.ravel(), np.repeat(t.mesh.V0, 4)
    return np.bincount(conn, V0 * np.repeat(values, 4)) / np.bincount(conn, V0)


def _linear_hardening(law: dict[str, float]) -> Any:
    """The material of the copper case: sigma_y = A + B eps_p, neither rate nor heat, a linear equation of state."""
    E, nu = law["E"], law["nu"]
    return SimpleNamespace(
        rho=law["rho"], G=E / (2 * (1 + nu)), K=E / (3 * (1 - 2 * nu)), s=0.0, Gamma0=0.0, A=law["A"], B=law["B"],
        n=1.0, C=0.0, m=1.0, eps_dot_0=1.0, T_ref=1000.0, T_m=2000.0, taylor_quinney=0.0,
        cp=((300.0, 385.0),), k=((300.0, 400.0),),
    )  # fmt: skip


def main(arguments: list[str]) -> None:
    cases = [a for a in arguments if a in CASES]
    sizes = [float(a) for a in arguments if a not in CASES]
    rows = []
    for case in cases or CASES:
        print(f"{case}: {reference(case)['title']}")
        for author, values in reference(case)["results"].items():
            print(f"  {author:33}", *(f"{name} {values[name]:g}" for name in MEASURES if name in values))
        for size in sizes or LADDER[case]:
            row = {"case": case, **bar(case, size)}
            rows.append(row)
            print(
                "  " + " ".join(f"{k} {v:.5g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()),
                flush=True,
            )
    if not arguments:
        write(rows)


def write(rows: list[dict[str, object]]) -> None:
    """Write the table, with the references above its header."""
    about = HEAD
    for case in dict.fromkeys(str(row["case"]) for row in rows):
        for author, values in reference(case)["results"].items():
            about += f"{case}, {author}: " + ", ".join(f"{m} {values[m]:g}" for m in MEASURES if m in values) + "\n"
    columns = [name for name in rows[0] if name != "wall_s"]
    shown = [{c: f"{row[c]:.5g}" if isinstance(row[c], float) else row[c] for c in columns} for row in rows]
    write_table(TABLES / "taylor_bar.csv", shown, about)


if __name__ == "__main__":
    main(sys.argv[1:])
