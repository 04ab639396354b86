"""Adhesion: critical velocities, and the law of adhesion of a scene, which gives the bonded area of a splat and its strength. SI
units."""

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

ROOM = 293.0  # K, temperature of the tensile strength in Schmidt's formula
EXTRUSION = 2.0 / math.sqrt(3.0)  # pressure that extrudes metal through a crack, over the flow stress
# net stress of a ligament between deep cracks, over the flow stress (Prandtl)
CONSTRAINT = (2.0 + math.pi) / math.sqrt(3.0)
MECHANICAL, THERMAL = 1.2, 0.3  # Schmidt's F1 and F2
REFERENCE, EXPONENT = 25e-6, -0.18  # diameter of the particles of the formula, m; exponent of the diameter
# stiffness (Pa/m) of the springs of a bonded particle, in units of the bulk modulus of the softer metal over the spacing of the points
PARTICLE_BOND_STIFFNESS = 1.0
NEVER = 1.0 - 1e-9  # surface exposure at which bonds to a ceramic would form: no surface reaches it


def critical_velocity(material: Material, temperature: float, diameter: float = REFERENCE) -> float:
    """Critical velocity, m/s, of particles of `diameter` m and `temperature` K on a target of the same metal.

        v = sqrt(F1 4 sigma_TS (1 - (T - T_R) / (T_m - T_R)) / rho + F2 cp (T_m - T)) (D / 25 um)^-0.18,   F1 = 1.2, F2 = 0.3

    Schmidt, Gaertner, Assadi & Kreye (2006), Acta Mater. 54, 729; they fitted F1 and F2 to impact tests and spray experiments. Exponent
    of the diameter: Assadi, Schmidt, Richter et al. (2011), J. Therm. Spray Technol. 20, 1161; their factor
    k1 = 0.64 (D / 10 um)^-0.18 agrees with Schmidt's formula at 25 um. sigma_TS: of the bulk metal at T_R = 293 K; T_m: melting
    point; cp: at T. Raises ColdsprayError for a ceramic, and if the material has no sigma_TS.
    """
    if material.is_ceramic:
        remedy = "spray it in a blend with a metal: [[powder]] of a job, or [[coating.powder]] of a scene"
        none = "it makes no metallic bond and has no critical velocity"
        raise ColdsprayError(f"{material.name} is a ceramic: {none}; {remedy}")
    if material.sigma_TS is None:
        lacks = f"{material.name} has no sigma_TS (tensile strength), which the formula of the critical velocity needs"
        raise ColdsprayError(f'{lacks}: give it under [materials.{material.name}], as in sigma_TS = "400 MPa"')
    T, T_m = temperature, material.T_m
    softening = max(1.0 - (T - ROOM) / (T_m - ROOM), 0.0)
    mechanical = MECHANICAL * 4.0 * material.sigma_TS * softening / material.rho
    thermal = THERMAL * material.cp_at(T) * max(T_m - T, 0.0)
    return math.sqrt(mechanical + thermal) * (diameter / REFERENCE) ** EXPONENT


@dataclass(frozen=True)
class PairFormula:
    """Schmidt's formula for a particle on a target. The formula is fitted to particles on a target of the same metal. Therefore it is
    evaluated for both metals, at the temperature and diameter of the particle, and is decisive if both results agree.

    metal, base: names of the metals of particle and target; base "": not given. critical, base_critical (m/s): their critical
    velocities; None: the metal is not given, is a ceramic, or its tensile strength is not known.
    """

    metal: str
    critical: float | None
    base: str = ""
    base_critical: float | None = None

    @property
    def known(self) -> dict[str, float]:
        """The critical velocities, m/s, that are known, by metal; the particle's metal comes first."""
        return {n: v for n, v in ((self.metal, self.critical), (self.base, self.base_critical)) if v is not None}

    def verdict(self, velocity: float, threshold: float = 1.0) -> str:
        """STICKS, REBOUNDS or UNDECIDED at a velocity (m/s) normal to the surface. threshold: factor by which the critical velocities
        are multiplied."""
        if self.critical is None:
            return UNDECIDED
        reached = {velocity >= threshold * critical for critical in self.known.values()}
        return UNDECIDED if len(reached) > 1 else STICKS if True in reached else REBOUNDS

    def margin(self, velocity: float, threshold: float = 1.0) -> float | None:
        """Difference, m/s, between a velocity and the critical velocities: positive above the highest one if the particle sticks,
        negative below the lowest one if it rebounds; None if the verdict is undecided."""
        verdict, limits = self.verdict(velocity, threshold), [threshold * v for v in self.known.values()]
        return None if verdict == UNDECIDED else velocity - (max(limits) if verdict == STICKS else min(limits))

    def words(self, velocity: float | None = None, threshold: float = 1.0) -> str:
        """A sentence about the formula, without its verdict: metals considered, velocity (m/s) and critical velocities."""
        if self.critical is None:
            return f"no formula: the critical velocity of {self.metal} is not known"
        head = "Schmidt's formula"
        if self.base_critical is None:
            why = f"{self.base} has no tensile strength sigma_TS" if self.base else "the scene names none"
            head = f"{head} of the particle's metal; the metal of the substrate is not considered ({why})"
        limits = " and ".join(f"{threshold * v:.0f} m/s ({name})" for name, v in self.known.items())
        speed = f"{velocity:.0f} m/s normal to the surface, " if velocity is not None else ""
        disagree = ": the results for the two metals disagree"
        split = velocity is not None and self.verdict(velocity, threshold) == UNDECIDED
        return f"{head}: {speed}critical {limits}{disagree if split else ''}"


