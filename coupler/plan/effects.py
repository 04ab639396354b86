"""Which physics a scene calls for: dimensionless numbers against thresholds, or what the user says."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from ..physics.materials import Material
from ..scene.effects import WHOLE, Switches
from .cost import STRAIN_OF_FLOW


class Criterion(NamedTuple):
    """What decides about an effect: on when the number is above its threshold. why_on, why_off: the reason in words."""

    number: str
    threshold: float
    why_on: str
    why_off: str


# The thresholds are what the study's rows allow (docs/evidence/effects.md), rounded down to one digit.
THRESHOLDS = {
    "thermal_softening": Criterion("heating or preheat / (T_m - T)", 0.006,
        "the metal gets warm enough to lose strength", "heating is too small to matter"),
    "rate_hardening": Criterion("rise of the flow stress at v/D", 0.0005,
        "the strain rate raises the flow stress", "the flow stress does not depend on the rate"),
    "plastic_heating": Criterion("Taylor-Quinney coefficient", 0.0,
        "temperature is a result", "no plastic work becomes heat"),
    "temperature_dependent_cp": Criterion("relative change of cp", 0.007,
        "heating changes cp", "cp stays nearly constant"),
    "temperature_dependent_k": Criterion("change of k x diffusion length / size", 0.04,
        "k changes where heat flows", "k stays, or conducts little"),
    "friction": Criterion("friction coefficient", 0.0,
        "the coefficient is above zero", "the coefficient is zero"),
    "friction_heat": Criterion("friction x heating / (T_m - T)", 0.009,
        "rubbing warms the surfaces", "what rubbing could heat is too little"),
    "dissipation_heat": Criterion("heating / T, 0 if it could melt", 0.01,
        "the scheme's dissipation becomes heat", "what the scheme dissipates heats too little, or would melt the metal"),
    "mie_gruneisen": Criterion("v / c0", 0.02,
        "pressures are in the shock range", "compression is small: linear is enough"),
    "thermal_expansion": Criterion("Gamma0 rho cp heating / K", 0.005,
        "heat raises the pressure", "heat hardly raises the pressure"),
    "adhesion": Criterion("splats that the scene bonds", 0.0,
        "splats stick to what they lie on", "there is nothing that the scene bonds"),
    "absorbing_boundaries": Criterion("time / wave's way to the side and back", 1.0,
        "waves would come back from the sides", "no wave comes back in time"),
    "conduction": Criterion("sqrt(alpha time) / size x warming", 0.04,
        "heat crosses elements of the target", "in the target heat stays in its element"),
    "particle_conduction": Criterion("sqrt(alpha time) / spacing", 0.007,
        "heat goes from point to point", "in the particle heat stays where it arises"),
    "interface_conduction": Criterion("sqrt(alpha time) / size, both", 0.07,
        "heat crosses the contact", "there is no time to cross the contact"),
    "cooling": Criterion("sqrt(alpha dwell) / diameter", 0.05,
        "heat leaves the splat between impacts", "no pause, or too short a one"),
}  # fmt: skip


@dataclass(frozen=True)
class Situation:
    """What the numbers of an impact are made of. SI units; materials and temperatures: of particle and target.

    end_time: the longest that waves and heat may travel until the run is over, this and later impacts together; duration:
    of this impact alone; dwell: the pause after it; bonded: whether its splat is to be.
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


@dataclass(frozen=True)
class Effect:
    """One row: the number that decides, its value and threshold, the decision, and the reason."""

    name: str
    number: str
    value: float
    threshold: float
    on: bool
    why: str


@dataclass(frozen=True)
class Effects(Switches):
    """The effects of a run, and a row for each, with the reason."""

    rows: tuple[Effect, ...]

    @property
    def switches(self) -> dict[str, bool]:
        """Name -> whether it takes part, as `constitutive.law_record` wants it."""
        return {row.name: row.on for row in self.rows}

    @property
    def active(self) -> list[str]:
        """Names of the effects that take part."""
        return [row.name for row in self.rows if row.on]


def decide(request: str | Sequence[str], *situations: Situation) -> Effects:
    """Decide every effect, once for all impacts of a run: of each number the largest counts.

    situations: one for each impact, at least one.
    request: "auto" (the numbers decide), "all", "none", or a list: names alone mean these and no other;
    a list that begins with "auto", "all" or "none" changes that choice: ["auto", "-friction"];
    one of signed names only changes "auto".
    """
    base, requested = _read(request)
    values = [numbers(situation) for situation in situations]
    rows = []
    for name, criterion in THRESHOLDS.items():
        value = max(each[name] for each in values)
        above = value > criterion.threshold
        on = requested.get(name, above if base == "auto" else base == "all")
        why = criterion.why_on if on else criterion.why_off
        if name in requested or base != "auto":
            why = "as the scene says"
        rows.append(Effect(name, criterion.number, value, criterion.threshold, on, why))
    return Effects(rows=tuple(rows), **{row.name: row.on for row in rows})


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


def expected(name: str, values: Mapping[str, float]) -> dict[str, str] | None:
    """The row of the study to expect of leaving out an effect; None where nothing was measured (docs/evidence/effects.md).

    flattening, crater, T_mean, T_p99 (both of K): changes in percent; cost_share: of a step's processor time, "" where it was not
    measured.
    values: the number of each effect, as in the rows of `Effects`. Nearest is the case whose own number comes nearest; where
    several do, the one whose other numbers come nearest too.
    """
    cases = [row for row in _measured() if row["effect"] == name]
    if not cases or values[name] == 0.0:  # what a scene does not have cannot be left out
        return None
    numbers_of: dict[str, dict[str, float]] = {}
    for row in _measured():
        numbers_of.setdefault(row["scene"], {})[row["effect"]] = float(row["number"])

    def far(row: dict[str, str]) -> float:
        others = numbers_of[row["scene"]]
        return _apart(others[name], values[name]) + 0.1 * max(_apart(others[n], values[n]) for n in others)

    return min(cases, key=far)


def _apart(a: float, b: float) -> float:
    return abs(math.log(max(a, 1e-12) / max(b, 1e-12)))


@cache
def _measured() -> list[dict[str, str]]:
    text = files(__package__).joinpath("effects_study.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


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


def _preheat(material: Material, T: float) -> float:
    return (T - material.T_ref) / (material.T_m - material.T_ref)


def _read(request: str | Sequence[str]) -> tuple[str, dict[str, bool]]:
    if isinstance(request, str):
        return request, {}
    items = list(request)
    signed = bool(items) and all(item[0] in "+-" for item in items)
    base = "auto" if signed else "none"
    if items and items[0] in WHOLE:
        base = items.pop(0)
    return base, {item.lstrip("+-"): not item.startswith("-") for item in items}
