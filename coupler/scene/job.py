"""The tables of a job: powder, gas and substrate in the terms of a process engineer, and the time for the computation."""

from typing import Annotated

from pydantic import Field

from .coating import PowderSizes
from .spray import GasConditions, GunPath, Track
from .values import Quantity, Section, Temperature


class Powder(Section):
    """The powder of a job. material: its metal; sizes: size distribution of its particles."""

    material: str
    sizes: PowderSizes


class Base(Section):
    """The part to be coated, which counts as thick. temperature: temperature of its surface, K."""

    material: str
    temperature: Temperature = 300.0


class JobData(Section):
    """All tables of a job, SI units. within: time that the computation may take on all cores, s."""

    within: Annotated[float, Quantity("min", "1 s", "1000 h")] = 1800.0
    powder: Powder
    gas: GasConditions
    spray: Track = Track()
    substrate: Base
    materials: dict[str, dict[str, object]] = Field(default_factory=dict)
    nozzles: dict[str, dict[str, object]] = Field(default_factory=dict)


class TrackSpray(GunPath):
    """The spray of a track. efficiency: a .csv file of angles of impact from the surface normal and deposition efficiencies, or a
    folder of runs at several angles; None: by the formula of the critical velocity."""

    efficiency: str | None = None


class TrackData(JobData):
    """All tables of a track: those of a job, with the path of the gun. SI units."""

    spray: TrackSpray = TrackSpray()
