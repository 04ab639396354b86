"""A job: powder, gas and substrate as a process engineer names them, and the time in which they are to be answered."""

import re
from typing import Annotated

from pydantic import Field, field_validator

from ..units import UnitError
from .tables import GasConditions, Quantity, Section, Temperature, Track

_SIEVES = re.compile(r"\s*([\d.]+)\s*(?:-|–|to)\s*([\d.]+)\s*(\D\S*)\s*|\s*-\s*([\d.]+)\s*\+\s*([\d.]+)\s*(\D\S*)\s*")
_SIZE = Quantity("um", "1 um", "200 um")
FORMS = '"15-45 um" (sieves), ["18 um", "28 um", "42 um"] (D10, D50, D90 by mass) or the name of a .csv of a sizer'


class Powder(Section):
    """material: its metal; sizes: two diameters (m) of sieves, three below which 10, 50 and 90 % of the mass are, or the name of a
    file of shares of the volume by size."""

    material: str
    sizes: tuple[float, ...] | str

    @field_validator("sizes", mode="before")
    @classmethod
    def _in_any_form(cls, value: object) -> tuple[float, ...] | str:
        if isinstance(value, str) and (sieves := _SIEVES.fullmatch(value)):
            low, high, unit = sieves.group(1, 2, 3) if sieves[1] else sieves.group(5, 4, 6)
            diameters = tuple(_SIZE.read(f"{number} {unit}") for number in (low, high))
            if not diameters[0] < diameters[1]:
                raise ValueError("needs the smaller sieve first")
            return diameters
        if isinstance(value, str) and value.lower().endswith((".csv", ".txt", ".tsv")):
            return value
        if not isinstance(value, list | tuple) or len(value) != 3:
            raise ValueError(f"needs {FORMS}")
        try:
            diameters = tuple(map(_SIZE.read, value))
        except UnitError as error:
            raise ValueError(f"has a diameter that {error}") from None
        if not diameters[0] <= diameters[1] <= diameters[2]:
            raise ValueError("needs D10, D50, D90 in ascending order")
        return diameters


class Base(Section):
    """The part that is coated, as thick as need be. temperature: K, of its surface."""

    material: str
    temperature: Temperature = 300.0


class JobData(Section):
    """All tables of a job, SI units. within: time, s, in which it is to be answered, on all cores."""

    within: Annotated[float, Quantity("min", "1 s", "1000 h")] = 1800.0
    powder: Powder
    gas: GasConditions
    spray: Track = Track()
    substrate: Base
    materials: dict[str, dict[str, object]] = Field(default_factory=dict)
    nozzles: dict[str, dict[str, object]] = Field(default_factory=dict)
