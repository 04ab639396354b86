"""The table of effects, each with a number and the value below which `auto` leaves it out (measured: docs/evidence/effects.md)."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from ..physics.dislocations import stress_of_gradient
from ..physics.materials import Material
from ..physics.recovery import recovered_share
from ..scene.effects import NAMES, WHOLE
from .cost import STRAIN_OF_FLOW

GRADIENTS = "gradient_hardening"  # a choice of the model: unless it is named, only with bonds by exposure, whose verdicts depend on it


@dataclass(frozen=True)
class Situation:
    """Input data for the choice of effects of one impact, SI units. materials, temperatures: (particle, target).

    side_distance: from the impact to the nearest absorbing face, infinite without any; end_time: sum of the durations of this and all
    later impacts, the longest time that waves and heat travel; element_size: smallest of the target; duration: of this impact alone;
    dwell: the pause after it; bonded: whether the scene has a law of adhesion; exposed: whether bonds form by exposure and the engine
    computes gradients of plastic strain.
    """

    materials: tuple[Material, Material]
    temperatures: tuple[float, float]
    velocity: float
    diameter: float
    friction: float
    side_distance: float
    end_time: float
    element_size: float
    spacing: float
    duration: float
    dwell: float
    bonded: bool
    exposed: bool

    @property
    def bodies(self) -> list[tuple[Material, float, float]]:
        """Material, temperature (K) and heating (K) of particle and target."""
        return [(m, T, heating(m, T, self.velocity)) for m, T in zip(self.materials, self.temperatures, strict=True)]

    @cached_property
    def warm(self) -> float:
        """Heating over the distance to the melting point, of the body that it softens more."""
        return max(dT / max(m.T_m - T, 1.0) for m, T, dT in self.bodies)

    def diffusion(self, body: int, time: float) -> float:
        """Distance, m, that heat diffuses in a time (s) in the particle (0) or the target (1)."""
        return math.sqrt(diffusivity(self.materials[body], self.temperatures[body]) * time)

    @cached_property
    def in_target(self) -> float:
        return self.diffusion(1, self.end_time) / self.element_size

    @cached_property
    def in_particle(self) -> float:
        return self.diffusion(0, self.duration) / self.spacing

    def recovered(self, m: Material, T: float, heated: float) -> float:
        """Share of the dislocations that recover in the pause: at T (K), or as hot as the impact makes it while a splat is that hot."""
        hot = min(self.dwell, self.diameter**2 / diffusivity(m, T))
        return max(recovered_share(m, T, self.dwell), recovered_share(m, min(T + heated, m.T_m), hot))

    def of_both(self, number: Callable[[Material, float, float], float]) -> float:
        """A number of material, temperature and heating, of the body that calls for the effect more."""
        return max(number(*body) for body in self.bodies)

    def flow_stress(self, m: Material, T: float) -> float:
        """Flow stress at the rate of the impact and T (K), at most that of the strength set, Pa."""
        return m.flow_stress(STRAIN_OF_FLOW, self.velocity / self.diameter, min(T, m.T_ref))

    def gradient_stress(self, m: Material) -> float:
        """Stress that a gradient of plastic strain of ten over the diameter adds, Pa."""
        return stress_of_gradient(m.forest, m.gradient_length, 10.0 / self.diameter)


@dataclass(frozen=True)
class Effect:
    """One effect. number: name of the number that decides it; value: the number of an impact; threshold: `auto` leaves the effect out
    if the number is not larger."""

    name: str
    number: str
    value: Callable[[Situation], float]
    threshold: float = 0.0


# Thresholds above 0 are those of what takes time and may change nothing: no wave is back yet; the pause is too short for heat to leave
# the splat; of conduction, what changes no measure by more than half a percent; of recovery, half a percent of the hardening.
EFFECTS = (
    Effect(
        "thermal_softening", "heating or preheat / (T_m - T)",
        lambda s: max(s.warm, s.of_both(lambda m, T, _: (T - m.T_ref) / (m.T_m - m.T_ref))),
    ),
    Effect(
        "rate_hardening", "rise of the flow stress at v/D",
        lambda s: s.of_both(lambda m, T, _: s.flow_stress(m, T) / m.flow_stress(STRAIN_OF_FLOW, 0.0, min(T, m.T_ref)) - 1.0),
    ),
    Effect(
        GRADIENTS, "rise of flow stress at 10/D",  # of a plastic strain that changes by 1 over a tenth of the diameter
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
    Effect("friction", "friction coefficient", lambda s: s.friction),
    Effect("friction_heat", "friction x heating / (T_m - T)", lambda s: s.friction * s.warm),
    Effect(
        "dissipation_heat", "heating / T, 0 if it could melt",  # molten, its heat drives the points without end
        lambda s: 0.0 if s.of_both(lambda m, T, dT: T + dT - m.T_m) >= 0.0 else s.of_both(lambda _, T, dT: dT / T),
    ),
    Effect("mie_gruneisen", "v / c0", lambda s: s.of_both(lambda m, *_: s.velocity / m.c0)),
    Effect(
        "thermal_expansion", "Gamma0 rho cp heating / K",
        lambda s: s.of_both(lambda m, T, dT: m.Gamma0 * m.rho * m.cp_at(T) * dT / m.K),
    ),
    Effect("adhesion", "splats that the scene bonds", lambda s: float(s.bonded)),
    Effect(
        "absorbing_boundaries", "time / wave's way to the side and back",
        lambda s: s.end_time * s.materials[1].wave_speed / (2 * s.side_distance), 1.0,
    ),
    Effect("conduction", "sqrt(alpha time) / size x warming", lambda s: s.in_target * s.warm, 0.05),
    Effect("particle_conduction", "sqrt(alpha time) / spacing", lambda s: s.in_particle, 0.1),
    Effect(
        "interface_conduction", "sqrt(alpha time) / size, both",  # what one side cannot take the other cannot give
        lambda s: min(s.diffusion(1, s.duration) / s.element_size, s.in_particle), 0.15,
    ),
    Effect("cooling", "sqrt(alpha dwell) / diameter", lambda s: max(s.diffusion(k, s.dwell) for k in (0, 1)) / s.diameter, 0.05),
    Effect("recovery", "dislocations that recover in a pause", lambda s: s.of_both(s.recovered), 0.01),
)  # fmt: skip


@dataclass(frozen=True)
class Decision:
    """The decision about one effect. number: name of its value; on: whether the effect takes part; why: the reason."""

    name: str
    number: str
    value: float
    on: bool
    why: str


def requested(request: str | Sequence[str]) -> dict[str, bool]:
    """The effects that a scene switches on or off; effects that it leaves to `decide` are not included. request: "auto" (the numbers
    decide), "all" (but GRADIENTS, which is as with "auto"), "none", or a list: names alone mean these and no other; a list that begins
    with "auto", "all" or "none" changes that choice: ["auto", "-friction"]; one of signed names only changes "auto"."""
    if isinstance(request, str):
        items, base = [], request
    else:
        items = list(request)
        base = "auto" if items and all(item[0] in "+-" for item in items) else "none"
        if items and items[0] in WHOLE:
            base = items.pop(0)
    whole = {} if base == "auto" else dict.fromkeys(NAMES, base == "all")
    if base == "all":
        del whole[GRADIENTS]
    return whole | {item.lstrip("+-"): not item.startswith("-") for item in items}


def decide(situations: Sequence[Situation], settled: Mapping[str, bool]) -> tuple[Decision, ...]:
    """The decision about each effect. situations: one for each impact, of each number the largest counts; settled: effects that
    the scene sets."""
    exposed = any(situation.exposed for situation in situations)

    def of(effect: Effect) -> Decision:
        value = max(map(effect.value, situations))
        on, why = value > effect.threshold, f"more than {effect.threshold:g}"
        if effect.name in settled:
            on, why = settled[effect.name], "as the scene says"
        elif effect.name == GRADIENTS and not exposed:
            on, why = False, "by default with bonds by exposure only"
        elif not on:
            why = f"no {why}"
        return Decision(effect.name, effect.number, value, on, why)

    return tuple(map(of, EFFECTS))


def heating(material: Material, T: float, velocity: float) -> float:
    """Rise of temperature, K, if all kinetic energy became plastic work there: beta v^2 / (2 cp)."""
    return material.taylor_quinney * velocity**2 / (2 * material.cp_at(T))


def diffusivity(material: Material, T: float) -> float:
    """Thermal diffusivity k / (rho cp) at T (K), m^2/s."""
    return material.k_at(T) / (material.rho * material.cp_at(T))
