"""Strength laws: the flow stress of a metal. Each law is a function of a record of constants; LAWS describes the constants.

The functions are plain Python, so that a scene is checked without a compiler. `physics.constitutive` compiles the same functions (njit)
into the kernels of both domains (`yield_stress`). Every law is zero at the melting point and above: a liquid has no strength.
"""  # `caches.kernel_folder` finds the sources of kernels by the word njit

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import erf, exp, inf, log, pi, sqrt
from types import SimpleNamespace
from typing import Any, Protocol, cast

import numpy as np

from .. import units
from . import library

ATOMIC_MASS = 1.66053907e-27  # kg
HARDNESS_OVER_FLOW_STRESS = 3.0  # Tabor (1951), The Hardness of Metals
STRAIN_OF_INDENT = 0.08  # strain under a Vickers indenter for this ratio, same source


class Numbers(Protocol):
    """The constants of a law, as kernels read them: each constant is a field."""

    def __getattr__(self, name: str, /) -> float: ...


def on(number: float) -> bool:
    """Whether a kernel contains the effect of this number of the law: yes unless its type is integer. Known at compile time.

    With a floating-point zero the effect is computed and does not change the result.
    """
    return not isinstance(number, int | np.integer)


def johnson_cook(law: Numbers, eps_p: float, rate: float, T: float) -> float:
    """Flow stress, Pa: (A + B eps_p^n) (1 + C ln(rate / eps_dot_0)) (1 - theta^m), theta = (T - T_ref) / (T_m - T_ref).

    Johnson & Cook (1983), Proc. 7th Int. Symp. on Ballistics, p. 541. eps_p without unit, rate 1/s, T K. If C_high > 0, the rate term
    above eps_dot_high is C ln(eps_dot_high / eps_dot_0) + C_high ln(rate / eps_dot_high), bilinear in the logarithm and continuous.
    """
    sigma = law.A
    if eps_p > 0.0:
        sigma += law.B * eps_p**law.n
    if on(law.C_high) and law.C_high > 0.0 and rate > law.eps_dot_high:
        sigma *= 1.0 + law.C * log(law.eps_dot_high / law.eps_dot_0) + law.C_high * log(rate / law.eps_dot_high)
    elif on(law.C) and rate > law.eps_dot_0:
        sigma *= 1.0 + law.C * log(rate / law.eps_dot_0)
    if on(law.softening) and T > law.T_ref:
        theta = (T - law.T_ref) / (law.T_m - law.T_ref)
        sigma *= max(1.0 - law.softening * theta**law.m, 0.0)
    return sigma


def zerilli_armstrong(law: Numbers, eps_p: float, rate: float, T: float) -> float:
    """Flow stress, Pa: C_0 + (C_1 + C_2 eps_p^n) exp(-C_3 T + C_4 T ln rate) + C_5 eps_p^n.

    Zerilli & Armstrong (1987), J. Appl. Phys. 61, 1816: C_1 = C_5 = 0 and n = 1/2 for fcc metals, C_2 = 0 for bcc metals. eps_p
    without unit, rate 1/s, T K. The thermal exponent is at most zero: a higher temperature does not harden.
    """
    if not on(law.softening) or law.softening == 0.0:
        T = law.T_ref
    elif T >= law.T_m:
        return 0.0
    rate = min(max(rate, law.eps_dot_0), law.rate_limit)
    hardening = max(eps_p, 0.0) ** law.n
    thermal = exp(min(law.C_4 * log(rate) - law.C_3, 0.0) * T)
    return law.C_0 + (law.C_1 + law.C_2 * hardening) * thermal + law.C_5 * hardening


def steinberg_guinan(law: Numbers, eps_p: float, rate: float, T: float) -> float:
    """Flow stress, Pa: Y_0 (1 + beta (eps_p + eps_i))^n, at most Y_max, times 1 - G_T (T - T_ref).

    Steinberg, Cochran & Guinan (1980), J. Appl. Phys. 51, 1498: for rates above some 1e5 1/s, with a flow stress that does not depend
    on the rate. eps_p, eps_i (strain of the metal as received) without unit, rate 1/s, T K. The pressure has no effect.
    """
    sigma = min(law.Y_0 * (1.0 + law.beta * (max(eps_p, 0.0) + law.eps_i)) ** law.n, law.Y_max)
    if on(law.softening) and law.softening > 0.0 and T > law.T_ref:
        sigma *= max(1.0 - law.G_T * (T - law.T_ref), 0.0) if T < law.T_m else 0.0
    return sigma


