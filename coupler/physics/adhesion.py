"""Will it stick? Critical velocities, and the adhesion of a scene: where a splat is bonded and how strongly. SI units."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from .. import units
from ..errors import ColdsprayError, SceneError
from .materials import Material

Kind = Literal["none", "tied", "cohesive"]
Criterion = Literal["all", "plastic_strain", "pressure", "velocity"]

ROOM = 293.0  # K, at which the tensile strength of Schmidt's formula is taken
MECHANICAL, THERMAL = 1.2, 0.3  # Schmidt's F1 and F2
HELD_STIFFNESS = (
    1.0  # of the springs of a bonded particle, bulk moduli (of the softer metal) per spacing, as the contact's
)


def critical_velocity(material: Material, temperature: float) -> float:
    """Critical velocity, m/s, of particles of about 25 um that hit at `temperature` K, on their own kind.

        v = sqrt(F1 4 sigma_TS (1 - (T - T_R) / (T_m - T_R)) / rho + F2 cp (T_m - T)),   F1 = 1.2, F2 = 0.3

    Schmidt, Gaertner, Assadi & Kreye (2006), Acta Mater. 54, 729; F1 and F2 are theirs, fitted to impact tests and spray
    experiments. sigma_TS is that of the bulk metal. Raises ColdsprayError where the material has none.
    """
    T, T_m = temperature, material.T_m
    softening = max(1.0 - (T - ROOM) / (T_m - ROOM), 0.0)
    mechanical = MECHANICAL * 4.0 * _tensile_strength(material) * softening / material.rho
    thermal = THERMAL * material.cp_at(T) * max(T_m - T, 0.0)
    return math.sqrt(mechanical + thermal)


def critical_velocity_linear(material: Material, temperature: float) -> float:
    """Critical velocity, m/s, as the linear fit v = 667 - 14 rho + 0.08 T_m + 0.1 sigma_TS - 0.4 T to computed impacts.

    There rho is in g/cm3, temperatures in degC, sigma_TS in MPa: Assadi, Gaertner, Stoltenhoff & Kreye (2003), Acta
    Mater. 51, 4379. It was fitted for copper and for small changes about it: use it for nothing far from copper. Raises
    ColdsprayError where the material has no sigma_TS.
    """
    strength = _tensile_strength(material) * 1e-6
    T, T_m = temperature - 273.15, material.T_m - 273.15
    return 667.0 - 14.0 * material.rho * 1e-3 + 0.08 * T_m + 0.1 * strength - 0.4 * T


def _tensile_strength(material: Material) -> float:
    if material.sigma_TS is None:
        raise ColdsprayError(
            f"{material.name} has no sigma_TS (tensile strength), which its critical velocity needs: "
            f'give it under [materials.{material.name}], as in sigma_TS = "400 MPa"'
        )
    return material.sigma_TS


def stored_at_strength(strength: float, stiffness: float) -> float:
    """Energy (J/m2) that a cohesive spring holds at its strength (Pa), at a stiffness in Pa/m: a bond's fracture energy cannot be less,
    unless it is 0 (brittle)."""
    return strength**2 / (2.0 * stiffness)


@dataclass(frozen=True)
class Adhesion:
    """What holds a splat to what it lies on, decided when it joins the target.

    kind: "none" (contact and friction only), "tied" (bonded nodes never part) or "cohesive" (they part when strength and
    fracture energy are spent). strength Pa, energy J/m2: in tension; the shear ones are equal to them unless given. energy 0
    is brittle. criterion, which of the nodes in contact are bonded: "all" of them, those where the "plastic_strain" at
    the interface or the "pressure" (Pa) of contact has come to the threshold, or all or none by the "velocity" of impact over
    the critical one (threshold 1 unless given). Thresholds of strain and pressure hang on the pair of metals and on the
    mesh, no published one holds in general, and there is no default. Raises SceneError with every problem.
    """

    kind: Kind = "none"
    strength: float | None = None
    energy: float | None = None
    shear_strength: float | None = None
    shear_energy: float | None = None
    criterion: Criterion = "all"
    threshold: float | None = None

    def __post_init__(self) -> None:
        problems = [
            f"{name}: {getattr(self, name)!r} is not one of {', '.join(known)}"
            for name, known in (("kind", get_args(Kind)), ("criterion", get_args(Criterion)))
            if getattr(self, name) not in known
        ]
        law = ("strength", "energy", "shear_strength", "shear_energy")
        for name in law:
            value = getattr(self, name)
            if self.kind == "cohesive" and value is None and name in ("strength", "energy"):
                problems.append(f'{name} is needed by kind = "cohesive"')
            elif self.kind != "cohesive" and value is not None:
                problems.append(f'{name} has no effect with kind = "{self.kind}": leave it out, or choose "cohesive"')
            elif value is not None and not (value > 0.0 or (value == 0.0 and "energy" in name)):
                problems.append(f"{name} must be positive{', or 0 for a brittle bond' if 'energy' in name else ''}")
        if self.criterion in ("plastic_strain", "pressure") and self.threshold is None:
            problems.append(f'threshold is needed by criterion = "{self.criterion}"')
        if self.threshold is not None and self.criterion == "all":
            problems.append('threshold has no effect with criterion = "all": leave it out, or choose another criterion')
        if self.threshold is not None and not (self.threshold > 0.0 and math.isfinite(self.threshold)):
            problems.append("threshold must be a positive number")
        if problems:
            raise SceneError(problems, "adhesion")

    def bonded(
        self,
        nodes: int,
        plastic_strain: np.ndarray | None = None,
        pressure: np.ndarray | None = None,
        velocity_ratio: float | None = None,
    ) -> np.ndarray:
        """Mask of the interface's nodes that are bonded, by the criterion.

        plastic_strain, pressure (nodes,): at the interface, the larger of both sides or of the history of contact as the
        caller sees fit; velocity_ratio: of the impact to the critical velocity. Raises ValueError where the value of the
        criterion is missing.
        """
        if self.kind == "none":
            return np.zeros(nodes, bool)
        if self.criterion == "all":
            return np.ones(nodes, bool)
        values: dict[str, np.ndarray | float | None] = {
            "plastic_strain": plastic_strain, "pressure": pressure, "velocity": velocity_ratio
        }  # fmt: skip
        value = values[self.criterion]
        if value is None:
            raise ValueError(f"the criterion {self.criterion!r} of adhesion needs a value, and there is none")
        threshold = 1.0 if self.threshold is None else self.threshold
        return np.broadcast_to(np.asarray(value) >= threshold, (nodes,)).copy()

    @property
    def in_impact(self) -> bool:
        """Whether bonds act from the greatest deformation on, while the particle rebounds: where they may break, or where the
        contact decides which there are. Others hold what has come to rest."""
        return self.kind == "cohesive" or (self.kind == "tied" and self.criterion in ("plastic_strain", "pressure"))

    @property
    def words(self) -> str:
        """The law in a line."""
        if self.kind == "none":
            return "none, contact and friction only"
        text: str = self.kind
        if self.strength is not None and self.energy is not None:
            text += f", {units.rounded(self.strength, 'MPa')} and {units.rounded(self.energy, 'J/m2')}"
            shear = (self.shear_strength, "MPa"), (self.shear_energy, "J/m2")
            of_shear = " and ".join(units.rounded(value, unit) for value, unit in shear if value is not None)
            text += f" ({of_shear} in shear)" if of_shear else ""
        reached = 1.0 if self.threshold is None else self.threshold
        where = {
            "all": "wherever they touch",
            "plastic_strain": f"where the plastic strain has reached {reached:g}",
            "pressure": f"where the pressure has reached {units.rounded(reached, 'MPa')}",
            "velocity": f"where the velocity has reached {reached:g} of the critical one",
        }
        return f"{text}, {where[self.criterion]}"

    def law(self) -> dict[str, float]:
        """Strengths (Pa) and energies (J/m2) for `contact.bond.Bond`; none for tied nodes, which is its default."""
        names = ("strength", "energy", "shear_strength", "shear_energy")
        return {name: float(value) for name in names if (value := getattr(self, name)) is not None}
