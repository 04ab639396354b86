"""Which physics a scene calls for: dimensionless numbers against thresholds, or what the user says."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from . import units
from .materials import Material

# effect -> (the number that decides, its threshold); on when the number is above
THRESHOLDS: dict[str, tuple[str, float]] = {
    "thermal_softening": ("heating or preheat / (T_m - T)", 0.1),
    "rate_hardening": ("C ln(v/D / eps_dot_0)", 0.01),
    "plastic_heating": ("Taylor-Quinney coefficient", 0.0),
    "temperature_dependent_cp": ("relative change of cp", 0.01),
    "friction": ("friction coefficient", 0.0),
    "mie_gruneisen": ("v / c0", 0.03),
    "absorbing_boundaries": ("time / wave's way to the side and back", 1.0),
    "conduction": ("sqrt(alpha time) / element size", 1.0),
}
NAMES = tuple(THRESHOLDS)
_WHOLE = ("auto", "all", "none")

_WHY = {  # (why on, why off)
    "thermal_softening": ("the metal gets warm enough to lose strength", "heating is too small to matter"),
    "rate_hardening": ("the strain rate raises the flow stress", "the flow stress does not feel the rate"),
    "plastic_heating": ("temperature is a result", "no plastic work becomes heat"),
    "temperature_dependent_cp": ("heating changes cp", "cp stays nearly constant"),
    "friction": ("the coefficient is above zero", "the coefficient is zero"),
    "mie_gruneisen": ("pressures are in the shock range", "compression is small: linear is enough"),
    "absorbing_boundaries": ("waves would come back from the sides", "no wave comes back in time"),
    "conduction": ("heat crosses elements of the target, where it acts", "in the target heat stays in its element"),
}


@dataclass(frozen=True)
class Situation:
    """What the numbers of an impact are made of. SI units; materials and temperatures: of particle and target.

    end_time: the longest that waves and heat may travel until the run is over, this and later impacts together.
    """

    materials: tuple[Material, Material]
    temperatures: tuple[float, float]
    velocity: float
    diameter: float
    friction: float
    side_distance: float  # from the impact to the nearest absorbing face; infinite without any
    end_time: float
    element_size: float = math.inf  # of the target, the smallest


@dataclass(frozen=True)
class Effect:
    """One row: the number that decides, its value and threshold, the decision, why, and who made it."""

    name: str
    number: str
    value: float
    threshold: float
    on: bool
    why: str
    forced_by_user: bool


@dataclass(frozen=True)
class Effects:
    """The effects of a run, a row for each name."""

    rows: tuple[Effect, ...]

    def on(self, name: str) -> bool:
        """Whether an effect takes part. Raises KeyError for a name that is none."""
        return {row.name: row.on for row in self.rows}[name]

    @property
    def active(self) -> list[str]:
        """Names of the effects that take part."""
        return [row.name for row in self.rows if row.on]


def check_request(request: str | Sequence[str]) -> list[str]:
    """Problems of what a scene says under `effects`; empty if it can be understood."""
    if isinstance(request, str):
        return [] if request in _WHOLE else [f"expected one of {', '.join(_WHOLE)}, or a list of names"]
    problems, seen = [], set()
    for i, item in enumerate(request):
        name = item.lstrip("+-") if item[:1] in "+-" else item
        if item in _WHOLE:
            if i > 0:
                problems.append(f'"{item}" may only be the first of the list')
        elif name not in THRESHOLDS or len(item) - len(name) > 1:
            problems.append(f"unknown effect {item[:40]!r}{units.nearest(name, NAMES)}; known: {', '.join(NAMES)}")
        elif name in seen:
            problems.append(f'"{name}" is named twice')
        seen.add(name)
    return problems


def decide(request: str | Sequence[str], *situations: Situation) -> Effects:
    """Decide every effect, once for all impacts of a run: of each number the largest counts.

    situations: one for each impact, at least one.
    request: "auto" (the numbers decide), "all", "none", or a list: names alone mean these and no other;
    a list that begins with "auto", "all" or "none" changes that choice: ["auto", "-friction"];
    one of signed names only changes "auto".
    """
    base, said = _read(request)
    rows = []
    found = [numbers(situation) for situation in situations]
    for name, (number, threshold) in THRESHOLDS.items():
        value = max(each[name] for each in found)
        wanted = value > threshold
        forced = name in said or base != "auto"
        on = said.get(name, wanted if base == "auto" else base == "all")
        why = "as the scene says" if forced else _WHY[name][0 if on else 1]
        rows.append(Effect(name, number, value, threshold, on, why, forced))
    return Effects(tuple(rows))


def numbers(situation: Situation) -> dict[str, float]:
    """The number that decides each effect; of the two bodies the one that calls for it more."""
    bodies = list(zip(situation.materials, situation.temperatures, strict=True))
    v, rate = situation.velocity, situation.velocity / situation.diameter
    wave = situation.materials[1].wave_speed
    diffused = math.sqrt(diffusivity(*bodies[1]) * situation.end_time)
    return {
        "thermal_softening": max(max(heating(m, T, v) / (m.T_m - T), _preheat(m, T)) for m, T in bodies),
        "rate_hardening": max(m.C * math.log(max(rate / m.eps_dot_0, 1.0)) for m, _ in bodies),
        "plastic_heating": max(m.taylor_quinney for m, _ in bodies),
        "temperature_dependent_cp": max(abs(m.cp_at(T + heating(m, T, v)) / m.cp_at(T) - 1) for m, T in bodies),
        "friction": situation.friction,
        "mie_gruneisen": max(v / m.c0 for m, _ in bodies),
        "absorbing_boundaries": situation.end_time * wave / (2 * situation.side_distance),
        "conduction": diffused / situation.element_size,
    }


def heating(material: Material, T: float, velocity: float) -> float:
    """Rise of temperature, K, if all kinetic energy became plastic work there: beta v^2 / (2 cp)."""
    return material.taylor_quinney * velocity**2 / (2 * material.cp_at(T))


def diffusivity(material: Material, T: float) -> float:
    """Thermal diffusivity k / (rho cp) at T (K), m^2/s."""
    return material.k_at(T) / (material.rho * material.cp_at(T))


def _preheat(material: Material, T: float) -> float:
    return (T - material.T_ref) / (material.T_m - material.T_ref)


def _read(request: str | Sequence[str]) -> tuple[str, dict[str, bool]]:
    if isinstance(request, str):
        return request, {}
    items = list(request)
    signed = bool(items) and all(item[0] in "+-" for item in items)
    base = "auto" if signed else "none"
    if items and items[0] in _WHOLE:
        base = items.pop(0)
    return base, {item.lstrip("+-"): not item.startswith("-") for item in items}
