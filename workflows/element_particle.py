"""The particle as finite elements: an independent discretisation of the same impact, beside that by points.

    python workflows/element_particle.py            # docs/tables/element_particle.csv and its part of the page; rows in it are kept
    python workflows/element_particle.py --docs     # computes nothing: the part of the page

The particle is one more body of the target: tetrahedra of the same kind, the contact kernels of the splats. Material, effects,
substrate mesh, friction, rule of the contact stiffness, end criterion and measures are those of the run by points. Rows of the same
size share the mesh of the substrate: edges of both bodies are `size`, the points have a spacing of size / 1.7.
"""

import itertools
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from pages import computed, impact_tables, markdown, options, write_parts
from study_table import Row, number, study

from coupler import Scene
from coupler.errors import SolverError
from coupler.geometry import mesher
from coupler.geometry.extent import shape_measures
from coupler.geometry.tetrahedra import volumes
from coupler.impact.domains import build_target
from coupler.impact.ending import EndCriterion
from coupler.impact.exchange import CHUNK
from coupler.impact.measure import crater_depth
from coupler.particle.packing import surface
from coupler.physics.constitutive import law_record
from coupler.plan.cost import ELEMENT_SIZE_OVER_SPACING
from coupler.plan.planning import Plan, plan
from coupler.target.domain import BodyState, domain_now, domain_of, merge

EFFECTS = ["auto", "-conduction", "-particle_conduction", "-interface_conduction", "-dissipation_heat"]  # of both
CASES = {"Ni300": ("Ni", 300.0), "Ni500": ("Ni", 500.0), "Cu300": ("OFHC_Cu", 300.0)}  # metal, m/s; 25 um on SS304
BODY = 1  # number of the particle among the bodies; the substrate is 0


def scene_of(case: str, size: float, friction: float = 0.5) -> Scene:
    """The scene of a case whose substrate has edges of `size` um."""
    tables = impact_tables(CASES[case][0], 25.0, CASES[case][1], spacing=size / ELEMENT_SIZE_OVER_SPACING)
    tables["resolution"]["element_size"] = f"{size!r} um"
    return Scene.from_dict({"effects": EFFECTS, **tables, "contact": {"friction": friction}}, case)


