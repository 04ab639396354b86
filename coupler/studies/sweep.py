"""A sweep: runs of one scene with some keys varied over a full grid, a list of points or a quasi-random ensemble."""

import copy
import itertools
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from .. import units
from ..errors import ColdsprayError, SceneError
from ..files.inputs import InputError, read_toml, similar
from ..plan.own import with_library
from ..plan.reading import Scene
from ..plan.solids import with_folders
from ..scene.model import particle_tables, safe_name
from ..scene.toml import set_key, toml_text
from .runs import run_points

MOST_POINTS = 10_000
SUBSTRATE = {"diameter": 8.0, "height": 4.0}  # over the particle's diameter: 200 x 100 um for 25 um
SHORT = {name: f"particle.{name}" for name in ("material", "diameter", "velocity", "temperature")}
_KEYS = ("name", "points", "ensemble", "scene", "target")
# problems of a scene that depend neither on its other keys nor on a limit: the file of the sweep is wrong
_MISWRITTEN = re.compile(
    r"\S+( = .*)?(: unknown|: expected| has no unit| has an unknown unit| is an? | is not | needs )"
)
# keys of the table of a distribution, by its kind
KINDS = {
    "normal": ("mean", "deviation"), "log-normal": ("median", "spread"), "uniform": ("from", "to"), "choice": ("values",),
}  # fmt: skip
LIMITS = ("smallest", "largest")
_EXAMPLES = (
    '{ mean = "600 m/s", deviation = "40 m/s" }, { median = "25 um", spread = 1.4 }, { from = "0 um", to = "10 um" },'
    " { values = [...] }"
)
Table = dict[str, object]
Settings = dict[str, object]  # key of a scene -> value
Quantile = Callable[[float], object]  # fraction (0 to 1) -> value of a scene, as text with its unit or as number


@dataclass(frozen=True)
class Sweep:
    """The points of a sweep. name: the runs are in runs/<name>; points: name -> scene as TOML; refused: points whose scene is not valid
    -> reason (they count as failed); varied: keys that differ between points; is_ensemble: values are drawn from distributions."""

    name: str
    points: dict[str, str]
    refused: dict[str, str]
    varied: tuple[str, ...] = ()
    is_ensemble: bool = False

    @classmethod
    def load(cls, path: str | Path) -> "Sweep":
        """Read the file of a sweep (TOML, such as workflows/map_ni.toml). Raises SceneError with all its problems."""
        path = Path(path)
        try:
            data = read_toml(path)
        except InputError as error:
            raise SceneError([f"the file {error.reason}{similar(path)}"], str(path)) from None
        return cls.from_dict(data, str(path))

    @classmethod
    def from_dict(cls, data: Mapping[str, object], source: str = "sweep") -> "Sweep":
        """Make a sweep from nested dicts, as TOML gives them. Raises SceneError with all problems.

        data["scene"]: the scene as a table, or the name of its file, relative to `source`. data["points"]: keys of the scene, such as
        particle.velocity, in a table of lists (all are combined) or in a list of tables (each is a point); material, diameter, velocity
        and temperature mean those of the particle. data["ensemble"]: `runs`, `seed`, and a distribution for each key (`quantile_of`).
        data["target"]: diameter and height of the target over the diameter of the particle, if the scene has none.
        """
        unknown = [key for key in data if key not in _KEYS]
        problems = [f"{key}: unknown key{units.nearest(key, _KEYS)}; known: {', '.join(_KEYS)}" for key in unknown]
        if not {"scene", "points", "ensemble"} & data.keys() and {"particle", "coating"} & data.keys():
            raise SceneError([f"this is a scene, not the file of a sweep: run coldspray run {source}"], source)
        name = data.get("name", safe_name(source))
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name):
            problems.append("name: use letters, digits, '_', '.', '-' (at most 64, a letter or digit first)")
        if ("points" in data) == ("ensemble" in data):
            problems.append("points: give [points] (lists, all combined), [[points]] (one table each) or [ensemble]")
        base, ratios = _base(data.get("scene"), source, problems), _ratios(data.get("target", {}), problems)
        if problems:
            raise SceneError(problems, source)
        is_ensemble = "ensemble" in data
        settings = _ensemble(data["ensemble"], source) if is_ensemble else _points(data["points"], source)
        varied = tuple(dict.fromkeys(key for point in settings for key in point))
        if not is_ensemble:
            varied = tuple(key for key in varied if len({repr(point.get(key)) for point in settings}) > 1)
        if not settings:
            raise SceneError(["points: there is no point; give a key of the scene and its values"], source)
        scenes: dict[str, str] = {}
        refused: dict[str, str] = {}
        first: SceneError | None = None
        for number, point in enumerate(settings, 1):
            label = f"{number:05d}" if is_ensemble else point_name(point) or "base"
            if label in scenes:
                raise SceneError([f"points: {label} is given twice; remove one of them"], source)
            try:
                scene = _with(base, point, ratios)
                with_folders(scene, source)
                scenes[label] = toml_text(scene)
                Scene.from_dict(scene, label)
            except SceneError as error:
                refused[label], first = "; ".join(error.problems), first or error
                problems += [line for line in error.problems if _MISWRITTEN.match(line) and line not in problems]
            except ValueError as error:  # a key that does not exist
                raise SceneError([str(error)], source) from None
        if problems:
            raise SceneError(problems, source)
        if first is not None and len(refused) == len(scenes):  # the fault is in what all points share
            raise SceneError([f"no point can be computed; the first: {problem}" for problem in first.problems], source)
        return cls(str(name), scenes, refused, varied, is_ensemble)

    def run(self, out: str | Path | None = None, jobs: int = 1, pool: Executor | None = None) -> Path:
        """Run the points as in `run_points`. out: folder, by default runs/<name>. jobs: number of simultaneous runs on this machine;
        pool: an executor to use instead; it is shut down at the end. Returns the folder."""
        folder = Path(out) if out is not None else Path("runs") / self.name
        run_points(folder, self.points, jobs, refused=self.refused, pool=pool)
        return folder


