"""The record of a finished impact for summary.json."""

import resource
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..files.summary import Values
from ..measures import STICKS, UNDECIDED, within_range
from .ending import EndCriterion
from .exchange import Impact
from .ledger import FLOWS
from .measure import share_inside_itself
from .recorder import Recorder
from .retry import Retry
from .verdict import verdict_values

# values that are None without a verdict, and for an undecided impact, in addition to the measures at the end
_NEED_VERDICT = ("rebound_velocity_m_s", "rebounded", "restitution", "margin_J", "margin_m_s")
NEEDS_REST = (*_NEED_VERDICT, "bonded_area_end_m2")
INSIDE_ITSELF = 0.002  # share of points inside another part of the particle: fewer are single points near an edge
STUCK = "the particle sticks"  # reason for no rebound velocity
# share of the points above the tensile limit at which a ceramic particle is broken: below it they are single points at its contact
BROKEN_SHARE = 0.01


@dataclass(frozen=True)
class ImpactRecord:
    """Record of a finished impact for summary.json. values: its entry in `impacts`; warnings, retries: its entries in the lists of
    the run; memory_peak: largest memory of all processes, bytes."""

    values: Values
    warnings: list[str]
    retries: list[Retry]
    memory_peak: float


def summarise(
    impact: Impact, recorder: Recorder, ending: EndCriterion, retries: Sequence[Retry], wall: float, looped: float
) -> ImpactRecord:
    """The record of a finished impact. wall (s): total wall time; looped (s): wall time in the time loop.

    A value is None, with a reason in `refused`, if it is outside its range, if it describes the end state and the impact is undecided,
    if it is the rebound velocity of a particle that does not rebound, or if it is divided by a plastic work that is too small.
    """
    # a coating continues without a particle that has slid off it
    several, cracked = len(recorder.plan.impacts) > 1, _cracked(recorder) if recorder.impact_plan.brittle == 0 else ""
    broken = cracked and f"{cracked}: it counts as broken and not deposited, but is computed as whole"
    is_lost = several and ending.slid_off(impact.time)
    undecided = None if is_lost or (several and broken) else ending.undecided(impact.time, impact.sinking)
    particle, measured = impact.particle, recorder.measures(impact)
    mass, upwards = float(particle.mass.sum()), -impact.sinking
    speed = float(np.linalg.norm(particle.totals.momentum)) / mass
    ground, sunk = recorder.plan.target.materials[-1], None
    if ground.is_polymer and recorder.impact_plan.formula.base == ground.name:
        sunk = impact.domains.level - float(particle.mass @ particle.x[:, 2]) / mass
    law, impact_plan = recorder.plan.adhesion, recorder.impact_plan
    touches = ending.loud == ending.time  # the contact had a force when last observed: it holds an embedded particle
    own = verdict_values(law, impact_plan, mass, upwards, impact.bonds, is_lost, touches, broken, sunk, speed)
    own |= _computed(impact, recorder)
    own |= {"wall_s": wall, "wall_loop_s": looped, "idle_share": particle.idle(looped), "undecided": undecided}
    end: Values = {**measured}
    if not ending.settled(impact.time) and not is_lost and not broken:
        own |= {"verdict": UNDECIDED, "verdict_by": None, "verdict_is_close": False, **dict.fromkeys(_NEED_VERDICT)}
        own["verdict_rests_on"] = undecided or "the particle is still in contact"
        own |= {"verdict_by_bonds": UNDECIDED} if "verdict_by_bonds" in own else {}
    missing = [key for key in ("rebounded", "restitution", "rebound_velocity_m_s") if own[key] is None]
    refused = dict.fromkeys(missing, STUCK if own["verdict"] == STICKS else str(own["verdict_rests_on"]))
    if undecided is not None:
        end |= dict.fromkeys(measured.keys() - {"time_s"})
        unknown = [key for key in NEEDS_REST if key in own]
        own |= dict.fromkeys(unknown)
        refused = dict.fromkeys([*unknown, *(f"end.{key}" for key in end if key != "time_s")], undecided)
    if own["dissipation_of_plastic"] is None:
        share = f"{FLOWS:.0%} of its kinetic energy"
        refused["dissipation_of_plastic"] = f"the plastic work of the particle is below {share}"
    if recorder.impact_plan.brittle is not None:
        own |= {"tension_max_Pa": recorder.seen.tension, "broken_share": recorder.seen.broken_share}
    own = accepted(own, refused)
    end = accepted(end, refused, "end.")
    greatest = accepted(recorder.seen.greatest, refused, "greatest.") if recorder.seen.greatest is not None else None
    values = {**own, "greatest": greatest, "end": end, "refused": refused, "errors": {}}
    warnings = [*_beyond(impact, recorder), *_molten(impact, recorder), *map(str, retries)]
    return ImpactRecord(values, warnings, list(retries), sum(particle.everywhere(peak_memory)))


