"""Independent check of a finished run, from its files and its scene alone: volumes, energies, ranges and contact.

Nothing here uses the program's own measures, laws or contact search: volumes are sums over tetrahedra and closed surfaces, energies
come from the fields' velocities and stresses, the equation of state is inverted here. `check` returns the figures and the faults.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from coupler import Result, Scene
from coupler.files.fields import Fields
from coupler.files.result import COLD, DOMAINS
from coupler.geometry.library import open3d
from coupler.impact.summary import STUCK
from coupler.physics.materials import Material
from coupler.plan.planning import plan

Array = NDArray[np.float64]

# Energies over the initial kinetic energy E_0, volumes over that of the particle V_p.
LEDGER = 0.01  # largest |drift| of the ledger at the end of an impact
SUM = 1e-6  # sum of the ledger's columns against its drift
MOMENTUM = 1e-10  # over the initial momentum
KINETIC = 0.005  # kinetic energy from the fields against the history, over E_0 plus the elastic energy in the target before the impact
ELASTIC = 0.05  # the same for the elastic energy, from the stresses
AVERAGED = 0.25  # tolerance over the elastic energy: the stored pressure of an element is the mean over its corners
HEAT = 0.10  # deviation of the heat (rise of c_p T) from the bounds by plastic work and friction, over these works
STORED_HEAT = 0.05  # share of the heat of earlier impacts that is added to these works: fields have single precision
JOINED = 0.05  # volume of a splat's elements when it joins, against its mass over its density
VOLUME = 0.015  # change of a body's volume in an impact, against its pressure; of the substrate: over V_p
# tolerance over the sum of all changes of volume: volume depends nonlinearly on pressure, and an element has the mean of its corners
AVERAGED_VOLUME = 0.05
SKIN = 0.20  # volume inside the carried surface of the particle against the volume of its points, relative
SUNK = 0.01  # share of a particle that may lie deeper than a spacing in the target: single points of a jet, as the program allows
# deviation of the momentum change from bounds by the smaller and the larger force of each two rows of the history, over the initial
# momentum; checked if the force acts in more than ROWS rows, because a short force may rise and fall between two rows
IMPULSE = 0.1
ROWS = 10
REST = 0.05  # downward speed over the impact speed: a faster particle is not at rest
FOLLOWED = 20.0  # plastic strain above which the summary must not give this strain as a number
SAME = 1e-3  # figures of the summary against those of the fields
# cooling over the highest rise of temperature: heat of one element reaches its nodes as a mean over about 24 elements around each.
# If the nodes conduct it away, a neighbour that shares three of its four nodes cools, by at most 3/4 of a 24th of this rise
UNDERSHOOT = 0.75 / 24.0
YIELD = 1.1  # von Mises stress over the greatest flow stress of the law
AMBIENT = 5.0  # K from ambient, for any element after the closing stage: plastic flow warms elements while bodies come to rest
DISSIPATION = 0.25  # numerical dissipation of particle and target together; a higher one needs a warning
LENGTH = 1e-6  # m: unit of distances, because open3d computes in single precision
STORED = (
    "kinetic", "elastic_particle", "elastic_target", "plastic_particle", "plastic_target", "numerical_particle",
    "numerical_target", "contact", "friction", "boundary", "bodies", "bond",
)  # fmt: skip


def tetrahedra_volumes(points: Array, cells: NDArray[np.int64]) -> Array:
    """(m,) m3, negative where inverted. points (n,3) m, cells (m,4)."""
    a, b, c, d = (points[cells[:, k]] for k in range(4))
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0


def enclosed_volume(points: Array, triangles: NDArray[np.int64]) -> float:
    """Volume (m3) inside a closed surface, by the divergence theorem. points (n,3) m, triangles (m,3)."""
    p = points - points.mean(axis=0)
    a, b, c = (p[triangles[:, k]] for k in range(3))
    return abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6.0


def thickness_of(points: Array, triangles: NDArray[np.int64], share: float = 0.99, levels: int = 1000) -> float:
    """Distance (m) of two horizontal planes with this share of a closed body between them and half of the rest beyond each, over the
    same distance for a sphere of diameter 1: 0.9172 for 0.99. The volume is the sum of the areas of horizontal sections."""
    corners = points[triangles]
    edges = np.linspace(corners[..., 2].min(), corners[..., 2].max(), levels + 1)
    area = np.zeros(levels)
    for n, z in enumerate(0.5 * (edges[1:] + edges[:-1])):
        above = corners[..., 2] > z
        crossed = corners[above.any(axis=1) & ~above.all(axis=1)]
        there = np.roll(crossed, -1, axis=1)
        part = (z - crossed[..., 2]) / (there[..., 2] - crossed[..., 2] + 1e-300)
        place = crossed[..., :2] + part[..., None] * (there - crossed)[..., :2]
        up, down = (crossed[..., 2] <= z) & (there[..., 2] > z), (crossed[..., 2] > z) & (there[..., 2] <= z)
        p, q = place[up], place[down]  # one p and one q in each triangle: the segments p q go round the body
        area[n] = 0.5 * float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())
    below = np.concatenate([[0.0], np.cumsum(area)])
    low, high = np.interp([0.5 * (1.0 - share), 0.5 * (1.0 + share)], below / below[-1], edges)
    return float(high - low) / 0.9172


def boundary_faces(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces (k,3) of tetrahedra (m,4) that belong to one of them only."""
    faces = np.concatenate([cells[:, [1, 2, 3]], cells[:, [0, 2, 3]], cells[:, [0, 1, 3]], cells[:, [0, 1, 2]]])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def depths(points: Array, nodes: Array, cells: NDArray[np.int64], near: int = 64) -> Array:
    """Depth (k,) m of points (k,3) inside tetrahedra (m,4) of nodes (n,3), below their boundary; 0 outside."""
    corners = nodes[cells]
    tree = cKDTree(corners.mean(axis=1))
    candidates = np.atleast_2d(tree.query(points, min(near, len(cells)))[1])
    base = corners[candidates, 0]
    frame = np.moveaxis(corners[candidates, 1:] - base[:, :, None], -1, -2)  # (k, near, 3, 3), edges as columns
    weights = np.linalg.solve(frame, (points[:, None] - base)[..., None])[..., 0]
    inside = np.any((weights.min(axis=2) > 1e-9) & (weights.sum(axis=2) < 1.0 - 1e-9), axis=1)
    depth = np.zeros(len(points))
    if inside.any():
        surface = open3d().t.geometry.RaycastingScene(nthreads=1)
        surface.add_triangles(np.float32(nodes / LENGTH), np.uint32(boundary_faces(cells)))
        depth[inside] = LENGTH * surface.compute_distance(np.float32(points[inside] / LENGTH), nthreads=1).numpy()
    return depth


