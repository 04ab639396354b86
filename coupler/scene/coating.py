"""The table [coating] of a scene: powders, and the distribution of the particles. `coupler.plan.coating` draws the particles at
random."""

import math
import re
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, StrictFloat, StrictInt, WithJsonSchema, field_validator, model_validator

from .. import units
from ..physics import shapes as morphology
from .tables import Core
from .values import DIAMETER, DWELL, KELVIN, PORE_DIAMETER, POROSITY, VELOCITY, BySize, Quantity, Section, check_pores


def _read_sizes(value: object) -> tuple[float, ...] | str | None:
    """Read the sizes of a powder from a value in one of SIZE_FORMS: diameters in m, or the name of a file."""
    if value is None:
        return None
    if isinstance(value, str) and value.lower().endswith(TABLES):
        return value
    if isinstance(value, str) and (sieves := _SIEVES.fullmatch(value)):
        low, high, unit = sieves.group(1, 2, 3) if sieves[1] else sieves.group(5, 4, 6)
        value = [f"{low} {unit}", f"{high} {unit}"]
    if not isinstance(value, list | tuple) or len(value) not in (2, 3):
        raise ValueError(f"needs {SIZE_FORMS}")
    try:
        diameters = tuple(map(DIAMETER.read, value))
    except units.UnitError as error:
        raise ValueError(f"has a diameter that {error}") from None
    if len(value) == 2 and not diameters[0] < diameters[1]:
        raise ValueError("needs the smaller sieve size first")
    if sorted(diameters) != list(diameters):
        raise ValueError("needs D10, D50, D90 in ascending order")
    return diameters


MOST_PARTICLES = 500
TABLES = (".csv", ".txt", ".tsv")  # endings of the names of files with numbers
_SIEVES = re.compile(r"\s*([\d.]+)\s*(?:-|–|to)\s*([\d.]+)\s*(\D\S*)\s*|\s*-\s*([\d.]+)\s*\+\s*([\d.]+)\s*(\D\S*)\s*")
SIZE_FORMS = (
    '"15-45 um" (sieves), ["18 um", "28 um", "42 um"] (D10, D50, D90 by mass) or the name of a .csv file with sizes'
)
_TEXTS = {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 3}
#: Sizes of a powder by mass: two diameters (m) of sieves, or D10, D50 and D90 (m), or the file of a particle-size analyser.
PowderSizes = Annotated[
    tuple[float, ...] | str,
    BeforeValidator(_read_sizes),
    WithJsonSchema({"anyOf": [{"type": "string"}, _TEXTS], "description": SIZE_FORMS}),
]


class Feedstock(Section):
    """A powder as it is fed, in a coating or a job. SI units.

    sizes: by mass. shapes: fraction by number of each shape; shapes other than spheres have a random tilt. files: pattern of names of
    files with shapes, of equal frequency, instead of `shapes`. hardness, yield_strength (Pa),
    porosity, pore_diameter (m), core: as in `Particle`.
    """

    material: str
    sizes: PowderSizes | None = None
    shapes: dict[str, StrictFloat | StrictInt] = Field({"sphere": 1.0})
    files: str | None = None
    hardness: Annotated[float | None, Quantity("HV", "5 HV", "3000 HV")] = None
    yield_strength: Annotated[float | None, Quantity("MPa", "1 MPa", "20 GPa")] = None
    porosity: POROSITY = 0.0
    pore_diameter: PORE_DIAMETER = None
    core: Core | None = None

    @field_validator("shapes")
    @classmethod
    def _shares(cls, value: dict[str, float]) -> dict[str, float]:
        known = morphology.SHAPES
        if unknown := [name for name in value if name not in known]:
            raise ValueError(f"{unknown[0]!r:.20} is not one of {', '.join(known)}{units.nearest(unknown[0], known)}")
        shares = list(value.values())
        if not all(math.isfinite(share) and share >= 0.0 for share in shares) or not sum(shares) > 0.0:
            raise ValueError(
                "needs shares of zero or more, not all of them zero, such as { sphere = 0.8, oblate = 0.2 }"
            )
        return value

    @model_validator(mode="after")
    def _has_sized_pores(self) -> Self:
        if isinstance(self, Coating) and self.powder:  # each powder has its own
            return self
        if self.core is not None and self.core.share is None:
            raise ValueError("needs the share of its core, not the diameter, because its particles differ in size")
        check_pores(self.porosity, self.pore_diameter)
        if self.porosity > 0.0 and self.files:
            raise ValueError("has porosity and files: remove porosity (a file has its own pores)")
        if self.porosity > 0.0 and self.shapes.get("hollow_sphere", 0.0) > 0.0:
            raise ValueError("has porosity and hollow spheres: remove one of them")
        return self


