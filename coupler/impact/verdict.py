"""The verdict on a particle: whether it sticks to the target; and the share of the powder that stays. SI units."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..contact.particle_bonds import FEWEST, ParticleBonds
from ..files.summary import Values
from ..measures import (
    BROKEN,
    BY_BONDS,
    BY_FORMULA,
    BY_MOTION,
    BY_SCENE,
    BY_STRESS,
    EMBEDDED,
    REBOUNDS,
    STICKS,
    UNDECIDED,
)
from ..physics.adhesion import Adhesion
from ..plan.planning import ImpactPlan

REBOUND = 1.0  # m/s: smallest velocity off the surface of a particle that leaves; a slower one without contact rests
# of the energy that bonds have dissipated: a smaller margin is within the scatter due to the placement of points and elements, whose
# standard deviation is at most 0.2 of this energy (docs/evidence/bonding.md)
SCATTER = 0.5


@dataclass(frozen=True)
class Verdict:
    """The verdict "sticks", "rebounds" or "undecided", of a ceramic also "embedded" or "broken", with its reasons. rests_on: values
    that decide it; by: method, one of `measures.VERDICT_BY`.

    rebounded: whether the particle in the run rebounds by the law of the scene, also if formula and bonds, or the two metals, disagree
    and the verdict is undecided; None if the run does not show it. bonds: verdict of the computed bonds alone, "" if not evaluated.
    margin_J, margin_m_s: distance from the opposite verdict, None if nothing was compared. With a criterion of velocity: energy and
    velocity of the impact less the critical ones. Otherwise positive if bonds hold: the energy that they can absorb less the energy
    that can break them, and the velocity at which the particle has this energy; negative after a rebound: energy and velocity of the
    particle away from the surface. is_close: the margin of computed bonds is within the scatter of placements.
    """

    verdict: str
    rests_on: str
    by: str
    rebounded: bool | None = None
    bonds: str = ""
    margin_J: float | None = None
    margin_m_s: float | None = None
    is_close: bool = False


def judge(
    law: Adhesion, impact: ImpactPlan, mass: float, upwards: float, bonds: ParticleBonds | None, touches: bool = False,
    sunk: float | None = None, speed: float = 0.0,
) -> Verdict:  # fmt: skip
    """The verdict on a particle at the end of its impact. mass (kg); upwards (m/s): velocity of its centre normal to the surface;
    bonds: bonds of the particle, None if nothing bonded; touches: whether the particle is still in contact, for a ceramic;
    sunk (m): depth of its centre in a polymer, None on a metal; speed (m/s): of its centre, in any direction."""
    if not impact.can_bond:
        if impact.material.is_ceramic and (touches or max(upwards, speed) <= REBOUND):
            return Verdict(EMBEDDED, "it stays in its crater without a bond", BY_MOTION, rebounded=False)
        moving = f"; without contact it moves at {speed:.3g} m/s" if speed > REBOUND >= upwards and not touches else ""
        return _unbonded(f"no metallic bond forms with a ceramic{moving}", BY_MOTION, mass, upwards)
    if law.in_impact:
        decided = _by_bonds(mass, upwards, bonds)
        scatter = SCATTER * bonds.bond.dissipated if bonds is not None else 0.0
        if decided.margin_J is not None and abs(decided.margin_J) < scatter:
            words = f"{decided.rests_on}; the margin is so small that other positions of points and elements can change the verdict"
            decided = replace(decided, rests_on=words, is_close=True)
        return _with_formula(decided, impact)
    if law.kind == "tied" and law.criterion == "velocity":
        return _by_velocity(law, impact, mass, upwards)
    if law.kind == "tied":
        words = "the scene, which ties all particles that touch the target; bonds are not computed"
        return Verdict(STICKS, words, BY_SCENE, rebounded=False)
    if sunk is None:
        return _unbonded("there is no adhesion in the scene", BY_MOTION, mass, upwards)
    base = f"{impact.formula.base}, a polymer"
    if sunk > 0.0 and upwards <= REBOUND:
        depth = f"{sunk * 1e6:.3g} um"
        words = f"it is embedded in {base}: its centre lies {depth} below the surface, and it does not move off"
        return Verdict(EMBEDDED, words, BY_MOTION, rebounded=False)
    return _unbonded(f"no bond of metals forms on {base}, whose erosion is not modelled", BY_MOTION, mass, upwards)


def _with_formula(decided: Verdict, impact: ImpactPlan) -> Verdict:
    """The verdict of the computed bonds, compared with the formula. It is undecided if the two differ. `rests_on` gives both."""
    formula, bonds = impact.formula, decided.verdict
    words = formula.words(impact.towards)
    if formula.critical is None or bonds == UNDECIDED:
        return replace(decided, bonds=bonds, rests_on=f"{decided.rests_on}; {words}")
    other = formula.verdict(impact.towards)
    if other == bonds:
        return replace(decided, bonds=bonds, rests_on=f"{decided.rests_on}; it {other} by the formula, too ({words})")
    by_formula = "is undecided" if other == UNDECIDED else other
    both = f"it {bonds} by computed bonds ({decided.rests_on}); by the formula it {by_formula} ({words})"
    return replace(decided, verdict=UNDECIDED, bonds=bonds, rests_on=both)


def is_tied(law: Adhesion, impact: ImpactPlan) -> bool:
    """Whether a particle sticks because the scene ties it or because of its impact velocity, whatever its motion at the end of the
    impact."""
    return law.kind == "tied" and impact.can_bond and judge(law, impact, 1.0, 0.0, None).rebounded is False


def _by_bonds(mass: float, upwards: float, bonds: ParticleBonds | None) -> Verdict:
    """The verdict of the bonds computed in the impact: the energy that the bonds can still absorb is compared with the energy that
    can still break them."""
    whole = 0 if bonds is None else int(np.count_nonzero(~bonds.bond.broken))
    if bonds is None or whole == 0:
        return _unbonded("no bond formed" if bonds is None else "all bonds are torn", BY_BONDS, mass, upwards)
    motion = 0.5 * mass * max(upwards, 0.0) ** 2
    if upwards > REBOUND and bonds.may_break(motion):
        left = f"the {whole} of {len(bonds.bond)} bonds that hold can absorb {bonds.bond.resistance.sum() / motion:.0%} of its energy"
        return _unbonded(left, BY_BONDS, mass, upwards)
    if whole < FEWEST:
        few = f"only {whole} of {len(bonds.bond)} bonds {'hold' if whole > 1 else 'holds'}"
        return Verdict(UNDECIDED, few, BY_BONDS)
    resistance, energy = bonds.resistance, 0.5 * mass * upwards**2 + bonds.bond.stored
    if math.isinf(resistance):
        unbreakable = f"{whole} of {len(bonds.bond)} bonds hold, and they cannot break"
        return Verdict(STICKS, unbreakable, BY_BONDS, rebounded=False)
    words = f"bonds can absorb {resistance * 1e9:.3g} nJ; {energy * 1e9:.3g} nJ of energy can break them"
    if resistance <= energy:
        return Verdict(UNDECIDED, words, BY_BONDS)
    spare = resistance - energy
    return Verdict(STICKS, words, BY_BONDS, rebounded=False, margin_J=spare, margin_m_s=math.sqrt(2.0 * spare / mass))


def _by_velocity(law: Adhesion, impact: ImpactPlan, mass: float, upwards: float) -> Verdict:
    """The verdict of the formula, from the normal velocity and the critical velocities of both metals. Whether the scene ties the
    particle depends only on the critical velocity of the particle's own metal."""
    formula, velocity = impact.formula, impact.towards
    verdict, ratio = formula.verdict(velocity, law.limit), impact.velocity_ratio
    words, margin = f"{formula.words(velocity, law.limit)}; bonds are not computed", formula.margin(velocity, law.limit)
    rebounded = None if ratio is None else False if ratio >= law.limit else True if upwards > REBOUND else None
    if verdict == REBOUNDS and rebounded is None:
        return Verdict(UNDECIDED, f"{words}, and it does not leave the target (velocity {upwards:.2g} m/s)", BY_FORMULA)
    if margin is None:
        return Verdict(verdict, words, BY_FORMULA, rebounded)
    energy = 0.5 * mass * (velocity**2 - (velocity - margin) ** 2)
    return Verdict(verdict, words, BY_FORMULA, rebounded, margin_J=energy, margin_m_s=margin)