def point_name(point: Mapping[str, object]) -> str:
    """Name of a point from its settings: {"particle.material": "Ni", "particle.velocity": "500 m/s"} gives "Ni_500ms"."""
    words = []
    for key, value in point.items():
        text = value if isinstance(value, str) else json.dumps(value)
        label = "" if key in SHORT.values() else key.rpartition(".")[2]
        words.append(re.sub(r"[^A-Za-z0-9.+-]", "", label + text))
    return "_".join(words)[:120]


def _base(scene: object, source: str, problems: list[str]) -> Table:
    """The scene that all points share."""
    base: Table = {}
    if isinstance(scene, str):
        source = str(Path(source).parent / scene)
        try:
            base = read_toml(source)
        except ColdsprayError as error:
            problems.append(f"scene: {error}")
    elif isinstance(scene, Mapping):
        base = dict(scene)
    else:
        problems.append('scene: expected a table [scene], or the file of a scene, as scene = "single.toml"')
    if "library" in base:  # a point may use any of its metals
        problems += with_library(base, source)
    base = copy.deepcopy(base)
    with_folders(base, source)
    return base


def _ratios(target: object, problems: list[str]) -> dict[str, float]:
    """Diameter and height of the target over the diameter of the particle, from `target` or else SUBSTRATE. Adds to `problems`."""
    ratios = dict(SUBSTRATE)
    for key, value in target.items() if isinstance(target, Mapping) else [("", None)]:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if key in SUBSTRATE and is_number and 1.0 <= float(str(value)) <= 1000.0:
            ratios[key] = float(str(value))
        else:
            expected = "diameter and height of the target divided by the diameter of the particle, 1 to 1000"
            problems.append(f"target.{key}: expected {expected}")
    return ratios


def _flat(table: Mapping[str, object], above: str = "") -> Iterator[tuple[str, object]]:
    """Yield (key with dots, value) for each value in nested tables. A distribution counts as one value. above: prefix of the keys."""
    for key, value in table.items():
        name = above + key if above else SHORT.get(key, key)
        inner = value if isinstance(value, Mapping) else {}
        is_law = any(keys[0] in inner and not isinstance(inner[keys[0]], Mapping) for keys in KINDS.values())
        if isinstance(value, Mapping) and not is_law:
            yield from _flat(value, f"{name}.")
        else:
            yield name, value


def _points(points: object, source: str) -> list[Settings]:
    """The settings of each point, from a list of tables, or from all combinations of a table of lists. Raises SceneError."""
    if isinstance(points, list):
        if not all(isinstance(point, Mapping) for point in points):
            raise SceneError(["points: expected tables [[points]], each with keys of the scene"], source)
        return [dict(_flat(point)) for point in points]
    if not isinstance(points, Mapping):
        raise SceneError(["points: expected a table [points] with a list of values for each key"], source)
    axes, problems = dict[str, list[object]](), list[str]()
    for key, values in _flat(points):
        listed = [values] if isinstance(values, str) else values
        if not isinstance(listed, list) or not listed:
            problems.append(f'points.{key}: expected a list, such as ["400 m/s", "600 m/s"]')
        else:
            axes[key] = [value for k, value in enumerate(listed) if value not in listed[:k]]
    count = math.prod(map(len, axes.values()))
    if count > MOST_POINTS:
        problems.append(f"points: {count} combinations; at most {MOST_POINTS} are possible")
    if problems:
        raise SceneError(problems, source)
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())] if axes else []


