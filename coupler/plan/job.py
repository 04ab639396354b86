"""The computations of a job: the scenes of its impacts and coatings; their number and resolution follow from the given time."""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

from .. import units
from ..errors import ColdsprayError, SceneError
from ..files.inputs import SCENE_LIMIT, leaves, read_text, toml_of
from ..measures import STICKS
from ..physics import materials
from ..physics.materials import Material
from ..physics.shapes import form, sphere_volume
from ..scene.coating import MOST_PARTICLES
from ..scene.job import JobData, Powder
from ..scene.messages import in_words
from ..scene.values import read_table
from ..spray import nozzles
from ..spray.gas import Flow
from ..spray.sizes import Sizes
from ..spray.window import EROSION, FASTEST, Spray, at_impact, spray
from . import cost
from . import gas as scene_gas
from .own import with_library
from .powder import sizes_of
from .reading import Scene

ROOM = 1.1 * cost.LEAST_POINTS  # points of the smallest particle of a coating
COVER = 7.4  # particles of a layer over the square of the radius `Coatings.disc`
LEAST_OF_EACH = 2  # particles of each powder in a coating
OF_PARTICLE = "hardness", "yield_strength", "porosity", "pore_diameter", "core"  # keys of powder and particle
_OF_COATING = re.compile(r"^(particle\[\d+\]|coating(\.number = \d+: powder|\.powder|(?=\.)))")  # a powder in messages
START = 4.0  # processor time of the start of a run and of its pictures, s
PARALLEL = 0.8  # efficiency of several threads and of runs of unequal length


@dataclass(frozen=True)
class Search:
    """A search for the critical velocity of the median particle of a powder on the metal `base`. points: points of the particle;
    placements: impacts at each velocity; tolerance: width of the bracket divided by its middle; strength: another strength set of the
    powder, "" for its own set."""

    powder: str
    base: str
    points: int
    placements: int = 1
    tolerance: float = 0.1
    strength: str = ""
    rounds: ClassVar[int] = 2  # the greatest and the least velocity of the powder, more only for a bracket

    @property
    def words(self) -> str:
        """The search as text."""
        what = f"bonds of {self.powder} on {self.base} with {self.points} points"
        each = f", {self.placements} impacts at each velocity" * (self.placements > 1)
        return what + f", {self.strength}" * bool(self.strength) + each

    @property
    def folder(self) -> str:
        """Folder of the runs of this search, relative to the folder of the job."""
        pair = f"{self.powder}_on_{self.base}".replace(" ", "_")
        return f"bonds/{pair}/{self.points}" + f"_{self.strength}" * bool(self.strength)


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
        """Number of particles of a coating: in each layer COVER times the square of the radius `disc`."""
        return self.layers * round(COVER * self.disc**2)


@dataclass(frozen=True)
class Feed:
    """A powder of a job. name: its materials, such as "Ni on Al2O3", with a number if another powder has the same ones; key: name of
    its table in messages; raw, table: its table as text and in SI units; sizes: size distribution; metal: material of its surface;
    flying: material in flight, as `Derived.flying`; room: number of points that a particle needs at least."""

    name: str
    key: str
    raw: dict[str, Any]
    table: Powder
    sizes: Sizes
    metal: Material
    flying: Material
    room: float = ROOM

    def keys(self, names: Iterable[str]) -> dict[str, Any]:
        """The given keys of the powder's table `raw` with their values, without keys that the table lacks."""
        return {name: self.raw[name] for name in names if name in self.raw}


