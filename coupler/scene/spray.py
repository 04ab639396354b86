"""The tables of the spray: gas and nozzle, and the motion of the gun."""

from typing import Annotated, Literal

from pydantic import Field, StrictBool, StrictFloat, StrictInt, ValidationInfo, field_validator

from .values import Quantity, Section

_GASES = {"n2": "N2", "nitrogen": "N2", "he": "He", "helium": "He", "air": "air"}


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


class GunPath(Section):
    """The motion of the spray gun over the target, on lines along y. SI units; the defaults are usual conditions.

    feed_rate (kg/s): feed rate of the powder; spot (m): diameter of the spray spot; traverse_speed (m/s): speed of the gun.
    distribution: mass flow over the spot, "uniform", "gaussian" or the name of a .csv file. passes: number of lines, None: the gun does
    not move, and particles arrive at the mean rate over the spot. step: distance of two lines in x, None: all passes are on one line.
    first: x of the first line, None: the lines are centred about 0. length: length of each line, with y = 0 in its middle. angle (rad):
    angle of the gun to the surface normal, in the plane of x and z; the particles fly to +x.
    """

    feed_rate: Annotated[float, Quantity("g/min", "0.01 g/min", "1000 g/min")] = 0.5e-3
    spot: Annotated[float, Quantity("mm", "0.1 mm", "100 mm")] = 6e-3
    traverse_speed: Annotated[float, Quantity("mm/s", "0.1 mm/s", "10 m/s")] = 0.3
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
            raise ValueError("needs the key passes (number of lines)")
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

    efficiency: share of the feed rate that the particles of the scene represent. heat_transfer: coefficient of the jet on the surface
    between impacts, W/(m2 K), by default none; gas_temperature (K): temperature of the jet on the surface, by default the total
    temperature of [gas].
    """

    efficiency: StrictFloat = Field(default=1.0, gt=0.0, le=1.0)
    heat_transfer: Annotated[float | None, Quantity("W/(m2 K)", "0 W/(m2 K)", "1000000 W/(m2 K)")] = None
    gas_temperature: Annotated[float | None, Quantity("K", "100 K", "2000 K")] = None
