"""A job: powder, gas and substrate as a process engineer names them, and the time in which they are to be answered."""

from typing import Annotated

from pydantic import Field

from .tables import GasConditions, PowderSizes, Quantity, Section, Temperature, Track


class Powder(Section):
    """material: its metal; sizes: of its particles."""

    material: str
    sizes: PowderSizes


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