def thermal_pressure(metal: Material, T: Array, T_0: float) -> Array:
    """(m,) Pa at T (m,) K: Gamma0 rho c_p (T - T_0)."""
    return metal.Gamma0 * metal.rho * np.interp(T, *np.transpose(metal.cp)) * np.maximum(T - T_0, 0.0)


def volume_ratios(metal: Material, pressure: Array, T: Array, T_0: float) -> tuple[Array, Array]:
    """Bounds (m,) of J at a pressure (m,) Pa and a temperature (m,) K, over the equations of state that a scene may have.

    Linear, p = K (1 - J); on the Hugoniot with the thermal pressure Gamma0 rho c_p (T - T_0), and without it.
    """
    thermal = thermal_pressure(metal, T, T_0)
    candidates = [1.0 - pressure / metal.K]
    for p in (pressure, pressure - thermal):
        eta = p / metal.K
        for _ in range(8):  # p (1 - s eta)^2 = K eta (1 - Gamma0 eta / 2)
            eta = p * (1.0 - metal.s * eta) ** 2 / (metal.K * (1.0 - 0.5 * metal.Gamma0 * eta))
        candidates.append(1.0 - eta)
    return np.min(candidates, axis=0), np.max(candidates, axis=0)


def mean_pressure(stress: Array) -> Array:
    """(n,) Pa of stress (n,6), xx yy zz xy yz xz."""
    return -np.asarray(stress[:, :3], float).mean(axis=1)


