"""Warnings about a scene, for `coldspray check` and for the summary of a run."""

import math
from collections.abc import Iterator, Sequence

from .. import units
from ..physics.materials import Material, fitted_at
from ..scene.effects import Effects
from . import cost, effects
from .model import ImpactPlan
from .reading import Scene

BEYOND_FIT = "beyond the fitted range"
NEAR_MELTING = 0.9  # temperature over melting point
# points of a particle: with fewer its surface stretches too little, and bonds by exposure are too weak
EXPOSURE_POINTS = 12000


def absorbing_distance(scene: Scene, offset: tuple[float, float]) -> float:
    """Distance (m) from a point at an offset (m) to the nearest absorbing face; infinite if there is no such face."""
    body = scene.substrate
    to_sides = body.diameter / 2 - math.hypot(*offset) if body.sides == "absorbing" else math.inf
    return min(to_sides, body.height if body.bottom == "absorbing" else math.inf)


def remarks(scene: Scene, impacts: Sequence[ImpactPlan], base: Material, decided: Effects) -> Iterator[str]:
    """Warnings about a scene: conditions outside the range of the models, and settings without effect."""
    if text := _extrapolation([i.material for i in impacts] + [base], impacts):
        yield text
    if scene.resolution.spacing is None and scene.derived.points > 1.05 * (usual := cost.PRESETS[scene.preset]):
        points = f"{scene.derived.points} points instead of {usual}"
        yield f"the smallest or thinnest particle sets the spacing: the largest has {points}"
    shortest = max(cost.CHUNK * i.dt_expected for i in impacts)
    if scene.output.every is not None and scene.output.every < shortest:
        less = f"{units.rounded(scene.output.every, 'ns')} is less than {cost.CHUNK} time steps, about {units.rounded(shortest, 'ns')}"
        yield f"output.every = {less}: fields are written every {cost.CHUNK} time steps"
    if scene.derived.element_size < scene.derived.spacing:
        yield "element_size is smaller than the spacing: single points can then penetrate the facets; give a larger element_size"
    hot: dict[str, list[tuple[str, float]]] = {}  # particles and their temperatures (K), by metal
    for i, label in zip(impacts, scene.labels, strict=True):
        T = effects.heating(i.material, i.temperature, math.hypot(*i.velocity)) + i.temperature
        if _hot(i.material, T):
            hot.setdefault(i.material.name, []).append((label, T))
    for metal in {i.material.name: i.material for i in impacts if i.material.name in hot}.values():
        labels, reached = zip(*hot[metal.name], strict=True)
        several = ", ".join(labels[:3]) + (f" and {len(labels) - 3} more" if len(labels) > 3 else "")
        yield f"{several if len(impacts) > 1 else 'the particle'} {_hot(metal, *reached)}"
    if text := _hot(base, scene.substrate.temperature):
        yield f"the target {text}"
    if len(impacts) > 1 and any(p.dwell == 0.0 for p in scene.particles[:-1]):
        real = f"in the spray the time between impacts is {units.rounded(scene.derived.time_between, 'ms')}"
        yield f"dwell = 0 us: each particle hits a target that the one before has heated; {real}"
    rigid = {m.name for m in (base, *(metal for i in impacts for metal in i.materials)) if not m.Gamma0}
    if scene.derived.ambient is not None and rigid:
        why = "Gamma0 is 0: its volume does not change with temperature, and cooling leaves this out of the residual stresses"
        yield f"{', '.join(sorted(rigid))}: {why}; give Gamma0 under [materials.{min(rigid)}]"
    if scene.coating is not None:
        across = 2.0 * scene.coating.radius + sum(i.diameter for i in impacts) / len(impacts)
        # volume of the particles over area of the disc
        height = sum(i.diameter**3 for i in impacts) / (1.5 * across**2)
        if height >= across:
            heap = f"{units.rounded(across, 'um')} make a heap of {units.rounded(height, 'um')} height"
            text = "and late particles slide down its flanks: give a larger coating.radius or fewer particles"
            yield f"{len(impacts)} particles on a disc of {heap}, {text}"
    walls = [0.5 * (1.0 - i.core.share ** (1.0 / 3.0)) * i.diameter for i in impacts if i.core is not None]
    if len(impacts) > 1 and walls and min(walls) < (size := scene.derived.splat_element_size):
        larger = f"{units.rounded(size, 'um')}, are larger than the shell of {units.rounded(min(walls), 'um')}"
        jagged = "the surface of its core is jagged; give a finer preset, or a smaller splat.element_size"
        yield f"the elements of a splat, {larger}: {jagged}"
    for name in sorted({m.name for m in (base, *(metal for i in impacts for metal in i.materials)) if m.is_ceramic}):
        yield (
            f"{name} is a ceramic: it makes no metallic bond without a law in [[adhesion.pair]]; its particles embed or rebound."
            " Above tensile_limit (default: that of bulk specimens) a particle breaks and is not deposited, and a core cracks"
        )
    if base.is_polymer and scene.derived.adhesion_law.kind == "none":
        yield f"no bond of metals forms on {base.name}, a polymer: the particle stays only if the polymer holds it"
    without = [i.material.name for i in impacts if i.material.sigma_TS is None and not i.material.is_ceramic]
    if scene.adhesion.kind is None and scene.derived.adhesion_law.kind == "none" and without and not base.is_polymer:
        name = without[0]
        give = f'give sigma_TS under [materials.{name}], or adhesion.kind ("none" if it shall not bond)'
        yield f"the critical velocity of {name} is not known (no sigma_TS), so that the particle does not bond; {give}"
    fewest = min(i.points for i in impacts)
    if scene.derived.adhesion_law.criterion == "exposure" and fewest < EXPOSURE_POINTS:
        yield (
            f"{fewest} points per particle are too few for bonds by exposure: with 5000 points critical velocities are 6 to 10 %"
            ' too high, with 1000 points no bonds may form; give preset = "fine"'
        )
    if scene.derived.adhesion_law.criterion == "exposure" and not decided.gradient_hardening:
        yield (
            "the effect gradient_hardening is off (it needs taylor_alpha and burgers of the metals): with bonds by exposure verdicts do"
            " not converge with the spacing, and nickel sticks at velocities about 20 % too low"
        )
    named = not isinstance(scene.effects, str) and any("absorbing" in item for item in scene.effects)
    if decided.absorbing_boundaries and named and math.isinf(absorbing_distance(scene, scene.particle.offset)):
        yield 'absorbing_boundaries has no effect: no face of the substrate is absorbing (substrate.sides = "absorbing")'


