"""Does it stick? The verdict on the particle of an impact, and how much of the powder stayed. SI units."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..contact.hold import FEWEST, Hold
from ..files.summary import Values
from ..measures import BY_BONDS, BY_FORMULA, BY_MOTION, BY_SCENE, REBOUNDS, STICKS, UNDECIDED
from ..physics.adhesion import Adhesion
from ..plan.planning import ImpactPlan

REBOUND = 1.0  # m/s off the surface: a particle that nothing holds leaves with more
# of the energy that bonds have dissipated: a margin below it is within the scatter of placements of points and elements, whose
# standard deviation is 0.1 to 0.2 of it where particles rebound and half of it where they stick (docs/evidence/bonding.md)
SCATTER = 0.5


@dataclass(frozen=True)
class Verdict:
    """verdict: "sticks", "rebounds" or "undecided". rests_on: the values that decide it. by: of `measures.VERDICT_BY`, what decides.

    margin_J, margin_m_s: how far the verdict is from the other one; positive where the particle sticks: the energy that its bonds
    can take up beyond that in motion, and the velocity of the particle with this energy; or, by a criterion of velocity, the
    energy and velocity of impact above the critical ones. Negative where it rebounds: its energy and velocity off the surface, or
    below the critical ones. None where nothing was compared. is_close: the margin of computed bonds is within the scatter of
    placements of points and elements.
    """

    verdict: str
    rests_on: str
    by: str
    margin_J: float | None = None
    margin_m_s: float | None = None
    is_close: bool = False

    @property
    def rebounded(self) -> bool | None:
        """Whether the particle leaves; None where that is undecided."""
        return None if self.verdict == UNDECIDED else self.verdict == REBOUNDS


def judge(law: Adhesion, impact: ImpactPlan, mass: float, upwards: float, hold: Hold | None) -> Verdict:
    """The verdict on a particle at the end of its impact.

    mass kg; upwards m/s: velocity of its centre normal to the surface; hold: its bonds, None if nothing bonded.
    """
    if law.in_impact:
        decided = _by_bonds(mass, upwards, hold)
        if hold is None or decided.margin_J is None or abs(decided.margin_J) >= SCATTER * hold.bond.dissipated:
            return decided
        words = f"{decided.rests_on}; so close that another placement of points and elements may change it"
        return replace(decided, rests_on=words, is_close=True)
    if law.kind == "tied" and law.criterion == "velocity":
        return _by_velocity(law, impact, mass, upwards)
    if law.kind == "tied":
        return Verdict(STICKS, "the scene, which ties all that touches; no bond was computed", BY_SCENE)
    return _unheld("there is no adhesion in the scene", BY_MOTION, mass, upwards)


def is_tied(law: Adhesion, impact: ImpactPlan) -> bool:
    """Whether a particle sticks by the scene or by its velocity, whatever it does at the end of its impact."""
    return law.kind == "tied" and judge(law, impact, 1.0, 0.0, None).verdict == STICKS


def _by_bonds(mass: float, upwards: float, hold: Hold | None) -> Verdict:
    """From the bonds computed in the impact: what they can still take up against the energy left to part them."""
    whole = 0 if hold is None else int(np.count_nonzero(hold.whole))
    if hold is None or whole == 0:
        return _unheld("no bond formed" if hold is None else "all bonds are torn", BY_BONDS, mass, upwards)
    motion = 0.5 * mass * max(upwards, 0.0) ** 2
    if upwards > REBOUND and hold.gives_way(motion):
        left = f"the {whole} of {len(hold.rows)} bonds that hold can take up {hold.bond.resistance.sum() / motion:.0%} of its energy"
        return _unheld(left, BY_BONDS, mass, upwards)
    if whole < FEWEST:
        few = f"only {whole} of {len(hold.rows)} bonds {'hold' if whole > 1 else 'holds'}"
        return Verdict(UNDECIDED, few, BY_BONDS)
    resistance, energy = hold.resistance, 0.5 * mass * upwards**2 + hold.bond.stored
    if math.isinf(resistance):
        return Verdict(STICKS, f"{whole} of {len(hold.rows)} bonds hold, which do not break", BY_BONDS)
    words = f"bonds can take up {resistance * 1e9:.3g} nJ, {energy * 1e9:.3g} nJ are left to part them"
    if resistance <= energy:
        return Verdict(UNDECIDED, words, BY_BONDS)
    spare = resistance - energy
    return Verdict(STICKS, words, BY_BONDS, spare, math.sqrt(2.0 * spare / mass))


def _by_velocity(law: Adhesion, impact: ImpactPlan, mass: float, upwards: float) -> Verdict:
    """From the normal velocity of impact over the critical one of Schmidt's formula."""
    ratio, threshold = impact.velocity_ratio, 1.0 if law.threshold is None else law.threshold
    if ratio is None:
        return Verdict(UNDECIDED, "the critical velocity is not known", BY_FORMULA)
    velocity = abs(impact.velocity[2])
    critical = velocity / ratio * threshold
    words = f"Schmidt's formula: {velocity:.0f} m/s normal to the surface, critical {critical:.0f} m/s; no bond was computed"
    margin = 0.5 * mass * (velocity**2 - critical**2), velocity - critical
    if ratio >= threshold:
        return Verdict(STICKS, words, BY_FORMULA, *margin)
    if upwards <= REBOUND:
        return Verdict(UNDECIDED, f"{words}, and it does not move off ({upwards:.2g} m/s)", BY_FORMULA, *margin)
    return Verdict(REBOUNDS, words, BY_FORMULA, *margin)


