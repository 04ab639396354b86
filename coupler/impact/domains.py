"""The domains of one impact, built from the plan: target, particle, and the contact and heat flow between them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ..contact.contact import Contact
from ..contact.law import stiffness
from ..core.records import new_rows
from ..fe.boundary import HALF_SPACE
from ..fe.explicit import Target
from ..fe.mesh import name_sides, prepare
from ..geometry import mesher
from ..geometry.apart import apart
from ..geometry.tetrahedra import volumes
from ..particle import shapes
from ..particle.carried_surface import CarriedSurface
from ..particle.engine import engine
from ..particle.heat import PointConduction
from ..particle.inertia import ENOUGH
from ..particle.particle import Numerics, Particle
from ..physics.adhesion import Adhesion
from ..physics.constitutive import is_metal, law_record
from ..physics.materials import Material
from ..physics.metal import MetalState
from ..plan.model import TargetPlan
from ..plan.planning import ImpactPlan, Plan
from ..ranks import ranks as parallel
from ..ranks.distributed import DistributedParticle
from ..target.bodies import Bodies, BodiesState
from ..target.domain import BodyState, domain_now
from ..target.positions import level_under
from .folding import SHAPES, Folding

MESHING_LIMIT = 600.0  # s, time limit of gmsh for the substrate


@dataclass
class Domains:
    """The two domains of an impact, ready to run, with the contact between them.

    plan, i: plan of the run, and index of the impact; particle: its points on all ranks; bodies: substrate and splats; surface: outer
    surface of the particle, carried by its points; level: height (m) of the target's surface where the particle first touches it;
    conduction: inside the particle; folding: self-contact of the particle; each None if it is not computed.
    """

    plan: Plan
    i: int
    particle: DistributedParticle
    bodies: Bodies
    contact: Contact
    surface: CarriedSurface
    level: float
    conduction: PointConduction | None
    folding: Folding | None

    @property
    def own(self) -> ImpactPlan:
        """The plan of this impact."""
        return self.plan.impacts[self.i]

    @property
    def target(self) -> Target:
        return self.bodies.target

    @property
    def whole_surface(self) -> CarriedSurface:
        """The surface of the particle, including its cavities."""
        return self.surface if self.folding is None else self.folding.surface


def build_target(plan: Plan) -> Bodies:
    """The meshed substrate, which is the target of the first impact: its layers are bodies, tied like splats. Starts gmsh."""
    t = plan.target
    below = sum(thickness for _, thickness in t.layers)
    sizes = t.diameter, t.height - below, t.element_size, t.refined_radius, t.growth, t.centre, t.largest_element
    top = None if t.is_flat else t.heights
    points, tets = apart(partial(mesher.cylinder, *sizes, spread=t.spread, top=top, below=below), MESHING_LIMIT)
    law_of = partial(law_record, on=vars(plan.effects), rate_filter=plan.impacts[0].rate_filter)
    fixed, absorbing, on = t.faces("fixed"), t.faces("absorbing"), plan.effects
    at = plan.impacts[0].offset
    mesh = prepare(points, tets, (*at, float(t.heights(np.array([at]))[0])))
    if half_space := t.faces("half_space"):
        mesh.sets[HALF_SPACE] = np.concatenate([mesh.sets[name] for name in half_space])
        mesh = replace(mesh, axis=np.array(t.centre))
    target = Target(mesh, law_of(t.material), t.temperature, fixed=fixed, absorbing=absorbing, conduction=on.conduction)
    bodies = Bodies(target, np.zeros(len(mesh.conn), np.int32), fixed, absorbing, plan.friction)
    for metal, thickness in reversed(t.layers):
        below -= thickness
        disc = partial(mesher.cylinder, t.diameter, thickness, *sizes[2:], spread=t.spread, below=max(below, 0.0))
        layer = _layer(*apart(disc, MESHING_LIMIT), law_of(metal), t)
        bodies = bodies.joined([layer], Adhesion(kind="tied"), t.element_size, (*at, 0.0), None, 0)
    return _with_faces(bodies, half_space) if t.layers else bodies


def _layer(points: np.ndarray, tets: np.ndarray, law: np.ndarray, t: TargetPlan) -> BodyState:
    """A layer at rest without stress, of points (n,3) m and tetrahedra (m,4). law: LAW record."""
    n, m = len(points), len(tets)
    state = vars(new_rows(MetalState, m, T=np.full(m, t.temperature)))
    mass = float(law["rho"][0]) * float(np.abs(volumes(points, tets)).sum())
    return BodyState(points, tets, np.zeros((m, 6)), np.ones(m), np.zeros((n, 3)), np.zeros(n), mass, law, **state)


def _with_faces(bodies: Bodies, half_space: tuple[str, ...]) -> Bodies:
    """`bodies`, a layered substrate, with sets of its outer faces: top, sides, bottom; HALF_SPACE: union of the sets `half_space`."""
    domain = domain_now(bodies.target, bodies.body)
    mesh, of_facet = domain.mesh, bodies.body[domain.mesh.facet_element]
    sets = name_sides(mesh.points, mesh.facets)
    for name, body in (("top", bodies.count - 1), ("bottom", 0)):
        sets[name] = sets[name][of_facet[sets[name]] == body]
    if half_space:
        sets[HALF_SPACE] = np.concatenate([sets[name] for name in half_space])
    rank = np.arange(len(mesh.points))
    return bodies.with_domain(replace(domain, mesh=replace(mesh, sets=sets)), rank, bodies.buried)


def metals_of(plan: Plan, bodies: Bodies) -> list[Material]:
    """The material of each body of the target. Its LAW record tells whether a body is a shell, a core or a layer."""
    found = []
    for law, i in zip(np.split(bodies.target.laws, bodies.count), bodies.impact.tolist(), strict=True):
        known = plan.impacts[i - 1].materials if i else plan.target.materials
        found.append(next((metal for metal in known[1:] if is_metal(law, metal)[0]), known[0]))
    return found


def restored_target(plan: Plan, state: BodiesState) -> Bodies:
    """Make the bodies of a stored state. Raises CheckpointError if parts of the state do not fit each other."""
    return Bodies.from_state(
        state, plan.target.faces("fixed"), plan.target.faces("absorbing"), plan.friction, plan.effects.conduction
    )


def build_domains(
    plan: Plan,
    i: int = 0,
    bodies: Bodies | None = None,
    log_file: Path | None = None,
    numerics: Mapping[str, float] | None = None,
    ranks: parallel.Ranks | None = None,
    level: float | None = None,
) -> Domains:
    """Make the particle of impact i above the bodies (default: the bare substrate), and the contact between them. Starts LAMMPS.

    log_file: log file of LAMMPS; numerics: values in place of the defaults of `particle.particle.Numerics`; ranks: default this
    process alone; level: height (m) of the surface where the particle first touches it, default: from the positions of the bodies.
    """
    ranks, bodies = ranks or parallel.Ranks(), bodies if bodies is not None else build_target(plan)
    impact_plan, t = plan.impacts[i], plan.target
    body = body_of(plan, i)
    target, facets = bodies.target, bodies.reachable()
    mesh, x = target.mesh, target.nodes.x
    offset = np.array([*impact_plan.offset, 0.0])
    if level is None:
        level = 0.0
        if not bodies.is_flat:
            level = level_under(body.vertices + offset, x, mesh.facets[facets]) - body.half_height
    place = offset + np.array([0.0, 0.0, body.half_height + level + impact_plan.gap])
    parallel.begin_impact(ranks, i, place, numerics or {})
    local = build_particle(plan, i, place, ranks, numerics, log_file, body) if ranks.sph_comm is not None else None
    particle = DistributedParticle(ranks, local, len(body.points), body.spacing)
    surface = CarriedSurface(body.points + place, body.vertices + place, body.triangles, body.spacing)
    softer = min(impact_plan.material.K, float(target.laws["K"].min()))
    k = stiffness(softer, body.area / len(body.vertices), body.spacing, plan.contact_stiffness)
    points, of_target = np.zeros(surface.touching.shape[0], np.int64), np.ones(len(mesh.facets), np.int64)
    own, other = impact_plan.material.effusivity(impact_plan.temperature), t.materials[-1].effusivity(t.temperature)
    share = own / (own + other)  # share of the particle in the heat of friction, as for two half-spaces in contact
    contact = Contact(points, mesh.facets, of_target, [k], [body.spacing], plan.friction, share, facing=[facets])
    inside = None
    if plan.effects.particle_conduction:
        volume = np.full(len(body.points), body.volume)
        inside = PointConduction(body.points, body.spacing, volume, particle.law, particle.law_of)
    folds = impact_plan.shape in SHAPES or body.inner is not None
    itself = Folding(body, surface, place, k, plan.friction) if folds else None
    return Domains(plan, i, particle, bodies, contact, surface, level, inside, itself)


def body_of(plan: Plan, i: int) -> shapes.Body:
    """Points and surface of the particle of impact i, relative to its centre."""
    p = plan.impacts[i]
    if p.file:
        points, triangles = map(np.array, vars(plan.solids[p.file]).values())
        return shapes.of_surface(points, triangles, p.diameter, p.points, p.tilt)
    return shapes.shape(p.shape, p.diameter, p.points, p.tilt, p.pores)


def build_particle(
    plan: Plan,
    i: int,
    place: np.ndarray,
    ranks: parallel.Ranks,
    numerics: Mapping[str, float] | None,
    log_file: Path | None,
    body: shapes.Body | None = None,
) -> Particle:
    """Make the part of the particle of impact i that this rank computes. Starts LAMMPS on all ranks that share the particle.

    place (3,) m: centre; body: result of `body_of`, computed by default; others: as in `build_domains`.
    """
    p, body = plan.impacts[i], body or body_of(plan, i)
    law = np.concatenate([law_record(metal, vars(plan.effects), p.rate_filter) for metal in p.materials])
    usual = {"inertia": ENOUGH} if plan.mass_scaling and plan.is_on_coating(i) else {}
    settings = Numerics(**usual | dict(numerics or {}))
    return engine(plan.engine, settings)(
        body.points + place, body.volume, law, p.velocity, p.temperature, settings,
        comm=ranks.sph_comm, log=log_file, strain=p.initial_strain, law_of=shapes.core_of(body, p.core.share) if p.core else None,
    )  # fmt: skip
