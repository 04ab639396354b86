"""The scene: what a person asks for, read from TOML, checked as a whole, written out with its defaults.

A scene is data. Its texts are restricted to safe patterns, as some reach solvers that can run commands.
"""

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    StrictBool,
    StrictFloat,
    field_validator,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from . import effects, estimates, materials, morphology, units
from .errors import SceneError
from .materials import Material

SHORTEST_GAP_MESSAGE = "would start the particle inside the target; give zero or more"
_LARGEST_FILE = 1_000_000  # bytes; a scene is a page of text


@dataclass(frozen=True)
class Quantity:
    """A field with a unit: text in the scene, an SI float inside. `unit` is the one it is written out in.

    low, high: limits, as text with units. below: a message of its own for a value under `low`.
    """

    unit: str
    low: str
    high: str
    below: str = ""

    def read(self, value: object) -> float:
        """SI value of a scene's text. Raises units.UnitError or ValueError with what is wrong."""
        if value is None:
            raise units.UnitError("needs a value")
        dimension = units.dimension_of(self.unit)
        number = units.parse(value, dimension)
        low, high = units.parse(self.low, dimension), units.parse(self.high, dimension)
        if self.below and number < low:
            raise ValueError(self.below)
        if not low <= number <= high:
            raise ValueError(f"is outside {self.low} to {self.high}")
        return number

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read)