def preston_tonks_wallace(law: Numbers, eps_p: float, rate: float, T: float) -> float:
    """Flow stress, Pa: 2 G(T) tau. Voce hardening from a yield stress y to a saturation stress s; tau, y, s: stresses over 2 G(T).

    Preston, Tonks & Wallace (2003), J. Appl. Phys. 93, 211, eqs. 3 to 12. s and y are each the larger of a stress by thermal
    activation, with erf(kappa T/T_m ln(gamma xi / rate)), and one by phonon drag at high rates, s_0 (rate / gamma xi)^beta; in y
    the drag stress is at most y_1 (rate / gamma xi)^y_2. G(T) = G_0 (1 - alpha T / T_m), without effect of pressure; xi: frequency of a
    shear wave across an atom, 1/s, at T. eps_p without unit, rate 1/s, T K.
    """
    if not on(law.softening) or law.softening == 0.0:
        T = law.T_ref
    elif T >= law.T_m:
        return 0.0
    T_hat = T / law.T_m
    softer = 1.0 - law.alpha * T_hat
    rate = min(max(rate, law.eps_dot_0), law.rate_limit)
    drag = log(rate / (law.gamma_xi * sqrt(softer)))  # ln(rate / gamma xi), positive if no activation is needed
    activation = erf(law.kappa * T_hat * max(-drag, 0.0))
    s_drag = law.s_0 * exp(law.beta * drag)
    s = max(law.s_0 - (law.s_0 - law.s_inf) * activation, s_drag)
    y = max(law.y_0 - (law.y_0 - law.y_inf) * activation, min(law.y_1 * exp(law.y_2 * drag), s_drag))
    tau = s
    room = s - y
    if room > 1e-9 * s and law.s_0 > y:
        if law.p > 0.0:
            a = (law.s_0 - y) / law.p
            phi = exp(room / a) - 1.0
            tau = s + a * log(1.0 - phi * exp(-room / a - law.theta * max(eps_p, 0.0) / (a * phi)))
        else:
            tau = s - room * exp(-law.theta * max(eps_p, 0.0) / room)
    return 2.0 * law.G_0 * softer * tau


@dataclass(frozen=True)
class Parameter:
    """A constant of a law. unit: "" for a plain number; low, high: limits in SI units; default: None if the constant is required."""

    unit: str
    low: float
    high: float
    default: float | None
    about: str


@dataclass(frozen=True)
class Law:
    """A strength law. function(record, eps_p, rate, T): the flow stress; about: description; parameters: its constants by name."""

    function: Callable[[Numbers, float, float, float], float]
    about: str
    parameters: Mapping[str, Parameter]


