"""The tables of a scene: their keys, units and limits. `coupler.scene.model` combines the tables."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal, TypeVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PrivateAttr,
    StrictBool,
    StrictFloat,
    StrictInt,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, core_schema

from .. import units
from ..physics import shapes as morphology
from ..physics.adhesion import Criterion, Kind

MASS_SCALING = 0.05  # of the next particle's mass, by which short elements may be heavier (`fe.inertia`)
GROWTH = 0.35  # element size gained per unit of distance outside the refined part of the target


@dataclass(frozen=True)
class Quantity:
    """A field with a unit: text in the scene, a float in SI units in the program. unit: for output; low, high: limits, as text with
    units; auto: "auto" is also a value, which becomes None."""

    unit: str
    low: str
    high: str
    auto: bool = False

    def read(self, value: object) -> float:
        """The SI value of a text in a scene. Raises units.UnitError or ValueError with the problem."""
        if value is None:
            raise units.UnitError("needs a value")
        dimension = units.dimension_of(self.unit)
        number = units.parse(value, dimension)
        low, high = units.parse(self.low, dimension), units.parse(self.high, dimension)
        if not low <= number <= high:
            raise ValueError(f"is outside {self.low} to {self.high}")
        return number

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        def read(value: object) -> float | None:
            return None if self.auto and value == "auto" else self.read(value)

        return core_schema.no_info_plain_validator_function(read)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        text = units.pattern(units.dimension_of(self.unit)) + ("|^auto$" if self.auto else "")
        return {"type": "string", "pattern": text, "description": f"{self.low} to {self.high}", "unit": self.unit}


@dataclass(frozen=True)
class BySize:
    """A quantity that depends on the particle's diameter: one text, or pairs of texts [diameter, value], linear between them.

    In the program: pairs (diameter m, value), ascending; one text becomes the pair (0.0, value). of: the quantity of the values.
    """

    of: Quantity

    def read(self, value: object) -> tuple[tuple[float, float], ...]:
        """The pairs (diameter, value) in SI units of a text or list in a scene. Raises units.UnitError or ValueError with the
        problem."""
        if not isinstance(value, list | tuple):
            return ((0.0, self.of.read(value)),)
        if not value or not all(isinstance(pair, list | tuple) and len(pair) == 2 for pair in value):
            raise ValueError('needs one value, or pairs of a diameter and a value, such as [["18 um", "610 m/s"]]')
        pairs = tuple(sorted((DIAMETER.read(size), self.of.read(number)) for size, number in value))
        if len({size for size, _ in pairs}) < len(pairs):
            raise ValueError("names a diameter twice: give one value for each diameter")
        return pairs

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        one, size = (q.__get_pydantic_json_schema__(schema, handler) for q in (self.of, DIAMETER))
        return {"anyOf": [one, {"type": "array", "items": {"type": "array", "items": [size, one]}}]}


DIAMETER = Quantity("um", "1 um", "200 um")
DWELL = Quantity("us", "0 s", "10 s", auto=True)
VELOCITY = Quantity("m/s", "10 m/s", "2000 m/s")
_GASES = {"n2": "N2", "nitrogen": "N2", "he": "He", "helium": "He", "air": "air"}
KELVIN = Quantity("K", "100 K", "5000 K")
POROSITY = Annotated[StrictFloat, Field(ge=0.0, le=0.4)]
PORE_DIAMETER = Annotated[float | None, Quantity("um", "0.1 um", "100 um")]


class Section(BaseModel):
    """Base class of the tables of a scene. Unknown keys are errors; values cannot be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


T = TypeVar("T", bound=Section)


def read_table(kind: type[T], data: object) -> tuple[T | None, list[ErrorDetails]]:
    """Read a table of texts with units. Returns (table, []), or (None, problems)."""
    try:
        return kind.model_validate(data), []
    except ValidationError as error:
        return None, error.errors(include_url=False)