def elastic_energy(metal: Material, stress: Array, volume: Array) -> float:
    """J of linear elasticity. stress (n,6) Pa; volume (n,) m3."""
    s, p = np.array(stress, float), mean_pressure(stress)
    s[:, :3] += p[:, None]
    shear = np.einsum("ij,ij->i", s[:, :3], s[:, :3]) + 2.0 * np.einsum("ij,ij->i", s[:, 3:], s[:, 3:])
    return float(volume @ (shear / (4.0 * metal.G) + p**2 / (2.0 * metal.K)))


def thermoelastic_bound(metal: Material, states: list[tuple[Array, Array]], volume: Array, T_0: float) -> float:
    """Bound (J) of the difference between p^2 / 2K and the work of the pressure: the integral of |p dp_th| / K over some states.

    p = K (1 - J) + p_th, so that d(p^2 / 2K) = -p dJ + p dp_th / K. A bound and not the integral, as the fields of an element have
    the mean of the pressures at its corners. states: stress (m,6) Pa and T (m,) K at each instant; volume (m,) m3.
    """
    p = [np.abs(mean_pressure(stress)) for stress, _ in states]
    thermal = [thermal_pressure(metal, np.asarray(T, float), T_0) for _, T in states]
    each = (0.5 * (p[k] + p[k + 1]) * np.abs(thermal[k + 1] - thermal[k]) for k in range(len(states) - 1))
    return float(sum(volume @ bound for bound in each)) / metal.K


def heat(metal: Material, T_0: Array, T: Array, varies: bool) -> Array:
    """(n,) J/kg from T_0 to T (n,) K: Simpson's rule over c_p(T), which is linear between two temperatures, or constant."""
    (low, first), (high, last) = metal.cp[0], metal.cp[-1]  # both are equal for a metal with one value
    if not varies:
        return first * (T - T_0)
    cp = [np.interp(t, (low, high), (first, last)) for t in (T_0, 0.5 * (T_0 + T), T)]
    return (T - T_0) * (cp[0] + 4.0 * cp[1] + cp[2]) / 6.0


def greatest_flow_stress(metal: Material, eps_p: Array) -> Array:
    """(n,) Pa at plastic strains (n,): when cold, at a strain rate of 1e10 1/s."""
    strains = np.linspace(0.0, max(float(np.max(eps_p, initial=0.0)), 1e-9), 400)
    stress = np.array([metal.flow_stress(eps, 1e10, min(metal.T_ref, 250.0)) for eps in strains])
    return stress[np.minimum(np.searchsorted(strains, eps_p), 399)]  # at the next larger strain: a bound


def value(record: Mapping[str, Any], name: str) -> Any:
    """A figure of an impact's record in the summary, at its end."""
    return record[name] if name in record else record["end"].get(name)


def half_space_energy(scene: Scene, untouched: Fields, target: Fields) -> float:
    """Energy (J) of the springs that replace the half-space beyond a face: traction 4 G u / R normal to a facet, 2 G u / R within it.

    R: distance of the facet from the middle of the surface of the substrate (docs/theory/target.md). untouched: the target before the
    first impact. The displacement u of its nodes on these faces is that to the nearest node of `target`.
    """
    substrate, x = scene.substrate, untouched.points
    faces = boundary_faces(untouched.cells)
    corners = x[faces]
    at_limit = np.zeros(len(faces), bool)
    for name, on in (
        ("bottom", corners[:, :, 2] < x[:, 2].min() + 1e-9),
        ("sides", np.hypot(corners[:, :, 0], corners[:, :, 1]) > 0.5 * substrate.diameter * (1.0 - 1e-6)),
    ):
        at_limit |= on.all(axis=1) & (getattr(substrate, name) == "half_space")
    if not at_limit.any():
        return 0.0
    own = corners[at_limit]
    normal = np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    normal /= 2.0 * area[:, None]
    base = target.points[np.unique(target.cells[target.data["impact"] == 0])]
    moved = base[cKDTree(base).query(own)[1]] - own
    across = np.einsum("fci,fi->fc", moved, normal) ** 2
    R = np.linalg.norm(own.mean(axis=1), axis=1)
    each = (2.0 * (np.einsum("fci,fci->fc", moved, moved) - across) + 4.0 * across).sum(axis=1) / 3.0
    below = -np.cumsum([layer.thickness for layer in substrate.layer])  # z of each layer's lower side
    of_face = (own[:, :, 2].mean(axis=1)[:, None] < below).sum(axis=1)
    G = np.array([scene.derived.material(name).G for name in substrate.materials])[of_face]
    return float(0.5 * np.sum(G / R * area * each))


