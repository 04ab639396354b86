"""Reading and checking of a scene, including the particles of its coating and the velocities from its gas. All problems are reported
at once."""

import copy
import math
import os
import re
from collections.abc import Mapping
from functools import cached_property
from html import escape
from pathlib import Path
from typing import cast

from ..errors import SceneError
from ..files.inputs import SCENE_LIMIT, InputError, leaves, line_of, parse_toml, read_text, similar
from ..physics import materials
from ..scene.messages import covers, dotted, in_words, text_of, without
from ..scene.model import SceneData, safe_name
from ..scene.tables import Particle
from ..scene.toml import Settings, TOMLKitError, changed, completed, to_toml
from ..scene.values import Section, read_table
from .batches import Landing, side_by_side
from .check import problems_of
from .coating import STAND_IN, expand
from .derived import Derived
from .gas import fill
from .own import KINDS, with_library
from .solids import read_forms, with_folders

MOST_ALIKE = 3  # reported problems of particles that differ only in numbers
_OF_PARTICLE, _NUMBERS = re.compile(r"particle\[\d+\]"), re.compile(r"[-+]?\d[\d.e+-]*")


class Scene(SceneData):
    """A complete, checked scene. Make it with `Scene.load`, `from_text` or `from_dict`."""

    @cached_property
    def derived(self) -> Derived:
        """The numbers that follow from the scene."""
        return Derived(self)

    @cached_property
    def text(self) -> str:
        """The TOML text of the scene, "" for a scene from dicts."""
        return ""

    @cached_property
    def given(self) -> tuple[Mapping[str, object], str]:
        """The nested dicts from which the scene was read, and the name of their source, as in `from_dict`."""
        return parse_toml(self.to_toml()), self.name

    def with_(self, **changes: object) -> "Scene":
        """A new scene with some keys changed: `scene.with_(particle={"velocity": "600 m/s"}, preset="fine")`.

        Values are written as in a file. A table changes only the keys that it names; for several particles it changes each of them.
        None removes a key. A list with one table for each particle changes each particle by its own table; {} changes nothing. Any
        other list replaces the list of the scene. Raises SceneError with all problems.
        """
        data, source = self.given
        return Scene.from_dict(cast(Mapping[str, object], _merged(data, changes)), source)

    def _repr_html_(self) -> str:
        """HTML for a notebook: the text of the scene."""
        text = escape(self.text or self.to_toml())
        return f'<pre style="white-space: pre; overflow: auto; max-height: 30em">{text}</pre>'

    @classmethod
    def load(cls, path: str | Path, settings: Settings = ()) -> "Scene":
        """Read a scene file. settings: keys and values as in `--set`, which replace values of the file. Raises SceneError with all
        problems."""
        try:
            text = read_text(path, SCENE_LIMIT)
        except InputError as error:
            raise SceneError([f"the file {error.reason}{similar(path)}"], str(path)) from None
        return cls.from_text(text, str(path), settings)

    @classmethod
    def from_text(cls, text: str, source: str = "scene", settings: Settings = ()) -> "Scene":
        """Read a scene from TOML. source: its name in messages, whose stem is the default of the key `name`; settings: as in `load`.
        Raises SceneError with all problems."""
        try:
            data = parse_toml(text)
        except ValueError as error:  # also for a number of thousands of digits
            raise SceneError([f"is not valid TOML: {error}{line_of(text, str(error))}"], source) from None
        if settings:
            try:
                text = changed(text, settings)
                data = parse_toml(text)
            except ValueError as error:
                raise SceneError([str(error)], source) from None
        scene = cls.from_dict(data, source)
        vars(scene)["text"] = text  # a cached property, no field: equal scenes may have different comments
        return scene

    @classmethod
    def from_dict(cls, data: Mapping[str, object], source: str = "scene") -> "Scene":
        """Check a scene of nested dicts, as from TOML. source: as in `from_text`. Raises SceneError with all problems."""
        if "scene" in data and not {"particle", "coating"} & data.keys() and {"points", "ensemble"} & data.keys():
            raise SceneError([f"this is the file of a sweep, not of a scene: run coldspray sweep {source}"], source)
        scene = _checked(data, source)
        vars(scene)["given"] = copy.deepcopy(dict(data)), source
        return scene

    def to_toml(self) -> str:
        """The scene as TOML with its default values and the comments of its file. Reading this text gives an equal scene."""
        full = to_toml(self, lambda head, table: defaults(self, head, table))
        try:
            text = completed(self.text, full) if self.text else full
            nowhere = Path(os.devnull) / self.name  # a file with a relative name is not found there
            return text if Scene.from_text(text, str(nowhere)) == self else full
        except (TOMLKitError, SceneError, ValueError):  # a form of TOML to which keys cannot be added
            return full


def _merged(old: object, new: object) -> object:
    """A value of a scene after changes, as `Scene.with_` describes them. `old` and `new` themselves do not change."""
    if isinstance(old, list) and isinstance(new, Mapping):
        return [_merged(each, new) for each in old]
    tables = old if isinstance(old, list) else [old]
    if isinstance(new, list) and len(new) == len(tables) and all(isinstance(each, Mapping) for each in new):
        return [_merged(before, each) for before, each in zip(tables, new, strict=True)]
    if not isinstance(new, Mapping):
        return new
    kept = dict(old) if isinstance(old, Mapping) else {}
    kept |= {key: _merged(kept.get(key), value) for key, value in new.items()}
    return {key: value for key, value in kept.items() if value is not None}


