"""Which physics a scene calls for: dimensionless numbers against thresholds, or what the user says."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from ..physics.materials import Material
from ..scene.effects import WHOLE

# effect -> (the number that decides, its threshold); on when the number is above. What the study's rows allow (`largest_threshold`,
# docs/evidence/effects.md), rounded down to one digit.
THRESHOLDS: dict[str, tuple[str, float]] = {
    "thermal_softening": ("heating or preheat / (T_m - T)", 0.006),
    "rate_hardening": ("C ln(v/D / eps_dot_0)", 0.0005),
    "plastic_heating": ("Taylor-Quinney coefficient", 0.0),
    "temperature_dependent_cp": ("relative change of cp", 0.007),
    "temperature_dependent_k": ("change of k x diffusion length / size", 0.04),
    "friction": ("friction coefficient", 0.0),
    "friction_heat": ("friction x heating / (T_m - T)", 0.009),
    "mie_gruneisen": ("v / c0", 0.02),
    "thermal_expansion": ("Gamma0 rho cp heating / K", 0.005),
    "adhesion": ("splats that the scene bonds", 0.0),
    "absorbing_boundaries": ("time / wave's way to the side and back", 1.0),
    "conduction": ("sqrt(alpha time) / size x warming", 0.04),
    "particle_conduction": ("sqrt(alpha time) / spacing", 0.007),
    "interface_conduction": ("sqrt(alpha time) / size, both", 0.07),
    "cooling": ("sqrt(alpha dwell) / diameter", 0.05),
}
LEFT_OUT = 1 / 3  # percent: what an effect below its threshold may change at the most, as the study's rows have it

_WHY = {  # (why on, why off)
    "thermal_softening": ("the metal gets warm enough to lose strength", "heating is too small to matter"),
    "rate_hardening": ("the strain rate raises the flow stress", "the flow stress does not depend on the rate"),
    "plastic_heating": ("temperature is a result", "no plastic work becomes heat"),
    "temperature_dependent_cp": ("heating changes cp", "cp stays nearly constant"),
    "temperature_dependent_k": ("k changes where heat flows", "k stays, or conducts little"),
    "friction": ("the coefficient is above zero", "the coefficient is zero"),
    "friction_heat": ("rubbing warms the surfaces", "what rubbing could heat is too little"),
    "mie_gruneisen": ("pressures are in the shock range", "compression is small: linear is enough"),
    "thermal_expansion": ("heat raises the pressure", "heat hardly raises the pressure"),
    "adhesion": ("splats stick to what they lie on", "there is nothing that the scene bonds"),
    "particle_conduction": ("heat goes from point to point", "in the particle heat stays where it arises"),
    "interface_conduction": ("heat crosses the contact", "there is no time to cross the contact"),
    "cooling": ("heat leaves the splat between impacts", "no pause, or too short a one"),
    "absorbing_boundaries": ("waves would come back from the sides", "no wave comes back in time"),
    "conduction": ("heat crosses elements of the target", "in the target heat stays in its element"),
}


@dataclass(frozen=True)
class Situation:
    """What the numbers of an impact are made of. SI units; materials and temperatures: of particle and target.

    end_time: the longest that waves and heat may travel until the run is over, this and later impacts together; duration:
    of this impact alone (default: the same); dwell: the pause after it; bonded: whether its splat is to be.
    """

    materials: tuple[Material, Material]
    temperatures: tuple[float, float]
    velocity: float
    diameter: float
    friction: float
    side_distance: float  # from the impact to the nearest absorbing face; infinite without any
    end_time: float
    element_size: float = math.inf  # of the target, the smallest
    spacing: float = math.inf
    duration: float | None = None
    dwell: float = 0.0
    bonded: bool = False


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
    """The effects of a run: a field for each, True where it takes part; and a row for each, with the reason."""

    thermal_softening: bool
    rate_hardening: bool
    plastic_heating: bool
    temperature_dependent_cp: bool
    temperature_dependent_k: bool
    friction: bool
    friction_heat: bool
    mie_gruneisen: bool
    thermal_expansion: bool
    adhesion: bool
    absorbing_boundaries: bool
    conduction: bool
    particle_conduction: bool
    interface_conduction: bool
    cooling: bool
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
    return Effects(rows=tuple(rows), **{row.name: row.on for row in rows})


def numbers(situation: Situation) -> dict[str, float]:
    """The number that decides each effect; of the two bodies the one that calls for it more."""
    bodies = list(zip(situation.materials, situation.temperatures, strict=True))
    v, rate = situation.velocity, situation.velocity / situation.diameter
    wave = situation.materials[1].wave_speed
    duration = situation.end_time if situation.duration is None else situation.duration
    in_target = math.sqrt(diffusivity(*bodies[1]) * situation.end_time) / situation.element_size
    in_particle = math.sqrt(diffusivity(*bodies[0]) * duration) / situation.spacing
    across = math.sqrt(diffusivity(*bodies[1]) * duration) / situation.element_size
    warm = max(heating(m, T, v) / max(m.T_m - T, 1.0) for m, T in bodies)
    k_change = max(abs(m.k_at(T + heating(m, T, v)) / m.k_at(T) - 1) for m, T in bodies)
    return {
        "thermal_softening": max(warm, *(_preheat(m, T) for m, T in bodies)),
        "rate_hardening": max(m.C * math.log(max(rate / m.eps_dot_0, 1.0)) for m, _ in bodies),
        "plastic_heating": max(m.taylor_quinney for m, _ in bodies),
        "temperature_dependent_cp": max(abs(m.cp_at(T + heating(m, T, v)) / m.cp_at(T) - 1) for m, T in bodies),
        "temperature_dependent_k": k_change * max(in_target, in_particle),
        "friction": situation.friction,
        "friction_heat": situation.friction * warm,
        "mie_gruneisen": max(v / m.c0 for m, _ in bodies),
        "absorbing_boundaries": situation.end_time * wave / (2 * situation.side_distance),
        "thermal_expansion": max(m.Gamma0 * m.rho * m.cp_at(T) * heating(m, T, v) / m.K for m, T in bodies),
        "adhesion": float(situation.bonded),
        "conduction": in_target * warm,
        "particle_conduction": in_particle,
        "interface_conduction": min(across, in_particle),  # what one side cannot take the other cannot give
        "cooling": math.sqrt(max(diffusivity(*body) for body in bodies) * situation.dwell) / situation.diameter,
    }


@dataclass(frozen=True)
class Influence:
    """What leaving an effect out has changed in the measured case that comes nearest, in percent: flattening, crater, mean
    temperature and its 99th percentile (both in K); cost: share of a step's processor time, None where it was not measured."""

    scene: str
    flattening: float
    crater: float
    T_mean: float
    T_p99: float
    cost: float | None