def _ensemble(table: object, source: str) -> list[Settings]:
    """The settings of each run of an ensemble, drawn from its distributions. Raises SceneError with all problems."""
    if not isinstance(table, Mapping):
        raise SceneError(["ensemble: expected a table [ensemble]"], source)
    limits, problems = {"runs": (1, MOST_POINTS), "seed": (0, 2**31)}, list[str]()
    numbers = {"seed": 1} | {key: table[key] for key in limits if key in table}
    for key, (low, high) in limits.items():
        if not isinstance(number := numbers.get(key), int) or isinstance(number, bool) or not low <= number <= high:
            problems.append(f"ensemble.{key}: expected a whole number from {low} to {high}")
    laws: dict[str, Quantile | list[Quantile]] = {}
    for key, value in _flat({key: value for key, value in table.items() if key not in limits}):
        try:
            laws[key] = [*map(quantile_of, value)] if isinstance(value, list) else quantile_of(value)
        except ValueError as error:
            problems.append(f"ensemble.{key}: {error}")
    if problems or not laws:
        raise SceneError(problems or ["ensemble: give a distribution for a key of the scene"], source)
    # scrambled Halton sequence (Owen 2017, arXiv:1706.02808): a longer series begins with the shorter one
    count, rng = int(str(numbers["runs"])), np.random.default_rng(int(str(numbers["seed"])))
    dimensions = sum(len(law) if isinstance(law, list) else 1 for law in laws.values())
    settings = []
    for row in map(iter, stats.qmc.Halton(dimensions, scramble=True, rng=rng).random(count).tolist()):
        drawn = {
            key: [each(next(row)) for each in law] if isinstance(law, list) else law(next(row))
            for key, law in laws.items()
        }
        settings.append(drawn)
    return settings


def _with(base: Table, point: Settings, ratios: Mapping[str, float]) -> Table:
    """The scene of a point: base with its settings; `ratios` give a missing size of the target. Raises ValueError (unknown key)."""
    scene = copy.deepcopy(base)
    for key, value in point.items():
        set_key(scene, key, value)
    particles = particle_tables(scene)
    diameter = particles[0].get("diameter") if len(particles) == 1 else None
    try:
        size = units.parse(diameter, "length")
    except units.UnitError:
        return scene  # the check of the scene reports it
    for side, ratio in ratios.items():
        substrate = scene.setdefault("substrate", {})
        if isinstance(substrate, dict) and side not in substrate:
            substrate[side] = units.rounded(ratio * size, "um", 12)
    return scene


def quantile_of(table: object) -> Quantile:
    """The quantile function of a distribution: { mean, deviation }, { median, spread } (log-normal; spread: geometric standard
    deviation), { from, to } or { values = [...] }. The first two may have limits `smallest` and `largest`. Raises ValueError."""
    table = table if isinstance(table, Mapping) else {}
    kind = next((k for k, keys in KINDS.items() if all(key in table for key in keys)), None)
    if kind is None:
        raise ValueError(f"expected a distribution: {_EXAMPLES}")
    keys, known = KINDS[kind], (*KINDS[kind], *(LIMITS if kind in ("normal", "log-normal") else ()))
    if unknown := [key for key in table if key not in known]:
        raise ValueError(f"{unknown[0]}: unknown key; known: {', '.join(known)}")
    if kind == "choice":
        values = table["values"]
        if not isinstance(values, list) or not values:
            raise ValueError("values: expected a list")
        return lambda share: values[min(int(share * len(values)), len(values) - 1)]
    numbers = {key: _number(key, table[key]) for key in known if key in table}
    found = {unit for key, (_, unit) in numbers.items() if key != "spread"}
    dimensions = {units.dimension_of(unit) if unit else "" for unit in found}
    if len(dimensions) > 1:
        raise ValueError(f"{', '.join(numbers)} must have units of the same dimension")
    a, b = (numbers[key][0] for key in keys)
    if kind == "normal" and numbers["deviation"][1] in ("degC", "C"):
        raise ValueError("deviation: give the value in K")
    is_sound, problem = {
        "normal": (b > 0.0, "deviation must be above zero"), "uniform": (a < b, "`from` must be below `to`"),
        "log-normal": (a > 0.0 and b > 1.0, "median must be above zero and spread above 1"),
    }[kind]  # fmt: skip
    low, high = (numbers[key][0] if key in numbers else end for key, end in zip(LIMITS, (-np.inf, np.inf), strict=True))
    if not is_sound or low >= high:
        raise ValueError("smallest must be below largest" if is_sound else problem)
    law = stats.norm(a, b) if kind == "normal" else stats.uniform(a, b - a)
    if kind == "log-normal":
        law = stats.lognorm(np.log(b), scale=a)
    below, above, unit = law.cdf(low), law.cdf(high), numbers[keys[0]][1]
    if not below < above:
        raise ValueError("smallest and largest leave nothing of the distribution")

    def quantile(share: float) -> object:
        value = float(law.ppf(below + share * (above - below)))
        return units.rounded(value, unit, 6) if unit else float(f"{value:.6g}")

    return quantile


def _number(key: str, value: object) -> tuple[float, str]:
    """A number in SI and the unit in which it is given. Raises ValueError."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value), ""
    unit = value.partition(" ")[2].strip() if isinstance(value, str) else ""
    try:
        return units.parse(value, units.dimension_of(unit)), unit
    except (LookupError, ValueError):
        raise ValueError(f'{key}: expected a number, or a number with its unit, such as "600 m/s"') from None