def check_pores(porosity: float, pore_diameter: float | None) -> None:
    """Raises ValueError if only one of the keys of pores is given."""
    if (porosity > 0.0) != (pore_diameter is not None):
        raise ValueError('needs both porosity and pore_diameter, such as 0.1 and "5 um"; leave out both for no pores')


Offset = Annotated[float, Quantity("um", "-5000 um", "5000 um")]
Temperature = Annotated[float, KELVIN]
Face = Literal["absorbing", "free", "fixed", "half_space"]
Shape = Literal["sphere", "hollow_sphere", "oblate", "rod", "flake", "angular"]  # the shapes of coupler.physics.shapes


class Core(Section):
    """The core of a composite particle, whose shell is of the particle's material. diameter (m): of the sphere of equal volume, or
    share: mass fraction of the core, 0 to 1; give one of them."""

    material: str
    diameter: Annotated[float | None, DIAMETER] = None
    share: StrictFloat | None = Field(None, gt=0.0, lt=1.0)

    @model_validator(mode="after")
    def _has_one_size(self) -> "Core":
        if (self.diameter is None) == (self.share is None):
            raise ValueError('needs either diameter, such as "15 um", or share, its mass fraction, such as 0.6')
        return self

    def share_by_volume(self, diameter: float, shell_rho: float, core_rho: float) -> float:
        """Volume fraction of the core in a particle. diameter (m): of the particle; shell_rho, core_rho: densities, kg/m3."""
        if self.share is None:
            assert self.diameter is not None
            return (self.diameter / diameter) ** 3
        core, shell = self.share / core_rho, (1.0 - self.share) / shell_rho
        return core / (core + shell)


class Particle(Section):
    """A particle and its impact. SI units. angle (rad): impact angle from the surface normal; offset: position of the centre at the
    start.

    shape: a name of `coupler.physics.shapes`, or "file" for the closed surface in `file`; diameter: diameter of the sphere of equal
    volume; tilt (rad): rotation of the shape about y; dwell: time (s) until the next impact, None: from the spray. hardness,
    yield_strength (Pa; at most one of them): values of the powder, instead of those of the metal. porosity: volume fraction of closed
    pores of about pore_diameter (m), at places from pore_seed. core: of another material, inside a shell of `material`.
    """

    material: str
    shape: Literal[Shape, "file"] = "sphere"
    file: str | None = None
    diameter: Annotated[float, DIAMETER]
    velocity: Annotated[float, VELOCITY]
    angle: Annotated[float, Quantity("deg", "0 deg", "80 deg")] = 0.0
    tilt: Annotated[float, Quantity("deg", "-90 deg", "90 deg")] = 0.0
    temperature: Temperature = 300.0
    offset: tuple[Offset, Offset] = (0.0, 0.0)
    gap: Annotated[float | None, Quantity("um", "0 um", "200 um")] = None
    dwell: Annotated[float | None, DWELL] = None
    hardness: Annotated[float | None, Quantity("HV", "5 HV", "3000 HV")] = None
    yield_strength: Annotated[float | None, Quantity("MPa", "1 MPa", "20 GPa")] = None
    porosity: POROSITY = 0.0
    pore_diameter: PORE_DIAMETER = None
    pore_seed: StrictInt = Field(1, ge=0, le=2**31)
    core: Core | None = None
    _of_file: morphology.Form | None = PrivateAttr(None)  # of diameter 1

    @model_validator(mode="after")
    def _file_of_shape(self) -> "Particle":
        if self.shape == "file" and self.file is None:
            raise ValueError('has shape = "file": give file, such as "powder.stl"')
        if self.shape != "file" and self.file is not None:
            raise ValueError('has a file: set shape = "file", or remove file')
        return self

    @model_validator(mode="after")
    def _has_sized_pores(self) -> "Particle":
        check_pores(self.porosity, self.pore_diameter)
        if self.porosity > 0.0 and self.shape in ("hollow_sphere", "file"):
            raise ValueError(f'has no porosity with shape = "{self.shape}": a file has its pores as surfaces inside it')
        return self

    def pores(self) -> morphology.Pores | None:
        """The pores, None for a dense particle. Raises ValueError if they do not fit."""
        if self.pore_diameter is None:
            return None
        return morphology.pores(self.form, self.volume, self.porosity, self.pore_diameter, self.pore_seed)

    @property
    def materials(self) -> tuple[str, ...]:
        """Its materials: that of the surface, then that of the core."""
        return (self.material,) if self.core is None else (self.material, self.core.material)

    @property
    def volume(self) -> float:
        """Volume of the particle's metal, m^3."""
        return morphology.sphere_volume(self.diameter)

    @property
    def form(self) -> morphology.Form:
        """The shape in the size of the particle. A shape from a file is a sphere until the file is read (`coupler.plan.solids`)."""
        if self.shape == "file":
            return (self._of_file or morphology.form("sphere", 1.0)).scaled(self.diameter)
        return morphology.form(self.shape, self.diameter).scaled((1.0 - self.porosity) ** (-1.0 / 3.0))

    @property
    def width(self) -> float:
        """Larger of the two extents of the particle parallel to the target, m."""
        return self.form.width(self.tilt)

    @property
    def height(self) -> float:
        """Extent of the particle normal to the target, m, at least the diameter of the sphere of equal volume."""
        return max(self.diameter, self.form.height(self.tilt))


