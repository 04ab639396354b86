"""The particle as finite elements: an independent discretisation of the same impact, beside that by points.

    python workflows/element_particle.py                    # docs/tables/element_particle.csv and the page; rows in it are kept
    python workflows/element_particle.py --cases Ni500      # other rows of the table: see --help
    python workflows/element_particle.py --docs             # computes nothing: the figure, and the tables of the page

The particle is one more body of the target: tetrahedra of the same kind, the contact kernels of the splats. Material, effects,
substrate mesh, friction, rule of the contact stiffness, end criterion and measures are those of the run by points. Rows of the same
size share the mesh of the substrate: its edges are `size`, the points have a spacing of size / 1.7, and the tetrahedra of the
particle have edges of `size` over --finer (default 1). Contact of the elements acts from both sides by default: nodes of each body on
facets of the other, each with half the stiffness. From one side only, as for points and splats, the body whose nodes are tested seems
too soft: half of what --contact particle and --contact substrate differ by is an error of that at the size computed.
"""

import argparse
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from pages import PAGES, figure_path, markdown, study_table, versions, write_parts

from coupler import Scene, run
from coupler.contact.bodies import JUMP, BodyContact
from coupler.contact.penalty import PointContact
from coupler.errors import SolverError
from coupler.fe.assemble import BodyState, domain_now, domain_of, merge
from coupler.geometry import mesher
from coupler.geometry.extent import shape_measures
from coupler.geometry.tetrahedra import volumes
from coupler.geometry.triangles import areas_and_normals
from coupler.impact.domains import build_target
from coupler.impact.ending import EndCriterion
from coupler.impact.exchange import WINDOW
from coupler.impact.measure import crater_depth
from coupler.physics.constitutive import law_record
from coupler.plan.cost import ELEMENT_SIZE_OVER_SPACING
from coupler.plan.planning import Plan, plan
from coupler.plan.refinement import line
from coupler.report.picture import blank, save
from coupler.sph.packing import surface
from coupler.studies.order import FEWEST, fit_order
from coupler.studies.table import Row

SCENE = """
effects = ["auto", "-conduction", "-particle_conduction", "-interface_conduction", "-dissipation_heat"]
[particle]
material = "{material}"
diameter = "25 um"
velocity = "{velocity:g} m/s"
[substrate]
material = "{substrate}"
[contact]
friction = {friction:g}
[resolution]
spacing = "{spacing!r} um"
element_size = "{size!r} um"
"""
CASES: dict[str, dict[str, object]] = {
    "Ni300": {"material": "Ni", "velocity": 300.0, "substrate": "SS304"},
    "Ni500": {"material": "Ni", "velocity": 500.0, "substrate": "SS304"},
    "Cu300": {"material": "OFHC_Cu", "velocity": 300.0, "substrate": "SS304"},
    "Cu500": {"material": "OFHC_Cu", "velocity": 500.0, "substrate": "SS304"},
}
LESS = "hourglass=0.1,Q1=0"  # the particle's scheme with a tenth of its hourglass control and no viscosity
CONTACTS = {
    "both": (0.5, 0.5),
    "particle": (1.0, 0.0),
    "substrate": (0.0, 1.0),
}  # share of the nodes of particle and substrate
BODY = 1  # number of the particle among the bodies; the substrate is 0


def scene_of(case: str, size: float, friction: float = 0.5) -> Scene:
    """The scene of a case whose substrate has edges of `size` um."""
    text = SCENE.format(**CASES[case], size=size, spacing=size / ELEMENT_SIZE_OVER_SPACING, friction=friction)
    return Scene.from_text(text, case)


