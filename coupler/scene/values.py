"""Kinds of values in the tables of a scene: quantities with units and limits, and the base class of the tables."""

from dataclasses import dataclass
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StrictFloat, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, core_schema

from .. import units


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

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> CoreSchema:
        def read(value: object) -> float | None:
            return None if self.auto and value == "auto" else self.read(value)

        return core_schema.no_info_plain_validator_function(read)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: object) -> JsonSchemaValue:
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

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: object) -> JsonSchemaValue:
        one, size = (q.__get_pydantic_json_schema__(schema, handler) for q in (self.of, DIAMETER))
        return {"anyOf": [one, {"type": "array", "items": {"type": "array", "items": [size, one]}}]}


DIAMETER = Quantity("um", "1 um", "200 um")
DWELL = Quantity("us", "0 s", "10 s", auto=True)
VELOCITY = Quantity("m/s", "10 m/s", "2000 m/s")
KELVIN = Quantity("K", "100 K", "5000 K")
POROSITY = Annotated[StrictFloat, Field(ge=0.0, le=0.4)]
Temperature = Annotated[float, KELVIN]
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