class GasConditions(Section):
    """Gas and nozzle of the spray. They give the velocity and temperature of particles for which the scene has no values. SI units.

    pressure, temperature: total values before the nozzle. nozzle: a name of the library or of [nozzles.NAME]. standoff: distance from
    nozzle to target. ambient: pressure outside. powder_temperature: temperature of the powder at the feed. drag: a drag law of
    `coupler.spray.flight`.
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

    @field_validator("kind", mode="before")
    @classmethod
    def _by_any_name(cls, value: object) -> object:
        return _GASES.get(value.lower(), value) if isinstance(value, str) else value


class Track(Section):
    """The motion of the spray gun over the target. SI units; the defaults are usual conditions.

    feed_rate (kg/s): feed rate of the powder; spot (m): diameter of the uniform spray spot; traverse_speed (m/s): speed of the gun.
    """

    feed_rate: Annotated[float, Quantity("g/min", "0.01 g/min", "1000 g/min")] = 0.5e-3
    spot: Annotated[float, Quantity("mm", "0.1 mm", "100 mm")] = 6e-3
    traverse_speed: Annotated[float, Quantity("mm/s", "0.1 mm/s", "10 m/s")] = 0.3


class GunPath(Track):
    """The path of the gun, lines along y. SI units.

    distribution: mass flow over the spot, "uniform", "gaussian" or the name of a .csv file. passes: number of lines, None: the gun does
    not move, and the particles have the mean rate over the spot. step: distance of two lines in x, None: all passes are on one line.
    first: x of the first line, None: the lines are centred about 0. length: length of each line, with y = 0 in its middle. angle (rad):
    angle of the gun to the surface normal, in the plane of x and z; the particles fly to +x.
    """

    distribution: str = "uniform"
    passes: StrictInt | None = Field(default=None, ge=1, le=1000)
    step: Annotated[float | None, Quantity("mm", "0.001 mm", "100 mm")] = None
    first: Annotated[float | None, Quantity("mm", "-1000 mm", "1000 mm")] = None
    length: Annotated[float, Quantity("mm", "1 mm", "10 m")] = 0.1
    angle: Annotated[float, Quantity("deg", "0 deg", "80 deg")] = 0.0

    @field_validator("step", "first")
    @classmethod
    def _of_lines(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("passes", 1) is None:
            raise ValueError("needs passes, the number of lines")
        return value

    @property
    def time_between_passes(self) -> float:
        """Time (s) from a pass at y = 0 to the next pass there."""
        return (self.length + (self.step or 0.0)) / self.traverse_speed

    @property
    def lines(self) -> tuple[float, ...]:
        """Positions x (m) of the lines, in the order of the gun."""
        count, step = self.passes or 1, self.step or 0.0
        first = -0.5 * step * (count - 1) if self.first is None else self.first
        return tuple(first + step * k for k in range(count))


class Spray(GunPath):
    """The spray, which gives the time between impacts. SI units.

    efficiency: fraction of the powder that the particles of the scene represent. heat_transfer: coefficient of the jet on the surface
    between impacts, W/(m2 K), by default none; gas_temperature (K): temperature of the jet on the surface, by default the total
    temperature of [gas].
    """

    efficiency: StrictFloat = Field(default=1.0, gt=0.0, le=1.0)
    heat_transfer: Annotated[float | None, Quantity("W/(m2 K)", "0 W/(m2 K)", "1000000 W/(m2 K)")] = None
    gas_temperature: Annotated[float | None, Quantity("K", "100 K", "2000 K")] = None


_Flank = Annotated[float, Quantity("deg", "1 deg", "89 deg")]
_Length = Annotated[float, Quantity("um", "0.1 um", "2000 um")]


class Straight(Section):
    """A straight shape of the surface through its axis. direction (rad): from x, across a groove, up a step or a slope."""

    direction: Annotated[float, Quantity("deg", "-180 deg", "180 deg")] = 0.0


class Groove(Straight):
    """width (m): at the top; depth (m); angle (rad): of the flanks to the surface."""

    width: _Length
    depth: _Length
    angle: _Flank = math.radians(45.0)


class Step(Straight):
    """height (m): of the upper surface over the lower one; angle (rad): of the flank to the surface."""

    height: _Length
    angle: _Flank = math.radians(45.0)


class Slope(Straight):
    """angle (rad): of the whole surface."""

    angle: _Flank


class HeightMap(Section):
    """Heights in a file (`coupler.plan.ground`), whose middle is put on the axis and whose mean on z = 0. unit: length (m) of one unit
    of x and y, such as the pitch of pixels; height (m): of one unit of the values, or of white over black, default `unit`."""

    file: str
    unit: Annotated[float, Quantity("um", "0.0001 um", "1 m")] = 1e-6
    height: Annotated[float | None, Quantity("um", "0.0001 um", "1 m")] = None


class Layer(Section):
    """A layer on the substrate, bonded to what is below. thickness: m."""

    material: str
    thickness: _Length


class Substrate(Section):
    """The target, a cylinder; its top face is the surface. SI units. window: radius (m) of the computed part around each impact.
    roughness: Sa (m) of the surface; roughness_length (m): its correlation length, at which the correlation is 1/e. The heights of the
    surface are the sum of roughness, groove, step, slope and height_map. layer: on its metal, the uppermost first, within `height`."""

    material: str
    diameter: Annotated[float, Quantity("um", "3 um", "5000 um")] = 200e-6
    height: Annotated[float, Quantity("um", "2 um", "5000 um")] = 100e-6
    temperature: Temperature = 300.0
    sides: Face = "absorbing"
    bottom: Face = "fixed"
    window: Annotated[float | None, Quantity("um", "1 um", "10000 um")] = None
    roughness: Annotated[float, Quantity("um", "0 um", "100 um")] = 0.0
    roughness_length: Annotated[float, Quantity("um", "1 um", "1000 um")] = 30e-6
    roughness_seed: StrictInt = Field(1, ge=0, le=2**31)
    groove: Groove | None = None
    step: Step | None = None
    slope: Slope | None = None
    height_map: HeightMap | None = None
    layer: tuple[Layer, ...] = ()

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of its metals, the uppermost first."""
        return (*(layer.material for layer in self.layer), self.material)