@dataclass
class Findings:
    """faults: texts; figures: the worst of each kind over all impacts; undecided, warned: texts of the run itself."""

    faults: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    undecided: str | None = None
    warned: list[str] = field(default_factory=list)

    def fault(self, wrong: bool, text: str) -> None:
        """Note a fault where something is wrong, once."""
        if wrong and text not in self.faults:
            self.faults.append(text)

    def hold(self, name: str, number: float, limit: float, text: str) -> None:
        """Keep the largest figure of a kind, and note a fault if a number is not within the limit."""
        self.figures[name] = max(self.figures.get(name, 0.0), abs(float(number)))
        self.fault(not abs(number) <= limit, f"{text}: {number:.3g}, allowed {limit:.3g}")


Instant = dict[str, Fields]  # by domain


def check(result: Result) -> Findings:
    """Figures and faults of a finished run. Raises StoreError for files that cannot be read."""
    scene = Scene.from_text(result.scene_text, "scene")
    warnings = result.summary["run"].get("warnings") or []
    found = Findings(undecided=result.undecided)
    found.warned = [text for text in warnings if "melting" in text or "of the kinetic energy" in text]
    records, history = result.summary["impacts"], result.history()
    for i, record in enumerate(records if found.undecided is None else records[:-1]):
        refused = {key: reason for key, reason in record.get("refused", {}).items() if reason != STUCK}
        found.warned += [f"impact {i + 1}: no {key}, {reason}" for key, reason in refused.items()]
    instants = [{domain: result.fields(k, domain) for domain in DOMAINS} for k in range(len(result.times("target")))]
    for name, column in history.items():
        found.fault(not np.all(np.isfinite(column)), f"history: {name} is not a number")
    for step, instant in enumerate(instants):
        for domain, f in instant.items():
            for name, data in {"points": f.points, **f.data}.items():
                found.fault(not np.all(np.isfinite(data)), f"{domain}, step {step}: {name} is not a number")
            found.fault(f.data["eps_p"].min() < 0.0, f"{domain}, step {step}: a plastic strain is negative")
    impacts = _by_impact(instants)
    n, last = len(impacts), len(scene.particles)
    complete = n == len(records) == len(np.unique(history["impact"])) and (n == last or found.undecided is not None)
    found.fault(not complete, f"fields of {n} impacts, records of {len(records)}, {last} particles")
    if found.faults:  # the other checks need valid numbers
        return found
    untouched = instants[0]["target"]
    for i, own in enumerate(impacts):
        rows = {name: column[history["impact"] == i + 1] for name, column in history.items()}
        _ImpactCheck(found, scene, i, own, rows, records[i], untouched, result.summary["joins"][:i]).all()
    if scene.end.at == "cold" and found.undecided is None:
        found.fault(len(result.times(COLD)) != 1, "no fields of the closing stage")
        if not found.faults:
            _check_cold(found, scene, result)
    return found


