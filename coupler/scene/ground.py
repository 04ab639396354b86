"""The tables of the target: its shape, its layers and its surface."""

import math
from typing import Annotated, Literal

from pydantic import Field, StrictInt

from .values import Quantity, Section, Temperature

Face = Literal["absorbing", "free", "fixed", "half_space"]
_Flank = Annotated[float, Quantity("deg", "1 deg", "89 deg")]
_Length = Annotated[float, Quantity("um", "0.1 um", "2000 um")]


class Straight(Section):
    """A shape of the surface whose height changes only in one direction; its middle is on the axis. direction (rad): angle of this
    direction from x, across a groove, or up a step or slope."""

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
    """angle (rad): of the whole surface to the plane z = 0."""

    angle: _Flank


class HeightMap(Section):
    """Heights in a file (`coupler.plan.ground`). Their middle is put on the axis, their mean on z = 0. unit: length (m) of one unit of
    x and y, such as the pitch of pixels; height (m): of one unit of the values, default `unit`; for an image, of white above black."""

    file: str
    unit: Annotated[float, Quantity("um", "0.0001 um", "1 m")] = 1e-6
    height: Annotated[float | None, Quantity("um", "0.0001 um", "1 m")] = None


class Layer(Section):
    """A layer on the substrate, bonded to what is below. thickness: m."""

    material: str
    thickness: _Length


class Substrate(Section):
    """The target, a cylinder; its top face is the surface. SI units. window: radius (m) of the computed part around each impact.
    roughness: Sa (m) of the surface; roughness_length (m): its correlation length, at which the correlation is 1/e. The heights are the
    sum of roughness, groove, step, slope and height_map. layer: layers on `material`, the uppermost first, within `height`."""

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