def _checked(data: Mapping[str, object], source: str) -> Scene:
    """Check nested dicts and make a scene of them. source: name of the scene in messages. Raises SceneError with all problems."""
    raw = copy.deepcopy(dict(data))
    own = {name for kind in KINDS if isinstance(tables := raw.get(kind), dict) for name in tables}
    problems = with_library(raw, source)
    tables = cast(dict[str, dict[str, object]], raw["materials"])
    strength = raw.get("strength")
    used = {str(value) for key, value in leaves(raw) if key.rpartition(".")[2] == "material"}
    catalogue, material_problems = materials.from_scene(tables, strength if isinstance(strength, str) else "", used)
    raw.setdefault("name", safe_name(source))
    drawn = "coating" in raw and "particle" not in raw
    if "coating" in raw:
        problems += expand(raw, Path(source).parent, catalogue)
    stands_in = drawn and raw["particle"] == [STAND_IN]
    _set_defaults(raw)
    problems += fill(raw, catalogue)
    with_folders(raw, source)
    read, entries = read_table(Scene, raw)
    particles = raw.get("particle")
    several = isinstance(particles, list) and len(particles) > 1
    problems += [in_words(entry, several) for entry in entries]
    faulty = {dotted(entry["loc"], several) for entry in entries} | ({"particle"} if stands_in else set())
    scene = without(raw, [entry["loc"] for entry in entries]) if entries else read
    problems += material_problems
    if scene is not None:
        problems += read_forms(scene)
        absent = {f"materials.{name}" for name in tables if name not in catalogue}
        for fields, problem in problems_of(scene, catalogue, absent):
            if not any(covers(bad, field) for bad in faulty for field in fields):
                problems.append(problem)
    if problems or read is None:
        raise SceneError(_brief(problems), source)
    # the scene does not include unused tables of its library
    own |= {*read.substrate.materials, *(name for each in read.particles for name in each.materials)}
    own |= {name for pair in read.adhesion.pair or () for name in pair.metals} | (
        {read.gas.nozzle} if read.gas else set()
    )
    own |= {name for name in tables if any(catalogue[name] is catalogue[each] for each in own if each in catalogue)}
    read = read.model_copy(
        update={kind: {name: table for name, table in dict(read)[kind].items() if name in own} for kind in KINDS}
    )
    if drawn and not (read.spray and read.spray.passes):  # in an order with large batches
        places = [Landing(p.offset, Derived(read).window_of(p), p.diameter) for p in read.particles]
        return read.model_copy(update={"particles": [read.particles[i] for i in side_by_side(places)]})
    return read


def _brief(problems: list[str]) -> list[str]:
    """The problems without repetitions: of those that differ only in particle and numbers, the first MOST_ALIKE remain."""
    kinds = [_NUMBERS.sub("#", problem) if _OF_PARTICLE.match(problem) else problem for problem in problems]
    told = [p for i, p in enumerate(problems) if kinds[:i].count(kinds[i]) < MOST_ALIKE or not _OF_PARTICLE.match(p)]
    left = len(problems) - len(told)
    return [*told, f"... and {left} more problems of other particles"] if left else told


def _set_defaults(raw: dict[str, object]) -> None:
    """Set default values that depend on other keys of a scene of nested dicts: a coating is on a half-space, a run of several
    particles has a closing stage, and bonds by exposure have the spacing at which their verdicts are valid."""
    if "coating" in raw and isinstance(substrate := raw.get("substrate"), dict):
        raw["substrate"] = {"sides": "half_space", "bottom": "half_space"} | substrate
    end, particles = raw.get("end", {}), raw.get("particle")
    if isinstance(particles, list) and len(particles) > 1 and isinstance(end, dict) and not end.keys() & {"at", "time"}:
        raw["end"] = {**end, "at": "cold"}
    if isinstance(adhesion := raw.get("adhesion"), dict) and adhesion.get("criterion") == "exposure":
        raw.setdefault("preset", "fine")


def defaults(scene: SceneData, head: str, table: Section) -> dict[str, str]:
    """The default value of each field that a table does not have, with the origin of the value. head: heading of the table."""
    d = Derived(scene)
    if isinstance(table, Particle):
        several = {"dwell": f"{text_of(d.time_between, 'us')}  (from: spray)"} if len(scene.particles) > 1 else {}
        return {"gap": f"{text_of(d.gap_of(table), 'um')}  (from: half a spacing)", **several}
    first, each = scene.particle, ", of the first impact" if len(scene.particles) > 1 else ""
    every, end = d.output_every_of(first), text_of(d.end_time_of(first), "ns")
    spacing, size = f"{text_of(d.spacing, 'um')}  (from: preset)", f"{text_of(d.element_size, 'um')}  (from: spacing)"
    kind = f'"{d.adhesion_law.kind}"  (from: the critical velocity, where all metals have one)'
    share = f"diameter / velocity / {d.outputs_per_crossing:.3g}"
    often = {"every": f"{text_of(every, 'ns')}  (from: {share}{each})"} if math.isfinite(every) else {}
    return {
        "[adhesion]": {"kind": kind, "criterion": f'"{d.adhesion_law.criterion}"  (from: kind)'},
        "[splat]": {"element_size": f"{text_of(d.splat_element_size, 'um')}  (from: the target's)"},
        "[resolution]": {"spacing": spacing, "element_size": size},
        "[end]": {"time": f"{end}  (from: 3 diameter / velocity, or twice the time to stop, at most{each})"},
        "[output]": often,
    }.get(head, {})