def bodies_of(scene: Scene, target: Fields) -> list[tuple[Material, float]]:
    """Material and initial temperature (K) of each body of a target: the substrate, its layers upwards, the splats."""
    came = np.zeros(int(target.data["body"].max()) + 1, int)
    came[target.data["body"].astype(int)] = target.data["impact"]
    ground = [(name, scene.substrate.temperature) for name in reversed(scene.substrate.materials)]
    splats = [scene.particles[k - 1] for k in came[len(ground) :]]
    return [(scene.derived.material(name), T) for name, T in [*ground, *((p.material, p.temperature) for p in splats)]]


def splat_volumes(scene: Scene, target: Fields, volume: Array, joins: list[dict[str, Any]]) -> dict[int, float]:
    """Volume of each splat in a target over that of its mass, without the mass that it has lost (reports of joining).

    volume (m,) m3, of the target's elements.
    """
    ratios = {}
    for k in (int(k) for k in np.unique(target.data["impact"]) if k > 0):
        fragments = [join.get("lost_mass_kg", 0.0) for join in joins if join.get("impact") == k]
        fallen = [each["mass_kg"] for join in joins for each in join.get("detached", []) if each["splat"] == k]
        splat = scene.particles[k - 1]
        lost = (sum(fragments) + sum(fallen)) / scene.derived.material(splat.material).rho
        ratios[k] = float(volume[target.data["impact"] == k].sum()) / (splat.volume - lost)
    return ratios


def _check_cold(found: Findings, scene: Scene, result: Result) -> None:
    """Check the bodies after the closing stage: temperature, stress against the yield stress, volume against the mass of splats."""
    f = result.fields(-1, COLD)
    volume, body = tetrahedra_volumes(f.points, f.cells), f.data["body"].astype(int)
    for name, data in {"points": f.points, **f.data}.items():
        found.fault(not np.all(np.isfinite(data)), f"cold: {name} is not a number")
    found.fault(volume.min() <= 0.0, "cold: an element is inverted")
    if found.faults:
        return
    found.hold("ambient", np.abs(f.data["T"] - scene.end.ambient).max(), AMBIENT, "cold: K from ambient")
    for b, (metal, _) in enumerate(bodies_of(scene, f)):
        own = body == b
        stress = f.data["von_mises"][own].astype(float)
        over = float((stress / greatest_flow_stress(metal, f.data["eps_p"][own].astype(float))).max())
        found.hold("yield", over, YIELD, f"cold: von Mises stress of body {b} over the law's")
    reports = [*result.summary["joins"], result.summary["closing"]]
    for k, ratio in splat_volumes(scene, f, volume, reports).items():
        found.hold("joined", ratio - 1.0, JOINED, f"cold: volume of splat {k} against its mass")


def _by_impact(instants: list[Instant]) -> list[list[Instant]]:
    """The instants of each impact. An impact begins when all points of the particle have the same velocity again."""
    impacts: list[list[Instant]] = []
    flying = False
    for instant in instants:
        velocity = instant["particle"].data["velocity"]
        before, flying = flying, float(np.ptp(velocity, axis=0).max()) < 1e-3
        if flying and not before:
            impacts.append([])
        if impacts:
            impacts[-1].append(instant)
    return impacts


