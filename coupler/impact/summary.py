"""The record of a finished impact for summary.json."""

import resource
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from .. import __version__
from ..plan.bands import half_widths
from .exchange import Impact
from .rebound import outcome
from .recorder import Recorder
from .retry import Retry

DISSIPATION_ALARM = (
    0.2  # of the kinetic energy: beyond it the numerical dissipation is no longer small beside plastic work
)


def summarise(
    impact: Impact,
    recorder: Recorder,
    retries: Sequence[Retry],
    wall: float,
    looped: float,
    undecided: str | None,
    settled: bool,
) -> dict[str, Any]:
    """The record of a finished impact. wall: s of wall time that it has taken in all; looped: s in the time loop; undecided: why it
    ended without its end criterion, None where it has met it; settled: whether the contact has come to an end."""
    particle, target, ledger = impact.particle, impact.target, impact.ledger
    plan, impact_plan = recorder.plan, recorder.impact_plan
    end = recorder.measures(impact)
    others = ("drift", "momentum_error")
    energies = {name: value / ledger.kinetic_0 for name, value in ledger.rows.items() if name not in others}
    return {
        **{name: value for name, value in end.items() if name != "time_s"},
        "material": impact_plan.material.name,
        "diameter_m": impact_plan.diameter,
        "speed_m_s": float(np.linalg.norm(impact_plan.velocity)),
        "surface_level_m": impact.domains.level,
        "rebound_velocity_m_s": max(end["velocity_z_m_s"], 0.0),
        "energy_drift": ledger.rows["drift"],
        "momentum_error": ledger.rows["momentum_error"],
        "numerical_dissipation": ledger.numerical_dissipation,
        "penetration_max_m": impact.deepest,
        "points": particle.n,
        "elements": len(target.mesh.conn),
        "nodes": len(target.x),
        "spacing_m": particle.spacing,
        "element_size_m": plan.target.element_size,
        "steps": particle.steps,
        "dt_mean_s": impact.time / particle.steps,
        "dt_limited_by": impact.limits,
        "engine": plan.engine,
        "numerics": asdict(particle.numerics),
        "sim_time_s": impact.time,
        "wall_s": wall,
        "wall_loop_s": looped,
        "placement": particle.ranks.placement,
        "ranks": particle.ranks.size,
        "idle_share": particle.idle(looped),
        "memory_peak_bytes": sum(particle.everywhere(peak_memory)),
        "kinetic_energy_0_J": ledger.kinetic_0,
        "energies": energies,
        "greatest_deformation": recorder.greatest,
        "end": end,
        "effects": plan.effects.active,
        "warnings": [*plan.warnings, *_beyond(impact, recorder), *_molten(impact, recorder), *map(str, retries)],
        "retries": [asdict(retry) for retry in retries],
        "bands": half_widths(
            impact_plan.bands, end | {"rebound_velocity_m_s": max(end["velocity_z_m_s"], 0.0)}, impact_plan.temperature
        ),
        "version": __version__,
        "undecided": undecided,
        **outcome(plan, recorder.i, particle, impact.hold, settled),
    }


def _beyond(impact: Impact, recorder: Recorder) -> list[str]:
    """Warnings where the impact left the range that its models were fitted in."""
    plan, impact_plan, number = recorder.plan, recorder.impact_plan, recorder.i + 1
    metals = {"particle": impact_plan.material, "target": plan.target.material}
    beyond = recorder.extremes.warnings(number, metals, plan.effects.mie_gruneisen)
    if recorder.over_rim:
        beyond.append(
            f"impact {number}: the particle went over the rim of the substrate ({plan.target.diameter * 1e6:.4g} um wide),"
            " which a real one does not have there: make substrate.diameter larger"
        )
    if recorder.in_layer:
        beyond.append(
            f"impact {number}: the particle touched the rim of its window of {impact_plan.window * 1e6:.4g} um, where the"
            " target is held back: make substrate.window larger"
        )
    dissipated = impact.ledger.numerical_dissipation
    if dissipated > DISSIPATION_ALARM:
        beyond.append(
            f"impact {number}: viscosity and hourglass control took {dissipated:.0%} of the kinetic energy, more than"
            f" {DISSIPATION_ALARM:.0%}: they shape the splat beside the metal's own strength, try a finer preset"
        )
    return beyond


def _molten(impact: Impact, recorder: Recorder) -> list[str]:
    """Warnings of matter above its melting point: the law has no latent heat and no liquid."""
    particle, target = impact.particle, impact.target
    melting = target.laws["T_m"][target.law_of]
    sphere = np.pi / 6.0 * recorder.impact_plan.diameter**3
    warnings = []
    for name, T, T_m, share in (
        ("particle", particle.T, np.full(particle.n, particle.law["T_m"][0]), particle.mass / particle.mass.sum()),
        ("target", target.T, melting, target.mesh.V0 / sphere),
    ):
        molten = T > T_m
        if molten.any():
            worst = int(np.argmax(T / T_m))
            warnings.append(
                f"impact {recorder.i + 1}: the {name} went beyond melting, to {T[worst]:.0f} K where it melts at {T_m[worst]:.0f} K"
                f" ({share[molten].sum():.2%} of the particle's volume): the law knows no latent heat and no melt"
            )
    return warnings


def peak_memory() -> float:
    """Largest resident memory of this process so far, bytes."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
