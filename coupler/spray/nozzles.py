"""De Laval nozzles: their lengths and diameters, with where they come from and what of them is assumed.

The library is `nozzles.toml`; a scene or a file of one's own may add others in the same form.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from typing import Any

from .. import units
from ..errors import SceneError

_SAFE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}", re.ASCII)
_LONGEST_TEXT = 600
_TEXTS = ("source", "assumed")
_LIMITS = {  # m
    "inlet": (0.2e-3, 0.2),
    "throat": (0.1e-3, 0.05),
    "exit": (0.1e-3, 0.2),
    "converging": (0.1e-3, 1.0),
    "diverging": (0.1e-3, 2.0),
    "barrel": (0.0, 2.0),
    "chamber": (0.0, 2.0),
    "injection": (-3.0, 4.0),
}
_DEFAULTS: dict[str, object] = {"barrel": 0.0, "chamber": 0.0, "injection": None, "source": "", "assumed": ""}


@dataclass(frozen=True)
class Nozzle:
    """A nozzle of circular section, m. inlet, throat, exit: diameters, a cone between each and the next; converging,
    diverging: lengths of the cones; chamber: a straight part before them, barrel: one behind. injection: where the powder is
    fed, from the throat (upstream negative); None: at the very start. assumed: what of this is not known."""

    name: str
    inlet: float
    throat: float
    exit: float
    converging: float
    diverging: float
    barrel: float
    chamber: float
    injection: float | None
    source: str
    assumed: str

    @property
    def end(self) -> float:
        """Position of the exit, m from the throat."""
        return self.diverging + self.barrel

    @property
    def feed(self) -> float:
        """Position where the powder is fed, m from the throat."""
        return -self.converging - self.chamber if self.injection is None else self.injection

    @property
    def corners(self) -> tuple[float, ...]:
        """Positions where one part ends, m from the throat, in order; the last is the exit."""
        return (-self.converging, 0.0, self.diverging) + ((self.end,) if self.barrel else ())

    def area_ratio(self, x: float) -> float:
        """Area at x (m from the throat) over that of the throat."""
        if x < 0:
            d = self.throat + min(-x / self.converging, 1.0) * (self.inlet - self.throat)
        else:
            d = self.throat + min(x / self.diverging, 1.0) * (self.exit - self.throat)
        return (d / self.throat) ** 2


def library() -> dict[str, Nozzle]:
    """The nozzles that come with the program, by name."""
    return dict(_library())


def unknown(name: str, known: Mapping[str, object]) -> str:
    """The message for a nozzle that is not there. known: nozzles by name."""
    return f"unknown nozzle{units.nearest(name, known)}; known: {', '.join(known)}"


def from_tables(tables: Mapping[str, object]) -> tuple[dict[str, Nozzle], list[str]]:
    """The library with the nozzles of [nozzles.NAME] tables added. Returns (nozzles by name, problems)."""
    known, problems = library(), []
    for name, table in tables.items():
        try:
            known[name] = from_table(name, table)
        except SceneError as error:
            problems += [f"nozzles.{name[:40]}: {problem}" for problem in error.problems]
    return known, problems


def from_table(name: str, table: object) -> Nozzle:
    """Make a nozzle from lengths with units. Raises SceneError with every problem, each beginning with the field at fault."""
    if not isinstance(table, Mapping):
        raise SceneError(["expected a table of lengths"], name)
    problems: list[str] = []
    values: dict[str, Any] = dict(_DEFAULTS)
    if not _SAFE_NAME.fullmatch(name):
        problems.append("the name of a nozzle is made of letters, digits, '_', '.' and '-' (at most 40)")
    wanted = [f.name for f in fields(Nozzle) if f.name != "name"]
    for key, value in table.items():
        if key not in wanted:
            problems.append(f"{key[:40]}: unknown key{units.nearest(key, wanted)}; known: {', '.join(wanted)}")
            continue
        try:
            values[key] = _text(value) if key in _TEXTS else _length(value, *_LIMITS[key])
        except ValueError as error:
            problems.append(f"{key} {error}")
    missing = [key for key in wanted if key not in values and key not in table]
    if missing:
        problems.append(f"missing: {', '.join(missing)}")
    if problems:
        raise SceneError(problems, name)
    made = Nozzle(name=name, **values)
    for key in ("inlet", "exit"):
        if getattr(made, key) <= made.throat:
            problems.append(f"{key} = {units.show(getattr(made, key), 'mm')}: must be wider than the throat")
    if made.injection is not None and not -made.converging - made.chamber <= made.injection < made.end:
        problems.append(f"injection = {units.show(made.injection, 'mm')}: lies outside the nozzle")
    if problems:
        raise SceneError(problems, name)
    return made


@cache
def _library() -> dict[str, Nozzle]:
    text = files(__package__).joinpath("nozzles.toml").read_text(encoding="utf-8")
    return {name: from_table(name, table) for name, table in tomllib.loads(text).items()}


def _text(value: object) -> str:
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT or not value.isprintable():
        raise ValueError(f"must be plain text of at most {_LONGEST_TEXT} characters")
    return value


def _length(value: object, low: float, high: float) -> float:
    number = units.parse(value, "length")
    if not low <= number <= high:
        raise ValueError(f"is outside {units.rounded(low, 'mm')} to {units.rounded(high, 'mm')}")
    return number
