"""Measures of a run: names, units, ranges and convergence. `impact/measure.py` computes them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")

# Greatest plastic strain that points and elements can resolve. It means a simple shear of 35 (eps_p = gamma / sqrt(3)); compression
# does not reach it. Neighbouring points across the shear plane are then 35 spacings apart, ten times the support of the kernel, and an
# element is 35 times as long and 1/35 as thick as initially: neither resolves the shear band.
EPS_P_LIMIT = 20.0
SHAPE_TOLERANCE = 0.01  # of the diameter of a sphere: accuracy with which the carried surface follows the points
PLASTIC_SHARE_LIMIT = 0.05  # a run warns if numerical dissipation over plastic work of the particle is larger
# A surface that lies d = D / 30 too deep everywhere encloses 20 % less volume (dV / V = 6 d / D)
SURFACE_VOLUME_LIMIT = 0.2
OF_THE_SURFACE = (
    "flattening_ratio", "flattening_ratio_total", "height_m", "thickness_m", "splat_diameter_m", "jet_length_m",
)  # fmt: skip
DISSIPATION_LIMIT = 0.25  # numerical dissipation over the initial kinetic energy: if larger, it influences the result

STICKS, REBOUNDS, UNDECIDED = "sticks", "rebounds", "undecided"  # verdicts on a particle
EMBEDDED, BROKEN = "embedded", "broken"  # of ceramic particles: held without a bond; broken by tensile stress
# verdict -> its verb for one particle, and for several
VERBS = {
    STICKS: ("sticks", "stick"), EMBEDDED: ("is embedded", "are embedded"), REBOUNDS: ("rebounds", "rebound"),
    BROKEN: ("is broken", "are broken"), UNDECIDED: ("is undecided", "are undecided"),
}  # fmt: skip
VERDICTS = tuple(VERBS)
BY_BONDS, BY_FORMULA, BY_SCENE, BY_MOTION, BY_STRESS = "bonds", "formula", "scene", "motion", "stress"
# method that decides a verdict -> its name: bonds computed in the impact, formula of the velocity, ties of the scene, ...
VERDICT_BY = {
    BY_BONDS: "computed bonds", BY_FORMULA: "formula", BY_SCENE: "the scene", BY_MOTION: "motion alone", BY_STRESS: "tensile stress",
}  # fmt: skip

SHAPE, PARTICLE, TARGET, RUN = "shape", "particle", "target", "run"
VERDICT, BALANCE = "verdict", "energy and momentum balance"
GROUPS = (VERDICT, SHAPE, PARTICLE, BALANCE, TARGET, RUN)  # in reading order

# Ending of a key -> display unit, factor from SI; the first ending that matches counts
_UNITS = {
    "_m_s": ("m/s", 1.0), "_m2": ("µm²", 1e12), "_m": ("µm", 1e6), "_Pa": ("MPa", 1e-6), "_K": ("K", 1.0), "_kg": ("ng", 1e12),
    "_J": ("nJ", 1e9), "_s": ("ns", 1e9),
}  # fmt: skip


@dataclass(frozen=True)
class Measure:
    """One measure. key: its name in files, where its value is in SI; label: its name in tables; short: its name in a list.

    unit, factor: display unit and factor from SI, by default from the ending of the key. low, high: range that follows from the
    definition; beyond: text for a value outside this range. expected: range of usual values; unusual: meaning of a value below this
    range, and of one above it. converges: True if the value converges with the number of points, False if it does not (local maxima),
    None if it does not depend on the resolution.
    """

    key: str
    label: str = ""
    group: str = RUN
    short: str = ""
    unit: str = ""
    factor: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    beyond: str = "outside the range of its definition"
    expected: tuple[float, float] = (-math.inf, math.inf)
    unusual: tuple[str, str] = ("", "")
    converges: bool | None = None

    def __post_init__(self) -> None:
        ending = next((ending for ending in _UNITS if self.key.endswith(ending)), "")
        unit, factor = _UNITS.get(ending, ("", 1.0))
        label = self.label or self.key.removesuffix(ending).replace("_", " ")
        derived: dict[str, str | float] = {"label": label, "short": self.short or label}
        derived |= {} if self.factor else {"unit": unit, "factor": factor}
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def initial(self, T_0: float) -> float:
        """The value to which relative errors refer: the initial temperature T_0 (K) for temperatures, zero for other measures."""
        return T_0 if self.key.startswith("T_") else 0.0

    def refusal(self, value: float) -> str | None:
        """Why a value is invalid (not finite or outside the range); None if it is valid."""
        if not math.isfinite(value):
            return "not a number"
        if self.low <= value <= self.high:
            return None
        side, limit = ("below", self.low) if value < self.low else ("above", self.high)
        text = f"{value * self.factor:.4g} is {side} {limit * self.factor:.4g} {self.unit}"
        return f"{text.rstrip()}: {self.beyond}"

    def remark(self, value: float) -> str | None:
        """The meaning of a valid but unusual value; None if the value is usual."""
        low, high = self.expected
        text = self.unusual[0] if value < low else self.unusual[1] if value > high else ""
        return f"{self.label} is {value * self.factor:.4g}: {text}" if text else None


_STRAIN = "such a plastic strain is too large for the numerical scheme"
TABLE = (
    Measure("time_s", "time", SHAPE),
    Measure(
        "flattening_ratio", "flattening above the surface", SHAPE, "flattening above surface", converges=True, expected=(0.0, 1.0),
        unusual=(
            "the top is higher than the particle's diameter: the particle stands upright or has left the target",
            "the top lies below the surface: the particle is embedded",
        ),
    ),
    Measure(
        "flattening_ratio_total", "flattening, whole", SHAPE, "flattening", converges=True, high=1.0, beyond="the thickness is zero",
        expected=(-SHAPE_TOLERANCE, 1.0),
        unusual=("the splat is thicker than the particle's diameter: it covers the wall of its crater, or is a rod", ""),
    ),
    Measure(
        "surface_volume_error", "volume error of the surface, relative to the points", SHAPE, unit="%", factor=100.0,
        low=-SURFACE_VOLUME_LIMIT, high=SURFACE_VOLUME_LIMIT, beyond="the surface does not follow the points: use more points",
    ),
    Measure("pore_share", "closed pores", SHAPE, unit="%", factor=100.0),
    Measure("height_m", group=SHAPE),
    Measure("thickness_m", group=SHAPE, low=0.0),
    Measure("crater_depth_m", group=SHAPE, short="crater", converges=True),
    Measure("splat_diameter_m", group=SHAPE, short="diameter", low=0.0, converges=True),
    Measure("jet_length_m", "jet length beyond the splat", SHAPE, "jet", low=0.0, converges=False),
    Measure("unresolved_share", "surface far from all points", SHAPE, unit="%", factor=100.0, low=0.0, high=1.0, converges=False),
    Measure("velocity_z_m_s", "mean velocity upwards", SHAPE),
    Measure("verdict", group=VERDICT),
    Measure("verdict_criterion", "criterion", VERDICT),
    Measure("verdict_by", "decided by", VERDICT),
    Measure("verdict_rests_on", "rests on", VERDICT),
    Measure("verdict_by_bonds", "verdict of the computed bonds alone", VERDICT),
    Measure("verdict_is_close", "margin below the scatter of placements", VERDICT),
    Measure("margin_m_s", "margin (as velocity)", VERDICT),
    Measure("margin_J", "margin (as energy)", VERDICT),
    Measure("rebounded", group=VERDICT),
    Measure("restitution", "rebound velocity / impact velocity", VERDICT, low=0.0),
    Measure(
        "velocity_ratio", "normal velocity / critical velocity of the particle's metal", VERDICT, "velocity / critical velocity",
        low=0.0,
    ),
    Measure("bonded_area_m2", "area that bonded", VERDICT, low=0.0),
    Measure("bonded_area_end_m2", "bonded area at the end", VERDICT, low=0.0),
    Measure("bond_energy_J", "energy to break all bonds", VERDICT, low=0.0),
    Measure("penetration_max_m", "greatest penetration", SHAPE, low=0.0),
    Measure("contact_dropped", "points of the particle that have lost their contact"),
    Measure("contact_dropped_bodies", "nodes that have lost their contact with another body so far"),
    Measure("surface_level_m", "height of the surface at the first contact", SHAPE),
    Measure("material", "material of the particle", PARTICLE),
    Measure("diameter_m", "diameter before impact", PARTICLE, "diameter"),
    Measure("speed_m_s", "impact speed", PARTICLE, low=0.0),
    Measure("velocity_m_s", "velocity", PARTICLE, low=0.0),  # this and the next: axes of a map, known before a run
    Measure("temperature_K", "initial temperature", PARTICLE, low=0.0),
    Measure("particle_mass_kg", "mass of the particle", PARTICLE, low=0.0),
    Measure("eps_p_mean", "mean plastic strain", PARTICLE, "mean strain", low=0.0, high=EPS_P_LIMIT, beyond=_STRAIN, converges=True),
    Measure("eps_p_p99", "plastic strain, 99 %", PARTICLE, "strain 99 %", low=0.0, high=EPS_P_LIMIT, beyond=_STRAIN, converges=True),
    Measure("eps_p_max", "greatest plastic strain", PARTICLE, low=0.0, high=EPS_P_LIMIT, beyond=_STRAIN, converges=False),
    Measure("T_mean_K", "mean temperature", PARTICLE, "mean T rise", low=0.0, converges=True),
    Measure("T_p99_K", "temperature, 99 %", PARTICLE, "T rise 99 %", low=0.0, converges=True),
    Measure("T_max_K", "highest temperature", PARTICLE, low=0.0, converges=False),
    Measure("rebound_velocity_m_s", "rebound velocity", SHAPE, "rebound", low=0.0, converges=True),
    Measure("von_mises_max_Pa", "highest von Mises stress", PARTICLE, low=0.0, converges=False),
    Measure("tension_max_Pa", "greatest tensile principal stress", PARTICLE, converges=False),
    Measure("broken_share", "points above the tensile limit", PARTICLE, unit="%", factor=100.0, low=0.0, high=1.0),
    Measure("energy_drift", group=BALANCE, unit="%", factor=100.0),
    Measure("momentum_error", group=BALANCE),
    Measure("numerical_dissipation", group=BALANCE, unit="%", factor=100.0),
    Measure("dissipation_of_plastic", "numerical dissipation / plastic work, particle", BALANCE, unit="%", factor=100.0),
    Measure("target_eps_p_max", "greatest plastic strain", TARGET, low=0.0, high=EPS_P_LIMIT, beyond=_STRAIN, converges=False),
    Measure("target_T_max_K", "highest temperature", TARGET, low=0.0, converges=False),
    Measure("target_von_mises_max_Pa", "highest von Mises stress", TARGET, low=0.0, converges=False),
    Measure("plastic_radius_m", "radius of the yielded zone", TARGET, low=0.0),
    Measure("plastic_depth_m", "depth of the yielded zone", TARGET, low=0.0),
    Measure("element_size_m", "smallest elements"),
    Measure("spacing_m", "spacing of the points"),
    Measure("ranks", "processes"),
    Measure("idle_share", "waiting time of each process", unit="%", factor=100.0),
    Measure("memory_peak_bytes", "most memory", unit="MB", factor=1e-6),
    Measure("kinetic_energy_0_J", "kinetic energy at the start"),
    Measure("deposition_efficiency", low=0.0, high=1.0),
    Measure("deposition_efficiency_range", "deposition efficiency, smallest and largest"),
    Measure("sim_time_s", "simulated time"),
    Measure("wall_s", "wall time", unit="s", factor=1.0),
    Measure("wall_loop_s", "wall time of the steps", unit="s", factor=1.0),
    Measure("dt_mean_s", "mean time step", unit="ps", factor=1e12),
    Measure("version", "coldspray"),
)  # fmt: skip
MEASURES = {measure.key: measure for measure in TABLE}
CONVERGING = tuple(measure.key for measure in TABLE if measure.converges)
PROPERTIES = {  # effective properties of a coating: name, SI unit, factor from SI to the display unit, display unit
    "E": ("Young's modulus", "Pa", 1e-9, "GPa"), "G": ("shear modulus", "Pa", 1e-9, "GPa"),
    "k": ("heat conductivity", "W/mK", 1.0, "W/mK"), "sigma": ("electric conductivity", "S/m", 1e-6, "MS/m"),
}  # fmt: skip


def measure(key: str) -> Measure:
    """The `Measure` of a key. A key that is not in TABLE gets one with the unit that its ending gives."""
    return MEASURES.get(key) or Measure(key, group=TARGET if key.startswith(("target", "plastic")) else RUN)


def within_range(values: Mapping[str, T]) -> tuple[dict[str, T | None], dict[str, str]]:
    """Return two tables by key: the values, with None in place of each invalid one (`Measure.refusal`); and the reason for each None.

    If the carried surface does not follow the points (surface_volume_error is invalid), all measures of the surface become None.
    """
    reasons = {
        key: reason
        for key, value in values.items()
        if isinstance(value, float | int) and (reason := measure(key).refusal(value)) is not None
    }
    if (reason := reasons.get("surface_volume_error")) is not None:
        reasons |= dict.fromkeys([key for key in OF_THE_SURFACE if key in values], reason)
    return {key: None if key in reasons else value for key, value in values.items()}, reasons


def axis_label(key: str, whole: bool = False) -> str:
    """Name and unit for an axis: "velocity (m/s)". whole: the name in tables, not the short one."""
    m = measure(key)
    name = m.label if whole else m.short
    return f"{name} ({m.unit})" if m.unit else name
