"""The scene: what a person asks for, read from TOML, checked as a whole, written out with its defaults.

A scene is data. Its texts are restricted to safe patterns, as some reach solvers that can run commands.
"""

import math
import re
import tomllib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from ..errors import SceneError
from ..physics import materials
from ..physics.adhesion import Adhesion
from ..physics.materials import Material
from ..plan import cost as estimates
from ..plan import effects
from .tables import SHAPES as SHAPES
from .tables import (
    AdhesionTable,
    Coating,
    Contact,
    End,
    GasConditions,
    Output,
    Particle,
    Resolution,
    Section,
    SplatTable,
    Substrate,
)
from .tables import Shape as Shape

MOST_IMPACTS = 500
_LARGEST_FILE = 1_000_000  # bytes; a scene is a page of text
_OUTPUTS_PER_CROSSING = 25.0  # written steps in D / v, of one impact ...
_OUTPUTS_IN_ALL = 1250.0  # ... and in the crossings of a long sequence together


class Scene(Section):
    """A complete scene, checked as a whole when made by `Scene.load`, `from_text` or `from_dict`."""

    name: str = Field("scene", pattern=r"^[A-Za-z0-9][A-Za-z0-9_. -]{0,63}$")
    preset: Literal["draft", "standard", "fine"] = "standard"
    effects: str | list[str] = "auto"
    particles: list[Particle] = Field(alias="particle")
    coating: Coating | None = None
    gas: GasConditions | None = None
    substrate: Substrate
    contact: Contact = Contact(friction=0.5)
    adhesion: AdhesionTable = AdhesionTable()
    splat: SplatTable = SplatTable()
    resolution: Resolution = Resolution()
    end: End = End(at="rest")
    output: Output = Output()
    materials: dict[str, dict[str, Any]] = Field(default_factory=dict)
    nozzles: dict[str, dict[str, Any]] = Field(default_factory=dict)

    @field_validator("particles", mode="before")
    @classmethod
    def _in_order(cls, value: Any) -> Any:
        if not isinstance(value, list):
            return [value]
        if not value:
            raise ValueError("needs a table [particle], or a [[particle]] for each of several impacts")
        if len(value) > MOST_IMPACTS:
            raise ValueError(f"has {len(value)} impacts; at most {MOST_IMPACTS} are possible")
        return value

    @field_validator("effects", mode="before")
    @classmethod
    def _known_effects(cls, value: Any) -> Any:
        texts = isinstance(value, list) and all(isinstance(item, str) and item for item in value)
        problems = effects.check_request(value if texts or isinstance(value, str) else "")
        if problems:
            raise ValueError("; ".join(problems))
        return value

    @classmethod
    def load(cls, path: str | Path) -> "Scene":
        """Read a scene file. Raises SceneError with every problem of it."""
        path = Path(path)
        try:
            with path.open("rb") as file:
                raw = file.read(_LARGEST_FILE + 1)
        except OSError as error:
            raise SceneError([f"cannot be read: {error.strerror}"], str(path)) from None
        if len(raw) > _LARGEST_FILE:
            raise SceneError(["is larger than 1 MB: not a scene"], str(path))
        try:
            text = raw.decode("utf-8")
        except UnicodeDecodeError:
            raise SceneError(["is not text in UTF-8: not a scene"], str(path)) from None
        return cls.from_text(text, str(path))

    @classmethod
    def from_text(cls, text: str, source: str = "scene") -> "Scene":
        """Read a scene from TOML. Raises SceneError with every problem of it.

        source: what to call it in messages; its stem is the scene's name unless the scene has one.
        """
        try:
            data = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # ValueError: also a number of thousands of digits
            raise SceneError([f"is not valid TOML: {error}"], source) from None
        return cls.from_dict(data, source)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], source: str = "scene") -> "Scene":
        """Check a scene given as nested dicts, as TOML has them. Raises SceneError with every problem."""
        from .check import checked  # there, because it needs the models above

        return checked(data, source)

    def to_toml(self) -> str:
        """The scene with its defaults written out. Reading it gives an equal scene."""
        from .check import to_toml

        return to_toml(self)

    @property
    def particle(self) -> Particle:
        """The first particle."""
        return self.particles[0]

    @property
    def labels(self) -> list[str]:
        """What messages call the particles: "particle" where there is one, else "particle[1]" and on."""
        n = len(self.particles)
        return ["particle"] if n == 1 else [f"particle[{i}]" for i in range(1, n + 1)]

    @cached_property
    def spacing(self) -> float:
        """Distance of the points, m, of all particles: the scene's own, or the preset's for the largest particle."""
        if self.resolution.spacing is not None:
            return self.resolution.spacing
        return estimates.spacing(max(p.volume for p in self.particles), estimates.PRESETS[self.preset])

    def points_of(self, particle: Particle) -> int:
        """Points of a particle, about: its volume over the cube of the spacing."""
        return round(particle.volume / self.spacing**3)

    @property
    def points(self) -> int:
        """Points of the largest particle, about."""
        return max(map(self.points_of, self.particles))

    @property
    def width(self) -> float:
        """Extent along the target of the widest particle, m."""
        return max(p.width for p in self.particles)

    @property
    def centre(self) -> tuple[float, float]:
        """Middle (x, y) of the box that holds all offsets, m."""
        xs, ys = zip(*(p.offset for p in self.particles), strict=True)
        return (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2

    @property
    def refined_radius(self) -> float:
        """Radius about `centre` of the part of the target with the smallest elements, m.

        It holds the widest particle at the farthest offset.
        """
        least = estimates.REFINED_RADIUS_OVER_DIAMETER
        middle, own = (
            self.centre,
            max(least * p.diameter + 0.5 * max(p.width - p.diameter, 0.0) for p in self.particles),
        )
        return own + max(math.dist(p.offset, middle) for p in self.particles)

    @property
    def element_size(self) -> float:
        """Smallest edge of the target's elements, m: the scene's own, or a little more than the spacing."""
        return self.resolution.element_size or estimates.ELEMENT_SIZE_OVER_SPACING * self.spacing

    def window_of(self, particle: Particle) -> float:
        """Radius (m) round an impact within which the target is computed: the scene's own; where there are many particles, one by
        the particle's size; everything where there are few."""
        if self.substrate.window is not None:
            return self.substrate.window
        if len(self.particles) < estimates.MANY:
            return math.inf
        return estimates.WINDOW_OVER_DIAMETER * particle.diameter + 0.5 * max(particle.width - particle.diameter, 0.0)

    @property
    def elements(self) -> int:
        """Elements of the target before the first impact, an estimate."""
        return estimates.elements(
            self.substrate.diameter,
            self.substrate.height,
            self.element_size,
            self.refined_radius,
            self.resolution.growth,
        )

    @property
    def splat_element_size(self) -> float:
        """Edge of the elements of splats, m: the scene's own, or the target's smallest."""
        return self.splat.element_size or self.element_size

    def splat_elements_of(self, particle: Particle) -> int:
        """Elements of a particle's splat, an estimate."""
        return estimates.splat_elements(particle.volume, self.splat_element_size)

    @property
    def adhesion_law(self) -> Adhesion:
        """The adhesion of splats. Raises SceneError for a table [adhesion] that makes no law: checked scenes have one."""
        said = self.adhesion.model_dump()
        said["kind"] = said["kind"] or ("tied" if len(self.particles) > 1 else "none")
        return Adhesion(**said)

    def gap_of(self, particle: Particle) -> float:
        """Distance of a particle's lowest point from what lies under it at the start, m; half a spacing by default."""
        return self.spacing / 2 if particle.gap is None else particle.gap

    def output_every_of(self, particle: Particle) -> float:
        """Simulated time between two written steps of an impact, s; D / v / 25 by default, more in a long sequence."""
        outputs = min(_OUTPUTS_PER_CROSSING, _OUTPUTS_IN_ALL / len(self.particles))
        return self.output.every or particle.diameter / particle.velocity / outputs

    def end_time_of(self, particle: Particle) -> float:
        """The longest an impact may take, s: the scene's time, else the flight over the gap and 3 D / v.

        For D the particle's height, where that is larger.
        """
        if self.end.time is not None:
            return self.end.time
        flight = self.gap_of(particle) / (particle.velocity * math.cos(particle.angle))
        return flight + estimates.CAP * particle.height / particle.velocity

    @property
    def end_time(self) -> float:
        """The longest all impacts together may take, s, without the pauses between them."""
        return sum(map(self.end_time_of, self.particles))

    def material(self, name: str) -> Material:
        """A material of the library, or the scene's own. Raises SceneError for a name that is neither."""
        catalogue, problems = materials.from_scene(self.materials)
        if name not in catalogue:
            problems.append(materials.unknown(name, catalogue))
        if problems:
            raise SceneError(problems, self.name)
        return catalogue[name]


def safe_name(source: str) -> str:
    """The stem of a file name, made of letters, digits, '_', '.', '-' and spaces only."""
    stem = re.sub(r"[^A-Za-z0-9_. -]", "_", Path(source).stem, flags=re.ASCII)[:64].lstrip("_. -")
    return stem or "scene"
