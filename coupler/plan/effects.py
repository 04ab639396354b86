"""The table of physical effects. For each effect a number is compared with a threshold; `auto` switches the effect off below it
(docs/evidence/effects.md)."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from ..physics.dislocations import stress_of_gradient
from ..physics.materials import Material
from ..physics.recovery import recovered_share
from ..scene.effects import GRADIENTS
from .cost import STRAIN_OF_FLOW
from .model import Decision, ImpactPlan
from .reading import Scene


class Effect(NamedTuple):
    """One effect. number: name of the deciding number (`numbers`); threshold: `auto` switches the effect on if the number is larger."""

    name: str
    number: str
    threshold: float = 0.0


# Effects with a cost have a threshold above 0: below it no reflected wave has come back, the pause is too short for heat to leave the
# splat, conduction changes no measure by more than 0.5 %, or recovery changes the hardening by less than 0.5 %.
EFFECTS = (
    Effect("thermal_softening", "heating or preheat / (T_m - T)"),
    Effect("rate_hardening", "rise of flow stress at the rate v/D"),
    Effect(GRADIENTS, "rise of flow stress by gradient 10/D"),
    Effect("plastic_heating", "Taylor-Quinney coefficient"),
    Effect("temperature_dependent_cp", "relative change of cp"),
    Effect("temperature_dependent_k", "change of k x diffusion length / size"),
    Effect("friction", "friction coefficient"),
    Effect("friction_heat", "friction x heating / (T_m - T)"),
    Effect("dissipation_heat", "heating / T, 0 if a body could melt"),
    Effect("mie_gruneisen", "v / c0"),
    Effect("thermal_expansion", "Gamma0 rho cp heating / K"),
    Effect("adhesion", "law of adhesion (1: yes, 0: none)"),
    Effect("absorbing_boundaries", "time / wave time to the side and back", 1.0),
    Effect("conduction", "sqrt(alpha time) / size x warming", 0.05),
    Effect("particle_conduction", "sqrt(alpha time) / spacing", 0.1),
    Effect("interface_conduction", "sqrt(alpha time) / size, smaller of both", 0.15),
    Effect("cooling", "sqrt(alpha dwell) / diameter", 0.05),
    Effect("recovery", "dislocations recovered in a pause", 0.01),
)


def numbers(
    scene: Scene, impact: ImpactPlan, base: Material, side_distance: float, duration: float, end_time: float
) -> dict[str, float]:
    """The deciding number (`Effect.number`) of each effect in one impact, by the name of the effect. base: metal of the substrate;
    side_distance (m): from the impact to the nearest absorbing face, infinite if there is no such face; duration (s): longest time of
    this impact; end_time (s): sum of the durations of this and all later impacts, the longest time that waves and heat travel."""
    velocity, friction, size = math.hypot(*impact.velocity), scene.contact.friction, scene.derived.element_size
    both = (impact.material, impact.temperature), (base, scene.substrate.temperature)
    bodies = [(m, T, heating(m, T, velocity)) for m, T in both]

    def of_both(number: Callable[[Material, float, float], float]) -> float:
        """The larger of the values for the two bodies. number: function of material, temperature (K) and heating (K)."""
        return max(number(*body) for body in bodies)

    def length(body: int, time: float) -> float:
        """Diffusion length of heat, m, during a time (s). body: 0 for the particle, 1 for the target."""
        return math.sqrt(diffusivity(*both[body]) * time)

    def stress(m: Material, T: float, rate: float = velocity / impact.diameter) -> float:
        return m.flow_stress(STRAIN_OF_FLOW, rate, min(T, m.T_ref))

    def by_gradient(m: Material, T: float, _: float) -> float:
        eta = 10.0 / impact.diameter  # 1/m: the strain changes by 1 over a tenth of the diameter
        own = stress_of_gradient(m.forest, m.gradient_length, eta)
        return math.hypot(1.0, own / stress(m, T)) - 1.0

    def recovered(m: Material, T: float, heated: float) -> float:
        """Fraction of the dislocations that recover. It is the largest of three values: at T (K) during the whole pause, at T + heated
        during the cooling time of a splat, and at T during the cooling of the closing stage."""
        hot = min(impact.dwell, impact.diameter**2 / diffusivity(m, T))
        ambient, time = scene.derived.ambient, scene.end.cooling_time
        cooling = recovered_share(m, max(T, ambient), time) if ambient is not None and time else 0.0
        return max(recovered_share(m, T, impact.dwell), recovered_share(m, min(T + heated, m.T_m), hot), cooling)

    warm = of_both(lambda m, T, dT: dT / max(m.T_m - T, 1.0))
    in_target, in_particle = length(1, end_time) / size, length(0, duration) / impact.spacing
    conducted, melts = max(in_target, in_particle), of_both(lambda m, T, dT: T + dT - m.T_m) >= 0.0
    return {
        "thermal_softening": max(warm, of_both(lambda m, T, _: (T - m.T_ref) / (m.T_m - m.T_ref))),
        "rate_hardening": of_both(lambda m, T, _: stress(m, T) / stress(m, T, 0.0) - 1.0),
        GRADIENTS: of_both(by_gradient),
        "plastic_heating": of_both(lambda m, *_: m.taylor_quinney),
        "temperature_dependent_cp": of_both(lambda m, T, dT: abs(m.cp_at(T + dT) / m.cp_at(T) - 1)),
        "temperature_dependent_k": conducted * of_both(lambda m, T, dT: abs(m.k_at(T + dT) / m.k_at(T) - 1)),
        "friction": friction,
        "friction_heat": friction * warm,
        # in melt this heat accelerates the points without limit
        "dissipation_heat": 0.0 if melts else of_both(lambda _, T, dT: dT / T),
        "mie_gruneisen": of_both(lambda m, *_: velocity / m.c0),
        "thermal_expansion": of_both(lambda m, T, dT: m.Gamma0 * m.rho * m.cp_at(T) * dT / m.K),
        "adhesion": float(scene.derived.adhesion_law.kind != "none"),
        "absorbing_boundaries": end_time * base.wave_speed / (2 * side_distance),
        "conduction": in_target * warm,
        "particle_conduction": in_particle,
        # the side with less diffusion limits the heat flow
        "interface_conduction": min(length(1, duration) / size, in_particle),
        "cooling": max(length(k, impact.dwell) for k in (0, 1)) / impact.diameter,
        "recovery": of_both(recovered),
    }


def decide(scene: Scene, each: Sequence[Mapping[str, float]], settled: Mapping[str, bool]) -> tuple[Decision, ...]:
    """The decision about each effect. each: the `numbers` of each impact, of which the largest counts; settled: effects that the scene
    sets itself; True means on."""
    exposed = scene.derived.adhesion_law.criterion == "exposure" and scene.resolution.engine != "machdyn"

    def of(effect: Effect) -> Decision:
        value = max(values[effect.name] for values in each)
        on, why = value > effect.threshold, f"more than {effect.threshold:g}"
        if effect.name in settled:
            on, why = settled[effect.name], "set by the scene"
        elif effect.name == GRADIENTS and not exposed:
            on, why = False, "by default only with bonds by exposure"
        elif not on:
            why = f"no {why}"
        return Decision(effect.name, effect.number, value, on, why)

    return tuple(map(of, EFFECTS))


def heating(material: Material, T: float, velocity: float) -> float:
    """Temperature rise, K, if all kinetic energy becomes plastic work: beta v^2 / (2 cp). beta: Taylor-Quinney coefficient."""
    return material.taylor_quinney * velocity**2 / (2 * material.cp_at(T))


def diffusivity(material: Material, T: float) -> float:
    """Thermal diffusivity k / (rho cp) at T (K), m^2/s."""
    return material.k_at(T) / (material.rho * material.cp_at(T))
