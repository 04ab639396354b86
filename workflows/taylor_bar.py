"""Taylor bars of each domain alone against a rigid, frictionless wall: python workflows/taylor_bar.py [--docs]

Elements (docs/tables/taylor_bar.csv): bars of copper and of 42CrMo4 steel, a quarter of each between two planes of symmetry; edges have
the given size (mm) within five radii of the struck face and grow by a tenth per unit of distance behind. Points (taylor_bar_sph.csv):
a bar of 42CrMo4. Rows in the tables are not computed again. Lengths are in mm, T_max in degrees Celsius; T_max and eps_p_max are the
largest means over the elements around a node, columns with _element those of single elements; energies are over the initial kinetic
energy. Published numbers, with sources, are in tests/data/references.toml and sph_references.toml. --docs only draws.
"""

import time as clock
import tomllib
from types import SimpleNamespace
from typing import Any

import numpy as np
from pages import drawing, options
from scipy.spatial import ConvexHull
from study_table import DOCS, column, study, table_rows

from coupler.fe.explicit import Target
from coupler.fe.mesh import prepare
from coupler.geometry.mesher import cylinder
from coupler.particle import shapes
from coupler.particle.carried_surface import CarriedSurface
from coupler.particle.engine import ENGINES
from coupler.particle.particle import Numerics
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.physics.strength import Strength
from coupler.plan.planning import RATE_FILTER_OVER_CROSSING

LADDER = {"42CrMo4": (0.8, 0.57, 0.4, 0.28), "copper": (0.8, 0.57, 0.4)}  # sizes, mm; a quarter of an hour on one core
POINTS = (500, 1000, 2000, 4000, 8000, 16000)  # some ten minutes
LARGEST = 1.0  # mm, of the elements
GROWTH = 0.1
DIAMETER, LENGTH, VELOCITY, TEMPERATURE, END = 6.4e-3, 32.4e-3, 287.0, 293.15, 80e-6  # of the bar of points
# With stretch = 1.2 single points at the foot go unstable (eps_p_max 5.9 in place of 1.9, 1.4 % more plastic work) and the
# ledger still closes; from 0.6 to 1.0 nothing changes beyond the third digit.
NUMERICS = Numerics(courant=0.3, stretch=0.8)


def reference(case: str) -> dict[str, Any]:
    """The case as tests/data/references.toml has it; `results`: by author, lengths in mm, T_max in degrees Celsius."""
    return tomllib.loads((DOCS.parent / "tests" / "data" / "references.toml").read_text())[f"taylor_{case}"]


def bar(case: str, size: float | str) -> dict[str, float]:
    """Compute one bar of elements of `size` (mm) and measure its shape."""
    known = reference(case)
    radius, length, speed = known["radius"] * 1e-3, known["length"] * 1e-3, known["velocity"]
    h, largest = float(size) * 1e-3, max(LARGEST, float(size)) * 1e-3
    points, tets = cylinder(2 * radius, length, h, 5 * radius, GROWTH, sizes_to=largest, sector=0.5 * np.pi)
    points[:, 2] *= -1.0  # struck face at z = 0, bar above it
    mesh = prepare(points, tets)
    law = _linear_hardening(known["law"]) if "law" in known else material(known["material"], known.get("strength", ""))
    record = law_record(law, rate_filter=RATE_FILTER_OVER_CROSSING * 2 * radius / speed)
    t = Target(mesh, record, known["temperature"], fixed=(), track_wave=False)
    face = np.unique(mesh.facets[mesh.sets["bottom"]])
    planes = [np.flatnonzero(np.abs(mesh.points[:, i]) < 1e-6 * radius) for i in (0, 1)]
    t.nodes.v[:, 2] = -speed
    t.nodes.v[face, 2] = 0.0
    start, steps, dt = t.kinetic(), 0, 0.0
    while t.time < known["time"]:
        if steps % 10 == 0:
            dt = t.stable_dt()
        t.advance(min(dt, known["time"] - t.time))
        t.finish()
        t.nodes.total[face, 2] = 0.0  # the wall
        for axis, nodes in enumerate(planes):
            t.nodes.total[nodes, axis] = 0.0
        steps += 1
    energy = t.kinetic() + t.elastic() + float(t.balance.plastic + t.balance.numerical)
    return {
        "elements": len(mesh.conn), "nodes": len(mesh.points), "steps": steps,
        "length": float(np.ptp(t.nodes.x[:, 2])) * 1e3, "diameter": 2e3 * float(np.hypot(t.nodes.x[face, 0], t.nodes.x[face, 1]).max()),
        "T_max": float(_at_nodes(t, t.elements.T).max()) - 273.15, "eps_p_max": float(_at_nodes(t, t.elements.eps_p).max()),
        "T_max_element": float(t.elements.T.max()) - 273.15, "eps_p_max_element": float(t.elements.eps_p.max()),
        "viscous_share": t.balance.numerical / start, "energy_drift": energy / start - 1.0,
    }  # fmt: skip


def _at_nodes(t: Target, values: np.ndarray) -> np.ndarray:
    """Means over the elements around each node, weighted with their volumes."""
    conn, V0 = t.mesh.conn.ravel(), np.repeat(t.mesh.V0, 4)
    return np.bincount(conn, V0 * np.repeat(values, 4)) / np.bincount(conn, V0)