def particle_mesh(diameter: float, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n,3) m and tetrahedra (m,4) of a ball about the origin with the volume of a sphere of `diameter` m; edge: m."""
    points, tets = mesher.fill([surface(diameter, edge)], edge)
    return points * (np.pi / 6.0 * diameter**3 / float(volumes(points, tets).sum())) ** (1.0 / 3.0), tets


class ElementImpact:
    """An impact whose particle is the second body of the target.

    nodes: of the particle; elements: its mask (m,); surface: its nodes on the surface; plastic_work: J, of the particle, by the
    trapezoidal rule over WINDOW steps. SI units.
    """

    def __init__(self, plan: Plan, edge: float, contact: str = "both", stiffness: float = 1.0):
        """edge: of the particle's tetrahedra, m. contact: one of CONTACTS; stiffness: factor on its rule."""
        self.plan, p = plan, plan.impact
        points, tets = particle_mesh(p.diameter, edge)
        points[:, 2] += p.gap - points[:, 2].min()
        n, m = len(points), len(tets)
        law = law_record(p.material, plan.effects.switches, p.rate_filter)
        mass = p.material.rho * np.pi / 6.0 * p.diameter**3
        body = BodyState(
            points, tets, np.zeros((m, 6)), np.zeros(m), np.full(m, p.temperature), np.ones(m), np.tile(p.velocity, (n, 1)),
            np.zeros(n), mass, law, np.zeros((m, 3)),
        )  # fmt: skip
        substrate = build_target(plan)
        parts = [domain_now(substrate.target, substrate.body), domain_of(body, "splat1")]
        domain, _ = merge(parts, (0.0, 0.0, 0.0))
        self.bodies = substrate.remade(domain)
        self.target = t = self.bodies.target
        self.elements = self.bodies.body == BODY
        self.nodes = np.unique(t.mesh.conn[self.elements])
        self.surface = self.bodies.surfaces.nodes_of(BODY)
        self.top = np.unique(t.mesh.facets[t.mesh.sets["top"]])
        self.volume = t.mesh.V0[self.elements]
        of_particle, of_substrate = (stiffness * weight for weight in CONTACTS[contact])
        if of_particle > 0.0:
            moduli = [float(K) for K in t.laws["K"]]
            self.bodies.contact = BodyContact(
                self.bodies.surfaces, t.x.copy(), moduli, plan.friction, 0.5 * of_particle
            )  # both sides press
        self.reverse = self._reverse(of_substrate) if of_substrate > 0.0 else None
        t.reach = max(t.reach, float(np.linalg.norm(t.x[self.nodes], axis=1).max()) * 1.01)  # the particle moves
        t._activate(0.0)
        self.dt, self.steps, self.plastic_work = 0.0, 0, 0.0
        self.kinetic_0 = t.kinetic()
        self.energy_0 = self.energy()

    def _reverse(self, factor: float) -> PointContact:
        """Contact of the substrate's nodes with the particle's facets; areas are those of the substrate's finest part."""
        t, surfaces = self.target, self.bodies.surfaces
        ids = surfaces.facets_of(BODY)
        top = t.mesh.facets[t.mesh.sets["top"]]
        near = top[np.linalg.norm(t.x[top].mean(axis=1), axis=1) < 0.5 * self.plan.impact.diameter]
        area = float(areas_and_normals(t.x, near)[0].sum())
        spacing = float(np.sqrt(4.0 / np.sqrt(3.0) * area / len(near)))
        K = float(t.laws["K"].min())
        each = area / len(np.unique(near))
        return PointContact(
            len(self.top), surfaces.facets[ids], spacing, each, K, self.plan.friction, factor=factor, facet_ids=ids, jump=JUMP
        )  # fmt: skip

    def _search(self, travel: float) -> None:
        """Contact search before surfaces move `travel` m; heat of friction goes to the elements."""
        t, r = self.target, self.reverse
        self.bodies.search(travel)
        if r is not None:
            of_facet = t.mesh.facet_element[t.mesh.sets["top"]]
            behind = np.zeros(len(t.x), np.int64)
            behind[t.mesh.facets[t.mesh.sets["top"]].ravel()] = np.repeat(of_facet, 3)
            elements = np.concatenate([behind[self.top], t.mesh.facet_element[r.facet_ids]])
            t.warm(elements, np.concatenate([r.heat_point, r.heat_facet]))
            r.heat_point[:], r.heat_facet[:] = 0.0, 0.0
            r.search(t.x[self.top], t.x, travel)

    @property
    def friction_heat(self) -> float:
        """Heat of friction so far, J."""
        return sum(c.friction_heat for c in (self.bodies.contact, self.reverse) if c is not None)

    def energy(self) -> float:
        """Sum of all energies of the ledger, J."""
        t, r = self.target, self.reverse
        held = 0.0 if r is None else r.penalty_energy + r.friction_heat
        return float(t.kinetic() + t.elastic() + t.sums[0] + t.sums[1] + t.absorbed + self.bodies.energy + held)

    @property
    def sinking(self) -> float:
        """Downward speed of the particle's centre of mass, m/s."""
        t, own = self.target, self.nodes
        return -float(t.mass[own] @ t.velocity()[own, 2] / t.mass[own].sum())

    def advance(self) -> float:
        """WINDOW steps with one time step and one contact search. Returns the contact force on the particle, upwards, N."""
        t, bodies, r = self.target, self.bodies, self.reverse
        fastest = float(np.sqrt(np.max(np.einsum("ij,ij->i", t.v, t.v))))
        self._search(3.0 * fastest * WINDOW * (self.dt or bodies.stable_dt(0.0)))
        self.dt = bodies.stable_dt(np.inf, WINDOW * self.dt)
        if r is not None:
            springs = r.stable_dt(1.0 / float(t.mass[self.top].min()), t.mass[self.surface])
            self.dt = float(1.0 / np.sqrt(1.0 / springs**2 + 1.0 / self.dt**2))
        force, own = 0.0, self.elements
        eps_p, sigma_y = t.eps_p[own], t.sigma_y[own]
        for _ in range(WINDOW):
            t.advance(self.dt)
            bodies.forces(self.dt)
            if r is not None:
                on_top = np.zeros((len(self.top), 3))
                r.forces(self.dt, t.x[self.top], t.v[self.top], t.x, t.v, on_top, t.f_ext)
                t.f_ext[self.top] += on_top
            force = float(t.f_ext[self.nodes, 2].sum())
            t.finish()
        self.steps += WINDOW
        self.plastic_work += float(self.volume @ (0.5 * (sigma_y + t.sigma_y[own]) * (t.eps_p[own] - eps_p)))
        return force

    def measures(self) -> dict[str, float]:
        """Measures of this instant, as `impact.measure` has them for points."""
        t, own = self.target, self.elements
        facets = t.mesh.facets[self.bodies.body[t.mesh.facet_element] == BODY]
        m = shape_measures(t.x, facets, self.plan.impact.diameter)
        m["crater_depth_m"] = crater_depth(t.x[self.top])
        m["eps_p_mean"] = float(np.average(t.eps_p[own], weights=self.volume))
        m["eps_p_p99"] = float(np.percentile(t.eps_p[own], 99))
        m["eps_p_max"] = float(t.eps_p[own].max())
        m["T_mean_K"] = float(np.average(t.T[own], weights=self.volume))
        return m