def _unheld(reason: str, by: str, mass: float, upwards: float) -> Verdict:
    if upwards <= REBOUND:
        return Verdict(UNDECIDED, f"{reason}, and it does not move off ({upwards:.2g} m/s)", by)
    return Verdict(REBOUNDS, f"{reason}, it moves off at {upwards:.3g} m/s", by, -0.5 * mass * upwards**2, -upwards)


def verdict_values(
    law: Adhesion, impact: ImpactPlan, mass: float, upwards: float, hold: Hold | None, is_lost: bool = False
) -> Values:
    """The part of the record of a finished impact that is its verdict.

    is_lost: whether the particle has slid over the rim of the target, whatever the scene ties. rebound_velocity_m_s: velocity of the
    centre of mass off the target, None of a particle that does not rebound;
    restitution: velocity of the centre of mass off the target after the impact over that towards it before, 0 where it stays;
    bonded_area_m2, bonded_area_end_m2: all that bonded, and what of it holds; bond_energy_J: to tear all that bonded, in tension,
    None where a bond does not break.
    """
    lost = Verdict(REBOUNDS, "it has slid over the rim of the target", BY_MOTION)
    decided = lost if is_lost else judge(law, impact, mass, upwards, hold)
    left = decided.rebounded
    values: Values = {
        "verdict": decided.verdict, "verdict_criterion": law.words, "verdict_by": decided.by,
        "verdict_rests_on": decided.rests_on, "verdict_is_close": decided.is_close,
        "margin_J": decided.margin_J, "margin_m_s": decided.margin_m_s, "rebounded": left,
        "restitution": None if left is None else max(upwards, 0.0) / -impact.velocity[2] if left else 0.0,
        "rebound_velocity_m_s": max(upwards, 0.0) if left else None,
    }  # fmt: skip
    if law.in_impact:
        first, last = hold.area if hold is not None else (0.0, 0.0)
        energy = 0.0 if hold is None else float(hold.bond.area @ hold.bond.energy[:, 0])
        values |= {
            "bonded_area_m2": first,
            "bonded_area_end_m2": last,
            "bond_energy_J": energy if math.isfinite(energy) else None,
        }
    return values | {"velocity_ratio": impact.velocity_ratio, "particle_mass_kg": mass}


def deposition_efficiency(records: Sequence[Values]) -> float | None:
    """Mass that stayed over the mass of all particles, from the records of their impacts; None while one is undecided.

    detached_mass_kg of a record: what of its splat has come off later. An undecided one that has come off as a whole is lost.
    """
    undecided = [record for record in records if record["rebounded"] is None]
    if any(record.get("detached_mass_kg", 0.0) < record["particle_mass_kg"] for record in undecided):
        return None
    mass = [record["particle_mass_kg"] for record in records]
    lost = [
        m if record["rebounded"] else record.get("detached_mass_kg", 0.0)
        for m, record in zip(mass, records, strict=True)
    ]
    return float(1.0 - sum(lost) / sum(mass))
