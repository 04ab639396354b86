"""Conversion of values with units: "25 um" in a file, 2.5e-5 m in the program.

A dimension is a name ("length"). It has one SI unit, which the program uses, and others for input. Conversion is exact to the last bit
("25 um" gives the float 2.5e-5), so that a scene that is written and read again is equal.
"""

import difflib
import math
import re
from fractions import Fraction
from functools import lru_cache

_MICRO_SIGNS = str.maketrans({"µ": "u", "μ": "u", "°": "deg"})
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,2})?)\s*(\S.*?)?\s*", re.ASCII)
_LONGEST = 60  # characters of a value, because exact arithmetic with longer numbers is slow

# dimension -> (an example for messages, {unit: factor to the SI unit}); the first unit of each is the SI one
_DIMENSIONS: dict[str, tuple[str, dict[str, str | float]]] = {
    "length": ("25 um", {"m": "1", "cm": "1e-2", "mm": "1e-3", "um": "1e-6", "nm": "1e-9"}),
    "velocity": ("500 m/s", {"m/s": "1", "km/s": "1e3", "mm/us": "1e3", "mm/s": "1e-3"}),
    "angle": ("30 deg", {"rad": "1", "deg": math.pi / 180}),
    "temperature": ("300 K", {"K": "1", "degC": "1", "C": "1"}),
    "time": ("60 ns", {"s": "1", "ms": "1e-3", "us": "1e-6", "ns": "1e-9", "ps": "1e-12", "min": "60", "h": "3600"}),
    "pressure": ("180 MPa", {"Pa": "1", "kPa": "1e3", "MPa": "1e6", "GPa": "1e9", "bar": "1e5", "HV": "9806650"}),
    "density": ("8906 kg/m^3", {"kg/m^3": "1", "kg/m3": "1", "g/cm^3": "1e3", "g/cm3": "1e3"}),
    "specific heat": ("456 J/(kg K)", {"J/(kg K)": "1", "J/kgK": "1", "J/kg/K": "1", "kJ/(kg K)": "1e3"}),
    "conductivity": ("91 W/(m K)", {"W/(m K)": "1", "W/mK": "1", "W/m/K": "1"}),
    "mass rate": ("30 g/min", {"kg/s": "1", "kg/h": "1/3600", "g/s": "1e-3", "g/min": "1/60000"}),
    "heat transfer": ("1e4 W/(m2 K)", {"W/(m2 K)": "1", "W/m2K": "1", "W/(m^2 K)": "1"}),
    "expansion": ("13e-6 1/K", {"1/K": "1"}),
    "rate": ("1 1/s", {"1/s": "1"}),
    "diffusivity": ("1e-4 m^2/s", {"m^2/s": "1", "m2/s": "1"}),
    "diffusivity of cores": ("1e-24 m^4/s", {"m^4/s": "1", "m4/s": "1"}),
    "activation energy": ("142 kJ/mol", {"J/mol": "1", "kJ/mol": "1e3"}),
    "surface energy": ("20 J/m2", {"J/m2": "1", "J/m^2": "1", "mJ/m2": "1e-3", "kJ/m2": "1e3"}),
}
_OFFSETS = dict.fromkeys(("degC", "C"), Fraction("273.15"))
_DIMENSION_OF = {unit: dimension for dimension, (_, units) in _DIMENSIONS.items() for unit in units}


class UnitError(ValueError):
    """A value without a unit, or with a wrong one. The message gives the expected dimension."""


def parse(value: object, dimension: str) -> float:
    """Read a quantity such as "25 um".

    value: text with a number and a unit; other values are refused. dimension: a name such as "length". Returns the value in the SI unit
    of the dimension (angles: radians, temperatures: kelvin). Raises UnitError with a message that continues "particle.diameter = 25: ".
    """
    example, units = _DIMENSIONS[dimension]
    wanted = f'{_named(dimension)} with its unit, such as "{example}"'
    if not isinstance(value, str):
        raise UnitError(f"needs {wanted}")
    match = _QUANTITY.fullmatch(value.translate(_MICRO_SIGNS)) if len(value) <= _LONGEST else None
    if match is None:
        raise UnitError(f"is not a number with a unit: needs {wanted}")
    number, unit = match.group(1), match.group(2)
    if unit is None:
        raise UnitError(f"has no unit: needs {wanted}")
    if unit not in units:
        other = _DIMENSION_OF.get(unit)
        wrong = f"is {_named(other)}" if other else f"has an unknown unit{nearest(unit, units)}"
        raise UnitError(f"{wrong}: needs {wanted}")
    return _in_si(number, unit, dimension)


@lru_cache(4096)  # each scene has the same hundreds of values of the material library
def _in_si(number: str, unit: str, dimension: str) -> float:
    return float(Fraction(number) * Fraction(_DIMENSIONS[dimension][1][unit]) + _OFFSETS.get(unit, 0))


def show(value: float, unit: str) -> str:
    """Write an SI value in a unit: show(2.5e-5, "um") gives "25 um". The text has only as many digits as are needed to read back the
    same float. If this is impossible in the given unit, the text has the SI unit."""
    dimension = _DIMENSION_OF[unit]
    exact = (Fraction(value) - _OFFSETS.get(unit, 0)) / Fraction(_DIMENSIONS[dimension][1][unit])
    for digits in range(1, 18):
        text = f"{_plain(float(exact), digits)} {unit}"
        if parse(text, dimension) == value:
            return text
    si = next(iter(_DIMENSIONS[dimension][1]))
    return f"{value!r} {si}"


def rounded(value: float, unit: str, digits: int = 3) -> str:
    """Write an SI value in a unit with the given number of significant digits: rounded(1.26936e-6, "um") gives "1.27 um"."""
    scale = Fraction(_DIMENSIONS[_DIMENSION_OF[unit]][1][unit])
    return f"{_plain(float((Fraction(value) - _OFFSETS.get(unit, 0)) / scale), digits)} {unit}"


def dimension_of(unit: str) -> str:
    """The dimension of a unit: dimension_of("um") gives "length"."""
    return _DIMENSION_OF[unit]


def pattern(dimension: str) -> str:
    """A regular expression for a number with a unit of a dimension, for JSON schemas."""
    written = (re.escape(unit).replace("u", "[uµμ]").replace("deg", "(deg|°)") for unit in _DIMENSIONS[dimension][1])
    known = "|".join(written)
    return rf"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*({known})\s*$"


def nearest(word: str, known: object) -> str:
    """A hint such as ' (did you mean "velocity"?)' if a known word is similar to `word`, else ""."""
    words = {str(k).lower(): str(k) for k in known}  # type: ignore[attr-defined]
    close = difflib.get_close_matches(word.lower()[:_LONGEST], list(words), n=1, cutoff=0.6)
    return f' (did you mean "{words[close[0]]}"?)' if close else ""


def _plain(value: float, digits: int) -> str:
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text  # 20 instead of 2e+01


def _named(dimension: str) -> str:
    return f"{'an' if dimension[0] in 'aeiou' else 'a'} {dimension}"
