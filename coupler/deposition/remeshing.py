"""Between two impacts: where an impact has distorted the target, a patch of its mesh is made new and takes over the state.

A handful of elements at the rim of a crater would otherwise dictate the time step of all impacts to come. The surface of
the patch is made even on itself, its inside filled anew, fields go over by moving least squares as for a splat; the mesh round
it stays as it is, to the last bit. Where that fails, or gains nothing, the mesh is kept: a run never ends here.
"""

import time as clock
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from ..contact.surfaces import interface
from ..errors import SolverError, SplatError
from ..fe import kernels
from ..fe.assemble import Domain, domain_now, merge
from ..fe.explicit import COURANT, LINEAR_VISCOSITY
from ..fe.patch import Patch, Renewal, patch_of, renewed
from ..fe.state import ElementState, NodeState
from ..files.summary import Values
from ..geometry import mesher
from ..geometry.apart import apart
from ..geometry.solid import check_solid
from ..geometry.tetrahedra import TETS_PER_H3, volumes
from ..impact import measure as measures
from ..impact.bodies import NEAR, Bodies
from ..splat import quality
from ..splat.meshing import MIN_GAMMA
from ..splat.renew import renewed_surface
from ..splat.transfer import Fit, with_energy, with_momentum, with_sum
from ..state.records import new_rows, rows_of

STRAINED = 0.3  # plastic strain from which on elements are bent: the cut must not run through them
# reach of a patch round bad and strained elements, in edges, and edges over the old ones: finer ones keep the surface better
TRIES = ((1.5, 0.7), (1.5, 1.0), (2.5, 1.0))
SAFE = 2.0  # true stable steps over the bound of the worst element, about: see `fe.stability`
OWN_STEP = 0.2  # spacings over wave speed: the step of a particle well deformed, half of what it begins with
MOST_PATCHES = 8
GAIN = 1.25  # of the smallest step, in a patch and in the whole mesh: less is not worth a transfer
MESHING_LIMIT = 60.0  # s, of gmsh for a patch
SEAM = 1e-6  # edges: largest distance of a node of the cut from its place


@dataclass(frozen=True)
class Gate:
    """When a mesh is distorted: its stable step is below `step` s, the limit of the particle to come, or the quality of an
    element below `quality`."""

    step: float
    quality: float = MIN_GAMMA

    @classmethod
    def of(cls, spacing: float, wave_speed: float) -> "Gate":
        """The gate that a particle of that spacing (m) and wave speed (m/s) sets."""
        return cls(OWN_STEP * spacing / wave_speed)


def remeshed(bodies: Bodies, gate: Gate, origin: tuple[float, float, float]) -> tuple[Bodies, Values]:
    """The bodies with what is distorted made new, numbered outwards from origin (m), and a report; the same bodies where
    nothing is, or nothing helped.

    The report says what was measured before and after: step and quality, mass (kg), momentum (N s), energies (J), the
    crater; see docs/theory/splats.md.
    """
    started = clock.perf_counter()
    before = _measures(bodies)
    report: Values = {"gate_step_s": gate.step, "gate_quality": gate.quality, "before": before, "patches": []}
    if before["step_s"] >= gate.step and before["quality"] >= gate.quality:
        return bodies, report | {"remeshed": False}
    if bodies.contact is not None:
        bodies.target.warm(*bodies.contact.heat())
    domain = domain_now(bodies.target, bodies.body)
    limits, gammas = _limits(domain), quality.gamma(domain.nodes.x, domain.mesh.conn)
    shortest, allowed = limits.min(), _loose(bodies)
    faster = limits[~allowed].min(initial=np.inf) > GAIN * shortest
    if not faster and not before["quality"] < gate.quality <= gammas[~allowed].min(initial=np.inf):
        return bodies, report | {"remeshed": False, "kept": "the worst elements touch what is bonded or held"}
    buried = bodies.buried
    number = np.arange(len(bodies.target.x))
    given_up = np.zeros(len(allowed), bool)
    for _ in range(MOST_PATCHES):
        bad, limit = _bad(domain, gate)
        if not (bad := bad & allowed & ~given_up).any():
            break
        seed = int(np.argmin(np.where(bad, limit, np.inf)))
        new_patch, tried, patch_report = _remesh_patch(domain, gate, bad, allowed, seed)
        report["patches"].append(patch_report)
        if new_patch is None:
            given_up |= tried
            continue
        domain = new_patch.domain
        number = np.where(number < 0, -1, new_patch.node[number])
        buried = new_patch.facet[buried]
        out = np.ones(len(allowed), bool)
        out[new_patch.patch.elements] = False
        fresh = len(domain.mesh.conn) - int(out.sum())
        allowed = np.concatenate([allowed[out], np.ones(fresh, bool)])
        given_up = np.concatenate([given_up[out], np.ones(fresh, bool)])  # twice would do no better
    # a transfer blurs the fields a little: nothing is taken over that leaves the step where it was
    sounder = before["quality"] < gate.quality <= quality.gamma(domain.nodes.x, domain.mesh.conn).min()
    gained = sounder or _limits(domain).min() > GAIN * shortest
    if not gained or not any(patch["done"] for patch in report["patches"]):
        return bodies, report | {"remeshed": False, "wall_s": clock.perf_counter() - started}
    # nodes that are gone carry neither bonds nor springs: any new node may stand for them
    number = np.where(number < 0, len(domain.mesh.points) - 1, number)
    domain, rank = merge([domain], origin)
    new = bodies.on(domain, rank[number], buried)
    new.target.sums[2] += sum(patch["warmth_J"] for patch in report["patches"] if patch["done"])
    return new, report | {"remeshed": True, "after": _measures(new), "wall_s": clock.perf_counter() - started}


