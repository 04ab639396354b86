"""Convergence of one impact in the number of points, and in the knobs of the SPH scheme.

    python workflows/convergence.py [--points 1000 2000 ...] [--knobs] [--velocity 500] [--out docs/tables/convergence_ni500.csv]
    python workflows/convergence.py --points --docs docs/solvers.md    # runs nothing: fits orders to the table that is there

25 um Ni on SS304. Each line of the table is one run to rest; lines that are there already are not computed again,
failures are listed too. A run that was stopped goes on from its last checkpoint in runs/convergence. Elements keep their
ratio to the spacing, so that both domains are refined together.
"""

import argparse
import csv
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from coupler import Scene, run
from coupler.deposition.run import resume
from coupler.errors import SolverError
from coupler.sph import shapes
from coupler.sph.packing import Lattice

COLUMNS = [
    "points", "kernel_radius", "Q1", "hourglass", "courant", "contact_stiffness", "lattice", "elements", "steps", "dt_mean_ps",
    "wall_loop_s", "flattening_gd", "flattening_end", "flattening_total_end", "crater_gd_um", "crater_end_um", "diameter_end_um",
    "eps_p_mean", "eps_p_p99", "eps_p_max", "T_mean_K", "T_p99_K", "T_max_K", "rebound_m_s", "plastic_particle",
    "plastic_target", "numerical_particle", "numerical_target", "friction", "drift", "failed",
]  # fmt: skip
LATTICES = {"fcc": Lattice(), "hcp": Lattice("hcp"), "bcc": Lattice("bcc")}
LATTICES |= {f"fcc turned {seed}": Lattice.at_random(seed) for seed in (1, 2, 3)}
DEFAULTS: dict[str, Any] = {
    "kernel_radius": 0.75, "Q1": 0.06, "hourglass": 1.0, "courant": 0.4, "contact_stiffness": 1.0, "lattice": "fcc",
}  # fmt: skip
KNOBS: list[dict[str, Any]] = [
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
    *({"lattice": name} for name in LATTICES if name != "fcc"),
]
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

# What orders are fitted to: column, name, and the limit where it is known.
MEASURES: list[tuple[str, str, float | None]] = [
    ("flattening_gd", "flattening, greatest", None),
    ("flattening_end", "flattening, end", None),
    ("crater_gd_um", "crater, greatest, µm", None),
    ("crater_end_um", "crater, end, µm", None),
    ("diameter_end_um", "diameter, µm", None),
    ("eps_p_mean", "eps_p mean", None),
    ("eps_p_p99", "eps_p 99 %", None),
    ("eps_p_max", "eps_p max", None),
    ("T_mean_K", "T mean, K", None),
    ("T_p99_K", "T 99 %, K", None),
    ("T_max_K", "T max, K", None),
    ("rebound_m_s", "rebound, m/s", None),
    ("numerical_particle", "eaten by SPH", 0.0),
    ("numerical_target", "bulk viscosity", 0.0),
]
ORDERS = np.linspace(0.1, 6.0, 296)
FEWEST = 4  # resolutions: one more than a fit has numbers
BEGIN, END = "<!-- orders: written by workflows/convergence.py --docs -->", "<!-- end of orders -->"


def key_of(row: Mapping[str, Any]) -> tuple[str, ...]:
    """What tells one run from another: the points, and each knob, its default where a row does not say."""
    knobs = {name: row.get(name) if row.get(name) not in (None, "") else usual for name, usual in DEFAULTS.items()}
    return tuple(str(v) if v in LATTICES else f"{float(v):g}" for v in (row["points"], *knobs.values()))


@contextmanager
def packed_on(lattice: str) -> Iterator[None]:
    """As long as it lasts, bodies are packed on this one of LATTICES: a scene has no say in it."""
    with mock.patch.object(shapes, "shape", partial(shapes.shape, lattice=LATTICES[lattice])):
        yield


def case(points: int, velocity: float, knobs: Mapping[str, Any]) -> dict[str, Any]:
    """One run; a row of the table."""
    spacing = (3.141592653589793 / 6 * 25.0**3 / points) ** (1 / 3)
    row: dict[str, Any] = {"points": points, **DEFAULTS, **{k: v for k, v in knobs.items() if k in DEFAULTS}}
    scene = Scene.from_text(SCENE.format(velocity=velocity, spacing=spacing), "convergence")
    numerics = {name: value for name, value in knobs.items() if name != "lattice"}
    folder = Path("runs/convergence") / "_".join((f"{velocity:g}", *key_of(row))).replace(" ", "-")
    try:
        with packed_on(row["lattice"]):
            stopped = (folder / "scene.toml").exists()
            s = (resume(folder, numerics=numerics) if stopped else run(scene, folder, numerics=numerics)).summary
    except SolverError as problem:
        shutil.rmtree(folder)
        return {**row, "failed": str(problem)[:160]}
    shutil.rmtree(folder)
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


