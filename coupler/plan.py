"""The plan of a run: everything decided, nothing computed, no solver imported."""

import math
from dataclasses import dataclass

from . import effects, estimates, units
from .effects import Effects, Situation
from .materials import Material
from .scene import Scene

RATE_FILTER_OVER_CROSSING = 0.01  # the strain rate is smoothed over this part of D / v
FITTED_RATE = 1e4  # 1/s: about the highest strain rate Johnson-Cook sets are fitted at (Hopkinson bars)
NEAR_MELTING = 0.9  # of the melting point


@dataclass(frozen=True)
class ImpactPlan:
    """The particle. diameter m, of the sphere of equal volume; tilt rad, about y; velocity (vx, vy, vz) m/s; offset
    (x, y) m, of its centre at the start; gap m, of its lowest point above the surface; spacing m; points: about
    that many."""

    material: Material
    shape: str
    tilt: float
    diameter: float
    velocity: tuple[float, float, float]
    temperature: float
    offset: tuple[float, float]
    gap: float
    spacing: float
    points: int


@dataclass(frozen=True)
class TargetPlan:
    """The target, a cylinder. Lengths m, temperature K; element_size inside refined_radius of the impact, then
    growing by `growth` per unit of distance. sides, bottom: what is done: "absorbing" only if that effect is on."""

    material: Material
    diameter: float
    height: float
    temperature: float
    sides: str
    bottom: str
    element_size: float
    refined_radius: float
    growth: float
    elements_estimate: int


@dataclass(frozen=True)
class Plan:
    """What will be computed and at what cost. Times in s; end_time is the longest a run may take; home_load: cost of the target and
    the contact over that of the particle."""

    scene: Scene
    impact: ImpactPlan
    target: TargetPlan
    friction: float
    effects: Effects
    end_time: float
    end_at_rest: bool
    output_every: float
    rate_filter: float
    dt_estimate: float
    steps_estimate: int
    memory_bytes: float
    wall_estimate: float
    home_load: float
    preset: str
    warnings: tuple[str, ...]


def plan(scene: Scene) -> Plan:
    """Decide everything about a checked scene. Raises SceneError if it names a material that is not there."""
    particle, substrate = scene.particle, scene.substrate
    metal, base = scene.material(particle.material), scene.material(substrate.material)
    D, v = particle.diameter, particle.velocity
    situation = Situation(
        materials=(metal, base),
        temperatures=(particle.temperature, substrate.temperature),
        velocity=v,
        diameter=D,
        friction=scene.contact.friction,
        side_distance=_absorbing_distance(scene),
        end_time=scene.end_time,
        element_size=scene.element_size,
    )
    decided = effects.decide(scene.effects, situation)
    absorbing = decided.on("absorbing_boundaries")
    impact = ImpactPlan(
        material=metal,
        shape=particle.shape,
        tilt=particle.tilt,
        diameter=D,
        velocity=(v * math.sin(particle.angle), 0.0, -v * math.cos(particle.angle)),
        temperature=particle.temperature,
        offset=particle.offset,
        gap=scene.gap,
        spacing=scene.spacing,
        points=scene.points,
    )
    target = TargetPlan(
        material=base,
        diameter=substrate.diameter,
        height=substrate.height,
        temperature=substrate.temperature,
        # where no wave comes back in time a plain face gives the same answer for less
        sides=substrate.sides if absorbing or substrate.sides != "absorbing" else "free",
        bottom=substrate.bottom if absorbing or substrate.bottom != "absorbing" else "fixed",
        element_size=scene.element_size,
        refined_radius=scene.refined_radius,
        growth=scene.resolution.growth,
        elements_estimate=scene.elements,
    )
    at_rest = scene.end.at == "rest"
    dt = estimates.CFL * scene.spacing / metal.wave_speed
    expected = min(scene.end_time, estimates.SHARE_OF_CAP * 3 * D / v) if at_rest else scene.end_time
    steps = math.ceil(expected / dt)
    return Plan(
        scene=scene,
        impact=impact,
        target=target,
        friction=scene.contact.friction if decided.on("friction") else 0.0,
        effects=decided,
        end_time=scene.end_time,
        end_at_rest=at_rest,
        output_every=scene.output_every,
        rate_filter=RATE_FILTER_OVER_CROSSING * D / v,
        dt_estimate=dt,
        steps_estimate=steps,
        memory_bytes=estimates.memory(scene.points, scene.elements),
        wall_estimate=estimates.wall_time(steps, scene.points, scene.elements),
        home_load=estimates.home_load(scene.points, scene.elements),
        preset=scene.preset,
        warnings=tuple(_warnings(scene, metal, base, decided)),
    )


def _absorbing_distance(scene: Scene) -> float:
    distances = [math.inf]
    if scene.substrate.sides == "absorbing":
        distances.append(scene.substrate.diameter / 2 - math.hypot(*scene.particle.offset))
    if scene.substrate.bottom == "absorbing":
        distances.append(scene.substrate.height)
    return min(distances)


