"""The computations of a job: the scenes of its impacts and coatings; their number and resolution follow from the given time."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

from .. import units
from ..errors import ColdsprayError, SceneError
from ..files.inputs import SCENE_LIMIT, read_text, toml_of
from ..physics import materials
from ..physics.materials import Material
from ..scene.job import JobData
from ..scene.messages import in_words
from ..scene.values import read_table
from ..spray import nozzles
from ..spray.gas import Flow
from ..spray.sizes import Sizes
from ..spray.window import FASTEST, Spray, spray
from . import cost
from . import gas as scene_gas
from .own import with_library
from .powder import sizes_of
from .reading import Scene

ROOM = 1.1 * cost.LEAST_POINTS  # points of the smallest particle of a coating
BLEND = "; a job has one powder: write a blend as a scene with [[coating.powder]], for coldspray run"
START = 4.0  # processor time of the start of a run and of its pictures, s
PARALLEL = 0.8  # efficiency of several threads and of runs of unequal length


@dataclass(frozen=True)
class Search:
    """A search for the critical velocity of the median particle on the metal `base`. points: points of the particle; placements:
    impacts at each velocity; tolerance: width of the bracket divided by its middle; strength: another strength set of the powder, ""
    for its own set."""

    base: str
    points: int
    placements: int = 1
    tolerance: float = 0.1
    strength: str = ""
    rounds: ClassVar[int] = 2  # the greatest and the least velocity of the powder, more only for a bracket

    @property
    def words(self) -> str:
        """The search as text."""
        each = f", {self.placements} impacts at each velocity" * (self.placements > 1)
        return f"bonds on {self.base} with {self.points} points" + f", {self.strength}" * bool(self.strength) + each

    @property
    def folder(self) -> str:
        """Folder of the runs of this search, relative to the folder of the job."""
        return f"bonds/on_{self.base}/{self.points}" + f"_{self.strength}" * bool(self.strength)


@dataclass(frozen=True)
class Coatings:
    """Coatings, one for each seed. points: points of the largest particle; disc: radius of the disc of the particle centres, in median
    diameters; layers: number of layers; seeds: number of coatings."""

    points: int
    disc: float
    layers: int
    seeds: int
    rounds: ClassVar[int] = 1

    @property
    def words(self) -> str:
        """The coatings as text."""
        return f"{self.seeds} coatings of {self.number} particles with {self.points} points"

    @property
    def number(self) -> int:
        """Number of particles of a coating: in each layer 7.4 times the square of the radius `disc`."""
        return self.layers * round(7.4 * self.disc**2)


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

    def coating(self, part: Coatings, seed: int) -> Scene:
        """The scene of a coating. Its particles are those that stick by the formula, or all particles if none sticks. All particles
        of the scene are tied to the surface."""
        smallest, median, largest = self.middle(part.points)
        radius, spread = part.disc * median, math.log(self.sizes.diameter(0.9) / self.sizes.diameter(0.1)) / 2.563
        metal = self.data.powder.material
        by_number = median * math.exp(-3.0 * spread**2)  # Hatch & Choate (1929), J. Franklin Inst. 207, 369
        return Scene.from_dict({
            "preset": "draft", "gas": self.raw["gas"], "spray": self.raw.get("spray", {}),
            "coating": {
                "material": metal, "number": part.number, "layers": part.layers, "radius": _um(radius), "positions": "even",
                "diameter": _um(min(max(by_number, smallest), largest)), "spread": max(math.exp(spread), 1.0),
                "smallest": _um(smallest), "largest": _um(largest), "seed": seed,
            },
            "substrate": self._base(self.data.substrate.material, 2.0 * radius + 3.7 * median, 3.0 * median),
            "adhesion": {"kind": "tied", "criterion": "all"}, "output": {"at": "ends"},
            "resolution": {"spacing": _um(cost.spacing(math.pi / 6.0 * largest**3, part.points))},
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

    @cached_property
    def parts(self) -> tuple[Search | Coatings, ...]:
        """The computations of the job, the most important first."""
        sets = [Search(base, 5000, strength=name) for base in self.bases for name in self.other_sets]
        return (
            *(Search(base, 5000) for base in self.bases), Coatings(1000, 0.9, 2, 2),
            *(Search(base, 16000) for base in self.bases), *sets,
            Coatings(1000, 1.2, 3, 4),
            *(Search(base, 16000, 3, 0.05) for base in self.bases), Coatings(2000, 1.2, 3, 4),
            *(Search(base, 40000, 3, 0.05) for base in self.bases), Coatings(2000, 1.6, 4, 6),
        )  # fmt: skip

    @cached_property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest velocity of the powder, m/s. Each size counts with the velocity at which the median particle has the
        same ratio of velocity to critical velocity by the formula."""
        same = self.arrived.ratio.clip(max=FASTEST) * self.arrived.critical[len(self.arrived.share) // 2]
        return math.floor(same.min()), math.ceil(same.max())

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
    for entry in entries:
        is_blend = entry["loc"] in (("coating",), ("powder",)) and entry["type"] != "missing"
        problems.append(in_words(entry, False, kind) + BLEND * is_blend)
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


def seconds(job: Job, part: Search | Coatings, takes: Callable[[Scene], float], cores: int) -> float:
    """Expected wall time of a round of a part on `cores` cores, s. A round is all impacts at one velocity, or all coatings.
    takes(scene): function that gives the processor time of a run, s."""
    if isinstance(part, Search):
        runs, scene = part.placements, job.on(part.base, part.points, part.strength)
    else:
        runs, scene = part.seeds, job.coating(part, 1)
    return runs * (takes(scene) + START) / (PARALLEL * cores)
