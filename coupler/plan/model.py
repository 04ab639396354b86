"""The plan of a run as a record: impacts, target, and common decisions."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..core.arrays import Floats, Vector
from ..geometry import rough
from ..physics.adhesion import Adhesion, PairFormula
from ..physics.materials import Material
from ..physics.shapes import Pores
from ..scene.effects import Effects
from ..scene.ground import Face
from .batches import Batch, Landing, batches_of, pause_of

VERTICAL = (0.0, 0.0, 1.0)


def towards(velocity: Vector, normal: Vector) -> float:
    """Component (m/s) of a velocity opposite to the outward unit normal of a surface: positive towards the surface."""
    return -sum(v * n for v, n in zip(velocity, normal, strict=True))


@dataclass(frozen=True)
class CorePlan:
    """The core of a composite particle. share: its volume fraction."""

    material: Material
    share: float


@dataclass(frozen=True, kw_only=True)
class ImpactPlan(Landing):
    """One impact. diameter (m): diameter of the sphere of equal volume; lengths (m): extents of the shape at tilt 0; tilt (rad):
    rotation about y; file: key of the surface in `Plan.solids`, "" for other shapes. velocity (vx, vy, vz) m/s; offset (x, y) m:
    position of the centre at the start; gap (m): initial distance of the lowest point from the surface under it. spacing (m); points:
    approximate number. initial_strain: plastic strain of the powder, from its hardness. window (m): radius within which the target is
    computed, inf for all of it. Times in s: end_time: limit of the impact; expected: expected duration; dt_expected: mean step;
    rate_filter: time constant of the strain rate's average; output_every: time between written steps; dwell: time until the next
    impact. end_at: "rest", "greatest" (deformation) or "time". formula: critical velocities of the metals of the particle and of the
    body that it hits. splat_elements: estimate, 0 if a rebound is expected. can_bond: whether the particle can bond to what it hits
    (`Adhesion.joins`). pores: pores of the particle, None if it is dense. core: the core inside a shell of `material`, None if the
    particle has one material. normal: upward unit normal of the bare ground where the particle meets it (`TargetPlan.normal`)."""

    material: Material
    shape: str
    file: str
    tilt: float
    velocity: Vector
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
    can_bond: bool = True
    pores: Pores | None = None
    core: CorePlan | None = None
    normal: Vector = VERTICAL

    @property
    def materials(self) -> tuple[Material, ...]:
        """Its materials: that of the surface, then that of the core."""
        return (self.material,) if self.core is None else (self.material, self.core.material)

    @property
    def rho(self) -> float:
        """Mean density of the particle, kg/m3."""
        share = 0.0 if self.core is None else self.core.share
        return (1.0 - share) * self.material.rho + share * self.materials[-1].rho

    @property
    def wave_speed(self) -> float:
        """Highest speed of longitudinal waves in its materials, m/s."""
        return max(metal.wave_speed for metal in self.materials)

    @property
    def brittle(self) -> int | None:
        """Index of the first ceramic in `materials`; None if there is no ceramic."""
        return next((k for k, metal in enumerate(self.materials) if metal.tensile_limit is not None), None)

    @property
    def towards(self) -> float:
        """Velocity of the particle towards the ground, along its normal, m/s."""
        return towards(self.velocity, self.normal)

    @property
    def angle(self) -> float:
        """Angle of the impact from the normal of the ground, rad."""
        along = (v + self.towards * n for v, n in zip(self.velocity, self.normal, strict=True))
        return math.atan2(math.hypot(*along), self.towards)

    @property
    def velocity_ratio(self) -> float | None:
        """`towards` divided by the critical velocity of the particle's metal. None if this critical velocity is not known; infinite at
        the melting point."""
        critical = self.formula.critical
        return None if critical is None else self.towards / critical if critical else math.inf


@dataclass(frozen=True)
class TargetPlan:
    """The substrate, a cylinder. Lengths in m, temperature in K. Elements have element_size within refined_radius of the disc of
    radius `spread` about `centre` (x, y). Farther away they grow by `growth` per unit of distance, up to largest_element. sides,
    bottom: conditions of the faces. roughness: Sa (m), correlation length (m) and seed of the top face, None for a smooth face;
    ground: its other heights, None for a flat face. layers: on `material`, the uppermost first: metal and thickness (m), within
    height."""

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
    ground: rough.Ground | None = None
    layers: tuple[tuple[Material, float], ...] = ()

    @property
    def materials(self) -> tuple[Material, ...]:
        """Its materials in the order of the bodies: that of the lowest body, then those of the layers upwards."""
        return (self.material, *(metal for metal, _ in reversed(self.layers)))

    @property
    def ceramics(self) -> tuple[Material, ...]:
        """The ceramics among `materials`."""
        return tuple(metal for metal in self.materials if metal.is_ceramic)

    @property
    def is_flat(self) -> bool:
        """Whether the top face is the plane z = 0."""
        return self.ground is None and self.roughness is None

    def heights(self, at: Floats) -> Floats:
        """Heights (k,) m of the top face at points (k,2) m."""
        z = np.zeros(len(at)) if self.ground is None else self.ground.heights(at)
        return z if self.roughness is None else z + rough.heights(at, self.diameter, *self.roughness)

    def normal(self, at: tuple[float, float], radius: float, velocity: Vector, gap: float) -> Vector:
        """Upward unit normal of the top face where a sphere first touches it, as in `rough.normal_under`."""
        return VERTICAL if self.is_flat else rough.normal_under(self.heights, at, radius, velocity, gap)

    def faces(self, condition: Face) -> tuple[str, ...]:
        """Names of the faces of the substrate that have this condition."""
        return tuple(name for name, kind in (("sides", self.sides), ("bottom", self.bottom)) if kind == condition)


@dataclass(frozen=True)
class SolidPlan:
    """The surface of a shape from a file, with the data of `geometry.solid.Solid`."""

    points: list[list[float]]
    triangles: list[list[int]]


@dataclass(frozen=True)
class Decision:
    """The decision about one effect. number: name of the deciding number; value: this number; on: True means on; why: the reason."""

    name: str
    number: str
    value: float
    on: bool
    why: str


@dataclass(frozen=True)
class Plan:
    """All decisions about a run, the content of plan.json. Times in s, lengths in m.

    impacts: in their order; batches: groups of impacts that are computed in parallel. contact_stiffness: factor on the penalty
    stiffness. engine: engine of the particles (`coupler.particle.engine`). decisions: about each effect. solids: shapes from files,
    by name of the file. ambient: temperature (K) to which all bodies cool after the last impact in cooling_time (s), None: they do
    not cool. surface_heat: heat transfer coefficient (W/(m2 K)) and temperature (K) of the jet on the surface between impacts. gas,
    spray: texts about the gas and about the time between impacts. companions: points of the coarser runs that measure the error,
    empty if it is not measured. skipped: the reasons of failed impacts of the scene, which are not in `impacts`.
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
        """Whether impact i hits a coating: it is not the first impact, and its window is finite."""
        return i > 0 and math.isfinite(self.impacts[i].window)

    @property
    def has_cores(self) -> bool:
        """Whether some of the particles have a core."""
        return any(impact.core is not None for impact in self.impacts)

    def batch_from(self, first: int) -> Batch | None:
        """The batch that contains impact `first`, without the impacts before it; None after the last impact."""
        found = next((each for each in self.batches if each.stop > first), None)
        return None if found is None else replace(found, first=first, pause=self.pause_after(first, found.stop))

    def pause_after(self, first: int, stop: int) -> float:
        """Time (s) for heat to flow after the impacts first to stop - 1, if these are a batch; 0 after the last impact of the plan."""
        return pause_of(self.impacts, first, stop) if self.effects.cooling else 0.0

    def without(self, i: int, why: str) -> "Plan":
        """The plan without impact i, which is skipped. why: reason for skipping it."""
        impacts, gone = [*self.impacts[:i], *self.impacts[i + 1 :]], self.impacts[i]
        if i > 0:  # its time, and the end of the pass, remain
            before = impacts[i - 1]
            impacts[i - 1] = replace(
                before, dwell=before.dwell + gone.dwell, ends_pass=before.ends_pass or gone.ends_pass
            )
        left = batches_of(impacts, self.effects.cooling)
        return replace(self, impacts=tuple(impacts), batches=left, skipped=(*self.skipped, why))

    @property
    def impact(self) -> ImpactPlan:
        """The first impact of the plan."""
        return self.impacts[0]