def expected(name: str, values: Mapping[str, float]) -> Influence | None:
    """What to expect of leaving out an effect; None where nothing was measured (docs/evidence/effects.md).

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

    nearest = min(cases, key=far)
    return Influence(
        scene=nearest["scene"],
        flattening=float(nearest["flattening"]),
        crater=float(nearest["crater"]),
        T_mean=float(nearest["T_mean"]),
        T_p99=float(nearest["T_p99"]),
        cost=float(nearest["cost_share"]) if nearest["cost_share"] else None,
    )


def largest_threshold(name: str) -> float | None:
    """The largest threshold that what was measured allows; None for an effect without measured cases.

    Of the cases that changed something by more than LEFT_OUT those count whose number is within twice the smallest: a straight
    line from nothing at zero through each, the steepest of which reaches LEFT_OUT at what is returned. Influence grows at least in
    proportion to the number, so that below it is less. Where no case changed more, the largest number measured.
    """
    cases = [(float(row["number"]), worst_change(row)) for row in _measured() if row["effect"] == name]
    too_much = [(number, change) for number, change in cases if change > LEFT_OUT]
    if not too_much:
        return max((number for number, _ in cases), default=None)
    least = min(number for number, _ in too_much)
    return min(LEFT_OUT * number / change for number, change in too_much if number <= 2.0 * least)


def worst_change(row: Mapping[str, str]) -> float:
    """The largest change of any measure in a row of the study, in percent, without its sign."""
    return max(abs(float(row[what])) for what in ("flattening", "crater", "diameter", "T_mean", "T_p99"))


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