def strike(impact: ElementImpact, probe: Callable[[ElementImpact], None] | None = None) -> dict[str, dict[str, float]]:
    """Advance an impact to rest; measures at its `greatest` deformation and at its `end`. Raises SolverError."""
    p = impact.plan.impact
    speed = float(np.linalg.norm(p.velocity))
    ending = EndCriterion(p.end_time, p.end_at, p.diameter / speed, speed)
    greatest: dict[str, float] = {}
    while not ending.reached(impact.target.time):
        force = impact.advance()
        ending.observe(impact.target.time, impact.sinking, force)
        if ending.turned is not None and not greatest:
            greatest = impact.measures()
        if probe is not None:
            probe(impact)
    if not greatest:
        raise SolverError("the particle has not turned at its time limit")
    return {"greatest": greatest, "end": impact.measures()}


KEY = ("case", "method", "size_um", "contact", "finer", "friction", "stiffness", "numerics")
MEASURED = {
    "flattening_gd": ("greatest", "flattening_ratio"), "flattening_end": ("end", "flattening_ratio"),
    "whole_gd": ("greatest", "flattening_ratio_total"), "whole_end": ("end", "flattening_ratio_total"),
    "crater_gd_um": ("greatest", "crater_depth_m"), "crater_end_um": ("end", "crater_depth_m"),
    "diameter_gd_um": ("greatest", "splat_diameter_m"), "diameter_end_um": ("end", "splat_diameter_m"),
    "eps_p_mean_gd": ("greatest", "eps_p_mean"), "eps_p_mean_end": ("end", "eps_p_mean"), "eps_p_p99": ("end", "eps_p_p99"),
    "eps_p_max": ("end", "eps_p_max"), "T_mean_K": ("end", "T_mean_K"),
}  # fmt: skip
BALANCE = (
    "plastic_particle",
    "plastic_target",
    "numerical",
    "friction_heat",
    "drift",
)  # over the initial kinetic energy
COLUMNS = (*KEY, "points", "elements", "steps", "dt_mean_ps", *MEASURED, "rebound_m_s", *BALANCE, "cpu_s", "failed")
SIZES = (
    3.4,
    2.4,
    1.7,
    1.2,
)  # um, edges of the substrate's elements; the points have a spacing of 2.0, 1.41, 1.0 and 0.71 um