class Contact(Section):
    """Friction between surfaces. friction: Coulomb's coefficient."""

    friction: StrictFloat = Field(0.5, ge=0.0, le=2.0)


_Stress = Quantity("MPa", "0 MPa", "100 GPa")
_SurfaceEnergy = Quantity("J/m2", "0 J/m2", "1000000 J/m2")


class PairTable(Section):
    """Bonds between two metals: a table [[adhesion.pair]], which replaces the bonds of [adhesion] for this pair. Strengths in Pa,
    energies in J/m2."""

    metals: tuple[str, str]
    strength: Annotated[float | None, _Stress] = None
    energy: Annotated[float | None, _SurfaceEnergy] = None
    shear_strength: Annotated[float | None, _Stress] = None
    shear_energy: Annotated[float | None, _SurfaceEnergy] = None


class AdhesionTable(Section):
    """Adhesion of splats (`coupler.physics.adhesion.Adhesion`). Strengths in Pa, energies in J/m2; threshold: a pressure (Pa), a
    strain or a ratio, depending on the criterion. Without kind and criterion the kind is "tied" by "velocity", or "none" if a metal
    has no tensile strength."""

    kind: Kind | None = None
    criterion: Criterion | None = None
    threshold: float | None = None
    strength: Annotated[float | None, _Stress] = None
    energy: Annotated[float | None, _SurfaceEnergy] = None
    shear_strength: Annotated[float | None, _Stress] = None
    shear_energy: Annotated[float | None, _SurfaceEnergy] = None
    pair: tuple[PairTable, ...] | None = None

    @field_validator("threshold", mode="before")
    @classmethod
    def _as_the_criterion_wants(cls, value: object, info: ValidationInfo) -> float | None:
        if "criterion" not in info.data:  # a faulty criterion has its own message
            return None
        if info.data["criterion"] == "pressure":
            return _Stress.read(value)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f'needs a number without unit if criterion = "{info.data["criterion"]}"')
        return float(value)


