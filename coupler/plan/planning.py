"""Makes the plan of a run: all decisions, before any computation. No solver is imported."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from .. import units
from ..core.arrays import Vector
from ..geometry.tetrahedra import COARSEST
from ..measures import REBOUNDS
from ..physics.adhesion import Adhesion, pair_formula
from ..physics.materials import Material
from ..scene.effects import Effects, requested
from ..scene.ground import Face
from ..scene.tables import Particle
from . import cost as estimates
from . import effects
from .batches import batches_of
from .gas import describe as describe_gas
from .ground import ground_of
from .model import ImpactPlan, Plan, SolidPlan, TargetPlan, towards
from .reading import Scene
from .refinement import companions
from .remarks import absorbing_distance, remarks
from .solids import load

RATE_FILTER_OVER_CROSSING = 0.01  # time constant of the strain rate's average over D / v
# factors on the penalty stiffness of the contact; the second with bonds: the springs then store a tenth of the rebound's energy
CONTACT_STIFFNESS, BONDED_STIFFNESS = 1.0, 8.0
COLD_EFFECTS = ("plastic_heating", "mie_gruneisen", "thermal_expansion")


def plan(scene: Scene, contact_stiffness: float | None = None, error: bool | None = False) -> Plan:
    """Make the plan of a checked scene. contact_stiffness: factor on the penalty stiffness, None: chosen from the adhesion; error:
    whether coarser runs measure the error. Raises SceneError for an unknown material."""
    target, d = _target(scene), scene.derived
    normals = [target.normal(p.offset, 0.5 * p.diameter, _velocity(p), d.gap_of(p)) for p in scene.particles]
    impacts = tuple(_impact(scene, i, normals) for i in range(len(scene.particles)))
    solids = {name: load(Path(name)) for name in dict.fromkeys(i.file for i in impacts if i.file)}
    base = d.material(scene.substrate.materials[0])
    usual = [d.end_time_of(particle) for particle in scene.particles]
    numbers = [  # waves and heat of an impact also travel during later impacts
        effects.numbers(scene, impact, base, absorbing_distance(scene, impact.offset), usual[i], sum(usual[i:]))
        for i, impact in enumerate(impacts)
    ]
    decisions = effects.decide(scene, numbers, _settled(scene))
    decided = Effects(**{row.name: row.on for row in decisions})
    if not decided.absorbing_boundaries:  # no wave comes back in time: simple faces give the same result at lower cost
        sides: Face = "free" if target.sides == "absorbing" else target.sides
        target = replace(target, sides=sides, bottom="fixed" if target.bottom == "absorbing" else target.bottom)
    adhesion = d.adhesion_law if decided.adhesion else Adhesion(kind="none")
    return Plan(
        name=scene.name,
        impacts=impacts,
        batches=batches_of(impacts, decided.cooling),
        target=target,
        adhesion=adhesion,
        splat_method=scene.splat.method,
        splat_element_size=d.splat_element_size,
        mass_scaling=float(scene.splat.mass_scaling),
        friction=scene.contact.friction if decided.friction else 0.0,
        contact_stiffness=contact_stiffness or (BONDED_STIFFNESS if adhesion.in_impact else CONTACT_STIFFNESS),
        effects=decided,
        decisions=decisions,
        preset=scene.preset,
        engine=scene.resolution.engine,
        gas=tuple(describe_gas(scene)),
        warnings=tuple(remarks(scene, impacts, base, decided)),
        ambient=d.ambient,
        cooling_time=scene.end.cooling_time,
        surface_heat=d.surface_heat,
        spray=_spray(scene),
        companions=companions(scene) if error else (),
        solids={name: SolidPlan(each.points.tolist(), each.triangles.tolist()) for name, each in solids.items()},
    )


def _settled(scene: Scene) -> dict[str, bool]:
    """The effects that the scene sets; True means on. They are those of the key `effects`, those that residual stresses need, and
    cooling if a dwell follows from the spray."""
    settled = requested(scene.effects)
    if scene.derived.ambient is not None:  # they cause residual stresses
        settled = dict.fromkeys(COLD_EFFECTS, True) | settled
    if any(p.dwell is None for p in scene.particles[:-1]):
        settled = {"cooling": True} | settled
    return settled


def _velocity(particle: Particle) -> Vector:
    return particle.velocity * math.sin(particle.angle), 0.0, -particle.velocity * math.cos(particle.angle)


def _stays(scene: Scene, particle: Particle, normal: Vector) -> bool:
    """Whether a particle is expected to stick as a splat. This is so, unless the criterion of adhesion is "velocity" and the formula
    of the critical velocity (`pair_formula`) predicts a rebound. normal: of the ground."""
    law, metal = scene.derived.adhesion_law, scene.derived.material(particle.material)
    if law.kind == "none" or law.criterion != "velocity":
        return True
    formula = pair_formula(metal, None, particle.temperature, particle.diameter)
    return formula.verdict(towards(_velocity(particle), normal), law.limit) != REBOUNDS


def _under(scene: Scene, i: int, normals: Sequence[Vector]) -> tuple[Material, float, bool]:
    """The body that impact i hits: the last splat under its centre, or the substrate. Returns its material, its initial
    temperature (K), and whether it is a splat. normals: of the ground at each impact."""
    at = scene.particles[i].offset
    for k in reversed(range(i)):
        earlier = scene.particles[k]
        if math.dist(earlier.offset, at) < earlier.diameter / 2 and _stays(scene, earlier, normals[k]):
            return scene.derived.material(earlier.material), earlier.temperature, True
    return scene.derived.material(scene.substrate.materials[0]), scene.substrate.temperature, False


def _impact(scene: Scene, i: int, normals: Sequence[Vector]) -> ImpactPlan:
    d, particle = scene.derived, scene.particles[i]
    D, v, cap, angle = particle.diameter, particle.velocity, d.end_time_of(particle), particle.angle
    end_at: Literal["rest", "greatest", "time"] = "rest" if scene.end.time is None else "time"
    if scene.end.at is not None:
        end_at = "rest" if scene.end.at == "cold" else scene.end.at
    material, (base, T, on_splat) = d.material(particle.material), _under(scene, i, normals)
    joins = d.adhesion_law.joins(material, base)
    load = estimates.loads((material, base), (particle.temperature, T), v, D)
    tall = particle.form.height(particle.tilt) / D
    height = D * max(tall, math.sqrt(tall))  # flat shapes come to rest earlier, but not in proportion to their height
    fastest, points = max(d.material(name).wave_speed for name in particle.materials), particle.volume / d.spacing**3
    dt = estimates.time_step(d.spacing, fastest, load, points, angle, scene.resolution.engine, tall)
    return ImpactPlan(
        material=material,
        shape=particle.shape,
        file=particle.file or "",
        tilt=particle.tilt,
        diameter=D,
        velocity=_velocity(particle),
        temperature=particle.temperature,
        offset=particle.offset,
        gap=d.gap_of(particle),
        spacing=d.spacing,
        points=d.points_of(particle),
        end_time=cap * (estimates.ON_SPLATS if i > 0 and scene.end.time is None else 1.0),
        expected=estimates.expected_time(cap, height, v, end_at, load, angle),
        dt_expected=dt * (estimates.STEP_ON_SPLAT if on_splat else 1.0),
        rate_filter=RATE_FILTER_OVER_CROSSING * D / v,
        output_every=d.output_every_of(particle),
        dwell=d.dwell_of(particle),
        ends_pass=d.spray.passes is not None and d.dwell_of(particle) > 0.5 * d.spray.time_between_passes,
        end_at=end_at,
        window=d.window_of(particle),
        formula=pair_formula(material, base, particle.temperature, D),
        lengths=particle.form.lengths,
        splat_elements=d.splat_elements_of(particle) if _stays(scene, particle, normals[i]) else 0,
        initial_strain=material.initial_strain(particle.hardness, particle.yield_strength),
        pores=particle.pores(),
        core=d.core_of(particle),
        can_bond=joins or (on_splat and not material.is_ceramic),  # beside a ceramic splat it can meet metal
        normal=normals[i],
    )


def _spray(scene: Scene) -> str:
    """Text about the time between impacts; "" if there is only one impact."""
    d, spray, show = scene.derived, scene.derived.spray, units.rounded
    if len(scene.particles) == 1:
        return ""
    share = f", {spray.efficiency:.0%} of it" if spray.efficiency < 1.0 else ""
    whence = "" if scene.spray else "usual conditions: "
    stream = f"{show(spray.feed_rate, 'g/min')}{share} in a spot of {show(spray.spot, 'mm')} at {show(spray.traverse_speed, 'mm/s')}"
    impacts = 0.25 * math.pi * spray.spot / spray.traverse_speed / d.time_between  # mean over the chords of the spot
    passes = f"{spray.passes} passes in a layer; under the spot " if spray.passes else ""
    time = f"{passes}time between impacts {show(d.time_between, 'ms')}"
    return f"{time} ({whence}{stream}: {impacts:.2g} impacts in a pass)"


def _target(scene: Scene) -> TargetPlan:
    d, body = scene.derived, scene.substrate
    return TargetPlan(
        d.material(body.material), body.diameter, body.height, body.temperature, body.sides, body.bottom, d.element_size,
        COARSEST * min(body.diameter, body.height), d.centre, d.spread, d.refined_radius, scene.resolution.growth, d.elements,
        (body.roughness, body.roughness_length, body.roughness_seed) if body.roughness else None,
        ground_of(body, d.element_size),
        tuple((d.material(layer.material), layer.thickness) for layer in body.layer),
    )  # fmt: skip