_T_REF = Parameter("K", 1.0, 2000.0, 300.0, "temperature of the metal without thermal softening")
_LOWEST_RATE = Parameter("1/s", 1e-6, 1e6, 1e-3, "lower bound of the rate in the law")
LAWS: dict[str, Law] = {
    "johnson_cook": Law(
        johnson_cook,
        "Johnson & Cook (1983); with C_high the rate term is bilinear in ln(rate)",
        {
            "A": Parameter("MPa", 1e5, 2e10, None, "yield stress at eps_dot_0 and T_ref"),
            "B": Parameter("MPa", 0.0, 1e11, None, "hardening"),
            "n": Parameter("", 0.01, 2.0, None, "exponent of the strain"),
            "C": Parameter("", 0.0, 1.0, None, "factor of the term ln(rate / eps_dot_0)"),
            "m": Parameter("", 0.01, 10.0, None, "exponent of the temperature"),
            "eps_dot_0": Parameter("1/s", 1e-6, 1e6, None, "reference rate; no rate hardening below this rate"),
            "T_ref": Parameter("K", 1.0, 2000.0, None, "reference temperature; no thermal softening below it"),
            "C_high": Parameter(
                "", 0.0, 2.0, 0.0, "factor of ln(rate / eps_dot_high) above eps_dot_high; 0: C at all rates"
            ),
            "eps_dot_high": Parameter("1/s", 1e-3, 1e9, 1e3, "strain rate above which C_high applies"),
        },
    ),
    "zerilli_armstrong": Law(
        zerilli_armstrong,
        "Zerilli & Armstrong (1987), fcc and bcc",
        {
            "C_0": Parameter("MPa", 0.0, 1e10, None, "athermal stress"),
            "C_1": Parameter("MPa", 0.0, 1e11, 0.0, "thermal stress (bcc)"),
            "C_2": Parameter("MPa", 0.0, 1e11, 0.0, "thermal hardening (fcc)"),
            "C_3": Parameter("1/K", 0.0, 0.1, None, "softening"),
            "C_4": Parameter("1/K", 0.0, 0.01, None, "decrease of the thermal softening per ln(rate)"),
            "C_5": Parameter("MPa", 0.0, 1e11, 0.0, "athermal hardening (bcc)"),
            "n": Parameter("", 0.01, 2.0, 0.5, "exponent of the strain"),
            "eps_dot_0": _LOWEST_RATE,
            "T_ref": _T_REF,
        },
    ),
    "steinberg_guinan": Law(
        steinberg_guinan,
        "Steinberg, Cochran & Guinan (1980): rates above 1e5 1/s",
        {
            "Y_0": Parameter("MPa", 1e5, 2e10, None, "yield stress"),
            "Y_max": Parameter("MPa", 1e5, 2e10, None, "largest flow stress at T_ref"),
            "beta": Parameter("", 0.0, 1e5, None, "hardening"),
            "n": Parameter("", 0.01, 2.0, None, "exponent of the hardening"),
            "eps_i": Parameter("", 0.0, 5.0, 0.0, "plastic strain of the metal as received"),
            "G_T": Parameter("1/K", 0.0, 0.01, None, "relative decrease per kelvin, as of the shear modulus"),
            "eps_dot_0": _LOWEST_RATE,
            "T_ref": _T_REF,
        },
    ),
    "preston_tonks_wallace": Law(
        preston_tonks_wallace,
        "Preston, Tonks & Wallace (2003): thermal activation and phonon drag",
        {
            "theta": Parameter("", 0.0, 1.0, None, "initial hardening rate / (2 G)"),
            "p": Parameter("", 0.0, 20.0, None, "0: Voce hardening; larger values: slower saturation"),
            "s_0": Parameter("", 1e-5, 1.0, None, "saturation stress at 0 K / (2 G)"),
            "s_inf": Parameter("", 1e-6, 1.0, None, "saturation stress near the melting point / (2 G)"),
            "kappa": Parameter("", 0.0, 10.0, None, "thermal activation"),
            "gamma": Parameter(
                "", 1e-12, 1.0, None, "rate of thermal activation / xi, the frequency of a shear wave across an atom"
            ),
            "y_0": Parameter("", 1e-6, 1.0, None, "yield stress at 0 K / (2 G)"),
            "y_inf": Parameter("", 1e-6, 1.0, None, "yield stress near the melting point / (2 G)"),
            "y_1": Parameter("", 1e-5, 1.0, None, "yield stress between thermal activation and phonon drag"),
            "y_2": Parameter("", 0.0, 2.0, None, "exponent of the rate in y_1"),
            "beta": Parameter("", 0.0, 1.0, None, "exponent of phonon drag"),
            "G_0": Parameter("GPa", 1e8, 1e12, None, "shear modulus at 0 K"),
            "alpha": Parameter("", 0.0, 0.99, None, "G(T) = G_0 (1 - alpha T / T_m)"),
            "M": Parameter("", 1.0, 300.0, None, "mass of an atom, u"),
            "eps_dot_0": _LOWEST_RATE,
            "T_ref": _T_REF,
        },
    ),
}
#: Names of the numbers of all laws in a record.
FIELDS = tuple(dict.fromkeys(["gamma_xi", "rate_limit", *(name for law in LAWS.values() for name in law.parameters)]))