class _ImpactCheck:
    """Checks of one impact. rows: its part of the history; record: its part of the summary; untouched: the target before the first
    impact; joins: reports of the splats that have joined before; mass kg, energy J: of the particle at the start."""

    def __init__(
        self, found: Findings, scene: Scene, i: int, instants: list[Instant], rows: dict[str, Array], record: Mapping[str, Any],
        untouched: Fields, joins: list[dict[str, Any]],
    ):  # fmt: skip
        self.found, self.scene, self.where = found, scene, f"impact {i + 1}"
        self.instants, self.rows, self.record = instants, rows, record
        self.first, self.last = instants[0], instants[-1]
        self.p = p = scene.particles[i]
        self.metal = scene.derived.material(p.material)
        self.mass = self.metal.rho * p.volume
        self.energy = 0.5 * self.mass * p.velocity**2
        planned = plan(scene)
        self.effects, self.end_at = planned.effects, planned.impact.end_at
        self.bodies, self.joins = bodies_of(scene, self.last["target"]), joins
        self.untouched, self.number = untouched, i + 1
        self.body = self.last["target"].data["body"].astype(int)
        self.volumes = [tetrahedra_volumes(f["target"].points, f["target"].cells) for f in instants]

    def hold(self, name: str, number: float, limit: float, text: str) -> None:
        self.found.hold(name, number, limit, f"{self.where}: {text}")

    def all(self) -> None:
        latest = int(self.last["target"].data["impact"].max())
        self.found.fault(latest >= self.number, f"{self.where}: the target holds the splat of impact {latest} already")
        self.found.fault(not self.rows["contact_force"].max() > 0.0, f"{self.where}: the particle never touched")
        if latest < self.number:
            self.ledger()
            self.contact()
            self.volume()
            self.kinetic_and_elastic()
            self.heat()
            self.ranges()
            self.measures()

    def ledger(self) -> None:
        rows = self.rows
        total = sum(rows[name] for name in STORED) / self.energy - rows["drift"]
        self.hold("sum", np.ptp(total), SUM, "the ledger's columns do not add up to its drift")
        self.hold("drift", rows["drift"][-1], LEDGER, "the energy ledger is open")
        self.hold("momentum", rows["momentum_error"].max(), MOMENTUM, "momentum")
        dissipated = (rows["numerical_particle"][-1] + rows["numerical_target"][-1]) / self.energy
        warned = any("of the kinetic energy" in text for text in self.found.warned)
        self.hold("dissipated", dissipated, np.inf if warned else DISSIPATION, "dissipated, without a warning")

    def contact(self) -> None:
        """Impulse of the contact force, depth of the particle in the target, motion at the end."""
        rows, target = self.rows, self.last["target"]
        taken = self.mass * (rows["velocity_z"][-1] - rows["velocity_z"][0])
        force = np.sort(np.stack([rows["contact_force"][:-1], rows["contact_force"][1:]]), axis=0)
        impulses = force * np.diff(rows["time"])
        low, high = impulses.sum(axis=1)
        if np.count_nonzero(rows["contact_force"]) > ROWS:
            between = float(impulses[1].max())  # a peak of the force may lie between two rows
            outside = max(low - between - taken, taken - high - between, 0.0) / (self.mass * self.p.velocity)
            self.hold("impulse", outside, IMPULSE, "impulse of the contact force")
        # if the summary has no thickness, the surface does not follow the points, and the points count
        name = "particle" if value(self.record, "thickness_m") is None else "surface"
        depth = depths(self.last[name].points, target.points, target.cells) / self.scene.derived.spacing
        self.found.figures["depth"] = max(self.found.figures.get("depth", 0.0), float(depth.max()))
        self.hold("sunk", np.mean(depth > 1.0), SUNK, f"share of the {name} more than a spacing inside the target")
        if self.end_at == "rest" and self.scene.end.time is None and not self.found.undecided:
            sinking = max(-rows["velocity_z"][-1] / self.p.velocity, 0.0)
            self.hold("sinking", sinking, REST, "said to be at rest, but sinks")

    def volume(self) -> None:
        """Volumes of the bodies against their pressure and mass, and of the particle's surface."""
        least = min(v.min() for v in self.volumes)
        self.found.fault(least <= 0.0, f"{self.where}: an element of the target is inverted")
        inside = self.last["surface"]
        closed = enclosed_volume(inside.points, inside.cells) / self.p.volume
        data = self.last["particle"].data
        J = np.mean(volume_ratios(self.metal, mean_pressure(data["stress"]), data["T"], self.p.temperature))
        enlarged = 1.0 / (1.0 - self.p.porosity) - 1.0  # pores lie inside the outer surface
        limit = SKIN + enlarged if value(self.record, "thickness_m") is not None else np.inf
        self.hold("skin", closed / J - 1.0, limit, "volume inside the particle's surface, off that of its points")
        for k, ratio in splat_volumes(self.scene, self.first["target"], self.volumes[0], self.joins).items():
            self.hold("joined", ratio - 1.0, JOINED, f"volume of splat {k} against its mass")
        for b, (metal, T_0) in enumerate(self.bodies):
            own = self.body == b
            # bounds of the change of volume (m3) due to the pressure, at the first and the last instant. Both use the volumes at the
            # start. The pressure of an element is the mean over its corners, and so over the elements around them
            bounds, changed = [], 0.0
            for f in (self.first, self.last):
                data = f["target"].data
                ratios = volume_ratios(metal, mean_pressure(data["stress"][own]), data["T"][own], T_0)
                bounds.append([float(self.volumes[0][own] @ (J - 1.0)) for J in ratios])
                changed = max(float(self.volumes[0][own] @ np.abs(J - 1.0)) for J in ratios)
            (low_0, high_0), (low, high) = bounds
            start, end = self.volumes[0][own].sum(), self.volumes[-1][own].sum()
            off = max(end - start - (high - low_0), low - high_0 - (end - start)) - AVERAGED_VOLUME * changed
            excess = max(off, 0.0) / (start if b else self.p.volume)
            self.hold("volume", excess, VOLUME, f"volume of body {b} against its pressure")

    def kinetic_and_elastic(self) -> None:
        """Energies of the fields at the end against those of the history."""
        points, cells = self.last["particle"].data, self.last["target"].data
        each = self.mass / len(self.last["particle"].points)
        rho = np.array([metal.rho for metal, _ in self.bodies])[self.body]
        shares = np.repeat(self.volumes[0] * rho / 4.0, 4)
        nodal = np.bincount(self.last["target"].cells.ravel(), shares, len(self.last["target"].points))
        of_point = np.full(len(points["T"]), each / self.metal.rho)
        energies = {
            "kinetic_particle": 0.5 * each * float(np.sum(points["velocity"].astype(float) ** 2)),
            "kinetic_target": 0.5 * float(nodal @ np.sum(cells["velocity"].astype(float) ** 2, axis=1)),
            "elastic_particle": elastic_energy(self.metal, points["stress"], of_point),
            "elastic_target": 0.0,
        }
        stored = 0.0  # by the impacts before
        for b, (metal, _) in enumerate(self.bodies):
            own = self.body == b
            before, after = (f["target"].data["stress"][own] for f in (self.first, self.last))
            volume = self.volumes[0][own]
            energies["elastic_target"] += elastic_energy(metal, after, volume) - elastic_energy(metal, before, volume)
            stored += elastic_energy(metal, before, volume)
        springs = [half_space_energy(self.scene, self.untouched, f["target"]) for f in (self.first, self.last)]
        energies["elastic_target"] += springs[1] - springs[0]
        uncertain = AVERAGED * abs(self.rows["elastic_target"][-1])
        for b, (metal, T_0) in enumerate(self.bodies):
            own = self.body == b
            states = [(f["target"].data["stress"][own], f["target"].data["T"][own]) for f in self.instants]
            uncertain += thermoelastic_bound(metal, states, self.volumes[0][own], T_0)
        for name, energy in energies.items():
            kind, body = name.split("_")
            off = abs(energy - self.rows[name][-1]) - (uncertain if name == "elastic_target" else 0.0)
            share = max(off, 0.0) / (self.energy + stored)
            self.hold(kind, share, {"kinetic": KINETIC, "elastic": ELASTIC}[kind], f"{kind} energy of the {body}")

    def heat(self) -> None:
        """Check the heat of all bodies (conduction moves heat) against plastic work, dissipation, friction and torn bonds."""
        varies, T = self.effects.temperature_dependent_cp, self.last["particle"].data["T"].astype(float)
        warmed = self.mass * float(np.mean(heat(self.metal, np.full(len(T), self.p.temperature), T, varies)))
        stored = 0.0  # by the impacts before
        for b, (metal, T_0) in enumerate(self.bodies):
            own = self.body == b
            before, after = (f["target"].data["T"][own].astype(float) for f in (self.first, self.last))
            warmed += metal.rho * float(self.volumes[0][own] @ heat(metal, before, after, varies))
            at_first = np.abs(heat(metal, np.full(len(before), T_0), before, varies))
            stored += metal.rho * float(self.volumes[0][own] @ at_first)
        work = [float(self.rows[name][-1]) for name in ("plastic_particle", "plastic_target", "friction")]
        shares = [metal.taylor_quinney for metal, _ in self.bodies]
        low, high = (self.metal.taylor_quinney * work[0] + share * work[1] for share in (min(shares), max(shares)))
        if not self.effects.plastic_heating:
            low = high = 0.0
        if self.effects.friction_heat:  # only the work of torn bonds becomes heat
            high += work[2] + sum(max(float(self.rows[name][-1]), 0.0) for name in ("bond", "bodies"))
        if self.effects.dissipation_heat:
            high += max(float(self.rows["numerical_particle"][-1] + self.rows["numerical_target"][-1]), 0.0)
        excess = max(warmed - high, low - warmed, 0.0) / (sum(work) + 0.01 * self.energy + STORED_HEAT * stored)
        self.hold("heat", excess, HEAT, "heat against plastic work")

    def ranges(self) -> None:
        """Temperatures, stresses and plastic strains of every written step."""
        coldest = min(self.p.temperature, *(T for _, T in self.bodies)) - 1.0
        before: dict[str, Array] = {}
        for instant in self.instants:
            parts = [("particle", self.metal, np.full(len(instant["particle"].points), True))]
            parts += [("target", metal, self.body == b) for b, (metal, _) in enumerate(self.bodies)]
            hottest = max(float(instant[name].data["T"].max()) for name in ("particle", "target"))
            for name, metal, own in parts:
                data = {key: instant[name].data[key][own].astype(float) for key in ("T", "eps_p", "von_mises")}
                place = f"{self.where}: {name} at {data['T'].min():.0f} K, colder than all at the start"
                self.found.fault(data["T"].min() < coldest - UNDERSHOOT * (hottest - coldest), place)
                most = np.inf if any("melting" in text for text in self.found.warned) else 1.0
                self.hold("melting", data["T"].max() / metal.T_m, most, "T over T_m, without a warning")
                stress = float((data["von_mises"] / greatest_flow_stress(metal, data["eps_p"])).max())
                self.hold("yield", stress, YIELD, f"von Mises stress of the {name} over the law's")
                self.hold("eps_p", data["eps_p"].max(), np.inf, "")
            for name in ("particle", "target"):
                strain = instant[name].data["eps_p"]
                fallen = float((before.get(name, strain) - strain).max())
                self.hold("fallen", max(fallen, 0.0), 1e-6, f"a plastic strain of the {name} fell")
                before[name] = strain

    def measures(self) -> None:
        """Check the record of the summary against the fields at the end; a measure that is None is not checked."""
        points, cells = self.last["particle"].data, self.last["target"].data
        surface = self.last["surface"]
        thickness = thickness_of(surface.points, surface.cells)
        expected = {  # value, size below which a difference does not count
            "thickness_m": (thickness, 1e-2 * self.p.diameter), "flattening_ratio_total": (1.0 - thickness / self.p.diameter, 0.1),
            "eps_p_max": (points["eps_p"].max(), 0.1), "eps_p_mean": (points["eps_p"].mean(), 0.1), "T_max_K": (points["T"].max(), 1.0),
            "target_eps_p_max": (cells["eps_p"].max(), 0.1), "target_T_max_K": (cells["T"].max(), 1.0),
            "velocity_z_m_s": (points["velocity"][:, 2].mean(), self.p.velocity),
        }  # fmt: skip
        for name, (number, size) in expected.items():
            reported = value(self.record, name)
            off = 0.0 if reported is None else abs(reported - number) / max(abs(number), size)
            text = f"{self.where}: {name} is {reported} in the summary, {number:.6g} from the fields"
            self.found.fault(off > SAME, text)
        for name in ("eps_p_max", "target_eps_p_max"):
            bad = expected[name][0] > FOLLOWED and value(self.record, name) is not None
            self.found.fault(bad, f"{self.where}: {name} {expected[name][0]:.3g} is a number in the summary")
