"""Materials: strength law, shock equation of state and thermal data of a metal, with sources.

The library is the file `materials.toml`. A scene may add materials, or change numbers of materials in the library, in the same
format.
"""

import math
import re
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from typing import Annotated, NamedTuple, get_args, get_type_hints

from .. import units
from ..errors import ColdsprayError, SceneError
from . import library
from .dislocations import NYE_FACTOR, taylor_relation
from .strength import HARDNESS_OVER_FLOW_STRESS, LAWS, STRAIN_OF_INDENT, Strength, read

Pairs = tuple[tuple[float, float], ...]

_SAFE_TEXT = re.compile(r"[A-Za-z0-9_.,:;/()=&+ -]{0,600}", re.ASCII)
_SAFE_WORDS = "A-Z, a-z, digits, spaces and _ . , : ; / ( ) = & + -"
_HV = 9.80665e6  # Pa
HOPKINSON_RATE = 1e4  # 1/s
_HARDEST = 5.0  # largest initial plastic strain for a hardness


class Number(NamedTuple):
    """Unit and limits of a numerical property. unit: "" for a plain number; low, high: limits in SI units, wide enough for any metal;
    varies: whether the property may depend on temperature."""

    unit: str
    low: float
    high: float
    varies: bool = False


@dataclass(frozen=True, kw_only=True)
class Material:
    """A metal, ceramic or polymer: strength law, shock equation of state, thermal data. SI units. None: not known.

    c0, s: constants of the Hugoniot. cp, k, thermal_expansion (linear): ((T, value), ...), one pair for a constant, or two pairs;
    values are linear between the pairs and constant outside. sigma_TS: tensile strength at 293 K, for critical velocities. kind:
    "metal" or "ceramic"; a ceramic, also a cemented carbide, makes no metallic bond and is broken where a tensile principal stress
    exceeds tensile_limit. oxide_thickness, oxide_strength, oxide_threshold: thickness and strength of the native oxide film, and
    surface exposure at which it cracks (`physics.adhesion`). burgers: Burgers vector. taylor_alpha: coefficient of Taylor's relation
    at 1e12 dislocations per m2; 0: gradients of plastic strain do not harden the metal (`forest`). D_v, Q_v: factor and activation
    energy (J/mol) of self-diffusion through the lattice. D_c, Q_c: the same for diffusion along dislocations; D_c (m4/s)
    includes the area of a dislocation core as a factor (`physics.recovery`). T_g: glass transition temperature of a polymer; None
    for a metal.
    """

    name: str
    rho: Annotated[float, Number("kg/m^3", 500.0, 25e3)]
    G: Annotated[float, Number("GPa", 1e8, 1e12)]
    c0: Annotated[float, Number("m/s", 100.0, 2e4)]
    s: Annotated[float, Number("", 0.0, 5.0)]
    Gamma0: Annotated[float, Number("", 0.0, 5.0)]
    T_m: Annotated[float, Number("K", 200.0, 5000.0)]
    taylor_quinney: Annotated[float, Number("", 0.0, 1.0)] = 0.9
    cp: Annotated[Pairs, Number("J/(kg K)", 10.0, 1e4, True)]
    k: Annotated[Pairs, Number("W/(m K)", 0.01, 5000.0, True)]
    thermal_expansion: Annotated[Pairs, Number("1/K", 0.0, 1e-3, True)] = ((300.0, 0.0),)
    sigma_TS: Annotated[float | None, Number("MPa", 1e6, 1e10)] = None
    kind: str = "metal"
    tensile_limit: Annotated[float | None, Number("MPa", 1e6, 1e11)] = None
    oxide_thickness: Annotated[float | None, Number("nm", 1e-10, 1e-6)] = None
    oxide_strength: Annotated[float | None, Number("GPa", 1e6, 1e11)] = None
    oxide_threshold: Annotated[float | None, Number("", 0.0, 0.9)] = None
    burgers: Annotated[float | None, Number("nm", 1e-10, 1e-9)] = None
    taylor_alpha: Annotated[float, Number("", 0.0, 1.0)] = 0.0
    D_v: Annotated[float | None, Number("m^2/s", 1e-9, 1.0)] = None
    Q_v: Annotated[float | None, Number("kJ/mol", 1e4, 1e6)] = None
    D_c: Annotated[float | None, Number("m^4/s", 1e-30, 1e-18)] = None
    Q_c: Annotated[float | None, Number("kJ/mol", 1e4, 1e6)] = None
    T_g: Annotated[float | None, Number("K", 100.0, 1000.0)] = None
    source: str = ""
    note: str = ""
    strength: Strength

    @property
    def K(self) -> float:
        """Bulk modulus, Pa: rho c0^2."""
        return self.rho * self.c0**2

    @property
    def E(self) -> float:
        """Young's modulus, Pa."""
        return 9 * self.K * self.G / (3 * self.K + self.G)

    @property
    def nu(self) -> float:
        """Poisson's ratio."""
        return (3 * self.K - 2 * self.G) / (2 * (3 * self.K + self.G))

    @property
    def forest(self) -> tuple[float, float]:
        """Constants A and B, Pa, of Taylor's relation (`physics.dislocations`); both are zero if the metal has no `taylor_alpha`."""
        return taylor_relation(self.G, self.burgers or 0.0, self.taylor_alpha) if self.taylor_alpha else (0.0, 0.0)

    @property
    def gradient_length(self) -> float:
        """Length r b, m, r: Nye factor; zero if the metal has no `taylor_alpha`. A gradient eta (1/m) of plastic strain needs the
        dislocation density r eta / b (Gao, Huang, Nix & Hutchinson (1999), J. Mech. Phys. Solids 47, 1239)."""
        return NYE_FACTOR * (self.burgers or 0.0) if self.taylor_alpha else 0.0

    @property
    def is_ceramic(self) -> bool:
        """Whether the material is brittle and makes no metallic bonds."""
        return self.kind == "ceramic"

    @property
    def is_polymer(self) -> bool:
        """Whether it is a polymer, on which metals bond only if the scene gives a law of adhesion."""
        return self.T_g is not None

    @property
    def wave_speed(self) -> float:
        """Speed of longitudinal elastic waves, m/s: sqrt((K + 4/3 G) / rho)."""
        return math.sqrt((self.K + 4 / 3 * self.G) / self.rho)

    @property
    def T_ref(self) -> float:
        """Reference temperature of the strength law, below which there is no thermal softening, K."""
        return self.strength["T_ref"]

    @property
    def fitted_rate(self) -> float:
        """Highest strain rate of the data to which the strength law is fitted, 1/s. If the source does not state it: a usual rate of
        Hopkinson bars."""
        rates = self.strength.fitted.rate
        return rates[1] if rates else HOPKINSON_RATE

    def flow_stress(self, eps_p: float, rate: float, T: float) -> float:
        """Flow stress, Pa, at a plastic strain, a strain rate (1/s) and a temperature (K)."""
        return self.strength.flow_stress(eps_p, rate, T, self.T_m, self.rho)

    def cp_at(self, T: float) -> float:
        """Specific heat of the metal at T (K), J/(kg K)."""
        return _interpolate(self.cp, T)

    def k_at(self, T: float) -> float:
        """Thermal conductivity of the metal at T (K), W/(m K)."""
        return _interpolate(self.k, T)

    def thermal_expansion_at(self, T: float) -> float:
        """Coefficient of linear thermal expansion at T (K), 1/K."""
        return _interpolate(self.thermal_expansion, T)

    def strain_between(self, T_0: float, T_1: float) -> float:
        """Linear thermal strain from T_0 to T_1, K: from thermal_expansion, or from Gamma0 rho c_p / 3 K if it is not known."""
        middle = 0.5 * (T_0 + T_1)
        alpha = self.thermal_expansion_at(middle) or self.Gamma0 * self.rho * self.cp_at(middle) / (3.0 * self.K)
        return alpha * (T_1 - T_0)

    def effusivity(self, T: float) -> float:
        """Thermal effusivity sqrt(k rho c_p) at T (K), W s^(1/2)/(m^2 K). The heat of a contact is divided between two half-spaces in
        proportion to it."""
        return math.sqrt(self.k_at(T) * self.rho * self.cp_at(T))

    def initial_strain(self, hardness: float | None, yield_strength: float | None) -> float:
        """Initial plastic strain of a metal with a given hardness or yield strength, Pa, at 293 K and the lowest rate of its law.

        Hardness: three times the flow stress after a further strain of 0.08 (Tabor 1951). Raises ValueError outside the law's range.
        """
        wanted = yield_strength if hardness is None else hardness
        if wanted is None:
            return 0.0
        factor, further = (1.0, 0.0) if hardness is None else (HARDNESS_OVER_FLOW_STRESS, STRAIN_OF_INDENT)

        def reached(eps_p: float) -> float:
            return factor * self.flow_stress(eps_p + further, 0.0, 293.0)

        low, high = 0.0, _HARDEST
        if not reached(low) * (1 - 1e-9) <= wanted <= reached(high):
            unit, scale = ("HV", _HV) if hardness is not None else ("MPa", 1e6)
            # the printed numbers are inside the limits
            limits = f"{(1 + 5e-4) * reached(low) / scale:.4g} to {(1 - 5e-4) * reached(high) / scale:.4g} {unit}"
            law = f"{self.name} ({self.strength.label}) at plastic strains of 0 to {_HARDEST:g}"
            raise ValueError(f"is outside {limits}, the range of {law}")
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if reached(middle) < wanted else (low, middle)
        return high