class ElementImpact:
    """An impact whose particle is the second body of the target, as a splat is.

    nodes: of the particle; elements: its mask (m,); plastic_work: J, of the particle, by the trapezoidal rule over CHUNK steps.
    """

    def __init__(self, plan: Plan, edge: float):
        """edge: of the particle's tetrahedra, m."""
        self.plan, p = plan, plan.impact
        volume = np.pi / 6.0 * p.diameter**3
        points, tets = mesher.fill([surface(p.diameter, edge)], edge)
        points *= (volume / float(volumes(points, tets).sum())) ** (1.0 / 3.0)
        points[:, 2] += p.gap - points[:, 2].min()
        n, m = len(points), len(tets)
        law = law_record(p.material, vars(plan.effects), p.rate_filter)
        body = BodyState(
            points, tets, np.zeros((m, 6)), np.ones(m), np.tile(p.velocity, (n, 1)), np.zeros(n), p.material.rho * volume, law,
            eps_p=np.zeros(m), T=np.full(m, p.temperature), eps_gradient=np.zeros((m, 3)),
        )  # fmt: skip
        substrate = build_target(plan)
        domain, _ = merge([domain_now(substrate.target, substrate.body), domain_of(body, "splat1")], (0.0, 0.0, 0.0))
        self.bodies = substrate.remade(domain)
        self.target = t = self.bodies.target
        self.bodies.touch()
        self.elements = self.bodies.body == BODY
        self.nodes = np.unique(t.mesh.conn[self.elements])
        self.top = np.unique(t.mesh.facets[t.mesh.sets["top"]])
        self.volume = t.mesh.V0[self.elements]
        t.reach = max(t.reach, float(np.linalg.norm(t.nodes.x[self.nodes], axis=1).max()) * 1.01)  # the particle moves
        t._activate(0.0)
        self.dt, self.steps, self.plastic_work = 0.0, 0, 0.0
        self.kinetic_0 = t.kinetic()
        self.energy_0 = self.energy()

    def energy(self) -> float:
        """Sum of all energies of the ledger, J."""
        t = self.target
        lost = t.balance.plastic + t.balance.numerical + t.balance.absorbed
        return float(t.kinetic() + t.elastic() + lost + self.bodies.energy)

    @property
    def sinking(self) -> float:
        """Downward speed of the particle's centre of mass, m/s."""
        t, own = self.target, self.nodes
        return -float(t.mass[own] @ t.velocity()[own, 2] / t.mass[own].sum())

    def advance(self) -> float:
        """CHUNK steps with one time step and one contact search. Returns the contact force on the particle, upwards, N."""
        t, bodies, own = self.target, self.bodies, self.elements
        fastest = float(np.sqrt(np.max(np.einsum("ij,ij->i", t.nodes.v, t.nodes.v))))
        bodies.search(3.0 * fastest * CHUNK * (self.dt or bodies.stable_dt(0.0)))
        self.dt = bodies.stable_dt(np.inf, CHUNK * self.dt)
        force, eps_p, sigma_y = 0.0, t.elements.eps_p[own], t.elements.sigma_y[own]
        for _ in range(CHUNK):
            t.advance(self.dt)
            bodies.forces(self.dt)
            force = float(t.f_ext[self.nodes, 2].sum())
            t.finish()
        self.steps += CHUNK
        mean, more = 0.5 * (sigma_y + t.elements.sigma_y[own]), t.elements.eps_p[own] - eps_p
        self.plastic_work += float(self.volume @ (mean * more))
        return force

    def measures(self) -> dict[str, float]:
        """Measures of this instant, as `impact.measure` has them for points."""
        t, own = self.target, self.elements
        facets = t.mesh.facets[self.bodies.body[t.mesh.facet_element] == BODY]
        m = shape_measures(t.nodes.x, facets, self.plan.impact.diameter)
        m["crater_depth_m"] = crater_depth(t.nodes.x[self.top])
        m["eps_p_mean"] = float(np.average(t.elements.eps_p[own], weights=self.volume))
        m["eps_p_p99"] = float(np.percentile(t.elements.eps_p[own], 99))
        m["eps_p_max"] = float(t.elements.eps_p[own].max())
        m["T_mean_K"] = float(np.average(t.elements.T[own], weights=self.volume))
        return m


def strike(impact: ElementImpact, probe: Callable[[], None] = lambda: None) -> dict[str, dict[str, float]]:
    """Advance an impact to rest. Returns its measures at `greatest` deformation and at the `end`. Raises SolverError.

    probe: called after each CHUNK of steps.
    """
    p = impact.plan.impact
    speed = float(np.linalg.norm(p.velocity))
    ending = EndCriterion(p.end_time, p.end_at, p.diameter / speed, speed)
    greatest: dict[str, float] = {}
    while not ending.reached(impact.target.time):
        force = impact.advance()
        probe()
        ending.observe(impact.target.time, impact.sinking, force)
        if ending.turned is not None and not greatest:
            greatest = impact.measures()
    if not greatest:
        raise SolverError("the particle has not turned at its time limit")
    return {"greatest": greatest, "end": impact.measures()}