def _cracked(recorder: Recorder) -> str:
    """Text about tensile stress above the limit in a particle's ceramic; "" without ceramic or below BROKEN_SHARE of its points."""
    index, seen = recorder.impact_plan.brittle, recorder.seen
    if index is None or seen.broken_share < BROKEN_SHARE:
        return ""
    limit = (recorder.impact_plan.materials[index].tensile_limit or 0.0) / 1e6
    return f"tensile stress of up to {seen.tension / 1e6:.0f} MPa, above {limit:.0f} MPa at {seen.broken_share:.0%} of its points"


def _computed(impact: Impact, recorder: Recorder) -> Values:
    """Data about the computation: input, resolution, time steps, and errors of the energy and momentum balances."""
    particle, target, ledger, impact_plan = impact.particle, impact.target, impact.ledger, recorder.impact_plan
    energies = {name: value for name, value in ledger.rows.items() if name not in ("drift", "momentum_error")}
    return {
        "material": impact_plan.material.name,
        "diameter_m": impact_plan.diameter,
        "speed_m_s": float(np.linalg.norm(impact_plan.velocity)),
        "surface_level_m": impact.domains.level,
        "penetration_max_m": impact.deepest,
        "contact_dropped": impact.contact.sums.dropped,
        "contact_dropped_bodies": impact.bodies.contact.pairs.sums.dropped if impact.bodies.contact is not None else 0,
        "energy_drift": ledger.rows["drift"],
        "momentum_error": ledger.rows["momentum_error"],
        "numerical_dissipation": (energies["numerical_particle"] + energies["numerical_target"]) / ledger.kinetic_0,
        "dissipation_of_plastic": ledger.dissipation_of_plastic,
        "points": particle.n,
        "elements": len(target.mesh.conn),
        "nodes": len(target.nodes.x),
        "spacing_m": particle.spacing,
        "steps": particle.steps,
        "dt_mean_s": impact.time / particle.steps,
        "dt_limited_by": impact.limits,
        "numerics": asdict(particle.numerics),
        "kinetic_energy_0_J": ledger.kinetic_0,
        "energies": {name: value / ledger.kinetic_0 for name, value in energies.items()},
    }


def accepted(values: Mapping[str, Any], refused: dict[str, str], block: str = "") -> dict[str, Any]:
    """The values, with None in place of values outside their range. The reasons are added to `refused`, under the key block + key."""
    kept, reasons = within_range(values)
    refused |= {block + key: reason for key, reason in reasons.items()}
    return kept


def _beyond(impact: Impact, recorder: Recorder) -> list[str]:
    """Warnings about limits of models that the impact has exceeded, and about rims that the particle has reached."""
    plan, impact_plan, number = recorder.plan, recorder.impact_plan, recorder.i + 1
    metals = {"particle": impact_plan.material, "target": plan.target.materials[-1]}
    beyond = recorder.seen.extremes.warnings(number, metals, plan.effects.mie_gruneisen)
    if impact.folding is not None:
        share = share_inside_itself(impact.folding.surface, impact.particle.x)
        if share > INSIDE_ITSELF:
            beyond.append(
                f"impact {number}: {share:.1%} of the particle's points lie inside another part of the particle; shape and strain"
                " are wrong there: try a finer preset"
            )
    if impact_plan.brittle == 1 and (text := _cracked(recorder)):
        core = impact_plan.materials[1].name
        beyond.append(f"impact {number}: {text} in the core of {core}: it cracks, but is computed as whole")
    if (share := recorder.seen.base_tension) > 1.0:
        names = ", ".join(ceramic.name for ceramic in plan.target.ceramics)
        beyond.append(
            f"impact {number}: in the target the tensile stress reached {share:.2g} times the limit of {names}: it cracks, but is"
            " computed as whole"
        )
    if recorder.seen.over_rim:
        beyond.append(
            f"impact {number}: the particle went over the rim of the substrate ({plan.target.diameter * 1e6:.4g} um wide),"
            " while a real substrate is wider: increase substrate.diameter"
        )
    if recorder.seen.at_rim:
        beyond.append(
            f"impact {number}: the particle touched the rim of its window of {impact_plan.window * 1e6:.4g} um, beyond which"
            " the target does not deform: increase substrate.window"
        )
    return beyond


def _molten(impact: Impact, recorder: Recorder) -> list[str]:
    """Warnings about material above its melting point, because the material law has no latent heat and no liquid."""
    particle, target = impact.particle, impact.target
    sphere = np.pi / 6.0 * recorder.impact_plan.diameter**3
    melting = particle.law["T_m"][particle.law_of], target.laws["T_m"][target.law_of]
    shares = particle.mass / particle.mass.sum(), target.mesh.V0 / sphere
    warnings = []
    present = particle.points.T, target.elements.T
    for name, T, T_m, share in zip(("particle", "target"), present, melting, shares, strict=True):
        molten = T > T_m
        if molten.any():
            worst = int(np.argmax(T / T_m))
            warnings.append(
                f"impact {recorder.i + 1}: the {name} has reached {T[worst]:.0f} K,"
                f" above its melting point of {T_m[worst]:.0f} K"
                f" ({share[molten].sum():.2%} of the particle's volume): the material law has no latent heat and no melt"
            )
    return warnings


def peak_memory() -> float:
    """Largest resident memory of this process so far, bytes."""
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