def _warnings(scene: Scene, metal: Material, base: Material, decided: Effects) -> list[str]:
    particle, substrate, found = scene.particle, scene.substrate, []
    rate = particle.velocity / particle.diameter
    if rate > FITTED_RATE:
        found.append(
            f"strain rates near v/D = {rate:.1e} 1/s lie beyond the {FITTED_RATE:.0e} 1/s"
            " that Johnson-Cook is fitted at"
        )
    if scene.element_size < scene.spacing:
        found.append("element_size is smaller than the spacing: single points indent facets finer than themselves")
    for body, material, T in (
        ("particle", metal, particle.temperature),
        ("target", base, substrate.temperature),
    ):
        hot = T + effects.heating(material, T, particle.velocity) if body == "particle" else T
        if hot > NEAR_MELTING * material.T_m:
            found.append(f"the {body} may reach {hot:.0f} K; {material.name} melts at {material.T_m:.0f} K")
    if scene.element_size < scene.spacing:
        found.append("elements smaller than the points' spacing: single points will indent the target")
    absorbing = next(row for row in decided.rows if row.name == "absorbing_boundaries")
    named = not isinstance(scene.effects, str) and any("absorbing" in item for item in scene.effects)
    if absorbing.on and named and math.isinf(_absorbing_distance(scene)):
        found.append("absorbing_boundaries is asked for, but no face of the substrate is absorbing")
    return found


def describe(plan: Plan) -> str:
    """The plan as text of some 30 lines, at most about 120 columns wide, for a terminal."""
    impact, target, show = plan.impact, plan.target, units.rounded
    speed = math.hypot(*impact.velocity)
    angle = show(plan.scene.particle.angle, "deg")
    end = f"at most {show(plan.end_time, 'ns')}" if plan.end_at_rest else show(plan.end_time, "ns")
    lines = [
        f"{plan.scene.name} ({plan.preset})",
        f"  particle   {impact.material.name} {impact.shape.replace('_', ' ')} {show(impact.diameter, 'um')},"
        f" {show(speed, 'm/s', 4)} at {angle} from the normal, {show(impact.temperature, 'K', 4)}",
        *_shape(plan),
        *_gas(plan.scene),
        f"  target     {target.material.name} cylinder {show(target.diameter, 'um', 4)}"
        f" x {show(target.height, 'um', 4)}, {show(target.temperature, 'K', 4)},"
        f" sides {target.sides}, bottom {target.bottom}",
        f"  friction   {plan.friction:g}",
        f"  ends       {'at rest, ' if plan.end_at_rest else ''}{end};"
        f" a step written every {show(plan.output_every, 'ns')}",
        "",
        f"  points     about {impact.points}, spacing {show(impact.spacing, 'um')}",
        f"  elements   about {_round(target.elements_estimate)}, smallest {show(target.element_size, 'um')}"
        f" within {show(target.refined_radius, 'um')}",
        f"  dt         about {show(plan.dt_estimate, 'ps')}",
        f"  steps      about {_round(plan.steps_estimate)}",
        f"  memory     about {plan.memory_bytes / 1e9:.2g} GB",
        f"  wall time  about {duration(plan.wall_estimate)} on one core, after compilation",
        f"  two ranks  mpiexec -n 2 coldspray run --placement {estimates.placement(plan.home_load)} ...:"
        f" the target and the contact cost {plan.home_load:.2g} of the particle",
        "",
        "  effect                    on   decided by",
    ]
    for row in plan.effects.rows:
        sign = ">" if row.value > row.threshold else "<="
        lines.append(
            f"  {row.name:25} {'yes' if row.on else 'no':4} "
            f"{row.number} = {row.value:.3g} {sign} {row.threshold:g}: {row.why}"
        )
    lines += ["", *(f"  note: {warning}" for warning in plan.warnings)] if plan.warnings else []
    return "\n".join(lines)


def _gas(scene: Scene) -> list[str]:
    """What the gas of a scene gives its particle, as some lines; none without a gas."""
    if scene.gas is None:
        return []
    from .scene_gas import describe as gas

    return gas(scene)


def _shape(plan: Plan) -> list[str]:
    """What there is to say of a shape that is no sphere, as one line or none."""
    impact = plan.impact
    if impact.shape == "sphere":
        return []
    lengths = " x ".join(units.rounded(length, "um").removesuffix(" um") for length in plan.scene.form.lengths)
    tilt = f" tilted {units.rounded(impact.tilt, 'deg')}" if impact.tilt else ""
    return [f"             {lengths} um{tilt}; {units.rounded(impact.diameter, 'um')} is the sphere of equal volume"]


def duration(seconds: float) -> str:
    """A wall time for people: "8 s", "3 min", "2.5 h"."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.2g} h"


def _round(number: int) -> int:
    """Two significant digits: an estimate deserves no more."""
    step = 10 ** max(len(str(number)) - 2, 0)
    return round(number / step) * step
