"""Adhesion: critical velocities, and the adhesion of a scene: where a splat is bonded and how strongly. SI units."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from .. import units
from ..errors import ColdsprayError, SceneError
from ..measures import REBOUNDS, STICKS, UNDECIDED
from .materials import Material

Kind = Literal["none", "tied", "cohesive"]
Criterion = Literal["all", "plastic_strain", "pressure", "velocity", "exposure"]

ROOM = 293.0  # K, at which the tensile strength of Schmidt's formula is taken
EXTRUSION = 2.0 / math.sqrt(3.0)  # pressure that brings metal through a crack, over its flow stress
# net stress of a ligament between deep cracks, over its flow stress (Prandtl)
CONSTRAINT = (2.0 + math.pi) / math.sqrt(3.0)
MECHANICAL, THERMAL = 1.2, 0.3  # Schmidt's F1 and F2
REFERENCE, EXPONENT = 25e-6, -0.18  # diameter, m, of the formula's particles; power of the diameter
# of the springs of a bonded particle, bulk moduli (of the softer metal) per spacing, as the contact's
PARTICLE_BOND_STIFFNESS = 1.0


def critical_velocity(material: Material, temperature: float, diameter: float = REFERENCE) -> float:
    """Critical velocity, m/s, of particles of `diameter` m that hit at `temperature` K, on their own kind.

        v = sqrt(F1 4 sigma_TS (1 - (T - T_R) / (T_m - T_R)) / rho + F2 cp (T_m - T)) (D / 25 um)^-0.18,   F1 = 1.2, F2 = 0.3

    Schmidt, Gaertner, Assadi & Kreye (2006), Acta Mater. 54, 729; F1 and F2 are theirs, fitted to impact tests and spray
    experiments. The power of the diameter: Assadi, Schmidt, Richter et al. (2011), J. Therm. Spray Technol. 20, 1161, whose factor
    k1 = 0.64 (D / 10 um)^-0.18 is that of Schmidt's formula at 25 um. sigma_TS is that of the bulk metal. Raises ColdsprayError where
    the material has none.
    """
    if material.sigma_TS is None:
        raise ColdsprayError(
            f"{material.name} has no sigma_TS (tensile strength), which its critical velocity needs: "
            f'give it under [materials.{material.name}], as in sigma_TS = "400 MPa"'
        )
    T, T_m = temperature, material.T_m
    softening = max(1.0 - (T - ROOM) / (T_m - ROOM), 0.0)
    mechanical = MECHANICAL * 4.0 * material.sigma_TS * softening / material.rho
    thermal = THERMAL * material.cp_at(T) * max(T_m - T, 0.0)
    return math.sqrt(mechanical + thermal) * (diameter / REFERENCE) ** EXPONENT


@dataclass(frozen=True)
class PairFormula:
    """Schmidt's formula for a particle on a metal. It is fitted to particles on their own kind, so that it is evaluated for both
    metals, at the particle's temperature and diameter, and decides where both agree.

    metal, base: names of the particle's metal and of the metal that it hits, "" where none is named; critical, base_critical m/s: their
    critical velocities, None where a metal has no tensile strength.
    """

    metal: str
    critical: float | None
    base: str = ""
    base_critical: float | None = None

    @property
    def known(self) -> dict[str, float]:
        """Critical velocities, m/s, of the metals that have one, the particle's first."""
        return {n: v for n, v in ((self.metal, self.critical), (self.base, self.base_critical)) if v is not None}

    def verdict(self, velocity: float, threshold: float = 1.0) -> str:
        """Sticks, rebounds or undecided at a velocity (m/s) normal to the surface. threshold: factor on the critical velocities."""
        if self.critical is None:
            return UNDECIDED
        reached = {velocity >= threshold * critical for critical in self.known.values()}
        return UNDECIDED if len(reached) > 1 else STICKS if True in reached else REBOUNDS

    def margin(self, velocity: float, threshold: float = 1.0) -> float | None:
        """Velocity above the highest critical one where it sticks, negative below the lowest where it rebounds; None: undecided."""
        verdict, limits = self.verdict(velocity, threshold), [threshold * v for v in self.known.values()]
        return None if verdict == UNDECIDED else velocity - (max(limits) if verdict == STICKS else min(limits))

    def words(self, velocity: float | None = None, threshold: float = 1.0) -> str:
        """The formula in a sentence, without its verdict: what it considers, the velocity (m/s) and the critical ones."""
        if self.critical is None:
            return f"no formula: {self.metal} has no tensile strength (sigma_TS)"
        head = "Schmidt's formula"
        if self.base_critical is None:
            why = f"{self.base} has no sigma_TS" if self.base else "none is named"
            head = f"{head} of the particle's metal; the substrate is not considered ({why})"
        limits = " and ".join(f"{threshold * v:.0f} m/s ({name})" for name, v in self.known.items())
        speed = f"{velocity:.0f} m/s normal to the surface, " if velocity is not None else ""
        disagree = ": the two metals disagree"
        split = velocity is not None and self.verdict(velocity, threshold) == UNDECIDED
        return f"{head}: {speed}critical {limits}{disagree if split else ''}"