class PowderTable(Feedstock):
    """A powder of a coating. SI units.

    diameter: median of a log-normal distribution by number; spread: its geometric standard deviation; or sizes instead of both.
    smallest, largest: limits of the diameter. velocity, temperature: one value or values by size, default from [gas]; velocity_spread
    (m/s): standard deviation, limited to two deviations.
    """

    diameter: Annotated[float | None, DIAMETER] = None
    spread: StrictFloat = Field(1.0, ge=1.0, le=3.0)
    smallest: Annotated[float | None, DIAMETER] = None
    largest: Annotated[float | None, DIAMETER] = None
    velocity: Annotated[tuple[tuple[float, float], ...] | None, BySize(VELOCITY)] = None
    velocity_spread: Annotated[float, Quantity("m/s", "0 m/s", "500 m/s")] = 0.0
    temperature: Annotated[tuple[tuple[float, float], ...] | None, BySize(KELVIN)] = None

    @model_validator(mode="after")
    def _has_one_size(self) -> Self:
        if isinstance(self, Coating) and self.powder:  # each powder has its own
            return self
        if (self.diameter is None) == (self.sizes is None):
            raise ValueError('needs either diameter (such as "22 um") or sizes (such as "15-45 um")')
        low, high = self.smallest or 0.0, self.largest or math.inf
        if not low <= (self.diameter or low) <= high:
            raise ValueError("needs values with smallest <= diameter <= largest")
        return self


class Share(PowderTable):
    """One of the powders of a blend. share: its mass fraction in the feed, 0 to 1."""

    share: StrictFloat = Field(gt=0.0, lt=1.0)


class Coating(PowderTable):
    """Random particles from a seed, instead of [[particle]] tables (`coupler.plan.coating`). SI units.

    number: number of particles, the same in each of `layers`; radius (m): radius of the disc about the axis for their centres;
    positions: "random", or "even" (far from the other positions of the pass). powder: tables [[coating.powder]] of a blend; their
    default values are those of [coating].
    """

    number: StrictInt = Field(ge=1, le=MOST_PARTICLES)
    layers: StrictInt = Field(1, ge=1, le=100)
    radius: Annotated[float, Quantity("um", "0 um", "2000 um")]
    positions: Literal["random", "even"] = "random"
    dwell: Annotated[float | None, DWELL] = None
    seed: StrictInt = Field(1, ge=0, le=2**31)
    powder: tuple[Share, ...] | None = None

    @model_validator(mode="before")
    @classmethod
    def _completes_its_powders(cls, data: object) -> object:
        if not isinstance(data, dict) or not isinstance(tables := data.get("powder"), list | tuple):
            return data
        common = {key: value for key, value in data.items() if key in PowderTable.model_fields}
        powders = [_completed(table, common) for table in tables]
        first = powders[0] if powders and isinstance(powders[0], dict) else {}
        return {key: first[key] for key in ("material",) if key in first} | data | {"powder": powders}

    @model_validator(mode="after")
    def _adds_up(self) -> Self:
        if self.powder is not None and len(self.powder) < 2:
            raise ValueError(
                "needs two tables [[coating.powder]] or more; for a single powder write its keys in [coating] instead"
            )
        if self.powder:
            check_shares([powder.share for powder in self.powder])
        if self.number % self.layers:
            raise ValueError(
                f"needs number = {self.number} to be a multiple of layers = {self.layers}: all layers have equally many particles"
            )
        return self

    @property
    def powders(self) -> tuple[PowderTable, ...]:
        """The powders of a blend, or the only one."""
        return self.powder or (self,)


def check_shares(shares: Sequence[float]) -> None:
    """Raises ValueError if the mass fractions of the powders of a blend do not add up to 1."""
    if abs((whole := math.fsum(shares)) - 1.0) > 1e-3:
        raise ValueError(f"needs values of powder.share that add up to 1: these add up to {whole:.4g}")


def _completed(table: object, common: dict[str, object]) -> object:
    """A table [[coating.powder]] whose missing keys come from [coating]. If it has diameter or sizes, it gets no diameter, spread or
    sizes from there."""
    if not isinstance(table, dict):
        return table
    sized = {"diameter", "spread", "sizes"} if {"diameter", "sizes"} & table.keys() else set()
    return {key: value for key, value in common.items() if key not in sized} | table