class Section(BaseModel):
    """A table of the scene: no other keys than its own, and unchangeable once read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


Offset = Annotated[float, Quantity("um", "-5000 um", "5000 um")]
Temperature = Annotated[float, Quantity("K", "100 K", "5000 K")]
Face = Literal["absorbing", "free", "fixed"]
Shape = Literal["sphere", "hollow_sphere", "oblate", "rod", "flake", "angular"]  # those of coupler.morphology
SHAPES: tuple[str, ...] = get_args(Shape)


class Particle(Section):
    """The impact. SI units; `angle` (rad) from the surface normal; `offset` of the centre at the start.

    shape: a name of `coupler.morphology`; diameter: of the sphere of equal volume; tilt (rad): of the shape about y.
    """

    material: str
    shape: Shape = "sphere"
    diameter: Annotated[float, Quantity("um", "1 um", "200 um")]
    velocity: Annotated[float, Quantity("m/s", "10 m/s", "2000 m/s")]
    angle: Annotated[float, Quantity("deg", "0 deg", "80 deg")] = 0.0
    tilt: Annotated[float, Quantity("deg", "-90 deg", "90 deg")] = 0.0
    temperature: Temperature = 300.0
    offset: tuple[Offset, Offset] = (0.0, 0.0)
    gap: Annotated[float | None, Quantity("um", "0 um", "200 um", SHORTEST_GAP_MESSAGE)] = None


class GasConditions(Section):
    """The gas that brings the particle: it gives the velocity and temperature that the scene leaves out. SI units.

    pressure, temperature: total, before the nozzle. nozzle: of the library or of [nozzles.NAME]. standoff: from there to
    the target. ambient: pressure outside. powder_temperature: when fed. drag: a law of `coupler.flight`.
    """

    kind: Literal["N2", "He", "air"] = "N2"
    pressure: Annotated[float, Quantity("bar", "1 bar", "100 bar")]
    temperature: Annotated[float, Quantity("degC", "200 K", "1800 K")]
    nozzle: str
    standoff: Annotated[float, Quantity("mm", "1 mm", "500 mm")] = 30e-3
    ambient: Annotated[float, Quantity("bar", "0.001 bar", "10 bar")] = 101325.0
    powder_temperature: Annotated[float, Quantity("degC", "200 K", "1500 K")] = 293.15
    bow_shock: StrictBool = False
    drag: Literal["henderson", "carlson-hoglund"] = "henderson"


class Substrate(Section):
    """The target, a cylinder whose top is the surface. SI units."""

    material: str
    diameter: Annotated[float, Quantity("um", "3 um", "5000 um")] = 200e-6
    height: Annotated[float, Quantity("um", "2 um", "5000 um")] = 100e-6
    temperature: Temperature = 300.0
    sides: Face = "absorbing"
    bottom: Face = "fixed"


class Contact(Section):
    """friction: the Coulomb coefficient."""

    friction: StrictFloat = Field(0.5, ge=0.0, le=2.0)


class Resolution(Section):
    """Overrides of the preset. spacing of the points and smallest element size, m; growth: element size gained per unit
    of distance away from the impact."""

    spacing: Annotated[float | None, Quantity("um", "0.01 um", "20 um")] = None
    element_size: Annotated[float | None, Quantity("um", "0.01 um", "50 um")] = None
    growth: Annotated[StrictFloat, Field(ge=0.02, le=1.0)] = estimates.GROWTH


class End(Section):
    """When a run ends: at rest, at a time (s), or at whichever comes first. Rest if neither is said."""

    at: Literal["rest"] | None = None
    time: Annotated[float | None, Quantity("ns", "0.01 ns", "1000000 ns")] = None

    @model_validator(mode="before")
    @classmethod
    def _rest_unless_told(cls, data: Any) -> Any:
        return {"at": "rest"} if data == {} else data


class Output(Section):
    """every: simulated time (s) between two written steps."""

    every: Annotated[float | None, Quantity("ns", "0.001 ns", "1000000 ns")] = None


class Scene(Section):
    """A complete scene, checked as a whole when made by `Scene.load`, `from_text` or `from_dict`."""

    name: str = Field("scene", pattern=r"^[A-Za-z0-9][A-Za-z0-9_. -]{0,63}$")
    preset: Literal["draft", "standard", "fine"] = "standard"
    effects: str | list[str] = "auto"
    particles: list[Particle] = Field(alias="particle")
    gas: GasConditions | None = None
    substrate: Substrate
    contact: Contact = Contact(friction=0.5)
    resolution: Resolution = Resolution()
    end: End = End(at="rest")
    output: Output = Output()
    materials: dict[str, dict[str, Any]] = {}
    nozzles: dict[str, dict[str, Any]] = {}

    @field_validator("particles", mode="before")
    @classmethod
    def _one_particle(cls, value: Any) -> Any:
        if isinstance(value, list) and len(value) != 1:
            raise ValueError("one particle is needed: sequences of impacts are not yet supported")
        return value if isinstance(value, list) else [value]

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
        from .scene_check import checked  # there, because it needs the models above

        return checked(data, source)

    def to_toml(self) -> str:
        """The scene with its defaults written out. Reading it gives an equal scene."""
        from .scene_check import to_toml

        return to_toml(self)

    @property
    def particle(self) -> Particle:
        """The one particle."""
        return self.particles[0]

    @property
    def spacing(self) -> float:
        """Distance of the particle's points, m: the scene's own, or the preset's."""
        if self.resolution.spacing is not None:
            return self.resolution.spacing
        volume = estimates.sphere_volume(self.particle.diameter)
        return estimates.spacing(volume, estimates.PRESETS[self.preset])

    @property
    def points(self) -> int:
        """Points of the particle, about: its volume over the cube of the spacing."""
        return round(estimates.sphere_volume(self.particle.diameter) / self.spacing**3)

    @property
    def form(self) -> morphology.Form:
        """The particle's shape in its size."""
        return morphology.form(self.particle.shape, self.particle.diameter)

    @property
    def width(self) -> float:
        """The particle's extent along the target, the larger of two, m; a sphere's diameter."""
        return self.form.width(self.particle.tilt)

    @property
    def refined_radius(self) -> float:
        """Radius of the part of the target with the smallest elements, m: it grows with the particle's width."""
        D = self.particle.diameter
        return estimates.REFINED_RADIUS_OVER_DIAMETER * D + 0.5 * max(self.width - D, 0.0)

    @property
    def element_size(self) -> float:
        """Smallest edge of the target's elements, m: the scene's own, or a little more than the spacing."""
        return self.resolution.element_size or estimates.ELEMENT_SIZE_OVER_SPACING * self.spacing

    @property
    def elements(self) -> int:
        """Elements of the target, an estimate."""
        return estimates.elements(
            self.substrate.diameter,
            self.substrate.height,
            self.element_size,
            self.refined_radius,
            self.resolution.growth,
        )

    @property
    def gap(self) -> float:
        """Distance of the lowest point from the surface at the start, m; half a spacing by default."""
        return self.spacing / 2 if self.particle.gap is None else self.particle.gap

    @property
    def output_every(self) -> float:
        """Simulated time between two written steps, s; D / v / 25 by default."""
        return self.output.every or self.particle.diameter / self.particle.velocity / 25

    @property
    def end_time(self) -> float:
        """The longest a run may take, s: the scene's time, else the flight over the gap and 3 D / v.

        For D the particle's height, where that is larger.
        """
        if self.end.time is not None:
            return self.end.time
        flight = self.gap / (self.particle.velocity * math.cos(self.particle.angle))
        height = max(self.particle.diameter, self.form.height(self.particle.tilt))
        return flight + 3 * height / self.particle.velocity

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