@dataclass(frozen=True)
class Fitted:
    """Range in which the parameters of a set are fitted; None: not stated in the source.

    rate: lowest and highest, 1/s, infinite without an upper limit. temperature: lowest and highest, K. strain: largest plastic strain.
    """

    rate: tuple[float, float] | None = None
    temperature: tuple[float, float] | None = None
    strain: float | None = None

    @property
    def words(self) -> str:
        """The range as text, "not stated" if all are None."""
        parts = []
        if self.rate:
            fastest = f"to {self.rate[1]:.3g} 1/s" if self.rate[1] < inf else "1/s and faster"
            parts.append(f"{self.rate[0]:.3g} {fastest}")
        if self.temperature:
            parts.append(f"{self.temperature[0]:.0f} to {self.temperature[1]:.0f} K")
        if self.strain:
            parts.append(f"strains to {self.strain:g}")
        return ", ".join(parts) or "not stated"

    @classmethod
    def read(cls, value: object) -> "Fitted":
        """Read a range { rate = ["1e-3 1/s", "1e4 1/s"], temperature = ["77 K"], strain = 0.5 }, all optional. Raises ValueError."""
        if not isinstance(value, Mapping) or not set(value) <= {"rate", "temperature", "strain"}:
            raise ValueError("must be a table of rate, temperature, strain")
        found: dict[str, Any] = {}
        for key, unit, high in (("rate", "1/s", 1e13), ("temperature", "K", 5000.0)):
            if key in value:
                pair = value[key]
                if not isinstance(pair, list) or len(pair) not in (1, 2):
                    example = f'such as ["1 {unit}", "1000 {unit}"], or only the first of them'
                    raise ValueError(f"{key} must be two values, {example}")
                first, last = [*(library.read_number(end, unit, 0.0, high) for end in pair), inf][:2]
                if first > last:
                    raise ValueError(f"{key} must have the smaller value first")
                found[key] = first, last
        if "strain" in value:
            found["strain"] = library.read_number(value["strain"], "", 0.0, 20.0)
        return cls(**found)


@dataclass(frozen=True)
class Strength:
    """A set of constants of a law. numbers: SI values by name; set: name in the library, "" if from a scene; fitted: valid range."""

    law: str
    numbers: dict[str, float] = field(hash=False)
    set: str = ""
    fitted: Fitted = Fitted()
    source: str = ""

    def __getitem__(self, name: str) -> float:
        """A constant of the law by its name, SI."""
        return self.numbers[name]

    @property
    def label(self) -> str:
        """Name for texts: the law, and the set if it has a name."""
        return f"{self.law} ({self.set})" if self.set else self.law

    def fields(self, T_m: float, rho: float, softens: bool = True, rate_hardens: bool = True) -> dict[str, float]:
        """The constants as fields of a LAW record. T_m: K; rho: kg/m3; softens, rate_hardens: whether heat softens and rate hardens."""
        values = dict.fromkeys((*FIELDS, *LAWS), 0.0) | self.numbers
        values |= {self.law: 1.0, "T_m": T_m, "softening": float(softens)}
        values["rate_limit"] = 1e30 if rate_hardens else values["eps_dot_0"]
        if not rate_hardens:
            values |= {"C": 0.0, "C_high": 0.0}
        if values["M"]:
            atoms = rho / (values["M"] * ATOMIC_MASS)  # in a cubic metre
            shear_wave = sqrt(values["G_0"] / rho)
            values["gamma_xi"] = values["gamma"] * 0.5 * (4.0 * pi / 3.0 * atoms) ** (1.0 / 3.0) * shear_wave
        return values

    def flow_stress(self, eps_p: float, rate: float, T: float, T_m: float, rho: float) -> float:
        """Flow stress, Pa. rate: strain rate, 1/s; T: temperature, K; T_m, rho: melting point and density of the metal."""
        return LAWS[self.law].function(cast(Numbers, SimpleNamespace(**self.fields(T_m, rho))), eps_p, rate, T)


def read(
    table: Mapping[str, object], old: Strength | None, problems: list[str]
) -> tuple[Strength, list[str], list[str]]:
    """The strength law of a material's table: (law, keys of the law, missing parameters). problems: list to which problems are added.

    Values that the table does not have are those of `old`, if its law is the same.
    """
    law = table.get("law", old.law if old else "johnson_cook")
    if not isinstance(law, str) or law not in LAWS:
        problems.append(f"law = {str(law)[:40]!r}: expected one of {', '.join(LAWS)}{units.nearest(str(law), LAWS)}")
        law = "johnson_cook"
    schema = LAWS[law].parameters
    numbers = {key: p.default for key, p in schema.items() if p.default is not None}
    if old is not None and old.law == law:
        numbers |= old.numbers
    for key, p in schema.items():
        if key in table:
            try:
                numbers[key] = library.read_number(table[key], p.unit, p.low, p.high)
            except ValueError as error:
                problems.append(f"{key} {error}")
                numbers[key] = p.low
    own = ["law", "fitted", *schema]
    fitted, name, source = Fitted(), "", ""
    if old is not None and not any(key in table for key in own):
        fitted, name, source = old.fitted, old.set, old.source
    if "fitted" in table:
        try:
            fitted = Fitted.read(table["fitted"])
        except ValueError as error:
            problems.append(f"fitted {error}")
    lacks = [key for key in schema if key not in numbers]
    return Strength(law, numbers | dict.fromkeys(lacks, 1.0), name, fitted, source), own, lacks
