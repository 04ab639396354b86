"""The contents of summary.json, from the records of the impacts (form: docs/guide/files.md)."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from .. import __version__
from ..files.summary import FORMAT, Summary, Values
from ..impact.summary import ImpactRecord, accepted, peak_memory
from ..impact.validity import merged
from ..impact.verdict import efficiency_range
from ..measures import DISSIPATION_LIMIT, PLASTIC_SHARE_LIMIT
from ..plan.planning import Plan
from ..plan.remarks import BEYOND_FIT
from ..ranks.ranks import Ranks
from ..splat.cloud import MIN_POINTS
from ..target.equilibrium import RELAX_STEPS
from .pause import AT_AMBIENT

FRAGMENTS = 0.01  # share of the mass of a particle: a run warns if more is lost in fragments too small for a mesh

# Limits of numerical losses: key in the record of an impact, limit, warning
LIMITS = (
    ("numerical_dissipation", DISSIPATION_LIMIT, "numerical viscosity and hourglass control took {share:.0%} of the kinetic energy,"
     " more than {limit:.0%}: they change the shape of the splat; try a finer preset"),
    ("dissipation_of_plastic", PLASTIC_SHARE_LIMIT, "in the particle, numerical viscosity and hourglass control took {share:.0%} of the"
     " plastic work, more than {limit:.0%}: plastic strains are too low; try a finer preset"),
)  # fmt: skip


def simulated(records: Sequence[ImpactRecord]) -> float:
    """Simulated time of all these impacts together, s."""
    return float(sum(record.values["end"]["time_s"] for record in records))


def summary(
    plan: Plan,
    records: Sequence[ImpactRecord],
    joins: list[Values],
    standing: Sequence[Mapping[str, float] | None],
    wall: float,
    ranks: Ranks,
    closing: Values | None = None,
) -> Summary:
    """The summary of a run.

    records: records of the impacts; joins: reports of the joining of splats; standing: shape of each splat at the end, None for a
    splat that has left (`target.positions.splats_at_end`); wall: wall time, s; closing: report of the closing stage.
    """
    reports, detached = [*joins, closing or {}], dict[int, float]()  # detached: mass (kg) that has come off each splat
    for each in (each for report in reports for each in report.get("detached", [])):
        detached[each["splat"]] = detached.get(each["splat"], 0.0) + each["mass_kg"]
    fragments = {join["impact"]: join["lost_mass_kg"] for join in joins if join.get("lost_mass_kg")}
    impacts, own = [record.values for record in records], [text for record in records for text in record.warnings]
    expected = [text for text in plan.warnings if BEYOND_FIT not in text]  # the impacts report the values they reached
    undecided = impacts[-1]["undecided"]
    for i, shape in enumerate(standing):
        refused = dict(impacts[i]["refused"])
        at_end = accepted(shape, refused, "at_end.") if shape is not None else None
        if undecided is not None and at_end is not None:  # the target is not at rest
            at_end, refused["at_end"] = None, undecided
        impacts[i] = {**impacts[i], "at_end": at_end, "refused": refused}
        if lost := detached.get(i + 1, 0.0) + fragments.get(i + 1, 0.0):
            impacts[i]["detached_mass_kg"] = impacts[i]["particle_mass_kg"] if shape is None else lost
    return {
        "format": FORMAT,
        "version": __version__,
        "run": {
            "engine": plan.engine,
            "effects": plan.effects.active,
            "element_size_m": plan.target.element_size,
            **_efficiency(impacts),
            "undecided": undecided,
            "sim_time_s": simulated(records),
            "steps": sum(impact["steps"] for impact in impacts),
            "wall_s": wall,
            "wall_loop_s": sum(impact["wall_loop_s"] for impact in impacts),
            "ranks": ranks.size,
            "memory_peak_bytes": max(peak_memory(), *(record.memory_peak for record in records)),  # of one process
            "warnings": [
                *plan.skipped,
                *(
                    f"splat {n} has come off, {kg * 1e12:.3g} ng: its bonds are broken, and its mass counts as lost"
                    for n, kg in detached.items()
                ),
                *(
                    f"impact {n}: {share:.1%} of the particle has separated as fragments of fewer than {MIN_POINTS} points,"
                    " which cannot be meshed; their mass counts as lost"
                    for n, kg in fragments.items()
                    if (share := kg / impacts[n - 1]["particle_mass_kg"]) > FRAGMENTS
                ),
                *(text for report in reports for text in unsettled(report)),
                *(text for limit in LIMITS for text in merged(_above(impacts, *limit))),
                *merged([*expected, *own]),
            ],
            "retries": [asdict(retry) for record in records for retry in record.retries],
        },
        "impacts": impacts,
        "joins": joins,
        **({"closing": closing} if closing is not None else {}),
    }  # fmt: skip


def _efficiency(impacts: Sequence[Values]) -> Values:
    """Deposition efficiency: mass that stayed, divided by the mass of all particles. If particles are undecided, it is replaced
    by None, and its range without and with the mass of these particles is added."""
    least, most = efficiency_range(impacts)
    if most - least < 1e-12:
        return {"deposition_efficiency": least}
    return {"deposition_efficiency": None, "deposition_efficiency_range": [least, most]}


def unsettled(report: Values) -> list[str]:
    """Warnings if bodies have not reached equilibrium or ambient temperature. report: of a joining and its pause, or of the closing."""
    if (off := report.get("off_ambient_K", 0.0)) > AT_AMBIENT:
        return [f"the bodies cool only to within {off:.0f} K of ambient, because plastic work heats them"]
    pause = report.get("cooling", {})
    steps = [report.get(name, 0) for name in ("settle_steps", "whole_settle_steps", "then_settle_steps")]
    steps += [pause.get(name, 0) for name in ("balance_steps", "then_settle_steps")]
    if max(steps) < RELAX_STEPS:
        return []
    when, then = "after cooling to ambient", "the stresses are not exactly residual stresses"
    if "impact" in report:
        when, then = f"after impact {report['impact']}", "the later pauses reduce the imbalance"
    return [f"{when} the bodies have not reached equilibrium in {RELAX_STEPS} steps: {then}"]


def _above(impacts: Sequence[Values], key: str, limit: float, words: str) -> list[str]:
    """A warning for each impact in which the share `key` is above the limit. words: text with the fields {share} and {limit}."""
    shares = {number: impact[key] for number, impact in enumerate(impacts, 1) if (impact[key] or 0.0) > limit}
    return [f"impact {number}: {words.format(share=share, limit=limit)}" for number, share in shares.items()]