def by_elements(
    case: str, size: float, contact: str = "both", finer: float = 1.0, friction: float = 0.5, stiffness: float = 1.0
) -> dict[str, object]:
    """One impact with the particle as elements; a row of the table. size: um; the rest as in KEY."""
    decided = plan(scene_of(case, size, friction))
    impact = ElementImpact(decided, size * 1e-6 / finer, contact, stiffness)
    values = strike(impact)
    t, K = impact.target, impact.kinetic_0
    own, whole, viscous = impact.plastic_work, float(t.sums[0]), float(t.sums[1])
    shares = (own, whole - own, viscous, impact.friction_heat, impact.energy() - impact.energy_0)
    return {
        "points": len(impact.nodes), "elements": len(t.mesh.conn), "steps": impact.steps,
        "dt_mean_ps": t.time / impact.steps * 1e12, "rebound_m_s": -impact.sinking,
        **dict(zip(BALANCE, (share / K for share in shares), strict=True)), **_shown(values),
    }  # fmt: skip


def by_points(case: str, size: float, friction: float, numerics: Mapping[str, float]) -> dict[str, object]:
    """The same impact by points; a row of the table."""
    folder = Path("runs/element_particle") / "_".join(
        map(str, (case, size, friction, *(f"{k}{v}" for k, v in numerics.items())))
    )
    shutil.rmtree(folder, ignore_errors=True)
    r = run(scene_of(case, size, friction), folder, numerics=dict(numerics))
    s, e, greatest = r.values, r.energies, r.greatest
    shutil.rmtree(folder)
    return {
        "points": s["points"], "elements": s["elements"], "steps": s["steps"], "dt_mean_ps": s["dt_mean_s"] * 1e12,
        "rebound_m_s": max(s["velocity_z_m_s"], 0.0), "plastic_particle": e["plastic_particle"],
        "plastic_target": e["plastic_target"], "numerical": e["numerical_particle"] + e["numerical_target"],
        "friction_heat": e["friction"], "drift": s["energy_drift"], **_shown({"greatest": greatest, "end": s}),
    }  # fmt: skip


def _shown(values: Mapping[str, Mapping[str, float | None]]) -> dict[str, float | None]:
    """The measures of a row, lengths in um; None for one that the run refuses."""
    row: dict[str, float | None] = {}
    for name, (at, key) in MEASURED.items():
        value = values[at][key]
        row[name] = None if value is None else value * (1e6 if name.endswith("_um") else 1.0)
    return row