def fit_order(points: np.ndarray, values: np.ndarray, limit: float | None = None) -> dict[str, float]:
    """Fit value(N) = v + a N^(-p/3) by least squares: p is the order in the spacing, v the limit (given, or fitted too).

    points, values (k,). Returns order, order_low and order_high (where the sum of squares stays within what an F test at 95 %
    takes for the same; at an end of ORDERS there is no bound), limit, limit_if_first (v for p = 1) and scatter (root
    mean square that is left). Raises ValueError for fewer than FEWEST values, which leave nothing to judge the fit by.
    """
    from scipy.stats import f as fisher

    if len(points) < FEWEST:
        raise ValueError(f"an order needs at least {FEWEST} resolutions, not {len(points)}")

    def squares(order: float) -> tuple[float, float]:
        h = (points / points[0]) ** (-order / 3.0)
        A = h[:, None] if limit is not None else np.stack([h, np.ones_like(h)], axis=1)
        found = np.linalg.lstsq(A, values - (limit or 0.0), rcond=None)[0]
        return float(np.sum((A @ found - values + (limit or 0.0)) ** 2)), float(
            limit if limit is not None else found[1]
        )

    tried = [squares(p) for p in ORDERS]
    left = np.array([s for s, _ in tried])
    best = int(left.argmin())
    free = len(points) - (3 if limit is None else 2)
    same = left <= left[best] * (1.0 + fisher.ppf(0.95, 1, free) / free)
    return {
        "order": float(ORDERS[best]), "order_low": float(ORDERS[same].min()), "order_high": float(ORDERS[same].max()),
        "limit": tried[best][1], "limit_if_first": squares(1.0)[1], "scatter": float(np.sqrt(left[best] / len(points))),
    }  # fmt: skip


def orders(rows: list[dict[str, str]]) -> list[str]:
    """The table of fitted orders, lines of Markdown, from the rows of the ladder (defaults of every knob)."""
    plain = [row for row in rows if key_of(row)[1:] == key_of({"points": 0})[1:] and not row["failed"]]
    plain.sort(key=lambda row: int(row["points"]))
    N = np.array([float(row["points"]) for row in plain])
    if len(N) < FEWEST:
        return [f"No orders: they need {FEWEST} resolutions at least, and there are {len(N)}."]
    lines = [
        "| | coarsest | finest | order p | 95 % | limit | limit if p = 1 | scatter |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for column, name, limit in MEASURES:
        y = np.array([float(row[column]) for row in plain])
        fit = fit_order(N, y, limit)
        low, high = fit["order_low"] > ORDERS[0], fit["order_high"] < ORDERS[-1]
        span = f"{fit['order_low']:.2g}" if low else f"below {ORDERS[0]:g}"
        span += f" to {fit['order_high']:.2g}" if high else f" to above {ORDERS[-1]:g}"
        order = f"{fit['order']:.2g}" if low and high else "none"
        last = "0 (given)" if limit is not None else f"{fit['limit']:.4g}" if low and high else "-"
        first = "-" if limit is not None else f"{fit['limit_if_first']:.4g}"
        lines.append(
            f"| {name} | {y[0]:.4g} | {y[-1]:.4g} | {order} | {span} | {last} | {first} | {fit['scatter']:.2g} |"
        )
    return lines


def write_orders(rows: list[dict[str, str]], docs: Path) -> None:
    """Put the table of orders between its two marks in a document."""
    text = docs.read_text()
    before, _, rest = text.partition(BEGIN)
    _, found, after = rest.partition(END)
    if not found:
        raise SystemExit(f"{docs} has no place for the orders: it needs the lines {BEGIN!r} and {END!r}")
    docs.write_text("\n".join([before + BEGIN, "", *orders(rows), "", END]) + after)


def main() -> None:
    """Fill the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs="*", default=[1000, 2000, 4000, 8000, 16000, 32000, 64000])
    parser.add_argument("--knobs", action="store_true", help="vary the knobs too, at 4000 points")
    parser.add_argument("--lattice", choices=LATTICES, default="fcc", help="of the points of the ladder")
    parser.add_argument("--velocity", type=float, default=500.0)
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--docs", type=Path, default=None, help="write the fitted orders into this document")
    a = parser.parse_args()
    out = a.out or Path(f"docs/tables/convergence_ni{a.velocity:g}.csv")
    done: list[dict[str, str]] = []
    if out.exists():
        with out.open() as file:
            done = list(csv.DictReader(line for line in file if not line.startswith("#")))
    have = {key_of(row) for row in done}
    wanted: list[tuple[int, dict[str, Any]]] = [
        (n, {} if a.lattice == "fcc" else {"lattice": a.lattice}) for n in a.points
    ]
    wanted += [(4000, knob) for knob in KNOBS if a.knobs]
    for points, knobs in wanted:
        if key_of({"points": points, **knobs}) in have:
            continue
        row = case(points, a.velocity, knobs)
        shown = ("points", *knobs, "flattening_end", "crater_end_um", "diameter_end_um", "wall_loop_s", "failed")
        print({name: row.get(name) for name in shown}, flush=True)
        done.append({k: str(row.get(k, "")) for k in COLUMNS})
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("w", newline="") as file:
            file.write(
                f"# remake: python workflows/convergence.py --velocity {a.velocity:g} --knobs (rows that are here are kept)\n"
            )
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows({**dict.fromkeys(COLUMNS, ""), **r, "lattice": r.get("lattice") or "fcc"} for r in done)
    if a.docs:
        write_orders(done, a.docs)
    else:
        print("\n".join(orders(done)))


if __name__ == "__main__":
    main()
