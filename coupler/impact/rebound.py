"""Did it stick? What became of the particle of an impact, and how much of the powder stayed. SI units."""

from collections.abc import Sequence

from ..contact.hold import Hold
from ..files.summary import Values
from ..plan.planning import Plan
from ..ranks.distributed import DistributedParticle

REBOUND = 1.0  # m/s upwards: a splat that nothing holds leaves with more


def rebounds(plan: Plan, i: int, upwards: float, hold: Hold | None) -> bool:
    """Whether the particle of impact i leaves the target: nothing holds it and its centre moves off when the impact is over.

    upwards: m/s; hold: None if nothing bonded.
    """
    law = plan.adhesion
    if law.in_impact:
        bonded = hold is not None and bool(hold.whole.any())
    else:
        bonded = bool(law.bonded(1, velocity_ratio=plan.impacts[i].velocity_ratio).any())
    return not bonded and upwards > REBOUND


def outcome(plan: Plan, i: int, particle: DistributedParticle, hold: Hold | None, settled: bool) -> Values:
    """The record of the finished impact i beside its measures.

    restitution: velocity of the centre of mass off the target after the impact over that towards it before, 0 where it stays;
    bonded_area_m2, bonded_area_end_m2: where it bonded at its greatest deformation, and what of that held. settled: whether the
    contact has come to an end; before that rebound and restitution are undecided, None.
    """
    mass = float(particle.mass.sum())
    upwards = float(particle.momentum()[2]) / mass
    left = rebounds(plan, i, upwards, hold)
    first, last = hold.area if hold is not None else (0.0, 0.0)
    record: Values = {"rebounded": None, "restitution": None}
    if settled:
        record = {"rebounded": left, "restitution": upwards / -plan.impacts[i].velocity[2] if left else 0.0}
    if plan.adhesion.in_impact:
        record |= {"bonded_area_m2": first, "bonded_area_end_m2": last}
    return record | {"velocity_ratio": plan.impacts[i].velocity_ratio, "particle_mass_kg": mass}


def deposition_efficiency(records: Sequence[Values]) -> float | None:
    """Mass of the particles that stayed over the mass of all, from the records of their impacts; None while one is undecided."""
    if any(record["rebounded"] is None for record in records):
        return None
    mass = [record["particle_mass_kg"] for record in records]
    stayed = [m for m, record in zip(mass, records, strict=True) if not record["rebounded"]]
    return float(sum(stayed) / sum(mass))