STANDARD = (  # the options that fill the table of the page
    "--friction 0.5",
    "--friction 0 --sizes 3.4 2.4 1.7",
    f"--methods points --numerics {LESS} --cases Ni300 Ni500 Cu300 --friction 0.5 --sizes 3.4 2.4 1.7",
    f"--methods points --numerics {LESS} --cases Ni300 Ni500 Cu300 --friction 0 --sizes 3.4 2.4",
    "--methods elements --contact particle --cases Ni300 Ni500 Cu300 --friction 0.5",
    "--methods elements --contact substrate --cases Ni300 Ni500 --friction 0.5 --sizes 3.4 2.4 1.7",
    "--methods elements --contact particle --cases Ni300 Cu300 --friction 0 --sizes 3.4 2.4 1.7",
    "--methods elements --contact substrate --cases Ni300 --friction 0 --sizes 3.4 2.4 1.7",
)
SHOWN = {
    "flattening_gd": "flattening above surface, greatest", "whole_end": "flattening, end", "crater_end_um": "crater, end, µm",
    "diameter_end_um": "diameter, end, µm", "eps_p_mean_gd": "mean strain, greatest", "eps_p_mean_end": "mean strain, end",
}  # fmt: skip
SERIES: dict[tuple[str, str, str, str], str] = {  # method, contact, finer, numerics
    ("points", "", "1", ""): "points",
    ("points", "", "1", LESS): f"points, {LESS.replace('=', ' ').replace(',', ', ')}",
    ("elements", "both", "1", ""): "elements",
    ("elements", "particle", "1", ""): "elements, nodes of the particle only",
    ("elements", "substrate", "1", ""): "elements, nodes of the substrate only",
}
ORDERS = np.linspace(0.5, 2.0, 151)
Curve = tuple[np.ndarray, np.ndarray]  # sizes (k,) um, descending, and values (k,)


def curves(rows: Sequence[Row], friction: str, measure: str) -> dict[tuple[str, str], Curve]:
    """The values of a measure over the size, by case and name of the series."""
    chosen: dict[tuple[str, str], dict[float, float]] = {}
    for row in rows:
        name = SERIES.get((row["method"], row["contact"], row["finer"], row["numerics"]))
        if name and row["friction"] == friction and row["stiffness"] == "1" and row[measure]:
            chosen.setdefault((row["case"], name), {})[float(row["size_um"])] = float(row[measure])
    order = [(case, name) for case in CASES for name in SERIES.values() if (case, name) in chosen]
    return {key: _sorted(chosen[key]) for key in order}


def _sorted(values: Mapping[float, float]) -> Curve:
    sizes = sorted(values, reverse=True)
    return np.array(sizes), np.array([values[size] for size in sizes])


def limits(found: Mapping[tuple[str, str], Curve]) -> dict[tuple[str, str], float]:
    """Limits at size 0, of curves with at least three sizes: order common to the cases of a series, 1 where none can be told."""
    result = {}
    for name in SERIES.values():
        cases = {key: curve for key, curve in found.items() if key[1] == name and len(curve[0]) >= 3}
        long = [curve for curve in cases.values() if len(curve[0]) >= FEWEST]
        fit = fit_order(long, ORDERS) if long else None
        order = fit.order if fit is not None and not any(fit.at_bound) else 1.0
        result |= {key: line(*curve, order)[0] for key, curve in cases.items()}
    return result


def table_lines(rows: Sequence[Row], friction: str) -> list[str]:
    """A table of the page: of each case and measure the value at the finest size and the limit, by series."""
    names, lines = list(SERIES.values()), []
    of = {measure: curves(rows, friction, measure) for measure in SHOWN}
    at = {measure: limits(found) for measure, found in of.items()}
    for case in CASES:
        for measure, label in SHOWN.items():
            cells = []
            for name in names:
                curve, limit = of[measure].get((case, name)), at[measure].get((case, name))
                text = "" if curve is None else f"{curve[1][-1]:.4g} ({curve[0][-1]:g})"
                cells.append(text if limit is None else f"{text} → {limit:.4g}")
            if any(cells):
                lines.append([case, label, *cells])
    return markdown(["case", "measure", *names], lines)


