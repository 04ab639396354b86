"""Numbers that follow from a scene: resolution, times, extents, estimated sizes. Everything here is a formula."""

import math
from dataclasses import dataclass
from functools import cached_property

from ..errors import SceneError
from ..physics import materials
from ..physics.adhesion import Adhesion, PairBond
from ..physics.materials import Material
from ..scene.model import SceneData
from ..scene.tables import Particle, Spray, Substrate
from ..spray.stream import Stream
from . import cost as estimates

_OUTPUTS_PER_CROSSING = 25.0  # written steps in D / v, of one impact ...
_OUTPUTS_IN_ALL = 1250.0  # ... and in the crossings of a long sequence together


@dataclass(frozen=True)
class Derived:
    """Quantities that follow from a scene."""

    scene: SceneData

    @cached_property
    def spacing(self) -> float:
        """Distance of the points, m, of all particles: the scene's own, or the preset's for the largest particle; a finer one where the
        smallest or the thinnest needs it, down to that of the finest preset."""
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
        """Points of a particle, about: its volume over the cube of the spacing."""
        return round(particle.volume / self.spacing**3)

    @property
    def points(self) -> int:
        """Points of the largest particle, about."""
        return max(map(self.points_of, self.scene.particles))

    @property
    def centre(self) -> tuple[float, float]:
        """Middle (x, y) of the box that holds all offsets, m."""
        xs, ys = zip(*(p.offset for p in self.scene.particles), strict=True)
        return (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2

    @property
    def spread(self) -> float:
        """Radius about `centre` of the disc that holds all offsets, m."""
        return max(math.dist(p.offset, self.centre) for p in self.scene.particles)

    @property
    def refined_radius(self) -> float:
        """Distance from the disc of `spread` up to which the target has the smallest elements, m: it covers the widest particle."""
        least = estimates.REFINED_RADIUS_OVER_DIAMETER
        return max(least * p.diameter + 0.5 * max(p.width - p.diameter, 0.0) for p in self.scene.particles)

    @property
    def element_size(self) -> float:
        """Smallest edge of the target's elements, m: the scene's own, or a little more than the spacing."""
        return self.scene.resolution.element_size or estimates.ELEMENT_SIZE_OVER_SPACING * self.spacing

    def window_of(self, particle: Particle) -> float:
        """Radius (m) round an impact within which the target is computed: the scene's own; where there are many particles, one by
        the particle's size; everything where there are few."""
        if self.scene.substrate.window is not None:
            return self.scene.substrate.window
        if len(self.scene.particles) < estimates.MANY:
            return math.inf
        return estimates.WINDOW_OVER_DIAMETER * particle.diameter + 0.5 * max(particle.width - particle.diameter, 0.0)

    @property
    def elements(self) -> int:
        """Elements of the target before the first impact, an estimate."""
        body, growth = self.scene.substrate, self.scene.resolution.growth
        sizes = self.element_size, self.refined_radius, growth, self.spread
        return estimates.elements(body.diameter, body.height, *sizes)

    @property
    def splat_element_size(self) -> float:
        """Edge of the elements of splats, m: the scene's own, or the target's smallest."""
        return self.scene.splat.element_size or self.element_size

    def splat_elements_of(self, particle: Particle) -> int:
        """Elements of a particle's splat, an estimate."""
        return estimates.splat_elements(particle.volume, self.splat_element_size)

    @cached_property
    def adhesion_law(self) -> Adhesion:
        """The adhesion of splats. Raises SceneError for a table [adhesion] that makes no law: checked scenes have one."""
        table = self.scene.adhesion.model_dump()
        table["pairs"] = tuple(PairBond(**pair) for pair in table.pop("pair") or ())
        if table["kind"] is None and table["criterion"] is None:
            metals = [self._catalogue[0].get(p.material) for p in self.scene.particles]
            known = all(metal is None or metal.sigma_TS is not None for metal in metals)
            table |= {"kind": "tied", "criterion": "velocity"} if known else {"kind": "none"}
        return Adhesion(**table | {"kind": table["kind"] or "tied", "criterion": table["criterion"] or "all"})

    def gap_of(self, particle: Particle) -> float:
        """Distance of a particle's lowest point from what lies under it at the start, m; half a spacing by default."""
        return self.spacing / 2 if particle.gap is None else particle.gap

    def output_every_of(self, particle: Particle) -> float:
        """Simulated time between two written steps of an impact, s: D / v / 25 by default, more in a long sequence; infinite where its
        end alone is written."""
        if self.scene.output.at == "ends":
            return math.inf
        outputs = min(_OUTPUTS_PER_CROSSING, _OUTPUTS_IN_ALL / len(self.scene.particles))
        return self.scene.output.every or particle.diameter / particle.velocity / outputs

    def usual_time_of(self, particle: Particle) -> float:
        """Time that an impact usually does not exceed, s: the scene's time, else the flight over the gap and the larger of 3 h / v and
        1.5 h / v_n. h: the particle's height; v_n: component of its velocity v towards the target."""
        if self.scene.end.time is not None:
            return self.scene.end.time
        towards = particle.velocity * math.cos(particle.angle)
        crossings = max(estimates.CAP / particle.velocity, estimates.SLIDES / towards)
        return self.gap_of(particle) / towards + particle.height * crossings

    def end_time_of(self, particle: Particle) -> float:
        """The longest an impact may take, s: the scene's time, else the usual one, or the flight and twice the time to stop. Raises
        SceneError for an unknown material."""
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
        """Each material that a particle may meet, and the highest temperature (K) at which: there it is softest."""
        hottest: dict[str, float] = {}
        bodies: list[Particle | Substrate] = [self.scene.substrate, *self.scene.particles[:-1]]
        for body in bodies:
            hottest[body.material] = max(body.temperature, hottest.get(body.material, 0.0))
        return list(hottest.items())

    @property
    def spray(self) -> Spray:
        """The spray of the scene, or usual conditions."""
        return self.scene.spray or Spray()

    @cached_property
    def stream(self) -> Stream:
        """The stream of powder. Raises SceneError for an unknown material."""
        masses = [self.material(p.material).rho * p.volume for p in self.scene.particles]
        spray = self.spray
        mass = sum(masses) / len(masses)
        return Stream(spray.efficiency * spray.feed_rate, mass, spray.spot, spray.traverse_speed)

    @cached_property
    def time_between(self) -> float:
        """Mean time (s) between impacts on the disc that the scene's particles fall on, no smaller than a particle. Raises SceneError
        for an unknown material."""
        particles, coating = self.scene.particles, self.scene.coating
        radius = coating.radius if coating else max(math.dist(p.offset, self.centre) for p in particles)
        return self.stream.time_between(max(radius, 0.5 * max(p.width for p in particles)))

    def dwell_of(self, particle: Particle) -> float:
        """Time (s) between a particle's impact and the next: the scene's own, or as the spray has it; 0 after the last."""
        if particle.dwell is not None:
            return particle.dwell
        return 0.0 if particle is self.scene.particles[-1] else self.time_between

    @property
    def ambient(self) -> float | None:
        """Temperature (K) to which all bodies cool after the last impact; None if they do not cool."""
        return self.scene.end.ambient if self.scene.end.at == "cold" else None

    @property
    def surface_heat(self) -> tuple[float, float] | None:
        """Heat transfer coefficient (W/(m2 K)) and temperature (K) of the jet on the surface; None without heat from it."""
        h, T, gas = self.spray.heat_transfer, self.spray.gas_temperature, self.scene.gas
        T = gas.temperature if T is None and gas is not None else T
        return (h, T) if h and T is not None else None

    @cached_property
    def _catalogue(self) -> tuple[dict[str, Material], list[str]]:
        used = {self.scene.substrate.material, *(particle.material for particle in self.scene.particles)}
        return materials.from_scene(self.scene.materials, self.scene.strength or "", used)

    def material(self, name: str) -> Material:
        """A material of the library, or the scene's own. Raises SceneError for a name that is neither."""
        catalogue, problems = self._catalogue
        if name not in catalogue:
            raise SceneError([*problems, materials.unknown(name, catalogue)], self.scene.name)
        if problems:
            raise SceneError(problems, self.scene.name)
        return catalogue[name]