class SplatTable(Section):
    """Conversion of a particle to finite elements. element_size (m): by default that of the target. mass_scaling: limit of the mass
    that is added to the elements with the shortest steps, divided by the mass of the next particle. The added mass resists only
    changes of the shape of these elements."""

    method: Literal["auto", "carried", "density"] = "auto"
    element_size: Annotated[float | None, Quantity("um", "0.01 um", "50 um")] = None
    mass_scaling: Annotated[StrictFloat, Field(ge=0.0, le=0.2)] = MASS_SCALING


class Resolution(Section):
    """Values that replace those of the preset. spacing: spacing of the points, m; element_size: smallest element size, m; growth:
    increase of the element size per unit of distance from the impact. engine: numerical scheme of the particle
    (`coupler.particle.engine`). error: whether coarser runs measure the error; None: only with `coldspray run`."""

    spacing: Annotated[float | None, Quantity("um", "0.01 um", "20 um")] = None
    element_size: Annotated[float | None, Quantity("um", "0.01 um", "50 um")] = None
    growth: Annotated[StrictFloat, Field(ge=0.02, le=1.0)] = GROWTH
    engine: Literal["compiled", "enriched", "machdyn"] = "enriched"
    error: StrictBool | None = None


class End(Section):
    """When an impact ends: at rest, at the greatest deformation, or `time` s after its start; if two keys are given, at the earlier
    time. "cold": at rest, and after the last impact all bodies cool to `ambient` (K). Default: "rest" for one particle, "cold" for
    several. cooling_time (s): duration of this cooling, for static recovery; 0: no recovery."""

    at: Literal["rest", "greatest", "cold"] | None = None
    time: Annotated[float | None, Quantity("ns", "0.01 ns", "1000000 ns")] = None
    ambient: Temperature = 300.0
    cooling_time: Annotated[float, Quantity("s", "0 s", "1000000 s")] = 0.0


class Output(Section):
    """Which fields are stored. at: all steps of each impact, or only its end; every: simulated time (s) between two stored steps."""

    at: Literal["steps", "ends"] = "steps"
    every: Annotated[float | None, Quantity("ns", "0.001 ns", "1000000 ns")] = None
