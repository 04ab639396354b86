"""What the [coating] table of a scene does: it becomes a list of particles, drawn from its seed, the same on every machine."""

import glob
import math
import random
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from statistics import NormalDist

from .. import units
from ..scene.tables import Coating, read_table

_STAND_IN = {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"}  # while the table itself is at fault
_CANDIDATES = 20  # places of which an "even" layer takes the one farthest from those it has
_CUT = 2.0  # standard deviations of the velocity
_BROADER = 3.0  # standard deviations of the logarithm, where smallest or largest are not given


def expand(raw: dict[str, object], folder: Path) -> list[str]:
    """Put the particles of a table [coating] into a scene that has no particles. Returns the problems of having both. raw: the scene as
    nested dicts, changed in place. A scene that was written out holds both: its particles are taken as they are. The table's own
    problems are reported by the scene's check; until then a particle stands in for those it would make."""
    table, _ = read_table(Coating, raw["coating"])
    if table is None:
        raw.setdefault("particle", [dict(_STAND_IN)])
        return []
    there = raw.get("particle")
    if there is None:
        problems = []
        files = sorted(map(Path, glob.glob(str(folder / table.files), recursive=True))) if table.files else []
        if table.files and not files:
            problems = [f'coating.files = "{table.files[:60]}": no file in {folder} has such a name']
        elif table.velocity is None and "gas" not in raw:
            problems = ['coating.velocity: missing; add for example velocity = "600 m/s", or a table [gas]']
        stand_in: dict[str, str | list[str]] = {"velocity": _STAND_IN["velocity"]} if problems else {}
        raw["particle"] = [stand_in | particle for particle in particles(table, files)]
        return problems
    if not isinstance(there, list) or len(there) != table.number:
        return ["coating: the scene has particles of its own too; take out the table [coating], or those"]
    return []


def particles(table: Coating, files: Sequence[Path] = ()) -> list[dict[str, str | list[str]]]:
    """The particles of a coating as a scene writes them, in the order of their impacts, a layer after the other.

    Only `random.Random.random` is drawn from, which Python keeps the same in all versions; quantities are written with so many
    digits as they are to be read with. Velocity and temperature are left out where the table has none. files: with shapes, in place
    of those of the table.
    """
    dice = random.Random(table.seed)
    places: list[tuple[float, float]] = []
    drawn = []
    for i in range(table.number):
        if i % (table.number // table.layers) == 0:
            places = []  # of this layer
        places.append(_place(table, dice, places))
        x, y = places[-1]
        diameter = _diameter(table, dice.random())
        off = _cut_normal(dice.random())
        u, tilt = dice.random(), 180.0 * dice.random() - 90.0
        shape = "file" if files else _shape(table, u)
        particle: dict[str, str | list[str]] = {
            "material": table.material, "shape": shape, "diameter": f"{diameter * 1e6:.2f} um",
            "offset": [f"{x * 1e6:.2f} um", f"{y * 1e6:.2f} um"],
        }  # fmt: skip
        if files:
            particle["file"] = str(files[int(u * len(files))].absolute())
        if shape != "sphere":
            particle["tilt"] = f"{tilt:.1f} deg"
        if table.velocity is not None:
            particle["velocity"] = f"{by_size(table.velocity, diameter) + table.velocity_spread * off:.1f} m/s"
        if table.temperature is not None:
            particle["temperature"] = f"{by_size(table.temperature, diameter):.1f} K"
        if table.dwell is not None:
            particle["dwell"] = units.show(table.dwell, "us")
        if table.hardness is not None:
            particle["hardness"] = units.show(table.hardness, "HV")
        if table.yield_strength is not None:
            particle["yield_strength"] = units.show(table.yield_strength, "MPa")
        drawn.append(particle)
    return drawn


def by_size(pairs: tuple[tuple[float, float], ...], diameter: float) -> float:
    """Linear between pairs (diameter m, value), constant beyond the first and the last."""
    for (low, at_low), (high, at_high) in pairwise(pairs):
        if low <= diameter <= high:
            return at_low + (at_high - at_low) * (diameter - low) / (high - low)
    return pairs[0][1] if diameter <= pairs[0][0] else pairs[-1][1]


def _place(table: Coating, dice: random.Random, places: list[tuple[float, float]]) -> tuple[float, float]:
    """Somewhere on the disc, uniform in area (m); for "even" layers the best of some candidates (Mitchell 1991)."""

    def anywhere() -> tuple[float, float]:
        r, phi = table.radius * math.sqrt(dice.random()), 2.0 * math.pi * dice.random()
        return r * math.cos(phi), r * math.sin(phi)

    if table.positions == "random" or not places:
        return anywhere()
    return max((anywhere() for _ in range(_CANDIDATES)), key=lambda p: min(math.dist(p, q) for q in places))


def _diameter(table: Coating, u: float) -> float:
    """The u-quantile (0 to 1) of the cut log-normal distribution of diameters, m."""
    sigma = math.log(table.spread)
    if sigma == 0.0:
        return table.diameter
    normal = NormalDist(math.log(table.diameter), sigma)
    low = normal.cdf(math.log(table.smallest)) if table.smallest else NormalDist().cdf(-_BROADER)
    high = normal.cdf(math.log(table.largest)) if table.largest else NormalDist().cdf(_BROADER)
    return math.exp(normal.inv_cdf(min(max(low + u * (high - low), 1e-12), 1.0 - 1e-12)))


def _cut_normal(u: float) -> float:
    """The u-quantile of a normal distribution of deviation 1 cut at `_CUT`."""
    low = NormalDist().cdf(-_CUT)
    return NormalDist().inv_cdf(low + u * (1.0 - 2.0 * low))


def _shape(table: Coating, u: float) -> str:
    """The shape at the share u (0 to 1) of all, in the order of the table."""
    total = sum(table.shapes.values())
    for name, share in table.shapes.items():
        u -= share / total
        if u < 0.0:
            return name
    return next(name for name in reversed(table.shapes) if table.shapes[name] > 0)