def _loose(bodies: Bodies) -> np.ndarray:
    """Elements (m,) that may be replaced: those that touch no other body, nor the faces that are held."""
    mesh = bodies.target.mesh
    kept = np.zeros(len(mesh.points), bool)
    kept[mesh.facets[bodies.buried]] = True
    for name in {"bottom", "sides", *bodies.fixed, *bodies.absorbing}:
        kept[mesh.facets[mesh.sets[name]]] = True
    if bodies.bond is not None:
        kept[bodies.bond.nodes] = kept[bodies.bond.triangles] = True
    surfaces, x = bodies.surfaces, bodies.target.x
    for body in range(1, bodies.count):
        contact = interface(surfaces, x, body, NEAR * surfaces.spacing(x, body))
        kept[contact.nodes] = kept[surfaces.facets[contact.facet]] = True
    return ~kept[mesh.conn].any(axis=1)


def _bad(domain: Domain, gate: Gate) -> tuple[np.ndarray, np.ndarray]:
    """Which elements (m,) are distorted, and the bound on the stable step (m,) s of each."""
    limit = _limits(domain)
    return (SAFE * limit < gate.step) | (quality.gamma(domain.nodes.x, domain.mesh.conn) < gate.quality), limit


def _limits(domain: Domain) -> np.ndarray:
    """The safe bound on the stable step (m,) s of each element."""
    limit = np.zeros(len(domain.mesh.conn))
    kernels.stable_dt(0, len(limit), domain.nodes.x, domain.mesh.conn, domain.nodes.J, domain.laws, domain.body, limit)
    return limit * COURANT / (1.0 + LINEAR_VISCOSITY)


@dataclass(frozen=True)
class _NewPatch:
    """domain: with the patch remeshed; node, facet: new number of each node and facet of before, -1 where it is gone."""

    domain: Domain
    node: np.ndarray
    facet: np.ndarray
    patch: Patch
    report: dict[str, float]


def _remesh_patch(
    domain: Domain, gate: Gate, bad: np.ndarray, allowed: np.ndarray, seed: int
) -> tuple[_NewPatch | None, np.ndarray, Values]:
    """Remesh the patch around the element `seed` and the bad elements connected to it, with the finest edges whose step passes the
    gate, else with the edges of the longest step. Returns it, None where nothing succeeds; the elements (m,) bool that were
    tried; a report."""
    mesh, x = domain.mesh, domain.nodes.x
    centre = x[mesh.conn].mean(axis=1)
    same = domain.body == domain.body[seed]
    tried = np.zeros(len(bad), bool)
    tried[seed] = True
    report: Values = {"done": False, "place_m": centre[seed].tolist(), "failed": []}
    best: _NewPatch | None = None
    for reach, factor in TRIES:
        edge = (TETS_PER_H3 * mesh.V0[seed]) ** (1.0 / 3.0)
        worn = same & (bad | (domain.elements.eps_p > STRAINED))
        near = cKDTree(centre[worn]).query(centre)[0] < reach * edge
        patch = patch_of(mesh, near & same, allowed & same, seed)
        if patch is None:
            report["failed"].append("no patch: it would touch what is bonded or held")
            continue
        tried[patch.elements] = True
        try:
            new, node, facet, about = _renew(domain, patch, factor)
        except (SplatError, SolverError) as problem:
            report["failed"].append(str(problem))
            continue
        if best is None or about["step_s"] > best.report["step_s"]:
            best = _NewPatch(new, node, facet, patch, about)
        if about["step_s"] >= gate.step:
            break
    return best, tried, report if best is None else report | best.report | {"done": True}


