"""The table of physical effects. For each effect a number is compared with a threshold; `auto` switches the effect off below it
(docs/evidence/effects.md)."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from ..physics.dislocations import stress_of_gradient
from ..physics.materials import Material
from ..physics.recovery import recovered_share
from ..scene.effects import GRADIENTS
from .cost import STRAIN_OF_FLOW
from .model import Decision, ImpactPlan
from .reading import Scene


@dataclass(frozen=True)
class Situation:
    """Input data for the choice of effects of one impact, SI units. base: metal of the substrate; side_distance: from the impact to
    the nearest absorbing face, infinite if there is no such face; duration: longest time of this impact; end_time: sum of the
    durations of this and all later impacts, the longest time that waves and heat travel."""

    scene: Scene
    impact: ImpactPlan
    base: Material
    side_distance: float
    duration: float
    end_time: float

    @cached_property
    def velocity(self) -> float:
        """Impact velocity, m/s."""
        return math.hypot(*self.impact.velocity)

    @cached_property
    def bodies(self) -> list[tuple[Material, float, float]]:
        """For particle and target: material, temperature (K), and the rise of temperature (K) by `heating`."""
        both = (self.impact.material, self.impact.temperature), (self.base, self.scene.substrate.temperature)
        return [(m, T, heating(m, T, self.velocity)) for m, T in both]

    @cached_property
    def warm(self) -> float:
        """Temperature rise by heating, divided by the difference to the melting point; the larger value of the two bodies."""
        return max(dT / max(m.T_m - T, 1.0) for m, T, dT in self.bodies)

    def diffusion(self, body: int, time: float) -> float:
        """Diffusion length of heat, m, during a time (s). body: 0 for the particle, 1 for the target."""
        return math.sqrt(diffusivity(*self.bodies[body][:2]) * time)

    @cached_property
    def in_target(self) -> float:
        """Diffusion length of heat in the target, divided by the element size."""
        return self.diffusion(1, self.end_time) / self.scene.derived.element_size

    @cached_property
    def in_particle(self) -> float:
        """Diffusion length of heat in the particle, divided by the point spacing."""
        return self.diffusion(0, self.duration) / self.impact.spacing

    def recovered(self, m: Material, T: float, heated: float) -> float:
        """Fraction of the dislocations that recover in the pause. It is the larger of two values: at T (K) during the whole pause, or
        at T + heated during the cooling time of a splat."""
        pause = self.impact.dwell
        hot = min(pause, self.impact.diameter**2 / diffusivity(m, T))
        return max(recovered_share(m, T, pause), recovered_share(m, min(T + heated, m.T_m), hot))

    def of_both(self, number: Callable[[Material, float, float], float]) -> float:
        """The larger of the values for the two bodies. number: function of material, temperature (K) and heating (K)."""
        return max(number(*body) for body in self.bodies)

    def flow_stress(self, m: Material, T: float) -> float:
        """Flow stress at the rate of the impact and at T (K), at most at T_ref, Pa."""
        return m.flow_stress(STRAIN_OF_FLOW, self.velocity / self.impact.diameter, min(T, m.T_ref))

    def gradient_stress(self, m: Material) -> float:
        """Stress of the dislocations due to a gradient of plastic strain of 10 / diameter, Pa."""
        return stress_of_gradient(m.forest, m.gradient_length, 10.0 / self.impact.diameter)


@dataclass(frozen=True)
class Effect:
    """One effect. number: name of the number that decides; value: function that gives the number of an impact; threshold: `auto`
    switches the effect on if the number is larger."""

    name: str
    number: str
    value: Callable[[Situation], float]
    threshold: float = 0.0


# Effects with a cost have a threshold above 0: below it no reflected wave has come back, the pause is too short for heat to leave the
# splat, conduction changes no measure by more than 0.5 %, or recovery changes the hardening by less than 0.5 %.
EFFECTS = (
    Effect(
        "thermal_softening", "heating or preheat / (T_m - T)",
        lambda s: max(s.warm, s.of_both(lambda m, T, _: (T - m.T_ref) / (m.T_m - m.T_ref))),
    ),
    Effect(
        "rate_hardening", "rise of flow stress at the rate v/D",
        lambda s: s.of_both(lambda m, T, _: s.flow_stress(m, T) / m.flow_stress(STRAIN_OF_FLOW, 0.0, min(T, m.T_ref)) - 1.0),
    ),
    Effect(
        GRADIENTS, "rise of flow stress by gradient 10/D",  # of a plastic strain that changes by 1 over a tenth of the diameter
        lambda s: s.of_both(lambda m, T, _: math.hypot(1.0, s.gradient_stress(m) / s.flow_stress(m, T)) - 1.0),
    ),
    Effect("plastic_heating", "Taylor-Quinney coefficient", lambda s: s.of_both(lambda m, *_: m.taylor_quinney)),
    Effect(
        "temperature_dependent_cp", "relative change of cp",
        lambda s: s.of_both(lambda m, T, dT: abs(m.cp_at(T + dT) / m.cp_at(T) - 1)),
    ),
    Effect(
        "temperature_dependent_k", "change of k x diffusion length / size",
        lambda s: s.of_both(lambda m, T, dT: abs(m.k_at(T + dT) / m.k_at(T) - 1)) * max(s.in_target, s.in_particle),
    ),
    Effect("friction", "friction coefficient", lambda s: s.scene.contact.friction),
    Effect("friction_heat", "friction x heating / (T_m - T)", lambda s: s.scene.contact.friction * s.warm),
    Effect(
        "dissipation_heat", "heating / T, 0 if it could melt",  # in melt this heat accelerates the points without limit
        lambda s: 0.0 if s.of_both(lambda m, T, dT: T + dT - m.T_m) >= 0.0 else s.of_both(lambda _, T, dT: dT / T),
    ),
    Effect("mie_gruneisen", "v / c0", lambda s: s.of_both(lambda m, *_: s.velocity / m.c0)),
    Effect(
        "thermal_expansion", "Gamma0 rho cp heating / K",
        lambda s: s.of_both(lambda m, T, dT: m.Gamma0 * m.rho * m.cp_at(T) * dT / m.K),
    ),
    Effect("adhesion", "number of splats that the scene bonds", lambda s: float(s.scene.derived.adhesion_law.kind != "none")),
    Effect(
        "absorbing_boundaries", "time / wave time to the side and back",
        lambda s: s.end_time * s.base.wave_speed / (2 * s.side_distance), 1.0,
    ),
    Effect("conduction", "sqrt(alpha time) / size x warming", lambda s: s.in_target * s.warm, 0.05),
    Effect("particle_conduction", "sqrt(alpha time) / spacing", lambda s: s.in_particle, 0.1),
    Effect(
        "interface_conduction", "sqrt(alpha time) / size, both",  # the side with less diffusion limits the heat flow
        lambda s: min(s.diffusion(1, s.duration) / s.scene.derived.element_size, s.in_particle), 0.15,
    ),
    Effect(
        "cooling", "sqrt(alpha dwell) / diameter",
        lambda s: max(s.diffusion(k, s.impact.dwell) for k in (0, 1)) / s.impact.diameter, 0.05,
    ),
    Effect("recovery", "dislocations recovered in a pause", lambda s: s.of_both(s.recovered), 0.01),
)  # fmt: skip


def decide(situations: Sequence[Situation], settled: Mapping[str, bool]) -> tuple[Decision, ...]:
    """The decision about each effect. situations: one for each impact; the largest number counts. settled: effects that the scene
    sets itself; True means on."""
    scene = situations[0].scene
    exposed = scene.derived.adhesion_law.criterion == "exposure" and scene.resolution.engine != "machdyn"

    def of(effect: Effect) -> Decision:
        value = max(map(effect.value, situations))
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
    """Temperature rise, K, if all kinetic energy became plastic work: beta v^2 / (2 cp)."""
    return material.taylor_quinney * velocity**2 / (2 * material.cp_at(T))


def diffusivity(material: Material, T: float) -> float:
    """Thermal diffusivity k / (rho cp) at T (K), m^2/s."""
    return material.k_at(T) / (material.rho * material.cp_at(T))