def pair_formula(particle: Material, base: Material | None, temperature: float, diameter: float) -> PairFormula:
    """The formula for a particle of `temperature` K and `diameter` m on a metal, or on one that is not named."""
    first, second = (
        critical_velocity(metal, temperature, diameter) if metal is not None and metal.sigma_TS is not None else None
        for metal in (particle, base)
    )
    return PairFormula(particle.name, first, base.name if base is not None else "", second)


def clean_share(exposure: np.ndarray, threshold: float | np.ndarray) -> np.ndarray:
    """Share of a surface that is clean metal between the fragments of its film: c = (Y - Y') / (1 - Y'), Y = 1 - A_0 / A.

    The brittle film stretches with the metal to the exposure Y' (threshold), cracks, and stretches no further. exposure Y (n,).
    """
    return np.clip((exposure - threshold) / (1.0 - threshold), 0.0, 1.0)


def sound_fraction(clean: np.ndarray, pressure: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Share (n,) of an interface at which clean metal comes to clean metal: the film theory of cold pressure welding.

        f = c min((p - p_E) / sigma_0, 1),   p_E = 2 sigma_0 / sqrt(3)

    Metal comes through the cracks under a pressure above p_E and meets what lies opposite, of which a share is clean metal too
    (`ligament_bonds`). clean c (n,): `clean_share`, of the two surfaces the smaller; pressure p, strength sigma_0 (n,) Pa: flow
    stress of the softer metal. Bay (1979), J. Eng. Ind. 101, 121, and (1983), Weld. J. 62, 137-s: a strength that grows with surface
    exposure and normal pressure; the linear form is quoted at second hand. p_E is the least value that plasticity allows, plane
    strain yield below a crack free of traction; Bay's is from slip lines.
    """
    return clean * np.clip(pressure / np.maximum(strength, 1.0) - EXTRUSION, 0.0, 1.0)  # molten metal has no strength


def ligament_width(clean: np.ndarray, film_force: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Width w (n,) m of the clean metal between two fragments of the film.

        w = L c / (1 - c),   L = 3/2 h sigma_f / k,   k = sigma_0 / sqrt(3)

    L: mean length of the fragments, where the shear flow stress k of the metal loads a film of thickness h and strength sigma_f (Kelly
    & Tyson (1965), J. Mech. Phys. Solids 13, 329: between L_c / 2 and L_c = 2 h sigma_f / k). clean c (n,); film_force h sigma_f
    (n,) N/m; strength sigma_0 (n,) Pa.
    """
    return 1.5 * film_force * math.sqrt(3.0) / strength * clean / (1.0 - clean)


def oxide_film(first: Material, second: Material) -> tuple[float, float]:
    """The film between two metals: exposure at which both surfaces have cracked, and strength times thickness (N/m) of the film that
    breaks into the smaller fragments. Raises ColdsprayError where a metal has no data of its film."""
    for metal in (first, second):
        if None in (metal.oxide_thickness, metal.oxide_strength, metal.oxide_threshold):
            raise ColdsprayError(
                f"{metal.name} has no oxide film: give oxide_thickness, oxide_strength and oxide_threshold under"
                f" [materials.{metal.name}]"
            )
    forces = [(metal.oxide_thickness or 0.0) * (metal.oxide_strength or 0.0) for metal in (first, second)]
    return max(first.oxide_threshold or 0.0, second.oxide_threshold or 0.0), min(forces)


def ligament_bonds(
    sound: np.ndarray, width: np.ndarray, opposite: np.ndarray, strength: np.ndarray, stiffness: float
) -> dict[str, np.ndarray]:
    """Bond laws at n places where metal has bonded through a cracked film: ligaments between its fragments, torn plastically.

        N = (2 + pi) k f c',   S = k f c',   G = N w c' / 2,   k = sigma_0 / sqrt(3)

    The films of both surfaces crack in patterns that know nothing of each other: in the mean of all positions the share c' of a strip
    of clean metal meets clean metal, and what is welded is narrower by c'. Slip under the pressure of the contact leaves the mean as it
    is. N: limit load of metal between deep cracks (Hill (1950), The Mathematical Theory of Plasticity). A ligament is gone when it has
    opened or slid by its width w (McClintock (1971), in Fracture III), so that strength falls linearly. With the half width a = w / 2
    this is G = 2.97 f c' sigma_0 a; Ashby, Blunt & Bannister (1989), Acta Metall. 37, 1847, measured 1.6 to 6.

    sound f (n,): `sound_fraction`; width w (n,) m: `ligament_width`; opposite c' (n,): share of the other surface that is clean;
    strength sigma_0 (n,) Pa; stiffness Pa/m: of the springs, whose traction is at most that at an opening of w c'. Returns the
    arguments of `contact.bond.Bond`.
    """
    welded, width = sound * opposite, width * opposite
    most = 0.999 * stiffness * width
    normal = np.minimum(CONSTRAINT * strength * welded, most)
    shear = np.minimum(strength / math.sqrt(3.0) * welded, most)
    return {
        "strength": normal, "energy": 0.5 * normal * width, "shear_strength": shear, "shear_energy": 0.5 * shear * width,
        "rewelds": np.ones_like(width),
    }  # fmt: skip


def stored_at_strength(strength: float, stiffness: float) -> float:
    """Energy (J/m2) that a cohesive spring stores at its strength (Pa), stiffness in Pa/m: a bond's fracture energy cannot be less,
    unless it is 0 (brittle)."""
    return strength**2 / (2.0 * stiffness)


@dataclass(frozen=True)
class PairBond:
    """Strengths (Pa) and energies (J/m2) of the bonds between two metals, in any order; None: the value of all metals."""

    metals: tuple[str, str]
    strength: float | None = None
    energy: float | None = None
    shear_strength: float | None = None
    shear_energy: float | None = None


LAW = ("strength", "energy", "shear_strength", "shear_energy")


@dataclass(frozen=True)
class Adhesion:
    """Adhesion of a splat to the bodies below it, decided when it joins the target.

    kind: "none" (contact and friction only), "tied" (bonded nodes never part) or "cohesive" (they part when strength and
    fracture energy are spent). strength Pa, energy J/m2: in tension; the shear ones are equal to them unless given. energy 0
    is brittle. criterion, which of the nodes in contact are bonded: "all" of them, those where the "plastic_strain" at
    the interface or the "pressure" (Pa) of contact has come to the threshold, or all or none by the "velocity" of impact over
    the critical one (threshold 1 unless given), or by "exposure" (cohesive only): the share of each place that has bonded by
    `sound_fraction`, with the law of `ligament_bonds`, from the oxide films of the metals. Thresholds of strain and pressure
    depend on the pair of metals and on the mesh, no published one is valid in general, and there is no default. pairs: laws of two
    metals in place of the law of all. Raises SceneError with every problem.
    """

    kind: Kind = "none"
    strength: float | None = None
    energy: float | None = None
    shear_strength: float | None = None
    shear_energy: float | None = None
    criterion: Criterion = "all"
    threshold: float | None = None
    pairs: tuple[PairBond, ...] = ()

    def __post_init__(self) -> None:
        problems = [
            f"{name}: {vars(self)[name]!r} is not one of {', '.join(known)}"
            for name, known in (("kind", get_args(Kind)), ("criterion", get_args(Criterion)))
            if vars(self)[name] not in known
        ]
        for name in LAW:
            value = vars(self)[name]
            if self.criterion == "exposure":
                if value is not None:
                    problems.append(
                        f'{name} has no effect with criterion = "exposure": it depends on metal and oxide film'
                    )
            elif self.kind == "cohesive" and value is None and name in ("strength", "energy"):
                problems.append(f'{name} is needed by kind = "cohesive"')
            elif self.kind != "cohesive" and value is not None:
                problems.append(f'{name} has no effect with kind = "{self.kind}": leave it out, or choose "cohesive"')
            elif value is not None and not (value > 0.0 or (value == 0.0 and "energy" in name)):
                problems.append(f"{name} must be positive{', or 0 for a brittle bond' if 'energy' in name else ''}")
        if self.criterion in ("plastic_strain", "pressure") and self.threshold is None:
            problems.append(f'threshold is needed by criterion = "{self.criterion}"')
        if self.criterion == "exposure" and self.kind == "tied":
            problems.append('criterion = "exposure" needs kind = "cohesive": bonds by exposure have a strength')
        if self.threshold is not None and self.criterion in ("all", "exposure"):
            problems.append(
                f'threshold has no effect with criterion = "{self.criterion}": leave it out, or choose another criterion'
            )
        if self.threshold is not None and not (self.threshold > 0.0 and math.isfinite(self.threshold)):
            problems.append("threshold must be a positive number")
        metals = [frozenset(pair.metals) for pair in self.pairs]
        if self.pairs and (self.kind != "cohesive" or self.criterion == "exposure"):
            without = f'kind = "{self.kind}"' if self.kind != "cohesive" else 'criterion = "exposure"'
            problems.append(f"pair has no effect with {without}: leave it out, or choose another")
        if len(set(metals)) < len(metals):
            problems.append("pair: two metals are named twice")
        for pair in self.pairs if not problems else ():
            try:
                self.between(*pair.metals)
            except SceneError as error:
                problems += [f"pair {' - '.join(pair.metals)}: {problem}" for problem in error.problems]
        if problems:
            raise SceneError(problems, "adhesion")

    def between(self, first: str, second: str) -> "Adhesion":
        """The adhesion of two metals: with the law of their pair, or the law of all metals."""
        for pair in self.pairs:
            if set(pair.metals) == {first, second}:
                own = {name: value for name in LAW if (value := vars(pair)[name]) is not None}
                return replace(self, pairs=(), **own)
        return self

    def bonded(
        self, nodes: int, plastic_strain: np.ndarray | None = None, pressure: np.ndarray | None = None,
        velocity_ratio: float | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Mask of the interface's nodes that are bonded, by the criterion.

        plastic_strain, pressure (nodes,): at the interface, the larger of both sides or of the history of contact as the caller sees
        fit; velocity_ratio: of the impact to the critical velocity. Raises ValueError where the value of the criterion is missing.
        """
        if self.kind == "none" or self.criterion == "all":
            return np.full(nodes, self.kind != "none")
        value = {"plastic_strain": plastic_strain, "pressure": pressure, "velocity": velocity_ratio}[self.criterion]
        if value is None:
            raise ValueError(f"the criterion {self.criterion!r} of adhesion needs a value at each node, got None")
        return np.broadcast_to(np.asarray(value) >= self.limit, (nodes,)).copy()

    @property
    def limit(self) -> float:
        """Threshold of the criterion: 1 of the velocity over the critical one unless given."""
        return 1.0 if self.threshold is None else self.threshold

    @property
    def in_impact(self) -> bool:
        """Whether bonds act during the rebound, from the greatest deformation on. True for cohesive bonds, and for tied bonds whose
        criterion is plastic strain or pressure. Otherwise bonds form when the particle is at rest."""
        return self.kind == "cohesive" or (self.kind == "tied" and self.criterion in ("plastic_strain", "pressure"))

    @property
    def words(self) -> str:
        """Text of one line that describes the law."""
        if self.kind == "none":
            return "none, contact and friction only"
        text: str = self.kind
        if self.criterion == "exposure":
            return f"{text}, by exposure and pressure, with the oxide films of the metals"
        if self.strength is not None and self.energy is not None:
            text += f", {units.rounded(self.strength, 'MPa')} and {units.rounded(self.energy, 'J/m2')}"
            shear = (self.shear_strength, "MPa"), (self.shear_energy, "J/m2")
            of_shear = " and ".join(units.rounded(value, unit) for value, unit in shear if value is not None)
            text += f" ({of_shear} in shear)" if of_shear else ""
        reached = self.limit
        where = {
            "all": "wherever they touch",
            "plastic_strain": f"where the plastic strain has reached {reached:g}",
            "pressure": f"where the pressure has reached {units.rounded(reached, 'MPa')}",
            "velocity": "where the velocity reaches "
            + (f"{reached:g} of " if reached != 1.0 else "")
            + "the critical one",
        }
        own = "".join(f"; {' on '.join(pair.metals)} by its own law" for pair in self.pairs)
        return f"{text}, {where[self.criterion]}{own}"

    def law(self) -> dict[str, float]:
        """Strengths (Pa) and energies (J/m2) for `contact.bond.Bond`; none for tied nodes, which is its default."""
        return {name: float(value) for name in LAW if (value := vars(self)[name]) is not None}

    def law_on(self, metal: str, others: Sequence[str]) -> dict[str, np.ndarray]:
        """As `law`, as arrays (n,), for n bonds of a metal to each of `others`; the same in shear as in tension unless given."""
        laws = {other: self.between(metal, other).law() for other in set(others)}
        arrays = {}
        for name in LAW:
            values = [laws[other].get(name, laws[other].get(name.removeprefix("shear_"))) for other in others]
            if None not in values:
                arrays[name] = np.array(values, float)
        return arrays