def _renew(domain: Domain, patch: Patch, factor: float) -> tuple[Domain, np.ndarray, np.ndarray, dict[str, float]]:
    """A patch made new with edges of `factor` times the old ones'. Raises SplatError or SolverError where it cannot be."""
    mesh, x = domain.mesh, domain.nodes.x
    own = mesh.conn[patch.elements]
    edge = factor * float(TETS_PER_H3 * np.median(mesh.V0[patch.elements])) ** (1.0 / 3.0)
    skin, triangles, moved = renewed_surface(x[patch.nodes], patch.triangles, patch.cut, patch.free, edge)
    check_solid(skin, triangles)
    points, tets = apart(partial(mesher.fill, [(skin, triangles)], edge, graded=True), MESHING_LIMIT)
    points, tets = _seamed(points, tets, x[patch.nodes[: patch.cut]], SEAM * edge)
    old_steps, new_steps = quality.step_lengths(x, own), quality.step_lengths(points, tets)
    gamma = quality.gamma(points, tets)
    if not new_steps.min() > GAIN * old_steps.min():
        raise SplatError(f"nothing gained: step length {new_steps.min():.3g} m, was {old_steps.min():.3g} m")
    if gamma.min() < MIN_GAMMA:
        raise SplatError(f"worst quality {gamma.min():.3f}, allowed {MIN_GAMMA}")
    new = _transfer(domain, patch, points, tets, edge)
    remade, node, facet, heat = renewed(domain, patch, new)
    limit = _limits(remade)[-len(tets) :].min()
    return remade, node, facet, {
        "step_s": SAFE * float(limit), "smoothed_J": float(heat[0]), "warmth_J": float(heat[1]), "edge_m": edge,
        "moved_m": moved, "elements_before": len(own), "elements": len(tets),
        "step_length_before_m": float(old_steps.min()), "step_length_m": float(new_steps.min()),
        "quality_before": float(quality.gamma(x, own).min()), "quality": float(gamma.min()),
    }  # fmt: skip