KEY = ("case", "method", "size_um")
MEASURED = {  # column -> instant, measure
    "flattening_gd": ("greatest", "flattening_ratio"), "flattening_end": ("end", "flattening_ratio"),
    "whole_end": ("end", "flattening_ratio_total"), "crater_end_um": ("end", "crater_depth_m"),
    "diameter_end_um": ("end", "splat_diameter_m"), "eps_p_mean_end": ("end", "eps_p_mean"), "eps_p_p99": ("end", "eps_p_p99"),
    "T_mean_K": ("end", "T_mean_K"),
}  # fmt: skip
BALANCE = ("plastic_particle", "plastic_target", "numerical", "drift")  # over the initial kinetic energy
SIZES = (3.4, 2.4, 1.7)  # um, edges of the substrate's elements; the points have a spacing of 2.0, 1.41 and 1.0 um
SHOWN = {
    "flattening_gd": "greatest flattening above surface", "whole_end": "whole flattening", "crater_end_um": "crater",
    "diameter_end_um": "diameter", "eps_p_mean_end": "mean strain",
}  # fmt: skip


def by_elements(case: str, size: float) -> dict[str, object]:
    """One impact with the particle as elements; a row of the table. size: um."""
    impact = ElementImpact(plan(scene_of(case, size)), size * 1e-6)
    values = strike(impact)
    t, K = impact.target, impact.kinetic_0
    own, whole, viscous = impact.plastic_work, t.balance.plastic, t.balance.numerical
    shares = (own, whole - own, viscous, impact.energy() - impact.energy_0)
    return {
        "points": len(impact.nodes), "elements": len(t.mesh.conn), "steps": impact.steps,
        "dt_mean_ps": t.time / impact.steps * 1e12, "rebound_m_s": -impact.sinking,
        **dict(zip(BALANCE, (share / K for share in shares), strict=True)), **_shown(values),
    }  # fmt: skip


def by_points(case: str, size: float) -> dict[str, object]:
    """The same impact by points; a row of the table."""
    with computed(scene_of(case, size)) as (r, _):
        s, e, greatest = r.values, r.energies, r.greatest
    return {
        "points": s["points"], "elements": s["elements"], "steps": s["steps"], "dt_mean_ps": s["dt_mean_s"] * 1e12,
        "rebound_m_s": max(s["velocity_z_m_s"], 0.0), "plastic_particle": e["plastic_particle"],
        "plastic_target": e["plastic_target"], "numerical": e["numerical_particle"] + e["numerical_target"],
        "drift": s["energy_drift"], **_shown({"greatest": greatest, "end": s}),
    }  # fmt: skip


def _shown(values: Mapping[str, Mapping[str, float | None]]) -> dict[str, float | None]:
    """The measures of a row, lengths in um; None for one that the run refuses."""
    found = {name: (values[at][key], 1e6 if name.endswith("_um") else 1.0) for name, (at, key) in MEASURED.items()}
    return {name: None if value is None else value * factor for name, (value, factor) in found.items()}


def row_of(case: str, method: str, size: str) -> dict[str, object]:
    """One impact by a method; size: um."""
    began = time.process_time()
    row = (by_elements if method == "elements" else by_points)(case, float(size))
    return {**row, "cpu_s": round(time.process_time() - began, 1)}


def part(rows: Sequence[Row]) -> list[str]:
    """Lines of the table of the page: differences between points and elements in each case, at the smallest size."""
    of = {(row["case"], row["method"]): row for row in rows if row["size_um"] == f"{SIZES[-1]:g}" and not row["failed"]}
    lines = []
    for case, (metal, velocity) in CASES.items():
        pair = of.get((case, "points")), of.get((case, "elements"))
        if all(pair):
            by_points, by_elements = ({name: number(row, name) for name in SHOWN} for row in pair if row)
            apart = (f"{100.0 * (by_points[n] / by_elements[n] - 1.0):+.1f}" for n in SHOWN)
            lines.append([f"{metal}, {velocity:g} m/s", *apart])
    return markdown(["points less elements, %", *SHOWN.values()], lines, rows)


if __name__ == "__main__":
    a = options(__doc__, "docs")
    keys = (
        (case, method, f"{size:g}") for size, case, method in itertools.product(SIZES, CASES, ("elements", "points"))
    )
    table = study("element_particle", KEY, () if a.docs else keys, row_of, may_fail=True)
    write_parts("accuracy", {"element particle": part(table.rows)})