def mixed(shell: Material, core: Material, share: float) -> Material:
    """The material of the shell, but with the mean density and specific heat of a composite particle, for the flight of this particle.
    share: volume fraction of the core."""
    rho = (1.0 - share) * shell.rho + share * core.rho
    by_mass = share * core.rho / rho
    ends = [T for table in (shell.cp, core.cp) for T, _ in table]
    cp = tuple((T, (1.0 - by_mass) * shell.cp_at(T) + by_mass * core.cp_at(T)) for T in (min(ends), max(ends)))
    return replace(shell, rho=rho, cp=cp)


#: By field: the numbers of a material, the default values, and other keys of a table (E and nu instead of G and c0).
_HINTS = {name: get_args(hint)[1:] for name, hint in get_type_hints(Material, include_extras=True).items()}
LIMITS: dict[str, Number] = {name: extra[0] for name, extra in _HINTS.items() if extra and isinstance(extra[0], Number)}
DEFAULTS = {f.name: f.default for f in fields(Material) if f.default is not MISSING}
_OTHER_FIELDS = {"density": LIMITS["rho"], "E": Number("GPa", 1e8, 1e12), "nu": Number("", 0.0, 0.495)}
#: Unit of each number in the table of a metal, "" of a plain number.
UNITS = {key: number.unit for key, number in (LIMITS | _OTHER_FIELDS).items()} | {
    key: parameter.unit for law in LAWS.values() for key, parameter in law.parameters.items()
}


