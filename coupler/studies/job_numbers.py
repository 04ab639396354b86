"""The numbers of a job with ranges, trust marks and origins. They are the contents of job.json and the table of its page."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..measures import STICKS
from ..plan.job import Choice, Job
from ..plan.text import duration
from ..report.words import with_error
from ..spray.window import Spray
from .coating import CoatingMeasures
from .job_parts import Bonds, Coating, efficiency, ends, thickness
from .trust import mark

BAND = 0.2  # relative uncertainty of the critical velocity by the formula, as in `coldspray window`
AGREE = 0.5  # share of the mass: two values on different sides of it disagree
FLOWN, CRITICAL = "velocity at impact", "critical velocity"
NOT_IN = (
    "oxide film (its strength is known within a factor of two)", "friction", "gas and drag", "resolution of the coatings",
    "shape of the powder",
)  # fmt: skip
APART = "Formula and computed bonds disagree."
COATING = "Porosity", "Roughness Sa", "Residual stress in the plane"
Range = tuple[float, float, float]  # value, least, greatest


@dataclass(frozen=True)
class Number:
    """A line of the table of numbers. formula, computed: value with its range as text, "" if there is none; values: the same in SI,
    for job.json; colour, why: its trust mark (`trust.Mark`); how: method; folder: folder of its runs, relative to the folder of the
    job."""

    label: str
    formula: str
    computed: str
    values: dict[str, Range | None]
    colour: str
    why: str
    how: str
    folder: str = ""


def formula_share(spray: Spray, on_substrate: bool) -> Range:
    """Mass fraction that sticks by the formula. Returns also its smallest and largest value if the critical velocity changes by
    BAND."""
    each = [spray.fates(f, on_substrate)[STICKS] for f in (1.0, *np.linspace(1.0 - BAND, 1.0 + BAND, 9).tolist())]
    return each[0], min(each), max(each)


def numbers(job: Job, bonds: Sequence[Bonds], coating: Coating) -> list[Number]:
    """All lines of the table of numbers, in their order."""
    spray, lines = job.arrived, [flown(job)]
    for base in job.bases:
        found = next((each for each in bonds if each.base == base), None)
        lines += on_metal(job, base, found if found is None or not found.failed else None)
    share, v = lines[-1].values, float(spray.velocity[len(spray.velocity) // 2])
    return lines + of_coating(job, share, coating, v)


def flown(job: Job) -> Number:
    """The table line of the velocities at impact."""
    spray, k = job.arrived, [int(len(job.arrived.share) * share) for share in (0.1, 0.5, 0.9)]
    v, T = (", ".join(f"{values[i]:.0f}" for i in k) for values in (spray.velocity, spray.temperature))
    slowest, middle, fastest = sorted(spray.velocity[k].tolist())
    values: dict[str, Range | None] = {"computed": (middle, slowest, fastest)}
    label, how = "Velocity at impact of D10, D50, D90", f"flight through nozzle {job.nozzle.name}; at impact {T} K"
    return Number(label, "", f"{v} m/s", values, *mark((FLOWN,), job.metal.name, middle), how)


def on_metal(job: Job, base: str, found: Bonds | None) -> list[Number]:
    """The table lines about a metal that the powder hits: critical velocity, and mass fraction that sticks. found: result of computed
    bonds, None if there is none."""
    spray, metal, is_own = job.arrived, job.metal.name, base == job.bases[-1]
    k, folder = len(spray.formula) // 2, found.folder if found else ""
    formula, v, name = spray.formula[k], float(spray.velocity[k]), job.metals[base].name
    known = {job.data.powder.material: formula.critical} | ({} if is_own else {base: formula.base_critical})
    limits = {who: value for who, value in known.items() if value is not None}
    by_formula = " and ".join(f"{value:.0f}{'' if is_own else f' ({who})'}" for who, value in limits.items())
    how = "Schmidt's formula" + ("; bonds computed through the oxide films" if found else "") + ", particle of D50"
    band = (max(limits.values()), (1.0 - BAND) * min(limits.values()), (1.0 + BAND) * max(limits.values()))
    by_bonds = (found.velocity, *found.band) if found else None
    marked = mark((CRITICAL,) if found else (), metal, v, name)
    label = f"Critical velocity on {base}" + (", after the first layer" if is_own else ", the first layer")
    values = {"formula": band, "computed": by_bonds}
    critical = Number(label, f"{by_formula} m/s", critical_words(found), values, *marked, how, folder)
    share, of_bonds = formula_share(spray, not is_own), efficiency(spray, found) if found else None
    marked = mark((CRITICAL, FLOWN) if found else (), metal, v, name)
    label = (
        f"Deposition efficiency after the first layer, {base} on {base}"
        if is_own
        else f"Share of the powder that sticks on {base}"
    )
    how = "mass of particles between 1 and 2 times (erosion) their critical velocity"
    values = {"formula": share, "computed": of_bonds}
    by_bonds_too = _percent(of_bonds) if of_bonds else ""
    return [critical, Number(label, _percent(share), by_bonds_too, values, *marked, how, folder)]


def critical_words(found: Bonds | None) -> str:
    """The critical velocity from computed bonds as text with its range."""
    if found is None:
        return "not computed"
    low, high = ends(found.found)
    if math.isinf(high):
        return f"above {low:.0f} m/s" if low else "no verdict"
    if found.found.low is None:
        return f"below {high:.0f} m/s"
    least, most = found.band
    return f"{found.velocity:.0f} m/s ({least:.0f} to {'-' if math.isinf(most) else f'{most:.0f}'})"


def of_coating(job: Job, shares: dict[str, Range | None], coating: Coating, v: float) -> list[Number]:
    """The table lines about the coating; none if no coating is computed. shares: deposition efficiency by "formula" and by "computed"
    bonds; v: velocity of the median particle, m/s."""
    if not coating.measures:
        return []
    name, (folder, first) = job.metal.name, next(iter(coating.measures.items()))
    porosity, spot = coating.over(pores).mean, f"{1e3 * job.data.spray.spot:.3g} mm"
    layers = {by: share and _range(thickness(job, x, porosity) for x in share) for by, share in shares.items()}
    quantities = (CRITICAL, FLOWN) if shares["computed"] else ()
    how = f"feed × efficiency / (density × (1 - porosity) × gun speed × spot), mean over the spot of {spot}"
    by_formula, by_bonds = (_um(layers[by]) for by in ("formula", "computed"))
    lines = [Number("Thickness of one pass", by_formula, by_bonds, layers, *mark(quantities, name, v), how, folder)]
    for label, of, value, factor, unit, how in (
        ("Porosity", ("density",), pores, 100.0, "%", f"open and closed pores thicker than {1e6 * first.void_limit_m:.2f} µm"),
        ("Roughness Sa", (), lambda c: c.Sa_m, 1e6, "µm", "mean distance of the surface from its mean height"),
        ("Residual stress in the plane", ("stress",), lambda c: c.stress_in_plane_Pa, 1e-6, "MPa", "mean of the"
        " cold coating; negative values are compression"),
    ):  # fmt: skip
        over = coating.over(value)
        mean, error = factor * over.mean, factor * over.error
        text = with_error(mean, error) if over.seeds > 1 else f"{mean:.2g}"
        values: dict[str, Range | None] = {"computed": (over.mean, over.least, over.greatest)}
        lines.append(Number(label, "", f"{text} {unit}", values, *mark(of, name, v), how, folder))
    return lines


def pores(coating: CoatingMeasures) -> float:
    """The sum of open and closed porosity."""
    return coating.porosity_open + coating.porosity_closed


def _range(values: Iterable[float]) -> Range:
    value, low, high = values
    return value, low, high


def _percent(share: Range) -> str:
    return f"{share[0]:.0%}" + (f" ({share[1]:.0%} to {share[2]:.0%})" if share[1] != share[2] else "")


def _um(layer: Range | None) -> str:
    if layer is None:
        return ""
    value, low, high = (f"{1e6 * x:.3g}" for x in layer)
    return f"{value} µm" + (f" ({low} to {high})" if low != high else "")


def answer(job: Job, lines: Sequence[Number]) -> list[str]:
    """The answer of the job in sentences. Disagreements between formula and computed bonds come first."""
    texts = []
    for line in lines:
        if (by_formula := line.values.get("formula")) is None or "ritical" in line.label or "Thickness" in line.label:
            continue
        by_bonds = line.values["computed"]
        text = f"{line.label}: {line.formula} by the formula, {line.computed if by_bonds else 'not computed'} by computed bonds."
        apart = by_bonds is not None and (by_formula[0] > AGREE) != (by_bonds[0] > AGREE)
        texts.append(f"{APART} {text}" if apart else text)
    coating = ", ".join(
        f"{line.label[0].lower()}{line.label[1:]} {line.computed}" for line in lines if line.label in COATING
    )
    texts.sort(key=lambda text: not text.startswith(APART))
    return [*texts, f"Coating, if all its particles stick: {coating}." if coating else "No coating is computed."]


def errors_in(choice: Choice, bonds: Sequence[Bonds], coating: Coating) -> list[str]:
    """Text: the kinds of error that the ranges of the numbers include."""
    texts = [f"by the formula: ± {BAND:.0%} of the critical velocity"]
    if bonds:
        texts.append(f"by bonds: the bracket of the search ({choice.tolerance:.0%})")
        texts += ["the resolution of the impacts"] if any(each.error is not None for each in bonds) else []
        sets = dict.fromkeys(name for each in bonds for name in each.sets)
        texts += [f"the strength of the powder ({', '.join(sets)})"] if sets else []
    if len(coating.measures) > 1:
        texts.append(
            f"for the coating: standard error of the mean of {len(coating.measures)} coatings of different particles"
        )
    return texts


def record(
    job: Job, choice: Choice, seconds: float, then: tuple[Choice, float] | None, bonds: Sequence[Bonds], coating: Coating
) -> dict[str, Any]:  # fmt: skip
    """The contents of job.json, SI."""
    lines = numbers(job, bonds, coating)
    is_in = {
        "resolution of the impacts": choice.coarser,
        "strength of the powder": choice.sets,
        "scatter between coatings": choice.seeds > 1,
    }
    more = (
        f"{duration(then[1])} would allow: {then[0].words}"
        if then
        else "more time changes nothing: this is the most that a job computes"
    )
    return {
        "job": job.name, "answer": answer(job, lines), "numbers": [asdict(line) for line in lines],
        "errors_in": errors_in(choice, bonds, coating),
        "errors_not_in": [*(name for name, there in is_in.items() if not there), *NOT_IN],
        "choice": asdict(choice), "computed": choice.words, "expected_s": seconds, "more_time": more,
        "failed": {each.folder: each.failed for each in bonds if each.failed} | dict(coating.failed),
        "bonds": [asdict(each) for each in bonds],
    }  # fmt: skip
