"""The plan of a run as a record: each impact, the target, and what holds for all."""

import math
from dataclasses import dataclass, replace
from typing import Literal

from ..physics.adhesion import Adhesion, PairFormula
from ..physics.materials import Material
from ..scene.effects import Effects
from ..scene.tables import Face
from .batches import Batch, Landing, batches_of
from .effects import Decision


@dataclass(frozen=True, kw_only=True)
class ImpactPlan(Landing):
    """One impact. diameter m, of the sphere of equal volume; tilt rad, about y; velocity (vx, vy, vz) m/s; offset (x, y) m, of its
    centre at the start; gap m, of its lowest point above what lies under it; spacing m; points: about that many. Times in s: end_time,
    the longest it may take; expected; dt_expected, its mean step; rate_filter, the strain rate's smoothing; dwell, the time until the
    next. end_at: "rest", "greatest" (deformation) or "time"; the first two at end_time at the latest. window: radius (m) round it
    beyond which the target rests, inf where all is computed. formula: critical velocities of its metal and of the metal that it hits,
    of a splat or the substrate. lengths: m, of the shape at tilt 0. file: the key of its surface in `Plan.solids`, "" of a shape that
    is no file's. splat_elements: of its splat, an estimate; 0 where it is expected to rebound. initial_strain: plastic strain of the
    powder, from its hardness."""

    material: Material
    shape: str
    file: str
    tilt: float
    velocity: tuple[float, float, float]
    temperature: float
    gap: float
    spacing: float
    points: int
    end_time: float
    expected: float
    dt_expected: float
    rate_filter: float
    output_every: float
    end_at: Literal["rest", "greatest", "time"]
    formula: PairFormula
    lengths: tuple[float, float, float]
    splat_elements: int
    initial_strain: float

    @property
    def towards(self) -> float:
        """Velocity normal to the surface, m/s."""
        return -self.velocity[2]

    @property
    def velocity_ratio(self) -> float | None:
        """`towards` over the critical velocity of its own metal; None where that has none, infinite at its melting point."""
        critical = self.formula.critical
        return None if critical is None else self.towards / critical if critical else math.inf


@dataclass(frozen=True)
class TargetPlan:
    """A cylinder. Lengths m, temperature K; element_size within refined_radius of the disc of radius `spread` about `centre` (x, y),
    then growing by `growth` per unit of distance to largest_element. sides, bottom: "absorbing" only if that effect is on. roughness:
    Sa m, correlation length m and seed of the top, None where it is flat."""

    material: Material
    diameter: float
    height: float
    temperature: float
    sides: Face
    bottom: Face
    element_size: float
    largest_element: float
    centre: tuple[float, float]
    spread: float
    refined_radius: float
    growth: float
    elements_estimate: int
    roughness: tuple[float, float, int] | None

    def faces(self, condition: Face) -> tuple[str, ...]:
        """Names of the faces with this condition."""
        return tuple(name for name, kind in (("sides", self.sides), ("bottom", self.bottom)) if kind == condition)


@dataclass(frozen=True)
class SolidPlan:
    """The surface of a shape from a file, as `geometry.solid.Solid` has it."""

    points: list[list[float]]
    triangles: list[list[int]]


@dataclass(frozen=True)
class Plan:
    """All decisions about a run; written to plan.json. Times in s, lengths in m.

    impacts: one after another; batches: which of them are computed side by side. contact_stiffness: factor on the penalty stiffness.
    gas: lines about what the gas gives. engine: of the particles (`coupler.particle.engine`). solids: shapes from files, by the name of
    the file. ambient: temperature (K) to which all cools after the last impact in cooling_time (s), None where it does not;
    surface_heat: heat transfer coefficient (W/(m2 K)) and temperature (K) of the jet on the surface between impacts; spray: about the
    time between impacts, "" for one. decisions: about each effect. companions: points of the coarser runs that measure the error, none
    where it is not measured. skipped: impacts of the scene that have failed and are not in `impacts`, with the reason.
    """

    name: str
    impacts: tuple[ImpactPlan, ...]
    batches: tuple[Batch, ...]
    target: TargetPlan
    adhesion: Adhesion
    splat_method: str
    splat_element_size: float
    mass_scaling: float
    friction: float
    contact_stiffness: float
    effects: Effects
    decisions: tuple[Decision, ...]
    preset: str
    engine: str
    gas: tuple[str, ...]
    warnings: tuple[str, ...]
    solids: dict[str, SolidPlan]
    ambient: float | None
    cooling_time: float
    surface_heat: tuple[float, float] | None
    spray: str
    companions: tuple[int, ...] = ()
    skipped: tuple[str, ...] = ()

    def is_on_coating(self, i: int) -> bool:
        """Whether impact i is one of many, each computed on its own cut of the coating."""
        return i > 0 and math.isfinite(self.impacts[i].window)

    def batch_from(self, first: int) -> Batch | None:
        """The batch of an impact without the impacts before this one; None after the last impact."""
        return next((replace(each, first=first) for each in self.batches if each.stop > first), None)

    def without(self, i: int, why: str) -> "Plan":
        """The plan less impact i, which is skipped."""
        impacts = (*self.impacts[:i], *self.impacts[i + 1 :])
        left = batches_of(impacts, self.effects.cooling)
        return replace(self, impacts=impacts, batches=left, skipped=(*self.skipped, why))

    @property
    def impact(self) -> ImpactPlan:
        """The first impact."""
        return self.impacts[0]