def _extrapolation(metals: list[Material], impacts: Sequence[ImpactPlan]) -> str:
    """Warning about metals whose strength law is fitted only below the largest strain rate velocity / diameter of the impacts, with
    their strength sets that are fitted up to this rate; "" if there are no such metals."""
    rate = max(math.hypot(*i.velocity) / i.diameter for i in impacts)
    short = {metal.name: metal for metal in metals if metal.fitted_rate < rate}
    limits = [f"{metal.name} {metal.strength.label} to {metal.fitted_rate:.0e} 1/s" for metal in short.values()]
    valid = [f"{name} {set_name}" for name, metal in short.items() for set_name in fitted_at(metal, rate)]
    others = f"; fitted there: {', '.join(valid)} (key strength of [materials.NAME])" if valid else ""
    return f"{BEYOND_FIT}: strain rates near v/D = {rate:.1e} 1/s; {', '.join(limits)}{others}" if limits else ""


def _hot(material: Material, *reached: float) -> str:
    """Text about bodies of a material that may come near its melting point; "" if there are none. reached: their temperatures, K."""
    near = [f"{T:.0f}" for T in sorted(reached) if T > NEAR_MELTING * material.T_m]
    between = " to ".join(dict.fromkeys((near[0], near[-1]))) if near else ""
    return f"may reach {between} K; {material.name} melts at {material.T_m:.0f} K" if near else ""