@dataclass(frozen=True)
class Entry:
    """A material of the library. material: the material with its first strength set; sets: tables of all strength sets by name;
    aliases: its other names."""

    material: Material
    sets: Mapping[str, Mapping[str, object]]
    aliases: tuple[str, ...]

    def with_set(self, choice: str) -> Material:
        """The material with the first strength set whose name or law is `choice`. Raises ValueError with all sets if there is none."""
        for name, table in self.sets.items():
            if choice in (name, table["law"]):
                return _with_set(self.material, name, table)
        there = ", ".join(f"{name} ({table['law']})" for name, table in self.sets.items())
        lacks = f"{self.material.name} has no strength set or law of this name"
        raise ValueError(f"{choice[:40]!r}: {lacks}; it has {there}")

    @property
    def materials(self) -> list[Material]:
        """Materials with each of the strength sets, one for each set."""
        return [_with_set(self.material, name, table) for name, table in self.sets.items()]


def names() -> list[str]:
    """Names of the materials of the library."""
    return list(_library())


def entry(name: str) -> Entry:
    """A material of the library with all its sets, by its name or an alias.

    Raises ColdsprayError with the nearest name for an unknown name.
    """
    known = _library() | _aliases()
    if name not in known:
        raise ColdsprayError(unknown(name, {key: found.material for key, found in known.items()}))
    return known[name]


def material(name: str, strength: str = "") -> Material:
    """A material of the library, by its name or an alias. strength: a set or a law, by default the first set.

    Raises ColdsprayError with the nearest name for an unknown name.
    """
    try:
        return entry(name).with_set(strength) if strength else entry(name).material
    except ValueError as error:
        raise ColdsprayError(f"strength = {error}") from None


def fitted_at(metal: Material, rate: float) -> list[str]:
    """Names of those of the library's strength sets of a metal that are fitted up to the strain rate `rate` (1/s) or higher."""
    known = _library().get(metal.name)
    ranges = {other.strength.set: other.strength.fitted.rate for other in known.materials} if known else {}
    return [name for name, limits in ranges.items() if limits and limits[1] >= rate]


def unknown(name: str, known: Mapping[str, Material]) -> str:
    """The message for an unknown material. known: materials by name and alias."""
    proper = {key: metal for key, metal in known.items() if key == metal.name}
    return f"unknown material{units.nearest(name, known)}; known: {', '.join(proper)}"


