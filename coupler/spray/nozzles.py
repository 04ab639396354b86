"""De Laval nozzles: lengths and diameters, their sources, and a list of assumed values.

The library is `nozzles.toml`; a scene or a file of the user may add nozzles in the same form.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from .. import units
from ..errors import SceneError
from ..physics import library as records

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
    """A nozzle of circular section, lengths in m. inlet, throat, exit: diameters; converging, diverging: lengths of the cones between
    them; chamber, barrel: lengths of the cylinders before and behind the cones. injection: position of the powder feed from the throat
    (upstream negative), None: at the inlet of the chamber. assumed: text about the values that are assumed."""

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
        """Position of the powder feed, m from the throat."""
        return -self.converging - self.chamber if self.injection is None else self.injection

    @property
    def corners(self) -> tuple[float, ...]:
        """Positions of the ends of the nozzle's parts, m from the throat, in order. The last is the exit."""
        return (-self.converging, 0.0, self.diverging) + ((self.end,) if self.barrel else ())

    def area_ratio(self, x: float) -> float:
        """Ratio of the flow area at x (m from the throat) to the area of the throat."""
        if x < 0:
            d = self.throat + min(-x / self.converging, 1.0) * (self.inlet - self.throat)
        else:
            d = self.throat + min(x / self.diverging, 1.0) * (self.exit - self.throat)
        return (d / self.throat) ** 2


@cache
def library() -> dict[str, Nozzle]:
    """The nozzles of the library, by name. Read only."""
    return records.load(__package__, "nozzles.toml", from_table)


def unknown(name: str, known: Mapping[str, object]) -> str:
    """The message for an unknown nozzle. known: nozzles by name."""
    return f"unknown nozzle{units.nearest(name, known)}; known: {', '.join(known)}"


def from_tables(tables: Mapping[str, Mapping[str, object]]) -> tuple[dict[str, Nozzle], list[str]]:
    """The nozzles of the library and of [nozzles.NAME] tables. Returns (nozzles by name, problems)."""
    known, problems = dict(library()), []
    for name, table in tables.items():
        try:
            known[name] = from_table(name, table)
        except SceneError as error:
            problems += [f"nozzles.{name[:40]}: {problem}" for problem in error.problems]
    return known, problems


def from_table(name: str, table: Mapping[str, object]) -> Nozzle:
    """A nozzle from lengths with units. Raises SceneError with all problems; each begins with the name of the field."""
    nozzle = records.read_record(Nozzle, name, table, _read, _DEFAULTS)
    problems = []
    for key, width in {"inlet": nozzle.inlet, "exit": nozzle.exit}.items():
        if width <= nozzle.throat:
            problems.append(f"{key} = {units.show(width, 'mm')}: must be wider than the throat")
    inlet, room = (
        -nozzle.converging - nozzle.chamber,
        1e-9 * (nozzle.converging + nozzle.chamber + nozzle.end),
    )  # for rounding
    if nozzle.injection is not None and not inlet - room <= nozzle.injection < nozzle.end - room:
        problems.append(f"injection = {units.show(nozzle.injection, 'mm')}: lies outside the nozzle")
    records.refuse(problems, name)
    return nozzle


def _read(key: str, value: object) -> float | str:
    return records.read_number(value, "mm", *_LIMITS[key]) if key in _LIMITS else records.read_text(value)
