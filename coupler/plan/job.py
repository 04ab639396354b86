"""The computations of a job: the scenes of its impacts and coatings; their number and resolution follow from the given time."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from .. import units
from ..errors import ColdsprayError, SceneError
from ..files.inputs import SCENE_LIMIT, read_text, toml_of
from ..physics import materials
from ..physics.materials import Material
from ..scene.job import JobData
from ..scene.messages import in_words
from ..scene.tables import read_table
from ..spray import nozzles
from ..spray.gas import Flow
from ..spray.sizes import Sizes
from ..spray.window import Spray, spray
from . import cost
from . import gas as scene_gas
from .forecast import forecast
from .own import with_library
from .planning import plan
from .powder import sizes_of
from .reading import Scene

ROOM = 1.1 * cost.LEAST_POINTS  # points of the smallest particle of a coating
BRACKET = 3  # velocities that a search computes before the first bisection
RATIO = 0.22  # width of the bracket over its middle before the first bisection
START = 4.0  # processor time of the start of a run and of its pictures, s
PARALLEL = 0.8  # efficiency of several threads and of runs of unequal length
WITHIN = 0.4, 1.4  # range of the search for a critical velocity over the velocity of the median particle


@dataclass(frozen=True)
class Choice:
    """Extent of the computations of a job. The searches for critical velocities have numbers of points, where 0 means no search.
    bonds: points of the main search; coarser: points of the search that measures the resolution error; sets: points of the searches
    with the other strength sets of the powder. placements: impacts at each velocity; tolerance: width of the bracket divided by its
    middle. Coatings: points: points of the largest particle; disc: radius of the disc of the particle centres, in median diameters;
    layers; seeds: number of coatings."""

    bonds: int
    placements: int
    tolerance: float
    coarser: int
    sets: int
    points: int
    disc: float
    layers: int
    seeds: int

    @property
    def words(self) -> str:
        """The choice as text."""
        bonds = f"bonds with {self.bonds} points, {self.placements} at each velocity, bracket of {self.tolerance:.0%}"
        texts = [bonds if self.bonds else "no bonds"] + ["with the error of the resolution"] * (self.coarser > 0)
        texts += ["with the other strength sets"] * (self.sets > 0)
        return f"{', '.join(texts)}; coatings: {self.seeds} of {self.number} particles with {self.points} points"

    @property
    def number(self) -> int:
        """Number of particles of a coating: in each layer 7.4 times the square of the radius `disc`."""
        return self.layers * round(7.4 * self.disc**2)


CHOICES = (
    Choice(0, 1, 0.1, 0, 0, 400, 0.7, 1, 1),
    Choice(0, 1, 0.1, 0, 0, 1000, 0.9, 2, 2),
    Choice(5000, 1, 0.1, 0, 0, 1000, 0.9, 2, 2),
    Choice(5000, 1, 0.05, 0, 5000, 1000, 0.9, 2, 3),
    Choice(16000, 1, 0.1, 5000, 5000, 1000, 0.9, 2, 3),
    Choice(16000, 1, 0.05, 5000, 5000, 1000, 1.2, 3, 4),
    Choice(16000, 3, 0.05, 5000, 5000, 2000, 1.2, 3, 4),
    Choice(40000, 3, 0.05, 10000, 16000, 2000, 1.6, 4, 6),
)


@dataclass(frozen=True)
class Job:
    """A job. raw: the tables of its file; data: the same in SI units; sizes: size distribution of the powder; metals: metals by name;
    nozzle: nozzle of the gas."""

    name: str
    raw: dict[str, Any]
    data: JobData
    sizes: Sizes
    metals: Mapping[str, Material]
    nozzle: nozzles.Nozzle

    @property
    def metal(self) -> Material:
        """Metal of the powder."""
        return self.metals[self.data.powder.material]

    @property
    def base(self) -> Material:
        """Metal of the substrate."""
        return self.metals[self.data.substrate.material]

    @cached_property
    def flow(self) -> Flow:
        """The gas flow through the nozzle. Raises SceneError."""
        try:
            return scene_gas.flow(self.data.gas, self.nozzle)
        except ColdsprayError as error:
            raise SceneError([f"gas.{error}"], self.name) from None

    @cached_property
    def arrived(self) -> Spray:
        """The powder at impact, with the critical-velocity formula for its metal and the substrate."""
        fly = partial(scene_gas.flights, self.data.gas, self.flow, self.metal)
        return spray(self.metal, self.base, self.sizes, fly)

    def on(self, base: str, points: int, strength: str = "") -> Scene:
        """The scene of one impact with computed bonds: a particle of median size, with its velocity and temperature from the gas, on
        the metal `base` of the job. points: number of points of the particle; strength: a strength set of the powder, by default its
        own."""
        k = len(self.arrived.share) // 2
        D = float(self.arrived.diameter[k])
        tables = self._materials(self.data.powder.material, base)
        if strength:
            tables[self.data.powder.material]["strength"] = strength
        return Scene.from_dict({
            "particle": {
                "material": self.data.powder.material, "diameter": _um(D), "velocity": f"{self.arrived.velocity[k]:.4g} m/s",
                "temperature": f"{self.arrived.temperature[k]:.4g} K",
            },
            "substrate": self._base(base, 6.0 * D, 3.0 * D), "adhesion": {"kind": "cohesive", "criterion": "exposure"},
            "resolution": {"spacing": _um(cost.spacing(math.pi / 6.0 * D**3, points))}, "materials": tables,
        }, f"{self.name}_on_{base}")  # fmt: skip

    def coating(self, choice: Choice, seed: int) -> Scene:
        """The scene of a coating. Its particles are those that stick by the formula, or all particles if none sticks. All particles
        of the scene are tied to the surface."""
        smallest, median, largest = self.middle(choice.points)
        radius, spread = choice.disc * median, math.log(self.sizes.diameter(0.9) / self.sizes.diameter(0.1)) / 2.563
        metal = self.data.powder.material
        by_number = median * math.exp(-3.0 * spread**2)  # Hatch & Choate (1929), J. Franklin Inst. 207, 369
        return Scene.from_dict({
            "preset": "draft", "gas": self.raw["gas"], "spray": self.raw.get("spray", {}),
            "coating": {
                "material": metal, "number": choice.number, "layers": choice.layers, "radius": _um(radius), "positions": "even",
                "diameter": _um(min(max(by_number, smallest), largest)), "spread": max(math.exp(spread), 1.0),
                "smallest": _um(smallest), "largest": _um(largest), "seed": seed,
            },
            "substrate": self._base(self.data.substrate.material, 2.0 * radius + 3.7 * median, 3.0 * median),
            "adhesion": {"kind": "tied", "criterion": "all"}, "output": {"at": "ends"},
            "resolution": {"spacing": _um(cost.spacing(math.pi / 6.0 * largest**3, choice.points))},
            "materials": self._materials(metal, self.data.substrate.material), "nozzles": self.raw["nozzles"],
        }, f"{self.name}_coating")  # fmt: skip

    def middle(self, points: int) -> tuple[float, float, float]:
        """Smallest, median and largest diameter (m) of the particles of a coating. The median is that of the mass that sticks by the
        formula. The range is the widest in which the smallest particle has ROOM points if the largest has `points`."""
        ratio = self.arrived.ratio
        stick = self.arrived.share[(ratio >= 1.0) & (ratio < 2.0)]
        median = self.sizes.diameter(float(stick.mean()) if len(stick) else 0.5)
        half = (points / ROOM) ** (1.0 / 6.0)
        return max(median / half, self.sizes.diameter(0.05)), median, min(median * half, self.sizes.diameter(0.95))

    @property
    def bases(self) -> tuple[str, ...]:
        """Names of the metals that the powder hits: first the metal of the substrate, then the metal of the coating."""
        return tuple(dict.fromkeys((self.data.substrate.material, self.data.powder.material)))

    def _base(self, material: str, diameter: float, height: float) -> dict[str, object]:
        K = f"{self.data.substrate.temperature:.6g} K"
        return {"material": material, "diameter": _um(diameter), "height": _um(height), "temperature": K}

    @property
    def other_sets(self) -> list[str]:
        """The strength sets of the powder other than its own."""
        name = self.data.powder.material
        return sets_of(self.raw["materials"].get(name, {}), name)[1:]

    def _materials(self, *names: str) -> dict[str, dict[str, Any]]:
        """The tables of metals, by name. A table that names no strength gets the first set of `sets_of`."""
        tables = {name: dict(self.raw["materials"].get(name, {})) for name in names}
        for name, table in tables.items():
            if sets := sets_of(table, name):
                table["strength"] = sets[0]
        return tables


def sets_of(table: Mapping[str, object], name: str) -> list[str]:
    """The strength sets of a metal in the library. The set that is fitted up to the highest strain rate comes first; for a fit
    without an upper limit its lowest rate counts. The list is empty if the table of the metal names its strength, or the library does
    not have the metal."""
    try:
        known = [] if {"strength", "law"} & table.keys() else materials.entry(str(table.get("base", name))).materials
    except ColdsprayError:
        return []

    def reaches(metal: Material) -> float:
        slowest, fastest = metal.strength.fitted.rate or (0.0, metal.fitted_rate)
        return fastest if math.isfinite(fastest) else slowest

    return [metal.strength.set for metal in sorted(known, key=reaches, reverse=True)]


def _um(length: float) -> str:
    return units.rounded(length, "um", 5)


def read(path: Path, kind: type[JobData] = JobData) -> Job:
    """Read the file of a job. kind: model of its tables. Raises the errors of `from_text`, and InputError if the file cannot be
    read."""
    return from_text(read_text(path, SCENE_LIMIT), path, kind)


def from_text(text: str, path: Path, kind: type[JobData] = JobData) -> Job:
    """Read a job from TOML. path: its file, whose stem is the name of the job and whose folder has the files that it names; kind: model
    of its tables. Raises InputError if the text is not valid TOML, SceneError with all problems of its tables."""
    raw = toml_of(text, path)
    problems = with_library(raw, str(path))
    metals, found = materials.from_scene(raw["materials"])
    known, of_nozzles = nozzles.from_tables(raw["nozzles"])
    problems += found + of_nozzles
    data, entries = read_table(kind, raw)
    problems += [in_words(entry, False, kind) for entry in entries]
    for table, key in (("powder", "material"), ("substrate", "material"), ("gas", "nozzle")):
        name = raw[table].get(key) if isinstance(raw.get(table), dict) else None
        if isinstance(name, str) and name not in (known if key == "nozzle" else metals):
            text = nozzles.unknown(name[:40], known) if key == "nozzle" else materials.unknown(name[:40], metals)
            problems.append(f'{table}.{key} = "{name[:40]}": {text}')
    sizes = None
    if data is not None:
        try:
            sizes = sizes_of(data.powder.sizes, path.parent)
        except ValueError as error:
            problems.append(f'powder.sizes = "{data.powder.sizes}": {error}')
    if problems or data is None or sizes is None:
        raise SceneError(problems, str(path))
    return Job(path.stem, raw, data, sizes, metals, known[data.gas.nozzle])


def seconds(job: Job, choice: Choice, takes: Callable[[Scene], float], cores: int) -> float:
    """Wall time of the computations of a choice on `cores` cores, s. takes(scene): function that gives the processor time of a run,
    s."""
    halvings = math.ceil(math.log2(RATIO / choice.tolerance))
    each, total = choice.placements * (BRACKET + halvings), choice.seeds * (takes(job.coating(choice, 1)) + START)
    rough = BRACKET + 1
    for base in job.bases if choice.bonds else ():
        total += each * (takes(job.on(base, choice.bonds)) + START)
        total += rough * (takes(job.on(base, choice.coarser)) + START) if choice.coarser else 0.0
        if choice.sets:
            total += rough * len(job.other_sets) * (takes(job.on(base, choice.sets)) + START)
    return total / (PARALLEL * cores)


def choose(job: Job, takes: Callable[[Scene], float], cores: int) -> tuple[Choice, float, tuple[Choice, float] | None]:
    """The largest of CHOICES that fits into the time of the job, its wall time (s), and the next larger choice with its time (None
    after the last). takes, cores: as in `seconds`. Raises SceneError if even the smallest choice takes longer."""
    best: tuple[Choice, float] | None = None
    for choice in CHOICES:
        time = seconds(job, choice, takes, cores)
        if time > job.data.within:
            if best is None:
                least = units.rounded(time, "min", 2)
                raise SceneError(
                    [
                        f"within = {units.rounded(job.data.within, 'min')}: too short, the smallest choice takes {least} here"
                    ],
                    job.name,
                )
            return *best, (choice, time)
        best = choice, time
    assert best is not None
    return *best, None


def processor_time(factor: float) -> Callable[[Scene], float]:
    """A function that gives the expected processor time of a scene, s. factor: processor time on this machine divided by the time of
    the cost model."""
    return lambda scene: factor * forecast(plan(scene)).whole