def from_table(name: str, table: Mapping[str, object], base: Material | None = None) -> Material:
    """A material from a table of numbers and texts with units.

    table: fields of Material as in materials.toml, or E, nu and density instead of G, c0 and rho; `law` and its parameters. Other
    values are from `base`, or the defaults. Raises SceneError with all problems; each begins with the name of the field.
    """
    values: dict[str, object] = dict(DEFAULTS if base is None else vars(base))
    values.pop("name", None)
    problems: list[str] = []
    table = _with_own_fields(table, base, problems)
    strength, own, lacks = read(table, base.strength if base else None, problems)
    known = [f.name for f in fields(Material) if f.name not in ("name", "strength")]
    every = [*known, *_OTHER_FIELDS, *own, "strength", "base"]
    foreign = [key for key in table if key not in every]
    problems += [f"{key[:40]!r}: unknown key{units.nearest(key, every)}; known: {', '.join(every)}" for key in foreign]
    rest = {key: value for key, value in table.items() if key in known}
    hint = ' (or name a material to start from: base = "Ni")'
    metal = library.read_record(Material, name, rest, _read, values | {"strength": strength}, hint, problems, lacks)
    if metal.T_m <= metal.T_ref:
        problems.append(f"T_m ({metal.T_m:g} K) must be above T_ref ({metal.T_ref:g} K)")
    if strength.numbers.get("C_high", 0.0) > 0.0 and strength["eps_dot_high"] < strength["eps_dot_0"]:
        high, low = strength["eps_dot_high"], strength["eps_dot_0"]
        why = "the metal would soften with the rate"
        problems.append(f"eps_dot_high ({high:g} 1/s) must not be below eps_dot_0 ({low:g} 1/s): {why}")
    if metal.taylor_alpha and metal.burgers is None:
        problems.append("taylor_alpha needs the Burgers vector: give also burgers")
    if metal.is_ceramic and metal.tensile_limit is None and "tensile_limit" not in table:
        problems.append(
            'tensile_limit: missing: a ceramic needs the tensile stress at which it breaks, as in tensile_limit = "260 MPa"'
        )
    if not metal.is_ceramic and "tensile_limit" not in table:
        metal = replace(metal, tensile_limit=None)
    if metal.tensile_limit is not None and not metal.is_ceramic:
        problems.append('tensile_limit has no effect on a metal: leave it out, or give kind = "ceramic"')
    if metal.nu < 0:
        problems.append(f"G, c0 and rho give Poisson's ratio {metal.nu:.2f}; it must be 0 or more")
    if not problems and not metal.flow_stress(0.0, 0.0, metal.T_ref) > 0.0:
        law = LAWS[strength.law].parameters
        problems.append(f"{', '.join(law)} give no positive yield stress at {metal.T_ref:g} K")
    library.refuse(problems, name)
    return metal


def _with_own_fields(table: Mapping[str, object], base: Material | None, problems: list[str]) -> dict[str, object]:
    """The table with rho instead of density, and with G and c0 = sqrt(K / rho) instead of E and nu. problems: list to which problems
    are added."""
    own = {"rho" if key == "density" else key: value for key, value in table.items()}
    given: dict[str, float] = {}
    for key in [key for key in ("E", "nu") if key in own]:
        try:
            given[key] = library.read_number(own.pop(key), *_OTHER_FIELDS[key][:3])
        except ValueError as error:
            problems.append(f"{key} {error}")
    for name, others in (("rho", ["density"]), ("G", ["E", "nu"]), ("c0", ["E", "nu"])):
        if name in table and (said := [key for key in others if key in table]):
            problems.append(f"{name} follows from {' and '.join(said)}: give only one of them")
    if given:
        values = ({"E": base.E, "nu": base.nu} if base is not None else {}) | given
        if lacks := {"E", "nu"} - values.keys():
            problems.append(f"{', '.join(given)} needs {', '.join(lacks)}, too")
            return own
        E, nu = values["E"], values["nu"]
        try:
            rho = library.read_number(own.get("rho", base and f"{base.rho!r} kg/m^3"), *LIMITS["rho"][:3])
        except ValueError:  # reported with the other fields
            rho = 1e3
        own["G"] = f"{E / (2.0 * (1.0 + nu))!r} Pa"
        own["c0"] = f"{math.sqrt(E / (3.0 * (1.0 - 2.0 * nu) * rho))!r} m/s"
    return own