def diagram(rows: Sequence[Row], friction: str) -> Figure:
    """Measures at the greatest deformation over the size of the elements, by case, with the limits at 0."""
    colours = dict(zip(SERIES.values(), ("#c44e52", "#dd8452", "#4c72b0", "#8fb4d9", "#55a3a0"), strict=True))
    figure = blank(17.0, 2.6 * len(CASES), 80)
    axes = figure.subplots(len(CASES), len(SHOWN), squeeze=False)
    for column, (measure, label) in enumerate(SHOWN.items()):
        found = curves(rows, friction, measure)
        at = limits(found)
        for row, case in enumerate(CASES):
            ax = axes[row][column]
            for name, colour in colours.items():
                curve = found.get((case, name))
                if curve is None:
                    continue
                ax.plot(*curve, "o-", color=colour, markersize=4, linewidth=1.2, label=name)
                if (case, name) in at:
                    ax.plot([0.0], [at[case, name]], "x", color=colour, markersize=6, clip_on=False)
            ax.set_xlim(0.0, None)
            ax.tick_params(labelsize=7)
            ax.set_title(f"{case}: {label}", fontsize=8)
            if row == len(CASES) - 1:
                ax.set_xlabel("edge of the substrate's elements, µm", fontsize=7)
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="upper center", ncols=len(SERIES), fontsize=9)
    figure.subplots_adjust(left=0.035, right=0.99, top=0.94, bottom=0.055, hspace=0.32, wspace=0.24)
    return figure


def write_docs(rows: Sequence[Row]) -> None:
    """The figures, and the tables of the page."""
    lines = []
    for friction, name in (("0.5", "element_particle.png"), ("0", "element_particle_frictionless.png")):
        save(diagram(rows, friction), figure_path("accuracy", name))
        lines += [f"Friction {friction}:", "", f"![Points and elements, friction {friction}]({name})", ""]
        lines += [*table_lines(rows, friction), ""]
    failures = [row for row in rows if row["failed"]]
    lines += [
        "Failed: " + "; ".join(
            f"{r['case']}, {r['method']}, {r['size_um']} µm, {r['contact']}, friction {r['friction']}" for r in failures
        ) + "." if failures else "No row failed.", "", versions(rows),
    ]  # fmt: skip
    write_parts(PAGES["accuracy"], {"element particle": lines})


def main(arguments: Sequence[str]) -> None:
    """Fill the table: with the rows that the options ask for, with all of STANDARD where there are none."""
    if not arguments:
        for line_of in (*STANDARD, "--docs"):
            main(line_of.split())
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=CASES)
    parser.add_argument("--methods", nargs="*", default=["elements", "points"])
    parser.add_argument("--sizes", type=float, nargs="*", default=SIZES)
    parser.add_argument("--contact", choices=CONTACTS, default="both", help="of the elements")
    parser.add_argument("--finer", type=float, default=1.0)
    parser.add_argument("--friction", type=float, default=0.5)
    parser.add_argument("--stiffness", type=float, default=1.0, help="factor on the stiffness of the contact")
    parser.add_argument("--numerics", default="", help="of the points: name=value,name=value")
    parser.add_argument("--docs", action="store_true", help="compute nothing: write figures and page")
    a = parser.parse_args(arguments)
    table = study_table("element_particle", COLUMNS, KEY, "python workflows/element_particle.py")
    if a.docs:
        write_docs(table.rows)
        return
    numerics = {name: float(value) for name, value in (item.split("=") for item in a.numerics.split(",") if item)}
    for size in a.sizes:
        for case in a.cases:
            for method in a.methods:
                elements = method == "elements"
                finer, contact = (f"{a.finer:g}", a.contact) if elements else ("1", "")
                numerics_of = "" if elements else a.numerics
                key = (case, method, f"{size:g}", contact, finer, f"{a.friction:g}", f"{a.stiffness:g}", numerics_of)
                if key in table:
                    continue
                began, failed = time.process_time(), ""
                row: dict[str, object] = {}
                try:
                    if elements:
                        row = by_elements(case, size, a.contact, a.finer, a.friction, a.stiffness)
                    else:
                        stiff = {} if a.stiffness == 1.0 else {"contact_stiffness": a.stiffness}
                        row = by_points(case, size, a.friction, {**numerics, **stiff})
                except SolverError as problem:
                    failed = str(problem)[:100]
                cpu = round(time.process_time() - began, 1)
                print(
                    table.add({**dict(zip(KEY, key, strict=True)), **row, "cpu_s": cpu, "failed": failed}), flush=True
                )


if __name__ == "__main__":
    main(sys.argv[1:])