def _seamed(points: np.ndarray, tets: np.ndarray, cut: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and tetrahedra with those of the cut (c,3) m first, exactly as they are there. Raises SplatError where one is missing."""
    distance, nearest = cKDTree(points).query(cut)
    if distance.max() > near or len(np.unique(nearest)) < len(cut):
        raise SplatError("the mesher has moved nodes of the cut")
    order = np.concatenate([nearest, np.setdiff1d(np.arange(len(points)), nearest)])
    ordered = points[order]
    ordered[: len(cut)] = cut
    return ordered, np.argsort(order)[tets]


def _transfer(domain: Domain, patch: Patch, points: np.ndarray, tets: np.ndarray, edge: float) -> Renewal:
    """The state of a patch on its new mesh: sums over reference volume, momenta and energies as they were."""
    mesh, state, x = domain.mesh, domain.nodes, domain.nodes.x
    law = domain.laws[domain.body[patch.elements[0]]]
    own = mesh.conn[patch.elements]
    # fits take in the ring of elements round the patch
    held = np.zeros(len(x), bool)
    held[own] = True
    around = np.flatnonzero(held[mesh.conn].any(axis=1) & (domain.body == domain.body[patch.elements[0]]))
    nodes = np.unique(mesh.conn[around])
    at_elements = Fit(x[mesh.conn[around]].mean(axis=1), points[tets].mean(axis=1), edge)
    at_nodes = Fit(x[nodes], points[patch.cut :], edge)

    J = at_elements(state.J[mesh.conn[around]].mean(axis=1))
    V0_before = mesh.V0[patch.elements]
    V0 = volumes(points, tets) / J
    V0 *= V0_before.sum() / V0.sum()
    s = at_elements(domain.elements.s[around])
    s[:, :3] -= s[:, :3].mean(axis=1)[:, None]
    thermal = at_elements(domain.elements.thermal_stress[around])
    known = {"s": s, "thermal_stress": thermal, "heat": V0 / V0.sum() * domain.elements.heat[patch.elements].sum()}
    for name, spec in rows_of(ElementState).items():
        if not spec.notes.get("computed"):
            values = getattr(domain.elements, name)
            floor = spec.notes.get("floor", float(values[around].min()))
            raw = np.maximum(at_elements(values[around]), floor)
            known[name] = with_sum(raw, V0, float(V0_before @ values[patch.elements]), floor)

    cut, free = patch.nodes[: patch.cut], slice(patch.cut, None)
    all_nodes = np.concatenate([cut, patch.inner])
    new_share = np.bincount(tets.ravel(), np.repeat(0.25 * V0, 4), len(points))
    gone = np.bincount(own.ravel(), np.repeat(0.25 * V0_before, 4), len(x))
    volume = new_share.copy()
    volume[: patch.cut] += mesh.node_volume[cut] - gone[cut]
    old_volume = mesh.node_volume[all_nodes]

    energy = float(old_volume @ state.energy[all_nodes]) - float(volume[: patch.cut] @ state.energy[cut])
    mass, old_mass = volume * law["rho"], old_volume * law["rho"]
    v, v_cut = state.v[all_nodes], state.v[cut]
    P = old_mass @ v - mass[: patch.cut] @ v_cut
    L = old_mass @ np.cross(x[all_nodes], v) - mass[: patch.cut] @ np.cross(x[cut], v_cut)
    kinetic = 0.5 * float(old_mass @ np.sum(v**2, axis=1) - mass[: patch.cut] @ np.sum(v_cut**2, axis=1))
    new_v = with_momentum(at_nodes(state.v[nodes]), points[free], mass[free], P, L)
    new_v = with_energy(new_v, points[free], mass[free], max(kinetic, 0.0))
    node_state = new_rows(
        NodeState, len(points) - patch.cut, energy=with_sum(at_nodes(state.energy[nodes]), volume[free], energy),
        v=with_momentum(new_v, points[free], mass[free], P, L),
    )  # fmt: skip
    return Renewal(points, tets, V0, node_state, new_rows(ElementState, len(tets), **known))


def _measures(bodies: Bodies) -> Values:
    """Step, quality, what is conserved, and the crater."""
    t = bodies.target
    mesh, x, mass = t.mesh, t.x, t.mass
    tops = np.unique(mesh.facets[mesh.sets["top"]])
    depth = measures.crater_depth(x[tops])
    rho = t.laws["rho"][t.law_of]
    return {
        "step_s": t.stable_dt(1.0)[0], "quality": float(quality.gamma(x, mesh.conn).min()), "elements": len(mesh.conn),
        "mass_kg": float(mass.sum()), "volume_m3": float(volumes(x, mesh.conn).sum()),
        "momentum_N_s": (mass @ t.v).tolist(), "angular_momentum_N_m_s": (mass @ np.cross(x, t.v)).tolist(),
        "kinetic_J": 0.5 * float(mass @ np.sum(t.v**2, axis=1)), "elastic_J": t.elastic(),
        "energy_J": t.elastic() + float(t.sums[2]),
        "internal_J": float(mesh.node_volume @ t.energy), "mass_temperature_kg_K": float(rho * mesh.V0 @ t.T),
        "mass_eps_p_kg": float(rho * mesh.V0 @ t.eps_p), "eps_p_max": float(t.eps_p.max()), "T_max_K": float(t.T.max()),
        "crater_depth_m": depth,
        "crater_diameter_m": crater_diameter(x[mesh.facets[mesh.sets["top"]]], 0.05 * depth),
        "rim_height_m": float(x[tops, 2].max()),
    }  # fmt: skip


def crater_diameter(corners: np.ndarray, below: float) -> float:
    """Diameter (m) of the circle with the area, seen from above, of what of facets (k,3,3) m lies deeper than `below` m under
    z = 0.
    """
    flat = corners[:, :, :2]
    u, v = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])  # of overhanging facets negative
    depth = np.sort(-corners[:, :, 2] - below, axis=1)
    a, b, c = depth.T
    with np.errstate(divide="ignore", invalid="ignore"):
        deepest = c * c / ((c - a) * (c - b))  # only the deepest corner lies below
        two = 1.0 - a * a / ((a - b) * (a - c))
    share = np.where(a >= 0.0, 1.0, np.where(b >= 0.0, two, np.where(c > 0.0, deepest, 0.0)))
    return float(np.sqrt(4.0 / np.pi * max(float(share @ area), 0.0)))