def from_scene(
    tables: Mapping[str, Mapping[str, object]], strength: str = "", used: AbstractSet[str] = frozenset()
) -> tuple[dict[str, Material], list[str]]:
    """The materials of the library and of a scene, by name and alias.

    tables: the scene's [materials.NAME] tables. A table with `base = "Ni"`, or with the name of a material of the library, starts from
    this material, also for its other names; its key `strength` is the set or law to start from. strength: set or law of the metals in
    `used` whose tables name none. Returns (materials by name, problems).
    """
    known, problems = _library() | _aliases(), []
    catalogue = {name: found.material for name, found in known.items()}
    for name, table in {**{name: {} for name in used if strength and name in known}, **tables}.items():
        where = f"materials.{name[:40]!r}" if not library.SAFE_NAME.fullmatch(name) else f"materials.{name}"
        base_name = table.get("base", name if name in known else None)
        if base_name is not None and (not isinstance(base_name, str) or base_name not in known):
            problems.append(f"{where}.base: {unknown(str(base_name)[:40], catalogue)}")
            continue
        # the table of a metal's own name counts for its other names, too
        is_own = name in known and known[name].material.name == name
        others = [other for other in known if is_own and known[other] is known[name] and other not in tables]
        is_used = name in used or not used.isdisjoint(others)
        base, choice = None, table.get("strength", strength if is_used and "law" not in table else "")
        rest = {key: value for key, value in table.items() if key not in ("base", "strength")}
        try:
            if base_name is not None:
                base = known[base_name].with_set(str(choice)) if choice else known[base_name].material
            elif choice and "strength" in table:
                needs = 'needs a material of the library to start from, such as base = "Ni"'
                raise ValueError(f"{str(choice)[:40]!r}: {needs}")
            metal = from_table(name if name in tables or base is None else base.name, rest, base)
            if base is not None and rest and "source" not in rest:
                metal = replace(metal, source=f"{base.source}; changed in the scene: {', '.join(rest)}")
            catalogue |= dict.fromkeys((name, *others), metal)
        except SceneError as error:
            problems += [f"{where}: {problem}" for problem in error.problems]
        except ValueError as error:
            problems.append(f"{where}.strength = {error}" if "strength" in table else f"strength = {error}")
    return catalogue, problems


@cache
def _library() -> dict[str, Entry]:
    return library.load(__package__, "materials.toml", _entry)


@cache
def _aliases() -> dict[str, Entry]:
    return {
        name: found for found in _library().values() for alias in found.aliases for name in (alias, alias.capitalize())
    }


def _entry(name: str, table: Mapping[str, object]) -> Entry:
    rest = {key: value for key, value in table.items() if key not in ("aliases", "sets")}
    sets, aliases = table["sets"], table.get("aliases", [])
    assert isinstance(sets, Mapping)
    assert isinstance(aliases, list)
    first = next(iter(sets))
    # a set may change fields of the metal too, such as its melting point
    metal = from_table(name, rest | {key: value for key, value in sets[first].items() if key != "source"})
    strength = replace(metal.strength, set=first, source=str(sets[first]["source"]))
    return Entry(replace(metal, strength=strength), sets, tuple(aliases))


def _with_set(metal: Material, name: str, table: Mapping[str, object]) -> Material:
    if name == metal.strength.set:
        return metal
    other = from_table(metal.name, {key: value for key, value in table.items() if key != "source"}, metal)
    return replace(other, strength=replace(other.strength, set=name, source=str(table["source"])))


def _read(key: str, value: object) -> float | Pairs | str:
    if key in ("source", "note"):
        return library.read_text(value, _SAFE_TEXT, _SAFE_WORDS)
    if key == "kind":
        if value not in ("metal", "ceramic"):
            raise ValueError('must be "metal" or "ceramic"')
        return str(value)
    return (_pairs if LIMITS[key].varies else library.read_number)(value, *LIMITS[key][:3])


def _pairs(value: object, unit: str, low: float, high: float) -> Pairs:
    """A property that may depend on temperature, from one value or two pairs [temperature, value]."""
    if isinstance(value, str):
        return ((300.0, library.read_number(value, unit, low, high)),)
    example = f'"... {unit}", or [["300 K", "... {unit}"], ["1073 K", "... {unit}"]]'
    if not isinstance(value, list) or [len(p) if isinstance(p, list) else 0 for p in value] != [2, 2]:
        raise ValueError(f"must be one value or two pairs, {example}")
    first, second = (
        (library.read_number(T, "K", 1.0, 5000.0), library.read_number(v, unit, low, high)) for T, v in value
    )
    if first[0] >= second[0]:
        raise ValueError("must have the lower temperature first")
    return first, second


def _interpolate(pairs: Pairs, T: float) -> float:
    (T0, v0), (T1, v1) = pairs[0], pairs[-1]
    x = min(max((T - T0) / (T1 - T0), 0.0), 1.0) if T1 > T0 else 0.0
    return v0 + x * (v1 - v0)