def pair_formula(particle: Material, base: Material | None, temperature: float, diameter: float) -> PairFormula:
    """The formula for a particle of `temperature` K and `diameter` m. base: metal of the target, None if it is not given."""
    first, second = (
        None
        if metal is None or metal.sigma_TS is None or metal.is_ceramic
        else critical_velocity(metal, temperature, diameter)
        for metal in (particle, base)
    )
    return PairFormula(particle.name, first, base.name if base is not None else "", second)


def clean_share(exposure: np.ndarray, threshold: float | np.ndarray) -> np.ndarray:
    """Area fraction c (n,) of clean metal between the fragments of an oxide film: c = (Y - Y') / (1 - Y'), at least 0.

    exposure: Y = 1 - A_0 / A (n,), with the initial area A_0 of the surface and its area A. threshold: Y', at which the film cracks.
    """
    return np.clip((exposure - threshold) / (1.0 - threshold), 0.0, 1.0)


def sound_fraction(clean: np.ndarray, pressure: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Area fraction (n,) of an interface at which metal is extruded through the cracked film: film theory of cold pressure welding.

        f = c min((p - p_E) / sigma_0, 1),   p_E = 2 sigma_0 / sqrt(3)

    Metal flows through the cracks at a pressure above p_E. `ligament_bonds` multiplies f by the clean fraction of the other surface.
    clean: c (n,), `clean_share`, the smaller value of the two surfaces; pressure: p (n,) Pa; strength: sigma_0 (n,) Pa, flow stress of
    the softer metal. Bay (1979), J. Eng. Ind. 101, 121, and (1983), Weld. J. 62, 137-s: the strength grows with surface exposure and
    normal pressure; the linear form is quoted second-hand. p_E is a lower bound of plasticity theory: yield in plane strain below a
    crack without traction; Bay's value is from slip-line theory.
    """
    return clean * np.clip(pressure / np.maximum(strength, 1.0) - EXTRUSION, 0.0, 1.0)  # molten metal has no strength


def ligament_width(clean: np.ndarray, film_force: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """Width w (n,) m of the clean metal between two fragments of the film.

        w = L c / (1 - c),   L = 3/2 h sigma_f / k,   k = sigma_0 / sqrt(3)

    c: area fraction of clean metal; h, sigma_f: thickness and strength of the film; k: shear flow stress of the metal. The metal
    loads the film with this stress, and the film breaks into fragments. Their lengths are from L_c / 2 to L_c = 2 h sigma_f / k
    (Kelly & Tyson (1965), J. Mech. Phys. Solids 13, 329). L is the mean length.

    Arguments: clean: c (n,); film_force: h sigma_f (n,) N/m; strength: sigma_0 (n,) Pa.
    """
    return 1.5 * film_force * math.sqrt(3.0) / strength * clean / (1.0 - clean)


def oxide_film(first: Material, second: Material) -> tuple[float, float]:
    """The films between two metals: exposure at which both films have cracked, and strength times thickness (N/m) of the film with the
    smaller fragments. A ceramic makes no metallic bond: the exposure is NEVER. Raises ColdsprayError for a polymer or a metal without
    data of its film."""
    if first.is_ceramic or second.is_ceramic:
        return NEVER, 0.0
    for metal in (first, second):
        if metal.is_polymer:
            raise ColdsprayError(f"{metal.name} is a polymer: it has no oxide film, and no bond of metals forms on it")
        if None in (metal.oxide_thickness, metal.oxide_strength, metal.oxide_threshold):
            remedy = f"give oxide_thickness, oxide_strength and oxide_threshold under [materials.{metal.name}]"
            raise ColdsprayError(f"{metal.name} has no oxide film: {remedy}")
    forces = [(metal.oxide_thickness or 0.0) * (metal.oxide_strength or 0.0) for metal in (first, second)]
    return max(first.oxide_threshold or 0.0, second.oxide_threshold or 0.0), min(forces)


def ligament_bonds(
    sound: np.ndarray, width: np.ndarray, opposite: np.ndarray, strength: np.ndarray, stiffness: float
) -> dict[str, np.ndarray]:
    """Bond laws at n points where metals are bonded through cracked films: ligaments between the fragments, which yield and tear.

        N = (2 + pi) k f c',   S = k f c',   G = N w c' / 2,   k = sigma_0 / sqrt(3)

    The crack patterns of the two films are independent. On average, the fraction c' of a strip of clean metal is opposite to clean
    metal, and the welded width is w c'. Slip under contact pressure does not change the average. N: limit load of metal between deep
    cracks (Hill (1950), The Mathematical Theory of Plasticity); S: strength in shear; G: energy, for shear with S in place of N. A
    ligament fails at an opening or slip equal to its width w c' (McClintock (1971), in Fracture III); the strength decreases linearly.
    With the half width a = w c' / 2, G = 2.97 f c' sigma_0 a; Ashby, Blunt & Bannister (1989), Acta Metall. 37, 1847, measured factors
    of 1.6 to 6.

    sound: f (n,), `sound_fraction`; width: w (n,) m, `ligament_width`; opposite: c' (n,), clean fraction of the other surface;
    strength: sigma_0 (n,) Pa; stiffness (Pa/m) of the springs; their traction at an opening of w c' is the upper limit of N and S.
    Returns the arguments of `contact.bond.Bond`.
    """
    welded, width = sound * opposite, width * opposite
    most = 0.999 * stiffness * width
    normal = np.minimum(CONSTRAINT * strength * welded, most)
    shear = np.minimum(strength / math.sqrt(3.0) * welded, most)
    return {
        "strength": normal, "energy": 0.5 * normal * width, "shear_strength": shear, "shear_energy": 0.5 * shear * width,
        "rewelds": np.ones_like(width),
    }  # fmt: skip


@dataclass(frozen=True)
class PairBond:
    """Strengths (Pa) and energies (J/m2) of the bonds between two metals, named in any order. None: the value for all metals."""

    metals: tuple[str, str]
    strength: float | None = None
    energy: float | None = None
    shear_strength: float | None = None
    shear_energy: float | None = None


LAW = ("strength", "energy", "shear_strength", "shear_energy")


@dataclass(frozen=True)
class Adhesion:
    """Law of adhesion of a splat to the bodies below it.

    kind: "none" (contact and friction only), "tied" (bonded nodes never separate) or "cohesive" (they separate when strength and
    fracture energy are reached). strength Pa, energy J/m2: in tension; shear_strength, shear_energy: by default the values in tension.
    Energy 0: a brittle bond. criterion: which nodes in contact are bonded.
    - "all": all nodes;
    - "plastic_strain", "pressure" (Pa): nodes where the value at the interface has reached the threshold. Thresholds depend on the
      metals and on the mesh; no published value is generally valid, and there is no default;
    - "velocity": all nodes or none, by the ratio of impact velocity to critical velocity (default threshold 1);
    - "exposure" (cohesive only): each point by its `sound_fraction`, with the law of `ligament_bonds`, from the oxide films.
    pairs: laws of two metals, which replace the law for all metals. Raises SceneError with all problems.
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
            if self.criterion == "exposure" and value is None:
                continue
            if self.criterion == "exposure":
                oxides = "which uses the oxide films: remove it"
                problems.append(f'{name} has no effect with criterion = "exposure", {oxides}')
            elif self.kind == "cohesive" and value is None and name in ("strength", "energy"):
                problems.append(f'{name} is missing: it is needed with kind = "cohesive"')
            elif self.kind != "cohesive" and value is not None:
                problems.append(f'{name} has no effect with kind = "{self.kind}": leave it out, or choose "cohesive"')
            elif value is not None and not (value > 0.0 or (value == 0.0 and "energy" in name)):
                problems.append(f"{name} must be positive{', or 0 for a brittle bond' if 'energy' in name else ''}")
        if self.criterion in ("plastic_strain", "pressure") and self.threshold is None:
            problems.append(f'threshold is missing: it is needed with criterion = "{self.criterion}"')
        if self.criterion == "exposure" and self.kind != "cohesive":
            problems.append('criterion = "exposure" needs kind = "cohesive": other bonds have no strength')
        if self.threshold is not None and self.criterion in ("all", "exposure"):
            remedy = "leave it out, or choose another criterion"
            problems.append(f'threshold has no effect with criterion = "{self.criterion}": {remedy}')
        if self.threshold is not None and not (self.threshold > 0.0 and math.isfinite(self.threshold)):
            problems.append("threshold must be a positive number")
        metals = [frozenset(pair.metals) for pair in self.pairs]
        if self.pairs and (self.kind != "cohesive" or self.criterion == "exposure"):
            without = f'kind = "{self.kind}"' if self.kind != "cohesive" else 'criterion = "exposure"'
            problems.append(f"pair has no effect with {without}: remove one of them")
        if len(set(metals)) < len(metals):
            problems.append("pair: the same two metals occur twice; remove one of the tables")
        for pair in self.pairs if not problems else ():
            try:
                self.between(*pair.metals)
            except SceneError as error:
                problems += [f"pair {' - '.join(pair.metals)}: {problem}" for problem in error.problems]
        if problems:
            raise SceneError(problems, "adhesion")

    def between(self, first: str, second: str) -> "Adhesion":
        """The adhesion between two metals: the law of this pair if there is one, otherwise the law for all metals."""
        for pair in self.pairs:
            if set(pair.metals) == {first, second}:
                own = {name: value for name in LAW if (value := vars(pair)[name]) is not None}
                return replace(self, pairs=(), **own)
        return self

    def joins(self, first: Material, second: Material) -> bool:
        """Whether two materials can bond: a ceramic only by a law of the pair, all others by any law, also a polymer."""
        named = any(set(pair.metals) == {first.name, second.name} for pair in self.pairs)
        return named or not (first.is_ceramic or second.is_ceramic)

    def bonded(
        self, nodes: int, plastic_strain: np.ndarray | None = None, pressure: np.ndarray | None = None,
        velocity_ratio: float | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Mask (nodes,) of the bonded nodes of an interface, by the criterion.

        plastic_strain, pressure (nodes,): at the interface; the caller uses the larger value of both sides, or the maximum over
        time. velocity_ratio: impact velocity divided by critical velocity. The criterion needs only one of them.
        """
        if self.kind == "none" or self.criterion == "all":
            return np.full(nodes, self.kind != "none")
        value = {"plastic_strain": plastic_strain, "pressure": pressure, "velocity": velocity_ratio}[self.criterion]
        if value is None:  # a ceramic has no critical velocity
            return np.zeros(nodes, bool)
        return np.broadcast_to(np.asarray(value) >= self.limit, (nodes,)).copy()

    @property
    def limit(self) -> float:
        """Threshold of the criterion. If none is given: 1, a default that only the criterion "velocity" uses."""
        return 1.0 if self.threshold is None else self.threshold

    @property
    def in_impact(self) -> bool:
        """Whether bonds act during the rebound, from the greatest deformation on. True for cohesive bonds, and for tied bonds whose
        criterion is plastic strain or pressure. Otherwise bonds form when the particle is at rest."""
        return self.kind == "cohesive" or (self.kind == "tied" and self.criterion in ("plastic_strain", "pressure"))

    @property
    def words(self) -> str:
        """The law as one line of text."""
        if self.kind == "none":
            return "none: only contact and friction"
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
            "all": "where nodes touch",
            "plastic_strain": f"where the plastic strain has reached {reached:g}",
            "pressure": f"where the pressure has reached {units.rounded(reached, 'MPa')}",
            "velocity": f"where the velocity reaches {f'{reached:g} of ' if reached != 1.0 else ''}the critical one",
        }
        own = "".join(f"; {' on '.join(pair.metals)} by their own law" for pair in self.pairs)
        return f"{text}, {where[self.criterion]}{own}"

    def law(self) -> dict[str, float]:
        """Strengths (Pa) and energies (J/m2) as arguments of `contact.bond.Bond`; empty for tied nodes, because `Bond` is tied by
        default."""
        return {name: float(value) for name in LAW if (value := vars(self)[name]) is not None}

    def law_on(self, metal: str, others: Sequence[str]) -> dict[str, np.ndarray]:
        """Arrays (n,) of the values of `law` for n bonds of a metal to the metals `others`. Default in shear: the value in tension."""
        laws = {other: self.between(metal, other).law() for other in set(others)}
        arrays = {}
        for name in LAW:
            values = [laws[other].get(name, laws[other].get(name.removeprefix("shear_"))) for other in others]
            if None not in values:
                arrays[name] = np.array(values, float)
        return arrays
