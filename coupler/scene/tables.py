"""The other tables of a scene: particles, bonds and how the run is done. `coupler.scene.model` combines all tables."""

import math
from typing import Annotated, Literal

from pydantic import Field, StrictBool, StrictFloat, StrictInt, ValidationInfo, field_validator, model_validator

from ..physics import shapes as morphology
from ..physics.adhesion import Criterion, Kind
from .values import DIAMETER, DWELL, PORE_DIAMETER, POROSITY, VELOCITY, Quantity, Section, Temperature, check_pores

MASS_SCALING = 0.05  # greatest added mass of short elements over the mass of the next particle (`fe.inertia`)
GROWTH = 0.35  # element size gained per unit of distance outside the refined part of the target

Offset = Annotated[float, Quantity("um", "-5000 um", "5000 um")]
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
    _of_file: morphology.Form | None = None  # of diameter 1

    @model_validator(mode="after")
    def _has_its_file_and_sized_pores(self) -> "Particle":
        if self.shape == "file" and self.file is None:
            raise ValueError('has shape = "file": give file, such as "powder.stl"')
        if self.shape != "file" and self.file is not None:
            raise ValueError('has a file: set shape = "file", or remove file')
        check_pores(self.porosity, self.pore_diameter)
        if self.porosity > 0.0 and self.shape in ("hollow_sphere", "file"):
            raise ValueError(f'has porosity and shape = "{self.shape}": remove porosity (a file has its own pores)')
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
        """Larger of the two extents parallel to the target, m, at least the diameter of the sphere of equal volume."""
        return max(self.diameter, self.form.width(self.tilt))

    @property
    def height(self) -> float:
        """Extent of the particle normal to the target, m, at least the diameter of the sphere of equal volume."""
        return max(self.diameter, self.form.height(self.tilt))


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
    """Adhesion of splats (`coupler.physics.adhesion.Adhesion`). Strengths in Pa, energies in J/m2; threshold: a pressure (Pa), a strain
    or a ratio, depending on the criterion. Without kind and criterion the kind is "tied" and the criterion "velocity". But the kind is
    "none" on a polymer, if no particle is of metal, or if the metal of a particle has no sigma_TS."""

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
    """When an impact ends. at: "rest", "greatest" (deformation) or "cold"; time: s after its start; with both keys, at the earlier
    time. "cold": at rest, and after the last impact all bodies cool to `ambient` (K). Without both keys: "rest" for one particle,
    "cold" for several. cooling_time (s): duration of this cooling, for static recovery; 0: no recovery."""

    at: Literal["rest", "greatest", "cold"] | None = None
    time: Annotated[float | None, Quantity("ns", "0.01 ns", "1000000 ns")] = None
    ambient: Temperature = 300.0
    cooling_time: Annotated[float, Quantity("s", "0 s", "1000000 s")] = 0.0


class Output(Section):
    """Which fields are stored. at: all steps of each impact, or only its end; every: simulated time (s) between two stored steps."""

    at: Literal["steps", "ends"] = "steps"
    every: Annotated[float | None, Quantity("ns", "0.001 ns", "1000000 ns")] = None