def _unbonded(reason: str, by: str, mass: float, upwards: float) -> Verdict:
    """The verdict on a particle without bonds: "rebounds" if it is faster than REBOUND, else "undecided"."""
    if upwards <= REBOUND:
        return Verdict(UNDECIDED, f"{reason}, and it does not leave the target (velocity {upwards:.2g} m/s)", by)
    words, energy = f"{reason}, it leaves the target at {upwards:.3g} m/s", -0.5 * mass * upwards**2
    return Verdict(REBOUNDS, words, by, rebounded=True, margin_J=energy, margin_m_s=-upwards)


def verdict_values(
    law: Adhesion, impact: ImpactPlan, mass: float, upwards: float, bonds: ParticleBonds | None, is_lost: bool = False,
    touches: bool = False, broken: str = "", sunk: float | None = None, speed: float = 0.0,
) -> Values:  # fmt: skip
    """The values of the verdict for the record of a finished impact.

    is_lost: the particle has slid over the rim of the target, and counts as rebounded; touches, sunk, speed: as in `judge`; broken:
    why a ceramic particle is broken, "" for a whole one; a broken one counts as rebounded, with None for both values of its rebound.
    rebound_velocity_m_s: velocity of the centre of mass off the target, None for a particle that does not rebound; restitution:
    velocity off the target after the impact divided by the velocity towards it before, 0 for a particle that stays, None if it is
    unknown whether it stays; verdict_by_bonds: verdict of the computed bonds alone; bonded_area_m2: area that has bonded;
    bonded_area_end_m2: part of it that still holds; bond_energy_J: energy to break all bonds in tension, None if a bond does not break.
    """
    lost = Verdict(REBOUNDS, "it has slid over the rim of the target", BY_MOTION, rebounded=True)
    decided = lost if is_lost else judge(law, impact, mass, upwards, bonds, touches, sunk, speed)
    if broken:
        decided = Verdict(BROKEN, broken, BY_STRESS, rebounded=True)
    left, is_whole = decided.rebounded, decided.verdict != BROKEN
    stays = left is False and (law.in_impact or decided.verdict in (STICKS, EMBEDDED))
    values: Values = {
        "verdict": decided.verdict, "verdict_criterion": law.words, "verdict_by": decided.by,
        "verdict_rests_on": decided.rests_on, "verdict_is_close": decided.is_close,
        "margin_J": decided.margin_J, "margin_m_s": decided.margin_m_s, "rebounded": left,
        "restitution": max(upwards, 0.0) / impact.towards if left and is_whole else 0.0 if stays else None,
        "rebound_velocity_m_s": max(upwards, 0.0) if left and is_whole else None,
    }  # fmt: skip
    if law.in_impact:
        area, bond = (np.zeros(0), None) if bonds is None else (bonds.bond.area, bonds.bond)
        energy = 0.0 if bond is None else float(area @ bond.energy[:, 0])
        values |= {
            "verdict_by_bonds": decided.bonds or decided.verdict,
            "bonded_area_m2": float(area.sum()),
            "bonded_area_end_m2": 0.0 if bond is None else float(area @ bond.soundness),
            "bond_energy_J": energy if math.isfinite(energy) else None,
        }
    return values | {"velocity_ratio": impact.velocity_ratio, "particle_mass_kg": mass}


def efficiency_range(records: Sequence[Values]) -> tuple[float, float]:
    """Smallest and largest deposition efficiency (mass that stayed divided by the mass of all particles), from the records of the
    impacts. Undecided particles count as lost for the smallest value, as staying for the largest.

    A record can have the key detached_mass_kg: mass that has come off its splat. This mass is lost for both values.
    """
    mass = sum(record["particle_mass_kg"] for record in records)
    decided = {
        STICKS: (0.0, 0.0), EMBEDDED: (0.0, 0.0), REBOUNDS: (1.0, 1.0), BROKEN: (1.0, 1.0), UNDECIDED: (1.0, 0.0)
    }  # fmt: skip
    lost = [0.0, 0.0]  # most, least
    for record in records:
        least = record.get("detached_mass_kg", 0.0)
        for k, share in enumerate(decided[record["verdict"]]):
            lost[k] += max(share * record["particle_mass_kg"], least)
    return 1.0 - lost[0] / mass, 1.0 - lost[1] / mass
