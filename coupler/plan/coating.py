"""Random particles from the table [coating] of a scene. A seed gives the same list of particles on all machines."""

import glob
import math
import os
import random
from bisect import bisect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, islice
from pathlib import Path
from statistics import NormalDist

import numpy as np

from .. import units
from ..physics.materials import Material, mixed, unknown
from ..physics.shapes import sphere_volume
from ..scene.coating import MOST_PARTICLES, Coating, PowderTable
from ..scene.spray import Spray
from ..scene.values import read_table
from .passes import arrivals, divided
from .powder import sizes_of

STAND_IN = {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"}  # a valid particle if the table has errors
_CANDIDATES = 20  # random positions; an "even" layer uses the one farthest from its other positions
_TRUNCATED = 2.0  # greatest deviation of the velocity from its mean, in standard deviations
_BROADER = 3.0  # default limits of the diameter, in standard deviations of the logarithm
_MIDDLE = 0.05, 0.95  # cumulative mass fractions of the smallest and largest particles, with sizes by mass
_CLASSES = 200  # of equal mass or number


@dataclass(frozen=True)
class Fed:
    """A powder from which particles are drawn. rho: density, kg/m3; files: files with shapes; by_number: ascending diameters (m), and
    the fraction of the number of particles below each; None if the table has no sizes by mass."""

    table: PowderTable
    rho: float = 1.0
    files: Sequence[Path] = ()
    by_number: tuple[np.ndarray, np.ndarray] | None = None

    def diameter(self, u: float) -> float:
        """Quantile u (0 to 1) of the diameter by number, m. The distribution is cut off at the limits of the diameter."""
        t = self.table
        if self.by_number is not None:
            return float(np.interp(u, *reversed(self.by_number)))
        assert t.diameter is not None
        sigma = math.log(t.spread)
        if sigma == 0.0:
            return t.diameter
        normal = NormalDist(math.log(t.diameter), sigma)
        low = normal.cdf(math.log(t.smallest)) if t.smallest else NormalDist().cdf(-_BROADER)
        high = normal.cdf(math.log(t.largest)) if t.largest else NormalDist().cdf(_BROADER)
        return math.exp(normal.inv_cdf(min(max(low + u * (high - low), 1e-12), 1.0 - 1e-12)))

    @property
    def mass(self) -> float:
        """Mean mass of a particle of this powder, kg."""
        middles = (np.arange(_CLASSES) + 0.5) / _CLASSES
        return self.rho * math.fsum(sphere_volume(self.diameter(u)) for u in middles) / _CLASSES


def expand(raw: dict[str, object], folder: Path, catalogue: Mapping[str, Material]) -> list[str]:
    """Add the random particles of the table [coating] to a scene. raw: the scene as nested dicts, changed in place; folder: folder to
    which file names are relative; catalogue: metals by name. Particles that the scene already has do not change: the scene.toml of a
    run has the table and its particles. Returns the problems, except errors in the table, which the check of the scene reports. If no
    particles can be drawn, a valid one is added for this check."""
    table, _ = read_table(Coating, raw["coating"])
    if table is None:
        raw.setdefault("particle", [dict(STAND_IN)])
        return []
    if (there := raw.get("particle")) is not None:
        fits = len(there if isinstance(there, list) else [there]) == table.number
        return [] if fits else ["coating: the scene has both [coating] and particles: remove one of them"]
    fed, problems = list[Fed](), list[str]()
    for i, powder in enumerate(table.powders, 1):
        try:
            if powder.velocity is None and "gas" not in raw:
                raise ValueError('velocity: missing; add for example velocity = "600 m/s", or a table [gas]')
            if powder.velocity is None and powder.velocity_spread > 0.0:
                raise ValueError("velocity_spread: has no effect on velocities from [gas]: remove it, or give velocity")
            fed.append(_fed(powder, folder, catalogue))
        except ValueError as error:
            problems.append(f"coating.powder[{i}].{error}" if table.powder else f"coating.{error}")
    spray = read_table(Spray, raw.get("spray", {}))[0] or Spray()  # the check of the scene reports its errors
    try:
        passes = arrivals(spray, table, folder)
    except ValueError as error:
        problems.append(f"spray.{error}")
    try:
        raw["particle"] = particles(table, fed, *passes, spray.angle) if not problems else [dict(STAND_IN)]
    except ValueError as error:
        raw["particle"] = [dict(STAND_IN)]
        problems.append(f"coating.{error}")
    return problems


def _fed(powder: PowderTable, folder: Path, catalogue: Mapping[str, Material]) -> Fed:
    """A powder with its files. folder: folder to which their names are relative. Raises ValueError; the message begins with the name
    of the field."""
    pattern = str(folder / os.path.expanduser(powder.files or ""))
    files = sorted(map(Path, glob.glob(pattern, recursive=True))) if powder.files else []
    named = {"material": powder.material} | ({"core.material": powder.core.material} if powder.core else {})
    for key, name in named.items():
        if name not in catalogue:
            raise ValueError(f'{key} = "{name[:40]}": {unknown(name[:40], catalogue)}')
    if powder.files and not files:
        raise ValueError(f'files = "{powder.files[:60]}": no file in {folder} matches this pattern')
    shell, rho = catalogue[powder.material], catalogue[powder.material].rho
    if powder.core is not None:
        core = catalogue[powder.core.material]
        rho = mixed(shell, core, powder.core.share_by_volume(1.0, shell.rho, core.rho)).rho
    if powder.sizes is None:
        return Fed(powder, rho, files)
    try:
        sizes = sizes_of(powder.sizes, folder)
    except ValueError as error:
        raise ValueError(f"sizes: {error}") from None
    share = np.linspace(*_MIDDLE, _CLASSES)
    D = np.array([sizes.diameter(u) for u in share])
    D = D[(D >= (powder.smallest or 0.0)) & (D <= (powder.largest or math.inf))]
    if len(D) < 2:
        raise ValueError("smallest, largest: the powder has no particles between these limits: give wider limits")
    number = np.concatenate([[0.0], np.cumsum((0.5 * (D[:-1] + D[1:])) ** -3.0)])  # each class has the same mass
    return Fed(powder, rho, files, (D, number / number[-1]))


def _counts(table: Coating, fed: Sequence[Fed]) -> list[int]:
    """Number of particles of each powder, for the mass fractions of the table. Raises ValueError if a powder has no particle."""
    shares = [powder.share for powder in table.powder] if table.powder else [1.0]
    each = np.array([share / powder.mass for share, powder in zip(shares, fed, strict=True)])
    counts = divided(table.number, each)
    if not counts.all():
        more = range(table.number + table.layers, MOST_PARTICLES + 1, table.layers)
        enough = next((n for n in more if divided(n, each).all()), None)
        give = "a larger share" if enough is None else f"{enough} particles"
        which = f"powder[{int(np.argmin(counts)) + 1}]"
        raise ValueError(f"number = {table.number}: {which} has no particle, because its share is small: give {give}")
    return counts.tolist()


def particles(
    table: Coating, fed: Sequence[Fed], passes: Sequence[int], dwells: Sequence[float | None], angle: float = 0.0
) -> list[dict[str, object]]:
    """The particles of a coating as tables of a scene, in the order of their impacts, layer by layer.

    All random numbers are from `random.Random.random`, which is equal in all versions of Python. Diameter, position, velocity,
    temperature and tilt are rounded. Velocity and temperature are omitted if the table has none. fed: the powders of the table; passes,
    dwells: as in `passes.arrivals`; angle (rad): angle of the gun. Raises ValueError if a powder has no particle.
    """
    dice = random.Random(table.seed)
    counts = _counts(table, fed)
    order = [k for k, count in enumerate(counts) for _ in range(count)]
    if len(fed) > 1:
        order = [k for _, k in sorted((dice.random(), k) for k in order)]
    drawn, left = [], iter(zip(order, dwells, strict=True))
    for count in [*passes] * table.layers:
        places: list[tuple[float, float]] = []  # of this pass
        for k, dwell in islice(left, count):
            places.append(_place(table, dice, places))
            drawn.append(_drawn(fed[k], places[-1], dwell, angle, dice))
    return drawn


def _drawn(
    fed: Fed, place: tuple[float, float], dwell: float | None, angle: float, dice: random.Random
) -> dict[str, object]:
    """A random particle, a table of a scene. place: its centre (x, y), m; dwell (s) until the next impact; angle (rad) of the gun."""
    table, (x, y) = fed.table, place
    diameter = fed.diameter(dice.random())
    low = NormalDist().cdf(-_TRUNCATED)
    off = NormalDist().inv_cdf(low + dice.random() * (1.0 - 2.0 * low))
    u, tilt = dice.random(), 180.0 * dice.random() - 90.0
    names = [name for name, share in table.shapes.items() if share > 0]
    ends = [*accumulate(table.shapes[name] for name in names)]
    shape = "file" if fed.files else names[min(bisect(ends, u * ends[-1]), len(names) - 1)]

    def at_size(pairs: Sequence[tuple[float, float]]) -> float:  # (diameter m, value)
        return float(np.interp(diameter, *np.array(pairs).T))

    velocity, temperature, pored = table.velocity, table.temperature, table.pore_diameter is not None
    values = {
        "material": table.material, "shape": shape, "diameter": f"{diameter * 1e6:.2f} um",
        "offset": [f"{x * 1e6:.2f} um", f"{y * 1e6:.2f} um"],
        "file": str(fed.files[int(u * len(fed.files))].absolute()) if fed.files else None,
        "tilt": f"{tilt:.1f} deg" if shape != "sphere" else None,
        "velocity": velocity and f"{at_size(velocity) + table.velocity_spread * off:.1f} m/s",
        "temperature": temperature and f"{at_size(temperature):.1f} K",
        "hardness": table.hardness and units.show(table.hardness, "HV"),
        "yield_strength": table.yield_strength and units.show(table.yield_strength, "MPa"),
        "porosity": table.porosity if pored else None,
        "pore_diameter": table.pore_diameter and units.show(table.pore_diameter, "um"),
        "pore_seed": int(2**31 * dice.random()) if pored else None,
        "core": table.core and {"material": table.core.material, "share": table.core.share},
        "dwell": units.show(dwell, "us") if dwell is not None else None,
        "angle": units.show(angle, "deg") if angle else None,
    }  # fmt: skip
    return {key: value for key, value in values.items() if value is not None}


def _place(table: Coating, dice: random.Random, places: list[tuple[float, float]]) -> tuple[float, float]:
    """A random position (m) on the disc of the coating, uniform in area. With "even", several positions are drawn, and the one with
    the largest distance from the nearest of `places` is used (Mitchell 1991). places: the earlier positions of the pass."""

    def anywhere() -> tuple[float, float]:
        r, phi = table.radius * math.sqrt(dice.random()), 2.0 * math.pi * dice.random()
        return r * math.cos(phi), r * math.sin(phi)

    if table.positions == "random" or not places:
        return anywhere()
    return max((anywhere() for _ in range(_CANDIDATES)), key=lambda p: min(math.dist(p, q) for q in places))
