"""The tables of a job: powders, gas and substrate in the terms of a process engineer, and the time for the computation."""

from typing import Annotated

from pydantic import Field, StrictFloat, field_validator

from .coating import Feedstock, PowderSizes, check_shares
from .ground import Substrate
from .spray import GasConditions, GunPath
from .values import Quantity, Section


class Powder(Feedstock):
    """A powder of a job. sizes: size distribution of its particles; share: its mass fraction in the feed, 0 to 1."""

    sizes: PowderSizes
    share: StrictFloat = Field(1.0, gt=0.0, le=1.0)

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of its materials: that of the surface, then that of the core."""
        return (self.material,) if self.core is None else (self.material, self.core.material)


class JobData(Section):
    """All tables of a job, SI units. within: time that the computation may take on all cores, s. powders: one table [powder], or
    tables [[powder]] of a blend. substrate: as in a scene; its diameter and height follow from the particles if it has none."""

    within: Annotated[float, Quantity("min", "1 s", "1000 h")] = 1800.0
    powders: tuple[Powder, ...] = Field(alias="powder")
    gas: GasConditions
    spray: GunPath = GunPath()
    substrate: Substrate
    materials: dict[str, dict[str, object]] = Field(default_factory=dict)
    nozzles: dict[str, dict[str, object]] = Field(default_factory=dict)

    @field_validator("powders", mode="before")
    @classmethod
    def _in_order(cls, value: object) -> object:
        return value if isinstance(value, list | tuple) else [value]

    @field_validator("powders")
    @classmethod
    def _adds_up(cls, value: tuple[Powder, ...]) -> tuple[Powder, ...]:
        check_shares([powder.share for powder in value])
        return value


class TrackSpray(GunPath):
    """The spray of a track. efficiency: a .csv file of angles of impact from the surface normal and deposition efficiencies, or a
    folder of runs at several angles; None: by the formula of the critical velocity."""

    efficiency: str | None = None


class TrackData(JobData):
    """All tables of a track: those of a job, with the source of the deposition efficiency. SI units."""

    spray: TrackSpray = TrackSpray()