def _linear_hardening(law: dict[str, float]) -> Any:
    """The material of the copper case: sigma_y = A + B eps_p, neither rate nor heat, a linear equation of state."""
    E, nu = law["E"], law["nu"]
    return SimpleNamespace(
        rho=law["rho"], G=E / (2 * (1 + nu)), K=E / (3 * (1 - 2 * nu)), s=0.0, Gamma0=0.0, T_m=2000.0,
        strength=Strength("johnson_cook", dict(A=law["A"], B=law["B"], n=1.0, C=0.0, m=1.0, eps_dot_0=1.0, T_ref=1000.0)),
        taylor_quinney=0.0, forest=(0.0, 0.0), gradient_length=0.0, cp=((300.0, 385.0),), k=((300.0, 400.0),),
    )  # fmt: skip


def taylor_bar(points: int | str, numerics: Numerics = NUMERICS, engine: str = "enriched") -> dict[str, Any]:
    """One bar of about `points` points, from first touch to 80 us: lengths mm, temperature C, energies over the initial kinetic one.

    diameter: of the circle with the area of the foot seen along the axis; diameter_largest: twice the largest radius.
    """
    started = clock.perf_counter()
    steel = material("42CrMo4")
    body = shapes.cylinder(DIAMETER, LENGTH, int(points))
    place = np.array([0.0, 0.0, body.half_height])
    law = law_record(steel, rate_filter=RATE_FILTER_OVER_CROSSING * DIAMETER / VELOCITY)
    bar = ENGINES[engine](body.points + place, body.volume, law, (0.0, 0.0, -VELOCITY), TEMPERATURE, numerics=numerics)
    skin = CarriedSurface(body.points + place, body.vertices + place, body.triangles, body.spacing)
    stiffness = steel.K * body.area / len(body.vertices) / body.spacing
    force = np.zeros((len(body.vertices), 3))
    stored = 0.0

    def wall() -> None:
        nonlocal stored
        depth = np.maximum(-skin.positions(bar.points.x)[:, 2], 0.0)
        stored = 0.5 * stiffness * float(depth @ depth)
        force[:, 2] = stiffness * depth
        bar.f_ext += skin.weights.T @ force  # on the vertices alone: a flat wall needs no more

    kinetic = 0.5 * bar.mass.sum() * VELOCITY**2
    longest = 1.6 / np.sqrt(stiffness * skin.softness(bar.mass))
    while bar.time < END * (1 - 1e-12):
        dt, steps = min(bar.stable_dt(), longest), 10
        if bar.time + steps * dt > END:
            steps = int(np.ceil((END - bar.time) / dt))
            dt = (END - bar.time) / steps
        bar.run(steps, dt, wall)
    surface, sums = skin.positions(bar.points.x), bar.totals()
    plastic, numerical = sums.plastic, sums.internal_work - sums.elastic - sums.plastic
    total = sums.kinetic + sums.elastic + plastic + numerical + stored
    result = {
        "engine": engine, "points": bar.n, "spacing_mm": bar.spacing * 1e3, "length_mm": float(np.ptp(surface[:, 2])) * 1e3,
        "diameter_mm": 2e3 * float(np.sqrt(ConvexHull(surface[:, :2]).volume / np.pi)),
        "diameter_largest_mm": 2e3 * float(np.hypot(surface[:, 0], surface[:, 1]).max()),
        "T_max_C": float(bar.points.T.max()) - 273.15, "eps_p_max": float(bar.points.eps_p.max()),
        "eps_p_p99": float(np.percentile(bar.points.eps_p, 99)), "plastic": plastic / kinetic, "numerical": numerical / kinetic,
        "drift": float(total) / kinetic - 1.0, "steps": bar.steps, "wall_s": clock.perf_counter() - started,
    }  # fmt: skip
    bar.close()
    return result


def draw() -> None:
    """Draw length and diameter of the struck face of the steel bar against the number of elements or points, with the references."""
    elements = [row for row in table_rows("taylor_bar") if row["case"] == "42CrMo4"]
    points = table_rows("taylor_bar_sph")
    panels = {"length": (0.09, "final length (mm)"), "diameter": (0.59, "diameter of the struck face (mm)")}
    with drawing("taylor_bar", 8.0, 3.4) as figure:
        for name, (left, title) in panels.items():
            axes = figure.add_axes((left, 0.16, 0.38, 0.75))
            axes.plot(column(elements, "elements"), column(elements, name), "o-", label="elements")
            axes.plot(column(points, "points"), column(points, f"{name}_mm"), "s--", label="points")
            others = [values[name] for values in reference("42CrMo4")["results"].values()]
            axes.axhspan(min(others), max(others), color="k", alpha=0.15, lw=0, label="DynELA and Abaqus")
            axes.set(title=title, xscale="log", xlabel="number of elements or points")
        axes.legend(fontsize=8)


if __name__ == "__main__":
    if not options(__doc__, "docs").docs:
        bars = ((case, f"{size:g}") for case, sizes in LADDER.items() for size in sizes)
        study("taylor_bar", ("case", "size"), bars, bar)
        study("taylor_bar_sph", ("asked",), ((f"{n}",) for n in POINTS), taylor_bar)
    draw()
