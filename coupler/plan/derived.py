"""Numbers that follow from a scene by formulas: resolution, times, dimensions, estimated sizes."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

from ..errors import SceneError
from ..physics import materials
from ..physics.adhesion import Adhesion, PairBond
from ..physics.materials import Material
from ..scene.model import SceneData
from ..scene.spray import Spray
from ..scene.tables import Particle
from . import cost as estimates
from .model import CorePlan

_OUTPUTS_PER_CROSSING = 25.0  # written steps in the time D / v of an impact, at most ...
_OUTPUTS_IN_ALL = 1250.0  # ... and over all impacts of a sequence, at most


@dataclass(frozen=True)
class Derived:
    """Numbers that follow from a scene."""

    scene: SceneData

    @cached_property
    def spacing(self) -> float:
        """Spacing of the points of all particles, m. It is given in the scene, or follows from the preset for the largest particle.
        It is finer if the smallest or thinnest particle needs this, but not finer than that of the finest preset."""
        if self.scene.resolution.spacing is not None:
            return self.scene.resolution.spacing
        particles = self.scene.particles
        largest = max(p.volume for p in particles)
        needed = min(
            min(estimates.spacing(p.volume, estimates.LEAST_POINTS), p.form.thinnest / estimates.LEAST_LAYERS)
            for p in particles
        )
        finest = estimates.spacing(largest, max(estimates.PRESETS.values()))
        return min(estimates.spacing(largest, estimates.PRESETS[self.scene.preset]), max(needed, finest))

    def points_of(self, particle: Particle) -> int:
        """Approximate number of points of a particle: its volume divided by the cube of the spacing."""
        return round(particle.volume / self.spacing**3)

    @property
    def points(self) -> int:
        """Approximate number of points of the largest particle."""
        return max(map(self.points_of, self.scene.particles))

    @property
    def centre(self) -> tuple[float, float]:
        """Middle (x, y) of the range of all offsets, m."""
        xs, ys = zip(*(p.offset for p in self.scene.particles), strict=True)
        return (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2

    @property
    def spread(self) -> float:
        """Radius of the disc about `centre` that contains all offsets, m."""
        return max(math.dist(p.offset, self.centre) for p in self.scene.particles)

    @property
    def refined_radius(self) -> float:
        """Distance from the disc of radius `spread` within which the target has the smallest elements, m, for the widest particle."""
        least = estimates.REFINED_RADIUS_OVER_DIAMETER
        return max(least * p.diameter + 0.5 * (p.width - p.diameter) for p in self.scene.particles)

    @property
    def element_size(self) -> float:
        """Smallest edge of the target's elements, m: from the scene, or a factor times the spacing."""
        return self.scene.resolution.element_size or estimates.ELEMENT_SIZE_OVER_SPACING * self.spacing

    def window_of(self, particle: Particle) -> float:
        """Radius (m) around an impact within which the target is computed. It is given in the scene; otherwise it follows from the
        size of the particle if there are many particles, and is infinite if there are few."""
        if self.scene.substrate.window is not None:
            return self.scene.substrate.window
        if len(self.scene.particles) < estimates.MANY:
            return math.inf
        return estimates.WINDOW_OVER_DIAMETER * particle.diameter + 0.5 * (particle.width - particle.diameter)

    @property
    def elements(self) -> int:
        """Estimated number of elements of the target before the first impact."""
        body, growth = self.scene.substrate, self.scene.resolution.growth
        sizes = self.element_size, self.refined_radius, growth, self.spread
        return estimates.elements(body.diameter, body.height, *sizes)

    @property
    def splat_element_size(self) -> float:
        """Edge of the elements of splats, m: from the scene, or the smallest edge of the target."""
        return self.scene.splat.element_size or self.element_size

    def splat_elements_of(self, particle: Particle) -> int:
        """Estimated number of elements of the splat of a particle."""
        return estimates.splat_elements(particle.volume, self.splat_element_size)

    @cached_property
    def adhesion_law(self) -> Adhesion:
        """The law of adhesion of splats. Raises SceneError if the table [adhesion] is wrong, which
        does not occur for a checked scene."""
        table = self.scene.adhesion.model_dump()
        catalogue = self._catalogue[0]

        def named(name: str) -> str:  # a scene may have another name of the metal
            return catalogue[name].name if name in catalogue else name

        pairs = (PairBond(**pair) for pair in table.pop("pair") or ())
        table["pairs"] = tuple(replace(p, metals=(named(p.metals[0]), named(p.metals[1]))) for p in pairs)
        if table["kind"] is None and table["criterion"] is None:
            found = [catalogue.get(p.material) for p in self.scene.particles]
            metals = [metal for metal in found if metal is None or not metal.is_ceramic]
            is_tied = (
                bool(metals) and not self.is_on_polymer and all(m is None or m.sigma_TS is not None for m in metals)
            )
            table |= {"kind": "tied", "criterion": "velocity"} if is_tied else {"kind": "none"}
        return Adhesion(**table | {"kind": table["kind"] or "tied", "criterion": table["criterion"] or "all"})

    @property
    def is_on_polymer(self) -> bool:
        """Whether the substrate is a polymer."""
        ground = self._catalogue[0].get(self.scene.substrate.materials[0])
        return ground is not None and ground.is_polymer

    def gap_of(self, particle: Particle) -> float:
        """Initial distance of a particle's lowest point from the surface under it, m; by default half a spacing."""
        return self.spacing / 2 if particle.gap is None else particle.gap

    def output_every_of(self, particle: Particle) -> float:
        """Simulated time between two written steps of an impact, s: by default diameter / velocity / 25, longer in a long sequence.
        Infinite if only the end is written."""
        if self.scene.output.at == "ends":
            return math.inf
        return self.scene.output.every or particle.diameter / particle.velocity / self.outputs_per_crossing

    @property
    def outputs_per_crossing(self) -> float:
        """Written steps in the time D / v of an impact, by default."""
        return min(_OUTPUTS_PER_CROSSING, _OUTPUTS_IN_ALL / len(self.scene.particles))

    def usual_time_of(self, particle: Particle) -> float:
        """Usual upper limit of the time of an impact, s. It is given in the scene; otherwise it is the flight time through the gap
        plus the larger of 3 h / v and 1.5 h / v_n. h: height of the particle; v_n: component of its velocity v towards the target."""
        if self.scene.end.time is not None:
            return self.scene.end.time
        towards = particle.velocity * math.cos(particle.angle)
        crossings = max(estimates.CAP / particle.velocity, estimates.SLIDES / towards)
        return self.gap_of(particle) / towards + particle.height * crossings

    def end_time_of(self, particle: Particle) -> float:
        """Longest permitted time of an impact, s. It is given in the scene; otherwise it is the larger of `usual_time_of` and the
        flight time plus twice the stopping time. Raises SceneError for an unknown material."""
        usual = self.usual_time_of(particle)
        if self.scene.end.time is not None:
            return usual
        metal, T = self.material(particle.material), particle.temperature
        stopping = max(
            estimates.stopping_time((metal, self.material(name)), (T, T_under), particle.velocity, particle.diameter)
            for name, T_under in self._underneath
        )
        flight = self.gap_of(particle) / (particle.velocity * math.cos(particle.angle))
        return max(usual, flight + estimates.STOPS * stopping)

    @cached_property
    def _underneath(self) -> list[tuple[str, float]]:
        """The materials that a particle may hit, each with the highest temperature (K) of its bodies. At this temperature the
        material is softest."""
        hottest = dict.fromkeys(self.scene.substrate.materials, self.scene.substrate.temperature)
        for body in self.scene.particles[:-1]:
            hottest[body.material] = max(body.temperature, hottest.get(body.material, 0.0))
        return list(hottest.items())

    @property
    def spray(self) -> Spray:
        """The spray of the scene, or a spray with default conditions."""
        return self.scene.spray or Spray()

    @cached_property
    def time_between(self) -> float:
        """Mean time (s) between impacts on a disc while the spray spot covers it. The disc is that of the coating or of all offsets,
        but at least as wide as the widest particle. Raises SceneError for an unknown material."""
        particles, coating, spray = self.scene.particles, self.scene.coating, self.spray
        radius = coating.radius if coating else self.spread
        mass = sum(self.flying(p).rho * p.volume for p in particles) / len(particles)
        flux = spray.efficiency * spray.feed_rate / mass / (0.25 * math.pi * spray.spot**2)  # impacts, 1/(m2 s)
        return 1.0 / (flux * math.pi * max(radius, 0.5 * max(p.form.width(p.tilt) for p in particles)) ** 2)

    def dwell_of(self, particle: Particle) -> float:
        """Time (s) between the impact of a particle and the next impact. It is given in the scene or follows from the spray; the
        default is 0 after the last particle."""
        if particle.dwell is not None:
            return particle.dwell
        return 0.0 if particle is self.scene.particles[-1] else self.time_between

    @property
    def ambient(self) -> float | None:
        """Temperature (K) to which all bodies cool after the last impact; None: they do not cool."""
        return self.scene.end.ambient if self.scene.end.at == "cold" else None

    @property
    def surface_heat(self) -> tuple[float, float] | None:
        """Heat transfer coefficient (W/(m2 K)) and temperature (K) of the jet on the surface; None: no heat transfer."""
        h, T, gas = self.spray.heat_transfer, self.spray.gas_temperature, self.scene.gas
        T = gas.temperature if T is None and gas is not None else T
        return (h, T) if h and T is not None else None

    def core_of(self, particle: Particle) -> CorePlan | None:
        """The core of a particle, None if it has one material. Raises SceneError for an unknown material."""
        if particle.core is None:
            return None
        shell, core = (self.material(name) for name in particle.materials)
        return CorePlan(core, particle.core.share_by_volume(particle.diameter, shell.rho, core.rho))

    def flying(self, particle: Particle) -> Material:
        """The material of a particle in flight. For a composite particle it is the shell with mean density and specific heat."""
        shell, core = self.material(particle.material), self.core_of(particle)
        return shell if core is None else materials.mixed(shell, core.material, core.share)

    @cached_property
    def _catalogue(self) -> tuple[dict[str, Material], list[str]]:
        used = {*self.scene.substrate.materials, *(name for p in self.scene.particles for name in p.materials)}
        return materials.from_scene(self.scene.materials, self.scene.strength or "", used)

    def material(self, name: str) -> Material:
        """A material of the scene or of the library. Raises SceneError for an unknown name."""
        catalogue, problems = self._catalogue
        if name not in catalogue:
            raise SceneError([*problems, materials.unknown(name, catalogue)], self.scene.name)
        if problems:
            raise SceneError(problems, self.scene.name)
        return catalogue[name]
