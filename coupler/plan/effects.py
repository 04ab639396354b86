"""Which physics a scene calls for: a dimensionless number of each effect, and the value below which `auto` leaves it out."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..physics.dislocations import stress_of_gradient
from ..physics.materials import Material
from ..scene.effects import NAMES, WHOLE, Switches
from .cost import STRAIN_OF_FLOW

GRADIENTS = "gradient_hardening"  # a choice of the model: unless it is named, only with bonds by exposure, whose verdicts depend on it
# The number of each effect, in words.
NUMBERS = {
    "thermal_softening": "heating or preheat / (T_m - T)",
    "rate_hardening": "rise of the flow stress at v/D",
    "gradient_hardening": "rise of flow stress at 10/D",
    "plastic_heating": "Taylor-Quinney coefficient",
    "temperature_dependent_cp": "relative change of cp",
    "temperature_dependent_k": "change of k x diffusion length / size",
    "friction": "friction coefficient",
    "friction_heat": "friction x heating / (T_m - T)",
    "dissipation_heat": "heating / T, 0 if it could melt",
    "mie_gruneisen": "v / c0",
    "thermal_expansion": "Gamma0 rho cp heating / K",
    "adhesion": "splats that the scene bonds",
    "absorbing_boundaries": "time / wave's way to the side and back",
    "conduction": "sqrt(alpha time) / size x warming",
    "particle_conduction": "sqrt(alpha time) / spacing",
    "interface_conduction": "sqrt(alpha time) / size, both",
    "cooling": "sqrt(alpha dwell) / diameter",
}
# Number below which `auto` leaves an effect out; the others take part wherever their number is above zero. No wave is back yet; the
# pause is too short for heat to leave the splat; of conduction, each kind of which costs 3 to 5 % of a step, what changes no measure of
# docs/tables/effects_study.csv by more than half a percent.
THRESHOLDS = {
    "absorbing_boundaries": 1.0, "cooling": 0.05,
    "conduction": 0.05, "particle_conduction": 0.1, "interface_conduction": 0.15,
}  # fmt: skip


@dataclass(frozen=True)
class Decision:
    """The decision about one effect. number: what its value is, in words; on: whether it takes part, and why."""

    name: str
    number: str
    value: float
    on: bool
    why: str


@dataclass(frozen=True)
class Situation:
    """What the numbers of an impact are made of. SI units; materials and temperatures: of particle and target.

    end_time: the longest that waves and heat may travel until the run is over, this and later impacts together; duration:
    of this impact alone; dwell: the pause after it; bonded: whether its splat is to be; exposed:
    whether bonds form by exposure, with an engine that knows gradients.
    """

    materials: tuple[Material, Material]
    temperatures: tuple[float, float]
    velocity: float
    diameter: float
    friction: float
    side_distance: float  # from the impact to the nearest absorbing face; infinite without any
    end_time: float
    element_size: float  # of the target, the smallest
    spacing: float
    duration: float
    dwell: float
    bonded: bool
    exposed: bool


@dataclass(frozen=True)
class Effects(Switches):
    """The effects of a run."""

    @property
    def switches(self) -> dict[str, bool]:
        """Name -> whether it takes part, as `constitutive.law_record` wants it."""
        return {name: getattr(self, name) for name in NAMES}

    @property
    def active(self) -> list[str]:
        """Names of the effects that take part."""
        return [name for name, on in self.switches.items() if on]


def requested(request: str | Sequence[str]) -> dict[str, bool]:
    """What a scene says about each effect; those that it leaves to `decide` are not in it.

    request: "auto" (the numbers decide), "all" (but GRADIENTS, which is as with "auto"), "none", or a list: names alone mean
    these and no other; a list that begins with "auto", "all" or "none" changes that choice: ["auto", "-friction"];
    one of signed names only changes "auto".
    """
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
    """The decision about each effect. situations: one for each impact, of each number the largest counts; settled: what the scene
    says itself."""
    each = [numbers(situation) for situation in situations]
    exposed = any(situation.exposed for situation in situations)

    def of(name: str) -> Decision:
        value, least = max(one[name] for one in each), THRESHOLDS.get(name, 0.0)
        if name in settled:
            return Decision(name, NUMBERS[name], value, settled[name], "as the scene says")
        if name == GRADIENTS and not exposed:
            return Decision(name, NUMBERS[name], value, False, "by default with bonds by exposure only")
        return Decision(
            name, NUMBERS[name], value, value > least, f"{'more' if value > least else 'no more'} than {least:g}"
        )

    return tuple(map(of, NUMBERS))


def numbers(situation: Situation) -> dict[str, float]:
    """The number that decides each effect; of the two bodies the one that calls for it more."""
    bodies = list(zip(situation.materials, situation.temperatures, strict=True))
    v, rate = situation.velocity, situation.velocity / situation.diameter
    wave = situation.materials[1].wave_speed
    in_target = math.sqrt(diffusivity(*bodies[1]) * situation.end_time) / situation.element_size
    in_particle = math.sqrt(diffusivity(*bodies[0]) * situation.duration) / situation.spacing
    across = math.sqrt(diffusivity(*bodies[1]) * situation.duration) / situation.element_size
    warm = max(heating(m, T, v) / max(m.T_m - T, 1.0) for m, T in bodies)
    melts = any(T + heating(m, T, v) >= m.T_m for m, T in bodies)  # molten, its heat drives the points without end
    k_change = max(abs(m.k_at(T + heating(m, T, v)) / m.k_at(T) - 1) for m, T in bodies)
    return {
        "thermal_softening": max(warm, *(_preheat(m, T) for m, T in bodies)),
        "rate_hardening": max(_rate_hardening(m, T, rate) for m, T in bodies),
        "gradient_hardening": max(_gradient_hardening(m, T, situation) for m, T in bodies),
        "plastic_heating": max(m.taylor_quinney for m, _ in bodies),
        "temperature_dependent_cp": max(abs(m.cp_at(T + heating(m, T, v)) / m.cp_at(T) - 1) for m, T in bodies),
        "temperature_dependent_k": k_change * max(in_target, in_particle),
        "friction": situation.friction,
        "friction_heat": situation.friction * warm,
        "dissipation_heat": 0.0 if melts else max(heating(m, T, v) / T for m, T in bodies),
        "mie_gruneisen": max(v / m.c0 for m, _ in bodies),
        "absorbing_boundaries": situation.end_time * wave / (2 * situation.side_distance),
        "thermal_expansion": max(m.Gamma0 * m.rho * m.cp_at(T) * heating(m, T, v) / m.K for m, T in bodies),
        "adhesion": float(situation.bonded),
        "conduction": in_target * warm,
        "particle_conduction": in_particle,
        "interface_conduction": min(across, in_particle),  # what one side cannot take the other cannot give
        "cooling": math.sqrt(max(diffusivity(*body) for body in bodies) * situation.dwell) / situation.diameter,
    }


def heating(material: Material, T: float, velocity: float) -> float:
    """Rise of temperature, K, if all kinetic energy became plastic work there: beta v^2 / (2 cp)."""
    return material.taylor_quinney * velocity**2 / (2 * material.cp_at(T))


def diffusivity(material: Material, T: float) -> float:
    """Thermal diffusivity k / (rho cp) at T (K), m^2/s."""
    return material.k_at(T) / (material.rho * material.cp_at(T))


def _rate_hardening(material: Material, T: float, rate: float) -> float:
    """Share by which a strain rate (1/s) raises the flow stress at T (K), short of melting."""
    T = min(T, material.T_ref)
    slow = material.flow_stress(STRAIN_OF_FLOW, 0.0, T)
    return material.flow_stress(STRAIN_OF_FLOW, rate, T) / slow - 1.0


def _gradient_hardening(material: Material, T: float, situation: Situation) -> float:
    """Share by which a plastic strain that changes by 1 over a tenth of the diameter raises the flow stress at T (K)."""
    rate = situation.velocity / situation.diameter
    flow_stress = material.flow_stress(STRAIN_OF_FLOW, rate, min(T, material.T_ref))
    stress = stress_of_gradient(material.forest, material.gradient_length, 10.0 / situation.diameter)
    return math.hypot(1.0, stress / flow_stress) - 1.0


def _preheat(material: Material, T: float) -> float:
    return (T - material.T_ref) / (material.T_m - material.T_ref)
