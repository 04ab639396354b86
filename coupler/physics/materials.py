"""Materials: the numbers of Johnson-Cook, the shock equation of state and heat, with their sources.

The library is `materials.toml`; a scene may add materials or change numbers of these, in the same form.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache

from ..errors import ColdsprayError, SceneError
from . import library

Pairs = tuple[tuple[float, float], tuple[float, float]]

_SAFE_TEXT = re.compile(r"[A-Za-z0-9_.,:;/()=&+ -]{0,400}", re.ASCII)

# field -> (unit, or "" for a plain number; smallest; largest), in SI: wide enough for any metal
_LIMITS: dict[str, tuple[str, float, float]] = {
    "rho": ("kg/m^3", 500.0, 25e3),
    "G": ("GPa", 1e8, 1e12),
    "c0": ("m/s", 100.0, 2e4),
    "s": ("", 0.0, 5.0),
    "Gamma0": ("", 0.0, 5.0),
    "A": ("MPa", 1e5, 2e10),
    "B": ("MPa", 0.0, 1e11),
    "n": ("", 0.01, 2.0),
    "C": ("", 0.0, 1.0),
    "m": ("", 0.01, 10.0),
    "eps_dot_0": ("1/s", 1e-6, 1e6),
    "T_ref": ("K", 1.0, 2000.0),
    "T_m": ("K", 200.0, 5000.0),
    "taylor_quinney": ("", 0.0, 1.0),
    "thermal_expansion": ("1/K", 0.0, 1e-3),
    "sigma_TS": ("MPa", 1e6, 1e10),
}
_PAIR_LIMITS: dict[str, tuple[str, float, float]] = {
    "cp": ("J/(kg K)", 10.0, 1e4),
    "k": ("W/(m K)", 0.01, 5000.0),
}
_DEFAULTS: dict[str, float | str | None] = {
    "eps_dot_0": 1.0,
    "taylor_quinney": 0.9,
    "thermal_expansion": 0.0,
    "sigma_TS": None,
    "source": "",
    "note": "",
}


@dataclass(frozen=True)
class Material:
    """A metal: Johnson-Cook flow stress, shock equation of state, heat. SI units.

    rho kg/m^3; G, A, B Pa; c0 m/s; s, Gamma0, n, C, m, taylor_quinney without unit; eps_dot_0 1/s;
    T_ref, T_m K; cp ((T, J/(kg K)), (T, J/(kg K))), k ((T, W/(m K)), (T, W/(m K))): linear between the
    points, constant outside; thermal_expansion (linear) 1/K; sigma_TS Pa: tensile strength at 293 K, for critical velocities,
    None where it is not known.
    """

    name: str
    rho: float
    G: float
    c0: float
    s: float
    Gamma0: float
    A: float
    B: float
    n: float
    C: float
    m: float
    eps_dot_0: float
    T_ref: float
    T_m: float
    taylor_quinney: float
    cp: Pairs
    k: Pairs
    thermal_expansion: float
    sigma_TS: float | None
    source: str
    note: str

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
    def wave_speed(self) -> float:
        """Speed of longitudinal elastic waves, m/s: sqrt((K + 4/3 G) / rho)."""
        return math.sqrt((self.K + 4 / 3 * self.G) / self.rho)

    def cp_at(self, T: float) -> float:
        """Specific heat at T (K), J/(kg K)."""
        return _interpolate(self.cp, T)

    def k_at(self, T: float) -> float:
        """Conductivity at T (K), W/(m K)."""
        return _interpolate(self.k, T)

    def effusivity(self, T: float) -> float:
        """sqrt(k rho c_p) at T (K), W s^(1/2)/(m^2 K): half-spaces in contact share heat in proportion to it."""
        return math.sqrt(self.k_at(T) * self.rho * self.cp_at(T))


def names() -> list[str]:
    """The materials of the library."""
    return list(_library())


def material(name: str) -> Material:
    """A material of the library. Raises ColdsprayError, which offers the nearest name, for any other."""
    if name not in _library():
        raise ColdsprayError(unknown(name, _library()))
    return _library()[name]


def unknown(name: str, known: Mapping[str, object]) -> str:
    """The message for a material that is not there. known: materials by name."""
    return library.unknown("material", name, known)


def from_table(name: str, table: Mapping[str, object], base: Material | None = None) -> Material:
    """Make a material from a table of numbers and texts with units.

    table: fields of Material as in materials.toml; what it lacks is from `base`, else the defaults.
    Raises SceneError with all problems, each beginning with the field at fault.
    """
    values = _DEFAULTS if base is None else {f.name: getattr(base, f.name) for f in fields(base) if f.name != "name"}
    hint = ' (or name a material to start from: base = "Ni")'
    metal = library.read_record(Material, name, table, _read, values, hint)
    problems = []
    if metal.T_m <= metal.T_ref:
        problems.append(f"T_m ({metal.T_m:g} K) must be above T_ref ({metal.T_ref:g} K)")
    if metal.nu < 0:
        problems.append(f"G, c0 and rho give Poisson's ratio {metal.nu:.2f}; it must be 0 or more")
    library.refuse(problems, name)
    return metal


def from_scene(tables: Mapping[str, Mapping[str, object]]) -> tuple[dict[str, Material], list[str]]:
    """The library with the materials of a scene added or changed.

    tables: the scene's [materials.NAME] tables; `base = "Ni"` starts from a material of the library,
    and a table that has the name of one starts from that. Returns (materials by name, problems).
    """
    catalogue, problems = dict(_library()), []
    for name, table in tables.items():
        where = f"materials.{name[:40]!r}" if not library.SAFE_NAME.fullmatch(name) else f"materials.{name}"
        base_name = table.get("base", name if name in _library() else None)
        if base_name is not None and (not isinstance(base_name, str) or base_name not in _library()):
            problems.append(f"{where}.base: {unknown(str(base_name)[:40], _library())}")
            continue
        base = _library()[base_name] if base_name is not None else None
        rest = {key: value for key, value in table.items() if key != "base"}
        try:
            metal = from_table(name, rest, base)
            if base is not None and rest and "source" not in rest:
                metal = replace(metal, source=f"{base.source}; changed in the scene: {', '.join(rest)}")
            catalogue[name] = metal
        except SceneError as error:
            problems += [f"{where}: {problem}" for problem in error.problems]
    return catalogue, problems


@cache
def _library() -> dict[str, Material]:
    return library.load(__package__, "materials.toml", from_table)


def _read(key: str, value: object) -> float | Pairs | str:
    if key in ("source", "note"):
        return library.read_text(value, _SAFE_TEXT)
    if key in _PAIR_LIMITS:
        return _pairs(value, *_PAIR_LIMITS[key])
    return library.read_number(value, *_LIMITS[key])


def _pairs(value: object, unit: str, low: float, high: float) -> Pairs:
    example = f'[["300 K", "... {unit}"], ["1073 K", "... {unit}"]]'
    if not isinstance(value, list) or [len(p) if isinstance(p, list) else 0 for p in value] != [2, 2]:
        raise ValueError(f"must be two pairs, {example}")
    (T0, v0), (T1, v1) = value
    first = (library.read_number(T0, "K", 1.0, 5000.0), library.read_number(v0, unit, low, high))
    second = (library.read_number(T1, "K", 1.0, 5000.0), library.read_number(v1, unit, low, high))
    if first[0] >= second[0]:
        raise ValueError("must have the lower temperature first")
    return first, second


def _interpolate(pairs: Pairs, T: float) -> float:
    (T0, v0), (T1, v1) = pairs
    x = min(max((T - T0) / (T1 - T0), 0.0), 1.0)
    return v0 + x * (v1 - v0)