@dataclass(frozen=True)
class Job:
    """A job. folder: folder of its file; raw: the tables of the file; data: the same in SI units; powders: its powders by name; metals:
    metals by name; nozzle: nozzle of the gas."""

    name: str
    folder: Path
    raw: dict[str, Any]
    data: JobData
    powders: Mapping[str, Feed]
    metals: Mapping[str, Material]
    nozzle: nozzles.Nozzle

    @property
    def main(self) -> Feed:
        """The metal powder with the largest share."""
        metals = [powder for powder in self.powders.values() if not powder.metal.is_ceramic]
        return max(metals or self.powders.values(), key=lambda powder: powder.table.share)

    @property
    def surface(self) -> str:
        """Name of the metal of the surface of the substrate."""
        return self.data.substrate.materials[0]

    @property
    def slant(self) -> float:
        """Velocity of a particle divided by its component normal to the surface."""
        return 1.0 / math.cos(self.data.spray.angle)

    @cached_property
    def flow(self) -> Flow:
        """The gas flow through the nozzle. Raises SceneError."""
        try:
            return scene_gas.flow(self.data.gas, self.nozzle)
        except ColdsprayError as error:
            raise SceneError([f"gas.{error}"], self.name) from None

    @cached_property
    def arrived(self) -> Mapping[str, Spray]:
        """Each powder at impact, by name. Its critical velocities are from the formula for its metal on the surface of the substrate;
        a ceramic has none. Raises ColdsprayError as `window.spray`, also for ceramics without a metal powder in the blend."""
        found, base = {}, self.metals[self.surface]
        of_base = f"substrate.{'layer[1].' * bool(self.data.substrate.layer)}material"
        for name, powder in self.powders.items():
            fly = partial(scene_gas.flights, self.data.gas, self.flow, powder.flying)
            in_blend = powder.metal.is_ceramic and not self.main.metal.is_ceramic
            made = at_impact if in_blend else partial(spray, keys=(f"{powder.key}.material", of_base))
            found[name] = made(powder.metal, base, powder.sizes, fly)
        return found

    def efficiency(self, powder: str) -> float:
        """Mass fraction of a powder that sticks on its own metal by the formula."""
        return self.arrived[powder].fates(self.slant)[STICKS]

    @property
    def sticks(self) -> bool:
        """Whether any of the powders sticks by the formula."""
        return any(self.efficiency(name) > 0.0 for name in self.powders)

    @cached_property
    def hits(self) -> tuple[tuple[str, str], ...]:
        """Names (powder, metal that it hits): each metal powder hits the surface of the substrate, then its own metal if it differs."""
        metals = (powder for powder in self.powders.values() if not powder.metal.is_ceramic)
        return tuple(
            (each.name, base) for each in metals for base in dict.fromkeys((self.surface, each.table.material))
        )

    def scene_on(self, powder: str, base: str, points: int, strength: str = "") -> Scene:
        """The scene of one impact with computed bonds: a particle of median size, with its velocity and temperature from the gas, at
        the angle of the gun on the metal `base` of the job. points: number of points of the particle; strength: a strength set of the
        powder, by default its own."""
        own, at = self.powders[powder], self.arrived[powder]
        k = len(at.share) // 2
        D, metal = float(at.diameter[k]), own.table.material
        tables = self._materials(*own.table.materials, base)
        if strength:
            tables[metal]["strength"] = strength
        return Scene.from_dict({
            "particle": {
                "material": metal, "diameter": _um(D), "velocity": f"{at.velocity[k]:.4g} m/s",
                "temperature": f"{at.temperature[k]:.4g} K", "angle": units.show(self.data.spray.angle, "deg"),
            } | own.keys(OF_PARTICLE),
            "substrate": {
                "material": base, "diameter": _um(6.0 * D), "height": _um(3.0 * D),
                "temperature": f"{self.data.substrate.temperature:.6g} K",
            },
            "adhesion": {"kind": "cohesive", "criterion": "exposure"},
            "resolution": {"spacing": _um(cost.spacing(sphere_volume(D), points))}, "materials": tables,
        }, f"{self.name}_on_{base}")  # fmt: skip

    def check(self) -> None:
        """Raise SceneError if the last coating of `parts` cannot be computed. For example, the gun does not move over it, the surface
        cannot be meshed, or a powder cannot be resolved. The message has one problem for each key of the job."""
        try:
            self.coating([part for part in self.parts if isinstance(part, Coatings)][-1], 1)
        except SceneError as error:
            told = [_OF_COATING.sub("powder", text) for text in error.problems if not text.startswith("...")]
            raise SceneError([*{text.split(" ")[0]: text for text in told}.values()], self.name) from None

    def coating(self, part: Coatings, seed: int) -> Scene:
        """The scene of a coating. Its particles are those that stay (`stays`); metal particles are tied to the surface, ceramic ones
        are not. Names of files are relative to the folder of the job. Raises SceneError."""
        ranges, body = self.middle(part.points), self.data.substrate
        smallest, largest = min(low for low, _, _ in ranges.values()), max(high for _, _, high in ranges.values())
        median = max(self.medians.values())
        radius = part.disc * math.sqrt(sum(n * self.medians[name] ** 2 for name, n in self.by_number.items()))
        spacing = min(cost.spacing(sphere_volume(D), n) for D, n in ((largest, part.points), (smallest, self.room)))
        height = max(3.0 * median, 21.0 * body.roughness) + sum(layer.thickness for layer in body.layer)
        shapes = ["sphere", *(shape for name in self.stays for shape in self.powders[name].table.shapes or {})]
        widest = largest * max(length for shape in shapes for length in form(shape, 1.0).lengths)
        wide = 2.0 * radius + max(3.7 * median, 1.05 * (largest + widest))
        powders = [self._drawn(name, *ranges[name]) for name in self.stays]
        names = [*(name for each in self.stays for name in self.powders[each].table.materials), *body.materials]
        return Scene.from_dict({
            "preset": "draft", "gas": self.raw["gas"], "spray": self.raw.get("spray", {}),
            "coating": {
                "number": part.number, "layers": part.layers, "radius": _um(radius), "positions": "even", "seed": seed,
            } | ({"powder": powders} if len(powders) > 1 else powders[0]),
            "substrate": {"diameter": _um(wide), "height": _um(height)} | self.raw["substrate"],
            "adhesion": {"kind": "tied", "criterion": "all"}, "output": {"at": "ends"},
            "resolution": {"spacing": _um(spacing)}, "materials": self._materials(*names), "nozzles": self.raw["nozzles"],
        }, str(self.folder / f"{self.name}_coating"))  # fmt: skip

    def _drawn(self, name: str, smallest: float, median: float, largest: float) -> dict[str, object]:
        """The table of a powder in a coating. smallest, median, largest: its diameters by mass, m."""
        powder = self.powders[name]
        spread = math.log(powder.sizes.diameter(0.9) / powder.sizes.diameter(0.1)) / 2.563
        by_number = median * math.exp(-3.0 * spread**2)  # Hatch & Choate (1929), J. Franklin Inst. 207, 369
        share = {"share": self.stays[name] / sum(self.stays.values())} if len(self.stays) > 1 else {}
        return {
            "material": powder.table.material, "diameter": _um(min(max(by_number, smallest), largest)),
            "spread": max(math.exp(spread), 1.0), "smallest": _um(smallest), "largest": _um(largest),
        } | share | powder.keys(("shapes", "files", *OF_PARTICLE))  # fmt: skip

    @cached_property
    def stays(self) -> Mapping[str, float]:
        """Mass of each powder in the coatings, divided by the fed mass of all powders. Of a metal the fraction `efficiency` stays, of a
        ceramic everything; if no metal sticks, everything of each powder. Powders of which nothing stays are left out."""
        each = {
            name: powder.table.share * (1.0 if powder.metal.is_ceramic or not self.sticks else self.efficiency(name))
            for name, powder in self.powders.items()
        }
        return {name: mass for name, mass in each.items() if mass > 0.0}

    @cached_property
    def medians(self) -> Mapping[str, float]:
        """Median diameter by mass, m, of each powder in the coatings. If sizes of it stick by the formula, only these sizes count."""
        found = {}
        for name in self.stays:
            ratio, share = self.arrived[name].ratio / self.slant, self.arrived[name].share
            stick = share[(ratio >= 1.0) & (ratio < EROSION)]
            found[name] = self.powders[name].sizes.diameter(float(stick.mean()) if len(stick) else 0.5)
        return found

    @cached_property
    def by_number(self) -> Mapping[str, float]:
        """Number of particles of each powder divided by the number of all particles of a coating."""
        each = {n: mass / (self.powders[n].flying.rho * self.medians[n] ** 3) for n, mass in self.stays.items()}
        return {name: number / sum(each.values()) for name, number in each.items()}

    @property
    def room(self) -> float:
        """Number of points that the smallest particle of a coating needs at least."""
        return max(powder.room for powder in self.powders.values())

    def middle(self, points: int) -> dict[str, tuple[float, float, float]]:
        """Smallest, median and largest diameter (m) of each powder in a coating. The largest particle has `points` points, the smallest
        at least `room`; the ranges are as wide as this allows. If the medians are too far apart, each powder has one size."""
        apart = math.sqrt(max(self.medians.values()) / min(self.medians.values()))
        half = max((points / self.room) ** (1.0 / 6.0) / apart, 1.0)
        least, most = ({n: self.powders[n].sizes.diameter(share) for n in self.medians} for share in (0.05, 0.95))
        return {n: (max(D / half, least[n]), D, min(D * half, most[n])) for n, D in self.medians.items()}

    @cached_property
    def parts(self) -> tuple[Search | Coatings, ...]:
        """The computations of the job, the most important first."""
        room, enough = math.ceil(self.room), min(LEAST_OF_EACH / min(self.by_number.values()), 0.99 * MOST_PARTICLES)

        def search(points: int, placements: int = 1, tolerance: float = 0.1) -> list[Search]:
            return [Search(*pair, max(points, room), placements, tolerance) for pair in self.hits]

        def coatings(points: int, disc: float, layers: int, seeds: int) -> Coatings:
            return Coatings(max(points, room), max(disc, math.sqrt(enough / layers / COVER)), layers, seeds)

        sets = [replace(part, strength=name) for part in search(5000) for name in self.other_sets(part.powder)]
        return tuple(dict.fromkeys((
            *search(5000), coatings(1000, 0.9, 2, 2), *search(16000), *sets, coatings(1000, 1.2, 3, 4),
            *search(16000, 3, 0.05), coatings(2000, 1.2, 3, 4), *search(40000, 3, 0.05), coatings(2000, 1.6, 4, 6),
        )))  # fmt: skip

    def reach(self, powder: str) -> tuple[float, float]:
        """Smallest and largest velocity, m/s, for a search with the median particle. They are its critical velocity times the
        smallest and the largest ratio of velocity to critical velocity of all sizes, by the formula, at most FASTEST."""
        at = self.arrived[powder]
        same = at.ratio.clip(max=FASTEST) * at.critical[len(at.share) // 2]
        return math.floor(same.min()), math.ceil(same.max())

    def other_sets(self, powder: str) -> list[str]:
        """The strength sets of a powder other than its own."""
        name = self.powders[powder].table.material
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
    without an upper limit its lowest rate counts. The list is empty if `table`, the table of the metal in the file, names a strength
    set or law, or if the library does not have the metal."""
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
    """Read a job from TOML. path: its file; the stem is the name of the job, and names of files are relative to its folder; kind: model
    of its tables. Raises InputError if the text is not valid TOML, SceneError with all problems of its tables."""
    raw = toml_of(text, path)
    problems = with_library(raw, str(path))
    metals, found = materials.from_scene(raw["materials"])
    known, of_nozzles = nozzles.from_tables(raw["nozzles"])
    problems += found + of_nozzles
    data, entries = read_table(kind, raw)
    given: list[Any] = raw["powder"] if isinstance(raw.get("powder"), list) else [raw.get("powder")]
    problems += [in_words(entry, len(given) > 1, kind) for entry in entries]
    for key, name in leaves({name: raw[name] for name in ("powder", "substrate", "gas") if name in raw}):
        if not isinstance(name, str):
            continue
        if key.endswith(".material") and name not in metals:
            problems.append(f'{key} = "{name[:40]}": {materials.unknown(name[:40], metals)}')
        elif key == "gas.nozzle" and name not in known:
            problems.append(f'{key} = "{name[:40]}": {nozzles.unknown(name[:40], known)}')
    sizes = list[Sizes]()
    keys = [f"powder[{k}]" if len(given) > 1 else "powder" for k in range(1, len(given) + 1)]
    for key, powder in zip(keys, data.powders if data else (), strict=False):
        try:
            sizes.append(sizes_of(powder.sizes, path.parent))
        except ValueError as error:
            problems.append(f'{key}.sizes = "{powder.sizes}": {error}')
    if problems or data is None:
        raise SceneError(problems, str(path))
    same = [" on ".join(powder.materials) for powder in data.powders]
    names = [f"{name} {k}" if same.count(name) > 1 else name for k, name in enumerate(same, 1)]
    powders = map(partial(_feed, metals), names, keys, given, data.powders, sizes)
    return Job(
        path.stem, path.parent, raw, data, dict(zip(names, powders, strict=True)), metals, known[data.gas.nozzle]
    )


def _feed(
    metals: Mapping[str, Material], name: str, key: str, raw: dict[str, Any], table: Powder, sizes: Sizes
) -> Feed:
    shell = metals[table.material]
    if table.core is None:
        return Feed(name, key, raw, table, sizes, shell, shell)
    core = metals[table.core.material]
    share = table.core.share_by_volume(1.0, shell.rho, core.rho)
    thinnest = min(0.5 * (1.0 - share ** (1.0 / 3.0)), share ** (1.0 / 3.0) / 3.0)  # shell or core, as `check` needs it
    room = max(ROOM, 1.1 * math.pi / 6.0 / thinnest**3)
    return Feed(name, key, raw, table, sizes, shell, materials.mixed(shell, core, share), room)


def seconds(job: Job, part: Search | Coatings, time_of: Callable[[Scene], float], cores: int) -> float:
    """Expected wall time of a round of a part on `cores` cores, s. A round is all impacts at one velocity, or all coatings.
    time_of(scene): function that gives the processor time of a run, s."""
    if isinstance(part, Search):
        runs, scene = part.placements, job.scene_on(part.powder, part.base, part.points, part.strength)
    else:
        runs, scene = part.seeds, job.coating(part, 1)
    return runs * (time_of(scene) + START) / (PARALLEL * cores)
